"""Kernels that find the square lattice of circles in an image: each circle's two lattice vectors and its four neighbours along them.

Directions count 0 to 3: along the first vector, along the second, and back; a quarter turn clockwise in the image each.
"""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel
from asterism.geometry.shared_kernels import clamped_index

_STEP = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
_ROUNDING = 1e-9
"""Pitches: first vectors end at circles, so several may fit without any error, and rounding must not choose among them."""


@kernel
def candidates(centres, whiten, reach, side, found, offsets):
    """The nearest other circles around each within `reach` pitches, by its own ellipse.

    IN  centres (n, 2) px; whiten (n, 2, 2) pitches per px; reach pitches; side px, of the square buckets that circles are sorted into
    OUT found (n, most) int32, ascending by distance, -1 after the last; offsets (n, most, 2) pitches

    O(n most buckets). Twin: tests/twins_garment_read.py

    Bounds: of more than `most` circles within reach the nearest are kept. Buckets cover the box of all centres, and places beyond it are
    clamped to it.
    """
    n, most = found.shape
    low_x, low_y, high_x, high_y = np.inf, np.inf, -np.inf, -np.inf
    for i in range(n):
        low_x, high_x = min(low_x, centres[i, 0]), max(high_x, centres[i, 0])
        low_y, high_y = min(low_y, centres[i, 1]), max(high_y, centres[i, 1])
    if n == 0:
        return
    # Buckets over the box of all centres: only those within reach are looked at.
    across, down = int((high_x - low_x) / side) + 1, int((high_y - low_y) / side) + 1
    starts = np.zeros(across * down + 1, np.int64)
    bucket = np.empty(n, np.int64)
    for i in range(n):
        bucket[i] = int((centres[i, 1] - low_y) / side) * across + int((centres[i, 0] - low_x) / side)
        starts[bucket[i] + 1] += 1
    # Counting sort of the circles by bucket, row by row, so that a stretch of buckets is one range.
    starts = np.cumsum(starts)
    order, filled = np.empty(n, np.int64), starts.copy()
    for i in range(n):
        order[filled[bucket[i]]] = i
        filled[bucket[i]] += 1
    distances = np.empty(most)
    for i in range(n):
        a, b, c, d = whiten[i, 0, 0], whiten[i, 0, 1], whiten[i, 1, 0], whiten[i, 1, 1]
        whole = abs(a * d - b * c)
        # The box around the circle's own ellipse of reach, which may lie aslant.
        wide, tall = reach * np.sqrt(b * b + d * d) / whole, reach * np.sqrt(a * a + c * c) / whole
        x0 = clamped_index((centres[i, 0] - wide - low_x) / side, 0, across)
        x1 = clamped_index((centres[i, 0] + wide - low_x) / side, 0, across - 1)
        y0 = clamped_index((centres[i, 1] - tall - low_y) / side, 0, down)
        y1 = clamped_index((centres[i, 1] + tall - low_y) / side, 0, down - 1)
        count = 0
        for row in range(y0, y1 + 1):
            for place in range(starts[row * across + x0], starts[row * across + x1 + 1]):
                j = order[place]
                if j == i:
                    continue
                dx, dy = centres[j, 0] - centres[i, 0], centres[j, 1] - centres[i, 1]
                px, py = a * dx + b * dy, c * dx + d * dy
                far = px * px + py * py
                # The farthest of a full list is known: what is farther needs no place.
                if far > reach * reach or (count == most and far >= distances[most - 1]):
                    continue
                # Insertion into a short sorted list; of a full one the last falls out.
                k = min(count, most - 1)
                while k > 0 and distances[k - 1] > far:
                    distances[k] = distances[k - 1]
                    found[i, k] = found[i, k - 1]
                    offsets[i, k, 0], offsets[i, k, 1] = offsets[i, k - 1, 0], offsets[i, k - 1, 1]
                    k -= 1
                distances[k], found[i, k] = far, j
                offsets[i, k, 0], offsets[i, k, 1] = px, py
                count = min(count + 1, most)
        for k in range(count, most):
            found[i, k] = -1


@kernel
def _score(offsets, count, px, py, qx, qy, fit, needed):
    """How well the offsets of candidates are explained by a lattice of two vectors: neighbours present less circles astray.

    A candidate gives one at most. Where those that are left cannot reach what is needed any more, less than that comes back.
    """
    det = px * qy - py * qx
    total = 0.0
    for k in range(count):
        # A circle gives one at most, so that this pair can no longer win.
        if total + (count - k) < needed:
            break
        x, y = offsets[k, 0], offsets[k, 1]
        a, b = (x * qy - y * qx) / det, (px * y - py * x) / det
        na, nb = np.rint(a), np.rint(b)
        far = (a - na) ** 2 + (b - nb) ** 2
        near = max(abs(na), abs(nb))
        # Two pitches and farther the lattice may have bent: it says nothing.
        if near > 1.0:
            continue
        if near == 0.0 or far > fit * fit:
            # Within the next pitch every circle should be on the lattice.
            if abs(a) < 1.2 and abs(b) < 1.2:
                total -= 0.5
            continue
        # Circles across a corner are farther and bend more, so they count less.
        total += (1.0 if na * nb == 0.0 else 0.6) * (1.0 - 0.7 * far / (fit * fit))
    return total


@kernel
def first_frames(found, offsets, whiten, side, square, fit, frames, scores):
    """Each circle's two lattice vectors: of all pairs of candidates that may be one and the next neighbour, those that explain most others.

    IN  found (n, most), offsets (n, most, 2) of `candidates`; whiten (n, 2, 2); side (2,) shortest and longest vector in pitches;
        square, least sine of the angle between them; fit pitches
    OUT frames (n, 2, 2) px, a vector in each column; scores (n,), -inf where there is none

    O(n most^3) at worst. Twin: tests/twins_garment_read.py

    Bounds: `count` is the number of candidates, `most` at most.
    """
    n, most = found.shape
    length, stretch = np.empty(most), np.empty(most)
    for i in range(n):
        count = 0
        while count < most and found[i, count] >= 0:
            length[count] = np.sqrt(offsets[i, count, 0] ** 2 + offsets[i, count, 1] ** 2)
            # Neighbours are one pitch away; how much longer or shorter costs alike.
            stretch[count] = np.log(length[count]) ** 2
            count += 1
        best, bp, bq = -np.inf, -1, -1
        for k in range(count):
            px, py, lp = offsets[i, k, 0], offsets[i, k, 1], length[k]
            # Half of the directions are enough: a vector and its opposite make the same lattice.
            if lp < side[0] or lp > side[1] or px < 0.0:
                continue
            for m in range(count):
                qx, qy, lq = offsets[i, m, 0], offsets[i, m, 1], length[m]
                if m == k or lq < side[0] or lq > side[1]:
                    continue
                det = px * qy - py * qx
                # Clockwise and nearly at right angles, and of the turns of one lattice only that whose first vector points most to the
                # right.
                if det < square * lp * lq or (px < abs(py) and qy > abs(qx)):
                    continue
                loss = 2.0 * (stretch[k] + stretch[m] + 1.0 - (det / (lp * lq)) ** 2)
                # With what the best one has, so that the count ends early where it cannot be beaten.
                score = _score(offsets[i], count, px, py, qx, qy, fit, best + loss - _ROUNDING) - loss
                if score > best:
                    best, bp, bq = score, k, m
        scores[i] = best
        if bp < 0:
            frames[i] = np.nan
            continue
        a, b, c, d = whiten[i, 0, 0], whiten[i, 0, 1], whiten[i, 1, 0], whiten[i, 1, 1]
        det = a * d - b * c
        for place in range(2):
            at = bp if place == 0 else bq
            x, y = offsets[i, at, 0], offsets[i, at, 1]
            frames[i, 0, place], frames[i, 1, place] = (d * x - b * y) / det, (a * y - c * x) / det


@kernel
def link(centres, found, frames, fit, ahead, links):
    """Neighbours along the lattice vectors, where two circles each are the other's.

    IN   centres (n, 2); found (n, most); frames (n, 2, 2), NaN where there is none; fit pitches
    WORK ahead (n, 4) int32
    OUT  links (n, 4, 2) int32: the neighbour in each direction, and the direction from it back; -1, -1 where there is none

    O(n most). Twin: tests/twins_garment_read.py
    """
    n, most = found.shape
    nearest = np.empty(4)
    for i in range(n):
        ahead[i, 0], ahead[i, 1], ahead[i, 2], ahead[i, 3] = -1, -1, -1, -1
        det = frames[i, 0, 0] * frames[i, 1, 1] - frames[i, 0, 1] * frames[i, 1, 0]
        # No lattice of its own, or NaN.
        if not det > 0.0:
            continue
        nearest[:] = fit * fit
        for k in range(most):
            j = found[i, k]
            if j < 0:
                break
            dx, dy = centres[j, 0] - centres[i, 0], centres[j, 1] - centres[i, 1]
            a = (dx * frames[i, 1, 1] - dy * frames[i, 0, 1]) / det
            b = (frames[i, 0, 0] * dy - frames[i, 1, 0] * dx) / det
            for direction in range(4):
                far = (a - _STEP[direction, 0]) ** 2 + (b - _STEP[direction, 1]) ** 2
                # The nearest of each direction: two circles may be within the fit where one is a blob of several.
                if far < nearest[direction]:
                    nearest[direction] = far
                    ahead[i, direction] = j
    for i in range(n):
        for direction in range(4):
            links[i, direction, 0], links[i, direction, 1] = -1, -1
            j = ahead[i, direction]
            if j < 0:
                continue
            for back in range(4):
                # Both must name each other: a link that only one of them sees is a skipped row or a fold.
                if ahead[j, back] == i:
                    links[i, direction, 0], links[i, direction, 1] = j, back


@kernel
def refine_frames(centres, found, links, frames, fit, out):
    """Lattice vectors again, by least squares from the linked neighbours and, with a smaller weight, from these neighbours' own vectors.

    A circle without a link takes the vectors of the circle with two links or more on whose lattice it lies best; of equals, the nearest.

    IN  centres (n, 2); found (n, most); links (n, 4, 2); frames (n, 2, 2); fit pitches
    OUT out (n, 2, 2) px

    O(n most). Twin: tests/twins_garment_read.py
    """
    n, most = found.shape
    right = np.empty((2, 2))
    for i in range(n):
        xx, yy = 0.0, 0.0
        right[0, 0], right[0, 1], right[1, 0], right[1, 1] = 0.0, 0.0, 0.0, 0.0
        for direction in range(4):
            j, back = links[i, direction, 0], links[i, direction, 1]
            if j < 0:
                continue
            sa, sb = _STEP[direction, 0], _STEP[direction, 1]
            xx += sa * sa
            yy += sb * sb
            for axis in range(2):
                step = centres[j, axis] - centres[i, axis]
                right[axis, 0] += sa * step
                right[axis, 1] += sb * step
            # The neighbour counts directions in its own frame; this many quarter turns lie between the two.
            turn = (back + 2 - direction) % 4
            for own in range(2):
                there = (own + turn) % 4
                # A neighbour's own vectors count less than the step to it, which was measured here; but they know beyond it.
                weight = 0.2
                if own == 0:
                    xx += weight
                else:
                    yy += weight
                for axis in range(2):
                    vector = frames[j, axis, there % 2] * (1.0 if there < 2 else -1.0)
                    right[axis, own] += weight * vector
        if xx > 0.0:
            for axis in range(2):
                out[i, axis, 0], out[i, axis, 1] = right[axis, 0] / xx, right[axis, 1] / yy
            continue
        # Circles at a border have no links yet, so they borrow the lattice of one that has.
        out[i] = frames[i]
        nearest = fit
        for k in range(most):
            j = found[i, k]
            if j < 0:
                break
            linked = 0
            for direction in range(4):
                linked += links[j, direction, 0] >= 0
            det = frames[j, 0, 0] * frames[j, 1, 1] - frames[j, 0, 1] * frames[j, 1, 0]
            # A lattice that hangs on one link alone is not lent on.
            if linked < 2 or not det > 0.0:
                continue
            dx, dy = centres[i, 0] - centres[j, 0], centres[i, 1] - centres[j, 1]
            a = (dx * frames[j, 1, 1] - dy * frames[j, 0, 1]) / det
            b = (frames[j, 0, 0] * dy - frames[j, 1, 0] * dx) / det
            for direction in range(4):
                far = np.sqrt((a - _STEP[direction, 0]) ** 2 + (b - _STEP[direction, 1]) ** 2)
                # Of equals the nearest circle, and rounding must not choose another.
                if far < nearest - _ROUNDING:
                    nearest = far
                    out[i] = frames[j]


@kernel(inline=True)
def between(flat, begin, width, height, x, y):
    """Gives the value between four pixels, bilinear. IN flat, from `begin` on an image, row by row; its width, height; x, y px. O(1).

    Bounds: places are clamped to 0 <= x < w - 1, 0 <= y < h - 1; the caller sees to it that flat holds h rows of w from `begin` on.
    """
    x, y = min(max(x, 0.0), width - 1.000001), min(max(y, 0.0), height - 1.000001)
    left, above = int(x), int(y)
    a, b = x - left, y - above
    # Unsigned places: Numba then does not ask whether they count from the end.
    place = np.uint64(begin + above * width + left)
    below, one = place + np.uint64(width), np.uint64(1)
    upper = (1.0 - a) * flat[place] + a * flat[place + one]
    return (1.0 - b) * upper + b * ((1.0 - a) * flat[below] + a * flat[below + one])


@kernel
def bump(flat, sizes, x, y, other_x, other_y, steps, rise):
    """By how much the colourfulness falls after it has risen on the way from one circle to another, where there should be dark cloth.

    IN flat, sizes of `grey_levels`; x, y, other_x, other_y px; steps of the way; rise (1 + levels,) that counts: as a share of the lower
    end, and at least at each level

    Gives the largest fall, 0 where it nowhere rises; the rise that counts here; the lower end. O(steps).
    """
    # A step's worth of pixels is averaged: single ones of a wide gap are as noisy as those of a narrow one, and far more.
    long, level, scale = max(abs(other_x - x), abs(other_y - y)) / steps, 0, 1.0
    while level + 1 < len(sizes) and long > 1.4142135623730951 * scale:
        level += 1
        scale *= 2.0
    begin, width, height = sizes[level, 0], sizes[level, 1], sizes[level, 2]
    x, y, other_x, other_y = (x + 0.5) / scale - 0.5, (y + 0.5) / scale - 0.5, (other_x + 0.5) / scale - 0.5, (other_y + 0.5) / scale - 0.5
    dx, dy = (other_x - x) / steps, (other_y - y) / steps
    first, last = between(flat, begin, width, height, x, y), between(flat, begin, width, height, other_x, other_y)
    end = max(min(first, last), 1.0)
    needed = max(rise[0] * end, rise[1 + level])
    # It falls from the first circle to dark cloth, and may then rise only at the other end.
    lowest, fall, highest = first, 0.0, -1.0
    for k in range(1, steps + 1):
        value = between(flat, begin, width, height, x + dx * k, y + dy * k)
        if highest < 0.0:
            lowest = min(lowest, value)
            # It has risen by more than noise before the end: something coloured lies on the way.
            if value > lowest + needed and k < steps:
                highest = value
        else:
            highest = max(highest, value)
            fall = max(fall, highest - value)
    return fall, needed, end


@kernel
def cut_skipping(flat, sizes, centres, whiten, side, rise, checked, links):
    """Cut links that lead over a circle that was not found, and those whose length is not a pitch by the ellipses at their ends.

    Between two neighbours the colourfulness falls to dark cloth and rises again. If it rises and falls again before, there is a circle.

    IN  flat, sizes of `grey_levels`; centres (n, 2); whiten (n, 2, 2); side (2,) shortest and longest link in pitches, the mean of both
        ends; rise (1 + levels,) of the colourfulness that is taken for a circle: as a share of the lower end, and at least at each level
    IO  checked (n, 4) int32: links that were looked at before, -1 for none, else twice the neighbour, and one more if the link was cut; no
        decision depends on it. links (n, 4, 2)

    O(n). Twin: tests/twins_garment_read.py
    """
    steps = 16
    for i in range(len(links)):
        for d in range(4):
            j, back = links[i, d, 0], links[i, d, 1]
            # Each link once, from its first end; both ends are cut together.
            if j < i:
                continue
            # The image does not change between the rounds, so that a link once looked at is known.
            if checked[i, d] < 0 or checked[i, d] >> 1 != j:
                dx, dy = centres[j, 0] - centres[i, 0], centres[j, 1] - centres[i, 1]
                length = 0.0
                for end in range(2):
                    k = i if end == 0 else j
                    a, b = whiten[k, 0, 0] * dx + whiten[k, 0, 1] * dy, whiten[k, 1, 0] * dx + whiten[k, 1, 1] * dy
                    length += 0.5 * np.sqrt(a * a + b * b)
                # By the ellipses at its ends first, which costs nothing.
                cut = length < side[0] or length > side[1]
                if not cut:
                    fall, needed, _ = bump(flat, sizes, centres[i, 0], centres[i, 1], centres[j, 0], centres[j, 1], steps, rise)
                    cut = fall > needed
                checked[i, d] = 2 * j + cut
            if checked[i, d] & 1:
                links[i, d, 0], links[i, d, 1] = -1, -1
                links[j, back, 0], links[j, back, 1] = -1, -1
