"""A marker set and a person's build in; where each marker sits on this person, and how skin moves it, out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.errors import AsterismError
from asterism.geometry import rotation_from_vector
from asterism.recording import Floats, MarkerSet, Place
from asterism.skeleton.angles import ANGLES
from asterism.skeleton.build import BONES, Build

USUAL_SPREAD = 0.008
"""m, spread of a marker on a bony point: what is common to the markers of a segment counts for such a one."""

SKIN = {
    "pelvis": 0.006,
    "thorax": 0.008,
    "head": 0.002,
    "clavicle": 0.008,
    "upper arm": 0.012,
    "forearm": 0.007,
    "hand": 0.003,
    "thigh": 0.012,
    "shank": 0.007,
    "foot": 0.003,
}
"""m per rad of a joint next to it, how far skin slides over bone (standard deviation among places and people). Within what fluoroscopy and
bone pins show: up to 30 mm on thighs, a few on shanks (Leardini et al., Gait Posture 21, 2005)."""


THIN = {"forearm": 0.25, "hand": 0.25}
"""Segments that are flat where markers sit: the share of all errors that counts to the side, from palm to back of the hand. Of nine arms of
five recorded people, the finger's marker lies 12 mm (standard deviation 8) on the back's side of the plane of wrist and elbow; with 1 here
it would be 27, and a third of the hands on the palm's side; with 0.25 it is 10 to 12, at half 9 to 11, at double 13 to 15."""

_BESIDE = (
    (("raise", "spread", "turn"), ("upper arm", "clavicle", "thorax")),
    (("elbow",), ("upper arm", "forearm")),
    (("palm",), ("forearm",)),
    (("wrist", "deviate"), ("hand", "forearm")),
    (("shrug",), ("clavicle",)),
    (("hip", "out", "twist"), ("thigh", "pelvis")),
    (("knee",), ("thigh", "shank")),
    (("pitch", "yaw"), ("foot",)),
    (("lean", "side", "spin"), ("pelvis", "thorax")),
    (("nod", "look", "cock"), ("head",)),
)
"""Joint angles, and the segments next to their joint."""


@dataclass(frozen=True)
class WearRules:
    """How hands put markers on people, in metres unless said otherwise (standard deviations; draws beyond 2.5 of them are cut).

    together     all markers of a segment: tables and people differ in what they call the segment. At half or double, 0.5 points fewer
                 right labels of markers on trunk and head
    symmetric    a marker and its mirror image, beside each marker's own spread
    own          times each marker's spread, by itself
    wand_height  of a rod or a marker placed by eye, share of the limb's length, both sides alike
    wand_side    the same, right against left: laboratories put them at different heights to tell sides apart
    wand_length  outwards
    plate_turn   rad, of a plate about each axis, as it is strapped on. At half, a plate that sits askew is foreign; at double, plates of
                 four are hard to tell from themselves upside down
    plate_shape  each marker of a plate from where the table has it: laboratories make their own plates and headbands
    skin         times `SKIN`
    swing        m, how far a rod's end swings while it moves at 1 m/s or faster
    """

    together: float = 0.008
    symmetric: float = 0.008
    own: float = 1.0
    wand_height: float = 0.14
    wand_side: float = 0.10
    wand_length: float = 0.025
    plate_turn: float = 0.12
    plate_shape: float = 0.008
    skin: float = 1.0
    swing: float = 0.003


@dataclass(frozen=True)
class Worn:
    """The markers of one person.

    segments  (M,) segment of each marker: "left thigh"
    at        (M, 3) m, in the segment's axes
    slide     (M, 3, A) m per rad of each joint angle
    along     (M,) where on a limb: 0 at the upper joint, 1 at the lower one; 0 on other segments. Markers of one plate have one
    swing     (M,) m, how far each marker swings: 0 but for rods
    """

    segments: tuple[str, ...]
    at: Floats
    slide: Floats
    along: Floats
    swing: Floats


def places_of(marker_set: MarkerSet) -> tuple[Place, ...]:
    """Where each marker of the set sits. Raises AsterismError where the set does not say so of all."""
    absent = [name for name in marker_set.names if name not in marker_set.places]
    if absent:
        raise AsterismError(
            f"marker set {marker_set.title or '(unnamed)'} does not say where {absent[0]} sits, so that no virtual person can wear it; "
            "add it to the table [places] of its TOML file."
        )
    return tuple(marker_set.places[name] for name in marker_set.names)


def put_on(rng: np.random.Generator, build: Build, marker_set: MarkerSet, rules: WearRules) -> Worn:
    """The markers of the set, put on one person. O(M A)."""

    def vary(std: float, count: int = 3) -> Floats:
        return np.clip(rng.normal(size=count), -2.5, 2.5) * std

    left_of = {right: left for left, right in marker_set.pairs}
    shared: dict[object, Floats] = {}
    at = np.empty((len(marker_set), 3))
    places = places_of(marker_set)
    middle_of = {plate: _middle(places, plate) for plate in {place.plate for place in places if place.plate}}
    for m, (name, place) in enumerate(zip(marker_set.names, places, strict=True)):
        segment, sign = place.plain_segment, -1.0 if place.side == "right" else 1.0
        # everything is drawn for the left side; the right one is its mirror image
        spot = np.array(middle_of[place.plate] if place.plate else place.at) * (1.0, sign, 1.0)
        pair = left_of.get(name, name)
        if place.wand:
            # a plate is put on as one, so its markers share their height and how far they stand off
            thing = place.plate.removeprefix(f"{place.side} ") or pair
            height, side = shared.setdefault(("wand", thing), np.append(vary(rules.wand_height, 1), vary(rules.wand_side, 1)))
            outwards = vary(rules.wand_length, 1)
            if place.plate:
                outwards = shared.setdefault(("outwards", place.plate), outwards)
            spot[2] += height + 0.5 * sign * side
            spot[1] += max(-0.02, float(outwards[0]))
        spot *= _scale(build, place)
        # what lies in the middle of the body is as far left as right, whoever puts it there
        common = shared.setdefault(("segment", segment), vary(rules.together)) * (1.0, bool(place.side), 1.0)
        # small segments have their bony points close to each other
        common = common * (0.5 if segment in ("foot", "hand", "head") else 1.0)
        one_side = shared.setdefault(("segment", place.segment), vary(0.3 * rules.together))
        both = shared.setdefault(("pair", pair), vary(rules.symmetric * place.spread / USUAL_SPREAD))
        flat = np.array([1.0, THIN.get(segment, 1.0), 1.0])
        # markers of one plate are put on together
        own = vary(rules.own * place.spread)
        if place.plate:
            both = 0.0 * both
            own = shared.setdefault(("plate", place.plate), own)
        spot = spot + flat * (common + one_side + both + own)
        if place.plate:
            turn = shared.setdefault(("turn", place.plate), vary(rules.plate_turn))
            on_plate = _on_plate(place, middle_of[place.plate]) * (1.0, sign, 1.0) + vary(rules.plate_shape)
            spot = spot + rotation_from_vector(turn) @ on_plate
        if segment == "foot":
            # a marker of 8 mm radius does not sink into the floor
            spot[2] = max(spot[2], 0.008 - build.bones["ankle"])
        at[m] = spot * (1.0, sign, 1.0)
    slide = rng.normal(size=(len(places), 3, len(ANGLES)))
    of_segment = {segment: np.array([segment in moves_skin_of(angle) for angle in ANGLES]) for segment in {p.segment for p in places}}
    together: dict[str, Floats] = {}
    for m, place in enumerate(places):
        # a plate slides as one
        if place.plate:
            slide[m] = together.setdefault(place.plate, slide[m].copy())
        slide[m] *= rules.skin * SKIN[place.plain_segment] * of_segment[place.segment]
        # skin slides over a bone, not off it
        slide[m, 1] *= THIN.get(place.plain_segment, 1.0)
    along = np.array([-spot[2] / build.bones[place.segment] if place.limb else 0.0 for spot, place in zip(at, places, strict=True)])
    for plate in {place.plate for place in places if place.plate}:
        members = [m for m, place in enumerate(places) if place.plate == plate]
        along[members] = along[members].mean()
    # a plate is too heavy to swing like a rod
    swing = np.array([rules.swing * (place.wand and not place.plate) for place in places])
    return Worn(tuple(place.segment for place in places), at, slide, along, swing)


def _middle(places: tuple[Place, ...], plate: str) -> tuple[float, float, float]:
    """The mean place of the markers of a plate."""
    ahead, left, up = np.mean([place.at for place in places if place.plate == plate], axis=0)
    return (float(ahead), float(left), float(up))


def _on_plate(place: Place, middle: tuple[float, float, float]) -> Floats:
    """(3,) m, from the middle of a plate to one of its markers: a plate is as large on a child as on a tall adult."""
    return (np.array(place.at) - middle) * (1.0, 1.0, BONES[place.plain_segment] if place.limb else 1.0)


def _scale(build: Build, place: Place) -> Floats:
    """What lengths (ahead, left, up) of the table become on this person."""
    segment, size, girth = place.plain_segment, build.size, build.girth
    head = size * build.share["head"] ** 0.7
    ahead = {"foot": size, "hand": size, "head": head}.get(segment, girth)
    # shoulders widen with the bones, waists and limbs with the flesh
    across = size * build.share["shoulders"] if segment == "clavicle" or (segment == "thorax" and place.at[1]) else girth
    up = build.bones[place.segment] if place.limb else size * (build.share["trunk"] if segment == "thorax" else 1.0)
    return np.array([ahead, head if segment == "head" else across, head if segment == "head" else up])


def moves_skin_of(angle: str) -> frozenset[str]:
    """The segments whose skin slides with a joint angle, those next to the joint."""
    side, _, plain = angle.rpartition(" ")
    beside = next((segments for angles, segments in _BESIDE if plain in angles), ())
    return frozenset(name if name in ("pelvis", "thorax", "head") else f"{side} {name}" for name in beside)
