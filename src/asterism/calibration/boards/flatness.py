"""An adjusted board in; how far its points lie from where they should be on it, out: whether it is flat."""

from __future__ import annotations

import numpy as np

from asterism.cameras.accuracy.jacobian_kernels import pixel_jacobians
from asterism.cameras.bundle import Adjustment, Sightings
from asterism.recording import Floats

_GROSS_PX, _BEYOND_NOISE = 5.0, 2.0


def bend_of(points: Floats, seen: Sightings, adjusted: Adjustment) -> float:
    """How far a board's points (K, 3) m lie from where they should be, RMS as a share of its longer side; 0 where noise explains it.

    Each point is moved on the board by least squares until it fits its sightings, cameras and boards held; of the mean square, what noise
    makes is taken off. Poses and lenses hide a part of the bend: it is not less than is said.
    """
    left = adjusted.residuals
    jacobians = np.full((len(seen), 2, 3), np.nan)
    for c, camera in enumerate(adjusted.cameras):
        own = np.nonzero(seen.camera == c)[0]
        turned, placed = adjusted.rotations[seen.frame[own]], adjusted.translations[seen.frame[own]]
        there = np.einsum("nij,nj->ni", turned, points[seen.point[own]]) + placed
        by_world = np.empty((len(own), 2, 3))
        pixel_jacobians(camera.lens, camera.rotation, camera.translation, there, by_world)
        jacobians[own] = by_world @ turned
    good = np.linalg.norm(left, axis=1) < _GROSS_PX
    left, jacobians, point = left[good], jacobians[good], seen.point[good]
    information, wanted = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    np.add.at(information, point, jacobians.swapaxes(1, 2) @ jacobians)
    np.add.at(wanted, point, np.einsum("nij,ni->nj", jacobians, left))
    known = np.linalg.matrix_rank(information) == 3
    if not known.any():
        return 0.0
    spread = np.linalg.inv(information[known])
    moved = np.einsum("kij,kj->ki", spread, wanted[known])
    noise = float((left**2).mean() * np.trace(spread, axis1=1, axis2=2).mean())
    beyond = float((moved**2).sum(axis=1).mean()) - noise
    return float(np.sqrt(beyond) / np.ptp(points, axis=0).max()) if beyond > _BEYOND_NOISE**2 * noise else 0.0
