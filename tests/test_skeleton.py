"""Kinematic trees: their kernels against plain twins, and the movement that inverse kinematics finds against the movement that was."""

from __future__ import annotations

import numpy as np
import pytest
import twins_skeleton as twins
from scipy.spatial.transform import Rotation

from asterism.errors import AsterismError
from asterism.recording import Recording
from asterism.skeleton import load_body, solve_kinematics, tree_of
from asterism.skeleton._smooth_kernels import likelihood, smoothed_variances, smoothing_step
from asterism.skeleton._tree_kernels import assemble, factorise, inverse_diagonal, pose_tree, solve_factored
from asterism.skeleton.inverse_kinematics import KinematicsRules, Solving
from asterism.skeleton.tree import Coordinate, Curve, KinematicTree, Motion, TreeBone, TreeMarker

pytestmark = pytest.mark.kernels

GAUSS = KinematicsRules(tails=0.0)
"""Plain least squares."""


@pytest.fixture(scope="module")
def leg() -> KinematicTree:
    """A leg whose knee slides with its angle, with a kneecap on the thigh that moves with the same angle; the pelvis is free."""
    slide = Curve(np.array([-1.0, 0.0, 1.0]), np.array([[0.01, 0.02, 0.0, 0.01], [0.04, 0.05, 0.03, 0.0], [0.12, 0.1, 0.0, 0.0]]))
    askew = Rotation.from_rotvec([0.2, -0.1, 0.3]).as_matrix()
    bones = (
        TreeBone("pelvis", "", np.zeros(3)),
        TreeBone("thigh", "pelvis", np.array([0.0, 0.1, -0.1]), (Motion((0, -1, 0), "flexion"), Motion((1, 0, 0), "abduction")), askew),
        TreeBone("kneecap", "thigh", np.array([0.05, 0.0, -0.4]), (Motion((0, 0, 1), "knee", True, slide), Motion((0, 1, 0), "knee"))),
        TreeBone("shank", "thigh", np.array([0.0, 0.0, -0.4]), (Motion((1, 0, 0), "knee", True, slide), Motion((0, 1, 0), "knee"))),
        TreeBone("foot", "shank", np.array([0.0, 0.0, -0.4]), (Motion((0, 0, 1), "", False, slide), Motion((0, -1, 0), "ankle"))),
    )
    coordinates = tuple(Coordinate(name, 0.1, 0.5, -0.3, 1.5) for name in ("flexion", "abduction", "knee", "ankle"))
    rng = np.random.default_rng(3)
    markers = tuple(
        TreeMarker(f"{bone.name}{i}", bone.name, tuple(rng.normal(0, 0.08, 3).tolist()), 0.01 + 0.002 * i)
        for bone in bones
        for i in range(3)
    )
    return KinematicTree(bones, coordinates, markers)


def _solving(tree: KinematicTree, tails: float = 0.0) -> Solving:
    return Solving(tails, np.full(len(tree.coordinates), 130.0), 1e-4, 60, 1e-6, 9.0, 50.0)


def _equations(tree, q, turn, place, points, weights, tails=0.0):
    """The kernels' cost, normal equations (as a full matrix) and gradient."""
    arrays, bones, size = tree.arrays, len(tree.bones), 6 + len(q)
    turned, joints, twists = np.empty((bones, 3, 3)), np.empty((bones, 3)), np.empty((len(arrays.numbers), 6))
    pose_tree(arrays, q, turn, place, turned, joints, twists)
    hessian, gradient, misses = np.zeros((size, size)), np.empty(size), np.empty(len(points))
    work = (points, weights, q, place, turned, joints, twists, np.empty((bones, 16)), hessian, gradient, misses)
    cost = assemble(arrays, _solving(tree, tails), *work)
    return cost, hessian, gradient


def test_the_composite_bodies_give_the_normal_equations_of_the_jacobian(leg) -> None:
    rng = np.random.default_rng(5)
    q, turn, place = rng.uniform(-0.2, 1.4, 4), Rotation.from_rotvec([0.4, 1.0, -2.0]).as_matrix(), np.array([3.0, -2.0, 1.0])
    points = twins.markers_of(leg, q, turn, place) + rng.normal(0, 0.01, (15, 3))
    points[4] = np.nan
    weights = rng.uniform(1e3, 1e4, 15)
    cost, lower, gradient = _equations(leg, q, turn, place, points, weights)
    there = np.isfinite(points[:, 0])
    slopes = twins.jacobian(leg, q, turn, place).reshape(15, 3, -1)[there].reshape(-1, 10)
    away, w = (points - twins.markers_of(leg, q, turn, place))[there].ravel(), np.repeat(weights[there], 3)
    usual, precision = leg.arrays.usual, leg.arrays.precision
    full = slopes.T @ (w[:, None] * slopes) + np.diag([*[1e-4] * 6, *(precision + 1e-4)])
    pull = slopes.T @ (w * away)
    pull[6:] -= precision * (q - usual)
    assert np.allclose(np.tril(lower), np.tril(full), atol=1e-4 * np.abs(full).max() ** 0.5)
    assert np.allclose(gradient, pull, atol=1e-6 * np.abs(pull).max())
    assert cost == pytest.approx(0.5 * (w * away**2).sum() + 0.5 * (precision * (q - usual) ** 2).sum())


def test_the_factor_of_the_branches_solves_and_inverts(leg) -> None:
    rng = np.random.default_rng(6)
    q, turn, place = rng.uniform(0.0, 1.0, 4), np.eye(3), np.zeros(3)
    points = twins.markers_of(leg, q, turn, place) + rng.normal(0, 0.01, (15, 3))
    _, lower, gradient = _equations(leg, q, turn, place, points, np.full(15, 1e4))
    full = np.tril(lower) + np.tril(lower, -1).T
    factor, inverse, variances = np.zeros_like(full), np.zeros_like(full), np.empty(10)
    assert factorise(leg.arrays, lower, 0.0, factor)
    solution = gradient.copy()
    solve_factored(leg.arrays, factor, solution)
    inverse_diagonal(leg.arrays, factor, inverse, variances)
    assert np.allclose(full @ solution, gradient, rtol=1e-8)
    assert np.allclose(variances, np.diag(np.linalg.inv(full)), rtol=1e-6)
    assert not factorise(leg.arrays, -lower, 0.0, factor), "a matrix that is not positive definite has no factor"


def test_frames_are_smoothed_as_by_one_dense_matrix(leg) -> None:
    rng = np.random.default_rng(7)
    frames, blocks, entries = 12, [], []
    for _ in range(frames):
        q = rng.uniform(0.0, 1.0, 4)
        points = twins.markers_of(leg, q, np.eye(3), np.zeros(3))
        lower = _equations(leg, q, np.eye(3), np.zeros(3), points, np.full(15, 1e2))[1]
        blocks.append(np.tril(lower) + np.tril(lower, -1).T)
        arrays = leg.arrays
        pairs = [(k, arrays.row_columns[p]) for k in range(10) for p in range(arrays.row_starts[k], arrays.row_starts[k + 1])]
        entries.append([*np.diag(lower), *(lower[k, j] for k, j in pairs)])
    penalties, right, steps = rng.uniform(0.1, 1e4, 10), rng.normal(0, 1, (frames, 10)), np.empty((frames, 10))
    smoothing_step(leg.arrays, np.array(entries), penalties, right, 1000, steps)
    expected = np.linalg.solve(twins.smoothing_matrix(np.array(blocks), penalties), right.ravel()).reshape(frames, 10)
    assert np.allclose(steps, expected, atol=2e-3 * np.abs(expected).max())


def test_a_courses_likelihood_and_variances_are_those_of_its_covariance() -> None:
    rng = np.random.default_rng(8)
    noise, ratio, values = rng.uniform(0.5, 2.0, 14), 0.3, rng.normal(0, 1, 14).cumsum()
    bends = twins.second_differences(14)
    # Second differences tell all but the course's own straight line, which the diffuse start takes.
    covariance = bends @ np.diag(noise) @ bends.T + ratio * np.eye(12)
    seen = bends @ values
    scale = seen @ np.linalg.solve(covariance, seen) / 12
    other = likelihood(values, noise, 3.0)
    covariance_3 = bends @ np.diag(noise) @ bends.T + 3.0 * np.eye(12)
    scale_3 = seen @ np.linalg.solve(covariance_3, seen) / 12
    gain = np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(covariance_3)[1] + 12 * np.log(scale / scale_3)
    found = likelihood(values, noise, ratio)
    assert found[1] == pytest.approx(scale, rel=1e-5)
    assert found[0] - other[0] == pytest.approx(gain, rel=1e-5)
    out = np.empty(14)
    smoothed_variances(noise, ratio, out)
    assert np.allclose(out, np.diag(np.linalg.inv(np.diag(1 / noise) + bends.T @ bends / ratio)), rtol=1e-4)


def _walk(tree: KinematicTree, frames: int, rate: float, rng: np.random.Generator, turn: np.ndarray) -> tuple[np.ndarray, Recording]:
    """Coordinates (T, Q) rad that swing within their ranges, and a recording of the markers, the body turned by `turn` (3, 3)."""
    low, high = np.radians(-20), np.radians(40)
    time = np.arange(frames)[:, None] / rate
    swing = np.sin(2 * np.pi * (rng.uniform(0.3, 1.2, len(tree.coordinates)) * time + rng.uniform(0, 1, len(tree.coordinates))))
    within = np.array([(max(c.low, low), min(c.high, high)) for c in tree.coordinates])
    q = within.mean(axis=1) + 0.45 * (within[:, 1] - within[:, 0]) * swing
    at = np.array([[1.2 * t, 0.3 * np.sin(t), 1.0] for t in time[:, 0]])
    positions = np.array([twins.markers_of(tree, q[t], turn, at[t]) for t in range(frames)])
    return q, Recording(positions, tree.labels, rate)


@pytest.mark.parametrize("turn", [(0, 0, 2.5), (0, 1.6, 0), (3.1, 0, 0.4)], ids=["walking", "lying", "upside down"])
def test_a_movement_without_noise_is_found_again(turn) -> None:
    tree = tree_of(load_body("plug-in-gait"))
    q, recording = _walk(tree, 60, 100.0, np.random.default_rng(1), Rotation.from_rotvec(turn).as_matrix())
    free = KinematicTree(tree.bones, tuple(Coordinate(c.name, c.usual) for c in tree.coordinates), tree.markers, starts=tree.starts)
    found = solve_kinematics(free, recording, rules=GAUSS)
    # Smoothing is as strong as the course is smooth, and here it is: what it moves is far below a tenth of a degree.
    assert np.degrees(np.abs(found.coordinates - q)).max() < 0.1
    assert np.nanmax(found.misses) < 1e-3


def test_too_few_markers_are_refused() -> None:
    tree = tree_of(load_body("plug-in-gait"))
    with pytest.raises(AsterismError, match="no frame shows three of its markers"):
        solve_kinematics(tree, Recording(np.zeros((5, 2, 3)), ("LASI", "RASI"), 100.0))
