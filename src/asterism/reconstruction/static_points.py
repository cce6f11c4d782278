"""A reconstruction in; the points that never move out: reflections, lamps, markers that rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.detection.static_lights import still_lights
from asterism.reconstruction.result import Reconstruction
from asterism.recording import Floats

_STILL = 0.4
"""The share of the frames that a light must stay for, and a point."""
_FRAMES = 400
_RADIUS = 0.02


@dataclass(frozen=True)
class StillPoint:
    """A point that blobs make which never move in their images.

    place    (3,) m, the median of where it was
    share    of the frames that have it
    cameras  how many cameras show it, mostly
    """

    place: Floats
    share: float
    cameras: int


def still_points(result: Reconstruction) -> tuple[StillPoint, ...]:
    """Points all of whose blobs stay at one place of their image in two of five frames, if as many frames have them.

    Those of most frames first. Nobody can tell a resting marker from a lamp, but where there are many cameras a point that two of them
    show is mostly two reflections that have nothing to do with each other. Looks at 400 frames, evenly spread; needs 50.
    """
    lit, lights = still_lights(result.blobs, _STILL)
    if not lights.any():
        return ()
    frames = np.unique(np.linspace(0, len(result.clouds) - 1, min(_FRAMES, len(result.clouds))).astype(np.int64))
    frame_of = np.repeat(np.arange(len(result.clouds)), result.clouds.counts)
    still = np.flatnonzero((lit[result.rays] | ~result.cameras).all(axis=1) & np.isin(frame_of, frames))
    found = []
    while len(still):
        near = np.linalg.norm(result.clouds.xyz[still] - result.clouds.xyz[still[0]], axis=1) < _RADIUS + 6 * result.deviation[still[0]]
        share = len(np.unique(frame_of[still[near]])) / len(frames)
        if share >= _STILL:
            place = np.median(result.clouds.xyz[still[near]], axis=0)
            found.append(StillPoint(place, share, int(np.median(result.cameras[still[near]].sum(axis=1)))))
        still = still[~near]
    return tuple(sorted(found, key=lambda point: -point.share))
