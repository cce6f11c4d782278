"""Live labelling: what a stream gives frame by frame, by its delay, and how long its worst push takes."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator

import numpy as np

import asterism
from asterism.recording import Clouds, Floats, Labelling
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import GAIT_BODY, gait
from benchmarks.figures import Figure
from benchmarks.recordings.full_body import full_body_subjects
from benchmarks.recordings.walks import Markers, unseen_ensemble, with_gaps
from benchmarks.score import Tally

CONDITIONS = {"3 hidden": (3, 0), "3 hidden + 3 ghosts": (3, 3)}
DELAYS = (0, 10, 50)
"""Frames, at 100 Hz."""


def stream(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The subjects of the row `full-body`, each with an ensemble that has not seen it; 15 markers, then all. Times need a quiet machine."""
    sets: tuple[Markers, ...] = ("helen-hayes",) if benchmark.quick else ("helen-hayes", GAIT_BODY)
    for markers in sets:
        subjects = full_body_subjects()[: 1 if benchmark.quick else None]
        tallies, times = defaultdict(Tally), defaultdict(list)
        for subject in subjects:
            ensemble = unseen_ensemble(benchmark, subject, markers)
            for condition, (hidden, ghosts) in CONDITIONS.items():
                for clouds, truth in with_gaps(benchmark, subject, hidden, ghosts, markers, seeds=1):
                    for delay in DELAYS:
                        labelling, spent = pushed(ensemble, clouds, delay)
                        tallies[condition, delay].add(labelling, truth)
                        times[condition, delay].append(spent)
        count = len(next(iter(gait(markers).values()))[0].labels)
        for (condition, delay), tally in tallies.items():
            row = f"stream, {count} markers, {condition}, delay {delay}"
            yield tally.figure(f"{row}: right", "none", tally.right_share)
            yield tally.figure(f"{row}: FA", "none", tally.false_assignments)
            asked = "< 10" if delay == 0 and markers is GAIT_BODY else "none"
            spent = np.concatenate(times[condition, delay])
            yield Figure(f"{row}: p99.9 of a push", asked, float(np.quantile(spent, 0.999)), "ms", len(spent))


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
