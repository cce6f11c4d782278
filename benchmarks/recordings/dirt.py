"""Recordings with real gaps and real ghosts, labelled by hand: how many of those labels are found again, and what is left alone.

A model learns from one half of a trial and labels the other (clouthier62: from one trial, and labels the other). Every column is broken
at its real gaps, each piece under a track number of its own; nothing is hidden besides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from itertools import groupby

import numpy as np

from asterism.errors import AsterismError
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.recording import NULL, Ints, Labelling, Recording
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import DIRTY, Fold, Test, everything, is_unnamed, movement_folds
from benchmarks.figures import Figure
from benchmarks.recordings.walks import silence
from benchmarks.score import Tally


@dataclass
class Found:
    """Hand labels found again, and the samples of pieces that nobody named.

    pieces  (4,) their samples; of these left null; those of pieces that can be no marker, since every marker is labelled elsewhere by
            hand in at least one of the piece's frames; of these left null
    """

    tally: Tally = field(default_factory=Tally)
    pieces: Ints = field(default_factory=lambda: np.zeros(4, dtype=np.int64))


def dirt(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Hand labels found again and wrong labels by set, and what becomes of the pieces without a name."""
    folds = _folds(benchmark.quick)
    for label, group in groupby(zip(folds, benchmark.each(_tested, range(len(folds))), strict=True), key=lambda outcome: outcome[0].label):
        total = Found()
        for _, found in group:
            total.tally += found.tally
            total.pieces = total.pieces + found.pieces
        tally, (samples, null, strange, strange_null) = total.tally, total.pieces
        yield tally.figure(f"dirt, {label}: hand labels found again", ">= 0.995", tally.right_share)
        yield tally.figure(f"dirt, {label}: wrong", "none", tally.false_assignments)
        if samples:
            yield Figure(f"dirt, {label}: samples without a name, left null", "none", null / samples, "fraction", int(samples))
        if strange:
            row = f"dirt, {label}: samples of pieces that can be no marker, left null"
            yield Figure(row, ">= 0.995", strange_null / strange, "fraction", int(strange))


@cache
def _folds(quick: bool) -> list[Fold]:
    return list(movement_folds(("optitrack-wheelchair/racing_full",) if quick else DIRTY, halves=True))


def _tested(benchmark: BenchmarkRun, number: int) -> Found:
    fold, found = _folds(benchmark.quick)[number], Found()
    try:
        ensemble = benchmark.fit(fold.train, fold.train_people)
    except AsterismError as problem:
        benchmark.report(f"{fold.label}: nothing learned, so every marker is missed: {problem}")
        ensemble = None
    for place, test in enumerate(fold.test):
        markers = len(test.recording.labels)
        clouds, truth = simulate_gaps_and_ghosts(_with_pieces(test), 0, 0, seed=place)
        nothing = silence(truth[:, :markers], test.recording.labels)
        labelling = ensemble.label(clouds) if ensemble else nothing
        found.tally.add(labelling, truth[:, :markers])
        found.pieces += _pieces(labelling, truth)
    told = f"found again {found.tally.right_share:.5f}, wrong {found.tally.false_assignments:.5f}, pieces {found.pieces}"
    benchmark.report(f"{fold.label}: {told}")
    return found


def _with_pieces(test: Test) -> Recording:
    """The frames that are tested: the markers of the set, then every column of the file that has no name."""
    whole = everything(test.file)
    rest = [column for column, label in enumerate(whole.labels) if is_unnamed(label)]
    positions = np.concatenate([test.recording.positions[test.frames], whole.positions[test.frames][:, rest]], axis=1)
    labels = (*test.recording.labels, *(f"*{column}" for column in rest))
    return Recording(positions, labels, whole.rate, whole.vertical)


def _pieces(labelling: Labelling, truth: Ints) -> Ints:
    """What became of the columns behind the markers; see `Found`."""
    markers = labelling.indices.shape[1]
    counts = np.zeros(4, dtype=np.int64)
    for places in truth[:, markers:].T:
        frames = np.nonzero(places != NULL)[0]
        if len(frames):
            null = int((labelling.indices[frames] != places[frames, None]).all(axis=1).sum())
            strange = bool((truth[frames, :markers] != NULL).any(axis=0).all())
            counts += np.array([len(frames), null, len(frames) * strange, null * strange])
    return counts
