"""Times for 3,000 points in 100 frames."""

from __future__ import annotations

import time
from collections.abc import Iterator
from statistics import median

from asterism.motion.analysis import MotionRules, analyse_motion
from asterism.motion.uncertainty import MonteCarloRules, estimate_uncertainty
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from benchmarks.motion.trials import plans, trial_of


def speed(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Limbs, point cluster weights and angles in one thread, the median of three; then 1,000 trials on two."""
    recording = trial_of(plans(False, benchmark.quick)[1]).recording
    for method in ("robust", "pct"):
        rules, times = MotionRules(method=method), []
        analyse_motion(recording, rules=rules)
        for _ in range(3):
            started = time.perf_counter()
            analyse_motion(recording, rules=rules)
            times.append(time.perf_counter() - started)
        row = f"3,000 points in 100 frames: limbs, {method} weights and angles, one core"
        yield Figure(row, "< 10", median(times), "s", len(times))
    trials = 20 if benchmark.quick else 1000
    never_enough = MonteCarloRules(block=trials // 2, most=trials, digits=6)
    started = time.perf_counter()
    estimate_uncertainty(analyse_motion(recording), rules=never_enough, budget_trials=2, workers=2)
    row = "3,000 points in 100 frames: Monte Carlo of 1,000 trials, two cores"
    yield Figure(row, "< 120", time.perf_counter() - started, "s", trials)
