"""The options of a reconstruction, checked."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from asterism.errors import AsterismError
from asterism.recording import Floats

METHODS = ("global", "plain", "plain-covariance")


@dataclass(frozen=True)
class ReconstructionSettings:
    """How points are made from blobs.

    method       "global": each blob shows one point at most, and of all sets of points the likeliest is chosen, frame by frame;
                 "plain": the thesis' algorithms 3.1 and 3.2, versions of a point merged within the sensitivity S, with their ghosts;
                 "plain-covariance": the same, but versions are merged within `gate` deviations of their distance
    noise        px, standard deviation of a blob's position per axis; None: estimated from the blobs themselves
    min_cameras  how many cameras must show a point, at least 2
    gate         how many standard deviations a blob may lie from where a point should show, 1 to 20. At 4, one blob in 3,000 is lost by
                 noise alone; a wider gate makes more hypotheses and more ghosts
    volume       (2, 3) m, two opposite corners of the box in which points may be; None: anywhere
    mask_static  leave out blobs that stay at one position of their image in three of four frames: lamps, reflections, resting markers
    """

    method: str = "global"
    noise: float | None = None
    min_cameras: int = 2
    gate: float = 4.0
    volume: ArrayLike | None = None
    mask_static: bool = False

    def check(self, cameras: int) -> None:
        """Raise AsterismError where an option is out of range for a rig of so many cameras."""
        if self.method not in METHODS:
            raise AsterismError(f"there is no method {self.method}; choose one of {', '.join(METHODS)}.")
        if self.noise is not None and not 0 < self.noise < math.inf:
            raise AsterismError(f"pixel noise of {self.noise} px is not possible; give a positive number, or none to have it measured.")
        if not 2 <= self.min_cameras <= cameras:
            raise AsterismError(
                f"points of at least {self.min_cameras} cameras are not possible with {cameras}; choose a number from 2 to {cameras}."
            )
        if not 1 <= self.gate <= 20:
            raise AsterismError(f"a gate of {self.gate} standard deviations is out of range; choose 1 to 20, such as 4.")

    @property
    def corners(self) -> Floats:
        """(2, 3) m, lowest and highest corner of the volume; infinite where there is none. Raises AsterismError for another shape."""
        if self.volume is None:
            return np.array([[-np.inf] * 3, [np.inf] * 3])
        corners = np.asarray(self.volume, dtype=np.float64)
        if corners.shape != (2, 3) or not np.isfinite(corners).all() or not (corners[0] != corners[1]).all():
            raise AsterismError("the volume needs two opposite corners, (2, 3) finite metres that differ in all axes.")
        return np.sort(corners, axis=0)
