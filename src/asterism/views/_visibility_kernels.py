"""Markers, capsules and cameras in; how deep each line of sight runs through the body out. Twins: tests/twins_views.py."""

from __future__ import annotations

import math

from asterism._jit import kernel

_CLEAR = 0.05
"""m, by which a capsule that hides nothing may be passed over: the probability that it hides is below 1e-5 there."""


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
def visible_shares(depths, doubt, softness, hidden, shown, out):
    """The probability that a camera has a blob of a marker, from how deep its line of sight runs.

    IN  depths (C, M) m; doubt m: what is hidden by less counts as visible; softness m; hidden, shown: the lowest and highest probability
    OUT out (C, M)
    O(C M), no allocation.
    """
    for c in range(depths.shape[0]):
        for m in range(depths.shape[1]):
            # The exponent is bounded, beyond which the share does not change any more.
            out[c, m] = hidden + (shown - hidden) / (1.0 + math.exp(min((depths[c, m] - doubt) / softness, 50.0)))
