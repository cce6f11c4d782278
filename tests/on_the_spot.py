"""People who stay where they are: on feet that stand, and on feet that leave the floor and come back."""

from __future__ import annotations

import numpy as np

from asterism import Recording


def rises(times: np.ndarray, begins: float, lasts: float) -> np.ndarray:
    """From 0 to 1 and back, along a cosine."""
    return 0.5 - 0.5 * np.cos(2 * np.pi * np.clip((times - begins) / lasts, 0, 1))


def upon_feet(pelvis: np.ndarray, **feet: np.ndarray) -> Recording:
    """Somebody whose pelvis goes along a path (T, 2), ahead and up, over feet that stand but for ways (T, 2) of heel (LH, RH) and toe."""
    points = {}
    for side, aside in (("L", 0.1), ("R", -0.1)):
        for name, end, ahead, high in (("HEE", "H", 0.0, 0.05), ("TOE", "T", 0.2, 0.04)):
            way = feet.get(side + end, np.zeros_like(pelvis))
            points[side + name] = np.stack([ahead + way[:, 0], np.full(len(way), aside), high + way[:, 1]], axis=1)
    for name, ahead, aside in (("LASI", 0.1, 0.12), ("RASI", 0.1, -0.12), ("SACR", 0.0, 0.0)):
        points[name] = np.stack([ahead + pelvis[:, 0], np.full(len(pelvis), aside), pelvis[:, 1]], axis=1)
    positions = np.stack(list(points.values()), axis=1)
    return Recording(positions + np.random.default_rng(0).normal(0.0, 0.0005, positions.shape), tuple(points), 100.0)


TEN_SECONDS = np.arange(0.0, 10.0, 0.01)


def standing_movements() -> dict[str, Recording]:
    """What people do on feet that stay: squats, on flat feet and on their toes; sitting down; swaying; a swing of a golf club."""
    deep = sum(rises(TEN_SECONDS, begins, 1.6) for begins in np.arange(0.5, 8.0, 1.9))
    toes = np.stack([0.2 - 0.2 * np.cos(0.6 * deep), 0.2 * np.sin(0.6 * deep)], axis=1)
    turned = 0.9 * rises(TEN_SECONDS, 3.0, 2.0)
    still = np.full_like(deep, 0.9)
    return {
        "squat": upon_feet(np.stack([-0.2 * deep, 0.9 - 0.4 * deep], axis=1)),
        "squat on the toes": upon_feet(np.stack([-0.1 * deep, 0.9 - 0.4 * deep], axis=1), LH=toes, RH=toes),
        "sit": upon_feet(np.stack([-0.45 * deep, 0.9 - 0.35 * deep], axis=1)),
        "sway": upon_feet(np.stack([0.1 * np.sin(0.8 * np.pi * TEN_SECONDS), still], axis=1)),
        "golf": upon_feet(
            np.stack([0.12 * turned, still], axis=1), RH=np.stack([0.2 - 0.2 * np.cos(turned), 0.2 * np.sin(turned)], axis=1)
        ),
    }


def marching() -> tuple[Recording, dict[str, np.ndarray]]:
    """Somebody who lifts a foot, and the other one, each for half a second; and s, when each of them leaves."""
    feet, swings = {}, {}
    for side, first in (("L", 0.5), ("R", 1.0)):
        swings[side] = first + np.arange(8.0)
        up = sum(rises(TEN_SECONDS, begins, 0.5) for begins in swings[side])
        feet |= {side + "H": np.stack([0.12 * up, 0.24 * up], axis=1), side + "T": np.stack([0.12 * up, 0.17 * up], axis=1)}
    return upon_feet(np.tile([0.0, 0.9], (len(TEN_SECONDS), 1)), **feet), swings


def kicking() -> tuple[Recording, float]:
    """Somebody whose right foot swings back and then ahead, where it is farthest after 2.9 s; and s, when it is back on the floor."""
    back, ahead = rises(TEN_SECONDS, 2.0, 0.6), rises(TEN_SECONDS, 2.5, 0.7)
    way = np.stack([0.8 * ahead - 0.4 * back, 0.5 * rises(TEN_SECONDS, 2.5, 0.8) + 0.25 * back], axis=1)
    return upon_feet(np.tile([0.0, 0.9], (len(TEN_SECONDS), 1)), RH=way, RT=way), 3.3


def pedalling() -> Recording:
    """Somebody on a bicycle that stands: cranks of 17 cm, 72 turns a minute."""
    feet = {}
    for side, ahead in (("L", 0.0), ("R", np.pi)):
        turn = 2.4 * np.pi * TEN_SECONDS + ahead
        pedal = np.stack([0.3 + 0.17 * np.cos(turn), 0.25 - 0.17 * np.sin(turn)], axis=1)
        feet |= {side + "T": pedal, side + "H": pedal + np.stack([0.0 * turn, 0.02 * np.cos(turn)], axis=1)}
    return upon_feet(np.tile([0.0, 1.05], (len(TEN_SECONDS), 1)), **feet)
