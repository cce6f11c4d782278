"""How much faster than real time a walk becomes a report on one core: the whole command, in a process that has run it before."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import asterism
from asterism.cli import main
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure
from benchmarks.reference import reference

GROUPS = {
    "walks of children": "gait/*/[st]*r[an]*.c3d",
    "walks on plates": "gait-events/plates/*/*.c3d",
    "treadmills": "gait-events/treadmill/*.c3d",
}
REPEATS = 5


def speed(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Time of the recordings over processor time from the command to its results, the median over a group; with a page, and without one."""
    yield from reference(benchmark)
    for group, pattern in GROUPS.items():
        files = sorted(folder().glob(pattern))[: 2 if benchmark.quick else None]
        if group == "walks of children":
            files = [path for path in files if path.with_name("static.c3d").exists()]
        for what, asked in (("parameters and curves as tables", "none"), ("page", "> 100")):
            ratios = [_ratio(path, what == "page") for path in files]
            yield Figure(f"gait, command to {what}: {group}, one core", asked, median(ratios), "x real time", len(files))


def _ratio(path: Path, page: bool) -> float:
    """Of one recording, with the standing trial beside it where there is one; the median of several runs behind one that warms up."""
    static = path.with_name("static.c3d")
    recording = asterism.read(path)
    with TemporaryDirectory() as where, Path(os.devnull).open("w"), redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        words = ["gait", str(path), *(["--static", str(static)] if static.exists() else []), "--overwrite"]
        out = Path(where)
        words += ["--report", str(out / "walk.html")] if page else ["-o", str(out / "parameters.csv"), "--curves", str(out / "curves.csv")]
        times = []
        for _ in range(REPEATS + 1):
            started = time.process_time()
            main(words)
            times.append(time.process_time() - started)
    return len(recording) / recording.rate / median(times[1:])
