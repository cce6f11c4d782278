"""A point's curves as they come in; how they go on, and how certain that is, out. Twin: tests/test_live_movement.py."""

from __future__ import annotations

import math

from asterism._jit import kernel


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
