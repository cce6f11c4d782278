"""How often the stated intervals hold the bones' angle."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from asterism.motion.analysis import analyse_motion
from asterism.motion.uncertainty import MonteCarloRules, estimate_uncertainty
from asterism.simulation.soft_tissue import TrialPlan
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from benchmarks.motion.trials import plans, trial_of

TRIALS = 100
DENSE_POINTS = 600
"""Fewer than in other rows: 100 trials for each of 30 recordings take minutes as it is."""
ASKED = {0.65: (">= 0.6", "<= 0.7"), 0.95: (">= 0.93", "<= 0.97")}


def coverage(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The share of frames whose true angle is in the interval, over people on whom nothing was chosen; and what the budget says."""
    for name, few in (("sparse", True), ("dense", False)):
        found = list(benchmark.each(_of_trial, plans(few, benchmark.quick, DENSE_POINTS)))
        n = len(found)
        for probability, asked in ASKED.items():
            share = float(np.mean([inside[probability] for inside, _ in found]))
            for bound in asked:
                yield Figure(f"{name}: {100 * probability:.0f} % interval holds the true angle, {bound[:2]}", bound, share, "fraction", n)
        for source in ("cameras", "soft tissue", "all"):
            mean = float(np.mean([budget[source] for _, budget in found]))
            yield Figure(f"{name}: budget of the flexion, {source}", "none", mean, "degrees", n)


def _of_trial(benchmark: BenchmarkRun, plan: TrialPlan) -> tuple[dict[float, float], dict[str, float]]:
    trial = trial_of(plan)
    labels = np.array(trial.recording.labels)
    analysis = analyse_motion(trial.recording, {f"bone {k}": list(labels[trial.limb_of == k]) for k in (0, 1)})
    trials = 20 if benchmark.quick else TRIALS
    rules = MonteCarloRules(block=trials // 2, most=trials)
    joint = estimate_uncertainty(analysis, rules=rules, budget_trials=max(trials // 5, 2)).joints[0]
    inside = {
        p: float(((low <= trial.angles[0]) & (trial.angles[0] <= high))[1:].mean()) for p, (low, high) in joint.angle_intervals.items()
    }
    return inside, {name: float(np.degrees(np.sqrt(np.nanmean(part**2)))) for name, part in joint.budget.items()}
