"""Exported names against the API reference."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages

import asterism
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

REFERENCE = Path(__file__).parent.parent.parent / "docs" / "reference"


def reference(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Names in the `__all__` of a public package or room that have no heading in docs/reference/."""
    headings = {
        heading
        for page in REFERENCE.glob("*.md")
        for heading in re.findall(r"^### (?:class )?`(\S+)`$", page.read_text(encoding="utf-8"), re.MULTILINE)
    }
    names = exported()
    missing = sorted(names - headings)
    for name in missing:
        benchmark.report(f"no place in the reference: {name}")
    yield Figure("public names without a place in the API reference", "== 0", len(missing), "names", len(names))


def exported() -> set[str]:
    """The dotted names that the package's public modules export."""
    found = (module.name for module in walk_packages(asterism.__path__, "asterism.") if module.ispkg or module.name.count(".") == 1)
    modules = ["asterism", *(name for name in found if _is_public(name))]
    return {f"{module}.{name}" for module in modules for name in getattr(import_module(module), "__all__", ())}


def _is_public(module: str) -> bool:
    return not any(part.startswith("_") for part in module.split("."))
