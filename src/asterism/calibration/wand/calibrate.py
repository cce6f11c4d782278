"""Wand calibration from nothing: blobs, image sizes and wand lengths in; a rig, what it was made of and whether to trust it out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from asterism.calibration.wand.adjustment import FinalAdjustment, adjust_cameras, inner_marker_position
from asterism.calibration.wand.checks import check_calibration
from asterism.calibration.wand.diagnose import check_detections, diagnose_camera, diagnose_no_start
from asterism.calibration.wand.drift import rejected_shares
from asterism.calibration.wand.identify import Wand, identify, wand_of
from asterism.calibration.wand.initialise import initialise_cameras
from asterism.calibration.wand.lenses import check_distance, lenses_and_sizes
from asterism.calibration.wand.recording import WandRecording
from asterism.calibration.wand.result import WandCalibration
from asterism.calibration.wand.synchronise import CameraLags, synchronise
from asterism.calibration.wand.world import default_world
from asterism.cameras.bundle import locate
from asterism.cameras.camera import Camera
from asterism.cameras.rig import Rig
from asterism.detection.static_lights import without_static_lights
from asterism.errors import AsterismError
from asterism.progress import Progress
from asterism.recording import Blobs, Ints


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
    # Cameras with times of their own are brought to common moments before they are compared in any way.
    frames, recording = len(recording), recording.on_common_clock()
    report(0.1, "posing cameras")
    start = initialise_cameras(recording, progress)
    if start is None:
        raise AsterismError(diagnose_no_start(recording))
    report(0.6, "comparing clocks")
    # Roughly posed cameras are good enough to tell which of them is late, and late ones would bend the final adjustment.
    recording, cameras, lags = synchronise(recording, start.cameras)
    report(0.7, "adjusting")
    final = adjust_cameras(recording, cameras, start.noise)
    report(0.9, "measuring the wand")
    calibration = _calibration(recording, cameras, lags, final, frames, static_lights)
    # A single marker has no length, so the rig's size comes from the two cameras' distance.
    if len(recording.wand) == 1 and distance is not None:
        here = np.linalg.norm(calibration.rig[distance[0]].position - calibration.rig[distance[1]].position)
        scale = distance[2] / float(here)
        calibration = calibration.moved(calibration.rig.moved(np.eye(3), np.zeros(3), scale), np.eye(3), np.zeros(3), scale)
    # Findings speak of up and below: they are looked for when the rig stands level.
    turn, shift = default_world(calibration.rig, calibration.positions)
    calibration = calibration.moved(calibration.rig.moved(turn, shift), turn, shift)
    posed = np.array([c for c, camera in enumerate(cameras) if camera is not None])
    calibration = replace(calibration, findings=check_calibration(calibration, lags.select(posed), scaled=distance is not None))
    report(1.0, "done")
    return replace(calibration, rig=replace(calibration.rig, metadata=_metadata(calibration)))


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


def _metadata(calibration: WandCalibration) -> dict[str, object]:
    finite = calibration.lengths[np.isfinite(calibration.lengths)]
    return {
        "calibrated_by": "wand",
        "wand_m": [float(length) for length in calibration.wand.lengths],
        "frames": calibration.frames,
        "frames_used": len(calibration.used),
        "reprojection_rms_px": round(calibration.rms, 4),
        "noise_px": round(calibration.noise, 4),
        "wand_length_mean_m": round(float(finite.mean()), 6) if len(finite) else None,
        "wand_length_std_m": round(float(finite.std()), 6) if len(finite) else None,
        "usable": calibration.usable,
        "world": "level by the cameras' own sense of up, origin below the middle of the waved volume",
    }
