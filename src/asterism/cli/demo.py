"""`asterism demo`: simulated walkers in; a table, a report, labelled files and a model out."""

from __future__ import annotations

import time
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._options import Json, Seed

if TYPE_CHECKING:
    import numpy as np

    from asterism.recording import Ints, Labelling

_WALKERS, _STRANGERS, _FRAMES, _RATE = 10, 2, 150, 50.0
_MARKERS = "helen-hayes"
_CONDITIONS = ((0, 0), (2, 0), (4, 0), (2, 3))


class Part(StrEnum):
    """What the demo shows: labelling, or the way from cameras to labels."""

    LABELLING = "labelling"
    CAMERAS = "cameras"


def demo(
    part: Annotated[
        Part, typer.Argument(metavar="[cameras]", help="Begin with cameras: calibrate, reconstruct, label.", show_default=False)
    ] = Part.LABELLING,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER", help="Where the files go.")] = Path("asterism-demo"),
    seed: Seed = 0,
    json: Json = None,
) -> None:
    """Try everything in under a minute, on simulated people.

    Ten people of different sizes walk for three seconds, 15 markers each. Eight train a model; it labels the other two, with
    markers hidden and ghosts added. Leaves a report, the model, and an unlabelled and a labelled C3D. Files of an earlier demo
    are replaced.

    `asterism demo cameras` begins one step earlier: eight simulated cameras see a waved wand and a walker who hides markers; the rig is
    calibrated from nothing, points are reconstructed and labelled, and everything is held against the truth. It leaves with 1 where it
    misses what it promises.
    """
    if part is Part.CAMERAS:
        from asterism.cli._demo_cameras import demo_cameras

        raise typer.Exit(demo_cameras(output, seed, json))
    from asterism import Recording, formats
    from asterism.labelling import SolverEnsemble, TrainingRules
    from asterism.labelling.simulated_occlusions import simulate_occlusions
    from asterism.recording import MarkerSet
    from asterism.report import label_report
    from asterism.simulation import simulate_walks

    _console.check_new(json, overwrite=True)
    output.mkdir(parents=True, exist_ok=True)
    walks = simulate_walks(subjects=_WALKERS, frames=_FRAMES, rate=_RATE, markers=_MARKERS, seed=seed)
    known, strangers = walks[:-_STRANGERS], walks[-_STRANGERS:]
    talk = _console.result if json != "-" else _console.error
    talk(f"Training on {len(known)} simulated walkers, {len(known[0].labels)} markers ...")
    started = time.perf_counter()
    with _console.progress("training") as progress:
        # a quick training: two groups left out in turn, and none of the partial solvers, which these rules do not ask
        training = TrainingRules(folds=2, trial_frames=60)
        marker_set = MarkerSet.load(_MARKERS)
        ensemble = SolverEnsemble.fit(known, seed=seed, miner=None, marker_set=marker_set, training=training, progress=progress)
    talk(f"Trained in {time.perf_counter() - started:.0f} s. Labelling {len(strangers)} walkers that the model has not seen ...")
    model = output / "walkers.model"
    ensemble.save(model)

    rows: list[dict[str, Any]] = []
    for hidden, ghosts in _CONDITIONS:
        counted = {"right": 0, "wrong": 0, "not labelled": 0, "visible": 0}
        seconds = frames = 0.0
        for i, stranger in enumerate(strangers):
            clouds, truth = simulate_occlusions(stranger, hidden, ghosts, seed=seed + 1 + i)
            started = time.perf_counter()
            labelling = ensemble.label(clouds)
            seconds += time.perf_counter() - started
            frames += len(clouds)
            for key, value in _compared(labelling, truth).items():
                counted[key] += value
        rows.append({"hidden": hidden, "ghosts": ghosts, **counted, "frames_per_second": frames / seconds})
    if json != "-":
        _print(rows)

    # The last condition, the hardest, is the one to look at.
    raw, labelled, page = output / "walk-unlabelled.c3d", output / "walk-labelled.c3d", output / "report.html"
    recording = Recording.from_clouds(clouds)
    formats.write(raw, recording)
    formats.write(labelled, recording.with_labelling(labelling))
    label_report(
        page,
        title="Asterism demo: a simulated walker that the model has not seen",
        files=[
            {
                "file": raw.name,
                "frames": len(clouds),
                "frames_per_second": rows[-1]["frames_per_second"],
            }
        ],
        recording=recording,
        labelling=labelling,
        clouds=clouds,
        model_info={"model": model.name, **ensemble.about},
        truth=truth,
        marker_set=ensemble.marker_set,
    )
    talk(f"Look at {page} in a browser, and at {labelled} in any C3D viewer. Label a file yourself:")
    talk(f"  asterism label {raw} --model {model} -o {output / 'labelled'}")
    _console.write_json(
        json, {"command": "demo", "seed": seed, "conditions": rows, "report": page, "model": model, "unlabelled": raw, "labelled": labelled}
    )


def _compared(labelling: Labelling, truth: Ints) -> dict[str, int]:
    """Counts over all frames and markers: visible ones, and what became of them; wrong includes names for hidden markers."""
    given: np.ndarray[Any, Any] = labelling.indices
    return {
        "visible": int((truth >= 0).sum()),
        "right": int(((given >= 0) & (given == truth)).sum()),
        "wrong": int(((given >= 0) & (given != truth)).sum()),
        "not labelled": int(((given < 0) & (truth >= 0)).sum()),
    }


def _print(rows: list[dict[str, Any]]) -> None:
    _console.table(
        f"{_STRANGERS} walkers, {_FRAMES} frames each; wrong labels include those given to hidden markers",
        ["hidden", "ghosts", "markers in view", "right", "not labelled", "wrong labels", "frames/s"],
        [
            [
                str(row["hidden"]),
                str(row["ghosts"]),
                _console.count(row["visible"]),
                f"{row['right']:,} ({_console.percent(row['right'] / max(row['visible'], 1))})",
                _console.count(row["not labelled"]),
                _console.count(row["wrong"]),
                _console.count(row["frames_per_second"]),
            ]
            for row in rows
        ],
        left=0,
    )
