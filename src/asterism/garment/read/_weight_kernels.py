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
    """
    width = 2 * radius + 1
    seen = np.full(width * width, -1, np.int32)
    queue = np.empty(width * width, np.int32)
    for i in range(len(cells)):
        out[i] = 0.0
        if cells[i, 0] < 0:
            continue
        row, col = cells[i, 0], cells[i, 1]
        seen[radius * width + radius] = i
        queue[0] = i
        first, last = 0, 1
        total, east, south, west, north = 0.0, 0.0, 0.0, 0.0, 0.0
        while first < last:
            k = queue[first]
            first += 1
            down, right = cells[k, 0] - row, cells[k, 1] - col
            value = own[k]
            total += value
            if right >= 0:
                east += value
            if down >= 0:
                south += value
            if right <= 0:
                west += value
            if down <= 0:
                north += value
            if not fits[k]:
                continue
            for d in range(4):
                r, c = cells[k, 0] + _DOWN[d], cells[k, 1] + _RIGHT[d]
                a, b = r - row + radius, c - col + radius
                if a < 0 or b < 0 or a >= width or b >= width or r < 0 or c < 0 or r >= at.shape[0] or c >= at.shape[1]:
                    continue
                if at[r, c] < 0 or seen[a * width + b] == i:
                    continue
                seen[a * width + b] = i
                queue[last] = at[r, c]
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
    expected = np.empty(6)
    for i in range(len(cells)):
        out[i] = np.inf, 0.0, 0.0
        if cells[i, 0] < 0 or expect(centres, at, fits, cells[i, 0], cells[i, 1], expected) == 0:
            continue
        row, col, x, y = cells[i, 0], cells[i, 1], centres[i, 0], centres[i, 1]
        out[i, 0] = off_by(expected, x, y)
        for d in range(4):
            e = (d + 1) % 4
            a = there(at, fits, row + _DOWN[d], col + _RIGHT[d])
            if a < 0:
                continue
            b = there(at, fits, row + 2 * _DOWN[d], col + 2 * _RIGHT[d])
            if b >= 0:
                expected[0], expected[1] = 2 * centres[a, 0] - centres[b, 0], 2 * centres[a, 1] - centres[b, 1]
                out[i, 1] = max(out[i, 1], off_by(expected, x, y))
            b = there(at, fits, row + _DOWN[e], col + _RIGHT[e])
            c = there(at, fits, row + _DOWN[d] + _DOWN[e], col + _RIGHT[d] + _RIGHT[e])
            if b >= 0 and c >= 0:
                expected[0] = centres[a, 0] + centres[b, 0] - centres[c, 0]
                expected[1] = centres[a, 1] + centres[b, 1] - centres[c, 1]
                out[i, 1] = max(out[i, 1], off_by(expected, x, y))
                out[i, 2] += 1.0


@kernel
def bumps(grey, centres, at, fits, cells, rise, out):
    """By how much the colourfulness rises and falls again on the way from a circle to its neighbours, where there should be dark cloth.

    IN  grey (h, w) uint8; centres (n, 2); at (rows, cols) of `occupy`; fits (n,); cells (n, 2); rise (2,) that counts: as a share of the
        lower end, and at least
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
            fall, _, end = bump(grey, centres[i], centres[j], steps, rise)
            out[i] = max(out[i], fall / end)
