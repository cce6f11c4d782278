"""Kernels of detection: a grey image and a level image in; connected blobs with their moments out."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

COLUMNS = 10
X, Y, AREA, PEAK, XX, YY, XY, WEIGHT, WIDE, TALL = range(COLUMNS)

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
def measure(image, base, cut, rows, firsts, lasts, order, starts, limits, split, step, top, out, flags):
    """Weighted moments of every component of a fitting size; components with several peaks become one blob per peak.

    IN  image (H, W), base (H, W): weights are grey values above it; cut (H, W): not 0 where a blob may go on unseen; rows, firsts, lasts:
        runs; order, starts: see `by_component`; limits: smallest and largest area px, weight that the brightest pixel must exceed;
        split: how deep the saddle between two peaks must be, as a share of the lower one, to part them (1 and more: never); step: see
        `_grow`, 0: not so; top: grey value from which a pixel is saturated
    OUT out (capacity, COLUMNS), flags (capacity,): one row per blob
    Returns how many blobs there are. O(pixels above the level), n log n in components with several peaks.
    """
    blobs = 0
    for component in range(len(starts) - 1):
        runs = order[starts[component] : starts[component + 1]]
        area, left, right = 0, image.shape[1], 0
        for run in runs:
            area += lasts[run] - firsts[run] + 1
            left, right = min(left, firsts[run]), max(right, lasts[run])
        if area < limits[0] or (area > limits[1] and step == 0.0):
            continue
        upper, lower = rows[runs[0]], rows[runs[-1]]
        box = (upper, lower, left, right)
        parts = 0
        if step > 0.0:
            parts = _grow(image, base, cut, rows, firsts, lasts, runs, box, step, limits[2], top, out[blobs:], flags[blobs:])
        elif split < 1.0 and area >= 2 * limits[0] and right - left + lower - upper >= 4:
            parts = _split(image, base, cut, rows, firsts, lasts, runs, box, split, top, out[blobs:], flags[blobs:])
        if parts == 0 and step == 0.0:
            _whole(image, base, cut, rows, firsts, lasts, runs, top, out[blobs], flags[blobs : blobs + 1])
            parts = 1
        kept = blobs
        for blob in range(blobs, blobs + parts):
            if limits[0] <= out[blob, AREA] <= limits[1] and out[blob, PEAK] > limits[2]:
                out[kept] = out[blob]
                flags[kept] = flags[blob] | (OVERLAPPING if parts > 1 else 0)
                kept += 1
        blobs = kept
    return blobs


@njit(cache=True, nogil=True)
def _whole(image, base, cut, rows, firsts, lasts, runs, top, out, flag):
    """One component as one blob: moments about its first pixel, moved to the centroid."""
    x0, y0 = firsts[runs[0]], rows[runs[0]]
    left, right = x0, x0
    total = sx = sy = sxx = syy = sxy = 0.0
    area, full, ends = 0, 0, 0
    peak = 0.0
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
            peak = max(peak, w)
            full += value >= top
            ends += cut[rows[run], column] != 0
        area += lasts[run] - firsts[run] + 1
        left, right = min(left, firsts[run]), max(right, lasts[run])
    x, y = sx / total, sy / total
    out[WIDE], out[TALL] = right - left + 1, rows[runs[-1]] - y0 + 1
    out[X], out[Y], out[AREA], out[PEAK], out[WEIGHT] = x0 + x, y0 + y, area, peak, total
    out[XX], out[YY], out[XY] = sxx / total - x * x, syy / total - y * y, sxy / total - x * y
    flag[0] = (SATURATED if full else 0) | (AT_BORDER if ends else 0)


@njit(cache=True, nogil=True)
def _split(image, base, cut, rows, firsts, lasts, runs, box, split, top, out, flags):
    """Part a component at the saddles between its peaks: watershed by flooding from the brightest pixel down, peaks that stand out too
    little above their saddle joined to their neighbour at once; then a mixture of round Gaussians, one per peak, shares pixels out.

    A pixel's height is its weight, summed over 3 x 3 pixels against noise, times its distance from the component's edge: so flat saturated
    tops part at their waist, others at their valley. Returns the number of blobs, written as rows of out and flags, or 0 and nothing
    written where there is one peak only.
    """
    weight = _window(image, base, rows, firsts, lasts, runs, box)
    tall, wide = weight.shape
    area = 0
    for run in runs:
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
        return 0

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
        return 0

    share = np.zeros((n, lobes))
    for i in range(n):
        share[i, label[ys[i], xs[i]]] = 1.0
    _look(image, cut, weight, ys, xs, label, box, lobes, top, out, flags)
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
        out[lobe, X] += box[2] - 1
        out[lobe, Y] += box[0] - 1
    return lobes


@njit(cache=True, nogil=True)
def _grow(image, base, cut, rows, firsts, lasts, runs, box, step, lowest, top, out, flags):
    """Part a component where its grey values rise by more than a step: the peak fitting of particle tracking velocimetry.

    From every peak above `lowest`, in reading order, a blob grows to the pixels beside it that are not taken, unless these or the pixels
    beside them are brighter by more than `step` than the one it grows from. Two blobs that touch are one where no pixel on the line between
    their centres is darker than the brighter peak by more than `step`, or where the centres are nearer than 2 px. Returns the number
    of blobs, written as rows of out and flags. O(n), and the touching pairs times their distance. After Maas, Gruen and Papantoniou,
    Particle tracking velocimetry in three-dimensional flows, Experiments in Fluids 15, 1993. Twin: tests/twins_detection.py
    """
    weight = _window(image, base, rows, firsts, lasts, runs, box)
    tall, wide = weight.shape
    label = np.full((tall, wide), -1, np.int64)
    ys, xs = np.empty(tall * wide, np.int64), np.empty(tall * wide, np.int64)
    heights = np.empty(tall * wide, np.int64)
    n = peaks = 0
    for y in range(1, tall - 1):
        for x in range(1, wide - 1):
            here = weight[y, x]
            if here <= lowest or label[y, x] >= 0 or here < weight[y - 1 : y + 2, x - 1 : x + 2].max():
                continue
            label[y, x] = peaks
            heights[peaks] = here
            ys[n], xs[n] = y, x
            next_, n = n, n + 1
            while next_ < n:
                row, column = ys[next_], xs[next_]
                limit = weight[row, column] + step
                next_ += 1
                for beside in range(4):
                    r, c = row + (beside == 0) - (beside == 1), column + (beside == 2) - (beside == 3)
                    if weight[r, c] <= 0 or label[r, c] >= 0:
                        continue
                    around = max(weight[r - 1, c], weight[r + 1, c], weight[r, c - 1], weight[r, c + 1], weight[r, c])
                    if around <= limit:
                        label[r, c] = peaks
                        ys[n], xs[n] = r, c
                        n += 1
            peaks += 1
    if peaks == 0:
        return 0
    ys, xs = ys[:n], xs[:n]
    parents = np.arange(peaks)
    if peaks > 1:
        centres = np.zeros((peaks, 3))
        for i in range(n):
            w = weight[ys[i], xs[i]]
            centres[label[ys[i], xs[i]]] += np.array([w * xs[i], w * ys[i], w], np.float64)
        looked_at = np.zeros((peaks, peaks), np.bool_)
        for i in range(n):
            for r in range(ys[i] - 1, ys[i] + 2):
                for c in range(xs[i] - 1, xs[i] + 2):
                    a, b = label[ys[i], xs[i]], label[r, c]
                    if b <= a or looked_at[a, b]:
                        continue
                    looked_at[a, b] = True
                    if _level_between(weight, centres[a], centres[b], max(heights[a], heights[b]) - step):
                        a, b = _root(parents, a), _root(parents, b)
                        parents[max(a, b)] = min(a, b)
    blobs = 0
    number = np.empty(peaks, np.int64)
    for peak in range(peaks):
        if parents[peak] == peak:
            number[peak] = blobs
            blobs += 1
        else:
            number[peak] = number[_root(parents, peak)]
    for i in range(n):
        label[ys[i], xs[i]] = number[label[ys[i], xs[i]]]
    _look(image, cut, weight, ys, xs, label, box, blobs, top, out, flags)
    for blob in range(blobs):
        mine = np.array([i for i in range(n) if label[ys[i], xs[i]] == blob])
        _moments(weight, ys[mine], xs[mine], np.ones((len(mine), 1)), out[blob : blob + 1])
        out[blob, X] += box[2] - 1
        out[blob, Y] += box[0] - 1
    return blobs


@njit(cache=True, nogil=True)
def _level_between(weight, a, b, lowest):
    """Whether no pixel on the line between two centres (x sum, y sum, weight sum) weighs less than `lowest`; true where they are near."""
    x, y = a[0] / a[2], a[1] / a[2]
    dx, dy = b[0] / b[2] - x, b[1] / b[2] - y
    away = math.sqrt(dx * dx + dy * dy)
    if away < 2.0:
        return True
    darkest = math.inf
    for k in range(1, math.ceil(away)):
        darkest = min(darkest, float(weight[int(y + k * dy / away + 0.5), int(x + k * dx / away + 0.5)]))
    return darkest >= lowest


@njit(cache=True, nogil=True)
def _window(image, base, rows, firsts, lasts, runs, box):
    """A component's weights in its bounding box, with one pixel of 0 around it; pixels of other components are 0 too."""
    upper, lower, left, right = box
    weight = np.zeros((lower - upper + 3, right - left + 3), np.int64)
    for run in runs:
        for column in range(firsts[run], lasts[run] + 1):
            weight[rows[run] - upper + 1, column - left + 1] = int(image[rows[run], column]) - int(base[rows[run], column])
    return weight


@njit(cache=True, nogil=True)
def _look(image, cut, weight, ys, xs, label, box, blobs, top, out, flags):
    """Area, extent, peak and flags of the blobs that the pixels of a window belong to."""
    height, width = image.shape
    ends = np.empty((blobs, 4), np.int64)
    for blob in range(blobs):
        out[blob, AREA] = out[blob, PEAK] = 0.0
        flags[blob] = 0
        ends[blob] = height + width, -1, height + width, -1
    for i in range(len(ys)):
        blob = label[ys[i], xs[i]]
        y, x = ys[i] + box[0] - 1, xs[i] + box[2] - 1
        left, right, upper, lower = ends[blob]
        ends[blob] = min(left, x), max(right, x), min(upper, y), max(lower, y)
        out[blob, AREA] += 1
        out[blob, PEAK] = max(out[blob, PEAK], float(weight[ys[i], xs[i]]))
        if image[y, x] >= top:
            flags[blob] |= SATURATED
        if cut[y, x]:
            flags[blob] |= AT_BORDER
    for blob in range(blobs):
        out[blob, WIDE], out[blob, TALL] = ends[blob, 1] - ends[blob, 0] + 1, ends[blob, 3] - ends[blob, 2] + 1


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
