"""The issue about garment capture: one function per row of its table."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from benchmarks.garment.capture import calibration, dense, whole_speed
from benchmarks.garment.pattern import check, code, speed
from benchmarks.garment.reading import captured_identities, hard_images

ISSUE = "Garment capture: thousands of colour-coded points, from printed cloth to 3D"

ROWS: dict[str, Callable[[BenchmarkRun], Iterator[Figure]]] = {
    "garment-read-speed": speed,
    "garment-check": check,
    "garment-code": code,
    "garment-speed": whole_speed,
    "garment-hard-images": hard_images,
    "garment-identities": captured_identities,
    "garment-points": dense,
    "garment-calibration": calibration,
}
"""Cheap rows first: a run that is cut short has measured most of them."""
