"""Blobs in; the rays that they are, without the blobs that cannot be one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Rig
from asterism.reconstruction import _kernels
from asterism.recording import Blobs, Floats


@dataclass(frozen=True)
class Rays:
    """Blobs as rays: flat (B, 2) on each camera's normalized plane, slopes (B, 4) px: how far a blob moves when its ray does."""

    blobs: Blobs
    flat: Floats
    slopes: Floats


def rays_of(blobs: Blobs, rig: Rig) -> tuple[Rays, int, int]:
    """The rays of all blobs; how many blobs were left out because the lens model leads no ray there, and because they are there twice."""
    flat = np.empty_like(blobs.xy)
    camera_of = blobs.camera_of
    for number, camera in enumerate(rig):
        mine = np.nonzero(camera_of == number)[0]
        flat[mine] = camera.undistort(blobs.xy[mine])
    reached = np.isfinite(flat).all(axis=1)
    single = np.empty(len(flat), dtype=np.bool_)
    _kernels.first_of_equals(blobs.xy, blobs.offsets, single)
    kept = reached & single
    if not kept.all():
        blobs, flat, camera_of = only(blobs, kept), flat[kept], camera_of[kept]
    slopes = np.empty((len(flat), 4))
    for number, camera in enumerate(rig):
        mine = np.nonzero(camera_of == number)[0]
        share = np.empty((len(mine), 4))
        _kernels.lens_slopes(camera.lens, flat[mine], share)
        slopes[mine] = share
    return Rays(blobs, flat, slopes), int((~reached).sum()), int((reached & ~single).sum())


def only(blobs: Blobs, kept: NDArray[np.bool_]) -> Blobs:
    """Some of the blobs; `kept` (P,) says which."""
    before = np.concatenate([[0], np.cumsum(kept)])
    return replace(blobs, xy=blobs.xy[kept], offsets=before[blobs.offsets].astype(np.int64), sizes=blobs.sizes[kept])
