"""What features of motion add to the pool of single frames (thesis 6.1, 6.2): the same training and clouds, with and without them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from asterism.labelling import FullSolver
from asterism.labelling.partial.features import TEMPORAL, THESIS, kinds_of
from asterism.labelling.partial.matrix import PartialSolvers, label_by_matrix
from asterism.labelling.partial.solver import FullSolverRules, stack_frames
from asterism.labelling.partial.solver_search import FEATURES, SearchSettings, search_partial_solvers
from asterism.recording import Clouds, Labelling, Recording
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import gait
from benchmarks.figures import Figure
from benchmarks.recordings.walks import CONDITIONS, unseen_training, walks, with_gaps
from benchmarks.score import Tally

NEIGHBOURS, DERIVATIVES = TEMPORAL[3:], TEMPORAL[:3]

POOLS = {
    "single frames": FEATURES,
    "+ derivatives": FEATURES + DERIVATIVES,
    "+ neighbouring frames": FEATURES + NEIGHBOURS,
    "+ both": FEATURES + TEMPORAL,
}
"""What partial solvers may look at."""

ABLATION = {"single frames": "partial solvers", "+ both": "+ time features"}
"""The pools that have a line among those of the row `ablation`, which labels the same clouds of more subjects."""

SUBJECTS = slice(2, None, 8)
"""Two of the eleven subjects, each left out in turn: a miner takes minutes for each pool."""

SETTINGS = SearchSettings(screening_frames=200, evaluation_frames=1000, validation_frames=4000, beam_width=100, max_solvers=80)
"""A third of the usual search, for every pool alike."""

WIDEN = 1.5
WRONG = 10**6


@dataclass
class Outcome:
    """Of one pool: labels by rules and condition, feature evaluations, and what was mined."""

    tallies: dict[str, Tally] = field(default_factory=lambda: defaultdict(Tally))
    evaluations: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    solvers: int = 0
    weak: int = 0
    markers: int = 0
    of_motion: int = 0
    hit_rates: list[float] = field(default_factory=list)
    accuracies: list[float] = field(default_factory=list)

    def __iadd__(self, other: Outcome) -> Outcome:
        for key, tally in other.tallies.items():
            self.tallies[key] += tally
            self.evaluations[key] += other.evaluations[key]
        for name in ("solvers", "weak", "markers", "of_motion", "hit_rates", "accuracies"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        return self


def features(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Right, FA and evaluations of the partial solvers under both rules, and how sure a full solver is, by pool."""
    subjects = list(gait())[SUBJECTS][: 1 if benchmark.quick else None]
    pools = ("single frames", "+ both") if benchmark.quick else tuple(POOLS)
    outcomes: dict[str, Outcome] = defaultdict(Outcome)
    for pool, outcome in benchmark.each(_left_out, [(subject, pool) for pool in pools for subject in subjects]):
        outcomes[pool] += outcome
    for pool, outcome in outcomes.items():
        for case, tally in outcome.tallies.items():
            row = f"features, {pool}, {case}"
            yield tally.figure(f"{row}: right", "none", tally.right_share)
            yield tally.figure(f"{row}: FA", "none", tally.false_assignments)
            yield Figure(f"{row}: evaluations", "none", outcome.evaluations[case] / tally.frames, "per frame", tally.frames)
        for condition in CONDITIONS if pool in ABLATION else ():
            tally = outcome.tallies[f"partial-solvers, {condition}"]
            yield tally.figure(f"ablation, {ABLATION[pool]}, {condition}: right", "none", tally.right_share)
            yield tally.figure(f"ablation, {ABLATION[pool]}, {condition}: FA", "none", tally.false_assignments)
        row, n = f"feature pool {pool}, partial solvers", outcome.solvers
        yield Figure(f"{row}: markers of a solver", "none", outcome.markers / n, "markers", n)
        yield Figure(f"{row}: weak classifiers of a solver", "none", outcome.weak / n, "classifiers", n)
        yield Figure(f"{row}: of them of motion", "none", outcome.of_motion / outcome.weak, "fraction", outcome.weak)
        yield Figure(f"{row}: hit rate in training", "none", float(np.mean(outcome.hit_rates)), "fraction", len(outcome.hit_rates))
        wrong = len(outcome.accuracies) * _wrong(benchmark)
        row = f"feature pool {pool}, full solver: accuracy over wrong labellings"
        yield Figure(row, "none", float(np.mean(outcome.accuracies)), "fraction", wrong)


def _left_out(benchmark: BenchmarkRun, item: tuple[str, str]) -> tuple[str, Outcome]:
    subject, pool = item
    people, train = unseen_training(benchmark, subject)
    outcome = Outcome()
    solvers = _mined(people, train, pool)
    outcome.solvers, outcome.weak, outcome.markers = len(solvers), len(solvers.solvers.kinds), len(solvers.solvers.markers)
    outcome.of_motion = int(np.isin(solvers.solvers.kinds, kinds_of(TEMPORAL)).sum())
    outcome.hit_rates = solvers.hit_rates[np.isfinite(solvers.hit_rates)].tolist()
    names = train[0].labels
    for condition, (hidden, ghosts) in CONDITIONS.items():
        for clouds, truth in with_gaps(benchmark, subject, hidden, ghosts, seeds=1):
            for rules in ("thesis", "partial-solvers"):
                labelling, made = _labelled(clouds, solvers, rules, names)
                outcome.tallies[f"{rules}, {condition}"].add(labelling, truth)
                outcome.evaluations[f"{rules}, {condition}"] += made
    own = tuple(name for name in POOLS[pool] if name in TEMPORAL)
    full = FullSolver.fit(train, rules=FullSolverRules(features=THESIS + own), subjects=people, seed=0)
    outcome.accuracies.append(full.accuracy(walks(subject), wrong=_wrong(benchmark), seed=0))
    for clouds, truth in with_gaps(benchmark, subject, 0, 0, seeds=1):
        outcome.tallies["full solver, none hidden"].add(full.label(clouds), truth)
        outcome.evaluations["full solver, none hidden"] += round(full.evaluations_in_all * len(clouds))
    told = "; ".join(f"{case} {tally.right_share:.4f} {tally.false_assignments:.5f}" for case, tally in outcome.tallies.items())
    benchmark.report(f"{subject} left out, {pool}: {told}")
    return pool, outcome


def _wrong(benchmark: BenchmarkRun) -> int:
    return 10**4 if benchmark.quick else WRONG


def _mined(people: list[str], train: list[Recording], pool: str) -> PartialSolvers:
    moving = any(name in TEMPORAL for name in POOLS[pool])
    frames, groups = stack_frames(train, people, motion=moving)
    usable = (~np.isnan(frames[:, :, 0])).sum(axis=1) >= 0.5 * frames.shape[1]
    return search_partial_solvers(
        frames[usable], groups[usable], targets=0.999, features=POOLS[pool], settings=replace(SETTINGS, widen=WIDEN), seed=0
    )


def _labelled(clouds: Clouds, solvers: PartialSolvers, rules: str, names: tuple[str, ...]) -> tuple[Labelling, int]:
    votes = label_by_matrix(clouds, solvers, rules="completed" if rules == "partial-solvers" else "printed")
    return Labelling(votes.indices, votes.votes, names), int(votes.evaluations.sum())
