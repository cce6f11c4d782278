"""Kernels of detection: a grey image and a level image in; connected blobs with their moments out."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

COLUMNS = 8
X, Y, AREA, PEAK, XX, YY, XY, WEIGHT = range(COLUMNS)

AT_BORDER, SATURATED, OVERLAPPING, UNROUND = 1, 2, 4, 8

STEP = 64
SWEEPS = 8


@njit(cache=True, nogil=True)
def _root(parents, i):
    while parents[i] != i:
        parents[i] = parents[parents[i]]
        i = parents[i]
    return i


@njit(cache=True, nogil=True)
def _dark(image, level, row, start):
    """Whether none of the next STEP pixels is above its level: no branch and no index that could be negative, so that the processor
    takes many at once."""
    here, limit = image[row, start : start + STEP], level[row, start : start + STEP]
    above = False
    for k in range(STEP):
        above |= here[k] > limit[k]
    return not above


@njit(cache=True, nogil=True)
def find_runs(image, level, reach, rows, firsts, lasts, parents):
    """Runs of pixels above their level, row by row, joined where they touch.

    IN  image, level (H, W) of the same unsigned type; reach 1 joins diagonal neighbours too (8-connected), 0 does not (4-connected)
    OUT rows, firsts, lasts (capacity,): each run's row, first and last column; parents (capacity,): the first run of its component
    Returns how many runs there are, at most H * ((W + 1) // 2). O(H W), dark stretches skipped; no allocation.
    Twin: cv2.connectedComponentsWithStats
    """
    height, width = image.shape
    count = above_start = above_end = 0
    for row in range(height):
        here = count
        column = 0
        while column < width:
            if column + STEP <= width and _dark(image, level, row, column):
                column += STEP
                continue
            stop = min(column + STEP, width)
            while column < stop:
                if image[row, column] > level[row, column]:
                    rows[count], firsts[count], parents[count] = row, column, count
                    column += 1
                    while column < width and image[row, column] > level[row, column]:
                        column += 1
                    lasts[count] = column - 1
                    count += 1
                column += 1
        other = above_start
        for run in range(here, count):
            while other < above_end and lasts[other] + reach < firsts[run]:
                other += 1
            touching = other
            while touching < above_end and firsts[touching] <= lasts[run] + reach:
                a, b = _root(parents, run), _root(parents, touching)
                parents[max(a, b)] = min(a, b)
                touching += 1
        above_start, above_end = here, count
    for run in range(count):
        parents[run] = parents[parents[run]]
    return count


@njit(cache=True, nogil=True)
def by_component(parents, count):
    """Runs in the order of their components: order (count,), starts (components + 1,) into it. O(count). Parents are roots already."""
    number = np.empty(count, np.int64)
    components = 0
    for run in range(count):
        if parents[run] == run:
            number[run] = components
            components += 1
        else:
            number[run] = number[parents[run]]
    starts = np.zeros(components + 1, np.int64)
    for run in range(count):
        starts[number[run] + 1] += 1
    for i in range(components):
        starts[i + 1] += starts[i]
    place = starts[:-1].copy()
    order = np.empty(count, np.int64)
    for run in range(count):
        order[place[number[run]]] = run
        place[number[run]] += 1
    return order, starts


@njit(cache=True, nogil=True)
def measure(image, base, rows, firsts, lasts, order, starts, limits, split, top, out, flags):
    """Weighted moments of every component of a fitting size; components with several peaks are split into one blob per peak.

    IN  image (H, W), base (H, W): weights are grey values above it; rows, firsts, lasts: runs; order, starts: see `by_component`;
        limits: smallest and largest area px; split: how deep the saddle between two peaks must be, as a share of the lower one, to
        part them (1 and more: never); top: grey value from which a pixel is saturated
    OUT out (capacity, COLUMNS), flags (capacity,): one row per blob
    Returns how many blobs there are. O(pixels above the level), n log n in components with several peaks.
    """
    height, width = image.shape
    blobs = 0
    for component in range(len(starts) - 1):
        runs = order[starts[component] : starts[component + 1]]
        area, left, right = 0, width, 0
        for run in runs:
            area += lasts[run] - firsts[run] + 1
            left, right = min(left, firsts[run]), max(right, lasts[run])
        if area < limits[0] or area > limits[1]:
            continue
        upper, lower = rows[runs[0]], rows[runs[-1]]
        flag = AT_BORDER if left == 0 or upper == 0 or right == width - 1 or lower == height - 1 else 0
        if split < 1.0 and area >= 2 * limits[0] and right - left + lower - upper >= 4:
            found = _split(image, base, rows, firsts, lasts, runs, (upper, lower, left, right), split, top, out[blobs:], flags[blobs:])
            if found > 1:
                kept = blobs
                for blob in range(blobs, blobs + found):
                    if out[blob, AREA] >= limits[0]:
                        out[kept] = out[blob]
                        flags[kept] = flags[blob] | flag | OVERLAPPING
                        kept += 1
                blobs = kept
                continue
        _whole(image, base, rows, firsts, lasts, runs, top, out[blobs], flags[blobs : blobs + 1])
        flags[blobs] |= flag
        blobs += 1
    return blobs


@njit(cache=True, nogil=True)
def _whole(image, base, rows, firsts, lasts, runs, top, out, flag):
    """One component as one blob: moments about its first pixel, moved to the centroid."""
    x0, y0 = firsts[runs[0]], rows[runs[0]]
    total = sx = sy = sxx = syy = sxy = 0.0
    area, peak, full = 0, 0, 0
    for run in runs:
        y = float(rows[run] - y0)
        for column in range(firsts[run], lasts[run] + 1):
            value = int(image[rows[run], column])
            w, x = float(value - int(base[rows[run], column])), float(column - x0)
            total += w
            sx += w * x
            sy += w * y
            sxx += w * x * x
            syy += w * y * y
            sxy += w * x * y
            peak = max(peak, value)
            full += value >= top
        area += lasts[run] - firsts[run] + 1
    x, y = sx / total, sy / total
    out[X], out[Y], out[AREA], out[PEAK], out[WEIGHT] = x0 + x, y0 + y, area, peak, total
    out[XX], out[YY], out[XY] = sxx / total - x * x, syy / total - y * y, sxy / total - x * y
    flag[0] = SATURATED if full else 0


@njit(cache=True, nogil=True)
def _split(image, base, rows, firsts, lasts, runs, box, split, top, out, flags):
    """Part a component at the saddles between its peaks: watershed by flooding from the brightest pixel down, peaks that stand out too
    little above their saddle joined to their neighbour at once; then a mixture of round Gaussians, one per peak, shares pixels out.

    A pixel's height is its weight, summed over 3 x 3 pixels against noise, times its distance from the component's edge: so flat saturated
    tops part at their waist, others at their valley. Returns the number of blobs, written as rows of out and flags, or 1 and nothing
    written where there is one peak only.
    """
    upper, lower, left, right = box
    tall, wide = lower - upper + 3, right - left + 3
    weight = np.zeros((tall, wide), np.int64)
    area = 0
    for run in runs:
        for column in range(firsts[run], lasts[run] + 1):
            weight[rows[run] - upper + 1, column - left + 1] = int(image[rows[run], column]) - int(base[rows[run], column])
        area += lasts[run] - firsts[run] + 1
    height = _from_edge(weight)
    ys, xs = np.empty(area, np.int64), np.empty(area, np.int64)
    n = 0
    for y in range(1, tall - 1):
        for x in range(1, wide - 1):
            if weight[y, x] > 0:
                above = weight[y - 1, x - 1] + weight[y - 1, x] + weight[y - 1, x + 1]
                below = weight[y + 1, x - 1] + weight[y + 1, x] + weight[y + 1, x + 1]
                height[y, x] *= above + weight[y, x - 1] + weight[y, x] + weight[y, x + 1] + below
                ys[n], xs[n] = y, x
                n += 1
    peaks = 0
    for i in range(n):
        y, x = ys[i], xs[i]
        peaks += height[y, x] >= height[y - 1 : y + 2, x - 1 : x + 2].max()
    if peaks < 2:
        return 1

    values = np.empty(n, np.int64)
    for i in range(n):
        values[i] = -height[ys[i], xs[i]]
    label = np.full((tall, wide), -1, np.int64)
    parents = np.empty(n, np.int64)
    for i in np.argsort(values, kind="mergesort"):
        y, x = ys[i], xs[i]
        mine = -1
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                if label[y + dy, x + dx] < 0:
                    continue
                other = _root(parents, label[y + dy, x + dx])
                if mine < 0:
                    mine = other
                elif other != mine:
                    high, low = (other, mine) if values[other] < values[mine] else (mine, other)
                    if values[i] - values[low] < split * -values[low]:
                        parents[low] = high
                    mine = high
        if mine < 0:
            mine = i
            parents[i] = i
        else:
            parents[i] = mine
        label[y, x] = mine
    lobes = 0
    number = np.full(n, -1, np.int64)
    for i in range(n):
        root = _root(parents, label[ys[i], xs[i]])
        if number[root] < 0:
            number[root] = lobes
            lobes += 1
        label[ys[i], xs[i]] = number[root]
    if lobes < 2:
        return 1

    share = np.zeros((n, lobes))
    for i in range(n):
        share[i, label[ys[i], xs[i]]] = 1.0
    for lobe in range(lobes):
        out[lobe, AREA] = out[lobe, PEAK] = 0.0
        flags[lobe] = 0
    for i in range(n):
        lobe = label[ys[i], xs[i]]
        value = int(image[ys[i] + upper - 1, xs[i] + left - 1])
        out[lobe, AREA] += 1
        out[lobe, PEAK] = max(out[lobe, PEAK], value)
        if value >= top:
            flags[lobe] = SATURATED
    _moments(weight, ys, xs, share, out)
    for _ in range(SWEEPS):
        for i in range(n):
            total = 0.0
            for lobe in range(lobes):
                spread = 0.5 * (out[lobe, XX] + out[lobe, YY]) + 0.1
                dx, dy = xs[i] - out[lobe, X], ys[i] - out[lobe, Y]
                share[i, lobe] = out[lobe, WEIGHT] / spread * math.exp(-0.5 * (dx * dx + dy * dy) / spread) + 1e-300
                total += share[i, lobe]
            for lobe in range(lobes):
                share[i, lobe] /= total
        _moments(weight, ys, xs, share, out)
    for lobe in range(lobes):
        out[lobe, X] += left - 1
        out[lobe, Y] += upper - 1
    return lobes


@njit(cache=True, nogil=True)
def _from_edge(weight):
    """Each pixel's distance from the nearest one without weight, in thirds of a pixel: the chamfer of 3 aside and 4 across."""
    tall, wide = weight.shape
    away = np.where(weight > 0, 3 * (tall + wide), 0)
    for y in range(1, tall):
        for x in range(1, wide - 1):
            near = min(away[y - 1, x] + 3, away[y, x - 1] + 3, away[y - 1, x - 1] + 4, away[y - 1, x + 1] + 4)
            away[y, x] = min(away[y, x], near)
    for y in range(tall - 2, -1, -1):
        for x in range(wide - 2, 0, -1):
            near = min(away[y + 1, x] + 3, away[y, x + 1] + 3, away[y + 1, x - 1] + 4, away[y + 1, x + 1] + 4)
            away[y, x] = min(away[y, x], near)
    return away


@njit(cache=True, nogil=True)
def _moments(weight, ys, xs, share, out):
    """Weighted mean and covariance of the pixels (n,) for each column of share (n, lobes), into the rows of out."""
    for lobe in range(share.shape[1]):
        total = sx = sy = sxx = syy = sxy = 0.0
        for i in range(len(ys)):
            w, x, y = share[i, lobe] * weight[ys[i], xs[i]], float(xs[i]), float(ys[i])
            total += w
            sx += w * x
            sy += w * y
            sxx += w * x * x
            syy += w * y * y
            sxy += w * x * y
        x, y = sx / total, sy / total
        out[lobe, X], out[lobe, Y], out[lobe, WEIGHT] = x, y, total
        out[lobe, XX], out[lobe, YY], out[lobe, XY] = sxx / total - x * x, syy / total - y * y, sxy / total - x * y
