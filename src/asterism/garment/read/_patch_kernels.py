"""Kernels that find linked circles on the sheet by their colours alone, where too few whole blocks were read."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel

_DOWN = np.array([0, 1, 0, -1])
_RIGHT = np.array([1, 0, -1, 0])


@kernel
def gather(links, turns, root, members, place, taken):
    """The circles without a cell around one, by links between them, nearest first, and where they are in the root's own directions.

    IN   links (n, 4, 2); turns (n,) -1 where a circle has no cell; root
    WORK taken (n,) int32, of which no value is the root
    OUT  members (most,) int32; place (most, 3) int32 rows down and columns right of the root, and the root's direction of their direction 0

    A circle to which two ways lead to different places ends the search there. Returns how many. O(most). Twin: tests/twins_garment_read.py

    Bounds: the search ends when `members` is full; it needs room for one.
    """
    members[0] = root
    place[0, 0], place[0, 1], place[0, 2] = 0, 0, 0
    taken[root] = root
    first, last = 0, 1
    # Nearest first: what lies around the root is less likely across a fold.
    while first < last and last < len(members):
        i = members[first]
        down, right, turn = place[first]
        first += 1
        for d in range(4):
            j = links[i, d, 0]
            if j < 0 or turns[j] >= 0 or taken[j] == root or last == len(members):
                continue
            # In the root's directions, so that all members have places on one grid.
            way = (d + turn) % 4
            a, b = down + _DOWN[way], right + _RIGHT[way]
            free = True
            # A place that is taken by another circle tells that one of the two ways went wrong.
            for k in range(last):
                free = free and (place[k, 0] != a or place[k, 1] != b)
            if not free:
                continue
            members[last] = j
            place[last, 0], place[last, 1], place[last, 2] = a, b, (way + 2 - links[i, d, 1]) % 4
            taken[j] = root
            last += 1
    return last


@kernel
def turned(down, right, turn):
    """Gives rows down and columns right after so many quarter turns. IN turn 0 to 3. O(1)."""
    if turn == 1:
        return right, -down
    if turn == 2:
        return -down, -right
    if turn == 3:
        return -right, down
    return down, right


@kernel
def locate(members, place, count, read, colours, misses, found):
    """Where on the sheet gathered circles have their colours: the place and turn with the fewest misses.

    IN  members, place, count of `gather`; read (n,) colours; colours (rows, cols) int8, -1 off the cloth; misses allowed
    OUT found (3,) row and column of the root, and the grid's direction of its direction 0

    Returns the misses there and at the next best place, `misses` + 1 where there is none. O(4 rows cols count), many columns at a time;
    allocates a sheet. Twin: tests/twins_garment_read.py

    Bounds: `sheet` has a margin as wide as the patch reaches from its root, in any of four turns.
    """
    rows, cols = colours.shape
    margin = 0
    for k in range(count):
        margin = max(margin, abs(place[k, 0]), abs(place[k, 1]))
    # With a margin of cells that fit no colour, no step has to ask whether it is on the sheet.
    sheet = np.full((rows + 2 * margin, cols + 2 * margin), np.int8(-1))
    sheet[margin : margin + rows, margin : margin + cols] = colours
    wrong = np.empty(cols, np.uint16)
    best, second = misses + 1, misses + 1
    # The camera may hold the cloth in any of four turns.
    for turn in range(4):
        for row in range(rows):
            wrong[:] = 0
            for k in range(count):
                down, right = turned(place[k, 0], place[k, 1], turn)
                # A whole row of the sheet at once: the patch's circle k at all columns of the root.
                line, wanted = sheet[row + margin + down, margin + right : margin + right + cols], np.int8(read[members[k]])
                for col in range(cols):
                    wrong[col] += np.uint16(line[col] != wanted)
            for col in range(cols):
                number = np.int64(wrong[col])
                # Only the best two matter: the second tells whether the best is the only one.
                if number >= second or colours[row, col] < 0:
                    continue
                if number < best:
                    best, second = number, best
                    found[0], found[1], found[2] = row, col, turn
                else:
                    second = number
    return best, second


@kernel
def place_patches(links, read, colours, least, misses, cells, turns, placed, taken):
    """Give cells to linked circles that only one place on the sheet has the colours for.

    IN   links (n, 4, 2); read (n,) colours; colours (rows, cols) int8; least circles of a patch that have their colours, and misses allowed
    IO   cells (n, 2), turns (n,)
    OUT  placed (n,) int32, the circles that got one
    WORK taken (n,) int32

    Returns how many got one. A patch has up to a quarter more circles than `least`; circles next to a root that failed are not tried again.
    O(patches rows cols). Twin: tests/twins_garment_read.py

    Bounds: a circle that is placed has a cell and is in no later patch, so `placed` needs n.
    """
    most = max(least + least // 4, 1)
    members, place, found = np.empty(most, np.int32), np.empty((most, 3), np.int32), np.empty(3, np.int32)
    count = 0
    taken[:] = -1
    tried = np.zeros(len(links), np.bool_)
    for root in range(len(links)):
        if turns[root] >= 0 or tried[root]:
            continue
        size = gather(links, turns, root, members, place, taken)
        # Fewer colours fit somewhere by chance.
        if size < least:
            continue
        # A small patch can spare no misread colour.
        allowed = min(misses, size - least)
        wrong, other = locate(members, place, size, read, colours, allowed, found)
        # It fits nowhere, or at two places.
        if wrong > allowed or other <= allowed:
            # Its neighbours would gather nearly the same circles and fail alike.
            for k in range(min(size, 9)):
                tried[members[k]] = True
            continue
        turn = found[2]
        for k in range(size):
            down, right = turned(place[k, 0], place[k, 1], turn)
            r, c = found[0] + down, found[1] + right
            # The misread ones get no cell: their colour speaks against it.
            if r < 0 or c < 0 or r >= len(colours) or c >= colours.shape[1] or colours[r, c] != read[members[k]]:
                continue
            cells[members[k], 0], cells[members[k], 1] = r, c
            turns[members[k]] = (place[k, 2] + turn) % 4
            placed[count] = members[k]
            count += 1
    return count
