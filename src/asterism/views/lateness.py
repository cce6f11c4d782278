"""A labelling of blobs in; by how many frames each camera is late, out."""

from __future__ import annotations

import numpy as np

from asterism.recording import Floats, Ints
from asterism.views.result import ViewsLabelling

_LEAST_FRAMES = 20
"""Frames with the body from which a delay is estimated: fewer may hold no movement that tells it from a camera that was turned."""
_MOVED = 1.5
"""px per frame, root mean square, that markers must move in an image: at half of it a quarter frame is less than the usual noise."""
_LATE = 0.5
"""Frames from which a delay is said; half a frame is what one camera without a common clock is off on average."""
_ERRORS = 6.0
"""Standard errors from which a delay is no chance; markers of one frame move alike, so a frame counts once."""
_SHIFTS = 5
"""Frames, both ways, by which the blobs of a camera that does not fit are shifted to see whether it is late."""
_NEAR = 4.0
"""Noise within which a blob is where a marker is expected."""


def late_by(result: ViewsLabelling, noise: float, left_out: Ints) -> Floats:
    """(C,) frames by which each camera is late against the median of the cameras that have labels; NaN where nothing can be said, 0 where
    a delay is not certain. Of two cameras the second one is late against the first.

    The place of a blob off its marker is a shift, as of a camera that was turned, plus the marker's velocity times the delay. Of a camera
    without labels the blobs are shifted in time until they lie where the body is. noise: px, see `fit_rig`. O(frames C M).
    """
    blobs, cameras, markers = result.blobs, len(result.rig), len(result.body.markers)
    there = np.isfinite(result.poses[:, 0])
    delay, error = np.full((2, cameras), np.nan)
    out = np.full(cameras, np.nan)
    if there.sum() < _LEAST_FRAMES:
        return out
    for c, camera in enumerate(result.rig):
        uv = camera.project(result.placed.reshape(-1, 3)).reshape(-1, markers, 2)
        # Velocity needs the body in the frames before and after.
        velocity = np.full_like(uv, np.nan)
        velocity[1:-1] = 0.5 * (uv[2:] - uv[:-2])
        own = np.nonzero((blobs.camera_of == c) & (result.candidates >= 0))[0]
        frame, marker = blobs.frame_of[own], result.candidates[own]
        off, moved = blobs.xy[own] - uv[frame, marker], velocity[frame, marker]
        known = np.isfinite(off).all(axis=1) & np.isfinite(moved).all(axis=1)
        if c in left_out:
            out[c] = _shift_of(result, c, uv, noise)
        elif known.sum() >= _LEAST_FRAMES and np.sqrt(np.mean(moved[known] ** 2)) >= _MOVED:
            delay[c], error[c] = _delay_of(off[known], moved[known], len(np.unique(frame[known])))
    if np.isfinite(delay).sum() < 2:
        return out
    # Of two cameras there is no majority: the first one is the clock.
    clock = np.nanmedian(delay) if np.isfinite(delay).sum() > 2 else delay[np.isfinite(delay)][0]
    certain = (np.abs(delay - clock) >= _LATE) & (np.abs(delay - clock) >= _ERRORS * error)
    return np.where(np.isfinite(delay), np.where(certain, delay - clock, 0.0), out)


def _delay_of(off: Floats, moved: Floats, frames: int) -> tuple[float, float]:
    """Frames of delay and its standard error, from how far blobs are off (N, 2) px and how their markers move (N, 2) px per frame."""
    weight = np.ones(len(off))
    slope = 0.0
    # Huber's weights: a wrong label must not make a camera late.
    for _ in range(5):
        # Around the weighted means: the shift of a camera that was turned is in them.
        middle, speed = (np.average(each, axis=0, weights=weight) for each in (off, moved))
        x, y = moved - speed, off - middle
        slope = float((weight[:, None] * x * y).sum() / max((weight[:, None] * x * x).sum(), 1e-9))
        left = np.linalg.norm(y - slope * x, axis=1)
        weight = np.minimum(1.0, 1.5 * np.median(left) / np.maximum(left, 1e-9))
    scatter = np.sqrt(np.average(left**2, weights=weight) / 2.0)
    # A blob shows where its marker was before, so a late camera has it behind.
    return -slope, float(scatter / np.sqrt(2.0 * np.mean(x**2) * frames))


def _shift_of(result: ViewsLabelling, c: int, uv: Floats, noise: float) -> float:
    """Frames by which the blobs of camera c must be shifted to lie where the body is, NaN where no shift lays most of them there."""
    shares, in_view = [], result.in_view
    for k in range(-_SHIFTS, _SHIFTS + 1):
        near = of = 0
        for t in range(max(k, 0), len(uv) + min(k, 0)):
            # A camera that is k frames late shows in frame t what was in frame t - k.
            expected = uv[t - k][(in_view[t - k, c] > 0.5) & np.isfinite(uv[t - k, :, 0])]
            cell = t * len(result.rig) + c
            xy = result.blobs.xy[result.blobs.offsets[cell] : result.blobs.offsets[cell + 1]]
            if len(expected) and len(xy):
                away = np.linalg.norm(expected[:, None] - xy[None], axis=2).min(axis=1)
                near, of = near + int((away < _NEAR * noise).sum()), of + len(away)
        shares.append(near / max(of, 1))
    best = int(np.argmax(shares))
    # Half of the markers where they are expected, and twice as many as without a shift: no turned camera does that by chance.
    return float(best - _SHIFTS) if shares[best] >= 0.5 and shares[best] >= 2.0 * shares[_SHIFTS] else np.nan
