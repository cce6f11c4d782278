"""Reconstructed markers in; out come the accuracy against a wand and the repeatability of what stands still (thesis 3.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from asterism.errors import AsterismError
from asterism.recording import Floats, Ints


@dataclass(frozen=True)
class WandAccuracy:
    """Measured lengths of a wand against its true ones, m.

    frames          how many frames show the whole wand
    mean_error      the thesis' mean error: the mean of measured less true over all frames and pairs of markers; its sign is that of a
                    wrong scale
    mean_absolute   the same without signs: how far off a length is on average
    std             of measured less true, each pair about its own mean
    pairs           (Q, 2) int, the wand's markers; pair_errors (Q,) the mean error of each
    places          (L, 3) m, the middles of the cells in which the wand was seen
    place_errors    (L,) the mean absolute error in each cell; place_frames (L,) int how many frames it rests on
    """

    frames: int
    mean_error: float
    mean_absolute: float
    std: float
    pairs: Ints
    pair_errors: Floats
    places: Floats
    place_errors: Floats
    place_frames: Ints


def wand_accuracy(positions: ArrayLike, lengths: Sequence[float], cell: float = 0.5) -> WandAccuracy:
    """How exact measured distances are, over all and per place: the thesis' "mean error" (3.3).

    positions  (T, K, 3) m of the wand's markers, NaN where not seen; frames without the whole wand are left out
    lengths    (K,) m, where the markers sit along the wand
    cell       m, the size of the cells that `places` are the middles of
    Raises AsterismError where shapes do not fit or no frame shows the whole wand.
    """
    points, along = np.asarray(positions, dtype=np.float64), np.asarray(lengths, dtype=np.float64)
    if points.ndim != 3 or points.shape[1:] != (len(along), 3) or len(along) < 2:
        raise AsterismError(f"wand positions have shape {points.shape}, expected (frames, {len(along)}, 3) for {len(along)} markers.")
    points = points[np.isfinite(points).all(axis=(1, 2))]
    if not len(points):
        raise AsterismError("no frame shows the whole wand; wave it where at least two cameras see all of its markers.")
    pairs = np.array(list(combinations(range(len(along)), 2)), dtype=np.int64)
    measured = np.linalg.norm(points[:, pairs[:, 0]] - points[:, pairs[:, 1]], axis=2)
    errors = measured - np.abs(along[pairs[:, 0]] - along[pairs[:, 1]])
    cells, member, count = np.unique(np.floor(points.mean(axis=1) / cell), axis=0, return_inverse=True, return_counts=True)
    absolute = np.bincount(member.ravel(), np.abs(errors).mean(axis=1), len(cells)) / count
    return WandAccuracy(
        len(points),
        float(errors.mean()),
        float(np.abs(errors).mean()),
        float((errors - errors.mean(axis=0)).std()),
        pairs,
        errors.mean(axis=0),
        (cells + 0.5) * cell,
        absolute,
        count.astype(np.int64),
    )


def repeatability(positions: ArrayLike) -> Floats:
    """(M,) m: how far each still marker's measurements (T, M, 3) m lie from their mean, on average (thesis 3.3).

    NaN where a marker is measured less than twice. Raises AsterismError where the shape is another.
    """
    points = np.asarray(positions, dtype=np.float64)
    if points.ndim != 3 or points.shape[2] != 3:
        raise AsterismError(f"positions have shape {points.shape}, expected (frames, markers, 3).")
    out = np.full(points.shape[1], np.nan)
    for m in range(points.shape[1]):
        own = points[np.isfinite(points[:, m]).all(axis=1), m]
        if len(own) >= 2:
            out[m] = np.linalg.norm(own - own.mean(axis=0), axis=1).mean()
    return out
