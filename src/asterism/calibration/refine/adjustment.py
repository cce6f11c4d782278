"""A rig and which of its cameras were moved in; the rig adjusted to all points that its cameras show, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.calibration.refine.subset import blobs_of
from asterism.cameras import Rig
from asterism.cameras.bundle import PARAMETERS, AdjustSettings, Sightings, adjust, free_parameters
from asterism.reconstruction.camera_fit import fit_of_cameras
from asterism.reconstruction.reconstruct import reconstruct
from asterism.reconstruction.settings import ReconstructionSettings
from asterism.recording import Blobs, Floats


@dataclass(frozen=True)
class RigFit:
    """An adjusted rig; for each camera its error and how far it is off as a whole (C,) px, NaN where nothing tells; how many blobs show
    the points; the standard deviations of focal lengths (C,) px, 0 where they were held."""

    rig: Rig
    errors: Floats
    off: Floats
    sightings: int
    focal_sigma: Floats


def adjust_rig(blobs: Blobs, rig: Rig, moved: list[int], cameras: list[int], noise: float, zoomed: Sequence[int] = ()) -> RigFit:
    """The moved cameras' poses, and focal lengths of those zoomed, by all points that three cameras or more show, the others held."""
    order = sorted(cameras)
    own = blobs_of(blobs, order)
    part = Rig(tuple(rig[c] for c in order), rig.vertical)
    reconstructed = reconstruct(own, part, ReconstructionSettings(noise=noise, min_cameras=min(3, len(order))))
    errors, off, sigma = np.full(len(rig), np.nan), np.full(len(rig), np.nan), np.zeros(len(rig))
    if not len(reconstructed.rays):
        return RigFit(rig, errors, off, 0, sigma)
    off[order] = [camera.systematic for camera in fit_of_cameras(reconstructed, part)]
    point, camera = np.nonzero(reconstructed.rays >= 0)
    sightings = Sightings.of(point, camera, np.zeros(len(point), dtype=np.int64), reconstructed.blobs.xy[reconstructed.rays[point, camera]])
    free = free_parameters(len(order), "pose")
    free[[i for i, c in enumerate(order) if c not in moved]] = False
    free |= free_parameters(len(order), "focal") & np.array([c in zoomed for c in order])[:, None]
    points = reconstructed.clouds.xyz
    turned = np.tile(np.eye(3), (len(points), 1, 1))
    with_sigma = len(zoomed) > 0
    settings = AdjustSettings(scale=3.0 * noise, covariance=with_sigma)
    result = adjust(list(part), np.zeros((1, 3)), sightings, turned, points, free=free, settings=settings)
    cameras_now = list(rig.cameras)
    for i, c in enumerate(order):
        errors[c] = result.cameras[i].error
        if c in moved:
            cameras_now[c] = result.cameras[i]
    if with_sigma:
        sigma[order] = np.nan_to_num(result.sigma[:, PARAMETERS.index("focal")])
    return RigFit(replace(rig, cameras=tuple(cameras_now)), errors, off, len(sightings), sigma)
