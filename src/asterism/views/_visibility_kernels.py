"""Markers, capsules and cameras in; how deep each line of sight runs through the body out. Twins: tests/twins_views.py."""

from __future__ import annotations

import math

from asterism._jit import kernel
from asterism.geometry.shared_kernels import nearest_on_segments

_CLEAR = 0.05
"""m, by which a capsule that hides nothing may be passed over: the probability that it hides is below 1e-5 there."""


@kernel(inline=True)
def squared_distance(p, q):
    """Gives the squared distance (m2) of two points. IN p, q (3,) m. O(1)."""
    return (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2


@kernel(inline=True)
def is_far(eye, point, start, end, reach):
    """Whether the line through eye and point passes the middle of start and end at more than reach (m). IN points (3,) m. O(1)."""
    ux, uy, uz = point[0] - eye[0], point[1] - eye[1], point[2] - eye[2]
    wx = 0.5 * (start[0] + end[0]) - eye[0]
    wy = 0.5 * (start[1] + end[1]) - eye[1]
    wz = 0.5 * (start[2] + end[2]) - eye[2]
    cx, cy, cz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
    return cx * cx + cy * cy + cz * cz > reach * reach * (ux * ux + uy * uy + uz * uz)


@kernel
def sight_depths(eyes, points, starts, ends, radii, clearance, out):
    """How far inside a capsule the line from each marker to each camera passes: above 0 where the body hides the marker.

    A marker lies in no capsule: for each marker a capsule is as thin as it must be to leave it outside, so that the near side of the
    segment on which a marker sits does not hide it, and the far side does.

    IN  eyes (C, 3) m; points (M, 3) m; starts, ends (K, 3) m; radii (K, 2) m at start and end, linear between; clearance m
    OUT out (C, M) m: the greatest over capsules that are not farther off than `_CLEAR`; -1 where all are
    O(C M K), no allocation. The ray trace of the paper's section 4.
    """
    for m in range(len(points)):
        point = points[m]
        for c in range(len(eyes)):
            out[c, m] = -1.0
        for k in range(len(radii)):
            # A marker sits on the body: its own capsule is as thin as that asks.
            own, _ = nearest_on_segments(point, point, starts[k], ends[k])
            room = math.sqrt(own) - clearance
            reach = 0.5 * math.sqrt(squared_distance(starts[k], ends[k])) + max(radii[k, 0], radii[k, 1]) + _CLEAR
            for c in range(len(eyes)):
                # Most capsules are far from a line of sight, and a cross product tells.
                if is_far(eyes[c], point, starts[k], ends[k], reach):
                    continue
                apart, t = nearest_on_segments(eyes[c], point, starts[k], ends[k])
                radius = min(radii[k, 0] + t * (radii[k, 1] - radii[k, 0]), room)
                out[c, m] = max(out[c, m], radius - math.sqrt(apart))


@kernel
def visible_shares(depths, occlusion_tolerance, softness, hidden, shown, out):
    """The probability that a camera has a blob of a marker, from how deep its line of sight runs.

    IN  depths (C, M) m; occlusion_tolerance m: occlusions shallower than this do not hide; softness m
        hidden, shown: the lowest and highest probability
    OUT out (C, M)
    O(C M), no allocation.
    """
    for c in range(depths.shape[0]):
        for m in range(depths.shape[1]):
            # The exponent is bounded, beyond which the share does not change any more.
            out[c, m] = hidden + (shown - hidden) / (1.0 + math.exp(min((depths[c, m] - occlusion_tolerance) / softness, 50.0)))
