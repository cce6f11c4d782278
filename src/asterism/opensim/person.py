"""A labelled trial in; its person's segments in the axes of OpenSim's models, and on which body each marker sits, out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.geometry import z_up_rotation
from asterism.motion.clinical import ClinicalModel, LowerBody
from asterism.motion.clinical.landmark_body import with_plug_in_gait_names
from asterism.motion.clinical.plug_in_gait import marker_of, thorax_axes, walking_axes
from asterism.motion.clinical.upper_body import arm_of
from asterism.motion.rigid.rotations import unit_vectors
from asterism.recording import Floats, Recording
from asterism.recording.arrays import nan_median
from asterism.recording.marker_set import shipped_sets, without_subject

SIDES = {"L": "l", "R": "r"}
"""OpenSim's letters."""
CENTRES = {
    side + centre: f"{body}_{SIDES[side]}"
    for centre, body in (("HJC", "femur"), ("KJC", "tibia"), ("AJC", "talus"), ("SJC", "humerus"), ("EJC", "ulna"), ("WJC", "hand"))
    for side in "RL"
}
"""Joint centres, as they are called among the markers of the trial that scales the model, and the body at whose upper joint each is."""
_NECK = 0.065
"""m, how far ahead of C7 the middle of the neck's base is: half of the way to the jugular notch, on a body of 1.70 m (place.py). A
centimetre tilts the trunk by 1.5 degrees, where no other marker tells the neck; its lean against the pelvis adds to that."""
_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""From a room with z up to one with y up, x kept."""
_BODIES = {
    "pelvis": "pelvis",
    "thorax": "torso",
    "clavicle": "torso",
    "head": "head",
    "upper arm": "humerus",
    "forearm": "radius",
    "hand": "hand",
    "thigh": "femur",
    "shank": "tibia",
    "foot": "calcn",
}
"""What OpenSim's models call the segments that `asterism.recording.place` names; those of a side end in _l and _r."""


@dataclass(frozen=True)
class Segment:
    """One segment over time, in OpenSim's room: axes (T, 3, 3) as columns x ahead, y up, z to the right; centre (T, 3) m, its upper joint.

    Of the pelvis the centre is midway between the hips. At rest the axes are those of a person who stands upright.
    """

    axes: Floats
    centre: Floats

    def local(self, points: Floats) -> Floats:
        """(T, 3) m, points of the room in the segment's axes."""
        return np.einsum("tji,tj->ti", self.axes, points - self.centre)


@dataclass(frozen=True)
class PersonInTrial:
    """The person of one trial.

    turn      (3, 3) from the recording's axes to OpenSim's: y up, x along that axis of the room along which the person walks or looks
    segments  by OpenSim's names of bodies, "femur_r"; those whose markers are not worn are missing
    centres   (T, 3) m, joint centres by the names of `CENTRES`
    markers   name -> (T, 3) m, in OpenSim's room
    trunk     (T, 3) m, the base of the neck; None where no marker tells it
    """

    turn: Floats
    segments: Mapping[str, Segment]
    centres: Mapping[str, Floats]
    markers: Mapping[str, Floats]
    trunk: Floats | None = None


def person_of(recording: Recording, clinical: ClinicalModel, lumbar: Floats) -> PersonInTrial:
    """The person of a trial, by the clinical model of its legs. O(T).

    lumbar  (3,): the lumbar joint from midway between the hips, in the pelvis' axes, as a share of the distance between the hips

    Raises AsterismError where the pelvis has no markers.
    """
    # both hips are known by the pelvis, also where a leg has no markers
    body = replace(clinical, sides="LR").body(_with_thighs(recording))
    room = np.asarray(walking_axes(body))
    # the room's x is where the person goes
    turned = _Y_UP @ room.T
    turn = turned @ z_up_rotation(recording.vertical)
    segments, centres = dict[str, Segment](), dict[str, Floats]()
    hips = {side: leg.hip @ turned.T for side, leg in body.legs.items()}
    middle = np.mean(list(hips.values()), axis=0)
    pelvis = _upright(body.pelvis, turned)
    segments["pelvis"] = Segment(pelvis, middle)
    for side, leg in body.legs.items():
        knee, ankle = leg.knee @ turned.T, leg.ankle @ turned.T
        thigh, shank = _upright(leg.thigh, turned), _upright(leg.shank, turned)
        foot = _foot(recording, clinical, body, side, turned)
        for name, axes, centre in (("femur", thigh, hips[side]), ("tibia", shank, knee), ("calcn", foot, ankle)):
            if axes is not None and np.isfinite(axes).all(axis=(1, 2)).any():
                segments[f"{name}_{SIDES[side]}"] = Segment(axes, centre)
        found = {f"{side}HJC": hips[side], f"{side}KJC": knee, f"{side}AJC": ankle}
        centres |= {name: points for name, points in found.items() if np.isfinite(points).any()}
    markers = {label: recording.positions[:, at] @ turn.T for at, label in enumerate(recording.labels)}
    wide = np.linalg.norm(hips["R"] - hips["L"], axis=1)[:, None] if len(hips) == 2 else np.full((len(middle), 1), np.nan)
    seat = middle + np.einsum("tij,j->ti", pelvis, lumbar) * wide
    neck, right = _neck(recording, turned, pelvis)
    if neck is not None:
        segments["torso"] = Segment(along_limb(neck - seat, right), seat)
    for side in SIDES:
        arm, joints = _arm(recording, clinical, side, turned)
        segments, centres = segments | arm, centres | joints
    return PersonInTrial(turn, segments, centres, markers, neck)


def _with_thighs(recording: Recording) -> Recording:
    """The recording with a column for each thigh's marker of Plug-in-Gait, without a sample where it has none."""
    worn = with_plug_in_gait_names(recording).labels
    absent = [f"{side}THI" for side in SIDES if f"{side}THI" not in worn]
    if not absent:
        return recording
    positions = np.concatenate([recording.positions, np.full((len(recording), len(absent), 3), np.nan)], axis=1)
    return replace(recording, positions=positions, labels=(*recording.labels, *absent), source=None, origin=None, taken=())


def has_leg(person: PersonInTrial) -> bool:
    """Whether hip, knee and ankle of a leg are known together."""
    legs = [[person.centres[side + joint] for joint in ("HJC", "KJC", "AJC") if side + joint in person.centres] for side in SIDES]
    return any(len(leg) == 3 and bool(np.isfinite(np.stack(leg)).all(axis=(0, 2)).any()) for leg in legs)


def _upright(axes: Floats, turned: Floats) -> Floats:
    """Axes with x ahead, y left and z up as OpenSim's, in its room."""
    return np.asarray(turned @ np.stack([axes[:, :, 0], axes[:, :, 2], -axes[:, :, 1]], axis=2))


def along_limb(up: Floats, right: Floats) -> Floats:
    """(T, 3, 3) axes with y along the first and z as near as can be to the second."""
    y = unit_vectors(up)
    x = unit_vectors(np.cross(y, right))
    return np.stack([x, y, np.cross(x, y)], axis=2)


def _foot(recording: Recording, clinical: ClinicalModel, body: LowerBody, side: str, turned: Floats) -> Floats | None:
    """(T, 3, 3): x along the sole. The clinical foot's, but where nothing tells the sole from the line to the toe marker."""
    leg = body.legs[side]
    if leg.foot is None:
        return None
    axes = np.stack([-leg.foot[:, :, 2], leg.foot[:, :, 1], leg.foot[:, :, 0]], axis=2)
    named = with_plug_in_gait_names(recording)
    told = clinical.name != "plug-in-gait" or "foot_flexion" in clinical.measures.of(side).from_file
    if not told and f"{side}HEE" in named.labels and f"{side}TOE" in named.labels:
        marker = marker_of(named)
        ahead = unit_vectors(marker(f"{side}TOE") - marker(f"{side}HEE"))
        up = unit_vectors(np.cross(ahead, axes[:, :, 1]))
        axes = np.stack([ahead, np.cross(up, ahead), up], axis=2)
    return _upright(axes, turned)


def _neck(recording: Recording, turned: Floats, pelvis: Floats) -> tuple[Floats | None, Floats]:
    """(T, 3) m, the base of the neck, and a direction to the right; by C7 and CLAV, else by the shoulders, else by C7 alone; None else."""
    named = with_plug_in_gait_names(recording)
    marker, worn = marker_of(named), {label for at, label in enumerate(named.labels) if named.visible[:, at].any()}
    right = pelvis[:, :, 2]
    neck = marker("C7") @ turned.T + _NECK * pelvis[:, :, 0] if "C7" in worn else None
    if {"LSHO", "RSHO"} <= worn:
        right = unit_vectors(marker("RSHO") - marker("LSHO")) @ turned.T
        neck = (marker("LSHO") + marker("RSHO")) @ turned.T / 2
    if {"C7", "CLAV"} <= worn:
        neck = (marker("C7") + marker("CLAV")) @ turned.T / 2
    return neck, right


def _arm(recording: Recording, clinical: ClinicalModel, side: str, turned: Floats) -> tuple[dict[str, Segment], dict[str, Floats]]:
    """Upper arm, forearm and hand, and their joint centres; nothing where a marker is not worn. Thumbs ahead, as models hang their arms."""
    named = with_plug_in_gait_names(recording)
    thorax = thorax_axes(named)
    arm = None if thorax is None else arm_of(named, side, clinical.measures, thorax)
    if arm is None or not np.isfinite(arm.elbow).any():
        return {}, {}
    marker = marker_of(named)
    towards_thumb = (marker(f"{side}WRA") - marker(f"{side}WRB")) @ turned.T
    shoulder, elbow, wrist = (points @ turned.T for points in (arm.shoulder, arm.elbow, arm.wrist))
    up = elbow - wrist
    letter = SIDES[side]
    found = {
        f"humerus_{letter}": Segment(_upright(arm.humerus, turned), shoulder),
        f"radius_{letter}": Segment(along_limb(up, np.cross(towards_thumb, up)), elbow),
    }
    if arm.hand is not None:
        up = arm.hand[:, :, 2] @ turned.T
        found[f"hand_{letter}"] = Segment(along_limb(up, np.cross(towards_thumb, up)), wrist)
    return found, {f"{side}SJC": shoulder, f"{side}EJC": elbow, f"{side}WJC": wrist}


def bodies_of(labels: Sequence[str]) -> dict[str, str]:
    """Label -> OpenSim's body on which a marker of this name sits, by the shipped sets; labels that none of them places are left out.

    Where sets disagree, that with more of the labels counts.

    >>> bodies_of(["RTHI", "SACR", "LHEE", "C7", "what"])
    {'RTHI': 'femur_r', 'SACR': 'pelvis', 'LHEE': 'calcn_l', 'C7': 'torso'}
    """
    placed = []
    for markers in shipped_sets().values():
        names = {label: markers.name_of(without_subject(label)) for label in labels}
        placed.append({label: markers.places[name] for label, name in names.items() if name is not None and name in markers.places})
    found: dict[str, str] = {}
    for one in sorted(placed, key=len, reverse=True):
        for label, place in one.items():
            side = {"left": "_l", "right": "_r", "": ""}[place.side if place.plain_segment != "clavicle" else ""]
            found.setdefault(label, _BODIES[place.plain_segment] + side)
    return {label: found[label] for label in labels if label in found}


def places_in(segment: Segment, points: Floats) -> tuple[Floats, float]:
    """Where a marker sits in a segment's axes, (3,) m: the median over the frames; and how far it moves there, m RMS. NaN for never."""
    local = segment.local(points)
    local = local[np.isfinite(local).all(axis=1)]
    if not len(local):
        return np.full(3, np.nan), float("nan")
    place = nan_median(local, axis=0)
    return place, float(np.sqrt(((local - place) ** 2).sum(axis=1).mean()))


def ridden(person: PersonInTrial, names: Iterable[str], least: float) -> dict[str, str]:
    """Name -> body of markers whose name says nothing: that segment in which a marker moves least while the person moves.

    least  how many times more it must move in every other segment

    Where the trunk is not known, its markers would ride on the pelvis, so that nothing does.
    """
    found, segments = {}, {body: one for body, one in person.segments.items() if body != "pelvis" or "torso" in person.segments}
    for name in names:
        moves = {body: places_in(segment, person.markers[name])[1] for body, segment in segments.items()}
        known = sorted((spread, body) for body, spread in moves.items() if np.isfinite(spread))
        if len(known) > 1 and known[1][0] > least * known[0][0]:
            found[name] = known[0][1]
    return found
