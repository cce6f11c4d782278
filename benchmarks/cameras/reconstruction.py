"""Composition and merging of simulated blobs: how fast, how many ghosts, how many lost; the thesis' plain algorithm beside it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from statistics import median

import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Rig
from asterism.reconstruction import Reconstruction, ReconstructionSettings, reconstruct
from asterism.recording import Blobs, Floats, Ints
from asterism.simulation.cameras import ImagingSettings, ring_rig, simulate_blobs
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

NOISE = 0.3
"""px."""
APART = 0.03
"""m, the least distance of two markers."""
NEAR = 0.005
"""m: a marker further from every point is lost; a point further from every marker is a ghost, unless it says that it is less exact."""
OWN, PLAIN = "global choice", "plain algorithm 3.1/3.2"
HARD = {"missed": 0.3, "strays": 0.5}
"""A third of all images of markers missing, a stray light in every second image."""


def speed(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Frames per second of CPU time on one core, all in: undistortion, telling the noise, covariances."""
    for cameras, markers, frames, asked in ((8, 50, 2000, "> 1000"), (12, 200, 200, "> 50")):
        frames = frames // 8 if benchmark.quick else frames
        rig, blobs, _, _ = scene(cameras, markers, frames)
        row = f"composition + merging, {cameras} cameras {markers} markers, one core"
        yield Figure(row, asked, _rate(blobs, rig), "frames/s", frames)


def ghosts(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Points without a marker and markers without a point, eight cameras, fifty markers anywhere in two cubic metres."""
    frames = 50 if benchmark.quick else 500
    for case, more in (("all seen", {}), ("30 % missed, 0.5 strays an image", HARD)):
        rig, blobs, truth, shows = scene(8, 50, frames, **more)
        for name, method, some in ((OWN, "global", blobs), (PLAIN, "plain", first_frames(blobs, frames // 25))):
            told = judged(reconstruct(some, rig, ReconstructionSettings(method=method)), truth, shows)
            bound = case == "all seen" and method == "global"
            row = f"8 cameras 50 markers {NOISE} px, {case}, {name}"
            yield Figure(f"ghosts, {row}", "<= 1" if bound else "none", 1000 * told.ghosts / told.seen, "per 1,000 points", told.seen)
            yield Figure(f"real points lost, {row}", "< 0.1" if bound else "none", 100 * told.lost / told.seen, "%", told.seen)


def scene(cameras: int, markers: int, frames: int, **more: float) -> tuple[Rig, Blobs, Floats, Ints]:
    """A ring of cameras, what they see of markers that are elsewhere in every frame, the markers (T, M, 3) m, and what blobs show."""
    rng = np.random.default_rng(cameras * markers)
    rig = ring_rig(cameras, rng=rng)
    truth = rng.uniform([-0.8, -0.8, 0.2], [0.8, 0.8, 1.8], (frames, markers, 3))
    for frame in truth:
        near = _too_near(frame)
        while near.any():
            frame[near] = rng.uniform([-0.8, -0.8, 0.2], [0.8, 0.8, 1.8], (int(near.sum()), 3))
            near = _too_near(frame)
    blobs, shows = simulate_blobs(rig, truth, ImagingSettings(noise=NOISE, **more), rng=rng)
    return rig, blobs, truth, shows


def _too_near(points: Floats) -> NDArray[np.bool_]:
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    too_near: NDArray[np.bool_] = (np.tril(apart < APART, -1)).any(axis=1)
    return too_near


def first_frames(blobs: Blobs, frames: int) -> Blobs:
    """The first frames of a recording of blobs."""
    end = int(blobs.offsets[frames * len(blobs.cameras)])
    kept = slice(0, end)
    return Blobs.from_rows(blobs.frame_of[kept], blobs.camera_of[kept], blobs.xy[kept], blobs.cameras, rate=blobs.rate, frames=frames)


@dataclass(frozen=True)
class Told:
    """Markers that two cameras saw by a blob of their own, how many of these have no point, and points that have no marker."""

    seen: int
    lost: int
    ghosts: int
    nearest: Floats


def judged(result: Reconstruction, truth: Floats, shows: Ints, near: float = NEAR) -> Told:
    """Points against markers (T, M, 3) m; a point that is less exact than `near` is a ghost beyond four of its own deviations.

    `nearest` (seen,) m: how far the point of each seen marker is, infinite where it has none.
    """
    frames, markers = len(result.clouds), truth.shape[1]
    blobs, deviation = result.blobs, result.deviation
    shows = shows[: len(blobs.xy)]
    seen = np.zeros((frames, markers), dtype=np.int64)
    np.add.at(seen, (blobs.frame_of[shows >= 0], shows[shows >= 0]), 1)
    nearest = np.full((frames, markers), np.inf)
    ghosts = 0
    for t, points in enumerate(result.clouds):
        if len(points):
            apart = np.nan_to_num(np.linalg.norm(points[:, None] - truth[t][None], axis=2), nan=np.inf)
            nearest[t] = apart.min(axis=0)
            here = slice(result.clouds.offsets[t], result.clouds.offsets[t + 1])
            ghosts += int((apart.min(axis=1) > np.maximum(near, 4 * deviation[here])).sum())
    two = seen >= 2
    return Told(int(two.sum()), int((nearest[two] > near).sum()), ghosts, nearest[two])


def _rate(blobs: Blobs, rig: Rig, repeats: int = 5) -> float:
    """Frames per second of CPU time: warmed by one call, then the median of several."""
    reconstruct(blobs, rig)
    times = []
    for _ in range(repeats):
        started = time.process_time()
        reconstruct(blobs, rig)
        times.append(time.process_time() - started)
    return len(blobs) / median(times)
