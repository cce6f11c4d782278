"""Points and rays in; where the rays of some blobs meet, and which rays must be dropped for that, out.

Residuals and Jacobians are in units of the noise: pixels over the camera's pixel noise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.geometry.shared_kernels import symmetric_inverse, where_lines_approach
from asterism.reconstruction._input_kernels import GATE, NOISE, in_camera_axes

MOST_DROPPED = 4
"""How many rays a hypothesis may lose at most because of their residual."""


class FitWorkspace(NamedTuple):
    """What a fit works on and leaves.

    point        (3,) m
    information  (6,) 1/m2, the inverse covariance as (xx, xy, xz, yy, yz, zz)
    gradient     (3,) 1/m
    """

    point: np.ndarray
    information: np.ndarray
    gradient: np.ndarray


@kernel
def fit_workspace():
    """An empty workspace. Returns FitWorkspace. O(1)."""
    return FitWorkspace(np.empty(3), np.empty(6), np.empty(3))


@kernel
def set_zero(values):
    """OUT values (n,), all set to 0. O(n)."""
    for i in range(len(values)):
        values[i] = 0.0


@kernel
def add_ray(rig, frame, c, blob, work):
    """Add a ray's share to the normal equations at a point. Returns its squared residual in units of the noise.

    IN  blob of camera c; work.point
    OUT work.information, work.gradient, added to
    A point that is not in front of the camera has an infinite residual, and nothing is added. O(1), no allocation.
    """
    x, h, g = work.point, work.information, work.gradient
    u, v, w = in_camera_axes(rig.cameras, c, x[0], x[1], x[2])
    # Behind the camera a projection would be mirrored, and a wrong ray would look right.
    if not w > 1e-9:
        return np.inf
    px, py = u / w, v / w
    cameras, blobs = rig.cameras, frame.blobs
    s0, s1, s2, s3 = blobs[blob, 2], blobs[blob, 3], blobs[blob, 4], blobs[blob, 5]
    # In units of the noise, so that cameras of different resolution count as they should.
    k = 1.0 / rig.cameras[c, NOISE]
    dx, dy = frame.blobs[blob, 0] - px, frame.blobs[blob, 1] - py
    r0, r1 = k * (s0 * dx + s1 * dy), k * (s2 * dx + s3 * dy)
    k /= w
    ax = cameras[c, 0] - px * cameras[c, 6]
    bx = cameras[c, 3] - py * cameras[c, 6]
    ay = cameras[c, 1] - px * cameras[c, 7]
    by = cameras[c, 4] - py * cameras[c, 7]
    az = cameras[c, 2] - px * cameras[c, 8]
    bz = cameras[c, 5] - py * cameras[c, 8]
    j00, j01, j02 = k * (s0 * ax + s1 * bx), k * (s0 * ay + s1 * by), k * (s0 * az + s1 * bz)
    j10, j11, j12 = k * (s2 * ax + s3 * bx), k * (s2 * ay + s3 * by), k * (s2 * az + s3 * bz)
    # Only the upper triangle: the matrix is symmetric.
    h[0] += j00 * j00 + j10 * j10
    h[1] += j00 * j01 + j10 * j11
    h[2] += j00 * j02 + j10 * j12
    h[3] += j01 * j01 + j11 * j11
    h[4] += j01 * j02 + j11 * j12
    h[5] += j02 * j02 + j12 * j12
    g[0] += j00 * r0 + j10 * r1
    g[1] += j01 * r0 + j11 * r1
    g[2] += j02 * r0 + j12 * r1
    return r0 * r0 + r1 * r1


@kernel
def fit(rig, frame, rays, work, steps):
    """Move a point to where its rays' reprojection error is least: Gauss-Newton, thesis eq. 3.8 for any number of cameras.

    IN  rays (C,) blob of each camera or -1; steps: at most
    OUT work: the point, moved in place; its information of the last step
    Returns the sum of the squared residuals in units of the noise, the largest one, and the camera that has it; infinite where the rays do
    not determine a point in front of all cameras. O(steps * C), no allocation. Twin: scipy.optimize.least_squares
    """
    x, h, g = work.point, work.information, work.gradient
    total, largest, camera = 0.0, -1.0, -1
    for step in range(steps + 1):
        set_zero(h)
        set_zero(g)
        total, largest, camera = 0.0, -1.0, -1
        for c in range(len(rays)):
            if rays[c] >= 0:
                square = add_ray(rig, frame, c, rays[c], work)
                total += square
                # The worst ray is what `fit_and_prune` drops.
                if square > largest:
                    largest, camera = square, c
        determinant, i0, i1, i2, i3, i4, i5 = symmetric_inverse(h)
        # Rays that are parallel, or NaN, determine no point.
        if not (determinant > 0.0 and total < np.inf):
            return np.inf, np.inf, camera
        if step == steps:
            break
        dx, dy, dz = i0 * g[0] + i1 * g[1] + i2 * g[2], i1 * g[0] + i3 * g[1] + i4 * g[2], i2 * g[0] + i4 * g[1] + i5 * g[2]
        x[0] += dx
        x[1] += dy
        x[2] += dz
        # The gain of the step in squared deviations: too little to go on for, and known without another look at the rays.
        if g[0] * dx + g[1] * dy + g[2] * dz < 1e-8:
            total -= g[0] * dx + g[1] * dy + g[2] * dz
            break
    return total, largest, camera


@kernel
def fit_and_prune(rig, frame, rays, work, steps):
    """Fit a point and drop rays that do not fit, worst first.

    IN  steps: of each fit
    OUT rays (C,), dropped ones become -1; work
    Returns the sum of the squared residuals in units of the noise and how many rays are left; infinite where no point is left.
    O(MOST_DROPPED * steps * C), no allocation. Twin: tests/twins_reconstruction.py
    """
    count = 0
    for c in range(len(rays)):
        count += rays[c] >= 0
    limit = rig.limits[GATE] * rig.limits[GATE]
    for _ in range(MOST_DROPPED + 1):
        square, largest, camera = fit(rig, frame, rays, work, steps)
        if not square < np.inf:
            return np.inf, count
        # Two rays always meet in a way: their sum must keep the limit, too.
        if largest <= limit and (count > 2 or square <= limit):
            return square, count
        if count <= 2:
            return np.inf, count
        # The worst one alone: others may fit once it is gone.
        rays[camera] = -1
        count -= 1
    return np.inf, count


@kernel
def closest_point(rig, frame, pair, i, j, x):
    """Where the rays of two blobs come nearest to each other.

    IN  blob i of the pair's first camera, blob j of its second
    OUT x (3,) m, the middle between the two rays
    Returns False, with x unchanged, where that is not in front of both cameras or the rays are parallel. O(1), no allocation.
    """
    a, b = rig.pairs[pair, 0], rig.pairs[pair, 1]
    cameras = rig.cameras
    fx, fy = frame.blobs[i, 0], frame.blobs[i, 1]
    d0, d1, d2 = (
        cameras[a, 0] * fx + cameras[a, 3] * fy + cameras[a, 6],
        cameras[a, 1] * fx + cameras[a, 4] * fy + cameras[a, 7],
        cameras[a, 2] * fx + cameras[a, 5] * fy + cameras[a, 8],
    )
    fx, fy = frame.blobs[j, 0], frame.blobs[j, 1]
    e0, e1, e2 = (
        cameras[b, 0] * fx + cameras[b, 3] * fy + cameras[b, 6],
        cameras[b, 1] * fx + cameras[b, 4] * fy + cameras[b, 7],
        cameras[b, 2] * fx + cameras[b, 5] * fy + cameras[b, 8],
    )
    o0, o1, o2 = cameras[b, 12] - cameras[a, 12], cameras[b, 13] - cameras[a, 13], cameras[b, 14] - cameras[a, 14]
    # In multiples of the rays, so that a negative one tells of a place behind its camera.
    s, t, cross = where_lines_approach(d0, d1, d2, e0, e1, e2, o0, o1, o2)
    if not (cross and s > 1e-6 and t > 1e-6):
        return False
    x[0] = 0.5 * (cameras[a, 12] + s * d0 + cameras[b, 12] + t * e0)
    x[1] = 0.5 * (cameras[a, 13] + s * d1 + cameras[b, 13] + t * e1)
    x[2] = 0.5 * (cameras[a, 14] + s * d2 + cameras[b, 14] + t * e2)
    return True
