"""A waved wand as the cameras saw it: blobs, which of them single images take for the wand, and what is known of the lenses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.calibration.wand.identify import Wand
from asterism.calibration.wand.poses import WandPoses, locate_wand
from asterism.cameras.camera import Camera
from asterism.errors import AsterismError
from asterism.recording import Blobs, Floats, Ints
from asterism.synchronization.known_paths import check_times, mean_clock, resample_path, shift_frames

Bools = NDArray[np.bool_]

_SAME_CLOCK = 1e-3
"""Frame periods: cameras whose times differ by less are triggered together."""


@dataclass(frozen=True)
class WandRecording:
    """A waved wand as C cameras saw it in T frames.

    blobs       all that they saw
    detections  (T, C, K) int: the wand's markers by single images, rows of blobs.xy; -1 where an image shows no wand for certain
    wand        what was waved, K markers
    lenses      (C,) cameras whose lens is known, None where it is not
    sizes       (C,) px, width and height of the images
    """

    blobs: Blobs
    detections: Ints
    wand: Wand
    lenses: tuple[Camera | None, ...]
    sizes: tuple[tuple[int, int], ...]

    def __len__(self) -> int:
        return len(self.blobs)

    @property
    def shows_wand(self) -> Bools:
        """(T, C) which images show the whole wand."""
        return shows_wand(self.detections)

    @property
    def shared_frames(self) -> Ints:
        """(C, C) how many frames show the wand to both of two cameras."""
        seen = self.shows_wand.astype(np.int64)
        return np.asarray(seen.T @ seen)

    def images(self, frames: Ints, camera: int) -> Floats:
        """(n, K, 2) px, the wand in some frames (n,) of a camera that show it whole."""
        return self.blobs.xy[self.detections[frames, camera]]

    def locate(self, cameras: Sequence[Camera | None], gate: ArrayLike) -> WandPoses:
        """Where the wand lay by these posed cameras, see `locate_wand`."""
        return locate_wand(self.blobs, self.detections, self.wand, cameras, gate)

    def select(self, frames: Ints) -> WandRecording:
        """Some frames (n,) only, without times."""
        detections = self.detections[frames]
        cells = (frames[:, None] * len(self.blobs.cameras) + np.arange(len(self.blobs.cameras))).ravel()
        some = replace(self.blobs.frames(frames), times=None, first_frame=0)
        moved_by = (self.blobs.offsets[cells] - some.offsets[:-1]).reshape(len(frames), -1)
        return replace(self, blobs=some, detections=np.where(detections >= 0, detections - moved_by[:, :, None], -1))

    def shifted(self, lag_frames: Ints) -> WandRecording:
        """Each camera's frames counted from `lag_frames` (C,) frames later; what is shifted beyond the ends is left out."""
        moved, row = shift_frames(self.blobs, lag_frames)
        rows = np.append(row, -1)[self.detections]
        rows[(rows < 0).any(axis=2)] = -1
        detections, frames = np.full_like(self.detections, -1), len(self)
        for c, lag in enumerate(lag_frames.tolist()):
            first, last = max(0, -lag), min(frames, frames - lag)
            if first < last:
                detections[first + lag : last + lag, c] = rows[first:last, c]
        return replace(self, blobs=moved, detections=detections)

    def on_common_clock(self) -> WandRecording:
        """The wand's markers at the instants at which the cameras took their images on average; `blobs.times` says when each did.

        Markers are identified here, unlike in `synchronization.to_common_clock`: none is taken for another. Blobs that images do not take
        for the wand are left out. Raises AsterismError where times are missing or do not increase, or cameras share no time.
        """
        blobs, times = self.blobs, self.blobs.times
        if times is None:
            return self
        check_times(blobs)
        for c, name in enumerate(blobs.cameras):
            if blobs.counts[:, c].any() and not np.isfinite(times[:, c]).any():
                raise AsterismError(f"camera {name}: its rows have no times; give each its time, or leave out the column.")
        clock = mean_clock(times)
        period = float(np.median(np.diff(clock)))
        if max((float(np.nanmin(own)) for own in times.T if np.isfinite(own).any()), default=0.0) > float(clock[-1]):
            raise AsterismError("the cameras' times do not overlap; check that they were recorded together, and that times are in seconds.")
        if np.nanmax(np.abs(times - clock[:, None])) < _SAME_CLOCK * period:
            return self
        return self._resampled(times, clock, period)

    def _resampled(self, times: Floats, clock: Floats, period: float) -> WandRecording:
        rows: list[tuple[Ints, Ints, Floats]] = []
        markers = len(self.wand)
        detections = np.full((len(clock), len(self.blobs.cameras), markers), -1, dtype=np.int64)
        shows = self.shows_wand
        for c in range(len(self.blobs.cameras)):
            own = np.nonzero(shows[:, c] & np.isfinite(times[:, c]))[0]
            images = self.images(own, c)
            if self.wand.symmetric:
                images = _without_flips(images)
            frames, path = resample_path(times[own, c], images.reshape(len(own), -1), clock, period)
            if len(frames):
                rows.append((np.repeat(frames, markers), np.full(len(frames) * markers, c), path.reshape(-1, 2)))
                detections[frames, c] = np.arange(markers)
        if not rows:
            raise AsterismError("no camera shows the wand often enough to interpolate it to a common clock; wave it longer.")
        frame, camera, xy = (np.concatenate(part) for part in zip(*rows, strict=True))
        moved = Blobs.from_rows(frame, camera, xy, self.blobs.cameras, rate=1.0 / period, frames=len(clock))
        first = moved.offsets[:-1].reshape(len(clock), -1)
        return replace(self, blobs=moved, detections=np.where(detections >= 0, detections + first[:, :, None], -1))


def shows_wand(detections: Ints) -> Bools:
    """(T, C) which images show the whole wand, by detections (T, C, K)."""
    return np.asarray((detections >= 0).all(axis=2))


def _without_flips(images: Floats) -> Floats:
    """Images (n, K, 2) of a symmetric wand with its markers ordered so that it does not flip from frame to frame."""
    if images.shape[1] == 1:
        return images
    along = images[:, -1] - images[:, 0]
    turned = np.cumprod(np.concatenate([[1.0], np.where((along[1:] * along[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)])) < 0.0
    return np.where(turned[:, None, None], images[:, ::-1], images)
