"""Markers of Plug-in-Gait's full body and measures of the person in; angles of head, neck, shoulders, elbows and wrists out.

Sources: the vendor's documentation of the upper body, and Davis et al. (1991) for the chord by which joint centres are found. What these
leave open was settled by the segments that recordings of three laboratories hold.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from asterism.motion.clinical.measures import SIDES, SubjectMeasures
from asterism.motion.clinical.plug_in_gait import along, axes_along, joint_centre, marker_of, normals, thorax_axes, turns
from asterism.recording import Floats, Recording

HEAD = ("LFHD", "RFHD", "LBHD", "RBHD")
THORAX = ("CLAV", "C7", "STRN", "T10")
_YXZ = np.array([1, 0, 2])
"""Turns about x, y and z in the order of the shoulder's angles: flexion is about y."""


def head_axes(recording: Recording, offset: float = 0.0) -> Floats | None:
    """(T, 3, 3) of the head, x ahead, y to the left, z up; None where one of its four markers is not worn.

    offset  rad by which the line from the back markers to the front ones is turned down, about y, to look straight ahead
    """
    if any(name not in recording.labels for name in HEAD):
        return None
    marker = marker_of(recording)
    left_front, right_front, left_back, right_back = (marker(name) for name in HEAD)
    axes = axes_along("x", left_front + right_front - left_back - right_back, "z", left_front + left_back - right_front - right_back)
    sine, cosine = np.sin(offset), np.cos(offset)
    return axes @ np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])


def upper_body_angles(recording: Recording, measures: SubjectMeasures, room: Floats, thorax: Floats | None = None) -> dict[str, Floats]:
    """Angles (T, 3) rad by Plug-in-Gait's names of what has its markers: LHeadAngles, LNeckAngles, LShoulderAngles, ..., both sides.

    room    (3, 3), see `walking_axes`: the head's angles are in these axes
    thorax  (T, 3, 3) as `thorax_axes` gives it, for who has it

    Head and neck: tilt, lateral bend, rotation. Shoulder: flexion, abduction, internal rotation. Elbow: flexion; the forearm turns about
    one axis alone in this model. Wrist: flexion, ulnar bend, rotation. A joint whose markers are not all worn is left out. O(T).
    """
    found: dict[str, Floats] = {}
    thorax, head = thorax_axes(recording) if thorax is None else thorax, head_axes(recording, measures.head_offset)
    against = {} if head is None else {"Head": turns(room, head)}
    if head is not None and thorax is not None:
        against["Neck"] = turns(head, thorax)
    for side in SIDES:
        left = 1.0 if side == "L" else -1.0
        found |= {f"{side}{name}Angles": angles * [-1.0, left, -left] for name, angles in against.items()}
        if thorax is not None:
            found |= _arm(recording, side, measures, thorax)
    return found


def arm_measures_needed(outputs: Iterable[str], side: str) -> list[str]:
    """The measures on which the angles of these names depend."""
    outputs = set(outputs)
    arm = f"{side}ShoulderAngles" in outputs
    hand = f"{side}WristAngles" in outputs
    return [*(("shoulder_offset", "elbow_width", "wrist_width") if arm else ()), *(("hand_thickness",) if hand else ())]


@dataclass(frozen=True)
class Arm:
    """One arm. Axes (T, 3, 3) are columns in a world with z up: x ahead, y to the left, z up the limb, when it hangs.

    shoulder, elbow, wrist  (T, 3) m, joint centres
    humerus, forearm        with the elbow's axis as y
    hand                    with the line between the sides of the wrist as y, of a left hand towards the thumb; None without its marker
    """

    shoulder: Floats
    elbow: Floats
    wrist: Floats
    humerus: Floats
    forearm: Floats
    hand: Floats | None


def arm_of(recording: Recording, side: str, measures: SubjectMeasures, thorax: Floats) -> Arm | None:
    """The arm of side "L" or "R", with these axes of the thorax; None where a marker that it needs is not worn. O(T)."""
    if any(side + name not in recording.labels for name in ("SHO", "ELB", "WRA", "WRB")):
        return None
    marker, own, radius, left = marker_of(recording), measures.arm(side), measures.marker_radius, 1.0 if side == "L" else -1.0
    acromion, elbow_marker, thumb_side, little_side = (marker(side + name) for name in ("SHO", "ELB", "WRA", "WRB"))
    ahead = thorax[:, :, 0]
    chest = marker("CLAV") - radius * ahead
    # below the acromion, at a right angle with the line from the chest
    down = left * normals(ahead, acromion - chest)
    shoulder = joint_centre(chest, acromion, chest + down, own.shoulder_offset + radius)
    between = (thumb_side + little_side) / 2
    # the marker stands beside the elbow's axis, which is at a right angle with the plane of shoulder, marker and wrist
    beside = left * normals(shoulder - elbow_marker, between - elbow_marker)
    elbow = joint_centre(shoulder, elbow_marker, elbow_marker + beside, own.elbow_width / 2 + radius)
    palm = left * normals(thumb_side - little_side, elbow - between)
    wrist = between + (own.wrist_width / 2 + radius) * palm
    # x ahead, y to the left, z up the limb
    humerus = axes_along("z", shoulder - elbow, "y", wrist - elbow)
    # the elbow is a hinge: both have its axis
    forearm = along(elbow - wrist, humerus[:, :, 1])
    hand = None
    if f"{side}FIN" in recording.labels:
        knuckle = joint_centre(wrist, marker(f"{side}FIN"), between, own.hand_thickness / 2 + radius)
        hand = along(wrist - knuckle, left * (thumb_side - little_side))
    return Arm(shoulder, elbow, wrist, humerus, forearm, hand)


def _arm(recording: Recording, side: str, measures: SubjectMeasures, thorax: Floats) -> dict[str, Floats]:
    arm, left = arm_of(recording, side, measures, thorax), 1.0 if side == "L" else -1.0
    if arm is None:
        return {}
    found = {
        f"{side}ShoulderAngles": turns(thorax, arm.humerus, "x", (left, -1.0, -left)).take(_YXZ, axis=1),
        f"{side}ElbowAngles": turns(arm.humerus, arm.forearm, signs=(-1.0, 0.0, 0.0)),
    }
    if arm.hand is not None:
        found[f"{side}WristAngles"] = turns(arm.forearm, arm.hand, signs=(-1.0, left, -left))
    return found
