"""A person and a generic model in; how much larger each body is, and where each marker sits on the generic model, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError
from asterism.formats.opensim_model import OsimModel, read_osim
from asterism.motion.clinical import SkinMotion
from asterism.motion.clinical.landmark_body import with_plug_in_gait_names
from asterism.opensim.person import SIDES, Person, Segment, along_limb, places_in
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
    centre    whether it is a joint centre, which was computed
    """

    name: str
    body: str
    location: Floats
    sigma: float
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


def scale_factors(model: OsimModel, person: Person, trial: Recording) -> dict[str, BodyScale]:
    """The factor of each body of the model, in the order of the bodies.

    Pelvis: between the hip centres. Femur and tibia: between the joint centres. Foot: from the ankle ahead to the toe marker, which sits
    at the joint of the toes; the mean of both feet. Torso: from lumbar joint to base of the neck, see `_TRUNK`. Others: as the body that
    they hang on.
    """

    def apart(one: str, other: str) -> float:
        return (
            _median(np.linalg.norm(person.centres[one] - person.centres[other], axis=1))
            if {one, other} <= person.centres.keys()
            else np.nan
        )

    def between(one: str, other: str) -> float:
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
            told[ankle] = (ahead, length, f"{side}AJC ahead to {side}TOE")
    # feet of one person are alike, and a toe marker is put a centimetre off
    feet = [f"talus_{letter}" for letter in "rl" if f"talus_{letter}" in told]
    if len(feet) == 2:
        both = float(np.mean([told[foot][0] for foot in feet]))
        told |= {foot: (both, told[foot][1], "AJC ahead to TOE, both feet") for foot in feet}
    legs = {name: one for name, one in told.items() if name[:5] in ("femur", "tibia") and np.isfinite(one[0])}
    if not legs:
        raise AsterismError(f"{trial.metadata.get('file', 'the trial')} never shows hip, knee and ankle of a leg; nothing tells its size.")
    size = sum(one[0] for one in legs.values()) / sum(one[1] for one in legs.values())
    if "torso" in person.segments and person.trunk is not None:
        trunk = _median(np.linalg.norm(person.trunk - person.segments["torso"].centre, axis=1))
        sides = [between(f"femur_{side}", f"tibia_{side}") + between(f"tibia_{side}", f"talus_{side}") for side in "rl"]
        told["torso"] = (trunk, _TRUNK * float(np.mean(sides)), "lumbar joint to base of neck")
    told = {name: one for name, one in told.items() if np.isfinite(one[0]) and one[0] > 0 and one[1] > 0}
    found = {name: BodyScale(name, measured / own, measured, own, by) for name, (measured, own, by) in told.items()}
    return {name: found[name] if name in found else _hanging(model, name, found, size) for name in model.joints}


def _hanging(model: OsimModel, body: str, found: Mapping[str, BodyScale], size: float) -> BodyScale:
    """The factor of the next body above that has one, for a leg without markers that of the other leg."""
    twin = {"_l": "_r", "_r": "_l"}.get(body[-2:])
    if twin is not None and body[:-2] + twin in found and body[:5] in ("femur", "tibia", "talus"):
        return BodyScale(body, found[body[:-2] + twin].factor, None, None, f"as {body[:-2] + twin}")
    above = model.joints[body].parent
    while above in model.joints and above not in found:
        above = model.joints[above].parent
    if above in found and body not in ("pelvis", "torso"):
        return BodyScale(body, found[above].factor, None, None, f"as {above}")
    return BodyScale(body, size, None, None, "as the legs")


def _median(values: Floats) -> float:
    seen = values[np.isfinite(values)]
    return float(np.median(seen)) if len(seen) else float("nan")


def _toe(trial: Recording, person: Person, side: str) -> Floats | None:
    """(T, 3) m: the toe marker, by whatever name."""
    named = with_plug_in_gait_names(trial)
    return person.markers[trial.labels[named.labels.index(f"{side}TOE")]] if f"{side}TOE" in named.labels else None


def placed_markers(
    model: OsimModel, person: Person, scales: Mapping[str, BodyScale], bodies: Mapping[str, str], skin: SkinMotion | None = None
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
        body = {"HJC": "femur", "KJC": "tibia", "AJC": "talus"}[name[1:4]] + "_" + SIDES[name[0]]
        if np.isfinite(points).any():
            placed.append(PlacedMarker(name, body, model.in_body(body, model.joints[body].centre), _NOISE, centre=True))
    for name, body in bodies.items():
        if body not in model.joints:
            left[name] = f"the model has no {lacking}"
            continue
        if body not in segments:
            left[name] = f"nothing tells where the person's {body} is"
            continue
        place, _ = places_in(segments[body], person.markers[name])
        if not np.isfinite(place).all():
            left[name] = f"it is never seen together with the markers of {body}"
            continue
        point = _on_model(model, body, place / scales[body].factor)
        toes = f"toes_{body[-1]}"
        if body.startswith("calcn") and toes in model.joints and point[0] - model.joints[toes].centre[0] > _TOES / scales[body].factor:
            body = toes
        sigma = float(np.hypot(_NOISE, slides.get(body if body == "pelvis" else body[:5], _TRUNK_SKIN)))
        placed.append(PlacedMarker(name, body, model.in_body(body, point), sigma))
    return placed, left


def _limbs(person: Person) -> dict[str, Segment]:
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
    below = {"femur": "tibia", "tibia": "talus"}.get(body[:5])
    if below is None:
        # the foot's places count from the ankle
        return np.asarray((joints[f"talus_{body[-1]}"] if body.startswith("calcn") else joints[body]).centre + place)
    along = joints[body].centre - joints[f"{below}_{body[-1]}"].centre
    axes = along_limb(along[None], np.array([[0.0, 0.0, 1.0]]))[0]
    return np.asarray(joints[body].centre + axes @ place)


def spreads(person: Person, markers: Sequence[PlacedMarker]) -> dict[str, float]:
    """Marker -> m, how far it moves on its segment in a walk (RMS); those that the walk does not show are left out."""
    segments = _limbs(person)
    found = {}
    for marker in markers:
        body = marker.body.replace("toes_", "calcn_")
        if marker.name in person.markers and body in segments and not marker.centre:
            _, moves = places_in(segments[body], person.markers[marker.name])
            if np.isfinite(moves):
                found[marker.name] = moves
    return found
