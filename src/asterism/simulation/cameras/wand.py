"""A rig in; the blobs of a wand that is waved through what it sees, and the truth about them, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from asterism.cameras import Rig
from asterism.cameras.accuracy import lines_of_sight_meet, sees
from asterism.errors import AsterismError
from asterism.recording import Blobs, Floats, Ints
from asterism.simulation.cameras.images import ImagingSettings, simulate_blobs

STEP = 0.6
"""Seconds between the places and directions that a hand aims at."""


@dataclass(frozen=True)
class WandTruth:
    """What a simulated wand did.

    positions  (T, K, 3) m, its markers
    identity   (P,) int for each blob: which wand marker it is, -1 for a stray or an outlier, -2 for several markers in one
    """

    positions: Floats
    identity: Ints


def simulate_wand(
    rig: Rig,
    lengths: Sequence[float] = (0.0, 0.2, 0.6),
    frames: int = 2000,
    *,
    rng: np.random.Generator,
    rate: float = 100.0,
    settings: ImagingSettings | None = None,
) -> tuple[Blobs, WandTruth]:
    """A wand waved by hand through the volume that the rig sees: 1 to 2 m/s, turning all the while.

    lengths   m, where its markers sit along it (any number of them, increasing)
    rate      frames per second; few frames cover the volume only at a low rate
    settings  how the cameras see it; None: 0.2 px of noise

    Raises AsterismError as `simulate_blobs` does, and where no place is seen by two cameras.

    >>> from asterism.simulation.cameras import ring_rig
    >>> blobs, truth = simulate_wand(ring_rig(4), frames=50, rng=np.random.default_rng(0))
    >>> np.linalg.norm(truth.positions[:, 2] - truth.positions[:, 0], axis=1).round(3).max()
    np.float64(0.6)
    """
    along = np.asarray(lengths, dtype=np.float64)
    if len(along) < 1 or frames < 1 or not rate > 0 or np.any(np.diff(along) <= 0):
        raise AsterismError("a wand needs increasing lengths, at least one frame and a positive rate.")
    steps = int(np.ceil(frames / rate / STEP)) + 2
    places = _tour(*_seen(rig, 0.5 * float(along[-1] - along[0]) + 0.05, rng), steps, rng)
    # A normal vector made one long points anywhere with equal chance.
    directions = rng.normal(size=(steps, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    # Splines through places and directions: a hand moves without corners.
    time = np.arange(frames) / rate / STEP
    middle = CubicSpline(np.arange(steps), places)(time)
    direction = CubicSpline(np.arange(steps), directions)(time)
    # A spline between unit vectors is shorter than one.
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    positions = middle[:, None] + direction[:, None] * (along - along.mean())[:, None]
    imaging = ImagingSettings(noise=0.2) if settings is None else settings
    blobs, identity = simulate_blobs(rig, positions, imaging, rng=rng, rate=rate)
    return blobs, WandTruth(positions, identity)


def _seen(rig: Rig, margin: float, rng: np.random.Generator, tries: int = 4000) -> tuple[Floats, NDArray[np.bool_]]:
    """Places (N, 3) m, `margin` m above the floor or more, that at least two cameras see, and which cameras see them, (C, N)."""
    middle = lines_of_sight_meet(rig)
    eyes = np.stack([camera.position for camera in rig])
    reach = float(np.median(np.linalg.norm(eyes - middle, axis=1)))
    # Candidates around where most cameras look; those that two see are kept.
    points = middle + rng.uniform(-0.6, 0.6, (tries, 3)) * reach
    if rig.vertical is not None:
        height = points @ rig.vertical
        # A rig may have its origin above the floor: no camera hangs below it.
        floor = min(0.0, float((eyes @ rig.vertical).min()))
        points = points[(height > floor + margin) & (height < floor + 2.3)]
    seen = sees(rig, points)
    common = seen.sum(axis=0) >= 2
    if not common.any():
        raise AsterismError("no volume is seen by two cameras of the rig at once; turn them to one place.")
    return points[common], seen[:, common]


def _tour(places: Floats, seen: NDArray[np.bool_], steps: int, rng: np.random.Generator) -> Floats:
    """(steps, 3) m: places one after the other, each about 0.9 m from the one before.

    A hand goes where it has not been yet, where many cameras look, and most of all before cameras that have seen little so far.
    """
    at = int(rng.integers(len(places)))
    tour, visited, shown = [places[at]], np.zeros(len(places)), seen[:, at].astype(np.float64)
    for _ in range(steps - 1):
        away = np.linalg.norm(places - tour[-1], axis=1)
        visited += np.exp(-0.5 * (away / 0.3) ** 2)
        # Cameras that have seen little pull the hand towards them.
        wanted = (seen / (1.0 + shown)[:, None]).sum(axis=0) / (1.0 / (1.0 + shown)).sum()
        # Not where it was, about 0.9 m on, a little chance, and most of all before cameras that lack views.
        at = int(np.argmin(visited + 8.0 * (away - 0.9) ** 2 + 0.3 * rng.random(len(places)) - 3.0 * wanted))
        tour.append(places[at])
        shown += seen[:, at]
    return np.array(tour)
