"""What lies behind markers: regions too large to be a marker, and the pixels around each blob, in; what must be exceeded, out."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.detection._moment_kernels import TALL, WIDE, X, Y

SAMPLE = 4096
"""Grey values of a large component from which its median and quartile are taken, at most."""
QUARTILE = 0.6745
"""Standard deviations from the median to a quartile."""


@kernel
def raise_threshold(image, level, components, largest, noise, top):
    """Raise the threshold within each component that is too large for a marker, so that markers must stand out from it.

    IN  image (H, W); components Components; largest: area px of a marker; noise: the least standard deviation of a component's grey
        values; top: the end of the grey scale
    OUT level (H, W): in those components the median plus six standard deviations, by the lower quartile, where that is higher
    Returns whether there is such a component. O(pixels above the level), but for some thousand values sorted per component.
    Twin: tests/twins_detection.py

    Bounds: of `area` pixels every `every`-th is taken, the first one too: (area + every - 1) // every.
    """
    rows, firsts, lasts, order, starts = components.rows, components.firsts, components.lasts, components.order, components.starts
    raised = False
    for component in range(len(starts) - 1):
        runs = order[starts[component] : starts[component + 1]]
        area = 0
        for run in runs:
            area += lasts[run] - firsts[run] + 1
        if area <= largest:
            continue
        # Some thousand values tell the median well enough; more would only cost the sort.
        every = (area + SAMPLE - 1) // SAMPLE
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
        # The lower quartile, because markers on the region lie in the upper half and must not count as its noise.
        threshold = middle + 6.0 * max(noise, (middle - values[n // 4]) / QUARTILE)
        for run in runs:
            for column in range(firsts[run], lasts[run] + 1):
                # Never lower than before, so that what was dark stays dark.
                if threshold > level[rows[run], column]:
                    level[rows[run], column] = min(threshold, top)
                    raised = True
    return raised


@kernel
def stands_out(image, blobs, contrast, out):
    """Whether the brightest pixel of each blob's box is brighter by more than a contrast than the median of those around it, 2 px away.

    IN  image (H, W); blobs (N, COLUMNS); contrast: grey values
    OUT out (N,)
    O(pixels of the boxes), no allocation. Twin: tests/twins_detection.py
    """
    height, width = image.shape
    for i in range(len(blobs)):
        # Two pixels away, because right beside a blob its own soft edge still shines.
        aside, above = 0.5 * blobs[i, WIDE], 0.5 * blobs[i, TALL]
        left, right = int(blobs[i, X] - aside) - 2, math.ceil(blobs[i, X] + aside) + 2
        upper, lower = int(blobs[i, Y] - above) - 2, math.ceil(blobs[i, Y] + above) + 2
        brightest = 0.0
        for row in range(max(upper + 1, 0), min(lower, height)):
            for column in range(max(left + 1, 0), min(right, width)):
                brightest = max(brightest, float(image[row, column]))
        around = darker = 0
        for row in range(max(upper, 0), min(lower + 1, height)):
            # The first and the last row are walked whole, the rows between only at their two ends: the frame of the box.
            step = 1 if row in (upper, lower) else right - left
            for column in range(left, right + 1, step):
                if 0 <= column < width:
                    around += 1
                    darker += image[row, column] < brightest - contrast
        # More than half darker is the same as a median that is darker, without a sort.
        out[i] = darker > around // 2 or around == 0
