"""What cameras see, on flat arrays: markers behind bodies, blobs that overlap, blobs as pixels. Twins: tests/test_simulated_cameras.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.geometry.shared_kernels import nearest_on_segments


@kernel
def hidden(eye, points, starts, ends, radii, clearance, out):
    """Which points capsules hide from an eye. No point lies in a capsule: for each point, a capsule is thin enough to leave it outside.

    IN  eye (3,) m; points (T, M, 3) m; starts, ends (T, K, 3) m, NaN for a capsule that is not there; radii (K,) m; clearance m
    OUT out (T, M) bool
    O(T M K), no allocation.
    """
    for t in range(points.shape[0]):
        for m in range(points.shape[1]):
            point = points[t, m]
            out[t, m] = False
            for k in range(len(radii)):
                start, end = starts[t, k], ends[t, k]
                from_point, _ = nearest_on_segments(point, point, start, end)
                # A capsule is thicker than the limb in places; it must not hide the marker on its own skin.
                radius = min(radii[k], math.sqrt(from_point) - clearance)
                if not radius > 0.0:
                    continue
                from_sight, _ = nearest_on_segments(eye, point, start, end)
                if from_sight < radius * radius:
                    out[t, m] = True
                    break


@kernel
def merge(offsets, xy, sizes, out):
    """Which blobs of a cell (one camera, one frame) run into each other: those nearer than the mean of their diameters, in chains.

    IN  offsets (cells + 1,); xy (P, 2) px; sizes (P,) px
    OUT out (P,) int, the first blob of the group that each blob belongs to; its number where it is alone
    O(sum of squares of the cells' blobs), no allocation.
    """
    for cell in range(len(offsets) - 1):
        first, last = offsets[cell], offsets[cell + 1]
        # Each blob is a group of its own, ...
        for i in range(first, last):
            out[i] = i
        # ... and two that touch become one: chains grow pair by pair.
        for i in range(first, last):
            for j in range(i + 1, last):
                reach = 0.5 * (sizes[i] + sizes[j])
                dx, dy = xy[i, 0] - xy[j, 0], xy[i, 1] - xy[j, 1]
                if dx * dx + dy * dy < reach * reach:
                    a, b = out[i], out[j]
                    low, high = min(a, b), max(a, b)
                    if low != high:
                        # The whole group takes the lower number, so that a chain has one head.
                        for k in range(first, last):
                            if out[k] == high:
                                out[k] = low


@kernel
def draw(xy, sizes, gaussian, peak, image):
    """Add blobs to an image: discs with edges one pixel soft, or Gaussians whose width at half of their height is the diameter.

    IN  xy (N, 2) px; sizes (N,) px; gaussian bool; peak grey values
    OUT image (H, W) grey values, added to in place; overlapping blobs take the brighter of the two
    O(sum of the blobs' areas), no allocation.

    Bounds: rows and columns are cut to the image.
    """
    rows, columns = image.shape
    for i in range(len(xy)):
        x, y, radius = xy[i, 0], xy[i, 1], 0.5 * sizes[i]
        # Beyond it a pixel gets less than a grey value.
        reach = 3.0 * radius + 1.0 if gaussian else radius + 1.0
        for row in range(max(0, int(np.floor(y - reach))), min(rows, int(np.ceil(y + reach)) + 1)):
            for column in range(max(0, int(np.floor(x - reach))), min(columns, int(np.ceil(x + reach)) + 1)):
                square = (column - x) ** 2 + (row - y) ** 2
                if gaussian:
                    light = peak * math.exp(-math.log(2.0) * square / (radius * radius))
                else:
                    light = peak * min(max(radius + 0.5 - math.sqrt(square), 0.0), 1.0)
                image[row, column] = max(image[row, column], light)
