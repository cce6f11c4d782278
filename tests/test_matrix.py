"""The labelling matrix and its safe rules, against a plain twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import twins
from test_weak import bodies

from asterism import AsterismError, Clouds, Recording
from asterism.labelling.features.search_kernels import search
from asterism.labelling.partial.matrix import PartialSolvers, label_by_matrix, no_classifiers
from asterism.labelling.partial.solver import pack_solvers
from asterism.labelling.partial.solver_search import SearchSettings, SolverSearch
from asterism.labelling.simulated_occlusions import simulate_occlusions

pytestmark = pytest.mark.kernels

FRAMES, GROUPS = bodies(people=3, frames=40)
NAMES = tuple("ABCDEFG")
SUBSETS = [(0, 1, 2), (1, 2, 3, 4), (2, 4, 5, 6), (0, 3, 5), (0, 1, 2, 3, 4, 5, 6), (3, 4, 6)]


@pytest.fixture(scope="module")
def ensemble():
    search_ = SolverSearch(FRAMES, GROUPS, settings=SearchSettings(screening_frames=50, evaluation_frames=200, validation_frames=200))
    solvers = [search_.build_solver(subset) for subset in SUBSETS]
    trusted = np.concatenate([solver.markers != 3 for solver in solvers])
    rates = np.array([np.where(np.isin(np.arange(7), subset), 1.0, np.nan) for subset in SUBSETS])
    trials = np.where(np.isnan(rates), 0, 200)
    return PartialSolvers(pack_solvers(solvers), rates, trials, np.full(7, 0.99), np.ones(7, dtype=bool), trusted, no_classifiers())


def slow(ensemble, points, rules):
    """Search by search, through the twin of the matrix: all candidates of a solver, or those on which its labellings agree."""
    proposals = []
    for s in range(len(ensemble)):
        begin, end = ensemble.solvers.first_depth[s : s + 2]
        found = np.empty((5000, end - begin), dtype=np.int64)
        solutions = search(ensemble.solvers, s, points, np.arange(len(points)), 10**7, found, np.zeros(2, dtype=np.int64))
        proposal = {}
        for depth in range(end - begin):
            candidates = set(found[: max(solutions, 0), depth].tolist())
            if (len(candidates) == 1 or rules == "printed") and ensemble.trusted[begin + depth] and solutions <= 32:
                proposal[int(ensemble.solvers.markers[begin + depth])] = candidates
        proposals.append(proposal)
    return twins.matrix(proposals, 7), proposals


@pytest.mark.parametrize("rules", ["printed", "agreed"])
@pytest.mark.parametrize("hidden", [0, 1, 3])
def test_labels_and_votes_equal_the_twin(ensemble, hidden, rules):
    clouds, _ = simulate_occlusions(Recording(FRAMES[::4], NAMES, 100.0), hidden, 2, seed=hidden)
    votes = label_by_matrix(clouds, ensemble, budget=10**7, rules=rules)
    able = [sum(ensemble.trusted[ensemble.solvers.markers == m]) for m in range(7)]
    for t, points in enumerate(clouds):
        expected, proposals = slow(ensemble, points, rules)
        assert votes.indices[t].tolist() == expected
        for m in range(7):
            for_it = [candidate for proposal in proposals for candidate in proposal.get(m, ())]
            most = max((for_it.count(c) for c in for_it), default=0)
            assert votes.votes[t, m] == pytest.approx(most / able[m] if able[m] else 0.0)
    assert (votes.indices[:, 3] == -1).all(), "no solver is trusted with it"


def test_twin_of_the_matrix_follows_the_safe_rules():
    assert twins.matrix([{0: {5}, 1: {6}}, {0: {5}}], 3) == [5, 6, -1]
    assert twins.matrix([{0: {5}}, {0: {6}}], 1) == [-1]
    assert twins.matrix([{0: {5}, 1: {6}}, {2: {5}}], 3) == [-1, 6, -1]
    assert twins.matrix([{0: {5, 6}}, {0: {5}}, {1: {6}}], 2) == [-1, -1], (
        "a solver of two minds nulls its marker, and who claims its points"
    )


def test_printed_and_agreed_differ_only_where_a_solver_finds_several_labellings(ensemble):
    """As printed, a solver hands in all its labellings, which can only null labels."""
    clouds, _ = simulate_occlusions(Recording(FRAMES[::2], NAMES, 100.0), 0, 12, seed=5)
    printed, agreed = (label_by_matrix(clouds, ensemble, budget=10**7, rules=rules).indices for rules in ("printed", "agreed"))
    assert (printed != agreed).any()
    assert ((printed == agreed) | (printed < 0)).all()
    with pytest.raises(AsterismError, match="completed"):
        label_by_matrix(clouds, ensemble, rules="whole-body")


def test_a_solver_without_budget_says_nothing(ensemble):
    clouds, _ = simulate_occlusions(Recording(FRAMES[:3], NAMES, 100.0), 0, 0)
    votes = label_by_matrix(clouds, ensemble, budget=0)
    assert (votes.indices == -1).all()


def test_500_points_come_back_within_the_budget(ensemble):
    points = np.random.default_rng(0).uniform(-1, 1, size=(500, 3))
    votes = label_by_matrix(Clouds.from_points([points, FRAMES[0]], 100.0), ensemble, budget=20_000)
    assert votes.evaluations[0] < len(ensemble) * 25_000
    assert (votes.indices[1] >= 0).any()


@pytest.mark.parametrize("points", [np.empty((0, 3)), np.zeros((1, 3)), np.zeros((7, 3))])
def test_strange_clouds_get_no_labels(ensemble, points):
    assert (label_by_matrix(Clouds.from_points([points], 100.0), ensemble).indices == -1).all()


def test_no_frames(ensemble):
    assert label_by_matrix(Clouds.from_points([], 100.0), ensemble).indices.shape == (0, 7)


def test_arrays_there_and_back(ensemble):
    again = PartialSolvers.from_arrays(ensemble.to_arrays())
    clouds, _ = simulate_occlusions(Recording(FRAMES[::10], NAMES, 100.0), 1, 1)
    assert np.array_equal(label_by_matrix(clouds, ensemble).indices, label_by_matrix(clouds, again).indices)


def test_what_trials_have_shown(ensemble):
    """The rule of three: n trials without a miss show about 1 - 3 / n; without trials nothing is shown."""
    shown = ensemble.shown_hit_rates
    assert shown[3] == 0.0, "no solver is trusted with it"
    assert np.delete(shown, 3) == pytest.approx(1.0 - 3.0 / 200.0, abs=2e-4)
    missed = replace(ensemble, hit_rates=np.where(np.isnan(ensemble.hit_rates), np.nan, 0.99))
    assert (np.delete(missed.shown_hit_rates, 3) < 0.985).all()
    summary = ensemble.summary(NAMES)
    assert summary["uncovered"] == []
    assert summary["shown_hit_rates"]["D"] == 0.0
    assert replace(ensemble, covered=np.arange(7) != 3).summary(NAMES)["uncovered"] == ["D"]
    assert (replace(ensemble, trials=np.zeros_like(ensemble.trials)).shown_hit_rates == 0.0).all()


@pytest.mark.parametrize(
    "name", ["solver_markers", "solver_slots", "solver_first_depth", "solver_first_feature", "trusted", "solver_kinds"]
)
def test_damaged_arrays_are_refused(ensemble, name):
    arrays = ensemble.to_arrays()
    with pytest.raises(AsterismError, match="train"):
        PartialSolvers.from_arrays({key: value for key, value in arrays.items() if key != name})
    with pytest.raises(AsterismError, match="train"):
        PartialSolvers.from_arrays({**arrays, name: arrays[name][:-1]})
    if name != "trusted":
        with pytest.raises(AsterismError, match="train"):
            PartialSolvers.from_arrays({**arrays, name: arrays[name] + 1000})
