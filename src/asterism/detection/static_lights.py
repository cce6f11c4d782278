"""Blobs in; the same without lights that never move, such as reflections and lamps, out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from asterism.recording.arrays import Floats, Ints
from asterism.recording.blobs import Blobs

_SHARE = 0.4
"""The share of a camera's images that show anything in which a static light is seen: people walk before lamps."""
_CROWDED = 0.1
"""A cell of the grid is looked at where it has blobs in this share of these images."""
_RADIUS = 3.0
"""px, around a static light in which blobs belong to it; also the side of the grid's cells."""
_FEWEST_IMAGES = 50


def without_static_lights(blobs: Blobs, share: float = _SHARE) -> tuple[Blobs, Ints]:
    """The blobs without those that stay at one place of an image in such a share of its frames; how many such places each camera has (C,).

    Whatever rests for so long is left out: also a wand that lies still, whose frames say nothing new.
    """
    lit, lights = find_static_lights(blobs, share)
    return (blobs.select(~lit) if lights.any() else blobs), lights


def find_static_lights(blobs: Blobs, share: float = _SHARE) -> tuple[NDArray[np.bool_], Ints]:
    """Which blobs (P,) lie where something stays in such a share of the camera's frames, and how many such places each camera has (C,).

    Cameras with fewer than 50 frames that show anything are not looked at.
    """
    frame, camera = blobs.frame_of, blobs.camera_of
    lit = np.zeros(len(blobs.xy), dtype=np.bool_)
    lights = np.zeros(len(blobs.cameras), dtype=np.int64)
    for c in range(len(blobs.cameras)):
        rows = np.nonzero(camera == c)[0]
        images = len(np.unique(frame[rows]))
        if images < _FEWEST_IMAGES:
            continue
        xy = blobs.xy[rows]
        for place in _crowded(xy, _CROWDED * images):
            near = ~lit[rows] & (np.linalg.norm(xy - place, axis=1) < _RADIUS)
            if len(np.unique(frame[rows[near]])) > share * images:
                lit[rows[near]] = True
                lights[c] += 1
    return lit, lights


def _crowded(xy: Floats, least: float) -> Floats:
    """The medians (m, 2) px of what lies in cells of a grid that hold more than `least` of the places (n, 2), fullest first."""
    _, cell_of, count = np.unique(np.floor(xy / _RADIUS).astype(np.int64), axis=0, return_inverse=True, return_counts=True)
    full = np.nonzero(count > least)[0]
    full = full[np.argsort(-count[full], kind="stable")]
    return np.array([np.median(xy[cell_of.ravel() == cell], axis=0) for cell in full]).reshape(-1, 2)
