"""Damaged copies of files of every kind that Asterism reads: exceptions that are no sentence, hangs, crashes, memory."""

from __future__ import annotations

import hashlib
import json
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from benchmarks.hostile.trials import HANG_S, MOST_BYTES, Fault, run
from benchmarks.sources import Sources

COPIES, QUICK_COPIES, STRETCH = 100_000, 300, 5000


def damaged_files(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """0 exceptions that are not `AsterismError` with the file's name, 0 hangs above 10 s, no crash, memory below 4 GB.

    Stretches that the same code has read are kept beside the trained ensembles, so that a run goes on where it was stopped.
    """
    copies = QUICK_COPIES if benchmark.quick else COPIES
    kept = benchmark.models / f"damaged-files-{_code()}.json" if benchmark.models and not benchmark.quick else None
    done, faults = _kept(kept)
    while done < copies:
        for _, found in run(range(done, min(done + STRETCH, copies)), benchmark.jobs):
            faults += found
        done = min(done + STRETCH, copies)
        _keep(kept, done, faults)
        benchmark.report(f"{done:,} of {copies:,} damaged files read, {len(faults)} faults")
    for fault in faults[:40]:
        benchmark.report(f"copy {fault.number} ({fault.kind}): {fault.what}, {fault.where}")
    of = Counter(fault.what for fault in faults)
    yield Figure("damaged files: exceptions that are no sentence", "<= 0", of["exception"], "files", copies)
    yield Figure(f"damaged files: hangs above {HANG_S:g} s", "<= 0", of["hang"], "files", copies)
    yield Figure("damaged files: crashes of the process", "<= 0", of["crash"], "files", copies, ours=True)
    yield Figure(f"damaged files: memory above {MOST_BYTES >> 30} GB", "<= 0", of["memory"], "files", copies)


def _code() -> str:
    """A hash of all that the row measures: readers, and how files are damaged."""
    measured = Sources.working().measured_by("hostile", "damaged-files")
    return hashlib.sha256(json.dumps(measured, sort_keys=True).encode()).hexdigest()[:16]


def _kept(path: Path | None) -> tuple[int, list[Fault]]:
    if path is None or not path.exists():
        return 0, []
    content = json.loads(path.read_text(encoding="utf-8"))
    return content["done"], [Fault(**fault) for fault in content["faults"]]


def _keep(path: Path | None, done: int, faults: list[Fault]) -> None:
    if path is None:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f"{path.name}.{os.getpid()}.part")
    temporary.write_text(json.dumps({"done": done, "faults": [fault.to_dict() for fault in faults]}), encoding="utf-8")
    os.replace(temporary, path)
