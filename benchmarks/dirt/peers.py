"""The peers in the same clutter: tracking from a hand-labelled first frame, key poses, and the thesis' rules, both frame by frame."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from asterism.labelling.partial.matrix import label_by_matrix
from asterism.labelling.partial.solver import stack_frames
from asterism.labelling.partial.solver_search import search_partial_solvers
from asterism.recording import Labelling
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import spread
from benchmarks.dirt.accuracy import FLICKER, RIDING, VOLUME, rates
from benchmarks.dirt.walks import reporting, samples
from benchmarks.figures import Figure
from benchmarks.peer import KeyPoses
from benchmarks.recordings.baselines import POSES, POSES_FRAMES, TRACKING
from benchmarks.recordings.features import SETTINGS, WIDEN
from benchmarks.recordings.gaps import Tallies, summed
from benchmarks.recordings.walks import unseen_training
from benchmarks.score import Tally, some_frames
from benchmarks.tracking import follow

THESIS = "thesis"
CONDITIONS = {**FLICKER, **VOLUME, **RIDING}


def peers(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Right and wrong of each peer by condition; the thesis' rules on one subject, since a search of partial solvers takes minutes."""
    subjects = reporting()[: 1 if benchmark.quick else None]
    for (condition, method), tally in summed(list(benchmark.each(_left_out, subjects))).items():
        yield from rates(f"clutter, peers, {condition}, {method}", tally)
    if not benchmark.quick:
        for condition, tally in _by_thesis(benchmark, subjects[0]).items():
            yield from rates(f"clutter, peers, {condition}, {THESIS}", tally)


def _left_out(benchmark: BenchmarkRun, subject: str) -> Tallies:
    tallies: Tallies = defaultdict(Tally)
    poses = KeyPoses.fit(unseen_training(benchmark, subject)[1])
    for name, condition in CONDITIONS.items():
        for one in samples(subject, condition, 1):
            tallies[name, TRACKING].add(follow(one.walk.positions[0], one.clouds, poses.names), one.truth)
            few, few_truth = some_frames(one.clouds, one.truth, spread(len(one.truth), POSES_FRAMES))
            tallies[name, POSES].add(poses.label(few), few_truth)
    return dict(tallies)


def _by_thesis(benchmark: BenchmarkRun, subject: str) -> dict[str, Tally]:
    """The labelling matrix of partial solvers from a third of the usual search, as the row `features` uses them."""
    people, train = unseen_training(benchmark, subject)
    frames, groups = stack_frames(train, people)
    usable = (~np.isnan(frames[:, :, 0])).sum(axis=1) >= 0.5 * frames.shape[1]
    solvers = search_partial_solvers(frames[usable], groups[usable], targets=0.999, settings=replace(SETTINGS, widen=WIDEN), seed=0)
    tallies: dict[str, Tally] = defaultdict(Tally)
    for name, condition in CONDITIONS.items():
        for one in samples(subject, condition, 1):
            votes = label_by_matrix(one.clouds, solvers, complete=False)
            tallies[name].add(Labelling(votes.indices, votes.votes, train[0].labels), one.truth)
    return tallies
