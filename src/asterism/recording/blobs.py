"""Blobs: bright spots in the images of synchronised cameras, in pixels, without identity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.errors import AsterismError
from asterism.recording.arrays import Floats, Ints, check_offsets, checked_rate, frame_rows
from asterism.recording.display import Rows, as_html, as_text, duration, listed


@dataclass(frozen=True, repr=False)
class Blobs:
    """2D points per frame and camera, in one flat array.

    xy       (P, 2) px, OpenCV's axes: the centre of the top left pixel is (0, 0), x to the right, y down; all finite
    offsets  (T * C + 1,) int: frame t of camera c has xy[offsets[t * C + c]:offsets[t * C + c + 1]]
    cameras  (C,) camera names
    rate     frames per second
    sizes    (P,) px, diameter of each blob, NaN where unknown
    times    (T, C) s, when each camera took each frame, NaN where it took none; None where all cameras are triggered together
    first_frame  the number that the file gives frame 0
    """

    xy: Floats
    offsets: Ints
    cameras: tuple[str, ...]
    rate: float
    sizes: Floats
    times: Floats | None = None
    first_frame: int = 0

    def __post_init__(self) -> None:
        check_offsets(self.offsets, len(self.xy), "blobs")

    @classmethod
    def from_rows(
        cls,
        frame: ArrayLike,
        camera: ArrayLike,
        xy: ArrayLike,
        cameras: Sequence[str],
        *,
        rate: float = 100.0,
        sizes: ArrayLike | None = None,
        frames: int | None = None,
        times: ArrayLike | None = None,
    ) -> Blobs:
        """Blobs from one row per blob, in any order; blobs of one camera and frame keep their order.

        frame (P,) int from 0, camera (P,) int place in `cameras`, xy (P, 2) px, sizes (P,) px; frames: their number (T),
        by default up to the last one with a blob; times (T, C) s. Raises AsterismError where shapes differ, a number is out of range or
        a position is not finite.
        """
        frame, camera = np.asarray(frame, dtype=np.int64).ravel(), np.asarray(camera, dtype=np.int64).ravel()
        xy = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
        sizes = np.full(len(xy), np.nan) if sizes is None else np.asarray(sizes, dtype=np.float64).ravel()
        if not len(frame) == len(camera) == len(xy) == len(sizes):
            raise AsterismError(f"{len(frame)} frame numbers, {len(camera)} cameras, {len(xy)} positions; give one of each per blob.")
        if not cameras or len(set(cameras)) < len(cameras):
            raise AsterismError(f"cameras are named {', '.join(cameras) or '(none)'}; give each camera another name.")
        if not np.isfinite(xy).all():
            row = int(np.argmax(~np.isfinite(xy).all(axis=1)))
            raise AsterismError(f"frame {frame[row]}, camera {camera[row]}: a blob's position is NaN or infinite; leave it out.")
        if len(camera) and (camera.min() < 0 or camera.max() >= len(cameras)):
            raise AsterismError(f"a blob belongs to camera number {int(camera.max())}, but there are {len(cameras)} cameras; count from 0.")
        total = int(frame.max(initial=-1)) + 1 if frames is None else frames
        if len(frame) and (frame.min() < 0 or frame.max() >= total):
            raise AsterismError(f"frame numbers run from {frame.min()} to {frame.max()}, expected 0 to {total - 1}; renumber them.")
        when = None if times is None else np.asarray(times, dtype=np.float64)
        if when is not None and when.shape != (total, len(cameras)):
            raise AsterismError(f"times have shape {when.shape}, expected ({total}, {len(cameras)}): frames, cameras.")
        cell = frame * len(cameras) + camera
        # Stable: blobs of one image keep the order in which they were detected.
        order = np.argsort(cell, kind="stable")
        offsets = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=total * len(cameras)))]).astype(np.int64)
        return cls(np.ascontiguousarray(xy[order]), offsets, tuple(cameras), checked_rate(rate), sizes[order], when)

    def __len__(self) -> int:
        return (len(self.offsets) - 1) // len(self.cameras)

    def select(self, kept: NDArray[np.bool_]) -> Blobs:
        # Offsets of what is kept: how many were kept before each place.
        """Some of the blobs: those that `kept` (P,) marks. All frames and cameras stay, also those without a blob."""
        before = np.concatenate([[0], np.cumsum(kept)])
        return replace(self, xy=self.xy[kept], offsets=before[self.offsets].astype(np.int64), sizes=self.sizes[kept])

    def select_cameras(self, cameras: Sequence[str]) -> Blobs:
        """The blobs of these cameras, in this order. Raises AsterismError where a name is absent."""
        absent = [name for name in cameras if name not in self.cameras]
        if absent or not cameras:
            raise AsterismError(f"there is no camera {absent[0] if absent else '(none)'}; the blobs are of {', '.join(self.cameras)}.")
        at = np.array([self.cameras.index(name) for name in cameras], dtype=np.int64)
        return self._cells(np.arange(len(self)), at)

    def frames(self, which: slice | ArrayLike) -> Blobs:
        """Some of the frames, in the order given: a slice, frame numbers or a mask (T,). `first_frame` follows the first."""
        chosen = np.arange(len(self))[which if isinstance(which, slice) else np.asarray(which)]
        some = self._cells(chosen, np.arange(len(self.cameras)))
        return replace(some, first_frame=self.first_frame + int(chosen[0]) if len(chosen) else self.first_frame)

    def _cells(self, frames: Ints, cameras: Ints) -> Blobs:
        rows, offsets = frame_rows(self.offsets, (frames[:, None] * len(self.cameras) + cameras).ravel())
        return replace(
            self,
            xy=self.xy[rows],
            offsets=offsets,
            cameras=tuple(self.cameras[camera] for camera in cameras),
            sizes=self.sizes[rows],
            times=None if self.times is None else self.times[np.ix_(frames, cameras)],
        )

    def _facts(self) -> Rows:
        return (
            ("frames", duration(len(self), self.rate)),
            ("first frame", str(self.first_frame) if self.first_frame else ""),
            ("cameras", listed(self.cameras)),
            ("blobs", str(len(self.xy))),
        )

    def __repr__(self) -> str:
        return as_text("Blobs", self._facts())

    def _repr_html_(self) -> str:
        return as_html("Blobs", self._facts())

    def of(self, frame: int, camera: int) -> Floats:
        """The blobs of one camera in one frame, (N, 2) px."""
        if not (0 <= frame < len(self) and 0 <= camera < len(self.cameras)):
            raise IndexError(f"frame {frame} of {len(self)}, camera {camera} of {len(self.cameras)}")
        cell = frame * len(self.cameras) + camera
        return self.xy[self.offsets[cell] : self.offsets[cell + 1]]

    @property
    def counts(self) -> Ints:
        """(T, C) blobs per frame and camera."""
        return np.diff(self.offsets).reshape(len(self), len(self.cameras))

    @property
    def frame_of(self) -> Ints:
        """(P,) the frame of each blob."""
        return np.repeat(np.arange(len(self)), self.counts.sum(axis=1))

    @property
    def camera_of(self) -> Ints:
        """(P,) the camera of each blob, its place in `cameras`."""
        return np.repeat(np.tile(np.arange(len(self.cameras)), len(self)), self.counts.ravel())
