"""`asterism demo cameras`: a simulated laboratory in; a calibrated rig, points, labels, and how far they are from the truth out."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from asterism.cli import _console
from asterism.cli._criteria import missed_criteria, print_criteria
from asterism.cli._demo_training import MARKERS, train_on_walkers
from asterism.findings import exit_status

if TYPE_CHECKING:
    from asterism.simulation.pipeline import PipelineResult
    from asterism.simulation.session import SimulatedSession

_WALKERS, _FRAMES, _RATE = 9, 300, 100.0


def demo_cameras(output: Path, seed: int, json: str | None) -> int:
    """Run it, print the table, leave the files. Returns the exit status: 0 where every criterion is met, else 1."""
    from asterism.simulation import simulate_walks
    from asterism.simulation.pipeline import run_pipeline
    from asterism.simulation.session import simulate_session

    _console.check_new(json, overwrite=True)
    output.mkdir(parents=True, exist_ok=True)
    say = _console.result if json != "-" else _console.error
    walks = simulate_walks(subjects=_WALKERS, frames=_FRAMES, rate=_RATE, markers=MARKERS, seed=seed)
    started = time.perf_counter()
    session = simulate_session(walks[-1], seed)
    say(
        f"Simulated {len(session.rig)} cameras, a waved wand ({len(session.wand):,} frames) and a walker ({_FRAMES} frames) whose body "
        f"hides some of the {len(walks[0].labels)} markers from the cameras; noise, strays, lost images."
    )
    say(f"Training on {_WALKERS - 1} other walkers ...")
    model = train_on_walkers(walks[:-1], seed)
    with _console.progress("working") as progress:
        result = run_pipeline(session, model, progress)
    seconds = time.perf_counter() - started
    model_file = output / "walkers.model"
    model.save(model_file)
    files = {**_written(output, session, result), "model": model_file}
    # what was promised, and not what happens to come out
    criteria = result.criteria()
    if json != "-":
        print_criteria(criteria, seconds)
    # the same by hand, so that a reader sees which commands did it
    _say_by_hand(say, output, files)
    findings = missed_criteria(criteria)
    for finding in findings:
        _console.report(finding)
    content = {**_facts(result), "findings": [finding.to_dict() for finding in findings]}
    _console.write_json(json, {"command": "demo cameras", "seed": seed, "seconds": seconds, **content, **files})
    return exit_status(findings)


def _say_by_hand(say: Callable[[str], None], output: Path, files: dict[str, Path]) -> None:
    """The commands that do the same with the files of the demo."""
    from asterism.simulation.session import L_FRAME

    say(f"Look at {files['rig_report']} and {files['report']} in a browser. The same by hand:")
    rig, points = output / "my-rig.toml", output / "my-points.npz"
    # on the floor, so that their height need not be given
    floor = " ".join(f"{x:g},{y:g}" for x, y, _ in L_FRAME)
    say(
        f"  asterism calibrate wand {files['wand']} --wand 0 0.2 0.6 --image-size 2048x1536 --floor {files['l_frame']} "
        f'--l-frame "{floor}" -o {rig}'
    )
    say(f"  asterism reconstruct {files['blobs']} --rig {rig} -o {points}")
    say(f"  asterism label {points} --model {files['model']} -o {output / 'labelled'}")


def _facts(result: PipelineResult) -> dict[str, Any]:
    points = result.points
    return {
        "criteria": [{**vars(criterion), "met": criterion.met} for criterion in result.criteria()],
        "seconds_by_step": result.seconds,
        "reprojection_rms_px": result.calibration.rms,
        "markers": int(points.wanted.sum()),
        "found_within_1_mm": points.found(0.001),
        "found_within_3_mm": points.found(0.003),
        "ghosts": points.ghosts,
        "points": points.points,
        "labels": {"right": result.right, "wrong": result.wrong, "not labelled": result.unlabelled},
    }


def _written(output: Path, session: SimulatedSession, result: PipelineResult) -> dict[str, Path]:
    """Everything as files, those of an earlier demo replaced."""
    from asterism import formats
    from asterism.cameras.accuracy import Volume, map_rig, wand_accuracy
    from asterism.cameras.files import write_rig
    from asterism.recording import Recording
    from asterism.report import LabelledRecording, label_report, rig_report
    from asterism.simulation.session import WAND

    names = {
        "true_rig": "true-rig.toml",
        "wand": "wand.csv",
        "l_frame": "l-frame.csv",
        "blobs": "walk.csv",
        "rig": "rig.toml",
        "points": "points.npz",
        "unlabelled": "walk-unlabelled.c3d",
        "labelled": "walk-labelled.c3d",
        "rig_report": "rig.html",
        "report": "report.html",
    }
    files = {key: output / name for key, name in names.items()}
    write_rig(session.rig, files["true_rig"])
    write_rig(result.rig, files["rig"])
    for key, blobs in (("wand", session.wand), ("l_frame", session.l_frame), ("blobs", session.blobs)):
        formats.write_blobs(blobs, files[key])
    result.reconstruction.write(files["points"])
    clouds = result.reconstruction.clouds
    recording = Recording.from_clouds(clouds)
    formats.write(files["unlabelled"], recording)
    formats.write(files["labelled"], recording.with_labelling(result.labelling))
    rig_report(
        files["rig_report"],
        result.rig,
        # the volume that the simulated cameras surround
        map_rig(result.rig, Volume.parse("4x4x2")),
        title="Asterism demo: a rig calibrated by a simulated wand",
        wand=wand_accuracy(result.calibration.positions, WAND),
    )
    label_report(
        files["report"],
        LabelledRecording(result.labelling, clouds, truth=result.points.truth),
        title="Asterism demo: a walker seen by simulated cameras",
        files=[{"file": files["unlabelled"].name, "frames": len(clouds), "frames_per_second": len(clouds) / result.seconds["label"]}],
        model_info={"model": "walkers.model"},
    )
    return files
