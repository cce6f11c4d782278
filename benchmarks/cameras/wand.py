"""Wand calibration from nothing, on simulated rigs: time, focal lengths, unseen points, and how often it arrives."""

from __future__ import annotations

import time
from collections.abc import Iterator
from statistics import median

import numpy as np
from numpy.typing import ArrayLike

from asterism.calibration.wand import calibrate_wand
from asterism.cameras import Rig
from asterism.cameras.bundle import Sightings, locate
from asterism.errors import AsterismError
from asterism.formats import read_blobs
from asterism.geometry import place_objects
from asterism.recording import Floats
from asterism.simulation.cameras import ImagingSettings, random_rig, ring_rig, simulate_wand
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure

WAND = (0.0, 0.2, 0.6)
FRAMES, CAMERAS, NOISE, SEEDS = 2000, 8, 0.2, 5
RIGS, RIG_FRAMES, OUTLIERS = 60, 400, 0.05
RIGHT_FOCAL, RIGHT_POINTS = 0.01, 0.003
"""A rig is the right one when focal lengths are within this share, and points that it has not seen within so many metres (RMS)."""
UNSEEN = 1000
REAL_WAND, REAL_SIZE = (0.0, 0.055, 0.157), (960, 720)
"""m, as its makers gave it, and px."""


def wand(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Eight cameras in a ring, nothing known: time and accuracy."""
    seeds = 1 if benchmark.quick else SEEDS
    seconds, focal, unseen, noisy, lengths = ([] for _ in range(5))
    for seed in range(seeds + 1):
        rng = np.random.default_rng(seed)
        rig = ring_rig(CAMERAS, rng=rng)
        blobs, _ = simulate_wand(rig, WAND, 600 if benchmark.quick else FRAMES, settings=ImagingSettings(noise=NOISE), rng=rng)
        started = time.perf_counter()
        made = calibrate_wand(blobs, WAND, sizes={camera.name: camera.size for camera in rig})
        if seed == 0:
            continue  # the first one compiles
        seconds.append(time.perf_counter() - started)
        focal += [abs(camera.focal[0] / rig[camera.name].focal[0] - 1.0) for camera in made.rig]
        points = volume(rng)
        unseen.append(points_error(rig, made.rig, points, 0.0, rng))
        noisy.append(points_error(rig, made.rig, points, NOISE, rng))
        lengths.append(1000.0 * float(made.lengths[np.isfinite(made.lengths)].std()))
    row = f"wand, {CAMERAS} cameras, {FRAMES:,} frames, {NOISE} px, cold start"
    yield Figure(f"{row}: in all, one core", "< 5", median(seconds), "s", seeds)
    yield Figure(f"{row}: focal length, RMS", "<= 0.05", 100.0 * _rms(focal), "%", len(focal))
    yield Figure(f"{row}: focal length, worst camera", "<= 0.05", 100.0 * max(focal), "%", len(focal))
    yield Figure(f"{row}: 3D of unseen points, their blobs with noise, RMS", "<= 0.61", 1000.0 * _rms(noisy), "mm", seeds * UNSEEN)
    yield Figure(f"{row}: 3D of unseen points, their blobs exact, RMS", "<= 0.61", 1000.0 * _rms(unseen), "mm", seeds * UNSEEN)
    yield Figure(f"{row}: wand length error, std", "<= 0.66", median(lengths), "mm", seeds * FRAMES)


def real_wand(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """A real waved wand before two Raspberry Pi cameras with rolling shutters and clocks of their own: how well its length is kept."""
    blobs = read_blobs(folder() / "cameras" / "pi-wand" / "2d.csv")
    made = calibrate_wand(blobs, REAL_WAND, sizes=REAL_SIZE)
    whole = made.lengths[np.isfinite(made.lengths)]
    row = "real wand (pi-wand), 2 cameras with rolling shutters"
    yield Figure(f"{row}: wand length error, std", "<= 0.66", 1000.0 * float(whole.std()), "mm", len(whole))
    yield Figure(f"{row}: wand length, mean's error", "none", 1000.0 * abs(float(whole.mean()) - REAL_WAND[-1]), "mm", len(whole))
    yield Figure(f"{row}: images left out", "none", made.mean_rejected_share, "fraction", len(blobs.xy))


def wand_rigs(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Rigs of all kinds with outliers: how many converge to the right one, and whether the others say so."""
    rigs = 10 if benchmark.quick else RIGS
    told = list(benchmark.each(_arrives, [(benchmark.quick, seed) for seed in range(1000, 1000 + rigs)]))
    right = [arrived for arrived, _, _ in told]
    row = f"wand, cold starts of {rigs} random rigs of 3 to 12 cameras, {100 * OUTLIERS:.0f} % outliers"
    yield Figure(f"{row}: converge to the right rig", ">= 99", 100.0 * float(np.mean(right)), "%", rigs)
    silent = sum(1 for arrived, usable, _ in told if not arrived and usable)
    yield Figure(f"{row}: wrong and not said so", "== 0", silent, "rigs", rigs)
    refused = sum(1 for arrived, usable, _ in told if arrived and not usable)
    yield Figure(f"{row}: right, but called unusable", "none", refused, "rigs", rigs)
    yield Figure(f"{row}: 3D of unseen points, RMS, median rig", "none", 1000.0 * median(error for _, _, error in told), "mm", rigs)


def _arrives(benchmark: BenchmarkRun, which: tuple[bool, int]) -> tuple[bool, bool, float]:
    """Of one rig: whether all its cameras were found right, whether the calibration calls itself usable, and its error, m."""
    rng = np.random.default_rng(which[1])
    rig = random_rig(rng=rng)
    blobs, _ = simulate_wand(rig, WAND, RIG_FRAMES, settings=ImagingSettings(noise=NOISE, outliers=OUTLIERS), rng=rng, rate=20.0)
    try:
        made = calibrate_wand(blobs, WAND, sizes={camera.name: camera.size for camera in rig})
    except AsterismError:
        return False, False, float("inf")
    focal = max(abs(camera.focal[0] / rig[camera.name].focal[0] - 1.0) for camera in made.rig)
    error = points_error(rig, made.rig, volume(rng, 0.5), 0.0, rng)
    if len(made.rig) < len(rig) or focal > RIGHT_FOCAL or not error < RIGHT_POINTS:
        posed = f"{len(made.rig)} of {len(rig)} cameras"
        benchmark.report(f"rig {which[1]}: {posed}, focal {100 * focal:.2f} %, points {1000 * error:.2f} mm, usable: {made.usable}")
        return False, made.usable, error
    return True, made.usable, error


def points_error(rig: Rig, found: Rig, points: Floats, noise: float, rng: np.random.Generator) -> float:
    """m, RMS of points (n, 3) m that a calibration has not seen, composed with it, after one world was laid on the other rigidly."""
    xy = np.full((len(points), len(found), 1, 2), np.nan)
    for c, camera in enumerate(found):
        true = rig[camera.name]
        seen = true.project(points)
        width, height = true.size or (0, 0)
        inside = ((seen > 0) & (seen < [width, height])).all(axis=1)
        xy[inside, c, 0] = seen[inside]
    xy += noise * rng.normal(size=xy.shape)
    there = locate(found.cameras, Sightings.from_array(xy), len(points), 1)[:, 0]
    return _rms(np.linalg.norm(_laid(points, there), axis=1))


def _laid(points: Floats, there: Floats) -> Floats:
    """What is left (m, 3) between points and those found, where they were, after the best rotation and shift."""
    good = np.isfinite(there).all(axis=1)
    rotations, translations = place_objects(there[good], points[good][None])
    return there[good] @ rotations[0].T + translations[0] - points[good]


def volume(rng: np.random.Generator, reach: float = 1.0) -> Floats:
    """(n, 3) m, places in the middle of the volume of simulated rigs."""
    return rng.uniform([-reach, -reach, 0.3], [reach, reach, 1.7], (UNSEEN, 3))


def _rms(values: ArrayLike) -> float:
    return float(np.sqrt(np.mean(np.square(np.asarray(values)))))
