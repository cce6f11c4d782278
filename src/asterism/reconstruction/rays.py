"""Blobs in; their rays, without the blobs that have none, out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.cameras import Rig
from asterism.cameras.lens_kernels import pixel_jacobian
from asterism.reconstruction._frame_kernels import RayArrays
from asterism.reconstruction._input_kernels import RigArrays, first_of_duplicates, rays_of_frame
from asterism.recording import Blobs, Floats


@dataclass(frozen=True)
class BlobRays:
    """Blobs as rays.

    blobs       those that have a ray
    normalised  (B, 2) where the ray crosses its camera's normalised image plane
    jacobian    (B, 4) px, how far the blob moves when its ray does: du/dx, du/dy, dv/dx, dv/dy
    """

    blobs: Blobs
    normalised: Floats
    jacobian: Floats

    @property
    def arrays(self) -> RayArrays:
        """The rays as the kernels take them."""
        return RayArrays(self.normalised, self.jacobian, self.blobs.offsets)


def to_rays(blobs: Blobs, rig: Rig) -> tuple[BlobRays, int, int]:
    """The rays of all blobs; how many blobs were left out because the lens model has no ray there, and how many as duplicates."""
    normalised = np.empty_like(blobs.xy)
    camera_of = blobs.camera_of
    for number, camera in enumerate(rig):
        rows = np.nonzero(camera_of == number)[0]
        normalised[rows] = camera.undistort(blobs.xy[rows])
    reached = np.isfinite(normalised).all(axis=1)
    single = np.empty(len(normalised), dtype=np.bool_)
    first_of_duplicates(blobs.xy, blobs.offsets, single)
    kept = reached & single
    if not kept.all():
        blobs, normalised, camera_of = blobs.select(kept), normalised[kept], camera_of[kept]
    jacobian = np.empty((len(normalised), 4))
    for number, camera in enumerate(rig):
        rows = np.nonzero(camera_of == number)[0]
        of_camera = np.empty((len(rows), 4))
        pixel_jacobian(camera.lens, normalised[rows], of_camera)
        jacobian[rows] = of_camera
    return BlobRays(blobs, normalised, jacobian), int((~reached).sum()), int((reached & ~single).sum())


def frame_to_rays(blobs: Blobs, arrays: RigArrays) -> tuple[BlobRays, int, int]:
    """What `to_rays` gives, for a single frame: in one call of a kernel, so that other threads hold it up less. arrays: of the rig."""
    normalised, jacobian = np.empty_like(blobs.xy), np.empty((len(blobs.xy), 4))
    single = np.empty(len(blobs.xy), dtype=np.bool_)
    rays_of_frame(arrays.cameras, blobs.xy, blobs.offsets, normalised, jacobian, single)
    reached = np.isfinite(normalised).all(axis=1)
    kept = reached & single
    if not kept.all():
        blobs, normalised, jacobian = blobs.select(kept), normalised[kept], jacobian[kept]
    return BlobRays(blobs, normalised, jacobian), int((~reached).sum()), int((reached & ~single).sum())
