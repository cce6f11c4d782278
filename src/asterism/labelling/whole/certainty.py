"""How certain a tracklet's label is: margins of labels from trials with known truth in; confidence, and the least one to accept, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.labelling.training.calibration import Calibration
from asterism.recording import NULL, Floats, Ints

MIN_TRUST = 0.1
"""Confidence is never less than this share of what the margin alone says, whatever the trials showed."""

MAX_SLOPE, MAX_SLOPE_OF_ONE = 5.0, 3.5
"""Log odds per nat of margin that a label is right, at most: without a margin a label is a coin toss, whatever the trials showed. The lower
value is for a model of one person, which was tried on that person only; from five people on the first one holds."""


@dataclass(frozen=True)
class TrialLabels:
    """Labels from n trials with known truth.

    margin           (n,) nats
    right            (n,) 0 or 1
    near_unlabelled  (n,) 1 where a point without a label was there at the same time, which may be a ghost
    """

    margin: Floats
    right: Floats
    near_unlabelled: Ints

    @classmethod
    def together(cls, parts: Sequence[TrialLabels]) -> TrialLabels:
        """All trials as one."""
        if not parts:
            return cls(np.empty(0), np.empty(0), np.empty(0, dtype=np.int64))
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("margin", "right", "near_unlabelled")))


@dataclass(frozen=True)
class Certainty:
    """From tracklets' margins to the confidence of their labels.

    calibrations      for tracklets without and with an unlabelled point at the same time: where ghosts may be, labels are less certain
    least_confidence  labels below this confidence are taken back
    max_slope         log odds per nat of margin at most
    """

    calibrations: tuple[Calibration, Calibration]
    least_confidence: float
    max_slope: float = MAX_SLOPE

    def confidence(self, margin: Floats, near_unlabelled: Ints) -> Floats:
        """The probability that labels are right: (J,).

        Few trials have small margins, so `max_slope` bounds the confidence there. Confidence is never less than a tenth of that bound: if
        all labels of the few people tried were wrong (one person stood, the other walked), those of the next one may still be right.
        """
        alone, crowded = (calibration.confidence(margin) for calibration in self.calibrations)
        bound = 1.0 / (1.0 + np.exp(-self.max_slope * np.clip(margin, -100.0, 100.0)))
        return np.clip(np.where(near_unlabelled > 0, crowded, alone), MIN_TRUST * bound, bound)

    @classmethod
    def fit(cls, trials: TrialLabels, target: float, people: int) -> Certainty:
        """Calibrate on trials of a model of so many people; `target`: share of the given labels that shall be right, where ghosts are near.

        The least confidence for that is a power law, fitted to people left out (docs/recordings.md): 0.70, 0.83, 0.91 for targets of 0.99,
        0.999, 0.9999. Solved from the trials of each training, it would depend on the one or two wrong tracklets among them.
        """
        one, other = (
            Calibration.fit(trials.margin[trials.near_unlabelled == side], trials.right[trials.near_unlabelled == side]) for side in (0, 1)
        )
        max_slope = MAX_SLOPE_OF_ONE + (MAX_SLOPE - MAX_SLOPE_OF_ONE) * min(people - 1, 4) / 4
        return cls((one, other), 1.0 - (1.0 - target) ** 0.26, max_slope)


def overlaps_unlabelled(label: Ints, first: Ints, last: Ints) -> Ints:
    """1 for tracklets that overlap in time with a tracklet without a label, else 0: (J,). O(J + T)."""
    unlabelled = label == NULL
    steps = np.zeros(int(last.max(initial=-1)) + 2, dtype=np.int64)
    np.add.at(steps, first[unlabelled], 1)
    np.add.at(steps, last[unlabelled] + 1, -1)
    before = np.concatenate([[0], np.cumsum(np.cumsum(steps) > 0)])
    return (before[last + 1] > before[first]).astype(np.int64)
