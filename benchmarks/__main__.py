"""`python -m benchmarks [CHAPTER] [--rows ...]` measures what is not yet measured by this code; `docs` writes the tables, `stale` lists."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
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
    schedule,
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
    measuring = Measuring(given, sources, held)
    if given.what != "docs":
        measuring.all_of(rows)
    if not given.quick:
        docs.write(stale.stale_rows(figures.load(), Sources.working(), held, explain=False))
    return 0 if measuring.complete else 1


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
    parser.add_argument(
        "--jobs", type=int, default=min(2, os.cpu_count() or 1), help="processes that share the rows, or the folds of one row"
    )
    return parser, known


class Measuring:
    """Measures rows and keeps what they give; `complete` until a row fails or is left out for want of time."""

    def __init__(self, given: argparse.Namespace, sources: Sources, held: Mapping[str, Folder]) -> None:
        self.given, self.sources, self.held = given, sources, held
        self.last, self.complete = runs.load(), True
        self.benchmark = BenchmarkRun(given.quick, given.models, given.jobs)
        self.until = float("inf") if given.minutes is None else time.perf_counter() + 60 * given.minutes

    def all_of(self, rows: Sequence[stale.Row]) -> None:
        """Measure rows: with several jobs those that may have company side by side, then the others one after the other."""
        origins = {row: self._origin(row) for row in rows}
        waiting = [row for row in rows if not self._is_done(row, origins[row])]
        shared = [row for row in waiting if self.given.jobs > 1 and len(waiting) > 1 and schedule.may_have_company(row)]
        measurement = schedule.Measurement(self.given.quick, self.given.models)
        for row, measured in schedule.side_by_side(shared, measurement, self.given.jobs, self._may_begin, self.last):
            for figure in measured.figures:
                self._keep(row, figure, origins[row])
            self._end(row, measured, origins[row], jobs=1)
        for row in waiting:
            if row not in shared and self._may_begin(row):
                measured = schedule.measured(
                    CHAPTERS[row[0]].ROWS[row[1]], self.benchmark, lambda figure, row=row: self._keep(row, figure, origins[row])
                )
                self._end(row, measured, origins[row], self.given.jobs)

    def _origin(self, row: stale.Row) -> figures.Origin:
        return figures.NOBODY if self.given.quick else figures.Origin(commit(), hash_of(self.sources, *row, self.held))

    def _is_done(self, row: stale.Row, origin: figures.Origin) -> bool:
        last = self.last.get(row)
        done = not (self.given.again or self.given.rows or self.given.quick) and last is not None and last.sources == origin.sources
        if done:
            print(f"{row[1]}: measured by this code already", file=sys.stderr, flush=True)
        return done

    def _may_begin(self, row: stale.Row) -> bool:
        left = self.until - time.perf_counter()
        if row in self.last and left < self.last[row].seconds:
            print(f"{row[1]}: left out, {left / 60:.0f} minutes are not enough", file=sys.stderr, flush=True)
            self.complete = False
            return False
        print(f"{row[1]} ...", file=sys.stderr, flush=True)
        return True

    def _keep(self, row: stale.Row, figure: figures.Figure, origin: figures.Origin) -> None:
        verdict = {True: "reached", False: "MISSED", None: ""}[figures.reached(figure.asked, figure.measured)]
        print(f"{figure.row:90} {figure.asked:>12} {figure.measured:12.5g} {figure.unit:18} n={figure.n:<8} {verdict}", flush=True)
        if not self.given.quick:
            figures.record(CHAPTERS[row[0]].ISSUE, [figure], stale.command_of(*row), origin=origin)

    def _end(self, row: stale.Row, measured: schedule.Measured, origin: figures.Origin, jobs: int) -> None:
        print(f"{row[1]}: {measured.problem or f'{measured.seconds:.0f} s'}", file=sys.stderr, flush=True)
        if measured.problem:
            self.complete = False
        elif not self.given.quick:
            figures.forget_others(stale.command_of(*row), [figure.row for figure in measured.figures])
            today = datetime.now(UTC).date().isoformat()
            runs.record(runs.Run(*row, measured.seconds, measured.cpu_seconds, jobs, origin.commit, origin.sources, today))


if __name__ == "__main__":
    sys.exit(main())
