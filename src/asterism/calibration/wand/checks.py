"""A calibration in; what to know before using it out, in words: what is not determined, where to wave more, whether to use it at all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from asterism.calibration.wand.drift import PARTS, jumps
from asterism.calibration.wand.frames import widest
from asterism.calibration.wand.world import default_world
from asterism.recording import Floats

if TYPE_CHECKING:
    from asterism.calibration.wand.calibrate import WandCalibration
    from asterism.calibration.wand.synchronise import Clocks

BAD_RMS, POOR_RMS, USUAL_WIDTH = 1.5, 0.7, 1280
"""px, reprojection errors that no good wand calibration has, and that most good ones have not, in images so wide; wider ones have more."""
BAD_LENGTH, POOR_LENGTH = 0.015, 0.006
"""Spread of the measured wand as a share of its length."""
BAD_FOCAL, POOR_FOCAL = 0.02, 0.004
BAD_PLACE, POOR_PLACE = 0.015, 0.003
"""Standard deviation of where a camera stands, as a share of its distance to the wand."""
BAD_LOST, POOR_LOST = 0.3, 0.12
"""Share of the wand's images, all told or of one camera, that contradict the others."""
BAD_TURN, POOR_TURN = (1.3e-4, 7e-4, 1.5e-3), 1e-4
"""rad, by which a camera's residuals change at one moment; of two, three, more cameras: fewer show less of a turn, and suffer more."""
ECHO = 0.8
"""A camera that was moved makes the others seem to be, by up to this share of it."""
LOOKS_UP = 0.1
"""The upward part of where a camera looks, as a share of one."""
BAD_PART, WHOLE_PART = 0.5, 0.8
"""Share of one camera's images of the wand in a tenth of the recording that contradict the others: most, and nearly all."""
BAD_DRIFT = 0.5
"""Frames."""
POOR_COVERAGE = 0.35
POOR_PART = 0.2
"""Share of its image in which the middle camera saw the wand."""
FAR_CENTRE = 0.07
"""Of an image's width, by which hardly a lens's centre is off the image's."""
CELLS = (6, 8)
"""Rows and columns that an image is divided into to say which part of it saw the wand."""
FEW_FRAMES = 100


@dataclass(frozen=True)
class Finding:
    """One sentence about a calibration: grave, then it should not be used; or mere advice, which speaks against nothing.

    of_scale: that the rig's size is unknown, which a world frame with a scale mends
    of_world: that up may be down, which a world frame tells
    """

    sentence: str
    grave: bool = False
    advice: bool = False
    of_scale: bool = False
    of_world: bool = False


def coverage(made: WandCalibration) -> Floats:
    """(C, rows, columns) how many markers of the wand each part of each image saw."""
    counts = np.zeros((len(made.rig), *CELLS))
    for c, camera in enumerate(made.rig):
        width, height = camera.size or (1, 1)
        xy = made.sightings.xy[made.sightings.camera == c]
        row = np.clip((xy[:, 1] / height * CELLS[0]).astype(np.int64), 0, CELLS[0] - 1)
        column = np.clip((xy[:, 0] / width * CELLS[1]).astype(np.int64), 0, CELLS[1] - 1)
        np.add.at(counts[c], (row, column), 1)
    return counts


def judge(made: WandCalibration, clocks: Clocks, *, scaled: bool) -> tuple[Finding, ...]:
    """What speaks against a calibration, gravest first. clocks: how late each camera was; scaled: a distance gave the scale."""
    found = [
        *(Finding(f"camera {name} is not in the rig: {why}{'' if why.endswith('?') else '.'}") for name, why in made.left_out.items()),
        *_fit(made),
        *_moved(made),
        *_clocks(made, clocks),
        *_undetermined(made),
        *_waved(made),
        *_covered(made),
        *_looking_up(made),
    ]
    if len(made.wand.lengths) == 1 and len(made.rig) == 2:
        found.append(Finding("one moved marker before two cameras hardly tells their lenses; add a camera, or wave a wand.", True))
    if len(made.wand.lengths) == 1 and not scaled:
        found.append(
            Finding(
                "one moved marker tells no size: the rig is right but for its scale; give a distance between two cameras.",
                True,
                of_scale=True,
            )
        )
    return tuple(sorted(found, key=lambda finding: (not finding.grave, finding.advice)))


def _fit(made: WandCalibration) -> list[Finding]:
    found = []
    large = max(1.0, widest(made.rig) / USUAL_WIDTH)
    poor, bad = large * POOR_RMS, large * BAD_RMS
    if made.rms > poor:
        found.append(
            Finding(
                f"the reprojection error is {made.rms:.2f} px; good wand calibrations stay below {poor:.1f}: look for blurred or saturated "
                "markers, cameras that moved, or cameras out of step.",
                made.rms > bad,
            )
        )
    for camera in made.rig:
        if camera.error > max(poor, 2.5 * made.rms):
            found.append(
                Finding(f"camera {camera.name} fits worse than the others ({camera.error:.2f} px); was it moved?", camera.error > bad)
            )
    whole = made.wand.lengths[-1]
    lengths = made.lengths[np.isfinite(made.lengths)]
    if whole > 0.0 and len(lengths) > 20:
        middle = float(np.median(lengths))
        spread = float(1.4826 * np.median(np.abs(lengths - middle))) / whole
        if spread > POOR_LENGTH:
            found.append(
                Finding(
                    f"the measured wand varies by {1000 * lengths.std():.1f} mm (standard deviation) about its {1000 * whole:.0f} mm.",
                    spread > BAD_LENGTH,
                )
            )
        if abs(middle / whole - 1.0) > 0.004:
            found.append(
                Finding(
                    f"the wand measures {1000 * middle:.1f} mm where {1000 * whole:.1f} mm were given.", abs(middle / whole - 1.0) > 0.02
                )
            )
    if np.isfinite(made.inner) and abs(made.inner - made.wand.lengths[1]) > max(0.0015, 0.004 * whole):
        found.append(
            Finding(
                f"the wand's inner marker sits {1000 * made.inner:.1f} mm from the first one, not the "
                f"{1000 * made.wand.lengths[1]:.1f} mm given; measure the wand.",
                abs(made.inner - made.wand.lengths[1]) > 0.01 * whole,
            )
        )
    if made.rejected > POOR_LOST:
        found.append(
            Finding(f"{100 * made.rejected:.0f} % of the wand's images contradict the others and were left out.", made.rejected > BAD_LOST)
        )
    if len(made.used) < FEW_FRAMES:
        found.append(Finding(f"only {len(made.used)} frames could be used; wave the wand for at least half a minute.", len(made.used) < 50))
    return found


def _moved(made: WandCalibration) -> list[Finding]:
    """Cameras that look elsewhere in one part of the recording than in another."""
    found = []
    steps, moments = jumps(made.sightings, made.residuals, len(made.rig))
    turns = steps / [camera.focal[0] for camera in made.rig]
    bad_turn = BAD_TURN[min(len(made.rig), 4) - 2]
    for camera, step, turn, moment in zip(made.rig, steps, turns, moments, strict=True):
        if turn > max(POOR_TURN, ECHO * turns.max()):
            found.append(
                Finding(
                    f"camera {camera.name} sees things {step:.1f} px elsewhere after {100 * moment:.0f} % of the recording than before; "
                    "was it moved while recording?",
                    bool(turn > bad_turn),
                )
            )
    usual, usual_part = 2.5 * float(np.median(made.lost)), 2.5 * _middle(made.lost_parts)
    for camera, lost, parts in zip(made.rig, made.lost, made.lost_parts, strict=True):
        bad = np.nonzero(parts > np.maximum(BAD_PART, usual_part))[0]
        if lost > max(POOR_LOST, usual) or len(bad):
            in_one = 0 < len(bad) < PARTS and np.ptp(bad) == len(bad) - 1
            begins, ends = (100 * edge // PARTS for edge in (bad.min(initial=PARTS), bad.max(initial=-1) + 1))
            when = f", most of it between {begins} and {ends} % of the recording" if in_one else ""
            sentence = f"{100 * lost:.0f} % of what camera {camera.name} saw contradicts the others{when}; was it moved while recording?"
            whole = lost > POOR_LOST and np.nan_to_num(parts).max() > WHOLE_PART
            found.append(Finding(sentence, bool(lost > BAD_LOST or whole or PARTS - 1 in bad)))
    return found


def _looking_up(made: WandCalibration) -> list[Finding]:
    """Whether the cameras hang below what they look at, by their own sense of up: so they seem to where y is counted from the bottom."""
    up = default_world(made.rig, made.positions)[0][2]
    below = [float(camera.rotation[2] @ up) > LOOKS_UP for camera in made.rig]
    if not all(below):
        return []
    return [
        Finding(
            "all cameras look up at the wand from below; if they hang above it, y is counted from the bottom in the images, and the rig "
            "is mirrored.",
            of_world=True,
        )
    ]


def _middle(parts: Floats) -> Floats:
    """(n,) the median over cameras of (C, n), 0 where none has a number."""
    return np.array([np.median(part[np.isfinite(part)]) if np.isfinite(part).any() else 0.0 for part in parts.T])


def _clocks(made: WandCalibration, clocks: Clocks) -> list[Finding]:
    found = []
    for camera, whole, part, drift in zip(made.rig, clocks.late, clocks.rest, clocks.drift, strict=True):
        if drift != 0.0:
            sentence = (
                f"camera {camera.name} takes its images {abs(drift):.1f} frames {'later' if drift > 0 else 'earlier'} in the last third "
                "of the recording than in the first; has it lost images, or another frame rate?"
            )
            found.append(Finding(sentence, abs(drift) > BAD_DRIFT))
        late = int(whole) + float(part)
        if late == 0.0:
            continue
        which, many = "late" if late > 0 else "early", abs(late)
        mended = "its images were moved for this calibration, but recordings need it mended."
        if part == 0.0:
            sentence = f"camera {camera.name} started {many:.0f} frame{'s' if many > 1 else ''} {which}; {mended}"
        else:
            sentence = f"camera {camera.name} takes its images {many:.2f} frames {which}; check its trigger: {mended}"
        found.append(Finding(sentence))
    return found


def _undetermined(made: WandCalibration) -> list[Finding]:
    """Parameters that this waving does not tell, by their standard deviations."""
    found = []
    middle = np.nanmedian(made.positions.reshape(-1, 3), axis=0)
    for c, camera in enumerate(made.rig):
        width = (camera.size or (1280, 1024))[0]
        focal = float(made.sigma[c, 6]) / camera.focal[0]
        place = float(made.place_sigma[c])
        far = max(float(np.linalg.norm(camera.position - middle)), 1e-9)
        if focal > POOR_FOCAL:
            known = "is not determined" if focal > BAD_FOCAL else f"is only known to {100 * focal:.1f} %"
            found.append(
                Finding(
                    f"the focal length of camera {camera.name} {known} by this wand; wave it nearer and farther away, too.",
                    focal > BAD_FOCAL,
                )
            )
        if place / far > POOR_PLACE:
            known = "is not determined" if place / far > BAD_PLACE else f"is only known to {1000 * place:.0f} mm"
            found.append(
                Finding(f"where camera {camera.name} stands {known} by this wand; wave it all over what it sees.", place / far > BAD_PLACE)
            )
        off = np.array(camera.centre) - 0.5 * (np.array(camera.size or camera.centre) - 1.0)
        if np.linalg.norm(off) > FAR_CENTRE * width:
            found.append(
                Finding(
                    f"the principal point of camera {camera.name} lies {abs(off[0]):.0f} px {'right' if off[0] > 0 else 'left'} of and "
                    f"{abs(off[1]):.0f} px {'below' if off[1] > 0 else 'above'} the image's middle; is the image size right?"
                )
            )
        if np.nanmax(made.sigma[c, 8:10]) > 0.015 * width:
            found.append(
                Finding(
                    f"the principal point of camera {camera.name} is not determined by this wand (within "
                    f"{np.nanmax(made.sigma[c, 8:10]):.0f} px); the middle of the image is assumed. Wave it up to the image's borders."
                )
            )
    return found


def _waved(made: WandCalibration) -> list[Finding]:
    """Whether the wand was waved through a volume and turned, by its positions and directions."""
    found: list[Finding] = []
    points = made.positions.reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 10:
        return found
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(points.T)), 0.0))
    wide = min(float(spread[2]), 0.35 * _distance(made))
    if spread[1] < 0.12 * wide:
        found.append(Finding("the wand was waved along a line only; wave it through the whole volume, up and down too.", True))
    elif spread[0] < 0.08 * wide:
        found.append(
            Finding("the wand was waved in a plane only; wave it through the whole volume, up and down too.", bool(spread[0] < 0.03 * wide))
        )
    seen = float(np.median([(cells > 0).mean() for cells in coverage(made)]))
    if seen < POOR_PART:
        found.append(
            Finding(
                f"the wand stayed in a small part of the volume, {' x '.join(f'{4.0 * part:.1f}' for part in spread[::-1])} m, which fills "
                f"{100 * seen:.0f} % of an image; points elsewhere can be off by more than is said here."
            )
        )
    if len(made.wand.lengths) > 1:
        along = made.positions[:, -1] - made.positions[:, 0]
        along = along[np.isfinite(along).all(axis=1)]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        if len(along) > 10 and np.linalg.eigvalsh(along.T @ along / len(along))[0] < 0.02:
            found.append(Finding("the wand was hardly turned; turn it in all directions while waving."))
    return found


def _distance(made: WandCalibration) -> float:
    """m, from the cameras to what they saw of the wand, the median."""
    seen = made.sightings
    points = made.positions[np.searchsorted(made.used, seen.frame), seen.point]
    eyes = np.stack([camera.position for camera in made.rig])
    return float(np.nanmedian(np.linalg.norm(points - eyes[seen.camera], axis=1)))


def _covered(made: WandCalibration) -> list[Finding]:
    found = []
    if made.lights.any():
        each = ", ".join(f"{count} in camera {camera.name}" for camera, count in zip(made.rig, made.lights, strict=True) if count)
        found.append(Finding(f"what never moved was left out: {each}; cover reflections before recording, or mask them.", advice=True))
    for camera, cells in zip(made.rig, coverage(made), strict=True):
        share = float((cells > 0).mean())
        if share < POOR_COVERAGE:
            found.append(
                Finding(
                    f"camera {camera.name} saw the wand in {100 * share:.0f} % of its image only ({_where_not(cells)} is missing); "
                    "its lens is a guess elsewhere.",
                    advice=True,
                )
            )
    return found


def _where_not(cells: Floats) -> str:
    """The side of an image that saw least."""
    rows, columns = cells.shape
    sides = {
        "the left": cells[:, : columns // 2],
        "the right": cells[:, columns // 2 :],
        "the top": cells[: rows // 2],
        "the bottom": cells[rows // 2 :],
    }
    return min(sides, key=lambda side: float((sides[side] > 0).mean()))
