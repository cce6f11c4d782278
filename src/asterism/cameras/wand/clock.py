"""Cameras that do not look at the same moments: their wand carried to a common clock, and lags found that nobody told."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from asterism.cameras.bundle import Sightings
from asterism.errors import AsterismError
from asterism.recording import Blobs, Floats, Ints

_LONGEST_STEP = 1.6
"""Frames: nothing is interpolated across a longer hole."""


def common_clock(blobs: Blobs, chosen: Ints) -> tuple[Blobs, Ints]:
    """The wand's blobs carried to the moments at which the cameras looked on average; `blobs.times` says when each did.

    Each marker's path in each image is interpolated by Akima's piecewise cubics, which a single wrong blob disturbs only next to it.
    Blobs are known here, which `recording.to_common_clock` cannot count on: nothing is taken for another marker. What the images do
    not take for the wand is left out. Raises AsterismError where times do not increase or cameras share no time.
    """
    if blobs.times is None:
        return blobs, chosen
    times = blobs.times
    for c, name in enumerate(blobs.cameras):
        steps = np.diff(times[np.isfinite(times[:, c]), c])
        if len(steps) and steps.min() <= 0.0:
            raise AsterismError(f"camera {name}: its times do not increase from frame to frame; sort its rows by time.")
    clock = _clock(times)
    step = float(np.median(np.diff(clock))) if len(clock) > 1 else 1.0 / blobs.rate
    if max((float(np.nanmin(own)) for own in times.T if np.isfinite(own).any()), default=0.0) > float(clock[-1]):
        raise AsterismError("the cameras' times do not overlap; were they recorded together, and in seconds?")
    if np.nanmax(np.abs(times - clock[:, None])) < 1e-3 * step:
        return blobs, chosen
    rows: list[tuple[Ints, Ints, Floats]] = []
    markers = chosen.shape[2]
    picked = np.full((len(clock), len(blobs.cameras), markers), -1, dtype=np.int64)
    for c in range(len(blobs.cameras)):
        own = np.nonzero((chosen[:, c] >= 0).all(axis=1) & np.isfinite(times[:, c]))[0]
        if len(own) < 5:
            continue
        paths = _one_way(blobs.xy[chosen[own, c]])
        at = times[own, c]
        after = np.clip(np.searchsorted(at, clock), 1, len(at) - 1)
        inside = (clock >= at[0]) & (clock <= at[-1]) & (at[after] - at[after - 1] <= _LONGEST_STEP * step)
        frames = np.nonzero(inside)[0]
        xy = Akima1DInterpolator(at, paths.reshape(len(own), -1))(clock[frames]).reshape(-1, markers, 2)
        rows.append((np.repeat(frames, markers), np.full(len(frames) * markers, c), xy.reshape(-1, 2)))
        picked[frames, c] = np.arange(markers)
    if not rows:
        raise AsterismError("no camera shows the wand often enough to carry it to a common clock; wave it longer.")
    frame, camera, xy = (np.concatenate(part) for part in zip(*rows, strict=True))
    moved = Blobs.from_rows(frame, camera, xy, blobs.cameras, rate=1.0 / step, frames=len(clock))
    first = moved.offsets[:-1].reshape(len(clock), -1)
    return moved, np.where(picked >= 0, picked + first[:, :, None], -1)


def _clock(times: Floats) -> Floats:
    """(T,) s, one moment per frame: the mean over the cameras, holes bridged."""
    known = np.isfinite(times)
    mean = np.where(known, times, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    complete = np.nonzero(known.all(axis=1))[0]
    if len(complete) < 2:
        raise AsterismError("fewer than two frames have a time for every camera; give each row its time, or leave out the column.")
    return np.interp(np.arange(len(times)), complete, mean[complete], left=np.nan, right=np.nan)[complete[0] : complete[-1] + 1]


def _one_way(paths: Floats) -> Floats:
    """Images (n, K, 2) of a wand with either order of its markers, so that it does not flip from frame to frame."""
    if paths.shape[1] == 1:
        return paths
    along = paths[:, -1] - paths[:, 0]
    turned = np.cumprod(np.concatenate([[1.0], np.where((along[1:] * along[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)])) < 0.0
    return np.where(turned[:, None, None], paths[:, ::-1], paths)


def shifted(blobs: Blobs, chosen: Ints, late: Ints) -> tuple[Blobs, Ints]:
    """The same with each camera's frames counted from `late` (C,) frames later; what falls off the ends is lost."""
    frames = len(blobs)
    frame, camera = blobs.frame_of + late[blobs.camera_of], blobs.camera_of
    kept = (frame >= 0) & (frame < frames)
    order = np.nonzero(kept)[0][np.argsort((frame * len(blobs.cameras) + camera)[kept], kind="stable")]
    place = np.full(len(blobs.xy) + 1, -1, dtype=np.int64)
    place[order] = np.arange(len(order))
    moved = Blobs.from_rows(
        frame[order], camera[order], blobs.xy[order], blobs.cameras, rate=blobs.rate, sizes=blobs.sizes[order], frames=frames
    )
    there = place[chosen]
    there[(there < 0).any(axis=2)] = -1
    picked = np.full_like(chosen, -1)
    for c, by in enumerate(late):
        first, last = max(0, -int(by)), min(frames, frames - int(by))
        if first < last:
            picked[first + by : last + by, c] = there[first:last, c]
    return moved, picked


def lags(sightings: Sightings, residuals: Floats, cameras: int) -> tuple[Floats, Floats]:
    """By how many frames each camera is late (C,), and the standard deviation of that: residuals along the way that its images move.

    sightings of neighbouring frames are needed, else NaN. A camera that is late by d frames sees where things were d frames later: its
    residuals are d times the images' velocity.
    """
    late, spread = np.full(cameras, np.nan), np.full(cameras, np.nan)
    key = (sightings.camera * (sightings.point.max(initial=0) + 1) + sightings.point) * (
        sightings.frame.max(initial=0) + 3
    ) + sightings.frame
    order = np.argsort(key)
    ordered = key[order]
    before, after = (np.searchsorted(ordered, key + by) for by in (-1, 1))
    last = len(key) - 1
    both = (ordered[np.minimum(before, last)] == key - 1) & (ordered[np.minimum(after, last)] == key + 1)
    velocity = 0.5 * (sightings.xy[order[np.minimum(after, last)]] - sightings.xy[order[np.minimum(before, last)]])
    for c in range(cameras):
        own = both & (sightings.camera == c) & np.isfinite(residuals[:, 0])
        if own.sum() < 30:
            continue
        v, r = velocity[own], residuals[own]
        weight = np.ones(len(v))
        for _ in range(10):
            power = float((weight[:, None] * v * v).sum())
            if power <= 0.0:
                break
            by = float((weight[:, None] * v * r).sum()) / power
            miss = np.linalg.norm(r - by * v, axis=1)
            weight = 1.0 / (1.0 + np.square(miss / max(2.0 * float(np.median(miss)), 1e-6)))
            late[c], spread[c] = by, float(np.median(miss)) / np.sqrt(power)
    return late, spread
