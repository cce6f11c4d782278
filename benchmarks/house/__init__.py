"""The issue "A house that others can carry on": one function per row of its table."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from benchmarks.house.faults import faults
from benchmarks.house.install import ci, ci_fresh, install
from benchmarks.house.kernels import kernels
from benchmarks.house.names import reference
from benchmarks.house.startup import startup
from benchmarks.house.structure import structure
from benchmarks.house.training import training

ISSUE = "A house that others can carry on: the field's names, rooms for what comes, deciders one can check, a suite of five minutes"

ROWS: dict[str, Callable[[BenchmarkRun], Iterator[Figure]]] = {
    "structure": structure,
    "reference": reference,
    "kernels": kernels,
    "faults": faults,
    "startup": startup,
    "training-default": training,
    "install": install,
    "ci": ci,
    "ci-fresh": ci_fresh,
}
"""Cheap rows first: a run that is cut short has measured most of them."""
