"""Cameras that do not look at the same moments: their wand carried to a common clock, and lags found that nobody told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from asterism.calibration.wand.identify import Wand
from asterism.cameras.bundle import Sightings
from asterism.cameras.camera import Camera
from asterism.errors import AsterismError
from asterism.recording import Blobs, Floats, Ints

_LAG_FRAMES, _FEWEST_MOVING = 600, 30
"""Frames that lags are told from, spread over the recording, and sightings of a moving wand that each camera needs for that."""
_LONGEST_STEP = 1.6
"""Frames: nothing is interpolated across a longer hole."""


def common_clock(blobs: Blobs, chosen: Ints, wand: Wand) -> tuple[Blobs, Ints]:
    """The wand's blobs carried to the moments at which the cameras looked on average; `blobs.times` says when each did.

    Each marker's path in each image is interpolated by Akima's piecewise cubics, which a single wrong blob disturbs only next to it.
    Blobs are known here, which `recording.to_common_clock` cannot count on: nothing is taken for another marker. What the images do
    not take for the wand is left out. Raises AsterismError where times are missing or do not increase, or cameras share no time.
    """
    if blobs.times is None:
        return blobs, chosen
    times = blobs.times
    for c, name in enumerate(blobs.cameras):
        known = np.isfinite(times[:, c])
        steps = np.diff(times[known, c])
        if blobs.counts[:, c].any() and not known.any():
            raise AsterismError(f"camera {name}: its rows have no times; give each its time, or leave out the column.")
        if len(steps) and steps.min() <= 0.0:
            raise AsterismError(f"camera {name}: its times do not increase from frame to frame; sort its rows by time.")
    clock = _clock(times)
    step = float(np.median(np.diff(clock)))
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
        paths = blobs.xy[chosen[own, c]]
        if wand.either:
            paths = _one_way(paths)
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
    """(T,) s, one moment per frame: the mean over the cameras, each of which goes on at its own rate where its times (T, C) are missing."""
    frames = np.arange(len(times))
    every = []
    for own in times.T:
        known = np.nonzero(np.isfinite(own))[0]
        if len(known) >= 2:
            rate = (own[known[-1]] - own[known[0]]) / (known[-1] - known[0])
            beyond = frames - np.clip(frames, known[0], known[-1])
            every.append(np.interp(frames, known, own[known]) + rate * beyond)
    return np.asarray(np.mean(every, axis=0))


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


def lags(cameras: Sequence[Camera], wand: Wand, sightings: Sightings, starts: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """By how many frames each camera is late (C,), counted from the middle one, and the standard deviation of that; NaN where unknown.

    sightings  of neighbouring frames: each camera's images of the wand's markers; starts, directions (T, 3) m: where the wand lay

    A camera that is late by d frames sees where things were d frames later: d times the images' velocity off. Where the wand lay was found
    from the same images, which hides part of that, nearly all of it where only two cameras look: so lags and each frame's wand are
    fitted together, frames that fit badly weighing less.
    """
    late, spread = np.full(len(cameras), np.nan), np.full(len(cameras), np.nan)
    velocity = _velocities(_followed(sightings, directions) if wand.either else sightings)
    moving = np.isfinite(velocity[:, 0]) & np.isfinite(starts[sightings.frame, 0])
    frames = np.unique(sightings.frame[moving])
    frames = frames[np.unique(np.linspace(0, len(frames) - 1, min(_LAG_FRAMES, len(frames))).astype(np.int64))]
    moving &= np.isin(sightings.frame, frames)
    seen, frames = sightings.select(moving).compact()
    if len(seen) < _FEWEST_MOVING:
        return late, spread
    residuals, by_wand = _linear(cameras, wand, seen, starts[frames], directions[frames])
    rows = np.arange(len(seen)) - np.searchsorted(seen.frame, np.arange(len(frames)))[seen.frame]
    shape = (len(frames), int(rows.max()) + 1, 2)
    miss, moved, turns = np.zeros(shape), np.zeros((*shape, len(cameras))), np.zeros((*shape, by_wand.shape[2]))
    good = np.isfinite(residuals[:, 0]) & np.isfinite(by_wand).all(axis=(1, 2))
    at = seen.frame[good], rows[good]
    miss[at], turns[at] = residuals[good], by_wand[good]
    moved[(*at, slice(None), seen.camera[good])] = velocity[moving][good]
    miss, moved, turns = (part.reshape(len(frames), 2 * shape[1], *part.shape[3:]) for part in (miss, moved, turns))
    basis, size, _ = np.linalg.svd(turns, full_matrices=False)
    basis = basis * (size > 1e-9 * np.maximum(size[:, :1], 1e-12))[:, None, :]
    miss = miss - np.einsum("tij,tj->ti", basis, np.einsum("tij,ti->tj", basis, miss))
    moved = moved - basis @ (basis.transpose(0, 2, 1) @ moved)
    found, weight = np.zeros(len(cameras)), np.ones(len(frames))
    for _ in range(10):
        matrix = np.einsum("t,tic,tid->cd", weight, moved, moved)
        inverse = np.linalg.pinv(matrix, rcond=1e-4, hermitian=True)
        found = inverse @ np.einsum("t,tic,ti->c", weight, moved, miss)
        left = np.sqrt(np.square(miss - moved @ found).mean(axis=1))
        typical = max(float(np.median(left)), 1e-6)
        weight = 1.0 / (1.0 + np.square(left / (2.0 * typical)))
    count = np.bincount(seen.camera[good], minlength=len(cameras))
    known = count >= _FEWEST_MOVING
    if known.any():
        middle = np.nonzero(known)[0][np.argsort(found[known])[(int(known.sum()) - 1) // 2]]
        late[known] = found[known] - found[middle]
        variance = np.diag(inverse) + inverse[middle, middle] - 2.0 * inverse[middle]
        spread[known] = typical * np.sqrt(np.maximum(variance[known], 0.0))
    return late, spread


def _followed(sightings: Sightings, directions: Floats) -> Sightings:
    """The same with markers named so that the wand does not turn around from frame to frame, as it may where both ends look alike."""
    back = (directions[1:] * directions[:-1]).sum(axis=1) < 0.0
    turned = np.concatenate([[0], np.cumsum(back)])[sightings.frame] % 2 == 1
    return replace(sightings, point=np.where(turned, sightings.point.max(initial=0) - sightings.point, sightings.point))


def _velocities(sightings: Sightings) -> Floats:
    """(n, 2) px per frame, from where the same camera saw the same marker one frame before and after; NaN where it did not."""
    key = (sightings.camera * (sightings.point.max(initial=0) + 1) + sightings.point) * (
        sightings.frame.max(initial=0) + 3
    ) + sightings.frame
    order = np.argsort(key)
    ordered, last = key[order], len(key) - 1
    before, after = (np.minimum(np.searchsorted(ordered, key + by), last) for by in (-1, 1))
    both = (ordered[before] == key - 1) & (ordered[after] == key + 1)
    velocity = 0.5 * (sightings.xy[order[after]] - sightings.xy[order[before]])
    return np.where(both[:, None], velocity, np.nan)


def _linear(cameras: Sequence[Camera], wand: Wand, seen: Sightings, starts: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """What each sighting misses (n, 2) px, and how a shift (m) and a turn (rad) of its frame's wand move it, (n, 2, 6)."""
    along = wand.lengths[seen.point][:, None] * directions[seen.frame]
    world = starts[seen.frame] + along
    residuals, by_point = np.empty((len(seen), 2)), np.empty((len(seen), 2, 3))
    for c, camera in enumerate(cameras):
        own = seen.camera == c
        residuals[own] = seen.xy[own] - camera.project(world[own])
        for axis, step in enumerate(1e-4 * np.eye(3)):
            by_point[own, :, axis] = (camera.project(world[own] + step) - camera.project(world[own] - step)) / 2e-4
    turned = np.cross(np.eye(3)[None], along[:, None])
    return residuals, np.concatenate([by_point, np.einsum("nij,nkj->nik", by_point, turned)], axis=2)
