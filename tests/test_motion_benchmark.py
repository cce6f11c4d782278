"""The rows about motion: small settings, and that errors are counted as they are."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from asterism.simulation.soft_tissue import TrialPlan, simulate_soft_tissue

sys.path.insert(0, str(Path(__file__).parents[1]))
benchmark_run, chapters, trials = (import_module(f"benchmarks.{name}") for name in ("benchmark_run", "chapters", "motion.trials"))


def figures_of(row: str) -> dict[str, float]:
    return {figure.row: figure.measured for figure in chapters.row_of("motion", row)(benchmark_run.BenchmarkRun(quick=True))}


def test_the_synthetic_trial_underestimates_with_all_points_and_not_with_robust_weights() -> None:
    found = figures_of("toy")
    assert found["synthetic trial of 4.1, svd: largest error of the angle"] > 1.0
    assert found["synthetic trial of 4.1, robust: largest error of the angle"] < 0.5


def test_points_on_the_wrong_limb_are_counted_and_cost_the_angle() -> None:
    trial = simulate_soft_tissue(TrialPlan("knee", points=200, noise_m=0.0), seed=1)
    assert trials.share_right(1 - trial.limb_of, trial.limb_of) == 1.0, "limbs are named as fits best"
    wrong = trial.limb_of.copy()
    near = np.argsort(np.linalg.norm(trial.recording.positions[0] - trial.centres[0, 0], axis=1))[:20]
    wrong[near] = 1 - wrong[near]
    assert trials.share_right(wrong, trial.limb_of) == pytest.approx(0.9)
    good, bad = (trials.errors_of(trial, limb_of, "svd") for limb_of in (trial.limb_of, wrong))
    assert good.mean < 0.5 < bad.mean and good.centre < 0.01


def test_people_of_the_rows_are_not_those_on_whom_constants_were_chosen() -> None:
    for few in (True, False):
        plans = trials.plans(few)
        assert max(plan.subject for plan in plans) < 100 and len({(plan.joint, plan.subject, plan.motion) for plan in plans}) == len(plans)
    assert len(trials.plans(False)) == 30 and len(trials.plans(True)) == 90 and trials.SEED != 1
