"""Points and rays on flat arrays: where the rays of some blobs meet, which blob a camera has near a point, and what speaks for it.

Everything of a frame is in undistorted coordinates of each camera's normalized plane, taken once; `slopes` carry a small step there
to pixels. Residuals and Jacobians are "in noise": pixels over the camera's pixel noise.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.cameras._kernels import CX, CY, FX, FY, distorted
from asterism.geometry._kernels import symmetric_inverse, where_lines_approach
from asterism.reconstruction._order_kernels import ascending

BORDER = 3.0
"""px: a point predicted nearer to the image border need not be seen."""
MERGED = 6.0
"""px: a point predicted this near to any blob may have merged with it, so that its absence there says nothing."""
DROPS = 4
"""How many rays at most a hypothesis may lose for their residual."""


NOISE, GAIN, MISSING, LOW, HIGH, LENS = 15, 16, 17, 18, 20, 22
"""Columns of a camera's row in `RigArrays.cameras`, behind 9 of its rotation, 3 of its translation, 3 of its position."""
PRIOR, GATE, FEWEST = 0, 1, 2
"""Places in `RigArrays.setting`, before the 6 of its corners."""
LEFT, TOP, PER_X, PER_Y, SIDE, CELLS, FIRST, END = 0, 1, 2, 3, 4, 5, 6, 7
"""Columns of a camera's row in `FrameArrays.grid`."""


class RigArrays(NamedTuple):
    """A rig of C cameras and K camera pairs, and how its images are believed to come about. Few arrays: each costs in every call.

    cameras  (C, LENS + lens): rotation (9), translation (3) m, position (3) m; pixel noise px; gain: nats for a blob explained, before
             its residual; missing: nats for a blob that should be there; lowest and highest x, y px of the image; the lens
    setting  (9,): prior nats for a point; gate in standard deviations; fewest cameras of a point; corners (3, 3) m of where points may be
    pairs    (K, 2), the most rectangular first
    axes     (K, 2, 3) unit vectors that span the plane across the pair's baseline
    """

    cameras: np.ndarray
    setting: np.ndarray
    pairs: np.ndarray
    axes: np.ndarray


class FrameArrays(NamedTuple):
    """One frame's B blobs, by camera, with a grid of cells over each image to find them.

    blobs  (B, 6): undistorted x, y; slopes du/dx, du/dy, dv/dx, dv/dy px
    grid   (C, 8): left, top; cells per unit of x, y; cells along a side; where the camera's cells begin in `bins`; its first blob, its end
    bins   for each cell of each camera where its blobs begin in `bins`, then the blob numbers
    """

    blobs: np.ndarray
    grid: np.ndarray
    bins: np.ndarray


@kernel
def lens_slopes(lens, flat, out):
    """How far a blob moves in the image when its ray does.

    IN  lens (LENS,); flat (n, 2) undistorted normalized coordinates
    OUT out (n, 4) px: du/dx, du/dy, dv/dx, dv/dy
    """
    for i in range(len(flat)):
        _, _, ux, uy, vx, vy = distorted(lens, flat[i, 0], flat[i, 1])
        out[i, 0], out[i, 1] = lens[FX] * ux, lens[FX] * uy
        out[i, 2], out[i, 3] = lens[FY] * vx, lens[FY] * vy


@kernel
def first_of_equals(xy, offsets, out):
    """Whether a blob is the first of its image at its place.

    IN  xy (B, 2) px, offsets (T * C + 1,) as in Blobs
    OUT out (B,) bool
    O(blobs log blobs).
    """
    for cell in range(len(offsets) - 1):
        begin, end = offsets[cell], offsets[cell + 1]
        across = np.empty(end - begin)
        for k in range(end - begin):
            across[k] = xy[begin + k, 0]
        order = ascending(across, end - begin)
        for k in range(end - begin):
            out[begin + order[k]] = True
            back = k - 1
            while back >= 0 and across[order[back]] == across[order[k]]:
                if xy[begin + order[back], 1] == xy[begin + order[k], 1]:
                    out[begin + order[k]] = False
                back -= 1


@kernel
def frame_arrays(flat, slopes, first):
    """Lay a grid over each camera's blobs, about one blob a cell. O(blobs).

    IN  flat (B, 2), slopes (B, 4), first (C + 1,) where each camera's blobs begin
    """
    cameras, count = len(first) - 1, len(flat)
    blobs = np.empty((count, 6))
    for i in range(count):
        blobs[i, 0], blobs[i, 1] = flat[i, 0], flat[i, 1]
        for k in range(4):
            blobs[i, 2 + k] = slopes[i, k]
    grid = np.zeros((cameras, 8))
    total = 0
    for c in range(cameras):
        side = max(1, int(math.sqrt(first[c + 1] - first[c])))
        grid[c, SIDE], grid[c, CELLS], grid[c, FIRST], grid[c, END] = side, total, first[c], first[c + 1]
        total += side * side + 1
        x0 = y0 = np.inf
        x1 = y1 = -np.inf
        for i in range(first[c], first[c + 1]):
            x0, x1 = min(x0, flat[i, 0]), max(x1, flat[i, 0])
            y0, y1 = min(y0, flat[i, 1]), max(y1, flat[i, 1])
        if x1 >= x0:
            grid[c, LEFT], grid[c, TOP] = x0, y0
            grid[c, PER_X], grid[c, PER_Y] = side / (x1 - x0 + 1e-9), side / (y1 - y0 + 1e-9)
    bins = np.zeros(total + count, np.int64)
    for c in range(cameras):
        base, side = int(grid[c, CELLS]), int(grid[c, SIDE])
        for i in range(first[c], first[c + 1]):
            bins[base + _cell(grid, c, flat[i, 0], flat[i, 1])] += 1
        bins[base] += total + first[c]
        for k in range(1, side * side + 1):
            bins[base + k] += bins[base + k - 1]
        for i in range(first[c + 1] - 1, first[c] - 1, -1):
            k = base + _cell(grid, c, flat[i, 0], flat[i, 1])
            bins[k] -= 1
            bins[bins[k]] = i
    return FrameArrays(blobs, grid, bins)


@kernel(inline=True)
def _cell(grid, c, x, y):
    side = int(grid[c, SIDE])
    column = min(max(int((x - grid[c, LEFT]) * grid[c, PER_X]), 0), side - 1)
    row = min(max(int((y - grid[c, TOP]) * grid[c, PER_Y]), 0), side - 1)
    return row * side + column


@kernel(inline=True)
def _in_camera(cameras, c, x, y, z):
    """A world point in the axes of camera c."""
    return (
        cameras[c, 0] * x + cameras[c, 1] * y + cameras[c, 2] * z + cameras[c, 9],
        cameras[c, 3] * x + cameras[c, 4] * y + cameras[c, 5] * z + cameras[c, 10],
        cameras[c, 6] * x + cameras[c, 7] * y + cameras[c, 8] * z + cameras[c, 11],
    )


@kernel
def clear(values):
    """Set all of (n,) to 0."""
    for i in range(len(values)):
        values[i] = 0.0


@kernel
def add_ray(rig, frame, c, blob, x, h, g):
    """Add a ray's share to the normal equations at point x: h (6,) information, g (3,). Returns its squared residual in noise.

    A point that is not in front of the camera has an infinite one, and nothing is added.
    """
    u, v, w = _in_camera(rig.cameras, c, x[0], x[1], x[2])
    if not w > 1e-9:
        return np.inf
    px, py = u / w, v / w
    cameras, blobs = rig.cameras, frame.blobs
    s0, s1, s2, s3 = blobs[blob, 2], blobs[blob, 3], blobs[blob, 4], blobs[blob, 5]
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
def fit(rig, frame, rays, x, h, g, steps):
    """Move a point to where its rays' reprojection error is least: Gauss-Newton, thesis eq. 3.8 for any number of cameras.

    IN  rays (C,) blob of each camera or -1; steps at most
    OUT x (3,) m, moved in place; h (6,) information in 1/m2, of the last step
    Returns the squared residual in noise at the end of all rays, of the worst one, and whose that is; infinite where it cannot be.
    """
    total, worst, whose = 0.0, -1.0, -1
    for step in range(steps + 1):
        clear(h)
        clear(g)
        total, worst, whose = 0.0, -1.0, -1
        for c in range(len(rays)):
            if rays[c] >= 0:
                square = add_ray(rig, frame, c, rays[c], x, h, g)
                total += square
                if square > worst:
                    worst, whose = square, c
        determinant, i0, i1, i2, i3, i4, i5 = symmetric_inverse(h)
        if not (determinant > 0.0 and total < np.inf):
            return np.inf, np.inf, whose
        if step == steps:
            break
        dx, dy, dz = i0 * g[0] + i1 * g[1] + i2 * g[2], i1 * g[0] + i3 * g[1] + i4 * g[2], i2 * g[0] + i4 * g[1] + i5 * g[2]
        x[0] += dx
        x[1] += dy
        x[2] += dz
        if g[0] * dx + g[1] * dy + g[2] * dz < 1e-8:
            total -= g[0] * dx + g[1] * dy + g[2] * dz
            break
    return total, worst, whose


@kernel
def best_blob(rig, frame, c, x, h, free, out):
    """The blob of camera c that fits a point best, by its residual against the spread that point and blob have together.

    IN  x (3,) m, h (6,) its information; free (B,) whether a blob may be taken
    OUT out (1,) its squared distance in standard deviations
    Returns the blob, -1 where none is within the gate. O(blobs within the spread).
    """
    u, v, w = _in_camera(rig.cameras, c, x[0], x[1], x[2])
    if not w > 1e-9 or frame.grid[c, FIRST] == frame.grid[c, END]:
        return -1
    determinant, i0, i1, i2, i3, i4, i5 = symmetric_inverse(h)
    if not determinant > 0.0:
        return -1
    px, py = u / w, v / w
    cameras = rig.cameras
    k = 1.0 / w
    ax, ay, az = (
        k * (cameras[c, 0] - px * cameras[c, 6]),
        k * (cameras[c, 1] - px * cameras[c, 7]),
        k * (cameras[c, 2] - px * cameras[c, 8]),
    )
    bx, by, bz = (
        k * (cameras[c, 3] - py * cameras[c, 6]),
        k * (cameras[c, 4] - py * cameras[c, 7]),
        k * (cameras[c, 5] - py * cameras[c, 8]),
    )
    qx, qy, qz = i0 * ax + i1 * ay + i2 * az, i1 * ax + i3 * ay + i4 * az, i2 * ax + i4 * ay + i5 * az
    sx, sy, sz = i0 * bx + i1 * by + i2 * bz, i1 * bx + i3 * by + i4 * bz, i2 * bx + i4 * by + i5 * bz
    cxx, cxy, cyy = ax * qx + ay * qy + az * qz, bx * qx + by * qy + bz * qz, bx * sx + by * sy + bz * sz
    noise = rig.cameras[c, NOISE]
    # The narrowest scale from pixels to the normalized plane is near the focal length; half of it is safe for the box.
    floor = noise / (0.5 * min(rig.cameras[c, LENS + FX], rig.cameras[c, LENS + FY]))
    wide_x, wide_y = rig.setting[GATE] * math.sqrt(cxx + floor * floor), rig.setting[GATE] * math.sqrt(cyy + floor * floor)
    grid = frame.grid
    side = int(grid[c, SIDE])
    left = int(max(0.0, (px - wide_x - grid[c, LEFT]) * grid[c, PER_X]))
    right = int(min(side - 1.0, math.floor((px + wide_x - grid[c, LEFT]) * grid[c, PER_X])))
    top = int(max(0.0, (py - wide_y - grid[c, TOP]) * grid[c, PER_Y]))
    bottom = int(min(side - 1.0, math.floor((py + wide_y - grid[c, TOP]) * grid[c, PER_Y])))
    best, chosen = rig.setting[GATE] * rig.setting[GATE], -1
    if left > right:
        return -1
    for row in range(top, bottom + 1):
        at = int(grid[c, CELLS]) + row * side
        for place in range(frame.bins[at + left], frame.bins[at + right + 1]):
            blob = frame.bins[place]
            dx, dy = frame.blobs[blob, 0] - px, frame.blobs[blob, 1] - py
            if not (free[blob] and math.fabs(dx) <= wide_x and math.fabs(dy) <= wide_y):
                continue
            s0, s1, s2, s3 = frame.blobs[blob, 2], frame.blobs[blob, 3], frame.blobs[blob, 4], frame.blobs[blob, 5]
            r0, r1 = s0 * dx + s1 * dy, s2 * dx + s3 * dy
            m0, m1 = s0 * cxx + s1 * cxy, s0 * cxy + s1 * cyy
            n0, n1 = s2 * cxx + s3 * cxy, s2 * cxy + s3 * cyy
            v00, v01, v11 = m0 * s0 + m1 * s1 + noise * noise, m0 * s2 + m1 * s3, n0 * s2 + n1 * s3 + noise * noise
            square = (v11 * r0 * r0 - 2.0 * v01 * r0 * r1 + v00 * r1 * r1) / (v00 * v11 - v01 * v01)
            if square < best or (square == best and blob < chosen):
                best, chosen = square, blob
    out[0] = best
    return chosen


@kernel
def _blob_near(frame, c, x, y, wide_x, wide_y):
    grid = frame.grid
    side = int(grid[c, SIDE])
    if frame.grid[c, FIRST] == frame.grid[c, END]:
        return False
    left = int(max(0.0, (x - wide_x - grid[c, LEFT]) * grid[c, PER_X]))
    right = int(min(side - 1.0, math.floor((x + wide_x - grid[c, LEFT]) * grid[c, PER_X])))
    top = int(max(0.0, (y - wide_y - grid[c, TOP]) * grid[c, PER_Y]))
    bottom = int(min(side - 1.0, math.floor((y + wide_y - grid[c, TOP]) * grid[c, PER_Y])))
    if left > right:
        return False
    for row in range(top, bottom + 1):
        at = int(grid[c, CELLS]) + row * side
        for place in range(frame.bins[at + left], frame.bins[at + right + 1]):
            blob = frame.bins[place]
            if math.fabs(frame.blobs[blob, 0] - x) <= wide_x and math.fabs(frame.blobs[blob, 1] - y) <= wide_y:
                return True
    return False


@kernel
def in_view(rig, c, x):
    """Whether camera c has a point inside its image, and where on the normalized plane."""
    u, v, w = _in_camera(rig.cameras, c, x[0], x[1], x[2])
    if not w > 1e-9:
        return False, 0.0, 0.0
    px, py = u / w, v / w
    lens = rig.cameras[c, LENS:]
    ix, iy, ux, uy, vx, vy = distorted(lens, px, py)
    ix, iy = lens[FX] * ix + lens[CX], lens[FY] * iy + lens[CY]
    inside = (
        rig.cameras[c, LOW] + BORDER <= ix <= rig.cameras[c, HIGH] - BORDER
        and rig.cameras[c, LOW + 1] + BORDER <= iy <= rig.cameras[c, HIGH + 1] - BORDER
        and ux * vy - uy * vx > 0.0
        and ux + vy > 0.0
    )
    return inside, px, py


@kernel
def score(rig, frame, rays, x, h, square):
    """The log-likelihood ratio, in nats, of "one point made these blobs" to "each of them is a stray".

    IN  rays (C,), x (3,) m, h (6,) 1/m2, square: the sum of its squared residuals in noise
    The integral over where the point may be is taken by its Gaussian shape around the best place (Laplace). A camera that has the place
    in its image and shows nothing there speaks against it, unless a blob is so near that both may have merged.
    """
    determinant = symmetric_inverse(h)[0]
    if not (determinant > 0.0 and square < np.inf):
        return -np.inf
    total = rig.setting[PRIOR] - 0.5 * math.log(determinant) - 0.5 * square
    for c in range(len(rays)):
        if rays[c] >= 0:
            total += rig.cameras[c, GAIN]
        else:
            inside, px, py = in_view(rig, c, x)
            if inside and not _blob_near(frame, c, px, py, MERGED / rig.cameras[c, LENS + FX], MERGED / rig.cameras[c, LENS + FY]):
                total += rig.cameras[c, MISSING]
    return total


@kernel
def settle(rig, frame, rays, x, h, g, steps):
    """Fit a point and drop rays that do not fit, worst first. Returns squared residual and rays left; infinite where it cannot be."""
    count = 0
    for c in range(len(rays)):
        count += rays[c] >= 0
    limit = rig.setting[GATE] * rig.setting[GATE]
    for _ in range(DROPS + 1):
        square, worst, whose = fit(rig, frame, rays, x, h, g, steps)
        if not square < np.inf:
            return np.inf, count
        if worst <= limit and (count > 2 or square <= limit):
            return square, count
        if count <= 2:
            return np.inf, count
        rays[whose] = -1
        count -= 1
    return np.inf, count


@kernel
def meeting(rig, frame, a, b, i, j, x):
    """Where the rays of two blobs come nearest to each other, into x; False where that is not in front of both cameras."""
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
    s, t, cross = where_lines_approach(d0, d1, d2, e0, e1, e2, o0, o1, o2)
    if not (cross and s > 1e-6 and t > 1e-6):
        return False
    x[0] = 0.5 * (cameras[a, 12] + s * d0 + cameras[b, 12] + t * e0)
    x[1] = 0.5 * (cameras[a, 13] + s * d1 + cameras[b, 13] + t * e1)
    x[2] = 0.5 * (cameras[a, 14] + s * d2 + cameras[b, 14] + t * e2)
    return True


@kernel(inline=True)
def within(rig, x):
    """Whether a place x (3,) m lies in the volume of the rig's settings. O(1)."""
    return (
        rig.setting[3] <= x[0] <= rig.setting[6] and rig.setting[4] <= x[1] <= rig.setting[7] and rig.setting[5] <= x[2] <= rig.setting[8]
    )
