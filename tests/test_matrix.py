"""The labelling matrix and its safe rules, against a plain twin."""

from __future__ import annotations

import numpy as np
import pytest
import twins
from test_weak import bodies

from asterism import AsterismError, Clouds, Recording
from asterism.labelling.partial._search_kernels import search
from asterism.labelling.partial.matrix import PartialSolvers, label_by_matrix, no_classifiers
from asterism.labelling.partial.solver import pack_solvers
from asterism.labelling.partial.solver_search import SearchSettings, SolverSearch
from asterism.labelling.simulated_occlusions import simulate_occlusions

FRAMES, GROUPS = bodies(people=3, frames=40)
NAMES = tuple("ABCDEFG")
SUBSETS = [(0, 1, 2), (1, 2, 3, 4), (2, 4, 5, 6), (0, 3, 5), (0, 1, 2, 3, 4, 5, 6), (3, 4, 6)]


@pytest.fixture(scope="module")
def ensemble():
    search_ = SolverSearch(FRAMES, GROUPS, settings=SearchSettings(screening_frames=50, evaluation_frames=200, validation_frames=200))
    solvers = [search_.build_solver(subset) for subset in SUBSETS]
    trusted = np.concatenate([solver.markers != 3 for solver in solvers])
    rates = np.array([np.where(np.isin(np.arange(7), subset), 1.0, np.nan) for subset in SUBSETS])
    return PartialSolvers(pack_solvers(solvers), rates, np.full(7, 0.99), np.ones(7, dtype=bool), trusted, no_classifiers())


def slow(ensemble, points):
    """Search by search, through the twin of the matrix."""
    proposals = []
    for s in range(len(ensemble)):
        begin, end = ensemble.solvers.first_depth[s : s + 2]
        found = np.empty((5000, end - begin), dtype=np.int64)
        solutions = search(ensemble.solvers, s, points, np.arange(len(points)), 10**7, found, np.zeros(2, dtype=np.int64))
        proposal = {}
        for depth in range(end - begin):
            candidates = set(found[: max(solutions, 0), depth].tolist())
            if len(candidates) == 1 and ensemble.trusted[begin + depth] and solutions <= 32:
                proposal[int(ensemble.solvers.markers[begin + depth])] = candidates.pop()
        proposals.append(proposal)
    return twins.matrix(proposals, 7), proposals


@pytest.mark.parametrize("hidden", [0, 1, 3])
def test_labels_and_votes_equal_the_twin(ensemble, hidden):
    clouds, _ = simulate_occlusions(Recording(FRAMES[::4], NAMES, 100.0), hidden, 2, seed=hidden)
    votes = label_by_matrix(clouds, ensemble, budget=10**7)
    able = [sum(ensemble.trusted[ensemble.solvers.markers == m]) for m in range(7)]
    for t, points in enumerate(clouds):
        expected, proposals = slow(ensemble, points)
        assert votes.indices[t].tolist() == expected
        for m in range(7):
            for_it = [proposal[m] for proposal in proposals if m in proposal]
            most = max((for_it.count(c) for c in for_it), default=0)
            assert votes.votes[t, m] == pytest.approx(most / able[m] if able[m] else 0.0)
    assert (votes.indices[:, 3] == -1).all(), "no solver is trusted with it"


def test_twin_of_the_matrix_follows_the_safe_rules():
    assert twins.matrix([{0: 5, 1: 6}, {0: 5}], 3) == [5, 6, -1]
    assert twins.matrix([{0: 5}, {0: 6}], 1) == [-1]
    assert twins.matrix([{0: 5, 1: 6}, {2: 5}], 3) == [-1, 6, -1]


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
