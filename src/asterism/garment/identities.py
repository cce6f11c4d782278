"""Colours of a 3 x 3 block in, its identity out: the centre's colour and the cyclic class of its ring of eight neighbours (GaMoCap 2.1)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.errors import AsterismError
from asterism.recording import Ints

RING = ((-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1))
"""Rows and columns from the centre to its neighbours, clockwise as the printed side shows them, from the upper left."""
MOST_COLOURS = 8
"""The table of all rings has colours ** 8 entries: 67 MB for eight colours."""


def count_rings(colours: int) -> int:
    """How many cyclic classes of rings of eight there are that have no rotational period: (q^8 - q^4) / 8.

    A ring of eight has a period if a shift by 1, 2 or 4 places leaves it unchanged, and then the shift by 4 does: q^4 rings are their own
    shift by 4. The others have eight different shifts each, which make one class. For four colours (65536 - 256) / 8 = 8160, as the paper
    has it (GaMoCap 2.1).
    """
    return (colours**8 - colours**4) // 8


def count_identities(colours: int) -> int:
    """The most identities that a pattern of so many colours can have: a centre of each colour in each class of rings; 32,640 for four."""
    return colours * count_rings(colours)


@lru_cache(maxsize=4)
def ring_classes(colours: int) -> NDArray[np.int32]:
    """The class of each ring of eight, (colours ** 8,) int32; -1 for a ring with a rotational period.

    A ring c0 ... c7 has the place c0 + c1 q + ... + c7 q^7. Classes count from 0 in the order of their smallest member. Where the ring
    begins does not matter: "rotation" is a shift by any number of places, as in the paper, also by odd ones, which no turn of the square
    grid makes. Raises AsterismError for fewer than 2 or more than 8 colours.
    """
    check_colours(colours)
    codes = np.arange(colours**8, dtype=np.int32)
    # All eight shifts of every ring, one after the other; the smallest one names the class.
    smallest, turned = codes.copy(), codes
    for shift in range(1, 8):
        turned = turned // colours + (turned % colours) * colours**7
        np.minimum(smallest, turned, out=smallest)
        # A ring with any period is its own shift by four.
        if shift == 4:
            # Classes are numbered by their smallest rings.
            periodic = turned == codes
    first = (smallest == codes) & ~periodic
    rank = np.cumsum(first, dtype=np.int32) - 1
    classes = np.where(periodic, -1, rank[smallest]).astype(np.int32)
    classes.setflags(write=False)
    return classes


def ring_codes(rings: ArrayLike, colours: int) -> Ints:
    """The place in `ring_classes` of rings (..., 8) of colours from 0; -1 where a colour is missing (-1) or unknown."""
    ring = np.asarray(rings, dtype=np.int64)
    whole = ((ring >= 0) & (ring < colours)).all(axis=-1)
    return np.where(whole, ring @ colours ** np.arange(8, dtype=np.int64), -1)


def identities(centres: ArrayLike, rings: ArrayLike, colours: int) -> NDArray[np.int32]:
    """The identities of blocks: centre * count_rings(colours) + class of the ring; -1 where a colour is missing or the ring has a period.

    centres (...,) and rings (..., 8) are colours from 0. Rings may begin anywhere but must be read clockwise on the printed side.
    """
    centre, codes = np.asarray(centres, dtype=np.int64), ring_codes(rings, colours)
    classes = ring_classes(colours)[np.maximum(codes, 0)]
    known = (codes >= 0) & (classes >= 0) & (centre >= 0) & (centre < colours)
    return np.where(known, centre * count_rings(colours) + classes, -1).astype(np.int32)


def block_rings(grid: NDArray[np.int8]) -> NDArray[np.int8]:
    """The ring of neighbours of each cell of a grid of colours, (rows, cols, 8); -1 beyond the grid and outside the mask."""
    padded = np.pad(grid, 1, constant_values=-1)
    rows, cols = grid.shape
    return np.stack([padded[1 + dr : 1 + dr + rows, 1 + dc : 1 + dc + cols] for dr, dc in RING], axis=-1)


def grid_identities(grid: NDArray[np.int8], colours: int) -> NDArray[np.int32]:
    """The identity of each cell, (rows, cols); -1 outside the mask, at its edge, and where the ring has a period."""
    return identities(grid, block_rings(grid), colours)


def check_colours(colours: int) -> None:
    """Raise AsterismError for fewer than 2 or more than 8 colours."""
    if not 2 <= colours <= MOST_COLOURS:
        raise AsterismError(f"a pattern of {colours} colours is not possible; choose from 2 to {MOST_COLOURS}, such as 4.")
