"""The smoothest path that measurements of different exactness allow, on flat arrays. Twin: tests/test_smooth_paths.py."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from asterism._jit import kernel

BAND = 12
"""Places on and below the diagonal that couple: three coordinates of four neighbouring frames."""
THIRD = np.array([-1.0, 3.0, -3.0, 1.0])


class JerkModel(NamedTuple):
    """How third differences are distributed.

    floor    m2, their variance that is expected beforehand; it counts as much as `trust` of them
    weights  (2 h + 1,) of the differences around one in the estimate of its variance
    rounds   of expectation and maximization
    """

    floor: float
    trust: float
    weights: np.ndarray
    rounds: int


@kernel
def smooth_path(measured, information, model, path, covariance):
    """One path as the posterior mean of a motion whose jerk changes its strength along the way.

    The third differences of the path are normal about 0 with a variance s_t, alike in all axes, which is estimated together with it
    (expectation-maximization): it is what the differences around t are in the mean, `floor` counting as much as `trust` of them.

    IN  measured (n, 3) m, n >= 4; information (n, 6) 1/m2, the inverse covariance of each as (xx, xy, xz, yy, yz, zz); model JerkModel
    OUT path (n, 3) m, covariance (n, 3, 3) m2
    O(rounds * n) time, O(n) memory: all matrices are banded.

    Bounds: n >= 4, so that there is a third difference.
    """
    weights = model.weights
    n = len(measured)
    reach = len(weights) // 2
    lower, inverse, right = np.empty((3 * n, BAND)), np.zeros((3 * n, BAND)), np.empty(3 * n)
    variance, square = np.empty(n - 3), np.empty(n - 3)
    # Begin with differences as large as the measurement noise: nothing is known of the motion yet.
    variance[:] = _usual(information)
    # Expectation: the path and its covariance for the present variances. Maximization: the variances for that path.
    for done in range(model.rounds):
        _normal_equations(measured, information, variance, lower, right)
        _factor(lower)
        _solve(lower, right)
        _invert(lower, inverse)
        # The last round only solves: path and covariance then belong to the same variances.
        if done == model.rounds - 1:
            break
        # The expected square holds what is not known of the path, too; without it the variances would shrink from round to round.
        for t in range(n - 3):
            square[t] = _expected_square(right, inverse, t)
        # A window around each frame: jerk is strong at a heel strike and weak a tenth of a second later.
        for t in range(n - 3):
            # The prior keeps the variance above zero where the path lies on a cubic by chance.
            above, below = model.trust * model.floor, model.trust
            for k in range(max(-reach, -t), min(reach, n - 4 - t) + 1):
                above += weights[k + reach] * square[t + k]
                below += 3.0 * weights[k + reach]
            variance[t] = above / below
    for t in range(n):
        # Only half of the covariance is in the band; the other half mirrors it.
        for i in range(3):
            path[t, i] = right[3 * t + i]
            for j in range(i + 1):
                covariance[t, i, j] = covariance[t, j, i] = inverse[3 * t + i, i - j]


@kernel
def _usual(information):
    """Returns m2, the mean variance of the measurements, about: where the estimate of the differences' variance begins. O(n)."""
    total = 0.0
    for t in range(len(information)):
        total += 3.0 / (information[t, 0] + information[t, 3] + information[t, 5])
    return total / len(information)


@kernel
def _normal_equations(measured, information, variance, lower, right):
    """Inverse covariances of measurements and of third differences, summed: row i holds places (i, i), (i, i - 1), ..."""
    lower[:] = 0.0
    for t in range(len(measured)):
        i, (xx, xy, xz, yy, yz, zz), (x, y, z) = 3 * t, information[t], measured[t]
        # A measurement couples the three coordinates of its own frame only.
        lower[i, 0], lower[i + 1, 0], lower[i + 2, 0] = xx, yy, zz
        lower[i + 1, 1], lower[i + 2, 1], lower[i + 2, 2] = xy, yz, xz
        right[i], right[i + 1], right[i + 2] = xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z
    for t in range(len(variance)):
        # A third difference couples four frames, each coordinate with itself.
        for a in range(4):
            for b in range(a + 1):
                weight = THIRD[a] * THIRD[b] / variance[t]
                for axis in range(3):
                    lower[3 * (t + a) + axis, 3 * (a - b)] += weight


@kernel
def _factor(lower):
    """OUT lower (3 n, BAND): the Cholesky factor of the banded matrix that it held. O(n BAND^2)."""
    for i in range(len(lower)):
        # Beyond the band all is zero and stays so.
        reach = min(i, BAND - 1)
        # From the far end of the band towards the diagonal: each place needs only those that are factored already.
        for k in range(reach, -1, -1):
            value = lower[i, k]
            for m in range(k + 1, reach + 1):
                value -= lower[i, m] * lower[i - k, m - k]
            lower[i, k] = value / lower[i - k, 0] if k else math.sqrt(value)


@kernel
def _solve(lower, right):
    """OUT right (3 n,): the solution, by a Cholesky factor. O(n BAND)."""
    # Forwards through the factor, ...
    for i in range(len(right)):
        value = right[i]
        for k in range(1, min(i, BAND - 1) + 1):
            value -= lower[i, k] * right[i - k]
        right[i] = value / lower[i, 0]
    # ... then backwards through its transpose.
    for i in range(len(right) - 1, -1, -1):
        value = right[i]
        for k in range(1, min(len(right) - 1 - i, BAND - 1) + 1):
            value -= lower[i + k, k] * right[i + k]
        right[i] = value / lower[i, 0]


@kernel
def _invert(lower, inverse):
    """Those places of the inverse that the band holds, from the last row to the first (Takahashi's equations)."""
    # From the last row on each place needs only those behind it within the band.
    for i in range(len(lower) - 1, -1, -1):
        reach = min(len(lower) - 1 - i, BAND - 1)
        # The full inverse is dense; these recursions need no place outside the band.
        for d in range(reach, -1, -1):
            value = 0.0
            for k in range(1, reach + 1):
                # The inverse is symmetric: a place above the diagonal is read below it.
                value -= lower[i + k, k] * inverse[i + max(k, d), abs(k - d)]
            value /= lower[i, 0]
            inverse[i + d, d] = value if d else value + 1.0 / lower[i, 0] ** 2


@kernel
def _expected_square(path, inverse, t):
    """m2, the expected squared length of the third difference at t: of its mean, and of what is not known about it."""
    total = 0.0
    for axis in range(3):
        mean = 0.0
        for a in range(4):
            mean += THIRD[a] * path[3 * (t + a) + axis]
            for b in range(a + 1):
                # The variance of the difference: each pair of frames counts from both sides.
                total += (1.0 if a == b else 2.0) * THIRD[a] * THIRD[b] * inverse[3 * (t + a) + axis, 3 * (a - b)]
        total += mean * mean
    return total
