"""The joint angles of a body: their names, their limits, and smooth curves of them over time.

An array of angles is (T, A) rad, its columns in the order of `ANGLES`. All are 0 when one stands upright with hanging arms, thumbs ahead.

raise, spread, turn   the upper arm ahead and up; away from the body; about its own axis
elbow, palm           flexion; the forearm turned inwards
wrist, deviate        the hand bent towards the palm's back; towards the thumb
shrug                 the shoulder girdle lifted
hip, out, twist       the thigh ahead; away from the body; about its own axis
knee                  flexion
pitch, yaw            toes up and out, of the foot in the room
tilt, list            the pelvis ahead; to its side
lean, side, spin      the trunk on the pelvis: ahead, to its side, about the vertical
nod, look, cock       the head on the trunk: ahead, about the vertical, to its side
"""

from __future__ import annotations

import numpy as np

from asterism.recording import Floats

ARM = ("raise", "spread", "turn", "elbow", "palm", "wrist", "deviate", "shrug")
LEG = ("hip", "out", "twist", "knee", "pitch", "yaw")
TRUNK = ("tilt", "list", "lean", "side", "spin", "nod", "look", "cock")
ANGLES = tuple(f"{side} {angle}" for side in ("left", "right") for angle in ARM + LEG) + TRUNK
COLUMN = {name: i for i, name in enumerate(ANGLES)}
"""Where each angle stands in an array of angles."""

LIMITS_DEG = {
    "raise": (-55, 175),
    "spread": (-45, 165),
    "turn": (-80, 80),
    "elbow": (0, 145),
    "palm": (-110, 110),
    "wrist": (-60, 60),
    "deviate": (-25, 25),
    "shrug": (-8, 20),
    "hip": (-25, 120),
    "out": (-20, 50),
    "twist": (-35, 40),
    "knee": (0, 140),
    "pitch": (-70, 35),
    "yaw": (-25, 45),
    "tilt": (-20, 60),
    "list": (-15, 15),
    "lean": (-25, 75),
    "side": (-30, 30),
    "spin": (-45, 45),
    "nod": (-40, 45),
    "look": (-70, 70),
    "cock": (-25, 25),
}
"""What joints allow, as textbooks of anatomy round it: degrees, both sides alike."""

_LOW, _HIGH = np.radians([LIMITS_DEG[name.split()[-1]] for name in ANGLES]).T


def limited(angles: Floats) -> Floats:
    """The angles (..., A) within what joints allow."""
    return np.clip(angles, _LOW, _HIGH)


def slow_curves(time: Floats, rng: np.random.Generator, count: int, low: float, high: float) -> Floats:
    """(T, count) smooth random curves of standard deviation 1: three sines each, of frequencies between low and high (Hz); time (T,) s."""
    frequency, phase = rng.uniform(low, high, (3, count)), rng.uniform(0.0, 2.0 * np.pi, (3, count))
    share = np.sqrt(2.0 * rng.dirichlet(np.ones(3), count).T)
    return np.asarray((share * np.sin(2.0 * np.pi * frequency * time[:, None, None] + phase)).sum(axis=1))


def restless(time: Floats, rng: np.random.Generator, std: float) -> Floats:
    """(T, A) rad, how joints wander about what they are meant to do, by `std` rad: half of it by four synergies that joints share."""
    synergies = rng.normal(size=(4, len(ANGLES))) / 2.0
    shared = slow_curves(time, rng, 4, 0.1, 0.8) @ synergies
    return std * np.sqrt(0.5) * (shared + slow_curves(time, rng, len(ANGLES), 0.1, 1.0))
