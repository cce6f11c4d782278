"""Identified 2D points in, and where the objects stood by linear means out: what a bundle adjustment starts from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.cameras.bundle import _kernels
from asterism.cameras.camera import Camera
from asterism.errors import AsterismError
from asterism.recording import Floats, Ints

Bools = NDArray[np.bool_]

PARAMETERS = ("turn x", "turn y", "turn z", "shift x", "shift y", "shift z", "focal", "aspect", "cx", "cy", "k1", "k2", "k3", "p1", "p2")
"""A camera's parameters in an adjustment: a turn (rad) and a shift (m) of its axes, fx (px), fy / fx, principal point (px), lens."""


@dataclass(frozen=True)
class Sightings:
    """Points of an object that cameras saw: one row each, sorted by frame.

    frame, camera, point  (n,) int: which frame's object, which camera, which point of the template
    xy                    (n, 2) px, all finite
    """

    frame: Ints
    camera: Ints
    point: Ints
    xy: Floats

    @classmethod
    def of(cls, frame: ArrayLike, camera: ArrayLike, point: ArrayLike, xy: ArrayLike) -> Sightings:
        """Sightings in any order; rows with a missing position are left out. Raises AsterismError where lengths differ."""
        f, c, p = (np.asarray(part, dtype=np.int64).ravel() for part in (frame, camera, point))
        places = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
        if not len(f) == len(c) == len(p) == len(places):
            raise AsterismError(
                f"{len(f)} frames, {len(c)} cameras, {len(p)} points, {len(places)} positions; give one of each per sighting."
            )
        kept = np.nonzero(np.isfinite(places).all(axis=1))[0]
        order = kept[np.lexsort((p[kept], c[kept], f[kept]))]
        return cls(f[order], c[order], p[order], np.ascontiguousarray(places[order]))

    @classmethod
    def from_array(cls, xy: ArrayLike) -> Sightings:
        """From (T, C, K, 2) px: point k of the object as camera c saw it in frame t, NaN where it did not."""
        dense = np.asarray(xy, dtype=np.float64)
        seen = np.nonzero(np.isfinite(dense).all(axis=3))
        frame, camera, point = (part.astype(np.int64) for part in seen)
        return cls(frame, camera, point, np.ascontiguousarray(dense[seen]))

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, which: ArrayLike) -> Sightings:
        """The sightings of a mask (n,) bool or of ascending places."""
        at = np.asarray(which)
        return replace(self, frame=self.frame[at], camera=self.camera[at], point=self.point[at], xy=self.xy[at])

    def compact(self) -> tuple[Sightings, Ints]:
        """The same with frames counted without holes, and the frame (m,) that each number now stands for."""
        frames, number = np.unique(self.frame, return_inverse=True)
        return replace(self, frame=number.astype(np.int64).ravel()), frames

    def among(self, cameras: Sequence[Camera | None]) -> Sightings:
        """The same with cameras counted without those that are None; sightings of these belong to camera -1."""
        there = np.array([camera is not None for camera in cameras])
        return replace(self, camera=np.where(there, np.cumsum(there) - 1, -1)[self.camera])


def triangulate(cameras: Sequence[Camera], sightings: Sightings, frames: int, points: int) -> Floats:
    """Each point of each frame where the rays of the cameras that see it come nearest: (frames, points, 3) m.

    NaN where fewer than two cameras see it or their rays are parallel. Linear: the distances to the rays are weighed alike.
    """
    rays = np.empty((len(sightings), 3))
    origins = np.empty((len(sightings), 3))
    for c, camera in enumerate(cameras):
        own = sightings.camera == c
        rays[own], origins[own] = camera.rays(sightings.xy[own]), camera.position
    cell = sightings.frame * points + sightings.point
    order = np.argsort(cell, kind="stable")
    starts = np.searchsorted(cell[order], np.arange(frames * points + 1))
    out = np.empty((frames * points, 3))
    _kernels.intersect_rays(origins[order], rays[order], starts, out)
    return out.reshape(frames, points, 3)


def place_objects(template: ArrayLike, positions: Floats) -> tuple[Floats, Floats]:
    """The rigid placement of a template (K, 3) m nearest to its points in each frame, (T, K, 3) m with NaN for missing ones.

    Returns rotations (T, 3, 3) and translations (T, 3) m, world from object; NaN where too few points are there (two for points in a
    line, three otherwise). Least squares over rotations by SVD (Kabsch 1976).
    """
    model = np.asarray(template, dtype=np.float64).reshape(-1, 3)
    there: Bools = np.asarray(np.isfinite(positions).all(axis=2))
    n = np.maximum(there.sum(axis=1), 1)[:, None]
    filled = np.where(there[:, :, None], positions, 0.0)
    mean = filled.sum(axis=1) / n
    model_mean = (there[:, :, None] * model).sum(axis=1) / n
    centred = np.where(there[:, :, None], model[None] - model_mean[:, None], 0.0)
    matrices = np.einsum("tki,tkj->tij", np.where(there[:, :, None], filled - mean[:, None], 0.0), centred)
    u, _, vt = np.linalg.svd(matrices)
    sign = np.linalg.det(u @ vt)
    u[:, :, 2] *= sign[:, None]
    rotations = u @ vt
    translations = mean - np.einsum("tij,tj->ti", rotations, model_mean)
    rank = np.linalg.matrix_rank(model - model.mean(axis=0), tol=1e-9)
    lost = there.sum(axis=1) < min(rank + 1, 3)
    rotations[lost], translations[lost] = np.nan, np.nan
    return rotations, translations
