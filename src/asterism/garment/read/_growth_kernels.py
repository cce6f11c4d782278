"""Kernels that carry the cells of the sheet to the circles around, by where rows and columns go on in the image."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel
from asterism.geometry.shared_kernels import clamped_index

_DOWN = np.array([0, 1, 0, -1])
_RIGHT = np.array([1, 0, -1, 0])


@kernel
def occupy(cells, at):
    """Which circle is at each cell of the sheet.

    IN  cells (n, 2) int32 row and column, -1 where a circle has none
    OUT at (rows, cols) int32: the circle, -1 where none is, -2 where several are

    O(n + rows cols). Twin: tests/twins_garment_read.py

    Bounds: cells are those of the sheet, -1 or from (0, 0) to (rows - 1, cols - 1).
    """
    at[:] = -1
    for i in range(len(cells)):
        if cells[i, 0] >= 0:
            # Where two claim one cell, none of them is believed.
            at[cells[i, 0], cells[i, 1]] = i if at[cells[i, 0], cells[i, 1]] == -1 else -2


@kernel(inline=True)
def there(at, fits, row, col):
    """Gives the circle at a cell, -1 where there is none of the cell's colour, or no sheet. IN at, fits: see `expect`. O(1)."""
    if row < 0 or col < 0 or row >= at.shape[0] or col >= at.shape[1]:
        return np.int64(-1)
    i = np.int64(at[row, col])
    # A circle of another colour is probably at the wrong cell and says nothing of where others are.
    return i if i >= 0 and fits[i] else np.int64(-1)


@kernel
def find_near(at, fits, row, col, near):
    """The circles that have their cell's colour around a cell.

    IN  at, fits: see `expect`; the cell
    OUT near (4, 3) in each direction, a quarter turn clockwise each from along a row: the circle beside, the one beyond it, and the one
        between this and the next direction; -1 where there is none

    O(1).
    """
    for d in range(4):
        e = (d + 1) & 3
        near[d, 0] = there(at, fits, row + _DOWN[d], col + _RIGHT[d])
        near[d, 1] = there(at, fits, row + 2 * _DOWN[d], col + 2 * _RIGHT[d])
        near[d, 2] = there(at, fits, row + _DOWN[d] + _DOWN[e], col + _RIGHT[d] + _RIGHT[e])


@kernel
def expect(centres, at, fits, row, col, near, out):
    """Where the circle of a cell is, by those around it: the mean of what straight rows and parallelograms say.

    IN  centres (n, 2) px; at (rows, cols) of `occupy`; fits (n,) whether a circle has its cell's colour, the others say nothing; the cell
    OUT near (4, 3) of `find_near`; out (6,): x, y px, and two lattice vectors, along a row and down a column, px

    Returns how many ways there were; 0 where the vectors are not known. O(1). Twin: tests/twins_garment_read.py
    """
    find_near(at, fits, row, col, near)
    x, y, ways = 0.0, 0.0, 0
    # Sums of the two vectors are in `out` first; `rows` and `columns` say of how many.
    out[2], out[3], out[4], out[5] = 0.0, 0.0, 0.0, 0.0
    rows, columns = 0, 0
    for d in range(4):
        e = (d + 1) & 3
        own, other = 2 + 2 * (d & 1), 2 + 2 * (e & 1)
        sign, turned = 1.0 if d < 2 else -1.0, 1.0 if e < 2 else -1.0
        a, beyond, b, c = near[d, 0], near[d, 1], near[e, 0], near[d, 2]
        ahead = across = 0
        # A straight row: the next circle is as far from its neighbour as that one from the one beyond.
        if a >= 0 and beyond >= 0:
            dx, dy = centres[beyond, 0] - centres[a, 0], centres[beyond, 1] - centres[a, 1]
            x += centres[a, 0] - dx
            y += centres[a, 1] - dy
            ways += 1
            out[own] += sign * dx
            out[own + 1] += sign * dy
            ahead += 1
        # The side of the square across the direction tells the other lattice vector.
        if a >= 0 and c >= 0:
            out[other] += turned * (centres[c, 0] - centres[a, 0])
            out[other + 1] += turned * (centres[c, 1] - centres[a, 1])
            across += 1
        if b >= 0 and c >= 0:
            out[own] += sign * (centres[c, 0] - centres[b, 0])
            out[own + 1] += sign * (centres[c, 1] - centres[b, 1])
            ahead += 1
        # A parallelogram: three corners tell the fourth.
        if a >= 0 and b >= 0 and c >= 0:
            x += centres[a, 0] + centres[b, 0] - centres[c, 0]
            y += centres[a, 1] + centres[b, 1] - centres[c, 1]
            ways += 1
        # Directions 1 and 3 are columns: what lies ahead there is a column's vector.
        rows += across if d & 1 else ahead
        columns += ahead if d & 1 else across
    for d in range(2):
        a, b = near[d, 0], near[d + 2, 0]
        # The middle between opposite neighbours is the surest place of all, so it counts as two ways.
        if a >= 0 and b >= 0:
            x += centres[a, 0] + centres[b, 0]
            y += centres[a, 1] + centres[b, 1]
            ways += 2
            out[2 + 2 * d] += 0.5 * (centres[a, 0] - centres[b, 0])
            out[3 + 2 * d] += 0.5 * (centres[a, 1] - centres[b, 1])
            rows += d == 0
            columns += d == 1
    # Without both vectors no distance can be told in pitches.
    if ways == 0 or rows == 0 or columns == 0:
        return 0
    out[0], out[1] = x / ways, y / ways
    out[2], out[3], out[4], out[5] = out[2] / rows, out[3] / rows, out[4] / columns, out[5] / columns
    return ways


@kernel
def off_by(expected, x, y):
    """Gives how far a place (px) is from where it is expected, in pitches of the lattice there; infinite where the vectors are none.

    IN expected (6,) of `expect`. O(1).
    """
    det = expected[2] * expected[5] - expected[3] * expected[4]
    # Rows and columns turned over, or in line: no lattice that a camera in front of the print could see.
    if not det > 0.0:
        return np.inf
    dx, dy = x - expected[0], y - expected[1]
    a, b = (dx * expected[5] - dy * expected[4]) / det, (expected[2] * dy - expected[3] * dx) / det
    return np.sqrt(a * a + b * b)


@kernel
def bucket_circles(centres, side, heads, following):
    """Sort circles into square buckets of the image.

    IN  centres (n, 2) px; side px
    OUT heads (rows, columns) of buckets: the first circle in each, -1 for none; following (n,): the next one in its bucket, -1 for none

    O(n + buckets).

    Bounds: centres are within the image (`measure`), and `heads` has a bucket for each of its pixels.
    """
    heads[:] = -1
    # From the last to the first, so that each bucket's list is in rising order.
    for i in range(len(centres) - 1, -1, -1):
        row, col = int(centres[i, 1] / side), int(centres[i, 0] / side)
        following[i] = heads[row, col]
        heads[row, col] = i


@kernel(inline=True)
def buckets_within(middle, reach, side, count):
    """Gives the first and the last of `count` buckets within reach of a place along one axis. IN middle, reach, side px. O(1)."""
    return clamped_index((middle - reach) / side, 0, count), clamped_index((middle + reach) / side, -1, count - 1)


@kernel
def grow(centres, likelihood, colours, heads, following, side, gate, cells, at, fits, queue):
    """Give circles without a cell the empty cell beside those that have one, where they lie as the rows and columns around go on.

    A circle is taken only where no other one is nearly as near. One of another colour than its cell's is taken, too, because it speaks
    against what is around it, but nothing goes on from it.

    IN   centres (n, 2); likelihood (n, q) nats; colours (rows, cols) int8; heads, following, side of `bucket_circles`; gate pitches
    IO   cells (n, 2); at (rows, cols) of `occupy`; fits (n,) bool, whether a circle has its cell's colour
    WORK queue (n,) int32

    O(n circles in reach). Twin: tests/twins_garment_read.py

    Bounds: a circle comes into the queue when it gets its cell, which it keeps, so once: n.
    """
    n = len(centres)
    expected, near = np.empty(6), np.empty((4, 3), np.int64)
    first, last = 0, 0
    for i in range(n):
        if cells[i, 0] >= 0:
            queue[last] = i
            last += 1
    while first < last:
        i = queue[first]
        first += 1
        # From a circle of another colour nothing goes on: it may be at the wrong cell.
        if not fits[i]:
            continue
        for d in range(4):
            row, col = cells[i, 0] + _DOWN[d], cells[i, 1] + _RIGHT[d]
            if row < 0 or col < 0 or row >= colours.shape[0] or col >= colours.shape[1]:
                continue
            # Off the cloth, taken, or not to be foreseen.
            if colours[row, col] < 0 or at[row, col] != -1 or expect(centres, at, fits, row, col, near, expected) == 0:
                continue
            # Twice the gate, because a rival that is nearly as near must be seen, too.
            reach = 2.0 * gate * max(abs(expected[2]) + abs(expected[4]), abs(expected[3]) + abs(expected[5]))
            x0, x1 = buckets_within(expected[0], reach, side, heads.shape[1])
            y0, y1 = buckets_within(expected[1], reach, side, heads.shape[0])
            best, nearest, next_best = -1, np.inf, np.inf
            for y in range(y0, y1 + 1):
                for x in range(x0, x1 + 1):
                    j = heads[y, x]
                    while j >= 0:
                        far = off_by(expected, centres[j, 0], centres[j, 1])
                        if far < nearest:
                            best, nearest, next_best = j, far, nearest
                        elif far < next_best:
                            next_best = far
                        j = following[j]
            # Where another circle is nearly as near, neither is taken: a wrong cell spoils all that grows from it.
            if best < 0 or nearest > gate or next_best < 2.0 * nearest or cells[best, 0] >= 0:
                continue
            cells[best, 0], cells[best, 1] = row, col
            at[row, col] = best
            # The colour decides whether the next ones may be expected from here.
            fits[best] = likelihood[best, colours[row, col]] > 0.0
            queue[last] = best
            last += 1


@kernel
def _beside(at, row, col):
    """Whether a circle is at one of the four cells beside. O(1)."""
    found = False
    for d in range(4):
        r, c = row + _DOWN[d], col + _RIGHT[d]
        if 0 <= r < at.shape[0] and 0 <= c < at.shape[1]:
            found = found or at[r, c] >= 0
    return found


@kernel
def rivals(centres, colours, heads, following, side, cells, at, fits, out):
    """How far each circle is, at least, from where an empty cell beside others is expected, which may be the cell that it really has.

    IN  as for `grow`
    OUT out (n,) pitches, 1 for all that is farther

    O(rows cols circles in reach). Twin: tests/twins_garment_read.py
    """
    expected, near = np.empty(6), np.empty((4, 3), np.int64)
    out[:] = 1.0
    for row in range(at.shape[0]):
        for col in range(at.shape[1]):
            # Only an empty cell beside occupied ones may be the one that a circle really has.
            if at[row, col] != -1 or colours[row, col] < 0 or not _beside(at, row, col):
                continue
            if expect(centres, at, fits, row, col, near, expected) == 0:
                continue
            reach = max(abs(expected[2]) + abs(expected[4]), abs(expected[3]) + abs(expected[5]))
            x0, x1 = buckets_within(expected[0], reach, side, heads.shape[1])
            y0, y1 = buckets_within(expected[1], reach, side, heads.shape[0])
            for y in range(y0, y1 + 1):
                for x in range(x0, x1 + 1):
                    j = heads[y, x]
                    while j >= 0:
                        if cells[j, 0] >= 0:
                            # The nearest empty cell counts: one alternative is enough for doubt.
                            out[j] = min(out[j], off_by(expected, centres[j, 0], centres[j, 1]))
                        j = following[j]
