"""What cameras see, on flat arrays: markers behind bodies, blobs that overlap, blobs as pixels. Twins: tests/test_simulated_cameras.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel


@kernel(inline=True)
def _squared_distance(p, q, a, b):
    """Returns the squared distance between the segments p q and a b, m2; of a point where a segment has no length. O(1)."""
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    wx, wy, wz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    uu, vv, uv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, ux * vx + uy * vy + uz * vz
    uw, vw = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    across = uu * vv - uv * uv
    s = 0.0
    # Parallel segments: any place on the first serves, and the second answers.
    if across > 1e-12 * uu * vv:
        s = min(max((uv * vw - vv * uw) / across, 0.0), 1.0)
    t = (uv * s + vw) / vv if vv > 0.0 else 0.0
    # The nearest place lies beyond an end: that end, and the first segment answers.
    if t < 0.0 or t > 1.0:
        t = min(max(t, 0.0), 1.0)
        s = min(max((uv * t - uw) / uu, 0.0), 1.0) if uu > 0.0 else 0.0
    dx, dy, dz = wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz
    return dx * dx + dy * dy + dz * dz


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
                # As thin as it must be to leave the marker outside.
                radius = min(radii[k], math.sqrt(_squared_distance(point, point, start, end)) - clearance)
                if radius > 0.0 and _squared_distance(eye, point, start, end) < radius * radius:
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
        for i in range(first, last):
            out[i] = i
        for i in range(first, last):
            for j in range(i + 1, last):
                reach = 0.5 * (sizes[i] + sizes[j])
                dx, dy = xy[i, 0] - xy[j, 0], xy[i, 1] - xy[j, 1]
                if dx * dx + dy * dy < reach * reach:
                    a, b = out[i], out[j]
                    # The smaller number names the chain; all of its members are renamed, since cells are small.
                    low, high = min(a, b), max(a, b)
                    if low != high:
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
