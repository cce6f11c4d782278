"""Shared by `convert` and `gait`: what --fill and --filter ask for and a recording in; the clean one, and what is to be said, out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.motion.filters import FilterChoice, FilteredRecording
    from asterism.motion.gaps import Filled
    from asterism.recording import Recording

Fill = Annotated[
    str,
    typer.Option(
        metavar="none|auto|MM",
        help="Fill the gaps of named markers whose 95 % interval is within MM to either side; auto is 10 mm.",
    ),
]
Filter = Annotated[
    str,
    typer.Option(
        "--filter",
        metavar="none|spline|butterworth[:HZ]",
        help="Low-pass filter without lag: a spline by cross-validation, or Butterworth at HZ, else by residual analysis.",
    ),
]
_AUTO = 0.010
"""m. Soft tissue moves markers by as much. Of 130 gaps of 1 s in walks of `movement` 83 % are filled, at half 62 %, at double 95 %."""


def fill_limit(fill: str) -> float | None:
    """The limit of the 95 % interval in m, None where nothing is to be filled. Raises AsterismError where it is none of these."""
    if fill in ("none", "auto"):
        return None if fill == "none" else _AUTO
    try:
        limit = float(fill) / 1000.0
    except ValueError:
        limit = math.nan
    if not (math.isfinite(limit) and limit > 0.0):
        raise AsterismError(f"--fill {fill}: give none, auto, or the largest uncertainty in mm, such as --fill 5.")
    return limit


def filled(recording: Recording, limit: float, trials: Sequence[Path], vertical: str | None = None) -> Filled:
    """The recording with its gaps filled, also from those of the trials (`session.trials_of`) that show the same person.

    Nothing is read where a recording has no gap. Raises AsterismError where no marker has a name.
    """
    from asterism import __version__
    from asterism.cli._options import vertical_axis
    from asterism.motion.gaps import fill_gaps
    from asterism.session import read_trials

    others = read_trials(recording, trials, vertical_axis(vertical))
    with _console.progress("filling gaps") as progress:
        return fill_gaps(recording, limit=limit, others=others, by=f"asterism {__version__}", progress=progress)


def cleaned(recording: Recording, choice: FilterChoice) -> FilteredRecording:
    """The recording filtered as asked, and its spikes."""
    from asterism import __version__
    from asterism.motion.filters import filter_trajectories

    return filter_trajectories(recording, choice, f"asterism {__version__}")


def filter_choice(text: str) -> FilterChoice:
    """What --filter says. Raises AsterismError where it is none of the choices."""
    from asterism.motion.filters import FilterChoice

    return FilterChoice.of(text)


def filter_values(effect: FilteredRecording) -> dict[str, Any]:
    """As JSON has it."""
    markers = [
        {
            "marker": one.label,
            "rms_change_m": one.moved,
            "cut_off_hz": None if math.isnan(one.cut_off) else one.cut_off,
            "spikes": one.spikes,
        }
        for one in effect.effects
    ]
    return {"filter": str(effect.choice), "markers": markers}


def filled_text(fill: Filled) -> str:
    """One sentence for a person."""
    if not fill.gaps:
        return "no gap filled"
    gaps = "1 gap" if fill.gaps == 1 else f"{fill.gaps} gaps"
    told = f", with {', '.join(trial_names(fill))} of the same person" if fill.trials else ""
    return f"{gaps} ({int(fill.filled.sum())} samples) filled, each within {1000.0 * fill.reach:.1f} mm (95 %){told}"


def trial_names(fill: Filled) -> list[str]:
    """The other trials that told, as the processing log names them."""
    return list(fill.recording.log[-1].settings.get("trials", ())) if fill.gaps and fill.recording.log else []


def as_values(fill: Filled) -> dict[str, Any]:
    """As JSON has it."""
    markers = [{"marker": label, "samples": many, "largest_deviation_m": most} for label, (many, most) in fill.by_marker().items()]
    return {"gaps": fill.gaps, "markers": markers, "trials": trial_names(fill)}
