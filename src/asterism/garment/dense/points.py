"""What the cameras read of a garment at one moment in; its circles in space, each with identity and covariance, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from asterism.cameras import Rig
from asterism.cameras.lens_kernels import pixel_jacobian
from asterism.errors import AsterismError
from asterism.garment.dense import _kernels as kernels
from asterism.recording import Floats, Ints

Bools = NDArray[np.bool_]


class UsedCircles(Protocol):
    """What is used of the circles that were read in one image."""

    @property
    def centres(self) -> Floats:
        """(n, 2) px."""

    @property
    def covariance(self) -> Floats:
        """(n, 2, 2) px2, of the centres."""

    @property
    def ids(self) -> NDArray[np.int32]:
        """(n,) identities, -1 where unknown."""


@dataclass(frozen=True)
class DenseRules:
    """How circles become points.

    outlier     share of right points that lie beyond the bound on a point's sum of squared errors; simulated suits have ten wrong
                centres in a thousand at worst, of which this keeps none that matters (tests/test_garment_dense.py)
    parallel    sine of the angle of two rays below which the paper's mid-point is not taken
    least_sigma px, added to each centre's standard deviation (root of squares): what lens, print, shading and folds leave
    flat        px3, divided by the square of the shorter diameter and added likewise, where a reader gives `axes`. Both were chosen on
                rendered pictures of one frame of a suit, from other places than those that figures are measured from: centres were
                0.05 px off for circles of 6 px, and 0.25 px for those 2 px high
    least_scale factor on all standard deviations, at least: errors in the plane of two cameras and a point leave no misfit, so a small
                misfit is no sign of small errors
    least_depth m, before a camera
    steps       of Gauss and Newton at most
    still       m, of the last step
    """

    outlier: float = 1e-5
    parallel: float = 0.03
    least_sigma: float = 0.038
    flat: float = 1.0
    least_scale: float = 1.0
    least_depth: float = 0.05
    steps: int = 12
    still: float = 1e-7

    @property
    def limits(self) -> Floats:
        """(d + 1,) the largest weighted sum of squares by degrees of freedom, for scale 1."""
        return _limits(self.outlier)


@lru_cache(maxsize=8)
def _limits(outlier: float) -> Floats:
    return np.concatenate([[0.0], chi2.isf(outlier, np.arange(1, 64))])


@dataclass(frozen=True)
class DensePoints:
    """The circles of a garment in space at one moment.

    ids         (m,) int32 ascending
    positions   (m, 3) m
    covariance  (m, 3, 3) m2
    cameras     (m,) how many cameras a point was made from
    misfit      (m,) weighted sum of squared reprojection errors, by `scale`
    scale       factor on the standard deviations of all centres, estimated from the misfit of all points
    seen        how many identities two cameras or more read once each
    duplicates  (camera, identity) pairs that an image showed twice and that were therefore left out
    rejected    (k, 2) place of camera and identity of circles that did not fit the others
    by_camera   (C,) circles of each camera that were used
    """

    ids: NDArray[np.int32]
    positions: Floats
    covariance: Floats
    cameras: Ints
    misfit: Floats
    scale: float
    seen: int
    duplicates: Ints
    rejected: Ints
    by_camera: Ints

    def __len__(self) -> int:
        return len(self.ids)


def dense_points(rig: Rig, circles: Sequence[UsedCircles], rules: DenseRules | None = None, *, scale: float | None = None) -> DensePoints:
    """The points that the cameras of a rig read at one moment.

    circles  one per camera, in the rig's order
    scale    factor on all centres' standard deviations; None estimates it from this moment, where 50 degrees of freedom allow that

    The start is GaMoCap's fused mid-point (2.2): mid-points of all pairs of rays, weighted by the inverse square of the rays' distance.
    That weight favours rays that happen to cross closely, also at a flat angle, where the point is worst known along them; so it serves as
    a start only. The paper's bundle adjustment per frame moves points and leaves cameras alone; points do not then depend on each other,
    so each is adjusted by itself, with every centre's covariance. Circles that do not fit are left out by reprojection, the one first
    without which the others fit best. An identity that an image shows twice is left out in that image.

    covariance of a point: that of the centres, carried to space. Errors of the rig are not in it.

    Raises AsterismError where there is not one set of circles per camera. O(circles).
    """
    rules = rules or DenseRules()
    rays = circle_rays(rig, circles, rules)
    # A moment alone estimates its own factor, and its first fit is a better start for the second.
    if scale is None:
        scale, start = _scale_of(rig, rays, rules, _midpoints(rays, rules))
        return _fitted(rig, rays, rules, scale, start)
    return ray_points(rig, rays, rules, scale)


def ray_scale(rig: Rig, rays: CircleRays, rules: DenseRules) -> float:
    """The factor on all centres' standard deviations that `dense_points` estimates from these rays."""
    return _scale_of(rig, rays, rules, _midpoints(rays, rules))[0]


def ray_points(rig: Rig, rays: CircleRays, rules: DenseRules, scale: float) -> DensePoints:
    """The points that `dense_points` makes of these rays by a known scale."""
    return _fitted(rig, rays, rules, scale, _midpoints(rays, rules))


def fused_midpoints(rig: Rig, circles: Sequence[UsedCircles], rules: DenseRules | None = None) -> tuple[NDArray[np.int32], Floats]:
    """The paper's first guess alone: identities (m,) that two cameras or more read, and points (m, 3) m, NaN where rays are parallel."""
    rays = circle_rays(rig, circles, rules or DenseRules())
    return rays.ids, _midpoints(rays, rules or DenseRules())


@dataclass(frozen=True)
class CircleRays:
    """Circles that two or more cameras read, sorted by identity.

    ids         (m,) int32 ascending
    starts      (m + 1,) where the rays of each identity begin
    camera      (n,) place of a ray's camera in the rig
    seen        (n, 2) undistorted, on the normalised plane
    weight      (n, 3) inverse covariance there: xx, xy, yy
    origins     (n, 3) m, of the rays
    directions  (n, 3) of length 1
    duplicates  (k, 2) camera and identity of circles that an image showed twice
    """

    ids: NDArray[np.int32]
    starts: Ints
    camera: Ints
    seen: Floats
    weight: Floats
    origins: Floats
    directions: Floats
    duplicates: Ints


def circle_rays(rig: Rig, circles: Sequence[UsedCircles], rules: DenseRules) -> CircleRays:
    """The rays of the identities that two cameras or more read once each.

    Raises AsterismError where there is not one set of circles per camera.
    """
    if len(circles) != len(rig):
        raise AsterismError(f"{len(circles)} images for a rig of {len(rig)} cameras; give one per camera, in the rig's order.")
    parts, twice = [], []
    for number, (camera, read) in enumerate(zip(rig, circles, strict=True)):
        ids = np.asarray(read.ids)
        known = np.flatnonzero((ids >= 0) & np.isfinite(read.centres[:, 0]) & np.isfinite(read.centres[:, 1]))
        # An identity that an image shows twice is known at neither place.
        unique, first, count = np.unique(ids[known], return_index=True, return_counts=True)
        twice += [(number, int(i)) for i in unique[count > 1]]
        rows = known[first[count == 1]]
        flat = camera.undistort(read.centres[rows])
        # Where the lens model has no ray the circle says nothing.
        rows, flat = rows[np.isfinite(flat[:, 0])], flat[np.isfinite(flat[:, 0])]
        # Errors are those of pixels, and rays are fitted on the normalised plane, so the weights are carried over.
        jacobian = np.empty((len(rows), 4))
        pixel_jacobian(camera.lens, np.ascontiguousarray(flat), jacobian)
        weight = _information(np.asarray(read.covariance, dtype=np.float64)[rows], _model_variance(read, rules)[rows], jacobian)
        ways = np.column_stack([flat, np.ones(len(flat))]) @ camera.rotation
        ways /= np.sqrt(ways[:, 0] ** 2 + ways[:, 1] ** 2 + ways[:, 2] ** 2)[:, None]
        parts.append((ids[rows], np.full(len(rows), number), flat, weight, np.tile(camera.position, (len(rows), 1)), ways))
    ids, camera_of, flat, weight, origins, ways = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.argsort(ids, kind="stable")
    unique, count = np.unique(ids, return_counts=True)
    # One ray makes no point.
    order = order[np.repeat(count >= 2, count)]
    starts = np.concatenate([[0], np.cumsum(count[count >= 2])]).astype(np.int64)
    return CircleRays(
        unique[count >= 2].astype(np.int32), starts, camera_of[order].astype(np.int64), np.ascontiguousarray(flat[order]),
        np.ascontiguousarray(weight[order]), np.ascontiguousarray(origins[order]), np.ascontiguousarray(ways[order]),
        np.array(twice, dtype=np.int64).reshape(-1, 2),
    )  # fmt: skip


def _model_variance(read: UsedCircles, rules: DenseRules) -> Floats:
    """(n,) px2, what is added to the variance of each centre."""
    variance = np.full(len(read.ids), rules.least_sigma**2)
    axes = getattr(read, "axes", None)
    # A circle seen flat is a few pixels high, and its centre is known worse than its edge pixels say.
    return variance if axes is None else variance + (rules.flat / np.maximum(2.0 * np.asarray(axes)[:, 1], 1.0) ** 2) ** 2


def _information(covariance: Floats, variance: Floats, jacobian: Floats) -> Floats:
    """The inverse covariance on the normalised plane (n, 3): xx, xy, yy; jacobian (n, 4): du/dx, du/dy, dv/dx, dv/dy."""
    xx, xy, yy = covariance[:, 0, 0] + variance, covariance[:, 0, 1], covariance[:, 1, 1] + variance
    determinant = xx * yy - xy * xy
    a, b, c = yy / determinant, -xy / determinant, xx / determinant
    ux, uy, vx, vy = jacobian.T
    across = a * ux * uy + b * (ux * vy + uy * vx) + c * vx * vy
    return np.column_stack([a * ux * ux + 2 * b * ux * vx + c * vx * vx, across, a * uy * uy + 2 * b * uy * vy + c * vy * vy])


def _midpoints(rays: CircleRays, rules: DenseRules) -> Floats:
    points = np.empty((len(rays.ids), 3))
    kernels.fuse_midpoints(rays.origins, rays.directions, rays.starts, rules.parallel, points)
    return points


def _refined(rig: Rig, rays: CircleRays, rules: DenseRules, scale: float, start: Floats) -> tuple[Floats, Bools, Floats, Floats]:
    """Points (m, 3) m, which rays they use (n,), their covariance (m, 6) m2, and their sum of squares (m,), both for scale 1."""
    points = start.copy()
    used = np.ones(len(rays.camera), dtype=np.bool_)
    covariance, cost = np.empty((len(points), 6)), np.empty(len(points))
    turns, shifts = (np.array([getattr(camera, name) for camera in rig]) for name in ("rotation", "translation"))
    numbers = np.array([rules.steps, rules.still, rules.least_depth])
    kernels.refine_points(
        turns, shifts, rays.seen, rays.weight, rays.camera, rays.starts, scale**2 * rules.limits, numbers, points, used, covariance, cost
    )
    return points, used, covariance, cost


_LEAST_FREEDOM = 50
"""Degrees of freedom of all points together from which on a scale can be estimated."""
_SCALE_ROUNDS = 2


def _scale_of(rig: Rig, rays: CircleRays, rules: DenseRules, start: Floats) -> tuple[float, Floats]:
    """By how much the centres' standard deviations are too small, or too large; and the points of all rays, where to begin again.

    First from the median of the points' sums of squares, each divided by the median of its own distribution, chi2 of 2 k - 3 degrees: it
    does not mind wrong circles. Then from the mean of those that fit by that scale, which a few hidden edges make larger: what is stated of
    a point is to be its mean square error.
    """
    count = np.diff(rays.starts)
    # Too few degrees of freedom would turn chance into a factor.
    if (2 * count - 3).sum() < _LEAST_FREEDOM:
        return 1.0, start
    points, _, _, cost = _refined(rig, rays, replace(rules, outlier=0.0), 1.0, start)
    # The median first, since wrong circles do not move it.
    ratio = cost / _medians()[np.minimum(2 * count - 3, 63)]
    ratio = ratio[np.isfinite(ratio)]
    if not len(ratio):
        return 1.0, points
    scale = max(float(np.sqrt(np.median(ratio))), rules.least_scale)
    group = np.repeat(np.arange(len(count)), count)
    # Then the mean of those that fit: what is stated of a point is to be its mean square error.
    for _ in range(_SCALE_ROUNDS):
        _, used, _, cost = _refined(rig, rays, rules, scale, points)
        freedom = 2 * np.bincount(group[used], minlength=len(count)) - 3
        kept = (freedom > 0) & np.isfinite(cost)
        if freedom[kept].sum() < _LEAST_FREEDOM:
            break
        scale = max(float(np.sqrt(cost[kept].sum() / freedom[kept].sum())), rules.least_scale)
    return scale, points


@lru_cache(maxsize=1)
def _medians() -> Floats:
    return np.append(np.nan, chi2.median(np.arange(1, 64)))


def _fitted(rig: Rig, rays: CircleRays, rules: DenseRules, scale: float, start: Floats) -> DensePoints:
    points, used, covariance, cost = _refined(rig, rays, rules, scale, start)
    there = np.isfinite(points[:, 0])
    group = np.repeat(np.arange(len(points)), np.diff(rays.starts))
    cameras = np.bincount(group[used], minlength=len(points))
    left_out = np.flatnonzero(~used)
    # The kernel keeps the upper triangle; full matrices go out.
    full = scale**2 * covariance[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    return DensePoints(
        rays.ids[there], points[there], full[there], cameras[there], cost[there] / scale**2, scale, len(rays.ids), rays.duplicates,
        np.column_stack([rays.camera[left_out], rays.ids[group[left_out]]]).astype(np.int64),
        np.bincount(rays.camera[used], minlength=len(rig)),
    )  # fmt: skip
