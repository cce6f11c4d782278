"""Cameras and what they saw in; points in the world out, each by itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from asterism.cameras.bundle.adjust import AdjustSettings, adjust
from asterism.cameras.bundle.sightings import Sightings, triangulate
from asterism.cameras.camera import Camera
from asterism.recording import Floats

FAR = 1e3
"""px: nothing is treated as an outlier."""


def locate(cameras: Sequence[Camera], sightings: Sightings, frames: int, markers: int) -> Floats:
    """Each marker by itself where its images put it, by least squares of reprojection errors: (frames, markers, 3) m.

    NaN where fewer than two cameras saw it. What a recording later does with any marker; the wand's lengths are not used.
    """
    single = Sightings.of(sightings.frame * markers + sightings.point, sightings.camera, np.zeros(len(sightings), int), sightings.xy)
    rough = triangulate(cameras, single, frames * markers, 1)[:, 0]
    there = np.asarray(np.isfinite(rough).all(axis=1))
    seen, kept = single.select(there[single.frame]).compact()
    if len(seen):
        turned = np.tile(np.eye(3), (len(kept), 1, 1))
        free = np.zeros((len(cameras), 15), dtype=bool)
        settings = AdjustSettings(scale=FAR, covariance=False)
        rough[kept] = adjust(cameras, np.zeros((1, 3)), seen, turned, rough[kept], free=free, settings=settings).translations
    return rough.reshape(frames, markers, 3)
