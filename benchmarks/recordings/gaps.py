"""Walks of people that training has not seen, markers gone in gaps, ghosts riding along: the whole recording labelled at once."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import gait
from benchmarks.figures import Figure
from benchmarks.recordings.walks import CONDITIONS, unseen_ensemble, walk_of_draw, with_gaps
from benchmarks.score import Tally

WHOLE = "whole recording"
ASKED = {
    ("1 hidden", "right"): ">= 0.9999",
    ("3 hidden", "right"): ">= 0.9998",
    ("5 hidden", "right"): ">= 0.9995",
    ("3 hidden + 3 ghosts", "right"): ">= 0.995",
    ("1 hidden", "wrong"): "<= 0.00005",
    ("3 hidden", "wrong"): "<= 0.0002",
    ("5 hidden", "wrong"): "<= 0.0003",
    ("3 hidden + 3 ghosts", "wrong"): "<= 0.001",
}

Tallies = dict[tuple[str, str], Tally]
"""By condition and method."""


def gaps(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Each subject left out in turn: right, wrong and missed by condition, and the calibration error of all labels."""
    subjects = list(gait())[: 1 if benchmark.quick else None]
    outcomes = dict(zip(subjects, benchmark.each(_left_out, subjects), strict=True))
    total = summed(outcomes.values())
    for (condition, method), tally in total.items():
        yield from rates(condition, method, tally, asked=True)
    pooled = Tally()
    for tally in total.values():
        pooled += tally
    row = f"calibration error, people not seen, {WHOLE}"
    yield Figure(row, "<= 0.005", pooled.calibration_error, "fraction", pooled.given)


def rates(condition: str, method: str, tally: Tally, asked: bool) -> Iterator[Figure]:
    """Right, wrong and missed of one condition and method."""
    for rate, measured in (("right", tally.right_share), ("wrong", tally.false_assignments), ("missed", tally.missed_share)):
        bound = ASKED.get((condition, rate), "none") if asked else "none"
        yield tally.figure(f"gaps, {condition}, {method}: {rate}", bound, measured)


def summed(outcomes: Iterable[Tallies]) -> Tallies:
    """The tallies of all subjects together, in the order of the first that has them."""
    total: Tallies = defaultdict(Tally)
    for outcome in outcomes:
        for key, tally in outcome.items():
            total[key] += tally
    return dict(total)


def _left_out(benchmark: BenchmarkRun, subject: str) -> Tallies:
    ensemble, tallies = unseen_ensemble(benchmark, subject), defaultdict(Tally)
    for condition, (hidden, ghosts) in CONDITIONS.items():
        for draw, (clouds, truth) in enumerate(with_gaps(benchmark, subject, hidden, ghosts)):
            tallies[condition, WHOLE].add(ensemble.label(clouds), truth, recording=walk_of_draw(benchmark, subject, draw))
    told = (f"{c} {tallies[c, WHOLE].right_share:.5f}, wrong {tallies[c, WHOLE].false_assignments:.5f}" for c in CONDITIONS)
    benchmark.report(f"{subject} left out: {'; '.join(told)}")
    return dict(tallies)
