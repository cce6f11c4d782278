"""Which images show the wand in; which frames to work with out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from asterism.cameras.camera import Camera
from asterism.recording import Blobs, Ints

Bools = NDArray[np.bool_]


def widest(cameras: Iterable[Camera | None]) -> int:
    """px, the greatest width of the images of the cameras that are posed."""
    return max((camera.size or (1280, 1024))[0] for camera in cameras if camera is not None)


def shown(chosen: Ints) -> Bools:
    """(T, C) which images show the whole wand."""
    return np.asarray((chosen >= 0).all(axis=2))


def shared_frames(chosen: Ints) -> Ints:
    """(C, C) how many frames show the wand to both of two cameras."""
    seen = shown(chosen).astype(np.int64)
    return np.asarray(seen.T @ seen)


def spread_frames(seen: Bools, most: int) -> Ints:
    """Some frames (m,), ascending: of each camera that sees something in (T, C) about equally many, evenly spread, no more than `most`."""
    useful = np.nonzero(seen.sum(axis=1) >= 2)[0]
    if len(useful) <= most:
        return useful
    picked = np.zeros(len(seen), dtype=bool)
    share = most // seen.shape[1]
    for own in seen[useful].T:
        at = useful[own]
        picked[at[np.unique(np.linspace(0, len(at) - 1, min(share, len(at))).astype(np.int64))] if len(at) else at] = True
    rest = useful[~picked[useful]]
    room = most - int(picked.sum())
    if room > 0 and len(rest):
        picked[rest[np.unique(np.linspace(0, len(rest) - 1, min(room, len(rest))).astype(np.int64))]] = True
    return np.nonzero(picked)[0]


def some_frames(blobs: Blobs, chosen: Ints, frames: Ints) -> tuple[Blobs, Ints]:
    """The blobs of some frames (m,) only, and what `identify` chose there."""
    cells = (frames[:, None] * len(blobs.cameras) + np.arange(len(blobs.cameras))).ravel()
    counts = np.diff(blobs.offsets)[cells]
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    shift = blobs.offsets[cells] - offsets[:-1]
    at = np.repeat(shift, counts) + np.arange(offsets[-1])
    picked = chosen[frames] - shift.reshape(len(frames), -1)[:, :, None]
    few = replace(blobs, xy=blobs.xy[at], sizes=blobs.sizes[at], offsets=offsets, times=None)
    return few, np.where(chosen[frames] >= 0, picked, -1)
