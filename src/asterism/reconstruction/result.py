"""What a reconstruction is: 3D points, and the blobs that each of them rests on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Rig
from asterism.findings import Finding
from asterism.formats import write_points
from asterism.recording import Blobs, Clouds, Evidence, Floats, Ints
from asterism.tracking.columns import columns_of


@dataclass(frozen=True)
class Reconstruction:
    """Points from blobs, with what each rests on.

    clouds         the points, frame by frame
    residual       (P,) px, the reprojection error of each point: RMS over its cameras of the distance between blob and projection
    covariance     (P, 3, 3) m2, from the rays' Jacobian and the pixel noise
    scale          (P,) m/px: how far a pixel of residual is at the point, the mean over its cameras
    rays           (P, C) int: the blob of each camera that shows the point, its place in `blobs.xy`; -1 where none does
    blobs          the blobs that were used: those given, on a common clock, without blobs that have no ray and duplicates
    noise          (C,) px per axis, the pixel noise that was given or estimated from the blobs
    method         "global", "plain" or "plain-covariance"
    unused         (T, C) int: blobs that show no point
    gated          (T,) int: pairs of blobs that passed the epipolar gate
    proved         (T,) bool: whether the choice among the frame's hypotheses is proved to be the best; never by the other methods
    masked_places  (C,) int: places of each image that were left out because what they show never moves
    findings       what a user should know
    noise_known    whether the noise was given or could be estimated: False where points are too few, or the blobs do not fit the rig
    """

    clouds: Clouds
    residual: Floats
    covariance: Floats
    scale: Floats
    rays: Ints
    blobs: Blobs
    noise: Floats
    method: str
    unused: Ints
    gated: Ints
    proved: NDArray[np.bool_]
    masked_places: Ints
    findings: tuple[Finding, ...] = ()
    noise_known: bool = True

    @property
    def cameras(self) -> NDArray[np.bool_]:
        """(P, C) the cameras that show each point."""
        return self.rays >= 0

    @property
    def evidence(self) -> Evidence:
        """What each point rests on, as files keep it."""
        return Evidence(self.residual, self.covariance, self.cameras, self.blobs.cameras, self.scale)

    def with_points(self, clouds: Clouds, covariance: Floats, rig: Rig) -> Reconstruction:
        """The same points at other places, those of `clouds`, with covariance (P, 3, 3) m2; residuals are those of the new places."""
        square, taken = np.zeros(len(self.rays)), self.cameras
        for c, camera in enumerate(rig.select(self.blobs.cameras)):
            seen = taken[:, c]
            error = camera.project(clouds.xyz[seen]) - self.blobs.xy[self.rays[seen, c]]
            square[seen] += (error**2).sum(axis=1)
        residual: Floats = np.sqrt(square / taken.sum(axis=1))
        return replace(self, clouds=clouds, covariance=covariance, residual=residual)

    def write(self, path: str | Path) -> list[str]:
        """Write the points in the format of the suffix, as `asterism.formats.write_points` does. Returns what the file cannot hold."""
        return write_points(path, self.clouds, self.evidence, columns_of(self.clouds))

    @property
    def deviation(self) -> Floats:
        """(P,) m, the standard deviation of each point's position: the root of its covariance's trace."""
        spread: Floats = np.sqrt(np.trace(self.covariance, axis1=1, axis2=2))
        return spread
