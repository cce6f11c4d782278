"""Kernels of several rooms: angles, 3 x 3 matrices, rays, segments, rigid placement about the vertical. Twins: tests/twins_geometry.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel


@kernel(inline=True)
def clamped_index(value, low, high):
    """A real number cut to a whole one, from `low` to `high`; `low` for NaN.

    IN  value; low, high whole. What infinity, NaN or a number beyond 64 bits becomes as a whole number depends on the processor, so it is
        clamped before, not after.
    O(1), no allocation.
    """
    # Also for NaN, which is not greater than anything.
    if not value > low:
        return low
    return int(value) if value < high else high


@kernel(inline=True)
def within_half_a_turn(angle):
    """The same direction as an angle between -pi and pi.

    IN  angle rad; NaN stays NaN. O(1), no allocation.
    """
    return (angle + math.pi) % (2 * math.pi) - math.pi


@kernel(inline=True)
def cofactors(xx, xy, xz, yx, yy, yz, zx, zy, zz):
    """Determinant and upper cofactors (xx, xy, xz, yy, yz, zz) of a 3 x 3 matrix, whose inverse is their quotient where it is symmetric.

    IN  the matrix by rows; it may be symmetric only up to rounding
    O(1), no allocation.
    """
    a, b, c = yy * zz - yz * zy, xz * zy - xy * zz, xy * yz - xz * yy
    d, e, f = xx * zz - xz * zx, xz * yx - xx * yz, xx * yy - xy * yx
    return xx * a + xy * (yz * zx - yx * zz) + xz * (yx * zy - yy * zx), a, b, c, d, e, f


@kernel(inline=True)
def symmetric_inverse(h):
    """Determinant and inverse of a symmetric 3 x 3 matrix; all 0 where the determinant is not positive.

    IN  h (6,): xx, xy, xz, yy, yz, zz; returns the determinant and the inverse's six in the same order
    O(1), no allocation.
    """
    determinant, xx, xy, xz, yy, yz, zz = cofactors(h[0], h[1], h[2], h[1], h[3], h[4], h[2], h[4], h[5])
    # Also where it is NaN.
    if not determinant > 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    k = 1.0 / determinant
    return determinant, xx * k, xy * k, xz * k, yy * k, yz * k, zz * k


@kernel
def rotate_by(rotation, x, y, z, own_axes):
    """Rotate a rotation matrix by a rotation vector (Rodrigues).

    IN  x, y, z rad; own_axes: about the axes of the rotation's columns (rotation @ step), else about those of its rows (step @ rotation)
    OUT rotation (3, 3), in place
    O(1).
    """
    angle = math.sqrt(x * x + y * y + z * z)
    # The limit of the quotient at 0, where it would be 0 / 0.
    half = 0.5 if angle < 1e-8 else (1.0 - math.cos(angle)) / (angle * angle)
    sine = 1.0 if angle < 1e-8 else math.sin(angle) / angle
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    step = np.eye(3) + sine * skew + half * (skew @ skew)
    rotation[:] = np.ascontiguousarray(rotation) @ step if own_axes else step @ np.ascontiguousarray(rotation)


@kernel(inline=True)
def nearest_on_segments(p, q, a, b):
    """Where two segments are nearest: returns the squared distance m2 and the share along the second.

    IN  p, q and a, b (3,) m: their ends; a segment without length is a point
    OUT nothing
    O(1), no allocation.
    """
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    wx, wy, wz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    uu, vv, uv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, ux * vx + uy * vy + uz * vz
    uw, vw = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    across = uu * vv - uv * uv
    s = 0.0
    if across > 1e-12 * uu * vv:
        s = min(max((uv * vw - vv * uw) / across, 0.0), 1.0)
    t = (uv * s + vw) / vv if vv > 0.0 else 0.0
    if t < 0.0 or t > 1.0:
        t = min(max(t, 0.0), 1.0)
        s = min(max((uv * t - uw) / uu, 0.0), 1.0) if uu > 0.0 else 0.0
    dx, dy, dz = wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz
    return dx * dx + dy * dy + dz * dz, t


@kernel(inline=True)
def nearest_to_rays(origins, rays, first, last, parallel, normal, right, out):
    """The point nearest to some rays, by least squares of the distances.

    IN  origins (n, 3) m, rays (n, 3) of length 1, NaN for a ray that does not count; first, last: which rows; parallel: rays whose normal
        equations have a smaller determinant per cubed number of rays count as parallel
    OUT normal (3, 3), right (3,): working memory; out (3,) m, untouched where False is returned: fewer than two rays, or parallel ones
    O(last - first), no allocation.
    """
    normal[:] = 0.0
    right[:] = 0.0
    count = 0
    for r in range(first, last):
        if not math.isfinite(rays[r, 0]):
            continue
        count += 1
        along = rays[r, 0] * origins[r, 0] + rays[r, 1] * origins[r, 1] + rays[r, 2] * origins[r, 2]
        for j in range(3):
            # A ray pulls only across its own direction.
            right[j] += origins[r, j] - rays[r, j] * along
            for k in range(3):
                normal[j, k] += (1.0 if j == k else 0.0) - rays[r, j] * rays[r, k]
    if count < 2:
        return False
    determinant, xx, xy, xz, yy, yz, zz = cofactors(
        normal[0, 0], normal[0, 1], normal[0, 2], normal[0, 1], normal[1, 1], normal[1, 2], normal[0, 2], normal[1, 2], normal[2, 2]
    )
    # Per cubed number of rays, so that the limit means the same for two rays and for twenty.
    if not determinant > parallel * count**3:
        return False
    out[0] = (xx * right[0] + xy * right[1] + xz * right[2]) / determinant
    out[1] = (xy * right[0] + yy * right[1] + yz * right[2]) / determinant
    out[2] = (xz * right[0] + yz * right[1] + zz * right[2]) / determinant
    return True


@kernel
def intersect_rays(origins, rays, starts, parallel, out):
    """The point nearest to each group of rays.

    IN  origins (n, 3) m, rays (n, 3), parallel: see `nearest_to_rays`; starts (m + 1,): which rows are whose
    OUT out (m, 3) m; NaN where fewer than two rays count, or all are parallel
    O(n), no allocation per point.
    """
    normal, right = np.empty((3, 3)), np.empty(3)
    for i in range(len(starts) - 1):
        out[i] = np.nan
        nearest_to_rays(origins, rays, starts[i], starts[i + 1], parallel, normal, right, out[i])


@kernel(inline=True)
def where_lines_approach(d0, d1, d2, e0, e1, e2, o0, o1, o2):
    """Where two lines come nearest to each other: the multiples s of d and t of e, and whether they are not parallel.

    IN  directions d and e of any length; o, from the origin of the line along d to that of the line along e
    O(1), no allocation.
    """
    dd, ee, de = d0 * d0 + d1 * d1 + d2 * d2, e0 * e0 + e1 * e1 + e2 * e2, d0 * e0 + d1 * e1 + d2 * e2
    od, oe = o0 * d0 + o1 * d1 + o2 * d2, o0 * e0 + o1 * e1 + o2 * e2
    under = dd * ee - de * de
    # Relative to the lengths, which are arbitrary: the squared sine of the angle.
    if not under > 1e-8 * dd * ee:
        return 0.0, 0.0, False
    return (od * ee - oe * de) / under, (od * de - oe * dd) / under, True


@kernel
def fit_about_z(points, rows, template, markers):
    """The turn about +z and the shift that lay the points at `rows` best on `template[markers]`: (cos, sin, from, onto).

    IN  points (n, 3) m; rows (k,), -1 where there is no point; template (M, 3) m; markers (k,)
    A point p goes to turn(p - from) + onto. O(k), no allocation.
    """
    count, px, py, pz, qx, qy, qz = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(rows)):
        if rows[i] >= 0:
            count += 1
            px += points[rows[i], 0]
            py += points[rows[i], 1]
            pz += points[rows[i], 2]
            qx += template[markers[i], 0]
            qy += template[markers[i], 1]
            qz += template[markers[i], 2]
    px, py, pz, qx, qy, qz = px / count, py / count, pz / count, qx / count, qy / count, qz / count
    along, across = 0.0, 0.0
    for i in range(len(rows)):
        if rows[i] >= 0:
            ax, ay = points[rows[i], 0] - px, points[rows[i], 1] - py
            bx, by = template[markers[i], 0] - qx, template[markers[i], 1] - qy
            along += ax * bx + ay * by
            across += ax * by - ay * bx
    # The turn is the direction of the summed products; no angle is needed, only its cosine and sine.
    size = math.sqrt(along * along + across * across)
    cos, sin = (along / size, across / size) if size > 0.0 else (1.0, 0.0)
    return cos, sin, (px, py, pz), (qx, qy, qz)


@kernel
def align_about_z(points, rows, template, markers, out):
    """Move all points as `fit_about_z` says. OUT out (n, 3) m. O(n + k), no allocation."""
    cos, sin, here, there = fit_about_z(points, rows, template, markers)
    for i in range(len(points)):
        x, y = points[i, 0] - here[0], points[i, 1] - here[1]
        out[i, 0] = cos * x - sin * y + there[0]
        out[i, 1] = sin * x + cos * y + there[1]
        out[i, 2] = points[i, 2] - here[2] + there[2]
