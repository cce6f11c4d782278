"""What a new user waits for: the first `asterism demo` in a fresh environment, which compiles kernels, and the second; and all checks."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from asterism.errors import AsterismError
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

ROOT = Path(__file__).parent.parent.parent


def install(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """`pip install .` into a new environment with a compile cache that is empty; then the demo, twice."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        environment = {
            **{key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "NUMBA"))},
            "XDG_CACHE_HOME": str(folder / "cache"),
            "PIP_DISABLE_PIP_VERSION_CHECK": "1",
        }
        _run([sys.executable, "-m", "venv", str(folder / "venv")], folder, environment)
        scripts = folder / "venv" / ("Scripts" if os.name == "nt" else "bin")
        _run([str(scripts / "python"), "-m", "pip", "install", "--quiet", str(ROOT)], folder, environment)
        benchmark.report("installed")
        for which, asked in (("first", "< 30"), ("second", "< 4")):
            seconds = _run([str(scripts / "asterism"), "demo", "-o", which], folder, environment)
            yield Figure(f"fresh install: {which} asterism demo", asked, seconds, "s", 1)


def ci(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """`.ci/run` with empty caches: all kernels compile, all models of the tests are trained. Stop everything else before."""
    if not benchmark.quick:
        with tempfile.TemporaryDirectory() as kept:
            environment = {**os.environ, "NUMBA_CACHE_DIR": f"{kept}/kernels", "ASTERISM_TEST_CACHE": f"{kept}/models"}
            before = os.times()
            seconds = _run([str(ROOT / ".ci" / "run")], ROOT, environment)
            after = os.times()
        spent = after.children_user + after.children_system - before.children_user - before.children_system
        yield Figure(".ci/run, empty caches, 2 cores", "< 3.5", seconds / 60, "min", 1)
        yield Figure(".ci/run, empty caches: processor time", "<= 330", spent, "s", 1)


def _run(words: list[str], folder: Path, environment: dict[str, str]) -> float:
    """Seconds that a command takes. Raises AsterismError with the end of what it printed where it fails."""
    started = time.perf_counter()
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise AsterismError(f"{' '.join(words)} left with {done.returncode}: {done.stderr[-500:]}\n{done.stdout[-1500:]}")
    return time.perf_counter() - started
