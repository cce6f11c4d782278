"""Odd files of many vendors: which of them open, and whether encodings agree."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from asterism.errors import AsterismError
from asterism.formats import read, read_table
from asterism.recording import Recording
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure

ONE_STEP_MM = 0.2812
"""The scale of the integer files of sample_02: to multiples of it coordinates were cut in some, rounded in others."""

TRUE_FRAMES = {"kyowadengyo.c3d": 152, "pyomeca_markers.trc": 93}
"""Where the index is wrong. The first file's header (11 points, 152 frames) and parameters (12, 145) differ, and only the header's
layout gives smooth paths; in the second a line of commas between head and data was counted as a frame."""


def conformance(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Files that open with the right number of frames; where one does not, its sentence goes to the log."""
    root = folder() / "conformance"
    paths = _c3d_files(root)
    yield Figure("conformance: C3D files read", f">= {len(paths) - 1}", sum(_opens(benchmark, path) for path in paths), "files", len(paths))
    sample = root / "c3d" / "sample_02"
    for kind, pattern, asked in (("three real", "*_real", 0.001), ("three integer", "*_int", ONE_STEP_MM), ("six", "*", ONE_STEP_MM)):
        some = [read(path) for path in sorted(sample.glob(f"{pattern}.c3d"))]
        apart = max(_millimetres_apart(some[0], other) for other in some[1:])
        yield Figure(f"conformance: {kind} encodings of one trial, farthest apart", f"<= {asked}", apart, "mm", len(some))
    for suffix in ("trc", "mot", "sto", "csv"):
        paths = sorted(root.rglob(f"*.{suffix}"))
        yield Figure(
            f"conformance: {suffix.upper()} files read",
            f">= {len(paths)}",
            sum(_opens(benchmark, path) for path in paths),
            "files",
            len(paths),
        )


def _c3d_files(root: Path) -> list[Path]:
    return sorted(path for path in root.rglob("*") if path.suffix.lower() == ".c3d")


def _name(path: Path) -> str:
    """The path as the index writes it: below `movement`, or else below the folder of all data or of the cameras."""
    for root in ("movement", "cameras"):
        if path.is_relative_to(folder() / root):
            return str(path.relative_to(folder() / root))
    return str(path.relative_to(folder()))


def _index() -> dict[str, dict[str, Any]]:
    known: dict[str, dict[str, Any]] = json.loads((folder() / "movement" / "index.json").read_text(encoding="utf-8"))
    return known


def _opens(benchmark: BenchmarkRun, path: Path) -> bool:
    """Whether a file opens, as a recording or as a table, with as many frames as the index knows (where it does)."""
    try:
        frames = len(read(path, vertical="z")) if path.suffix not in (".mot", ".sto") else len(read_table(path).values)
    except AsterismError as problem:
        benchmark.report(str(problem))
        return False
    expected = TRUE_FRAMES.get(path.name) or _index().get(_name(path), {}).get("frames") or frames
    if frames != expected or frames == 0:
        benchmark.report(f"{_name(path)}: {frames} frames instead of {expected}")
    return frames == expected and frames > 0


def _millimetres_apart(one: Recording, other: Recording) -> float:
    """The largest difference of any coordinate; infinite where labels or gaps differ."""
    if one.labels != other.labels or not np.array_equal(one.visible, other.visible):
        return float("inf")
    return float(np.nanmax(np.abs(one.positions - other.positions))) * 1000
