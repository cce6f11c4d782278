"""An adjusted board in; how far its points lie from where they should be on it, out: whether it is flat."""

from __future__ import annotations

import numpy as np

from asterism.cameras.accuracy._kernels import image_slopes
from asterism.cameras.bundle import Adjustment, Sightings
from asterism.recording import Floats

_GROSS_PX, _BEYOND_NOISE = 5.0, 2.0


def bend_of(points: Floats, seen: Sightings, adjusted: Adjustment) -> float:
    """How far a board's points (K, 3) m lie from where they should be, RMS as a share of its longer side; 0 where noise explains it.

    Each point is moved on the board by least squares until it fits its sightings, cameras and boards held; of the mean square, what noise
    makes is taken off. Poses and lenses hide a part of the bend: it is not less than is said.
    """
    left = adjusted.residuals
    slopes = np.full((len(seen), 2, 3), np.nan)
    for c, camera in enumerate(adjusted.cameras):
        own = np.nonzero(seen.camera == c)[0]
        turned, placed = adjusted.rotations[seen.frame[own]], adjusted.translations[seen.frame[own]]
        there = np.einsum("nij,nj->ni", turned, points[seen.point[own]]) + placed
        by_world = np.empty((len(own), 2, 3))
        image_slopes(camera.lens, camera.rotation, camera.translation, there, by_world)
        slopes[own] = by_world @ turned
    good = np.linalg.norm(left, axis=1) < _GROSS_PX
    left, slopes, point = left[good], slopes[good], seen.point[good]
    told, wanted = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    np.add.at(told, point, slopes.swapaxes(1, 2) @ slopes)
    np.add.at(wanted, point, np.einsum("nij,ni->nj", slopes, left))
    known = np.linalg.matrix_rank(told) == 3
    if not known.any():
        return 0.0
    spread = np.linalg.inv(told[known])
    moved = np.einsum("kij,kj->ki", spread, wanted[known])
    noise = float((left**2).mean() * np.trace(spread, axis1=1, axis2=2).mean())
    beyond = float((moved**2).sum(axis=1).mean()) - noise
    return float(np.sqrt(beyond) / np.ptp(points, axis=0).max()) if beyond > _BEYOND_NOISE**2 * noise else 0.0
