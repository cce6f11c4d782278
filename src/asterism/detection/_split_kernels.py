"""A component of bright pixels in; the blobs that it is made of, as labels of its pixels, out."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.detection._run_kernels import find_root

LEAST_APART = 2.0
"""px: peaks whose centres are nearer are one blob."""


@kernel
def split_at_saddles(weight, share, ys, xs, label):
    """Part a component at the saddles between its peaks: watershed by flooding from the brightest pixel down.

    A pixel's height is its weight, summed over 3 x 3 pixels against noise, times its distance from the component's edge: so flat saturated
    tops part at their waist, others at their valley. A peak that stands out above its saddle by less than a share of its height
    is joined to its neighbour at once.

    IN  weight (h, w), 0 around the component; share: of the height
    OUT ys, xs (n,) the component's pixels; label (h, w) the peak that each belongs to, where there are several
    Returns n and the number of peaks. O(n log n), O(n) where there is one peak. Twin: tests/twins_detection.py

    Bounds: ys and xs have room for the component's area, see `_heights`.
    """
    height, n = _heights(weight, ys, xs)
    peaks = 0
    for i in range(n):
        peaks += _is_peak(height, ys[i], xs[i])
    # Nearly all components have one peak, and need no flood.
    if peaks < 2:
        return n, peaks

    # Height and place in one whole number: one sort gives the order of the flood, and equal heights stay in reading order.
    ranks = np.empty(n, np.int64)
    for i in range(n):
        ranks[i] = i - n * height[ys[i], xs[i]]
    parents = np.empty(n, np.int64)
    # From the brightest pixel down: a pixel joins what lies beside it, begins a peak, or is the saddle of two.
    for rank in np.sort(ranks):
        i = rank % n
        y, x = ys[i], xs[i]
        here = height[y, x]
        joined = -1
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                if label[y + dy, x + dx] < 0:
                    continue
                other = find_root(parents, label[y + dy, x + dx])
                # Nothing around was flooded yet: a peak of its own.
                if joined < 0:
                    joined = other
                elif other != joined:
                    # The peak that was reached first is the higher one.
                    high, low = (other, joined) if ranks[other] < ranks[joined] else (joined, other)
                    peak = height[ys[low], xs[low]]
                    # A peak that stands out by so little is noise on the slope of the other.
                    if peak - here < share * peak:
                        parents[low] = high
                    # The saddle's own pixel goes to the higher peak, whether or not the two become one.
                    joined = high
        if joined < 0:
            joined = i
        parents[i] = joined
        label[y, x] = joined
    return n, _number_groups(parents, ys[:n], xs[:n], label)


@kernel
def _heights(weight, ys, xs):
    """Returns the height of each pixel in the flood (h, w), and how many there are. OUT ys, xs (n,): where they are. O(h w).

    Bounds: pixels of the component have a weight above 0 and all others 0, so n is no larger than the component's area.
    """
    tall, wide = weight.shape
    height = _distance_from_edge(weight)
    n = 0
    for y in range(1, tall - 1):
        for x in range(1, wide - 1):
            if weight[y, x] > 0:
                # Summed over 3 x 3 pixels, because single pixels are noisy enough to be peaks of their own.
                around = 0
                for dy in range(-1, 2):
                    around += weight[y + dy, x - 1] + weight[y + dy, x] + weight[y + dy, x + 1]
                height[y, x] *= around
                ys[n], xs[n] = y, x
                n += 1
    return height, n


@kernel
def grow_from_peaks(weight, step, lowest, ys, xs, label):
    """Part a component where its grey values rise by more than a step: the peak fitting of particle tracking velocimetry.

    From every peak above `lowest`, in reading order, a blob grows to the pixels beside it that are not taken, unless these or the pixels
    beside them are brighter by more than `step` than the one it grows from. Two blobs that touch are one where no pixel on the line between
    their centres is darker than the brighter peak by more than `step`, or where the centres are nearer than 2 px. After Maas, Gruen and
    Papantoniou, Particle tracking velocimetry in three-dimensional flows, Experiments in Fluids 15, 1993.

    IN  weight (h, w), 0 around the component
    OUT ys, xs (n,) the pixels that some blob has; label (h, w) which blob that is
    Returns n and the number of blobs. O(n), and the touching pixels times the centres' distance. Twin: tests/twins_detection.py

    Bounds: ys and xs have room for the component's area. Only pixels with a weight are taken, whatever `lowest` is, and each once; a blob
    begins with a pixel of its own.
    """
    tall, wide = weight.shape
    n = peaks = 0
    centres = np.zeros((len(ys), 4))
    for y in range(1, tall - 1):
        for x in range(1, wide - 1):
            # A pixel without weight belongs to no component, whatever the least peak is.
            if weight[y, x] <= 0 or not weight[y, x] > lowest or label[y, x] >= 0 or not _is_peak(weight, y, x):
                continue
            label[y, x] = peaks
            centres[peaks, 3] = weight[y, x]
            ys[n], xs[n] = y, x
            # ys and xs are the queue of this blob and, after it, the list of its pixels.
            next_, n = n, n + 1
            while next_ < n:
                row, column = ys[next_], xs[next_]
                # Upwards only within the step: what rises by more is another blob's slope.
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
                    # The pixel's own neighbours count, too, so that a blob ends before the foot of the next and not on it.
                    around = max(weight[r - 1, c], weight[r + 1, c], weight[r, c - 1], weight[r, c + 1], weight[r, c])
                    if around <= limit:
                        label[r, c] = peaks
                        ys[n], xs[n] = r, c
                        n += 1
            peaks += 1
    # Blobs that touch are one where no valley lies between them.
    parents = np.arange(peaks)
    for i in range(n):
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                a, b = label[ys[i], xs[i]], label[ys[i] + dy, xs[i] + dx]
                # Each pair once, and not again where it was joined through others.
                if b > a and find_root(parents, a) != find_root(parents, b) and _is_ridge_between(weight, centres[a], centres[b], step):
                    a, b = find_root(parents, a), find_root(parents, b)
                    parents[max(a, b)] = min(a, b)
    return n, _number_groups(parents, ys[:n], xs[:n], label)


@kernel
def _is_ridge_between(weight, a, b, step):
    """Whether no pixel between two centres (x sum, y sum, weight sum, peak) is darker than their peaks by more than a step, or they are
    near."""
    x, y = a[0] / a[2], a[1] / a[2]
    dx, dy = b[0] / b[2] - x, b[1] / b[2] - y
    away = math.sqrt(dx * dx + dy * dy)
    # So near there is no pixel between the centres that could be a valley.
    if away < LEAST_APART:
        return True
    darkest = math.inf
    # One look per pixel of the way.
    for k in range(1, math.ceil(away)):
        darkest = min(darkest, float(weight[int(y + k * dy / away + 0.5), int(x + k * dx / away + 0.5)]))
    return darkest >= max(a[3], b[3]) - step


@kernel
def _is_peak(height, y, x):
    """Returns whether none of the eight pixels around is higher. O(1)."""
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            if height[y + dy, x + dx] > height[y, x]:
                return False
    return True


@kernel
def _number_groups(parents, ys, xs, label):
    """OUT label (h, w): the group of each pixel, counted from 0 in the order of ys, xs. Returns how many groups there are. O(n)."""
    # Numbers in the order of the first pixels, so that they do not depend on which peak became the root.
    number = np.full(len(parents), -1)
    groups = 0
    for i in range(len(ys)):
        root = find_root(parents, label[ys[i], xs[i]])
        if number[root] < 0:
            number[root] = groups
            groups += 1
        label[ys[i], xs[i]] = number[root]
    return groups


@kernel
def _distance_from_edge(weight):
    """Returns each pixel's distance from the nearest one without weight, in thirds of a pixel: the chamfer of 3 aside, 4 across. O(h w)."""
    tall, wide = weight.shape
    away = np.zeros((tall, wide), np.int64)
    # Two passes are exact for a chamfer: the first brings distances from above and left, the second those from below and right.
    for y in range(1, tall):
        for x in range(1, wide - 1):
            if weight[y, x] > 0:
                away[y, x] = min(away[y - 1, x] + 3, away[y, x - 1] + 3, away[y - 1, x - 1] + 4, away[y - 1, x + 1] + 4)
    for y in range(tall - 2, -1, -1):
        for x in range(wide - 2, 0, -1):
            near = min(away[y + 1, x] + 3, away[y, x + 1] + 3, away[y + 1, x - 1] + 4, away[y + 1, x + 1] + 4)
            away[y, x] = min(away[y, x], near)
    return away
