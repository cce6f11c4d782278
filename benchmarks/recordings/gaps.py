"""Walks of people that training has not seen, markers gone in gaps, ghosts and clutter: the whole recording labelled at once."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from asterism.recording import Ints, Labelling
from asterism.simulation import Clutter
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import GAIT_BODY, file_of, gait
from benchmarks.figures import Figure
from benchmarks.recordings.walks import (
    HELEN_HAYES,
    Condition,
    Markers,
    Sample,
    full_body_subjects,
    label_whole,
    reporting,
    samples,
    unnumbered,
    unseen_model,
)
from benchmarks.score import Tally

WHOLE, BARE = "whole recording", "without numbers"

GAPS = {"1 hidden": Condition(1), "3 hidden": Condition(3), "5 hidden": Condition(5), "3 hidden + 3 ghosts": Condition(3, 3)}
FLICKER = {
    "3 flickering, 80 mm, 0 hidden": Condition(0, clutter=Clutter(3.0, 1, "beside", 0.08)),
    "3 flickering, 80 mm, 3 hidden": Condition(3, clutter=Clutter(3.0, 1, "beside", 0.08)),
    "3 flickering, 30 mm, 3 hidden": Condition(3, clutter=Clutter(3.0, 1, "beside", 0.03)),
    "3 there for 3 frames, 30 mm, 3 hidden": Condition(3, clutter=Clutter(3.0, 3, "beside", 0.03)),
}
ASKED = {
    "gaps, 1 hidden": (">= 0.9999", "<= 0.00005"),
    "gaps, 3 hidden": (">= 0.9998", "<= 0.0002"),
    "gaps, 5 hidden": (">= 0.9995", "<= 0.0003"),
    "gaps, 3 hidden + 3 ghosts": (">= 0.995", "<= 0.001"),
    "59 markers, 3 hidden": (">= 0.999", "<= 0.0005"),
    "clutter, 3 flickering, 80 mm, 0 hidden": (">= 0.998", "<= 0.0005"),
    "clutter, 3 flickering, 80 mm, 3 hidden": (">= 0.995", "<= 0.001"),
    "clutter, 3 flickering, 30 mm, 3 hidden": (">= 0.995", "<= 0.001"),
    "clutter, 3 there for 3 frames, 30 mm, 3 hidden": (">= 0.995", "<= 0.001"),
}
"""Right and wrong, as the issues ask."""

Tallies = dict[tuple[str, str], Tally]
"""By condition and method."""
Counted = tuple[str, Labelling, Ints]
"""A method's name, its labelling, and the truth about it."""


def gaps(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Each subject left out in turn: 15 markers in gaps, and ghosts."""
    yield from _measured(benchmark, _Task("gaps", GAPS, _whole), list(gait()))


def full_body(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """All physical markers of the gait subjects, two of them left out in turn."""
    conditions = {name: GAPS[name] for name in ("3 hidden", "3 hidden + 3 ghosts")}
    yield from _measured(benchmark, _Task(f"{len(GAIT_BODY)} markers", conditions, _whole, GAIT_BODY, 1), full_body_subjects())


def flicker(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Points beside markers for one frame or three, with and without track numbers."""
    yield from _measured(benchmark, _Task("clutter", FLICKER, _bare_too), reporting())


def summed(outcomes: Iterable[Tallies]) -> Tallies:
    """The tallies of all subjects together, in the order of the first that has them."""
    total: Tallies = defaultdict(Tally)
    for outcome in outcomes:
        for key, tally in outcome.items():
            total[key] += tally
    return dict(total)


@dataclass(frozen=True)
class _Task:
    """How the rows begin, the conditions, what labels a subject's samples, its markers, and how often each walk is hidden anew."""

    start: str
    conditions: Mapping[str, Condition]
    labels: Callable[[BenchmarkRun, str, Markers], Callable[[Sample], Iterator[Counted]]]
    markers: Markers = HELEN_HAYES
    seeds: int = 2


def _measured(benchmark: BenchmarkRun, task: _Task, subjects: Sequence[str]) -> Iterator[Figure]:
    subjects = subjects[: 1 if benchmark.quick else None]
    for (condition, method), tally in summed(benchmark.each(partial(_left_out, task=task), subjects)).items():
        row = f"{task.start}, {condition}"
        right, wrong = ASKED.get(row, ("none", "none"))
        yield tally.figure(f"{row}, {method}: right", right, tally.right_share)
        yield tally.figure(f"{row}, {method}: wrong", wrong, tally.false_assignments)
        yield tally.figure(f"{row}, {method}: missed", "none", tally.missed_share)


def _left_out(benchmark: BenchmarkRun, subject: str, task: _Task) -> Tallies:
    tallies: Tallies = defaultdict(Tally)
    labels = task.labels(benchmark, subject, task.markers)
    for name, condition in task.conditions.items():
        for one in samples(benchmark, subject, condition, task.markers, task.seeds):
            for method, labelling, truth in labels(one):
                tallies[name, method].add(labelling, truth, recording=str(file_of(one.walk)))
    told = (f"{name}, {method} {t.right_share:.5f}, wrong {t.false_assignments:.5f}" for (name, method), t in tallies.items())
    benchmark.report(f"{subject} left out: {'; '.join(told)}")
    return dict(tallies)


def _whole(benchmark: BenchmarkRun, subject: str, markers: Markers) -> Callable[[Sample], Iterator[Counted]]:
    model = unseen_model(benchmark, subject, markers)
    return lambda one: iter([(WHOLE, label_whole(model, one.clouds, one.truth), one.truth)])


def _bare_too(benchmark: BenchmarkRun, subject: str, markers: Markers) -> Callable[[Sample], Iterator[Counted]]:
    model = unseen_model(benchmark, subject, markers)
    ways = ((WHOLE, lambda clouds: clouds), (BARE, unnumbered))
    return lambda one: ((way, label_whole(model, change(one.clouds), one.truth), one.truth) for way, change in ways)
