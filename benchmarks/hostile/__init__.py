"""The issue about hostile input (broken, hostile and heavy files): one function per row of its table."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from benchmarks.hostile.damaged_files import damaged_files
from benchmarks.hostile.long_recordings import long_recordings

ISSUE = "Broken, hostile and heavy input: no hang, no wrong floor, no batch lost"

ROWS: dict[str, Callable[[BenchmarkRun], Iterator[Figure]]] = {"long-recordings": long_recordings, "damaged-files": damaged_files}
"""Cheap rows first: a run that is cut short has measured most of them."""
