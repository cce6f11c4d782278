"""The issue "Label a real recording end to end: the solver ensemble": one function per row of its table."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from benchmarks.labelling.files import conformance, physical
from benchmarks.labelling.movement import movement
from benchmarks.labelling.seen import full_body, speed, tables, training
from benchmarks.labelling.solver import full_solver, strong_classifier
from benchmarks.labelling.thesis import thesis
from benchmarks.labelling.unseen import unseen

ISSUE = "Label a real recording end to end: the solver ensemble"

ROWS: dict[str, Callable[[BenchmarkRun], Iterator[Figure]]] = {
    "conformance": conformance,
    "physical": physical,
    "strong-classifier": strong_classifier,
    "full-solver": full_solver,
    "training": training,
    "speed": speed,
    "tables": tables,
    "thesis": thesis,
    "full-body": full_body,
    "unseen": unseen,
    "movement": movement,
}
"""Cheap rows first: a run that is cut short has measured most of them."""
