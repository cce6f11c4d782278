"""A true rig and a true walk: 2D simulated from both, points from the 2D alone, held against the walk."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from asterism.cameras.files import read_rig
from asterism.formats import read
from asterism.motion import smooth_paths
from asterism.reconstruction import Reconstruction, reconstruct
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
    """Twelve Vicon cameras, 34 markers, about half of the images hidden by the body."""
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


def _expected(result: Reconstruction) -> float:
    """The share of points within 1 mm if errors are as the covariances say: what no reconstruction of single frames can beat."""
    spread = np.linalg.cholesky(result.covariance)
    draws = np.random.default_rng(0).normal(size=(len(spread), SAMPLES, 3))
    return float((np.linalg.norm(np.einsum("pij,pkj->pki", spread, draws), axis=2) < 0.001).mean())
