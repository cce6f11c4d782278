"""Kernels of the colour classes of one image."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel


@kernel
def posteriors(points, centres, spreads, outliers, out):
    """Probabilities that points are of each of a few normal distributions, all equally frequent.

    IN  points (n, 2); centres (q, 2); spreads (q, 2, 2); outliers, a density that every distribution has everywhere
    OUT out (n, q)

    O(n q), allocates five numbers a colour. Twin: tests/twins_garment_read.py
    """
    q = len(centres)
    shape = np.empty((q, 5))
    for k in range(q):
        xx, xy, yy = spreads[k, 0, 0], spreads[k, 0, 1], spreads[k, 1, 1]
        det = xx * yy - xy * xy
        # What depends on the colour alone is worked out once, not for each point.
        shape[k, 0], shape[k, 1], shape[k, 2], shape[k, 3], shape[k, 4] = xx, 2.0 * xy, yy, det, np.sqrt(det)
    for i in range(len(points)):
        whole = 0.0
        for k in range(q):
            x, y = points[i, 0] - centres[k, 0], points[i, 1] - centres[k, 1]
            far = shape[k, 2] * x * x - shape[k, 1] * x * y + shape[k, 0] * y * y
            # Outliers everywhere: a point far from all colours is then no colour's surely, instead of 0 / 0.
            value = np.exp(-0.5 * far / shape[k, 3]) / shape[k, 4] + outliers
            out[i, k] = value
            whole += value
        for k in range(q):
            out[i, k] /= whole


@kernel
def fit_mixture(points, least, outliers, rounds, centres, spreads, weights):
    """Fit a few normal distributions to points, by expectation and maximisation from given ones.

    IN   points (n, 2); least standard deviation; outliers of `posteriors`; rounds
    IO   centres (q, 2); spreads (q, 2, 2)
    WORK weights (n, q)

    O(n q rounds). Twin: tests/twins_garment_read.py
    """
    for _ in range(rounds):
        posteriors(points, centres, spreads, outliers, weights)
        for k in range(len(centres)):
            whole, x, y = 0.0, 0.0, 0.0
            for i in range(len(points)):
                whole += weights[i, k]
                x += weights[i, k] * points[i, 0]
                y += weights[i, k] * points[i, 1]
            # So few points do not tell a spread: the colour stays where it is expected.
            if whole < 3.0:
                continue
            x, y = x / whole, y / whole
            xx, xy, yy = 0.0, 0.0, 0.0
            for i in range(len(points)):
                dx, dy = points[i, 0] - x, points[i, 1] - y
                xx += weights[i, k] * dx * dx
                xy += weights[i, k] * dx * dy
                yy += weights[i, k] * dy * dy
            centres[k, 0], centres[k, 1] = x, y
            # The least spread is added, not a limit: two points of one colour are not that colour alone.
            spreads[k, 0, 0], spreads[k, 1, 1] = xx / whole + least * least, yy / whole + least * least
            spreads[k, 0, 1] = xy / whole
            spreads[k, 1, 0] = spreads[k, 0, 1]


@kernel
def balance(shares, wanted, rounds, gains):
    """Factors on three channels, of product 1, after which the mean shares of light are those wanted.

    IN  shares (n, 3); wanted (3,) of sum 1; rounds
    IO  gains (3,)

    O(n rounds), no allocation. Twin: tests/twins_garment_read.py
    """
    for _ in range(rounds):
        a, b, c = 0.0, 0.0, 0.0
        for i in range(len(shares)):
            x, y, z = shares[i, 0] * gains[0], shares[i, 1] * gains[1], shares[i, 2] * gains[2]
            whole = x + y + z
            a += x / whole
            b += y / whole
            c += z / whole
        # Each channel alone to its share, then all to a product of 1: together they settle within some rounds.
        gains[0] *= wanted[0] * len(shares) / max(a, 1e-6)
        gains[1] *= wanted[1] * len(shares) / max(b, 1e-6)
        gains[2] *= wanted[2] * len(shares) / max(c, 1e-6)
        root = np.cbrt(gains[0] * gains[1] * gains[2])
        for channel in range(3):
            gains[channel] /= root
