"""A point and a frame in; which blob each camera has near the point, and how likely the point is, out."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.cameras.lens_kernels import CX, CY, FX, FY, distorted
from asterism.geometry.shared_kernels import clamped_index, symmetric_inverse
from asterism.reconstruction._input_kernels import (
    CELLS,
    END,
    FIRST,
    GAIN,
    GATE,
    HIGH,
    LEFT,
    LENS,
    LOW,
    MISSING,
    NOISE,
    PER_X,
    PER_Y,
    PRIOR,
    SIDE,
    TOP,
    in_camera_axes,
)

BORDER = 3.0
"""px: a point predicted nearer to the image border need not be seen."""
MERGED = 6.0
"""px: a point predicted this near to any blob may have merged with it, so that its absence there says nothing."""


@kernel
def best_blob(rig, frame, c, work, available):
    """The blob of camera c that fits a point best, by its residual against the spread that point and blob have together.

    IN  work: the point and its information; available (B,) whether a blob may be taken
    Returns the blob, -1 where none is within the gate, and its squared distance in standard deviations. O(blobs within the spread), no
    allocation. Twin: tests/test_reconstruction.py

    Bounds: cells beyond the grid are clamped to it before they become whole numbers, however far the point is.
    """
    x, h = work.point, work.information
    u, v, w = in_camera_axes(rig.cameras, c, x[0], x[1], x[2])
    # A point behind the camera, or a camera without blobs.
    if not w > 1e-9 or frame.grid[c, FIRST] == frame.grid[c, END]:
        return -1, np.inf
    determinant, i0, i1, i2, i3, i4, i5 = symmetric_inverse(h)
    if not determinant > 0.0:
        return -1, np.inf
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
    # The point's covariance as this camera sees it: how far off the blob may be.
    cxx, cxy, cyy = ax * qx + ay * qy + az * qz, bx * qx + by * qy + bz * qz, bx * sx + by * sy + bz * sz
    noise = rig.cameras[c, NOISE]
    # The narrowest scale from pixels to the normalized plane is near the focal length; half of it is safe for the box.
    floor = noise / (0.5 * min(rig.cameras[c, LENS + FX], rig.cameras[c, LENS + FY]))
    wide_x, wide_y = rig.limits[GATE] * math.sqrt(cxx + floor * floor), rig.limits[GATE] * math.sqrt(cyy + floor * floor)
    grid = frame.grid
    side = int(grid[c, SIDE])
    left = clamped_index((px - wide_x - grid[c, LEFT]) * grid[c, PER_X], 0, side)
    right = clamped_index(np.floor((px + wide_x - grid[c, LEFT]) * grid[c, PER_X]), -1, side - 1)
    top = clamped_index((py - wide_y - grid[c, TOP]) * grid[c, PER_Y], 0, side)
    bottom = clamped_index(np.floor((py + wide_y - grid[c, TOP]) * grid[c, PER_Y]), -1, side - 1)
    best, chosen = rig.limits[GATE] * rig.limits[GATE], -1
    # The box lies beside all blobs.
    if left > right:
        return -1, np.inf
    for row in range(top, bottom + 1):
        at = int(grid[c, CELLS]) + row * side
        for place in range(frame.bins[at + left], frame.bins[at + right + 1]):
            blob = frame.bins[place]
            dx, dy = frame.blobs[blob, 0] - px, frame.blobs[blob, 1] - py
            # A cell reaches beyond the box.
            if not (available[blob] and math.fabs(dx) <= wide_x and math.fabs(dy) <= wide_y):
                continue
            s0, s1, s2, s3 = frame.blobs[blob, 2], frame.blobs[blob, 3], frame.blobs[blob, 4], frame.blobs[blob, 5]
            r0, r1 = s0 * dx + s1 * dy, s2 * dx + s3 * dy
            m0, m1 = s0 * cxx + s1 * cxy, s0 * cxy + s1 * cyy
            n0, n1 = s2 * cxx + s3 * cxy, s2 * cxy + s3 * cyy
            # The blob's noise beside the point's own inexactness.
            v00, v01, v11 = m0 * s0 + m1 * s1 + noise * noise, m0 * s2 + m1 * s3, n0 * s2 + n1 * s3 + noise * noise
            square = (v11 * r0 * r0 - 2.0 * v01 * r0 * r1 + v00 * r1 * r1) / (v00 * v11 - v01 * v01)
            # Of equals the smaller number, so that the order of the cells decides nothing.
            if square < best or (square == best and blob < chosen):
                best, chosen = square, blob
    return chosen, best


@kernel
def _has_blob_near(frame, c, x, y, wide_x, wide_y):
    """Returns whether camera c has a blob in the box of half widths around a place on its normalised plane. O(blobs within the box)."""
    grid = frame.grid
    side = int(grid[c, SIDE])
    if frame.grid[c, FIRST] == frame.grid[c, END]:
        return False
    left = clamped_index((x - wide_x - grid[c, LEFT]) * grid[c, PER_X], 0, side)
    right = clamped_index(np.floor((x + wide_x - grid[c, LEFT]) * grid[c, PER_X]), -1, side - 1)
    top = clamped_index((y - wide_y - grid[c, TOP]) * grid[c, PER_Y], 0, side)
    bottom = clamped_index(np.floor((y + wide_y - grid[c, TOP]) * grid[c, PER_Y]), -1, side - 1)
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
    """Returns whether a point x (3,) m lies inside the image of camera c, and where on its normalised plane. O(1), no allocation."""
    u, v, w = in_camera_axes(rig.cameras, c, x[0], x[1], x[2])
    if not w > 1e-9:
        return False, 0.0, 0.0
    px, py = u / w, v / w
    lens = rig.cameras[c, LENS:]
    ix, iy, ux, uy, vx, vy = distorted(lens, px, py)
    ix, iy = lens[FX] * ix + lens[CX], lens[FY] * iy + lens[CY]
    # Beyond the fold of the lens model a point far aside comes back into the image.
    inside = (
        rig.cameras[c, LOW] + BORDER <= ix <= rig.cameras[c, HIGH] - BORDER
        and rig.cameras[c, LOW + 1] + BORDER <= iy <= rig.cameras[c, HIGH + 1] - BORDER
        and ux * vy - uy * vx > 0.0
        and ux + vy > 0.0
    )
    return inside, px, py


@kernel
def score(rig, frame, rays, work, square):
    """The log-likelihood ratio, in nats, of "one point made these blobs" to "each of them is a stray".

    IN  rays (C,); work: the point and its information; square: the sum of its squared residuals in units of the noise
    The integral over where the point may be is taken by its Gaussian shape around the best place (Laplace). A camera that has the place
    in its image and shows nothing there speaks against it, unless a blob is so near that both may have merged.
    O(C), and the blobs near the point. Twin: tests/twins_reconstruction.py
    """
    determinant = symmetric_inverse(work.information)[0]
    if not (determinant > 0.0 and square < np.inf):
        return -np.inf
    # The volume of places that explain the blobs alike: exact hypotheses pay for being exact (Occam).
    total = rig.limits[PRIOR] - 0.5 * math.log(determinant) - 0.5 * square
    for c in range(len(rays)):
        if rays[c] >= 0:
            total += rig.cameras[c, GAIN]
        else:
            inside, px, py = in_view(rig, c, work.point)
            # A blob so near may hold this marker, too: then its absence says nothing.
            if inside and not _has_blob_near(frame, c, px, py, MERGED / rig.cameras[c, LENS + FX], MERGED / rig.cameras[c, LENS + FY]):
                total += rig.cameras[c, MISSING]
    return total
