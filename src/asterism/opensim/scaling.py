"""A person and a generic model in; how much larger each body is, and where each marker sits on the generic model, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError
from asterism.formats.opensim_model import OsimModel, read_osim
from asterism.motion.clinical import SkinMotion
from asterism.motion.clinical.landmark_body import worn_landmarks
from asterism.opensim.person import CENTRES, SIDES, PersonInTrial, Segment, along_limb, places_in
from asterism.recording import Floats, Recording

NEEDED = ("pelvis", *(f"{body}_{side}" for side in "rl" for body in ("femur", "tibia", "talus", "calcn")), "torso")
"""Bodies of gait2392, gait2354, Rajagopal's model and those made of them, between which legs are scaled."""
_TRUNK = 0.44
"""From lumbar joint to the base of the neck, of thigh and shank together: 0.37 m on a body of 1.70 m whose leg is 0.835 m (Winter 2009;
places of C7 and jugular notch as in `asterism.recording.place`). It says how long the model's trunk is, which has no such point. A tenth
more makes the torso's factor a tenth less, and moves its centre of mass by 3 cm; joints of the legs stay where they are."""
_TOES = 0.02
"""m, how far ahead of the joint of the toes a marker sits that is on them: metatarsal heads are at the joint, a hallux is 0.04 m ahead. At
half, a marker on the second metatarsal head that was put a little ahead turns the toes; at double, no marker does."""
_NOISE = 0.003
"""m: what a marker is off where skin does not slide. At half, feet weigh twice as much as now against thighs; at double, half as much."""
_TRUNK_SKIN = 0.008
"""m, as `SkinMotion`, of trunk, arms and head: shoulders move on the trunk. At half, the trunk weighs as the pelvis; at double, little."""


@dataclass(frozen=True)
class BodyScale:
    """How much larger the person's body is than the model's.

    body      name in the model
    factor    the same along its three axes
    measured  m, of the person, and model, m, of the generic model; None where the body has the factor of another one
    by        what was measured, or whose factor it is
    """

    body: str
    factor: float
    measured: float | None
    model: float | None
    by: str


@dataclass(frozen=True)
class PlacedMarker:
    """A marker of the generic model.

    location  (3,) m in the body's axes; sigma  m, what it is off, besides what a walk shows
    segment   of the person, and place  (3,) m in its axes
    centre    whether it is a joint centre, which was computed
    """

    name: str
    body: str
    location: Floats
    sigma: float
    segment: str = ""
    place: Floats = field(default_factory=lambda: np.zeros(3))
    centre: bool = False


def generic_model(path: str | Path) -> OsimModel:
    """The model of a file. Raises AsterismError, naming the file, where it holds none, or the model lacks a body that legs need."""
    model = read_osim(path)
    lacking = [body for body in NEEDED if body not in model.joints]
    if lacking:
        raise AsterismError(
            f"{path}: the model {model.name} has no body {', '.join(lacking)}; give one with the names of gait2392 or Rajagopal's."
        )
    return model


def lumbar_share(model: OsimModel) -> Floats:
    """(3,): the lumbar joint from midway between the hips, as a share of the distance between them, the pelvis upright."""
    left, right = (model.joints[f"femur_{side}"].centre for side in "lr")
    return np.asarray((model.joints["torso"].centre - (left + right) / 2) / np.linalg.norm(right - left))


def scale_factors(model: OsimModel, person: PersonInTrial, trial: Recording) -> dict[str, BodyScale]:
    """The factor of each body of the model, in the order of the bodies.

    Pelvis: between the hip centres. Femur and tibia: between the joint centres. Foot: from the ankle ahead to the metatarsal heads, where
    the joint of the toes is; the mean of both feet. Torso: from lumbar joint to base of the neck, see `_TRUNK`. Arms: between their
    joint centres. Others: as the body that they hang on.
    """

    def apart(one: str, other: str) -> float:
        return (
            _median(np.linalg.norm(person.centres[one] - person.centres[other], axis=1))
            if {one, other} <= person.centres.keys()
            else np.nan
        )

    def between(one: str, other: str) -> float:
        if not {one, other} <= model.joints.keys():
            return float("nan")
        return float(np.linalg.norm(model.joints[one].centre - model.joints[other].centre))

    told = {"pelvis": (apart("RHJC", "LHJC"), between("femur_r", "femur_l"), "RHJC to LHJC")}
    for side, letter in SIDES.items():
        knee, ankle = f"tibia_{letter}", f"talus_{letter}"
        told[f"femur_{letter}"] = (apart(f"{side}HJC", f"{side}KJC"), between(f"femur_{letter}", knee), f"{side}HJC to {side}KJC")
        told[knee] = (apart(f"{side}KJC", f"{side}AJC"), between(knee, ankle), f"{side}KJC to {side}AJC")
        foot, toe = f"calcn_{letter}", _toe(trial, person, side)
        if foot in person.segments and toe is not None and f"toes_{letter}" in model.joints:
            ahead = float(places_in(person.segments[foot], toe)[0][0])
            length = float((model.joints[f"toes_{letter}"].centre - model.joints[ankle].centre)[0])
            told[ankle] = (ahead, length, f"{side}AJC ahead to metatarsal heads")
        told[f"humerus_{letter}"] = (
            apart(f"{side}SJC", f"{side}EJC"),
            between(f"humerus_{letter}", f"ulna_{letter}"),
            f"{side}SJC to {side}EJC",
        )
        for body in (f"ulna_{letter}", f"radius_{letter}"):
            told[body] = (apart(f"{side}EJC", f"{side}WJC"), between(f"ulna_{letter}", f"hand_{letter}"), f"{side}EJC to {side}WJC")
    # feet of one person are alike, and a toe marker is put a centimetre off
    feet = [f"talus_{letter}" for letter in "rl" if f"talus_{letter}" in told]
    if len(feet) == 2:
        both = float(np.mean([told[foot][0] for foot in feet]))
        told |= {foot: (both, told[foot][1], "AJC ahead to metatarsal heads, both feet") for foot in feet}
    legs = {name: one for name, one in told.items() if name[:5] in ("femur", "tibia") and np.isfinite(one[0])}
    if not legs:
        raise AsterismError(f"{trial.metadata.get('file', 'the trial')} never shows hip, knee and ankle of a leg; nothing tells its size.")
    size = sum(one[0] for one in legs.values()) / sum(one[1] for one in legs.values())
    if "torso" in person.segments and person.trunk is not None:
        trunk = _median(np.linalg.norm(person.trunk - person.segments["torso"].centre, axis=1))
        sides = [between(f"femur_{side}", f"tibia_{side}") + between(f"tibia_{side}", f"talus_{side}") for side in "rl"]
        told["torso"] = (trunk, _TRUNK * float(np.mean(sides)), "lumbar joint to base of neck")
    told = {name: one for name, one in told.items() if name in model.joints and one[0] > 0 and one[1] > 0}
    found: dict[str, BodyScale] = {}
    for body, joint in model.joints.items():
        twin = {"_l": f"{body[:-2]}_r", "_r": f"{body[:-2]}_l"}.get(body[-2:], "")
        if body in told:
            measured, own, by = told[body]
            found[body] = BodyScale(body, measured / own, measured, own, by)
        elif twin in told:
            found[body] = BodyScale(body, told[twin][0] / told[twin][1], None, None, f"as {twin}")
        elif joint.parent in found and body != "torso":
            found[body] = BodyScale(body, found[joint.parent].factor, None, None, f"as {joint.parent}")
        else:
            found[body] = BodyScale(body, size, None, None, "as the legs")
    return found


def _median(values: Floats) -> float:
    seen = values[np.isfinite(values)]
    return float(np.median(seen)) if len(seen) else float("nan")


def _toe(trial: Recording, person: PersonInTrial, side: str) -> Floats | None:
    """(T, 3) m: the second metatarsal head, else midway between the first and the fifth, else the toe marker, by whatever names."""
    at = {role: person.markers[trial.labels[column]] for role, column in worn_landmarks(trial).roles.items()}
    if f"{side}SM" not in at and {f"{side}FM", f"{side}VM"} <= at.keys():
        return (at[f"{side}FM"] + at[f"{side}VM"]) / 2
    return at.get(f"{side}SM", at.get(f"{side}TOE"))


def placed_markers(
    model: OsimModel, person: PersonInTrial, scales: Mapping[str, BodyScale], bodies: Mapping[str, str], skin: SkinMotion | None = None
) -> tuple[list[PlacedMarker], dict[str, str]]:
    """The markers on the generic model, so that scaled they are where the person's are; and why others are left out, by name.

    bodies  marker -> body on which it sits, of those that the trial shows
    """
    skin = skin or SkinMotion()
    slides = {"pelvis": skin.pelvis_m, "femur": skin.thigh_m, "tibia": skin.shank_m, "calcn": skin.foot_m, "toes_": skin.foot_m}
    segments = _limbs(person)
    placed, left = list[PlacedMarker](), dict[str, str]()
    lacking = ", ".join(dict.fromkeys(body for body in bodies.values() if body not in model.joints))
    for name, points in person.centres.items():
        body = CENTRES[name]
        if body in model.joints and np.isfinite(points).any():
            placed.append(PlacedMarker(name, body, model.in_body(body, model.joints[body].centre), _NOISE, centre=True))
    for name, body in bodies.items():
        if body not in model.joints:
            left[name] = f"the model has no {lacking}"
            continue
        if body not in segments:
            left[name] = f"nothing tells where the person's {body} is"
            continue
        segment = body
        place, _ = places_in(segments[body], person.markers[name])
        if not np.isfinite(place).all():
            left[name] = f"it is never seen together with the markers of {body}"
            continue
        point = _on_model(model, body, place / scales[body].factor)
        toes = f"toes_{body[-1]}"
        if body.startswith("calcn") and toes in model.joints and point[0] - model.joints[toes].centre[0] > _TOES / scales[body].factor:
            body = toes
        sigma = float(np.hypot(_NOISE, slides.get(body if body == "pelvis" else body[:5], _TRUNK_SKIN)))
        placed.append(PlacedMarker(name, body, model.in_body(body, point), sigma, segment, place))
    return placed, left


def _limbs(person: PersonInTrial) -> dict[str, Segment]:
    """The segments, those of legs along the line between their joints, with the thigh's axis: the model's knee only bends."""
    found = dict(person.segments)
    for side, letter in SIDES.items():
        if f"femur_{letter}" not in found:
            continue
        right = found[f"femur_{letter}"].axes[:, :, 2]
        for body, upper, lower in ((f"femur_{letter}", "HJC", "KJC"), (f"tibia_{letter}", "KJC", "AJC")):
            if body in found and {side + upper, side + lower} <= person.centres.keys():
                along = person.centres[side + upper] - person.centres[side + lower]
                found[body] = replace(found[body], axes=along_limb(along, right))
    return found


def _on_model(model: OsimModel, body: str, place: Floats) -> Floats:
    """(3,) m in the room, the model upright: a place in the segment's axes, in the model's size."""
    joints = model.joints
    if body == "pelvis":
        return np.asarray((joints["femur_l"].centre + joints["femur_r"].centre) / 2 + place)
    # of a foot places count from the ankle, of the radius from the elbow
    name, side = body[:-2], body[-2:]
    first = joints.get({"calcn": "talus", "radius": "ulna"}.get(name, name) + side, joints[body]).centre
    lower = joints.get({"femur": "tibia", "tibia": "talus", "humerus": "ulna", "radius": "hand"}.get(name, "") + side)
    if lower is None:
        return np.asarray(first + place)
    axes = along_limb((first - lower.centre)[None], np.array([[0.0, 0.0, 1.0]]))[0]
    return np.asarray(first + axes @ place)


def moved(person: PersonInTrial, markers: Sequence[PlacedMarker]) -> dict[str, float]:
    """Marker -> m, how far it is from its place on its segment in a walk (RMS); those that the walk does not show are left out.

    The place is the standing trial's: shoulders of raised arms are elsewhere than in a walk.
    """
    segments = _limbs(person)
    found = {}
    for marker in markers:
        if marker.name in person.markers and marker.segment in segments:
            apart = ((segments[marker.segment].local(person.markers[marker.name]) - marker.place) ** 2).sum(axis=1)
            apart = apart[np.isfinite(apart)]
            if len(apart):
                found[marker.name] = float(np.sqrt(apart.mean()))
    return found
