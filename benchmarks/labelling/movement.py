"""Other people, laboratories, vendors and movements: every labelled set, by person, never by frame."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from itertools import groupby
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError
from asterism.labelling.simulated_occlusions import simulate_occlusions
from asterism.recording import NULL, Clouds, Ints, Labelling, Recording
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import Fold, Test, evenly, everything, movement_folds, spread
from benchmarks.figures import Figure
from benchmarks.score import Tally

FRAMES = 400
"""Frames of each recording that are tested, evenly spread."""

REAL_DIRT = ("pig39/test_movement.c3d", "qtm-fullbody/static_lower_body_U.c3d", "mouse-qtm/MOS1aD_S2_M5_MC2_T2_TRM_5MMIN_E.mat")
"""Files with points that nobody labelled. The other dirty ones have gaps only, and every row of theirs keeps its gaps."""


def movement(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """FA and missed with 0 and 3 occlusions by person, then the files with real unlabelled points as they were recorded."""
    folds = _folds(benchmark.quick)
    outcomes = zip(folds, benchmark.each(_tested, range(len(folds))), strict=True)
    for (label, person), group in groupby(outcomes, key=lambda outcome: (outcome[0].label, outcome[0].person)):
        tallies: dict[str, Tally] = defaultdict(Tally)
        for fold, found in group:
            unseen = fold.unseen
            for condition, tally in found.items():
                tallies[condition] += tally
        for condition, tally in tallies.items():
            row = f"movement, {label}, {person}{' not seen' if unseen else ''}, {condition}"
            limited = unseen and "as recorded" not in condition
            yield tally.figure(f"{row}: FA", "<= 0.005" if limited else "none", tally.false_assignments)
            yield tally.figure(f"{row}: missed", "none", tally.missed_share)


@cache
def _folds(quick: bool) -> list[Fold]:
    return list(movement_folds(("clinical-lower",) if quick else None))


def _tested(benchmark: BenchmarkRun, number: int) -> dict[str, Tally]:
    fold = _folds(benchmark.quick)[number]
    train = [evenly(recording, 40) for recording in fold.train] if benchmark.quick else fold.train
    try:
        ensemble = benchmark.fit(train, fold.train_people)
    except AsterismError as problem:
        benchmark.report(f"{fold.label}, {fold.person}: nothing learned, so every marker is missed: {problem}")
        ensemble = None
    tallies: dict[str, Tally] = defaultdict(Tally)

    def count(condition: str, clouds: Clouds, truth: Ints) -> None:
        tallies[condition].add(ensemble.label(clouds) if ensemble else _silence(truth, fold.train[0].labels), truth)

    for place, test in enumerate(fold.test):
        frames = test.frames[spread(len(test.frames), 50 if benchmark.quick else FRAMES)]
        for hidden in (0, 3):
            count(f"{hidden} occlusions", *simulate_occlusions(test.recording.frames(frames), hidden, 0, seed=place))
        if test.file in REAL_DIRT:
            count(f"{Path(test.file).stem} as recorded", *_as_recorded(test, frames))
    benchmark.report(f"{fold.label}, {fold.person}: {', '.join(f'{c} FA {t.false_assignments:.4f}' for c, t in tallies.items())}")
    return dict(tallies)


def _silence(truth: Ints, names: tuple[str, ...]) -> Labelling:
    return Labelling(np.full(truth.shape, NULL, dtype=np.int64), np.zeros(truth.shape), names)


def _as_recorded(test: Test, frames: Ints) -> tuple[Clouds, Ints]:
    """The clouds with the file's other points in them, and the truth about the markers of the set."""
    markers, whole = test.recording, everything(test.file)
    rest = [column for column, label in enumerate(whole.labels) if label not in markers.labels]
    positions = np.concatenate([markers.positions[frames], whole.positions[frames][:, rest]], axis=1)
    labels = (*markers.labels, *(f"*{column}" for column in rest))
    clouds, truth = simulate_occlusions(Recording(positions, labels, whole.rate, whole.vertical), 0, 0, seed=0)
    return clouds, truth[:, : len(markers.labels)]
