"""Wand calibration from nothing, on simulated rigs: time, focal lengths, unseen points and their bound, and how often it arrives."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from statistics import median

import numpy as np
from numpy.typing import ArrayLike

from asterism.calibration.wand import WandCalibration, calibrate_wand
from asterism.cameras import Camera, Rig
from asterism.cameras.bundle import AdjustSettings, Sightings, adjust, free_parameters, locate
from asterism.errors import AsterismError
from asterism.formats import read_blobs
from asterism.geometry import place_objects, rotation_from_vector
from asterism.recording import Floats
from asterism.simulation.cameras import ImagingSettings, random_rig, ring_rig, simulate_wand
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure

WAND = (0.0, 0.2, 0.6)
FRAMES, CAMERAS, NOISE, SEEDS = 2000, 8, 0.2, 5
RIGS, RIG_FRAMES, OUTLIERS = 200, 400, 0.05
GROUPS = ("pose", "focal", "aspect", "centre", "k1", "k2", "tangential")
"""What the calibration frees on such lenses; the bound is that of the same unknowns."""
RIGHT_FOCAL, RIGHT_POINTS = 0.01, 0.003
"""A rig is the right one when focal lengths are within this share, and points that it has not seen within so many metres (RMS)."""
UNSEEN = 1000
REAL_WAND, REAL_SIZE = (0.0, 0.055, 0.157), (960, 720)
"""m, as its makers gave it, and px."""


def wand(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Eight cameras in a ring, nothing known: time, accuracy, and the best that any method could do with these images."""
    seeds = 1 if benchmark.quick else SEEDS
    seconds, final, focal, unseen, noisy, bound, likely, lengths, arms = ([] for _ in range(9))
    for seed in range(seeds + 1):
        rng = np.random.default_rng(seed)
        rig = ring_rig(CAMERAS, rng=rng)
        blobs, truth = simulate_wand(rig, WAND, 600 if benchmark.quick else FRAMES, settings=ImagingSettings(noise=NOISE), rng=rng)
        started = time.perf_counter()
        made = calibrate_wand(blobs, WAND, sizes={camera.name: camera.size for camera in rig})
        if seed == 0:
            continue  # the first one compiles
        seconds.append(time.perf_counter() - started)
        final.append(_final_adjustment(made))
        focal += [abs(camera.focal[0] / rig[camera.name].focal[0] - 1.0) for camera in made.rig]
        points = volume(rng)
        unseen.append(points_error(rig, made.rig, points, 0.0, rng))
        noisy.append(points_error(rig, made.rig, points, NOISE, rng))
        likeliest, least = _best(rig, made, truth.positions, points, rng)
        likely.append(likeliest)
        bound.append(least)
        whole = made.lengths[np.isfinite(made.lengths)]
        lengths.append(1000.0 * float(whole.std()))
        arms.append(1000.0 * abs(float(whole.mean()) - WAND[-1]))
    row = f"wand, {CAMERAS} cameras, {FRAMES:,} frames, {NOISE} px, cold start"
    yield Figure(f"{row}: final adjustment, one core", "< 1", median(final), "s", seeds)
    yield Figure(f"{row}: in all, one core", "< 5", median(seconds), "s", seeds)
    yield Figure(f"{row}: focal length, RMS", "<= 0.05", 100.0 * float(np.sqrt(np.mean(np.square(focal)))), "%", len(focal))
    yield Figure(f"{row}: focal length, worst camera", "<= 0.05", 100.0 * max(focal), "%", len(focal))
    yield Figure(f"{row}: 3D of unseen points, their blobs with noise, RMS", "<= 0.61", 1000.0 * _rms(noisy), "mm", seeds * UNSEEN)
    yield Figure(f"{row}: 3D of unseen points, their blobs exact, RMS", "<= 0.61", 1000.0 * _rms(unseen), "mm", seeds * UNSEEN)
    yield Figure(f"{row}: the same, Cramer-Rao bound", "none", 1000.0 * _rms(bound), "mm", seeds * UNSEEN)
    yield Figure(f"{row}: the same over the bound", "none", _rms(unseen) / _rms(bound), "times", seeds)
    over = "3D of unseen points over those of the likeliest rig, found from the truth"
    yield Figure(f"{row}: {over}", "<= 1.05", _rms(unseen) / _rms(likely), "times", seeds)
    yield Figure(f"{row}: wand length error, std", "<= 0.66", median(lengths), "mm", seeds * FRAMES)
    yield Figure(f"{row}: wand length, mean's error", "none", max(arms), "mm", seeds * FRAMES)


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


def _best(rig: Rig, made: WandCalibration, positions: Floats, points: Floats, rng: np.random.Generator) -> tuple[float, float]:
    """m, the error (RMS) of the same points by the likeliest rig, and the one that no unbiased calibration falls below on average.

    The likeliest rig is where an adjustment of these images ends that starts at the truth. The bound is Cramer's and Rao's: the
    covariance of all camera parameters at the truth, for the noise and the images that there were, is drawn from; each draw's points are
    composed, exact blobs given, and laid on the truth as those of the calibration are.
    """
    frames = made.used
    rotations, translations = place_objects(np.array([[length, 0.0, 0.0] for length in WAND]), positions[frames])
    sightings = replace(made.sightings, frame=np.searchsorted(frames, made.sightings.frame))
    true = [rig[name] for name in made.rig.names]
    free = free_parameters(len(true), *GROUPS)
    at_truth = adjust(true, made.wand.template, sightings, rotations, translations, free=free, settings=AdjustSettings(scale=1e3, steps=0))
    likeliest = adjust(
        true, made.wand.template, sightings, rotations, translations, free=free, settings=AdjustSettings(scale=1e3, tolerance=1e-10)
    )
    covariance = at_truth.covariance * (NOISE / at_truth.noise) ** 2
    root = np.linalg.cholesky(covariance + 1e-18 * np.eye(len(covariance)) * np.trace(covariance))
    squares = []
    for _ in range(40):
        step = np.zeros(at_truth.free.shape)
        step[at_truth.free] = root @ rng.normal(size=len(root))
        drawn = Rig(tuple(_stepped(camera, part) for camera, part in zip(true, step, strict=True)))
        squares.append(points_error(rig, drawn, points, 0.0, rng) ** 2)
    return points_error(rig, Rig(likeliest.cameras), points, 0.0, rng), float(np.sqrt(np.mean(squares)))


def _stepped(camera: Camera, step: Floats) -> Camera:
    """A camera moved by a step of its 15 parameters."""
    fx = camera.focal[0] + step[6]
    radial = np.zeros(max(3, len(camera.radial)))
    radial[: len(camera.radial)] = camera.radial
    radial[:3] += step[10:13]
    return replace(
        camera,
        rotation=rotation_from_vector(step[:3]) @ camera.rotation,
        translation=camera.translation + step[3:6],
        focal=(fx, fx * (camera.focal[1] / camera.focal[0] + step[7])),
        centre=(camera.centre[0] + step[8], camera.centre[1] + step[9]),
        radial=tuple(radial),
        tangential=(camera.tangential[0] + step[13], camera.tangential[1] + step[14]),
    )


def _final_adjustment(made: WandCalibration) -> float:
    """Seconds that the adjustment of all parameters over all frames takes, from focal lengths 1 % and places 2 cm off, to its end."""
    rng = np.random.default_rng(0)
    sightings = replace(made.sightings, frame=np.searchsorted(made.used, made.sightings.frame))
    off = [
        replace(
            camera,
            focal=(1.01 * camera.focal[0], 1.01 * camera.focal[1]),
            translation=camera.translation + 0.02 * rng.normal(size=3),
            radial=(0.0, 0.0, 0.0),
            tangential=(0.0, 0.0),
        )
        for camera in made.rig
    ]
    started = time.perf_counter()
    points = locate(off, sightings, len(made.used), len(WAND))
    rotations, translations = place_objects(made.wand.template, points)
    good = np.isfinite(translations).all(axis=1)
    part, kept = sightings.select(good[sightings.frame]).compact()
    free = free_parameters(len(off), *GROUPS)
    result = adjust(off, made.wand.template, part, rotations[kept], translations[kept], free=free, settings=AdjustSettings(scale=3 * NOISE))
    seconds = time.perf_counter() - started
    if not result.converged or result.noise > 1.2 * NOISE:
        raise AsterismError(f"the final adjustment did not arrive: {result.noise:.2f} px.")
    return seconds


def volume(rng: np.random.Generator, reach: float = 1.0) -> Floats:
    """(n, 3) m, places in the middle of the volume of simulated rigs."""
    return rng.uniform([-reach, -reach, 0.3], [reach, reach, 1.7], (UNSEEN, 3))


def _rms(values: ArrayLike) -> float:
    return float(np.sqrt(np.mean(np.square(np.asarray(values)))))
