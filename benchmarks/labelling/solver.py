"""The full solver that one strong classifier makes (thesis 5.2): how few evaluations, how fast."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from asterism.labelling import FullSolver, FullSolverRules
from asterism.labelling.simulated_occlusions import simulate_occlusions
from benchmarks.benchmark_run import BenchmarkRun, frames_per_second
from benchmarks.data import blocks, gait, people_and_trials
from benchmarks.figures import Figure
from benchmarks.labelling.seen import redrawn, test_frames

WEAK = 40


def full_solver(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Frames outside training, nothing hidden: evaluations to the right labelling, and frames per second on one core."""
    solver = _solver()
    clouds, truth = simulate_occlusions(test_frames(1024 if benchmark.quick else 16384), 0, 0, seed=0)
    tally = redrawn(solver.label(clouds), truth)
    first, in_all = solver.evaluations, solver.evaluations_in_all
    rate = frames_per_second(partial(solver.label, clouds), len(clouds))
    row = "full solver, no occlusion"
    yield Figure(f"{row}: feature evaluations per frame to the right labelling", "< 300", first, "evaluations", tally.distinct)
    yield Figure(f"{row}: feature evaluations per frame until no other is left", "none", in_all, "evaluations", tally.distinct)
    yield Figure(f"{row}: labelling, one core", "> 100000", rate, "frames/s", tally.distinct)
    yield tally.figure(f"{row}: right", "none", tally.right_share)
    yield tally.figure(f"{row}: FA", "none", tally.false_assignments)


def _solver() -> FullSolver:
    people, recordings = people_and_trials(gait())
    return FullSolver.fit(
        [blocks(recording, odd=False) for recording in recordings], rules=FullSolverRules(weak_classifiers=WEAK), subjects=people, seed=0
    )
