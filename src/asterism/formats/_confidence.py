"""The confidence of labels, beside the positions that a file holds: one value for each label and frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.recording import Floats, Labelling


@dataclass(frozen=True)
class LabelConfidence:
    """How certain the labels of a recording are.

    names   (M,) labels
    values  (T, M) in [0, 1]: the probability that the label is right; 0 where the frame has no such label, or nothing is known about it
    """

    names: tuple[str, ...]
    values: Floats

    @classmethod
    def of_labelling(cls, labelling: Labelling) -> LabelConfidence:
        """The confidence of the labels that a labelling gives."""
        # NaN stands for a label of which nothing is known, and a file has no place for that.
        known = np.nan_to_num(np.clip(labelling.confidence, 0.0, 1.0))
        return cls(labelling.names, np.where(labelling.indices >= 0, known, 0.0))
