"""Circles in; which of them are neighbours on the cloth out, by local affine frames (GaMoCap 2.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from asterism.garment.read import _lattice_kernels as kernels
from asterism.garment.read.circles import Circles
from asterism.garment.read.rules import ReadRules
from asterism.recording import Floats

_MOST = 20
"""Candidates around a circle: eight are its neighbours."""
_ROUNDS = 2


def link_circles(circles: Circles, diameter: float, rules: ReadRules) -> tuple[NDArray[np.int32], Floats]:
    """Links (n, 4, 2) of circles and their lattice vectors (n, 2, 2) px, one in each column.

    diameter  of a circle, in pitches

    A circle's ellipse says how its surroundings are seen, up to a turn: there neighbours are one pitch away at right angles. Two neighbours
    that explain the others best are its lattice vectors. Then each takes part of its vectors from the circles that it is linked with, which
    carries the lattice to circles at a border. links[i, d] is the neighbour in direction d (0 to 3, a quarter turn clockwise each, in the
    circle's own frame) and the direction that leads from it back; -1, -1 where two circles are not each other's neighbour, as at a fold.
    """
    n = len(circles.centres)
    found, offsets = np.full((n, _MOST), -1, np.int32), np.zeros((n, _MOST, 2))
    frames, scores, links = np.full((n, 2, 2), np.nan), np.empty(n), np.full((n, 4, 2), -1, np.int32)
    if n == 0:
        return links, frames
    # The ellipse undone: in these units the pitch is 1 and right angles are right again.
    whiten = 0.25 * diameter * _inverse_root(circles.moments)
    # Buckets hold a few circles each, whatever their size in the image.
    side = max(4.0, 2.0 / diameter * 2.0 * float(np.sqrt(np.median(np.trace(circles.moments, axis1=1, axis2=2)))))
    kernels.candidates(circles.centres, whiten, rules.reach, side, found, offsets)
    kernels.first_frames(found, offsets, whiten, np.array(rules.side), rules.square, rules.fit, frames, scores)
    ends, rise = np.array(rules.length), circles.rises(rules.rise, rules.rise_noise * circles.noise, rules.cloth_noise)
    ahead, checked = np.empty((n, 4), np.int32), np.full((n, 4), -1, np.int32)
    # Neighbours correct each other's vectors, and corrected vectors find more neighbours; two rounds reach the borders.
    for _ in range(_ROUNDS):
        kernels.link(circles.centres, found, frames, rules.fit, ahead, links)
        kernels.cut_skipping(*circles.levels, circles.centres, whiten, ends, rise, checked, links)
        refined = np.empty_like(frames)
        kernels.refine_frames(circles.centres, found, links, frames, rules.fit, refined)
        frames = refined
    kernels.link(circles.centres, found, frames, rules.fit, ahead, links)
    kernels.cut_skipping(*circles.levels, circles.centres, whiten, ends, rise, checked, links)
    return links, frames


def _inverse_root(matrices: Floats) -> Floats:
    """The inverse square roots of symmetric positive matrices (n, 2, 2), in closed form by trace and determinant."""
    det = np.sqrt(matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] ** 2)
    whole = np.sqrt(matrices[:, 0, 0] + matrices[:, 1, 1] + 2 * det)
    root = (matrices + det[:, None, None] * np.eye(2)) / whole[:, None, None]
    turned = np.stack([root[:, 1, 1], -root[:, 0, 1], -root[:, 1, 0], root[:, 0, 0]], axis=1).reshape(-1, 2, 2)
    return np.asarray(turned / det[:, None, None])
