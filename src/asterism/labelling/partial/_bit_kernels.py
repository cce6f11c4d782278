"""Kernels of sets of points or samples as bits of 64-bit words: how many there are, the first n of them."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel


@kernel(inline=True)
def popcount(word):
    """Number of set bits.

    IN  word uint64
    Returns int. O(1).
    """
    # Sums of neighbouring bits, then of pairs, nibbles and bytes.
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@kernel(inline=True)
def set_first_bits(mask, depth, n):
    """Set the first n bits of a row of words, and clear the others.

    IN  mask (D, ceil(n / 64)) uint64; depth, the row; n
    OUT mask[depth]
    O(n / 64).
    """
    # A shift by 64 is undefined, so that full words are set as a whole.
    for w in range((n + 63) // 64):
        left = n - 64 * w
        mask[depth, w] = ~np.uint64(0) if left >= 64 else (np.uint64(1) << np.uint64(left)) - np.uint64(1)
