"""Kernels of motion: tracks of points in; neighbouring positions, velocities, accelerations and the features made of them out.

A point that carries its motion is a row of `WIDTH` numbers: its position (3, m), its positions a window before and after (3 and 3, m), its
velocity (3, m/s) and its acceleration (3, m/s2); NaN where the track is too short. Twins: tests/twins.py.
"""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel

# Order of `registry.FEATURES`, going on from the constants in `feature_kernels`.
G10, G11, G12, G13, G14, G15, G16, G17, G18, G9 = range(9, 19)

BEFORE, AFTER, VELOCITY, ACCELERATION, WIDTH = 3, 6, 9, 12, 15


@kernel
def motion_feature(kind, points, a, b, c):
    """One feature over neighbouring frames or derivatives, of the points at rows a, b and (G18) c.

    IN  kind, place in `registry.FEATURES`; points (n, WIDTH), z up; rows
    Returns m, m2, m/s or m2/s2; NaN where a point's motion is not known. The same when time runs backwards. O(1).
    Thesis eq. 6.1 and 6.2. Twin: tests/twins.py
    """
    if kind == G18:
        total = 0.0
        for at in (0, BEFORE, AFTER):
            bx, by = points[b, at] - points[a, at], points[b, at + 1] - points[a, at + 1]
            cx, cy = points[c, at] - points[a, at], points[c, at + 1] - points[a, at + 1]
            total += bx * cy - by * cx
        return total / 3.0
    if kind in (G14, G16):
        now, before, after = points[a, 2] - points[b, 2], points[a, 5] - points[b, 5], points[a, 8] - points[b, 8]
        return (now + before + after) / 3.0 if kind == G14 else _spread(now, before, after)
    if kind == G17:
        return 0.5 * (_between(points, a, BEFORE, b, AFTER) + _between(points, a, AFTER, b, BEFORE))
    if kind in (G13, G15):
        now, before, after = _between(points, a, 0, b, 0), _between(points, a, BEFORE, b, BEFORE), _between(points, a, AFTER, b, AFTER)
        return (now + before + after) / 3.0 if kind == G13 else _spread(now, before, after)
    if kind == G10:
        return _between(points, a, VELOCITY, b, VELOCITY)
    square, rate, pull, speed = 0.0, 0.0, 0.0, 0.0
    for axis in range(3):
        apart, drift = points[b, axis] - points[a, axis], points[b, VELOCITY + axis] - points[a, VELOCITY + axis]
        square += apart * apart
        rate += apart * drift
        speed += drift * drift
        pull += apart * (points[b, ACCELERATION + axis] - points[a, ACCELERATION + axis])
    if kind == G11:
        return abs(rate) / math.sqrt(square) if square > 0.0 else 0.0 * speed
    return speed + pull


@kernel(inline=True)
def _between(points, a, at, b, other):
    x, y, z = points[b, other] - points[a, at], points[b, other + 1] - points[a, at + 1], points[b, other + 2] - points[a, at + 2]
    return math.sqrt(x * x + y * y + z * z)


@kernel(inline=True)
def _spread(x, y, z):
    # plain comparisons would take a NaN for no spread
    return max(x, y, z) - min(x, y, z) + 0.0 * (x + y + z)


@kernel
def estimate_motion(xyz, frame, track, order, away, reach, rate, out):
    """Each point's motion from its track.

    IN  xyz (P, 3) m; frame, track (P,), track -1 for none; order (P,) points by track, then frame
        away, frames to the neighbouring positions; reach, frames on each side over which a parabola is fitted; rate frames per second
    OUT out (P, WIDTH), NaN where the track has not so many frames without a gap on both sides
    Velocity and acceleration are those of the least-squares parabola at its middle. O(P reach). Twin: `motion` in tests/twins.py
    """
    out[:] = np.nan
    # Sums of the parabola's powers, the same for every point.
    squares, fourths, count = 0.0, 0.0, 2.0 * reach + 1.0
    for k in range(-reach, reach + 1):
        squares += k * k
        fourths += k * k * k * k
    first = 0
    for i in range(len(order) + 1):
        if i > first and i < len(order):
            one, other = order[i - 1], order[i]
            # As long as the track goes on without a gap.
            if track[other] >= 0 and track[one] == track[other] and frame[other] == frame[one] + 1:
                continue
        for j in range(first, i):
            here = order[j]
            for axis in range(3):
                out[here, axis] = xyz[here, axis]
                # Both neighbours, so that features are the same when time runs backwards.
                if j - away >= first and j + away < i:
                    out[here, BEFORE + axis] = xyz[order[j - away], axis]
                    out[here, AFTER + axis] = xyz[order[j + away], axis]
                # The whole stretch of the parabola must be there.
                if j - reach >= first and j + reach < i:
                    slope, bend, middle = 0.0, 0.0, xyz[here, axis]
                    for k in range(-reach, reach + 1):
                        step = xyz[order[j + k], axis] - middle
                        slope += k * step
                        bend += (count * k * k - squares) * step
                    out[here, VELOCITY + axis] = rate * slope / squares
                    out[here, ACCELERATION + axis] = 2.0 * rate * rate * bend / (count * fourths - squares * squares)
        first = i
