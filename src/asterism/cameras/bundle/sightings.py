"""Identified 2D points in, and where the objects stood by linear means out: what a bundle adjustment starts from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.cameras.camera import Camera
from asterism.errors import AsterismError
from asterism.geometry import intersect_rays
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
    return intersect_rays(origins[order], rays[order], starts).reshape(frames, points, 3)
