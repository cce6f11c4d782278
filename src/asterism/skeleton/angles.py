"""The joint angles of a body: their names, their limits, and smooth curves of them over time.

An array of angles is (T, A) rad, its columns in the order of `ANGLES`. All are 0 when one stands upright with hanging arms, thumbs ahead.

raise, spread, turn   the upper arm ahead and up; away from the body; about its own axis
elbow, palm           flexion; the forearm turned inwards
wrist, deviate        the hand bent towards the palm's back; towards the thumb
shrug                 the shoulder girdle lifted
hip, out, twist       the thigh ahead; away from the body; about its own axis
knee                  flexion
pitch, yaw            toes up and out, of the foot against the body as a whole: in the room while one is upright
tilt, list            the pelvis ahead; to its side
lean, side, spin      the trunk on the pelvis: ahead, to its side, about the vertical
nod, look, cock       the head on the trunk: ahead, about the vertical, to its side
lie, roll             the body as a whole: tipped ahead (backwards below 0), and before that turned about its long axis
"""

from __future__ import annotations

import numpy as np

from asterism.recording import Floats
from asterism.recording.place import other_side

ARM = ("raise", "spread", "turn", "elbow", "palm", "wrist", "deviate", "shrug")
LEG = ("hip", "out", "twist", "knee", "pitch", "yaw")
TRUNK = ("tilt", "list", "lean", "side", "spin", "nod", "look", "cock")
WHOLE = ("lie", "roll")
ANGLES = tuple(f"{side} {angle}" for side in ("left", "right") for angle in ARM + LEG) + TRUNK + WHOLE
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
    "pitch": (-160, 60),
    "yaw": (-25, 45),
    "tilt": (-20, 60),
    "list": (-15, 15),
    "lean": (-25, 75),
    "side": (-30, 30),
    "spin": (-45, 45),
    "nod": (-40, 45),
    "look": (-70, 70),
    "cock": (-25, 25),
    "lie": (-180, 180),
    "roll": (-180, 180),
}
"""What joints allow, as textbooks of anatomy round it: degrees, both sides alike. The foot is held by the ankle, too."""

ANKLE_DEG = (-60, 42)
"""How far toes go down and up against the shank: degrees. Plantar flexion with the midfoot's share, and dorsal flexion under load."""

MOVABLE = np.array([name not in WHOLE for name in ANGLES], dtype=np.float64)
"""(A,) 1 for the angles of joints, 0 for those of the body as a whole."""

_MIRROR_SIGN = np.array([-1.0 if name in ("list", "side", "spin", "look", "cock", "roll") else 1.0 for name in ANGLES])
_OTHER_SIDE = np.array([COLUMN[other_side(name)] for name in ANGLES])

_LOW, _HIGH = np.radians([LIMITS_DEG[name.split()[-1]] for name in ANGLES]).T


def limited(angles: Floats) -> Floats:
    """The angles (..., A) within what joints allow."""
    found = np.clip(angles, _LOW, _HIGH)
    for side in ("left", "right"):
        shank = shank_tilt(found, side)
        low, high = np.radians(ANKLE_DEG)
        pitch = COLUMN[f"{side} pitch"]
        found[..., pitch] = np.clip(found[..., pitch], low - shank, high - shank)
    return found


def mirrored(angles: Floats) -> Floats:
    """The angles (..., A) of the same posture seen in a mirror."""
    return np.asarray(angles[..., _OTHER_SIDE] * _MIRROR_SIGN)


def shank_tilt(angles: Floats, side: str) -> Floats:
    """(...) rad, how far the shank of an upright body is tipped ahead, from angles (..., A); legs aside change it little."""
    return np.asarray(angles[..., COLUMN["tilt"]] - angles[..., COLUMN[f"{side} hip"]] + angles[..., COLUMN[f"{side} knee"]])


def slow_curves(time: Floats, rng: np.random.Generator, count: int, low: float, high: float) -> Floats:
    """(T, count) smooth random curves of standard deviation 1: three sines each, of frequencies between low and high (Hz); time (T,) s."""
    frequency, phase = rng.uniform(low, high, (3, count)), rng.uniform(0.0, 2.0 * np.pi, (3, count))
    share = np.sqrt(2.0 * rng.dirichlet(np.ones(3), count).T)
    return np.asarray((share * np.sin(2.0 * np.pi * frequency * time[:, None, None] + phase)).sum(axis=1))


def restless(time: Floats, rng: np.random.Generator, std: float) -> Floats:
    """(T, A) rad, how joints wander about what they are meant to do, by `std` rad: half of it by four synergies that joints share."""
    joints = len(ANGLES) - len(WHOLE)
    synergies = rng.normal(size=(4, joints)) / 2.0
    shared = slow_curves(time, rng, 4, 0.1, 0.8) @ synergies
    wander = std * np.sqrt(0.5) * (shared + slow_curves(time, rng, joints, 0.1, 1.0))
    # the body as a whole goes where its joints take it
    return np.concatenate([wander, np.zeros((len(time), len(WHOLE)))], axis=1)


_HABIT_DEG = {
    "raise": (5, 3),
    "spread": (5, 2),
    "turn": (6, 3),
    "elbow": (5, 4),
    "palm": (9, 3),
    "shrug": (2.5, 1.2),
    "out": (3, 1),
    "twist": (3, 1.5),
    "knee": (3, 1.5),
    "yaw": (3.5, 1.5),
    "tilt": (5, 0),
    "lean": (4, 0),
    "nod": (8, 0),
    "side": (1.5, 0),
    "look": (3, 0),
}
"""How people differ from each other in how they hold themselves: degrees, standard deviation of both sides together, and of each alone.
Of medians of angles of ten people who stood, walked or ran: see docs/virtual_people.md. Lean and nod beside what the pelvis asks for."""

_USUAL_TILT_DEG, _LEAN_FOR_TILT = -4.0, -0.8
"""People's pelves are tipped ahead by 5 degrees rather than by the 9 of the skeleton, and the trunk makes up for it."""


def habits(rng: np.random.Generator) -> Floats:
    """(A,) rad, what one person adds to every posture: how the pelvis is tipped, the head is held, feet and palms are turned."""
    degrees = np.zeros(len(ANGLES))
    both = {name: std * rng.normal() for name, (std, _) in _HABIT_DEG.items()}
    for name, column in COLUMN.items():
        plain = name.split()[-1]
        if plain in both:
            degrees[column] = both[plain] + _HABIT_DEG[plain][1] * rng.normal()
    degrees[COLUMN["tilt"]] += _USUAL_TILT_DEG
    degrees[COLUMN["lean"]] += _LEAN_FOR_TILT * degrees[COLUMN["tilt"]]
    for side in ("left", "right"):
        # the thighs hang as before
        degrees[COLUMN[f"{side} hip"]] += degrees[COLUMN["tilt"]]
    return np.radians(degrees)
