"""What the kernels of this room take: a body, cameras, what is known beforehand and the model of observation, as flat arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.recording import Floats, Ints


class ArticulatedBodyArrays(NamedTuple):
    """A body model on flat arrays; rest positions are relative to the root's pivot, in metres.

    parents (B,), pivots (B, 3), hinge_starts (B + 1,), axes (J, 3), moves (B, J), low, high, usual (J,) rad, precision (J,) rad-2: bones
    and hinges; bones (M,), places (M, 3), spreads (M,) m: markers; capsule_bones (2K,), capsule_ends (2K, 3): starts, then ends;
    radii (K, 2) m
    """

    parents: Ints
    pivots: Floats
    hinge_starts: Ints
    axes: Floats
    moves: NDArray[np.bool_]
    low: Floats
    high: Floats
    usual: Floats
    precision: Floats
    bones: Ints
    places: Floats
    spreads: Floats
    capsule_bones: Ints
    capsule_ends: Floats
    radii: Floats


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


class Known(NamedTuple):
    """What is known before any image.

    vertical (3,); scale_usual (3,); scale_precision (2,): of the common scale, and of each scale's difference from it; tilt_precision rad-2
    """

    vertical: Floats
    scale_usual: Floats
    scale_precision: Floats
    tilt_precision: float


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
