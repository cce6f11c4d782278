"""Ten tuned numbers at half, once and twice their value: what becomes of labels of people that training has not seen."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from typing import Any

import asterism
from asterism.labelling.body.labeller import FrameLabellingSettings
from asterism.labelling.body.model import BodyRules
from asterism.labelling.whole.scene import RecordingLabellingSettings
from asterism.tracking import LinkRules
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import file_of, gait
from benchmarks.figures import Figure
from benchmarks.recordings.walks import with_gaps
from benchmarks.score import Tally

NUMBERS: tuple[tuple[type, str], ...] = (
    (FrameLabellingSettings, "reward"),
    (FrameLabellingSettings, "first_ghost_cost"),
    (FrameLabellingSettings, "outlier_score"),
    (FrameLabellingSettings, "assign_margin"),
    (BodyRules, "placement_std"),
    (BodyRules, "size_std"),
    (RecordingLabellingSettings, "frame_correlation"),
    (RecordingLabellingSettings, "ghosts_cost"),
    (RecordingLabellingSettings, "max_rigid_deviation"),
    (LinkRules, "ratio_test"),
)
FACTORS = {"half": 0.5, "double": 2.0}
HIDDEN, GHOSTS = 3, 3
FOLDS = 1
"""Subjects who are left out, one after the other; the model learns from the straight walks of all others. One: there are 27 variants."""


def sensitivity(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Right and wrong labels with each number halved and doubled, in training and in labelling, and with all as they were chosen."""
    variants: list[tuple[str, type | None, str, float]] = [("all as chosen, once", None, "", 1.0)]
    for rules, field in NUMBERS[: 1 if benchmark.quick else None]:
        variants += [(f"{rules.__name__}.{field} ({getattr(rules(), field):g}), {name}", rules, field, f) for name, f in FACTORS.items()]
    for (row, *_), tally in zip(variants, benchmark.each(_tally, variants), strict=True):
        start = f"sensitivity, {row}"
        yield Figure(f"{start}: right", "none", tally.right_share, "fraction", tally.visible)
        yield Figure(f"{start}: FA", "none", tally.false_assignments, "fraction", tally.given)


@contextmanager
def multiplied(rules: type, field: str, factor: float) -> Iterator[None]:
    """A rules dataclass with another default for one field, for instances made meanwhile and for those that exist with the old one."""
    init: Any = rules.__init__
    names = [f.name for f in fields(rules)]
    place, before = names.index(field), init.__defaults__
    chosen = before[place - len(names) + len(before)]
    changed = type(chosen)(factor * chosen)
    instances = [thing for thing in gc.get_objects() if type(thing) is rules and getattr(thing, field) == chosen]
    init.__defaults__ = tuple(changed if n == place - len(names) + len(before) else value for n, value in enumerate(before))
    for instance in instances:
        object.__setattr__(instance, field, changed)
    try:
        yield
    finally:
        init.__defaults__ = before
        for instance in instances:
            object.__setattr__(instance, field, chosen)


def _tally(benchmark: BenchmarkRun, variant: tuple[str, type | None, str, float]) -> Tally:
    row, rules, field, factor = variant
    benchmark.report(row)
    if rules is None:
        return _label_unseen(benchmark)
    with multiplied(rules, field, factor):
        return _label_unseen(benchmark)


def _label_unseen(benchmark: BenchmarkRun) -> Tally:
    tally = Tally()
    for subject in list(gait())[:FOLDS]:
        straight = {name: trial for name, trials in gait().items() for trial in trials if file_of(trial).stem == "straight"}
        train = {name: trial for name, trial in straight.items() if name != subject}
        ensemble = asterism.MarkerModel.fit(list(train.values()), seed=0, subjects=list(train))
        for clouds, truth in with_gaps(benchmark, subject, HIDDEN, GHOSTS):
            tally.add(ensemble.label(clouds, time=True), truth)
    return tally
