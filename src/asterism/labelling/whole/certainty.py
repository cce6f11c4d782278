"""How sure a tracklet's label is: margins of labels whose rightness is known in; confidence, and what is too doubtful to give, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.labelling.training.calibration import Calibration
from asterism.recording import NULL, Floats, Ints

LEAST_TRUST = 0.1
"""Share of what a margin itself says that trials can never take away."""

STEEP, STEEP_OF_ONE = 5.0, 3.5
"""Log odds per nat of margin that a label is right, at most: one without any margin is a coin toss, whatever the trials say. A model of one
person was tried on that person only, so its trials are believed less; from five people on they count in full."""


@dataclass(frozen=True)
class TrialLabels:
    """Labels given in trials whose truth is known: margin (n,) nats, right (n,) 0 or 1, beside (n,) whether a ghost may have been near."""

    margin: Floats
    right: Floats
    beside: Ints

    @classmethod
    def together(cls, parts: Sequence[TrialLabels]) -> TrialLabels:
        """All trials as one."""
        if not parts:
            return cls(np.empty(0), np.empty(0), np.empty(0, dtype=np.int64))
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("margin", "right", "beside")))


@dataclass(frozen=True)
class Certainty:
    """From tracklets' margins to the confidence of their labels.

    calibrations      of tracklets beside which no point is left over, and of those beside which some are: where ghosts are, less is sure
    least_confidence  below which a label is taken back
    steep             log odds per nat of margin at most
    """

    calibrations: tuple[Calibration, Calibration]
    least_confidence: float
    steep: float = STEEP

    def confidence(self, margin: Floats, beside: Ints) -> Floats:
        """The probability that labels are right: (J,).

        Small margins were seldom tried, so `steep` bounds what the trials say there; and it is never less than a tenth of that bound, for
        where a few people tried were all labelled wrong (one person stood, the other walked) that does not prove the next one wrong.
        """
        alone, crowded = (calibration.confidence(margin) for calibration in self.calibrations)
        bound = 1.0 / (1.0 + np.exp(-self.steep * np.clip(margin, -100.0, 100.0)))
        return np.clip(np.where(beside > 0, crowded, alone), LEAST_TRUST * bound, bound)

    @classmethod
    def fit(cls, tried: TrialLabels, target: float, people: int) -> Certainty:
        """Calibrate on trials of a model of so many people.

        `target` is the share of the labels given that shall be right, where ghosts are near.

        How sure a label must be for that: a power law through what was measured on people left out (docs/recordings.md): 0.70, 0.83, 0.91
        for 0.99, 0.999, 0.9999. Solved from the trials of each training it would hang on the one or two wrong tracklets that it saw.
        """
        one, other = (Calibration.fit(tried.margin[tried.beside == side], tried.right[tried.beside == side]) for side in (0, 1))
        steep = STEEP_OF_ONE + (STEEP - STEEP_OF_ONE) * min(people - 1, 4) / 4
        return cls((one, other), 1.0 - (1.0 - target) ** 0.26, steep)


def beside_spare(label: Ints, first: Ints, last: Ints) -> Ints:
    """1 for tracklets during which a tracklet without a label is there, else 0: (J,). O(J + T)."""
    spare = label == NULL
    steps = np.zeros(int(last.max(initial=-1)) + 2, dtype=np.int64)
    np.add.at(steps, first[spare], 1)
    np.add.at(steps, last[spare] + 1, -1)
    before = np.concatenate([[0], np.cumsum(np.cumsum(steps) > 0)])
    return (before[last + 1] > before[first]).astype(np.int64)
