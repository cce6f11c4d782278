"""Two subjects' walks in one volume, neither seen in training: one model given twice."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

import asterism
from asterism.labelling import SeveralBodies, join_labellings, label_together
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.recording import Ints, Labelling, Recording
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import gait, people_and_trials
from benchmarks.figures import Figure
from benchmarks.recordings.walks import walks
from benchmarks.score import Tally

CONDITIONS = {"": (0, 0), ", 3 hidden of each": (6, 0), ", 3 hidden of each + 6 ghosts": (6, 6)}
AWAY = ((1.0, 0.0, 0.0), (0.4, 0.3, 0.0))
"""Where the second one's middle is from the first one's, in metres."""


def bodies(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Every third subject with the next one, side by side and elbow to elbow; whether one model says that there are two; and one alone."""
    twice, said, false, alone = defaultdict(Tally), 0, 0, 0
    for pair in list(pairwise(gait("helen-hayes")))[:: 11 if benchmark.quick else 3]:
        ensemble = _unseen(benchmark, pair)
        for number, (first, second) in enumerate(zip(walks(pair[0]), walks(pair[1]), strict=False)):
            false, alone = false + _crowd(ensemble, first) + _crowd(ensemble, second), alone + 2
            for away in AWAY:
                both, together = beside(first, second, away), f"{pair}, walk {number}"
                for condition, (hidden, ghosts) in CONDITIONS.items():
                    clouds, truth = simulate_gaps_and_ghosts(both, hidden, ghosts, seed=number)
                    labellings = label_together([ensemble, ensemble], clouds)
                    orders = [_joined(labellings, ensemble), _joined(labellings[::-1], ensemble)]
                    twice[condition].add(max(orders, key=lambda labelling: _right(labelling, truth)), truth, recording=together)
                said += _crowd(ensemble, both)
    for condition, tally in twice.items():
        yield tally.figure(f"two people, one model twice{condition}: right", ">= 0.99", tally.right_share)
        yield tally.figure(f"two people, one model twice{condition}: wrong", "<= 0.01", tally.false_assignments)
    yield Figure("two people where one is expected: said", "none", said / (len(AWAY) * alone / 2), "fraction", len(AWAY) * alone // 2)
    yield Figure("one person where one is expected: taken for two", "none", false / alone, "fraction", alone)


def beside(first: Recording, second: Recording, away: tuple[float, float, float]) -> Recording:
    """Both in one volume, as long as the shorter one."""
    frames = min(len(first), len(second))
    one, two = first.positions[:frames], second.positions[:frames]
    between = np.nanmean(one, axis=(0, 1)) - np.nanmean(two, axis=(0, 1))
    between -= first.vertical * (between @ first.vertical)
    labels = tuple(f"{number}:{label}" for number in (1, 2) for label in first.labels)
    return replace(
        first,
        positions=np.concatenate([one, two + between + np.array(away)], axis=1),
        labels=labels,
        source=None,
        origin=None,
        taken=(),
    )


def _unseen(benchmark: BenchmarkRun, subjects: Sequence[str]) -> asterism.MarkerModel:
    """An ensemble that has seen neither of them."""
    others = {subject: trials for subject, trials in gait("helen-hayes").items() if subject not in subjects}
    people, train = people_and_trials(others)
    return benchmark.fit(train, people)


def _joined(labellings: Sequence[Labelling], ensemble: asterism.MarkerModel) -> Labelling:
    return join_labellings(labellings, [ensemble.marker_set] * 2)[0]


def _right(labelling: Labelling, truth: Ints) -> float:
    return float((labelling.indices == truth).mean())


def _crowd(ensemble: asterism.MarkerModel, recording: Recording) -> int:
    """1 where the ensemble says that a recording shows several bodies."""
    try:
        ensemble.label_one_body(recording.clouds())
    except SeveralBodies:
        return 1
    return 0
