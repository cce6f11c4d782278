"""Partial solvers: their hit rates against the truth, the 2nd property, the three miners."""

from __future__ import annotations

from collections import Counter
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from test_weak import bodies

from asterism import AsterismError
from asterism.labelling.partial._search_kernels import search
from asterism.labelling.partial.matrix import label_by_matrix
from asterism.labelling.partial.solver import pack_solvers, stack_frames
from asterism.labelling.partial.solver_search import (
    MINERS,
    SearchSettings,
    SolverSearch,
    bottom_up,
    random_occlusions,
    search_partial_solvers,
)
from asterism.labelling.simulated_occlusions import simulate_occlusions
from asterism.simulation import simulate_walks

WALKS = simulate_walks(subjects=3, frames=120, seed=2)
FRAMES, GROUPS = stack_frames(WALKS)
QUICK = SearchSettings(screening_frames=100, evaluation_frames=400, validation_frames=600, beam_width=40, max_markers=6, max_solvers=40)
QUICKEST = SearchSettings(screening_frames=60, evaluation_frames=200, validation_frames=200, beam_width=10, max_markers=5, max_solvers=15)


@pytest.fixture(scope="module")
def prepared():
    return SolverSearch(FRAMES, GROUPS, settings=QUICK, seed=0)


@cache
def mined(miner):
    return search_partial_solvers(FRAMES, GROUPS, targets=0.99, miner=miner, settings=QUICK, seed=0)


@pytest.fixture(scope="module", params=MINERS)
def found(request):
    return request.param, mined(request.param)


def test_first_property_no_hit_rate_outside(prepared):
    evaluated = prepared.evaluate((0, 1, 2, 5))
    assert np.array_equal(np.isnan(evaluated.hit_rates), ~np.isin(np.arange(15), (0, 1, 2, 5)))


def test_hit_rates_equal_a_plain_count(prepared):
    """The same exposures, searched one by one and compared with the truth in plain Python."""
    subset = (0, 1, 3, 9)
    solver = prepared.build_solver(subset)
    arrays, hits, wrong = pack_solvers([solver]), Counter(), Counter()
    for frame, hidden in zip(prepared.chosen_frames[:300], prepared.hidden[:300], strict=True):
        there = np.nonzero(~hidden)[0]
        points, found = prepared.frames[frame][there], np.empty((33, 4), dtype=np.int64)
        solutions = search(arrays, 0, points, np.arange(len(there)), 10**7, found, np.zeros(2, dtype=np.int64))
        for depth, marker in enumerate(solver.markers.tolist()):
            proposed = set(found[: max(solutions, 0), depth].tolist())
            if len(proposed) == 1 and solutions <= 32:
                (hits if there[proposed.pop()] == marker else wrong)[marker] += 1
    assert wrong.total() > 0, "a solver of four markers errs when one of them is hidden"
    rates = prepared.evaluate_on(solver, 300).hit_rates
    for marker in subset:
        assert rates[marker] == pytest.approx(hits[marker] / max(hits[marker] + wrong[marker], 1))


def test_second_property_hit_rates_grow_with_size(prepared):
    """4.5.2: adding markers does not lower a hit rate, up to what 400 exposures can tell (three standard errors)."""
    rng = np.random.default_rng(0)
    falls = []
    for _ in range(12):
        order = rng.permutation(15)
        rates = [prepared.evaluate_on(prepared.build_solver(tuple(sorted(order[:size].tolist()))), 400).hit_rates for size in (3, 5, 7, 9)]
        falls += [small[m] - big[m] for small, big in pairwise(rates) for m in np.nonzero(~np.isnan(small))[0]]
    falls = np.array(falls)
    assert falls.mean() < 0, "on average hit rates rise"
    assert (falls > 0.08).mean() < 0.05, f"{(falls > 0.08).mean():.1%} of the hit rates fell by more than chance"


def test_miner_covers_the_markers(found):
    name, ensemble = found
    assert ensemble.covered.all(), f"{name}: {np.nonzero(~ensemble.covered)[0]}"
    assert len(ensemble) <= QUICK.max_solvers
    rates = ensemble.hit_rates
    assert ((rates >= 0.99).sum(axis=1) >= 1).all(), "each solver reaches the target in one marker at least"
    owner = np.repeat(np.arange(len(ensemble)), np.diff(ensemble.solvers.first_depth))
    assert (rates[owner, ensemble.solvers.markers][ensemble.trusted] >= 0.99).all()


def test_ensemble_found_labels_through_occlusions(found):
    name, ensemble = found
    clouds, truth = simulate_occlusions(WALKS[1], 2, 0, seed=1)
    indices = label_by_matrix(clouds, ensemble).indices
    given = indices >= 0
    right = (indices == truth) & given
    assert right.sum() / given.sum() > 0.99, f"{name}: {right.sum() / given.sum():.4f} of the labels are right"
    assert right.sum() / (truth >= 0).sum() > 0.6, f"{name}: {right.sum() / (truth >= 0).sum():.3f} of the markers in sight are labelled"


def test_completion_adds_labels():
    ensemble = mined("bottom-up")
    clouds, truth = simulate_occlusions(WALKS[1], 3, 0, seed=1)
    plain, completed = label_by_matrix(clouds, ensemble, complete=False).indices, label_by_matrix(clouds, ensemble).indices
    assert (completed[plain >= 0] == plain[plain >= 0]).mean() > 0.9
    added = (completed >= 0) & (plain < 0)
    assert added.sum() > 0
    assert (completed == truth)[added].mean() > 0.95


def test_same_seed_same_solvers_and_another_seed_others():
    one, two, three = (search_partial_solvers(FRAMES, GROUPS, targets=0.98, settings=QUICKEST, seed=seed) for seed in (5, 5, 6))
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(one.to_arrays().values(), two.to_arrays().values(), strict=True))
    assert len(one.solvers.low) != len(three.solvers.low) or not np.array_equal(one.solvers.low, three.solvers.low)


def test_bottom_up_does_not_grow_what_has_reached_its_target():
    easy = SolverSearch(FRAMES, GROUPS, targets=0.5, settings=QUICKEST, seed=0)
    hard = SolverSearch(FRAMES, GROUPS, targets=0.9999, settings=QUICKEST, seed=0)
    sizes = [np.mean([len(a.solver.markers) for a in bottom_up(prepared, lambda fraction, doing: None)]) for prepared in (easy, hard)]
    assert sizes[0] < sizes[1]


def test_a_marker_that_none_reaches_is_flagged():
    """Two markers that swap places at random cannot be reported apart, whatever the solver."""
    frames, groups = bodies(people=2, frames=100)
    flip = np.random.default_rng(0).random(len(frames)) < 0.5
    frames[flip, 5], frames[flip, 6] = frames[flip, 6].copy(), frames[flip, 5].copy()
    ensemble = search_partial_solvers(frames, groups, targets=0.99, settings=QUICK)
    assert not ensemble.covered[[5, 6]].any()
    assert ensemble.covered[:5].any()


def test_targets_per_marker():
    targets = np.full(15, 0.95)
    targets[0] = 1.0
    ensemble = search_partial_solvers(FRAMES, GROUPS, targets=targets, settings=QUICK)
    own = ensemble.solvers.markers == 0
    owner = np.repeat(np.arange(len(ensemble)), np.diff(ensemble.solvers.first_depth))
    assert (ensemble.hit_rates[owner[own & ensemble.trusted], 0] == 1.0).all() or not ensemble.covered[0]


def test_hide_hides_each_number_as_often():
    hidden = random_occlusions(600, 15, 5, np.random.default_rng(0))
    assert np.array_equal(np.bincount(hidden.sum(axis=1)), np.full(6, 100))


def test_progress_rises_to_one():
    reported = []
    search_partial_solvers(
        FRAMES,
        GROUPS,
        settings=SearchSettings(60, 60, 100, 100, 3, 10, 5, 10),
        progress=lambda fraction, doing: reported.append((fraction, doing)),
    )
    fractions = [fraction for fraction, _ in reported]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert all(doing for _, doing in reported)


@pytest.mark.parametrize(
    ("changes", "words"), [({"miner": "oracle"}, "oracle"), ({"targets": 0.0}, "target"), ({"features": ["g0"]}, "g0")]
)
def test_bad_arguments_are_named(changes, words):
    with pytest.raises(AsterismError, match=words):
        search_partial_solvers(FRAMES, GROUPS, **changes)
    with pytest.raises(AsterismError, match="three"):
        search_partial_solvers(FRAMES[:, :2], GROUPS)
