"""A recording with the markers of a gait laboratory in; clinical angles of hip, knee and ankle out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.errors import AsterismError
from asterism.motion.clinical.measures import LegMeasures, leg_measures
from asterism.motion.joints.anatomy import AnatomicalFrames, leg_frames, sacrum_markers
from asterism.motion.joints.angles import grood_suntay
from asterism.motion.rigid.rotations import unit_vectors
from asterism.recording import Floats, Recording

CLINICAL = ("flexion", "adduction", "rotation")
"""The angles of a joint, in this order; positive are flexion (dorsiflexion), adduction and internal rotation, on both sides."""
SIDES = {"L": "left", "R": "right"}
_LEG = ("THI", "KNE", "TIB", "ANK")


@dataclass(frozen=True)
class ClinicalJoint:
    """The angles of one joint of one side.

    side    "left" or "right"; joint "hip", "knee" or "ankle"
    angles  (T, 3) rad: flexion, adduction, internal rotation; NaN where markers are missing
    """

    side: str
    joint: str
    angles: Floats

    @property
    def name(self) -> str:
        """Such as "left knee"."""
        return f"{self.side} {self.joint}"


@dataclass(frozen=True)
class ClinicalAngles:
    """The joints of the legs, left before right, and the measures by side with which they were computed."""

    joints: tuple[ClinicalJoint, ...]
    measures: Mapping[str, LegMeasures]


def complete_legs(recording: Recording) -> tuple[str, ...]:
    """The sides, "L" and "R", of which all markers that clinical angles need are seen together in at least one frame.

    These are, after Helen Hayes and Plug-in-Gait: LASI, RASI, SACR or both LPSI and RPSI; and of the side THI, KNE, TIB, ANK.
    """
    return tuple(side for side in SIDES if not _missing(recording, side) and _seen_together(recording, side))


def clinical_angles(recording: Recording, sides: Sequence[str] | None = None) -> ClinicalAngles:
    """Flexion, adduction and internal rotation of hip, knee and ankle (Grood and Suntay 1983; ISB, Wu et al. 2002), over time.

    sides  "L", "R" or both; by default those with all markers

    Frames are those of `leg_frames`, with the measures that the file holds (`leg_measures`): widths, and how far the wands of thigh and
    shank are turned, about which the markers are turned back first. The hip centre is Bell's (1990), not Davis', and no torsion of
    the tibia is taken off: against Plug-in-Gait the angles of a subject differ by an offset. The foot is the line from ankle to TOE,
    as in Plug-in-Gait; a line leaves its own turn open, so the ankle's adduction (inversion) is NaN. Without TOE there is no ankle.
    Raises AsterismError where a side lacks a marker or is none, and where no side has all markers. O(T).

    >>> from asterism.simulation import simulate_walks
    >>> walk = simulate_walks(1, frames=120, seed=0)[0]
    >>> angles = {joint.name: np.degrees(joint.angles[:, 0]) for joint in clinical_angles(walk).joints}
    >>> bool(50 < angles["left knee"].max() < 90)
    True
    """
    chosen = complete_legs(recording) if sides is None else tuple(sides)
    # Sides that are asked for are demanded; sides that are found are complete already.
    for side in chosen if sides is not None else ():
        _demand(recording, side)
    if not chosen:
        missing = min((_missing(recording, side) for side in SIDES), key=len)
        said = f"has no marker {', '.join(missing)}" if missing else "never shows all markers of a leg in one frame"
        raise AsterismError(f"{_file(recording)} {said}; clinical angles need the markers of Helen Hayes or Plug-in-Gait.")
    measures = {SIDES[side]: leg_measures(recording, side) for side in chosen}
    joints = [joint for side in chosen for joint in leg_angles(recording, side, measures[SIDES[side]])]
    return ClinicalAngles(tuple(joints), measures)


def _file(recording: Recording) -> str:
    return str(recording.metadata.get("file", "the recording"))


def _needed(recording: Recording, side: str) -> list[str]:
    return ["LASI", "RASI", *sacrum_markers(recording), *(side + name for name in _LEG)]


def _missing(recording: Recording, side: str) -> list[str]:
    return [name for name in _needed(recording, side) if name not in recording.labels]


def _seen_together(recording: Recording, side: str) -> bool:
    columns = [recording.labels.index(name) for name in _needed(recording, side)]
    return bool(recording.visible[:, columns].all(axis=1).any())


def _demand(recording: Recording, side: str) -> None:
    if side not in SIDES:
        raise AsterismError(f"{side} is no side; give L or R.")
    if missing := _missing(recording, side):
        raise AsterismError(f"{_file(recording)} has no marker {', '.join(missing)}, which the {SIDES[side]} leg's angles need.")
    if not _seen_together(recording, side):
        raise AsterismError(f"{_file(recording)}: the markers of the {SIDES[side]} leg are never seen in one frame.")


def leg_angles(recording: Recording, side: str, measures: LegMeasures) -> list[ClinicalJoint]:
    """Hip, knee and, with TOE, ankle of one side, by given measures; see `clinical_angles`.

    Raises AsterismError where a marker is missing.
    """
    right = 1.0 if side == "R" else -1.0
    frames = leg_axes(recording, side, measures)
    # Axes point right on both sides, so adduction and rotation of a left leg change sign.
    mirrored = np.array([1.0, right, right])
    hip = grood_suntay(frames.pelvis, frames.thigh) * mirrored
    # A knee bends backwards: its flexion is the negative turn about z.
    knee = grood_suntay(frames.thigh, frames.shank) * mirrored * [-1.0, 1.0, 1.0]
    joints = [ClinicalJoint(SIDES[side], "hip", hip), ClinicalJoint(SIDES[side], "knee", knee)]
    if f"{side}TOE" in recording.labels:
        foot = _foot(frames, recording.positions[:, recording.labels.index(f"{side}TOE")])
        ankle = grood_suntay(frames.shank, foot) * mirrored + [measures.foot_flexion, 0.0, 0.0]
        # The line from ankle to toe has no turn about itself.
        ankle[:, 1] = np.nan
        joints.append(ClinicalJoint(SIDES[side], "ankle", ankle))
    return joints


def leg_axes(recording: Recording, side: str, measures: LegMeasures) -> AnatomicalFrames:
    """The leg's frames, in m, after the wands of thigh and shank are turned back: the shank's needs the knee, which needs the thigh's."""
    widths = {"knee_width": measures.knee_width, "ankle_width": measures.ankle_width}
    # The thigh first: the knee centre, on which the shank's turn rests, moves with it.
    for wand, end, angle in (("THI", "KNE", measures.thigh_rotation), ("TIB", "ANK", measures.shank_rotation)):
        if angle:
            frames = leg_frames(recording, side, **widths)
            upper = frames.hip if wand == "THI" else frames.knee
            recording = _turned(recording, side + wand, side + end, upper, -angle if side == "R" else angle)
    return leg_frames(recording, side, **widths)


def _turned(recording: Recording, wand: str, end: str, upper: Floats, angle: float) -> Recording:
    """The recording with the marker `wand` turned by an angle (rad) about the line from the upper joint (T, 3) to the marker `end`."""
    positions = recording.positions.copy()
    marker = positions[:, recording.labels.index(end)]
    axis = unit_vectors(marker - upper)
    arm = positions[:, recording.labels.index(wand)] - marker
    along = axis * np.einsum("ti,ti->t", axis, arm)[:, None]
    # Rodrigues about the limb's line.
    turned = arm * np.cos(angle) + np.cross(axis, arm) * np.sin(angle) + along * (1 - np.cos(angle))
    positions[:, recording.labels.index(wand)] = marker + turned
    return replace(recording, positions=positions)


def _foot(frames: AnatomicalFrames, toe: Floats) -> Floats:
    """(T, 3, 3): x from the ankle to the toe marker, z the shank's z as far as it is across x."""
    x = unit_vectors(toe - frames.ankle)
    y = unit_vectors(np.cross(frames.shank[:, :, 2], x))
    return np.stack([x, y, np.cross(x, y)], axis=2)
