"""A motion and a moment in; the joints of a simulated wearer, and the tubes that make up the body, out.

World axes: x forward, y to the wearer's left, z up, the floor at z = 0. The wearer walks on the spot, as on a treadmill.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import Floats

Motion = Literal["walk", "raise arms", "stand"]
MOTIONS: tuple[Motion, ...] = ("walk", "raise arms", "stand")
_REFERENCE_STATURE = 1.85
"""m: the tables below are of a body of this height. Girths are those of a man of 85 kg, measured with a tape."""

_HIP = (0.0, 0.093, 0.96)
_SHOULDER = (0.0, 0.205, 0.55)  # above the hips
_THIGH, _SHANK, _UPPER_ARM, _FOREARM = 0.452, 0.455, 0.315, 0.277
_NECK, _HEAD = 0.60, 0.76  # above the hips

Sections = tuple[tuple[float, float, float], ...]
"""m: along the centre line, half width (to the side), half depth (forward)."""

_TORSO: Sections = (
    (-0.07, 0.172, 0.122), (0.05, 0.182, 0.128), (0.20, 0.155, 0.110), (0.35, 0.165, 0.120), (0.47, 0.172, 0.122), (0.56, 0.160, 0.108),
    (0.61, 0.105, 0.085), (0.65, 0.060, 0.062),
)  # fmt: skip
_LEG: Sections = (
    (-0.04, 0.088, 0.088), (0.0, 0.094, 0.094), (0.10, 0.092, 0.092), (0.25, 0.082, 0.082), (0.45, 0.060, 0.060), (0.55, 0.062, 0.062),
    (0.72, 0.048, 0.048), (0.88, 0.039, 0.039),
)  # fmt: skip
_ARM: Sections = (
    (-0.055, 0.015, 0.015), (-0.04, 0.040, 0.040), (0.0, 0.056, 0.056), (0.06, 0.056, 0.056), (0.15, 0.052, 0.052), (0.31, 0.043, 0.043),
    (0.40, 0.044, 0.044), (0.58, 0.030, 0.030),
)  # fmt: skip
_HEAD_SHAPE: Sections = (
    (-0.14, 0.03, 0.03), (-0.12, 0.06, 0.07), (-0.04, 0.075, 0.095), (0.04, 0.078, 0.098), (0.10, 0.055, 0.07), (0.13, 0.01, 0.01),
)  # fmt: skip
_HAND: Sections = ((0.0, 0.028, 0.028), (0.06, 0.042, 0.02), (0.15, 0.036, 0.015), (0.18, 0.01, 0.008))
_FOOT: Sections = ((-0.08, 0.02, 0.02), (-0.05, 0.036, 0.04), (0.08, 0.042, 0.032), (0.17, 0.036, 0.02), (0.19, 0.01, 0.01))


@dataclass(frozen=True)
class Tube:
    """A part of the body: cross sections along a line through joints.

    name      "torso", "left leg", ...
    joints    names of the joints that the centre line runs through, and beyond the first and last of which it goes on straight
    sections  (n, 3) m: along the centre line from its first joint, half width, half depth; between them by a smooth curve
    forward   the direction of half depth at the beginning, in the wearer's axes
    dressed   (first, last) m along the centre line that the garment covers; None for skin
    bend      m, over which the centre line rounds a joint
    """

    name: str
    joints: tuple[str, ...]
    sections: Sections
    forward: tuple[float, float, float]
    dressed: tuple[float, float] | None = None
    bend: float = 0.07


def wearer_tubes(stature: float = 1.85) -> tuple[Tube, ...]:
    """The tubes of a body of this height (m): torso, arms and legs in the garment; head, hands and feet in none.

    Raises AsterismError where the height is not that of a person.
    """
    if not 0.8 <= stature <= 2.3:
        raise AsterismError(f"a wearer of {stature:g} m is no person; give a stature of 0.8 to 2.3 m.")
    k = stature / _REFERENCE_STATURE

    def tube(name: str, joints: tuple[str, ...], table: Sections, forward: tuple[float, float, float],
             dressed: tuple[float, float] | None = None) -> Tube:  # fmt: skip
        sections = tuple((k * s, k * a, k * b) for s, a, b in table)
        return Tube(name, joints, sections, forward, None if dressed is None else (k * dressed[0], k * dressed[1]), 0.07 * k)

    ahead, up = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    tubes = [tube("torso", ("pelvis", "chest", "neck"), _TORSO, ahead, (-0.065, 0.58)), tube("head", ("head", "crown"), _HEAD_SHAPE, ahead)]
    for side in ("left", "right"):
        tubes += [
            tube(f"{side} leg", (f"{side} hip", f"{side} knee", f"{side} ankle"), _LEG, ahead, (-0.005, 0.87)),
            tube(f"{side} arm", (f"{side} shoulder", f"{side} elbow", f"{side} wrist"), _ARM, ahead, (-0.005, 0.575)),
            tube(f"{side} hand", (f"{side} wrist", f"{side} fingers"), _HAND, ahead),
            tube(f"{side} foot", (f"{side} ankle base", f"{side} toe"), _FOOT, up),
        ]
    return tuple(tubes)


def wearer_joints(motion: Motion, time: float, stature: float = 1.85, *, seed: int = 0) -> Mapping[str, Floats]:
    """Where each joint is at a moment (s): joint name -> (3,) m.

    motion  "walk": steps of 0.55 s, arms swinging; "raise arms": both arms from the hips to over the head and back in 4 s, elbows bending;
            "stand": still, arms 35 degrees off the body
    seed    the wearer's way of moving: amplitudes, and where the motion begins

    Deterministic. Raises AsterismError for any other motion.
    """
    if motion not in MOTIONS:
        raise AsterismError(f"the wearer does not know the motion {motion!r}; choose from {', '.join(MOTIONS)}.")
    # The way of moving is the seed's, whatever the moment.
    style = np.random.default_rng([seed, 17])
    beginning, vigour = float(style.uniform(0.0, 1.0)), float(style.uniform(0.9, 1.1))
    walking = motion == "walk"
    phase = 2 * np.pi * (time / 1.1 + beginning) if walking else 0.0
    raised = 0.5 - 0.5 * np.cos(2 * np.pi * (time / 4.0)) if motion == "raise arms" else 0.0
    k = stature / _REFERENCE_STATURE
    bob = 0.015 * np.cos(2 * phase) if walking else 0.0
    pelvis = k * np.array([0.0, 0.02 * np.sin(phase) if walking else 0.0, _HIP[2] + bob])
    lean = 0.03 * np.sin(phase) if walking else 0.0
    joints: dict[str, Floats] = {"pelvis": pelvis, "chest": pelvis + k * np.array([0.01, 0.5 * lean, 0.33])}
    joints["neck"] = pelvis + k * np.array([0.02, lean, _NECK])
    joints["head"] = pelvis + k * np.array([0.03, lean, _HEAD])
    joints["crown"] = joints["head"] + k * np.array([0.0, 0.0, 0.12])
    for side, sign in (("left", 1.0), ("right", -1.0)):
        # The other side is half a cycle later.
        swing = phase + (0.0 if sign > 0 else np.pi)
        _add_leg(joints, side, sign, k, swing if walking else None, vigour)
        _add_arm(joints, side, sign, k, swing if walking else None, raised, vigour)
    return joints


def _add_leg(joints: dict[str, Floats], side: str, sign: float, k: float, swing: float | None, vigour: float) -> None:
    """Hip, knee, ankle and toe: a hip that swings by 25 degrees and a knee that bends up to 60 in swing, or legs a little apart."""
    # Standing: feet a little apart, knees not locked.
    if swing is None:
        flexion, bent, apart = 0.03, 0.06, 0.10
    else:
        flexion = vigour * (0.12 + 0.42 * np.sin(swing))
        bent = vigour * (0.15 + 0.85 * max(0.0, np.cos(swing)) ** 2)
        apart = 0.03
    hip = joints["pelvis"] + k * np.array([0.0, sign * _HIP[1], 0.0])
    knee = hip + k * _THIGH * _limb(flexion, sign * apart)
    ankle = knee + k * _SHANK * _limb(flexion - bent, sign * apart)
    foot = flexion - 0.6 * bent
    joints[f"{side} hip"], joints[f"{side} knee"], joints[f"{side} ankle"] = hip, knee, ankle
    ahead = np.array([np.cos(foot), 0.1 * sign, np.sin(foot)])
    joints[f"{side} ankle base"] = ankle + k * (0.02 * ahead + np.array([0.0, 0.0, -0.035]))
    joints[f"{side} toe"] = joints[f"{side} ankle base"] + k * 0.1 * ahead


def _add_arm(joints: dict[str, Floats], side: str, sign: float, k: float, swing: float | None, raised: float, vigour: float) -> None:
    """Shoulder, elbow, wrist and fingers: swinging against the leg, or raised to the side and over the head."""
    shoulder = joints["pelvis"] + k * np.array([0.01, sign * (_SHOULDER[1] - 0.03 * raised), _SHOULDER[2] + 0.05 * raised])
    if swing is None:
        flexion, apart, bent = 0.05, 0.6 + 2.0 * raised, 0.25 + 0.5 * raised * (1.0 - raised) * 4.0
    else:
        flexion, apart, bent = vigour * (0.1 - 0.45 * np.sin(swing)), 0.30, vigour * (0.45 - 0.2 * np.sin(swing))
    upper = _limb(flexion, sign * apart)
    if swing is None:
        # A raised arm bends its elbow to the side, a swinging one forward.
        lower = _limb(flexion + 0.6 * bent, sign * (apart + 0.4 * bent * (1.0 if raised > 0 else 0.0)))
    else:
        lower = _limb(flexion + bent, sign * 0.6 * apart)
    elbow = shoulder + k * _UPPER_ARM * upper
    wrist = elbow + k * _FOREARM * lower
    joints[f"{side} shoulder"], joints[f"{side} elbow"], joints[f"{side} wrist"] = shoulder, elbow, wrist
    joints[f"{side} fingers"] = wrist + k * 0.1 * lower


def _limb(flexion: float, apart: float) -> Floats:
    """A unit vector that hangs down, swung forward by `flexion` and to the left by `apart` (rad)."""
    return np.array([np.sin(flexion) * np.cos(apart), np.sin(apart), -np.cos(flexion) * np.cos(apart)])
