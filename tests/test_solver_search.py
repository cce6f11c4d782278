"""Partial solvers: their hit rates against the truth, the 2nd property, the three miners."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import twins
from test_weak import bodies

from asterism import AsterismError
from asterism.labelling.features.registry import FEATURES as REGISTRY
from asterism.labelling.features.registry import THESIS
from asterism.labelling.features.search_kernels import search
from asterism.labelling.partial._choice_kernels import count_labels
from asterism.labelling.partial.ensemble_choice import choose_ensemble
from asterism.labelling.partial.matrix import label_by_matrix
from asterism.labelling.partial.matrix_choice import Matrix, choose_solvers
from asterism.labelling.partial.search_strategies import MINERS, bottom_up, evolve, genetic, genetic_all, search_partial_solvers, top_down
from asterism.labelling.partial.solver import Solver, pack_solvers, stack_frames
from asterism.labelling.partial.solver_search import PRINTED, EvaluatedSolver, SearchSettings, SolverSearch, random_occlusions
from asterism.labelling.partial.weak import WeakClassifiers
from asterism.labelling.simulated_occlusions import simulate_occlusions
from asterism.simulation import simulate_walks

pytestmark = pytest.mark.kernels

NO_CLASSIFIERS = WeakClassifiers(np.empty(0, dtype=np.int64), np.empty((0, 4), dtype=np.int64), np.empty(0), np.empty(0))
WALKS = simulate_walks(subjects=3, frames=120, seed=2)
FRAMES, GROUPS = stack_frames(WALKS)
QUICK = SearchSettings(screening_frames=80, evaluation_frames=300, validation_frames=400, beam_width=40, max_markers=6, max_solvers=30)
QUICKEST = SearchSettings(screening_frames=60, evaluation_frames=200, validation_frames=200, beam_width=10, max_markers=5, max_solvers=15)


@pytest.fixture(scope="module")
def prepared():
    return SolverSearch(FRAMES, GROUPS, settings=QUICK, seed=0)


@cache
def mined(miner):
    return search_partial_solvers(FRAMES, GROUPS, targets=0.99, miner=miner, settings=QUICK, seed=0)


@pytest.fixture(scope="module", params=[pytest.param(name, marks=[] if name == "genetic" else pytest.mark.slow) for name in MINERS])
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
    # the fitness of section 4.5.3 knows nothing of coverage, so the survivors of the genetic search may leave a marker out
    covered = ensemble.covered
    assert covered.sum() >= 15 - 3 * (name == "genetic"), f"{name}: {np.nonzero(~covered)[0]}"
    assert len(ensemble) <= QUICK.max_solvers + QUICK.substitutes * (~covered).sum()
    rates = ensemble.hit_rates
    reaches = (rates >= 0.99).any(axis=1)
    assert reaches.sum() >= len(ensemble) - QUICK.substitutes * (~covered).sum(), "each solver reaches the target in one marker at least"
    owner = np.repeat(np.arange(len(ensemble)), np.diff(ensemble.solvers.first_depth))
    trusted = ensemble.trusted & covered[ensemble.solvers.markers]
    assert (rates[owner, ensemble.solvers.markers][trusted] >= 0.99).all()


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
    plain, completed = (label_by_matrix(clouds, ensemble, rules=rules).indices for rules in ("agreed", "completed"))
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
    for marker in (5, 6):
        votes = ensemble.trusted & (ensemble.solvers.markers == marker)
        owner = np.repeat(np.arange(len(ensemble)), np.diff(ensemble.solvers.first_depth))[votes]
        assert len(owner) == QUICK.substitutes, "the best known solvers vote for it instead"
        assert (ensemble.hit_rates[owner, marker] > 0).all()


def test_targets_per_marker():
    targets = np.full(15, 0.95)
    targets[0] = 1.0
    ensemble = search_partial_solvers(FRAMES, GROUPS, targets=targets, settings=QUICK)
    own = ensemble.solvers.markers == 0
    owner = np.repeat(np.arange(len(ensemble)), np.diff(ensemble.solvers.first_depth))
    assert (ensemble.hit_rates[owner[own & ensemble.trusted], 0] == 1.0).all() or not ensemble.covered[0]


class KnownRates:
    """A search whose hit rates are known: 1 for subsets that hold markers 0, 1 and 2, else lower, the fewer of these they hold."""

    def __init__(self, n_markers=6, **settings):
        self.n_markers, self.targets = n_markers, np.full(n_markers, 0.99)
        self.settings, self.rng = replace(QUICK, **settings), np.random.default_rng(0)
        self.evaluated = {}

    def evaluate(self, markers):
        subset = tuple(sorted(markers))
        rate = 0.7 + 0.1 * len({0, 1, 2} & set(subset))
        own = np.isin(np.arange(self.n_markers), subset)
        solver = Solver(np.array(subset), NO_CLASSIFIERS, np.zeros(len(subset) + 1, dtype=np.int64))
        self.evaluated[subset] = EvaluatedSolver(solver, np.where(own, rate, np.nan), np.where(own, 100, 0), own * 1.0)
        return self.evaluated[subset]

    reaches_target, reaches_goal, _reaches = SolverSearch.reaches_target, SolverSearch.reaches_goal, SolverSearch._reaches


def subsets_of(found):
    return {tuple(evaluated.solver.markers.tolist()) for evaluated in found}


def nothing(fraction, doing):
    """No progress."""


def test_top_down_keeps_a_solver_none_of_whose_children_reaches_the_target():
    """Algorithm 4.2: (0, 1, 2) is the smallest that reaches the target, and all its children fail."""
    found = subsets_of(top_down(KnownRates(), nothing))
    assert (0, 1, 2) in found
    assert all({0, 1, 2} <= set(subset) for subset in found)


GENES = {"n_markers": 9, "generations": 10, "beam_width": 12, "max_markers": 9}


def test_evolution_lets_the_least_fit_die_out():
    """Fitness is the hit rate: the initial population reaches 0.7 to 1, and after ten generations all that live reach the target."""
    search = KnownRates(**GENES)
    population = evolve(search, nothing)
    rate = {subset: np.nanmax(evaluated.hit_rates) for subset, evaluated in search.evaluated.items()}
    assert min(rate.values()) < 0.9, "unfit ones were born"
    assert min(rate[subset] for subset in population) == 1.0
    assert 6 <= len(population) <= 24, "at most twice the initial population lives on"


def test_the_genetic_miner_returns_survivors_and_genetic_all_whatever_reached_the_target():
    last, all_of_them = subsets_of(genetic(KnownRates(**GENES), nothing)), subsets_of(genetic_all(KnownRates(**GENES), nothing))
    assert last == evolve(KnownRates(**GENES), nothing)
    assert np.mean([*map(len, last)]) < np.mean([*map(len, all_of_them)]), "among equals the smaller wins"
    assert last < all_of_them, "some reached the target and died out: larger ones, which lose among equals"
    assert all({0, 1, 2} <= set(subset) for subset in all_of_them)


def test_second_property_is_exact_on_whole_frames_of_the_training():
    """With the intervals of eq. 4.4 the right labelling is always found there. Only another one beside it can cost a marker its point, and
    with more markers there are never more labellings: what a solver names, a larger one names too, without any tolerance."""
    search = SolverSearch(FRAMES, GROUPS, features=THESIS, settings=replace(PRINTED, max_hidden=0, validation_frames=400), seed=0)
    rng = np.random.default_rng(0)
    lowest = 1.0
    for _ in range(6):
        order = rng.permutation(15)
        rates = [search.evaluate_on(search.build_solver(tuple(sorted(order[:size].tolist()))), 200).response_rates for size in (3, 4, 5, 6)]
        for small, big in pairwise(rates):
            named = small > 0.2  # hopeless ones end early
            assert (big[named] >= small[named]).all()
            lowest = min([lowest, *small[named]])
    assert lowest < 0.9, "small solvers find several labellings"


def points_of(*markers):
    """The bits of some markers' points."""
    return sum(1 << marker for marker in markers)


def labels_counted(cells, hidden=None):
    """Of each frame (K, M): markers in sight without a label, labels, right labels."""
    cells = np.asarray(cells, dtype=np.uint16).T
    hidden = np.zeros(cells.shape, dtype=np.bool_) if hidden is None else hidden.T
    counts = np.empty((cells.shape[1], 4), dtype=np.int64)
    count_labels(cells, np.empty(0, dtype=np.int64), cells[:0], hidden, np.arange(cells.shape[1]), counts)
    assert (counts[:, 0] == 1).all()
    return counts[:, 1:].tolist()


def test_the_matrix_gives_labels_by_the_safe_rules():
    """Three markers: two that agree with the truth; one of two minds; two that claim one point; one that is wrong alone."""
    cells = [
        [points_of(0), points_of(1), 0],
        [points_of(0, 2), points_of(1), 0],
        [points_of(1), points_of(1), points_of(2)],
        [points_of(2), points_of(1), 0],
    ]
    assert labels_counted(cells) == [[1, 2, 2], [2, 1, 1], [2, 1, 1], [1, 2, 1]]
    hidden = np.array([[False, False, True]] * 4)
    assert labels_counted(cells, hidden) == [[0, 2, 2], [1, 1, 1], [2, 1, 1], [0, 2, 1]], "a hidden marker is not missed"


@pytest.mark.parametrize("seed", range(6))
def test_counted_labels_agree_with_their_twin(seed):
    rng = np.random.default_rng(seed)
    handed_in = [[{m: set(rng.permutation(4)[: rng.integers(0, 3)].tolist()) for m in range(4)} for _ in range(3)] for _ in range(40)]
    cells, last = (
        np.array([[points_of(*set().union(*(one[m] for one in some))) for m in range(4)] for some in frames], dtype=np.uint64).T
        for frames in ([frame[:2] for frame in handed_in], [frame[2:] for frame in handed_in])
    )
    hidden = rng.random((40, 4)) < 0.3
    markers, counts = rng.permutation(4), np.empty((5, 4), dtype=np.int64)
    count_labels(cells, markers, last[markers], hidden.T, hidden.sum(axis=1), counts)
    expected = np.zeros((5, 4), dtype=np.int64)
    for frame, away in zip(handed_in, hidden, strict=True):
        labels = np.array(twins.matrix(frame, 4))
        given = labels >= 0
        expected[away.sum()] += [1, (~given & ~away).sum(), given.sum(), (labels == np.arange(4)).sum()]
    assert counts.tolist() == expected.tolist()


def test_the_cost_is_the_weighted_mean_of_both_rates_over_the_numbers_of_hidden_markers():
    hidden = np.array([[True, False, False], [True, False, False], [True, True, False], [False, False, False]])
    matrix = Matrix(hidden.T, 5.0)
    cells = np.array([[0, points_of(1), 0], [points_of(1), 0, points_of(2)], [0, 0, points_of(2)], [0, 0, 0]], dtype=np.uint64)
    missed = 2 / (2 + 2)  # with one hidden, two visible ones beside the two that are hidden; with two hidden none
    wrong = 1 / 3  # with one hidden, of three labels; with two hidden none
    assert matrix.cost(np.arange(3), cells.T) == pytest.approx(missed / (1 + 1 / 4) + 5.0 * wrong / 2), "missed ones weigh 1 / h^2"
    assert Matrix(np.zeros((3, 4), dtype=np.bool_), 1.0).cost() == 0.0, "nothing is hidden"


def test_the_choice_takes_what_lowers_the_cost_and_leaves_what_nulls_others():
    hidden = np.tile([[True, False, False]], (10, 1))
    matrix, markers = Matrix(hidden.T, 10.0), np.array([1, 2])
    right = np.tile(np.array([[points_of(1)], [points_of(2)]], dtype=np.uint16), (1, 10))
    half, doubtful = right.copy(), right.copy()
    half[:, 5:], doubtful[0, ::2] = 0, points_of(1, 2)
    three = [half, doubtful, right]
    assert choose_solvers(matrix.emptied(), [markers] * 3, three, 3) == [2], "nothing is left to gain"
    assert choose_solvers(matrix.emptied(), [markers] * 3, three, 3, without=[2]) == [0], "the other one takes as many labels as it gives"
    assert matrix.cost(markers, right) == 0.0
    matrix.cells[markers] |= right
    assert matrix.cost(markers, doubtful) > 0.3, "as printed, one solver of two minds takes the labels away"


def test_the_choice_hands_in_only_what_is_confirmed():
    """The better solver is not confirmed for its second marker, and then adds nothing to the other one's first."""
    hidden = np.tile([[True, False, False]], (10, 1))
    matrix, markers = Matrix(hidden.T, 10.0), [np.array([1, 2]), np.array([1])]
    both = np.tile(np.array([[points_of(1)], [points_of(2)]], dtype=np.uint16), (1, 10))
    points = [both, both[:1].copy()]
    confirmed = {0: np.array([False, True]), 1: np.array([True])}
    assert choose_solvers(matrix, markers, points, 3, confirm=confirmed.__getitem__) == [0, 1]
    assert matrix.cost() == 0.0
    assert not both[0].any(), "what is not confirmed is not handed in"


def test_minimal_solvers_reject_what_larger_ones_do_with_fewer_classifiers():
    settings = [replace(QUICK, minimal=minimal) for minimal in (False, True)]
    searches = [SolverSearch(FRAMES, GROUPS, features=THESIS, settings=one, seed=0) for one in settings]
    whole, minimal = (each.build_solver(tuple(range(8))).weak for each in searches)
    assert len(minimal) < len(whole)
    pairs = [feature.points == 2 and not feature.moving for feature in REGISTRY]
    assert np.array(pairs)[minimal.kinds].sum() == 2 * 28, "distance and height of each pair, which solvers share"


def test_a_solver_is_trusted_only_with_markers_that_the_choice_knew_of():
    """Few frames decide which solvers are candidates, more confirm them: a marker that reaches the target only then was never weighed."""
    settings = replace(PRINTED, evaluation_frames=100, validation_frames=2000, beam_width=20, coverage_patterns=600, large_subsets=5)
    search = SolverSearch(FRAMES, GROUPS, targets=0.98, features=THESIS, settings=settings, seed=0)
    ensemble = choose_ensemble(search, bottom_up(search, nothing), nothing)
    found_later = 0
    for begin, end in pairwise(ensemble.solvers.first_depth):
        markers = ensemble.solvers.markers[begin:end]
        reached = search.reaches_target(search.evaluated[tuple(sorted(markers.tolist()))])
        assert (reached[markers] >= ensemble.trusted[begin:end]).all()
        found_later += int((search.reaches_target(search.evaluate(markers.tolist(), validate=True)) & ~reached).sum())
    assert found_later, "some markers reach the target only on the validation frames"


def test_targets_decide_how_many_frames_validate():
    """Three over one minus the target, the rule of three, and never more than the settings allow."""
    counts = {
        (target, most): SolverSearch(FRAMES, GROUPS, targets=target, settings=replace(QUICKEST, validation_frames=most)).validation_frames
        for target, most in ((0.99, 300_000), (0.9999, 300_000), (0.9999, 5_000), (1.0, 40_000))
    }
    assert list(counts.values()) == [12_000, 30_000, 5_000, 40_000]


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
