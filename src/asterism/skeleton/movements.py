"""Frame times in; joint angles of someone who stands, walks, runs, or goes from posture to posture, out."""

from __future__ import annotations

import numpy as np

from asterism.recording import Floats
from asterism.skeleton.angles import COLUMN, limited, restless, slow_curves
from asterism.skeleton.postures import Posture, any_posture, posture_book, taken

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

_OWN_DEG = np.array([2.5, 1.0, 0.6, 0.3, 0.1, 0.1])
"""How far one person's curve is from the usual one, by harmonic: degrees, standard deviation. Gait is smooth: high ones differ little."""

_ARMS_OF_WALKERS = ("hang", "hang", "hang", "away", "carry", "crossed", "hips", "runner")
"""What arms do while one walks; most hang and swing."""


def standing(time: Floats, rng: np.random.Generator) -> Floats:
    """(T, A) rad, of someone who stands still in one of the usual postures; time (T,) s."""
    postures, share = posture_book().standing()
    posture = postures[rng.choice(len(postures), p=share)]
    return limited(taken(rng, posture) + restless(time, rng, np.radians(0.7)))


def moving(time: Floats, rng: np.random.Generator, apart: float = 0.5, hold: float = 0.8) -> Floats:
    """(T, A) rad, of someone who goes from posture to posture, one every `hold` s or so.

    apart: share of the postures with arms, legs and trunk drawn each by itself.
    """
    begins = [0.0]
    while begins[-1] < time[-1] + 0.1:
        begins.append(begins[-1] + hold * rng.uniform(0.5, 1.6))
    postures = np.array([taken(rng, any_posture(rng, apart)) for _ in begins])
    at = np.clip(np.searchsorted(begins, time, side="right") - 1, 0, len(begins) - 2)
    start, end = np.array(begins)[at], np.array(begins)[at + 1]
    # a fifth of the time is spent in the posture itself
    share = np.clip(1.25 * (time - start) / (end - start), 0.0, 1.0)[:, None]
    # the path of least jerk from rest to rest (Flash and Hogan, J Neurosci 5, 1985)
    eased = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return limited(postures[at] + eased * (postures[at + 1] - postures[at]) + restless(time, rng, np.radians(4.0)))


def walking(time: Floats, rng: np.random.Generator) -> Floats:
    """(T, A) rad, of someone who walks, slowly or fast."""
    arms = str(rng.choice(_ARMS_OF_WALKERS))
    swing = 1.0 if arms in ("hang", "away", "runner") else 0.15
    return _gait(time, rng, Posture(arms, "stand", "upright"), rng.uniform(0.75, 1.1), rng.uniform(0.6, 1.15), swing, 0.0)


def running(time: Floats, rng: np.random.Generator) -> Floats:
    """(T, A) rad, of someone who runs."""
    return _gait(time, rng, Posture("runner", "stand", "lean"), rng.uniform(1.25, 1.55), rng.uniform(1.15, 1.6), 1.0, 1.0)


def _gait(time: Floats, rng: np.random.Generator, posture: Posture, cadence: float, vigour: float, swing: float, crouch: float) -> Floats:
    """(T, A) rad, of a cyclic gait.

    cadence cycles per second; vigour, swing: times the usual swing of all joints, of the arms; crouch: 1 where knees and hips stay bent.
    """
    # nobody keeps a cadence exactly
    phase = rng.random() + cadence * time + 0.01 * np.sin(2.0 * np.pi * 0.3 * time + rng.uniform(0.0, 6.0))
    own: dict[str, np.ndarray] = {}

    def curve(name: str, shift: float, scale: float = 1.0) -> Floats:
        spectrum = np.fft.rfft(GAIT_DEG[name])[: len(_OWN_DEG)] / len(GAIT_DEG[name])
        if name not in own:
            own[name] = (rng.normal(size=len(_OWN_DEG)) + 1j * rng.normal(size=len(_OWN_DEG))) * _OWN_DEG
        turns = np.exp(2j * np.pi * np.outer(phase + shift, np.arange(1, len(_OWN_DEG))))
        mean = spectrum[0].real + own[name][0].real
        return np.radians(mean + 2.0 * scale * (turns @ (spectrum[1:] + own[name][1:])).real)

    angles = np.tile(taken(rng, posture, 0.7), (len(time), 1))
    for side, shift in (("left", 0.0), ("right", 0.5)):
        here = {name: COLUMN[f"{side} {name}"] for name in ("hip", "knee", "pitch", "raise", "elbow", "twist", "yaw")}
        angles[:, here["hip"]] = curve("hip", shift, vigour) - curve("tilt", shift) + np.radians(8.0) * crouch
        angles[:, here["knee"]] = curve("knee", shift, vigour) + np.radians(15.0) * crouch
        # the foot meets the floor, so that it never pitches much more than in walking
        angles[:, here["pitch"]] = curve("pitch", shift, min(vigour, 1.15)) - np.radians(10.0) * crouch
        angles[:, here["raise"]] += swing * vigour * (curve("raise", shift) + np.radians(5.0))
        angles[:, here["elbow"]] += swing * vigour * (curve("elbow", shift) - np.radians(28.0))
        angles[:, here["yaw"]] = angles[:, here["twist"]] + np.radians(rng.normal(4.0, 4.0))
    angles[:, COLUMN["tilt"]] = curve("tilt", 0.0) + np.radians(8.0) * crouch
    angles[:, COLUMN["list"]] = curve("list", 0.0, vigour)
    angles[:, COLUMN["spin"]] += vigour * (curve("pelvis turn", 0.0) - curve("trunk turn", 0.0))
    return limited(angles + restless(time, rng, np.radians(1.5)))


def heading(time: Floats, rng: np.random.Generator) -> Floats:
    """(T,) rad, where someone heads: anywhere, turning slowly and a little to and fro."""
    start, rate = rng.uniform(-np.pi, np.pi), np.radians(rng.normal(0.0, 20.0))
    return start + rate * time + np.radians(8.0) * slow_curves(time, rng, 1, 0.05, 0.3)[:, 0]
