"""A reconstruction in; the points that never move out: reflections, lamps, markers that rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.detection.static_lights import find_static_lights
from asterism.reconstruction.result import Reconstruction
from asterism.recording import Floats

_SHARE = 0.4
"""The share of the frames in which a light must stay at its place, and a point."""
_FRAMES = 400
"""Frames that are looked at."""
_RADIUS = 0.02
"""m, around a static point in which others are taken to be the same, besides six standard deviations."""


@dataclass(frozen=True)
class StaticPoint:
    """A point whose blobs never move in their images.

    position  (3,) m, the median over time
    share     of the frames that have it
    cameras   how many cameras show it, in the median
    """

    position: Floats
    share: float
    cameras: int


def find_static_points(result: Reconstruction) -> tuple[StaticPoint, ...]:
    """Points all of whose blobs stay at one place of their image in two of five frames, if as many frames have them.

    Those of most frames come first. A resting marker cannot be told from a lamp. But where there are many cameras, a point that two of them
    show is mostly two unrelated reflections. Looks at 400 frames, evenly spread; needs 50.
    """
    lit, lights = find_static_lights(result.blobs, _SHARE)
    if not lights.any():
        return ()
    frames = np.unique(np.linspace(0, len(result.clouds) - 1, min(_FRAMES, len(result.clouds))).astype(np.int64))
    frame_of = result.clouds.frame_of
    left = np.flatnonzero((lit[result.rays] | ~result.cameras).all(axis=1) & np.isin(frame_of, frames))
    found = []
    while len(left):
        near = np.linalg.norm(result.clouds.xyz[left] - result.clouds.xyz[left[0]], axis=1) < _RADIUS + 6 * result.deviation[left[0]]
        share = len(np.unique(frame_of[left[near]])) / len(frames)
        if share >= _SHARE:
            position = np.median(result.clouds.xyz[left[near]], axis=0)
            found.append(StaticPoint(position, share, int(np.median(result.cameras[left[near]].sum(axis=1)))))
        left = left[~near]
    return tuple(sorted(found, key=lambda point: -point.share))
