"""A calibration in; what to know before using it out: what is not determined, where to wave more, whether to use it at all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from asterism.calibration.wand.drift import PARTS, residual_steps
from asterism.calibration.wand.frames import widest_image
from asterism.calibration.wand.result import WandCalibration
from asterism.calibration.wand.synchronise import CameraLags
from asterism.calibration.wand.world import default_world
from asterism.findings import Finding, Severity
from asterism.recording import Floats

CELLS = (6, 8)
"""Rows and columns that an image is divided into to say which part of it saw the wand."""


@dataclass(frozen=True)
class CheckRules:
    """Limits of the checks. Each pair: warn from; refuse from.

    rms              px, reprojection error in images of `usual_width` px or less; in wider ones in proportion
    worse            a camera is named from so many times the error of all
    length_spread    robust spread of the measured wand, as a share of its length
    length_error     median of the measured wand, as a share of its length
    inner_error      of the inner marker's position, as a share of the wand's length, and at least `inner_least` m
    focal            standard deviation of a focal length, as a share of it
    position         standard deviation of a camera's position, as a share of its distance to the wand
    centre           standard deviation of the principal point, and its distance from the middle of the image; shares of the image's width
    rejected         share of the wand's images, of all cameras or of one, that contradict the others
    rejected_part    share of one camera's images of the wand in a tenth of the recording that contradict the others: most, nearly all
    unusual          so many times the median camera's share is unusual
    turn             rad by which a camera's residuals change at one moment; refuse from, for rigs of two, three, and more cameras. Few
                     cameras show less of a turn and suffer more
    echo             a camera that was moved makes the others seem to be moved, by up to this share of it
    drift            frames between the first and the last third of the recording: refuse from
    frames           that were used
    line, plane      spread of the wand's positions along the second and third axis, as a share of the first: less is a line, a plane
    reach            the spread along the first axis counts up to this share of the distance to the cameras
    turned           mean square of the wand's direction along its rarest axis
    covered          share of one image in which the wand was seen, and of the median camera's
    up               a camera looks up from this upward part of its line of sight, a share of one

    Checked on the simulated and real wands of tests/test_wand.py and benchmarks/cameras/wand.py.
    """

    rms: tuple[float, float] = (0.7, 1.5)
    usual_width: int = 1280
    worse: float = 2.5
    length_spread: tuple[float, float] = (0.006, 0.015)
    length_error: tuple[float, float] = (0.004, 0.02)
    inner_error: tuple[float, float] = (0.004, 0.01)
    inner_least: float = 0.0015
    focal: tuple[float, float] = (0.004, 0.02)
    position: tuple[float, float] = (0.003, 0.015)
    centre: tuple[float, float] = (0.015, 0.07)
    rejected: tuple[float, float] = (0.12, 0.3)
    rejected_part: tuple[float, float] = (0.5, 0.8)
    unusual: float = 2.5
    turn: tuple[float, tuple[float, float, float]] = (1e-4, (1.3e-4, 7e-4, 1.5e-3))
    echo: float = 0.8
    drift: float = 0.5
    frames: tuple[int, int] = (100, 50)
    line: float = 0.12
    plane: tuple[float, float] = (0.08, 0.03)
    reach: float = 0.35
    turned: float = 0.02
    covered: tuple[float, float] = (0.35, 0.2)
    up: float = 0.1


RULES = CheckRules()


def coverage(calibration: WandCalibration) -> Floats:
    """(C, rows, columns) how many markers of the wand each part of each image saw."""
    counts = np.zeros((len(calibration.rig), *CELLS))
    for c, camera in enumerate(calibration.rig):
        width, height = camera.size or (1, 1)
        xy = calibration.sightings.xy[calibration.sightings.camera == c]
        row = np.clip((xy[:, 1] / height * CELLS[0]).astype(np.int64), 0, CELLS[0] - 1)
        column = np.clip((xy[:, 0] / width * CELLS[1]).astype(np.int64), 0, CELLS[1] - 1)
        np.add.at(counts[c], (row, column), 1)
    return counts


def check_calibration(calibration: WandCalibration, lags: CameraLags, *, scaled: bool) -> tuple[Finding, ...]:
    """What to know about a calibration, most severe first. lags: of each camera; scaled: whether a distance gave the scale."""
    found = [
        *_excluded(calibration),
        *_residuals(calibration),
        *_lengths(calibration),
        *_used(calibration),
        *_moved(calibration),
        *_rejected(calibration),
        *_lags(calibration, lags),
        *_undetermined(calibration),
        *_waved(calibration),
        *_covered(calibration),
        *_looking_up(calibration),
        *_single_marker(calibration, scaled),
    ]
    return tuple(sorted(found, key=lambda finding: -finding.severity))


def _grade(severe: bool | np.bool_) -> Severity:
    return Severity.ERROR if severe else Severity.WARNING


def _excluded(calibration: WandCalibration) -> Iterator[Finding]:
    for name, (reason, mend) in calibration.excluded.items():
        yield Finding("wand-camera-excluded", Severity.WARNING, name, f"camera {name} is not in the rig: {reason}.", mend)


def _residuals(calibration: WandCalibration) -> Iterator[Finding]:
    # Errors in pixels grow with the number of pixels that the same lens spreads its image over.
    large = max(1.0, widest_image(calibration.rig) / RULES.usual_width)
    poor, bad = (large * limit for limit in RULES.rms)
    if calibration.rms > poor:
        yield Finding(
            "wand-large-error",
            _grade(calibration.rms > bad),
            "",
            f"the reprojection error is {calibration.rms:.2f} px; good wand calibrations stay below {poor:.1f}.",
            "Look for blurred or saturated markers, cameras that moved, or cameras out of step.",
        )
    for camera in calibration.rig:
        if camera.error > max(poor, RULES.worse * calibration.rms):
            yield Finding(
                "wand-camera-large-error",
                _grade(camera.error > bad),
                camera.name,
                f"camera {camera.name} fits worse than the others ({camera.error:.2f} px).",
                "Check whether it was moved while recording.",
            )


def _lengths(calibration: WandCalibration) -> Iterator[Finding]:
    """Whether the wand, measured marker by marker, has the lengths that were given."""
    whole = calibration.wand.lengths[-1]
    lengths = calibration.lengths[np.isfinite(calibration.lengths)]
    if whole > 0.0 and len(lengths) > 20:
        middle = float(np.median(lengths))
        # By the median: a few frames in which a marker was mistaken must not make a good wand look bad.
        spread = float(1.4826 * np.median(np.abs(lengths - middle))) / whole
        if spread > RULES.length_spread[0]:
            yield Finding(
                "wand-length-varies",
                _grade(spread > RULES.length_spread[1]),
                "",
                f"the measured wand varies by {1000 * lengths.std():.1f} mm (standard deviation) about its {1000 * whole:.0f} mm.",
                "Wave it more slowly, and check that the cameras are in step.",
            )
        off = abs(middle / whole - 1.0)
        if off > RULES.length_error[0]:
            yield Finding(
                "wand-length-wrong",
                _grade(off > RULES.length_error[1]),
                "",
                f"the wand measures {1000 * middle:.1f} mm where {1000 * whole:.1f} mm were given.",
                "Measure the wand, and give its lengths anew.",
            )
    inner = abs(calibration.inner_marker_m - calibration.wand.lengths[1]) if np.isfinite(calibration.inner_marker_m) else 0.0
    if inner > max(RULES.inner_least, RULES.inner_error[0] * whole):
        yield Finding(
            "wand-inner-marker-wrong",
            _grade(inner > RULES.inner_error[1] * whole),
            "",
            f"the wand's inner marker sits {1000 * calibration.inner_marker_m:.1f} mm from the first one, not the "
            f"{1000 * calibration.wand.lengths[1]:.1f} mm given.",
            "Measure the wand, and give its lengths anew.",
        )


def _used(calibration: WandCalibration) -> Iterator[Finding]:
    if calibration.mean_rejected_share > RULES.rejected[0]:
        yield Finding(
            "wand-images-rejected",
            _grade(calibration.mean_rejected_share > RULES.rejected[1]),
            "",
            f"{100 * calibration.mean_rejected_share:.0f} % of the wand's images contradict the others and were left out.",
            "Check the wand's lengths, and that the cameras are in step and were not moved.",
        )
    if len(calibration.used) < RULES.frames[0]:
        yield Finding(
            "wand-few-frames",
            _grade(len(calibration.used) < RULES.frames[1]),
            "",
            f"only {len(calibration.used)} frames could be used.",
            "Wave the wand for at least half a minute.",
        )


def _moved(calibration: WandCalibration) -> Iterator[Finding]:
    """Cameras whose residuals change at one moment."""
    steps, moments = residual_steps(calibration.sightings, calibration.residuals, len(calibration.rig))
    turns = steps / [camera.focal[0] for camera in calibration.rig]
    # With few cameras the others follow a bumped one, so that less of the bump is left to see.
    bad_turn = RULES.turn[1][min(len(calibration.rig), 4) - 2]
    for camera, step, turn, moment in zip(calibration.rig, steps, turns, moments, strict=True):
        # A bump of one camera shows as an echo in those that shared its points; only the loudest are named.
        if turn > max(RULES.turn[0], RULES.echo * turns.max()):
            yield Finding(
                "wand-camera-moved",
                _grade(turn > bad_turn),
                camera.name,
                f"camera {camera.name} sees things {step:.1f} px elsewhere after {100 * moment:.0f} % of the recording than before.",
                "Check whether it was moved while recording; fasten it and record again.",
            )


def _rejected(calibration: WandCalibration) -> Iterator[Finding]:
    """Cameras whose images contradict the others, all over the recording or in a part of it."""
    usual, usual_part = RULES.unusual * float(np.median(calibration.rejected_share)), RULES.unusual * _middle(calibration.rejected_parts)
    most, nearly_all = RULES.rejected_part
    for camera, share, parts in zip(calibration.rig, calibration.rejected_share, calibration.rejected_parts, strict=True):
        bad = np.nonzero(parts > np.maximum(most, usual_part))[0]
        if share > max(RULES.rejected[0], usual) or len(bad):
            # Bad parts in one stretch tell when it happened, which helps to find the cause.
            in_one = 0 < len(bad) < PARTS and np.ptp(bad) == len(bad) - 1
            begins, ends = (100 * edge // PARTS for edge in (bad.min(initial=PARTS), bad.max(initial=-1) + 1))
            when = f", most of it between {begins} and {ends} % of the recording" if in_one else ""
            whole = share > RULES.rejected[0] and np.nan_to_num(parts).max() > nearly_all
            yield Finding(
                "wand-camera-contradicts",
                _grade(share > RULES.rejected[1] or whole or PARTS - 1 in bad),
                camera.name,
                f"{100 * share:.0f} % of what camera {camera.name} saw contradicts the others{when}.",
                "Check whether it was moved while recording; fasten it and record again.",
            )


def _middle(parts: Floats) -> Floats:
    """(n,) the median over cameras of (C, n), 0 where none has a number."""
    return np.array([np.median(part[np.isfinite(part)]) if np.isfinite(part).any() else 0.0 for part in parts.T])


def _lags(calibration: WandCalibration, lags: CameraLags) -> Iterator[Finding]:
    for camera, whole, part, drift in zip(calibration.rig, lags.lag_frames, lags.fraction, lags.drift, strict=True):
        if drift != 0.0:
            yield Finding(
                "wand-camera-drifts",
                _grade(abs(drift) > RULES.drift),
                camera.name,
                f"camera {camera.name} takes its images {abs(drift):.1f} frames {'later' if drift > 0 else 'earlier'} in the last third "
                "of the recording than in the first.",
                "Check whether it lost images, or has another frame rate.",
            )
        lag = int(whole) + float(part)
        if lag == 0.0:
            continue
        which, many = "late" if lag > 0 else "early", abs(lag)
        shifted = "its images were shifted for this calibration."
        if part == 0.0:
            yield Finding(
                "wand-camera-lags",
                Severity.WARNING,
                camera.name,
                f"camera {camera.name} started {many:.0f} frame{'s' if many > 1 else ''} {which}; {shifted}",
                "Start the cameras together before you record, or give the time of each image.",
            )
        else:
            yield Finding(
                "wand-camera-lags",
                Severity.WARNING,
                camera.name,
                f"camera {camera.name} takes its images {many:.2f} frames {which}; {shifted}",
                "Check its trigger before you record.",
            )


def _undetermined(calibration: WandCalibration) -> Iterator[Finding]:
    """Parameters that this waving does not determine, by their standard deviations."""
    # How far off a camera's place may be depends on how far away it stands.
    middle = np.nanmedian(calibration.positions.reshape(-1, 3), axis=0)
    for c, camera in enumerate(calibration.rig):
        focal = float(calibration.sigma[c, 6]) / camera.focal[0]
        position = float(calibration.position_sigma[c])
        distance = max(float(np.linalg.norm(camera.position - middle)), 1e-9)
        if focal > RULES.focal[0]:
            known = "is not determined" if focal > RULES.focal[1] else f"is only known to {100 * focal:.1f} %"
            yield Finding(
                "wand-focal-uncertain",
                _grade(focal > RULES.focal[1]),
                camera.name,
                f"the focal length of camera {camera.name} {known} by this wand.",
                "Wave it nearer and farther away, too.",
            )
        share = position / distance
        if share > RULES.position[0]:
            known = "is not determined" if share > RULES.position[1] else f"is only known to {1000 * position:.0f} mm"
            yield Finding(
                "wand-position-uncertain",
                _grade(share > RULES.position[1]),
                camera.name,
                f"the position of camera {camera.name} {known} by this wand.",
                "Wave it all over what the camera sees.",
            )
        yield from _principal_point(calibration, c)


def _principal_point(calibration: WandCalibration, c: int) -> Iterator[Finding]:
    camera = calibration.rig.cameras[c]
    width = (camera.size or (1280, 1024))[0]
    off = np.array(camera.centre) - 0.5 * (np.array(camera.size or camera.centre) - 1.0)
    # Lenses sit nearly over their sensors' middles: a principal point far off mostly means another image size.
    if np.linalg.norm(off) > RULES.centre[1] * width:
        yield Finding(
            "wand-centre-far",
            Severity.WARNING,
            camera.name,
            f"the principal point of camera {camera.name} lies {abs(off[0]):.0f} px {'right' if off[0] > 0 else 'left'} of and "
            f"{abs(off[1]):.0f} px {'below' if off[1] > 0 else 'above'} the image's middle.",
            "Check the image size.",
        )
    if np.nanmax(calibration.sigma[c, 8:10]) > RULES.centre[0] * width:
        yield Finding(
            "wand-centre-uncertain",
            Severity.WARNING,
            camera.name,
            f"the principal point of camera {camera.name} is not determined by this wand (within "
            f"{np.nanmax(calibration.sigma[c, 8:10]):.0f} px); the middle of the image is assumed.",
            "Wave it up to the image's borders.",
        )


def _waved(calibration: WandCalibration) -> Iterator[Finding]:
    """Whether the wand was waved through a volume and turned, by its positions and directions."""
    points = calibration.positions.reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 10:
        return
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(points.T)), 0.0))
    wide = min(float(spread[2]), RULES.reach * _distance(calibration))
    if spread[1] < RULES.line * wide:
        yield Finding(
            "wand-waved-in-line",
            Severity.ERROR,
            "",
            "the wand was waved along a line only.",
            "Wave it through the whole volume, up and down too.",
        )
    elif spread[0] < RULES.plane[0] * wide:
        yield Finding(
            "wand-waved-in-plane",
            _grade(spread[0] < RULES.plane[1] * wide),
            "",
            "the wand was waved in a plane only.",
            "Wave it through the whole volume, up and down too.",
        )
    seen = float(np.median([(cells > 0).mean() for cells in coverage(calibration)]))
    if seen < RULES.covered[1]:
        yield Finding(
            "wand-small-volume",
            Severity.WARNING,
            "",
            f"the wand stayed in a small part of the volume, {' x '.join(f'{4.0 * part:.1f}' for part in spread[::-1])} m, which fills "
            f"{100 * seen:.0f} % of an image; points elsewhere can be off by more than is said here.",
            "Wave it through the whole volume.",
        )
    if len(calibration.wand) > 1:
        along = calibration.positions[:, -1] - calibration.positions[:, 0]
        along = along[np.isfinite(along).all(axis=1)]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        if len(along) > 10 and np.linalg.eigvalsh(along.T @ along / len(along))[0] < RULES.turned:
            yield Finding(
                "wand-hardly-turned", Severity.WARNING, "", "the wand was hardly turned.", "Turn it in all directions while waving."
            )


def _distance(calibration: WandCalibration) -> float:
    """m, from the cameras to what they saw of the wand, the median."""
    seen = calibration.sightings
    points = calibration.positions[np.searchsorted(calibration.used, seen.frame), seen.point]
    eyes = np.stack([camera.position for camera in calibration.rig])
    return float(np.nanmedian(np.linalg.norm(points - eyes[seen.camera], axis=1)))


def _covered(calibration: WandCalibration) -> Iterator[Finding]:
    if calibration.static_lights.any():
        each = ", ".join(
            f"{count} in camera {camera.name}" for camera, count in zip(calibration.rig, calibration.static_lights, strict=True) if count
        )
        yield Finding(
            "wand-static-lights",
            Severity.NOTE,
            "",
            f"what never moved was left out: {each}.",
            "Cover reflections before recording, or mask them.",
        )
    for camera, cells in zip(calibration.rig, coverage(calibration), strict=True):
        share = float((cells > 0).mean())
        if share < RULES.covered[0]:
            yield Finding(
                "wand-image-uncovered",
                Severity.NOTE,
                camera.name,
                f"camera {camera.name} saw the wand in {100 * share:.0f} % of its image only ({_least_covered(cells)} is missing); "
                "its lens is a guess elsewhere.",
                "Wave the wand there, too.",
            )


def _least_covered(cells: Floats) -> str:
    """The side of an image that saw least."""
    rows, columns = cells.shape
    sides = {
        "the left": cells[:, : columns // 2],
        "the right": cells[:, columns // 2 :],
        "the top": cells[: rows // 2],
        "the bottom": cells[rows // 2 :],
    }
    return min(sides, key=lambda side: float((sides[side] > 0).mean()))


def _looking_up(calibration: WandCalibration) -> Iterator[Finding]:
    """Whether the cameras hang below what they look at, by their own sense of up: so they seem to where y is counted from the bottom."""
    up = default_world(calibration.rig, calibration.positions)[0][2]
    if all(float(camera.rotation[2] @ up) > RULES.up for camera in calibration.rig):
        yield Finding(
            "wand-looks-up",
            Severity.WARNING,
            "",
            "all cameras look up at the wand from below.",
            "If they hang above it, y is counted from the bottom in the images, and the rig is mirrored: count y from the top.",
        )


def _single_marker(calibration: WandCalibration, scaled: bool) -> Iterator[Finding]:
    if len(calibration.wand) > 1:
        return
    if len(calibration.rig) == 2:
        yield Finding(
            "wand-one-marker-two-cameras",
            Severity.ERROR,
            "",
            "one moved marker before two cameras hardly determines their lenses.",
            "Add a camera, or wave a wand.",
        )
    if not scaled:
        yield Finding(
            "wand-no-scale",
            Severity.ERROR,
            "",
            "one moved marker gives no size: the rig is right but for its scale.",
            "Give a distance between two cameras.",
        )
