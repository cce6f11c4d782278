"""Markers of Plug-in-Gait and measures of the person in; joint centres, segments and angles as Plug-in-Gait computes them, out.

Sources: Davis et al. (1991) for the chord; Kadaba et al. (1990) for segments and angles; the vendor's documentation for
wand angles, torsion and feet. What these leave open was settled by the angles that recordings of eight laboratories hold.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from asterism.errors import AsterismError
from asterism.geometry import rotate_z_up
from asterism.motion.clinical._kernels import joint_centres, relative_turns, segment_axes, unit_normals
from asterism.motion.clinical.hip import hip_centre
from asterism.motion.clinical.measures import SIDES, LegMeasures, SubjectMeasures, all_computed_by_the_file
from asterism.motion.joints.anatomy import sacrum_markers
from asterism.motion.rigid.rotations import cross
from asterism.recording import Floats, Recording

TURNS = 30
"""Steps in which a wand is turned to its angle, at most: each leaves a twentieth of the error, so twelve reach the last digit."""

WALKED = 0.8
"""m: a pelvis that moves less far from the first frame to the last stands, or is on a treadmill. As public copies of the model have it."""
_SEEN = {"L": np.array([1.0, 1.0, -1.0]), "R": np.array([1.0, -1.0, 1.0])}
"""Signs of what has no side, turns about y, x and z, as the angles of a side count them."""
_YZX = np.array([0, 2, 1])
"""Turns about y, x and z in the order of a foot's angles: its sole turns about x, its long axis is z."""
_NEAR_RIGHT = np.radians(75.0)
"""rad: a turn about the middle axis that stays below was never past a right angle; at 100 frames/s none turns by 15 degrees in one."""


@dataclass(frozen=True)
class Leg:
    """One leg. Axes (T, 3, 3) are columns in a world with z up: x ahead, y to the left, z along the limb upwards.

    hip, knee, ankle  (T, 3) m, joint centres
    thigh             with the knee's axis as y
    shank             with the knee's axis as y: the proximal tibia, from which the knee's angles count
    distal_shank      with the ankle's axis as y, from which the ankle's angles count
    foot              z from the toe to the heel, along the sole; None without a toe marker
    """

    hip: Floats
    knee: Floats
    ankle: Floats
    thigh: Floats
    shank: Floats
    distal_shank: Floats
    foot: Floats | None


@dataclass(frozen=True)
class LowerBody:
    """Pelvis axes (T, 3, 3), its origin (T, 3) m between the anterior iliac spines, and the legs by side, "L" and "R"."""

    pelvis: Floats
    origin: Floats
    legs: Mapping[str, Leg]


def lower_body(recording: Recording, measures: SubjectMeasures, sides: str = "LR") -> LowerBody:
    """Joint centres and segments of pelvis and legs, NaN where a marker is missing. O(T).

    Raises AsterismError where the recording lacks a marker.
    """
    marker = marker_of(recording)
    left, right = marker("LASI"), marker("RASI")
    back = [marker(name) for name in sacrum_markers(recording)]
    sacrum = sum(back[1:], start=back[0]) / len(back)
    origin = (left + right) / 2
    pelvis = axes_along("y", left - right, "z", sacrum - origin)
    legs = {}
    for side in sides:
        own = measures.of(side)
        hip = origin + pelvis @ hip_centre(measures, side, left, right, sacrum)
        legs[side] = _leg(marker, side, hip, own, measures.marker_radius, f"{side}TOE" in recording.labels)
    return LowerBody(pelvis, origin, legs)


def marker_of(recording: Recording) -> Callable[[str], Floats]:
    """A function that gives a marker's positions (T, 3) m, z up. It raises AsterismError for a marker that is not there."""
    positions = rotate_z_up(recording.positions, recording.vertical)

    def marker(name: str) -> Floats:
        if name not in recording.labels:
            raise AsterismError(f"{recording.metadata.get('file', 'the recording')} has no marker {name}, which the legs' axes need.")
        return positions[:, recording.labels.index(name)]

    return marker


def _leg(marker: Callable[[str], Floats], side: str, hip: Floats, measures: LegMeasures, radius: float, has_toe: bool) -> Leg:
    outwards = 1.0 if side == "L" else -1.0
    knee_marker, ankle_marker = marker(f"{side}KNE"), marker(f"{side}ANK")
    knee = joint_centre(
        hip, knee_marker, marker(f"{side}THI"), measures.knee_width / 2 + radius, outwards * measures.thigh_rotation
    )  # fmt: skip
    ankle = joint_centre(
        knee, ankle_marker, marker(f"{side}TIB"), measures.ankle_width / 2 + radius, outwards * measures.shank_rotation, measures.ankle_tilt
    )  # fmt: skip
    thigh = along(hip - knee, outwards * (knee_marker - knee))
    distal = along(knee - ankle, outwards * (ankle_marker - ankle))
    shank = distal @ _about_z(outwards * measures.tibial_torsion)
    foot = None
    if has_toe:
        foot = turned_foot(along(ankle - marker(f"{side}TOE"), shank[:, :, 1]), side, measures)
    return Leg(hip, knee, ankle, thigh, shank, distal, foot)


def turned_foot(line: Floats, side: str, measures: LegMeasures) -> Floats:
    """(T, 3, 3) of the foot of side "L" or "R": the axes along the line from toe to ankle, turned by the offsets of the standing trial."""
    outwards = 1.0 if side == "L" else -1.0
    return line @ _about_y(-measures.foot_flexion) @ _about_x(-outwards * measures.foot_rotation)


def joint_centre(upper: Floats, marker: Floats, wand: Floats, offset: float, turn: float = 0.0, tilt: float = 0.0) -> Floats:
    """(T, 3) m: the centre of a joint `offset` (m) beside its marker, where upper centre, centre and marker make a right angle.

    turn  rad about the line from the centre to the upper one, from the wand to the marker: how far the plane of upper centre, marker and
          centre is turned out of the wand's
    tilt  rad by which the angle at the centre is more than a right one

    The chord function of Davis et al. (1991). The turn counts about the line between the centres, of which one is sought, so the plane
    is turned until it does.
    """
    centres = np.empty((len(marker), 3))
    joint_centres(*map(np.ascontiguousarray, (upper, marker, wand)), float(offset), float(turn), float(tilt), TURNS, centres)
    return centres


def axes_along(first: str, line: Floats, second: str, other: Floats) -> Floats:
    """(T, 3, 3) axes, x, y and z as columns: `first` ("x", "y" or "z") along a line (T, 3), `second` along the product of that axis and
    another direction (T, 3). NaN where a direction is missing or has no length."""
    axes = np.empty((len(line), 3, 3))
    segment_axes(np.ascontiguousarray(line), np.ascontiguousarray(other), "xyz".index(first), "xyz".index(second), axes)
    return axes


def along(z: Floats, left: Floats) -> Floats:
    """(T, 3, 3) axes: z along the first, y as near as can be to the second."""
    return axes_along("z", z, "x", -left)


def normals(one: Floats, other: Floats) -> Floats:
    """(T, 3) of length 1, along the vector products; NaN where a vector (T, 3) is missing, or both are along one line."""
    found = np.empty((len(one), 3))
    unit_normals(np.ascontiguousarray(one), np.ascontiguousarray(other), found)
    return found


@lru_cache(maxsize=64)
def _about_x(angle: float) -> Floats:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


@lru_cache(maxsize=64)
def _about_y(angle: float) -> Floats:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


@lru_cache(maxsize=64)
def _about_z(angle: float) -> Floats:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def turns(
    parent: Floats, child: Floats, first: str = "y", signs: tuple[float, float, float] = (1.0, 1.0, 1.0), zero: float = 0.0
) -> Floats:
    """(T, 3) rad, from -pi to pi: turns of the child in the parent's axes, about y, then x, then z; NaN where axes are missing.

    parent  (T, 3, 3), or (3, 3) of what does not move; child  (T, 3, 3)
    first   "y"; or "x", for turns about x, then y, then z, which come in this order
    signs   with which the three turns are given; zero  rad that is added to the first of them

    Two triples of turns make one rotation. The one nearer to the frame before is given, so that a foot that turns by more than a right
    angle goes on; of the first frame's two triples that with less of the other turns, since no foot is upside down.
    """
    found = np.empty((len(child), 3))
    axes = parent if parent.ndim == 3 else parent[None]
    relative_turns(np.ascontiguousarray(axes), np.ascontiguousarray(child), first == "x", _NEAR_RIGHT, signs, zero, found)
    return found


def walking_axes(body: LowerBody) -> Floats:
    """(3, 3): the room's axes, z up, with x along that one of the room's axes along which the pelvis moves; where it stays, faces."""
    seen = np.isfinite(body.origin).all(axis=1)
    way = body.origin[seen][-1] - body.origin[seen][0] if seen.any() else np.zeros(3)
    if np.linalg.norm(way[:2]) < WALKED:
        faces = body.pelvis[np.isfinite(body.pelvis).all(axis=(1, 2)), :, 0]
        way = faces.mean(axis=0) if len(faces) else np.array([1.0, 0.0, 0.0])
    axis = int(abs(way[1]) > abs(way[0]))
    ahead = np.zeros(3)
    ahead[axis] = 1.0 if way[axis] >= 0 else -1.0
    up = np.array([0.0, 0.0, 1.0])
    return np.stack([ahead, cross(up, ahead), up], axis=1)


def thorax_axes(recording: Recording) -> Floats | None:
    """(T, 3, 3) of the trunk; None where one of CLAV, C7, STRN and T10 is not worn."""
    if any(name not in recording.labels for name in ("CLAV", "C7", "STRN", "T10")):
        return None
    marker = marker_of(recording)
    clavicle, neck, sternum, spine = (marker(name) for name in ("CLAV", "C7", "STRN", "T10"))
    return axes_along("z", clavicle + neck - sternum - spine, "y", clavicle + sternum - neck - spine)


def angles_of(recording: Recording, body: LowerBody, room: Floats | None = None, thorax: Floats | None = None) -> dict[str, Floats]:
    """Angles (T, 3) rad by Plug-in-Gait's names: of hips, knees, ankles, pelvis, feet (FootProgress), thorax and spine.

    room  (3, 3), see `walking_axes`, which are taken where none are given; thorax  (T, 3, 3) as `thorax_axes` gives it, for who has it

    Hip and knee: flexion, adduction, internal rotation. Ankle: dorsiflexion, then the foot's inversion and internal rotation. Pelvis and
    thorax: tilt ahead, obliquity, rotation, in the axes of the room.
    """
    room = walking_axes(body) if room is None else room
    pelvis, found = turns(room, body.pelvis), dict[str, Floats]()
    for side, leg in body.legs.items():
        left = 1.0 if side == "L" else -1.0
        found |= _hip_and_knee(body, side)
        found[f"{side}PelvisAngles"] = pelvis * _SEEN[side]
        if leg.foot is not None:
            # The foot's z points backwards, a right angle from the shank's.
            ankle = turns(leg.distal_shank, leg.foot, signs=(-1.0, -left, -left), zero=-np.pi / 2)
            found[f"{side}AnkleAngles"] = ankle.take(_YZX, axis=1)
            found[f"{side}FootProgressAngles"] = turns(room, leg.foot, signs=(1.0, -left, left)).take(_YZX, axis=1)
    return found | trunk_angles(recording, body.pelvis, room, "".join(body.legs), thorax)


def trunk_angles(recording: Recording, pelvis: Floats, room: Floats, sides: str = "LR", thorax: Floats | None = None) -> dict[str, Floats]:
    """Those of thorax, in the room's axes (3, 3), and spine, against the pelvis (T, 3, 3); none without the thorax' markers.

    thorax  (T, 3, 3) as `thorax_axes` gives it, for who has it
    """
    thorax = thorax_axes(recording) if thorax is None else thorax
    if thorax is None:
        return {}
    against = {"Thorax": turns(room, thorax), "Spine": turns(thorax, pelvis, signs=(-1.0, 1.0, 1.0))}
    return {f"{side}{name}Angles": angles * _SEEN[side] for side in sides for name, angles in against.items()}


def _hip_and_knee(body: LowerBody, side: str) -> dict[str, Floats]:
    leg, left = body.legs[side], 1.0 if side == "L" else -1.0
    # Turns to the left are outwards on the left and inwards on the right.
    hip, knee = (-1.0, -left, -left), (1.0, -left, -left)
    return {f"{side}HipAngles": turns(body.pelvis, leg.thigh, signs=hip), f"{side}KneeAngles": turns(leg.thigh, leg.shank, signs=knee)}


_RADII = np.arange(0.0025, 0.0151, 0.00025)
"""m: radii of markers that are tried."""
_FEW = 60
"""Frames on which they are tried."""
_MEETS = np.radians(0.02)
"""rad RMS: angles that a radius meets as well as files store them; a radius that is 0.1 mm off leaves 0.05 degrees and more."""
_FITS = np.radians(0.5)
"""rad RMS: angles that no radius brings nearer were computed by another model or from other measures, and tell no radius."""


def radius_by_the_file(recording: Recording, measures: SubjectMeasures) -> float | None:
    """m: the marker radius with which the file's program computed the hip and knee angles that it holds; None where it holds none.

    The diameter that a file names need not be the one that its angles were computed with. O(1).
    """
    names = [f"{side}{joint}Angles" for side in SIDES for joint in ("Hip", "Knee")]
    given = all_computed_by_the_file(recording, names)
    if not given or any(name not in recording.labels for name in ("LASI", "RASI")):
        return None
    known = np.nonzero(np.isfinite(np.concatenate(list(given.values()), axis=1)).any(axis=1))[0]
    rows = known[np.unique(np.linspace(0, len(known) - 1, min(_FEW, len(known))).astype(int))] if len(known) else known
    some = replace(recording, positions=recording.positions[rows], source=None, origin=None)
    sides, expected = "".join(dict.fromkeys(name[0] for name in given)), {name: np.radians(values[rows]) for name, values in given.items()}

    def off(radius: float) -> float:
        body = lower_body(some, replace(measures, marker_radius=radius), sides)
        found = {name: angles for side in sides for name, angles in _hip_and_knee(body, side).items()}
        apart = np.concatenate([(found[name] - values + np.pi) % (2 * np.pi) - np.pi for name, values in expected.items()])
        return float(np.sqrt(np.nanmean(apart**2))) if np.isfinite(apart).any() else float("inf")

    errors: dict[float, float] = {}

    def best_of(radii: Floats) -> float:
        errors.update({radius: off(radius) for radius in radii.tolist() if radius not in errors})
        return min(errors, key=errors.__getitem__)

    stated = measures.marker_radius
    try:
        left = off(stated)
        if left < _MEETS:
            return stated
        # The angles follow the radius evenly, so that the square of what is left is a parabola: three radii tell where it is lowest.
        between = bool(_RADII[0] < stated < _RADII[-1])
        best = best_of(_RADII[[0, -1] if between else [0, len(_RADII) // 2, -1]])
        three = {**errors, stated: left} if between else errors
        bend, slope, _ = np.polyfit(list(three), [error**2 for error in three.values()], 2)
        place = int(np.argmin(np.abs(_RADII - (-slope / (2 * bend) if bend > 0 else best))))
        best = best_of(_RADII[[place]])
        if errors[best] < _MEETS:
            return float(best)
        while (best := best_of(_RADII[max(place - 1, 0) : place + 2])) != _RADII[place]:
            place = int(np.argmin(np.abs(_RADII - best)))
    except AsterismError:
        return None
    # The stated one may lie between those that are tried; one that differs by rounding is the stated one.
    if left < errors[best] or abs(best - stated) < 1e-6:
        return stated if left < _FITS else None
    return float(best) if errors[best] < _FITS else None
