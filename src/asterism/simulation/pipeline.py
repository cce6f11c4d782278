"""A simulated session in; its calibration, points and labels as a laboratory would make them, compared with the truth, out."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from asterism.calibration.wand import WandCalibration, calibrate_wand, in_world, world_from_l_frame
from asterism.cameras import Rig
from asterism.labelling import MarkerModel
from asterism.progress import Progress
from asterism.reconstruction import Reconstruction, reconstruct
from asterism.recording import Labelling
from asterism.simulation.comparison import PointErrors, RigErrors, compare_points, compare_rigs
from asterism.simulation.session import L_FRAME, WAND, SimulatedSession


@dataclass(frozen=True)
class Criterion:
    """One promise: what was measured, and the limit, in the same unit; at_least: whether the limit is the least value or the most."""

    name: str
    measured: float
    limit: float
    at_least: bool
    unit: str

    @property
    def met(self) -> bool:
        """Whether the measurement keeps to the limit; a missing one (NaN) does not."""
        return self.measured >= self.limit if self.at_least else self.measured <= self.limit


class TimedSteps:
    """The seconds that each step of a pipeline took, and what `progress` is told when it begins."""

    def __init__(self, progress: Progress | None) -> None:
        self.seconds: dict[str, float] = {}
        self._progress, self._name, self._started = progress, "", time.perf_counter()

    def begin(self, name: str, done: float, doing: str) -> None:
        """End the step before and begin this one; done: the share of the work that is behind it, doing: what it does."""
        self.end(done, doing)
        self._name = name

    def end(self, done: float, doing: str) -> None:
        """End the last step; what is done from here on belongs to none."""
        if self._name:
            self.seconds[self._name] = time.perf_counter() - self._started
        if self._progress is not None:
            self._progress(done, doing)
        self._name, self._started = "", time.perf_counter()


@dataclass(frozen=True)
class PipelineResult:
    """What a session gave.

    calibration, rig            from the wand, and in the L-frame's world
    reconstruction, labelling   the walker's points, and their labels
    rig_errors, points          against the truth
    right, wrong, unlabelled    labels of markers in all frames: on the right point; on another one; not given though the point was found
    seconds                     of each step
    """

    calibration: WandCalibration
    rig: Rig
    reconstruction: Reconstruction
    labelling: Labelling
    rig_errors: RigErrors
    points: PointErrors
    right: int
    wrong: int
    unlabelled: int
    seconds: dict[str, float]

    def criteria(self) -> list[Criterion]:
        """What the whole pipeline promises on simulated sessions, and what was measured."""
        # Of the markers that were found: what no camera saw cannot be labelled.
        points, found_markers = self.points, self.right + self.unlabelled
        return [
            Criterion("cameras that could not be calibrated", float(len(self.calibration.excluded)), 0.0, False, ""),
            Criterion("focal length, largest error", 100 * float(self.rig_errors.focal.max()), 0.1, False, "%"),
            Criterion("camera position, largest error", 1000 * float(self.rig_errors.position.max()), 2.0, False, "mm"),
            Criterion("markers that two cameras see, found within 3 mm", 100 * points.found(0.003), 99.5, True, "%"),
            Criterion("their distance from the truth, median", 1000 * float(np.nanmedian(points.error)), 1.0, False, "mm"),
            Criterion("points that are no marker", 1000 * points.ghosts / max(points.points, 1), 5.0, False, "of 1,000"),
            Criterion("markers found that are labelled right", 100 * self.right / max(found_markers, 1), 97.0, True, "%"),
            Criterion("labels that are wrong", 100 * self.wrong / max(self.right + self.wrong, 1), 0.5, False, "%"),
        ]


def run_pipeline(session: SimulatedSession, model: MarkerModel, progress: Progress | None = None) -> PipelineResult:
    """Calibrate by the wand, put the world into the L-frame, reconstruct the walker, label, and compare with the truth.

    The steps use the blobs, the image sizes and the lengths of wand and L-frame; the truth is used for the comparison only. Raises
    AsterismError where a step is impossible.
    """
    steps = TimedSteps(progress)
    steps.begin("calibrate", 0.0, "calibrating")
    # Of the true rig only what a laboratory knows: image sizes, and the lengths of wand and frame.
    sizes = {camera.name: camera.size for camera in session.rig if camera.size is not None}
    calibration = calibrate_wand(session.wand, WAND, sizes=sizes)
    rig = in_world(calibration.rig, world_from_l_frame(calibration.rig, session.l_frame, L_FRAME), "the L-frame")
    steps.begin("reconstruct", 0.6, "reconstructing")
    reconstruction = reconstruct(session.blobs, rig)
    steps.begin("label", 0.8, "labelling")
    labelling = model.label(reconstruction.clouds)
    steps.end(1.0, "comparing")
    points = compare_points(reconstruction.clouds, session.walk.positions, session.seen >= 2)
    indices = labelling.indices
    return PipelineResult(
        calibration,
        rig,
        reconstruction,
        labelling,
        compare_rigs(rig, session.rig),
        points,
        int(((indices >= 0) & (indices == points.truth)).sum()),
        int(((indices >= 0) & (indices != points.truth)).sum()),
        int(((indices < 0) & (points.truth >= 0)).sum()),
        steps.seconds,
    )
