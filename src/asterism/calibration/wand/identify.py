"""Blobs in; which of them single images take for the wand out, and where the wand lies by what posed cameras agree on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.calibration.wand import _kernels
from asterism.cameras.bundle import Sightings
from asterism.cameras.camera import Camera
from asterism.errors import AsterismError
from asterism.recording import Blobs, Floats, Ints

DEPTH_RATIO = 1.7
"""One end of a wand is at most this many times as far from a camera as the other."""
SHORTEST = 14.0
SLACK, BEND = 1.2, 0.02
_LONGEST = 4.0
"""m, longer than which no wand is."""
LIKE_ITS_MIRROR = 0.12
"""Wands whose middle marker is nearer than this share of their length to the middle look alike from both ends, in perspective."""


@dataclass(frozen=True)
class Wand:
    """Markers in a line.

    lengths  (K,) m, ascending from 0: where each marker sits; one marker is a single moved dot
    either   whether images leave open which end is which
    """

    lengths: Floats
    either: bool

    @property
    def template(self) -> Floats:
        """(K, 3) m, along x."""
        return np.column_stack([self.lengths, np.zeros((len(self.lengths), 2))])


def wand_of(lengths: ArrayLike) -> Wand:
    """A wand by its markers' places along it, m, in any order. Raises AsterismError for what no wand is: millimetres, four markers."""
    along = np.asarray(lengths, dtype=np.float64).ravel()
    told = " ".join(f"{length:g}" for length in along)
    if not 1 <= len(along) <= 3 or not np.isfinite(along).all():
        raise AsterismError(f"the wand {told} has {len(along)} markers; give the places of one, two or three in a line, such as 0 0.2 0.6.")
    along = np.sort(along - along.min())
    whole = along[-1]
    if len(along) > 1 and np.diff(along).min() <= 0.0:
        raise AsterismError(f"two markers of the wand {told} are at one place; give each its place along the wand in metres.")
    if whole > _LONGEST:
        sure = whole > 80.0
        mend = " ".join(f"{length / (1000.0 if sure else 100.0):g}" for length in along)
        raise AsterismError(
            f"a wand of {whole:g} m is no wand: the lengths look like {'millimetres' if sure else 'centimetres'}; "
            f"give metres: {mend}{'' if sure else ', if they are'}."
        )
    if len(along) > 1 and whole < 0.02:
        raise AsterismError(f"a wand of {whole * 1000:g} mm is too short to calibrate with; are its lengths {told} metres?")
    either = len(along) < 3 or abs(float(along[1] / whole) - 0.5) < LIKE_ITS_MIRROR
    return Wand(along, either)


def identify(blobs: Blobs, wand: Wand) -> Ints:
    """Which blobs each image by itself shows of the wand: (T, C, K) int, places in blobs.xy, -1 where it shows none for certain.

    Three markers are found among strays by line and ratio; two or one where there are no other blobs. The order of the markers may be
    the reverse one where `wand.either` says so.
    """
    frames, cameras, markers = len(blobs), len(blobs.cameras), len(wand.lengths)
    chosen = np.full((frames * cameras, markers), -1, dtype=np.int64)
    if markers == 3:
        certain = np.zeros(len(chosen), dtype=bool)
        share = float(wand.lengths[1] / wand.lengths[2])
        _kernels.find_lines(blobs.xy, blobs.offsets, share, DEPTH_RATIO, SLACK, BEND, SHORTEST, wand.either, chosen, certain)
        chosen[~certain] = -1
    else:
        exact = np.nonzero(np.diff(blobs.offsets) == markers)[0]
        chosen[exact] = blobs.offsets[exact, None] + np.arange(markers)
        if markers == 2:
            apart = np.linalg.norm(blobs.xy[chosen[exact, 1]] - blobs.xy[chosen[exact, 0]], axis=1)
            chosen[exact[apart < SHORTEST]] = -1
    return chosen.reshape(frames, cameras, markers)


@dataclass(frozen=True)
class Agreed:
    """Where posed cameras agree that the wand lay.

    starts, directions  (T, 3) m: its first marker and its unit direction; NaN where no two cameras agree
    sights              (T, C, K) int: the blobs on it, -1 for none
    """

    starts: Floats
    directions: Floats
    sights: Ints

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(T, C) which cameras have a blob on the wand."""
        return np.asarray((self.sights >= 0).any(axis=2))

    def sightings(self, blobs: Blobs, frames: ArrayLike | None = None) -> Sightings:
        """The blobs on the wand as sightings, of some frames only (mask or places) where told; frames keep their numbers.

        Frames that tell nothing about the cameras are left out: those with one camera, or with too few coordinates for a wand.
        """
        keep = np.zeros(len(self.sights), dtype=bool)
        keep[slice(None) if frames is None else np.asarray(frames)] = True
        there = self.sights >= 0
        markers = there.shape[2]
        shared = there.any(axis=2).sum(axis=1)
        coordinates = 2 * there.sum(axis=(1, 2))
        keep &= (shared >= 2) & (coordinates > (3 if markers == 1 else 5)) & np.isfinite(self.starts[:, 0])
        if markers > 1:
            keep &= (there.sum(axis=1) > 0).sum(axis=1) > 1
        frame, camera, point = np.nonzero(there & keep[:, None, None])
        return Sightings.of(frame, camera, point, blobs.xy[self.sights[frame, camera, point]])

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


def agree(blobs: Blobs, chosen: Ints, wand: Wand, cameras: Sequence[Camera | None], gate: ArrayLike) -> Agreed:
    """Where the wand lay in each frame by what posed cameras agree on, and all blobs within `gate` px of it, for all cameras or (C,).

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
    sights, support = np.empty((frames, len(cameras), markers), dtype=np.int64), np.empty(frames)
    _kernels.agree(
        blobs.xy, rays, blobs.offsets, chosen, wand.lengths, wand.either, lens, rotation, translation, origins, posed, gates,
        starts, directions, sights, support,
    )  # fmt: skip
    return Agreed(starts, directions, sights)
