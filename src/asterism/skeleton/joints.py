"""SegmentJoint angles and bone lengths in; the segments of `asterism.recording.Place`, turned and moved, out.

The skeleton is that of virtual people (`kinematics`), a test compares the two. It is to be laid on a person's markers, so each joint turns
with the segment above it, and has usual angles and a spread about them instead of limits: feet with the shank, shoulders with the girdle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from asterism.geometry import axis_rotations
from asterism.recording import Floats
from asterism.skeleton.build import BONES

LENGTHS: Mapping[str, float] = {name: BONES[name] for name in ("hips", "thigh", "shank", "trunk", "shoulders", "upper arm", "forearm")}
"""m, of a body of 1.70 m: what of it is found out from a person's markers. Feet and hands grow with the body."""

LENGTH_NAMES = tuple(LENGTHS)


@dataclass(frozen=True)
class Turn:
    """One axis of a joint. axis: 0, 1, 2 for x, y, z; usual and spread: degrees, of the left side."""

    name: str
    axis: int
    usual: float
    spread: float


@dataclass(frozen=True)
class SegmentJoint:
    """A segment, the one that carries its origin, the one that it turns with, where the origin is, and its axes from outside to inside.

    at: (fixed part, m of a body of 1.70 m; multiples of lengths by name), left side
    """

    segment: str
    carrier: str
    turns_with: str
    at: tuple[float, float, float]
    along: tuple[tuple[str, tuple[float, float, float]], ...]
    turns: tuple[Turn, ...]


# Usual angles are those of standing; spreads cover walking, running, sitting and raised arms within two of them.
_LEFT = (
    SegmentJoint(
        "clavicle",
        "thorax",
        "thorax",
        (0.0, 0.02, 0.0),
        (("trunk", (0.0, 0.0, 0.90)),),
        (Turn("girdle up", 0, 0.0, 12.0), Turn("girdle ahead", 2, 0.0, 12.0)),
    ),
    SegmentJoint(
        "upper arm",
        "clavicle",
        "thorax",
        (-0.01, -0.02, 0.0),
        (("shoulders", (0.0, 0.5, 0.0)), ("trunk", (0.0, 0.0, 0.05))),
        (Turn("shoulder flexion", 1, 0.0, 60.0), Turn("shoulder abduction", 0, 10.0, 45.0), Turn("shoulder rotation", 2, 0.0, 35.0)),
    ),
    SegmentJoint(
        "forearm",
        "upper arm",
        "upper arm",
        (0.0, 0.0, 0.0),
        (("upper arm", (0.0, 0.0, -1.0)),),
        (Turn("carrying angle", 0, 8.0, 2.0), Turn("elbow flexion", 1, -15.0, 45.0), Turn("pronation", 2, -25.0, 45.0)),
    ),
    SegmentJoint(
        "hand",
        "forearm",
        "forearm",
        (0.0, 0.0, 0.0),
        (("forearm", (0.0, 0.0, -1.0)),),
        (Turn("wrist flexion", 0, 0.0, 25.0), Turn("wrist deviation", 1, 0.0, 12.0)),
    ),
    SegmentJoint(
        "thigh",
        "pelvis",
        "pelvis",
        (0.0, 0.0, 0.0),
        (("hips", (0.0, 0.5, 0.0)),),
        (Turn("hip abduction", 0, 2.0, 12.0), Turn("hip flexion", 1, -9.0, 35.0), Turn("hip rotation", 2, 3.0, 12.0)),
    ),
    SegmentJoint("shank", "thigh", "thigh", (0.0, 0.0, 0.0), (("thigh", (0.0, 0.0, -1.0)),), (Turn("knee flexion", 1, 8.0, 40.0),)),
    SegmentJoint(
        "foot",
        "shank",
        "shank",
        (0.0, 0.0, 0.0),
        (("shank", (0.0, 0.0, -1.0)),),
        (Turn("foot rotation", 2, 5.0, 12.0), Turn("ankle flexion", 1, 0.0, 20.0), Turn("foot inversion", 0, 0.0, 8.0)),
    ),
)

_MIDDLE = (
    SegmentJoint("pelvis", "", "", (0.0, 0.0, 0.0), (), ()),
    SegmentJoint(
        "thorax",
        "pelvis",
        "pelvis",
        (-0.02, 0.0, 0.10),
        (),
        (Turn("trunk rotation", 2, 0.0, 15.0), Turn("trunk bending", 0, 0.0, 12.0), Turn("trunk flexion", 1, -6.0, 20.0)),
    ),
    SegmentJoint(
        "head",
        "thorax",
        "thorax",
        (0.02, 0.0, 0.0),
        (("trunk", (0.0, 0.0, 1.08)),),
        (Turn("head rotation", 2, 0.0, 25.0), Turn("head bending", 0, 0.0, 10.0), Turn("head flexion", 1, 0.0, 20.0)),
    ),
)


def _right(joint: SegmentJoint) -> SegmentJoint:
    """The joint of the other side: what lies in the mirror's plane turns the other way."""
    one_of_two = {other.segment for other in _LEFT}

    def side(name: str) -> str:
        return f"right {name}" if name in one_of_two else name

    def flip(at: tuple[float, float, float]) -> tuple[float, float, float]:
        return (at[0], -at[1], at[2])

    turns = tuple(Turn(f"right {t.name}", t.axis, t.usual if t.axis == 1 else -t.usual, t.spread) for t in joint.turns)
    along = tuple((name, flip(by)) for name, by in joint.along)
    return SegmentJoint(side(joint.segment), side(joint.carrier), side(joint.turns_with), flip(joint.at), along, turns)


def _left(joint: SegmentJoint) -> SegmentJoint:
    one_of_two = {other.segment for other in _LEFT}

    def side(name: str) -> str:
        return f"left {name}" if name in one_of_two else name

    turns = tuple(Turn(f"left {t.name}", t.axis, t.usual, t.spread) for t in joint.turns)
    return SegmentJoint(side(joint.segment), side(joint.carrier), side(joint.turns_with), joint.at, joint.along, turns)


JOINTS: tuple[SegmentJoint, ...] = (*_MIDDLE, *(_left(joint) for joint in _LEFT), *(_right(joint) for joint in _LEFT))
"""Parents before children."""

TURNS: tuple[Turn, ...] = tuple(turn for joint in JOINTS for turn in joint.turns)
"""All axes in the order of the angles."""

USUAL: Floats = np.array([turn.usual for turn in TURNS])
SPREAD: Floats = np.array([turn.spread for turn in TURNS])


@dataclass(frozen=True, eq=False)
class PosedSegments:
    """rotations (T, 3, 3) and origins (T, 3) m by segment."""

    rotations: Mapping[str, Floats]
    origins: Mapping[str, Floats]


def lengths_of(sizes: Floats) -> dict[str, float]:
    """m, of a person: sizes (8,) are logarithms, first of the whole body, then of each length beside that."""
    return {name: LENGTHS[name] * float(np.exp(sizes[0] + sizes[1 + i])) for i, name in enumerate(LENGTH_NAMES)}


def pose_segments(sizes: Floats, root: Floats, places: Floats, degrees: Floats) -> PosedSegments:
    """The segments of one person in T frames. sizes (8,); root (T, 3, 3); places (T, 3) m; degrees (T, J). O(T J)."""
    lengths, size = lengths_of(sizes), float(np.exp(sizes[0]))
    rotations: dict[str, Floats] = {}
    origins: dict[str, Floats] = {}
    column = 0
    for joint in JOINTS:
        if not joint.carrier:
            rotations[joint.segment], origins[joint.segment] = root, places
            continue
        local = size * np.array(joint.at)
        for name, by in joint.along:
            local = local + lengths[name] * np.array(by)
        origins[joint.segment] = origins[joint.carrier] + rotations[joint.carrier] @ local
        turned = rotations[joint.turns_with]
        for turn in joint.turns:
            turned = turned @ axis_rotations("xyz"[turn.axis], np.radians(degrees[:, column]))
            column += 1
        rotations[joint.segment] = turned
    return PosedSegments(rotations, origins)


def scales_of(sizes: Floats, segment: str) -> Floats:
    """(3,) what a place on the segment is multiplied by to be metres of this person: limbs by their length, widths by the shoulders'."""
    plain = segment.removeprefix("left ").removeprefix("right ")
    lengths, size = lengths_of(sizes), float(np.exp(sizes[0]))
    scales = np.full(3, size)
    if plain in ("upper arm", "forearm", "thigh", "shank"):
        scales[2] = lengths[plain]
    elif plain == "thorax":
        scales[2] = lengths["trunk"] / LENGTHS["trunk"]
    elif plain == "clavicle":
        scales[1] = lengths["shoulders"] / LENGTHS["shoulders"]
    return scales
