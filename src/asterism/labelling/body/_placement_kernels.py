"""Placement: the rotation about the vertical and the translation that bring labelled points onto the mean body."""

from __future__ import annotations

import math

from asterism._jit import kernel


@kernel(reassociate=True)
def placement(points, point_of, mean, markers):
    """The turn about the vertical and the shift that bring the points at `point_of` best onto `mean[markers]`: (cos, sin, from, onto).

    IN  points (n, 3); point_of (k,), -1 for none; mean (M, 3); markers (k,). O(k), no allocation.
    """
    count, px, py, pz, qx, qy, qz = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(point_of)):
        if point_of[i] >= 0:
            count += 1
            px += points[point_of[i], 0]
            py += points[point_of[i], 1]
            pz += points[point_of[i], 2]
            qx += mean[markers[i], 0]
            qy += mean[markers[i], 1]
            qz += mean[markers[i], 2]
    px, py, pz, qx, qy, qz = px / count, py / count, pz / count, qx / count, qy / count, qz / count
    along, across = 0.0, 0.0
    for i in range(len(point_of)):
        if point_of[i] >= 0:
            ax, ay = points[point_of[i], 0] - px, points[point_of[i], 1] - py
            bx, by = mean[markers[i], 0] - qx, mean[markers[i], 1] - qy
            along += ax * bx + ay * by
            across += ax * by - ay * bx
    size = math.sqrt(along * along + across * across)
    cos, sin = (along / size, across / size) if size > 0.0 else (1.0, 0.0)
    return cos, sin, (px, py, pz), (qx, qy, qz)


@kernel(reassociate=True)
def place_points(points, point_of, mean, markers, out):
    """Move all points by `placement`. OUT out (n, 3). O(n + k)."""
    cos, sin, here, there = placement(points, point_of, mean, markers)
    for i in range(len(points)):
        x, y = points[i, 0] - here[0], points[i, 1] - here[1]
        out[i, 0] = cos * x - sin * y + there[0]
        out[i, 1] = sin * x + cos * y + there[1]
        out[i, 2] = points[i, 2] - here[2] + there[2]
