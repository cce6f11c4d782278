"""What the kernels of this room take: a body, and what is known of its pose beforehand, as flat arrays."""

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


class PosePrior(NamedTuple):
    """What is known before any image.

    vertical (3,); scale_usual (3,); scale_precision (2,): of the common scale, and of each scale's difference from it; tilt_precision rad-2
    """

    vertical: Floats
    scale_usual: Floats
    scale_precision: Floats
    tilt_precision: float
