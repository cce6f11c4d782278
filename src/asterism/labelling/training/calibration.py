"""From margins to confidence: what share of labels with such a margin was right, on people whom the model had not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import isotonic_regression

from asterism.recording import Floats

LARGEST = 60.0
"""Margins beyond this (nats) count as this. Not tuned."""


@dataclass(frozen=True)
class Calibration:
    """A non-decreasing curve from margin (nats) to the probability that the label is right.

    margin, right  (B,) knots, between which the curve is straight; flat beyond the ends
    """

    margin: Floats
    right: Floats

    def confidence(self, margin: ArrayLike) -> Floats:
        """The probability that labels with these margins are right, in [0, 1]."""
        return np.interp(np.asarray(margin, dtype=np.float64), self.margin, self.right)

    @classmethod
    def fit(cls, margin: ArrayLike, right: ArrayLike, bins: int = 60) -> Calibration:
        """Isotonic regression of right (0 or 1) on margin, (n,) each, held in `bins` knots.

        Each bin counts one label more than it saw, as often right as the labels are on the whole, so that few labels prove little.
        """
        given, hit = np.clip(np.asarray(margin, dtype=np.float64), -LARGEST, LARGEST), np.asarray(right, dtype=np.float64)
        if len(given) == 0:
            return cls(np.array([0.0]), np.array([0.5]))
        order = np.argsort(given, kind="stable")
        given, hit = given[order], hit[order]
        # bins of equal numbers of wrong labels resolve the low margins, where wrong labels are, better than bins of equal numbers of labels
        weight = np.cumsum(np.where(hit > 0, 1.0 / len(hit), 1.0 / max(1.0, float((hit == 0).sum()))))
        bin_of = np.minimum((weight / weight[-1] * bins).astype(int), bins - 1)
        _, bin_of = np.unique(bin_of, return_inverse=True)
        count = np.bincount(bin_of)
        share = (np.bincount(bin_of, weights=hit) + 1.0 * hit.mean()) / (count + 1.0)
        curve = isotonic_regression(share, weights=count).x
        return cls(np.bincount(bin_of, weights=given) / count, np.minimum(curve, 1.0 - 0.5 / (len(hit) + 1.0)))
