"""The truth of an image's circles in; what a reader of known error would have read out: dense points can be tried without images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.recording import Floats
from asterism.simulation.garment.photograph import CircleTruth


@dataclass(frozen=True)
class SimulatedCircles:
    """Circles as a reader gives them: centres (n, 2) px, covariance (n, 2, 2) px2, identities (n,)."""

    centres: Floats
    covariance: Floats
    ids: NDArray[np.int32]


def simulated_reading(
    truth: CircleTruth, noise: float = 0.1, wrong: float = 0.0, astray: float = 0.0, *, rng: np.random.Generator
) -> SimulatedCircles:
    """What a reader would give of all readable circles: longer diameter 5 px or more, within 65 degrees, nine tenths visible.

    noise   px, standard deviation of a circle of 6 px; it grows as the shorter diameter shrinks
    wrong   share of the circles that get the identity of another one of the garment
    astray  share of the centres that are elsewhere by 1 to 5 px, as where a fold hides an edge

    Raises AsterismError where a share is none.
    """
    if not (noise >= 0 and 0 <= wrong <= 1 and 0 <= astray <= 1):
        raise AsterismError("noise must be at least 0, and the shares of wrong and stray circles from 0 to 1.")
    rows = np.flatnonzero(truth.readable(5.0, np.radians(65.0)) & (truth.ids >= 0))
    # A flat ellipse is read less exactly.
    sigma = noise * np.clip(6.0 / truth.diameters[rows, 1], 0.5, 3.0)
    centres = truth.centres[rows] + sigma[:, None] * rng.standard_normal((len(rows), 2))
    stray = rng.random(len(rows)) < astray
    turn, far = rng.uniform(0, 2 * np.pi, len(rows)), rng.uniform(1.0, 5.0, len(rows))
    centres = centres + (stray * far)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    ids = truth.ids[rows].copy()
    misread = rng.random(len(rows)) < wrong
    # A wrong identity is one of the garment's: another could not be printed.
    ids[misread] = rng.choice(truth.ids[truth.ids >= 0], int(misread.sum()))
    covariance = sigma[:, None, None] ** 2 * np.eye(2)
    return SimulatedCircles(centres, covariance, ids)
