"""Recordings of an hour and of minutes: what reading, writing and labelling them takes of memory, and how time grows with the frames."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import mean, median

import numpy as np

import asterism
from asterism.recording import Clouds, Ints, Recording
from asterism.simulation import simulate_gaps_and_ghosts, simulate_walks
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

HOUR, QUICK_HOUR = 360_000, 20_000
"""Frames of an hour at 100 Hz."""

PEOPLE, TRIALS, FRAMES = 7, 2, 600
"""Simulated walks of 39 markers; the first person's are labelled, the others' teach."""

HIDDEN = 3
REPEATS = 3
COULD_NOT_WORK = 2
"""Exit status."""

LAUNCHER = """
import resource, subprocess, sys
status = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
sys.exit(status)
"""
"""Runs a command, and prints the most memory that it took."""


def long_recordings(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """An hour of 39 markers read, written and labelled, each by the command; 48,000 frames in gaps against 6,000."""
    walks = simulate_walks(PEOPLE, FRAMES, markers="plug-in-gait", seed=3, trials=TRIALS)
    learnt = walks[TRIALS:]
    ensemble = benchmark.fit(learnt, [str(walk.metadata["subject"]) for walk in learnt])
    with tempfile.TemporaryDirectory() as folder:
        yield from _memory(Path(folder), walks[0], ensemble, QUICK_HOUR if benchmark.quick else HOUR)
    shorter = 10 if benchmark.quick else 1
    yield from _growth(ensemble, walks[0], [count // shorter for count in (6000, 48_000)], "<= 8.5")


def _memory(folder: Path, walk: Recording, ensemble: asterism.MarkerModel, frames: int) -> Iterator[Figure]:
    recording, model = str(folder / "hour.c3d"), str(folder / "hour.model")
    asterism.write(recording, _repeated(walk, frames))
    ensemble.save(model)
    commands = {
        "read (`asterism info`)": ["info", recording],
        "read and written (`asterism convert`)": ["convert", recording, str(folder / "again.c3d")],
        "read, labelled and written (`asterism label`)": ["label", recording, "--model", model, "-o", str(folder / "labelled.c3d")],
    }
    for name, command in commands.items():
        yield Figure(f"long recordings, an hour of 39 markers {name}: memory at most", "< 1", _peak(command) / 1e9, "GB", frames)


def _growth(ensemble: asterism.MarkerModel, walk: Recording, frames: list[int], asked: str) -> Iterator[Figure]:
    """How much longer the longer of two lengths of the same walk takes: the median of some turns."""
    trials = [simulate_gaps_and_ghosts(_repeated(walk, count), HIDDEN, 0, seed=1) for count in frames]
    ensemble.label(trials[0][0])
    ratio = median(_times_as_long(ensemble, *(clouds for clouds, _ in trials)) for _ in range(REPEATS))
    lengths = f"{frames[1]:,} frames of 39 markers in gaps against {frames[0]:,}"
    yield Figure(f"long recordings, {lengths}: time", asked, ratio, "times", REPEATS)
    rights = [_right(ensemble, clouds, truth) for clouds, truth in trials]
    yield Figure(f"long recordings, {lengths}: right, less", "<= 0.001", rights[0] - rights[1], "fraction", frames[1])
    yield Figure(f"long recordings, {lengths}: right", ">= 0.99", rights[1], "fraction", frames[1])


def _repeated(walk: Recording, frames: int) -> Recording:
    """The walk there and back, again and again."""
    there_and_back = np.concatenate([walk.positions, walk.positions[::-1]])
    times = -(-frames // len(there_and_back))
    return Recording(np.tile(there_and_back, (times, 1, 1))[:frames], walk.labels, walk.rate, walk.vertical)


def _times_as_long(ensemble: asterism.MarkerModel, short: Clouds, long: Clouds) -> float:
    """How many times as long one recording takes as another.

    The machine's speed changes from second to second. So the short one is labelled as often as the long one has times its frames, half of
    that before the long one and half after, and its mean time counts.
    """
    half = max(1, round(len(long) / len(short) / 2))
    before = [_seconds(ensemble, short) for _ in range(half)]
    took = _seconds(ensemble, long)
    after = [_seconds(ensemble, short) for _ in range(half)]
    return took / mean([*before, *after])


def _seconds(ensemble: asterism.MarkerModel, clouds: Clouds) -> float:
    started = time.perf_counter()
    ensemble.label(clouds)
    return time.perf_counter() - started


def _right(ensemble: asterism.MarkerModel, clouds: Clouds, truth: Ints) -> float:
    """Of the markers that have a point, the share that got it."""
    seen = truth >= 0
    return float((ensemble.label(clouds).indices == truth)[seen].mean())


def _peak(command: list[str]) -> float:
    """The most memory (bytes) that a command takes.

    A small process starts it: what a system tells of a command's memory begins with that of the process which started it, and this one has
    trained a model.
    """
    done = subprocess.run([sys.executable, "-c", LAUNCHER, sys.executable, "-m", "asterism", *command], stdout=subprocess.PIPE, text=True)
    if done.returncode == COULD_NOT_WORK:
        raise RuntimeError(f"asterism {command[0]} could not work")
    return float(done.stdout) * (1 if sys.platform == "darwin" else 1024)
