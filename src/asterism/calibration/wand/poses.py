"""Posed cameras and their blobs in; where the wand lay in each frame, and which blobs show it, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.calibration.wand import _kernels
from asterism.calibration.wand.identify import Wand
from asterism.cameras.bundle import Sightings
from asterism.cameras.camera import Camera
from asterism.recording import Blobs, Floats, Ints


@dataclass(frozen=True)
class WandPoses:
    """Where posed cameras agree that the wand lay.

    starts, directions  (T, 3) m: its first marker and its unit direction; NaN where no two cameras agree
    observations        (T, C, K) int: the blobs on it, rows of blobs.xy; -1 where there is no blob
    """

    starts: Floats
    directions: Floats
    observations: Ints

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(T, C) which cameras have a blob on the wand."""
        return np.asarray((self.observations >= 0).any(axis=2))

    def sightings(self, blobs: Blobs, frames: ArrayLike | None = None) -> Sightings:
        """The blobs on the wand as sightings, of some frames only (mask or places) where given; frames keep their numbers.

        Frames that do not constrain the cameras are left out: those with one camera, or with too few coordinates for a wand.
        """
        keep = np.zeros(len(self.observations), dtype=bool)
        keep[slice(None) if frames is None else np.asarray(frames)] = True
        there = self.observations >= 0
        markers = there.shape[2]
        shared = there.any(axis=2).sum(axis=1)
        coordinates = 2 * there.sum(axis=(1, 2))
        keep &= (shared >= 2) & (coordinates > (3 if markers == 1 else 5)) & np.isfinite(self.starts[:, 0])
        if markers > 1:
            keep &= (there.sum(axis=1) > 0).sum(axis=1) > 1
        frame, camera, point = np.nonzero(there & keep[:, None, None])
        return Sightings.of(frame, camera, point, blobs.xy[self.observations[frame, camera, point]])

    def markers(self, wand: Wand, frames: Ints) -> Floats:
        """(n, K, 3) m, where the wand's markers were in some frames (n,); NaN where it is not known."""
        return np.asarray(self.starts[frames, None] + wand.lengths[None, :, None] * self.directions[frames, None])

    def placements(self) -> tuple[Floats, Floats]:
        """Rotations (T, 3, 3) and translations (T, 3) m of the wand, as a bundle adjustment takes them; NaN where it is not known."""
        x = self.directions
        aside = np.where(np.abs(x[:, :1]) < 0.7, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
        y = np.cross(x, aside)
        y /= np.linalg.norm(y, axis=1, keepdims=True)
        return np.stack([x, y, np.cross(x, y)], axis=2), self.starts


def locate_wand(blobs: Blobs, detections: Ints, wand: Wand, cameras: Sequence[Camera | None], gate: ArrayLike) -> WandPoses:
    """Where the wand lay in each frame by what posed cameras agree on, and all blobs within `gate` px of it.

    detections  (T, C, K) of `identify`; gate: px, one for all cameras or (C,)

    Cameras that are None are not posed yet.
    """
    frames, markers = len(blobs), len(wand.lengths)
    posed = np.array([camera is not None for camera in cameras])
    radial = max([3, *(len(camera.radial) for camera in cameras if camera is not None)])
    lens = np.zeros((len(cameras), 9 + radial))
    lens[:, :2] = 1.0
    rotation, translation = np.tile(np.eye(3), (len(cameras), 1, 1)), np.zeros((len(cameras), 3))
    origins, rays = np.zeros((len(cameras), 3)), np.full((len(blobs.xy), 3), np.nan)
    owner = blobs.camera_of
    for c, camera in enumerate(cameras):
        if camera is not None:
            lens[c, : len(camera.lens)] = camera.lens
            rotation[c], translation[c], origins[c] = camera.rotation, camera.translation, camera.position
            rays[owner == c] = camera.rays(blobs.xy[owner == c])
    starts, directions = np.empty((frames, 3)), np.empty((frames, 3))
    gates = np.full(len(cameras), np.asarray(gate, dtype=np.float64))
    observations, support = np.empty((frames, len(cameras), markers), dtype=np.int64), np.empty(frames)
    places = _kernels.WandPlaces(starts, directions, observations, support)
    images = _kernels.WandImages(blobs.xy, rays, blobs.offsets, detections)
    posed_cameras = _kernels.WandCameras(lens, rotation, translation, origins, posed, gates)
    _kernels.locate_wand(images, posed_cameras, wand.lengths, wand.symmetric, places)
    return WandPoses(starts, directions, observations)
