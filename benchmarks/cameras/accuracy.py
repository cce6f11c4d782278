"""How well the analytic sensitivity stands for one at a time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from asterism.cameras.accuracy import sensitivity
from asterism.simulation.cameras import random_rig
from benchmarks.benchmark_run import BenchmarkRun, frames_per_second
from benchmarks.figures import Figure

SHIFT = 0.3


def accuracy(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The 12 scalars both ways at random places of random rigs, wherever a pair composes a point to 1 cm or better."""
    rigs = 5 if benchmark.quick else 40
    off, seconds = [], {}
    for seed in range(rigs):
        rng = np.random.default_rng(seed)
        rig = random_rig(rng=rng)
        places = rng.uniform(-0.6, 0.6, (20, 3)) + np.array([0.0, 0.0, 0.9])
        exact, first = (sensitivity(rig, places, SHIFT, method).scalars for method in ("one-at-a-time", "analytic"))
        usual = exact.mean(axis=(2, 3), keepdims=True)
        good = np.isfinite(exact).all(axis=(2, 3)) & np.isfinite(first).all(axis=(2, 3)) & (usual[..., 0, 0] < 0.01)
        off.append((np.abs(first - exact) / usual)[good].ravel())
    for method in ("one-at-a-time", "analytic"):
        seconds[method] = 1.0 / frames_per_second(lambda rig=rig, at=places, how=method: sensitivity(rig, at, SHIFT, how), 1)  # type: ignore[misc]
    every = np.concatenate(off)
    row = f"12 scalars, ± {SHIFT} px, analytic against one at a time: difference over their mean"
    yield Figure(f"{row}, median", "none", float(np.median(every)), "fraction", len(every))
    yield Figure(f"{row}, 99.9 % of scalars", "none", float(np.percentile(every, 99.9)), "fraction", len(every))
    yield Figure(
        "12 scalars: time one at a time over time analytically", "none", seconds["one-at-a-time"] / seconds["analytic"], "times", len(every)
    )
