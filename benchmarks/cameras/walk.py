"""A true rig and a true walk: 2D simulated from both, points and labels from the 2D alone, held against the walk."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from asterism.cameras.files import read_rig
from asterism.formats import read
from asterism.motion import smooth_paths
from asterism.reconstruction import Reconstruction, reconstruct
from asterism.recording import NULL, Clouds, Floats, Labelling, Recording
from asterism.simulation.cameras import ImagingSettings, simulate_blobs, walker_capsules
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.cameras.reconstruction import NEAR, NOISE, judged
from benchmarks.data import folder
from benchmarks.figures import Figure

STRAYS = 0.3
"""Lights per image that are nowhere in the next."""
RIGS_OWN_NOISE = 0.15
"""px, what Nexus wrote into the rig for its worst camera."""
SAMPLES = 20


def walk(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Twelve Vicon cameras, 34 markers, about half of the images hidden by the body; the model is trained on the walk's first half.

    It is trained on the reconstructed points of that half under their true names, as a laboratory would train it that has labelled them
    once.
    """
    place = folder() / "cameras" / "vicon-rig-walk"
    rig, recording = read_rig(place / "walking_1.xcp"), read(place / "walking_1.c3d")
    recording = recording.frames(slice(0, 200)) if benchmark.quick else recording
    body = walker_capsules(recording)
    for noise in (NOISE, RIGS_OWN_NOISE):
        rng = np.random.default_rng(0)
        blobs, shows = simulate_blobs(
            rig, recording.positions, ImagingSettings(noise=noise, strays=STRAYS), body=body, rng=rng, rate=recording.rate
        )
        result = reconstruct(blobs, rig)
        told = judged(result, recording.positions, shows)
        row = f"vicon-rig-walk, {noise} px, body, strays"
        asked = ">= 0.995" if noise == NOISE else "none"
        yield Figure(
            f"{row}: markers seen by two cameras, found within 1 mm", asked, float((told.nearest < 0.001).mean()), "fraction", told.seen
        )
        yield Figure(f"{row}: the same, expected from the covariances", "none", _expected(result), "fraction", len(result.residual))
        paths = smooth_paths(result.clouds, result.covariance)
        smooth = judged(result.with_points(paths.clouds, paths.covariance, rig), recording.positions, shows)
        share = float((smooth.nearest < 0.001).mean())
        yield Figure(f"{row}: the same, smoothed along paths", asked, share, "fraction", smooth.seen)
        yield Figure(f"{row}: found within 2 mm", "none", float((told.nearest < 0.002).mean()), "fraction", told.seen)
        yield Figure(f"{row}: found within 5 mm", "none", float((told.nearest < NEAR).mean()), "fraction", told.seen)
        yield Figure(f"{row}: ghosts", "none", 1000 * told.ghosts / told.seen, "per 1,000 points", told.seen)
        if noise == NOISE:
            half = len(recording) // 2
            ensemble = benchmark.fit([_named(result, recording).frames(slice(0, half))], ["S01"])
            clouds = _from(result.clouds, half)
            right, wrong, there = _labels(ensemble.label(clouds), clouds, recording.positions[half:])
            labelled = f"{row}: second half labelled by a model of the first"
            yield Figure(f"{labelled}, points of markers labelled right", "none", right / there, "fraction", there)
            yield Figure(f"{labelled}, labels that are wrong", "none", wrong / max(1, right + wrong), "fraction", right + wrong)


def _named(result: Reconstruction, recording: Recording) -> Recording:
    """The reconstructed points under the names of the markers that they are nearest to, those that are near one."""
    positions = np.full(recording.positions.shape, np.nan)
    for t, points in enumerate(result.clouds):
        if len(points):
            apart = np.linalg.norm(points[:, None] - recording.positions[t][None], axis=2)
            near = np.flatnonzero(np.nan_to_num(apart, nan=np.inf).min(axis=0) < NEAR)
            positions[t, near] = points[apart[:, near].argmin(axis=0)]
    return Recording(positions, recording.labels, recording.rate, recording.vertical)


def _expected(result: Reconstruction) -> float:
    """The share of points within 1 mm if errors are as the covariances say: what no reconstruction of single frames can beat."""
    spread = np.linalg.cholesky(result.covariance)
    draws = np.random.default_rng(0).normal(size=(len(spread), SAMPLES, 3))
    return float((np.linalg.norm(np.einsum("pij,pkj->pki", spread, draws), axis=2) < 0.001).mean())


def _from(clouds: Clouds, frame: int) -> Clouds:
    """The clouds from a frame on."""
    return Clouds.from_points([clouds[t] for t in range(frame, len(clouds))], clouds.rate, clouds.vertical)


def _labels(labelling: Labelling, clouds: Clouds, truth: Floats) -> tuple[int, int, int]:
    """Labels on the marker's own point, labels elsewhere, and markers that have a point within NEAR."""
    right = wrong = there = 0
    for t, points in enumerate(clouds):
        apart = np.linalg.norm(points[:, None] - truth[t][None], axis=2)
        there += int((apart.min(axis=0, initial=np.inf) < NEAR).sum())
        for marker, point in enumerate(labelling.indices[t]):
            if point != NULL:
                fits = apart[point, marker] < NEAR
                right, wrong = right + int(fits), wrong + int(not fits)
    return right, wrong, there
