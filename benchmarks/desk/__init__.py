"""The issue about the person at the desk (labels corrected on a page, folders, nothing hidden): one function per row of its table."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.desk.kills import kills
from benchmarks.desk.pages import pages
from benchmarks.desk.person import person
from benchmarks.desk.resolve import resolve
from benchmarks.desk.trees import trees
from benchmarks.figures import Figure

ISSUE = "The person at the desk: a page on which labels are corrected, folders in and out, and nothing hidden"

ROWS: dict[str, Callable[[BenchmarkRun], Iterator[Figure]]] = {
    "pages": pages,
    "kills": kills,
    "resolve": resolve,
    "trees": trees,
    "person": person,
}
"""Cheap rows first: a run that is cut short has measured most of them."""
