"""From margins to confidence: what share of labels with such a margin was right, on people whom the model had not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import isotonic_regression, minimize
from scipy.special import expit

from asterism.recording import Floats, Ints

MARGIN_KNOTS = (-30.0, 2.0, 5.0, 10.0, 20.0, 40.0)
"""Nats between which the log odds rise straight with the margin: steeply where labels are doubtful, hardly where they are certain."""

FIT_KNOTS = (-8.0, -2.0, 0.0, 2.0)
"""Nats between which the log odds rise straight with the fit; 0 is what rightly labelled frames usually score. Of five sets of knots these
gave the best log score on the models for choosing."""

LARGEST = 60.0
"""Margins beyond this (nats) count as this. Not tuned."""

AT_ONCE = 1 << 16
"""Labels whose pieces are held in memory at once."""


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
        # Beyond the largest margin nothing more is learned, and a single label would set the end of the curve.
        given, hit = np.clip(np.asarray(margin, dtype=np.float64), -LARGEST, LARGEST), np.asarray(right, dtype=np.float64)
        # Without trials a label is as likely wrong as right.
        if len(given) == 0:
            return cls(np.array([0.0]), np.array([0.5]))
        order = np.argsort(given, kind="stable")
        given, hit = given[order], hit[order]
        # bins of equal numbers of wrong labels resolve the low margins, where wrong labels are, better than bins of equal numbers of labels
        weight = np.cumsum(np.where(hit > 0, 1.0 / len(hit), 1.0 / max(1.0, float((hit == 0).sum()))))
        bin_of = np.minimum((weight / weight[-1] * bins).astype(int), bins - 1)
        _, bin_of = np.unique(bin_of, return_inverse=True)
        count = np.bincount(bin_of)
        # The share of a bin is pulled towards the mean by one label.
        share = (np.bincount(bin_of, weights=hit) + 1.0 * hit.mean()) / (count + 1.0)
        curve = isotonic_regression(share, weights=count).x
        # Never certain: the trials cannot show a rarer error than one in their number.
        return cls(np.bincount(bin_of, weights=given) / count, np.minimum(curve, 1.0 - 0.5 / (len(hit) + 1.0)))


MAX_SLOPE = 5.0
"""Log odds per nat of margin that a label is right, at most: without a margin a label is a coin toss, whatever the trials showed."""

PIECES = len(MARGIN_KNOTS) + len(FIT_KNOTS) - 2

CELL = 0.25
"""Nats: trials whose margin and fit are this near count as equal, which keeps the regression small. Not tuned."""


@dataclass(frozen=True)
class LabelTrials:
    """n labels with known truth.

    margin     (n,) nats
    fit        (n,) nats, how well the label's point lies where the others predict it, less what rightly labelled frames usually score
    left_over  (n,) 1 where points without a label were there at the same time, else 0
    right      (n,) 0 or 1
    weight     (n,) how much each label counts
    """

    margin: Floats
    fit: Floats
    left_over: Ints
    right: Floats
    weight: Floats

    @classmethod
    def together(cls, parts: Sequence[LabelTrials]) -> LabelTrials:
        """All trials as one."""
        if not parts:
            return cls(np.empty(0), np.empty(0), np.empty(0, dtype=np.int64), np.empty(0), np.empty(0))
        names = ("margin", "fit", "left_over", "right", "weight")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def in_cells(self, left_over: int) -> tuple[Floats, Floats, Floats, Floats]:
        """Margin, fit and right of the labels that differ, without or with points left over, and the weight of each kind: (m,) each."""
        # Labels are counted by kind, which makes the regression as fast for a million trials as for a thousand.
        own = self.left_over == left_over
        margin = np.round(np.clip(self.margin[own], MARGIN_KNOTS[0], MARGIN_KNOTS[-1]) / CELL)
        fit = np.round(np.clip(self.fit[own], FIT_KNOTS[0], FIT_KNOTS[-1]) / CELL)
        cells, kind = np.unique(np.stack([margin, fit, self.right[own]], axis=1), axis=0, return_inverse=True)
        weight = np.bincount(kind.ravel(), weights=self.weight[own], minlength=len(cells)).astype(np.float64)
        return cells[:, 0] * CELL, cells[:, 1] * CELL, cells[:, 2].astype(np.float64), weight


USUAL_WEIGHTS = (7.0, 0.3, 3.0, 2.0, 0.5, 0.1, 0.7, 0.7, 0.7)
"""Weights of `LabelCalibration` that single frames of ten people have, roughly."""

Weights = tuple[tuple[float, ...], tuple[float, ...]]


@dataclass(frozen=True)
class LabelPrior:
    """What is known of confidence before any trial: weights, see `LabelCalibration`, without and with points left over.

    of_one      of models of one person, on other people
    of_several  of models of several people, on other people
    people      people of the training for whom the trials count as much as this does
    """

    of_one: Weights
    of_several: Weights
    people: float = 2.0

    def alone(self) -> LabelCalibration:
        """The calibration of a model that was tried on nobody."""
        known = np.array(self.of_several)
        return LabelCalibration(known, known, 0.0)


IN_FRAMES = LabelPrior(
    ((7.01, 3.99, 0.32, 0.44, 0.00, 0.05, 0.65, 2.68, 6.57), (7.18, 3.53, 0.82, 2.17, 0.04, 0.00, 0.00, 3.14, 4.29)),
    ((7.50, 5.61, 2.51, 0.58, 0.74, 0.00, 1.20, 1.30, 3.41), (7.72, 1.91, 1.88, 2.37, 0.69, 0.03, 0.00, 0.00, 4.40)),
)
"""For single frames. Fitted to what models of one to ten gait subjects, and of three movement sets, gave others of those for choosing
(docs/confidence.md); frames with ghosts or clutter count a fifth."""

IN_TIME = LabelPrior(
    ((9.36, 0.14, 2.75, 1.03, 0.26, 0.00, 4.95, 0.60, 2.32), (8.34, 0.67, 0.03, 0.00, 1.19, 0.00, 1.62, 0.00, 2.91)),
    ((9.32, 0.04, 4.68, 1.36, 0.83, 0.00, 0.60, 0.79, 0.65), (8.63, 0.41, 0.60, 0.85, 1.15, 0.28, 0.00, 0.42, 3.54)),
)
"""For whole recordings. Fitted likewise; all count alike."""


_OF_VIRTUAL_IN_FRAMES = (
    (6.49, 0.30, 2.37, 0.37, 0.00, 0.49, 0.95, 0.43, 5.07),
    (6.95, 1.69, 1.27, 1.12, 0.89, 0.35, 0.00, 0.00, 3.87),
)
_OF_VIRTUAL_IN_TIME = (
    (6.64, 0.00, 3.27, 0.14, 0.96, 0.30, 0.72, 1.00, 0.02),
    (8.70, 0.08, 1.57, 0.73, 0.16, 1.11, 0.66, 2.12, 2.16),
)

BESIDE_VIRTUAL_IN_FRAMES = LabelPrior(_OF_VIRTUAL_IN_FRAMES, _OF_VIRTUAL_IN_FRAMES)
"""For single frames labelled by models that virtual people taught, alone or beside real ones.

Fitted to what models of virtual people alone gave the real people of ten sets of `movement`, each set counting alike. Of a set left out,
95.7 % of the labels at 0.90 to 0.95 were right, 96.6 % of those at 0.95 and above, and hardly any was above 0.99.
"""

BESIDE_VIRTUAL_IN_TIME = LabelPrior(_OF_VIRTUAL_IN_TIME, _OF_VIRTUAL_IN_TIME)
"""For whole recordings. Fitted likewise. Of a set left out, 92.4 % of the labels at 0.90 to 0.95 were right, 96.5 % at 0.95 to 0.99, and
99.84 % above; by `IN_TIME`, which was fitted to easier sets, 72, 83 and 98.9 %."""

VIRTUAL_IN_STREAMS = (
    (7.66, 2.70, 0.94, 1.71, 0.78, 0.31, 0.70, 0.70, 0.37),
    (7.71, 1.26, 1.39, 1.30, 0.45, 0.78, 0.70, 0.70, 0.35),
)
"""Weights, see `LabelCalibration`, for streams labelled by models of virtual people alone, whose margins add up what a track's frames say.

Fitted to what they gave the real people of 14 sets of `movement`, each set counting alike: nothing hidden, 3 hidden, with 3 ghosts, with
flickering points. Of a set left out 90.4 % of the labels at 0.85 to 0.90 were right, 94.6 % at 0.90 to 0.95 and 97.6 % at 0.95 to 0.99. By
the weights of single frames, whose margins are often large where a whole limb is wrong, 98.7 to 99.5 % were right there, and every fifth
right label was not given.
"""

MOST_IN_STREAMS = 0.98
"""What no label of such a stream is more certain than: of those that the weights call 0.99 or more, one in 300 was wrong, markers exchanged
for a whole recording of one person, and what is called sure is hardly ever wrong."""


@dataclass(frozen=True)
class LabelCalibration:
    """The probability that a label is right, from its margin and its fit, and whether points were left over.

    The margin says how much better the label is than the nearest other one, the fit how well its point lies where all other labels predict
    the marker: a ghost beside a hidden marker has no rival, but fits poorly. The log odds are a sum of straight pieces that never fall.
    Trials on people left out are few, and smaller models were tried than the final one. So the confidence is a mean of what the trials say
    and of what models of as many people gave elsewhere. No trial can make a label without a margin more than a coin toss.

    own    (2, 9) weights from the trials, without and with points left over: log odds of a label of the largest margin and fit; then for
           each piece what 4 nats of it add
    prior  (2, 9) those from elsewhere
    share  of `own` in the mean
    """

    own: Floats
    prior: Floats
    share: float

    def confidence(self, margin: ArrayLike, fit: ArrayLike, left_over: ArrayLike) -> Floats:
        """The probability that labels are right, in [0, 1]: margin and fit in nats, fit less the usual score, left_over 0 or 1."""
        given = np.broadcast_arrays(np.asarray(margin, dtype=np.float64), fit, np.asarray(left_over, dtype=np.int64))
        margins, fits, sides = (values.ravel() for values in given)
        found = np.empty(len(margins))
        # In blocks: the pieces of all labels at once would take nine times their memory.
        for start in range(0, len(margins), AT_ONCE):
            block = slice(start, start + AT_ONCE)
            found[block] = self._confidence(margins[block], fits[block], sides[block])
        return found.reshape(given[0].shape)

    def _confidence(self, margin: Floats, fit: Floats, side: Ints) -> Floats:
        pieces = _pieces(margin, fit)
        one, other = (expit(weights[side, 0] + (pieces * weights[side, 1:]).sum(axis=-1)) for weights in (self.own, self.prior))
        coin_toss = expit(MAX_SLOPE * np.clip(margin, -100.0, 100.0))
        return np.asarray(np.minimum(self.share * one + (1.0 - self.share) * other, coin_toss))

    @classmethod
    def fitted(cls, trials: LabelTrials, people: int, prior: LabelPrior) -> LabelCalibration:
        """The weights that explain trials of a model of so many people best, beside those of the prior."""
        known = np.array(prior.of_one if people < 2 else prior.of_several)
        # With and without points left over are different worlds: a ghost can take a label only where it is.
        own = np.stack([_regression(*trials.in_cells(side)) for side in (0, 1)])
        return cls(own, known, people / (people + prior.people))


def stream_curves_of_virtual() -> tuple[Calibration, Calibration]:
    """The confidence by their margin of labels that streams give by models of virtual people alone, without and with points left over."""
    known, margin = np.array(VIRTUAL_IN_STREAMS), np.arange(MARGIN_KNOTS[0], MARGIN_KNOTS[-1] + 0.5, 0.5)
    calibration = LabelCalibration(known, known, 0.0)
    without, some = (Calibration(margin, np.minimum(calibration.confidence(margin, 0.0, side), MOST_IN_STREAMS)) for side in (0, 1))
    return without, some


def _regression(margin: Floats, fit: Floats, right: Floats, weight: Floats) -> Floats:
    """The weights (9,) of a logistic regression on labels of m kinds, `weight` of each, whose pieces have no negative weight.

    A precision of 1 of each weight around `USUAL_WEIGHTS` stands for what few trials leave open.
    """
    columns, usual = np.column_stack([np.ones(len(margin)), _pieces(margin, fit)]), np.array(USUAL_WEIGHTS)
    sign = np.where(right > 0, 1.0, -1.0)

    def loss(weights: Floats) -> tuple[float, Floats]:
        signed, away = sign * (columns @ weights), weights - usual
        value = (weight * np.logaddexp(0.0, -signed)).sum() + 0.5 * (away**2).sum()
        return float(value), away - columns.T @ (weight * sign * expit(-signed))

    # Slopes must not fall: more margin or fit never makes a label less likely right.
    bounds = [(None, None)] + [(0.0, None)] * (columns.shape[1] - 1)
    return np.asarray(minimize(loss, usual, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 300, "ftol": 1e-10}).x)


def _pieces(margin: ArrayLike, fit: ArrayLike) -> Floats:
    """How far margins and fits stay below the upper end of each piece of their range: (..., 8), 0 or less, in units of 4 nats."""
    parts = []
    for values, knots in ((margin, MARGIN_KNOTS), (fit, FIT_KNOTS)):
        given = np.asarray(values, dtype=np.float64)
        parts += [(np.clip(given, low, high) - high) / 4.0 for low, high in pairwise(knots)]
    return np.stack(parts, axis=-1)
