"""Rows in; the order in which they are measured out: rows that measure time or memory alone, the others on all cores, the longest first."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path

from asterism.errors import AsterismError
from benchmarks import runs
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from benchmarks.runs import Run
from benchmarks.stale import Row

ALONE = {
    "labelling": ("full-solver", "training", "speed", "full-body", "unseen"),
    "recordings": ("swaps", "speed-time", "stream"),
    "dirt": ("long-clutter", "speed-clutter", "stream-clutter"),
    "cameras": ("accuracy", "detection", "points-speed", "demo", "wand", "wand-peer"),
    "views": ("parts",),
    "garment": ("garment-read-speed", "garment-code", "garment-speed"),
    "hostile": ("long-recordings", "damaged-files"),
    "desk": ("pages", "resolve"),
    "motion": ("speed",),
    "house": ("startup", "training-default", "install", "ci", "ci-fresh"),
}
"""Rows that measure time or memory, or use all cores themselves: nothing else is measured beside them."""


def may_have_company(row: Row) -> bool:
    """Whether other rows may be measured beside this one."""
    return row[1] not in ALONE.get(row[0], ())


def expected_seconds(durations: Sequence[Run], cores: int) -> float:
    """How long a whole run takes by what the rows took last: those that are measured alone, and the others on all cores."""
    alone = sum(run.seconds for run in durations if not may_have_company((run.chapter, run.row)))
    shared = [run.cpu_seconds for run in durations if may_have_company((run.chapter, run.row))]
    return alone + max(sum(shared) / cores, max(shared, default=0.0))


@dataclass(frozen=True)
class Measured:
    """A row that was measured to its end, or to the problem that ended it; seconds by the clock and of the processors."""

    figures: tuple[Figure, ...]
    seconds: float
    cpu_seconds: float
    problem: str = ""


@dataclass(frozen=True)
class Measurement:
    """Measures a row in a process of its own; can be pickled."""

    quick: bool
    models: Path | None

    def __call__(self, row: Row) -> Measured:
        """The figures of a row."""
        chapter, name = row
        return measured(import_module(f"benchmarks.{chapter}").ROWS[name], BenchmarkRun(self.quick, self.models))


def measured(
    row: Callable[[BenchmarkRun], Iterator[Figure]], benchmark: BenchmarkRun, report: Callable[[Figure], None] = lambda figure: None
) -> Measured:
    """Measure a row in this process; `report` is told of each figure as it comes."""
    started, cpu_before, figures, problem = time.perf_counter(), runs.cpu_seconds(), [], ""
    try:
        for figure in row(benchmark):
            figures.append(figure)
            report(figure)
    except AsterismError as error:
        problem = str(error)
    return Measured(tuple(figures), round(time.perf_counter() - started, 1), round(runs.cpu_seconds() - cpu_before, 1), problem)


def side_by_side(
    rows: Sequence[Row], work: Callable[[Row], Measured], jobs: int, may_begin: Callable[[Row], bool], last: Mapping[Row, Run]
) -> Iterator[tuple[Row, Measured]]:
    """Measure rows in so many processes, those that took longest the last time first; each as it ends.

    may_begin  asked before a row begins; a row that may not is left out
    last       when each row was measured last
    """
    waiting = sorted(rows, key=lambda row: -(last[row].cpu_seconds if row in last else float("inf")))
    running: dict[Future[Measured], Row] = {}
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), max_tasks_per_child=1) as pool:
        while waiting or running:
            while waiting and len(running) < jobs:
                row = waiting.pop(0)
                if may_begin(row):
                    running[pool.submit(work, row)] = row
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future.result()
