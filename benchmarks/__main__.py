"""`python -m benchmarks [CHAPTER] [--quick] [--rows ...]` measures; `python -m benchmarks docs` writes the tables."""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from asterism.errors import AsterismError
from benchmarks import cameras, dirt, docs, figures, house, labelling, recordings
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder

CHAPTERS = {"labelling": labelling, "recordings": recordings, "dirt": dirt, "cameras": cameras, "house": house}


def main(arguments: list[str] | None = None) -> int:
    """Measure, tell each figure beside what was asked, keep it. Returns 0; 1 where a row failed; 2 where nothing can be measured."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("what", nargs="?", choices=["all", *CHAPTERS, "docs"], default="all")
    parser.add_argument("--quick", action="store_true", help="few frames and folds, under two minutes a chapter; nothing is written")
    known = "; ".join(f"{name}: {', '.join(chapter.ROWS)}" for name, chapter in CHAPTERS.items())
    parser.add_argument("--rows", nargs="+", metavar="ROW", help=f"only these ({known})")
    parser.add_argument(
        "--models", type=Path, help="keep trained ensembles in this folder, and take them from there while the code is the same"
    )
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1), help="processes that share the folds of a row")
    given = parser.parse_args(arguments)
    if given.what == "docs":
        docs.write()
        return 0
    chapters = [given.what] if given.what in CHAPTERS else list(CHAPTERS)
    rows = [(name, row) for name in chapters for row in CHAPTERS[name].ROWS if not given.rows or row in given.rows]
    strangers = set(given.rows or ()) - {row for _, row in rows}
    if strangers:
        parser.error(f"there is no row {sorted(strangers)[0]!r} in {' or '.join(chapters)}; choose from {known}")
    try:
        folder()
    except AsterismError as problem:
        print(problem, file=sys.stderr)
        return 2
    benchmark = BenchmarkRun(given.quick, given.models, given.jobs)
    failed = [row for chapter, row in rows if not _measure(chapter, row, benchmark)]
    if not given.quick:
        docs.write()
    return 1 if failed else 0


def _measure(chapter: str, row: str, benchmark: BenchmarkRun) -> bool:
    started = time.perf_counter()
    print(f"{row} ...", file=sys.stderr, flush=True)
    try:
        for figure in CHAPTERS[chapter].ROWS[row](benchmark):
            reached = {True: "reached", False: "MISSED", None: ""}[figures.reached(figure.asked, figure.measured)]
            print(f"{figure.row:90} {figure.asked:>12} {figure.measured:12.5g} {figure.unit:18} n={figure.n:<8} {reached}", flush=True)
            if not benchmark.quick:
                figures.record(CHAPTERS[chapter].ISSUE, [figure], f"python -m benchmarks {chapter} --rows {row}")
    except AsterismError as problem:
        print(f"{row}: {problem}", file=sys.stderr, flush=True)
        return False
    print(f"{row}: {time.perf_counter() - started:.0f} s", file=sys.stderr, flush=True)
    return True


if __name__ == "__main__":
    sys.exit(main())
