"""Damaged copies of files of every kind that Asterism reads: exceptions that are no sentence, hangs, crashes, memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from tests.damage.trials import HANG_S, MOST_BYTES, run

COPIES, QUICK_COPIES = 20_000, 300


def damaged_files(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """0 exceptions that are not `AsterismError` with the file's name, 0 hangs above 10 s, no crash, memory below 4 GB."""
    copies = QUICK_COPIES if benchmark.quick else COPIES
    faults = [fault for _, found in run(range(copies), benchmark.jobs) for fault in found]
    for fault in faults[:40]:
        benchmark.report(f"copy {fault.number} ({fault.kind}): {fault.what}, {fault.where}")
    of = Counter(fault.what for fault in faults)
    ended = (copies - len({fault.number for fault in faults})) / copies
    yield Figure("damaged files: read, or a sentence that names the file", "== 1", ended, "fraction", copies)
    yield Figure("damaged files: exceptions that are no sentence", "<= 0", of["exception"], "files", copies)
    yield Figure(f"damaged files: hangs above {HANG_S:g} s", "<= 0", of["hang"], "files", copies)
    yield Figure("damaged files: crashes of the process", "<= 0", of["crash"], "files", copies)
    yield Figure(f"damaged files: memory above {MOST_BYTES >> 30} GB", "<= 0", of["memory"], "files", copies)
