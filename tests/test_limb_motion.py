"""Rigid motion of limbs: kernels against twins and SciPy, methods against the bones of simulated people, careless input."""

from __future__ import annotations

import numpy as np
import pytest
import twins_motion as twins
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from asterism import AsterismError
from asterism.motion.rigid import (
    METHODS,
    LimbMotion,
    angular_velocity,
    estimate_limb_motion,
    helical_axes,
    quaternions,
    relative_rotations,
    rotation_vectors,
)
from asterism.motion.rigid._kernels import eigenvalue_weights, fit_frames, local_positions, point_spread
from asterism.simulation.soft_tissue import TrialPlan, simulate_soft_tissue

pytestmark = pytest.mark.kernels

SEEDS = st.integers(0, 2**32 - 1)


def moved(rng: np.random.Generator, frames: int, points: int, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A random limb in random places: template, positions, rotations, translations."""
    template = rng.normal(0, 0.1, (points, 3))
    rotations = Rotation.random(frames, random_state=int(rng.integers(2**31))).as_matrix()
    translations = rng.normal(0, 1, (frames, 3))
    positions = np.einsum("tij,nj->tni", rotations, template) + translations[:, None]
    return template, positions + rng.normal(0, noise, positions.shape), rotations, translations


def turn_between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Degrees between two rotations over time, each since its first frame, in the world's axes."""
    a, b = one @ one[0].T, other @ other[0].T
    return np.degrees(np.linalg.norm(rotation_vectors(np.einsum("tij,tkj->tik", a, b)), axis=1))


@given(SEEDS)
def test_the_fit_is_kabschs_with_weights_and_gaps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    template, positions, _, _ = moved(rng, 6, 7, 0.02)
    positions[rng.random((6, 7)) < 0.3] = np.nan
    weights = rng.random((6, 7)) * (rng.random((6, 7)) > 0.1)
    rotations, translations = np.empty((6, 3, 3)), np.empty((6, 3))
    fit_frames(template, positions, weights, 1e-9, rotations, translations)
    for t in range(6):
        rotation, translation = twins.fit_frame(template, positions[t], weights[t])
        np.testing.assert_allclose(rotations[t], rotation, atol=1e-7)
        np.testing.assert_allclose(translations[t], translation, atol=1e-7)


@given(SEEDS)
def test_the_fit_is_scipys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    template, positions, _, _ = moved(rng, 1, 9, 0.03)
    weights = rng.random(9) + 0.01
    rotations, translations = np.empty((1, 3, 3)), np.empty((1, 3))
    fit_frames(template, positions, weights[None], 1e-9, rotations, translations)
    here, there = weights @ template / weights.sum(), weights @ positions[0] / weights.sum()
    scipys = Rotation.align_vectors(positions[0] - there, template - here, weights=weights)[0].as_matrix()
    np.testing.assert_allclose(rotations[0], scipys, atol=1e-7)


def test_a_mirrored_limb_is_never_reflected() -> None:
    template = np.random.default_rng(0).normal(0, 0.1, (8, 3))
    rotations, translations = np.empty((1, 3, 3)), np.empty((1, 3))
    fit_frames(template, (template * [1, 1, -1])[None].copy(), np.ones((1, 8)), 1e-9, rotations, translations)
    assert np.linalg.det(rotations[0]) == pytest.approx(1.0, abs=1e-9)


@given(SEEDS)
def test_spread_and_local_positions_are_those_of_the_twins(seed: int) -> None:
    rng = np.random.default_rng(seed)
    _, positions, rotations, translations = moved(rng, 5, 4, 0.05)
    positions[rng.random((5, 4)) < 0.4] = np.nan
    local = np.empty_like(positions)
    local_positions(positions, rotations, translations, local)
    np.testing.assert_allclose(local, twins.local_positions(positions, rotations, translations), atol=1e-12)
    means, squares, counts = np.empty((4, 3)), np.empty(4), np.empty(4, dtype=np.int64)
    point_spread(positions, rotations, translations, means, squares, counts)
    expected = twins.point_spread(positions, rotations, translations)
    for found, wanted in zip((means, squares, counts), expected, strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_eigenvalue_weights_keep_the_eigenvalues_and_drop_the_point_that_moves() -> None:
    rng = np.random.default_rng(3)
    reference = rng.normal(0, 0.1, (20, 3))
    local = reference[None].copy()
    local[0, 4] += [0.05, 0.02, -0.04]
    before, after = (twins.inertia(points, np.ones(20)) for points in (reference, local[0]))
    weights = np.zeros((1, 20))
    eigenvalue_weights(local, reference, 5, weights)
    assert weights[0].sum() == pytest.approx(20)
    left = np.abs(twins.inertia(local[0], weights[0]) - twins.inertia(reference, weights[0])).max()
    assert left < 0.05 * np.abs(after - before).max()
    assert weights[0, 4] < 0.5 and np.delete(weights[0], 4).min() > 0.6


@pytest.mark.parametrize("method", METHODS)
def test_a_rigid_limb_with_gaps_is_followed_exactly_by_all_methods(method: str) -> None:
    rng = np.random.default_rng(1)
    _, positions, rotations, translations = moved(rng, 30, 9)
    positions[:15, 2] = np.nan
    positions[0, 5] = np.nan
    positions[20, 3:] = np.nan
    positions[21, 2:] = np.nan
    motion = estimate_limb_motion(positions, method)
    known = np.isfinite(motion.rotations[:, 0, 0])
    assert (~known).nonzero()[0].tolist() == [21]
    since = rotations @ rotations[motion.reference].T
    np.testing.assert_allclose(motion.rotations[known], since[known], atol=1e-6)
    carried = np.einsum("tij,tj->ti", since, np.tile(translations[motion.reference], (30, 1)))
    np.testing.assert_allclose((motion.translations + carried)[known], translations[known], atol=1e-6)
    assert np.nanmax(motion.residuals) < 1e-6


@pytest.mark.parametrize("sparse", [False, True])
def test_limbs_under_moving_skin_turn_as_their_bones(sparse: bool) -> None:
    plan = TrialPlan("knee", subject=2, points=8 if sparse else 400, sparse=sparse, noise_m=0.0005)
    trial = simulate_soft_tissue(plan, seed=5)
    for limb in (0, 1):
        points = trial.recording.positions[:, trial.limb_of == limb]
        error = turn_between(estimate_limb_motion(points).rotations, trial.rotations[limb])
        assert error.mean() < (1.5 if sparse else 0.6), f"limb {limb}: {error.mean():.2f} degrees"


def test_two_points_of_another_limb_do_not_drag_the_robust_fit_as_they_drag_the_plain_one() -> None:
    trial = simulate_soft_tissue(TrialPlan("knee", points=60, noise_m=0.0), seed=2)
    own = np.nonzero(trial.limb_of == 0)[0]
    other = np.nonzero(trial.limb_of == 1)[0]
    points = trial.recording.positions[:, [*own, *other[:4]]]
    errors = {m: turn_between(estimate_limb_motion(points, m).rotations, trial.rotations[0]).mean() for m in ("svd", "robust")}
    assert errors["robust"] < 0.5 < 2 * errors["robust"] + 0.5 < errors["svd"], errors


def test_a_limb_that_never_moves_has_no_rotation() -> None:
    template = np.random.default_rng(0).normal(0, 0.1, (6, 3))
    motion = estimate_limb_motion(np.tile(template, (10, 1, 1)))
    np.testing.assert_allclose(motion.rotations, np.tile(np.eye(3), (10, 1, 1)), atol=1e-9)


def test_points_far_from_the_origin_cost_no_digits() -> None:
    _, positions, rotations, _ = moved(np.random.default_rng(2), 10, 6)
    near, far = estimate_limb_motion(positions), estimate_limb_motion(positions + 1000.0)
    np.testing.assert_allclose(near.rotations, far.rotations, atol=1e-6)
    assert turn_between(far.rotations, rotations).max() < 1e-4


def test_input_that_has_no_rotation_is_refused_in_a_sentence() -> None:
    rng = np.random.default_rng(0)
    line = np.linspace(0, 1, 5)[:, None] * np.array([[0.1, 0.2, 0.3]])
    good = rng.normal(0, 0.1, (4, 5, 3))
    cases = [
        (good[:, :2], {}, "at least three points"),
        (np.tile(line, (4, 1, 1)), {}, "in a line"),
        (np.full((4, 5, 3), np.nan), {}, "at most 0"),
        (np.where(np.arange(5)[:, None] < 2, good, np.nan), {}, "at most 2"),
        (good, {"weights": [1, 1, np.inf, 1, 1]}, "not finite"),
        (good, {"weights": [1, 1, -1, 1, 1]}, "negative"),
        (good, {"weights": [1, 1, 0, 0, 0]}, "fewer than three"),
        (good, {"weights": [1.0]}, "weights for 5 points"),
        (good[0], {}, "expected"),
        (np.where(np.arange(5)[:, None] < 4, good, np.inf), {}, "infinite"),
        (good, {"method": "magic"}, "no method"),
    ]
    for positions, options, sentence in cases:
        with pytest.raises(AsterismError, match=sentence):
            estimate_limb_motion(positions, **options)


def test_the_order_of_equation_5_changes_the_axis_but_not_the_angle() -> None:
    """Both limbs turn with the body; the joint is a hinge about x. Printed, its axis wanders; corrected, it stays."""
    time = np.linspace(0, 1, 20)
    body = Rotation.from_rotvec(np.stack([0 * time, 0 * time, 2 * time], axis=1)).as_matrix()
    child = body @ Rotation.from_rotvec(np.stack([time, 0 * time, 0 * time], axis=1)).as_matrix()
    corrected = rotation_vectors(relative_rotations(body, child))
    printed = rotation_vectors(np.einsum("tij,tkj->tik", child, body))
    np.testing.assert_allclose(np.linalg.norm(printed, axis=1), np.linalg.norm(corrected, axis=1), atol=1e-12)
    np.testing.assert_allclose(corrected, np.stack([time, 0 * time, 0 * time], axis=1), atol=1e-12)
    assert np.abs(printed[-1] - corrected[-1]).max() > 0.5


def test_quaternions_velocities_and_screws_of_a_known_motion() -> None:
    time = np.arange(50) / 50
    axis = np.array([0.0, 0.6, 0.8])
    rotations = Rotation.from_rotvec(5.0 * time[:, None] * axis).as_matrix()
    point = np.array([0.3, 0.1, -0.2])
    translations = point - rotations @ point + 0.2 * time[:, None] * axis
    np.testing.assert_allclose(angular_velocity(rotations, 50.0), np.tile(5.0 * axis, (50, 1)), atol=1e-9)
    four = quaternions(rotations)
    assert (np.einsum("ti,ti->t", four[1:], four[:-1]) > 0).all()
    np.testing.assert_allclose(four[:, 0], np.cos(2.5 * time), atol=1e-12)
    screws = helical_axes(rotations, translations)
    early = slice(1, 30)
    np.testing.assert_allclose(screws.directions[early], np.tile(axis, (29, 1)), atol=1e-9)
    np.testing.assert_allclose(screws.angles[early], 5.0 * time[early], atol=1e-9)
    np.testing.assert_allclose(screws.shifts[early], 0.2 * time[early], atol=1e-9)
    nearest = point - (point @ axis) * axis
    np.testing.assert_allclose(screws.points[early], np.tile(nearest, (29, 1)), atol=1e-9)
    assert np.isnan(screws.directions[0]).all()


def test_missing_rotations_stay_missing() -> None:
    rotations = np.tile(np.eye(3), (5, 1, 1))
    rotations[2] = np.nan
    velocity = angular_velocity(rotations, 10.0)
    assert np.isnan(velocity[2]).all() and np.isfinite(velocity[[0, 1, 3, 4]]).all()
    assert np.isnan(quaternions(rotations)[2]).all() and np.isnan(helical_axes(rotations, np.zeros((5, 3))).angles[2])
    with pytest.raises(AsterismError, match="rate"):
        angular_velocity(rotations, 0.0)


def test_residuals_and_weights_say_which_points_slide() -> None:
    trial = simulate_soft_tissue(TrialPlan("knee", points=300, noise_m=0.0002), seed=3)
    rows = trial.limb_of == 1
    motion: LimbMotion = estimate_limb_motion(trial.recording.positions[:, rows])
    skin = np.linalg.norm(trial.displacement[:, rows], axis=2).max(axis=0)
    rejected = motion.rejected.mean(axis=0) > 0.5
    assert skin[rejected].mean() > 3 * skin[~rejected].mean()
    assert np.corrcoef(motion.rms, skin)[0, 1] > 0.9
