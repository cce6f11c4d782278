"""What a confidence of 0.99 is worth: frames, whole recordings and streams, of people whom training has not seen, by how many taught it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from itertools import groupby

from asterism.errors import AsterismError
from asterism.labelling import ConfidenceTally
from asterism.recording import Clouds, Ints, Labelling
from asterism.simulation import Clutter, simulate_gaps_and_ghosts
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import CHOOSING, CHOOSING_SETS, PEOPLE, Fold, evenly, gait, movement_folds
from benchmarks.dirt.walks import Condition, ensemble_of, label_whole, reporting, samples
from benchmarks.figures import Figure
from benchmarks.recordings.stream import pushed

Tallies = Mapping[str, ConfidenceTally]

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
LONGEST, FRAMES_OF_TRIAL = 600, 200
"""Frames of a movement recording that are labelled, from its middle as a whole, and evenly spread as single frames."""


def reliability(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Gait subjects left out, by those chosen on and those reported on; models of few of them; movement sets by person."""
    subjects = reporting()[:2] if benchmark.quick else list(gait())
    found = list(zip(subjects, benchmark.each(_left_out, subjects), strict=True))
    for chosen in (False, True):
        some = [tallies for subject, tallies in found if (subject in CHOOSING) == chosen]
        if some:
            yield from _figures(f"reliability, gait, {'subjects chosen on, ' if chosen else ''}ten taught", _summed(some), asked=not chosen)
    items = [(count, i) for count in FEW[: 1 if benchmark.quick else None] for i in range(1 if benchmark.quick else len(reporting()))]
    few = zip(items, benchmark.each(_few, items), strict=True)
    for count, group in groupby(few, key=lambda outcome: outcome[0][0]):
        yield from _figures(f"reliability, gait, {count} taught", _summed([tallies for _, tallies in group]), asked=True)
    folds = _folds(benchmark.quick)
    outcomes = zip(folds, benchmark.each(_moved, range(len(folds))), strict=True)
    for label, own in groupby(outcomes, key=lambda outcome: outcome[0].label):
        row, chosen = f"reliability, {label}, people not seen", label.startswith(CHOOSING_SETS)
        total = _summed([tallies for _, tallies in own])
        yield from _figures(f"{row}{', chosen on' if chosen else ''}", total, asked=not chosen)


def _figures(row: str, tallies: Tallies, asked: bool) -> Iterator[Figure]:
    """Reliability at 0.99, log score beside the best constant, and how many labels can be given at 99.9 % right."""
    for method, tally in tallies.items():
        score = tally.score()
        if not score.labels:
            continue
        level, name = score.at(0.99), f"{row}, {method}"
        if level is not None:
            outside = max(level.low - level.confidence, level.confidence - level.high, 0.0)
            yield Figure(f"{name}: stated at 0.99 to 0.999", "none", level.confidence, "fraction", level.labels)
            yield Figure(f"{name}: right at 0.99 to 0.999", ">= 0.98" if asked else "none", level.right, "fraction", level.labels)
            yield Figure(
                f"{name}: stated at 0.99, outside its 95 % interval by", "<= 0" if asked else "none", outside, "fraction", level.labels
            )
        # where no label is wrong, no confidence can beat the constant 1
        beatable = asked and score.constant_log_score > 0
        gained = score.log_score - score.constant_log_score
        yield Figure(f"{name}: log score", "none", score.log_score, "nats", score.labels)
        yield Figure(f"{name}: log score less that of the best constant", "< 0" if beatable else "none", gained, "nats", score.labels)
        yield Figure(f"{name}: Brier score less that of the best constant", "none", score.brier - score.constant_brier, "1", score.labels)
        yield Figure(f"{name}: labels that can be given at 99.9 % right", "none", score.share_at_999, "fraction", score.labels)


def _summed(parts: list[Tallies]) -> Tallies:
    total: dict[str, ConfidenceTally] = defaultdict(ConfidenceTally)
    for part in parts:
        for method, tally in part.items():
            total[method] += tally
    return total


def _add(tallies: dict[str, ConfidenceTally], method: str, labelling: Labelling, truth: Ints, group: str) -> None:
    given = labelling.indices >= 0
    tallies[method].add(labelling.confidence, given, given & (labelling.indices == truth), group)


def _left_out(benchmark: BenchmarkRun, subject: str) -> Tallies:
    """One subject under all conditions, by a model of all others."""
    tallies: dict[str, ConfidenceTally] = defaultdict(ConfidenceTally)
    ensemble = ensemble_of(benchmark, subject)
    for condition in CONDITIONS[: 1 if benchmark.quick else None]:
        for one in samples(subject, condition, 1):
            _add(tallies, FRAMES, ensemble.label(one.clouds), one.truth, subject)
            _add(tallies, WHOLE, label_whole(ensemble, one.clouds, one.truth), one.truth, subject)
            _add(tallies, STREAM, pushed(ensemble, one.clouds, 10)[0], one.truth, subject)
    benchmark.report(f"{subject} left out: {_told(tallies)}")
    return dict(tallies)


def _few(benchmark: BenchmarkRun, item: tuple[int, int]) -> Tallies:
    """A model of so many of the subjects reported on, beginning with the one of this number, on the two before them."""
    count, first = item
    subjects, tallies = reporting(), defaultdict[str, ConfidenceTally](ConfidenceTally)
    taught = [subjects[(first + i) % len(subjects)] for i in range(count)]
    trials = [(person, trial) for person in taught for trial in gait()[person]]
    ensemble = benchmark.fit([trial for _, trial in trials], [person for person, _ in trials])
    for number in (1, 2):
        subject = subjects[(first - number) % len(subjects)]
        for condition in CONDITIONS[:3]:
            for one in samples(subject, condition, 1):
                _add(tallies, FRAMES, ensemble.label(one.clouds), one.truth, subject)
                _add(tallies, WHOLE, label_whole(ensemble, one.clouds, one.truth), one.truth, subject)
    benchmark.report(f"{', '.join(taught)} taught: {_told(tallies)}")
    return dict(tallies)


def _folds(quick: bool) -> list[Fold]:
    """The sets of movement that show several people, split by person."""
    return [fold for fold in movement_folds(("clinical-lower",) if quick else tuple(PEOPLE)) if fold.unseen]


def _moved(benchmark: BenchmarkRun, number: int) -> Tallies:
    """The trials of one fold with three markers hidden."""
    fold, tallies = _folds(benchmark.quick)[number], defaultdict[str, ConfidenceTally](ConfidenceTally)
    try:
        ensemble = benchmark.fit(fold.train, fold.train_people)
    except AsterismError as problem:
        benchmark.report(f"{fold.label}, {fold.person}: nothing learned, so no label is given: {problem}")
        return {}
    for place, test in enumerate(fold.test):
        spare = max(0, len(test.frames) - LONGEST) // 2
        trial = test.recording.frames(test.frames[spare : spare + LONGEST])
        whole: tuple[Clouds, Ints] = simulate_gaps_and_ghosts(trial, 3, 0, seed=place)
        _add(tallies, WHOLE, label_whole(ensemble, *whole), whole[1], fold.person)
        single, truth = simulate_gaps_and_ghosts(evenly(trial, FRAMES_OF_TRIAL), 3, 0, seed=place)
        _add(tallies, FRAMES, ensemble.label(single), truth, fold.person)
    benchmark.report(f"{fold.label}, {fold.person}: {_told(tallies)}")
    return dict(tallies)


def _told(tallies: Tallies) -> str:
    scores = {method: tally.score() for method, tally in tallies.items()}
    return "; ".join(f"{method} log score {s.log_score:.4f} ({s.constant_log_score:.4f})" for method, s in scores.items())
