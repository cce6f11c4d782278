"""The issue about labelling in the images of few cameras: one function per row of its table."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from benchmarks.views.rows import ablation, bad_input, baseline, gait, own_static, whole_body
from benchmarks.views.speed import basin, nothing_known, parts

ISSUE = "Label in the images of few cameras: a body model that knows what it hides"

ROWS: dict[str, Callable[[BenchmarkRun], Iterator[Figure]]] = {
    "parts": parts,
    "nothing-known": nothing_known,
    "basin": basin,
    "gait-views": gait,
    "whole-body": whole_body,
    "own-static": own_static,
    "plain-baseline": baseline,
    "views-ablation": ablation,
    "bad-views": bad_input,
}
