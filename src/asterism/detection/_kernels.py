"""Kernels of detection: a grey image and a level image in; connected blobs with their moments out."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel

COLUMNS = 10
X, Y, AREA, PEAK, XX, YY, XY, WEIGHT, WIDE, TALL = range(COLUMNS)

AT_BORDER, SATURATED, OVERLAPPING, UNROUND = 1, 2, 4, 8

STEP = 64
SWEEPS, STILL_PX, MOST_MIXED = 100, 1e-3, 6000
"""How often the pixels of overlapping blobs are shared anew, until no centre moves by so much; and pixels times blobs beyond which they
stay cut where the flood cut them, as in the clutter of a lit room."""


@kernel
def _root(parents, i):
    while parents[i] != i:
        parents[i] = parents[parents[i]]
        i = parents[i]
    return i


@kernel
def _dark(image, level, row, start):
    """Whether none of the next STEP pixels is above its level: no branch and no index that could be negative, so that the processor
    takes many at once."""
    here, limit = image[row, start : start + STEP], level[row, start : start + STEP]
    above = False
    for k in range(STEP):
        above |= here[k] > limit[k]
    return not above


@kernel
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


@kernel
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


@kernel
def measure(image, base, cut, rows, firsts, lasts, order, starts, limits, split, step, top, out, flags):
    """Weighted moments of every component of a fitting size; components with several peaks become one blob per peak.

    IN  image (H, W), base (H, W): weights are grey values above it; cut (H, W): not 0 where a blob may go on unseen; rows, firsts, lasts:
        runs; order, starts: see `by_component`; limits: smallest and largest area px, weight that the brightest pixel must exceed;
        split: see `_split`, 1 and more: never; step: see `_grow`, 0: not so; top: grey value from which a pixel is saturated
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
        many = right - left + lower - upper >= 4 and area >= 2 * limits[0] and split < 1.0
        parts = 1
        if many or step > 0.0:
            weight = _window(image, base, rows, firsts, lasts, runs, upper, lower, left, right)
            label = np.full(weight.shape, -1)
            ys, xs = np.empty(area, np.int64), np.empty(area, np.int64)
            n, parts = _grow(weight, step, limits[2], ys, xs, label) if step > 0.0 else _split(weight, split, ys, xs, label)
            if parts > 1 or step > 0.0:
                mine = out[blobs : blobs + parts]
                _look(image, cut, weight, ys[:n], xs[:n], label, upper - 1, left - 1, top, mine, flags[blobs:])
                if step == 0.0 and parts * n <= MOST_MIXED:
                    _mix(weight, ys[:n], xs[:n], mine)
                for blob in range(parts):
                    mine[blob, X] += left - 1
                    mine[blob, Y] += upper - 1
        if parts == 1 and step == 0.0:
            _whole(image, base, cut, rows, firsts, lasts, runs, top, out[blobs], flags[blobs : blobs + 1])
        kept = blobs
        for blob in range(blobs, blobs + parts):
            if limits[0] <= out[blob, AREA] <= limits[1] and out[blob, PEAK] > limits[2]:
                for k in range(COLUMNS):
                    out[kept, k] = out[blob, k]
                flags[kept] = flags[blob] | (OVERLAPPING if parts > 1 else 0)
                kept += 1
        blobs = kept
    return blobs


@kernel
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


@kernel
def _window(image, base, rows, firsts, lasts, runs, upper, lower, left, right):
    """A component's weights in its bounding box, with one pixel of 0 around it; pixels of other components are 0 too."""
    weight = np.zeros((lower - upper + 3, right - left + 3), np.int64)
    for run in runs:
        for column in range(firsts[run], lasts[run] + 1):
            weight[rows[run] - upper + 1, column - left + 1] = int(image[rows[run], column]) - int(base[rows[run], column])
    return weight


@kernel
def _split(weight, split, ys, xs, label):
    """Part a component at the saddles between its peaks: watershed by flooding from the brightest pixel down.

    A pixel's height is its weight, summed over 3 x 3 pixels against noise, times its distance from the component's edge: so flat saturated
    tops part at their waist, others at their valley. A peak that stands out above its saddle by less than the share `split` of its height
    is joined to its neighbour at once.

    IN  weight (h, w), 0 around the component
    OUT ys, xs (n,) the component's pixels; label (h, w) the peak that each belongs to, where there are several
    Returns n and the number of peaks. O(n log n), O(n) where there is one peak.
    """
    tall, wide = weight.shape
    height = _from_edge(weight)
    n = 0
    for y in range(1, tall - 1):
        for x in range(1, wide - 1):
            if weight[y, x] > 0:
                around = 0
                for dy in range(-1, 2):
                    around += weight[y + dy, x - 1] + weight[y + dy, x] + weight[y + dy, x + 1]
                height[y, x] *= around
                ys[n], xs[n] = y, x
                n += 1
    peaks = 0
    for i in range(n):
        peaks += _is_peak(height, ys[i], xs[i])
    if peaks < 2:
        return n, peaks

    ranks = np.empty(n, np.int64)
    for i in range(n):
        ranks[i] = i - n * height[ys[i], xs[i]]
    parents = np.empty(n, np.int64)
    for rank in np.sort(ranks):
        i = rank % n
        y, x = ys[i], xs[i]
        here = height[y, x]
        mine = -1
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                if label[y + dy, x + dx] < 0:
                    continue
                other = _root(parents, label[y + dy, x + dx])
                if mine < 0:
                    mine = other
                elif other != mine:
                    high, low = (other, mine) if ranks[other] < ranks[mine] else (mine, other)
                    peak = height[ys[low], xs[low]]
                    if peak - here < split * peak:
                        parents[low] = high
                    mine = high
        if mine < 0:
            mine = i
        parents[i] = mine
        label[y, x] = mine
    return n, _numbered(parents, ys[:n], xs[:n], label)


@kernel
def _grow(weight, step, lowest, ys, xs, label):
    """Part a component where its grey values rise by more than a step: the peak fitting of particle tracking velocimetry.

    From every peak above `lowest`, in reading order, a blob grows to the pixels beside it that are not taken, unless these or the pixels
    beside them are brighter by more than `step` than the one it grows from. Two blobs that touch are one where no pixel on the line between
    their centres is darker than the brighter peak by more than `step`, or where the centres are nearer than 2 px. After Maas, Gruen and
    Papantoniou, Particle tracking velocimetry in three-dimensional flows, Experiments in Fluids 15, 1993.

    IN  weight (h, w), 0 around the component
    OUT ys, xs (n,) the pixels that some blob has; label (h, w) which blob that is
    Returns n and the number of blobs. O(n), and the touching pixels times the centres' distance. Twin: tests/twins_detection.py
    """
    tall, wide = weight.shape
    n = peaks = 0
    centres = np.zeros((len(ys), 4))
    for y in range(1, tall - 1):
        for x in range(1, wide - 1):
            if weight[y, x] <= lowest or label[y, x] >= 0 or not _is_peak(weight, y, x):
                continue
            label[y, x] = peaks
            centres[peaks, 3] = weight[y, x]
            ys[n], xs[n] = y, x
            next_, n = n, n + 1
            while next_ < n:
                row, column = ys[next_], xs[next_]
                limit = weight[row, column] + step
                w = float(weight[row, column])
                centres[peaks, 0] += w * column
                centres[peaks, 1] += w * row
                centres[peaks, 2] += w
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
    parents = np.arange(peaks)
    for i in range(n):
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                a, b = label[ys[i], xs[i]], label[ys[i] + dy, xs[i] + dx]
                if b > a and _root(parents, a) != _root(parents, b) and _level_between(weight, centres[a], centres[b], step):
                    a, b = _root(parents, a), _root(parents, b)
                    parents[max(a, b)] = min(a, b)
    return n, _numbered(parents, ys[:n], xs[:n], label)


@kernel
def _level_between(weight, a, b, step):
    """Whether no pixel between two centres (x sum, y sum, weight sum, peak) is darker than their peaks by more than a step, or they are
    near."""
    x, y = a[0] / a[2], a[1] / a[2]
    dx, dy = b[0] / b[2] - x, b[1] / b[2] - y
    away = math.sqrt(dx * dx + dy * dy)
    if away < 2.0:
        return True
    darkest = math.inf
    for k in range(1, math.ceil(away)):
        darkest = min(darkest, float(weight[int(y + k * dy / away + 0.5), int(x + k * dx / away + 0.5)]))
    return darkest >= max(a[3], b[3]) - step


@kernel
def _is_peak(height, y, x):
    """Whether none of the eight pixels around is higher."""
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            if height[y + dy, x + dx] > height[y, x]:
                return False
    return True


@kernel
def _numbered(parents, ys, xs, label):
    """Label pixels (n,) by their groups, counted from 0 in the order in which they are met; returns how many groups there are."""
    number = np.full(len(parents), -1)
    groups = 0
    for i in range(len(ys)):
        root = _root(parents, label[ys[i], xs[i]])
        if number[root] < 0:
            number[root] = groups
            groups += 1
        label[ys[i], xs[i]] = number[root]
    return groups


@kernel
def _look(image, cut, weight, ys, xs, label, upper, left, top, out, flags):
    """Moments, area, extent, peak and flags of the blobs that the pixels (n,) of a window belong to; the window begins at upper, left.

    OUT out (blobs, COLUMNS), in the window's axes; flags (blobs,)
    """
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
        if image[upper + y, left + x] >= top:
            flags[blob] |= SATURATED
        if cut[upper + y, left + x]:
            flags[blob] |= AT_BORDER
    for blob in range(len(out)):
        out[blob, WIDE], out[blob, TALL] = ends[blob, 1] - ends[blob, 0] + 1, ends[blob, 3] - ends[blob, 2] + 1
        _central(out[blob])


@kernel
def _central(blob):
    """Sums of weighted coordinates and their products to mean and covariance, in place."""
    for k in (X, Y, XX, YY, XY):
        blob[k] /= blob[WEIGHT]
    blob[XX] -= blob[X] * blob[X]
    blob[YY] -= blob[Y] * blob[Y]
    blob[XY] -= blob[X] * blob[Y]


@kernel
def _mix(weight, ys, xs, out):
    """Share the pixels (n,) of blobs that overlap by a mixture of round Gaussians, one per blob: expectation and maximization in turn.

    OUT out (blobs, COLUMNS): moments and weights, begun from those of the parts that the blobs were cut into
    O(sweeps n blobs), until no centre moves by STILL_PX, SWEEPS at most
    """
    blobs = len(out)
    share = np.empty(blobs)
    sums = np.empty((blobs, COLUMNS))
    for _ in range(SWEEPS):
        for blob in range(blobs):
            for k in range(COLUMNS):
                sums[blob, k] = 0.0
        for i in range(len(ys)):
            x, y = float(xs[i]), float(ys[i])
            total = 0.0
            for blob in range(blobs):
                spread = 0.5 * (out[blob, XX] + out[blob, YY]) + 0.1
                dx, dy = x - out[blob, X], y - out[blob, Y]
                share[blob] = out[blob, WEIGHT] / spread * math.exp(-0.5 * (dx * dx + dy * dy) / spread) + 1e-300
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
            _central(sums[blob])
            moved = max(moved, math.fabs(out[blob, X] - sums[blob, X]), math.fabs(out[blob, Y] - sums[blob, Y]))
            for k in (X, Y, XX, YY, XY, WEIGHT):
                out[blob, k] = sums[blob, k]
        if moved < STILL_PX:
            break


@kernel
def _from_edge(weight):
    """Each pixel's distance from the nearest one without weight, in thirds of a pixel: the chamfer of 3 aside and 4 across."""
    tall, wide = weight.shape
    away = np.zeros((tall, wide), np.int64)
    for y in range(1, tall):
        for x in range(1, wide - 1):
            if weight[y, x] > 0:
                away[y, x] = min(away[y - 1, x] + 3, away[y, x - 1] + 3, away[y - 1, x - 1] + 4, away[y - 1, x + 1] + 4)
    for y in range(tall - 2, -1, -1):
        for x in range(wide - 2, 0, -1):
            near = min(away[y + 1, x] + 3, away[y, x + 1] + 3, away[y + 1, x - 1] + 4, away[y + 1, x + 1] + 4)
            away[y, x] = min(away[y, x], near)
    return away
