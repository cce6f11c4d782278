"""Kernels that carry identities along the links of circles, and weigh what speaks for each."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel

_ROW = np.array([0, 1, 0, -1])
_COLUMN = np.array([1, 0, -1, 0])


@kernel
def rings(links, out):
    """The eight circles around each, in steps of half a direction: 0, between 0 and 1, 1, ... clockwise in the image.

    A circle between two directions is reached by two ways, which must lead to one circle where both can be gone.

    IN  links (n, 4, 2) of `link`
    OUT out (n, 8) int32, -1 where it is not known

    O(n). Twin: tests/twins_garment_read.py
    """
    for i in range(len(links)):
        for d in range(4):
            # The corner circle is beside a neighbour in one direction and beside the other neighbour in the other: two ways to it.
            e = (d + 1) % 4
            out[i, 2 * d] = links[i, d, 0]
            one, other = -1, -1
            j = links[i, d, 0]
            if j >= 0:
                one = links[j, (links[i, d, 1] + 3) % 4, 0]
            j = links[i, e, 0]
            if j >= 0:
                other = links[j, (links[i, e, 1] + 1) % 4, 0]
            # One way is enough where the other is broken; two that disagree tell of a fold.
            if one < 0:
                one = other
            out[i, 2 * d + 1] = one if other < 0 or one == other else -1


@kernel
def look_up(ring, read, q, classes, cell_of, colours, cells, turns):
    """The blocks around circles that the pattern has: their cells, and how they are turned.

    A block's ring of colours gives its class, the class and the centre's colour its identity, and the identity one cell of the sheet. A
    ring that fits there only by an odd shift, its corners at the sides, is none of the pattern's: no turn of the grid makes that.

    IN  ring (n, 8) of `rings`; read (n,) colours; q, how many there are; classes (q^8,) of `ring_classes`; cell_of (ids,) int32, the flat
        cell of each identity, -1 where it does not occur; colours (rows, cols) int8, without identities at the border
    OUT cells (n, 2) int32 row and column, turns (n,) int32 the grid's direction of direction 0; -1 where no block was read or it is none

    Returns how many blocks there are, and of how many the pattern has the identity in one of the four turns. O(n).
    Twin: tests/twins_garment_read.py

    Bounds: a block with an identity has all eight neighbours on the sheet, so no cell beside it is off the sheet. A ring's code is below
    q^8, as colours are below q.
    """
    rings_of_a_colour = len(cell_of) // q
    cols = colours.shape[1]
    whole = existing = 0
    for i in range(len(ring)):
        cells[i, 0], cells[i, 1], turns[i] = -1, -1, -1
        complete, code = True, 0
        for place in range(7, -1, -1):
            j = ring[i, place]
            # Without a branch: nearly all blocks are read to the end.
            complete = complete and j >= 0
            code = code * q + read[max(j, 0)]
        whole += complete
        # A ring with a period looks the same after a turn, and no pattern has one.
        if not complete or classes[code] < 0:
            continue
        flat = np.int64(cell_of[read[i] * rings_of_a_colour + classes[code]])
        if flat < 0:
            continue
        row, col = flat // cols, flat % cols
        # Class and identity do not tell the turn: the sheet's own ring does.
        for turn in range(4):
            same = True
            for place in range(8):
                # Direction 0 is along a row where the turn is 0; the even places of a ring are those beside.
                d = (place // 2 + turn) & 3
                e = (d + 1) & 3
                down, right = _ROW[d], _COLUMN[d]
                if place & 1:
                    down, right = down + _ROW[e], right + _COLUMN[e]
                same = same and colours[row + down, col + right] == read[ring[i, place]]
            if same:
                cells[i, 0], cells[i, 1], turns[i] = row, col, turn
        existing += turns[i] >= 0
    return whole, existing


@kernel(inline=True)
def _agree(i, d, links, cells, turns):
    """Whether a link leads to the circle that the grid has there, turned alike."""
    j = links[i, d, 0]
    if j < 0 or turns[i] < 0 or turns[j] < 0:
        return False
    grid = (d + turns[i]) & 3
    if cells[j, 0] != cells[i, 0] + _ROW[grid] or cells[j, 1] != cells[i, 1] + _COLUMN[grid]:
        return False
    return (links[i, d, 1] + turns[j]) & 3 == (grid + 2) & 3


@kernel
def groups(links, cells, turns, roots):
    """Groups of read blocks whose identities are side by side on the grid as the circles are in the image (union-find).

    IN  links (n, 4, 2); cells (n, 2) int32 row and column of the block read around each circle; turns (n,) int32, the grid's direction
        (0 along a row, 1 down a column, ...) of a circle's direction 0, -1 where none was read
    OUT roots (n,) int32 one circle of each group

    O(n). Twin: tests/twins_garment_read.py
    """
    n = len(links)
    for i in range(n):
        roots[i] = i
    for i in range(n):
        for d in range(4):
            # One block is right by chance too often; blocks that agree on where they are, hardly ever.
            if not _agree(i, d, links, cells, turns):
                continue
            a, b = np.int64(i), np.int64(links[i, d, 0])
            if roots[a] == roots[b]:
                continue
            while roots[a] != a:
                roots[a] = roots[roots[a]]
                a = roots[a]
            while roots[b] != b:
                roots[b] = roots[roots[b]]
                b = roots[b]
            # The smallest number is the root, so that the result does not depend on the order of the links.
            roots[max(a, b)] = min(a, b)
    for i in range(n):
        # Every circle to its root, since the caller compares roots.
        while roots[i] != roots[roots[i]]:
            roots[i] = roots[roots[i]]


@kernel
def spread(links, colours, likelihood, order, cells, turns, queue):
    """Carry the grid's cells from read blocks, largest groups first, along the links to circles whose own block was not read.

    Nothing is carried on from a circle whose colour is rather not that of its cell.

    IN   links (n, 4, 2); colours (rows, cols) int8 of the pattern; likelihood (n, q) nats, evidence for each colour;
         order (m,) the circles with a block, best first
    IO   cells (n, 2), turns (n,): of read blocks in, of all that were reached out
    WORK queue (n,) int32

    O(n). Twin: tests/twins_garment_read.py

    Bounds: a circle comes into the queue with its turn, which it keeps, so once: n.
    """
    rows, cols = colours.shape
    first, last = 0, 0
    # Best groups first: where two would give a circle different cells, the larger group has it.
    for k in range(len(order)):
        queue[last] = order[k]
        last += 1
    while first < last:
        i = queue[first]
        first += 1
        # A circle whose colour speaks against its cell may be across a fold.
        if likelihood[i, colours[cells[i, 0], cells[i, 1]]] < 0.0:
            continue
        for d in range(4):
            j = links[i, d, 0]
            if j < 0 or turns[j] >= 0:
                continue
            grid = (d + turns[i]) % 4
            row, col = cells[i, 0] + _ROW[grid], cells[i, 1] + _COLUMN[grid]
            if row < 0 or col < 0 or row >= rows or col >= cols or colours[row, col] < 0:
                continue
            cells[j, 0], cells[j, 1] = row, col
            # The neighbour's own direction back is known, and on the grid it is the opposite one.
            turns[j] = (grid + 2 - links[i, d, 1]) % 4
            queue[last] = j
            last += 1
