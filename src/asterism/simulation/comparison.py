"""What was reconstructed and the truth in; how far apart they are out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.geometry import fit_rigid
from asterism.recording import NULL, Clouds, Floats, Ints


@dataclass(frozen=True)
class RigErrors:
    """A rig against the true one, camera by camera, after the worlds are aligned by rotation and translation, without a scale.

    position   (C,) m
    direction  (C,) rad, between the lines of sight
    focal      (C,) share, of fx
    world      (m, rad): translation and rotation between the worlds
    """

    position: Floats
    direction: Floats
    focal: Floats
    world: tuple[float, float]


@dataclass(frozen=True)
class PointErrors:
    """Reconstructed points against the true markers.

    truth   (T, M) int: the point of its frame's cloud that is each marker, -1 where none is near; a point is one marker's only
    error   (T, M) m, its distance from the truth, NaN where there is none
    wanted  (T, M) bool: the markers that should have been found
    ghosts  how many points belong to no marker, seen or not
    points  how many points there are
    """

    truth: Ints
    error: Floats
    wanted: NDArray[np.bool_]
    ghosts: int
    points: int

    def found(self, within: float) -> float:
        """The share of the wanted markers with a point within so many metres."""
        return float((self.error[self.wanted] <= within).mean()) if self.wanted.any() else float("nan")


def compare_rigs(rig: Rig, truth: Rig) -> RigErrors:
    """How far a rig is from the true one; cameras are paired by name. Raises AsterismError where fewer than three are in both."""
    names = [name for name in rig.names if name in truth.names]
    if len(names) < 3:
        raise AsterismError("two rigs are compared by three common cameras or more; name their cameras alike.")
    chosen, true = rig.select(names), truth.select(names)
    # Without a scale: a rig that is too small is wrong, not elsewhere.
    rotation, translation = fit_rigid(np.stack([c.position for c in chosen]), np.stack([c.position for c in true]))
    moved = chosen.moved(rotation, translation)
    # Rounding may leave a cosine a little above 1.
    turned = np.clip([a.rotation[2] @ b.rotation[2] for a, b in zip(moved, true, strict=True)], -1.0, 1.0)
    return RigErrors(
        np.array([float(np.linalg.norm(a.position - b.position)) for a, b in zip(moved, true, strict=True)]),
        np.arccos(turned),
        np.array([abs(a.focal[0] / b.focal[0] - 1.0) for a, b in zip(chosen, true, strict=True)]),
        (float(np.linalg.norm(translation)), float(np.arccos(np.clip(0.5 * (np.trace(rotation) - 1.0), -1.0, 1.0)))),
    )


def compare_points(clouds: Clouds, positions: ArrayLike, wanted: ArrayLike, reach: float = 0.01) -> PointErrors:
    """Which point is which marker, and how far off.

    positions  (T, M, 3) m, where the markers were, NaN where they were not; wanted: (T, M) bool, those that should have been found
    reach      m: a point farther from every marker is a ghost
    Nearest pairs first, each point and marker once. Raises AsterismError where the numbers of frames differ.

    >>> markers = np.array([[[0.0, 0.0, 1.0], [0.5, 0.0, 1.0]]])
    >>> found = compare_points(Clouds.from_points(markers + 0.001, rate=100.0), markers, wanted=[[True, True]])
    >>> found.truth.tolist(), found.found(within=0.003), found.ghosts
    ([[0, 1]], 1.0, 0)
    """
    markers = np.asarray(positions, dtype=np.float64)
    if len(markers) != len(clouds):
        raise AsterismError(f"{len(clouds)} frames of points, {len(markers)} of markers; give both the same.")
    truth = np.full(markers.shape[:2], NULL, dtype=np.int64)
    error = np.full(markers.shape[:2], np.nan)
    ghosts = 0
    for t, cloud in enumerate(clouds):
        distance = np.linalg.norm(markers[t][:, None] - cloud[None], axis=2)
        # A marker that is not there is infinitely far.
        distance = np.where(np.isfinite(distance), distance, np.inf)
        ghosts += int((distance.min(axis=0, initial=np.inf) > reach).sum())
        # Nearest pairs first: a greedy matching is the best one while markers are farther apart than errors.
        for index in np.argsort(distance, axis=None, kind="stable"):
            m, n = divmod(int(index), len(cloud))
            if distance[m, n] > reach:
                break
            if truth[t, m] == NULL and n not in truth[t]:
                truth[t, m], error[t, m] = n, distance[m, n]
    return PointErrors(truth, error, np.asarray(wanted, dtype=np.bool_), ghosts, len(clouds.xyz))
