"""Where blobs of one image should be in the next, and the blobs there, in; which of them each is, out."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel


@kernel
def link_blobs(ways, xy, clear, near, spreads, before):
    """Link blobs that choose each other, none of which has a second one near, and that lie no further off than most.

    IN  ways (n, 2) px, where blobs should be; xy (m, 2) px, where blobs are; clear: the share of the second's distance that the nearest
        must stay below; near px and spreads: how far off a link may be, the latter in medians of all links
    OUT before (m,) int, the blob that each is, -1 where that is not clear
    O(n m), a few arrays. Twin: tests/test_live_gathering.py

    Bounds: each blob is linked to another one of the n, since both choose each other, so that n links fit.
    """
    many, others = len(ways), len(xy)
    # Squares of distances, since roots cost more than all the rest.
    ahead, miss, second = np.full(many, -1, np.int64), np.full(many, np.inf), np.full(many, np.inf)
    back, closest = np.full(others, -1, np.int64), np.full(others, np.inf)
    for i in range(many):
        for j in range(others):
            dx, dy = ways[i, 0] - xy[j, 0], ways[i, 1] - xy[j, 1]
            apart = dx * dx + dy * dy
            if apart < miss[i]:
                second[i] = miss[i]
                miss[i], ahead[i] = apart, j
            elif apart < second[i]:
                second[i] = apart
            if apart < closest[j]:
                closest[j], back[j] = apart, i
    linked, links = np.empty(many), 0
    for j in range(others):
        before[j] = -1
        i = back[j]
        # Both must choose each other: where two cross, they are left open rather than wrong.
        if i >= 0 and ahead[i] == j and miss[i] < clear * clear * second[i]:
            before[j] = i
            linked[links] = math.sqrt(miss[i])
            links += 1
    if links == 0:
        return
    farthest = near + spreads * np.median(linked[:links])
    for j in range(others):
        # What moved much further than most did is another one that happened to be the only one near.
        if before[j] >= 0 and miss[before[j]] > farthest * farthest:
            before[j] = -1
