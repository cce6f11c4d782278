"""Cameras bumped after the calibration, found and mended from a recording of a walker: how often, and how well."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from statistics import median

import numpy as np

from asterism.calibration import refine_rig
from asterism.cameras import Camera, Rig
from asterism.geometry import rotation_from_vector
from asterism.simulation import simulate_walks
from asterism.simulation.cameras import ImagingSettings, ring_rig, simulate_blobs, walker_capsules
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

TRIALS, NOISE, FRAMES = 40, 0.3, 300
SMALLEST, LARGEST, SHIFT = 0.1, 8.0, 0.02
"""Degrees by which cameras are turned, and metres by which they are shifted at most."""


def refine(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Rigs of 4 to 10 cameras, none, one or two of them bumped; a walker whose body hides markers, with strays."""
    trials = 6 if benchmark.quick else TRIALS
    told = list(benchmark.each(_trial, list(range(trials))))
    row = "refine, 4 to 10 cameras, none to two bumped by 0.1 to 8 degrees"
    yield Figure(
        f"{row}: recordings in which just the bumped are named", "none", 100.0 * float(np.mean([right for right, _ in told])), "%", trials
    )
    left = [miss for _, misses in told for miss in misses]
    yield Figure(f"{row}: the mended cameras' images are off by, median", "none", median(left), "px", len(left))
    yield Figure(f"{row}: the same, worst camera", "none", max(left), "px", len(left))


def _trial(_bench: BenchmarkRun, seed: int) -> tuple[bool, list[float]]:
    """Whether just the bumped cameras were named, and by how many px the images of the mended ones are off (median over the volume)."""
    rng = np.random.default_rng(seed)
    true = ring_rig(int(rng.integers(4, 11)), rng=rng)
    walk = simulate_walks(1, frames=FRAMES, seed=seed)[0]
    blobs, _ = simulate_blobs(true, walk.positions, ImagingSettings(noise=NOISE, strays=0.5), body=walker_capsules(walk), rng=rng)
    most = 1 if len(true) < 6 else 2
    chosen = sorted(rng.choice(len(true), int(rng.integers(0, most + 1)), replace=False).tolist())
    rig = replace(true, cameras=tuple(_bumped(camera, rng) if c in chosen else camera for c, camera in enumerate(true)))
    made = refine_rig(blobs, rig)
    named = [c for c, check in enumerate(made.cameras) if check.state != "good"]
    points = rng.uniform([-0.5, -0.5, 0.2], [0.5, 0.5, 1.6], (200, 3))
    return named == chosen, [_off(made.rig, true, c, points) for c in chosen]


def _bumped(camera: Camera, rng: np.random.Generator) -> Camera:
    axis, shift = rng.normal(size=3), rng.uniform(-1.0, 1.0, 3) * SHIFT
    degrees = SMALLEST * (LARGEST / SMALLEST) ** rng.random()
    rotation = rotation_from_vector(np.radians(degrees) * axis / np.linalg.norm(axis)) @ camera.rotation
    # small bumps turn a camera in its mount, large ones move the mount
    place = camera.position + shift * degrees / LARGEST
    return replace(camera, rotation=rotation, translation=-rotation @ place)


def _off(found: Rig, true: Rig, camera: int, points: np.ndarray) -> float:
    return float(np.nanmedian(np.linalg.norm(found[camera].project(points) - true[camera].project(points), axis=1)))
