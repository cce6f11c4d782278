"""Weighted set packing on flat arrays: hypotheses that want the same blobs in, the set without a conflict that is worth most out."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel
from asterism.reconstruction._order_kernels import ascending

MOST_WORK = 5_000_000
"""Looks at a rival that the search in one tangle may take before the best found so far must do, and again that exchanges may take."""


@kernel
def pack(rays, scores, count, blobs):
    """Choose hypotheses of the greatest total score, no two with a blob in common.

    IN  rays (n, C) blob numbers below `blobs` or -1; scores (n,) > 0; the first `count` rows count
    Returns chosen (count,) bool, and how many tangles were cut off before their search had proved the best.
    A hypothesis that is worth no less than the best that its rivals can be worth together is taken at once; what is left falls into
    tangles without common blobs, each solved by branch and bound. Within MOST_WORK the choice is the best there is (twin: an
    integer program); beyond, it is the best found, improved by exchanges of one for several.
    """
    cameras = rays.shape[1]
    order = ascending(-scores, count)
    starts = np.zeros(blobs + 1, np.int64)
    for n in range(count):
        for c in range(cameras):
            if rays[n, c] >= 0:
                starts[rays[n, c] + 1] += 1
    for blob in range(blobs):
        starts[blob + 1] += starts[blob]
    holders = np.empty(starts[blobs], np.int64)
    fill = np.empty(blobs + 1, np.int64)
    for blob in range(blobs + 1):
        fill[blob] = starts[blob]
    for n in order:
        for c in range(cameras):
            if rays[n, c] >= 0:
                holders[fill[rays[n, c]]] = n
                fill[rays[n, c]] += 1
    chosen = np.zeros(count, np.bool_)
    alive = np.ones(count, np.bool_)
    seen = np.full(count, -1, np.int64)
    stamp = 0
    changed = True
    while changed:
        changed = False
        for n in order:
            if not alive[n]:
                continue
            stamp += 1
            rivals = 0.0
            for c in range(cameras):
                if rays[n, c] < 0:
                    continue
                best = 0.0
                for place in range(starts[rays[n, c]], starts[rays[n, c] + 1]):
                    other = holders[place]
                    if alive[other] and other != n and seen[other] != stamp:
                        seen[other] = stamp
                        best = max(best, scores[other])
                rivals += best
            if scores[n] >= rivals:
                chosen[n] = True
                changed = True
                _strike(rays, starts, holders, alive, n)
    unproved = 0
    members, falling, local = np.empty(count, np.int64), np.empty(count), np.full(count, -1, np.int64)
    for n in order:
        if alive[n]:
            many = _tangle(rays, starts, holders, alive, n, members, local)
            for k in range(many):
                falling[k] = -scores[members[k]]
            tangle = members[ascending(falling, many)]
            for k in range(many):
                local[tangle[k]] = k
            if not _search(rays, scores, starts, holders, local, tangle, chosen):
                unproved += 1
            for k in range(many):
                alive[tangle[k]] = False
                local[tangle[k]] = -1
    return chosen, unproved


@kernel
def _strike(rays, starts, holders, alive, n):
    """Take a hypothesis and all its rivals off the list."""
    alive[n] = False
    for c in range(rays.shape[1]):
        if rays[n, c] >= 0:
            for place in range(starts[rays[n, c]], starts[rays[n, c] + 1]):
                alive[holders[place]] = False


@kernel
def _tangle(rays, starts, holders, alive, n, members, local):
    """All living hypotheses that hang together with one by common blobs, which `local` marks; they are written to `members`.

    Returns how many. Allocates nothing: frames can have thousands of tangles.
    """
    local[n] = 0
    members[0] = n
    many, at = 1, 0
    while at < many:
        for c in range(rays.shape[1]):
            blob = rays[members[at], c]
            if blob >= 0:
                for place in range(starts[blob], starts[blob + 1]):
                    other = holders[place]
                    if alive[other] and local[other] < 0:
                        local[other] = many
                        members[many] = other
                        many += 1
        at += 1
    return many


@kernel
def _search(rays, scores, starts, holders, local, members, chosen):
    """Branch and bound over one tangle, best first into `chosen`. Returns whether the result is proved the best.

    members: by falling score; local: their places among them, -1 for all others. The search begins with the greedy choice. Its bound lets
    each blob be used once but no more: a cover of the hypotheses by blobs, each blob at the worth of its best.
    """
    many = len(members)
    blocked = np.zeros(many, np.int64)
    taken, best = np.zeros(many, np.bool_), np.zeros(many, np.bool_)
    covered = np.full(many, -1, np.int64)
    path = np.empty(many + 1, np.int64)
    best_value = _greedy(rays, scores, starts, holders, local, members, best)
    depth, at, value, work, stamp = 0, 0, 0.0, 0, 0
    proved = True
    going = True
    while going:
        bound = value
        stamp += 1
        for k in range(at, many):
            if blocked[k] == 0 and covered[k] != stamp:
                bound += scores[members[k]]
                opened, widest = -1, 0
                for c in range(rays.shape[1]):
                    blob = rays[members[k], c]
                    if blob >= 0:
                        wide = 0
                        work += starts[blob + 1] - starts[blob]
                        for place in range(starts[blob], starts[blob + 1]):
                            j = local[holders[place]]
                            wide += j >= at and blocked[j] == 0 and covered[j] != stamp
                        if wide > widest:
                            opened, widest = blob, wide
                for place in range(starts[opened], starts[opened + 1]):
                    j = local[holders[place]]
                    if j >= 0:
                        covered[j] = stamp
        while at < many and blocked[at] != 0:
            at += 1
        if bound > best_value + 1e-9 and at < many and work <= MOST_WORK:
            taken[at] = True
            value += scores[members[at]]
            path[depth] = at
            depth += 1
            _block(rays, starts, holders, local, members[at], blocked, 1)
            at += 1
            continue
        if at >= many and value > best_value + 1e-9:
            best_value = value
            for k in range(many):
                best[k] = taken[k]
        if work > MOST_WORK:
            proved = False
            break
        going = False
        if depth > 0:
            depth -= 1
            at = path[depth]
            taken[at] = False
            value -= scores[members[at]]
            _block(rays, starts, holders, local, members[at], blocked, -1)
            at += 1
            going = True
    if not proved:
        _exchange(rays, scores, starts, holders, local, members, best)
    for k in range(many):
        if best[k]:
            chosen[members[k]] = True
    return proved


@kernel
def _greedy(rays, scores, starts, holders, local, members, best):
    """Take the hypotheses of a tangle in their order where they still can be, into `best`. Returns what they are worth."""
    blocked = np.zeros(len(members), np.int64)
    value = 0.0
    for k in range(len(members)):
        if blocked[k] == 0:
            best[k] = True
            value += scores[members[k]]
            _block(rays, starts, holders, local, members[k], blocked, 1)
    return value


@kernel
def _block(rays, starts, holders, local, n, blocked, by):
    """Count one more (or less) chosen rival for everything that shares a blob with hypothesis n."""
    for c in range(rays.shape[1]):
        blob = rays[n, c]
        if blob >= 0:
            for place in range(starts[blob], starts[blob + 1]):
                j = local[holders[place]]
                if j >= 0:
                    blocked[j] += by


@kernel
def _exchange(rays, scores, starts, holders, local, members, best):
    """Improve a choice while putting one hypothesis in and its rivals out, then what became free in, is worth more."""
    many = len(members)
    blocked = np.zeros(many, np.int64)
    for k in range(many):
        if best[k]:
            _block(rays, starts, holders, local, members[k], blocked, 1)
    out = np.empty(many, np.int64)
    new = np.empty(many, np.int64)
    improved = True
    work = 0
    while improved and work <= MOST_WORK:
        improved = False
        for k in range(many):
            if best[k] or work > MOST_WORK:
                continue
            lost, leaving = 0.0, 0
            for c in range(rays.shape[1]):
                blob = rays[members[k], c]
                if blob >= 0:
                    work += starts[blob + 1] - starts[blob]
                    for place in range(starts[blob], starts[blob + 1]):
                        j = local[holders[place]]
                        if j >= 0 and best[j]:
                            best[j] = False
                            _block(rays, starts, holders, local, members[j], blocked, -1)
                            out[leaving] = j
                            leaving += 1
                            lost += scores[members[j]]
            best[k] = True
            _block(rays, starts, holders, local, members[k], blocked, 1)
            won, coming = scores[members[k]], 0
            for o in range(leaving):
                for c in range(rays.shape[1]):
                    blob = rays[members[out[o]], c]
                    if blob >= 0:
                        work += starts[blob + 1] - starts[blob]
                        for place in range(starts[blob], starts[blob + 1]):
                            j = local[holders[place]]
                            if j >= 0 and not best[j] and blocked[j] == 0:
                                best[j] = True
                                _block(rays, starts, holders, local, members[j], blocked, 1)
                                new[coming] = j
                                coming += 1
                                won += scores[members[j]]
            if won > lost + 1e-9:
                improved = True
                continue
            for n in range(coming):
                best[new[n]] = False
                _block(rays, starts, holders, local, members[new[n]], blocked, -1)
            best[k] = False
            _block(rays, starts, holders, local, members[k], blocked, -1)
            for o in range(leaving):
                best[out[o]] = True
                _block(rays, starts, holders, local, members[out[o]], blocked, 1)
