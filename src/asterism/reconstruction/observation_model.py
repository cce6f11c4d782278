"""Rays of some frames in; an estimate of pixel noise, detection rates and strays out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from asterism.reconstruction._frame_kernels import count_visibility
from asterism.reconstruction._input_kernels import RigArrays
from asterism.reconstruction.problem import ObservationModel, ReconstructionProblem
from asterism.recording import Floats, Ints


@dataclass(frozen=True)
class EstimationRules:
    """How the observation model is estimated.

    What it must give: 0.1 to 2 px of noise to 10 % (tests/test_reconstruction.py), and the noise of the other cameras where one camera of
    four or two of eight were moved (tests/test_camera_fit.py).

    start_noise         px, with which the estimate begins; assumed where nothing tells the noise
    min_noise           px: below, blobs say nothing about noise (simulations without noise have less)
    max_noise           px: where more is needed, the blobs do not fit the rig
    start_detection     detection rate with which the estimate begins; it counts as much as `detection_weight` points
    detection_weight    points
    detection_limits    least and greatest detection rate
    stray_floor         strays per frame and camera, per blob of an ordinary frame, that are allowed for at least
    min_frames, max_frames, enough_blobs  frames that are looked at: as many as have enough blobs, within these limits
    min_points          points that tell the noise
    rounds              how often the frames are reconstructed at most
    first_share         share of the points that must fit each other in the first rounds; so a moved camera or two are borne
    cut_off             where the noise that was found is more than this share of the noise that was allowed for, the gate cut it off
    space_margin        how much wider than the box of nearly all points the space is
    """

    start_noise: float = 0.5
    min_noise: float = 0.02
    max_noise: float = 8.0
    start_detection: float = 0.7
    detection_weight: float = 10.0
    detection_limits: tuple[float, float] = (0.2, 0.98)
    stray_floor: float = 0.02
    min_frames: int = 3
    max_frames: int = 24
    enough_blobs: int = 8000
    min_points: int = 10
    rounds: int = 9
    first_share: float = 1 / 3
    cut_off: float = 1.2
    space_margin: float = 1.3


RULES = EstimationRules()

Run = Callable[[RigArrays, int, int], tuple[Ints, Floats, Floats]]
"""Reconstructs frames from begin to end: rays (P, C), points (P, 3) m, residuals (P,) px."""


def estimate_observation_model(
    problem: ReconstructionProblem, counts: Ints, run: Run, noise: float | None, rules: EstimationRules = RULES
) -> tuple[ObservationModel, bool, int]:
    """The observation model by some frames that are spread over the recording.

    counts  (T, C) blobs per frame and camera
    noise   px where it is known already, else None

    Returns the model, whether the noise is known (given, or estimated from enough points), and how many blobs the frames have.

    The first round allows for little noise, since in a crowd nothing else tells anything; the noise is doubled while that is too little.
    Further rounds go on with what was found.
    """
    cameras = counts.shape[1]
    model, frames = first_model(problem, counts, noise, rules)
    blobs = int(counts[frames].sum())
    widening = noise is None
    for _ in range(rules.rounds):
        arrays = problem.arrays(model)
        parts = [(np.empty((0, cameras), dtype=np.int64), np.empty((0, 3)), np.empty(0)), *(run(arrays, t, t + 1) for t in frames)]
        rays, points, residual = (np.concatenate([part[i] for part in parts]) for i in range(3))
        allowed = float(model.noise[0])
        enough = len(points) >= rules.min_points
        share = rules.first_share if widening else 0.5
        measured = noise_of(residual, (rays >= 0).sum(axis=1), share, rules.min_points) if enough else math.inf
        if widening and measured > rules.cut_off * allowed and allowed < rules.max_noise:
            model = replace(model, noise=2 * model.noise)
            continue
        if noise is None and (not enough or (widening and measured > rules.cut_off * allowed)):
            return replace(model, noise=np.full(cameras, rules.start_noise)), False, blobs
        if not enough:
            return model, True, blobs
        widening = False
        model = _refined(arrays, model, rays, points, counts[frames], measured if noise is None else noise, rules)
        if abs(allowed - model.noise[0]) <= 0.1 * model.noise[0]:
            break
    return model, True, blobs


def first_model(
    problem: ReconstructionProblem, counts: Ints, noise: float | None, rules: EstimationRules = RULES
) -> tuple[ObservationModel, Ints]:
    """The model with which the estimate begins, and the frames that are looked at."""
    cameras = counts.shape[1]
    filled = counts[counts.sum(axis=1) > 0]
    usual = np.maximum(np.median(filled, axis=0), 1.0) if len(filled) else np.ones(cameras)
    model = ObservationModel(
        np.full(cameras, rules.start_noise if noise is None else noise),
        np.full(cameras, rules.start_detection),
        rules.stray_floor * usual + 0.1,
        max(1.0, float(usual.max())),
        problem.space,
    )
    sample = int(np.clip(rules.enough_blobs / usual.sum(), rules.min_frames, rules.max_frames))
    return model, np.unique(np.linspace(0, len(counts) - 1, min(sample, len(counts))).round().astype(np.int64))


def _refined(
    arrays: RigArrays, model: ObservationModel, rays: Ints, points: Floats, counts: Ints, noise: float, rules: EstimationRules
) -> ObservationModel:
    """The model by the points (P, 3) m, rays (P, C) and blob counts (T, C) of some frames."""
    expected, seen = np.zeros(rays.shape[1], dtype=np.int64), np.zeros(rays.shape[1], dtype=np.int64)
    count_visibility(arrays, points, rays, expected, seen)
    per_camera = (rays >= 0).sum(axis=0) / len(counts)
    strays = np.maximum(counts.mean(axis=0) - per_camera, 0.0) + rules.stray_floor * (1.0 + 0.25 * counts.mean(axis=0))
    weight = rules.detection_weight
    return ObservationModel(
        np.full(len(model.noise), min(max(noise, rules.min_noise), rules.max_noise)),
        np.clip((seen + weight * rules.start_detection) / (expected + weight), *rules.detection_limits),
        strays,
        len(points) / len(counts),
        _space_of(points, model.space, rules),
    )


def _space_of(points: Floats, most: float, rules: EstimationRules) -> float:
    """m3, the box of nearly all points (P, 3) m, a little widened; at most `most`."""
    low, high = np.quantile(points, [0.02, 0.98], axis=0)
    return min(most, float(np.prod(rules.space_margin * (high - low) + 0.01 * np.cbrt(most))))


def noise_of(residual: Floats, cameras: Ints, share: float = 0.5, min_points: int = RULES.min_points) -> float:
    """px per axis, from the residuals (P,) px that this share of the points stays below; cameras (P,): how many show each.

    Of a point's 2 n numbers 2 n - 3 are free; the quantile of their chi-square is Wilson and Hilferty's. Points of three cameras are taken
    where there are at least `min_points`, else those of two: two rays that do not belong together meet easily.
    """
    good = cameras >= 3 if (cameras >= 3).sum() >= min_points else cameras >= 2
    free = 2.0 * cameras[good] - 3.0
    expected = free * (1 - 2 / (9 * free) + float(ndtri(share)) * np.sqrt(2 / (9 * free))) ** 3
    return math.sqrt(float(np.quantile(residual[good] ** 2 * cameras[good] / expected, share)))
