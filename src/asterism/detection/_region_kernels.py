"""What lies behind markers: regions too large to be a marker, and the pixels around each blob, in; what must be exceeded, out."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel
from asterism.detection._moment_kernels import TALL, WIDE, X, Y, is_distinct

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
    for i in range(len(blobs)):
        out[i] = is_distinct(image, blobs[i, X], blobs[i, Y], blobs[i, WIDE], blobs[i, TALL], contrast)
