"""Other people, laboratories, vendors and movements, whole recordings with gaps: every labelled set, by person."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import groupby

from asterism.errors import AsterismError
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import DIRTY, Fold, movement_folds
from benchmarks.figures import Figure
from benchmarks.recordings.walks import silence
from benchmarks.score import Tally

LONGEST = 1000
"""Frames of each recording that are labelled, from its middle."""
LABORATORIES = ("cmu41", "pig39", "clinical-lower", "qtm-fullbody", "lab51-multiactivity", "optitrack-lower/rizzoli24")
"""Six laboratories: a person is left out in the first four, a movement of the one person in the others."""


def movement(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Right, wrong and missed with three gaps open at every moment; what is asked of a person seen is not asked of real dirt besides."""
    yield from _sets(benchmark, ("clinical-lower",) if benchmark.quick else None)


def laboratories(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Six laboratories other than that of the children: each by itself, and all together."""
    chosen = LABORATORIES[2:3] if benchmark.quick else LABORATORIES
    yield from _sets(benchmark, chosen)


def _sets(benchmark: BenchmarkRun, chosen: tuple[str, ...] | None) -> Iterator[Figure]:
    folds, total = _folds(chosen), Tally()
    outcomes = zip(folds, benchmark.each(_tested, [(chosen, number) for number in range(len(folds))]), strict=True)
    for (label, person), group in groupby(outcomes, key=lambda outcome: (outcome[0].label, outcome[0].person)):
        tally, unseen = Tally(), False
        for fold, found in group:
            unseen = fold.unseen
            tally += found
        total += tally
        row = f"movement, {label}, {person}{' not seen' if unseen else ''}, 3 hidden"
        own = "none" if label in DIRTY else ">= 0.999"
        yield tally.figure(f"{row}: right", ">= 0.995" if unseen else own, tally.right_share)
        yield tally.figure(f"{row}: wrong", "<= 0.001" if unseen else "none", tally.false_assignments)
        yield tally.figure(f"{row}: missed", "none", tally.missed_share)
    if chosen:
        row = f"movement, {len(chosen)} other laboratories, 3 hidden"
        yield total.figure(f"{row}: right", ">= 0.995", total.right_share)
        yield total.figure(f"{row}: wrong", "<= 0.001", total.false_assignments)


@cache
def _folds(chosen: tuple[str, ...] | None) -> list[Fold]:
    return list(movement_folds(chosen, halves=True))


def _tested(benchmark: BenchmarkRun, item: tuple[tuple[str, ...] | None, int]) -> Tally:
    fold, tally = _folds(item[0])[item[1]], Tally()
    try:
        ensemble = benchmark.fit(fold.train, fold.train_people)
    except AsterismError as problem:
        benchmark.report(f"{fold.label}, {fold.person}: nothing learned, so every marker is missed: {problem}")
        ensemble = None
    for place, test in enumerate(fold.test):
        spare = max(0, len(test.frames) - LONGEST) // 2
        clouds, truth = simulate_gaps_and_ghosts(test.recording.frames(test.frames[spare : spare + LONGEST]), 3, 0, seed=place)
        tally.add(ensemble.label(clouds) if ensemble else silence(truth, fold.train[0].labels), truth)
    benchmark.report(f"{fold.label}, {fold.person}: right {tally.right_share:.5f}, wrong {tally.false_assignments:.5f}")
    return tally
