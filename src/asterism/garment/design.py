"""A size or an outline in; a pattern in which every block of 3 x 3 has an identity of its own out: the code generator (GaMoCap 2.1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, product
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.errors import AsterismError
from asterism.garment import _design_kernels as kernels
from asterism.garment.identities import RING, check_colours, count_identities, count_rings, ring_classes, ring_codes
from asterism.garment.pattern import Pattern, Piece, spread_hues
from asterism.progress import Progress
from asterism.recording import Ints

Bools = NDArray[np.bool_]
_CHUNK = 1_000_000
_MOST_LIKE = 40_000_000
"""Entries of the table of identities that are too like each other: 160 MB."""


@dataclass(frozen=True)
class DesignRules:
    """How a pattern is searched. The weights and the acceptance were chosen on squares of 140 to 160 cells and four colours.

    method            "search", or "paper": random colours in raster order, three cells undone at a dead end (GaMoCap 2.1)
    least_difference  cells in which any two blocks differ at least, over all shifts of their rings: 1, or 2 so that no single misread
                      colour makes one identity of another, or 3
    equal_neighbours  whether circles side by side (not diagonal) may have one colour
    balance           how far the share of a colour may exceed 1 / colours, relative; None: by any amount
    raster_steps      cells coloured or undone before what is missing is searched
    search_steps      recolourings tried after that
    patience          steps without progress before the fill in raster order jumps back, each time twice as far
    left              what it costs to leave a context with so many free identities before (1, 2, 3, ...)
    ahead             what it costs to go on from a context with so many free identities (0, 1, 2, ...)
    acceptance        probability to keep a recolouring for each conflict that it adds
    """

    method: Literal["search", "paper"] = "search"
    least_difference: int = 1
    equal_neighbours: bool = True
    balance: float | None = None
    raster_steps: int = 10_000_000
    search_steps: int = 1_500_000_000
    patience: int = 20_000
    left: tuple[float, ...] = (9.0, 1.0, 0.1)
    ahead: tuple[float, ...] = (3.0, 1.0, 0.3, 0.1)
    acceptance: float = 0.02

    def __post_init__(self) -> None:
        if self.least_difference not in (1, 2, 3):
            raise AsterismError(f"a least difference of {self.least_difference} cells is not possible; choose 1, 2 or 3.")
        if self.balance is not None and self.balance <= 0:
            raise AsterismError(f"a balance of {self.balance:g} is not possible; give what a share may exceed the mean by, such as 0.02.")
        if not 0 < self.acceptance < 1 or min(self.raster_steps, self.search_steps) < 0:
            raise AsterismError("the rules of the design need an acceptance between 0 and 1 and steps of 0 or more.")


def design_pattern(
    outline: tuple[int, int] | ArrayLike | Mapping[str, ArrayLike],
    colours: int = 4,
    *,
    seed: int = 0,
    rules: DesignRules | None = None,
    pieces: tuple[Piece, ...] = (),
    size: tuple[float, float] = (0.018, 0.010),
    progress: Progress | None = None,
) -> Pattern:
    """Find a pattern for a size (rows, cols), a mask (rows, cols) bool, or several masks by name, which become pieces of one sheet.

    pieces  where the pieces are in a mask of the whole sheet; left out, the masks given by name are laid side by side
    size    m, pitch and diameter of the circles

    First the cells are coloured in raster order, depth first, which alone reaches 71 % of all identities of four colours on a square;
    then what is missing is filled with conflicts, which a focused search removes. Same outline, seed and rules: the same pattern.
    All pieces share one set of identities, so no two have one in common. Raises AsterismError where the outline needs more identities
    than there are, or where the search does not find them in the steps of its rules.
    """
    check_colours(colours)
    given = rules or DesignRules()
    mask, laid_out = lay_out(outline)
    blocks = int((whole_blocks(mask)).sum())
    most = most_identities(colours, given)
    # What cannot be done is said before any search.
    if blocks > most:
        raise AsterismError(
            f"the pattern needs {blocks} identities, and {colours} colours have at most {most} with these rules; "
            "make it smaller or take more colours."
        )
    rng = np.random.default_rng(seed)
    sheet = _DesignArrays(mask, colours, given)
    # Raster order is fast, and leaves holes near the end; the search then fills them with conflicts and removes these.
    cells, missing = _fill(sheet, given, rng, progress)
    if missing and given.method == "search":
        missing = _search(sheet, cells, given, rng, progress)
    if missing:
        raise AsterismError(
            f"no pattern was found for {blocks} identities of at most {most}: {missing} {_what_is_missing(given)}; "
            "make it smaller, take more colours or fewer rules, or allow more steps."
        )
    return Pattern(sheet.unpadded(cells), spread_hues(colours), *size, pieces or laid_out)


def most_identities(colours: int, rules: DesignRules) -> int:
    """More identities than this no pattern has under these rules; how many of them a sheet can have is for the search to find.

    Where two blocks must differ in two cells, at most one of the blocks with one ring can occur: a colours-th of all. Where circles side by
    side must differ, only classes count of which some ring, in one of its places on the grid, has no equal neighbours.
    """
    if rules.equal_neighbours:
        return count_identities(colours) // (colours if rules.least_difference > 1 else 1)
    codes = np.flatnonzero(ring_classes(colours) >= 0)
    # A class counts only if one of its rings, in one of its turns, has no two equal neighbours.
    ring = codes[:, None] // colours ** np.arange(8) % colours
    uneven = (ring != np.roll(ring, 1, axis=1)).all(axis=1)
    possible = [ring_classes(colours)[codes[uneven & (ring[:, 1::2] != centre).all(axis=1)]] for centre in range(colours)]
    return len(np.unique(np.concatenate(possible))) if rules.least_difference > 1 else sum(len(np.unique(part)) for part in possible)


def fill_pattern(rows: int, cols: int, colours: int = 4, *, seed: int = 0, rules: DesignRules | None = None) -> int:
    """How many whole rows the fill in raster order reaches of a sheet, without the search; for comparisons such as with the paper's."""
    given = rules or DesignRules()
    sheet = _DesignArrays(np.ones((rows, cols), dtype=np.bool_), colours, given)
    missing = _fill(sheet, given, np.random.default_rng(seed), None)[1]
    return (rows * cols - missing) // cols


def lay_out(outline: tuple[int, int] | ArrayLike | Mapping[str, ArrayLike]) -> tuple[Bools, tuple[Piece, ...]]:
    """The mask of the whole sheet and its pieces: side by side from the left, one empty column between them, in the order given.

    Raises AsterismError for a size below 3 x 3 and for a mask that is not two-dimensional or is empty.
    """
    masks = {"sheet": outline} if not isinstance(outline, Mapping) else outline
    cut: dict[str, Bools] = {}
    for name, form in masks.items():
        array = np.ones(form, dtype=np.bool_) if isinstance(form, tuple) and len(form) == 2 else np.asarray(form)
        # A piece without a whole block would carry no identity at all.
        if array.ndim != 2 or not array.size or not whole_blocks(array.astype(np.bool_)).any():
            raise AsterismError(f"piece {name} has no room for a block of 3 x 3 circles; give rows and columns, or a mask of them.")
        cut[str(name)] = array.astype(np.bool_)
    rows = max(mask.shape[0] for mask in cut.values())
    # An empty column between pieces, so that no block spans a seam.
    sheet = np.zeros((rows, sum(mask.shape[1] + 1 for mask in cut.values()) - 1), dtype=np.bool_)
    pieces, column = [], 0
    for name, mask in cut.items():
        sheet[: mask.shape[0], column : column + mask.shape[1]] = mask
        pieces.append(Piece(name, 0, column, *mask.shape))
        column += mask.shape[1] + 1
    return sheet, tuple(pieces)


def tapered(rows: int, top: int, bottom: int) -> Bools:
    """The mask of a sleeve or a trouser leg laid flat: `top` cells wide at its upper end and `bottom` at its lower, (rows, widest) bool."""
    widths = np.rint(np.linspace(top, bottom, rows)).astype(int)
    widest = int(widths.max())
    start = (widest - widths) // 2
    column = np.arange(widest)
    return (column >= start[:, None]) & (column < (start + widths)[:, None])


def whole_blocks(mask: Bools) -> Bools:
    """Which cells have all of their 3 x 3 block in the mask, (rows, cols)."""
    padded = np.pad(mask, 1)
    rows, cols = mask.shape
    return np.logical_and.reduce([padded[1 + dr : 1 + dr + rows, 1 + dc : 1 + dc + cols] for dr, dc in (*RING, (0, 0))])


def too_like(colours: int, least_difference: int) -> NDArray[np.int32]:
    """For each identity the others that differ from it in fewer cells, over all shifts of the ring: (ids, k) int32, -1 fills up.

    Raises AsterismError where the table would not fit into 160 MB.
    """
    rings, ids = count_rings(colours), count_identities(colours)
    near: list[NDArray[np.int32]] = []
    changes = [
        (cells, steps)
        for count in range(1, least_difference)
        for cells in combinations(range(9), count)
        for steps in product(range(1, colours), repeat=count)
    ]
    if len(changes) * ids > _MOST_LIKE:
        raise AsterismError(f"a least difference of {least_difference} is not possible with {colours} colours; choose a smaller one.")
    digits = smallest_rings(colours)[:, None] // colours ** np.arange(8) % colours
    own = np.arange(ids, dtype=np.int32)
    for cells, steps in changes:
        changed, centre = digits.copy(), np.arange(colours)
        for cell, step in zip(cells, steps, strict=True):
            # Cells 0 to 7 are the ring, 8 is the centre.
            if cell < 8:
                changed[:, cell] = (changed[:, cell] + step) % colours
            else:
                centre = (centre + step) % colours
        classes = ring_classes(colours)[ring_codes(changed, colours)]
        other = np.where(classes >= 0, centre[:, None] * rings + classes, -1).astype(np.int32).ravel()
        # A change that turns an identity into itself is no other identity.
        near.append(np.where(other == own, -1, other))
    return np.ascontiguousarray(np.stack(near, axis=1)) if near else np.zeros((ids, 0), dtype=np.int32)


def smallest_rings(colours: int) -> Ints:
    """The smallest ring of each class, (rings,), as its place in `ring_classes`."""
    classes = ring_classes(colours)
    known = np.flatnonzero(classes >= 0)
    return known[np.unique(classes[known], return_index=True)[1]]


class _DesignArrays:
    """The arrays that the kernels share: a mask with an empty border, its cells in raster order, and the tables of identities."""

    def __init__(self, mask: Bools, colours: int, rules: DesignRules) -> None:
        self.colours, self.shape = colours, mask.shape
        # A border of empty cells, so that the ring of every cell can be read without asking whether it is on the sheet.
        self.is_cell = np.pad(mask, 1).ravel()
        self.is_block = np.pad(whole_blocks(mask), 1).ravel()
        self.width = mask.shape[1] + 2
        self.around = np.array([dr * self.width + dc for dr, dc in RING], dtype=np.int64)
        self.order = np.flatnonzero(self.is_cell)
        # A block is whole once its last cell in raster order, the one below right, is coloured.
        last = self.order - self.around[4]
        self.completed = np.where(self.is_block[np.maximum(last, 0)] & (last >= 0), last, -1)
        self.classes = ring_classes(colours)
        self.rings = count_rings(colours)
        self.members = smallest_rings(colours)
        self.near = too_like(colours, rules.least_difference)
        self.apart = not rules.equal_neighbours
        self.excess = np.inf if rules.balance is None else rules.balance

    def unpadded(self, flat: Ints) -> NDArray[np.int8]:
        """The grid (rows, cols) of padded cells."""
        return flat.reshape(self.shape[0] + 2, self.width)[1:-1, 1:-1].astype(np.int8)


def _fill(sheet: _DesignArrays, rules: DesignRules, rng: np.random.Generator, progress: Progress | None) -> tuple[Ints, int]:
    """The padded cells (-1: not coloured) of the fill in raster order, and how many are missing."""
    paper, q = rules.method == "paper", sheet.colours
    flat = np.full(len(sheet.is_cell), -1, dtype=np.int64)
    weights = np.zeros((2, q + 2))
    # The paper chooses at random; ours prefers colours that leave many rings free.
    if not paper:
        weights[0, 1 : q + 1] = [rules.left[k] if k < len(rules.left) else 0.0 for k in range(q)]
        weights[1, : q + 1] = [rules.ahead[k] if k < len(rules.ahead) else 0.0 for k in range(q + 1)]
    free = np.zeros(q**8, dtype=np.int8)
    codes = np.flatnonzero(sheet.classes >= 0)
    low, high = codes % q**4, codes // q**5 * q**4
    for centre in range(q):
        np.add.at(free, centre * q**7 + low + high, 1)
    state = np.array([0, 0, 0, 0, 4], dtype=np.int64)
    word = rng.integers(1, 2**63, 1, dtype=np.uint64)
    tried, chosen = np.zeros(len(sheet.order), dtype=np.int64), np.full(len(sheet.order), -1, dtype=np.int64)
    taken = np.zeros(count_identities(q), dtype=np.int32)
    cap = np.array([20.0, (1.0 + sheet.excess) / q]) if np.isfinite(sheet.excess) else np.array([np.inf, 0.0])
    done = 0
    # Kernels run in pieces, so that progress can be told and Ctrl-C works.
    while done < rules.raster_steps:
        steps = min(_CHUNK, rules.raster_steps - done)
        limits = np.array([3 if paper else 1, rules.raster_steps if paper else rules.patience, steps], dtype=np.int64)
        complete = kernels.fill_in_raster_order(
            flat, sheet.order, sheet.completed, sheet.around, sheet.classes, sheet.members, sheet.near, q, sheet.apart, cap, weights,
            limits, state, word, tried, chosen, taken, free,
        )  # fmt: skip
        done += steps
        if progress is not None:
            progress(0.5 * state[kernels.FURTHEST] / len(sheet.order), "colouring the cells")
        if complete:
            break
    return flat, len(sheet.order) - int(state[kernels.POSITION])


def _search(sheet: _DesignArrays, flat: Ints, rules: DesignRules, rng: np.random.Generator, progress: Progress | None) -> int:
    """Colour the missing cells of `flat` at random, then remove the conflicts in place; returns the conflicts left."""
    q = sheet.colours
    missing = sheet.order[flat[sheet.order] < 0]
    # Start colours at random, but never equal to a neighbour where that is asked for.
    for cell in missing:
        barred = {int(flat[cell + step]) for step in (-1, 1, sheet.around[1], sheet.around[5])} if sheet.apart else set()
        possible = [colour for colour in range(q) if colour not in barred] or list(range(q))
        flat[cell] = possible[int(rng.integers(len(possible)))]
    codes, number, counts, others = _count(sheet, flat)
    queue, queued = np.zeros(len(flat), dtype=np.int64), np.zeros(len(flat), dtype=np.bool_)
    blocks = np.flatnonzero(sheet.is_block)
    # Each pair of equal blocks is a conflict, and each block without a class is one.
    conflicts = int((counts * (counts - 1) // 2).sum() + (number[blocks] < 0).sum())
    for like in sheet.near.T:
        conflicts += int((counts[like] * counts)[like >= 0].sum()) // 2
    waiting = [block for block in blocks if kernels.in_conflict(block, number, counts, sheet.near)]
    queue[: len(waiting)], queued[waiting] = waiting, True
    state = np.array([0, len(waiting), conflicts, 0], dtype=np.int64)
    word = rng.integers(1, 2**63, 1, dtype=np.uint64)
    used = np.bincount(flat[sheet.order], minlength=q).astype(np.int64)
    # A few more than the share of each colour, so that small sheets can be balanced at all.
    cap = int(np.ceil(len(sheet.order) * (1.0 + sheet.excess) / q)) + 20 if np.isfinite(sheet.excess) else len(flat)
    accept = rules.acceptance ** np.arange(12.0)
    while state[kernels.QUEUED] and state[kernels.STEPS] < rules.search_steps:
        steps = int(min(_CHUNK, rules.search_steps - state[kernels.STEPS]))
        kernels.remove_conflicts(
            flat, sheet.is_cell, sheet.is_block, sheet.around, q, sheet.classes, sheet.rings, sheet.near, sheet.apart, cap, accept, steps,
            state, word, codes, number, counts, others, queue, queued, used,
        )  # fmt: skip
        if progress is not None:
            progress(0.5 + 0.5 * state[kernels.STEPS] / rules.search_steps, f"removing {state[kernels.CONFLICTS]} conflicts")
    return int(state[kernels.CONFLICTS])


def _count(sheet: _DesignArrays, flat: Ints) -> tuple[Ints, Ints, Ints, Ints]:
    """Of coloured cells: the ring and the identity of each block, how often each identity occurs, and the exclusive or of its blocks."""
    codes, number = np.zeros(len(flat), dtype=np.int64), np.full(len(flat), -1, dtype=np.int64)
    blocks = np.flatnonzero(sheet.is_block)
    codes[blocks] = flat[blocks[:, None] + sheet.around] @ sheet.colours ** np.arange(8)
    classes = sheet.classes[codes[blocks]]
    number[blocks] = np.where(classes >= 0, classes + flat[blocks] * sheet.rings, -1)
    counts, others = np.zeros(count_identities(sheet.colours), dtype=np.int64), np.zeros(count_identities(sheet.colours), dtype=np.int64)
    known = blocks[number[blocks] >= 0]
    np.add.at(counts, number[known], 1)
    np.bitwise_xor.at(others, number[known], known)
    return codes, number, counts, others


def least_difference(pattern: Pattern) -> int:
    """In how many cells any two blocks of a pattern differ at least, over all shifts of their rings: 1, 2, or 3 for 3 or more.

    A misread of fewer cells never makes one identity of another.
    """
    known = np.zeros(count_identities(pattern.q), dtype=np.bool_)
    known[pattern.known] = True
    for difference in (2, 3):
        near = too_like(pattern.q, difference)[pattern.known]
        # Only pairs of which both occur in this pattern count.
        if (known[np.maximum(near, 0)] & (near >= 0)).any():
            return difference - 1
    return 3


def _what_is_missing(rules: DesignRules) -> str:
    return "cells had no colour left" if rules.method == "paper" else "conflicts were left"
