"""How long the command line takes before it answers, in new processes, and which heavy packages it loads for that."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from statistics import median

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import file_of, gait
from benchmarks.figures import Figure

REPEATS = 9
HEAVY = ("cv2", "jinja2", "numba", "plotly", "scipy")


def startup(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """`asterism --help` and `asterism info FILE` of a C3D file of the gait recordings: wall time, warm, median of nine.

    The modules' bytecode is kept, as in an installed package, also where the environment says that none is to be written.
    """
    file = str(file_of(next(iter(gait().values()))[0]))
    for words, shown, asked in ((["--help"], "--help", "< 0.3"), (["info", file], "info FILE", "< 0.5")):
        repeats = 3 if benchmark.quick else REPEATS
        yield Figure(f"asterism {shown}: wall time", asked, _seconds(words, repeats), "s", repeats)
        loaded = _loaded(words)
        benchmark.report(f"asterism {shown} loads {', '.join(loaded) or 'no heavy package'}")
        row = f"asterism {shown}: heavy packages loaded, of {', '.join(HEAVY)}"
        yield Figure(row, "== 0", len(loaded), "packages", len(HEAVY))


def _seconds(words: list[str], repeats: int) -> float:
    with tempfile.TemporaryDirectory() as folder:
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        environment["PYTHONPYCACHEPREFIX"] = folder

        def once() -> float:
            started = time.perf_counter()
            subprocess.run([sys.executable, "-m", "asterism", *words], check=True, capture_output=True, env=environment)
            return time.perf_counter() - started

        once()
        return median(once() for _ in range(repeats))


def _loaded(words: list[str]) -> list[str]:
    code = f"import sys; from asterism.cli import main; main({words!r}); print(*sorted(set({HEAVY!r}) & set(sys.modules)), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return done.stderr.split()
