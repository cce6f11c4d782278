"""One strong classifier and the full solver that it makes (thesis 5.2): how sure, how few evaluations, how fast."""

from __future__ import annotations

from collections.abc import Iterator

from asterism.hiding import hide_and_haunt
from asterism.labelling import FullSolver
from benchmarks.bench import Bench, frames_per_second
from benchmarks.data import blocks, gait, people_and_trials
from benchmarks.figures import Figure
from benchmarks.labelling.seen import test_frames
from benchmarks.score import Tally

WEAK = 40
WRONG = 10**7


def strong_classifier(bench: Bench) -> Iterator[Figure]:
    """Wrong labellings of frames outside training, from two to all markers permuted: the share that 40 weak classifiers refuse."""
    solver, test = _solver(), [blocks(recording, odd=True) for recording in people_and_trials(gait())[1]]
    wrong = 10**5 if bench.quick else WRONG
    yield Figure(
        f"strong classifier, {WEAK} weak classifiers: accuracy over wrong labellings",
        "> 0.999",
        solver.accuracy(test, wrong=wrong, seed=0),
        "fraction",
        wrong,
    )


def full_solver(bench: Bench) -> Iterator[Figure]:
    """Frames outside training, nothing hidden: evaluations to the right labelling, and frames per second on one core."""
    solver = _solver()
    clouds, truth = hide_and_haunt(test_frames(1024 if bench.quick else 16384), 0, 0, seed=0)
    labelling = solver.label(clouds)
    tally = Tally()
    tally.add(labelling, truth)
    yield Figure("full solver, no occlusion: feature evaluations per frame", "< 300", solver.evaluations, "evaluations", tally.frames)
    yield Figure(
        "full solver, no occlusion, one core",
        "> 100000",
        frames_per_second(lambda: solver.label(clouds), len(clouds)),
        "frames/s",
        len(clouds),
    )
    yield Figure("full solver, no occlusion: right", "none", tally.right_share, "fraction", tally.frames)
    yield Figure("full solver, no occlusion: FA", "none", tally.false_assignments, "fraction", tally.frames)


def _solver() -> FullSolver:
    return FullSolver.fit([blocks(recording, odd=False) for recording in people_and_trials(gait())[1]], weak_classifiers=WEAK, seed=0)
