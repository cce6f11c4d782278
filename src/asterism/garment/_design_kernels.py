"""Kernels of the code generator: the fill in raster order, and the focused search that removes conflicts."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel

DRAWN, POSITION, FURTHEST, SINCE, JUMP = 0, 1, 2, 3, 4
"""Places in the state of a fill: the random word, cells filled, the most so far, steps since then, cells of the next jump back."""
QUEUED, CONFLICTS, STEPS = 1, 2, 3
"""Places in the state of a search: blocks in the queue, conflicts left, steps made."""


@kernel(inline=True)
def next_word(word):
    """The next 64 bits of a xorshift generator (Marsaglia, Xorshift RNGs, 2003, triple 13 7 17); word is not zero.

    IN  word 64 bits. Returns the next word. O(1).
    """
    word ^= word << np.uint64(13)
    word ^= word >> np.uint64(7)
    word ^= word << np.uint64(17)
    return word


@kernel
def contexts_of(identity, members, colours, out):
    """The eight contexts in which the last cell of a block makes this identity: the centre and the seven other cells of the ring.

    IN  members (rings,) the smallest ring of each class; OUT out (8,) places below colours ** 8. O(8). Twin: tests/twins_garment_design.py
    """
    rings = members.size
    centre = identity // rings
    code = members[identity - centre * rings]
    middle, top = colours**4, colours**7
    # Each of the eight ring places may be the one that is still open.
    for k in range(8):
        out[k] = centre * top + code % middle + code // (middle * colours) * middle
        code = code // colours + code % colours * top


@kernel
def place(identity, step, near, taken, members, colours, free, context):
    """Count an identity as used (step 1) or as free again (step -1), in `taken` with all that are too like it, and in `free` contexts.

    IN near (ids, k) identities too like each, -1 fills up; OUT taken (ids,), free (colours ** 8,), context (8,) scratch. O(k + 8).
    """
    taken[identity] += step
    for k in range(near.shape[1]):
        if near[identity, k] >= 0:
            taken[near[identity, k]] += step
    contexts_of(identity, members, colours, context)
    for k in range(8):
        free[context[k]] -= step


@kernel
def fill_in_raster_order(
    flat, order, completed, around, classes, members, near, colours, apart, cap, weights, rules, state, word, tried, chosen, taken, free
):
    """Colour the cells of a mask one after the other so that every block that a cell completes has an identity of its own; depth first.

    IN  order (cells,) where in `flat` each is; completed (cells,) the centre of the block that the cell is the last of, -1: of none;
        around (8,) steps from a centre along its ring; classes (colours ** 8,); members (rings,); near (ids, k); apart: whether the cells
        to the left and above must differ; cap (2,) a colour is used at most cap[0] + cap[1] * cells times; weights (2, colours + 2):
        what it costs to leave a context, and to go on from one, with so many free identities; rules (3,): cells undone at a dead end,
        steps without progress before a longer jump back, steps of this call
    OUT flat (padded cells,), state, word (1,), tried (cells,) bits, chosen (cells,), taken (ids,), free (colours ** 8,): all of the fill,
        so that the next call goes on. Returns whether it is complete.

    The last cell of a block is always the fourth place of its ring. Of the colours possible there the one is taken that leaves the
    contexts of its identity the most free identities (a context without one is a dead end). O(steps * (colours * 16 + k)), no allocation
    but of two small arrays. GaMoCap 2.1 undoes three cells at a dead end and has no weights.

    Bounds: `position` is a cell of `order` and falls no further than 0. `free` starts as the number of rings in each context, `colours` at
    most, and no identity is placed twice, so it stays within 0 to `colours`: `weights` has two more.
    """
    rings, context, used = members.size, np.zeros(8, np.int64), np.zeros(colours, np.int64)
    position, furthest, since, jump = state[POSITION], state[FURTHEST], state[SINCE], state[JUMP]
    random = word[0]
    # The counts are not kept between calls, since they follow from the cells.
    for k in range(position):
        used[flat[order[k]]] += 1
    for _ in range(rules[2]):
        if position == order.size:
            break
        since += 1
        cell, centre = order[position], completed[position]
        base, middle = 0, 0
        if centre >= 0:
            middle = flat[centre]
            for k in range(8):
                if k != 4:
                    base += flat[centre + around[k]] * colours**k
        random = next_word(random)
        # A random addend below one breaks ties without outweighing a context.
        best, best_cost, best_identity = -1, np.inf, -1
        for colour in range(colours):
            # Tried before at this place with the same cells before it, or used up.
            if (tried[position] >> colour) & 1 or used[colour] >= cap[0] + cap[1] * position:
                continue
            if apart and (flat[cell - 1] == colour or flat[cell + around[1]] == colour):
                continue
            cost, identity = float((random >> np.uint64(7 * colour + 7)) & np.uint64(127)) / 256.0, -1
            if centre >= 0:
                ring = classes[base + colour * colours**4]
                # No identity, one that is taken, or one too like it.
                if ring < 0 or taken[ring + middle * rings] > 0:
                    continue
                identity = ring + middle * rings
                contexts_of(identity, members, colours, context)
                for k in range(8):
                    # A context that loses its last free identity is a dead end for a later cell.
                    cost += weights[0, free[context[k]]]
                # One cell ahead: what this colour leaves for the next.
                if position + 1 < order.size and completed[position + 1] >= 0:
                    following = completed[position + 1]
                    ahead = flat[following] * colours**7
                    for k in range(8):
                        if k != 4:
                            seen = following + around[k]
                            ahead += (colour if seen == cell else flat[seen]) * colours ** (k if k < 4 else k - 1)
                    cost += weights[1, free[ahead]]
            if cost < best_cost:
                best, best_cost, best_identity = colour, cost, identity
        if best >= 0:
            tried[position] |= 1 << best
            flat[cell], chosen[position] = best, best_identity
            used[best] += 1
            if best_identity >= 0:
                place(best_identity, 1, near, taken, members, colours, free, context)
            position += 1
            if position < order.size:
                tried[position] = 0
            if position > furthest:
                furthest, since, jump = position, 0, 4
            continue
        back = min(rules[0], position)
        # Stuck: the mistake lies farther back than single steps reach, and each longer jump doubles.
        jumps = since > rules[1]
        if jumps:
            back, jump, since = min(jump, position), 2 * jump, 0
        for _ in range(back):
            position -= 1
            used[flat[order[position]]] -= 1
            flat[order[position]] = -1
            if chosen[position] >= 0:
                place(chosen[position], -1, near, taken, members, colours, free, context)
        # After a jump the colours tried here were tried with other cells before it.
        if jumps or position == 0:
            tried[position] = 0
    state[POSITION], state[FURTHEST], state[SINCE], state[JUMP] = position, furthest, since, jump
    word[0] = random
    return position == order.size


@kernel
def in_conflict(block, number, counts, near):
    """Whether a block has no identity, or shares it, or has one that is too like another's.

    IN  number (blocks,) identity of each block, -1 for none; counts (identities,) blocks of each; near (identities, k) those too like it,
        -1 where there are fewer
    Returns a bool. O(k).
    """
    identity = number[block]
    if identity < 0 or counts[identity] > 1:
        return True
    shared = False
    for k in range(near.shape[1]):
        shared |= near[identity, k] >= 0 and counts[near[identity, k]] > 0
    return shared


@kernel
def recolour(cell, colour, flat, is_block, around, colours, classes, rings, codes, number, counts, others, near):
    """Give a cell another colour and its nine blocks their new identities; returns by how much the conflicts grow.

    A conflict is a block without an identity, or a pair of blocks with one identity or with two that are too like each other.
    IN  is_block (cells,), around (8,), classes (colours ** 8,), near (ids, k)
    OUT flat, codes (cells,) rings; number (cells,) identities; counts (ids,); others (ids,) exclusive or of the blocks with an identity
    O(9 (k + 1)). Twin: tests/twins_garment_design.py

    Bounds: flat has a border of one cell outside the mask, so the blocks around a cell are in it.
    """
    step = colour - flat[cell]
    flat[cell] = colour
    change, scale = 0, 1
    for k in range(9):
        block = cell - around[k] if k < 8 else cell
        if k < 8:
            scale = colours**k
        if not is_block[block]:
            continue
        if k < 8:
            codes[block] += step * scale
        before, after = number[block], classes[codes[block]]
        if before >= 0:
            counts[before] -= 1
            # An exclusive or of all blocks of an identity: of two, it gives the other.
            others[before] ^= block
            # Pairs that the block made with all others of its identity.
            change -= counts[before]
            for j in range(near.shape[1]):
                if near[before, j] >= 0:
                    change -= counts[near[before, j]]
        else:
            change -= 1
        if after >= 0:
            after += flat[block] * rings
            change += counts[after]
            for j in range(near.shape[1]):
                if near[after, j] >= 0:
                    change += counts[near[after, j]]
            counts[after] += 1
            others[after] ^= block
        else:
            change += 1
        number[block] = after
    return change


@kernel
def remove_conflicts(
    flat, is_cell, is_block, around, colours, classes, rings, near, apart, cap, accept, steps, state, word, codes, number, counts, others,
    queue, queued, used,
):  # fmt: skip
    """Recolour cells of blocks in conflict until none is left, or for so many steps: focused Metropolis search.

    A step takes a block in conflict at random, one of its nine cells and another colour. What makes no new conflict is kept; d more
    conflicts are kept with probability accept[d]. Seitz, Alava, Orponen, Focused local search for random 3-satisfiability (2005).
    IN  is_cell, is_block (cells,); apart: whether cells side by side must differ; cap: the most cells of one colour; accept (m,)
    OUT all others; queue (cells,) holds every block in conflict but at most one of each identity. Returns the conflicts left.
    O(steps * 18 (k + 1)), no allocation.

    Bounds: a block is in the queue once (`queued`), so `queue` needs no more room than there are cells. flat has a border of one cell
    outside the mask.
    """
    waiting, conflicts, random = state[QUEUED], state[CONFLICTS], word[0]
    for _ in range(steps):
        if waiting == 0:
            break
        state[STEPS] += 1
        random = next_word(random)
        entry = np.int64(((random >> np.uint64(32)) * np.uint64(waiting)) >> np.uint64(32))
        block = queue[entry]
        # Solved by a neighbour's step since it came into the queue.
        if not in_conflict(block, number, counts, near):
            waiting -= 1
            queue[entry] = queue[waiting]
            queued[block] = False
            continue
        random = next_word(random)
        identity = number[block]
        # Only one of the two is in the queue; half of the time the other one moves.
        if identity >= 0 and counts[identity] == 2 and (random >> np.uint64(60)) & np.uint64(1):
            block ^= others[identity]
        pick = np.int64(((random >> np.uint64(28)) & np.uint64(0xFFFFFF)) * np.uint64(9 * (colours - 1)) >> np.uint64(24))
        cell = block + around[pick // (colours - 1)] if pick < 8 * (colours - 1) else block
        old = flat[cell]
        new = (old + pick % (colours - 1) + 1) % colours
        if used[new] >= cap:
            continue
        # Equal neighbours could run into one blob in the image.
        if apart and (flat[cell - 1] == new or flat[cell + 1] == new or flat[cell + around[1]] == new or flat[cell + around[5]] == new):
            continue
        change = recolour(cell, new, flat, is_block, around, colours, classes, rings, codes, number, counts, others, near)
        random = next_word(random)
        # Uphill now and then, or the search stays in the first valley.
        if change > 0 and (change >= accept.size or (random >> np.uint64(11)) * (1.0 / 9007199254740992.0) >= accept[change]):
            recolour(cell, old, flat, is_block, around, colours, classes, rings, codes, number, counts, others, near)
            continue
        conflicts += change
        used[old] -= 1
        used[new] += 1
        for k in range(9):
            touched = cell - around[k] if k < 8 else cell
            if is_block[touched] and not queued[touched] and in_conflict(touched, number, counts, near):
                queued[touched] = True
                queue[waiting] = touched
                waiting += 1
    state[QUEUED], state[CONFLICTS] = waiting, conflicts
    word[0] = random
    return conflicts
