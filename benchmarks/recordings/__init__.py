"""The issue about whole recordings (tracks, time, the subject's own body, corrections that teach): one function per row of its table."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from benchmarks.recordings.ablation import ablation
from benchmarks.recordings.baselines import baselines
from benchmarks.recordings.bodies import bodies
from benchmarks.recordings.dirt import dirt
from benchmarks.recordings.features import features
from benchmarks.recordings.full_body import full_body
from benchmarks.recordings.gaps import gaps
from benchmarks.recordings.loop import loop
from benchmarks.recordings.movement import movement
from benchmarks.recordings.sensitivity import sensitivity
from benchmarks.recordings.speed import speed
from benchmarks.recordings.stream import stream
from benchmarks.recordings.swaps import swaps

ISSUE = "Label whole recordings: tracks, time, the subject's own body, and corrections that teach"

ROWS: dict[str, Callable[[BenchmarkRun], Iterator[Figure]]] = {
    "swaps": swaps,
    "speed-time": speed,
    "bodies": bodies,
    "stream": stream,
    "loop": loop,
    "sensitivity": sensitivity,
    "baselines": baselines,
    "gaps": gaps,
    "ablation": ablation,
    "dirt": dirt,
    "features": features,
    "full-body": full_body,
    "movement-time": movement,
}
"""Cheap rows first: a run that is cut short has measured most of them."""
