"""A standing trial in; the offsets of wands, tibia and feet that a walk's angles need, out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from asterism.errors import AsterismError
from asterism.geometry import rotate_z_up
from asterism.motion.clinical.landmark_body import with_plug_in_gait_names, worn_landmarks
from asterism.motion.clinical.measures import SIDES, LegMeasures, SubjectMeasures
from asterism.motion.clinical.plug_in_gait import Leg, along, joint_centre, lower_body, marker_of, turns
from asterism.motion.clinical.upper_body import head_axes
from asterism.motion.rigid.rotations import unit_vectors
from asterism.recording import Floats, Recording

DEVICE = ("KAX", "KD1", "KD2")
"""Markers of a knee alignment device: one on the knee's axis and two across it, all as far from the knee's marker."""


@dataclass(frozen=True)
class StaticRules:
    """How a standing trial is read.

    flat_foot   the sole stands flat: heel and toe marker count as equally high. Without, their heights count
    tilted      the angle between the ankle's axis and the shank is taken from the malleoli, and the foot's axis is the ankle's, as older
                programs have it; without, it is a right one, and the foot's axis is the knee's
    level_head  the head looks straight ahead: its tilt is taken off. Without, the offset stays that of the measures
    """

    flat_foot: bool = True
    tilted: bool = False
    level_head: bool = False


def with_static_offsets(static: Recording, measures: SubjectMeasures, rules: StaticRules | None = None) -> SubjectMeasures:
    """The measures with the offsets that the standing trial tells, for every leg whose markers it shows.

    The knee's axis is that of a knee alignment device, where one is worn, else of a medial condyle's marker, else of the thigh's wand
    turned by its angle. The ankle's is that of the malleoli, else of the shank's wand. From these follow the wands' angles and the
    tibial torsion; markers on both sides of a joint tell its width, where nobody gave it. The foot's flexion and rotation take the sole
    for the line from toe to heel. Means over the frames. O(T).
    Raises AsterismError where neither leg shows its markers.
    """
    rules = rules or StaticRules()
    static = with_knee_markers(with_plug_in_gait_names(static))
    found = {}
    for side in SIDES:
        needed = [f"{side}{name}" for name in ("THI", "KNE", "TIB", "ANK")]
        if all(name in static.labels for name in needed):
            found[side] = _leg_with_offsets(static, side, measures, rules)
    if not found:
        raise AsterismError(
            f"{static.metadata.get('file', 'the standing trial')} shows no leg with THI, KNE, TIB and ANK; give a trial that does."
        )
    for side, leg in found.items():
        measures = measures.with_leg(side, leg)
    head = head_axes(static) if rules.level_head else None
    if head is not None:
        # up is positive; the mean of the directions, not of their angles
        ahead = head[np.isfinite(head).all(axis=(1, 2)), :, 0].sum(axis=0)
        if np.any(ahead):
            measures = replace(measures, head_offset=float(np.arctan2(ahead[2], np.hypot(ahead[0], ahead[1]))))
    return measures


def _leg_with_offsets(static: Recording, side: str, measures: SubjectMeasures, rules: StaticRules) -> LegMeasures:
    own, marker, left = measures.of(side), marker_of(static), 1.0 if side == "L" else -1.0
    radius = measures.marker_radius
    told: dict[str, float] = {}
    # a joint whose both sides wear a marker is measured
    for width, name, role in (("knee_width", "KNE", "ME"), ("ankle_width", "ANK", "MM")):
        medial = _worn(static, side + role)
        if medial is not None and width not in own.from_file:
            apart = _mean(np.linalg.norm(marker(side + name) - medial, axis=1)) - 2 * radius
            own = own.with_values(_known({width: apart}) if apart > 0.0 else {})
    hip = _leg(static, side, measures, own).hip
    knee_marker, ankle_marker = marker(f"{side}KNE"), marker(f"{side}ANK")
    axis = _knee_axis(static, side)
    if axis is not None:
        # the plane of the device in place of the wand's
        knee = joint_centre(hip, knee_marker, knee_marker + axis, own.knee_width / 2 + radius)
        told["thigh_rotation"] = left * _angle_about(hip, knee, marker(f"{side}THI"), knee_marker)
        own = own.with_values(_known(told))
    medial = _worn(static, side + "MM")
    leg = _leg(static, side, measures, own)
    if medial is not None and np.isfinite(medial).any():
        outwards = ankle_marker - medial
        if rules.tilted:
            ankle = ankle_marker - (own.ankle_width / 2 + radius) * unit_vectors(outwards)
            corner = np.arccos(np.clip(_cosine(leg.knee - ankle, ankle_marker - ankle), -1.0, 1.0))
            told["ankle_tilt"] = _mean(corner) - np.pi / 2
        else:
            ankle = joint_centre(leg.knee, ankle_marker, ankle_marker + outwards, own.ankle_width / 2 + radius)
        told["shank_rotation"] = left * _angle_about(leg.knee, ankle, marker(f"{side}TIB"), ankle_marker)
        own = own.with_values(_known(told))
        ankle_leg = _leg(static, side, measures, own)
        # from the ankle's axis to the knee's, about the shank
        between = turns(ankle_leg.distal_shank, along(ankle_leg.knee - ankle_leg.ankle, leg.thigh[:, :, 1]))[:, 2]
        told["tibial_torsion"] = left * _mean(between)
    own = own.with_values(_known(told))
    if f"{side}TOE" in static.labels and f"{side}HEE" in static.labels:
        leg = _leg(static, side, measures, own)
        # Programs that tilt the ankle's axis lay the foot's beside it; others beside the knee's.
        axis = (leg.distal_shank if rules.tilted else leg.shank)[:, :, 1]
        toe, heel = marker(f"{side}TOE"), marker(f"{side}HEE").copy()
        if rules.flat_foot:
            heel[:, 2] = toe[:, 2]
        sole = turns(along(leg.ankle - toe, axis), along(heel - toe, axis))
        told["foot_flexion"] = -_mean(sole[:, 0])
        told["foot_rotation"] = -left * _mean(sole[:, 1])
    return own.with_values(_known(told))


def _known(told: Mapping[str, float]) -> dict[str, float]:
    """Without the offsets that no frame tells: the measures' own stay."""
    return {name: value for name, value in told.items() if np.isfinite(value)}


def _mean(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")


def _leg(static: Recording, side: str, measures: SubjectMeasures, own: LegMeasures) -> Leg:
    return lower_body(static, measures.with_leg(side, own), side).legs[side]


def _knee_axis(static: Recording, side: str) -> Floats | None:
    """(T, 3): outwards along the knee's axis; None where only the wand tells it."""
    marker = marker_of(static)
    if all(side + name in static.labels for name in DEVICE):
        return marker(f"{side}KAX") - marker(f"{side}KNE")
    medial = _worn(static, side + "ME")
    return None if medial is None or not np.isfinite(medial).any() else marker(f"{side}KNE") - medial


def _worn(static: Recording, role: str) -> Floats | None:
    """(T, 3) m, z up: the marker on a landmark, by any name of the shipped sets."""
    column = worn_landmarks(static).roles.get(role)
    return None if column is None else rotate_z_up(static.positions, static.vertical)[:, column]


def with_knee_markers(static: Recording) -> Recording:
    """The trial with the knee's marker where only a knee alignment device is worn: the corner from which its three markers are as far.

    The corner of three equal edges at right angles stands over the middle of their ends, on the side where the limb is.
    """
    marker, added = marker_of(static), {}
    for side in SIDES:
        if f"{side}KNE" in static.labels or any(f"{side}{name}" not in static.labels for name in (*DEVICE, "ASI", "ANK")):
            continue
        ends = np.stack([marker(side + name) for name in DEVICE])
        middle = ends.mean(axis=0)
        normal = unit_vectors(np.cross(ends[1] - ends[0], ends[2] - ends[0]))
        edge = np.mean([np.linalg.norm(ends[i] - ends[j], axis=1) for i, j in ((0, 1), (1, 2), (0, 2))], axis=0) / np.sqrt(2.0)
        apart = normal * (edge / np.sqrt(3.0))[:, None]
        spine, ankle = marker(f"{side}ASI"), marker(f"{side}ANK")
        limb = unit_vectors(spine - ankle)
        beside = [np.linalg.norm(np.cross(corner - ankle, limb), axis=1) for corner in (middle + apart, middle - apart)]
        added[f"{side}KNE"] = np.where((beside[0] < beside[1])[:, None], middle + apart, middle - apart)
    if not added:
        return static
    positions = np.concatenate([rotate_z_up(static.positions, static.vertical), np.stack(list(added.values()), axis=1)], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    return replace(static, positions=positions, labels=(*static.labels, *added), vertical=up, source=None, origin=None, taken=())


def _angle_about(upper: Floats, centre: Floats, wand: Floats, marker: Floats) -> float:
    """rad, mean over the frames: from the wand to the marker about the line from the centre to the upper one."""
    line = unit_vectors(upper - centre) * -1.0
    to_wand, to_marker = (vector - np.einsum("ti,ti->t", vector, line)[:, None] * line for vector in (wand - centre, marker - centre))
    angle = np.arctan2(np.einsum("ti,ti->t", np.cross(to_wand, to_marker), line), np.einsum("ti,ti->t", to_wand, to_marker))
    return _mean(angle)


def _cosine(one: Floats, other: Floats) -> Floats:
    return np.asarray(np.einsum("ti,ti->t", unit_vectors(one), unit_vectors(other)))
