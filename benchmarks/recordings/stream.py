"""Live labelling: what a stream gives frame by frame, by its delay, and how long its worst push takes."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator

import numpy as np

import asterism
from asterism.recording import Clouds, Floats, Labelling
from asterism.simulation import Clutter
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import GAIT_BODY
from benchmarks.figures import Figure
from benchmarks.recordings.walks import Condition, Markers, full_body_subjects, sample, unseen_model, walks
from benchmarks.score import Tally

CONDITIONS = {
    "3 hidden": Condition(3),
    "3 hidden + 3 ghosts": Condition(3, 3),
    "3 hidden, 10 flickering": Condition(3, clutter=Clutter(10.0, 1, "beside", 0.08)),
}
SETS: tuple[tuple[str, Markers, tuple[int, ...]], ...] = (("15 markers", "helen-hayes", (0, 10, 50)), ("59 markers", GAIT_BODY, (0, 10)))
"""Markers, and delays in frames at 100 Hz."""


def stream(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The subjects of the row `full-body`, each with a model that has not seen it. Times need a quiet machine."""
    for name, markers, delays in SETS[: 1 if benchmark.quick else None]:
        tallies, times = defaultdict(Tally), defaultdict(list)
        for subject in full_body_subjects()[: 1 if benchmark.quick else None]:
            ensemble = unseen_model(benchmark, subject, markers)
            for condition, wanted in CONDITIONS.items():
                for number, walk in enumerate(walks(subject, markers)):
                    one = sample(walk, wanted, number)
                    for delay in delays:
                        labelling, spent = pushed(ensemble, one.clouds, delay)
                        tallies[condition, delay].add(labelling, one.truth)
                        times[condition, delay].append(spent)
        for (condition, delay), tally in tallies.items():
            row = f"stream, {name}, {condition}, delay {delay}"
            asked = (">= 0.99", "<= 0.01") if condition == "3 hidden + 3 ghosts" and delay == 10 else ("none", "none")
            yield tally.figure(f"{row}: right", asked[0], tally.right_share)
            yield tally.figure(f"{row}: wrong", asked[1], tally.false_assignments)
            spent = np.concatenate(times[condition, delay])
            yield Figure(f"{row}: p99.9 of a push", "< 10", float(np.quantile(spent, 0.999)), "ms", len(spent))


def pushed(ensemble: asterism.MarkerModel, clouds: Clouds, delay: int) -> tuple[Labelling, Floats]:
    """The labelling that comes out of a stream, and what each push took (T,), in ms."""
    live = ensemble.stream(clouds.rate, delay, clouds.vertical)
    frames, spent = [], []
    for points in clouds:
        started = time.perf_counter()
        frame = live.push(points)
        spent.append(1000.0 * (time.perf_counter() - started))
        if frame is not None:
            frames.append(frame)
    frames += live.flush()
    indices, confidence = np.array([frame.indices for frame in frames]), np.array([frame.confidence for frame in frames])
    return Labelling(indices, confidence, ensemble.marker_set.names), np.array(spent)
