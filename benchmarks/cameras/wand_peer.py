"""The same wand recording adjusted by a peer, aniposelib, where it is installed: time, focal lengths, points that it has not seen."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec

import numpy as np

from asterism.calibration.wand import calibrate_wand
from asterism.cameras import Camera, Rig
from asterism.cameras.bundle import Sightings, locate
from asterism.errors import AsterismError
from asterism.geometry import vector_from_rotation
from asterism.recording import Floats
from asterism.simulation.cameras import ImagingSettings, ring_rig, simulate_wand
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.cameras.wand import CAMERAS, FRAMES, NOISE, UNSEEN, WAND, points_error, volume
from benchmarks.figures import Figure


@dataclass(frozen=True)
class PeerSettings:
    """How the peer adjusts: whether the second radial coefficient is free, when it stops, and where it takes principal points from.

    It has one focal length a camera and cannot free principal points or tangential distortion.
    """

    name: str
    second_radial: bool
    tolerance: float
    true_centres: bool


SETTINGS = (
    PeerSettings("as it comes", False, 1e-4, False),
    PeerSettings("k2 free, ftol 1e-6, true principal points given", True, 1e-6, True),
)
"""Its defaults, and what these rigs need: lenses with two radial coefficients and principal points off the centre."""


def wand_peer(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """aniposelib's bundle adjustment on the images that our calibration identified, from focal lengths 1 % and places 2 cm off.

    It knows no wand: its size is set afterwards by the mean length. Its points begin where ours would (its own way to triangulate
    needs one more package). Nothing is measured where it is not installed.
    """
    if find_spec("aniposelib") is None:
        raise AsterismError("aniposelib is not installed: pip install aniposelib")
    rng = np.random.default_rng(1)
    rig = ring_rig(CAMERAS, rng=rng)
    blobs, _ = simulate_wand(rig, WAND, 200 if benchmark.quick else FRAMES, settings=ImagingSettings(noise=NOISE), rng=rng)
    made = calibrate_wand(blobs, WAND, sizes={camera.name: camera.size for camera in rig})
    sightings = replace(made.sightings, frame=np.searchsorted(made.used, made.sightings.frame))
    off = 0.02 * rng.normal(size=(len(made.rig), 3))
    unseen = volume(rng)
    for settings in SETTINGS:
        start = [_off(camera, rig[camera.name], step, settings) for camera, step in zip(made.rig, off, strict=True)]
        started = time.perf_counter()
        found = _adjusted(start, sightings, len(made.used), settings)
        seconds = time.perf_counter() - started
        there = locate(found.cameras, sightings, len(made.used), len(WAND))
        length = float(np.nanmean(np.linalg.norm(there[:, -1] - there[:, 0], axis=1)))
        found = found.moved(np.eye(3), np.zeros(3), WAND[-1] / length)
        focal = [abs(camera.focal[0] / rig[camera.name].focal[0] - 1.0) for camera in found]
        error = points_error(rig, found, unseen, NOISE, np.random.default_rng(2))
        row = f"wand, {CAMERAS} cameras, {FRAMES:,} frames, {NOISE} px, aniposelib from 1 % off, {settings.name}"
        yield Figure(f"{row}: its adjustment, one core", "none", seconds, "s", 1)
        yield Figure(f"{row}: focal length, RMS", "none", 100.0 * float(np.sqrt(np.mean(np.square(focal)))), "%", len(focal))
        yield Figure(f"{row}: 3D of unseen points, their blobs with noise, RMS", "none", 1000.0 * error, "mm", UNSEEN)


def _off(camera: Camera, true: Camera, step: Floats, settings: PeerSettings) -> Camera:
    """Where the peer begins."""
    assert camera.size
    middle = (0.5 * (camera.size[0] - 1), 0.5 * (camera.size[1] - 1))
    return replace(
        camera,
        focal=(1.01 * camera.focal[0],) * 2,
        centre=true.centre if settings.true_centres else middle,
        translation=camera.translation + step,
        radial=(0.0, 0.0, 0.0),
        tangential=(0.0, 0.0),
    )


def _adjusted(start: Sequence[Camera], sightings: Sightings, frames: int, settings: PeerSettings) -> Rig:
    """The rig that the peer arrives at."""
    from aniposelib.cameras import Camera as PeerCamera
    from aniposelib.cameras import CameraGroup

    seen = np.full((len(start), frames * len(WAND), 2), np.nan)
    seen[sightings.camera, sightings.frame * len(WAND) + sightings.point] = sightings.xy
    points = locate(list(start), sightings, frames, len(WAND)).reshape(-1, 3)

    class Group(CameraGroup):
        def triangulate(self, *_: object, **__: object) -> Floats:
            return points

        def average_error(self, *_: object, **__: object) -> float:
            return 0.0

    placed = [(camera, vector_from_rotation(camera.rotation)) for camera in start]
    group = Group(
        [
            PeerCamera(
                camera.matrix, camera.distortion, camera.size, turn, camera.translation, camera.name, extra_dist=settings.second_radial
            )
            for camera, turn in placed
        ]
    )
    group.bundle_adjust(seen, ftol=settings.tolerance, verbose=False)
    return Rig(
        tuple(
            Camera.from_opencv(
                peer.get_name(),
                peer.get_camera_matrix(),
                peer.get_distortions(),
                np.ravel(peer.get_rotation()),
                np.ravel(peer.get_translation()),
            )
            for peer in group.cameras
        )
    )
