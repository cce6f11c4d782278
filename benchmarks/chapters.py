"""The scripts by chapter: each row is a generator of figures, named by its module and function in the chapter."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

Row = Callable[[BenchmarkRun], Iterator[Figure]]

_SCRIPTS = {
    "labelling": "files.conformance solver.full_solver thesis.thesis thesis.thesis_main",
    "recordings": "speed.speed bodies.bodies stream.stream loop.loop gaps.gaps gaps.full_body gaps.flicker "
    "movement.movement movement.laboratories",
    "virtual": "rows.fifteen rows.thirty_nine rows.others rows.raw rows.taught rows.more_points rows.set_worn "
    "rows.first_command rows.virtual_standing rows.virtual_standing_all",
    "dirt": "reliability.reliability",
    "cameras": "boards.stereo boards.charuco detection.detection detection.centroids "
    "detection.particles reconstruction.speed reconstruction.ghosts walk.walk wand.real_wand wand.wand wand.wand_rigs",
    "views": "rows.gait rows.whole_body",
    "garment": "pattern.speed capture.whole_speed reading.hard_images capture.dense",
    "files": "vertical.vertical logs.logs",
    "hostile": "long_recordings.long_recordings damaged_files.damaged_files",
    "motion": "paper.toy gait.knee clinical.plug_in_gait angles.sparse angles.dense coverage.coverage "
    "skeleton.opensim_ik skeleton.kinematics_speed skeleton.skeleton retarget.retarget",
    "gait": "events.events events.peers gaps.gaps kinetics.kinetics parameters.parameters bands.bands speed.speed page.page",
    "live": "rows.packets rows.killed damaged.damaged rows.soak blobs.blobs blobs.agreement share.share "
    "movement.strikes movement.steps movement.angles "
    "page.tone silence.silence page.page streams.outputs webcams.webcams",
    "house": "startup.startup install.install install.ci process.process process.cluster",
}
CHAPTERS = {
    chapter: {script.partition(".")[2].replace("_", "-"): script for script in scripts.split()} for chapter, scripts in _SCRIPTS.items()
}
"""Chapter and row, such as "recordings" and "full-body"; the row is its function's name."""


def row_of(chapter: str, row: str) -> Row:
    """The generator that measures a row, imported when it is asked for."""
    module, _, function = CHAPTERS[chapter][row].partition(".")
    generator: Row = getattr(import_module(f"benchmarks.{chapter}.{module}"), function)
    return generator
