"""A body and the phase of its gait in; positions and rotations of its segments in every frame out.

The joint angles are periodic curves through round numbers near those of normal gait in textbooks (degrees, every 10 % of the
cycle, which starts with the foot strike); each walker bends them in a way of its own. Axes: x ahead, y left, z up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.geometry import axis_rotations
from asterism.recording import Floats
from asterism.simulation.body import BALL, HEEL, Body

FOOT_OFF = 0.62
"""The share of the cycle at which the foot leaves the floor."""

CURVES = {
    "hip": (30, 25, 16, 6, -4, -10, -2, 15, 28, 32),
    "knee": (5, 14, 14, 8, 5, 11, 38, 60, 55, 26),
    "foot": (17, 2, 0, -1, -8, -27, -56, -54, -20, 12),  # toes up
    "pelvis tilt": (10, 11, 10, 9, 9, 10, 11, 10, 9, 9),  # forward
    "pelvis drop": (0, 4, 4, 2, 1, 0, -4, -4, -2, -1),  # swing side down
    "pelvis turn": (4, 3, 1, -1, -3, -4, -3, -1, 1, 3),  # this side ahead
    "shoulder": (-18, -15, -6, 5, 14, 18, 15, 8, -4, -14),  # arm ahead
    "elbow": (22, 22, 24, 28, 34, 38, 36, 31, 26, 23),
    "trunk turn": (-5, -4, -2, 1, 4, 5, 4, 2, -1, -4),
}
HARMONICS = 5
FLOOR_SOFTNESS = 0.004


@dataclass(frozen=True)
class Style:
    """How one person walks.

    series     curve name -> (HARMONICS + 1,) complex Fourier coefficients, rad
    step_width m, between the feet
    toe_out    rad
    sway       m, of the pelvis to the side
    lean       rad, of the trunk, forward
    abduction  rad, of the arms
    """

    series: dict[str, np.ndarray]
    step_width: float
    toe_out: float
    sway: float
    lean: float
    abduction: float


@dataclass(frozen=True)
class Pose:
    """Segments over time: name -> ((T, 3, 3) rotation from segment to room axes, (T, 3) m origin), and the (T, 4, 3) m sole points."""

    segments: dict[str, tuple[Floats, Floats]]
    soles: Floats


def random_style(rng: np.random.Generator, body: Body, vigour: float) -> Style:
    """A way of walking; `vigour` scales the swing of all joints (1 is normal speed, 0 is standing still)."""
    series = {}
    for name, degrees in CURVES.items():
        spectrum = np.fft.rfft(np.radians(degrees))[: HARMONICS + 1] / len(degrees)
        # Own amplitudes and phases, less in the high harmonics: a person's gait is smooth.
        personal = (rng.normal(size=HARMONICS + 1) + 1j * rng.normal(size=HARMONICS + 1)) * np.radians([2.0, 0.9, 0.5, 0.2, 0.1, 0.1])
        # The foot meets the floor: a large change of its pitch would lift or sink it.
        if name == "foot":
            personal *= 0.3
        # The mean of a real curve is real; vigour scales the swing about it.
        spectrum[0] = spectrum[0].real + personal[0].real
        spectrum[1:] = (spectrum[1:] + personal[1:]) * vigour
        series[name] = spectrum
    return Style(
        series,
        step_width=float(np.clip(rng.normal(0.11, 0.03), 0.05, 0.20)) * body.size,
        toe_out=float(np.radians(np.clip(rng.normal(7.0, 4.0), -4.0, 18.0))),
        sway=float(rng.uniform(0.01, 0.03)) * vigour,
        lean=float(np.radians(rng.normal(3.0, 2.0))),
        abduction=float(np.radians(np.clip(rng.normal(10.0, 3.0), 4.0, 20.0))),
    )


def pose(body: Body, style: Style, phase: Floats, foot_turn: tuple[Floats, Floats]) -> Pose:
    """The body in axes that turn with its heading and hang on its pelvis.

    phase      (T,) cycles, 0 at the left foot strike
    foot_turn  (left, right) (T,) rad, how far each foot points left of the heading, besides toeing out
    """
    # The right side is half a cycle later.
    angle = {name: {"left": _curve(series, phase), "right": _curve(series, phase + 0.5)} for name, series in style.series.items()}
    lengths, frames = body.lengths, len(phase)
    # The pelvis is one: it follows the mean of both sides.
    tilt = 0.5 * (angle["pelvis tilt"]["left"] + angle["pelvis tilt"]["right"])
    drop, turn = angle["pelvis drop"]["left"], angle["pelvis turn"]["left"]
    pelvis = axis_rotations("z", -turn) @ axis_rotations("x", drop) @ axis_rotations("y", tilt)
    pelvis_at = np.zeros((frames, 3))
    pelvis_at[:, 1] = style.sway * np.sin(2 * np.pi * (phase - 0.06))
    segments = {"pelvis": (pelvis, pelvis_at)}
    soles = np.empty((frames, 4, 3))
    for side, sign, place in (("left", 1.0, 0), ("right", -1.0, 1)):
        hip = pelvis_at + pelvis @ np.array([0.0, sign * lengths["hips"] / 2, 0.0])
        swing, bend, pitch = angle["hip"][side] - tilt, np.maximum(angle["knee"][side], 0.0), angle["foot"][side]
        # How far the leg hangs down in this pose, from which the feet's distance gives the angle sideways.
        reach = lengths["thigh"] * np.cos(swing) + lengths["shank"] * np.cos(swing - bend)
        sideways = np.arctan2(sign * style.step_width / 2 - hip[:, 1], reach)
        # Turning out is shared between hip and foot.
        thigh = (
            axis_rotations("x", sideways)
            @ axis_rotations("y", -swing)
            @ axis_rotations("z", 0.5 * foot_turn[place] + sign * 0.4 * style.toe_out)
        )
        knee = hip + thigh @ np.array([0.0, 0.0, -lengths["thigh"]])
        shank = thigh @ axis_rotations("y", bend)
        ankle = knee + shank @ np.array([0.0, 0.0, -lengths["shank"]])
        foot = axis_rotations("z", foot_turn[place] + sign * style.toe_out) @ axis_rotations("y", -pitch)
        segments |= {f"{side} thigh": (thigh, hip), f"{side} shank": (shank, knee), f"{side} foot": (foot, ankle)}
        # Heel and ball are what can touch the floor.
        for end, point in enumerate((HEEL, BALL)):
            soles[:, 2 * place + end] = ankle + foot @ np.array([point[0] * body.size, point[1], -lengths["ankle"]])
    segments |= _upper_body(body, style, angle, pelvis, pelvis_at)
    return Pose(segments, soles)


def _upper_body(
    body: Body, style: Style, angle: dict[str, dict[str, Floats]], pelvis: Floats, pelvis_at: Floats
) -> dict[str, tuple[Floats, Floats]]:
    lengths = body.lengths
    twist, drop = angle["trunk turn"]["left"], angle["pelvis drop"]["left"]
    thorax = axis_rotations("z", -twist) @ axis_rotations("x", -0.4 * drop) @ axis_rotations("y", np.full(len(twist), style.lean))
    thorax_at = pelvis_at + pelvis @ (np.array([-0.02, 0.0, 0.10]) * body.size)
    head = axis_rotations("z", -0.3 * twist) @ axis_rotations("y", np.full(len(twist), 0.5 * style.lean))
    segments = {"thorax": (thorax, thorax_at), "head": (head, thorax_at + thorax @ np.array([-0.01, 0.0, 1.12 * lengths["trunk"]]))}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        shoulder = thorax_at + thorax @ np.array([-0.01, sign * lengths["shoulders"] / 2, 0.95 * lengths["trunk"]])
        spread = np.full(len(twist), sign * style.abduction)
        upper = thorax @ axis_rotations("x", spread) @ axis_rotations("y", -angle["shoulder"][side])
        elbow = shoulder + upper @ np.array([0.0, 0.0, -lengths["upper arm"]])
        fore = upper @ axis_rotations("y", -np.maximum(angle["elbow"][side], 0.0)) @ axis_rotations("x", -0.5 * spread)
        segments |= {f"{side} upper arm": (upper, shoulder), f"{side} forearm": (fore, elbow)}
    return segments


def support(soles: Floats, phase: Floats) -> tuple[Floats, Floats]:
    """Which sole points carry the body: (T, 4) weights that sum to 1, and the (T,) m height of the floor below the pelvis.

    Only a foot in its stance phase carries; the floor is where the lowest point of all is.
    """
    height = soles[:, :, 2]
    cycle = np.stack([phase, phase, phase + 0.5, phase + 0.5], axis=1) % 1.0
    # A foot in swing must not carry, though it may be the lowest for a moment.
    swing = np.clip(np.minimum(cycle - FOOT_OFF, 1.0 - cycle) / 0.04, 0.0, 1.0)
    return _soft_lowest(height + 0.3 * swing)[0], _soft_lowest(height)[1]


def _soft_lowest(height: Floats) -> tuple[Floats, Floats]:
    # A soft minimum: support passes from one point to the next without a jump.
    lowest = height.min(axis=1, keepdims=True)
    weight = np.exp(-(height - lowest) / FLOOR_SOFTNESS)
    total = weight.sum(axis=1, keepdims=True)
    return weight / total, (lowest - FLOOR_SOFTNESS * np.log(total))[:, 0]


def _curve(series: np.ndarray, phase: Floats) -> Floats:
    """(T,) the Fourier series at these phases."""
    turns = np.exp(2j * np.pi * np.outer(phase, np.arange(1, len(series))))
    return np.asarray(series[0].real + 2.0 * (turns @ series[1:]).real, dtype=np.float64)
