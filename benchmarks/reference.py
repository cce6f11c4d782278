"""A fixed piece of work, timed beside every speed, so that speeds of different machines can be compared."""

from __future__ import annotations

import time
from collections.abc import Iterator
from statistics import median

import numpy as np
from numba import njit

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

POINTS, ROUNDS, REPEATS = 400, 20, 7
"""Distances between so many points in so many rounds, so often: about 0.05 s of each round's loops on the machine it was written on."""


@njit
def _nearest(points: np.ndarray) -> float:
    """The sum of squared distances of each point to its nearest neighbour."""
    total = 0.0
    for i in range(len(points)):
        best = np.inf
        for j in range(len(points)):
            if i != j:
                dx, dy, dz = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1], points[i, 2] - points[j, 2]
                best = min(best, dx * dx + dy * dy + dz * dz)
        total += best
    return total


def rounds_per_second() -> float:
    """Rounds of the fixed work (a Numba loop over pairs, and NumPy's solution of normal equations) in a second: the median of several."""
    rng = np.random.default_rng(0)
    points, matrix = rng.normal(size=(POINTS, 3)), rng.normal(size=(POINTS, 60))
    _nearest(points)
    times = []
    for _ in range(REPEATS):
        started = time.perf_counter()
        for turn in range(ROUNDS):
            _nearest(points + turn)
            np.linalg.solve(matrix.T @ matrix + np.eye(60), matrix.T @ points)
        times.append(time.perf_counter() - started)
    return ROUNDS / median(times)


def reference(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The speed of this machine at the fixed work."""
    yield Figure("reference: fixed NumPy and Numba loop, one core", "none", rounds_per_second(), "rounds/s", REPEATS)
