"""What the kernels of this room take beside a body: cameras and the model of observation, as flat arrays."""

from __future__ import annotations

from typing import NamedTuple

from asterism.recording import Floats


class PinholeArrays(NamedTuple):
    """Pinholes without lenses: blobs are undistorted before. Pixels are of the undistorted image around the principal point.

    rotations (C, 3, 3), translations (C, 3) m: camera from world; focals (C, 2) px; eyes (C, 3) m; limits (C, 4) px: left, right, top,
    bottom; detected (C,): how often a camera has a blob of what it sees, as a share of what is usual
    """

    rotations: Floats
    translations: Floats
    focals: Floats
    eyes: Floats
    limits: Floats
    detected: Floats


class Observing(NamedTuple):
    """How blobs come about.

    noise    px, standard deviation of a blob's x and y
    strays   blobs per px2 that show no marker
    occlusion_tolerance, softness, clearance m; hidden, shown: see `visible_shares` and `sight_depths`; infinite tolerance: all are shown
    reach    px, `nearest` alone: distances above it do not count
    nearest  whether each visible marker takes its nearest blob (the paper's eq. 7), or blobs are shared among markers
    """

    noise: float
    strays: float
    occlusion_tolerance: float
    softness: float
    hidden: float
    shown: float
    clearance: float
    reach: float
    nearest: bool
