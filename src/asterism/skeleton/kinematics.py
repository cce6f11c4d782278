"""A person's build and joint angles in; where each segment is, and the markers on it, out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from asterism.recording import Floats
from asterism.skeleton.angles import ANGLES, COLUMN
from asterism.skeleton.build import Build
from asterism.skeleton.worn import Worn

_REST = np.zeros(len(ANGLES))
for _name, _degrees in {"left elbow": 15, "right elbow": 15, "left knee": 5, "right knee": 5, "tilt": 9}.items():
    _REST[COLUMN[_name]] = np.radians(_degrees)

_CARRYING = np.radians(8.0)
"""Of the forearm away from the body, about which the elbow bends."""

_SOFT_FLOOR = 0.01
"""m, by how much the parts of the soles near the lowest one share in what keeps the feet in place."""

_SMOOTHED = 0.1
"""s, over which the path of the body over the floor is smoothed, to both sides: weight goes from foot to foot, and does not jump."""


@dataclass(frozen=True)
class Segments:
    """Where segments are over T frames, the middle of the hips at the origin.

    axes    segment -> (T, 3, 3) rotation from its axes to the room's
    origin  segment -> (T, 3) m
    soles   (T, 4, 3) m, heel and ball of both feet
    """

    axes: dict[str, Floats]
    origin: dict[str, Floats]
    soles: Floats


def about(axis: str, angle: Floats) -> Floats:
    """(T, 3, 3) rotations about x, y or z by angles (T,) rad."""
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    out = np.zeros((len(angle), 3, 3))
    out[:, i, i] = 1.0
    out[:, j, j] = out[:, k, k] = np.cos(angle)
    out[:, k, j] = np.sin(angle)
    out[:, j, k] = -out[:, k, j]
    return out


def pose(build: Build, angles: Floats) -> Segments:
    """The segments of a body in the postures of `angles` (T, A) rad."""
    angle: Mapping[str, Floats] = {name: angles[:, column] for name, column in COLUMN.items()}
    frames, size, bones = len(angles), build.size, build.bones
    axes, origin = dict[str, Floats](), dict[str, Floats]()
    pelvis = about("x", angle["list"]) @ about("y", angle["tilt"])
    axes["pelvis"], origin["pelvis"] = pelvis, np.zeros((frames, 3))
    # a pelvis leans ahead by 9 degrees in one who stands upright
    thorax = pelvis @ about("z", angle["spin"]) @ about("x", angle["side"]) @ about("y", angle["lean"] - np.radians(9.0))
    axes["thorax"], origin["thorax"] = thorax, pelvis @ (np.array([-0.02, 0.0, 0.10]) * size)
    axes["head"] = thorax @ about("z", angle["look"]) @ about("x", angle["cock"]) @ about("y", angle["nod"])
    origin["head"] = origin["thorax"] + thorax @ np.array([0.02 * size, 0.0, 1.08 * bones["trunk"]])
    soles = np.empty((frames, 4, 3))
    for number, (side, sign) in enumerate((("left", 1.0), ("right", -1.0))):
        _pose_arm(build, angle, side, sign, axes, origin)
        _pose_leg(build, angle, side, sign, axes, origin)
        foot, ankle = axes[f"{side} foot"], origin[f"{side} foot"]
        for end, ahead in enumerate((-0.05, 0.125)):
            soles[:, 2 * number + end] = ankle + foot @ np.array([ahead * size, 0.0, -bones["ankle"]])
    return Segments(axes, origin, soles)


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
        @ about("x", sign * (0.28 * np.maximum(from_hanging - np.radians(30.0), 0.0) + angle[f"{side} shrug"]))
        @ about("z", -sign * 0.12 * np.clip(lift, np.radians(-40.0), np.radians(110.0)))
    )
    root = origin["thorax"] + thorax @ np.array([0.0, sign * 0.02 * size, 0.90 * bones["trunk"]])
    shoulder = root + girdle @ np.array([-0.01 * size, sign * (bones["shoulders"] / 2 - 0.02 * size), 0.05 * bones["trunk"]])
    upper = thorax @ about("y", -lift) @ about("x", sign * spread) @ about("z", -sign * angle[f"{side} turn"])
    elbow = shoulder + upper @ np.array([0.0, 0.0, -bones[f"{side} upper arm"]])
    bent = upper @ about("x", np.full(len(lift), sign * _CARRYING)) @ about("y", -angle[f"{side} elbow"])
    wrist = elbow + bent @ np.array([0.0, 0.0, -bones[f"{side} forearm"]])
    # skin near the elbow turns less than the wrist; markers of forearms sit nearer to the wrist
    forearm = bent @ about("z", -sign * 0.85 * angle[f"{side} palm"])
    hand = forearm @ about("x", sign * angle[f"{side} wrist"]) @ about("y", -angle[f"{side} deviate"])
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
    """Add the segments of one leg, that of the pelvis being known."""
    bones, pelvis = build.bones, axes["pelvis"]
    hip = origin["pelvis"] + pelvis @ np.array([0.0, sign * bones["hips"] / 2, 0.0])
    thigh = pelvis @ about("x", sign * angle[f"{side} out"]) @ about("y", -angle[f"{side} hip"]) @ about("z", sign * angle[f"{side} twist"])
    knee = hip + thigh @ np.array([0.0, 0.0, -bones[f"{side} thigh"]])
    shank = thigh @ about("y", angle[f"{side} knee"])
    ankle = knee + shank @ np.array([0.0, 0.0, -bones[f"{side} shank"]])
    # the foot meets the floor, whatever the shank does
    foot = about("z", sign * angle[f"{side} yaw"]) @ about("y", -angle[f"{side} pitch"])
    for name, rotation, at in (("thigh", thigh, hip), ("shank", shank, knee), ("foot", foot, ankle)):
        axes[f"{side} {name}"], origin[f"{side} {name}"] = rotation, at


def markers(worn: Worn, segments: Segments, angles: Floats) -> Floats:
    """(T, M, 3) m, markers on these segments, moved by the skin."""
    # skin slides with the angle, and less and less as it is stretched
    slid = np.tanh(angles - _REST) @ worn.slide.reshape(-1, angles.shape[1]).T
    at = worn.at + slid.reshape(len(angles), -1, 3)
    out = np.empty_like(at)
    for segment in dict.fromkeys(worn.segments):
        own = [m for m, name in enumerate(worn.segments) if name == segment]
        out[:, own] = at[:, own] @ segments.axes[segment].swapaxes(1, 2) + segments.origin[segment][:, None]
    return out


def on_the_floor(soles: Floats, rate: float) -> Floats:
    """(T, 3) m, how the body moves over the floor: its lowest sole stays on it, and stays where it is. soles (T, 4, 3) m."""
    height = soles[:, :, 2]
    lowest = height.min(axis=1, keepdims=True)
    weight = np.exp((lowest - height) / _SOFT_FLOOR)
    weight /= weight.sum(axis=1, keepdims=True)
    path = np.zeros((len(soles), 3))
    if len(soles) > 1:
        drift = -np.einsum("ts,tsx->tx", weight, np.gradient(soles[:, :, :2], axis=0))
        width = max(1, int(_SMOOTHED * rate))
        mean = np.ones(2 * width + 1) / (2 * width + 1)
        smooth = np.stack([np.convolve(np.pad(one, width, mode="edge"), mean, "valid") for one in drift.T], axis=1)
        path[:, :2] = np.cumsum(smooth, axis=0)
    path[:, 2] = -lowest[:, 0]
    return path
