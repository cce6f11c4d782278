"""Wand calibration from nothing: blobs, image sizes and wand lengths in; a rig, what it was made of and whether to trust it out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from asterism.calibration.wand.adjustment import FinalAdjustment, adjust_cameras, inner_marker_position
from asterism.calibration.wand.checks import SCALE_UNKNOWN, UPSIDE_DOWN, check_calibration
from asterism.calibration.wand.diagnose import check_detections, diagnose_camera, diagnose_no_start
from asterism.calibration.wand.drift import rejected_shares
from asterism.calibration.wand.identify import Wand, identify, wand_of
from asterism.calibration.wand.initialise import initialise_cameras
from asterism.calibration.wand.lenses import check_distance, lenses_and_sizes
from asterism.calibration.wand.recording import WandRecording
from asterism.calibration.wand.synchronise import CameraLags, synchronise
from asterism.calibration.wand.world import default_world
from asterism.cameras.bundle import Sightings, locate
from asterism.cameras.camera import Camera
from asterism.cameras.rig import Rig
from asterism.detection.static_lights import without_static_lights
from asterism.errors import AsterismError
from asterism.findings import Finding, Severity, worst
from asterism.progress import Progress
from asterism.recording import Blobs, Floats, Ints


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


def calibrate_wand(
    blobs: Blobs,
    lengths: ArrayLike,
    *,
    sizes: Mapping[str, tuple[int, int]] | tuple[int, int] | None = None,
    known: Rig | None = None,
    distance: tuple[str, str, float] | None = None,
    progress: Progress | None = None,
) -> WandCalibration:
    """Calibrate cameras by a waved wand (thesis 3.3, eq. 3.10), from nothing but image sizes and its lengths.

    blobs     what the cameras saw of the wand, strays among it; `blobs.times` where they are not triggered together
    lengths   m, the places of three or two markers along the wand; one number for a single moved marker
    sizes     (width, height) px of the images, one for all or by camera name; not needed where `known` has them
    known     a rig whose lenses are known, more or less: they are where it begins; poses are not used
    distance  two cameras' names and the metres between them: the scale, where a single marker was moved

    Returns a `WandCalibration`; ask its `usable` and `findings` before using its rig. Deterministic. Raises AsterismError where lengths or
    sizes are impossible, and where no two cameras can be posed at all.
    """
    report: Progress = progress or (lambda fraction, doing: None)
    recording, static_lights = _detected(blobs, wand_of(lengths), lenses_and_sizes(blobs, sizes, known), distance, report)
    frames, recording = len(recording), recording.on_common_clock()
    report(0.1, "posing cameras")
    start = initialise_cameras(recording, progress)
    if start is None:
        raise AsterismError(diagnose_no_start(recording))
    report(0.6, "comparing clocks")
    recording, cameras, lags = synchronise(recording, start.cameras)
    report(0.7, "adjusting")
    final = adjust_cameras(recording, cameras, start.noise)
    report(0.9, "measuring the wand")
    made = _calibration(recording, cameras, lags, final, frames, static_lights)
    if len(recording.wand) == 1 and distance is not None:
        here = np.linalg.norm(made.rig[distance[0]].position - made.rig[distance[1]].position)
        scale = distance[2] / float(here)
        made = made.moved(made.rig.moved(np.eye(3), np.zeros(3), scale), np.eye(3), np.zeros(3), scale)
    turn, shift = default_world(made.rig, made.positions)
    made = made.moved(made.rig.moved(turn, shift), turn, shift)
    posed = np.array([c for c, camera in enumerate(cameras) if camera is not None])
    made = replace(made, findings=check_calibration(made, lags.select(posed), scaled=distance is not None))
    report(1.0, "done")
    return replace(made, rig=replace(made.rig, metadata=_metadata(made)))


def _detected(
    blobs: Blobs,
    wand: Wand,
    lenses_sizes: tuple[tuple[Camera | None, ...], tuple[tuple[int, int], ...]],
    distance: tuple[str, str, float] | None,
    report: Progress,
) -> tuple[WandRecording, Ints]:
    """The recording with the wand found in single images, and how many static lights (C,) were left out."""
    if len(blobs.cameras) < 2:
        raise AsterismError("a wand is seen by one camera only; calibration needs two that look at the same place.")
    if len(wand) == 1 and distance is not None:
        check_distance(blobs.cameras, distance)
    report(0.0, "looking for the wand")
    blobs, static_lights = without_static_lights(blobs)
    recording = WandRecording(blobs, identify(blobs, wand), wand, *lenses_sizes)
    check_detections(recording, static_lights)
    return recording, static_lights


def _calibration(
    recording: WandRecording,
    cameras: Sequence[Camera | None],
    lags: CameraLags,
    final: FinalAdjustment,
    frames: int,
    static_lights: Ints,
) -> WandCalibration:
    """What the final adjustment gives, with the wand as its cameras measure it."""
    posed = np.array([c for c, camera in enumerate(cameras) if camera is not None])
    result, sightings, used = final.result, final.sightings, final.used
    positions = locate(result.cameras, sightings, len(used), len(recording.wand))
    excluded = {name: diagnose_camera(recording, cameras, c) for c, name in enumerate(recording.blobs.cameras) if cameras[c] is None}
    rejected = rejected_shares(recording.detections[final.offered][:, posed], final.offered, final.recorded, len(recording))
    by_number = dict(zip(posed.tolist(), result.cameras, strict=True))
    return WandCalibration(
        Rig(result.cameras), recording.wand, frames, final.recorded, result.residuals, positions, used, result.sigma,
        result.position_sigma, result.noise, lags.lag_frames[posed], *rejected, static_lights[posed],
        inner_marker_position(recording, used, by_number, positions), excluded,
    )  # fmt: skip


def _metadata(made: WandCalibration) -> dict[str, object]:
    finite = made.lengths[np.isfinite(made.lengths)]
    return {
        "calibrated_by": "wand",
        "wand_m": [float(length) for length in made.wand.lengths],
        "frames": made.frames,
        "frames_used": len(made.used),
        "reprojection_rms_px": round(made.rms, 4),
        "noise_px": round(made.noise, 4),
        "wand_length_mean_m": round(float(finite.mean()), 6) if len(finite) else None,
        "wand_length_std_m": round(float(finite.std()), 6) if len(finite) else None,
        "usable": made.usable,
        "world": "level by the cameras' own sense of up, origin below the middle of the waved volume",
    }
