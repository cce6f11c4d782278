"""A rig and the blobs of one frame in; the arrays on which all kernels of the reconstruction work out.

All coordinates of a frame are undistorted coordinates on each camera's normalised image plane, computed once; Jacobians carry a small step
there to pixels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.cameras.lens_kernels import pixel_jacobian, undistort_points
from asterism.geometry.shared_kernels import clamped_index
from asterism.reconstruction._order_kernels import ascending

NOISE, GAIN, MISSING, LOW, HIGH, LENS = 15, 16, 17, 18, 20, 22
"""Columns of a camera's row in `RigArrays.cameras`, behind 9 of its rotation, 3 of its translation, 3 of its position."""
PRIOR, GATE, FEWEST, VOLUME_LOW, VOLUME_HIGH, MOST_WORK = 0, 1, 2, 3, 6, 9
"""Places in `RigArrays.limits`."""
LEFT, TOP, PER_X, PER_Y, SIDE, CELLS, FIRST, END = 0, 1, 2, 3, 4, 5, 6, 7
"""Columns of a camera's row in `FrameArrays.grid`."""


class RigArrays(NamedTuple):
    """A rig of C cameras and K camera pairs, with its observation model. Few arrays: each adds to the cost of every call.

    cameras  (C, LENS + lens): rotation (9), translation (3) m, position (3) m; pixel noise px; gain: nats for an explained blob, before
             its residual; missing: nats for a blob that is expected and absent; lowest and highest x, y px of the image; the lens
    limits   (10,): prior nats for a point; gate in standard deviations; fewest cameras of a point; two corners m of the volume; looks at a
             rival at most, see `pack`
    pairs    (K, 2) the two cameras of each pair, the most rectangular pair first
    axes     (K, 2, 3) unit vectors that span the plane across the pair's baseline
    """

    cameras: np.ndarray
    limits: np.ndarray
    pairs: np.ndarray
    axes: np.ndarray


class FrameArrays(NamedTuple):
    """One frame's B blobs, by camera, with a grid of cells over each image to find them.

    blobs  (B, 6): undistorted x, y; Jacobian du/dx, du/dy, dv/dx, dv/dy px
    grid   (C, 8): left, top; cells per unit of x, y; cells along a side; where the camera's cells begin in `bins`; its first blob, its end
    bins   for each cell of each camera where its blobs begin in `bins`, then the blob numbers
    """

    blobs: np.ndarray
    grid: np.ndarray
    bins: np.ndarray


@kernel
def first_of_duplicates(xy, offsets, out):
    """Whether a blob is the first of its image at its position.

    IN  xy (B, 2) px; offsets (T * C + 1,) as in Blobs
    OUT out (B,) bool
    O(B log B). Twin: tests/twins_reconstruction.py
    """
    for cell in range(len(offsets) - 1):
        begin, end = offsets[cell], offsets[cell + 1]
        x = np.empty(end - begin)
        for k in range(end - begin):
            x[k] = xy[begin + k, 0]
        # By x, so that equal positions stand together.
        order = ascending(x, end - begin)
        for k in range(end - begin):
            out[begin + order[k]] = True
            back = k - 1
            # Only back to another x.
            while back >= 0 and x[order[back]] == x[order[k]]:
                if xy[begin + order[back], 1] == xy[begin + order[k], 1]:
                    out[begin + order[k]] = False
                back -= 1


@kernel
def rays_of_frame(cameras, xy, offsets, normalised, jacobian, single):
    """The rays of all blobs of a frame at once: a call of a kernel costs other threads more than its work.

    IN  cameras of RigArrays; xy (B, 2) px; offsets (C + 1,) where each camera's blobs begin
    OUT normalised (B, 2), NaN where the lens has no ray; jacobian (B, 4) px; single (B,) bool, whether a blob is the first at its position
    O(B log B). Twin: `rays.to_rays`, camera by camera
    """
    for c in range(len(offsets) - 1):
        a, b = offsets[c], offsets[c + 1]
        # Behind a camera's own coefficients there are zeros.
        lens = cameras[c, LENS:]
        undistort_points(lens, xy[a:b], normalised[a:b])
        pixel_jacobian(lens, normalised[a:b], jacobian[a:b])
    first_of_duplicates(xy, offsets, single)


@kernel
def frame_arrays(normalised, jacobian, first):
    """Lay a grid over each camera's blobs, about one blob a cell.

    IN  normalised (B, 2); jacobian (B, 4) px; first (C + 1,) where each camera's blobs begin
    Returns FrameArrays. O(B).

    Bounds: cells and their ends are counted before `bins` is made; `_cell` clamps to the grid.
    """
    cameras, count = len(first) - 1, len(normalised)
    blobs = np.empty((count, 6))
    for i in range(count):
        blobs[i, 0], blobs[i, 1] = normalised[i, 0], normalised[i, 1]
        for k in range(4):
            blobs[i, 2 + k] = jacobian[i, k]
    grid = np.zeros((cameras, 8))
    total = 0
    for c in range(cameras):
        # About one blob a cell: fewer cells hold too many, more are empty.
        side = max(1, int(math.sqrt(first[c + 1] - first[c])))
        grid[c, SIDE], grid[c, CELLS], grid[c, FIRST], grid[c, END] = side, total, first[c], first[c + 1]
        total += side * side + 1
        x0 = y0 = np.inf
        x1 = y1 = -np.inf
        for i in range(first[c], first[c + 1]):
            x0, x1 = min(x0, normalised[i, 0]), max(x1, normalised[i, 0])
            y0, y1 = min(y0, normalised[i, 1]), max(y1, normalised[i, 1])
        if x1 >= x0:
            grid[c, LEFT], grid[c, TOP] = x0, y0
            # The tiny addend keeps the last blob in the last cell, and one blob alone from dividing by zero.
            grid[c, PER_X], grid[c, PER_Y] = side / (x1 - x0 + 1e-9), side / (y1 - y0 + 1e-9)
    return FrameArrays(blobs, grid, _filled_bins(blobs, grid, first, total))


@kernel
def _filled_bins(blobs, grid, first, cells):
    """Returns FrameArrays.bins: the blobs of each cell in rising order. `cells`: of all cameras, with one end each. O(B)."""
    bins = np.zeros(cells + len(blobs), np.int64)
    for c in range(len(grid)):
        base, side = int(grid[c, CELLS]), int(grid[c, SIDE])
        for i in range(first[c], first[c + 1]):
            bins[base + _cell(grid, c, blobs[i, 0], blobs[i, 1])] += 1
        # Behind all cells the blob numbers, so that one array holds both.
        bins[base] += cells + first[c]
        for k in range(1, side * side + 1):
            bins[base + k] += bins[base + k - 1]
        # Backwards, because ends count down to beginnings: each cell's blobs rise.
        for i in range(first[c + 1] - 1, first[c] - 1, -1):
            k = base + _cell(grid, c, blobs[i, 0], blobs[i, 1])
            bins[k] -= 1
            bins[bins[k]] = i
    return bins


@kernel(inline=True)
def _cell(grid, c, x, y):
    """Returns the cell of camera c in which a place on its normalised plane lies, or the nearest one. O(1)."""
    side = int(grid[c, SIDE])
    column = clamped_index((x - grid[c, LEFT]) * grid[c, PER_X], 0, side - 1)
    row = clamped_index((y - grid[c, TOP]) * grid[c, PER_Y], 0, side - 1)
    return row * side + column


@kernel(inline=True)
def in_camera_axes(cameras, c, x, y, z):
    """Returns a world point (m) in the axes of camera c. O(1)."""
    return (
        cameras[c, 0] * x + cameras[c, 1] * y + cameras[c, 2] * z + cameras[c, 9],
        cameras[c, 3] * x + cameras[c, 4] * y + cameras[c, 5] * z + cameras[c, 10],
        cameras[c, 6] * x + cameras[c, 7] * y + cameras[c, 8] * z + cameras[c, 11],
    )


@kernel(inline=True)
def inside_volume(rig, x):
    """Returns whether a point (3,) m lies in the volume where points may be. O(1)."""
    limits = rig.limits
    return limits[3] <= x[0] <= limits[6] and limits[4] <= x[1] <= limits[7] and limits[5] <= x[2] <= limits[8]
