"""Triples of turns of one frame in; those near the frame before out. Twin: tests/test_live_movement.py."""

from __future__ import annotations

import math

from asterism._jit import kernel
from asterism.geometry.shared_kernels import within_half_a_turn


@kernel
def nearer_triples(found, middle, last):
    """Of the two triples of turns that make one rotation that nearer to the last one, by the sum of the three differences.

    IN  middle (N,) which of the three is the turn about the middle axis, half a turn from which the other triple has it; -1 where a row is
        no such triple
    OUT found (N, 3) rad, one of the triples before, the nearer one after; last (N, 3) rad, the last known angles before, with these after
    O(N), no allocation. Bounds: none.
    """
    for row in range(len(found)):
        here, there = 0.0, 0.0
        for k in range(3):
            here += abs(within_half_a_turn(found[row, k] - last[row, k]))
            there += abs(within_half_a_turn(_other(found[row, k], k == middle[row]) - last[row, k]))
        # NaN is never nearer.
        exchange = middle[row] >= 0 and there < here
        for k in range(3):
            if exchange:
                found[row, k] = _other(found[row, k], k == middle[row])
            if math.isfinite(found[row, k]):
                last[row, k] = found[row, k]


@kernel(inline=True)
def _other(angle, is_middle):
    return within_half_a_turn(math.pi - angle if is_middle else angle + math.pi)
