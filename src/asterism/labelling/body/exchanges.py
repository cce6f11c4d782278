"""Labelled frames and the body's whole covariance in; by how far the labels are ahead of each exchange of near markers out.

Frames are labelled by a covariance of few directions, beside which every marker moves by itself. That is fast, but it makes neighbours look
more alike than they are: what it leaves over of two neighbours' movements is nearly the same. So an exchange is judged by the whole
covariance. Given the points of all other markers, those of the exchanged ones follow a normal distribution of a few coordinates; where they
deviate by more than expected, its spread may be larger, as in `log_tail`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from asterism.geometry import align_about_z
from asterism.labelling.body._score_kernels import MAX_DISTANCE
from asterism.labelling.body.model import MOVES, BodyModel
from asterism.recording import Floats, Ints


@dataclass(frozen=True)
class ExchangeModel:
    """What exchanges are judged by; K key poses of M markers.

    mean        (K, M, 3) m
    covariance  (K, 3 M, 3 M) m2, of the placed body of one unknown person
    log_weight  (K,) log share of the training frames
    pairs       (N, 2) markers near enough to be exchanged, the first below the second
    groups      (G, m) each marker and those whose distances to it are the steadiest, each group once
    """

    mean: Floats
    covariance: Floats
    log_weight: Floats
    pairs: Ints
    groups: Ints

    @classmethod
    def of_body(cls, body: BodyModel, groups: Ints) -> ExchangeModel:
        """Of a body model; groups: see `neighbours_of`. One of an earlier Asterism knows its main directions only."""
        if body.within is None or body.between is None:
            covariance = np.stack([body.covariance(k) for k in range(len(body.mean))])
        else:
            # small moves of the whole body are the last directions of its load
            moves = body.load[..., -MOVES:].reshape(len(body.mean), -1, MOVES)
            covariance = body.within + body.between + moves @ moves.transpose(0, 2, 1)
        apart = np.linalg.norm(body.mean[:, :, None] - body.mean[:, None], axis=3).min(axis=0)
        return cls(body.mean, covariance, body.log_weight, np.argwhere(np.triu(apart < MAX_DISTANCE, 1)), groups)

    @cached_property
    def table(self) -> Ints:
        """All exchanges (W, M): for each marker the one whose point it takes. Pairs first, then the permutations of each group."""
        markers, orders = self.mean.shape[1], len(self._orders)
        table = np.tile(np.arange(markers), (len(self.pairs) + len(self.groups) * orders, 1))
        one, other = self.pairs.T
        rows = np.arange(len(self.pairs))
        table[rows, one], table[rows, other] = other, one
        of_groups = len(self.pairs) + np.arange(len(self.groups) * orders).reshape(len(self.groups), -1)
        table[of_groups[:, :, None], self.groups[:, None, :]] = self.groups[:, self._orders]
        return table

    @cached_property
    def _orders(self) -> Ints:
        """Permutations of a group that move three of its markers or more; exchanges of two are among the pairs."""
        size = self.groups.shape[1]
        return np.array([order for order in permutations(range(size)) if sum(i != o for i, o in enumerate(order)) >= 3]).reshape(-1, size)

    def held(self, frames: Floats, freedom: float) -> HeldFrames:
        """Labelled frames (E, M, 3) m, z up, NaN where missing, to be held against exchanges and other points.

        freedom: degrees of freedom of the tail. O(E' K M^3) for E' different sets of markers in view.
        """
        shown, parts = ~np.isnan(frames[:, :, 0]), list[tuple[Ints, int, _Conditional]]()
        patterns, which = np.unique(shown, axis=0, return_inverse=True)
        for p, pattern in enumerate(patterns):
            rows = np.nonzero(which.ravel() == p)[0]
            # two points leave the body's turn open
            if pattern.sum() < 3:
                continue
            for k, own in self._by_pose(frames[rows], pattern):
                of_pose = rows[own]
                parts.append((of_pose, k, _Conditional.of_frames(frames[of_pose], pattern, self.mean[k], self.covariance[k])))
        return HeldFrames(self, frames, freedom, parts)

    def _by_pose(self, frames: Floats, shown: NDArray[np.bool_]) -> Iterable[tuple[int, Ints]]:
        """Which key pose explains which of these frames (E, M, 3) best; all show the same markers (M,)."""
        coordinates, scores = np.repeat(shown, 3), np.empty((len(self.mean), len(frames)))
        for k, mean in enumerate(self.mean):
            residual = (align_about_z(frames, mean) - mean).reshape(len(frames), -1)[:, coordinates]
            lower = np.linalg.cholesky(self.covariance[k][np.ix_(coordinates, coordinates)])
            squares = (np.linalg.solve(lower, residual.T) ** 2).sum(axis=0)
            scores[k] = self.log_weight[k] - np.log(np.diag(lower)).sum() - 0.5 * squares
        best = scores.argmax(axis=0)
        return [(int(k), np.nonzero(best == k)[0]) for k in np.unique(best)]


@dataclass(frozen=True)
class HeldFrames:
    """Labelled frames (E, M, 3) and what the points of a frame say of each other: see `ExchangeModel.held`.

    parts  which frames show the same markers in the same key pose, that pose, and what their points say
    """

    model: ExchangeModel
    frames: Floats
    freedom: float
    parts: Sequence[tuple[Ints, int, _Conditional]]

    def behind(self) -> Floats:
        """By how many nats each exchange of the model's `table` is behind the labels in each frame: (W, E).

        NaN for an exchange that leaves the frame as it is, and in frames of fewer than three labels. O(E (N + G m!)), and O(E' (N + G m!))
        for E' different sets of markers in view.
        """
        pairs, orders = self.model.pairs, self.model._orders
        out = np.full((len(self.model.table), len(self.frames)), np.nan)
        for rows, _, given in self.parts:
            out[: len(pairs), rows] = given.behind_pairs(pairs, self.freedom)
            out[len(pairs) :, rows] = given.behind_orders(self.model.groups, orders, self.freedom).reshape(-1, len(rows))
        return out

    def behind_others(self, others: Floats) -> Floats:
        """By how many nats each marker's label is behind in each frame where one of N other points gets it in place of its own: (N, M, E).

        others (E, N, 3) m, of no marker. NaN where either is missing, and in frames of fewer than three labels. O(E M N).
        """
        markers, count = self.frames.shape[1], others.shape[1]
        out = np.full((count, markers, len(self.frames)), np.nan)
        for rows, k, given in self.parts:
            # what has no place in the mean body is moved with the rest
            mean = np.concatenate([self.model.mean[k], np.full((count, 3), np.nan)])
            beside = align_about_z(np.concatenate([self.frames[rows], others[rows]], axis=1), mean)[:, markers:]
            out[np.ix_(np.arange(count), np.nonzero(given.shown)[0], rows)] = given.behind_others(beside, self.freedom)
        return out


@dataclass(frozen=True)
class _Conditional:
    """Frames (E) in which the same V of M markers are in view, placed onto a key pose, and what the labelled points say of every marker.

    placed     (E, M, 3) m, NaN where missing
    place      (M,) each marker's number among those in view, or among the H others
    precision  (V, 3, V, 3) 1/m2, of the markers in view
    pull       (E, V, 3) 1/m, the precision times their deviation from the mean body
    gain       (H, 3, V, 3) how the others follow those in view
    left       (H, 3, H, 3) m2, their covariance, given all in view
    predicted  (E, H, 3) m, where these predict them
    """

    placed: Floats
    shown: NDArray[np.bool_]
    place: Ints
    precision: Floats
    pull: Floats
    gain: Floats
    left: Floats
    predicted: Floats

    @classmethod
    def of_frames(cls, frames: Floats, shown: NDArray[np.bool_], mean: Floats, covariance: Floats) -> _Conditional:
        placed = align_about_z(frames, mean)
        seen, count, hidden = np.repeat(shown, 3), int(shown.sum()), int((~shown).sum())
        precision: Floats = np.asarray(np.linalg.inv(covariance[np.ix_(seen, seen)]), dtype=np.float64)
        residual = (placed - mean)[:, shown].reshape(len(frames), -1)
        across = covariance[np.ix_(~seen, seen)]
        gain = across @ precision
        left = covariance[np.ix_(~seen, ~seen)] - gain @ across.T
        place = np.where(shown, np.cumsum(shown), np.cumsum(~shown)) - 1
        return cls(
            placed,
            shown,
            place,
            precision.reshape(count, 3, count, 3),
            (residual @ precision).reshape(len(frames), count, 3),
            gain.reshape(hidden, 3, count, 3),
            left.reshape(hidden, 3, hidden, 3),
            mean[~shown] + (residual @ gain.T).reshape(len(frames), hidden, 3),
        )

    def behind_pairs(self, pairs: Ints, freedom: float) -> Floats:
        """By how many nats the exchange of each pair (N, 2) is behind in each frame: (N, E)."""
        out = np.full((len(pairs), len(self.placed)), np.nan)
        seen = self.shown[pairs]
        both = seen.all(axis=1)
        out[both] = self._behind_exchanges(pairs[both], freedom)
        # the one in view first
        mixed = seen[:, 0] != seen[:, 1]
        ordered = np.where(seen[mixed][:, :1], pairs[mixed], pairs[mixed][:, ::-1])
        out[mixed] = self._behind_hidden(ordered, freedom)
        return out

    def _behind_exchanges(self, pairs: Ints, freedom: float) -> Floats:
        """`behind_pairs` of markers in view. Given all others, two deviate by the inverse of their precision times their pull."""
        one, other = self.place[pairs].T
        step = (self.placed[:, pairs[:, 1]] - self.placed[:, pairs[:, 0]]).transpose(1, 0, 2)
        pull = np.concatenate([self.pull[:, one], self.pull[:, other]], axis=2).transpose(1, 0, 2)
        aa, ab, bb = self.precision[one, :, one], self.precision[one, :, other], self.precision[other, :, other]
        block = np.concatenate([np.concatenate([aa, ab], axis=2), np.concatenate([ab.transpose(0, 2, 1), bb], axis=2)], axis=1)
        own = (pull * np.linalg.solve(block, pull.transpose(0, 2, 1)).transpose(0, 2, 1)).sum(axis=2)
        of_step = np.einsum("nei,nij,nej->ne", step, aa + bb - ab - ab.transpose(0, 2, 1), step)
        exchanged = own + 2.0 * (step * (pull[:, :, :3] - pull[:, :, 3:])).sum(axis=2) + of_step
        return _log_t(own, 6, freedom) - _log_t(exchanged, 6, freedom)

    def _behind_hidden(self, pairs: Ints, freedom: float) -> Floats:
        """`behind_pairs` of a marker in view and one that is not, which takes its point."""
        one, other = self.place[pairs].T
        spread = np.linalg.inv(self.precision[one, :, one])
        deviation = np.einsum("nij,enj->nei", spread, self.pull[:, one])
        own = (deviation * self.pull[:, one].transpose(1, 0, 2)).sum(axis=2)
        gain = self.gain[other, :, one]
        wider = self.left[other, :, other] + gain @ spread @ gain.transpose(0, 2, 1)
        apart = (self.placed[:, pairs[:, 0]] - self.predicted[:, other]).transpose(1, 0, 2) + deviation @ gain.transpose(0, 2, 1)
        taken = (apart * np.linalg.solve(wider, apart.transpose(0, 2, 1)).transpose(0, 2, 1)).sum(axis=2)
        scale = 0.5 * (np.linalg.slogdet(wider)[1] - np.linalg.slogdet(spread)[1])
        return _log_t(own, 3, freedom) - _log_t(taken, 3, freedom) + scale[:, None]

    def behind_others(self, others: Floats, freedom: float) -> Floats:
        """`HeldFrames.behind_others` of placed points (E, N, 3) for the V markers in view: (N, V, E)."""
        every = np.arange(self.precision.shape[0])
        precision = self.precision[every, :, every]
        deviation = np.einsum("evi,vij->evj", self.pull, np.linalg.inv(precision))
        own = (deviation * self.pull).sum(axis=2)
        apart = others[:, :, None] - (self.placed[:, self.shown] - deviation)[:, None]
        taken = np.einsum("envi,vij,envj->env", apart, precision, apart)
        return np.asarray((_log_t(own, 3, freedom)[:, None] - _log_t(taken, 3, freedom)).transpose(1, 2, 0))

    def behind_orders(self, groups: Ints, orders: Ints, freedom: float) -> Floats:
        """By how many nats each permutation (W, m) of each group (G, m) is behind in each frame: (G, W, E)."""
        out = np.full((len(groups), len(orders), len(self.placed)), np.nan)
        seen = self.shown[groups]
        # Groups of which the same places are in view are judged at once: most are in view as a whole.
        patterns, which = np.unique(seen, axis=0, return_inverse=True)
        for p, pattern in enumerate(patterns):
            if pattern.any():
                same = np.nonzero(which.ravel() == p)[0]
                out[same] = self._behind_alike(groups[same], pattern, orders, freedom)
        return out

    def _behind_alike(self, groups: Ints, seen: NDArray[np.bool_], orders: Ints, freedom: float) -> Floats:
        """`behind_orders` of groups of which the same places (m,) are in view."""
        frames, size, count = len(self.placed), len(seen), int(seen.sum())
        out = np.full((len(groups), len(orders), frames), np.nan)
        mean, covariance = self._given_others(groups, seen)
        at = self.placed[:, groups].transpose(1, 0, 2, 3)
        filled, takers = np.concatenate([seen[None], seen[orders]]), np.concatenate([np.arange(size)[None], orders])
        scores = np.empty((len(groups), len(filled), frames))
        for slots in np.unique(filled, axis=0):
            same = np.nonzero((filled == slots).all(axis=1))[0]
            own = np.nonzero(np.repeat(slots, 3))[0]
            block = covariance[:, own[:, None], own]
            points = at[:, :, takers[same][:, slots]]
            apart = (points - mean[:, :, None, slots]).reshape(len(groups), frames * len(same), 3 * count)
            squares = ((apart @ np.linalg.inv(block)) * apart).sum(axis=2).reshape(len(groups), frames, len(same))
            weights = 0.5 * np.linalg.slogdet(block)[1]
            scores[:, same] = _log_t(squares, 3 * count, freedom).transpose(0, 2, 1) - weights[:, None, None]
        moved = ((orders != np.arange(size)) & (seen | seen[orders])).any(axis=1)
        out[:, moved] = (scores[:, :1] - scores[:, 1:])[:, moved]
        return out

    def _given_others(self, groups: Ints, seen: NDArray[np.bool_]) -> tuple[Floats, Floats]:
        """Where the points of all other markers predict those of groups (G, m): (G, E, m, 3) m, and the covariance (G, 3 m, 3 m).

        seen (m,): which places of all these groups are in view.
        """
        there, away = self.place[groups[:, seen]], self.place[groups[:, ~seen]]
        number, frames, count = len(groups), len(self.placed), 3 * there.shape[1]
        spread = np.linalg.inv(_blocks(self.precision, there, there))
        deviation = self.pull[:, there].transpose(1, 0, 2, 3).reshape(number, frames, count) @ spread
        gain = _blocks(self.gain, away, there)
        mean, covariance = np.empty((number, frames, len(seen), 3)), np.empty((number, 3 * len(seen), 3 * len(seen)))
        placed, predicted = (of[:, rows].transpose(1, 0, 2, 3) for of, rows in ((self.placed, groups[:, seen]), (self.predicted, away)))
        mean[:, :, seen] = placed - deviation.reshape(placed.shape)
        mean[:, :, ~seen] = predicted - (deviation @ gain.transpose(0, 2, 1)).reshape(number, frames, away.shape[1], 3)
        follows = gain @ spread
        of_seen, of_hidden = (np.nonzero(np.repeat(one, 3))[0] for one in (seen, ~seen))
        covariance[:, of_seen[:, None], of_seen] = spread
        covariance[:, of_hidden[:, None], of_seen] = follows
        covariance[:, of_seen[:, None], of_hidden] = follows.transpose(0, 2, 1)
        covariance[:, of_hidden[:, None], of_hidden] = _blocks(self.left, away, away) + follows @ gain.transpose(0, 2, 1)
        return mean, covariance


def _blocks(matrix: Floats, rows: Ints, columns: Ints) -> Floats:
    """Of a matrix (A, 3, B, 3) those parts whose rows (G, a) and columns (G, b) are given: (G, 3 a, 3 b)."""
    parts = matrix[rows[:, :, None], :, columns[:, None, :]].transpose(0, 1, 3, 2, 4)
    return np.ascontiguousarray(parts).reshape(len(rows), 3 * rows.shape[1], 3 * columns.shape[1])


def _log_t(squares: Floats, coordinates: int, freedom: float) -> Floats:
    """What a squared Mahalanobis distance takes from the log density of a t distribution of so many coordinates, nats."""
    return np.asarray(-0.5 * (freedom + coordinates) * np.log1p(np.maximum(squares, 0.0) / freedom))
