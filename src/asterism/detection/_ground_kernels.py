"""Kernels of what lies behind markers: components too large to be any, and the pixels around each blob, in; what must be exceeded, out."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.detection._kernels import TALL, WIDE, X, Y

SOME, QUARTILE = 4096, 0.6745
"""Grey values that tell what a large component is like; standard deviations from the median to a quartile."""


@kernel
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


@kernel
def stand_out(image, blobs, contrast, out):
    """Whether the brightest pixel of each blob's box is brighter by more than a contrast than the median of those around it, 2 px away.

    IN  image (H, W); blobs (N, COLUMNS); contrast: grey values
    OUT out (N,)
    O(pixels of the boxes), no allocation. Twin: tests/twins_detection.py
    """
    height, width = image.shape
    for i in range(len(blobs)):
        aside, above = 0.5 * blobs[i, WIDE], 0.5 * blobs[i, TALL]
        left, right = int(blobs[i, X] - aside) - 2, math.ceil(blobs[i, X] + aside) + 2
        upper, lower = int(blobs[i, Y] - above) - 2, math.ceil(blobs[i, Y] + above) + 2
        brightest = 0.0
        for row in range(max(upper + 1, 0), min(lower, height)):
            for column in range(max(left + 1, 0), min(right, width)):
                brightest = max(brightest, float(image[row, column]))
        around = darker = 0
        for row in range(max(upper, 0), min(lower + 1, height)):
            step = 1 if row in (upper, lower) else right - left
            for column in range(left, right + 1, step):
                if 0 <= column < width:
                    around += 1
                    darker += image[row, column] < brightest - contrast
        out[i] = darker > around // 2 or around == 0
