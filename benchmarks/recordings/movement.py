"""Other people, laboratories, vendors and movements, whole recordings with gaps: every labelled set, by person."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import groupby

import numpy as np

from asterism.errors import AsterismError
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.recording import NULL, Ints, Labelling
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import DIRTY, Fold, movement_folds
from benchmarks.figures import Figure
from benchmarks.score import Tally

LONGEST = 1000
"""Frames of each recording that are labelled, from its middle."""


def movement(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Right, FA and missed with three gaps open at every moment; what is asked of a person seen is not asked of real dirt besides."""
    folds = _folds(benchmark.quick)
    outcomes = zip(folds, benchmark.each(_tested, range(len(folds))), strict=True)
    for (label, person), group in groupby(outcomes, key=lambda outcome: (outcome[0].label, outcome[0].person)):
        tally, framewise, unseen = Tally(), Tally(), False
        for fold, found in group:
            unseen = fold.unseen
            tally += found[0]
            framewise += found[1]
        row = f"movement, {label}, {person}{' not seen' if unseen else ''}, 3 hidden"
        own = "none" if label in DIRTY else ">= 0.999"
        yield tally.figure(f"{row}: right", ">= 0.995" if unseen else own, tally.right_share)
        yield tally.figure(f"{row}: FA", "<= 0.001" if unseen else "none", tally.false_assignments)
        yield tally.figure(f"{row}: missed", "none", tally.missed_share)
        yield framewise.figure(f"{row}, frame by frame: right", "none", framewise.right_share)
        yield framewise.figure(f"{row}, frame by frame: FA", "none", framewise.false_assignments)


@cache
def _folds(quick: bool) -> list[Fold]:
    return list(movement_folds(("clinical-lower",) if quick else None, halves=True))


def _tested(benchmark: BenchmarkRun, number: int) -> tuple[Tally, Tally]:
    """The whole recordings, and the same frame by frame."""
    fold, tally, framewise = _folds(benchmark.quick)[number], Tally(), Tally()
    try:
        ensemble = benchmark.fit(fold.train, fold.train_people)
    except AsterismError as problem:
        benchmark.report(f"{fold.label}, {fold.person}: nothing learned, so every marker is missed: {problem}")
        ensemble = None
    for place, test in enumerate(fold.test):
        spare = max(0, len(test.frames) - LONGEST) // 2
        clouds, truth = simulate_gaps_and_ghosts(test.recording.frames(test.frames[spare : spare + LONGEST]), 3, 0, seed=place)
        nothing = silence(truth, fold.train[0].labels)
        tally.add(ensemble.label(clouds) if ensemble else nothing, truth)
        framewise.add(ensemble.label_frames(clouds) if ensemble else nothing, truth)
    told = f"right {tally.right_share:.5f}, FA {tally.false_assignments:.5f}, frame by frame {framewise.right_share:.5f}"
    benchmark.report(f"{fold.label}, {fold.person}: {told}")
    return tally, framewise


def silence(truth: Ints, names: tuple[str, ...]) -> Labelling:
    """The labelling of whoever has learned nothing."""
    return Labelling(np.full(truth.shape, NULL, dtype=np.int64), np.zeros(truth.shape), names)
