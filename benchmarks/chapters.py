"""The scripts by chapter: each row's name, and the generator of figures that measures it, as module and function in the chapter."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

Row = Callable[[BenchmarkRun], Iterator[Figure]]

CHAPTERS: dict[str, dict[str, str]] = {
    "labelling": {
        "conformance": "files.conformance",
        "physical": "files.physical",
        "strong-classifier": "solver.strong_classifier",
        "full-solver": "solver.full_solver",
        "tables": "seen.tables",
        "thesis": "thesis.thesis",
        "thesis-main": "thesis.thesis_main",
    },
    "recordings": {
        "speed": "speed.speed",
        "bodies": "bodies.bodies",
        "stream": "stream.stream",
        "loop": "loop.loop",
        "baselines": "baselines.baselines",
        "gaps": "gaps.gaps",
        "ablation": "ablation.ablation",
        "dirt": "dirt.dirt",
        "full-body": "full_body.full_body",
        "movement": "movement.movement",
        "laboratories": "movement.laboratories",
    },
    "dirt": {
        "flicker": "accuracy.flicker",
        "volume": "accuracy.volume",
        "riding": "accuracy.riding",
        "reliability": "reliability.reliability",
        "standing": "standing.standing",
    },
    "cameras": {
        "rig-files": "boards.rig_files",
        "stereo": "boards.stereo",
        "charuco": "boards.charuco",
        "accuracy": "accuracy.accuracy",
        "detection": "detection.detection",
        "centroids": "detection.centroids",
        "particles": "detection.particles",
        "speed": "reconstruction.speed",
        "ghosts": "reconstruction.ghosts",
        "vicon-rig-walk": "walk.walk",
        "real-wand": "wand.real_wand",
        "wand": "wand.wand",
        "refine": "refine.refine",
        "wand-rigs": "wand.wand_rigs",
    },
    "views": {
        "parts": "speed.parts",
        "nothing-known": "speed.nothing_known",
        "gait": "rows.gait",
        "whole-body": "rows.whole_body",
        "baseline": "rows.baseline",
    },
    "garment": {
        "read-speed": "pattern.speed",
        "check": "pattern.check",
        "code": "pattern.code",
        "speed": "capture.whole_speed",
        "hard-images": "reading.hard_images",
        "identities": "reading.captured_identities",
        "points": "capture.dense",
        "calibration": "capture.calibration",
    },
    "hostile": {"long-recordings": "long_recordings.long_recordings", "damaged-files": "damaged_files.damaged_files"},
    "desk": {
        "person": "person.person",
    },
    "motion": {
        "paper": "paper.paper",
        "toy": "paper.toy",
        "knee": "gait.knee",
        "sparse": "angles.sparse",
        "dense": "angles.dense",
        "coverage": "coverage.coverage",
        "speed": "speed.speed",
    },
    "house": {
        "startup": "startup.startup",
        "training": "training.training",
        "install": "install.install",
        "ci": "install.ci",
    },
}


def row_of(chapter: str, row: str) -> Row:
    """The generator that measures a row, imported when it is asked for."""
    module, _, function = CHAPTERS[chapter][row].partition(".")
    return getattr(import_module(f"benchmarks.{chapter}.{module}"), function)
