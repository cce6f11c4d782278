"""Components of bright pixels in; one row of moments, size and flags per blob out."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.detection._split_kernels import grow_from_peaks, split_at_saddles

COLUMNS = 10
X, Y, AREA, PEAK, XX, YY, XY, WEIGHT, WIDE, TALL = range(COLUMNS)
"""Columns of a blob's row."""
AT_BORDER, SATURATED, OVERLAPPING, UNROUND = 1, 2, 4, 8
"""Bits of a blob's flags."""
MOST_SWEEPS, SETTLED_PX = 100, 1e-3
"""How often the pixels of overlapping blobs are shared again at most, until no centre moves by more (px)."""
MOST_SHARED = 6000
"""Pixels times blobs of a component beyond which its blobs stay cut where the flood cut them, as in the clutter of a lit room."""
LEAST_SPREAD = 0.1
"""px2, added to the variance of a blob while pixels are shared, so that a blob of one pixel has one."""


class ImageArrays(NamedTuple):
    """An image (H, W); base (H, W), above which grey values are weights; cut (H, W), not 0 where a blob may go on unseen."""

    image: np.ndarray
    base: np.ndarray
    cut: np.ndarray


class MeasureLimits(NamedTuple):
    """What is a blob, and when a component is several.

    min_area, max_area  px
    min_peak   grey values above the base that the brightest pixel must exceed
    split      see `split_at_saddles`; 1 and more: never
    step       see `grow_from_peaks`; 0: not so
    saturated  grey value from which a pixel is saturated
    contrast   see `is_distinct`; 0: not asked for
    sharings   see `share_pixels`
    """

    min_area: float
    max_area: float
    min_peak: float
    split: float
    step: float
    saturated: float
    contrast: float
    sharings: int


class Pixels(NamedTuple):
    """The pixels of a component in its box: weight (h, w) with one pixel around it; ys, xs (n,); label (h, w) the blob of each pixel."""

    weight: np.ndarray
    ys: np.ndarray
    xs: np.ndarray
    label: np.ndarray


class Box(NamedTuple):
    """A component's bounding box: first and last row, first and last column."""

    upper: int
    lower: int
    left: int
    right: int


@kernel
def measure(arrays, components, limits, out, flags):
    """Weighted moments of every component of a fitting size; components with several peaks become one blob per peak.

    IN  arrays ImageArrays; components Components; limits MeasureLimits
    OUT out (capacity, COLUMNS), flags (capacity,): one row per blob
    Returns how many blobs there are. O(pixels above the level), n log n in components with several peaks. Twin: tests/twins_detection.py

    Bounds: `capacity` is the number of pixels in all components. A blob has a pixel of its own, so a component gives no more blobs than it
    has pixels; what is kept is written over what was measured.
    """
    blobs = 0
    for component in range(len(components.starts) - 1):
        runs = components.order[components.starts[component] : components.starts[component + 1]]
        area, box = _extent(components, runs, arrays.image.shape[1])
        # Too large is dropped at once only where components are not grown from peaks: there a large one may hold many small blobs.
        if area < limits.min_area or (area > limits.max_area and limits.step == 0.0):
            continue
        # Most components of a noisy image are dim, and to part what is dropped afterwards would cost most of the time.
        if not _exceeds(arrays, components, runs, limits.min_peak):
            continue
        parts = 1
        # Four pixels and more, because less has no room for two peaks with a saddle.
        large = box.right - box.left + box.lower - box.upper >= 4 and area >= 2 * limits.min_area
        if limits.step > 0.0 or (large and limits.split < 1.0):
            parts = _measure_parts(arrays, components, runs, area, box, limits, out[blobs:], flags[blobs:])
        if parts == 1 and limits.step == 0.0:
            _measure_whole(arrays, components, runs, limits.saturated, out[blobs], flags[blobs : blobs + 1])
        # Blobs that do not fit are written over by those that do, so that no second array is needed.
        kept = blobs
        for blob in range(blobs, blobs + parts):
            if limits.min_area <= out[blob, AREA] <= limits.max_area and out[blob, PEAK] > limits.min_peak:
                for k in range(COLUMNS):
                    out[kept, k] = out[blob, k]
                flags[kept] = flags[blob] | (OVERLAPPING if parts > 1 else 0)
                kept += 1
        blobs = kept
    return blobs


@kernel
def _extent(components, runs, width):
    """Returns a component's number of pixels and its Box; width: of the image. O(runs)."""
    area, left, right = 0, width, 0
    for run in runs:
        area += components.lasts[run] - components.firsts[run] + 1
        left, right = min(left, components.firsts[run]), max(right, components.lasts[run])
    # Runs of a component are in the order of rows, so the first and the last have its rows.
    return area, Box(components.rows[runs[0]], components.rows[runs[-1]], left, right)


@kernel
def _exceeds(arrays, components, runs, least):
    """Returns whether some pixel of a component exceeds its base by more than `least`. O(pixels)."""
    image, base, rows = arrays.image, arrays.base, components.rows
    for run in runs:
        for column in range(components.firsts[run], components.lasts[run] + 1):
            if float(int(image[rows[run], column]) - int(base[rows[run], column])) > least:
                return True
    return False


@kernel
def _measure_parts(arrays, components, runs, area, box, limits, out, flags):
    """The blobs that a component is made of, where it is more than one or all are grown from peaks.

    OUT out (blobs, COLUMNS), flags (blobs,)
    Returns how many blobs there are. O(n log n) for n pixels, and the sweeps of `share_pixels`.
    """
    weight = _weights(arrays, components, runs, box)
    label = np.full(weight.shape, -1)
    ys, xs = np.empty(area, np.int64), np.empty(area, np.int64)
    if limits.step > 0.0:
        n, parts = grow_from_peaks(weight, limits.step, limits.min_peak, ys, xs, label)
    else:
        n, parts = split_at_saddles(weight, limits.split, ys, xs, label)
        # A component that is not cut is measured without its box, which costs less.
        if parts == 1:
            return parts
    ys, xs, parts_out = ys[:n], xs[:n], out[:parts]
    _sum_parts(arrays, Pixels(weight, ys, xs, label), box, limits.saturated, parts_out, flags)
    # To share the pixels of a component whose parts are all dropped, as in the noise of compressed images, would cost most of the time.
    if limits.contrast > 0.0 and not _has_distinct_part(arrays.image, parts_out, box, limits):
        return 0
    # Blobs that are grown from peaks part where they are, by the method's own rule.
    if limits.step == 0.0 and parts * n <= MOST_SHARED:
        share_pixels(weight, ys, xs, limits.sharings, parts_out)
    for blob in range(parts):
        parts_out[blob, X] += box.left - 1
        parts_out[blob, Y] += box.upper - 1
    return parts


@kernel
def _has_distinct_part(image, parts, box, limits):
    """Returns whether some part, in the axes of its box with the border, is a blob that stands out. O(pixels of the parts' boxes)."""
    for part in parts:
        fits = limits.min_area <= part[AREA] <= limits.max_area and part[PEAK] > limits.min_peak
        x, y = part[X] + box.left - 1, part[Y] + box.upper - 1
        if fits and is_distinct(image, x, y, part[WIDE], part[TALL], limits.contrast):
            return True
    return False


@kernel
def is_distinct(image, x, y, wide, tall, contrast):
    """Returns whether the brightest pixel of a box about (x, y) exceeds the median of those around it, 2 px away, by more than a contrast.

    O(pixels of the box), no allocation.
    """
    height, width = image.shape
    # Two pixels away, because right beside a blob its own soft edge still shines.
    aside, above = 0.5 * wide, 0.5 * tall
    left, right = int(x - aside) - 2, math.ceil(x + aside) + 2
    upper, lower = int(y - above) - 2, math.ceil(y + above) + 2
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
    return darker > around // 2 or around == 0


@kernel
def _measure_whole(arrays, components, runs, saturated, out, flag):
    """OUT out (COLUMNS,), flag (1,): one component as one blob, by moments about its first pixel, moved to the centroid. O(pixels)."""
    image, base, cut = arrays.image, arrays.base, arrays.cut
    rows, firsts, lasts = components.rows, components.firsts, components.lasts
    # About the first pixel: sums of squares of large coordinates would lose the digits that the variance needs.
    x0, y0 = firsts[runs[0]], rows[runs[0]]
    left, right = x0, x0
    total = sx = sy = sxx = syy = sxy = 0.0
    area, full, ends = 0, 0, 0
    peak = 0.0
    for run in runs:
        y = float(rows[run] - y0)
        for column in range(firsts[run], lasts[run] + 1):
            value = int(image[rows[run], column])
            # Unsigned grey values are made whole numbers before they are subtracted: below zero they would wrap around.
            w, x = float(value - int(base[rows[run], column])), float(column - x0)
            total += w
            sx += w * x
            sy += w * y
            sxx += w * x * x
            syy += w * y * y
            sxy += w * x * y
            peak = max(peak, w)
            full += value >= saturated
            ends += cut[rows[run], column] != 0
        area += lasts[run] - firsts[run] + 1
        left, right = min(left, firsts[run]), max(right, lasts[run])
    x, y = sx / total, sy / total
    out[WIDE], out[TALL] = right - left + 1, rows[runs[-1]] - y0 + 1
    out[X], out[Y], out[AREA], out[PEAK], out[WEIGHT] = x0 + x, y0 + y, area, peak, total
    out[XX], out[YY], out[XY] = sxx / total - x * x, syy / total - y * y, sxy / total - x * y
    flag[0] = (SATURATED if full else 0) | (AT_BORDER if ends else 0)


@kernel
def _weights(arrays, components, runs, box):
    """Returns a component's weights in its box, with one pixel of 0 around it; pixels of other components are 0 too. O(area of the box)."""
    image, base, rows = arrays.image, arrays.base, components.rows
    weight = np.zeros((box.lower - box.upper + 3, box.right - box.left + 3), np.int64)
    for run in runs:
        for column in range(components.firsts[run], components.lasts[run] + 1):
            weight[rows[run] - box.upper + 1, column - box.left + 1] = int(image[rows[run], column]) - int(base[rows[run], column])
    return weight


@kernel
def _sum_parts(arrays, pixels, box, saturated, out, flags):
    """Moments, area, extent, peak and flags of the blobs that the pixels of a box belong to.

    OUT out (blobs, COLUMNS), in the axes of the box with its border; flags (blobs,)
    O(pixels).
    """
    weight, ys, xs, label = pixels.weight, pixels.ys, pixels.xs, pixels.label
    upper, left = box.upper - 1, box.left - 1
    ends = np.empty((len(out), 4), np.int64)
    for blob in range(len(out)):
        flags[blob] = 0
        for k in range(COLUMNS):
            out[blob, k] = 0.0
        ends[blob, 0], ends[blob, 1] = weight.shape[1], 0
        ends[blob, 2], ends[blob, 3] = weight.shape[0], 0
    for i in range(len(ys)):
        y, x = ys[i], xs[i]
        blob, w = label[y, x], float(weight[y, x])
        out[blob, WEIGHT] += w
        out[blob, X] += w * x
        out[blob, Y] += w * y
        out[blob, XX] += w * x * x
        out[blob, YY] += w * y * y
        out[blob, XY] += w * x * y
        out[blob, AREA] += 1.0
        out[blob, PEAK] = max(out[blob, PEAK], w)
        ends[blob, 0], ends[blob, 1] = min(ends[blob, 0], x), max(ends[blob, 1], x)
        ends[blob, 2], ends[blob, 3] = min(ends[blob, 2], y), max(ends[blob, 3], y)
        # A flag of one pixel is a flag of the blob.
        if arrays.image[upper + y, left + x] >= saturated:
            flags[blob] |= SATURATED
        if arrays.cut[upper + y, left + x]:
            flags[blob] |= AT_BORDER
    for blob in range(len(out)):
        out[blob, WIDE], out[blob, TALL] = ends[blob, 1] - ends[blob, 0] + 1, ends[blob, 3] - ends[blob, 2] + 1
        _to_central_moments(out[blob])


@kernel
def _to_central_moments(blob):
    """OUT blob (COLUMNS,): sums of weighted coordinates and their products become mean and covariance. O(1)."""
    for k in (X, Y, XX, YY, XY):
        blob[k] /= blob[WEIGHT]
    blob[XX] -= blob[X] * blob[X]
    blob[YY] -= blob[Y] * blob[Y]
    blob[XY] -= blob[X] * blob[Y]


@kernel
def share_pixels(weight, ys, xs, most, out):
    """Share the pixels (n,) of blobs that overlap by a mixture of round Gaussians, one per blob: expectation and maximization in turn.

    IN  most: sweeps times pixels times blobs at most
    OUT out (blobs, COLUMNS): moments and weights, begun from those of the parts that the blobs were cut into
    O(sweeps n blobs), until no centre moves by SETTLED_PX, MOST_SWEEPS at most. Twin: tests/twins_detection.py
    """
    blobs = len(out)
    share, spreads, peaks = np.empty(blobs), np.empty(blobs), np.empty(blobs)
    sums = np.empty((blobs, COLUMNS))
    for _ in range(min(MOST_SWEEPS, max(1, most // max(1, len(ys) * blobs)))):
        for blob in range(blobs):
            # Round, although blobs may not be: with free axes, one of two blobs could stretch over the other.
            spreads[blob] = 0.5 * (out[blob, XX] + out[blob, YY]) + LEAST_SPREAD
            peaks[blob] = out[blob, WEIGHT] / spreads[blob]
            for k in range(COLUMNS):
                sums[blob, k] = 0.0
        for i in range(len(ys)):
            x, y = float(xs[i]), float(ys[i])
            total = 0.0
            for blob in range(blobs):
                dx, dy = x - out[blob, X], y - out[blob, Y]
                # The tiny addend gives a pixel that is far from all of them to someone, instead of dividing by zero.
                share[blob] = peaks[blob] * math.exp(-0.5 * (dx * dx + dy * dy) / spreads[blob]) + 1e-300
                total += share[blob]
            for blob in range(blobs):
                w = weight[ys[i], xs[i]] * share[blob] / total
                sums[blob, WEIGHT] += w
                sums[blob, X] += w * x
                sums[blob, Y] += w * y
                sums[blob, XX] += w * x * x
                sums[blob, YY] += w * y * y
                sums[blob, XY] += w * x * y
        moved = 0.0
        for blob in range(blobs):
            _to_central_moments(sums[blob])
            # Centres are what is wanted, so that they decide when it is enough.
            moved = max(moved, math.fabs(out[blob, X] - sums[blob, X]), math.fabs(out[blob, Y] - sums[blob, Y]))
            for k in (X, Y, XX, YY, XY, WEIGHT):
                out[blob, k] = sums[blob, k]
        if moved < SETTLED_PX:
            break
