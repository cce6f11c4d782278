"""The tree search and the full solver, against trying every labelling."""

from __future__ import annotations

from functools import cache
from itertools import permutations

import numpy as np
import pytest
import twins
from hypothesis import given, settings
from hypothesis import strategies as st
from test_weak import bodies

from asterism import AsterismError, Clouds, Recording
from asterism.labelling.features.feature_kernels import G9
from asterism.labelling.features.motion_kernels import WIDTH
from asterism.labelling.features.registry import FEATURES as REGISTRY
from asterism.labelling.features.search_kernels import SolverArrays, search
from asterism.labelling.partial._full_solver_kernels import sort_highest_first
from asterism.labelling.partial._pair_search_kernels import later_accepted, load_frame, make_search_workspace, search_by_pairs
from asterism.labelling.partial.full_solver_study import fit_printed, solver_sizes
from asterism.labelling.partial.solver import (
    FullSolver,
    build_search_tree,
    factor_pair_rules,
    pack_solvers,
    replacement_table,
    stack_frames,
    unpack_solvers,
)
from asterism.labelling.partial.weak import FeatureRanges, WeakClassifiers
from asterism.labelling.simulated_occlusions import simulate_occlusions
from asterism.simulation import simulate_walks

pytestmark = pytest.mark.kernels

ALL = tuple(feature.name for feature in REGISTRY)
MARKERS = np.array([1, 2, 4, 5])


@cache
def solver_and_rules(width, seed=0):
    """A solver of four of seven markers, with intervals so wide (by `width` of their range) that some wrong labellings pass.

    The ends lie off the values that they were learned from by more than rounding: twin and kernels sum in different orders.
    The motion of a tenth of the points is unknown.
    """
    frames, groups = bodies(people=2, frames=30, seed=seed)
    rng = np.random.default_rng(seed)
    around = np.tile(frames, (1, 1, 2)) + rng.normal(scale=0.02, size=(*frames.shape[:2], 6))
    frames = np.concatenate([frames, around, rng.normal(scale=0.2, size=(*frames.shape[:2], 6))], axis=2)
    frames[rng.random(frames.shape[:2]) < 0.1, 3:] = np.nan
    weak = FeatureRanges.measure(frames, groups, ALL).classifiers("range")
    outside = np.setdiff1d(np.arange(7), MARKERS)
    points = np.array([feature.points for feature in REGISTRY])[weak.kinds]
    own = np.array([not np.isin(slots[:count], outside).any() for slots, count in zip(weak.slots, points, strict=True)])
    weak = weak.take(own)
    room = width * (weak.high - weak.low) + 1e-9
    weak = WeakClassifiers(weak.kinds, weak.slots, weak.low - room, weak.high + room)
    return frames, weak, build_search_tree(weak, replacement_table(frames, weak, np.random.default_rng(0)), MARKERS, int(MARKERS[2]))


def by_marker(solver, rows):
    return tuple(rows[np.argsort(solver.markers)].tolist())


@given(width=st.sampled_from([0.0, 1.0, 4.0, 20.0]), frame=st.integers(0, 59), drop=st.integers(0, 3), seed=st.integers(0, 3))
@settings(max_examples=25, deadline=None)
def test_search_finds_what_trying_everything_finds(width, frame, drop, seed):
    frames, weak, solver = solver_and_rules(width, seed)
    points = np.random.default_rng(frame).permutation(frames[frame])[drop:]
    place = {marker: i for i, marker in enumerate(MARKERS.tolist())}
    local = WeakClassifiers(weak.kinds, np.vectorize(lambda m: place.get(m, 0))(weak.slots), weak.low, weak.high)
    expected = twins.labellings(local, MARKERS, points)

    found, counters = np.empty((2000, 4), dtype=np.int64), np.zeros(2, dtype=np.int64)
    solutions = search(pack_solvers([solver]), 0, points, np.arange(len(points)), 10**7, found, counters)
    assert {by_marker(solver, row) for row in found[:solutions]} == expected
    assert counters[0] > 0

    rest, pairs = factor_pair_rules(pack_solvers([solver]), 7)
    workspace = make_search_workspace(7, len(points), 4, WIDTH, len(pairs.kinds))._replace(found=np.empty((2000, 4), dtype=np.int64))
    load_frame(points, len(points), pairs.kinds, workspace)
    solutions = search_by_pairs(rest, pairs, 0, len(points), 1, 10**7, workspace)
    assert {by_marker(solver, workspace.order[row]) for row in workspace.found[:solutions]} == expected


def test_budget_and_room_end_a_search_without_an_answer():
    frames, _, solver = solver_and_rules(20.0)
    arrays, order, counters = pack_solvers([solver]), np.arange(7), np.zeros(2, dtype=np.int64)
    assert search(arrays, 0, frames[0], order, 10, np.empty((2000, 4), dtype=np.int64), counters) == -1
    assert 10 < counters[0] < 100
    counters[:] = 0
    assert search(arrays, 0, frames[0], order, 10**7, np.empty((1, 4), dtype=np.int64), counters) == -1


def test_too_few_points_have_no_labelling():
    frames, _, solver = solver_and_rules(1.0)
    found, counters = np.empty((4, 4), dtype=np.int64), np.zeros(2, dtype=np.int64)
    assert search(pack_solvers([solver]), 0, frames[0][:3], np.arange(3), 1000, found, counters) == 0


def test_more_than_64_points():
    frames, _, solver = solver_and_rules(0.0)
    far = np.random.default_rng(0).uniform(10, 50, size=(90, WIDTH))
    points = np.concatenate([far, frames[0]])
    rest, pairs = factor_pair_rules(pack_solvers([solver]), 7)
    workspace = make_search_workspace(7, len(points), 4, WIDTH, len(pairs.kinds))
    load_frame(points, len(points), pairs.kinds, workspace)
    assert search_by_pairs(rest, pairs, 0, len(points), 1, 10**7, workspace) >= 1
    right = (90 + MARKERS).tolist()
    assert right in [workspace.order[row][np.argsort(solver.markers)].tolist() for row in workspace.found[:1]]


def test_solvers_of_several_widenings_share_rules_and_find_what_each_finds_alone():
    """The widest solver's interval is the rule of a pair, and the narrow one keeps its own: else one would find the other's labellings."""
    frames, _, narrow = solver_and_rules(0.0)
    wide = solver_and_rules(20.0)[2]
    rest, pairs = factor_pair_rules(pack_solvers([narrow, wide]), 7)
    kept = np.diff(rest.first_feature[[0, 4, 8]])
    assert kept[0] > kept[1], "only the narrow one has classifiers of pairs"
    workspace = make_search_workspace(7, 7, 4, WIDTH, len(pairs.kinds))._replace(found=np.empty((2000, 4), dtype=np.int64))
    more = 0
    for number, points in enumerate(frames[:4]):
        load_frame(points, 7, pairs.kinds, workspace)
        sets = []
        for s, solver in enumerate((narrow, wide)):
            solutions = search_by_pairs(rest, pairs, s, 7, number, 10**7, workspace)
            sets.append({tuple(workspace.order[row].tolist()) for row in workspace.found[:solutions]})
            assert sets[-1] == twins.labellings(solver.weak, np.arange(4), points)
        more += len(sets[1]) > len(sets[0])
    assert more, "the wide one finds more"


def test_pack_and_unpack():
    solvers = [solver_and_rules(width)[2] for width in (0.0, 1.0)]
    for solver, again in zip(solvers, unpack_solvers(pack_solvers(solvers)), strict=True):
        assert np.array_equal(solver.markers, again.markers)
        assert np.array_equal(solver.weak.low, again.weak.low)
        assert np.array_equal(solver.first_feature, again.first_feature)


def test_every_classifier_stands_where_its_last_point_is_assigned():
    _, weak, solver = solver_and_rules(0.0)
    assert len(solver.weak) == len(weak)
    for depth in range(4):
        for f in range(solver.first_feature[depth], solver.first_feature[depth + 1]):
            assert solver.weak.slots[f, : REGISTRY[solver.weak.kinds[f]].points].max() == depth


WALKS = simulate_walks(subjects=3, frames=80, seed=1)


@pytest.fixture(scope="module")
def full():
    return FullSolver.fit(WALKS, seed=0)


def test_full_solver_labels_shuffled_frames(full):
    clouds, truth = simulate_occlusions(WALKS[0], 0, 0, seed=2)
    labelling = full.label(clouds)
    given_labels = labelling.indices >= 0
    assert (labelling.indices == truth)[given_labels].all()
    assert given_labels.mean() > 0.95
    assert full.evaluations < 1000
    assert full.evaluations <= full.evaluations_in_all
    assert (labelling.confidence[~given_labels] == 0).all()


def test_full_solver_is_silent_when_a_marker_is_hidden(full):
    clouds, _ = simulate_occlusions(WALKS[0], 1, 0, seed=2)
    assert (full.label(clouds).indices == -1).all()


def test_full_solver_does_not_depend_on_order_place_heading_or_vertical(full):
    clouds, truth = simulate_occlusions(WALKS[1].frames(slice(0, 20)), 0, 0, seed=3)
    before = full.label(clouds).indices == truth
    turned = clouds.xyz @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) + [3.0, -2.0, 0.5]
    assert np.array_equal(full.label(Clouds(turned, clouds.offsets, 100.0, clouds.vertical, clouds.columns)).indices == truth, before)
    y_up = np.stack([clouds.xyz[:, 1], clouds.xyz[:, 2], clouds.xyz[:, 0]], axis=1)
    tipped = Clouds(y_up, clouds.offsets, 100.0, np.array([0.0, 1.0, 0.0]), clouds.columns)
    assert np.array_equal(full.label(tipped).indices == truth, before)


def test_full_solver_does_not_accept_a_mirrored_body(full):
    clouds, _ = simulate_occlusions(WALKS[0], 0, 0, seed=2)
    mirrored = Clouds(clouds.xyz * [1.0, -1.0, 1.0], clouds.offsets, 100.0, clouds.vertical, clouds.columns)
    names = full.names
    pairs = [(names.index("R" + name[1:]), i) for i, name in enumerate(names) if name[0] == "L" and "R" + name[1:] in names]
    swapped = np.arange(len(names))
    for a, b in pairs:
        swapped[[a, b]] = b, a
    plain, other = full.label(clouds).indices, full.label(mirrored).indices
    # A mirrored walker is a walker with left and right exchanged, and must not keep the names of the original.
    assert not ((other == plain) & (plain >= 0)).all(axis=1).any()


@pytest.mark.parametrize("points", [np.empty((0, 3)), np.zeros((15, 3)), np.random.default_rng(0).normal(size=(40, 3))])
def test_full_solver_on_strange_clouds(full, points):
    assert (full.label(Clouds.from_points([points], 100.0)).indices == -1).all()


def test_full_solver_says_what_it_cannot_learn_from():
    with pytest.raises(AsterismError, match="at least three"):
        FullSolver.fit([WALKS[0].select(["RASI", "LASI"])])
    with pytest.raises(AsterismError, match="other columns"):
        stack_frames([WALKS[0], WALKS[1].select(WALKS[1].labels[::-1])])
    with pytest.raises(AsterismError, match="no frames"):
        stack_frames([])
    with pytest.raises(AsterismError, match="subjects"):
        stack_frames(WALKS, ["one"])
    gone = WALKS[0].positions.copy()
    gone[:, 3] = np.nan
    with pytest.raises(AsterismError, match=f"{WALKS[0].labels[3]} is never visible"):
        FullSolver.fit([Recording(gone, WALKS[0].labels, 100.0)])


def test_full_solver_is_the_same_for_the_same_seed(full):
    again = FullSolver.fit(WALKS, seed=0)
    assert np.array_equal(again.solver.weak.low, full.solver.weak.low)
    assert np.array_equal(again.solver.markers, full.solver.markers)


def test_people_come_from_metadata():
    frames, groups = stack_frames(WALKS)
    assert len(frames) == 240
    assert np.array_equal(groups, np.repeat([0, 1, 2], 80))


def test_every_order_of_three_markers_is_tried():
    """Three markers without a classifier between the last two: all labellings of three points are feasible."""
    weak = WeakClassifiers(np.array([1]), np.array([[0, 1, 0, 0]]), np.array([0.0]), np.array([99.0]))
    frames = np.random.default_rng(0).normal(size=(5, 3, 3))
    solver = build_search_tree(weak, replacement_table(frames, weak, np.random.default_rng(0)), np.arange(3), 0)
    found, counters = np.empty((10, 3), dtype=np.int64), np.zeros(2, dtype=np.int64)
    assert search(pack_solvers([solver]), 0, frames[0], np.arange(3), 1000, found, counters) == 6
    assert {tuple(row) for row in found[:6].tolist()} == set(permutations(range(3)))


def test_a_later_classifier_that_rejects_ends_the_count_of_evaluations():
    """Of four classifiers of the unit normal, those from the second on: the third, which rejects, is the second evaluation."""
    low, high = np.array([2.0, -1.0, 2.0, -1.0]), np.array([3.0, 1.0, 3.0, 1.0])
    none = np.zeros(0, dtype=np.int64)
    slots = np.tile(np.array([0, 1, 2, 0]), (4, 1))
    solvers = SolverArrays(none, none, none, np.full(4, G9), slots, low, high)
    points, path = np.array([[0.0, 0, 1], [0.3, 0, 1], [0, 0.4, 1]]), np.arange(3)
    assert later_accepted(solvers, 1, 4, points, path) == (False, 2)
    assert later_accepted(solvers, 1, 2, points, path) == (True, 1)


@pytest.mark.parametrize("width", [3, WIDTH])
def test_points_are_sorted_highest_first_and_equal_heights_stay_in_order(width):
    points = np.random.default_rng(0).normal(size=(12, width))
    points[[2, 5, 9], 2] = points[7, 2]
    order = np.full(12, -1)
    sort_highest_first(points, 11, order)
    assert order.tolist() == [*np.argsort(-points[:11, 2], kind="stable"), -1]


def test_the_last_of_the_solver_sizes_is_the_full_solver():
    """Figure 5.1: the tree of all its classifiers begins with its first marker, and needs about as many evaluations as its own tree."""
    walks = simulate_walks(subjects=2, frames=100, seed=2)
    frames, groups = stack_frames(walks)
    solver, few = fit_printed(frames, groups, walks[0].labels), np.ascontiguousarray(frames[::25])
    assert not solver.solver.lowest_first, "the sizes are searched from the highest point on"
    last = solver_sizes(solver, few, wrong=1000)[-1]
    solver.label(Clouds.from_points(list(few), 1.0))
    assert last.classifiers == len(solver.strong.weak) == 40
    assert last.evaluations == pytest.approx(solver.evaluations, rel=0.2)
