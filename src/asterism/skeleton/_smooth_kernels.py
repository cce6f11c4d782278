"""The states of a tree over time, each with its normal equations, in; the same, as smooth as they say themselves, out.

Twins: tests/twins_skeleton.py.
"""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel

_MOST = 150
"""Iterations of conjugate gradients at most; 10 to 50 are usual. Somersaults take more, and the next round goes on with what is left."""


@kernel
def likelihood(values, variances, ratio):
    """How likely a course is that drifts at a velocity which changes by white noise, seen with noise.

    IN  values (T,); variances (T,): of the noise of each, but for a common factor, infinite where a value says nothing; ratio: variance
        of a second difference, in units of that factor
    OUT twice the negative log likelihood, of the best factor; and that factor. Diffuse start: the first two values tell the course's own.
    O(T), no allocation. Kalman filter with a concentrated scale (Harvey 1989, ch. 3.4).
    """
    x, v, pxx, pxv, pvv = 0.0, 0.0, 0.0, 0.0, 0.0
    total, square, count = 0.0, 0.0, -2
    for t in range(len(values)):
        x += v
        pxx += 2.0 * pxv + pvv
        pxv += pvv
        pvv += ratio
        if not math.isfinite(variances[t]):
            continue
        count += 1
        # The first value is the course's place, and nothing is known of its velocity.
        if count == -1:
            x, v, pxx, pxv, pvv = values[t], 0.0, variances[t], 0.0, 1e12 * variances[t]
            continue
        away, seen = values[t] - x, pxx + variances[t]
        if count > 0:
            total += math.log(seen)
            square += away * away / seen
        gain_x, gain_v = pxx / seen, pxv / seen
        x += gain_x * away
        v += gain_v * away
        pvv -= gain_v * pxv
        pxx -= gain_x * pxx
        pxv *= 1.0 - gain_x
    scale = max(square / max(count, 1), 1e-300)
    return total + count * math.log(scale), scale


@kernel
def best_ratio(values, variances):
    """The ratio of `likelihood` that makes a course likeliest, and its factor; golden section over 12 decades.

    IN  values (T,), variances (T,). O(40 T), no allocation. The ratio is between 1e-8 and 1e4 of the least variance: below, values tell
    each other over more than 100 frames, above, not over one.
    """
    least = variances.min()
    low, high = math.log(1e-8 * least), math.log(1e4 * least)
    golden = 0.5 * (math.sqrt(5.0) - 1.0)
    one, other = high - golden * (high - low), low + golden * (high - low)
    at_one, at_other = likelihood(values, variances, math.exp(one))[0], likelihood(values, variances, math.exp(other))[0]
    # 12 decades down to a tenth of one: a strength within a quarter is as good.
    for _ in range(12):
        if at_one < at_other:
            high, other, at_other = other, one, at_one
            one = high - golden * (high - low)
            at_one = likelihood(values, variances, math.exp(one))[0]
        else:
            low, one, at_one = one, other, at_other
            other = low + golden * (high - low)
            at_other = likelihood(values, variances, math.exp(other))[0]
    ratio = math.exp(0.5 * (low + high))
    return ratio, likelihood(values, variances, ratio)[1]


@kernel
def smoothed_variances(variances, ratio, out):
    """The variances of a smoothed course, in units of its factor. IN variances (T,), ratio. OUT out (T,). O(T); allocates (T, 2, 3).

    Forward and backward information are added: both are filters of `likelihood`.
    """
    frames = len(variances)
    ahead = np.empty((frames, 3))
    for way in range(2):
        pxx, pxv, pvv = 1e8 * variances.max(), 0.0, 1e8 * variances.max()
        for i in range(frames):
            t = i if way == 0 else frames - 1 - i
            if way == 0:
                ahead[t, 0], ahead[t, 1], ahead[t, 2] = pxx, pxv, pvv
                seen = pxx + variances[t]
                pvv -= pxv * pxv / seen
                pxv *= variances[t] / seen
                pxx *= variances[t] / seen
            else:
                seen = pxx + variances[t]
                pvv -= pxv * pxv / seen
                pxv *= variances[t] / seen
                pxx *= variances[t] / seen
                # The sum of two informations about position and velocity; backwards the velocity has the other sign.
                one = ahead[t, 0] * ahead[t, 2] - ahead[t, 1] ** 2
                other = pxx * pvv - pxv * pxv
                a = ahead[t, 2] / one + pvv / other
                b = -ahead[t, 1] / one + pxv / other
                c = ahead[t, 0] / one + pxx / other
                out[t] = c / (a * c - b * b)
            # Both velocities are that between this frame and the next, so backwards it changes before it carries the place.
            if way == 1:
                pvv += ratio
            pxx += 2.0 * pxv + pvv
            pxv += pvv
            if way == 0:
                pvv += ratio


@kernel
def _second_differences(x, penalties, out):
    """Add penalties times the transposed second difference of the second difference of x. IN x (T, D), penalties (D,). OUT out (T, D)."""
    for t in range(len(x) - 2):
        for d in range(x.shape[1]):
            bend = penalties[d] * (x[t, d] - 2.0 * x[t + 1, d] + x[t + 2, d])
            out[t, d] += bend
            out[t + 1, d] -= 2.0 * bend
            out[t + 2, d] += bend


@kernel
def _multiply(tree, entries, penalties, x, out):
    """The equations of all frames times x. IN entries (T, P), penalties (D,), x (T, D). OUT out (T, D). O(T P)."""
    size = x.shape[1]
    for t in range(len(x)):
        for k in range(size):
            out[t, k] = entries[t, k] * x[t, k]
        for k in range(size):
            for p in range(tree.row_starts[k], tree.row_starts[k + 1]):
                j, value = tree.row_columns[p], entries[t, size + p]
                out[t, k] += value * x[t, j]
                out[t, j] += value * x[t, k]
    _second_differences(x, penalties, out)


@kernel
def _band(values, frames, pivots, one, two):
    """L D L^T of value + D2^T D2 for each of the values (D,): five diagonals. OUT pivots, one, two (T, D). O(T D)."""
    for t in range(frames):
        centre = (1.0 if t < frames - 2 else 0.0) + (4.0 if 0 < t < frames - 1 else 0.0) + (1.0 if t > 1 else 0.0)
        near = (-2.0 if 0 < t < frames - 1 else 0.0) + (-2.0 if t > 1 else 0.0)
        for d in range(len(values)):
            second, total = near, values[d] + centre
            if t > 1:
                two[t, d] = 1.0 / pivots[t - 2, d]
                second -= one[t - 1, d]
                total -= two[t, d]
            if t > 0:
                one[t, d] = second / pivots[t - 1, d]
                total -= one[t, d] ** 2 * pivots[t - 1, d]
            pivots[t, d] = total


@kernel
def smoothing_step(tree, entries, penalties, basis, values, right, least, x):
    """The step of all frames: (A + penalties D2^T D2) x = right, by conjugate gradients.

    The preconditioner is the same matrix with one mean A for all frames, which `basis` takes apart: V^T A V = values, V^T penalties V = 1.
    IN  entries (T, P): the normal equations A of each frame, see `follow`; penalties (D,), above 0; basis (D, D), values (D,);
        right (T, D); least: the residual's square in the
        preconditioner's metric at which it ends
    OUT x (T, D). Gives the iterations.
    O(iterations T (P + D^2)); allocates (T, D) nine times.
    """
    frames, size = right.shape
    pivots, one, two = np.empty((frames, size)), np.zeros((frames, size)), np.zeros((frames, size))
    _band(values, frames, pivots, one, two)
    back = np.ascontiguousarray(basis.T)
    x[:] = 0.0
    left, course, image = right.copy(), np.zeros((frames, size)), np.empty((frames, size))
    before, start = 1.0, 0.0
    for iteration in range(_MOST):
        eased = left @ basis
        for t in range(frames):
            for d in range(size):
                if t > 0:
                    eased[t, d] -= one[t, d] * eased[t - 1, d]
                if t > 1:
                    eased[t, d] -= two[t, d] * eased[t - 2, d]
        for t in range(frames - 1, -1, -1):
            for d in range(size):
                eased[t, d] /= pivots[t, d]
                if t < frames - 1:
                    eased[t, d] -= one[t + 1, d] * eased[t + 1, d]
                if t < frames - 2:
                    eased[t, d] -= two[t + 2, d] * eased[t + 2, d]
        eased = eased @ back
        now = 0.0
        for t in range(frames):
            for d in range(size):
                now += left[t, d] * eased[t, d]
        if iteration == 0:
            start = now
        # This is about the square of what is left of the step, in standard deviations, over all numbers and frames.
        if now <= max(least, 1e-10 * start):
            return iteration
        for t in range(frames):
            for d in range(size):
                course[t, d] = eased[t, d] + (now / before * course[t, d] if iteration else 0.0)
        _multiply(tree, entries, penalties, course, image)
        bend = 0.0
        for t in range(frames):
            for d in range(size):
                bend += course[t, d] * image[t, d]
        # Rounding has taken over; what was found stands.
        if not bend > 0.0:
            return iteration
        length = now / bend
        for t in range(frames):
            for d in range(size):
                x[t, d] += length * course[t, d]
                left[t, d] -= length * image[t, d]
        before = now
    return _MOST
