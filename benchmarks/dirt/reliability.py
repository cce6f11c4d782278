"""What a confidence is worth: frames, whole recordings and streams of people whom training has not seen, by how many taught it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from itertools import groupby

import numpy as np

from asterism.errors import AsterismError
from asterism.labelling import ConfidenceTally
from asterism.recording import Ints, Labelling
from asterism.simulation import Clutter, simulate_gaps_and_ghosts
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import PEOPLE, Fold, evenly, gait, movement_folds
from benchmarks.figures import Figure
from benchmarks.recordings.stream import pushed
from benchmarks.recordings.walks import Condition, label_whole, reporting, samples, unseen_model

CONDITIONS = (
    Condition(3),
    Condition(5),
    Condition(3, 3),
    Condition(3, clutter=Clutter(3.0, 1, "beside", 0.08)),
    Condition(3, clutter=Clutter(3.0, 1, "beside", 0.03)),
)
FRAMES, WHOLE, STREAM = "frame by frame", "whole recording", "stream, delay 10"
FEW = (1, 2)
"""People that teach a model."""
BANDS = {"at 0.99 or more": (0.99, 1.01, ">= 0.99"), "from 0.95 to 0.99": (0.95, 0.99, ">= 0.95")}
"""Labels by their confidence: of each band as many must be right as its lower end says."""
LONGEST, FRAMES_OF_TRIAL = 600, 200
"""Frames of a movement recording that are labelled, from its middle as a whole, and evenly spread as single frames."""


class Worth:
    """What the labels of one way to label were worth: by band, and by proper scores."""

    def __init__(self) -> None:
        self.scores, self.bands = ConfidenceTally(), {name: np.zeros(2, dtype=np.int64) for name in BANDS}

    def add(self, labelling: Labelling, truth: Ints, person: str) -> None:
        """Count one labelling of a person, truth (T, M)."""
        given = labelling.indices >= 0
        right = given & (labelling.indices == truth)
        self.scores.add(labelling.confidence, given, right, person)
        for name, (low, high, _) in BANDS.items():
            here = given & (labelling.confidence >= low) & (labelling.confidence < high)
            self.bands[name] += [int(here.sum()), int((here & right).sum())]

    def __iadd__(self, other: Worth) -> Worth:
        self.scores += other.scores
        for name, counts in other.bands.items():
            self.bands[name] += counts
        return self


Worths = Mapping[str, Worth]


def reliability(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Gait subjects left out; models of few of them; movement sets by person."""
    subjects = reporting()[: 1 if benchmark.quick else None]
    found = list(benchmark.each(_left_out, subjects))
    yield from _figures("reliability, gait, ten taught", _summed(found))
    items = [(count, i) for count in FEW[: 1 if benchmark.quick else None] for i in range(1 if benchmark.quick else len(reporting()))]
    few = zip(items, benchmark.each(_few, items), strict=True)
    for count, group in groupby(few, key=lambda outcome: outcome[0][0]):
        yield from _figures(f"reliability, gait, {count} taught", _summed([worths for _, worths in group]))
    folds = _folds(benchmark.quick)
    moved = list(zip(folds, benchmark.each(_moved, range(len(folds))), strict=True))
    for label, own in groupby(moved, key=lambda outcome: outcome[0].label):
        yield from _figures(f"reliability, {label}, people not seen", _summed([worths for _, worths in own]))
    if moved:
        yield from _figures("reliability, other laboratories, people not seen", _summed([worths for _, worths in moved]))


def _figures(row: str, worths: Worths) -> Iterator[Figure]:
    """The share right of each band, log score beside the best constant, and how many labels can be given at 99.9 % right."""
    for method, worth in worths.items():
        score, name = worth.scores.score(), f"{row}, {method}"
        if not score.labels:
            continue
        for band, (_, _, asked) in BANDS.items():
            count, right = worth.bands[band].tolist()
            if count:
                yield Figure(f"{name}: right {band}", asked, right / count, "fraction", count)
        # where no label is wrong, no confidence can beat the constant 1
        asked, gained = ("< 0" if score.constant_log_score > 0 else "none"), score.log_score - score.constant_log_score
        yield Figure(f"{name}: log score", "none", score.log_score, "nats", score.labels)
        yield Figure(f"{name}: log score less that of the best constant", asked, gained, "nats", score.labels)
        yield Figure(f"{name}: labels that can be given at 99.9 % right", "none", score.share_at_999, "fraction", score.labels)


def _summed(parts: list[Worths]) -> Worths:
    total: dict[str, Worth] = defaultdict(Worth)
    for part in parts:
        for method, worth in part.items():
            total[method] += worth
    return total


def _left_out(benchmark: BenchmarkRun, subject: str) -> Worths:
    """One subject under all conditions, by a model of all others."""
    worths: dict[str, Worth] = defaultdict(Worth)
    ensemble = unseen_model(benchmark, subject)
    for condition in CONDITIONS[: 1 if benchmark.quick else None]:
        for one in samples(benchmark, subject, condition, seeds=1):
            worths[FRAMES].add(ensemble.label_frames(one.clouds), one.truth, subject)
            worths[WHOLE].add(label_whole(ensemble, one.clouds, one.truth), one.truth, subject)
            worths[STREAM].add(pushed(ensemble, one.clouds, 10)[0], one.truth, subject)
    return dict(worths)


def _few(benchmark: BenchmarkRun, item: tuple[int, int]) -> Worths:
    """A model of so many of the subjects reported on, beginning with the one of this number, on the two before them."""
    count, first = item
    subjects, worths = reporting(), defaultdict[str, Worth](Worth)
    taught = [subjects[(first + i) % len(subjects)] for i in range(count)]
    trials = [(person, trial) for person in taught for trial in gait()[person]]
    ensemble = benchmark.fit([trial for _, trial in trials], [person for person, _ in trials])
    for number in (1, 2):
        subject = subjects[(first - number) % len(subjects)]
        for condition in CONDITIONS[:3]:
            for one in samples(benchmark, subject, condition, seeds=1):
                worths[FRAMES].add(ensemble.label_frames(one.clouds), one.truth, subject)
                worths[WHOLE].add(label_whole(ensemble, one.clouds, one.truth), one.truth, subject)
    return dict(worths)


def _folds(quick: bool) -> list[Fold]:
    """The sets of movement that show several people, split by person."""
    return [fold for fold in movement_folds(("clinical-lower",) if quick else tuple(PEOPLE)) if fold.unseen]


def _moved(benchmark: BenchmarkRun, number: int) -> Worths:
    """The trials of one fold with three markers hidden."""
    fold, worths = _folds(benchmark.quick)[number], defaultdict[str, Worth](Worth)
    try:
        ensemble = benchmark.fit(fold.train, fold.train_people)
    except AsterismError as problem:
        benchmark.report(f"{fold.label}, {fold.person}: nothing learned, so no label is given: {problem}")
        return {}
    for place, test in enumerate(fold.test):
        spare = max(0, len(test.frames) - LONGEST) // 2
        trial = test.recording.frames(test.frames[spare : spare + LONGEST])
        clouds, truth = simulate_gaps_and_ghosts(trial, 3, 0, seed=place)
        worths[WHOLE].add(label_whole(ensemble, clouds, truth), truth, fold.person)
        single, own = simulate_gaps_and_ghosts(evenly(trial, FRAMES_OF_TRIAL), 3, 0, seed=place)
        worths[FRAMES].add(ensemble.label_frames(single), own, fold.person)
    return dict(worths)
