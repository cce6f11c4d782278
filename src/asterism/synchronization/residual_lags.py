"""What posed cameras leave over of moving objects in; by how many frames each camera lags behind the others out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.cameras.bundle import Sightings
from asterism.recording import Floats


@dataclass(frozen=True)
class LagRules:
    """How lags are fitted to residuals.

    least_sightings    sightings of a moving object that a camera needs; fewer leave its lag unknown
    iterations         rounds of reweighting
    downweight_at      a frame whose RMS residual is this many times the median has half the weight (Cauchy)
    least_freedom      singular values of an object's freedoms below this share of the largest are not fitted
    least_information  eigenvalues of the normal equations below this share of the largest are not inverted

    Checked on the simulated wands with lagging cameras of tests/test_wand.py.
    """

    least_sightings: int = 30
    iterations: int = 10
    downweight_at: float = 2.0
    least_freedom: float = 1e-9
    least_information: float = 1e-4


def image_velocities(sightings: Sightings) -> Floats:
    """(n, 2) px per frame, from where the same camera saw the same point one frame before and after; NaN where it did not."""
    # One number for camera, point and frame: the neighbours in time are the number before and after.
    key = (sightings.camera * (sightings.point.max(initial=0) + 1) + sightings.point) * (
        sightings.frame.max(initial=0) + 3
    ) + sightings.frame
    order = np.argsort(key)
    ordered, last = key[order], len(key) - 1
    before, after = (np.minimum(np.searchsorted(ordered, key + by), last) for by in (-1, 1))
    both = (ordered[before] == key - 1) & (ordered[after] == key + 1)
    velocity = 0.5 * (sightings.xy[order[after]] - sightings.xy[order[before]])
    return np.where(both[:, None], velocity, np.nan)


def lags_from_residuals(
    sightings: Sightings, residuals: Floats, velocities: Floats, by_object: Floats, cameras: int, rules: LagRules | None = None
) -> tuple[Floats, Floats]:
    """By how many frames each camera lags (C,), counted from the median camera, and the standard deviation of that; NaN where unknown.

    sightings   of moving objects, frames counted without holes
    residuals   (n, 2) px, seen minus projected; rows that are not finite do not count
    velocities  (n, 2) px per frame
    by_object   (n, 2, D) how the freedoms of its frame's object move each sighting

    A camera that lags by d frames sees where things were d frames later: d times the images' velocity off. Where the object was, was found
    from the same images, which hides part of that, nearly all of it where only two cameras look: so lags and each frame's object are fitted
    together, and frames that fit badly weigh less.
    """
    rules = rules or LagRules()
    lag_frames, sigma = np.full(cameras, np.nan), np.full(cameras, np.nan)
    frames = int(sightings.frame[-1]) + 1
    # All frames in one block of equal height, so that linear algebra runs over all of them at once.
    rows = np.arange(len(sightings)) - np.searchsorted(sightings.frame, np.arange(frames))[sightings.frame]
    shape = (frames, int(rows.max()) + 1, 2)
    miss, moved, turns = np.zeros(shape), np.zeros((*shape, cameras)), np.zeros((*shape, by_object.shape[2]))
    good = np.isfinite(residuals[:, 0]) & np.isfinite(by_object).all(axis=(1, 2))
    at = sightings.frame[good], rows[good]
    miss[at], turns[at] = residuals[good], by_object[good]
    moved[(*at, slice(None), sightings.camera[good])] = velocities[good]
    miss, moved, turns = (part.reshape(frames, 2 * shape[1], *part.shape[3:]) for part in (miss, moved, turns))
    # The object's place was fitted to the late images, too, and took up part of the lag; what it can explain is taken out of both sides.
    miss, moved = _without_object(miss, moved, turns, rules.least_freedom)
    found, weight = np.zeros(cameras), np.ones(frames)
    for _ in range(rules.iterations):
        matrix = np.einsum("t,tic,tid->cd", weight, moved, moved)
        # All cameras later by the same is a shift of the object, so the matrix has a direction of which nothing is known.
        inverse = np.linalg.pinv(matrix, rcond=rules.least_information, hermitian=True)
        found = inverse @ np.einsum("t,tic,ti->c", weight, moved, miss)
        left = np.sqrt(np.square(miss - moved @ found).mean(axis=1))
        typical = max(float(np.median(left)), 1e-6)
        weight = 1.0 / (1.0 + np.square(left / (rules.downweight_at * typical)))
    count = np.bincount(sightings.camera[good], minlength=cameras)
    known = count >= rules.least_sightings
    if known.any():
        #
        middle = np.nonzero(known)[0][np.argsort(found[known])[(int(known.sum()) - 1) // 2]]
        lag_frames[known] = found[known] - found[middle]
        variance = np.diag(inverse) + inverse[middle, middle] - 2.0 * inverse[middle]
        sigma[known] = typical * np.sqrt(np.maximum(variance[known], 0.0))
    return lag_frames, sigma


def _without_object(miss: Floats, moved: Floats, turns: Floats, least: float) -> tuple[Floats, Floats]:
    """Residuals (T, n) and their derivatives by the lags (T, n, C), both without what the object's freedoms (T, n, D) can explain."""
    basis, size, _ = np.linalg.svd(turns, full_matrices=False)
    basis = basis * (size > least * np.maximum(size[:, :1], 1e-12))[:, None, :]
    miss = miss - np.einsum("tij,tj->ti", basis, np.einsum("tij,ti->tj", basis, miss))
    return miss, moved - basis @ (basis.transpose(0, 2, 1) @ moved)
