"""`python -m benchmarks [CHAPTER] [--rows ...]` measures what is not yet measured by this code; `docs` writes the tables, `stale` lists."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from asterism.errors import AsterismError
from benchmarks import (
    cameras,
    desk,
    dirt,
    docs,
    figures,
    garment,
    hostile,
    house,
    labelling,
    motion,
    read_values,
    recordings,
    runs,
    stale,
    views,
)
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.sources import Folder, Sources, commit, hash_of

CHAPTERS = {
    "labelling": labelling,
    "recordings": recordings,
    "dirt": dirt,
    "cameras": cameras,
    "views": views,
    "garment": garment,
    "hostile": hostile,
    "desk": desk,
    "motion": motion,
    "house": house,
}


def main(arguments: list[str] | None = None) -> int:
    """Measure, tell each figure beside what was asked, keep it. Returns 0; 1: a row failed or is stale; 2: there are no recordings."""
    parser, known = _parser()
    given = parser.parse_args(arguments)
    chapters = [given.what] if given.what in CHAPTERS else list(CHAPTERS)
    rows = [(name, row) for name in chapters for row in CHAPTERS[name].ROWS if not given.rows or row in given.rows]
    strangers = set(given.rows or ()) - {row for _, row in rows}
    if strangers:
        parser.error(f"there is no row {sorted(strangers)[0]!r} in {' or '.join(chapters)}; choose from {known}")
    try:
        recordings_folder = folder()
    except AsterismError as problem:
        if given.what not in ("docs", "stale"):
            print(problem, file=sys.stderr)
            return 2
        recordings_folder = None
    sources = Sources.working()
    held = {} if given.quick else read_values.contents(sources, recordings_folder, _report_reading)
    if given.what == "stale":
        found = stale.stale_rows(figures.load(), sources, held)
        print(stale.report(found, runs.load()))
        return 1 if found else 0
    failed = False
    if given.what != "docs":
        failed = not _measure_all(rows, BenchmarkRun(given.quick, given.models, given.jobs), sources, held, given)
    if not given.quick:
        docs.write(stale.stale_rows(figures.load(), Sources.working(), held, explain=False))
    return 1 if failed else 0


def _report_reading(share: float, what: str) -> None:
    """On a terminal, one line that is written over, of how much of the recordings has been read."""
    if sys.stderr.isatty():
        bar = "#" * round(20 * share)
        print(f"\rreading the recordings [{bar:20}] {what:40}", end="" if share < 1.0 else "\n", file=sys.stderr, flush=True)


def _parser() -> tuple[argparse.ArgumentParser, str]:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("what", nargs="?", choices=["all", *CHAPTERS, "docs", "stale"], default="all")
    parser.add_argument("--quick", action="store_true", help="few frames and folds, under two minutes a chapter; nothing is written")
    known = "; ".join(f"{name}: {', '.join(chapter.ROWS)}" for name, chapter in CHAPTERS.items())
    parser.add_argument("--rows", nargs="+", metavar="ROW", help=f"these, also where this code has measured them already ({known})")
    parser.add_argument("--again", action="store_true", help="all rows, also those that this code has measured already")
    parser.add_argument("--minutes", type=float, help="start no row that took longer, the last time, than what is left of these")
    parser.add_argument(
        "--models",
        type=Path,
        default=Path(tempfile.gettempdir()) / "asterism-benchmark-models",
        help="keep trained ensembles in this folder, and take them from there while the code is the same",
    )
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1), help="processes that share the folds of a row")
    return parser, known


def _measure_all(
    rows: list[stale.Row], benchmark: BenchmarkRun, sources: Sources, held: Mapping[str, Folder], given: argparse.Namespace
) -> bool:
    """Measure rows one after the other; whether none failed and none was left for want of time."""
    started, complete, done = time.perf_counter(), True, runs.load()
    for chapter, row in rows:
        origin = figures.NOBODY if given.quick else figures.Origin(commit(), hash_of(sources, chapter, row, held))
        last = done.get((chapter, row))
        if not (given.again or given.rows or given.quick) and last and last.sources == origin.sources:
            print(f"{row}: measured by this code already", file=sys.stderr, flush=True)
            continue
        left = float("inf") if given.minutes is None else 60 * given.minutes - (time.perf_counter() - started)
        if left < (last.seconds if last else 0.0):
            print(f"{row}: left out, {left / 60:.0f} minutes are not enough", file=sys.stderr, flush=True)
            complete = False
            continue
        complete &= _measure(chapter, row, benchmark, origin)
    return complete


def _measure(chapter: str, row: str, benchmark: BenchmarkRun, origin: figures.Origin) -> bool:
    started, cpu_before, command, measured = time.perf_counter(), runs.cpu_seconds(), stale.command_of(chapter, row), []
    print(f"{row} ...", file=sys.stderr, flush=True)
    try:
        for figure in CHAPTERS[chapter].ROWS[row](benchmark):
            reached = {True: "reached", False: "MISSED", None: ""}[figures.reached(figure.asked, figure.measured)]
            print(f"{figure.row:90} {figure.asked:>12} {figure.measured:12.5g} {figure.unit:18} n={figure.n:<8} {reached}", flush=True)
            measured.append(figure.row)
            if not benchmark.quick:
                figures.record(CHAPTERS[chapter].ISSUE, [figure], command, origin=origin)
    except AsterismError as problem:
        print(f"{row}: {problem}", file=sys.stderr, flush=True)
        return False
    seconds = time.perf_counter() - started
    print(f"{row}: {seconds:.0f} s", file=sys.stderr, flush=True)
    if not benchmark.quick:
        figures.forget_others(command, measured)
        spent, today = round(runs.cpu_seconds() - cpu_before, 1), datetime.now(UTC).date().isoformat()
        runs.record(runs.Run(chapter, row, round(seconds, 1), spent, benchmark.jobs, origin.commit, origin.sources, today))
    return True


if __name__ == "__main__":
    sys.exit(main())
