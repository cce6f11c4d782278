"""Blobs in images: against a peer's on real particles, against rendered truth, and how long they take."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from asterism.detection import BlobSettings, Flag, ImageBlobs, find_blobs
from asterism.recording import Blobs, Floats
from asterism.simulation.cameras import RenderSettings, render_images
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure

SIZE = (1280, 1024)
NEAR_PX = 1.0
"""A blob is the peer's target where they are nearer than this."""
CORNER = 0.5
"""The peer counts pixels from the corner of the first one, we from its centre."""
WINDOW = 25
"""The peer takes off the mean of so many by so many pixels (its high-pass filter)."""


def particles(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Particles in four cameras and four time steps: blobs against the peer's targets, with the peer's thresholds and with ours."""
    images = [(camera, step) for camera in range(1, 5) for step in range(10001, 10002 if benchmark.quick else 10005)]
    pairs = {"the peer's thresholds": [], "automatic": []}
    for camera, step in images:
        image, targets = _image(camera, step), _targets(camera, step)
        pairs["the peer's thresholds"].append((_as_the_peer(image, camera), targets))
        pairs["automatic"].append((_whole_blobs(find_blobs(image, BlobSettings(background=WINDOW))), targets))
    for how, both in pairs.items():
        asked = how != "automatic"
        row = f"particles-4cam, blobs against the peer's targets, {how}"
        found = [cKDTree(blobs).query(targets)[0] for blobs, targets in both]
        true = [cKDTree(targets).query(blobs)[0] for blobs, targets in both]
        missed, extra = np.concatenate(found), np.concatenate(true)
        near = missed[missed < NEAR_PX]
        yield Figure(f"{row}: recall", ">= 99" if asked else "none", 100 * float((missed < NEAR_PX).mean()), "%", len(missed))
        yield Figure(f"{row}: precision", ">= 99" if asked else "none", 100 * float((extra < NEAR_PX).mean()), "%", len(extra))
        yield Figure(f"{row}: centroid difference, median", "< 0.1" if asked else "none", float(np.median(near)), "px", len(near))


def detection(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Time for one image of 300 markers, with the threshold given and not."""
    places = _apart(300, 24.0, np.random.default_rng(1))
    image = _rendered(places, 7.0, "disc", 0.01, np.random.default_rng(2))
    ways: dict[str, tuple[str, Callable[[], Any]]] = {
        "detection, 1280 x 1024, 300 blobs, one core": ("< 2", lambda: find_blobs(image, BlobSettings(threshold=60))),
        "detection, 1280 x 1024, 300 blobs, one core, threshold told from the image": ("< 2", lambda: find_blobs(image)),
    }
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        for row, (asked, run) in ways.items():
            assert len(run()) == 300, row
            milliseconds = 1e3 * _seconds(run, 11 if benchmark.quick else 101)
            yield Figure(row, asked, milliseconds, "ms", 300)
    finally:
        cv2.setNumThreads(threads)


def centroids(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Centroids of rendered markers against where they were drawn."""
    for shape in ("disc", "gaussian"):
        for diameter in (3.0, 6.0, 10.0):
            away, noise = [], 0.01
            for seed in range(1 if benchmark.quick else 4):
                rng = np.random.default_rng(seed)
                places = _apart(300, 40.0, rng)
                found = find_blobs(_rendered(places, diameter, shape, noise, rng)).xy
                away.append((found[cKDTree(found).query(places)[1]] - places).ravel())
            rms, count = float(np.sqrt((np.concatenate(away) ** 2).mean())), sum(map(len, away))
            row = f"centroids of rendered markers, {shape}, {diameter:.0f} px, noise 1 % of the scale"
            yield Figure(row, "none", rms, "px RMS per axis", count)


def _files() -> Path:
    return folder() / "cameras" / "particles-4cam"


def _image(camera: int, step: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.imread(str(_files() / "images" / f"cam{camera}.{step}"), cv2.IMREAD_UNCHANGED))


def _targets(camera: int, step: int) -> Floats:
    """The peer's targets (N, 2) px, in our axes."""
    return np.loadtxt(_files() / "images" / f"cam{camera}.{step}_targets", skiprows=1)[:, 1:3] - CORNER


def _as_the_peer(image: NDArray[np.uint8], camera: int) -> Floats:
    """Blobs by the settings in the peer's parameter file; its peaks exceed twice the threshold."""
    numbers = [int(word) for word in (_files() / "parameters" / "targ_rec.par").read_text().split()]
    threshold, step, fewest, most, narrow, _, low, _, weight = numbers[camera - 1], *numbers[4:12]
    settings = BlobSettings(
        threshold=threshold,
        background=WINDOW,
        weight_reference="background",
        min_peak=2 * threshold,
        step=step,
        min_size=2 * np.sqrt((fewest - 0.1) / np.pi),
        max_size=2 * np.sqrt((most + 0.1) / np.pi),
        min_width=min(narrow, low),
        min_weight=weight + 1,
    )
    return _whole_blobs(find_blobs(image, settings))


def _whole_blobs(blobs: ImageBlobs) -> Floats:
    return blobs.xy[blobs.flags & Flag.AT_BORDER == 0]


def _apart(count: int, distance: float, rng: np.random.Generator) -> Floats:
    """Places (count, 2) px in the image, none within `distance` of another or of the edge."""
    places: list[Floats] = []
    while len(places) < count:
        place = rng.uniform([distance, distance], np.array(SIZE) - distance)
        if not places or np.linalg.norm(np.array(places) - place, axis=1).min() > distance:
            places.append(place)
    return np.array(places)


def _rendered(places: Floats, diameter: float, shape: str, noise: float, rng: np.random.Generator) -> NDArray[Any]:
    none = np.zeros(len(places))
    blobs = Blobs.from_rows(none, none, places, ["one"], sizes=none + diameter)
    return next(render_images(blobs, 0, SIZE, RenderSettings(shape=shape, noise=noise), rng=rng))


def _seconds(run: Callable[[], Any], repeats: int) -> float:
    run()
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        run()
        times.append(time.perf_counter() - started)
    return median(times)
