"""`asterism demo`: simulated walkers in; a table, a report, labelled files and a model out."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._demo_training import MARKERS, train_on_walkers
from asterism.cli._options import Json, Seed

if TYPE_CHECKING:
    import numpy as np

    from asterism.labelling import MarkerModel
    from asterism.recording import Clouds, Ints, Labelling, Recording

_WALKERS, _NEW_WALKERS, _FRAMES, _RATE = 10, 2, 150, 50.0
_CONDITIONS = ((0, 0), (2, 0), (4, 0), (2, 3))
"""The numbers of markers in a gap and of ghosts at every moment. The last condition is the hardest; the report shows it."""


class DemoPart(StrEnum):
    """What the demo shows; without a word it is labelling."""

    LABELLING = "labelling"
    CAMERAS = "cameras"
    GARMENT = "garment"
    VIEWS = "views"
    MOTION = "motion"


_SHOWS = {
    DemoPart.CAMERAS: "calibrate, reconstruct, label",
    DemoPart.GARMENT: "capture a printed suit",
    DemoPart.VIEWS: "label in the images",
    DemoPart.MOTION: "joint angles under moving skin",
}
"""What each demo but the first does, as `asterism demo --help` says it."""


@dataclass(frozen=True)
class DemoOptions:
    """What `asterism demo` is asked to do."""

    part: Annotated[
        DemoPart,
        typer.Argument(
            metavar="|".join(_SHOWS),
            help=" ".join(f"{part}: {what}." for part, what in _SHOWS.items()),
            show_default=False,
        ),
    ] = DemoPart.LABELLING
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER", help="Where the files go.")] = Path("asterism-demo")
    seed: Seed = 0
    json: Json = None


@takes(DemoOptions)
def demo(options: DemoOptions) -> None:
    """Try it on simulated people, in about a minute.

    Without a word it is the labelling; the words name other parts.

    Ten people of different sizes walk for three seconds, 15 markers each. Eight train a model. It labels the recordings of the other two
    as `asterism label` does, each as a whole: markers vanish for up to a second and come back under new track numbers, and ghosts
    come and go. At last the same file is labelled without any training: the marker set is found, and virtual people label. Leaves a report,
    the model, and an unlabelled and a labelled C3D. Files of an earlier demo are replaced.

    `asterism demo cameras` begins one step earlier: eight simulated cameras see a waved wand and a walker who hides markers; the rig is
    calibrated from nothing, points are reconstructed and labelled, and everything is compared with the truth. The exit status is 1 where a
    promised figure is missed.

    `asterism demo garment` designs a suit of coded circles, photographs a simulated walker in it with eight cameras, calibrates them by a
    coded target, captures the suit, and compares with the truth; a few minutes.

    `asterism demo views` labels in the images: a simulated walker before four small cameras, with a model of the body that hides markers.

    `asterism demo motion` simulates a knee under skin that slides and wobbles, finds its limbs from the points alone, and compares the
    joint angle and its intervals with the bones. The exit status is 1 where the angle is more than 1.5 degrees off.
    """
    if options.part is DemoPart.MOTION:
        from asterism.cli._demo_motion import demo_motion

        raise typer.Exit(demo_motion(options.output, options.seed, options.json))
    if options.part is DemoPart.CAMERAS:
        from asterism.cli._demo_cameras import demo_cameras

        raise typer.Exit(demo_cameras(options.output, options.seed, options.json))
    if options.part is DemoPart.VIEWS:
        from asterism.cli._demo_views import demo_views

        raise typer.Exit(demo_views(options.output, options.seed, options.json))
    if options.part is DemoPart.GARMENT:
        from asterism.cli._demo_garment import demo_garment

        raise typer.Exit(demo_garment(options.output, options.seed, options.json))
    from asterism.simulation import simulate_walks

    # before a minute of training
    _console.check_new(options.json, overwrite=True)
    options.output.mkdir(parents=True, exist_ok=True)
    # JSON on standard output must be nothing but JSON
    show = _console.result if options.json != "-" else _console.error
    walks = simulate_walks(subjects=_WALKERS, frames=_FRAMES, rate=_RATE, markers=MARKERS, seed=options.seed)
    model = _trained(walks[:-_NEW_WALKERS], options.seed, show)
    files = _Files.in_folder(options.output)
    model.save(files.model)
    trials = [_labelled(model, walks[-_NEW_WALKERS:], *condition, options.seed) for condition in _CONDITIONS]
    if options.json != "-":
        _print([trial.row for trial in trials])
    _write(files, model, trials[-1])
    without = _without_model(files.unlabelled, trials[-1])
    show(
        f"Without any model: {without['worn']} and virtual people give {without['right']:,} of {without['visible']:,} markers in view "
        f"their own point, and {without['wrong']} another one."
    )
    show(f"Open {files.report} in a browser, and {files.labelled} in any C3D viewer. Label a file yourself:")
    show(f"  asterism label {files.unlabelled} -o {options.output / 'labelled'}")
    _console.write_json(
        options.json,
        {
            "command": "demo",
            "seed": options.seed,
            "whole_recordings": True,
            "conditions": [trial.row for trial in trials],
            "without_model": without,
            "report": files.report,
            "model": files.model,
            "unlabelled": files.unlabelled,
            "labelled": files.labelled,
        },
    )


@dataclass(frozen=True)
class _Files:
    """What the demo leaves in its folder."""

    model: Path
    unlabelled: Path
    labelled: Path
    report: Path

    @classmethod
    def in_folder(cls, folder: Path) -> _Files:
        return cls(folder / "walkers.model", folder / "walk-unlabelled.c3d", folder / "walk-labelled.c3d", folder / "report.html")


@dataclass(frozen=True)
class _DemoTrial:
    """Walkers labelled under one condition: the table's row; clouds, labelling and truth of the last walker."""

    row: dict[str, Any]
    clouds: Clouds
    labelling: Labelling
    truth: Ints


def _trained(walks: Sequence[Recording], seed: int, show: Callable[[str], None]) -> MarkerModel:
    show(f"Training on {len(walks)} simulated walkers, {len(walks[0].labels)} markers ...")
    started = time.perf_counter()
    model = train_on_walkers(walks, seed)
    show(f"Trained in {time.perf_counter() - started:.0f} s. Labelling recordings of {_NEW_WALKERS} walkers that it has not seen ...")
    return model


def _labelled(model: MarkerModel, walks: Sequence[Recording], hidden: int, ghosts: int, seed: int) -> _DemoTrial:
    """Label the walks, each as a whole, with so many markers in a gap and so many ghosts at every moment."""
    from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
    from asterism.recording import LABEL_STATES, label_states

    counts = {"right": 0, "wrong": 0, "not labelled": 0, "visible": 0}
    states = dict.fromkeys(LABEL_STATES, 0)
    seconds, frames = 0.0, 0
    for i, walk in enumerate(walks):
        # another seed for each walk: gaps at other places
        clouds, truth = simulate_gaps_and_ghosts(walk, hidden, ghosts, seed=seed + 1 + i)
        started = time.perf_counter()
        labelling = model.label(clouds)
        seconds += time.perf_counter() - started
        frames += len(clouds)
        for key, value in _compared(labelling, truth).items():
            counts[key] += value
        for key, value in vars(label_states(labelling, clouds)).items():
            states[key] += int(value.sum())
    shares = {key: value / sum(states.values()) for key, value in states.items()}
    row = {"hidden": hidden, "ghosts": ghosts, **counts, "shares": shares, "frames_per_second": frames / seconds}
    return _DemoTrial(row, clouds, labelling, truth)


def _without_model(path: Path, trial: _DemoTrial) -> dict[str, Any]:
    """The file labelled as by somebody who has trained nothing: the set taken, and how many labels are right and wrong."""
    import numpy as np

    from asterism import formats
    from asterism.recording import Labelling
    from asterism.session import label_file

    labelled = label_file(path)
    names = labelled.labelling.names
    truth = Labelling(trial.truth, np.ones(trial.truth.shape), _marker_names()).positions(trial.clouds)
    given = labelled.labelling.positions(formats.read(path).clouds())
    # of a set that was not worn, only the markers of the same names can be right
    shown = np.full((len(truth), len(names), 3), np.nan)
    for column, name in enumerate(names):
        if name in _marker_names():
            shown[:, column] = truth[:, _marker_names().index(name)]
    there = ~np.isnan(given[:, :, 0])
    # a file keeps millimetres to six digits
    right = there & (np.abs(given - shown).max(axis=2) < 1e-4)
    return {
        "worn": labelled.worn[0].words,
        "visible": int((trial.truth >= 0).sum()),
        "right": int(right.sum()),
        "wrong": int((there & ~right).sum()),
    }


def _marker_names() -> tuple[str, ...]:
    from asterism.recording import MarkerSet

    return MarkerSet.load(MARKERS).names


def _write(files: _Files, model: MarkerModel, trial: _DemoTrial) -> None:
    """Write a trial's recording without and with labels, and the report on it."""
    from asterism import formats
    from asterism.labelling import review
    from asterism.labelling.correction import readiness
    from asterism.report import LabelledRecording, label_report

    # as a camera system would write it: tracks without names
    recording, clouds = _as_recording(trial.clouds)
    formats.write(files.unlabelled, recording)
    formats.write(files.labelled, recording.with_labelling(trial.labelling, clouds))
    # what `asterism label` says of a file, in its words
    use = readiness(trial.labelling, trial.clouds, review(trial.labelling, trial.clouds))
    row = {"file": files.unlabelled.name, "frames": len(clouds), "frames_per_second": trial.row["frames_per_second"]}
    row |= {"readiness": use.kind, "use": use.words, "why": use.why}
    label_report(
        files.report,
        LabelledRecording(trial.labelling, clouds, model.marker_set, trial.truth),
        title="Asterism demo: a simulated walker that the model has not seen",
        files=[row],
        model_info={"model": files.model.name, "labelled": "the recording as a whole, by its tracks", **model.about},
    )


def _as_recording(clouds: Clouds) -> tuple[Recording, Clouds]:
    """The recording of clouds with tracks, a column for each track as a camera system writes it; and its clouds, in the given order."""
    import numpy as np

    from asterism.recording import Recording

    assert clouds.tracks is not None
    # a column for each track, as anonymous files have
    positions = np.full((len(clouds), int(clouds.tracks.max(initial=-1)) + 1, 3), np.nan)
    positions[clouds.frame_of, clouds.tracks] = clouds.xyz
    labels = tuple(f"*{i + 1}" for i in range(positions.shape[1]))
    return Recording(positions, labels, clouds.rate, clouds.vertical), replace(clouds, columns=clouds.tracks)


def _compared(labelling: Labelling, truth: Ints) -> dict[str, int]:
    """Counts over all frames and markers: visible ones, and what became of them; wrong includes names for hidden markers."""
    given: np.ndarray[Any, Any] = labelling.indices
    return {
        "visible": int((truth >= 0).sum()),
        "right": int(((given >= 0) & (given == truth)).sum()),
        "wrong": int(((given >= 0) & (given != truth)).sum()),
        "not labelled": int(((given < 0) & (truth >= 0)).sum()),
    }


def _print(rows: Sequence[dict[str, Any]]) -> None:
    from asterism.recording import LABEL_STATES

    _console.table(
        f"{_NEW_WALKERS} recordings of {_FRAMES} frames, each labelled as a whole; wrong labels include those given to hidden markers",
        ["hidden", "ghosts", "markers in view", "right", "not labelled", "wrong labels", *LABEL_STATES, "frames/s"],
        [
            [
                str(row["hidden"]),
                str(row["ghosts"]),
                _console.count(row["visible"]),
                f"{row['right']:,} ({_console.percent(row['right'] / max(row['visible'], 1))})",
                _console.count(row["not labelled"]),
                _console.count(row["wrong"]),
                *(_console.percent(row["shares"][name]) for name in LABEL_STATES),
                _console.count(row["frames_per_second"]),
            ]
            for row in rows
        ],
        left=0,
    )
