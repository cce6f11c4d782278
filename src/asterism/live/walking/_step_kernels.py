"""Points of the body and their curves as they come in; how they go on, and how certain that is, out. Twin: tests/test_live_movement.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel


@kernel
def carried_point(points, columns, part, before, last, now, place, carried):
    """Where a point is by its own markers, and where if it moved as the markers of its part of the body did: the middle one of them.

    IN  points (M, 3) m; columns (C,) of the markers whose mean the point is; part (P,) columns of all markers that move with it;
        before (P, 3) m, where these were; last (3,) m, where the point was
    OUT now (P, 3) m, where they are; place (3,) m, NaN where one of `columns` is hidden; carried (3,) m, NaN where none of `part` is known
    Returns the largest difference of a coordinate of both, m; NaN where one of them is not known.
    O(P^2), one allocation. Bounds: columns are at least one. Twin: numpy.
    """
    farthest = 0.0
    moved = np.empty(len(part))
    for k in range(3):
        total = points[columns[0], k]
        for n in range(1, len(columns)):
            total += points[columns[n], k]
        place[k] = total / len(columns)
        known = 0
        for n in range(len(part)):
            now[n, k] = points[part[n], k]
            way = now[n, k] - before[n, k]
            if math.isfinite(way):
                # Sorted as they come: they are few.
                at = known
                while at > 0 and moved[at - 1] > way:
                    moved[at] = moved[at - 1]
                    at -= 1
                moved[at] = way
                known += 1
        middle = 0.5 * (moved[(known - 1) // 2] + moved[known // 2]) if known else math.nan
        carried[k] = last[k] + middle
        apart = abs(place[k] - carried[k])
        # NaN stays.
        farthest = apart if apart > farthest or math.isnan(apart) else farthest
    return farthest


@kernel
def nearer_exchanged(feet, before, speeds, step):
    """By how much feet are nearer to where they are expected if left and right are exchanged: m, of the foot that is farther off.

    IN  feet, before (2, 2, 3) m, heel and toe of left and right in a frame and in the frame before; speeds (2, 2, 3) m/s; step s between
    NaN where one of them is not known.
    O(1), no allocation. Bounds: none. Twin: numpy.
    """
    as_told, exchanged = 0.0, 0.0
    for side in range(2):
        same, other = 0.0, 0.0
        for k in range(3):
            heel, toe = before[side, 0, k] + step * speeds[side, 0, k], before[side, 1, k] + step * speeds[side, 1, k]
            same += ((feet[side, 0, k] - heel + feet[side, 1, k] - toe) / 2) ** 2
            other += ((feet[1 - side, 0, k] - heel + feet[1 - side, 1, k] - toe) / 2) ** 2
        # One that is not known leaves all unknown.
        if not math.isfinite(same + other):
            return math.nan
        as_told, exchanged = max(as_told, math.sqrt(same)), max(exchanged, math.sqrt(other))
    return as_told - exchanged


@kernel
def followed(state, cov, step, jerk, values, variance):
    """Kalman's filter of curves that keep their acceleration but for white jerk, all as certain as each other.

    IN  step s since the last frame; jerk m2/s5, its spectral density; values (C,) m, NaN where nothing is seen; variance m2 of a value
    OUT state (C, 3) m, m/s, m/s2; cov (3, 3): both of the last frame before, of this one after. The caller begins them
    Returns the largest difference of a value from what was expected, in standard deviations; 0 where nothing is seen.
    O(C), no allocation. Bounds: step > 0. Twin: numpy.
    """
    t, half = step, 0.5 * step * step
    # transition [[1, t, half], [0, 1, t], [0, 0, 1]] on both sides
    a, b, c = cov[0, 0], cov[0, 1], cov[0, 2]
    d, e, f = cov[1, 1], cov[1, 2], cov[2, 2]
    cov[0, 0] = a + t * (b + b) + half * (c + c) + t * t * d + 2.0 * t * half * e + half * half * f + jerk * t**5 / 20.0
    cov[0, 1] = b + t * c + t * d + (half + t * t) * e + half * t * f + jerk * t**4 / 8.0
    cov[0, 2] = c + t * e + half * f + jerk * t**3 / 6.0
    cov[1, 1] = d + 2.0 * t * e + t * t * f + jerk * t**3 / 3.0
    cov[1, 2] = e + t * f + jerk * t * t / 2.0
    cov[2, 2] = f + jerk * t
    for k in range(len(state)):
        state[k, 0] += t * state[k, 1] + half * state[k, 2]
        state[k, 1] += t * state[k, 2]
    if not math.isfinite(values[0]):
        _mirror(cov)
        return 0.0
    total = cov[0, 0] + variance
    gain0, gain1, gain2 = cov[0, 0] / total, cov[0, 1] / total, cov[0, 2] / total
    farthest = 0.0
    for k in range(len(state)):
        miss = values[k] - state[k, 0]
        state[k, 0] += gain0 * miss
        state[k, 1] += gain1 * miss
        state[k, 2] += gain2 * miss
        farthest = max(farthest, abs(miss) / math.sqrt(total))
    a, b, c = cov[0, 0], cov[0, 1], cov[0, 2]
    cov[0, 0] -= gain0 * a
    cov[0, 1] -= gain0 * b
    cov[0, 2] -= gain0 * c
    cov[1, 1] -= gain1 * b
    cov[1, 2] -= gain1 * c
    cov[2, 2] -= gain2 * c
    _mirror(cov)
    return farthest


@kernel(inline=True)
def _mirror(cov):
    cov[1, 0], cov[2, 0], cov[2, 1] = cov[0, 1], cov[0, 2], cov[1, 2]
