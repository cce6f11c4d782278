"""Walks of people that training has not seen, markers gone in gaps, ghosts riding along: the whole recording labelled at once."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from asterism.labelling.simulated_occlusions import simulate_gaps, simulate_gaps_and_ghosts
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import gait
from benchmarks.figures import Figure
from benchmarks.recordings.walks import CONDITIONS, SEEDS, standing, unseen_ensemble, walk_of_draw, walks, with_gaps
from benchmarks.score import Tally, some_frames

WHOLE, FRAMEWISE = "whole recording", "frame by frame"
FEW = "5 gaps in the whole trial"
STANDING = "standing, 3 hidden"
VARIANTS = ("no track numbers", "backwards in time")
ASKED = {
    ("1 hidden", "right"): ">= 0.9999",
    ("3 hidden", "right"): ">= 0.9998",
    ("5 hidden", "right"): ">= 0.9995",
    ("3 hidden + 3 ghosts", "right"): ">= 0.995",
    ("1 hidden", "FA"): "<= 0.00005",
    ("3 hidden", "FA"): "<= 0.0002",
    ("5 hidden", "FA"): "<= 0.0003",
    ("3 hidden + 3 ghosts", "FA"): "<= 0.001",
    (FEW, "right"): ">= 0.9999",
    (STANDING, "right"): ">= 0.999",
}

Tallies = dict[tuple[str, str], Tally]
"""By condition and method."""


def gaps(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Leave one subject out over all of them: right, FA and missed by condition, what is lost without track numbers and backwards, ECE."""
    subjects = list(gait())[: 1 if benchmark.quick else None]
    outcomes = dict(zip(subjects, benchmark.each(_left_out, subjects), strict=True))
    total = summed(outcomes.values())
    for (condition, method), tally in total.items():
        yield from rates(condition, method, tally, asked=method == WHOLE)
    for condition in CONDITIONS:
        plain = total[condition, WHOLE]
        for variant in VARIANTS:
            other = total[f"{condition}, {variant}", WHOLE]
            row = f"change, {condition}, {variant}"
            yield other.figure(f"{row}: right lost", "<= 0.001", plain.right_share - other.right_share)
            yield other.figure(f"{row}: FA gained", "<= 0.001", other.false_assignments - plain.false_assignments)
    for method, bound in ((WHOLE, "<= 0.005"), (FRAMEWISE, "none")):
        pooled = Tally()
        for condition in CONDITIONS:
            pooled += total[condition, method]
        yield Figure(f"calibration error, subjects not seen, {method}", bound, pooled.calibration_error, "fraction", pooled.given)
    for subject, outcome in outcomes.items():
        for condition in (*CONDITIONS, STANDING):
            tally = outcome.get((condition, WHOLE))
            if tally:
                yield tally.figure(f"subject {subject} not seen, {condition}: right", "none", tally.right_share)
                yield tally.figure(f"subject {subject} not seen, {condition}: FA", "none", tally.false_assignments)


def rates(condition: str, method: str, tally: Tally, asked: bool) -> Iterator[Figure]:
    """Right, FA and missed of one condition and method."""
    for rate, measured in (("right", tally.right_share), ("FA", tally.false_assignments), ("missed", tally.missed_share)):
        bound = ASKED.get((condition, rate), "none") if asked else "none"
        yield tally.figure(f"gaps, {condition}, {method}: {rate}", bound, measured)


def summed(outcomes: Iterator[Tallies] | list[Tallies]) -> Tallies:
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
            walk = walk_of_draw(benchmark, subject, draw)
            tallies[condition, WHOLE].add(ensemble.label(clouds), truth, recording=walk)
            tallies[condition, FRAMEWISE].add(ensemble.label_frames(clouds), truth, recording=walk)
            bare = replace(clouds, tracks=None)
            tallies[f"{condition}, {VARIANTS[0]}", WHOLE].add(ensemble.label(bare), truth, recording=walk)
            reverse, reverse_truth = some_frames(clouds, truth, np.arange(len(truth))[::-1])
            tallies[f"{condition}, {VARIANTS[1]}", WHOLE].add(ensemble.label(reverse), reverse_truth, recording=walk)
    still = standing(subject)
    for seed in range(1 if benchmark.quick else SEEDS):
        for number, recording in enumerate(walks(subject)):
            clouds, truth = simulate_gaps(recording, 5, seed=SEEDS * number + seed)
            walk = f"{subject}, walk {number}"
            tallies[FEW, WHOLE].add(ensemble.label(clouds), truth, recording=walk)
            tallies[FEW, FRAMEWISE].add(ensemble.label_frames(clouds), truth, recording=walk)
        if still:
            clouds, truth = simulate_gaps_and_ghosts(still, 3, 0, seed=seed)
            tallies[STANDING, WHOLE].add(ensemble.label(clouds), truth, recording=f"{subject}, standing")
            tallies[STANDING, FRAMEWISE].add(ensemble.label_frames(clouds), truth, recording=f"{subject}, standing")
    told = (f"{c} {tallies[c, WHOLE].right_share:.5f}, FA {tallies[c, WHOLE].false_assignments:.5f}" for c in CONDITIONS)
    benchmark.report(f"{subject} left out: {'; '.join(told)}")
    return dict(tallies)
