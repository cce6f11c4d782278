"""Kernels of what lies behind markers: components too large to be any, and the pixels around each blob, in; what must be exceeded, out."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from asterism.detection._kernels import TALL, WIDE, X, Y

SOME, QUARTILE = 4096, 0.6745
"""Grey values that tell what a large component is like; standard deviations from the median to a quartile."""


@njit(cache=True, nogil=True)
def raise_levels(image, level, rows, firsts, lasts, order, starts, largest, noise, top):
    """Make each component that is too large for a marker a ground of its own: its pixels must stand out from it.

    IN  image (H, W); rows, firsts, lasts: runs; order, starts: see `by_component`; largest: area px of a marker; noise: the least that a
        component's grey values are taken to have; top: the end of the grey scale
    OUT level (H, W): in those components their median and six times the standard deviation that the lower quartile tells, where that is
        higher
    Returns whether there is such a component. O(pixels above the level), but for some thousand values sorted per component.
    Twin: tests/twins_detection.py
    """
    raised = False
    for component in range(len(starts) - 1):
        runs = order[starts[component] : starts[component + 1]]
        area = 0
        for run in runs:
            area += lasts[run] - firsts[run] + 1
        if area <= largest:
            continue
        every = (area + SOME - 1) // SOME
        values = np.empty((area + every - 1) // every, np.float64)
        place = n = 0
        for run in runs:
            for column in range(firsts[run], lasts[run] + 1):
                if place % every == 0:
                    values[n] = image[rows[run], column]
                    n += 1
                place += 1
        values.sort()
        middle = values[n // 2]
        own = middle + 6.0 * max(noise, (middle - values[n // 4]) / QUARTILE)
        for run in runs:
            for column in range(firsts[run], lasts[run] + 1):
                if own > level[rows[run], column]:
                    level[rows[run], column] = min(own, top)
                    raised = True
    return raised


@njit(cache=True, nogil=True)
def contrasts(image, blobs, out):
    """How much brighter the brightest pixel of each blob's box is than the median of the pixels that run around the box, 2 px away.

    IN  image (H, W); blobs (N, COLUMNS)
    OUT out (N,)
    O(pixels of the boxes). Twin: tests/twins_detection.py
    """
    height, width = image.shape
    for i in range(len(blobs)):
        aside, above = 0.5 * blobs[i, WIDE], 0.5 * blobs[i, TALL]
        left, right = int(blobs[i, X] - aside) - 2, math.ceil(blobs[i, X] + aside) + 2
        upper, lower = int(blobs[i, Y] - above) - 2, math.ceil(blobs[i, Y] + above) + 2
        around = np.empty(2 * (right - left + lower - upper) + 4)
        n, brightest = 0, 0.0
        for row in range(max(upper, 0), min(lower + 1, height)):
            for column in range(max(left, 0), min(right + 1, width)):
                value = float(image[row, column])
                if row in (upper, lower) or column in (left, right):
                    around[n] = value
                    n += 1
                else:
                    brightest = max(brightest, value)
        around[:n].sort()
        out[i] = brightest - around[n // 2] if n > 0 else brightest
