"""Posed cameras and their images of a wand in; the images with each camera's lag of whole frames taken out, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from asterism.cameras.bundle import Sightings
from asterism.cameras.camera import Camera
from asterism.cameras.wand.clock import lags, shifted
from asterism.cameras.wand.identify import Agreed, Wand, agree
from asterism.cameras.wand.start import adjust_some
from asterism.recording import Blobs, Floats, Ints

_REACH = 0.012
"""How far blobs may be off where a camera looks at another moment, in widths of the image."""
_LATE, _ROUNDS = 0.35, 4


def in_step(
    blobs: Blobs, chosen: Ints, wand: Wand, cameras: list[Camera | None], lenses: Sequence[Camera | None]
) -> tuple[Blobs, Ints, list[Camera | None], Ints]:
    """Move the images of cameras that run some frames late or early, the latest first, until all look at the same wand."""
    late = np.zeros(len(cameras), dtype=np.int64)
    posed = [c for c, camera in enumerate(cameras) if camera is not None]
    place = np.full(len(cameras), -1)
    place[posed] = np.arange(len(posed))
    for _ in range(_ROUNDS * len(posed)):
        width = max((camera.size or (1280, 0))[0] for camera in cameras if camera is not None)
        agreed = agree(blobs, chosen, wand, cameras, _REACH * width)
        result = adjust_some(blobs, agreed, wand, cameras, lenses, ("pose", "focal", "k1", "k2"), 2.0, 60)
        if result is None:
            break
        found = list(cameras)
        for c, camera in zip(posed, result.cameras, strict=True):
            found[c] = camera
        seen, residuals = _missed(blobs, agree(blobs, chosen, wand, found, _REACH * width), wand, list(result.cameras), place)
        by, spread = lags(seen, residuals, len(posed))
        by = by - np.nanmedian(by) if np.isfinite(by).any() else by
        sure = np.isfinite(by) & (np.abs(by) > _LATE) & (np.abs(by) > 5.0 * spread)
        if not sure.any():
            break
        cameras = found
        worst = int(np.nanargmax(np.where(sure, np.abs(by), np.nan)))
        move = np.zeros(len(cameras), dtype=np.int64)
        move[posed[worst]] = int(np.rint(by[worst])) or int(np.sign(by[worst]))
        late += move
        blobs, chosen = shifted(blobs, chosen, move)
    return blobs, chosen, cameras, late


def _missed(blobs: Blobs, agreed: Agreed, wand: Wand, cameras: Sequence[Camera], place: Ints) -> tuple[Sightings, Floats]:
    """All sightings and how far the wand, where the cameras agree on it, is from them."""
    seen = agreed.sightings(blobs)
    world = agreed.starts[seen.frame] + wand.lengths[seen.point][:, None] * agreed.directions[seen.frame]
    seen = replace(seen, camera=place[seen.camera])
    projected = np.full((len(seen), 2), np.nan)
    for c, camera in enumerate(cameras):
        own = seen.camera == c
        projected[own] = camera.project(world[own])
    return seen, seen.xy - projected
