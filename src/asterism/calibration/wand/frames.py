"""Which images show the wand in; which frames to work with out."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from asterism.cameras.camera import Camera
from asterism.recording import Ints

Bools = NDArray[np.bool_]


def widest_image(cameras: Iterable[Camera | None]) -> int:
    """px, the greatest width of the images of the cameras that are posed."""
    return max((camera.size or (1280, 1024))[0] for camera in cameras if camera is not None)


def evenly(frames: Ints, most: int) -> Ints:
    """At most so many of the frames (n,), evenly spread."""
    return frames[np.unique(np.linspace(0, len(frames) - 1, min(most, len(frames))).astype(np.int64))]


def spread_frames(seen: Bools, most: int) -> Ints:
    """Some frames (m,), ascending: of each camera that sees something in (T, C) about equally many, evenly spread, no more than `most`."""
    useful = np.nonzero(seen.sum(axis=1) >= 2)[0]
    if len(useful) <= most:
        return useful
    picked = np.zeros(len(seen), dtype=bool)
    share = most // seen.shape[1]
    for own in seen[useful].T:
        at = useful[own]
        picked[evenly(at, share) if len(at) else at] = True
    rest = useful[~picked[useful]]
    room = most - int(picked.sum())
    if room > 0 and len(rest):
        picked[evenly(rest, room)] = True
    return np.nonzero(picked)[0]
