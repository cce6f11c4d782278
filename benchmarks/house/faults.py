"""Deliberate faults that the tests notice, from what `tools/mutate.py` has tried."""

from __future__ import annotations

import importlib.util
import json
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from scipy.stats import binomtest

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

ROOT = Path(__file__).parent.parent.parent
RESULTS = ROOT / "benchmarks" / "faults.json"
ROOMS = ("labelling", "reconstruction", "cameras", "formats")
ASKED = 300


def faults(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Results count while the changed text stands in the same function; kernels that do not compile and modules without import do not.

    A fault that survived and that nobody could notice, because it changes nothing, counts as not caught in the first row.
    """
    possible, _ = _tool("faults").sample(ROOT, [f"src/asterism/{room}" for room in ROOMS], 0, sys.maxsize)
    there = {fault.key for fault in possible}
    entries = json.loads(RESULTS.read_text(encoding="utf-8"))
    tried = [entry for key, entry in entries.items() if key in there and entry["status"] not in ("no import", "no compile")]
    if not tried:
        return
    if len(tried) < len(entries):
        benchmark.report(f"{len(entries) - len(tried)} of {len(entries)} results do not count: other code, no import or no compile")
    caught = sum(entry["status"] == "caught" for entry in tried)
    equal = sum(entry["note"].startswith("equal") for entry in tried)
    what = f"deliberate faults in {', '.join(ROOMS)}"
    yield Figure(f"{what}: tried", f">= {ASKED}", len(tried), "faults", len(tried))
    yield from _share(f"{what}: caught", ">= 0.9" if len(tried) >= ASKED else "none", caught, len(tried))
    first = sum(entry["first"] == "caught" for entry in tried)
    yield from _share(f"{what}: caught before tests were written for survivors", "none", first, len(tried))
    if equal:
        yield from _share(f"{what}, without {equal} that change nothing: caught", "none", caught, len(tried) - equal)
    for status, count in sorted(Counter(entry["status"] for entry in tried if entry["status"] != "caught").items()):
        yield Figure(f"{what}: {status}", "none", count, "faults", len(tried))


def _share(what: str, asked: str, caught: int, tried: int) -> Iterator[Figure]:
    ends = binomtest(caught, tried).proportion_ci(method="wilson")
    yield Figure(what, asked, caught / tried, "fraction", tried)
    yield Figure(f"{what}, lower end of the 95 % interval", "none", float(ends.low), "fraction", tried)
    yield Figure(f"{what}, upper end of the 95 % interval", "none", float(ends.high), "fraction", tried)


def _tool(name: str) -> ModuleType:
    """A script of `tools/`, which is no package."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "tools" / f"{name}.py")
    assert spec and spec.loader
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
