"""The fastest images of each half second in; the line that tells how two clocks go against each other, out."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel


@kernel
def fit_line(since, least, scatter, quartz, variance):
    """The line through differences of two clocks, in which late ones weigh less.

    IN  since (n,) s, to the last of them; least (n,) s, the differences; scatter s, as believed before any came, counts as one of them;
        quartz: standard deviation of the drift that is believed before
    OUT variance (2, 2) of offset and drift
    Returns offset s, drift, and spread s. O(n log n), a few arrays. Twin: tests/test_live_gathering.py
    """
    many = len(least)
    offset, drift, spread = np.min(least), 0.0, scatter
    rest = np.empty(many)
    for _ in range(4):
        for k in range(many):
            rest[k] = least[k] - offset - drift * since[k]
        median = np.median(rest)
        # Of a normal distribution the middle deviation is 1 / 1.4826 of the standard one.
        usual = 1.4826 * np.median(np.abs(rest - median))
        spread = math.sqrt((many * usual * usual + scatter * scatter) / (many + 1))
        a, b, c, d, e = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(many):
            # Half seconds in which all images were late weigh less.
            weight = 1.0 / (1.0 + (rest[k] / (3 * spread)) ** 2)
            a += weight
            b += weight * since[k]
            c += weight * since[k] * since[k]
            d += weight * least[k]
            e += weight * since[k] * least[k]
        square = spread * spread
        a, b, c, d, e = a / square, b / square, c / square + 1.0 / (quartz * quartz), d / square, e / square
        determinant = a * c - b * b
        variance[0, 0], variance[0, 1], variance[1, 0], variance[1, 1] = (
            c / determinant,
            -b / determinant,
            -b / determinant,
            a / determinant,
        )
        offset, drift = (c * d - b * e) / determinant, (a * e - b * d) / determinant
    return offset, drift, spread
