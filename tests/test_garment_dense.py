"""Points of a garment from identified circles: right to their own covariance, and wrong circles are left out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import twins_garment as twins
from garment_scenes import arm_rig, photos, sleeve, true_positions
from hypothesis import given
from hypothesis import strategies as st

from asterism.errors import AsterismError
from asterism.garment.dense import DenseRules, dense_points, fused_midpoints
from asterism.garment.dense import _kernels as kernels
from asterism.garment.dense.points import circle_rays, ray_points, ray_scale
from asterism.simulation.garment import SimulatedCircles, simulated_reading

pytestmark = pytest.mark.kernels

CLEAN = DenseRules(least_sigma=0.0, least_scale=0.05)


def readings(noise: float = 0.1, wrong: float = 0.0, astray: float = 0.0, seed: int = 0) -> list[SimulatedCircles]:
    return [simulated_reading(photo.truth, noise, wrong, astray, rng=np.random.default_rng([seed, i])) for i, photo in enumerate(photos())]


def errors(points) -> np.ndarray:
    true = true_positions(sleeve())
    return points.positions - np.array([true[i] for i in points.ids.tolist()])


def test_exact_circles_give_exact_points() -> None:
    points = dense_points(arm_rig(), readings(noise=0.0), replace(CLEAN, least_sigma=0.1))
    assert len(points) == points.seen > 100
    assert np.abs(errors(points)).max() < 1e-8
    ids, rough = fused_midpoints(arm_rig(), readings(noise=0.0))
    np.testing.assert_array_equal(ids, points.ids)
    assert np.abs(rough - points.positions).max() < 1e-6


def test_errors_are_as_large_as_the_covariance_says() -> None:
    """Of eight draws of the noise: squared errors, divided by their covariance, have a mean of 3, to a tenth of its root."""
    found = [dense_points(arm_rig(), readings(seed=seed), CLEAN) for seed in range(8)]
    normalised = np.concatenate([np.einsum("ni,nij,nj->n", errors(p), np.linalg.inv(p.covariance), errors(p)) for p in found])
    assert abs(np.sqrt(normalised.mean() / 3) - 1) < 0.1, np.sqrt(normalised.mean() / 3)
    rms = np.sqrt(np.mean([np.square(errors(p)).sum(axis=1).mean() for p in found]))
    assert rms < 0.0006, f"{1000 * rms:.3f} mm, allowed 0.6"


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_the_scale_of_a_readers_covariance_is_found(factor: float) -> None:
    stated = [replace(read, covariance=factor * read.covariance) for read in readings()]
    points = dense_points(arm_rig(), stated, CLEAN)
    assert abs(points.scale * np.sqrt(factor) - 1) < 0.15
    right = dense_points(arm_rig(), readings(), CLEAN)
    np.testing.assert_array_equal(points.ids, right.ids)
    np.testing.assert_allclose(points.covariance, right.covariance, rtol=1e-6)


def test_rays_made_once_give_the_same_scale_and_points() -> None:
    rays = circle_rays(arm_rig(), readings(), CLEAN)
    scale = ray_scale(arm_rig(), rays, CLEAN)
    assert scale == dense_points(arm_rig(), readings(), CLEAN).scale != 1.0
    made, known = ray_points(arm_rig(), rays, CLEAN, scale), dense_points(arm_rig(), readings(), CLEAN, scale=scale)
    for name in ("ids", "positions", "covariance", "misfit", "rejected"):
        np.testing.assert_array_equal(getattr(made, name), getattr(known, name))
    with pytest.raises(AsterismError, match="2 images for a rig of 3"):
        circle_rays(arm_rig(), readings()[:2], CLEAN)


def test_a_small_misfit_does_not_shrink_the_covariance() -> None:
    stated = [replace(read, covariance=4.0 * read.covariance) for read in readings()]
    assert dense_points(arm_rig(), stated).scale == 1.0


def test_flat_ellipses_count_less() -> None:
    """A reader that tells axes: the same centres, of ellipses 2 px high in one image, have a larger covariance there, and only there."""

    @dataclass(frozen=True)
    class WithAxes:
        centres: np.ndarray
        covariance: np.ndarray
        ids: np.ndarray
        axes: np.ndarray

    reads = readings()
    high, flat = (
        [WithAxes(r.centres, r.covariance, r.ids, np.tile([3.0, half, 0.0], (len(r.ids), 1))) for r in reads] for half in (3.0, 1.0)
    )
    round_points, flat_points = dense_points(arm_rig(), high, scale=1.0), dense_points(arm_rig(), flat, scale=1.0)
    common = np.isin(round_points.ids, flat_points.ids)
    volume = np.linalg.det(flat_points.covariance[np.isin(flat_points.ids, round_points.ids)]) / np.linalg.det(
        round_points.covariance[common]
    )
    assert (volume > 20).all()
    without = dense_points(arm_rig(), reads, scale=1.0)
    assert np.trace(without.covariance, axis1=1, axis2=2).sum() < np.trace(round_points.covariance, axis1=1, axis2=2).sum()


def test_wrong_circles_are_left_out_where_others_tell() -> None:
    """One circle in a hundred elsewhere or with another's identity: no point of three cameras is off by its noise times ten."""
    rig, clean = arm_rig(), dense_points(arm_rig(), readings(), CLEAN)
    points = dense_points(rig, readings(wrong=0.01, astray=0.02), CLEAN)
    assert len(points.rejected) > 0
    far = np.linalg.norm(errors(points), axis=1) > 10 * np.sqrt(np.trace(points.covariance, axis1=1, axis2=2))
    assert not (far & (points.cameras >= 3)).any()
    assert len(points) > 0.93 * len(clean)
    loose = dense_points(rig, readings(wrong=0.01, astray=0.02), DenseRules(outlier=0.0))
    assert np.linalg.norm(errors(loose), axis=1).max() > 0.01 > np.linalg.norm(errors(points)[points.cameras >= 3], axis=1).max()


def test_an_identity_that_an_image_shows_twice_is_left_out_there() -> None:
    reads = readings()
    first = reads[0]
    doubled = SimulatedCircles(
        np.concatenate([first.centres, first.centres[:1] + 40]),
        np.concatenate([first.covariance, first.covariance[:1]]),
        np.concatenate([first.ids, first.ids[:1]]),
    )
    points = dense_points(arm_rig(), [doubled, *reads[1:]], CLEAN)
    assert points.duplicates.tolist() == [[0, int(first.ids[0])]]
    before = dense_points(arm_rig(), reads, CLEAN)
    assert len(before) - len(points) <= 1
    assert (points.cameras[points.ids == first.ids[0]] == before.cameras[before.ids == first.ids[0]] - 1).all()


def test_few_circles_or_none() -> None:
    nothing = SimulatedCircles(np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0, dtype=np.int32))
    assert len(dense_points(arm_rig(), [nothing] * 3)) == 0
    reads = readings()
    alone = dense_points(arm_rig(), [reads[0], nothing, nothing])
    assert len(alone) == alone.seen == 0
    unknown = replace(reads[0], ids=np.full_like(reads[0].ids, -1))
    assert len(dense_points(arm_rig(), [unknown, unknown, unknown])) == 0
    lost = replace(reads[0], centres=np.full_like(reads[0].centres, np.nan))
    assert dense_points(arm_rig(), [lost, *reads[1:]]).seen > 50
    with pytest.raises(AsterismError, match="2 images for a rig of 3 cameras"):
        dense_points(arm_rig(), reads[:2])


def test_cameras_in_another_order_give_the_same_points() -> None:
    reads, rig = readings(), arm_rig()
    points = dense_points(rig, reads, CLEAN)
    turned = dense_points(rig.select(["c3", "c1", "c2"]), [reads[2], reads[0], reads[1]], CLEAN)
    np.testing.assert_array_equal(points.ids, turned.ids)
    np.testing.assert_allclose(points.positions, turned.positions, atol=1e-9)


@given(st.integers(0, 10_000))
def test_midpoints_equal_their_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    starts = np.cumsum([0, *rng.integers(0, 5, 4)])
    origins, rays = rng.normal(size=(starts[-1], 3)), rng.normal(size=(starts[-1], 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    if starts[-1] > 1:
        rays[1] = rays[0]
    out = np.empty((4, 3))
    kernels.fuse_midpoints(origins, rays, starts, 0.03, out)
    np.testing.assert_allclose(out, twins.fuse_midpoints(origins, rays, starts, 0.03), rtol=1e-6, atol=1e-9)


@given(st.integers(0, 10_000))
def test_a_refined_point_has_no_better_one_around_it(seed: int) -> None:
    """The twin is the definition: the weighted sum of squares at the point, and nowhere a smaller one; covariance from its curvature."""
    rng = np.random.default_rng(seed)
    rig, n = arm_rig(), 3
    turns, shifts = np.array([c.rotation for c in rig]), np.array([c.translation for c in rig])
    truth = np.mean([c.position for c in rig], axis=0) + 0.8 * rig.cameras[1].rotation[2] + 0.05 * rng.normal(size=3)
    inside = np.einsum("cij,j->ci", turns, truth) + shifts
    seen = inside[:, :2] / inside[:, 2:] + 2e-4 * rng.normal(size=(n, 2))
    roots = 3e3 * (np.eye(2) + 0.2 * rng.normal(size=(n, 2, 2)))
    information = roots @ roots.transpose(0, 2, 1)

    def cost(point: np.ndarray) -> float:
        camera = turns @ point + shifts
        off = seen - camera[:, :2] / camera[:, 2:]
        return float(np.einsum("ci,cij,cj->", off, information, off))

    points, used = truth[None] + 0.001, np.ones(n, dtype=np.bool_)
    covariance, left = np.empty((1, 6)), np.empty(1)
    weight = information.reshape(-1, 4)[:, [0, 1, 3]]
    limits, rules, rows = np.full(20, np.inf), np.array([20, 1e-10, 0.05]), np.array([0, n])
    flat = np.ascontiguousarray(weight)
    kernels.refine_points(turns, shifts, seen, flat, np.arange(n), rows, limits, rules, points, used, covariance, left)
    assert left[0] == pytest.approx(cost(points[0]), rel=1e-9)
    for step in np.concatenate([np.eye(3), -np.eye(3)]):
        assert cost(points[0] + 1e-5 * step) > left[0]
    full = covariance[0, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3)
    h, axes = 1e-4, np.eye(3)

    def mixed(a: np.ndarray, b: np.ndarray) -> float:
        signs = ((1, 1), (1, -1), (-1, 1), (-1, -1))
        return sum(s * t * cost(points[0] + h * (s * a + t * b)) for s, t in signs) / (8 * h * h)

    curvature = np.array([[mixed(a, b) for b in axes] for a in axes])
    np.testing.assert_allclose(np.linalg.inv(curvature), full, rtol=0.05, atol=0.02 * full.max())
