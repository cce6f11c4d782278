"""Gaps cut into the straight walks of the gait subjects: how far fills are off, how often intervals hold, how long a fill takes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from asterism.motion.gaps import fill_gaps
from asterism.recording import Recording
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import GAIT_BODY, gait
from benchmarks.figures import Figure

LENGTHS = (0.1, 0.5, 1.0)  # s
CASES = (
    ("one marker of 59", GAIT_BODY, 1, ("<= 0.12", "<= 0.8", "<= 1.0"), "<= 3"),
    ("one marker of 15", "helen-hayes", 1, ("<= 0.25", "<= 1.8", "<= 2.2"), "<= 6"),
    ("three at once on one segment of 59", GAIT_BODY, 3, ("<= 0.12", "<= 2.3", "<= 2.8"), "<= 10"),
)
"""Markers, how many are gone at once; asked: mean mm at each length, p95 at the longest."""


def gaps(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Alone, and with the person's other trials: mean and p95 of the gaps' mean errors, coverage, processor time of a fill."""
    for name, markers, many, asked, tail in CASES:
        people = list(gait(markers).values())[: 2 if benchmark.quick else None]
        for way in ("", ", with the person's other trials"):
            for length, bound in zip(LENGTHS, asked, strict=True):
                rng = np.random.default_rng(0)
                told = [_cut(trials, length, many, rng, bool(way)) for trials in people for _ in range(6)]
                errors, inside, taken = (np.array(part) for part in zip(*told, strict=True))
                row = f"gaps, {name}, {length} s{way}"
                yield Figure(f"{row}: mean error", bound, float(errors.mean()), "mm", len(errors))
                if length == LENGTHS[-1]:
                    yield Figure(f"{row}: 95 % of the errors below", tail, float(np.quantile(errors, 0.95)), "mm", len(errors))
                yield Figure(f"{row}: inside the stated 95 %", "none", float(inside.mean()), "fraction", len(errors))
                yield Figure(f"{row}: that share off 95 %", "<= 0.02", abs(float(inside.mean()) - 0.95), "fraction", len(errors))
                yield Figure(f"{row}: processor time, median", "< 20", float(np.median(taken)), "ms", len(errors))


def _cut(trials: tuple[Recording, ...], length: float, many: int, rng: np.random.Generator, others: bool) -> tuple[float, float, float]:
    """mm off on average, the share of the coordinates within their interval, and ms for a gap anywhere in the straight walk."""
    walk = next(trial for trial in trials if "straight" in str(trial.metadata["file"]))
    frames = round(length * walk.rate)
    column, begin = int(rng.integers(len(walk.labels))), int(rng.integers(5, len(walk) - frames - 5))
    gap, positions = slice(begin, begin + frames), walk.positions.copy()
    if not walk.visible[gap, column].all():
        return _cut(trials, length, many, rng, others)
    for hidden in np.argsort(np.nanmedian(np.linalg.norm(positions - positions[:, [column]], axis=2), axis=0))[:many]:
        positions[gap, hidden] = np.nan
    rest = [trial for trial in trials if others and trial is not walk]
    start = time.process_time()
    fill = fill_gaps(replace(walk, positions=positions), limit=1.0, others=rest)
    taken = 1000.0 * (time.process_time() - start) / fill.gaps
    off = fill.recording.positions[gap, column] - walk.positions[gap, column]
    inside = (np.abs(off) < 1.96 * fill.deviation[gap, column][:, None]).mean()
    return 1000.0 * float(np.linalg.norm(off, axis=1).mean()), float(inside), taken
