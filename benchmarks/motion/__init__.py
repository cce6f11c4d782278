"""The issue about motion with its uncertainty: one function per row of its table."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from benchmarks.motion.angles import dense, sparse
from benchmarks.motion.coverage import coverage
from benchmarks.motion.gait import knee
from benchmarks.motion.paper import paper, toy
from benchmarks.motion.peers import peers
from benchmarks.motion.speed import speed

ISSUE = "Motion with its uncertainty: segments, joints and angles from points alone"

ROWS: dict[str, Callable[[BenchmarkRun], Iterator[Figure]]] = {
    "paper": paper,
    "toy": toy,
    "knee": knee,
    "peers": peers,
    "sparse": sparse,
    "dense": dense,
    "coverage": coverage,
    "speed": speed,
}
"""Cheap rows first: a run that is cut short has measured most of them."""
