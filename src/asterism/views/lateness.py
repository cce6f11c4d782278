"""A labelling of blobs in; by how many frames each camera is late, and the blobs in the frames that they show, out."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from asterism.cameras import Camera
from asterism.geometry import cross_matrix
from asterism.recording import Blobs, Floats, Ints
from asterism.views.result import ViewsLabelling

_LEAST_FRAMES = 20
"""Frames with the body from which a delay is estimated: fewer may hold no movement that tells it from a camera that was turned."""
_LATE = 0.3
"""Frames from which a delay is said: 5 ms at 60 Hz. Cameras in step come out at up to 0.05, before a rig that is 0.3 degrees off at 0.2,
which half of it would say; twice as much would miss what is left of a frame where some labels are wrong."""
_ERRORS = 6.0
"""Standard errors from which a delay is no chance: they rest on eight parts of a recording, and of 48 recordings in step none has four."""
_PARTS = 8
"""Parts of the recording by whose difference the error is judged, since markers and frames beside each other err alike."""
_LEAST_SIGHTINGS = 30
"""Markers that two cameras show at a time, with the frames before and after, from which the two tell a delay."""
_MOST_SIGHTINGS = 2000
"""Of these that are looked at for a pair of cameras: ten seconds of a walk; more cost time and change hundredths of a frame."""
_ROUNDS = 6
"""Rounds of reweighting, and whole frames by which the delay is sought step by step."""
_SHIFTS = 5
"""Frames, both ways, by which the blobs of a camera that does not fit are shifted to see whether it is late."""
_NEAR = 4.0
"""Noise within which a blob is where a marker is expected."""


def in_step(blobs: Blobs, late: Ints) -> tuple[Blobs, Ints]:
    """The blobs of cameras that are so many frames late (C,), each in the frame that it shows, and which of the blobs (P,) each one is.

    The number of frames stays; blobs of a time that is in none of them are left out. O(P log P).
    """
    frame, camera = blobs.frame_of - late[blobs.camera_of], blobs.camera_of
    rows = np.nonzero((frame >= 0) & (frame < len(blobs)))[0]
    rows = rows[np.argsort(frame[rows] * len(late) + camera[rows], kind="stable")]
    moved = Blobs.from_rows(
        frame[rows], camera[rows], blobs.xy[rows], blobs.cameras, rate=blobs.rate, sizes=blobs.sizes[rows], frames=len(blobs)
    )
    return replace(moved, first_frame=blobs.first_frame), rows


def late_by(result: ViewsLabelling, noise: float, left_out: Ints) -> Floats:
    """(C,) frames by which each camera is late against the median of the cameras that have labels; NaN where nothing can be said, 0 where
    a delay is not certain. Of two cameras the second one is late against the first.

    The line of sight of a late camera misses those of the others by the marker's velocity across their common plane times the delay. A rig
    that is off makes them miss each other, too, by where the marker is in the images; both are fitted together. Of a camera without labels
    the blobs are shifted in time until they lie where the body is. noise: px, see `fit_rig`. O(frames C^2 M).
    """
    cameras, markers = len(result.rig), len(result.body.markers)
    out = np.full(cameras, np.nan)
    there = np.isfinite(result.poses[:, 0])
    if there.sum() < _LEAST_FRAMES:
        return out
    xy, own = np.full((cameras, len(result.blobs), markers, 2), np.nan), result.candidates >= 0
    for c, camera in enumerate(result.rig):
        seen = own & (result.blobs.camera_of == c)
        xy[c, result.blobs.frame_of[seen], result.candidates[seen]] = camera.undistort(result.blobs.xy[seen])
        if c in left_out:
            xy[c] = np.nan
            uv = camera.project(result.placed.reshape(-1, 3)).reshape(-1, markers, 2)
            out[c] = _shift_of(result, c, uv, noise)
    delay, error = _delays(result, xy)
    # A marker that turns back within a long delay shows less of it, so whole frames are taken out until less than half of one is left.
    whole = np.zeros(cameras, dtype=np.int64)
    for _ in range(_ROUNDS):
        step = np.rint(np.nan_to_num(delay - whole)).astype(np.int64)
        if not step.any():
            break
        whole += step
        if np.abs(whole).max() >= len(result.blobs) // 2:
            return out
        left, again = _delays(result, np.stack([_earlier(one, k) for one, k in zip(xy, whole.tolist(), strict=True)]))
        # Chance that led away from no delay at all must not count as certain where it led to.
        delay, error = whole + left, np.maximum(error, again)
    certain = (np.abs(delay) >= _LATE) & (np.abs(delay) >= _ERRORS * error)
    return np.where(np.isfinite(delay), np.where(certain, delay, 0.0), out)


def _earlier(xy: Floats, frames: int) -> Floats:
    """What a camera that is so many frames late would have shown in time; NaN at the end where nothing is known. xy (T, M, 2)."""
    out = np.full_like(xy, np.nan)
    if frames >= 0:
        out[: len(xy) - frames] = xy[frames:]
    else:
        out[-frames:] = xy[:frames]
    return out


def _delays(result: ViewsLabelling, xy: Floats) -> tuple[Floats, Floats]:
    """(C,) frames by which each camera is late against the median, or the first of two, and the standard error of it; NaN where unknown.

    xy (C, T, M, 2): the labelled blobs on their cameras' normalized planes.
    """
    cameras = len(xy)
    velocity = np.full_like(xy, np.nan)
    velocity[:, 1:-1] = 0.5 * (xy[:, 2:] - xy[:, :-2])
    pairs: list[tuple[Ints, Floats, Floats, Floats]] = []
    for a, b in combinations(range(cameras), 2):
        t, m = np.nonzero(np.isfinite(xy[a] + xy[b] + velocity[a] + velocity[b]).all(axis=2))
        if len(t) < _LEAST_SIGHTINGS:
            continue
        some = np.unique(np.linspace(0, len(t) - 1, min(len(t), _MOST_SIGHTINGS)).round().astype(np.int64))
        t, m = t[some], m[some]
        one, two = xy[a, t, m], xy[b, t, m]
        miss, by_one, by_two = _epipolar(result.rig.cameras[a], result.rig.cameras[b], one, two)
        moved = np.zeros((len(t), cameras))
        # A late camera shows a marker where it was before.
        moved[:, a], moved[:, b] = -(by_one * velocity[a, t, m]).sum(axis=1), -(by_two * velocity[b, t, m]).sum(axis=1)
        # What a rig that is off makes the lines miss: to first order a linear function of the places in both images.
        pairs.append((t * _PARTS // len(result.blobs), miss, moved, np.column_stack([np.ones(len(t)), one, two])))
    delay, error = np.full((2, cameras), np.nan)
    if not pairs:
        return delay, error
    part, miss, moved = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1, 2))
    ends = np.cumsum([len(pair[0]) for pair in pairs])[:-1]
    weight, found = np.ones(len(miss)), np.zeros(cameras)
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)
        # Without what the rig can explain, of both sides: the weights of each round take part in it.
        bases = [np.linalg.qr(pair[3] * own[:, None])[0] for pair, own in zip(pairs, np.split(root, ends), strict=True)]
        columns = [
            side - basis @ (basis.T @ side)
            for basis, side in zip(bases, np.split(np.column_stack([moved, miss]) * root[:, None], ends), strict=True)
        ]
        x, y = np.concatenate(columns)[:, :-1], np.concatenate(columns)[:, -1]
        # All cameras later by the same is no delay, a direction of which nothing is known.
        inverse = np.linalg.pinv(x.T @ x, rcond=1e-4, hermitian=True)
        found = inverse @ (x.T @ y)
        left = np.abs(y - x @ found) / root
        # Huber's weights: a wrong label must not make a camera late.
        weight = np.minimum(1.0, 1.5 * np.median(left) / np.maximum(left, 1e-12))
    score = np.zeros((_PARTS, cameras))
    np.add.at(score, part, x * (y - x @ found)[:, None])
    spread = inverse @ score.T @ score @ inverse * _PARTS / (_PARTS - 1.0)
    known = np.nonzero(np.abs(moved).sum(axis=0) > 0)[0]
    # Of two cameras there is no majority: the first one is the clock.
    clock = known[np.argsort(found[known])[(len(known) - 1) // 2]] if len(known) > 2 else known[0]
    delay[known] = found[known] - found[clock]
    error[known] = np.sqrt(np.maximum(np.diag(spread) + spread[clock, clock] - 2.0 * spread[clock], 0.0))[known]
    return delay, error


def _epipolar(first: Camera, second: Camera, one: Floats, two: Floats) -> tuple[Floats, Floats, Floats]:
    """(N,) px by which lines of sight miss each other in the second image, and (N, 2) how that changes with the places in either.

    one, two (N, 2): on the cameras' normalized planes.
    """
    one, two = (np.column_stack([flat, np.ones(len(flat))]) for flat in (one, two))
    turn = second.rotation @ first.rotation.T
    essential = cross_matrix(second.translation - turn @ first.translation) @ turn
    lines = one @ essential.T
    scale = float(np.mean(second.focal)) / np.linalg.norm(lines[:, :2], axis=1)
    miss: Floats = (two * lines).sum(axis=1) * scale
    back = two @ essential
    return miss, back[:, :2] * scale[:, None], lines[:, :2] * scale[:, None]


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
