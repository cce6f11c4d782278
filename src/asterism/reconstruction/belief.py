"""Rays of some frames in; what they tell of pixel noise, hidden points and strays out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from asterism.reconstruction import _frame_kernels, _kernels
from asterism.reconstruction.setting import Belief, Setting
from asterism.recording import Floats, Ints

NOISE_FLOOR = 0.02
"""px: below, blobs say nothing about noise (simulations have none)."""
_NOISE_GUESS = 0.5
_MOST_NOISE = 8.0
_SEEN_GUESS = 0.7
_STRAYS_FLOOR = 0.02
_LEAST_FRAMES, _MOST_FRAMES, _ENOUGH_BLOBS = 3, 24, 8000
_MANY_BLOBS = 100
_ROUNDS = 9
_FEWEST_POINTS = 10
_WIDER = 1.3
_FIT, _CUT = 1 / 3, 1.2
"""The share of the points that must fit each other for a first look to tell the noise, a bumped camera or two apart; and what share of
the noise that was allowed for may be found: more means that the gate cut it off."""

Run = Callable[[_kernels.RigArrays, int, int], tuple[Ints, Floats, Floats]]
"""Reconstructs frames from begin to end: rays (P, C), points (P, 3) m, residuals (P,) px."""


def told_by(setting: Setting, counts: Ints, run: Run, noise: float | None) -> tuple[Belief, str]:
    """What some frames spread over the recording tell; and a remark where they do not tell the noise, else "".

    counts  (T, C) blobs per frame and camera
    noise   px where it is known already, else None

    The first look allows for little noise, since in a crowd nothing else tells anything; it is widened while that is too little. Further
    ones go on with what was found.
    """
    cameras = counts.shape[1]
    filled = counts[counts.sum(axis=1) > 0]
    usual = np.maximum(np.median(filled, axis=0), 1.0) if len(filled) else np.ones(cameras)
    start = _NOISE_GUESS if noise is None else noise
    belief = Belief(
        np.full(cameras, start), np.full(cameras, _SEEN_GUESS), _STRAYS_FLOOR * usual + 0.1, max(1.0, float(usual.max())), setting.space
    )
    sample = int(np.clip(_ENOUGH_BLOBS / usual.sum(), _LEAST_FRAMES, _MOST_FRAMES))
    frames = np.unique(np.linspace(0, len(counts) - 1, min(sample, len(counts))).round().astype(np.int64))
    widening = noise is None
    for _ in range(_ROUNDS):
        arrays = setting.arrays(belief)
        parts = [(np.empty((0, cameras), dtype=np.int64), np.empty((0, 3)), np.empty(0)), *(run(arrays, t, t + 1) for t in frames)]
        rays, points, residual = (np.concatenate([part[i] for part in parts]) for i in range(3))
        allowed = float(belief.noise[0])
        enough = len(points) >= _FEWEST_POINTS
        told = noise_of(residual, (rays >= 0).sum(axis=1), _FIT if widening else 0.5) if enough else math.inf
        if widening and told > _CUT * allowed and allowed < _MOST_NOISE:
            belief = replace(belief, noise=2 * belief.noise)
            continue
        if noise is None and (not enough or (widening and told > _CUT * allowed)):
            return replace(belief, noise=np.full(cameras, _NOISE_GUESS)), _untold(int(counts[frames].sum()))
        if not enough:
            return belief, ""
        widening = False
        belief = _refined(arrays, belief, rays, points, counts[frames], told if noise is None else noise)
        if abs(allowed - belief.noise[0]) <= 0.1 * belief.noise[0]:
            break
    return belief, ""


def _untold(blobs: int) -> str:
    if blobs < _MANY_BLOBS:
        return f"too few points to tell the pixel noise from; {_NOISE_GUESS:.2f} px was assumed."
    return (
        f"the blobs do not fit the rig, whatever noise up to {_MOST_NOISE:g} px they may have: do not use these points. "
        "Is it the rig of this recording, with its image size, its cameras' names, and y counted from the top?"
    )


def _refined(arrays: _kernels.RigArrays, belief: Belief, rays: Ints, points: Floats, counts: Ints, noise: float) -> Belief:
    in_sight, seen = np.zeros(rays.shape[1], dtype=np.int64), np.zeros(rays.shape[1], dtype=np.int64)
    _frame_kernels.seen_shares(arrays, points, rays, in_sight, seen)
    per_camera = (rays >= 0).sum(axis=0) / len(counts)
    strays = np.maximum(counts.mean(axis=0) - per_camera, 0.0) + _STRAYS_FLOOR * (1.0 + 0.25 * counts.mean(axis=0))
    return Belief(
        np.full(len(belief.noise), min(max(noise, NOISE_FLOOR), _MOST_NOISE)),
        np.clip((seen + 10 * _SEEN_GUESS) / (in_sight + 10), 0.2, 0.98),
        strays,
        len(points) / len(counts),
        _space_of(points, belief.space),
    )


def _space_of(points: Floats, most: float) -> float:
    """m3, the box that nearly all points are in, a little widened; never more than was thought."""
    low, high = np.quantile(points, [0.02, 0.98], axis=0)
    return min(most, float(np.prod(_WIDER * (high - low) + 0.01 * np.cbrt(most))))


def noise_of(residual: Floats, cameras: Ints, share: float = 0.5) -> float:
    """px per axis, from the residuals (P,) px that this share of the points stays below; cameras (P,): how many show each.

    Of a point's 2 n numbers 2 n - 3 are free; the quantile of their chi-square is Wilson and Hilferty's. Points of three cameras tell
    where there are some: two rays that do not belong together meet easily.
    """
    good = cameras >= 3 if (cameras >= 3).sum() >= _FEWEST_POINTS else cameras >= 2
    free = 2.0 * cameras[good] - 3.0
    expected = free * (1 - 2 / (9 * free) + float(ndtri(share)) * np.sqrt(2 / (9 * free))) ** 3
    return math.sqrt(float(np.quantile(residual[good] ** 2 * cameras[good] / expected, share)))
