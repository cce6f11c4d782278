"""What a reconstruction is: 3D points, and how sure each is."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import NDArray
import numpy as np

from asterism.recording import Clouds, Floats, Ints


@dataclass(frozen=True)
class Reconstruction:
    """Points from blobs, with what each rests on.

    clouds       the points, frame by frame
    residual     (P,) px, the reprojection error of each point: RMS over its cameras of the distance between blob and projection
    covariance   (P, 3, 3) m2, from the rays' Jacobian and the pixel noise
    rays         (P, C) int: the blob of each camera that shows the point, its place in `Blobs.xy`; -1 where none does
    camera_names (C,) the cameras, in the order of `rays`
    noise        (C,) px, the pixel noise per axis that was given or told from the blobs
    method       "global" or "plain"
    unused       (T, C) int: blobs that belong to no point
    gated        (T,) int: pairs of blobs that passed the epipolar gate
    proved       (T,) bool: whether the choice among the frame's hypotheses is proved to be the best; all False for "plain"
    remarks      what a user should know, one sentence each
    """

    clouds: Clouds
    residual: Floats
    covariance: Floats
    rays: Ints
    camera_names: tuple[str, ...]
    noise: Floats
    method: str
    unused: Ints
    gated: Ints
    proved: NDArray[np.bool_]
    remarks: tuple[str, ...] = ()

    @property
    def cameras(self) -> NDArray[np.bool_]:
        """(P, C) which cameras each point was made from."""
        return self.rays >= 0

    @property
    def deviation(self) -> Floats:
        """(P,) m, the standard deviation of each point: the root of its covariance's trace."""
        spread: Floats = np.sqrt(np.trace(self.covariance, axis1=1, axis2=2))
        return spread
