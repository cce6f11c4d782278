"""What clutter costs: frames per second against the same recording clean, in the same run; and 2,000 frames of 41 markers in flicker."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Iterator
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np

import asterism
from asterism.errors import AsterismError
from asterism.recording import Clouds, Recording
from asterism.simulation import Clutter
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import evenly, movement_folds
from benchmarks.dirt.accuracy import FLICKER, RIDING, VOLUME
from benchmarks.dirt.walks import Condition, ensemble_of, reporting, sample, samples, unnumbered
from benchmarks.figures import Figure

EXTREMES = {
    "30 flickering, 30 mm, 5 hidden": Condition(5, clutter=Clutter(30.0, 1, "beside", 0.03)),
    "30 there for 10 frames, 80 mm, 3 hidden": Condition(3, clutter=Clutter(30.0, 10, "beside", 0.08)),
    "30 crossing, 3 hidden": Condition(3, clutter=Clutter(30.0, None, "crossing")),
    "30 at rest, 3 hidden": Condition(3, clutter=Clutter(30.0, None, "fixed")),
}
"""Corners of the grid, beside the conditions of the rows about accuracy."""
CONDITIONS = {**FLICKER, **VOLUME, **RIDING, **EXTREMES}
REPEATS = 3
LONG = 2000
"""Frames of the long recording."""
PATIENCE = 240.0
"""Seconds after which a call that has not come back counts as that long."""


def speed(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """One subject's walks, whole recordings on one core, with and without track numbers; the worst ratio is asked for."""
    subject = reporting()[0]
    ensemble = ensemble_of(benchmark, subject)
    clean = {hidden: _seconds(ensemble, [one.clouds for one in samples(subject, Condition(hidden), 1)]) for hidden in (0, 3, 5)}
    ratios = []
    for name, condition in list(CONDITIONS.items())[: 2 if benchmark.quick else None]:
        clouds = [one.clouds for one in samples(subject, condition, 1)]
        frames = sum(map(len, clouds))
        for numbers, given in (("with", clouds), ("without", [unnumbered(cloud) for cloud in clouds])):
            seconds = _seconds(ensemble, given)
            ratios.append(clean[condition.hidden] / seconds)
            row = f"speed in clutter, {name}, {numbers} numbers"
            yield Figure(f"{row}: speed on one core", "none", frames / seconds, "frames/s", frames)
            yield Figure(f"{row}: of that without clutter", "none", ratios[-1], "fraction", frames)
    yield Figure("worst speed in clutter, of that without clutter", ">= 0.2", min(ratios), "fraction", len(ratios))
    yield Figure("median speed in clutter, of that without clutter", "none", median(ratios), "fraction", len(ratios))


def _seconds(ensemble: asterism.MarkerModel, clouds: list[Clouds]) -> float:
    """Seconds of all the recordings together, after one call to warm up: the median of some; of one where a call is slow."""
    times = []
    for repeat in range(REPEATS + 1):
        started = time.perf_counter()
        for cloud in clouds:
            with suppress(AsterismError):
                ensemble.label(cloud)
        times.append(time.perf_counter() - started)
        if repeat and times[-1] > PATIENCE / 10:
            break
    return median(times[1:])


def long_recording(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """A model of the other people of cmu41, the longest recording of one of them, 3 flickering points in each frame."""
    fold = next(fold for fold in movement_folds(("cmu41",)) if fold.person == "85")
    train = [evenly(recording, 100) for recording in fold.train] if benchmark.quick else fold.train
    ensemble = benchmark.fit(train, fold.train_people)
    longest = max((test.recording for test in fold.test), key=len)
    walk = _looped(longest, 200 if benchmark.quick else LONG)
    one = sample(walk, Condition(0, clutter=Clutter(3.0, 1, "beside", 0.08)), 0)
    for numbers, clouds in (("with", one.clouds), ("without", unnumbered(one.clouds))):
        seconds = _seconds_apart(ensemble, clouds)
        row = f"time in clutter, {len(walk):,} frames, {len(walk.labels)} markers, 3 flickering, {numbers} numbers, one core"
        yield Figure(row, "< 4", seconds, "s", len(walk))


def _looped(recording: Recording, frames: int) -> Recording:
    """So many frames: the recording forwards and backwards in turn, so that it never jumps."""
    there = np.arange(len(recording))
    return recording.frames(np.resize(np.concatenate([there, there[-2:0:-1]]), frames))


def _seconds_apart(ensemble: asterism.MarkerModel, clouds: Clouds) -> float:
    """Seconds of one call in a process of its own, which is ended where it does not come back; a tenth of the frames compile before."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "long.model"
        ensemble.save(path)
        context = multiprocessing.get_context("spawn")
        mine, other = context.Pipe(duplex=False)
        process = context.Process(target=_label_and_tell, args=(path, clouds, other))
        process.start()
        seconds = mine.recv() if mine.poll(2 * PATIENCE) else 2 * PATIENCE
        process.terminate()
        process.join()
    return float(seconds)


def _label_and_tell(path: Path, clouds: Clouds, told: Connection) -> None:
    ensemble = asterism.MarkerModel.load(path)
    ensemble.label(clouds.frames(slice(0, len(clouds) // 10)))
    started = time.perf_counter()
    ensemble.label(clouds)
    told.send(time.perf_counter() - started)
