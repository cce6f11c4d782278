"""Frame times in; joint angles of someone who stands, walks, runs, or goes from posture to posture, out."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from asterism.recording import Floats
from asterism.skeleton.angles import COLUMN, limited, restless, slow_curves
from asterism.skeleton.postures import Posture, Step, any_posture, like_a_recorded_one, posture_book, taken

GAIT_DEG = {
    "hip": (30, 25, 16, 6, -4, -10, -2, 15, 28, 32),
    "knee": (5, 14, 14, 8, 5, 11, 38, 60, 55, 26),
    "pitch": (17, 2, 0, -1, -8, -27, -56, -54, -20, 12),
    "tilt": (10, 11, 10, 9, 9, 10, 11, 10, 9, 9),
    "list": (0, 4, 4, 2, 1, 0, -4, -4, -2, -1),
    "pelvis turn": (4, 3, 1, -1, -3, -4, -3, -1, 1, 3),
    "raise": (-18, -15, -6, 5, 14, 18, 15, 8, -4, -14),
    "elbow": (22, 22, 24, 28, 34, 38, 36, 31, 26, 23),
    "trunk turn": (-5, -4, -2, 1, 4, 5, 4, 2, -1, -4),
}
"""Joint angles of normal gait as textbooks show them: degrees, every 10 % of the cycle from the foot strike on."""

RUN_DEG = {
    "hip": (31, 27, 15, 3, -5, -1, 15, 33, 41, 37),
    "knee": (18, 36, 40, 28, 18, 34, 66, 88, 76, 38),
    "pitch": (12, 0, -4, -22, -58, -82, -84, -64, -30, 4),
    "tilt": (12, 13, 12, 11, 12, 12, 13, 12, 11, 12),
    "list": (0, 4, 5, 2, 0, 0, -4, -5, -2, 0),
    "pelvis turn": (5, 3, 0, -3, -5, -5, -3, 0, 3, 5),
    "raise": (-45, -38, -28, -16, -8, -6, -10, -20, -32, -42),
    "elbow": (92, 96, 102, 108, 110, 108, 102, 96, 92, 90),
    "trunk turn": (-12, -8, -2, 5, 10, 12, 8, 2, -5, -10),
}
"""The same of running, with the foot off the floor from 35 to 40 % of the cycle on: the heel is flung up behind, the arms are bent."""

_OWN_DEG = np.array([2.5, 1.0, 0.6, 0.3, 0.1, 0.1])
"""How far one person's curve is from the usual one, by harmonic: degrees, standard deviation. Gait is smooth: high ones differ little."""

_ARMS_OF_WALKERS = ("hang", "hang", "hang", "away", "carry", "crossed", "hips", "runner")
"""What arms do while one walks; most hang and swing."""


@dataclass(frozen=True)
class Movement:
    """What a body does: angles (T, A) rad; above (T,) m, how far its lowest part is from the floor."""

    angles: Floats
    above: Floats


def standing(time: Floats, rng: np.random.Generator) -> Movement:
    """Someone who stands still in one of the usual postures; time (T,) s."""
    postures, share = posture_book().standing()
    posture = postures[rng.choice(len(postures), p=share)]
    return _on_the_floor(taken(rng, posture) + restless(time, rng, np.radians(0.7)))


def moving(time: Floats, rng: np.random.Generator, recorded: float = 0.35, apart: float = 0.5, without: Collection[str] = ()) -> Movement:
    """Someone who goes from posture to posture, one every 0.8 s or so.

    recorded: share of the postures that are near one of a recorded person, but for those of the sources `without`.
    apart: share of the others with arms, legs and trunk drawn each by itself.
    """
    begins = [0.0]
    while begins[-1] < time[-1] + 0.1:
        begins.append(begins[-1] + rng.uniform(0.4, 1.3))
    postures = np.array(
        [like_a_recorded_one(rng, without) if rng.random() < recorded else taken(rng, any_posture(rng, apart)) for _ in begins]
    )
    # a fifth of the time is spent in the posture itself
    angles = _through(time, np.array(begins), postures, 0.8)
    return _on_the_floor(angles + restless(time, rng, np.radians(4.0)))


def acting(time: Floats, rng: np.random.Generator, steps: Sequence[Step]) -> Movement:
    """Someone who goes through these steps again and again, from anywhere in them on, at a pace of one's own."""
    exchanged, pace = bool(rng.random() < 0.5), rng.uniform(0.7, 1.4)
    # one takes each posture in one's own way, and a little otherwise each time
    own = np.array([np.append(taken(rng, step.posture, 1.0, exchanged), step.above) for step in steps])
    seconds = pace * np.array([step.seconds for step in steps])
    begins, which = [-rng.random() * seconds.sum()], [0]
    while begins[-1] < time[-1] + 0.1:
        # a step's time is that of the way to it
        which.append((which[-1] + 1) % len(steps))
        begins.append(begins[-1] + seconds[which[-1]] * rng.uniform(0.85, 1.15))
    # within what hands and feet repeat: an eighth of a second is too short for a rest between two steps
    found = _through(time, np.array(begins), own[which], 1.0)
    return Movement(limited(found[:, :-1] + restless(time, rng, np.radians(3.0))), np.maximum(found[:, -1], 0.0))


def _through(time: Floats, begins: Floats, rows: Floats, moved: float) -> Floats:
    """(T, N) from row to row (B, N), the way to the next one beginning at `begins` (B,) s and taking a share `moved` of the time to it."""
    at = np.clip(np.searchsorted(begins, time, side="right") - 1, 0, len(begins) - 2)
    start, end = begins[at], begins[at + 1]
    share = np.clip((time - start) / (moved * (end - start)), 0.0, 1.0)[:, None]
    # the path of least jerk from rest to rest (Flash and Hogan, J Neurosci 5, 1985)
    eased = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return np.asarray(rows[at] + eased * (rows[at + 1] - rows[at]))


def _on_the_floor(angles: Floats) -> Movement:
    return Movement(limited(angles), np.zeros(len(angles)))


def walking(time: Floats, rng: np.random.Generator) -> Movement:
    """Someone who walks, slowly or fast."""
    arms = str(rng.choice(_ARMS_OF_WALKERS))
    swing = 1.0 if arms in ("hang", "away", "runner") else 0.15
    cadence, vigour = rng.uniform(0.75, 1.1), rng.uniform(0.6, 1.15)
    posture = taken(rng, Posture(arms, "stand", "upright"), 0.7)
    return _on_the_floor(_gait(time, rng, posture, GAIT_DEG, cadence, vigour, swing))


def running(time: Floats, rng: np.random.Generator) -> Movement:
    """Someone who runs, from a jog to 7 m/s; with arms as runners have them, or now and then otherwise."""
    vigour = rng.uniform(0.7, 1.35)
    cadence = rng.uniform(1.2, 1.4) + 0.3 * (vigour - 0.7)
    arms = "runner" if rng.random() < 0.85 else str(rng.choice(_ARMS_OF_WALKERS))
    angles = _gait(time, rng, taken(rng, Posture(arms, "stand", "lean"), 0.7), RUN_DEG, cadence, vigour, 1.0 if arms == "runner" else 0.3)
    return _on_the_floor(angles)


def _gait(
    time: Floats,
    rng: np.random.Generator,
    posture: Floats,
    curves: Mapping[str, tuple[int, ...]],
    cadence: float,
    vigour: float,
    swing: float,
) -> Floats:
    """(T, A) rad, of a cyclic gait.

    posture (A,) rad, about which it moves; cadence cycles per second; vigour, swing: times the usual swing of all joints, of the arms.
    """
    # nobody keeps a cadence exactly
    phase = rng.random() + cadence * time + 0.01 * np.sin(2.0 * np.pi * 0.3 * time + rng.uniform(0.0, 6.0))
    own: dict[str, np.ndarray] = {}

    def curve(name: str, shift: float, scale: float = 1.0) -> Floats:
        spectrum = np.fft.rfft(curves[name])[: len(_OWN_DEG)] / len(curves[name])
        if name not in own:
            own[name] = (rng.normal(size=len(_OWN_DEG)) + 1j * rng.normal(size=len(_OWN_DEG))) * _OWN_DEG
        turns = np.exp(2j * np.pi * np.outer(phase + shift, np.arange(1, len(_OWN_DEG))))
        mean = spectrum[0].real + own[name][0].real
        return np.radians(mean + 2.0 * scale * (turns @ (spectrum[1:] + own[name][1:])).real)

    angles = np.tile(posture, (len(time), 1))
    usual = {name: np.radians(np.mean(curves[name])) for name in ("raise", "elbow")}
    for side, shift in (("left", 0.0), ("right", 0.5)):
        here = {name: COLUMN[f"{side} {name}"] for name in ("hip", "knee", "pitch", "raise", "elbow", "twist", "yaw", "out")}
        angles[:, here["hip"]] = curve("hip", shift, vigour)
        angles[:, here["knee"]] = curve("knee", shift, vigour)
        # the foot meets the floor, so that it never pitches much more than usual
        angles[:, here["pitch"]] = curve("pitch", shift, min(vigour, 1.15))
        angles[:, here["raise"]] += swing * vigour * (curve("raise", shift) - usual["raise"])
        angles[:, here["elbow"]] += swing * vigour * (curve("elbow", shift) - usual["elbow"])
        # feet come down near the line under the body
        angles[:, here["out"]] -= np.radians(5.0) * min(vigour, 1.0)
        angles[:, here["yaw"]] = angles[:, here["twist"]] + np.radians(rng.normal(4.0, 4.0))
    angles[:, COLUMN["tilt"]] = curve("tilt", 0.0)
    angles[:, COLUMN["list"]] = curve("list", 0.0, vigour)
    angles[:, COLUMN["spin"]] += vigour * (curve("pelvis turn", 0.0) - curve("trunk turn", 0.0))
    return limited(angles + restless(time, rng, np.radians(1.5)))


def heading(time: Floats, rng: np.random.Generator) -> Floats:
    """(T,) rad, where someone heads: anywhere, turning slowly and a little to and fro, and now and then round a corner."""
    start, rate = rng.uniform(-np.pi, np.pi), np.radians(rng.normal(0.0, 20.0))
    if rng.random() < 0.2:
        # within a second, at some time of the recording
        middle, corner = rng.uniform(0.0, time[-1] + 1e-9), np.radians(rng.choice([-1.0, 1.0]) * rng.uniform(45.0, 180.0))
        start = start + corner / (1.0 + np.exp(-6.0 * (time - middle)))
    return start + rate * time + np.radians(8.0) * slow_curves(time, rng, 1, 0.05, 0.3)[:, 0]


def _movements() -> dict[str, Callable[[Floats, np.random.Generator], Movement]]:
    by_steps = {name: partial(acting, steps=steps) for name, steps in posture_book().movements.items()}
    return {"walk": walking, "run": running, "stand": standing, "move": moving, **by_steps}


MOVEMENTS = _movements()
"""What virtual people do, by name: movements with laws of their own, and those of the book, step by step."""

BY_STEPS = tuple(posture_book().movements)
"""The movements of the book."""
