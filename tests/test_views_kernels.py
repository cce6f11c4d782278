"""The kernels of labelling in images against their twins, their derivatives against differences, and the paper's own way."""

from __future__ import annotations

import numpy as np
import pytest
import twins_views as twins
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism.errors import AsterismError
from asterism.simulation.views_laboratory import paper_rig
from asterism.skeleton import load_body
from asterism.skeleton.body_fit import known_of, pose_recording
from asterism.skeleton.pose_kernels import place_bones, point_jacobian, take_step
from asterism.skeleton.posing import posed_bones, posed_points
from asterism.views._carry_kernels import carry_labels
from asterism.views._chain_kernels import label_odds, link_chains
from asterism.views._fit_kernels import evaluate, minimise, project_linear, share_blobs
from asterism.views._label_kernels import assign_best, margins
from asterism.views._limb_kernels import fit_limb, screen_limb
from asterism.views._visibility_kernels import sight_depths, visible_shares
from asterism.views.chains import continued
from asterism.views.exchanges import exchanges_of
from asterism.views.limbs import LimbScreen, LimbSearchRules, evenly, limbs_of
from asterism.views.rules import ViewsRules
from asterism.views.scene import camera_arrays
from asterism.views.start import place_by_centroids

pytestmark = pytest.mark.kernels

BODY = load_body("gait15")
RIG = paper_rig()
CAMERAS = camera_arrays(RIG, [(656.0, 491.0)] * 4)
OBSERVING = ViewsRules().observing(656.0 * 491.0)
UP = np.array([0.0, 0.0, 1.0])
NOBODY = np.empty(0, dtype=np.int64)


def random_pose(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    hinges = np.clip(rng.normal(0.0, 0.4, len(BODY.hinges)), BODY.arrays.low, BODY.arrays.high)
    pose = np.concatenate([rng.uniform(0.8, 1.2, 3), rng.uniform(-0.3, 0.3, 3) + 0.8 * UP, np.zeros(3), hinges])
    return pose, twins.rotation_about(UP, rng.uniform(-3, 3)) @ twins.rotation_about(np.array([1.0, 0.0, 0.0]), rng.normal(0, 0.1))


@pytest.mark.parametrize("seed", range(5))
def test_markers_of_a_posed_body_are_where_the_chain_of_joints_puts_them(seed: int) -> None:
    pose, rotation = random_pose(seed)
    assert np.allclose(posed_points(BODY, pose, rotation)[0], twins.posed_markers(BODY, pose, rotation), atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_the_jacobian_is_the_slope_of_the_positions(seed: int) -> None:
    pose, rotation = random_pose(seed)
    arrays, size = BODY.arrays, len(pose)
    bones, hinges = len(BODY.bones), len(BODY.hinges)
    turned, moved, by_scale = np.empty((bones, 3, 3)), np.empty((bones, 3)), np.empty((bones, 3, 3))
    axes, pivots = np.empty((hinges, 3)), np.empty((hinges, 3))
    place_bones(arrays.parents, arrays.pivots, arrays.hinge_starts, arrays.axes, pose, rotation, turned, moved, by_scale, axes, pivots)
    points = posed_points(BODY, pose, rotation)[0]
    free = np.full(hinges, 10.0)
    for p in range(size):
        step = np.zeros(size)
        step[p] = 1e-6
        there, turn = np.empty(size), np.empty((3, 3))
        take_step(pose, rotation, step, 0.1, -free, free, there, turn)
        slope = (posed_points(BODY, there, turn)[0] - points) / 1e-6
        for m in range(len(points)):
            out = np.empty((3, size))
            b = arrays.bones[m]
            point_jacobian(b, arrays.places[m], points[m], pose, turned, by_scale, axes, pivots, arrays.moves[b], out)
            assert np.allclose(out[:, p], slope[m], atol=1e-5), (p, m)


def test_the_gradient_of_the_cost_points_downhill_by_as_much_as_it_says() -> None:
    pose, rotation = random_pose(1)
    rng = np.random.default_rng(0)
    truth = posed_points(BODY, pose, rotation)[0]
    blobs = [camera.undistort(camera.project(truth) + rng.normal(0, 3, (15, 2))) * camera.focal for camera in RIG]
    offsets = np.concatenate([[0], np.cumsum([len(each) for each in blobs])]).astype(np.int64)
    xy, shares = np.concatenate(blobs), rng.uniform(0.2, 0.9, (4, 15))
    known = known_of(BODY, UP)
    size = len(pose)
    tight = BODY.arrays._replace(spreads=np.full(15, 1e-9))  # else the blur would change with the distance, which the step leaves out

    def cost(at: np.ndarray, turn: np.ndarray) -> tuple[float, np.ndarray]:
        hessian, gradient = np.empty((size, size)), np.empty(size)
        value = evaluate(tight, CAMERAS, known, OBSERVING, shares, xy, offsets, NOBODY, at, turn, 8.0, hessian, gradient)
        return value, gradient

    _, gradient = cost(pose, rotation)
    wide = np.full(len(BODY.hinges), 10.0)
    for p in range(size):
        values = []
        for sign in (1.0, -1.0):
            step = np.zeros(size)
            step[p] = sign * 1e-6
            there, turn = np.empty(size), np.empty((3, 3))
            take_step(pose, rotation, step, 0.1, -wide, wide, there, turn)
            values.append(cost(there, turn)[0])
        slope = (values[0] - values[1]) / 2e-6
        assert abs(gradient[p] + slope) < 1e-3 * (1.0 + abs(slope)), f"number {p}: {-gradient[p]:.4f}, by differences {slope:.4f}"


def test_sharing_blobs_costs_what_the_mixture_says() -> None:
    rng = np.random.default_rng(4)
    points = posed_points(BODY, *random_pose(2))[0]
    uv, slopes = np.empty((4, 15, 2)), np.empty((4, 15, 2, 3))
    project_linear(CAMERAS, points, uv, slopes)
    blobs = [uv[c][rng.permutation(15)[:9]] + rng.normal(0, 4, (9, 2)) for c in range(4)]
    shares = rng.uniform(0.1, 0.95, (4, 15))
    offsets = np.array([0, 9, 18, 27, 36])
    cost = share_blobs(
        uv, slopes, shares, BODY.arrays.spreads, np.concatenate(blobs), offsets, 5.0, OBSERVING, np.zeros((15, 3, 3)), np.zeros((15, 3))
    )
    variances = 25.0 + 0.5 * (slopes**2).sum(axis=(2, 3)) * BODY.arrays.spreads**2
    assert cost == pytest.approx(twins.shared_cost(uv, variances, shares, blobs, OBSERVING.strays), rel=1e-9)


def test_linear_projection_is_that_of_the_cameras_without_their_lenses() -> None:
    points = posed_points(BODY, *random_pose(3))[0]
    uv, slopes = np.empty((4, 15, 2)), np.empty((4, 15, 2, 3))
    project_linear(CAMERAS, points, uv, slopes)
    for c, camera in enumerate(RIG):
        flat = camera.undistort(camera.project(points)) * np.array(camera.focal)
        assert np.allclose(uv[c], flat, atol=1e-6)
    moved = np.empty((4, 15, 2))
    project_linear(CAMERAS, points + np.array([0.0, 1e-7, 0.0]), moved, np.empty((4, 15, 2, 3)))
    assert np.allclose((moved - uv) / 1e-7, slopes[..., 1], atol=1e-2)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000))
def test_depths_of_sights_are_those_of_many_places_along_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    eye, point, start, end = rng.uniform(-1, 1, (4, 3)) + np.array([[3.0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]])
    radii = rng.uniform(0.03, 0.3, 2)
    out = np.empty((1, 1))
    sight_depths(eye[None], point[None], start[None], end[None], radii[None], 0.007, out)
    told = twins.sight_depth(eye, point, start, end, radii, 0.007)
    if told > -0.05:
        assert out[0, 0] == pytest.approx(told, abs=2e-3)
    else:  # a capsule that is farther off may be passed over
        assert out[0, 0] == -1.0 or out[0, 0] == pytest.approx(told, abs=2e-3)


def test_a_marker_on_the_far_side_is_hidden_and_on_the_near_side_is_not() -> None:
    start, end, radii = np.array([[0.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]]), np.array([[0.1, 0.1]])
    points = np.array([[0.105, 0.0, 0.5], [-0.105, 0.0, 0.5]])
    out, shares = np.empty((1, 2)), np.empty((1, 2))
    sight_depths(np.array([[3.0, 0.0, 0.5]]), points, start, end, radii, 0.007, out)
    visible_shares(out, 0.002, 0.004, 0.05, 0.95, shares)
    assert out[0, 0] < 0 < 0.09 < out[0, 1]
    assert shares[0, 0] > 0.8 and shares[0, 1] < 0.06


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 4), st.integers(0, 4))
def test_assignments_and_their_margins_are_those_of_trying_all(seed: int, rows: int, columns: int) -> None:
    gain = np.random.default_rng(seed).normal(0.0, 3.0, (rows, columns))
    chosen, margin = np.empty(rows, dtype=np.int64), np.empty(rows)
    assign_best(gain, chosen)
    used = chosen[chosen >= 0]
    assert len(set(used.tolist())) == len(used)
    assert sum(gain[i, k] for i, k in enumerate(chosen) if k >= 0) == pytest.approx(twins.best_total(gain))
    margins(gain, chosen, margin)
    for m in np.nonzero(chosen >= 0)[0]:
        assert margin[m] >= twins.margin_by_trying(gain, chosen, m) - 1e-9


def test_the_minimum_from_a_start_that_is_off_is_the_pose_itself() -> None:
    pose, rotation = random_pose(1)
    pose[9:] = BODY.arrays.usual
    truth = posed_points(BODY, pose, rotation)[0]
    blobs = [camera.undistort(camera.project(truth)) * camera.focal for camera in RIG]
    offsets = np.arange(0, 61, 15).astype(np.int64)
    everything = OBSERVING._replace(occlusion_tolerance=np.inf)
    start = pose.copy()
    start[:6] += np.array([0.1, 0.1, -0.1, 0.1, -0.1, 0.1])
    turn = twins.rotation_about(UP, np.radians(20)) @ rotation
    free = np.arange(len(pose))
    minimise(
        BODY.arrays,
        CAMERAS,
        known_of(BODY, UP, scale=(10.0, 10.0), tilt=10.0),
        everything,
        np.concatenate(blobs),
        offsets,
        NOBODY,
        np.array([40.0, 20.0, 10.0, 5.0, 2.0]),
        8,
        free,
        start,
        turn,
        np.empty((len(pose), len(pose))),
    )
    away = np.linalg.norm(posed_points(BODY, start, turn)[0] - truth, axis=1)
    assert away.max() < 0.004, f"{1e3 * away.max():.1f} mm"


def test_known_positions_give_the_pose_back() -> None:
    pose, rotation = random_pose(2)
    pose[:3] = 1.05
    pose[9:] = BODY.arrays.usual + 0.3 * np.sign(pose[9:]) * BODY.arrays.precision**-0.5
    truth = posed_points(BODY, pose, rotation)[0]
    fitted = pose_recording(BODY, truth[None])
    again = posed_points(BODY, fitted.poses[0], fitted.rotations[0])[0]
    assert np.linalg.norm(again - truth, axis=1).max() < 0.01
    assert np.isnan(pose_recording(BODY, np.full((1, 15, 3), np.nan)).poses).all()


def test_the_centroids_place_the_body_by_the_equations_of_the_paper() -> None:
    centre, place = np.array([0.1, -0.2, 0.3]), np.array([0.2, 0.1, 0.5])
    seen = np.array([camera.project(centre + place) for camera in RIG])
    assert np.allclose(place_by_centroids(RIG, seen, centre), place, atol=1e-6)
    seen[1:] = np.nan
    with pytest.raises(AsterismError, match="two cameras"):
        place_by_centroids(RIG, seen, centre)


WHOLE = load_body("body26")
LIMBS = limbs_of(WHOLE)


def standing_whole(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    pose = np.concatenate([rng.uniform(0.9, 1.1, 3), [0.0, 0.0, 0.9], np.zeros(3), WHOLE.arrays.usual])
    return pose, twins.rotation_about(UP, rng.uniform(-3, 3))


def blobs_of(pose: np.ndarray, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    uv = np.empty((4, 26, 2))
    project_linear(CAMERAS, posed_points(WHOLE, pose, rotation)[0], uv, np.empty((4, 26, 2, 3)))
    return uv, np.arange(0, 105, 26)


def test_the_limbs_that_are_sought_are_the_arms() -> None:
    assert [WHOLE.bones[limb.first].name for limb in LIMBS] == ["left upper arm", "right upper arm"]
    ends = [[[WHOLE.labels[m] for m in each] for each in end] for limb in LIMBS for end in limb.pairs]
    assert ends == [[["LWRA", "LWRB"], ["LFIN"]], [["RWRA", "RWRB"], ["RFIN"]]]
    assert limbs_of(BODY) == ()


@pytest.mark.parametrize("seed", range(3))
def test_the_cost_of_a_limbs_angles_is_that_of_the_whole_body_with_them(seed: int) -> None:
    pose, rotation = standing_whole(seed)
    uv, offsets = blobs_of(pose, rotation)
    xy, limb = uv.reshape(-1, 2) + np.random.default_rng(seed).normal(0, 2, (104, 2)), LIMBS[1]
    angles, costs = limb.tried[:5], np.empty(5)
    screen_limb(WHOLE.arrays, limb.arrays, limb.first, CAMERAS, OBSERVING, xy, offsets, 12.0, limb.rest, angles, pose, rotation, costs)
    for n in range(5):
        tried = pose.copy()
        tried[9 + limb.hinges] = angles[n]
        there, slopes = np.empty((4, 26, 2)), np.empty((4, 26, 2, 3))
        project_linear(CAMERAS, posed_points(WHOLE, tried, rotation)[0], there, slopes)
        variances = 144.0 + 0.5 * (slopes**2).sum(axis=(2, 3)) * WHOLE.arrays.spreads**2
        blobs = list(xy.reshape(4, 26, 2))
        told = twins.shared_cost(there, variances, np.full((4, 26), OBSERVING.shown), blobs, OBSERVING.strays)
        told += float((0.5 * limb.arrays.precision * (angles[n] - limb.arrays.usual) ** 2).sum())
        assert costs[n] == pytest.approx(told, rel=1e-3)


def test_an_arm_that_is_raised_is_found_by_trying() -> None:
    pose, rotation = standing_whole(1)
    limb, raised = LIMBS[0], standing_whole(1)[0]
    raised[9 + limb.hinges] = limb.tried[17]
    uv, offsets = blobs_of(raised, rotation)
    screen = LimbScreen(WHOLE, CAMERAS, OBSERVING, uv.reshape(-1, 2), offsets)
    found = screen.poses(limb, pose, rotation, tried=64, blur=12.0)[0]
    assert np.abs(found - raised).max() < 1e-9
    several = screen.poses(limb, pose, rotation, tried=64, blur=12.0, kept=3, apart=0.5)
    assert len(several) == 3 and np.abs(several[1] - several[0]).max() > 0.5


def test_a_limb_is_fitted_to_labels_from_the_best_of_its_starts() -> None:
    pose, rotation = standing_whole(2)
    limb, bent = LIMBS[0], standing_whole(2)[0]
    bent[9 + limb.hinges] += 0.5 * np.sqrt(1.0 / limb.arrays.precision)
    uv, offsets = blobs_of(bent, rotation)
    screen = LimbScreen(WHOLE, CAMERAS, OBSERVING, uv.reshape(-1, 2), offsets)
    found = screen.labelled(limb, np.tile(np.arange(26), 4), pose, rotation, known_of(WHOLE, UP), tried=4, steps=20)
    away = np.linalg.norm(posed_points(WHOLE, found, rotation)[0] - posed_points(WHOLE, bent, rotation)[0], axis=1)
    assert away[limb.markers].max() < 0.03 and away[limb.rest].max() < 1e-9
    turned, moved = posed_bones(WHOLE, bent, rotation)
    above = WHOLE.arrays.parents[limb.first]
    own = np.concatenate([bent[:3], moved[above], np.zeros(3), bent[9 + limb.hinges]])[None]
    costs, labels = np.empty(1), np.searchsorted(limb.markers, np.tile(limb.markers, 4))
    some = uv[:, limb.markers].reshape(-1, 2)
    fit_limb(
        *(limb.arrays, CAMERAS, known_of(WHOLE, UP), OBSERVING, some, np.arange(0, 4 * len(limb.markers) + 1, len(limb.markers))),
        *(labels, np.array([3.0]), 0, turned[above], own, costs),
    )
    prior = 0.5 * (limb.arrays.precision * (bent[9 + limb.hinges] - limb.arrays.usual) ** 2).sum()
    assert costs[0] > prior - 1e-9, "blobs at the markers cost nothing beside what is known of the pose"


def test_a_limb_is_found_by_blobs_without_labels_among_strays() -> None:
    pose, rotation = standing_whole(2)
    limb, bent = LIMBS[1], standing_whole(2)[0]
    bent[9 + limb.hinges[:4]] += [0.9, 0.4, 0.3, 0.9]
    uv = blobs_of(bent, rotation)[0].reshape(4, 26, 2)[:, limb.markers]
    strays = np.random.default_rng(2).uniform(-200, 200, (4, 3, 2))
    xy = np.concatenate([uv, strays], axis=1).reshape(-1, 2)
    screen = LimbScreen(WHOLE, CAMERAS, OBSERVING, xy, np.arange(0, len(xy) + 1, len(xy) // 4))
    found = screen.alone(limb, pose, rotation, known_of(WHOLE, UP), LimbSearchRules(), 3)
    assert len(found) <= 3
    there = posed_points(WHOLE, bent, rotation)[0]
    away, before = (np.linalg.norm(posed_points(WHOLE, each, rotation)[0] - there, axis=1) for each in (found[0], pose))
    assert before[limb.markers].max() > 0.2 and away[limb.markers].max() < 0.04, f"{1e3 * away[limb.markers].max():.0f} mm"
    assert away[limb.rest].max() < 1e-9


def test_parts_that_may_be_exchanged_are_each_bone_with_both_sides_and_what_hangs_on_it() -> None:
    parts = exchanges_of(WHOLE)
    names = [{WHOLE.labels[m] for m in np.nonzero(part.names[1:] != np.arange(26))[0]} for part in parts]
    assert {"LHEE", "LTOE", "RHEE", "RTOE"} in names and {"LSHO", "RSHO"} in names
    assert max(names, key=len) == {name for name in WHOLE.labels if name[0] in "LR"}
    for part, own in zip(parts, names, strict=True):
        assert part.names[0] == -1 and all(WHOLE.labels[part.names[m + 1]][1:] == WHOLE.labels[m][1:] for m in range(26))
        assert len(set(map(frozenset, names))) == len(names)
        feet = {"LHEE", "RHEE"} <= own
        assert ({WHOLE.hinge_names[j] for j in part.hinges} >= {"left foot flexion", "right foot flexion"}) == feet


def test_numbers_are_spread_evenly() -> None:
    some = evenly(400, 3)
    counts = np.histogramdd(some, bins=(4, 4, 4), range=[(0, 1)] * 3)[0]
    assert counts.min() >= 3 and counts.max() <= 11, f"{counts.min()} to {counts.max()} of 6.25 in each cell"


def test_labels_go_on_with_the_blobs_that_move_as_expected() -> None:
    old_uv, old_xy = np.zeros((1, 3, 2)), np.array([[10.0, 10.0], [50.0, 50.0], [90.0, 10.0]])
    new_uv = old_uv + np.array([5.0, 0.0])
    old_labels, old_offsets, out = np.array([2, 0, 1]), np.array([0, 3]), np.empty(4, dtype=np.int64)
    xy = np.array([[55.5, 50.0], [15.0, 10.5], [95.0, 12.0], [95.0, 13.0]])
    carry_labels(old_uv, new_uv, old_xy, old_offsets, old_labels, xy, np.array([0, 4]), 8.0, out)
    assert out.tolist() == [0, 2, -1, -1], "of two blobs near each other neither is taken"
    carry_labels(old_uv, new_uv, old_xy, old_offsets, old_labels, xy + 100.0, np.array([0, 4]), 8.0, out)
    assert (out == -1).all()
    both = np.array([[10.0, 10.0], [10.5, 10.0]])
    carry_labels(old_uv, old_uv, both, np.array([0, 2]), np.array([0, 1]), both[:1], np.array([0, 1]), 8.0, out)
    assert out[0] == -1, "two labels for one blob are none"


@given(st.integers(0, 10_000))
def test_labels_along_chains_are_those_of_the_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # Steps as long as the points are apart, so that some links are doubtful.
    positions = rng.uniform(0.0, 0.3, (1, 4, 3)) + np.cumsum(rng.normal(0.0, rng.uniform(0.002, 0.05), (12, 4, 3)), axis=0)
    positions = np.take_along_axis(positions, np.argsort(rng.random((12, 4)) < 0.1, axis=1)[:, :, None], axis=1)
    positions[rng.random((12, 4)) < 0.2] = np.nan
    weights = rng.uniform(0.0, 7.0, (12, 4))
    frame, marker = np.nonzero(np.isfinite(positions[..., 0]))
    offsets = np.searchsorted(frame, np.arange(13))
    previous, following = np.empty((2, len(frame)), dtype=np.int64)
    link_chains(positions[frame, marker], offsets, 0.2, 0.005, previous, following)
    odds, total = np.empty(len(frame)), np.zeros(4)
    label_odds(previous, following, frame, marker, weights[frame, marker], 3, total, odds)
    expected = twins.chained_labels(positions, weights, 0.2, 0.005, 3)[frame, marker]
    np.testing.assert_allclose(odds, expected, atol=1e-9)
    assert not total.any()


def test_a_marker_that_becomes_another_one_in_a_single_frame_is_doubted() -> None:
    # Ankle and heel 6 cm apart, walking on at 1.5 m/s; in frame 5 the heel's point is called ankle and the ankle is not seen.
    way = np.arange(11)[:, None, None] * np.array([0.03, 0.0, 0.0]) + np.array([[0.0, 0.0, 0.08], [0.0, 0.06, 0.03]])
    seen, sure = way.copy(), np.full((11, 2), 0.995)
    seen[5], sure[5] = [way[5, 1], [np.nan] * 3], [0.995, 0.0]
    shares = continued(seen, sure, 50.0, 5)
    assert shares[5, 0] < 0.01
    assert (np.delete(shares, 5, axis=0) > 0.999).all(), "the labels around are as sure as before"
    # Nothing speaks against a label that begins and stays.
    assert (continued(way, np.full((11, 2), 0.6), 50.0, 5) == 1.0).all()
    # Half-way another name: nobody knows which half is right.
    seen = way.copy()
    seen[6:, 0], seen[6:, 1] = way[6:, 1], np.nan
    seen[:6, 0] = np.nan
    assert 0.2 < continued(seen, np.full((11, 2), 0.995), 50.0, 5)[5, 1] < 0.95
