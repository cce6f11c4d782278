"""A rig from a waved wand, with all that speaks for and against it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from asterism.calibration.wand.identify import Wand
from asterism.cameras.bundle import Sightings
from asterism.cameras.rig import Rig
from asterism.findings import Finding, Severity, worst
from asterism.recording import Floats, Ints

SCALE_UNKNOWN, UPSIDE_DOWN = "wand-no-scale", "wand-looks-up"
"""The codes of findings that a world frame settles: the scale of the rig, and which way is up."""


@dataclass(frozen=True)
class WandCalibration:
    """A rig from a waved wand, and what speaks for and against it.

    rig             the cameras that could be calibrated; its world is level by the cameras' own sense of up until a floor is given
    wand            what was waved
    frames          how many the recording has
    sightings       the wand's markers in the images that were used: frames are those of the recording (of the common clock, where
                    cameras were not triggered together), cameras are places in the rig
    residuals       (n, 2) px, seen minus projected, per sighting
    positions       (m, K, 3) m, the markers of the wand in `used`, each triangulated by itself, without knowing the wand; NaN where only
                    one camera saw it
    used            (m,) the frames that were used
    sigma           (C, 15) standard deviation of each camera's parameters, see `bundle.PARAMETERS`
    position_sigma  (C,) m, of the camera's position, relative to all cameras
    noise           px, standard deviation of one coordinate of a blob
    lag_frames      (C,) by how many frames each camera started late; its images were shifted by as many
    rejected_share  (C,) share of each camera's images of the wand that did not fit those of the others and were left out
    rejected_parts  (C, 10) the same of each tenth of the recording; NaN where it hardly shows the wand
    static_lights   (C,) how many lights of each camera never moved; they were left out
    inner_marker_m  m, where the inner one of three markers sits by all images that show it, used or not; NaN for other wands
    excluded        cameras that could not be calibrated, each with the reason and what to do
    findings        what to know before using the rig, most severe first
    """

    rig: Rig
    wand: Wand
    frames: int
    sightings: Sightings
    residuals: Floats
    positions: Floats
    used: Ints
    sigma: Floats
    position_sigma: Floats
    noise: float
    lag_frames: Ints
    rejected_share: Floats
    rejected_parts: Floats
    static_lights: Ints
    inner_marker_m: float
    excluded: Mapping[str, tuple[str, str]]
    findings: tuple[Finding, ...] = ()

    @property
    def usable(self) -> bool:
        """Whether no finding is an error."""
        return worst(self.findings) < Severity.ERROR

    @property
    def lengths(self) -> Floats:
        """(m,) m, the whole wand as measured in each frame without knowing it; NaN where an end was seen by fewer than two cameras."""
        return np.asarray(np.linalg.norm(self.positions[:, -1] - self.positions[:, 0], axis=1), dtype=np.float64)

    @property
    def mean_rejected_share(self) -> float:
        """The mean share of the wand's images that did not fit and were left out."""
        return float(self.rejected_share.mean())

    @property
    def rms(self) -> float:
        """px, the reprojection error: root of the mean squared distance."""
        return float(np.sqrt(np.square(self.residuals).sum(axis=1).mean()))

    def moved(self, rig: Rig, rotation: ArrayLike, translation: ArrayLike, scale: float = 1.0) -> WandCalibration:
        """The same in another world frame, of which `rig` is the rig: X becomes scale rotation X + translation (3,) m.

        Findings that a given world frame settles are dropped: which way is up, and with a scale, how large the rig is.
        """
        positions = scale * self.positions @ np.asarray(rotation).T + np.asarray(translation)
        settled = (UPSIDE_DOWN,) if scale == 1.0 else (UPSIDE_DOWN, SCALE_UNKNOWN)
        findings = tuple(finding for finding in self.findings if finding.code not in settled)
        return replace(self, rig=rig, positions=positions, position_sigma=scale * self.position_sigma, findings=findings)
