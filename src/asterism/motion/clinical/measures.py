"""A recording in; the measures of a subject's legs, which its file may hold, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import Floats, Recording, without_subject

SIDES = {"L": "left", "R": "right"}
MARKER_RADIUS = 0.007
"""m: half of the 14 mm that Plug-in-Gait takes where nothing else is said."""

_LENGTHS = {
    "leg_length": ("LEGLENGTH", 0.3, 1.4),
    "knee_width": ("KNEEWIDTH", 0.02, 0.25),
    "ankle_width": ("ANKLEWIDTH", 0.02, 0.25),
    "asis_trochanter": ("ASISTROCANTERDISTANCE", 0.01, 0.25),
}
"""The parameter of a length, and in which range (m) it is believed: another value may be in another unit."""
_ARM_LENGTHS = {
    "shoulder_offset": ("SHOULDEROFFSET", 0.005, 0.15),
    "elbow_width": ("ELBOWWIDTH", 0.02, 0.2),
    "wrist_width": ("WRISTWIDTH", 0.0, 0.12),
    "hand_thickness": ("HANDTHICKNESS", 0.005, 0.08),
}
"""The same of an arm. A wrist of no width is one whose markers stand beside the bones."""
_TURNS = {
    "thigh_rotation": "THIGHROTATION",
    "shank_rotation": "SHANKROTATION",
    "tibial_torsion": "TIBIALTORSION",
    "ankle_tilt": "ANKLEABADD",
    "foot_flexion": "STATICPLANTFLEX",
    "foot_rotation": "STATICROTOFF",
}
_WHOLE = {
    "INTERASISDISTANCE": ("inter_asis", 0.001, 50.0, 500.0, "mm"),
    "MARKERDIAMETER": ("marker_radius", 0.0005, 1.0, 60.0, "mm"),
    "BODYMASS": ("mass", 1.0, 2.0, 400.0, "kg"),
    "HEADOFFSET": ("head_offset", float(np.pi / 180), -90.0, 90.0, "degrees"),
}
"""Of the whole person: the field, its unit by that of `SubjectMeasures.with_values`, and the least and largest that anybody has, from a
newborn to the heaviest. They tell metres, grams and no number; half and double change nothing of that."""
_RIGHT_ANGLE = np.pi / 2 + 1e-3
"""rad: a wand may stand in front of a limb, so up to a right angle; what lies beyond is in degrees, or no such angle."""


@dataclass(frozen=True)
class LegMeasures:
    """Measures of one leg, as Plug-in-Gait has them.

    knee_width, ankle_width  m, between the condyles and between the malleoli. The defaults are an adult's
    leg_length               m, from the anterior iliac spine to the medial malleolus; None: the hip is put by the pelvis' width
    asis_trochanter          m, from the spine backwards to the trochanter; None: by the leg's length (Davis et al. 1991)
    thigh_rotation, shank_rotation  rad, by which the wand stands behind the joint's axis, about the line between the joint centres
    tibial_torsion           rad, from the ankle's axis to the knee's; negative where the ankle turns outwards
    ankle_tilt               rad, by which the ankle's axis is off a right angle with the shank
    foot_flexion             rad, between the line from ankle to toe and the sole in the standing trial
    foot_rotation            rad, the same line's turn against the foot's axis
    from_file                which of these the recording's file holds, or were given
    """

    knee_width: float = 0.10
    ankle_width: float = 0.07
    thigh_rotation: float = 0.0
    shank_rotation: float = 0.0
    foot_flexion: float = 0.0
    from_file: tuple[str, ...] = ()
    leg_length: float | None = None
    asis_trochanter: float | None = None
    tibial_torsion: float = 0.0
    ankle_tilt: float = 0.0
    foot_rotation: float = 0.0

    def with_values(self, values: Mapping[str, float]) -> LegMeasures:
        """With these measures, m and rad, which count as given."""
        return replace(self, **values, from_file=tuple(dict.fromkeys((*self.from_file, *values))))


@dataclass(frozen=True)
class ArmMeasures:
    """Measures of one arm, m, as Plug-in-Gait has them. The defaults are an adult's.

    shoulder_offset  from the acromion down to the joint's centre
    elbow_width      between the epicondyles
    wrist_width      from front to back, where the bar or the markers of the wrist are; nothing where these stand beside the bones
    hand_thickness   from the palm to the back of the hand, below the knuckle's marker
    from_file        which of these the recording's file holds, or were given
    """

    shoulder_offset: float = 0.045
    elbow_width: float = 0.070
    wrist_width: float = 0.040
    hand_thickness: float = 0.028
    from_file: tuple[str, ...] = ()

    def with_values(self, values: Mapping[str, float]) -> ArmMeasures:
        """With these measures, m, which count as given."""
        return replace(self, **values, from_file=tuple(dict.fromkeys((*self.from_file, *values))))


@dataclass(frozen=True)
class SubjectMeasures:
    """Measures of a person.

    left, right          see `LegMeasures`
    inter_asis           m, between the anterior iliac spines; None: measured between their markers
    marker_radius        m, from the skin to a marker's centre
    mass                 kg, None where it is not known
    left_arm, right_arm  see `ArmMeasures`
    hip_regression       the regression of the hip centres, of `asterism.motion.clinical.hip.REGRESSIONS`; None: the model's own
    head_offset          rad, by which the markers of the head look up where the head looks straight ahead
    pelvis_depth         m, from midway between these spines to the sacrum; None: measured between their markers
    """

    left: LegMeasures = field(default_factory=LegMeasures)
    right: LegMeasures = field(default_factory=LegMeasures)
    inter_asis: float | None = None
    marker_radius: float = MARKER_RADIUS
    mass: float | None = None
    left_arm: ArmMeasures = field(default_factory=ArmMeasures)
    right_arm: ArmMeasures = field(default_factory=ArmMeasures)
    head_offset: float = 0.0
    hip_regression: str | None = None
    pelvis_depth: float | None = None

    def of(self, side: str) -> LegMeasures:
        """The leg of side "L" or "R"."""
        return self.left if side == "L" else self.right

    def arm(self, side: str) -> ArmMeasures:
        """The arm of side "L" or "R"."""
        return self.left_arm if side == "L" else self.right_arm

    def with_arm(self, side: str, arm: ArmMeasures) -> SubjectMeasures:
        """With another arm on side "L" or "R"."""
        return replace(self, left_arm=arm) if side == "L" else replace(self, right_arm=arm)

    def with_leg(self, side: str, leg: LegMeasures) -> SubjectMeasures:
        """With another leg on side "L" or "R"."""
        return replace(self, left=leg) if side == "L" else replace(self, right=leg)

    def with_values(self, values: Mapping[str, float]) -> SubjectMeasures:
        """With measures by Plug-in-Gait's names, such as LKneeWidth: lengths in mm, turns in degrees, mass in kg.

        Raises AsterismError for a name that is no measure, and for a value that no person has.

        >>> SubjectMeasures().with_values({"LKneeWidth": 100, "MarkerDiameter": 14}).left.knee_width
        0.1
        """
        changed = self
        for name, value in values.items():
            changed = changed._with_value(name, value)
        return changed

    def value_of(self, name: str) -> float | None:
        """A measure by the names and in the units of `with_values`; None where a usual one stands for it.

        >>> SubjectMeasures().with_values({"LKneeWidth": 100}).value_of("LKNEEWIDTH"), SubjectMeasures().value_of("LKneeWidth")
        (100.0, None)
        """
        key = name.upper()
        if key in _WHOLE:
            attribute, unit = _WHOLE[key][:2]
            value = getattr(self, attribute)
            return None if value is None or value == getattr(SubjectMeasures(), attribute) else float(value / unit)
        parts: tuple[LegMeasures | ArmMeasures, ...] = (self.of(key[:1]), self.arm(key[:1])) if key[:1] in SIDES else ()
        for part in parts:
            for measure in part.from_file:
                if measure in _TURNS and _TURNS[measure] == key[1:]:
                    return float(np.degrees(getattr(part, measure)))
                if (_LENGTHS | _ARM_LENGTHS).get(measure, ("",))[0] == key[1:]:
                    return float(1000.0 * getattr(part, measure))
        return None

    def _with_value(self, name: str, value: float) -> SubjectMeasures:
        key = name.upper()
        if key in _WHOLE:
            _, _, least, most, unit = _WHOLE[key]
            if not least <= value <= most:
                raise AsterismError(f"{name} is {value:g}; give it in {unit}, from {least:g} to {most:g}.")
            return replace(self, **{_WHOLE[key][0]: value * _WHOLE[key][1]})  # type: ignore[arg-type]
        side, parameter = key[:1], key[1:]
        lengths = _LENGTHS | _ARM_LENGTHS
        measure = next((one for one, (own, _, _) in lengths.items() if own == parameter), None)
        turn = next((one for one, own in _TURNS.items() if own == parameter), None)
        if side not in SIDES or (measure is None and turn is None):
            known = [f"{letter}{own.title()}" for letter in SIDES for own, _, _ in lengths.values()]
            raise AsterismError(
                f"{name} is no measure of a person; measures are {', '.join(known)}, InterAsisDistance, MarkerDiameter, BodyMass "
                "and the turns of Plug-in-Gait, such as LTibialTorsion."
            )
        if measure is not None:
            _, least, most = lengths[measure]
            if not least <= value * 0.001 <= most:
                raise AsterismError(f"{name} is {value:g}; give it in mm, from {1000 * least:g} to {1000 * most:g}.")
            if measure in _ARM_LENGTHS:
                return self.with_arm(side, self.arm(side).with_values({measure: value * 0.001}))
            return self.with_leg(side, self.of(side).with_values({measure: value * 0.001}))
        if not abs(value) <= 90.0:
            raise AsterismError(f"{name} is {value:g}; give it in degrees, from -90 to 90.")
        return self.with_leg(side, self.of(side).with_values({str(turn): float(np.radians(value))}))


def measure_names() -> set[str]:
    """Names of `SubjectMeasures.with_values`, in capitals."""
    sided = [own for own, _, _ in (_LENGTHS | _ARM_LENGTHS).values()] + list(_TURNS.values())
    return {*_WHOLE, *(side + own for side in SIDES for own in sided)}


def subject_measures(recording: Recording) -> SubjectMeasures:
    """The measures of the PROCESSING group of the recording's C3D file; usual ones where it has none.

    Plug-in-Gait writes lengths in the unit of the points and turns in radians. A value that no person has counts as absent.
    """
    read = _reader_of(recording)
    left, right = (_leg(recording, side, read) for side in SIDES)
    inter = _length(read("INTERASISDISTANCE"), recording, 0.05, 0.5)
    mass = read("BODYMASS")
    radius = named_radius(recording) or MARKER_RADIUS
    left_arm, right_arm = (_arm(recording, side, read) for side in SIDES)
    head = read("HEADOFFSET")
    return SubjectMeasures(
        left,
        right,
        inter,
        radius,
        mass if mass is not None and 2.0 < mass < 400.0 else None,
        left_arm,
        right_arm,
        float(head) if head is not None and abs(head) < _RIGHT_ANGLE else 0.0,
    )


def named_radius(recording: Recording) -> float | None:
    """m: the markers' radius that the recording's file names; None where it names none."""
    diameter = _length(_reader_of(recording)("MARKERDIAMETER"), recording, 0.002, 0.05)
    return None if diameter is None else diameter / 2


def leg_measures(recording: Recording, side: str) -> LegMeasures:
    """The measures of the leg of this side ("L" or "R"), see `subject_measures`."""
    return _leg(recording, side, _reader_of(recording))


def _reader_of(recording: Recording) -> Any:
    number = getattr(getattr(recording.source, "parameters", None), "number", None)
    return (lambda name: None) if number is None else (lambda name: number("PROCESSING", name))


def _lengths(recording: Recording, side: str, read: Any, known: Mapping[str, tuple[str, float, float]]) -> dict[str, float]:
    lengths = {name: _length(read(side + parameter), recording, least, most) for name, (parameter, least, most) in known.items()}
    return {name: length for name, length in lengths.items() if length is not None}


def _arm(recording: Recording, side: str, read: Any) -> ArmMeasures:
    return ArmMeasures().with_values(_lengths(recording, side, read, _ARM_LENGTHS))


def _leg(recording: Recording, side: str, read: Any) -> LegMeasures:
    measures = _lengths(recording, side, read, _LENGTHS)
    for measure, parameter in _TURNS.items():
        value = read(side + parameter)
        if value is not None and 0.0 < abs(value) <= _RIGHT_ANGLE:
            measures[measure] = float(value)
    return LegMeasures().with_values(measures)


def _length(value: float | None, recording: Recording, least: float, most: float) -> float | None:
    """m; None for a value that no person has."""
    # Lengths are in the unit of the points, which may be mm or m; where programs changed that of the points alone, they are still in mm.
    metres = float(recording.metadata.get("metres_per_unit", 0.001) or 0.001)
    lengths = [] if value is None else [float(value * unit) for unit in (metres, 0.001)]
    return next((length for length in lengths if least <= length <= most), None)


def computed_by_the_file(recording: Recording, name: str) -> Floats | None:
    """A quantity that the file's own program computed, such as "LHipAngles", (T, 3) in the file's unit; NaN where it has none.

    None where the file has no such column, and for a recording that shows other frames than its file.
    """
    return all_computed_by_the_file(recording, (name,)).get(name)


def all_computed_by_the_file(recording: Recording, names: Sequence[str]) -> dict[str, Floats]:
    """Those of several quantities that the file has, as `computed_by_the_file` gives one; its points are read once."""
    labels = [without_subject(str(label)) for label in getattr(recording.source, "labels", ())]
    columns = {name: labels.index(name) for name in names if name in labels}
    if not columns:
        return {}
    if recording.source.layout.frames != len(recording):
        return {}
    coordinates = recording.source.coordinates_of(slice(None), list(columns.values()))
    found = {name: coordinates[:, place].copy() for place, name in enumerate(columns)}
    for values in found.values():
        values[(values == 0.0).all(axis=1)] = np.nan
    return found
