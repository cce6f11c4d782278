"""A recording with the markers of a gait laboratory in; clinical angles of legs, trunk, head and arms out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.motion.clinical.gathered import gathered_measures
from asterism.motion.clinical.landmark_body import landmark_body, with_plug_in_gait_names, worn_landmarks
from asterism.motion.clinical.measures import SIDES, LegMeasures, SubjectMeasures
from asterism.motion.clinical.model import MODELS, ClinicalModel, wears_both_sides, wears_medial_markers
from asterism.motion.clinical.upper_body import arm_measures_needed
from asterism.motion.joints.anatomy import sacrum_markers
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
    findings  what was assumed or left out; model  by which they were computed
    """

    joints: tuple[ClinicalJoint, ...]
    measures: Mapping[str, LegMeasures]
    subject: SubjectMeasures = field(default_factory=SubjectMeasures)
    outputs: Mapping[str, Floats] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    model: ClinicalModel = field(default_factory=ClinicalModel)


def complete_legs(recording: Recording) -> tuple[str, ...]:
    """The sides, "L" and "R", of which all markers that clinical angles need are seen together in at least one frame.

    These are, after Helen Hayes and Plug-in-Gait: LASI, RASI, SACR or both LPSI and RPSI; and of the side THI, KNE, TIB, ANK.
    """
    recording = with_plug_in_gait_names(recording)
    return tuple(side for side in SIDES if not _missing(recording, side) and _seen_together(recording, side))


def clinical_angles(
    recording: Recording,
    sides: Sequence[str] | None = None,
    measures: SubjectMeasures | None = None,
    *,
    static: Recording | None = None,
    model: str | None = None,
) -> ClinicalAngles:
    """Flexion, adduction and internal rotation of hip, knee and ankle; angles of pelvis, feet, trunk, head and arms.

    sides     "L", "R" or both; by default those with a joint
    measures  of the person; by default those of the recording's file (`gathered_measures`)
    static    a standing trial; it carries medial markers that it alone shows
    model     "plug-in-gait" or "landmarks", see `landmark_body`; by default the latter where the recording shows both sides of a knee and
              of its ankle, or no leg of the former

    With the measures of the file, angles of Plug-in-Gait are those that the vendor computes, to the digits that a file holds: hip centres
    by Davis et al. (1991), wand angles about the line between the joint centres, the tibia's torsion, the foot's offsets.
    `with_static_offsets` takes the offsets from a standing trial. Without TOE there is no ankle; of a leg without one marker, what can be
    computed is, and the rest is said. Raises AsterismError where a side that is asked for lacks a marker or is none, where no angle can be
    computed, and for a model of another name. O(T).

    >>> from asterism.simulation import simulate_walks
    >>> walk = simulate_walks(1, frames=120, seed=0)[0]
    >>> flexion = {joint.name: joint.angles[:, 0] for joint in clinical_angles(walk).joints}
    >>> bool(0.9 < flexion["left knee"].max() < 1.6)
    True
    """
    if model is not None and model not in MODELS:
        raise AsterismError(f"{model} is no model; take {' or '.join(MODELS)}.")
    named = with_plug_in_gait_names(recording)
    legs = "".join(side for side in SIDES if _has_hip(named, side))
    model = model or ("landmarks" if wears_medial_markers(recording) or not legs else "plug-in-gait")
    found: Sequence[Finding] = ()
    if measures is None:
        measures, found = gathered_measures(recording, static)
    # Sides that are asked for are demanded; sides that are found are complete already.
    for side in sides or ():
        if side not in SIDES:
            raise AsterismError(f"{side} is no side; give L or R.")
        if model == "plug-in-gait":
            _demand(named, side)
    chosen = ClinicalModel(model, measures, "".join(sides) if sides is not None else legs if model == "plug-in-gait" else "LR", static)
    outputs = chosen.outputs(recording) if chosen.sides and (model != "plug-in-gait" or legs) else {}
    joints = tuple(
        ClinicalJoint(SIDES[side], joint, outputs[name])
        for side in chosen.sides
        for joint in JOINTS
        if (name := f"{side}{joint.title()}Angles") in outputs
    )
    if not joints and (sides is not None or "LPelvisAngles" not in outputs):
        raise AsterismError(_nothing(named))
    if model == "plug-in-gait":
        found = [*_assumed(recording, measures, chosen.sides), *_assumed_arms(recording, measures, outputs), *found]
    else:
        found = [_told(recording, chosen), *_assumed_arms(recording, measures, outputs), *found]
    found = [*found, *_left_out(recording, chosen, outputs, sides or tuple(SIDES))]
    known = dict.fromkeys(joint.side for joint in joints)
    return ClinicalAngles(joints, {side: measures.of(side[0].upper()) for side in known}, measures, outputs, tuple(found), chosen)


def _has_hip(recording: Recording, side: str) -> bool:
    """Whether pelvis and thigh of Plug-in-Gait are seen together."""
    names = [name for name in _needed(recording, side) if name[1:] not in ("TIB", "ANK")]
    return all(name in recording.labels for name in names) and _together(recording, names)


def _nothing(recording: Recording) -> str:
    missing = min((_missing(recording, side) for side in SIDES), key=len)
    if wears_both_sides(recording):
        seen = {label for label, shown in zip(recording.labels, np.asarray(recording.visible.any(axis=0)), strict=True) if shown}
        missing = [name for name in ("LASI", "RASI", *sacrum_markers(recording)) if name not in seen]
    said = f"has no marker {', '.join(missing)}" if missing else "never shows all markers of a leg in one frame"
    return (
        f"{_file(recording)} {said}; clinical angles need the markers of Helen Hayes or Plug-in-Gait, or pelvis, epicondyles and "
        "malleoli, the medial ones at least in a standing trial."
    )


def _told(recording: Recording, model: ClinicalModel) -> Finding:
    """Which model it is: not everybody expects another one than Plug-in-Gait."""
    carried = landmark_body(recording, model.measures, model.static)
    names = "" if carried is None or not carried.carried else f"; carried over from the standing trial: {', '.join(carried.carried)}"
    sentence = f"{_file(recording)}: angles by {model.title(recording)}, hip centres by {model.hip}{names}."
    return Finding("clinical-model", Severity.NOTE, _file(recording), sentence, "Another model can be asked for with --lower-body.")


def _left_out(recording: Recording, model: ClinicalModel, outputs: Mapping[str, Floats], sides: Sequence[str]) -> list[Finding]:
    """Joints of legs that lack a marker in all frames."""
    found = []
    seen = {label for label, shown in zip(recording.labels, np.asarray(recording.visible.any(axis=0)), strict=True) if shown}
    made = landmark_body(recording, model.measures, model.static) if model.name == "landmarks" else None
    roles = {role for role, column in worn_landmarks(recording).roles.items() if recording.labels[column] in seen}
    roles |= set(() if made is None else made.carried)
    # of a set with wands these are missed first, but where medial markers are worn
    named = with_plug_in_gait_names(recording)
    shown = {label for label, shown in zip(named.labels, np.asarray(recording.visible.any(axis=0)), strict=True) if shown}
    wands = any(side + name in named.labels for side in SIDES for name in ("THI", "TIB")) and not roles & {"LME", "RME", "LMM", "RMM"}
    for side in sides:
        absent = [joint for joint in JOINTS if f"{side}{joint.title()}Angles" not in outputs]
        back = "SACR" in roles or {"LPSI", "RPSI"} <= roles
        pelvis = [name for name in ("LASI", "RASI", *(() if back else ("LPSI", "RPSI"))) if name not in roles]
        known, lacking = roles, [*pelvis, *(side + role for role in ("LE", "ME", "LM", "MM", "CA") if side + role not in roles)]
        if model.name == "plug-in-gait" or wands:
            known, lacking = shown, [name for name in _needed(named, side) if name not in shown]
            # a set that has no toe has no ankle, which is no loss
            lacking += [f"{side}TOE"] if f"{side}TOE" in {*named.labels} - shown else []
        if absent and (lacking or absent != ["ankle"]):
            why = f"{', '.join(lacking)} cannot be seen" if lacking else "its markers are never seen together, or lie in one place"
            sentence = f"{_file(recording)}: no angles of the {SIDES[side]} {', '.join(absent)}: {why}."
            # a set without this marker on either side is no leg with a gap
            gap = {*lacking} & {*named.labels} or {{"L": "R", "R": "L"}.get(name[0], "") + name[1:] for name in lacking} & known
            mend = "Fill its gaps (--fill), or give a standing trial with markers on both sides of knee and ankle (--static)."
            if model.static is not None and model.name == "landmarks":
                mend = "The standing trial carries a landmark by three markers that both trials show on the limb."
            severity = Severity.WARNING if gap or not lacking else Severity.NOTE
            found.append(Finding("clinical-left-out", severity, _file(recording), sentence, mend))
    return found


def _assumed(recording: Recording, measures: SubjectMeasures, sides: Sequence[str]) -> list[Finding]:
    """A finding for each leg whose widths nobody gave: they move the joint by half of their error."""
    found = []
    for side in sides:
        needed = {"knee_width": "an adult's width", "ankle_width": "an adult's width", "leg_length": "a hip by the width of the pelvis"}
        if measures.hip_regression is not None:
            del needed["leg_length"]
        lacking = [name for name in needed if name not in measures.of(side).from_file]
        taken = " and ".join(dict.fromkeys(needed[name] for name in lacking))
        found += _lacking(recording, lacking, f"{SIDES[side]} leg, so that it has {taken}")
    return found


def _assumed_arms(recording: Recording, measures: SubjectMeasures, outputs: Mapping[str, Floats]) -> list[Finding]:
    """A finding for each arm whose measures nobody gave: a centimetre turns the upper arm by two to three degrees."""
    found = []
    for side in SIDES:
        lacking = [name for name in arm_measures_needed(outputs, side) if name not in measures.arm(side).from_file]
        found += _lacking(recording, lacking, f"{SIDES[side]} arm; an adult's were taken")
    return found


def _lacking(recording: Recording, lacking: Sequence[str], of: str) -> list[Finding]:
    if not lacking:
        return []
    words = ", ".join(name.replace("_", " ") for name in lacking)
    mend = "Give the measures, or a standing trial that holds them."
    return [Finding("clinical-measures", Severity.NOTE, _file(recording), f"{_file(recording)} has no {words} of the {of}.", mend)]


def _file(recording: Recording) -> str:
    return str(recording.metadata.get("file", "the recording"))


def _needed(recording: Recording, side: str) -> list[str]:
    return ["LASI", "RASI", *sacrum_markers(recording), *(side + name for name in _LEG)]


def _missing(recording: Recording, side: str) -> list[str]:
    return [name for name in _needed(recording, side) if name not in recording.labels]


def _seen_together(recording: Recording, side: str) -> bool:
    return _together(recording, _needed(recording, side))


def _together(recording: Recording, names: Sequence[str]) -> bool:
    columns = [recording.labels.index(name) for name in names]
    return bool(recording.visible[:, columns].all(axis=1).any())


def _demand(recording: Recording, side: str) -> None:
    if missing := _missing(recording, side):
        raise AsterismError(f"{_file(recording)} has no marker {', '.join(missing)}, which the {SIDES[side]} leg's angles need.")
    if not _seen_together(recording, side):
        raise AsterismError(f"{_file(recording)}: the markers of the {SIDES[side]} leg are never seen in one frame.")
