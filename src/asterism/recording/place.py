"""Where a marker sits on the body: a segment, a place in its axes, and how far hands put it elsewhere.

Every segment has axes of its own: x ahead, y left, z up, when one stands upright with hanging arms and thumbs ahead. Places are those of
a body of 1.70 m:

segment    its origin
pelvis     midway between the hip joints
thorax     at the lower end of the lumbar spine: 0.02 m behind and 0.10 m above the pelvis' origin
head       at the base of the neck
clavicle   at the inner end of the clavicle, in the middle of the body but for 0.02 m; turns with the shoulder girdle
upper arm  the shoulder joint
forearm    the elbow; turns with the palm
hand       the wrist
thigh      the hip joint
shank      the knee
foot       the ankle, 0.078 m above the sole

Of the four limbs (upper arm, forearm, thigh, shank) `up` is a share of the bone's length: 0 at the upper joint, -1 at the lower one.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources

from asterism.errors import AsterismError

CENTRAL_SEGMENTS = ("pelvis", "thorax", "head")
"""Segments of which a body has one."""

LIMBS = ("upper arm", "forearm", "thigh", "shank")
"""Segments along which a place is a share of their length."""

SIDED_SEGMENTS = ("clavicle", *LIMBS, "hand", "foot")
"""Segments of which a body has a left and a right one."""

SEGMENTS = (*CENTRAL_SEGMENTS, *(f"{side} {name}" for name in SIDED_SEGMENTS for side in ("left", "right")))
"""All segments by the names that a `Place` has."""

_FARTHEST = 0.7
"""m from a segment's origin; the top of a tall hat is there. At half, heads of tall people would be refused; places in mm never pass."""

_ALONG = (-1.7, 0.7)
"""Of a limb's length: from above its upper joint to beyond its lower one."""

_WIDEST = 0.10
"""m, standard deviation of a place: a marker that is put anywhere on the thigh has half of it."""

USUAL_SPREAD = 0.008
"""m, standard deviation of a marker that is put on a bony point (Della Croce et al., Med Biol Eng Comput 37, 1999: 6 to 21 mm)."""


@dataclass(frozen=True)
class Place:
    """Where one marker sits.

    segment  one of `SEGMENTS`: "pelvis", "left thigh"
    at       (ahead, left, up) in the segment's axes, of a body of 1.70 m: metres; of limbs `up` is a share of the bone's length
    spread   m, standard deviation of the place among people, as hands put the marker
    wand     whether the marker stands on a rod, or anywhere along the limb by eye: its height differs by far more than `spread`
    plate    markers of one rigid plate have its name here; "" for a marker on the skin

    Raises AsterismError where the segment is not known, or a number is no place on a body.

    >>> Place("left thigh", (0.02, 0.085, -0.55), spread=0.015, wand=True).mirrored().at
    (0.02, -0.085, -0.55)
    """

    segment: str
    at: tuple[float, float, float]
    spread: float = USUAL_SPREAD
    wand: bool = False
    plate: str = ""

    def __post_init__(self) -> None:
        if self.segment not in SEGMENTS:
            raise AsterismError(f"{self.segment!r} is no segment of a body; take one of {', '.join(SEGMENTS)}.")
        if len(self.at) != 3 or not all(math.isfinite(number) for number in self.at):
            raise AsterismError("a place is three finite numbers: ahead, left and up.")
        low, high = _ALONG if self.limb else (-_FARTHEST, _FARTHEST)
        if not (abs(self.at[0]) <= _FARTHEST and abs(self.at[1]) <= _FARTHEST):
            raise AsterismError(
                f"{self.at[0]:g} ahead, {self.at[1]:g} left is farther than {_FARTHEST} m from the {self.segment}; give metres."
            )
        if not low <= self.at[2] <= high:
            unit = "a share of the bone's length" if self.limb else "metres"
            raise AsterismError(f"{self.at[2]:g} up is not between {low} and {high} on the {self.segment}; give {unit}.")
        if not 0.0 <= self.spread <= _WIDEST:
            raise AsterismError(f"a spread of {self.spread:g} is not between 0 and {_WIDEST} m; give metres.")

    @property
    def side(self) -> str:
        """ "left", "right", or "" for a segment of which there is one."""
        side = self.segment.split()[0]
        return side if side in ("left", "right") else ""

    @property
    def plain_segment(self) -> str:
        """The segment without its side."""
        return self.segment.removeprefix("left ").removeprefix("right ")

    @property
    def limb(self) -> bool:
        """Whether `up` is a share of the bone's length."""
        return self.plain_segment in LIMBS

    def mirrored(self) -> Place:
        """The same place on the other side of the body."""
        ahead, left, up = self.at
        return Place(other_side(self.segment), (ahead, 0.0 - left, up), self.spread, self.wand, other_side(self.plate))


def other_side(name: str) -> str:
    """A name with left and right exchanged at its beginning; any other name as it is."""
    for one, other in (("left ", "right "), ("right ", "left ")):
        if name.startswith(one):
            return other + name.removeprefix(one)
    return name


@dataclass(frozen=True)
class Landmark:
    """A place that has a name in the field, on the left side: a bony point, or where laboratories stick a marker.

    segment           without its side: "thigh"
    at, spread, wand  as of a `Place`
    """

    segment: str
    at: tuple[float, float, float]
    spread: float
    wand: bool


@cache
def landmarks() -> Mapping[str, Landmark]:
    """The landmarks that a marker set's file may name.

    >>> landmarks()["lateral epicondyle of femur"].segment
    'thigh'
    """
    text = resources.files("asterism.recording").joinpath("landmarks.toml").read_text(encoding="utf-8")
    table = tomllib.loads(text)
    return {
        name: Landmark(
            entry["segment"],
            (float(entry["place"][0]), float(entry["place"][1]), float(entry["place"][2])),
            float(entry.get("spread", USUAL_SPREAD)),
            bool(entry.get("wand", False)),
        )
        for name, entry in table.items()
    }
