"""Confidence and whether labels were right in; how far the confidence can be trusted out: reliability, log score, Brier score."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.special import betaincinv

from asterism.recording import Floats

LEVELS = (0.0, 0.9, 0.95, 0.99, 0.999, 1.0)
"""Confidence between two of these is judged together."""

LEAST_ERROR = 1e-6
"""Confidence counts as at least this and at most 1 minus this: else one wrong label at confidence 1 would make the log score infinite."""

RESAMPLES = 2000
"""Resamples of the bootstrap. Not tuned."""

_NINES = 10.0 ** -np.linspace(0.0, 6.0, 601)
_EDGES = np.unique(np.round(np.concatenate([LEVELS[:-1], 1.0 - _NINES]), 9))
"""Fine bins of confidence, which begin at these: a hundredth of a nine wide."""


@dataclass(frozen=True)
class Reliability:
    """Labels given with a confidence from `least` to below `below`: what was stated, and what came of it.

    labels      how many
    confidence  their mean confidence
    right       share of them that was right
    low, high   95 % interval of that share
    """

    least: float
    below: float
    labels: int
    confidence: float
    right: float
    low: float
    high: float

    @property
    def holds(self) -> bool:
        """Whether the mean confidence lies in the interval."""
        return self.low <= self.confidence <= self.high

    @property
    def too_high(self) -> bool:
        """Whether the mean confidence is above the interval: more labels are wrong than it says."""
        return self.confidence > self.high


@dataclass(frozen=True)
class ConfidenceScore:
    """How good the confidence of given labels is. All numbers are NaN where there is no label.

    labels              labels given
    log_score           mean of -ln of the probability that the confidence gave to what came, in nats; less is better
    constant_log_score  the same for the constant confidence that fits these labels best, which is the share that was right
    brier               mean square of confidence minus 1 (right) or 0 (wrong); less is better
    constant_brier      the same for the best constant
    share_at_999        the largest share of the labels, the most confident ones, of which 99.9 % are right
    levels              reliability by level of confidence; levels without labels are left out
    """

    labels: int
    log_score: float
    constant_log_score: float
    brier: float
    constant_brier: float
    share_at_999: float
    levels: list[Reliability]

    @property
    def beats_constant(self) -> bool:
        """Whether the confidence scores better than any constant could, by the log score."""
        return self.log_score < self.constant_log_score

    def at(self, level: float) -> Reliability | None:
        """The level that a confidence belongs to; None where it has no labels."""
        return next((each for each in self.levels if each.least <= level < each.below), None)


@dataclass
class _LabelGroup:
    """Counts of one group of labels: (bins, 3) how many, sum of confidence, right; (levels,) runs; sums of both scores."""

    bins: Floats = field(default_factory=lambda: np.zeros((len(_EDGES), 3)))
    runs: Floats = field(default_factory=lambda: np.zeros(len(LEVELS) - 1))
    log_score: float = 0.0
    brier: float = 0.0

    def __iadd__(self, other: _LabelGroup) -> _LabelGroup:
        for name in ("bins", "runs", "log_score", "brier"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        return self


@dataclass
class ConfidenceTally:
    """Counts of given labels by their confidence, which add up over recordings.

    The labels of one person are alike: a person whom the model does not know well has many wrong labels. So labels are counted by group,
    usually a person, and intervals come from a bootstrap over the groups. Labels of one marker in frames that follow each other are one
    *run* as long as they stay in one level of confidence and remain right or wrong. Where no label is wrong the bootstrap says nothing, so
    no interval is narrower than that of as many independent labels as there are runs. Labels whose confidence is NaN are not counted.

    >>> tally = ConfidenceTally()
    >>> confidence, right = np.array([[0.995, 0.93], [0.999, 0.92]]), np.array([[True, True], [True, False]])
    >>> tally.add(confidence, given=np.ones((2, 2), bool), right=right)
    >>> [(level.least, level.labels, float(level.right)) for level in tally.score().levels if level.labels]
    [(0.9, 2, 0.5), (0.99, 1, 1.0), (0.999, 1, 1.0)]
    """

    groups: dict[str, _LabelGroup] = field(default_factory=dict)

    def add(self, confidence: Floats, given: Any, right: Any, group: str = "") -> None:
        """Count labels: confidence (T, M), whether a label was given (T, M) and whether it is right (T, M), frames in their order."""
        own = self.groups.setdefault(group, _LabelGroup())
        given = given & ~np.isnan(confidence)
        stated = np.clip(confidence, 0.0, 1.0)
        level = np.where(given, np.searchsorted(LEVELS[1:-1], stated, side="right"), -1)
        kind = np.where(given, 2 * level + np.where(right, 1, 0), -1)
        begins = (kind >= 0) & (kind != np.concatenate([np.full((1, kind.shape[1]), -1), kind[:-1]]))
        own.runs += np.bincount(level[begins], minlength=len(own.runs))
        said, hit = stated[given], np.asarray(right)[given].astype(np.float64)
        which = np.searchsorted(_EDGES, said, side="right") - 1
        for column, weights in enumerate((np.ones(len(said)), said, hit)):
            own.bins[:, column] += np.bincount(which, weights=weights, minlength=len(_EDGES))
        bounded = np.clip(said, LEAST_ERROR, 1.0 - LEAST_ERROR)
        own.log_score -= float(np.log(np.where(hit > 0, bounded, 1.0 - bounded)).sum())
        own.brier += float(((said - hit) ** 2).sum())

    def __iadd__(self, other: ConfidenceTally) -> ConfidenceTally:
        for name, group in other.groups.items():
            self.groups.setdefault(name, _LabelGroup()).__iadd__(group)
        return self

    def score(self, seed: int = 0) -> ConfidenceScore:
        """The scores of all labels counted; `seed` draws the resamples of the bootstrap."""
        groups = list(self.groups.values())
        bins = np.sum([group.bins for group in groups], axis=0) if groups else _LabelGroup().bins
        labels, _, right = bins.sum(axis=0)
        if not labels:
            nan = float("nan")
            return ConfidenceScore(0, nan, nan, nan, nan, nan, [])
        share = right / labels
        return ConfidenceScore(
            int(labels),
            sum(group.log_score for group in groups) / labels,
            _entropy(share),
            sum(group.brier for group in groups) / labels,
            share * (1.0 - share),
            _share_of_most_confident(bins, 0.999),
            list(_levels(groups, np.random.default_rng(seed))),
        )


def _levels(groups: list[_LabelGroup], rng: np.random.Generator) -> Iterable[Reliability]:
    """The reliability of each level of confidence that has labels."""
    level_of = np.searchsorted(LEVELS[1:-1], _EDGES, side="right")
    weights = rng.multinomial(len(groups), np.full(len(groups), 1.0 / len(groups)), size=RESAMPLES).astype(np.float64)
    for level, (least, below) in enumerate(pairwise(LEVELS)):
        counts = np.array([group.bins[level_of == level].sum(axis=0) for group in groups])
        labels, stated, right = counts.sum(axis=0)
        if labels:
            runs = float(sum(group.runs[level] for group in groups))
            low, high = _interval(counts[:, [0, 2]], runs, weights)
            yield Reliability(least, below, int(labels), stated / labels, right / labels, low, high)


def _interval(counts: Floats, runs: float, weights: Floats) -> tuple[float, float]:
    """The 95 % interval of a share; counts (G, 2): labels and right ones by group; weights (B, G): how often a resample takes a group."""
    labels, right = counts.sum(axis=0)
    share = right / labels
    ends = (0.025, 0.975)
    low, high = (float(betaincinv(share * runs + 0.5, (1.0 - share) * runs + 0.5, end)) for end in ends)
    low, high = 0.0 if right == 0 else low, 1.0 if right == labels else high
    drawn = weights @ counts
    drawn = drawn[drawn[:, 0] > 0]
    shares = np.quantile(drawn[:, 1] / drawn[:, 0], ends)
    return min(low, float(shares[0])), max(high, float(shares[1]))


def _share_of_most_confident(bins: Floats, target: float) -> float:
    """The largest share of the labels, taken from the most confident ones on, of which the target share is right."""
    labels, right = np.cumsum(bins[::-1, 0]), np.cumsum(bins[::-1, 2])
    enough = labels[right >= target * labels]
    return float(enough.max(initial=0.0) / labels[-1])


def _entropy(share: float) -> float:
    """The log score of the best constant confidence: nats per label."""
    return sum(-part * float(np.log(part)) for part in (share, 1.0 - share) if 0.0 < part < 1.0)
