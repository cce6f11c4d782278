"""Words in; rows on standard output, and in a file where `--json` names one."""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks import docs, release
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.chapters import CHAPTERS, row_of
from benchmarks.figures import Figure, measured_text, reached

Row = tuple[str, str]
"""Chapter and row."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what the words name. Returns 0; 1 where a row failed; 2 where a release is refused."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words[:1] == ["release"]:
        return release.main(words[1:])
    if words == ["docs"]:
        return docs.main()
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Measure figures, each beside what is asked.")
    parser.add_argument("chapter", choices=list(CHAPTERS), help="a chapter; or `release` or `docs`, see their own --help")
    parser.add_argument("rows", nargs="*", metavar="ROW", help="; ".join(f"{name}: {', '.join(rows)}" for name, rows in CHAPTERS.items()))
    _add_options(parser)
    given = parser.parse_args(words)
    known = CHAPTERS[given.chapter]
    strangers = [row for row in given.rows if row not in known]
    if strangers:
        parser.error(f"there is no row {strangers[0]!r} in {given.chapter}; choose from {', '.join(known)}")
    return _measure([(given.chapter, row) for row in given.rows or known], given)


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--quick", action="store_true", help="few frames and folds, to see that it runs; the numbers mean little")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows into a file, too")
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1), help="processes that share the folds of a row")
    parser.add_argument("--dask", metavar="ADDRESS", help="in place of --jobs, a Dask cluster that sees --models; or local:N")
    parser.add_argument("--models", type=Path, help="keep trained models in this folder; empty it when the code has changed")


def _measure(rows: Iterable[Row], given: argparse.Namespace) -> int:
    entries, failed = [], []
    with tempfile.TemporaryDirectory() as scratch:
        run = BenchmarkRun(given.quick, given.models or Path(scratch), given.jobs, given.dask)
        for chapter, row in rows:
            started, processor = time.perf_counter(), time.process_time()
            try:
                for figure in row_of(chapter, row)(run):
                    print(line_of(figure), flush=True)
                    entries.append(entry_of(chapter, figure))
            except Exception as problem:  # one row costs itself, whatever it met
                failed.append(f"{chapter} {row}: {type(problem).__name__}: {problem}")
                print(failed[-1], file=sys.stderr, flush=True)
            run.report(f"{chapter} {row}: {time.perf_counter() - started:.0f} s, of one core {time.process_time() - processor:.0f} s")
    if given.json:
        given.json.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")
    return int(bool(failed))


def entry_of(chapter: str, figure: Figure) -> dict[str, object]:
    """A figure as files keep it: chapter, row, asked, measured, unit, n."""
    return {"chapter": chapter, **asdict(figure)}


def line_of(figure: Figure) -> str:
    """A figure as a line of standard output."""
    verdict = {True: "reached", False: "MISSED", None: ""}[reached(figure.asked, figure.measured)]
    return f"{figure.row:90} {figure.asked:>12} {measured_text(figure.measured, figure.unit):>20} n={figure.n:<8} {verdict}".rstrip()
