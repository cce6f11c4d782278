"""Markers on bony landmarks in, some of them from a standing trial alone; joint centres, segments and angles by the axes of ISB out.

One construction serves the sets that wear the medial side of knee and ankle: Helen Hayes with medial markers, the gait protocol of the
Istituto Ortopedico Rizzoli (Leardini et al. 2007), and CAST (Cappozzo et al. 1995). They differ in which markers carry the landmarks.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache

import numpy as np

from asterism.geometry import place_objects, rotate_z_up
from asterism.motion.clinical._kernels import any_known
from asterism.motion.clinical.hip import hip_centre
from asterism.motion.clinical.measures import SIDES, SubjectMeasures
from asterism.motion.clinical.plug_in_gait import Leg, LowerBody, along, axes_along, normals, turns
from asterism.recording import Floats, Recording
from asterism.recording.marker_set import canonical, plain_name, shipped_sets
from asterism.recording.place import landmarks

ROLES = {
    "ASI": "anterior superior iliac spine",
    "PSI": "posterior superior iliac spine",
    "SACR": "sacrum",
    "LE": "lateral epicondyle of femur",
    "ME": "medial epicondyle of femur",
    "HF": "head of fibula",
    "TT": "tibial tuberosity",
    "LM": "lateral malleolus",
    "MM": "medial malleolus",
    "CA": "heel",
    "FM": "first metatarsal head",
    "SM": "second metatarsal head",
    "VM": "fifth metatarsal head",
    "TOE": "toe",
}
"""Landmarks by the letters of Leardini et al., and their names in `asterism.recording.place`."""
_PELVIS = ("LASI", "RASI", "LPSI", "RPSI", "SACR")
_FOOT = ("CA", "FM", "SM", "VM", "TOE")
_ON = {"thigh": ("LE", "ME"), "shank": ("HF", "TT", "LM", "MM")}
_LEAST = 3
"""Markers that carry a landmark: fewer leave a turn open."""


@dataclass(frozen=True)
class WornLandmarks:
    """Which column of a recording is which landmark, such as "LLE" (left, lateral epicondyle) or "SACR", and which markers are on a limb.

    roles  landmark -> column; segments  "left thigh" -> columns
    """

    roles: Mapping[str, int] = field(default_factory=dict)
    segments: Mapping[str, tuple[int, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class LandmarkBody:
    """The body, and how it was made.

    feet     by side (T, 3, 3): x ahead, y to the left, z up; carried  landmarks that the standing trial alone shows
    clusters whether markers that are no landmarks carried them; shank  whether fibula and tuberosity made the shank's axes
    """

    body: LowerBody
    feet: Mapping[str, Floats]
    carried: tuple[str, ...]
    clusters: bool
    shank: bool

    @property
    def title(self) -> str:
        """Whose definitions these are, in words."""
        if self.carried and self.clusters:
            return "CAST (Cappozzo et al. 1995)"
        return "the gait protocol of Rizzoli (Leardini et al. 2007)" if self.shank else "medial markers, axes of ISB (Wu et al. 2002)"


@cache
def _spellings() -> Mapping[str, tuple[Mapping[str, str], Mapping[str, str]]]:
    """By set: spelling -> landmark, and spelling -> limb."""
    role_at = {(mark.segment, mark.at): role for role, name in ROLES.items() for mark in [landmarks()[name]]}
    found = {}
    for name, markers in shipped_sets().items():
        roles, limbs = {}, {}
        for marker, place in markers.places.items():
            letter = "R" if place.side == "right" or (not place.side and place.at[1] < 0.0) else "L"
            own = place.mirrored() if letter == "R" else place
            role = role_at.get((own.plain_segment, own.at))
            for spelling in (marker, *markers.aliases.get(marker, ())):
                if role is not None:
                    roles[canonical(spelling)] = role if role == "SACR" else letter + role
                if place.plain_segment in _ON:
                    limbs[canonical(spelling)] = place.segment
        found[name] = (roles, limbs)
    return found


def worn_landmarks(recording: Recording) -> WornLandmarks:
    """Which landmarks and limbs the recording's names are, by the shipped sets; where two sets disagree, the one with more of the names."""
    return _worn(tuple(recording.labels))


@lru_cache(maxsize=32)
def _worn(labels: tuple[str, ...]) -> WornLandmarks:
    spelled = {plain_name(label): column for column, label in enumerate(labels)}
    known = {name: sum(one in roles or one in limbs for one in spelled) for name, (roles, limbs) in _spellings().items()}
    found: dict[str, int] = {}
    limb_of: dict[str, str] = {}
    for name in sorted(known, key=lambda name: (-known[name], name)):
        roles, limbs = _spellings()[name]
        limb_of = {one: limbs[one] for one in spelled if one in limbs} | limb_of
        for spelling, column in spelled.items():
            role = roles.get(spelling)
            if role is not None and role not in found and column not in found.values():
                found[role] = column
    segments = {"pelvis": tuple(found[role] for role in _PELVIS if role in found)}
    for spelling, limb in limb_of.items():
        segments[limb] = (*segments.get(limb, ()), spelled[spelling])
    return WornLandmarks(found, segments)


_NAMES = {"LE": "KNE", "LM": "ANK", "CA": "HEE", "SM": "TOE"}
"""Landmarks that Plug-in-Gait calls otherwise."""


def with_plug_in_gait_names(recording: Recording) -> Recording:
    """The recording with Plug-in-Gait's names, where its own are other ones of the shipped sets for the same places, such as R.ASIS."""
    labels = plug_in_gait_names(tuple(recording.labels))
    return recording if labels == tuple(recording.labels) else replace(recording, labels=labels)


@lru_cache(maxsize=32)
def plug_in_gait_names(given: tuple[str, ...]) -> tuple[str, ...]:
    """The names of columns with those of Plug-in-Gait, see `with_plug_in_gait_names`."""
    labels, known = list(given), shipped_sets()["plug-in-gait"]
    legs = {"LASI", "RASI", "LTHI", "LKNE", "LTIB", "LANK", "LHEE", "LTOE"}
    if any(legs | back <= set(labels) for back in ({"SACR"}, {"LPSI", "RPSI"})):
        return given
    for role, column in _worn(given).roles.items():
        name = role if role == "SACR" else role[0] + _NAMES.get(role[1:], role[1:])
        if name not in labels and name in (*known.names, "SACR") and labels[column] not in known.names:
            labels[column] = name
    for column, label in enumerate(labels):
        # thighs and shanks have many markers, of which only these are wands
        name = shipped_sets()["helen-hayes"].name_of(label) or known.name_of(label) or label
        if name not in labels:
            labels[column] = name
    return tuple(labels)


def landmark_body(recording: Recording, measures: SubjectMeasures, static: Recording | StandingTrial | None = None) -> LandmarkBody | None:
    """Joint centres and segments of pelvis and legs, NaN where a landmark is not known; None without landmarks of the pelvis. O(T).

    static  a standing trial with medial markers; markers that both trials show on a limb carry what only this one shows. Three others on a
            limb carry its lateral landmarks, too, as CAST has it

    Knee and ankle lie midway between epicondyles and between malleoli. Thigh: z from knee to hip, y along the epicondyles. Shank: with head
    of fibula and tibial tuberosity x is normal to the plane of malleoli and fibula and z points to the tuberosity (Leardini et al. 2007),
    else z points to the knee and y along the malleoli. Foot: x from heel to second metatarsal head, in the plane of heel, first and fifth;
    else from heel to toe, y near the ankle's axis.
    """
    worn = _seen_landmarks(recording)
    at = _positions(recording, worn)
    missing = np.full((len(recording), 3), np.nan)
    still = static if static is None or isinstance(static, StandingTrial) else standing_trial(static, measures)
    told = _carried(recording, worn, still, "pelvis", _PELVIS, {})
    at |= told.positions
    carried = list(told.positions)
    if not {"LASI", "RASI"} <= at.keys():
        return None
    sacrum = _sacrum(at, missing)
    pelvis, origin = _pelvis(at, sacrum)
    hips, legs, feet, clusters = dict[str, Floats](), dict[str, Leg](), dict[str, Floats](), False
    for side, word in SIDES.items():
        hip = origin + pelvis @ hip_centre(measures, side, at["LASI"], at["RASI"], sacrum, davis=False)
        for limb, names in _ON.items():
            own = [side + name for name in names]
            extra = {"hip": hip} if limb == "thigh" else {}
            told = _carried(recording, worn, still, f"{word} {limb}", own, extra)
            clusters |= told.clusters
            at |= told.positions
            carried += [name for name in told.positions if name not in worn.roles]
        hips[side] = hip
    # One definition for both legs: a marker that one lacks must not make them differ.
    legged = [side for side in SIDES if {f"{side}LM", f"{side}MM"} & at.keys()]
    bones = bool(legged) and all({f"{side}HF", f"{side}TT"} <= at.keys() for side in legged)
    sole = all({f"{side}FM", f"{side}VM"} <= at.keys() for side in SIDES if f"{side}CA" in at)
    for side, hip in hips.items():
        legs[side], feet[side] = _leg(at, side, hip, missing, bones, sole)
    return LandmarkBody(LowerBody(pelvis, origin, legs), feet, tuple(carried), clusters, bones)


def landmarks_displaced(
    recording: Recording, measures: SubjectMeasures, static: Recording | None, step: float
) -> Iterator[tuple[Recording, Recording | None]]:
    """Recording and standing trial with one landmark's marker `step` m along one axis of its segment, in both; those of both legs at once.

    What a landmark does that is put elsewhere on the skin, in all trials of a session alike.
    """
    trials = [trial for trial in (recording, static) if trial is not None]
    made = [landmark_body(trial, measures, static) for trial in trials]
    groups: list[tuple[str, ...]] = [(role,) for role in _PELVIS]
    groups += [("L" + role, "R" + role) for role in (*_ON["thigh"], *_ON["shank"], *_FOOT)]
    for group in groups:
        for axis in range(3):
            moved = [_moved(trial, one, group, axis, step) for trial, one in zip(trials, made, strict=True)]
            if all(new is old for new, old in zip(moved, trials, strict=True)):
                break
            yield moved[0], moved[1] if len(moved) > 1 else None


def _moved(trial: Recording, made: LandmarkBody | None, group: tuple[str, ...], axis: int, step: float) -> Recording:
    worn = worn_landmarks(trial).roles
    if made is None or not any(role in worn for role in group):
        return trial
    positions = rotate_z_up(trial.positions, trial.vertical).copy()
    for role in group:
        if role in worn:
            positions[:, worn[role]] += step * np.nan_to_num(_axes_of(made, role))[:, :, axis]
    return replace(trial, positions=positions, vertical=np.array([0.0, 0.0, 1.0]), source=None, origin=None)


def segment_of(role: str) -> str:
    """ "pelvis", "thigh", "shank" or "foot"."""
    return "pelvis" if role in _PELVIS else next((limb for limb, names in _ON.items() if role[1:] in names), "foot")


def _axes_of(made: LandmarkBody, role: str) -> Floats:
    """(T, 3, 3) of its segment; the foot's are the shank's."""
    if role in _PELVIS:
        return made.body.pelvis
    leg = made.body.legs[role[0]]
    return leg.thigh if segment_of(role) == "thigh" else leg.shank


def landmark_angles(made: LandmarkBody, room: Floats) -> dict[str, Floats]:
    """Angles (T, 3) rad of hip, knee, ankle, pelvis and foot by the names of Plug-in-Gait: Grood and Suntay (1983), the same signs.

    Flexion (dorsiflexion) about the proximal segment's axis, internal rotation about the distal one's, adduction (inversion) about the
    one at right angles with both. Pelvis and foot in the room's axes (3, 3), see `walking_axes`. A joint that is never known is left out.
    """
    body, found = made.body, dict[str, Floats]()
    pelvis = turns(room, body.pelvis)
    for side, leg in body.legs.items():
        left = 1.0 if side == "L" else -1.0
        joint, knee, seen = (-1.0, -left, -left), (1.0, -left, -left), (1.0, left, -left)
        found |= {
            f"{side}HipAngles": turns(body.pelvis, leg.thigh, signs=joint),
            f"{side}KneeAngles": turns(leg.thigh, leg.shank, signs=knee),
            f"{side}AnkleAngles": turns(leg.shank, made.feet[side], signs=joint),
            f"{side}PelvisAngles": pelvis * seen,
            # the vendor's first counts from a foot that points down, the second the other way
            f"{side}FootProgressAngles": turns(room, made.feet[side], signs=seen, zero=-np.pi / 2),
        }
    return {name: angles for name, angles in found.items() if any_known(angles)}


def _seen_landmarks(recording: Recording) -> WornLandmarks:
    """Without what the recording never shows."""
    worn = worn_landmarks(recording)
    seen = set(np.nonzero(recording.visible.any(axis=0))[0].tolist())
    roles = {role: column for role, column in worn.roles.items() if column in seen}
    return WornLandmarks(roles, {limb: tuple(column for column in columns if column in seen) for limb, columns in worn.segments.items()})


def _positions(recording: Recording, worn: WornLandmarks) -> dict[str, Floats]:
    upright = rotate_z_up(recording.positions, recording.vertical)
    return {role: upright[:, column] for role, column in worn.roles.items()}


def _pelvis(at: Mapping[str, Floats], sacrum: Floats) -> tuple[Floats, Floats]:
    origin = (at["LASI"] + at["RASI"]) / 2
    return axes_along("y", at["LASI"] - at["RASI"], "z", sacrum - origin), origin


def _sacrum(at: Mapping[str, Floats], missing: Floats) -> Floats:
    return at["SACR"] if "SACR" in at else (at.get("LPSI", missing) + at.get("RPSI", missing)) / 2


def _leg(at: Mapping[str, Floats], side: str, hip: Floats, missing: Floats, bones: bool, sole: bool) -> tuple[Leg, Floats]:
    left = 1.0 if side == "L" else -1.0

    def mark(role: str) -> Floats:
        return at.get(side + role, missing)

    knee, ankle = (mark("LE") + mark("ME")) / 2, (mark("LM") + mark("MM")) / 2
    thigh = along(hip - knee, left * (mark("LE") - mark("ME")))
    outwards = left * (mark("LM") - mark("MM"))
    shank = along(knee - ankle, outwards)
    if bones:
        # z is as near as can be to the tuberosity
        ahead = normals(outwards, mark("HF") - ankle)
        shank = axes_along("x", ahead, "y", ankle - mark("TT"))
    foot = np.full_like(shank, np.nan)
    if side + "CA" in at:
        if sole:
            up = left * normals(mark("FM") - mark("CA"), mark("VM") - mark("CA"))
            second = mark("SM") if side + "SM" in at else (mark("FM") + mark("VM")) / 2
            foot = axes_along("z", up, "y", second - mark("CA"))
        else:
            foot = axes_along("x", (mark("SM") if side + "SM" in at else mark("TOE")) - mark("CA"), "z", outwards)
    # as Plug-in-Gait has it: x up, z backwards
    backwards = np.stack([foot[:, :, 2], foot[:, :, 1], -foot[:, :, 0]], axis=2)
    known = backwards if np.isfinite(foot).any() else None
    return Leg(hip, knee, ankle, thigh, shank, shank, known), foot


@dataclass(frozen=True)
class StandingTrial:
    """A standing trial: its recording, what is worn in it, and its hip centres by side.

    clusters  what was made of it for a limb and its markers, so that each frame of a stream need not make it anew
    """

    recording: Recording
    worn: WornLandmarks
    hips: Mapping[str, Floats]
    clusters: dict[tuple[str, ...], _Cluster | None] = field(default_factory=dict)


@dataclass(frozen=True)
class _Cluster:
    """Where markers of a limb (K, 3) m are in one frame of a standing trial, and in the same axes its landmarks (3,) m."""

    template: Floats
    landmarks: Mapping[str, Floats]


@dataclass(frozen=True)
class _Told:
    positions: Mapping[str, Floats] = field(default_factory=dict)
    clusters: bool = False


def standing_trial(static: Recording, measures: SubjectMeasures) -> StandingTrial:
    """What a standing trial of a person with these measures says of landmarks. O(T)."""
    worn = _seen_landmarks(static)
    at = _positions(static, worn)
    missing = np.full((len(static), 3), np.nan)
    hips = {side: missing for side in SIDES}
    if {"LASI", "RASI"} <= at.keys():
        sacrum = _sacrum(at, missing)
        pelvis, origin = _pelvis(at, sacrum)
        hips = {side: origin + pelvis @ hip_centre(measures, side, at["LASI"], at["RASI"], sacrum, davis=False) for side in SIDES}
    return StandingTrial(static, worn, hips)


def _carried(
    recording: Recording, worn: WornLandmarks, still: StandingTrial | None, limb: str, roles: Sequence[str], extra: Mapping[str, Floats]
) -> _Told:
    """Landmarks of a limb that markers of both trials carry over from the standing one; none without one."""
    if still is None:
        return _Told()
    # a subject's name before a label may differ between two files
    names, places = (
        {plain_name(trial.labels[column]): column for column in own.segments.get(limb, ())}
        for trial, own in ((recording, worn), (still.recording, still.worn))
    )
    common = [name for name in names if name in places]
    own = [name for name in common if names[name] not in [worn.roles.get(role) for role in roles]]
    clusters = len(own) >= _LEAST
    common = own if clusters else common
    walking = rotate_z_up(recording.positions, recording.vertical)[:, [names[name] for name in common]]
    with_hip = len(common) < _LEAST and "hip" in extra
    if with_hip:
        walking = np.concatenate([walking, extra["hip"][:, None]], axis=1)
    key = (limb, *common)
    if key not in still.clusters:
        still.clusters[key] = _cluster(still, [places[name] for name in common], roles, limb if with_hip else "")
    cluster = still.clusters[key]
    if cluster is None:
        return _Told()
    rotations, translations = place_objects(cluster.template, walking)
    # what the recording shows itself is taken from it, but for CAST, whose clusters follow the bone better than single markers
    kept = {role: place for role, place in cluster.landmarks.items() if role not in worn.roles or clusters}
    found = {role: rotations @ place + translations for role, place in kept.items()}
    return _Told(found, clusters and bool(found))


def _cluster(still: StandingTrial, columns: Sequence[int], roles: Sequence[str], hip_of: str) -> _Cluster | None:
    """Markers of a standing trial, with the hip of a limb where one is named, and landmarks; None where they leave a turn open."""
    upright = rotate_z_up(still.recording.positions, still.recording.vertical)
    standing = upright[:, columns]
    if hip_of:
        standing = np.concatenate([standing, still.hips[hip_of[0].upper()][:, None]], axis=1)
    whole = np.nonzero(np.isfinite(standing).all(axis=(1, 2)))[0]
    if standing.shape[1] < _LEAST or not len(whole):
        return None
    template = standing[whole[0]]
    turned, moved = place_objects(template, standing)
    found = {}
    for role in roles:
        if role in still.worn.roles:
            local = np.einsum("tji,tj->ti", turned, upright[:, still.worn.roles[role]] - moved)
            seen = local[np.isfinite(local).all(axis=1)]
            if len(seen):
                found[role] = np.median(seen, axis=0)
    return _Cluster(template, found)
