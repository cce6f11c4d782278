"""The kernels of partial solvers that decide, against their plain twins: random cases, ties, NaN, coincident points and empty frames."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest
import twins_partial as twins
from test_search import MARKERS, solver_and_rules

from asterism.labelling.features.motion_kernels import WIDTH
from asterism.labelling.features.registry import FEATURES
from asterism.labelling.partial._build_kernels import choose_covering, order_tests
from asterism.labelling.partial._evaluation_kernels import (
    EvaluationLimits,
    ProposalCounts,
    ValidationFrames,
    evaluate_solver,
    handed_in_points,
)
from asterism.labelling.partial._full_solver_kernels import label_by_full_solver
from asterism.labelling.partial._matrix_kernels import (
    MatrixRules,
    StrongClassifierArrays,
    VoteArrays,
    _accept_single,
    _choose_by_votes,
    check_marker,
    complete_labels,
    count_confusions,
    label_by_matrix,
)
from asterism.labelling.partial._pair_search_kernels import load_frame, make_search_workspace, search_by_pairs
from asterism.labelling.partial.solver import Solver, factor_pair_rules, pack_solvers

pytestmark = pytest.mark.kernels

RULES = MatrixRules(outvote=2, slack=0.1, min_tests=3, rounds=3, budget=10**7, hand_in_all=False)
SEEDS = range(8)
SEEDS_OF_CASES = [*SEEDS[:4], *(pytest.param(seed, marks=pytest.mark.slow) for seed in SEEDS[4:])]


def body(seed, markers=5, width=WIDTH, frames=1):
    """(frames, markers, width) m one shape that moves a little; a tenth of the motions unknown."""
    rng = np.random.default_rng(seed)
    shape = np.random.default_rng(0).normal(scale=0.4, size=(markers, 3))
    out = np.empty((frames, markers, WIDTH))
    out[:, :, :9] = np.tile(shape, (1, 3)) + rng.normal(scale=0.02, size=(frames, markers, 9))
    out[:, :, 9:] = rng.normal(scale=0.2, size=(frames, markers, 6))
    out[rng.random((frames, markers)) < 0.1, 3:] = np.nan
    return np.ascontiguousarray(out[:, :, :width])


def strong_classifier(seed, markers=5, width=WIDTH, each=3):
    """Classifiers of all kinds over random markers, with intervals that most frames of `body` keep."""
    rng = np.random.default_rng(seed)
    sample, found = body(1000 + seed, markers, width, frames=60), []
    for kind, feature in enumerate(FEATURES):
        if feature.moving and width == 3:
            continue
        for _ in range(each):
            slots = rng.permutation(markers)[: feature.points]
            values = np.array([twins.value(kind, [points[m] for m in slots]) for points in sample])
            low, high = np.nanmin(values) - 1e-4, np.nanmax(values) + 1e-4
            found.append((kind, (*slots.tolist(), 0, 0)[:4], feature.points, low, high))
    rows = [[row for row in found if m in row[1][: row[2]]] for m in range(markers)]
    kinds, slots, points, low, high = zip(*(row for own in rows for row in own), strict=True)
    first = np.cumsum([0, *map(len, rows)]).astype(np.int64)
    return StrongClassifierArrays(first, np.array(kinds), np.array(slots), np.array(points), np.array(low), np.array(high))


def cloud(seed, markers=5, ghosts=2, width=WIDTH, hostile=""):
    """Points (n, width) of a body and ghosts, some of them near it, from the highest to the lowest; the truth is row to marker."""
    rng = np.random.default_rng(seed)
    points = body(seed, markers, width)[0]
    extra = points[rng.integers(markers, size=ghosts)] + rng.normal(scale=0.03, size=(ghosts, width))
    points = np.concatenate([points, extra])
    if hostile == "coincident":
        points[-1] = points[0]
    if hostile == "missing":
        points[1] = np.nan
    return np.ascontiguousarray(points[rng.permutation(len(points))])


@pytest.mark.parametrize("seed", SEEDS_OF_CASES)
def test_choose_covering(seed):
    rng = np.random.default_rng(seed)
    rejects = rng.random((12, 128)) < rng.choice([0.02, 0.1, 0.5])
    rejects[3], rejects[7] = rejects[5], False  # a tie, and one that never gains
    weight, counts = rng.integers(1, 4, size=2), rng.random(128) < 0.7
    table = np.packbits(rejects, axis=1, bitorder="little").view(np.uint64)
    wrong = np.packbits(counts, bitorder="little").view(np.uint64)
    for most in (1, 5, 12):
        chosen, gains = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
        count, first_round = choose_covering(table, wrong, weight, most, chosen, gains)
        expected = twins.choose_covering(rejects, np.repeat(weight, 64) * counts, most)
        assert (chosen[:count].tolist(), gains[:count].tolist(), first_round) == expected


@pytest.mark.parametrize("seed", SEEDS_OF_CASES)
def test_order_tests(seed):
    rng = np.random.default_rng(seed)
    features, markers, words = 20, 6, 2
    rejects = rng.random((features, markers, 64 * words)) < rng.choice([0.05, 0.3], size=(features, 1, 1))
    rejects[4] = rejects[9]  # ties
    rejects[rng.integers(features, size=3)] = False
    reads = np.zeros((features, markers), dtype=np.bool_)
    for f in range(features):
        reads[f, rng.permutation(markers)[: rng.integers(1, 4)]] = True
    own = np.sort(rng.permutation(markers)[:4])
    table = np.packbits(rejects, axis=2, bitorder="little").view(np.uint64)
    order, rank = np.empty(4, dtype=np.int64), np.full(features, -1)
    first = np.empty(5, dtype=np.int64)
    order_tests(table, reads, own, own[1], order, rank, first)
    markers_by_depth, tests = twins.order_tests(rejects, reads, own.tolist(), int(own[1]))
    assert order.tolist() == markers_by_depth
    assert [rank[a:b].tolist() for a, b in pairwise(first.tolist())] == tests


@pytest.mark.parametrize("hostile", ["", "coincident", "missing"])
def test_check_marker_on_all_placements_of_four_markers(hostile):
    strong, points = strong_classifier(1, markers=4, each=2), cloud(5, markers=4, ghosts=int(not hostile), hostile=hostile)
    levels = set()
    for place in product(range(-1, len(points)), repeat=4):
        given = np.array(place)
        if len({*place} - {-1}) < (given >= 0).sum():
            continue
        for m in np.nonzero(given >= 0)[0]:
            slack = (0.0, 0.1, 1.0, 8.0)[(place[0] + m) % 4]
            level = check_marker(strong, m, given, points, slack, RULES.min_tests)[0]
            assert level == twins.check_marker(strong, m, place, points, slack, RULES.min_tests), f"marker {m} of {place}"
            levels.add(level)
    assert levels == {0, 1, 2}, "all outcomes are met"


@pytest.mark.parametrize("hostile", ["", "coincident", "missing"])
@pytest.mark.parametrize("seed", SEEDS_OF_CASES)
def test_complete_labels(seed, hostile):
    rng = np.random.default_rng(seed)
    strong, points = strong_classifier(seed, each=1 + seed % 3), cloud(seed, hostile=hostile)
    for given in range(5):
        place, taken = np.full(5, -1), np.zeros(len(points), dtype=np.bool_)
        own = body(seed)[0]
        for m in rng.permutation(5)[:given]:
            near = np.nansum((points[:, :3] - own[m, :3]) ** 2, axis=1)
            place[m] = np.argmin(np.where(taken | np.isnan(points[:, 0]), np.inf, near))
            taken[place[m]] = True
        expected = twins.complete_labels(strong, points, place.tolist(), RULES)
        complete_labels(strong, points, len(points), place, taken, np.empty((5, len(points)), dtype=np.int64), RULES)
        assert place.tolist() == expected
        assert sorted(np.nonzero(taken)[0]) == sorted(row for row in expected if row >= 0)


def test_complete_labels_gives_something():
    """The twin's cases above would be empty if nothing were ever completed."""
    given = 0
    for seed in SEEDS:
        strong, points = strong_classifier(seed), body(seed)[0]
        place, taken = np.array([0, 1, 2, -1, -1]), np.array([True, True, True, False, False])
        complete_labels(strong, points, 5, place, taken, np.empty((5, 5), dtype=np.int64), RULES)
        given += (place >= 0).sum() - 3
        if given > 3:
            return
    raise AssertionError("nothing is completed")


@pytest.mark.parametrize("completing", [False, True])
def test_choose_by_votes_on_all_small_matrices(completing):
    """Two markers, two points, up to five votes each: ties, rivals in the row and the column, exactly as many votes as `outvote` asks."""
    for votes in product(range(6), repeat=4):
        cells = np.array(votes).reshape(2, 2)
        for trusting in ((1, 1), (5, 1), (5, 5)):
            place, taken = np.full(2, -1), np.zeros(2, dtype=np.bool_)
            single, shares = np.empty(2, dtype=np.int64), np.empty(2)
            _choose_by_votes(cells, 2, np.array(trusting), (completing, 2), place, taken, single, shares)
            expected, alone = twins.choose_by_votes(cells, trusting, completing, 2)
            assert (place.tolist(), single.tolist()) == (expected, [alone.get(m, -1) for m in range(2)])
            assert sorted(np.nonzero(taken)[0]) == sorted(row for row in expected if row >= 0)
            assert shares.tolist() == [cells[m].max() / trusting[m] for m in range(2)]


@pytest.mark.parametrize("seed", range(24))
def test_accept_single(seed):
    rng = np.random.default_rng(seed)
    strong, points = strong_classifier(seed, each=1), cloud(seed)
    rules = RULES._replace(slack=3.0, min_tests=1)
    place, taken = np.full(5, -1), np.zeros(len(points), dtype=np.bool_)
    near = np.linalg.norm(points[None, :, :3] - body(seed)[0][:, None, :3], axis=2)
    for m in rng.permutation(5)[:3]:
        if not taken[np.argmin(near[m])]:
            place[m] = np.argmin(near[m])
            taken[place[m]] = True
    single = np.where(rng.random(5) < 0.7, np.argsort(near, axis=1)[np.arange(5), rng.integers(0, 2, size=5)], -1)
    expected = twins.accept_single(strong, points, rules, {m: c for m, c in enumerate(single.tolist()) if c >= 0}, place.tolist())
    _accept_single(strong, points, rules, single, place, taken)
    assert place.tolist() == expected
    assert sorted(np.nonzero(taken)[0]) == sorted(row for row in expected if row >= 0)


@pytest.mark.parametrize("seed", SEEDS_OF_CASES)
def test_count_confusions(seed):
    rng = np.random.default_rng(seed)
    strong, frames = strong_classifier(seed, each=1 + seed % 2), body(seed, frames=10)
    frames[rng.random((10, 5)) < 0.15] = np.nan
    frames[0] = np.nan  # an empty frame
    frames[1, 3] = frames[1, 4]  # coincident points
    known = rng.random((10, 5)) < 0.4
    taken_for, shown = np.zeros((5, 5), dtype=np.int64), np.zeros(5, dtype=np.int64)
    count_confusions(strong, frames, np.arange(10), known, taken_for, shown)
    expected = twins.count_confusions(strong, frames, known)
    np.testing.assert_array_equal(taken_for, expected[0])
    np.testing.assert_array_equal(shown, expected[1])
    assert taken_for.sum() > shown.sum(), "something is confused"


def frames_of(frames, seed):
    """The points of some frames in random order, one marker missing at times, with an empty frame, two coincident points and ghosts."""
    rng = np.random.default_rng(seed)
    clouds = [rng.permutation(frame)[rng.integers(0, 3) :] for frame in frames[seed::17][:3]]
    clouds += [np.empty((0, WIDTH)), np.concatenate([clouds[0], clouds[0][:1]]), frames[0][:2]]
    offsets = np.concatenate([[0], np.cumsum([len(points) for points in clouds])]).astype(np.int64)
    return clouds, np.ascontiguousarray(np.concatenate(clouds)), offsets


@pytest.mark.parametrize(("width", "seed"), [(0.0, 0), (1.0, 1), (4.0, 2)])
def test_label_by_full_solver(width, seed):
    frames, _, solver = solver_and_rules(width, seed)
    clouds, xyz, offsets = frames_of(frames, seed)
    indices, first, total = (
        np.empty((len(clouds), 7), dtype=np.int64),
        np.empty(len(clouds), dtype=np.int64),
        np.empty(len(clouds), dtype=np.int64),
    )
    expected = [(twins.label_by_full_solver(solver, points, 64), len(twins.labellings(solver, points)) > 0) for points in clouds]
    for lowest_first in (False, True):
        label_by_full_solver(pack_solvers([solver]), lowest_first, xyz, offsets, 10**7, indices, first, total)
        for t, (labels, some) in enumerate(expected):
            assert indices[t, solver.markers].tolist() == labels
            assert (first[t] >= 0) == some
            assert first[t] <= total[t]


@pytest.mark.parametrize(("width", "seed", "count"), [(0.0, 0, 12), (1.0, 1, 8), (4.0, 2, 4)])
def test_search_by_pairs_and_evaluate_solver(width, seed, count):
    frames, _, solver = solver_and_rules(width, seed)
    rng = np.random.default_rng(seed)
    chosen, hidden = rng.integers(len(frames), size=count), rng.random((count, 7)) < 0.2
    hidden[0] = True
    motion_unknown = rng.random((count, 7)) < 0.2
    frames = frames.copy()
    frames[chosen[1], 2] = np.nan
    arrays, pairs = factor_pair_rules(pack_solvers([solver]), 7)
    workspace = make_search_workspace(7, 7, 7, WIDTH, len(pairs.kinds))
    counts = ProposalCounts(*(np.full(7, 99) for _ in range(3)))
    validation = ValidationFrames(frames, chosen, hidden, motion_unknown)
    made = evaluate_solver(arrays, pairs, 0, validation, EvaluationLimits(10**7, 10**6), workspace, 0, counts)
    expected = twins.evaluate_solver(solver, frames, chosen, hidden, motion_unknown, 7)
    assert made == count
    for got, plain in zip(counts, expected, strict=True):
        np.testing.assert_array_equal(got, plain)
    end = solver.first_feature[3]
    smaller = Solver(solver.markers[:3], solver.weak.take(np.arange(end)), solver.first_feature[:4])
    arrays, pairs = factor_pair_rules(pack_solvers([smaller, solver]), 7)
    handed_in = np.empty((count, 7), dtype=np.uint64)
    handed_in_points(arrays, pairs, validation, 10**7, workspace, count, handed_in)
    for one, points in zip((smaller, solver), np.split(handed_in, [3], axis=1), strict=True):
        sets = twins.handed_in_points(one, frames, chosen, hidden, motion_unknown, 7)
        assert points.tolist() == [[sum(1 << m for m in own) for own in row] for row in sets]


def test_evaluate_solver_stops_as_soon_as_no_target_can_be_reached():
    """The truth is exchanged among the solver's markers, so that what it proposes is wrong; it stops at the first failure too many."""
    frames, _, solver = solver_and_rules(0.0, 0)
    frames = frames.copy()
    frames[:, MARKERS] = frames[:, np.roll(MARKERS, 1)]
    count, limit = 20, 3
    chosen, nothing = np.arange(count), np.zeros((count, 7), dtype=np.bool_)
    arrays, pairs = factor_pair_rules(pack_solvers([solver]), 7)
    workspace = make_search_workspace(7, 7, 7, WIDTH, len(pairs.kinds))
    counts = ProposalCounts(*(np.zeros(7, dtype=np.int64) for _ in range(3)))
    validation = ValidationFrames(frames, chosen, nothing, nothing)
    made = evaluate_solver(arrays, pairs, 0, validation, EvaluationLimits(10**7, limit), workspace, 0, counts)
    assert counts.hits.sum() == 0
    assert made < count
    assert ((counts.failures + counts.abstentions)[MARKERS] == made).all(), "each evaluation shows all markers, and counts once for each"
    assert counts.failures[MARKERS].min() == limit + 1, "one frame fewer, and a marker could still reach its target"


@pytest.mark.parametrize("seed", SEEDS_OF_CASES)
def test_label_by_matrix_with_the_strong_classifier(seed):
    """Three solvers whose labellings are tried one by one, their votes by the rules, completed by the twin."""
    solvers = [solver_and_rules(width, seed % 4)[2] for width in (0.0, 0.5, 2.0)]
    frames = solver_and_rules(0.0, seed % 4)[0]
    strong = strong_for(frames, seed)
    clouds, xyz, offsets = frames_of(frames, seed)
    arrays, pairs = factor_pair_rules(pack_solvers(solvers), 7)
    trusted = np.random.default_rng(seed).random(len(arrays.markers)) < 0.9
    out = VoteArrays(np.empty((len(clouds), 7), dtype=np.int64), np.empty((len(clouds), 7)), np.empty(len(clouds), dtype=np.int64))
    label_by_matrix(arrays, pairs, trusted, strong, RULES, xyz, offsets, out)
    trusting = [int(trusted[arrays.markers == m].sum()) for m in range(7)]
    workspace = make_search_workspace(7, max(map(len, clouds)), 4, WIDTH, len(pairs.kinds))
    for t, points in enumerate(clouds):
        load_frame(points, len(points), pairs.kinds, workspace)
        proposals = []
        for s in range(3):
            found = search_by_pairs(arrays, pairs, s, len(points), 10 * t + s, RULES.budget, workspace)
            own = [tuple(workspace.order[row].tolist()) for row in workspace.found[: max(found, 0), :4]]
            span = slice(*arrays.first_depth[s : s + 2])
            agreed = zip(arrays.markers[span].tolist(), twins.agreement(own, 4), trusted[span], strict=True)
            proposals.append({m: row for m, row, may in agreed if row >= 0 and may})
        assert out.indices[t].tolist() == twins.label_by_matrix(proposals, trusting, strong, points, RULES)


def strong_for(frames, seed):
    """A strong classifier with the ranges of these frames, a little wider."""
    rng = np.random.default_rng(seed)
    rows = []
    for kind, feature in enumerate(FEATURES):
        for _ in range(6):
            slots = rng.permutation(7)[: feature.points]
            values = np.array([twins.value(kind, [points[m] for m in slots]) for points in frames[::3]])
            rows.append((kind, (*slots.tolist(), 0, 0)[:4], feature.points, np.nanmin(values) - 1e-6, np.nanmax(values) + 1e-6))
    own = [[row for row in rows if m in row[1][: row[2]]] for m in range(7)]
    kinds, slots, points, low, high = zip(*(row for listed in own for row in listed), strict=True)
    first = np.cumsum([0, *map(len, own)]).astype(np.int64)
    return StrongClassifierArrays(first, np.array(kinds), np.array(slots), np.array(points), np.array(low), np.array(high))
