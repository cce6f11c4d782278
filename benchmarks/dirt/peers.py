"""The peers in the same clutter: tracking from a hand-labelled first frame, key poses, and the thesis' rules, both frame by frame."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from asterism.labelling.partial.matrix import PartialSolvers, label_by_matrix
from asterism.labelling.partial.solver import stack_frames
from asterism.labelling.partial.solver_search import PRINTED, PRINTED_FEATURES, search_partial_solvers
from asterism.recording import Labelling, Recording
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import spread
from benchmarks.dirt.accuracy import FLICKER, RIDING, VOLUME, rates
from benchmarks.dirt.walks import ensemble_of, label_whole, reporting, samples
from benchmarks.figures import Figure
from benchmarks.peer import KeyPoses
from benchmarks.recordings.baselines import POSES, POSES_FRAMES, TRACKING
from benchmarks.recordings.features import SETTINGS
from benchmarks.recordings.gaps import WHOLE, Tallies, summed
from benchmarks.recordings.walks import unseen_training
from benchmarks.score import Tally, some_frames
from benchmarks.tracking import follow

THESIS = "thesis"
CONDITIONS = {**FLICKER, **VOLUME, **RIDING}


def peers(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Right and wrong of each peer and ours by condition, and the condition in which ours has the smallest lead over the best of them."""
    subjects = reporting()[: 1 if benchmark.quick else None]
    total = summed(list(benchmark.each(_left_out, subjects)))
    for (condition, method), tally in total.items():
        yield from rates(f"clutter, peers, {condition}, {method}", tally)
    leads = {}
    for condition in CONDITIONS:
        others = [tally.right_share for (name, method), tally in total.items() if name == condition and method != WHOLE]
        leads[condition] = total[condition, WHOLE].right_share - max(others)
    row = "clutter, lead of the whole recording over the best peer: right, worst condition"
    yield Figure(row, ">= 0", min(leads.values()), "fraction", len(leads))


def _left_out(benchmark: BenchmarkRun, subject: str) -> Tallies:
    tallies: Tallies = defaultdict(Tally)
    people, train = unseen_training(benchmark, subject)
    ensemble, poses = ensemble_of(benchmark, subject), KeyPoses.fit(train)
    solvers = None if benchmark.quick else _searched(people, train)
    for name, condition in CONDITIONS.items():
        for one in samples(subject, condition, 1):
            tallies[name, WHOLE].add(label_whole(ensemble, one.clouds, one.truth), one.truth)
            tallies[name, TRACKING].add(follow(one.walk.positions[0], one.clouds, poses.names), one.truth)
            few, few_truth = some_frames(one.clouds, one.truth, spread(len(one.truth), POSES_FRAMES))
            tallies[name, POSES].add(poses.label(few), few_truth)
            if solvers:
                votes = label_by_matrix(one.clouds, solvers, rules="printed")
                tallies[name, THESIS].add(Labelling(votes.indices, votes.votes, train[0].labels), one.truth)
    return dict(tallies)


def _searched(people: list[str], train: list[Recording]) -> PartialSolvers:
    """The thesis' partial solvers from a third of the usual search, as in the row `features`: it takes a minute for each subject."""
    frames, groups = stack_frames(train, people)
    usable = (~np.isnan(frames[:, :, 0])).sum(axis=1) >= 0.5 * frames.shape[1]
    third = {name: getattr(SETTINGS, name) for name in ("screening_frames", "evaluation_frames", "beam_width", "max_solvers")}
    printed = replace(PRINTED, validation_frames=SETTINGS.validation_frames, **third)
    return search_partial_solvers(frames[usable], groups[usable], targets=0.999, features=PRINTED_FEATURES, settings=printed, seed=0)
