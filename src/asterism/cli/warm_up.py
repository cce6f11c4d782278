"""`asterism warm-up`: what a first labelling does once, done beforehand."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from asterism.cli import _console
from asterism.cli._command import takes

_WORN = "helen-hayes"
"""What the simulated person wears."""


@dataclass(frozen=True)
class WarmUpOptions:
    """What `asterism warm-up` is asked to do."""

    markers: Annotated[
        list[str] | None,
        typer.Option(
            "--markers",
            metavar="SET",
            help="Make the model of virtual people who wear it: a shipped set, a TOML file, or names with commas; once for each set.",
            show_default=False,
        ),
    ] = None


@takes(WarmUpOptions)
def warm_up(options: WarmUpOptions) -> None:
    """Do beforehand what the first labelling does once.

    Compiles the numerical kernels of `asterism label`, and makes what marker sets are found by, and the models of virtual people who wear
    --markers. All of it is kept for later runs. To get there, a simulated walk of helen-hayes markers is labelled.
    """
    from asterism.cli._labelling import worn_sets
    from asterism.labelling import virtual_model

    started, given = time.perf_counter(), worn_sets(options.markers)
    with _console.progress("making models of virtual people") as progress:
        # all of them first: a set that cannot be used is told before the minute of compiling
        for one in given:
            virtual_model(one, progress=progress)
    with _console.progress("labelling a simulated person"):
        _label_somebody()
    made = "; ".join(dict.fromkeys([*(options.markers or ()), _WORN]))
    _console.result(f"Ready in {time.perf_counter() - started:.0f} s: kernels compiled; models of virtual people kept for {made}.")


def _label_somebody() -> None:
    """Look for the set of a simulated recording with gaps, and label it."""
    from tempfile import TemporaryDirectory

    from asterism import formats
    from asterism.recording import Recording
    from asterism.session import LabellingOptions, SetFinder, label_file
    from asterism.simulation import simulate_gaps_and_ghosts, simulate_walks

    walk = simulate_walks(subjects=1, frames=100, markers=_WORN, seed=1)[0]
    # pieces of tracks have kernels of their own
    clouds, _ = simulate_gaps_and_ghosts(walk, hidden=1, ghosts=0, seed=1)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "walk.c3d"
        formats.write(path, Recording.from_clouds(clouds))
        # without a model to compare sets by: the walk's set is known, and others are not asked for
        SetFinder().of(path, formats.read(path))
        label_file(path, options=LabellingOptions(markers=[_WORN]))
