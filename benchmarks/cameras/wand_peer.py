"""The same wand recording adjusted by a peer, aniposelib, where it is installed: time, focal lengths, points that it has not seen."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from asterism.calibration.wand import calibrate_wand
from asterism.cameras import Camera, Rig
from asterism.cameras.bundle import locate
from asterism.geometry import vector_from_rotation
from asterism.recording import Floats
from asterism.simulation.cameras import ImagingSettings, ring_rig, simulate_wand
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.cameras.wand import CAMERAS, FRAMES, NOISE, UNSEEN, WAND, points_error, volume
from benchmarks.figures import Figure


def wand_peer(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """aniposelib's bundle adjustment on the images that our calibration identified, from focal lengths 1 % and places 2 cm off.

    It knows no wand: its size is set afterwards by the mean length. Its points begin where ours would (its own way to triangulate
    needs one more package). Nothing is measured where it is not installed.
    """
    try:
        from aniposelib.cameras import Camera as PeerCamera
        from aniposelib.cameras import CameraGroup
    except ImportError:
        benchmark.report("aniposelib is not installed: pip install aniposelib")
        return
    rng = np.random.default_rng(1)
    rig = ring_rig(CAMERAS, rng=rng)
    blobs, _ = simulate_wand(rig, WAND, 200 if benchmark.quick else FRAMES, settings=ImagingSettings(noise=NOISE), rng=rng)
    made = calibrate_wand(blobs, WAND, sizes={camera.name: camera.size for camera in rig})
    sightings = replace(made.sightings, frame=np.searchsorted(made.used, made.sightings.frame))
    seen = np.full((len(made.rig), len(made.used) * len(WAND), 2), np.nan)
    seen[sightings.camera, sightings.frame * len(WAND) + sightings.point] = sightings.xy
    start = [
        replace(
            camera,
            focal=(1.01 * camera.focal[0],) * 2,
            centre=(0.5 * (camera.size[0] - 1), 0.5 * (camera.size[1] - 1)),
            translation=camera.translation + 0.02 * rng.normal(size=3),
            radial=(0.0, 0.0, 0.0),
            tangential=(0.0, 0.0),
        )
        for camera in made.rig
    ]
    points = locate(start, sightings, len(made.used), len(WAND)).reshape(-1, 3)

    class Group(CameraGroup):
        def triangulate(self, *_: object, **__: object) -> Floats:
            return points

        def average_error(self, *_: object, **__: object) -> float:
            return 0.0

    group = Group(
        [
            PeerCamera(
                camera.matrix, camera.distortion, camera.size, vector_from_rotation(camera.rotation), camera.translation, camera.name
            )
            for camera in start
        ]
    )
    started = time.perf_counter()
    group.bundle_adjust(seen, verbose=False)
    seconds = time.perf_counter() - started
    found = Rig(
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
    there = locate(found.cameras, sightings, len(made.used), len(WAND))
    length = float(np.nanmean(np.linalg.norm(there[:, -1] - there[:, 0], axis=1)))
    found = found.moved(np.eye(3), np.zeros(3), WAND[-1] / length)
    focal = [abs(camera.focal[0] / rig[camera.name].focal[0] - 1.0) for camera in found]
    row = f"wand, {CAMERAS} cameras, {FRAMES:,} frames, {NOISE} px, aniposelib from 1 % off"
    yield Figure(f"{row}: its adjustment, one core", "none", seconds, "s", 1)
    yield Figure(f"{row}: focal length, RMS", "none", 100.0 * float(np.sqrt(np.mean(np.square(focal)))), "%", len(focal))
    yield Figure(
        f"{row}: 3D of unseen points, their blobs with noise, RMS",
        "none",
        1000.0 * points_error(rig, found, volume(rng), NOISE, rng),
        "mm",
        UNSEEN,
    )
