"""Posed cameras and their images of a wand in; the images with each camera's lag taken out, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.calibration.wand.clock import common_clock, lags, shifted
from asterism.calibration.wand.frames import shown, widest
from asterism.calibration.wand.identify import Wand, agree
from asterism.calibration.wand.initialise import adjust_some, resect, resected
from asterism.calibration.wand.two_view import FEWEST, guessed
from asterism.cameras.camera import Camera
from asterism.recording import Blobs, Floats, Ints

_REACH = 0.012
"""How far blobs may be off where a camera looks at another moment, in widths of the image."""
_LEAST, _LEFT, _ROUNDS = 0.08, 0.008, 12
"""Frames: lags smaller than this are let be, and what may be left of larger ones. Rounds of moving images and adjusting cameras to them."""
_LEAST_DRIFT, _ECHO = 0.2, 0.3
"""Frames between the first and the last third; a camera that drifts makes the others seem to, by up to this share of it."""
_FARTHEST, _STRIDE = 120, 2
"""Frames: how far cameras that do not fit at all are moved, and in which steps."""


@dataclass(frozen=True)
class Clocks:
    """By how many frames each camera (C,) was late.

    late   whole frames
    rest   the part of a frame that is left
    drift  by how many frames more in the last third of the recording than in the first; 0 where nothing speaks for it
    """

    late: Ints
    rest: Floats
    drift: Floats

    def of(self, cameras: Ints) -> Clocks:
        """Those of some cameras only."""
        return Clocks(self.late[cameras], self.rest[cameras], self.drift[cameras])


def in_step(
    blobs: Blobs,
    chosen: Ints,
    wand: Wand,
    cameras: list[Camera | None],
    lenses: Sequence[Camera | None],
    sizes: Sequence[tuple[int, int]],
) -> tuple[Blobs, Ints, list[Camera | None], Clocks]:
    """Move the images of cameras that run late or early, by whole frames, then by what is left, until all look at the same wand.

    Returns the blobs and what images take for the wand, moved; the cameras; and how late each was.
    """
    late = _far_behind(blobs, chosen, wand, cameras, lenses, sizes)
    blobs, chosen = shifted(blobs, chosen, late) if late.any() else (blobs, chosen)
    cameras = _posed_again(blobs, chosen, wand, cameras, lenses, sizes, late)
    posed = np.array([c for c, camera in enumerate(cameras) if camera is not None])
    rest, drift = np.zeros(len(cameras)), np.zeros(len(cameras))
    whole_frames = blobs, chosen
    for _ in range(_ROUNDS):
        gate = _REACH * widest(cameras)
        agreed = agree(blobs, chosen, wand, cameras, gate)
        made = adjust_some(blobs, agreed, wand, cameras, lenses, ("pose", "focal", "k1", "k2"), 0.5 * gate, 60)
        if made is None:
            break
        result = made[0]
        found = list(cameras)
        for c, camera in zip(posed, result.cameras, strict=True):
            found[c] = camera
        agreed = agree(blobs, chosen, wand, found, gate)
        seen = agreed.sightings(blobs).among(found)
        least = np.where(rest[posed] != 0.0, _LEFT, _LEAST)
        by = _sure(*lags(result.cameras, wand, seen, agreed.starts, agreed.directions), least)
        if not by.any():
            first, last = (
                lags(result.cameras, wand, seen.select(part), agreed.starts, agreed.directions)
                for part in (3 * seen.frame < len(blobs), 3 * seen.frame >= 2 * len(blobs))
            )
            drift[posed] = _sure(last[0] - first[0], np.hypot(first[1], last[1]), _LEAST_DRIFT)
            drift[np.abs(drift) < _ECHO * np.abs(drift).max()] = 0.0
            break
        cameras = found
        rest[posed] += by
        whole = np.rint(rest).astype(np.int64)
        if whole.any():
            late, rest = late + whole, np.zeros(len(cameras))
            whole_frames = shifted(*whole_frames, whole)
        blobs, chosen = whole_frames
        if rest.any():
            blobs, chosen = common_clock(replace(blobs, times=(np.arange(len(blobs))[:, None] + rest) / blobs.rate), chosen, wand)
    return blobs, chosen, cameras, Clocks(late, rest, drift)


def _sure(by: Floats, spread: Floats, least: Floats | float) -> Floats:
    """Lags (C,), 0 where they are unknown, smaller than what matters, or not certain."""
    return np.where(np.isfinite(by) & (np.abs(by) > np.maximum(least, 6.0 * spread)), by, 0.0)


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
            world, xy = agreed.markers(wand, at + lag), blobs.xy[chosen[at, c]]
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
