"""Blobs in; the same without lights that never move, such as reflections and lamps, out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from asterism.recording.arrays import Floats, Ints
from asterism.recording.blobs import Blobs

_RADIUS = 3.0
"""px around a light that never moves in which blobs are it."""
_SHARE, _WORTH_A_LOOK = 0.4, 0.1
"""Of the images of a camera that show anything: so many show a light that never moves; one grid cell shows so many of these."""
_FEWEST_IMAGES = 50


def without_still_lights(blobs: Blobs, share: float = _SHARE) -> tuple[Blobs, Ints]:
    """The blobs without those that stay at one place of an image in such a share of its frames; how many such places each camera has (C,).

    Whatever rests for so long is left out while it does: a wand that lies still, too, whose frames tell nothing new.
    """
    lit, lights = still_lights(blobs, share)
    if not lights.any():
        return blobs, lights
    counts = np.bincount((blobs.frame_of * len(blobs.cameras) + blobs.camera_of)[~lit], minlength=blobs.counts.size)
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return replace(blobs, xy=blobs.xy[~lit], sizes=blobs.sizes[~lit], offsets=offsets), lights


def still_lights(blobs: Blobs, share: float = _SHARE) -> tuple[NDArray[np.bool_], Ints]:
    """(P,) which blobs lie where something stays in such a share of the camera's frames, and how many such places each camera has (C,).

    Cameras with fewer than 50 frames that show anything are not looked at.
    """
    frame, camera = blobs.frame_of, blobs.camera_of
    lit = np.zeros(len(blobs.xy), dtype=np.bool_)
    lights = np.zeros(len(blobs.cameras), dtype=np.int64)
    for c in range(len(blobs.cameras)):
        own = np.nonzero(camera == c)[0]
        images = len(np.unique(frame[own]))
        if images < _FEWEST_IMAGES:
            continue
        xy = blobs.xy[own]
        for place in _crowded(xy, _WORTH_A_LOOK * images):
            near = ~lit[own] & (np.linalg.norm(xy - place, axis=1) < _RADIUS)
            if len(np.unique(frame[own[near]])) > share * images:
                lit[own[near]] = True
                lights[c] += 1
    return lit, lights


def _crowded(xy: Floats, least: float) -> Floats:
    """The medians (m, 2) px of what lies in cells of a grid that hold more than `least` of the places (n, 2), fullest first."""
    _, own, count = np.unique(np.floor(xy / _RADIUS).astype(np.int64), axis=0, return_inverse=True, return_counts=True)
    full = np.nonzero(count > least)[0]
    full = full[np.argsort(-count[full], kind="stable")]
    return np.array([np.median(xy[own.ravel() == cell], axis=0) for cell in full]).reshape(-1, 2)
