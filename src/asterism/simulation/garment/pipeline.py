"""A simulated session with a garment and a reader in; calibration, capture, and how far they are from the truth, out."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.calibration.boards import BoardCalibration
from asterism.calibration.coded_target import calibrate_target
from asterism.garment.capture import Capture, Moment, Reader, capture
from asterism.garment.footage import ColourFootage
from asterism.garment.surface import surface
from asterism.garment.target_images import find_target
from asterism.progress import Progress
from asterism.recording import Ints
from asterism.simulation.comparison import RigErrors, compare_rigs
from asterism.simulation.garment.photograph import Photo
from asterism.simulation.garment.session import DenseErrors, GarmentSession, compare_dense
from asterism.simulation.pipeline import Criterion, TimedSteps

_WRONG = 0.01
"""m: a point farther from the truth than this has another circle's identity, or another's ray; noise of a point is a fiftieth of it."""


@dataclass
class Views:
    """In how many images each circle could have been read: what `GarmentSession.film` tells about the truth.

    diameter, tilt, visible  px, rad and share: what counts, see `CircleTruth.readable`
    """

    diameter: float = 6.0
    tilt: float = float(np.radians(60.0))
    visible: float = 0.9
    counts: dict[int, dict[int, int]] = field(default_factory=dict)

    def add(self, frame: int, camera: int, photo: Photo) -> None:
        """Count the circles of one picture."""
        truth = photo.truth
        there = truth.readable(self.diameter, self.tilt, self.visible) & (truth.ids >= 0)
        by_circle = self.counts.setdefault(frame, {})
        for number in truth.ids[there].tolist():
            by_circle[number] = by_circle.get(number, 0) + 1

    def of(self, frame: int, ids: NDArray[np.integer[Any]]) -> Ints:
        """(n,) in how many images of a frame these circles could have been read."""
        by_circle = self.counts.get(frame, {})
        return np.array([by_circle.get(number, 0) for number in ids.tolist()], dtype=np.int64)


@dataclass(frozen=True)
class GarmentResult:
    """What a session gave.

    calibration, captured  by the target and of the wearer
    rig_errors             of the calibration
    errors                 of the points, in the true world
    found                  share of the circles that two images show well, and that have a point
    wrong                  points farther than 10 mm from the truth
    density                points per 100 cm2 of the surface of the first frame
    seconds                of each step
    """

    calibration: BoardCalibration
    captured: Capture
    rig_errors: RigErrors
    errors: DenseErrors
    found: float
    wrong: int
    density: float
    seconds: dict[str, float]

    def criteria(self, points: float = 3000.0) -> list[Criterion]:
        """What a capture of a whole body promises; points: per frame, of a smaller suit fewer."""
        summary = self.captured.summary()
        return [
            Criterion("cameras that could not be calibrated", float(len(self.calibration.excluded)), 0.0, False, ""),
            Criterion("reprojection error of the calibration", self.calibration.rms, 0.2, False, "px"),
            Criterion("points per frame", summary["points_per_frame"], points, True, ""),
            Criterion("circles that two images show well, with a point", 100 * self.found, 98.0, True, "%"),
            Criterion("error of a point (RMS)", 1000 * self.errors.rms, 0.5, False, "mm"),
            Criterion("error by its own standard deviation", self.errors.normalised, 1.1, False, ""),
            Criterion("points with another circle's place", float(self.wrong), 0.0, False, ""),
        ]

    def facts(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            **self.captured.summary(),
            "reprojection_rms_px": self.calibration.rms,
            "error_rms_m": self.errors.rms,
            "error_worst_m": self.errors.worst,
            "normalised_error": self.errors.normalised,
            "found_of_those_two_images_show_well": self.found,
            "wrong_points": self.wrong,
            "points_per_100_cm2": self.density,
            "camera_position_error_m": self.rig_errors.position.tolist(),
            "seconds_by_step": self.seconds,
        }


def run_garment_session(
    session: GarmentSession,
    target: ColourFootage,
    film: Iterable[Moment],
    views: Views,
    readers: Callable[[str], Reader],
    *,
    frames: int,
    workers: int = 1,
    progress: Progress | None = None,
) -> GarmentResult:
    """Calibrate by the pictures of the target, capture the wearer with that rig, and compare with the truth.

    target, film  pictures of the session, from files or memory
    views         filled while the film was taken
    readers       "target" or "suit" -> what reads one of their images
    frames        of the film

    Raises AsterismError where a step is impossible.
    """
    steps = TimedSteps(progress)
    steps.begin("read the target", 0.0, "reading the target")
    seen = find_target(target, session.target.pattern, readers("target"), workers=workers)
    steps.begin("calibrate", 0.35, "calibrating")
    calibration = calibrate_target(seen)
    steps.begin("capture", 0.6, "reading the suit")
    pattern = session.worn.pattern
    captured = capture(calibration.rig, pattern, film, readers("suit"), rate=session.rate, workers=workers)
    steps.end(0.95, "comparing")
    errors = compare_dense(captured.trajectories, session.truth(frames))
    possible, captured_circles = 0, 0
    for t in range(frames):
        # What two images show well can be composed; of the others nothing is promised.
        well = pattern.known[views.of(t, pattern.known) >= 2]
        possible += len(well)
        captured_circles += int(np.isin(well, captured.trajectories.points(t).ids).sum())
    wrong = int((np.linalg.norm(errors.errors, axis=1) > _WRONG).sum())
    density = surface(captured.trajectories.points(0), pattern).density
    return GarmentResult(
        calibration,
        captured,
        compare_rigs(calibration.rig, session.rig),
        errors,
        captured_circles / max(possible, 1),
        wrong,
        density,
        steps.seconds,
    )
