"""A labelled recording of a person in; the body that hides markers from cameras out: capsules between estimated joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.errors import AsterismError
from asterism.motion.rigid.rotations import unit_vectors
from asterism.recording import Floats, Recording, canonical, plain_name

PELVIS_WIDTH = 0.24
"""Between the markers on the front of the pelvis, in metres, of the body that `RADII` are for."""

RADII = {
    "trunk": 0.10,
    "hips": 0.09,
    "neck": 0.05,
    "head": 0.09,
    "thigh": 0.070,
    "shank": 0.048,
    "foot": 0.032,
    "upper arm": 0.045,
    "forearm": 0.035,
    "hand": 0.028,
}


@dataclass(frozen=True)
class Capsules:
    """Cylinders with round ends, moving.

    starts, ends  (T, K, 3) m, where their axes begin and end; NaN in frames without
    radii         (K,) m
    names         (K,)
    """

    starts: Floats
    ends: Floats
    radii: Floats
    names: tuple[str, ...]


def walker_capsules(recording: Recording) -> Capsules:
    """The body of the person in a recording, for occlusion: trunk, head, arms, legs and feet.

    Joints come from the markers by their usual names (those of Helen Hayes, Plug-in Gait and cluster sets: LASI, RPSI, SACR, LKNE or the
    shank's cluster, LANK or LMALL, ...); a part without markers is put where it usually is: an upright trunk on the pelvis, hanging arms.
    Offsets and radii grow with the pelvis. Good enough to hide what a body hides, not for anatomy. Raises AsterismError where
    the markers on the front of the pelvis, or those on its back, are absent.
    """
    markers = _Markers(recording)
    left_front, right_front = markers.mean("LASI"), markers.mean("RASI")
    front, back = markers.mean("LASI", "RASI"), markers.mean("LPSI", "RPSI", "SACR")
    if left_front is None or right_front is None or front is None or back is None:
        raise AsterismError("a body needs the pelvis' markers (LASI, RASI, and LPSI and RPSI or SACR); label them.")
    # The pelvis gives the scale of everything else; its median holds where a frame is noisy.
    width = float(np.nanmedian(np.linalg.norm(left_front - right_front, axis=1)))
    scale = width / PELVIS_WIDTH
    # Axes of the pelvis that stay level: a body leans, a trunk capsule does not need to.
    left = unit_vectors(left_front - right_front)
    up = unit_vectors(recording.vertical - left * (left @ recording.vertical)[:, None])
    ahead = np.cross(left, up)
    middle = 0.5 * (front + back)

    def at(origin: Floats, forward: float = 0.0, leftward: float = 0.0, upward: float = 0.0) -> Floats:
        place: Floats = origin + scale * (forward * ahead + leftward * left + upward * up)
        return place

    # Parts without markers stand where they usually are: a guess hides better than nothing.
    neck = markers.mean("C7", "CLAV")
    neck = at(middle, upward=0.50) if neck is None else neck
    head = markers.mean("LFHD", "RFHD", "LBHD", "RBHD")
    head = at(neck, forward=0.04, upward=0.18) if head is None else head
    bones: list[tuple[str, Floats, Floats]] = [("neck", neck, head), ("head", at(head, upward=-0.04), at(head, upward=0.06))]
    for side, sign in (("L", 1.0), ("R", -1.0)):
        hip = at(middle, leftward=0.085 * sign, upward=-0.07)
        ankle = _ankle(markers, side, sign, left, scale)
        shoulder = markers.mean(f"{side}SHO", f"{side}ACR")
        shoulder = at(neck, leftward=0.17 * sign, upward=-0.06) if shoulder is None else at(shoulder, upward=-0.05)
        bones += [
            ("hips", hip, at(middle, leftward=0.05 * sign, upward=0.05)),
            ("trunk", at(middle, leftward=0.05 * sign, upward=0.05), 0.5 * (neck + shoulder) - 0.08 * scale * up),
        ]
        if ankle is not None:
            knee = _knee(markers, side, sign, left, scale, hip, ankle)
            toe = markers.mean(f"{side}TOE", f"{side}MT1", f"{side}MT5", f"{side}D1M", f"{side}D5M")
            heel = markers.mean(f"{side}HEE", f"{side}CAL")
            bones += [("thigh", hip, knee), ("shank", knee, ankle)]
            if toe is not None and heel is not None:
                bones.append(("foot", heel + 0.2 * (toe - heel), toe))
        # Markers sit on the skin; the capsule runs inside the limb.
        elbow, wrist = markers.mean(f"{side}ELB"), markers.mean(f"{side}WRA", f"{side}WRB")
        elbow = at(shoulder, leftward=0.05 * sign, upward=-0.28) if elbow is None else at(elbow, leftward=-0.04 * sign)
        wrist = at(elbow, forward=0.10, leftward=0.02 * sign, upward=-0.22) if wrist is None else wrist
        bones += [("upper arm", shoulder, elbow), ("forearm", elbow, wrist), ("hand", wrist, wrist + 0.35 * (wrist - elbow))]
    return Capsules(
        np.ascontiguousarray(np.stack([start for _, start, _ in bones], axis=1)),
        np.ascontiguousarray(np.stack([end for _, _, end in bones], axis=1)),
        np.array([scale * RADII[name] for name, _, _ in bones]),
        tuple(name for name, _, _ in bones),
    )


class _Markers:
    """Positions by name, with or without a subject before it (Ann:LKNE)."""

    def __init__(self, recording: Recording) -> None:
        self._positions = recording.positions
        self._place = {plain_name(name): i for i, name in enumerate(recording.labels)}

    def mean(self, *names: str) -> Floats | None:
        """(T, 3) m, NaN in frames in which one of those that the recording has is missing; None where it has none of them."""
        known = [self._place[canonical(name)] for name in names if canonical(name) in self._place]
        if not known:
            return None
        mean: Floats = self._positions[:, known].mean(axis=1)
        return mean


def _ankle(markers: _Markers, side: str, sign: float, left: Floats, scale: float) -> Floats | None:
    both = markers.mean(f"{side}MALL", f"{side}MALM")
    if both is not None:
        return both
    outer = markers.mean(f"{side}ANK")
    return None if outer is None else outer - 0.035 * scale * sign * left


def _knee(markers: _Markers, side: str, sign: float, left: Floats, scale: float, hip: Floats, ankle: Floats) -> Floats:
    """From the knee's marker, else along the shank's cluster, else halfway."""
    outer = markers.mean(f"{side}KNE")
    if outer is not None:
        return outer - 0.05 * scale * sign * left
    cluster = markers.mean(f"{side}TBU", f"{side}TBD", f"{side}TBM", f"{side}TBC")
    if cluster is None:
        return 0.5 * (hip + ankle)
    # A cluster gives the direction of the shank, half of the leg its length.
    shank = 0.5 * float(np.nanmax(np.linalg.norm(hip - ankle, axis=1)))
    return ankle + shank * unit_vectors(cluster - 0.05 * scale * sign * left - ankle)
