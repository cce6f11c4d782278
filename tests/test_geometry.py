"""Geometry: kernels equal their plain twins, rotations never mirror, and degenerate input is answered as the docstrings say."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import twins_geometry as twins
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from asterism.geometry import (
    align_about_z,
    best_rotation,
    cross_matrix,
    fit_rigid,
    intersect_rays,
    nearest_orthogonal,
    nearest_point_to_lines,
    place_objects,
    rotate_z_up,
    rotation_from_vector,
    shared_kernels,
    vector_from_rotation,
    z_up_rotation,
)

pytestmark = pytest.mark.kernels

seeds = st.integers(0, 2**32 - 1)
coordinates = st.floats(-1.0, 1.0)
verticals = st.tuples(coordinates, coordinates, coordinates).filter(lambda v: np.linalg.norm(v) > 0.1)


def assert_rotation(matrix):
    assert np.allclose(matrix @ np.swapaxes(matrix, -1, -2), np.eye(3), atol=1e-12), "not orthogonal"
    assert np.allclose(np.linalg.det(matrix), 1.0, atol=1e-12), "a reflection"


def moved(rng, points):
    rotation = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    translation = rng.normal(size=3)
    return points @ rotation.T + translation, rotation, translation


# --- rotations


@given(verticals)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_the_z_up_rotation_lifts_the_vertical_by_the_shortest_way(vertical):
    up = np.array(vertical) / np.linalg.norm(vertical)
    rotation = z_up_rotation(up)
    assert_rotation(rotation)
    assert np.allclose(rotation @ up, [0, 0, 1], atol=1e-9)
    angle = np.linalg.norm(vector_from_rotation(rotation))
    assert angle == pytest.approx(np.arccos(np.clip(up[2], -1.0, 1.0)), abs=1e-6), "not the shortest way"
    points = np.random.default_rng(0).normal(size=(5, 3))
    assert np.allclose(rotate_z_up(points, up), points @ rotation.T, atol=1e-12)


@pytest.mark.parametrize("vertical", np.concatenate([np.eye(3), -np.eye(3)]), ids=["x", "y", "z", "-x", "-y", "-z"])
def test_axes_are_turned_exactly(vertical):
    rotation = z_up_rotation(vertical)
    assert_rotation(rotation)
    assert np.array_equal(np.abs(rotation).sum(axis=0), [1.0, 1.0, 1.0]), "an axis goes to an axis without rounding"
    points = np.random.default_rng(0).normal(size=(5, 3))
    assert np.array_equal(rotate_z_up(points, vertical), points @ rotation.T)


def test_points_that_are_z_up_are_not_copied():
    points = np.zeros((2, 3))
    assert rotate_z_up(points, np.array([0.0, 0.0, 1.0])) is points


@given(seeds)
@settings(max_examples=40, deadline=None, derandomize=True)
def test_rotation_vectors_come_back(seed):
    rng = np.random.default_rng(seed)
    vector = rng.normal(size=3)
    vector *= rng.uniform(0.0, 3.1) / np.linalg.norm(vector)
    rotation = rotation_from_vector(vector)
    assert_rotation(rotation)
    assert np.allclose(vector_from_rotation(rotation), vector, atol=1e-9)
    assert np.allclose(rotation @ vector, vector, atol=1e-12), "the axis does not stay"


def test_the_nearest_orthogonal_matrix_keeps_a_reflection():
    turn = rotation_from_vector([0.1, 0.2, 0.3])
    rounded = np.round(np.stack([turn, turn @ np.diag([1.0, 1.0, -1.0])]), 4)
    nearest = nearest_orthogonal(rounded)
    assert np.abs(nearest - rounded).max() < 1e-4
    assert np.allclose(nearest @ nearest.swapaxes(1, 2), np.eye(3), atol=1e-12)
    assert np.allclose(np.linalg.det(nearest), [1.0, -1.0])


def test_the_cross_matrix_multiplies_as_the_cross_product():
    one, other = np.random.default_rng(1).normal(size=(2, 3))
    assert np.allclose(cross_matrix(one) @ other, np.cross(one, other), atol=1e-15)


@given(seeds, st.booleans(), st.sampled_from([0.0, 1e-12, 1e-6, 0.3, 3.0]))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_rotate_by_equals_its_twin(seed, own_axes, angle):
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    vector = rng.normal(size=3)
    vector *= angle / np.linalg.norm(vector)
    expected = twins.rotate_by(rotation, vector, own_axes)
    shared_kernels.rotate_by(rotation, *vector, own_axes)
    assert np.allclose(rotation, expected, atol=1e-12)
    assert_rotation(rotation)


# --- rigid motions


@given(seeds, st.integers(3, 12), st.floats(0.0, 0.3))
@settings(max_examples=60, deadline=None, derandomize=True)
def test_the_best_rotation_equals_its_twin_by_quaternions(seed, count, noise):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3))
    targets, _, _ = moved(rng, points)
    targets += noise * rng.normal(size=targets.shape)
    rotation, translation = fit_rigid(points, targets)
    assert_rotation(rotation)
    centred, aims = points - points.mean(axis=0), targets - targets.mean(axis=0)
    expected = twins.best_rotation_by_quaternion(centred, aims)
    assert np.trace(rotation.T @ aims.T @ centred) == pytest.approx(np.trace(expected.T @ aims.T @ centred), rel=1e-9)
    assert np.allclose(points.mean(axis=0) @ rotation.T + translation, targets.mean(axis=0), atol=1e-12)


@given(seeds, st.sampled_from(["weighted", "frames", "about z"]))
@settings(max_examples=30, deadline=None, derandomize=True)
def test_a_rigid_motion_is_found_again(seed, way):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(6, 3))
    targets, rotation, translation = moved(rng, points)
    if way == "weighted":
        targets[0] += 100.0
        found = fit_rigid(points, targets, np.array([0.0, 1.0, 2.0, 0.5, 1.0, 1.0]))
    elif way == "frames":
        turned, placed = place_objects(points, np.stack([targets, points]))
        assert np.allclose(turned[1], np.eye(3), atol=1e-9) and np.allclose(placed[1], 0.0, atol=1e-9)
        found = turned[0], placed[0]
    else:
        about_z = rotation_from_vector([0.0, 0.0, rng.uniform(-3, 3)])
        frames = (points @ about_z.T + translation)[None]
        assert np.allclose(align_about_z(frames, points)[0], points, atol=1e-9)
        return
    assert np.allclose(found[0], rotation, atol=1e-9) and np.allclose(found[1], translation, atol=1e-9)


def test_mirrored_points_are_not_laid_on_by_a_reflection():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(8, 3))
    rotation, _ = fit_rigid(points, points * [1.0, 1.0, -1.0])
    assert_rotation(rotation)


@pytest.mark.parametrize(
    "points",
    [np.outer(np.arange(4.0), [1.0, 2.0, -1.0]), np.ones((4, 3)), np.eye(3)[:2], np.ones((1, 3)), np.eye(3)],
    ids=["collinear", "coincident", "two points", "one point", "three points"],
)
def test_degenerate_points_still_give_a_rotation_that_fits(points):
    rng = np.random.default_rng(4)
    targets, _, _ = moved(rng, points)
    rotation, translation = fit_rigid(points, targets)
    assert_rotation(rotation)
    assert np.allclose(points @ rotation.T + translation, targets, atol=1e-9)


def test_nothing_to_fit_leaves_the_rotation_at_identity():
    assert np.array_equal(best_rotation(np.zeros((3, 3))), np.eye(3))


@pytest.mark.parametrize(("template", "needed"), [(np.eye(3), 3), (np.outer([0.0, 1.0, 3.0], [1.0, 0.0, 0.0]), 2)], ids=["plane", "line"])
def test_frames_with_too_few_points_are_not_placed(template, needed):
    frames = np.tile(template, (4, 1, 1))
    for missing in range(4):
        frames[missing, :missing] = np.nan
    turned, placed = place_objects(template, frames)
    placeable = 3 - np.arange(4) >= needed
    assert np.array_equal(np.isfinite(turned).all(axis=(1, 2)), placeable)
    assert np.array_equal(np.isfinite(placed).all(axis=1), placeable)
    assert_rotation(turned[placeable])


@given(seeds, st.integers(1, 8))
@settings(max_examples=60, deadline=None, derandomize=True)
def test_aligning_about_z_equals_its_twin_in_both_forms(seed, count):
    rng = np.random.default_rng(seed)
    points, template = rng.normal(size=(10, 3)), rng.normal(size=(9, 3))
    rows, markers = rng.permutation(10)[:count], rng.permutation(9)[:count]
    turn, here, there = twins.fit_about_z(points[rows], template[markers])
    cos, sin, start, goal = shared_kernels.fit_about_z(points, rows, template, markers)
    assert cos * cos + sin * sin == pytest.approx(1.0)
    assert np.allclose(start, here) and np.allclose(goal, there)
    if count == 1:
        return
    assert np.allclose([[cos, -sin], [sin, cos]], turn[:2, :2], atol=1e-9)
    out = np.empty_like(points)
    shared_kernels.align_about_z(points, rows, template, markers, out)
    assert np.allclose(out, (points - here) @ turn.T + there, atol=1e-9)
    frame, wanted = np.full((1, 9, 3), np.nan), np.full((9, 3), np.nan)
    frame[0, markers], wanted[markers] = points[rows], template[markers]
    assert np.allclose(align_about_z(frame, wanted)[0, markers], out[rows], atol=1e-9)


def test_points_above_each_other_are_not_turned_about_z():
    points = np.array([[1.0, 2.0, 0.0], [1.0, 2.0, 1.0]])
    rows = np.arange(2)
    assert shared_kernels.fit_about_z(points, rows, points + 3.0, rows)[:2] == (1.0, 0.0)


# --- rays and small matrices


@given(seeds)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_cofactors_equal_their_twin(seed):
    matrix = np.random.default_rng(seed).normal(size=(3, 3))
    matrix = matrix + matrix.T
    assert np.allclose(shared_kernels.cofactors(*matrix.ravel()), twins.cofactors(matrix), atol=1e-9)


@given(seeds)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_the_symmetric_inverse_equals_numpys(seed):
    root = np.random.default_rng(seed).normal(size=(4, 3))
    matrix = root.T @ root
    upper = np.triu_indices(3)
    determinant, *found = shared_kernels.symmetric_inverse(matrix[upper])
    assert determinant == pytest.approx(np.linalg.det(matrix), rel=1e-6)
    assert np.allclose(found, np.linalg.inv(matrix)[upper], rtol=1e-6)


@pytest.mark.parametrize("h", [np.zeros(6), np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0]), np.array([-1.0, 0, 0, 1.0, 0, 1.0])])
def test_a_matrix_without_positive_determinant_has_no_inverse(h):
    assert shared_kernels.symmetric_inverse(h) == (0.0,) * 7


@given(seeds)
@settings(max_examples=40, deadline=None, derandomize=True)
def test_rays_meet_where_their_twin_says(seed):
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, 5, size=6)
    starts = np.concatenate([[0], np.cumsum(counts)])
    origins, rays = rng.normal(size=(2, starts[-1], 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rays[rng.random(len(rays)) < 0.2] = np.nan
    found = intersect_rays(origins, rays, starts)
    for group, (first, last) in enumerate(pairwise(starts)):
        counted = np.isfinite(rays[first:last, 0])
        if counted.sum() < 2:
            assert np.isnan(found[group]).all()
            continue
        expected = twins.nearest_to_rays(origins[first:last][counted], rays[first:last][counted])
        assert np.allclose(found[group], expected, atol=1e-6)
        assert np.allclose(nearest_point_to_lines(origins[first:last][counted], rays[first:last][counted]), expected, atol=1e-6)


def test_parallel_rays_do_not_meet():
    origins, rays = np.eye(3), np.tile([0.0, 0.0, 1.0], (3, 1))
    assert np.isnan(intersect_rays(origins, rays, np.array([0, 3]))).all()
    assert np.allclose(nearest_point_to_lines(origins, rays), [1 / 3, 1 / 3, 0.0]), "the best point nearest to the world's origin"
    assert shared_kernels.where_lines_approach(*rays[0], *rays[0], 1.0, 0.0, 0.0) == (0.0, 0.0, False)


@given(seeds)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_two_lines_approach_where_their_twin_says(seed):
    d, e, o = np.random.default_rng(seed).normal(size=(3, 3))
    s, t, crossing = shared_kernels.where_lines_approach(*d, *e, *o)
    assert crossing
    assert np.allclose([s, t], twins.where_lines_approach(d, e, o), rtol=1e-6, atol=1e-6)
