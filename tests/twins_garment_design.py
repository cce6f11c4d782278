"""Slow, readable twins of the garment's kernels."""

from __future__ import annotations

from itertools import product

import numpy as np


def contexts_of(centre: int, ring: tuple[int, ...], colours: int) -> set[tuple[int, ...]]:
    """Centre and seven colours that are known before the fourth place of the ring is coloured, for each shift of the ring."""
    shifts = [ring[k:] + ring[:k] for k in range(8)]
    return {(centre, *shift[:4], *shift[5:]) for shift in shifts}


def difference(a: tuple[int, ...], b: tuple[int, ...]) -> int:
    """In how many cells two blocks (centre, then ring) differ at least, over all shifts of the ring."""
    return (a[0] != b[0]) + min(sum(x != y for x, y in zip(a[1:], b[1 + k :] + b[1 : 1 + k], strict=True)) for k in range(8))


def blocks_of(grid: np.ndarray) -> list[tuple[int, ...]]:
    """Centre and ring of all whole blocks of a grid, rows first."""
    places = [(-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1)]
    rows, cols = grid.shape
    blocks = [[(r, c), *((r + dr, c + dc) for dr, dc in places)] for r, c in product(range(1, rows - 1), range(1, cols - 1))]
    return [tuple(int(grid[cell]) for cell in block) for block in blocks if all(grid[cell] >= 0 for cell in block)]


def conflicts(grid: np.ndarray) -> int:
    """Blocks whose ring has a period, and pairs of blocks with one identity."""
    blocks = blocks_of(grid)
    periodic = [block[1:] == block[5:] + block[1:5] for block in blocks]
    whole = [
        min((block[0], *block[1 + k :], *block[1 : 1 + k]) for k in range(8))
        for block, bad in zip(blocks, periodic, strict=True)
        if not bad
    ]
    times = np.unique(np.array(whole), axis=0, return_counts=True)[1] if whole else np.zeros(0, int)
    return sum(periodic) + int((times * (times - 1) // 2).sum())
