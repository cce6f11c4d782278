"""What became of each camera of a rig, and what a person should know about it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from asterism.cameras import Rig
from asterism.findings import Finding, Severity
from asterism.synchronization.lags import out_of_step


@dataclass(frozen=True)
class CameraCheck:
    """How one camera fits what the others see.

    name        of the camera
    moved_px    median distance by which its view has moved from where the rig has it; NaN where too little is known
    rms_px      RMS reprojection error of the points that it shows, with the refined rig
    turned      rad, and shifted m: how far the refined camera is from the rig's
    zoomed      share by which its focal length changed, 0 where no change is certain
    shown       share of the points in its image that it shows, with its refined pose
    points      points of the others that it could be compared with
    state       "good", "moved" (and posed anew), "out of step", "lost" (it does not fit, and no new pose was found) or "unknown" (too
                little to compare)
    lag_frames  frames by which it is behind the others
    place_of    another camera of the rig in whose place it stands with its refined pose, else ""
    """

    name: str
    moved_px: float
    rms_px: float
    turned: float
    shifted: float
    zoomed: float
    shown: float
    points: int
    state: str
    lag_frames: int
    place_of: str


@dataclass(frozen=True)
class Refinement:
    """A refined rig: those cameras that were moved have new poses, the others are as they were.

    rig      all cameras; those that are lost keep their old pose
    cameras  (C,) what became of each
    noise    px, standard deviation of one coordinate of a blob
    frames   how many frames were used
    """

    rig: Rig
    cameras: tuple[CameraCheck, ...]
    noise: float
    frames: int

    @property
    def findings(self) -> tuple[Finding, ...]:
        """One for each camera that is not good."""
        return tuple(finding for check in self.cameras for finding in _findings(check))


def _findings(check: CameraCheck) -> Iterator[Finding]:
    name = check.name
    if check.state == "moved" and check.place_of:
        yield Finding(
            "refine-names-exchanged",
            Severity.WARNING,
            name,
            f"camera {name} stands where the rig has camera {check.place_of}.",
            "Check whether their names were exchanged.",
        )
    elif check.state == "moved":
        zoom = f", its focal length changed by {100 * check.zoomed:+.2f} % (zoom or focus)" if check.zoomed else ""
        yield Finding(
            "refine-camera-moved",
            Severity.WARNING,
            name,
            f"camera {name} was moved: it is turned by {np.degrees(check.turned):.2f} degrees and shifted by {1000 * check.shifted:.0f} mm"
            f"{zoom}, {check.moved_px:.1f} px in its image; its pose was corrected.",
            "Use the refined rig for this and later recordings.",
        )
    elif check.state == "out of step":
        sentence, mend = out_of_step(name, check.lag_frames)
        yield Finding("refine-out-of-step", Severity.WARNING, name, f"{sentence} It was left as it is.", mend)
    elif check.state == "lost":
        yield Finding(
            "refine-camera-lost",
            Severity.WARNING,
            name,
            f"camera {name} does not fit the others with any pose: its lens, the size of its images or its name in the rig may be another.",
            "Calibrate it again.",
        )
    elif check.state == "unknown":
        yield Finding(
            "refine-camera-unknown",
            Severity.WARNING,
            name,
            f"the recording shows too little to check camera {name} ({check.points} points that others see too).",
            "Record markers that move all over the volume.",
        )
