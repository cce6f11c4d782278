"""Anchors: partial solvers of three markers from which the whole body is predicted.

A whole-body labelling needs a first guess of where the body is. Each anchor is a partial solver (section 4.5.2) over three markers with
wide intervals on their distances, height differences and signed triangle: it should never miss the right triple, and may propose wrong
ones, which the whole body then rejects. The anchors are ordered so that the markers of a few of the first are visible whatever is hidden.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from asterism.labelling.body._workspace_kernels import LOG_2PI, AnchorArrays
from asterism.labelling.body.model import BodyModel
from asterism.labelling.features.feature_kernels import G2, G4, G19, feature_ranges
from asterism.labelling.features.search_kernels import SolverArrays, count_search
from asterism.recording import Floats, Ints

CHECKS = ((G4, (0, 1), 1), (G2, (0, 1), 1), (G4, (0, 2), 2), (G2, (0, 2), 2), (G2, (1, 2), 2), (G19, (0, 1, 2), 2))
"""An anchor's classifiers: feature, its points among the three, and the depth of the search at which it can be computed."""


@dataclass(frozen=True)
class AnchorRules:
    """How anchors are chosen.

    count      anchors kept
    candidates about how many triples are compared
    widen      standard deviations, over the people of the training, by which each end of an interval is moved outwards
    one_person share of the end's value by which it is moved beyond that for one person; falls with the square of the number of people
    max_hidden share of the markers that may be hidden in the occlusion patterns that the anchors must cover
    repeat     weight of a pattern for each earlier anchor that covers it already

    All were chosen on the gait subjects, each left out in turn (docs/labelling.md).
    """

    count: int = 40
    candidates: int = 1500
    widen: float = 0.3
    one_person: float = 0.3
    max_hidden: float = 0.4
    repeat: float = 0.25


@dataclass(frozen=True)
class Anchors:
    """triples (A, 3) markers; low, high (A, 6) interval of each of `CHECKS`."""

    triples: Ints
    low: Floats
    high: Floats

    def solvers(self) -> SolverArrays:
        """The anchors as solvers for the tree search."""
        count, checks = len(self.triples), len(CHECKS)
        per_depth = [sum(depth == d for _, _, depth in CHECKS) for d in range(3)]
        starts = np.concatenate([[0], np.cumsum(np.tile(per_depth, count))])
        slots = np.array([(*points, 0, 0, 0)[:4] for _, points, _ in CHECKS])
        return SolverArrays(
            first_depth=3 * np.arange(count + 1),
            markers=self.triples.reshape(-1),
            first_feature=starts,
            kinds=np.tile([kind for kind, _, _ in CHECKS], count),
            slots=np.tile(slots, (count, 1)),
            low=self.low.reshape(count * checks),
            high=self.high.reshape(count * checks),
        )

    def arrays(self, body: BodyModel) -> AnchorArrays:
        """What follows for the whole body from each anchor, as the kernels read it."""
        poses, markers = body.mean.shape[:2]
        count = len(self.triples)
        rows = (3 * self.triples[:, None, :] + np.arange(3)[:, None]).reshape(count, 9)
        parts = []
        for k in range(poses):
            full = body.covariance(k)
            own = body.mean[k, self.triples].transpose(0, 2, 1)
            centred = (own - own.mean(axis=2, keepdims=True)).reshape(count, 9)
            of_anchor = full[rows[:, :, None], rows[:, None, :]]
            precision = np.linalg.inv(of_anchor)
            cross = full[:, rows].transpose(1, 0, 2).reshape(count, markers, 3, 9)
            gain = cross @ precision[:, None]
            blocks = np.stack([full[3 * m : 3 * m + 3, 3 * m : 3 * m + 3] for m in range(markers)])
            spread = blocks - gain @ cross.transpose(0, 1, 3, 2)
            spread[np.arange(count)[:, None], self.triples] = 1e-4 * np.eye(3)
            lower = np.linalg.cholesky(spread)
            log_peak = body.log_weight[k] - 0.5 * np.linalg.slogdet(of_anchor)[1] - 4.5 * LOG_2PI
            log_scale = -np.log(np.diagonal(lower, axis1=2, axis2=3)).sum(axis=2)
            widest = np.trace(spread, axis1=2, axis2=3)
            factor = np.linalg.cholesky(precision).transpose(0, 2, 1)
            by_displacement = gain.transpose(0, 3, 2, 1).reshape(count, 9, -1)
            parts.append((centred, factor, log_peak, by_displacement, np.linalg.inv(lower), log_scale, widest))
        return AnchorArrays(np.ascontiguousarray(self.triples), *(np.stack(part) for part in zip(*parts, strict=True)))


def choose_anchors(frames: Floats, people: Ints, body: BodyModel, rules: AnchorRules, rng: np.random.Generator) -> Anchors:
    """Pick anchors from labelled frames: (N, M, 3) m, z up, NaN where missing; people (N,).

    The value of a triple is the number of occlusion patterns in which its markers are visible, those weighted less that earlier anchors
    cover already, per unit of time that it costs.
    """
    markers = frames.shape[1]
    triples = np.array(list(combinations(range(markers), 3)), dtype=np.int64)
    if len(triples) <= rules.candidates:
        # few enough to compare all from which the whole body can be predicted well
        ends = np.zeros((len(triples), len(CHECKS)))
        certainty = Anchors(triples, ends, ends).arrays(body).log_scale.mean(axis=(0, 2))
        triples = triples[np.argsort(-certainty, kind="stable")[: max(60, len(triples) // 2)]]
    else:
        triples = _some_triples(frames, rules, rng)
    anchors = with_intervals(triples, frames, people, rules)
    cost = _cost(anchors, frames, rng)
    patterns = 3000
    seen = np.ones((patterns, markers), dtype=bool)
    for p in range(patterns):
        seen[p, rng.choice(markers, int(rng.uniform(0, rules.max_hidden) * markers), replace=False)] = False
    covered: Floats = np.all(seen[:, triples], axis=2).T.astype(np.float64)
    often_shown = (~np.isnan(frames[:, :, 0])).mean(axis=0)[triples].prod(axis=1)
    worth = often_shown / cost
    times = np.zeros(patterns)
    chosen: list[int] = []
    free: NDArray[np.bool_] = np.ones(len(triples), dtype=np.bool_)
    while len(chosen) < rules.count and free.any():
        gain = np.where(free, (covered @ rules.repeat**times) * worth, -1.0)
        best = int(np.argmax(gain))
        free[best] = False
        chosen.append(best)
        times += covered[best] * often_shown[best]
    return Anchors(triples[chosen], anchors.low[chosen], anchors.high[chosen])


def _some_triples(frames: Floats, rules: AnchorRules, rng: np.random.Generator) -> Ints:
    """Triples of a large marker set that are worth trying: neighbours that keep their distances, and some at random."""
    markers = frames.shape[1]
    sample = frames[rng.choice(len(frames), min(200, len(frames)), replace=False)]
    picked = {tuple(sorted(rng.choice(markers, 3, replace=False).tolist())) for _ in range(rules.candidates // 3)}
    with np.errstate(invalid="ignore"):
        for m in range(markers):
            distance = np.linalg.norm(sample - sample[:, m : m + 1], axis=2)
            spread = np.where(
                np.isfinite(distance).sum(axis=0) > 5, np.nanstd(np.where(np.isfinite(distance), distance, np.nan), axis=0), np.inf
            )
            spread[m] = np.inf
            near = np.argsort(spread, kind="stable")[:7].tolist()
            picked |= {tuple(sorted((m, *pair))) for pair in combinations(near, 2)}
    return np.array(sorted(picked), dtype=np.int64)


def with_intervals(triples: Ints, frames: Floats, people: Ints, rules: AnchorRules) -> Anchors:
    """Intervals of every check: the people's range, each end widened by how much the people differ there, and how few they are."""
    kinds = np.tile([kind for kind, _, _ in CHECKS], len(triples))
    slots = np.stack([triples[:, (*points, 0, 0, 0)[:4]] for _, points, _ in CHECKS], axis=1).reshape(-1, 4)
    count = people.max() + 1
    low, high = np.empty((len(kinds), count)), np.empty((len(kinds), count))
    feature_ranges(frames, people, count, kinds, slots, low, high)
    # a triple that is never seen together keeps an empty interval, which rejects everything
    all_low, all_high = np.full(len(kinds), np.inf), np.full(len(kinds), -np.inf)
    seen = np.isfinite(low).any(axis=1)
    shown = np.isfinite(low[seen])
    low, high = np.where(shown, low[seen], np.nan), np.where(shown, high[seen], np.nan)
    least, most = np.nanmin(low, axis=1), np.nanmax(high, axis=1)
    slack = np.maximum(0.02 * (most - least), 1e-3)
    unseen_people = rules.one_person / count**2 * np.maximum(np.abs(least), np.abs(most))
    all_low[seen] = least - np.maximum(rules.widen * np.nanstd(low, axis=1), slack) - unseen_people
    all_high[seen] = most + np.maximum(rules.widen * np.nanstd(high, axis=1), slack) + unseen_people
    return Anchors(triples, all_low.reshape(-1, len(CHECKS)), all_high.reshape(-1, len(CHECKS)))


def _cost(anchors: Anchors, frames: Floats, rng: np.random.Generator) -> Floats:
    """Mean cost of each anchor in a frame, in microseconds of a usual machine: evaluations, and labellings to follow up."""
    shown = [frame[~np.isnan(frame[:, 0])] for frame in frames[rng.choice(len(frames), min(20, len(frames)), replace=False)]]
    offsets = np.cumsum([0, *map(len, shown)])
    evaluations, labellings = np.empty((2, len(anchors.triples), len(shown)), dtype=np.int64)
    room = np.empty((64, 3), dtype=np.int64)
    count_search(anchors.solvers(), np.concatenate(shown), offsets, 10**7, room, evaluations, labellings)
    followed = np.where(labellings >= 0, labellings, 2 * len(room))
    cost = 0.006 * evaluations + 0.0035 * frames.shape[1] ** 2 * followed + 1.0
    # One after the other: NumPy's sum takes another order.
    return np.add.accumulate(cost, axis=1)[:, -1] / len(shown)
