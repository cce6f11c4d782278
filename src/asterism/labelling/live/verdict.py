"""Labelled frames of a stream in, one by one; whether they show what the model was trained on, and how certain labels may be, out."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from asterism.labelling.whole.verdict import RigidDistances
from asterism.recording import Floats


@dataclass(frozen=True)
class LiveVerdictRules:
    """How a stream is judged. Not tuned.

    memory    s in which what was seen decays to 1/e
    interval  s between two judgements
    """

    memory: float = 2.0
    interval: float = 0.1


class LiveVerdict:
    """Compares the near-rigid distances of the last seconds with the training's.

    Memory and cost of a frame grow with the number of these distances only.
    """

    def __init__(self, distances: RigidDistances, rate: float, rules: LiveVerdictRules) -> None:
        self._distances = distances
        self._decay = math.exp(-1.0 / (rules.memory * rate))
        self._interval = max(1, round(rules.interval * rate))
        self.restart()

    def restart(self) -> None:
        """Forget the person."""
        self._sum = np.zeros(len(self._distances.first))
        self._weight = np.zeros(len(self._distances.first))
        self._frames = 0
        self.scatter = float("nan")

    @property
    def fits(self) -> bool:
        """Whether the last seconds show what the model was trained on; so does what cannot be compared."""
        return not self.scatter > self._distances.limit

    @property
    def limit(self) -> float:
        """What no label may be more certain than."""
        return float(self._distances.confidence_limits(np.array([self.scatter]))[0])

    def add(self, points: Floats) -> None:
        """Take a frame: points (M, 3) m, NaN for a marker without a label."""
        distance = np.linalg.norm(points[self._distances.first] - points[self._distances.second], axis=1)
        known = ~np.isnan(distance)
        self._sum = self._decay * self._sum + np.where(known, distance, 0.0)
        self._weight = self._decay * self._weight + known
        if self._frames % self._interval == 0:
            seen = self._weight > 0.0
            mean = np.where(seen, self._sum / np.where(seen, self._weight, 1.0), np.nan)
            self.scatter = float(self._distances.scatters_of(mean[None])[0])
        self._frames += 1
