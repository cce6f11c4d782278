"""Rays of some frames in; what they tell of pixel noise, hidden points and strays out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

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
_ROUNDS = 5
_FEWEST_POINTS = 10
_WIDER = 1.3

Run = Callable[[_kernels.RigArrays, int, int], tuple[Ints, Floats, Floats]]
"""Reconstructs frames from begin to end: rays (P, C), points (P, 3) m, residuals (P,) px."""


def told_by(setting: Setting, counts: Ints, run: Run, noise: float | None) -> tuple[Belief, bool]:
    """What some frames spread over the recording tell, and whether they told anything.

    counts  (T, C) blobs per frame and camera
    noise   px where it is known already, else None

    The first look allows for much noise, so that no true ray is missed; further ones go on with what was found.
    """
    cameras = counts.shape[1]
    filled = counts[counts.sum(axis=1) > 0]
    usual = np.maximum(np.median(filled, axis=0), 1.0) if len(filled) else np.ones(cameras)
    start = 2 * _NOISE_GUESS if noise is None else noise
    belief = Belief(
        np.full(cameras, start), np.full(cameras, _SEEN_GUESS), _STRAYS_FLOOR * usual + 0.1, max(1.0, float(usual.max())), setting.space
    )
    sample = int(np.clip(_ENOUGH_BLOBS / usual.sum(), _LEAST_FRAMES, _MOST_FRAMES))
    frames = np.unique(np.linspace(0, len(counts) - 1, min(sample, len(counts))).round().astype(np.int64))
    enough = False
    for _ in range(_ROUNDS):
        arrays = setting.arrays(belief)
        parts = [(np.empty((0, cameras), dtype=np.int64), np.empty((0, 3)), np.empty(0)), *(run(arrays, t, t + 1) for t in frames)]
        rays, points, residual = (np.concatenate([part[i] for part in parts]) for i in range(3))
        enough = len(points) >= _FEWEST_POINTS
        if not enough and noise is None and belief.noise[0] < _MOST_NOISE / 2:
            belief = replace(belief, noise=2 * belief.noise)
            continue
        if not enough:
            return replace(belief, noise=np.full(cameras, _NOISE_GUESS if noise is None else noise)), False
        before = belief
        belief = _refined(arrays, belief, rays, points, residual, counts[frames], noise)
        if np.allclose(before.noise, belief.noise, rtol=0.1):
            break
    return belief, enough


def _refined(
    arrays: _kernels.RigArrays, belief: Belief, rays: Ints, points: Floats, residual: Floats, counts: Ints, noise: float | None
) -> Belief:
    in_sight, seen = np.zeros(rays.shape[1], dtype=np.int64), np.zeros(rays.shape[1], dtype=np.int64)
    _frame_kernels.seen_shares(arrays, points, rays, in_sight, seen)
    per_camera = (rays >= 0).sum(axis=0) / len(counts)
    strays = np.maximum(counts.mean(axis=0) - per_camera, 0.0) + _STRAYS_FLOOR * (1.0 + 0.25 * counts.mean(axis=0))
    told = belief.noise if noise is not None else np.full(len(belief.noise), _noise_of(residual, (rays >= 0).sum(axis=1), belief.noise[0]))
    return Belief(
        told,
        np.clip((seen + 10 * _SEEN_GUESS) / (in_sight + 10), 0.2, 0.98),
        strays,
        len(points) / len(counts),
        _space_of(points, belief.space),
    )


def _space_of(points: Floats, most: float) -> float:
    """m3, the box that nearly all points are in, a little widened; never more than was thought."""
    low, high = np.quantile(points, [0.02, 0.98], axis=0)
    return min(most, float(np.prod(_WIDER * (high - low) + 0.01 * np.cbrt(most))))


def _noise_of(residual: Floats, cameras: Ints, allowed: float) -> float:
    """px per axis, from the residuals that 80 % of the points stay below; twice of what was allowed for where that was too little.

    Of a point's 2 n numbers 2 n - 3 are free; the quantile of their chi-square is Wilson and Hilferty's.
    """
    good = cameras >= 3 if (cameras >= 3).sum() >= _FEWEST_POINTS else cameras >= 2
    free = 2.0 * cameras[good] - 3.0
    expected = free * (1 - 2 / (9 * free) + 0.8416 * np.sqrt(2 / (9 * free))) ** 3
    told = math.sqrt(float(np.quantile(residual[good] ** 2 * cameras[good] / expected, 0.8)))
    return min(2.0 * allowed, _MOST_NOISE) if told > 0.7 * allowed and allowed >= 2 * _NOISE_GUESS else max(told, NOISE_FLOOR)
