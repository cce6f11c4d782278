"""Circles with colours and neighbours in; the identities of those that the grid confirms out (GaMoCap 2.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from asterism.garment.identities import block_rings
from asterism.garment.pattern import Pattern
from asterism.garment.read import _identity_kernels as kernels
from asterism.garment.read.rules import ReadRules
from asterism.recording import Floats

_RADIUS = 3
_LEVEL = 0.95


@dataclass(frozen=True)
class Identified:
    """Identities of circles.

    ids         (n,) int32, -1 where unknown
    grid        (n, 2) int32 row and column on the sheet, -1 where unknown: also of circles at a border, which have no identity
    confidence  (n,) that the row and column are right, 0 where unknown: never above what was measured; see `identify`
    windows     3 x 3 blocks that were read whole
    existing    of them, those that the pattern has
    shared      circles left out because another one would be at the same place of the sheet
    """

    ids: NDArray[np.int32]
    grid: NDArray[np.int32]
    confidence: Floats
    windows: int
    existing: int
    shared: int


def identify(centres: Floats, links: NDArray[np.int32], posterior: Floats, pattern: Pattern, rules: ReadRules) -> Identified:
    """Look blocks up in the pattern, and keep what a neighbourhood agrees on.

    A block of nine colours is some block of a suit's pattern by chance in one of ten cases, so none is believed alone. Blocks that
    are side by side in the image and on the grid form groups; a group's map to the grid is carried on to the circles around it. Each
    circle whose colour is that of its cell is evidence, log q nats, and one misread costs it. A map needs `rules.alone` nats beyond the
    number of places and turns that it could have. A circle needs `nearby` nats around it and `each_side` on its weakest side, so that
    what is across a fold does not speak for it. It needs two squares of four linked circles, or one that is nearly a parallelogram: a
    link that leads over a circle which was not found, or to another part of the cloth, makes none.

    Colours speak by the score for most circles, so by them alone doubt would be 1e-12; but identities go wrong by links. So each has at
    least the share of wrong ones that 102,666 identities of rendered suits leave possible (95 %): 7e-4 of circles with the fewest squares,
    where 2 of 8,839 were wrong, 3e-5 of all others, where none of 93,827 was. What those images did not show is not in it.
    """
    n, q = posterior.shape
    ring = np.empty((n, 8), np.int32)
    kernels.rings(links, ring)
    read = posterior.argmax(axis=1)
    cells, turns, windows, existing = _look_up(ring, read, pattern)
    roots = np.empty(n, np.int32)
    kernels.groups(links, cells, turns, roots)
    size = np.bincount(roots[turns >= 0], minlength=n)[roots]
    lone = (turns >= 0) & (size < 3)
    turns[lone] = -1
    blocks = np.flatnonzero(turns >= 0)
    order = blocks[np.argsort(-size[blocks], kind="stable")].astype(np.int32)
    likelihood = np.log(q * ((1 - rules.misread) * posterior + rules.misread / q))
    kernels.spread(links, pattern.colours, likelihood, order, cells, turns, np.empty(n, np.int32))
    kernels.groups(links, cells, turns, roots)
    there = turns >= 0
    own = np.zeros(n)
    own[there] = likelihood[there, pattern.colours[cells[there, 0], cells[there, 1]]]
    agreed, weight = np.empty((n, 4), np.int32), np.empty((n, 8))
    kernels.agreeing(links, cells, turns, agreed)
    kernels.evidence(centres, links, agreed, own, cells, turns, _RADIUS, rules.skew, weight)
    beyond = np.bincount(roots, own, n)[roots] - np.log(4.0 * max((pattern.colours >= 0).sum(), 1))
    side = weight[:, 1:5].min(axis=1)
    given = there & (beyond > rules.alone) & (weight[:, 0] > rules.nearby) & (side > rules.each_side)
    given &= (weight[:, 5] >= rules.squares) & (weight[:, 6] > weight[:, 7])
    twice = _twice(cells, given, pattern.shape)
    given &= ~twice
    grid = np.where(given[:, None], cells, -1).astype(np.int32)
    ids = np.where(given, pattern.ids[cells[:, 0], cells[:, 1]], -1).astype(np.int32)
    shown = np.where(weight[:, 5] > rules.squares, _at_most(*rules.shown_more), _at_most(*rules.shown_few))
    doubt = (
        shown + np.exp(-np.minimum(beyond, 30.0)) + rules.astray * np.exp(-np.maximum(side, 0.0)) + np.exp(-np.maximum(weight[:, 0], 0.0))
    )
    return Identified(ids, grid, np.where(given, 1.0 / (1.0 + doubt), 0.0), windows, existing, int(twice.sum()))


def _at_most(count: int, wrong: int) -> float:
    """The share of wrong ones that is possible where so many of a count were, with 95 % probability: 3 / count where none was (Poisson)."""
    return min(1.0, float(chdtri(2 * (wrong + 1), 1 - _LEVEL)) / 2 / max(count, 1))


def _look_up(ring: NDArray[np.int32], read: NDArray[np.int64], pattern: Pattern) -> tuple[NDArray[np.int32], NDArray[np.int32], int, int]:
    """Cells (n, 2) and turns (n,) of the blocks around circles, -1 where none was read or the pattern has none such; counts of both.

    A ring that fits only by an odd shift, its corners at the sides, is none of the pattern's: no turn of the grid makes that.
    """
    n = len(ring)
    cells, turns = np.full((n, 2), -1, np.int32), np.full(n, -1, np.int32)
    whole = np.flatnonzero((ring >= 0).all(axis=1))
    seen = read[ring[whole]]
    number = pattern.identity(read[whole], seen)
    known = number >= 0
    rows, seen = whole[known], seen[known]
    place = pattern.cells(number[known])
    # The pattern's rings begin at the upper left; those of `rings` at direction 0, which is along a row where the turn is 0.
    printed = np.roll(block_rings(pattern.colours)[place[:, 0], place[:, 1]], -3, axis=1)
    for turn in range(4):
        same = (np.roll(printed, -2 * turn, axis=1) == seen).all(axis=1)
        turns[rows[same]] = turn
        cells[rows[same]] = place[same]
    return cells, turns, len(whole), int((turns >= 0).sum())


def _twice(cells: NDArray[np.int32], given: NDArray[np.bool_], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """(n,) circles whose cell another circle has, too: at most one of them is right."""
    flat = cells[:, 0] * shape[1] + cells[:, 1]
    count = np.bincount(flat[given], minlength=shape[0] * shape[1])
    return np.asarray(given & (count[np.where(given, flat, 0)] > 1))
