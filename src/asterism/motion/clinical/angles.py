"""A recording with the markers of a gait laboratory in; clinical angles of legs, trunk, head and arms out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.motion.clinical.gathered import gathered_measures
from asterism.motion.clinical.measures import SIDES, LegMeasures, SubjectMeasures
from asterism.motion.clinical.plug_in_gait import angles_of, lower_body, walking_axes
from asterism.motion.clinical.upper_body import arm_measures_needed, upper_body_angles
from asterism.motion.joints.anatomy import AnatomicalFrames, sacrum_markers
from asterism.recording import Floats, Recording

CLINICAL = ("flexion", "adduction", "rotation")
"""The angles of a joint, in this order; positive are flexion (dorsiflexion), adduction and internal rotation, on both sides."""
JOINTS = ("hip", "knee", "ankle")
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
    """The angles of one recording.

    joints    of the legs, left before right
    measures  by side, "left" and "right", with which they were computed; `subject` all of them
    outputs   (T, 3) rad by Plug-in-Gait's names, such as LPelvisAngles: the joints', and those of pelvis, feet, trunk, head and arms
    findings  what was assumed or left out
    """

    joints: tuple[ClinicalJoint, ...]
    measures: Mapping[str, LegMeasures]
    subject: SubjectMeasures = field(default_factory=SubjectMeasures)
    outputs: Mapping[str, Floats] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()


def complete_legs(recording: Recording) -> tuple[str, ...]:
    """The sides, "L" and "R", of which all markers that clinical angles need are seen together in at least one frame.

    These are, after Helen Hayes and Plug-in-Gait: LASI, RASI, SACR or both LPSI and RPSI; and of the side THI, KNE, TIB, ANK.
    """
    return tuple(side for side in SIDES if not _missing(recording, side) and _seen_together(recording, side))


def clinical_angles(recording: Recording, sides: Sequence[str] | None = None, measures: SubjectMeasures | None = None) -> ClinicalAngles:
    """Flexion, adduction and internal rotation of hip, knee and ankle; angles of pelvis, feet, trunk, head and arms: Plug-in-Gait's.

    sides     "L", "R" or both; by default those with all markers
    measures  of the person; by default those of the recording's file (`gathered_measures`)

    With the measures of the file, angles are those that Plug-in-Gait computes, to the digits that a file holds: hip centres by Davis et
    al. (1991), wand angles about the line between the joint centres, the tibia's torsion, the foot's offsets. `with_static_offsets`
    takes the offsets from a standing trial. Without TOE there is no ankle.
    Raises AsterismError where a side lacks a marker or is none, and where no side has all markers. O(T).

    >>> from asterism.simulation import simulate_walks
    >>> walk = simulate_walks(1, frames=120, seed=0)[0]
    >>> flexion = {joint.name: joint.angles[:, 0] for joint in clinical_angles(walk).joints}
    >>> bool(0.9 < flexion["left knee"].max() < 1.6)
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
    found: Sequence[Finding] = ()
    if measures is None:
        measures, found = gathered_measures(recording)
    body = lower_body(recording, measures, "".join(chosen))
    outputs = angles_of(recording, body) | upper_body_angles(recording, measures, walking_axes(body))
    found = [*_assumed(recording, measures, chosen), *_assumed_arms(recording, measures, outputs), *found]
    joints = tuple(
        ClinicalJoint(SIDES[side], joint, outputs[name])
        for side in chosen
        for joint in JOINTS
        if (name := f"{side}{joint.title()}Angles") in outputs
    )
    return ClinicalAngles(joints, {SIDES[side]: measures.of(side) for side in chosen}, measures, outputs, tuple(found))


def leg_axes(recording: Recording, side: str, measures: LegMeasures) -> AnatomicalFrames:
    """The frames of one leg in the axes of ISB, x ahead, y up, z to the right, z up in the room; see `lower_body` for Plug-in-Gait's own.

    Raises AsterismError where a marker is missing.
    """
    body = lower_body(recording, SubjectMeasures().with_leg(side, measures), side)
    leg = body.legs[side]

    def isb(axes: Floats) -> Floats:
        return np.stack([axes[:, :, 0], axes[:, :, 2], -axes[:, :, 1]], axis=2)

    return AnatomicalFrames(isb(body.pelvis), isb(leg.thigh), isb(leg.shank), leg.hip, leg.knee, leg.ankle)


def _assumed(recording: Recording, measures: SubjectMeasures, sides: Sequence[str]) -> list[Finding]:
    """A finding for each leg whose widths nobody gave: they move the joint by half of their error."""
    found = []
    for side in sides:
        lacking = [name for name in ("knee_width", "ankle_width", "leg_length") if name not in measures.of(side).from_file]
        if lacking:
            words = ", ".join(name.replace("_", " ") for name in lacking)
            found.append(
                Finding(
                    "clinical-measures",
                    Severity.NOTE,
                    _file(recording),
                    f"{_file(recording)} has no {words} of the {SIDES[side]} leg; an adult's widths were taken, "
                    "and the hip by the width of the pelvis.",
                    "Give the measures, or a standing trial that holds them.",
                )
            )
    return found


def _assumed_arms(recording: Recording, measures: SubjectMeasures, outputs: Mapping[str, Floats]) -> list[Finding]:
    """A finding for each arm whose measures nobody gave: a centimetre turns the upper arm by two to three degrees."""
    found = []
    for side in SIDES:
        lacking = [name for name in arm_measures_needed(outputs, side) if name not in measures.arm(side).from_file]
        if lacking:
            words = ", ".join(name.replace("_", " ") for name in lacking)
            found.append(
                Finding(
                    "clinical-measures",
                    Severity.NOTE,
                    _file(recording),
                    f"{_file(recording)} has no {words} of the {SIDES[side]} arm; an adult's were taken.",
                    "Give the measures, or a standing trial that holds them.",
                )
            )
    return found


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
