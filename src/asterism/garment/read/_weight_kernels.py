"""Kernels that weigh what speaks for the cell of each circle: colours around it, and how smoothly it lies in the rows and columns."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel
from asterism.garment.read._growth_kernels import expect, off_by, there
from asterism.garment.read._lattice_kernels import bump

_DOWN = np.array([0, 1, 0, -1])
_RIGHT = np.array([1, 0, -1, 0])


@kernel
def evidence(at, fits, cells, own, radius, out):
    """The colours around each circle that are the grid's, in all and on its weakest side.

    IN  at (rows, cols) of `occupy`; fits (n,); cells (n, 2); own (n,) nats, evidence that the colour of each circle's cell is its own;
        radius in cells
    OUT out (n, 2): the sum of all circles within `radius` rows and columns that hang together by circles which fit; the least of the four
        sums of those not to the left, right, above and below

    O(n radius^2). Twin: tests/twins_garment_read.py

    Bounds: each place within reach comes into the queue once, because it is taken out of `near`: (2 radius + 3)^2. The border of `near`
    holds no circle, so that no step leaves it.
    """
    # The circles within reach, with a border of none, so that no step has to be checked; a circle that was reached is taken out.
    width = 2 * radius + 3
    near, queue = np.full(width * width, -1, np.int32), np.empty((width * width, 2), np.int32)
    middle = (radius + 1) * width + radius + 1
    offset = np.empty((width * width, 2), np.int32)
    for place in range(width * width):
        offset[place, 0], offset[place, 1] = place // width - radius - 1, place % width - radius - 1
    for i in range(len(cells)):
        out[i, 0], out[i, 1] = 0.0, 0.0
        row, col = np.int64(cells[i, 0]), np.int64(cells[i, 1])
        if row < 0:
            continue
        for down in range(-radius, radius + 1):
            r, start = row + down, middle + down * width
            for right in range(-radius, radius + 1):
                c = col + right
                near[start + right] = at[r, c] if 0 <= r < at.shape[0] and 0 <= c < at.shape[1] else -1
        # The circle itself is taken out before it comes in a second time.
        near[middle], queue[0, 0], queue[0, 1] = -1, middle, i
        first, last = 0, 1
        total, east, south, west, north = 0.0, 0.0, 0.0, 0.0, 0.0
        while first < last:
            place, k = np.int64(queue[first, 0]), np.int64(queue[first, 1])
            down, right = offset[place, 0], offset[place, 1]
            first += 1
            value = own[k]
            total += value
            # Those straight above and below count for both sides: only what is clearly across is left out.
            if right >= 0:
                east += value
            if down >= 0:
                south += value
            if right <= 0:
                west += value
            if down <= 0:
                north += value
            # What does not fit is counted and ends the way: what lies behind it may be another piece of cloth.
            if not fits[k]:
                continue
            for beside in (place + 1, place + width, place - 1, place - width):
                if near[beside] >= 0:
                    queue[last, 0], queue[last, 1] = beside, near[beside]
                    near[beside] = -1
                    last += 1
        out[i, 0], out[i, 1] = total, min(min(east, south), min(west, north))


@kernel
def smoothness(centres, at, fits, cells, out):
    """How far each circle is from where the rows, columns and squares around it have it.

    IN  centres (n, 2) px; at (rows, cols) of `occupy`; fits (n,); cells (n, 2)
    OUT out (n, 3): pitches from the mean of all ways (`expect`), infinite where there is none; from the way that is farthest off; squares
        of four circles that it closes with three others

    O(n). Twin: tests/twins_garment_read.py
    """
    expected, near = np.empty(6), np.empty((4, 3), np.int64)
    for i in range(len(cells)):
        out[i, 0], out[i, 1], out[i, 2] = np.inf, 0.0, 0.0
        if cells[i, 0] < 0 or expect(centres, at, fits, cells[i, 0], cells[i, 1], near, expected) == 0:
            continue
        x, y = centres[i, 0], centres[i, 1]
        out[i, 0] = off_by(expected, x, y)
        for d in range(4):
            a, beyond, b, c = near[d, 0], near[d, 1], near[(d + 1) & 3, 0], near[d, 2]
            # Every way begins at a neighbour.
            if a < 0:
                continue
            if beyond >= 0:
                expected[0], expected[1] = 2 * centres[a, 0] - centres[beyond, 0], 2 * centres[a, 1] - centres[beyond, 1]
                out[i, 1] = max(out[i, 1], off_by(expected, x, y))
            if b >= 0 and c >= 0:
                expected[0] = centres[a, 0] + centres[b, 0] - centres[c, 0]
                expected[1] = centres[a, 1] + centres[b, 1] - centres[c, 1]
                out[i, 1] = max(out[i, 1], off_by(expected, x, y))
                # A square closed by three others holds a circle better than any row: what was misplaced hardly closes one.
                out[i, 2] += 1.0


@kernel
def slants(centres, moments, at, fits, cells, out):
    """How far from right angles the ways to two neighbours side by side are, as a circle's own ellipse has it.

    IN  centres (n, 2) px; moments (n, 2, 2) px2; at (rows, cols) of `occupy`; fits (n,); cells (n, 2)
    OUT out (n,) the largest cosine of such an angle, 0 where there are no two

    O(n). Twin: tests/twins_garment_read.py
    """
    ways, known = np.empty((4, 3)), np.empty(4, np.bool_)
    for i in range(len(cells)):
        out[i] = 0.0
        if cells[i, 0] < 0:
            continue
        xx, xy, yy = moments[i, 0, 0], moments[i, 0, 1], moments[i, 1, 1]
        for d in range(4):
            j = there(at, fits, cells[i, 0] + _DOWN[d], cells[i, 1] + _RIGHT[d])
            known[d] = j >= 0
            if known[d]:
                x, y = centres[j, 0] - centres[i, 0], centres[j, 1] - centres[i, 1]
                ways[d, 0], ways[d, 1], ways[d, 2] = x, y, yy * x * x - 2.0 * xy * x * y + xx * y * y
        # Where the surface falls away, as at the rim of a limb, the ways leave their right angle.
        for d in range(4):
            e = (d + 1) & 3
            if known[d] and known[e]:
                dot = yy * ways[d, 0] * ways[e, 0] - xy * (ways[d, 0] * ways[e, 1] + ways[d, 1] * ways[e, 0])
                dot += xx * ways[d, 1] * ways[e, 1]
                out[i] = max(out[i], abs(dot) / np.sqrt(ways[d, 2] * ways[e, 2]))


@kernel
def bumps(flat, sizes, centres, at, fits, cells, rise, out):
    """By how much the colourfulness rises and falls again on the way from a circle to its neighbours, where there should be dark cloth.

    IN  flat, sizes of `grey_levels`; centres (n, 2); at (rows, cols) of `occupy`; fits (n,); cells (n, 2); rise (1 + levels,) that
        counts: as a share of the lower end, and at least at each level
    OUT out (n,) largest fall as a share of the lower end, 0 where it nowhere rises

    O(n). Twin: tests/twins_garment_read.py
    """
    steps = 12
    for i in range(len(cells)):
        out[i] = 0.0
        if cells[i, 0] < 0:
            continue
        for d in range(4):
            j = there(at, fits, cells[i, 0] + _DOWN[d], cells[i, 1] + _RIGHT[d])
            if j < 0:
                continue
            fall, _, end = bump(flat, sizes, centres[i, 0], centres[i, 1], centres[j, 0], centres[j, 1], steps, rise)
            # As a share of the lower end, because the same bump is more beside a faint circle.
            out[i] = max(out[i], fall / end)


@kernel
def usual_areas(area, cells, at, out):
    """The median area of the up to eight circles around each.

    IN  area (n,) px2; cells (n, 2); at (rows, cols) of `occupy`
    OUT out (n,) px2, NaN where there is none, and for circles without a cell

    O(n); allocates (8,). Twin: tests/twins_garment_read.py

    Bounds: the nine cells about a circle without its own: 8.
    """
    around = np.empty(8)
    for i in range(len(cells)):
        out[i] = np.nan
        row, col, count = np.int64(cells[i, 0]), np.int64(cells[i, 1]), 0
        if row < 0:
            continue
        for r in range(max(row - 1, 0), min(row + 2, at.shape[0])):
            for c in range(max(col - 1, 0), min(col + 2, at.shape[1])):
                j = at[r, c]
                if j < 0 or (r == row and c == col):
                    continue
                # Insertion into at most eight sorted values: their median is in the middle.
                value, k = area[j], count
                while k > 0 and around[k - 1] > value:
                    around[k] = around[k - 1]
                    k -= 1
                around[k] = value
                count += 1
        if count > 0:
            out[i] = (around[(count - 1) // 2] + around[count // 2]) / 2.0


@kernel
def stretches(moments, cells, at, out):
    """How far each ellipse is from the mean ellipse of the up to eight circles around it, whatever their sizes.

    IN  moments (n, 2, 2) px2; cells (n, 2); at (rows, cols) of `occupy`
    OUT out (n,) logarithm of the longer over the shorter axis, seen so that the mean ellipse around is a circle; 0 without neighbours

    O(n), no allocation. Twin: tests/twins_garment_read.py
    """
    for i in range(len(cells)):
        out[i] = 0.0
        row, col = np.int64(cells[i, 0]), np.int64(cells[i, 1])
        if row < 0:
            continue
        xx, xy, yy = 0.0, 0.0, 0.0
        for r in range(max(row - 1, 0), min(row + 2, at.shape[0])):
            for c in range(max(col - 1, 0), min(col + 2, at.shape[1])):
                j = at[r, c]
                if j < 0 or (r == row and c == col):
                    continue
                xx, xy, yy = xx + moments[j, 0, 0], xy + moments[j, 0, 1], yy + moments[j, 1, 1]
        around = xx * yy - xy * xy
        if not around > 0.0:
            continue
        # Half of the trace over the root of the determinant: the hyperbolic cosine of the logarithm wanted, 1 for one shape.
        own = moments[i, 0, 0] * moments[i, 1, 1] - moments[i, 0, 1] * moments[i, 1, 0]
        both = yy * moments[i, 0, 0] - 2.0 * xy * moments[i, 0, 1] + xx * moments[i, 1, 1]
        ratio = max(both / (2.0 * np.sqrt(around * own)), 1.0)
        out[i] = np.log(ratio + np.sqrt(ratio * ratio - 1.0))
