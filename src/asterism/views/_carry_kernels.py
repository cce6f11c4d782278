"""Labels of the last frame and where the body is expected to go in; the same blobs in the next frame out. Twins: tests/twins_views.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel


@kernel
def carry_labels(old_uv, new_uv, old_xy, old_offsets, old_labels, xy, offsets, reach, out):
    """Give each blob the label of the blob before that is expected where it is.

    IN  old_uv, new_uv (C, M, 2) px: the body's markers then and as expected now; old_xy (Q, 2) px, old_offsets (C + 1,), old_labels (Q,)
        -1 for none; xy (P, 2) px, offsets (C + 1,); reach px: how far off a blob may be
    OUT out (P,): labels, -1 where no blob, or more than one, is expected: another blob at less than twice the distance is one too many
    O(Q P / C), no allocation but (P,).
    """
    out[:] = -1
    taken = np.full(len(xy), np.inf)
    for c in range(len(offsets) - 1):
        for q in range(old_offsets[c], old_offsets[c + 1]):
            m = old_labels[q]
            if m < 0:
                continue
            # By how far the body moves, from where the blob was: what the model has off at a marker stays off.
            u = old_xy[q, 0] + new_uv[c, m, 0] - old_uv[c, m, 0]
            v = old_xy[q, 1] + new_uv[c, m, 1] - old_uv[c, m, 1]
            best, second, chosen = np.inf, np.inf, -1
            for k in range(offsets[c], offsets[c + 1]):
                square = (xy[k, 0] - u) ** 2 + (xy[k, 1] - v) ** 2
                if square < best:
                    best, second, chosen = square, best, k
                elif square < second:
                    second = square
            # Another blob nearly as near makes it ambiguous.
            if chosen < 0 or not best < reach * reach or second < 4.0 * best:
                continue
            # Two labels for one blob: neither is believed, now or later.
            if math.isfinite(taken[chosen]):
                out[chosen] = -1
                continue
            taken[chosen], out[chosen] = best, m
