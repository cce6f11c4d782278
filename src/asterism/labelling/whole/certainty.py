"""How certain a label in a whole recording is: its margin and its fit in; confidence, and the least one to accept, out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.labelling.training.calibration import MAX_SLOPE, Calibration, LabelCalibration
from asterism.recording import NULL, Floats, Ints

MIN_TRUST = 0.1
"""Confidence of a model of an earlier Asterism is never less than this share of what the margin alone says."""


@dataclass(frozen=True)
class Certainty:
    """From the margins and fits of labels in whole recordings to their confidence.

    calibration       the curve; in a model of an earlier Asterism two curves of the margin alone, for tracklets without and with an
                      unlabelled point at the same time
    least_confidence  labels below this confidence are taken back
    max_slope         log odds per nat of margin at most, with the two curves
    """

    calibration: LabelCalibration | tuple[Calibration, Calibration]
    least_confidence: float
    max_slope: float = MAX_SLOPE

    def confidence(self, margin: Floats, left_over: Ints, fit: Floats) -> Floats:
        """The probability that labels are right: (J,); margin, fit in nats, left_over 0 or 1."""
        if isinstance(self.calibration, LabelCalibration):
            return self.calibration.confidence(margin, fit, left_over)
        alone, crowded = (calibration.confidence(margin) for calibration in self.calibration)
        bound = 1.0 / (1.0 + np.exp(-self.max_slope * np.clip(margin, -100.0, 100.0)))
        return np.clip(np.where(left_over > 0, crowded, alone), MIN_TRUST * bound, bound)


def least_confidence_in_time(target: float) -> float:
    """The confidence below which a label of a whole recording is taken back, so that about the target share of those given is right.

    A power law, fitted to people left out (docs/recordings.md): 0.70, 0.83, 0.91 for targets of 0.99, 0.999, 0.9999. Solved from the trials
    of each training, it would depend on the one or two wrong tracklets among them.
    """
    return 1.0 - (1.0 - target) ** 0.26


def overlaps_unlabelled(label: Ints, first: Ints, last: Ints) -> Ints:
    """1 for tracklets that overlap in time with a tracklet without a label, else 0: (J,). O(J + T)."""
    unlabelled = label == NULL
    steps = np.zeros(int(last.max(initial=-1)) + 2, dtype=np.int64)
    np.add.at(steps, first[unlabelled], 1)
    np.add.at(steps, last[unlabelled] + 1, -1)
    before = np.concatenate([[0], np.cumsum(np.cumsum(steps) > 0)])
    return (before[last + 1] > before[first]).astype(np.int64)
