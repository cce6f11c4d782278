"""A person's build and joint angles in; where each segment is, and the markers on it, out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from asterism.geometry import axis_rotations
from asterism.recording import Floats
from asterism.recording.place import LIMBS
from asterism.skeleton.angles import ANGLES, COLUMN, slow_curves
from asterism.skeleton.build import BONES, Build
from asterism.skeleton.worn import Worn

_REST = np.zeros(len(ANGLES))
for _name, _degrees in {"left elbow": 15, "right elbow": 15, "left knee": 5, "right knee": 5, "tilt": 9}.items():
    _REST[COLUMN[_name]] = np.radians(_degrees)

_CARRYING = np.radians(8.0)
"""Of the forearm away from the body, about which the elbow bends."""

_SOFT_FLOOR = 0.01
"""m, by how much the parts of the body near the lowest one share in what keeps it in place."""

_SMOOTHED = 0.1
"""s, over which the path of the body over the floor is smoothed, to both sides: weight goes from foot to foot, and does not jump."""


_ROD_HZ = (4.0, 9.0)
"""At which rods of 5 to 10 cm with a marker at the end swing on skin."""

_TOUCHING = (
    ("foot", (-0.050, 0.0, -0.078)),
    ("foot", (0.125, 0.0, -0.078)),
    ("foot", (0.190, 0.0, -0.060)),
    ("shank", (0.050, 0.0, -0.40)),
    ("thigh", (0.050, 0.0, -1.00)),
    ("hand", (0.0, -0.020, -0.09)),
    ("forearm", (-0.025, 0.0, 0.0)),
    ("clavicle", (0.0, 0.190, 0.01)),
    ("pelvis", (-0.070, 0.060, -0.08)),
    ("pelvis", (-0.100, 0.050, 0.10)),
    ("pelvis", (0.0, 0.160, 0.0)),
    ("pelvis", (0.095, 0.080, 0.06)),
    ("thorax", (-0.110, 0.090, 0.33)),
    ("thorax", (0.110, 0.080, 0.26)),
    ("head", (-0.090, 0.0, 0.15)),
    ("head", (0.110, 0.0, 0.15)),
    ("head", (0.010, 0.080, 0.15)),
    ("head", (0.0, 0.0, 0.25)),
)
"""Where a body can touch the floor: soles and toes, shins and knees, hands and elbows, shoulders, seat, hips, belly, back, chest, head.
Segment and place as in `asterism.recording.Place`, of the left side; what is not in the middle is on both."""

_TWISTED = {"forearm": ("palm", -1.0, 0.0), "upper arm": ("turn", -1.0, 0.2), "thigh": ("twist", 1.0, 0.3)}
"""Limbs whose skin turns less near the upper joint than the bone does: the angle, its sign about the limb's axis on the left side, and the
share with which skin at the upper joint follows; at the lower joint it follows wholly. A forearm turns gradually from elbow to wrist, since
the radius turns about the ulna. At 1 throughout, markers in the middle of a forearm are 40 mm off where palms face ahead."""


@dataclass(frozen=True)
class Segments:
    """Where segments are over T frames, the middle of the hips at the origin.

    axes    segment -> (T, 3, 3) rotation from its axes to the room's
    origin  segment -> (T, 3) m
    touch   (T, C, 3) m, the parts that can touch the floor
    """

    axes: dict[str, Floats]
    origin: dict[str, Floats]
    touch: Floats


def pose(build: Build, angles: Floats) -> Segments:
    """The segments of a body in the postures of `angles` (T, A) rad."""
    angle: Mapping[str, Floats] = {name: angles[:, column] for name, column in COLUMN.items()}
    frames, size, bones = len(angles), build.size, build.bones
    axes, origin = dict[str, Floats](), dict[str, Floats]()
    whole = axis_rotations("y", angle["lie"]) @ axis_rotations("z", angle["roll"])
    pelvis = whole @ axis_rotations("x", angle["list"]) @ axis_rotations("y", angle["tilt"])
    axes["pelvis"], origin["pelvis"] = pelvis, np.zeros((frames, 3))
    # a pelvis leans ahead by 9 degrees in one who stands upright
    thorax = (
        pelvis
        @ axis_rotations("z", angle["spin"])
        @ axis_rotations("x", angle["side"])
        @ axis_rotations("y", angle["lean"] - np.radians(9.0))
    )
    axes["thorax"], origin["thorax"] = thorax, pelvis @ (np.array([-0.02, 0.0, 0.10]) * size)
    axes["head"] = thorax @ axis_rotations("z", angle["look"]) @ axis_rotations("x", angle["cock"]) @ axis_rotations("y", angle["nod"])
    origin["head"] = origin["thorax"] + thorax @ np.array([0.02 * size, 0.0, 1.08 * bones["trunk"]])
    for side, sign in (("left", 1.0), ("right", -1.0)):
        _pose_arm(build, angle, side, sign, axes, origin)
        _pose_leg(build, angle, side, sign, axes, origin)
        # the foot meets the floor, whatever the shank does
        foot = axis_rotations("z", sign * angle[f"{side} yaw"]) @ axis_rotations("y", -angle[f"{side} pitch"])
        axes[f"{side} foot"] = whole @ foot
    return Segments(axes, origin, _touching(build, axes, origin))


def _touching(build: Build, axes: Mapping[str, Floats], origin: Mapping[str, Floats]) -> Floats:
    """(T, C, 3) m, the parts of the body that can touch the floor."""
    found = []
    for segment, (ahead, left, up) in _TOUCHING:
        for sign in (1.0, -1.0) if segment not in ("pelvis", "thorax", "head") or left else (1.0,):
            name = segment if segment in axes else f"{'left' if sign > 0 else 'right'} {segment}"
            # soles are as far below the ankle as this person's are, other places grow with the body; of limbs `up` is a share
            along = build.bones[name] if segment in LIMBS else build.bones["ankle"] / BONES["ankle"] if segment == "foot" else build.size
            at = np.array([ahead * build.size, sign * left * build.size, up * along])
            found.append(origin[name] + axes[name] @ at)
    return np.stack(found, axis=1)


def _pose_arm(
    build: Build, angle: Mapping[str, Floats], side: str, sign: float, axes: dict[str, Floats], origin: dict[str, Floats]
) -> None:
    """Add the segments of one arm, that of the thorax being known."""
    size, bones, thorax = build.size, build.bones, axes["thorax"]
    lift, spread = angle[f"{side} raise"], angle[f"{side} spread"]
    # the shoulder girdle takes part once the arm is 30 degrees from hanging (scapulohumeral rhythm)
    from_hanging = np.arccos(np.clip(np.cos(lift) * np.cos(spread), -1.0, 1.0))
    girdle = (
        thorax
        @ axis_rotations("x", sign * (0.28 * np.maximum(from_hanging - np.radians(30.0), 0.0) + angle[f"{side} shrug"]))
        @ axis_rotations("z", -sign * 0.12 * np.clip(lift, np.radians(-40.0), np.radians(110.0)))
    )
    root = origin["thorax"] + thorax @ np.array([0.0, sign * 0.02 * size, 0.90 * bones["trunk"]])
    shoulder = root + girdle @ np.array([-0.01 * size, sign * (bones["shoulders"] / 2 - 0.02 * size), 0.05 * bones["trunk"]])
    upper = thorax @ axis_rotations("y", -lift) @ axis_rotations("x", sign * spread) @ axis_rotations("z", -sign * angle[f"{side} turn"])
    elbow = shoulder + upper @ np.array([0.0, 0.0, -bones[f"{side} upper arm"]])
    bent = upper @ axis_rotations("x", np.full(len(lift), sign * _CARRYING)) @ axis_rotations("y", -angle[f"{side} elbow"])
    wrist = elbow + bent @ np.array([0.0, 0.0, -bones[f"{side} forearm"]])
    forearm = bent @ axis_rotations("z", -sign * angle[f"{side} palm"])
    hand = forearm @ axis_rotations("x", sign * angle[f"{side} wrist"]) @ axis_rotations("y", -angle[f"{side} deviate"])
    for name, rotation, at in (
        ("clavicle", girdle, root),
        ("upper arm", upper, shoulder),
        ("forearm", forearm, elbow),
        ("hand", hand, wrist),
    ):
        axes[f"{side} {name}"], origin[f"{side} {name}"] = rotation, at


def _pose_leg(
    build: Build, angle: Mapping[str, Floats], side: str, sign: float, axes: dict[str, Floats], origin: dict[str, Floats]
) -> None:
    """Add thigh, shank and the ankle of one leg, the axes of the pelvis being known."""
    bones, pelvis = build.bones, axes["pelvis"]
    hip = origin["pelvis"] + pelvis @ np.array([0.0, sign * bones["hips"] / 2, 0.0])
    thigh = (
        pelvis
        @ axis_rotations("x", sign * angle[f"{side} out"])
        @ axis_rotations("y", -angle[f"{side} hip"])
        @ axis_rotations("z", sign * angle[f"{side} twist"])
    )
    knee = hip + thigh @ np.array([0.0, 0.0, -bones[f"{side} thigh"]])
    shank = thigh @ axis_rotations("y", angle[f"{side} knee"])
    ankle = knee + shank @ np.array([0.0, 0.0, -bones[f"{side} shank"]])
    axes[f"{side} thigh"], origin[f"{side} thigh"] = thigh, hip
    axes[f"{side} shank"], origin[f"{side} shank"] = shank, knee
    origin[f"{side} foot"] = ankle


def markers(worn: Worn, segments: Segments, angles: Floats) -> Floats:
    """(T, M, 3) m, markers on these segments, moved by the skin."""
    # skin slides with the angle, and less and less as it is stretched
    slid = np.tanh(angles - _REST) @ worn.slide.reshape(-1, angles.shape[1]).T
    at = worn.at + slid.reshape(len(angles), -1, 3)
    out = np.empty_like(at)
    for segment in dict.fromkeys(worn.segments):
        own = [m for m, name in enumerate(worn.segments) if name == segment]
        out[:, own] = _untwisted(at[:, own], worn.along[own], segment, angles) @ segments.axes[segment].swapaxes(1, 2)
        out[:, own] += segments.origin[segment][:, None]
    return out


def swung(worn: Worn, positions: Floats, rate: float, rng: np.random.Generator) -> Floats:
    """The positions (T, M, 3) m with rods that swing about where they stand, all the more the faster they are moved."""
    rods = np.nonzero(worn.swing)[0]
    if not len(rods) or len(positions) < 2:
        return positions
    speed = np.linalg.norm(np.gradient(positions[:, rods], 1.0 / rate, axis=0), axis=2)
    swing = slow_curves(np.arange(len(positions)) / rate, rng, 3 * len(rods), *_ROD_HZ).reshape(len(positions), -1, 3)
    out = positions.copy()
    out[:, rods] += worn.swing[rods, None] * np.minimum(speed, 1.0)[:, :, None] * swing
    return out


def _untwisted(at: Floats, along: Floats, segment: str, angles: Floats) -> Floats:
    """Places (T, M, 3) on a segment, turned back by what the skin there does not follow; along (M,): 0 at the upper joint, 1 below."""
    side, _, plain = segment.partition(" ")
    if plain not in _TWISTED:
        return at
    angle, sign, least = _TWISTED[plain]
    follows = least + (1.0 - least) * np.clip(along, 0.0, 1.0)
    back = -(sign if side == "left" else -sign) * angles[:, COLUMN[f"{side} {angle}"], None] * (1.0 - follows)
    cosine, sine = np.cos(back), np.sin(back)
    x, y, z = np.moveaxis(at, 2, 0)
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=2)


def on_the_floor(touch: Floats, rate: float) -> Floats:
    """(T, 3) m, how the body moves over the floor: its lowest part stays on it, and stays where it is. touch (T, C, 3) m."""
    height = touch[:, :, 2]
    lowest = height.min(axis=1, keepdims=True)
    weight = np.exp((lowest - height) / _SOFT_FLOOR)
    weight /= weight.sum(axis=1, keepdims=True)
    path = np.zeros((len(touch), 3))
    if len(touch) > 1:
        drift = -np.einsum("ts,tsx->tx", weight, np.gradient(touch[:, :, :2], axis=0))
        width = max(1, int(_SMOOTHED * rate))
        mean = np.ones(2 * width + 1) / (2 * width + 1)
        smooth = np.stack([np.convolve(np.pad(one, width, mode="edge"), mean, "valid") for one in drift.T], axis=1)
        path[:, :2] = np.cumsum(smooth, axis=0)
    path[:, 2] = -lowest[:, 0]
    return path
