"""The deciding kernels and whether each decision is checked by a plain twin or by exhaustion."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

TABLE = Path(__file__).parent.parent.parent / "tests" / "deciding_kernels.py"


def kernels(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Entries of tests/deciding_kernels.py that name no test; that the named tests exist and pass is what the tests check."""
    spec = importlib.util.spec_from_file_location("deciding_kernels", TABLE)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    unchecked = [kernel for kernel, test in module.CHECKED_BY.items() if not test]
    for kernel in unchecked:
        benchmark.report(f"no twin or exhaustive check: {kernel}")
    yield Figure("kernels that decide, without a twin or an exhaustive check", "== 0", len(unchecked), "kernels", len(module.CHECKED_BY))
