"""Paths of known points and their times in; the same on a common clock, or shifted by whole frames, out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.recording import Blobs, Floats, Ints


@dataclass(frozen=True)
class PathRules:
    """Where a path is interpolated.

    longest_gap    frame periods: nothing is interpolated across a longer gap. 1.6 allows one period with jitter, never a lost image
    fewest_places  of a path; Akima's cubic between two places takes the two on each side as well

    Checked on the simulated cameras with clocks of their own of tests/test_wand.py.
    """

    longest_gap: float = 1.6
    fewest_places: int = 5


RULES = PathRules()


def check_times(blobs: Blobs) -> None:
    """Raise AsterismError where a camera's times do not increase from frame to frame. Missing times are passed over."""
    if blobs.times is None:
        return
    for c, name in enumerate(blobs.cameras):
        there = np.isfinite(blobs.times[:, c])
        known = blobs.times[there, c]
        if len(known) > 1 and np.diff(known).min() <= 0:
            frame = int(np.flatnonzero(there)[np.argmin(np.diff(known)) + 1]) + blobs.first_frame
            raise AsterismError(f"camera {name}, frame {frame}: its time is not after that of the frame before; correct the times.")


def mean_clock(times: Floats) -> Floats:
    """(T,) s, one instant per frame: the mean over the cameras' times (T, C).

    A camera whose times are missing at an end goes on there at its own rate; inside, it is interpolated.
    """
    frames = np.arange(len(times))
    every = []
    for own in times.T:
        known = np.nonzero(np.isfinite(own))[0]
        if len(known) >= 2:
            rate = (own[known[-1]] - own[known[0]]) / (known[-1] - known[0])
            # A camera that started late or stopped early keeps its rate there; left out, it would make the mean jump.
            beyond = frames - np.clip(frames, known[0], known[-1])
            every.append(np.interp(frames, known, own[known]) + rate * beyond)
    return np.asarray(np.mean(every, axis=0))


def resample_path(times: Floats, path: Floats, clock: Floats, period: float) -> tuple[Ints, Floats]:
    """The frames (m,) of a clock (T,) s inside a path's times (n,) s, and the path (n, D) there: (m, D).

    By Akima's piecewise cubics, which one wrong place disturbs only next to it. Nothing is interpolated across gaps longer than
    `PathRules.longest_gap` periods (s). No frames come back of a path of fewer than `PathRules.fewest_places` places.
    """
    if len(times) < RULES.fewest_places:
        return np.empty(0, dtype=np.int64), np.empty((0, path.shape[1]))
    from scipy.interpolate import Akima1DInterpolator

    # An instant inside a gap is asked of the two times around it, whose distance tells whether an image was lost.
    after = np.clip(np.searchsorted(times, clock), 1, len(times) - 1)
    inside = (clock >= times[0]) & (clock <= times[-1]) & (times[after] - times[after - 1] <= RULES.longest_gap * period)
    frames = np.nonzero(inside)[0]
    return frames, np.asarray(Akima1DInterpolator(times, path)(clock[frames]))


def shift_frames(blobs: Blobs, lag_frames: Ints) -> tuple[Blobs, Ints]:
    """Blobs with each camera's frames counted from `lag_frames` (C,) frames later, and the new row of each old one, -1 where it is gone.

    What is shifted beyond the ends of the recording is left out. The result has no times.
    """
    frames = len(blobs)
    frame, camera = blobs.frame_of + lag_frames[blobs.camera_of], blobs.camera_of
    kept: NDArray[np.bool_] = (frame >= 0) & (frame < frames)
    order = np.nonzero(kept)[0][np.argsort((frame * len(blobs.cameras) + camera)[kept], kind="stable")]
    row = np.full(len(blobs.xy), -1, dtype=np.int64)
    row[order] = np.arange(len(order))
    moved = Blobs.from_rows(
        frame[order], camera[order], blobs.xy[order], blobs.cameras, rate=blobs.rate, sizes=blobs.sizes[order], frames=frames
    )
    return moved, row
