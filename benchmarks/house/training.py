"""How long training takes with the default settings."""

from __future__ import annotations

import time
from collections.abc import Iterator

import asterism
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import evenly, gait, people_and_trials
from benchmarks.figures import Figure


def training(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Training from all gait recordings with 15 markers, after one of three recordings, which compiles the kernels or loads them."""
    people, recordings = people_and_trials(gait())
    if benchmark.quick:
        recordings = [evenly(recording, 60) for recording in recordings]
    asterism.MarkerModel.fit([evenly(recording, 60) for recording in recordings[:3]], seed=0, subjects=people[:3])
    started = time.perf_counter()
    asterism.MarkerModel.fit(recordings, seed=0, subjects=people)
    seconds = time.perf_counter() - started
    yield Figure(f"default training, 15 markers, {len(recordings)} recordings", "< 20", seconds, "s", len(recordings))
