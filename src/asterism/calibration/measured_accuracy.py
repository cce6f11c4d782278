"""A rig and what its cameras saw of a wand or of still markers in; measured positions out, for `wand_accuracy` and `repeatability`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from asterism.calibration.wand.identify import identify, wand_of
from asterism.calibration.wand.poses import locate_wand
from asterism.calibration.wand.world import still_points
from asterism.cameras.bundle import Sightings
from asterism.cameras.bundle.locate import locate
from asterism.cameras.camera import Camera
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.recording import Blobs, Floats, Ints

GATE = 5.0
"""px, how far a blob may lie from where the others put its marker."""


def measure_wand(rig: Rig, blobs: Blobs, lengths: Sequence[float]) -> Floats:
    """Where a rig measures the markers of a waved wand: (T, K, 3) m, each composed by itself, without its lengths; NaN where not seen.

    lengths  m, the places of its two or three markers along the wand, ascending, in the order in which positions come
    Raises AsterismError where lengths are not increasing positive numbers, or fewer than two of the blobs' cameras are in the rig.
    """
    wand = wand_of(lengths)
    cameras = _cameras(rig, blobs)
    found = locate_wand(blobs, identify(blobs, wand), wand, cameras, GATE)
    shared = found.sightings(blobs)
    return _located(cameras, shared.frame, shared.camera, shared.point, shared.xy, (len(blobs), len(wand.lengths)))


def measure_still(rig: Rig, blobs: Blobs) -> Floats:
    """Where a rig measures what stands still, in each frame: (T, M, 3) m, NaN where fewer than two cameras see it.

    Raises AsterismError where nothing stands still in two cameras, or fewer than two of the blobs' cameras are in the rig.
    """
    cameras = _cameras(rig, blobs)
    points = still_points(rig, blobs)
    if not len(points):
        raise AsterismError("nothing stands still before two cameras; leave a marker on the floor while you record.")
    frame, camera, point, xy = [], [], [], []
    owner, when = blobs.camera_of, blobs.frame_of
    for c, own in enumerate(cameras):
        if own is None:
            continue
        rows = np.nonzero(owner == c)[0]
        off = np.linalg.norm(blobs.xy[rows, None] - own.project(points)[None], axis=2)
        for m in range(len(points)):
            near = rows[off[:, m] < GATE]
            near = near[np.argsort(off[off[:, m] < GATE, m], kind="stable")]
            near = near[np.unique(when[near], return_index=True)[1]]  # the nearest of each frame
            frame.append(when[near])
            camera.append(np.full(len(near), c))
            point.append(np.full(len(near), m))
            xy.append(blobs.xy[near])
    shape = len(blobs), len(points)
    return _located(cameras, np.concatenate(frame), np.concatenate(camera), np.concatenate(point), np.concatenate(xy), shape)


def _cameras(rig: Rig, blobs: Blobs) -> list[Camera | None]:
    cameras = [rig[name] if name in rig.names else None for name in blobs.cameras]
    if sum(camera is not None for camera in cameras) < 2:
        raise AsterismError(
            f"the blobs come from cameras {', '.join(blobs.cameras)}, the rig has {', '.join(rig.names)}: rename them, two must be in both."
        )
    return cameras


def _located(cameras: list[Camera | None], frame: Ints, camera: Ints, point: Ints, xy: Floats, shape: tuple[int, int]) -> Floats:
    seen = Sightings.of(frame, camera, point, xy).among(cameras)
    return locate([own for own in cameras if own is not None], seen, *shape)
