"""Segmentation, angles and joint centres under soft tissue that is not white noise, every method on the same trials."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from asterism.motion.rigid import METHODS
from asterism.motion.segmentation import segment_limbs
from asterism.simulation.soft_tissue import TrialPlan, simulate_soft_tissue
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from benchmarks.motion.trials import MARKERS, SEED, SUBJECTS, Errors, errors_of, plans, share_right, trial_of

OURS, LSA = "robust", "LSA alone"
OTHERS = ("leg", "rigid")
"""Three limbs and one: the number of limbs is counted on these too."""


def dense(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """3,000 points on both limbs."""
    yield from _rows(benchmark, "dense", False)


def sparse(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Eight markers on each limb."""
    yield from _rows(benchmark, "sparse", True)


def _rows(benchmark: BenchmarkRun, name: str, few: bool) -> Iterator[Figure]:
    found = list(benchmark.each(_of_trial, plans(few, benchmark.quick)))
    others = list(benchmark.each(_number_right, _other_plans(few, benchmark.quick)))
    n = len(found)
    numbers = [number for _, _, number in found] + others
    yield Figure(f"{name}: points on the right limb", ">= 0.99", float(np.mean([right for _, right, _ in found])), "fraction", n)
    yield Figure(f"{name}: points on the right limb, worst trial", "none", float(min(right for _, right, _ in found)), "fraction", n)
    yield Figure(f"{name}: number of limbs right", ">= 0.95", float(np.mean(numbers)), "fraction", len(numbers))
    by_method: dict[str, list[Errors]] = defaultdict(list)
    for errors, _, _ in found:
        for method, error in errors.items():
            by_method[method].append(error)
    for method, errors in by_method.items():
        asked = ("< 0.5", "< 1.5", "< 0.005") if method == OURS else ("none", "none", "none")
        means = [one.mean for one in errors]
        yield Figure(f"{name}, {method}: angle error, mean", asked[0], float(np.mean(means)), "degrees", n)
        yield Figure(f"{name}, {method}: angle error, worst trial", asked[1], float(max(means)), "degrees", n)
        yield Figure(f"{name}, {method}: largest angle error of a frame", "none", float(max(one.worst for one in errors)), "degrees", n)
        slope = float(np.mean([abs(one.slope) for one in errors]))
        yield Figure(f"{name}, {method}: error growing with the angle", asked[2], slope, "degrees per degree", n)
    centres = [one.centre for one in by_method[OURS]]
    yield Figure(f"{name}: joint centre, mean error", "< 5", 1000 * float(np.mean(centres)), "mm", n)
    yield Figure(f"{name}: joint centre, worst trial", "none", 1000 * float(max(centres)), "mm", n)


def _of_trial(benchmark: BenchmarkRun, plan: TrialPlan) -> tuple[dict[str, Errors], float, bool]:
    """Errors by method, the share of points on the right limb, and whether the number of limbs was found."""
    trial = trial_of(plan)
    positions = trial.recording.positions
    counted = segment_limbs(positions)
    ours = counted if counted.limbs == 2 else segment_limbs(positions, 2)
    errors = {method: errors_of(trial, ours.limb_of, method) for method in METHODS}
    alone = segment_limbs(positions, 2, method="lsa").limb_of
    if min(np.bincount(alone[alone >= 0], minlength=2)) >= 3:
        errors[LSA] = errors_of(trial, alone, "svd")
        errors["LSA alone, then PCT"] = errors_of(trial, alone, "pct-half-mean")
    return errors, share_right(counted.limb_of, trial.limb_of), counted.limbs == 2


def _other_plans(few: bool, quick: bool) -> list[TrialPlan]:
    people = range(1 if quick else SUBJECTS)
    return [TrialPlan(j, s, s % 3, MARKERS if few else 1000, few, noise_m=0.0005 if few else 0.001) for s in people for j in OTHERS]


def _number_right(benchmark: BenchmarkRun, plan: TrialPlan) -> bool:
    trial = simulate_soft_tissue(plan, SEED)
    return segment_limbs(trial.recording.positions).limbs == int(trial.limb_of.max()) + 1
