"""`asterism demo cameras`: a simulated laboratory in; a calibrated rig, points, labels, and how far they are from the truth out."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from asterism.cli import _console

if TYPE_CHECKING:
    from asterism.simulation.chain import Outcome
    from asterism.simulation.session import Session

_WALKERS, _FRAMES, _RATE = 9, 300, 100.0
_MARKERS = "helen-hayes"


def demo_cameras(output: Path, seed: int, json: str | None) -> int:
    """Run it, print the table, leave the files; 0 where every promise was kept, else 1."""
    from asterism.labelling import SolverEnsemble, TrainingRules
    from asterism.recording import MarkerSet
    from asterism.simulation import simulate_walks
    from asterism.simulation.chain import work_through
    from asterism.simulation.session import L_FRAME, simulate_session

    _console.check_new(json, overwrite=True)
    output.mkdir(parents=True, exist_ok=True)
    talk = _console.result if json != "-" else _console.error
    walks = simulate_walks(subjects=_WALKERS, frames=_FRAMES, rate=_RATE, markers=_MARKERS, seed=seed)
    started = time.perf_counter()
    session = simulate_session(walks[-1], seed)
    talk(
        f"Simulated {len(session.rig)} cameras, a waved wand ({len(session.wand):,} frames) and a walker ({_FRAMES} frames) whose body "
        f"hides his {len(walks[0].labels)} markers from many of them; noise, strays, lost images."
    )
    talk(f"Training on {_WALKERS - 1} other walkers ...")
    with _console.progress("training") as progress:
        ensemble = SolverEnsemble.fit(
            walks[:-1],
            seed=seed,
            miner=None,
            marker_set=MarkerSet.load(_MARKERS),
            training=TrainingRules(folds=2, trial_frames=60),
            progress=progress,
        )
    with _console.progress("working") as progress:
        outcome = work_through(session, ensemble, progress)
    seconds = time.perf_counter() - started
    model = output / "walkers.model"
    ensemble.save(model)
    files = {**_written(output, session, outcome), "model": model}
    checks = outcome.checks()
    if json != "-":
        _console.table(
            f"What came of it, against the truth ({seconds:.0f} s)",
            ["", "measured", "promised", ""],
            [
                [
                    check.name,
                    _told(check.measured, check.unit),
                    f"{'≥' if check.at_least else '≤'} {_told(check.limit, check.unit)}",
                    "kept" if check.kept else "MISSED",
                ]
                for check in checks
            ],
        )
    talk(f"Look at {files['rig_report']} and {files['report']} in a browser. The same by hand:")
    mine = output / "my-rig.toml", output / "my-points.npz"
    floor = " ".join(f"{x:g},{y:g}" for x, y, _ in L_FRAME)
    talk(
        f"  asterism calibrate wand {files['wand']} --wand 0 0.2 0.6 --image-size 2048x1536 --floor {files['l_frame']} "
        f'--l-frame "{floor}" -o {mine[0]}'
    )
    talk(f"  asterism reconstruct {files['blobs']} --rig {mine[0]} -o {mine[1]}")
    talk(f"  asterism label {mine[1]} --model {model} -o {output / 'labelled'}")
    for check in checks:
        if not check.kept:
            _console.error(f"{check.name}: {_told(check.measured, check.unit)}, promised {_told(check.limit, check.unit)}.")
    _console.write_json(json, {"command": "demo cameras", "seed": seed, "seconds": seconds, **_facts(outcome), **files})
    return 0 if all(check.kept for check in checks) else 1


def _told(value: float, unit: str) -> str:
    return f"{value:.3g} {unit}".strip()


def _facts(outcome: Outcome) -> dict[str, Any]:
    points = outcome.points
    return {
        "checks": [{**vars(check), "kept": check.kept} for check in outcome.checks()],
        "seconds_by_step": outcome.seconds,
        "reprojection_rms_px": outcome.calibration.rms,
        "markers": int(points.wanted.sum()),
        "found_within_1_mm": points.found(0.001),
        "found_within_3_mm": points.found(0.003),
        "ghosts": points.ghosts,
        "points": points.points,
        "labels": {"right": outcome.right, "wrong": outcome.wrong, "not labelled": outcome.unlabelled},
    }


def _written(output: Path, session: Session, outcome: Outcome) -> dict[str, Path]:
    """Everything as files, those of an earlier demo replaced."""
    from asterism import Recording, formats
    from asterism.cameras.accuracy import Volume, map_rig, wand_accuracy
    from asterism.cameras.files import write_rig
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
    write_rig(outcome.rig, files["rig"])
    for key, blobs in (("wand", session.wand), ("l_frame", session.l_frame), ("blobs", session.blobs)):
        formats.write_blobs(blobs, files[key])
    outcome.reconstruction.write(files["points"])
    clouds = outcome.reconstruction.clouds
    recording = Recording.from_clouds(clouds)
    formats.write(files["unlabelled"], recording)
    formats.write(files["labelled"], recording.with_labelling(outcome.labelling))
    rig_report(
        files["rig_report"],
        outcome.rig,
        map_rig(outcome.rig, Volume.parse("4x4x2")),
        title="Asterism demo: a rig calibrated by a simulated wand",
        wand=wand_accuracy(outcome.calibration.positions, WAND),
    )
    label_report(
        files["report"],
        LabelledRecording(outcome.labelling, clouds, truth=outcome.points.truth),
        title="Asterism demo: a walker seen by simulated cameras",
        files=[{"file": files["unlabelled"].name, "frames": len(clouds), "frames_per_second": len(clouds) / outcome.seconds["label"]}],
        model_info={"model": "walkers.model"},
    )
    return files
