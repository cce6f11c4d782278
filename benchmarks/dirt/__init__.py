"""The issue about dirt (clutter, oddly placed markers, strangers, confidence): one function per row of its table."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.dirt.accuracy import flicker, riding, volume
from benchmarks.dirt.guarantee import guarantee
from benchmarks.dirt.peers import peers
from benchmarks.dirt.reliability import reliability
from benchmarks.dirt.speed import long_recording, speed
from benchmarks.dirt.strangers import strangers
from benchmarks.dirt.stream import stream
from benchmarks.figures import Figure

ISSUE = "Stand firm in dirt: clutter, oddly placed markers, strangers' movements, and a confidence that means what it says"

ROWS: dict[str, Callable[[BenchmarkRun], Iterator[Figure]]] = {
    "flicker": flicker,
    "volume": volume,
    "riding": riding,
    "long-clutter": long_recording,
    "speed-clutter": speed,
    "guarantee": guarantee,
    "stream-clutter": stream,
    "peers-clutter": peers,
    "reliability": reliability,
    "strangers": strangers,
}
