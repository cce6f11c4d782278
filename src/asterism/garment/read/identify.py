"""Circles with colours and neighbours in; the identities of those that the grid confirms out (GaMoCap 2.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from asterism.garment.identities import ring_classes
from asterism.garment.pattern import Pattern
from asterism.garment.read import _growth_kernels as growth
from asterism.garment.read import _identity_kernels as kernels
from asterism.garment.read import _weight_kernels as weigh
from asterism.garment.read._patch_kernels import place_patches
from asterism.garment.read.circles import Circles, ellipse_axes
from asterism.garment.read.rules import ReadRules
from asterism.recording import Floats

_RADIUS = 3
"""Rows and columns around a circle whose colours speak for it."""
_BLOCKS = 3
"""Blocks side by side from which cells are carried on."""
_FOLDS = 0.25
"""Change of the logarithm of the ratio of axes from a circle to its neighbours that folds and covers make; a circle of d px adds 1 / d."""
_SIDE = 8.0
"""px, of the buckets that circles are sorted into."""
_LEVEL = 0.95


@dataclass(frozen=True)
class Identified:
    """Identities of circles.

    ids         (n,) int32, -1 where unknown
    grid        (n, 2) int32 row and column on the sheet, -1 where unknown: also of circles at a border, which have no identity
    confidence  (n,) that the row and column are right, 0 where unknown: never above what was measured (`rules.validated_wrong`)
    apart       (n,) how far the logarithm of the area is from that of the neighbours
    windows     3 x 3 blocks that were read whole
    existing    of them, those that the pattern has
    shared      circles left out because another one would be at the same place of the sheet
    """

    ids: NDArray[np.int32]
    grid: NDArray[np.int32]
    confidence: Floats
    apart: Floats
    windows: int
    existing: int
    shared: int


def identify(circles: Circles, links: NDArray[np.int32], posterior: Floats, pattern: Pattern, rules: ReadRules) -> Identified:
    """Look blocks up in the pattern, carry their cells on to the circles around, and keep what is most likely right.

    A block of nine colours is some block of a suit's pattern by chance in one of ten cases, so none is believed alone. Blocks that are
    side by side in the image and on the grid form groups, whose cells are carried on along links. Linked circles that hold no such blocks,
    as between a seam and the rim of an arm, are placed where `rules.patch` of their colours fit, and nowhere else nearly as well. A map
    needs `rules.map_evidence` nats beyond the number of places and turns that it could have; it needs `rules.map_evidence_supported` where
    other maps are sure of most circles. From there cells are carried on to circles that lie where rows and columns go on, with links or
    without.

    Then each circle is weighed: the colours around it, as log q nats each and a misread one as a loss, in all and on its weakest side,
    because what is across a fold does not speak for it; how far it is from where its neighbours expect it; whether another cell is
    expected there, too; squares that it closes; and whether something coloured lies between it and its neighbours. `rules.weights` make
    log odds of that, less for an area unlike the neighbours', and a circle needs `rules.odds`; where it closes few squares with others, it
    needs what `rules.end` and `rules.corner` say, too. One that is much larger or smaller than its neighbours has run into another, or is
    covered, and gets no identity. A lone misread colour in a neighbourhood that fits is corrected so.
    """
    n, q = posterior.shape
    ring = np.empty((n, 8), np.int32)
    kernels.rings(links, ring)
    # Blocks first: nine colours without a doubt about neighbours, looked up under all four turns of the ring.
    read = posterior.argmax(axis=1)
    cells, turns = np.empty((n, 2), np.int32), np.empty(n, np.int32)
    windows, existing = kernels.look_up(ring, read, q, ring_classes(q), pattern.cell_of, pattern.colours, cells, turns)
    # A colour may be misread, so no circle speaks against a place without bound.
    likelihood = np.log(q * ((1 - rules.misread) * posterior + rules.misread / q))
    _carry_on(links, read, likelihood, pattern, rules, cells, turns)
    own = _of_cells(likelihood, cells, turns >= 0, pattern)
    roots = np.empty(n, np.int32)
    kernels.groups(links, cells, turns, roots)
    # Evidence beyond chance: a map could lie at any place of the sheet, under any of four turns.
    beyond = np.bincount(roots, own, n)[roots] - np.log(4.0 * max((pattern.colours >= 0).sum(), 1))
    sure = (turns >= 0) & (beyond > rules.map_evidence)
    # Where most of what is mapped is sure, the image shows this garment, and less evidence is needed for the rest.
    recognised = 2 * sure.sum() > (turns >= 0).sum()
    cells[(turns < 0) | (beyond <= (rules.map_evidence_supported if recognised else rules.map_evidence))] = -1
    # Two circles at one cell: at most one is right, and nothing here tells which.
    twice = _twice(cells, pattern.shape)
    cells[twice] = -1
    odds = _odds(circles, likelihood, own, pattern, rules, cells)
    apart, stretch = _apart_from_neighbours(circles.moments, cells, pattern.shape)
    odds -= rules.unlike * apart + rules.slanted * np.maximum(stretch - rules.slant, 0.0) ** 2
    # A circle that is covered or has run into another one has its centre in the wrong place, however sure its cell is.
    given = (odds > rules.odds) & (apart < rules.alike)
    given &= _beside_another(np.where(given[:, None], cells, -1), pattern.shape)
    grid = np.where(given[:, None], cells, -1).astype(np.int32)
    ids = np.where(given, pattern.ids[cells[:, 0], cells[:, 1]], -1).astype(np.int32)
    # No certainty beyond what was measured on images with known truth.
    doubt = _at_most(rules.validated_count, rules.validated_wrong) + np.exp(-np.clip(odds, 0.0, 30.0))
    return Identified(ids, grid, np.where(given, 1.0 / (1.0 + doubt), 0.0), apart, windows, existing, int(twice.sum()))


def _carry_on(
    links: NDArray[np.int32],
    read: NDArray[np.int64],
    likelihood: Floats,
    pattern: Pattern,
    rules: ReadRules,
    cells: NDArray[np.int32],
    turns: NDArray[np.int32],
) -> None:
    """From blocks (cells and turns, changed in place) to the circles that are linked with three blocks side by side, and to patches."""
    n = len(read)
    roots, queue = np.empty(n, np.int32), np.empty(n, np.int32)
    kernels.groups(links, cells, turns, roots)
    size = np.bincount(roots[turns >= 0], minlength=n)[roots]
    # A block alone is in the pattern by chance once in ten times; blocks side by side that agree are not.
    turns[(turns >= 0) & (size < _BLOCKS)] = -1
    blocks = np.flatnonzero(turns >= 0)
    # The largest groups are carried on first, so that their cells are not taken by smaller ones.
    order = blocks[np.argsort(-size[blocks], kind="stable")].astype(np.int32)
    kernels.spread(links, pattern.colours, likelihood, order, cells, turns, queue)
    # Patches between a seam and a rim hold no whole blocks, so their colours are laid over the sheet.
    placed = np.empty(n, np.int32)
    count = place_patches(links, read, pattern.colours, rules.patch, rules.misses, cells, turns, placed, queue)
    kernels.spread(links, pattern.colours, likelihood, placed[:count], cells, turns, queue)


def _of_cells(likelihood: Floats, cells: NDArray[np.int32], there: NDArray[np.bool_], pattern: Pattern) -> Floats:
    """(n,) nats, evidence that the colour of a circle's cell is its own; 0 where it has no cell."""
    own = np.zeros(len(cells))
    own[there] = likelihood[there, pattern.colours[cells[there, 0], cells[there, 1]]]
    return own


def _odds(circles: Circles, likelihood: Floats, own: Floats, pattern: Pattern, rules: ReadRules, cells: NDArray[np.int32]) -> Floats:
    """(n,) log odds that circles are at their cells, -inf where they have none or lie far off it; cells (n, 2) grow in place."""
    n, centres = len(cells), circles.centres
    at, fits = np.empty(pattern.shape, np.int32), own > 0
    # Circles are sorted into buckets, so that the search for neighbours at a place does not grow with the image.
    growth.occupy(cells, at)
    height, width = circles.grey.shape
    heads, following = np.empty((int(height / _SIDE) + 1, int(width / _SIDE) + 1), np.int32), np.empty(n, np.int32)
    growth.bucket_circles(centres, _SIDE, heads, following)
    growth.grow(centres, likelihood, pattern.colours, heads, following, _SIDE, rules.gate, cells, at, fits, np.empty(n, np.int32))
    there = cells[:, 0] >= 0
    own = _of_cells(likelihood, cells, there, pattern)
    # The pieces of evidence, each by its own kernel; cells are complete from here on.
    rival, bump, around, off = np.empty(n), np.empty(n), np.empty((n, 2)), np.empty((n, 3))
    growth.rivals(centres, pattern.colours, heads, following, _SIDE, cells, at, fits, rival)
    weigh.evidence(at, fits, cells, own, _RADIUS, around)
    weigh.smoothness(centres, at, fits, cells, off)
    weigh.bumps(*circles.levels, centres, at, fits, cells, circles.rises(*rules.bump, rules.cloth_noise), bump)
    slant = np.empty(n)
    weigh.slants(centres, circles.moments, at, fits, cells, slant)
    predictors = {
        "constant": np.ones(n),
        "weakest side": np.clip(around[:, 1], -10, 14),
        "around": np.clip(around[:, 0], -10, 50) / 3,
        "mean offset": np.log(np.clip(off[:, 0], 0.02, 2)),
        "largest offset": np.log(np.clip(off[:, 1], 0.1, 3)),
        "rival distance": rival,
        "squares": off[:, 2],
        "own": np.clip(own, -5, 1.4),
        "bump": np.clip(bump, 0, 0.5),
    }
    squares, near = off[:, 2], np.isfinite(off[:, 0]) & (off[:, 1] < rules.astray)
    # The fewer squares a circle closes, the more else it has to show.
    inner = squares > rules.end.squares
    end = (slant < rules.end.slant) & (bump < rules.end.bump) & (own > rules.end.own)
    corner = end & (slant < rules.corner.slant) & (bump < rules.corner.bump) & (rival > rules.corner.rival)
    held = inner | (end & (squares > rules.corner.squares)) | (corner & (squares > 0))
    return np.where(there & near & held, np.column_stack(list(predictors.values())) @ np.array(rules.weights), -np.inf)


def _beside_another(cells: NDArray[np.int32], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """(n,) circles one of whose up to eight neighbours has a cell, too: what all around it is doubted for speaks against it."""
    taken = np.zeros((shape[0] + 2, shape[1] + 2), np.int64)
    there = cells[:, 0] >= 0
    row, col = cells[there].T + 1
    taken[row, col] = 1
    out = np.zeros(len(cells), np.bool_)
    out[there] = sum(taken[row + r, col + c] for r in (-1, 0, 1) for c in (-1, 0, 1)) > 1
    return out


def _apart_from_neighbours(moments: Floats, cells: NDArray[np.int32], shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """(n,) how far the logarithm of each circle's area is from that of its neighbours (the median of up to eight), and its ellipse's shape.

    A circle that something covers in part is smaller than its neighbours, and one that has run into another is larger; both have their
    centres in the wrong place. The cloth around a circle is seen as aslant as the circle: another slant is another thing. The shape is
    the logarithm of the ratio of axes, over what pixels alone make of it.
    """
    area, at, usual = np.sqrt(np.linalg.det(moments)), np.empty(shape, np.int32), np.empty(len(cells))
    growth.occupy(cells, at)
    weigh.usual_areas(area, cells, at, usual)
    # Without neighbours of known area nothing is unusual.
    out = np.zeros(len(area))
    known = np.isfinite(usual)
    out[known] = np.abs(np.log(area[known] / usual[known]))
    stretch = np.empty(len(cells))
    weigh.stretches(moments, cells, at, stretch)
    # Pixels change the axes of a small circle more; folds bend the cloth between circles of any size.
    shorter = 4.0 * np.sqrt(ellipse_axes(moments)[0][:, 1])
    return out, stretch / (_FOLDS + 1.0 / shorter)


def _at_most(count: int, wrong: int) -> float:
    """The share of wrong ones that is possible where so many of a count were, with 95 % probability: 3 / count where none was (Poisson)."""
    return min(1.0, float(chdtri(2 * (wrong + 1), 1 - _LEVEL)) / 2 / max(count, 1))


def _twice(cells: NDArray[np.int32], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """(n,) circles whose cell another circle has, too: at most one of them is right."""
    # Circles without a cell share place 0 here and are masked again below.
    there = cells[:, 0] >= 0
    flat = np.where(there, cells[:, 0] * shape[1] + cells[:, 1], 0)
    count = np.bincount(flat[there], minlength=shape[0] * shape[1])
    return np.asarray(there & (count[flat] > 1))
