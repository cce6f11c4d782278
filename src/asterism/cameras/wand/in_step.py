"""Posed cameras and their images of a wand in; the images with each camera's lag of whole frames taken out, out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from asterism.cameras.bundle import Sightings
from asterism.cameras.camera import Camera
from asterism.cameras.wand.clock import lags, shifted
from asterism.cameras.wand.frames import shown, widest
from asterism.cameras.wand.identify import Agreed, Wand, agree
from asterism.cameras.wand.pair import FEWEST, guessed
from asterism.cameras.wand.start import adjust_some, resect, resected
from asterism.recording import Blobs, Floats, Ints

_REACH = 0.012
"""How far blobs may be off where a camera looks at another moment, in widths of the image."""
_LATE, _ROUNDS = 0.35, 4
_FARTHEST, _STRIDE = 120, 2
"""Frames: how far cameras that do not fit at all are moved, and in which steps."""


def in_step(
    blobs: Blobs,
    chosen: Ints,
    wand: Wand,
    cameras: list[Camera | None],
    lenses: Sequence[Camera | None],
    sizes: Sequence[tuple[int, int]],
) -> tuple[Blobs, Ints, list[Camera | None], Ints]:
    """Move the images of cameras that run some frames late or early, the latest first, until all look at the same wand."""
    late = _far_behind(blobs, chosen, wand, cameras, lenses, sizes)
    blobs, chosen = shifted(blobs, chosen, late) if late.any() else (blobs, chosen)
    cameras = _posed_again(blobs, chosen, wand, cameras, lenses, sizes, late)
    posed = [c for c, camera in enumerate(cameras) if camera is not None]
    for _ in range(_ROUNDS * len(posed)):
        width = widest(cameras)
        agreed = agree(blobs, chosen, wand, cameras, _REACH * width)
        result = adjust_some(blobs, agreed, wand, cameras, lenses, ("pose", "focal", "k1", "k2"), 2.0, 60)
        if result is None:
            break
        found = list(cameras)
        for c, camera in zip(posed, result.cameras, strict=True):
            found[c] = camera
        seen, residuals = _missed(blobs, agree(blobs, chosen, wand, found, _REACH * width), wand, found)
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


def _far_behind(
    blobs: Blobs,
    chosen: Ints,
    wand: Wand,
    cameras: Sequence[Camera | None],
    lenses: Sequence[Camera | None],
    sizes: Sequence[tuple[int, int]],
) -> Ints:
    """(C,) by how many frames cameras that could not be posed are late: with that lag they see the wand where the others say; else 0."""
    late = np.zeros(len(cameras), dtype=np.int64)
    others = [camera for camera in cameras if camera is not None and camera.size is not None]
    agreed = agree(blobs, chosen, wand, cameras, _REACH * widest(others))
    focal = float(np.median([camera.focal[0] / (camera.size or (1280, 0))[0] for camera in others]))
    for c in range(len(cameras)):
        frames = np.nonzero(shown(chosen)[:, c])[0]
        if cameras[c] is not None or len(frames) < FEWEST:
            continue
        size = sizes[c]
        best = (0.4, 0)
        for lag in range(-_FARTHEST, _FARTHEST + 1, _STRIDE):
            at = frames[(frames + lag >= 0) & (frames + lag < len(blobs))]
            at = at[np.isfinite(agreed.starts[at + lag, 0])]
            if len(at) < FEWEST:
                continue
            at = at[np.unique(np.linspace(0, len(at) - 1, 60).astype(np.int64))]
            world = agreed.starts[at + lag, None] + wand.lengths[None, :, None] * agreed.directions[at + lag, None]
            xy = blobs.xy[chosen[at, c]]
            if wand.either:
                world, xy = world.mean(axis=1, keepdims=True), xy.mean(axis=1, keepdims=True)
            guess = lenses[c] or guessed(blobs.cameras[c], size, focal * size[0])
            share = resect(world.reshape(-1, 3), xy.reshape(-1, 2), blobs.cameras[c], size, guess)[1]
            best = max(best, (share, lag))
        late[c] = best[1]
    return late


def _posed_again(
    blobs: Blobs,
    chosen: Ints,
    wand: Wand,
    cameras: list[Camera | None],
    lenses: Sequence[Camera | None],
    sizes: Sequence[tuple[int, int]],
    late: Ints,
) -> list[Camera | None]:
    """The cameras, those posed too whose lag is known now."""
    if not late.any():
        return cameras
    width = widest(cameras)
    agreed = agree(blobs, chosen, wand, cameras, _REACH * width)
    again = [resected(blobs, chosen, agreed, wand, c, sizes[c], lenses[c]) if late[c] else None for c in range(len(late))]
    for c in np.nonzero(late)[0]:
        late[c] = late[c] if again[c] is not None else 0
    return [camera or other for camera, other in zip(cameras, again, strict=True)]


def _missed(blobs: Blobs, agreed: Agreed, wand: Wand, cameras: Sequence[Camera | None]) -> tuple[Sightings, Floats]:
    """All sightings, by posed cameras, and how far the wand, where the cameras agree on it, is from them."""
    seen = agreed.sightings(blobs)
    world = agreed.starts[seen.frame] + wand.lengths[seen.point][:, None] * agreed.directions[seen.frame]
    seen = seen.among(cameras)
    projected = np.full((len(seen), 2), np.nan)
    for c, camera in enumerate(camera for camera in cameras if camera is not None):
        own = seen.camera == c
        projected[own] = camera.project(world[own])
    return seen, seen.xy - projected
