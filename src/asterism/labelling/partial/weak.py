"""Weak classifiers (thesis 4.3, 4.4.1): labelled frames in; intervals, wrong labellings, the boosted choice, the strong classifier out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.labelling.features.feature_kernels import count_rejected, feature_ranges, mark_rejections
from asterism.labelling.features.registry import THESIS, check_motion, feature_pool, markers_read
from asterism.labelling.partial._build_kernels import choose_covering
from asterism.recording import Floats, Ints

Bits = NDArray[np.uint64]

INTERVAL_RULES = ("range", "widened")
"""How an interval follows from training: smallest and largest value (eq. 4.4), or these moved outward by how much people differ."""

WIDENINGS = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0)
"""The factors from which `choose_widening` chooses. Chosen by hand."""

ONE_PERSON_SHARE = 0.1
"""With one person there is no spread over people; this share of the range replaces it. Not tuned."""

CHUNK = 100_000
"""Wrong labellings that `StrongClassifier.accuracy` draws at once: bounds its memory."""


@dataclass(frozen=True)
class WeakClassifiers:
    """Weak classifiers (eq. 4.4): a feature of some markers, and the interval that right labellings keep to.

    kinds (F,) places in `features.FEATURES`; slots (F, 4) markers; low, high (F,) in the feature's unit
    """

    kinds: Ints
    slots: Ints
    low: Floats
    high: Floats

    def __len__(self) -> int:
        return len(self.kinds)

    def take(self, rows: Ints | NDArray[np.bool_]) -> WeakClassifiers:
        """Some of them."""
        return WeakClassifiers(self.kinds[rows], self.slots[rows], self.low[rows], self.high[rows])


@dataclass(frozen=True)
class FeatureRanges:
    """How the features of a pool spread: low, high (F, P), the smallest and largest value that each of P people showed.

    +inf and -inf where a person never showed all the feature's points.
    """

    kinds: Ints
    slots: Ints
    low: Floats
    high: Floats

    @classmethod
    def measure(cls, frames: Floats, groups: Ints, features: Sequence[str] = THESIS, seed: int | np.random.Generator = 0) -> FeatureRanges:
        """Features over all subsets of the columns of frames (N, M, 3) m, z up; groups (N,) whose frame each is. O(F N).

        Features of motion take frames (N, M, WIDTH) as `motion_points.frames_with_motion` gives them; an unknown motion does not count.
        """
        kinds, slots = feature_pool(frames.shape[1], features, seed)
        check_motion(kinds, frames)
        people, group = np.unique(groups, return_inverse=True)
        low, high = np.empty((len(kinds), len(people))), np.empty((len(kinds), len(people)))
        feature_ranges(np.ascontiguousarray(frames), group.astype(np.int64), len(people), kinds, slots, low, high)
        return cls(kinds, slots, low, high)

    def classifiers(
        self, rule: str = "range", widen: float = 1.0, people: Sequence[int] | NDArray[np.bool_] | slice = slice(None)
    ) -> WeakClassifiers:
        """The intervals that the given people's values make; a feature that none of them showed accepts everything.

        rule "range"    smallest and largest value (eq. 4.4)
        rule "widened"  each end moved outward by `widen` standard deviations of that end over the people; for one person by `widen`
                        times `ONE_PERSON_SHARE` of the range
        """
        if rule not in INTERVAL_RULES:
            raise AsterismError(f"rule {rule!r} is not known; choose among {', '.join(INTERVAL_RULES)}.")
        low, high = self.low[:, people], self.high[:, people]
        shown = np.isfinite(low)
        count = shown.sum(axis=1)
        # Smallest and largest value of all people together, eq. 4.4.
        alpha, beta = low.min(axis=1), high.max(axis=1)
        if rule == "widened":
            width = np.where(count > 0, beta - alpha, 0.0)
            # The ends of a few people say little of the next one: their spread widens them.
            alpha = alpha - widen * np.where(count > 1, _deviation(low, shown), ONE_PERSON_SHARE * width)
            beta = beta + widen * np.where(count > 1, _deviation(high, shown), ONE_PERSON_SHARE * width)
        # A feature that nobody showed must not reject anybody.
        return WeakClassifiers(self.kinds, self.slots, np.where(count > 0, alpha, -np.inf), np.where(count > 0, beta, np.inf))


def _deviation(values: Floats, shown: NDArray[np.bool_]) -> Floats:
    count = np.maximum(shown.sum(axis=1), 1)
    mean = np.where(shown, values, 0.0).sum(axis=1) / count
    squares = np.where(shown, values - mean[:, None], 0.0) ** 2
    return np.sqrt(squares.sum(axis=1) / np.maximum(count - 1, 1))


def draw_wrong_labellings(n_markers: int, severities: Ints, rng: np.random.Generator) -> Ints:
    """(K, M) labellings in each of which exactly severities[k] >= 2 labels, drawn at random, are wrong: permuted without a fixed point."""
    count = len(severities)
    labels = np.tile(np.arange(n_markers), (count, 1))
    which = np.argsort(rng.random((count, n_markers)), axis=1)
    open_rows = np.arange(count)
    image = np.empty_like(which)
    inside = np.arange(n_markers) < severities[:, None]
    # A permutation with a fixed point has too few wrong labels: it is drawn anew.
    while len(open_rows):
        keys = np.where(inside[open_rows], rng.random((len(open_rows), n_markers)), np.inf)
        image[open_rows] = np.argsort(keys, axis=1, kind="stable")
        fixed = (image[open_rows] == np.arange(n_markers)) & inside[open_rows]
        open_rows = open_rows[fixed.any(axis=1)]
    np.put_along_axis(labels, which, np.take_along_axis(which, image, axis=1), axis=1)
    return labels


@dataclass(frozen=True)
class WrongLabellings:
    """Wrong labellings, and which weak classifiers of a pool reject them, as bits.

    frames (K, M, 3) m, labels (K, M); table (F, W) bit k set where classifier f rejects labelling k; wrong_markers (M, W) bit k set where
    labelling k is wrong about marker m; weight (W,) of the labellings of a word: the fewer labels are wrong, the harder and heavier
    """

    frames: Floats
    labels: Ints
    table: Bits
    wrong_markers: Bits
    weight: Ints

    @classmethod
    def draw(cls, frames: Floats, weak: WeakClassifiers, rng: np.random.Generator, count: int = 8192) -> WrongLabellings:
        """Permutations with severities from 2 to M (section 4.4.1), half of them of 2 to 4 labels, of frames without gaps if there are."""
        n = frames.shape[1]
        words = max(2, count // 64)
        # Exchanges of two to four labels are the hardest, and get half of the samples.
        few = np.linspace(2, min(4, n), words // 2)
        severity = np.sort(np.concatenate([few, np.linspace(2, n, words - len(few))]).round().astype(np.int64))
        complete = np.nonzero(~np.isnan(frames[:, :, 0]).any(axis=1))[0]
        # Too few complete frames would repeat themselves.
        source = complete if len(complete) >= 64 else np.arange(len(frames))
        drawn = frames[rng.choice(source, size=64 * words)]
        labels = draw_wrong_labellings(n, np.repeat(severity, 64), rng)
        # The fewer labels are wrong, the more a rejection is worth.
        return cls.from_labellings(drawn, labels, weak, n + 1 - severity)

    @classmethod
    def from_labellings(cls, frames: Floats, labels: Ints, weak: WeakClassifiers, weight: Ints) -> WrongLabellings:
        """Given labellings; `weight` is one whole number per 64 of them."""
        words = -(-len(labels) // 64)
        table = np.zeros((len(weak), words), dtype=np.uint64)
        mark_rejections(np.ascontiguousarray(frames), np.ascontiguousarray(labels), weak.kinds, weak.slots, weak.low, weak.high, table)
        return cls(frames, labels, table, _pack((labels != np.arange(labels.shape[1])).T, words), weight.astype(np.int64))

    def joined(self, other: WrongLabellings) -> WrongLabellings:
        """Both trials' labellings."""
        return WrongLabellings(
            np.concatenate([_padded(self.frames, self.table), other.frames]),
            np.concatenate([_padded(self.labels, self.table), other.labels]),
            np.concatenate([self.table, other.table], axis=1),
            np.concatenate([self.wrong_markers, other.wrong_markers], axis=1),
            np.concatenate([self.weight, other.weight]),
        )

    def boost(self, rows: Ints, markers: Ints | Sequence[int], most: int) -> tuple[Ints, Ints, int]:
        """The weighted greedy selection of section 4.4.1 among classifiers `rows` for a labelling of `markers` alone.

        A labelling that is right about all of `markers` is no wrong sample for them. Returns at most `most` rows in order of selection,
        the weight each has earned, and how many of them were taken before every sample that can be rejected was.
        """
        # Only labellings that are wrong about one of these markers are wrong for them.
        wrong = np.bitwise_or.reduce(self.wrong_markers[np.asarray(markers, dtype=np.int64)], axis=0)
        chosen, gains = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
        count, once = choose_covering(np.ascontiguousarray(self.table[rows]), wrong, self.weight, min(most, len(rows)), chosen, gains)
        return rows[chosen[:count]], gains[:count].copy(), once


def _padded(values: NDArray[np.generic], table: Bits) -> NDArray[np.generic]:
    # The last word may be short: copies fill it, which no bit counts.
    short = table.shape[1] * 64 - len(values)
    return np.concatenate([values, np.repeat(values[-1:], short, axis=0)]) if short else values


def _pack(flags: NDArray[np.bool_], words: int) -> Bits:
    """(R, K) booleans as (R, W) words, flag k in bit k % 64 of word k // 64."""
    padded = np.zeros((len(flags), words * 64), dtype=np.bool_)
    padded[:, : flags.shape[1]] = flags
    return np.packbits(padded, axis=1, bitorder="little").view("<u8").astype(np.uint64)


@dataclass(frozen=True)
class StrongClassifier:
    """The ensemble of weak classifiers, phi of eq. 4.5, for a set of M markers.

    weak     in order of selection
    weights  (F,) the weight that each earned when it was selected
    """

    weak: WeakClassifiers
    weights: Floats
    n_markers: int

    def score(self, frames: Floats, labels: Ints) -> Floats:
        """(N,) phi in [0, 1]: of the weak classifiers that can be evaluated, the weighted share that accept; 1 where none can be.

        frames (N, n, 3) m, z up, or with their motion (N, n, WIDTH); labels (N, M) row of the point that each marker is given, -1 for none.
        A classifier is ignored, in the numerator and in the denominator, where one of its markers has no point (section 4.4.2), or the
        point or the motion that it reads is missing.
        """
        check_motion(self.weak.kinds, frames)
        # A row of NaN stands for "no point", so that a missing marker reads as missing.
        absent = np.full((len(frames), 1, frames.shape[2]), np.nan)
        points = np.ascontiguousarray(np.concatenate([frames, absent], axis=1))
        rows = np.where(np.asarray(labels, dtype=np.int64) < 0, frames.shape[1], labels).astype(np.int64)
        rejected = self._rejections(points, rows, self.weak.low, self.weak.high)
        nothing = np.full(len(self.weak), np.inf)
        known = self._rejections(points, rows, nothing, -nothing)  # an interval that rejects every value
        # What cannot be evaluated counts neither for nor against.
        weight = self.weights @ known
        score: Floats = 1.0 - (self.weights @ rejected) / np.where(weight > 0, weight, 1.0)
        # A score of exactly 1 is kept for "nothing rejects", whatever rounding does.
        return np.where(rejected.any(axis=0), np.minimum(score, np.nextafter(1.0, 0.0)), 1.0)

    def _rejections(self, frames: Floats, labels: Ints, low: Floats, high: Floats) -> NDArray[np.uint8]:
        """(F, N) 1 where a weak classifier with these intervals rejects."""
        table = np.zeros((len(self.weak), -(-len(labels) // 64)), dtype=np.uint64)
        mark_rejections(frames, labels, self.weak.kinds, self.weak.slots, low, high, table)
        return np.unpackbits(table.astype("<u8").view(np.uint8), axis=1, bitorder="little")[:, : len(labels)]

    def accepts(self, frames: Floats, labels: Ints) -> NDArray[np.bool_]:
        """(N,) whether phi is 1: no weak classifier rejects."""
        accepted: NDArray[np.bool_] = self.score(frames, labels) == 1.0
        return accepted

    def accuracy(self, frames: Floats, wrong: int = 10**7, seed: int | np.random.Generator = 0) -> float:
        """Share of `wrong` wrong labellings of random frames (N, M, 3), of severities 2 to M alike, that are rejected (section 5.2).

        O(wrong), about a microsecond each. Raises AsterismError where no frame shows all markers.
        """
        check_motion(self.weak.kinds, frames)
        complete = np.ascontiguousarray(frames[~np.isnan(frames[:, :, 0]).any(axis=1)])
        if not len(complete):
            raise AsterismError("no frame shows all markers, so no wrong labelling can be made; give frames without gaps.")
        rng = np.random.default_rng(seed)
        caught = 0
        # In parts, which bounds the memory.
        for start in range(0, wrong, CHUNK):
            size = min(CHUNK, wrong - start)
            labels = draw_wrong_labellings(self.n_markers, rng.integers(2, self.n_markers + 1, size=size), rng)
            choice = rng.integers(len(complete), size=size)
            caught += count_rejected(complete, choice, labels, self.weak.kinds, self.weak.slots, self.weak.low, self.weak.high)
        return caught / wrong


def choose_widening(ranges: FeatureRanges, frames: Floats, groups: Ints, rows: Ints, seed: int | np.random.Generator = 0) -> float:
    """The factor of rule "widened" that does best on people left out, one after the other, for the classifiers `rows`.

    Best: the share of a left-out person's frames that is accepted, minus the share of their wrong labellings of 2 or 3 labels that is
    accepted too, averaged over the people; of equals the smallest. With one person nothing can be left out: 1.
    """
    people = np.unique(groups)
    if len(people) < 2:
        return 1.0
    rng = np.random.default_rng(seed)
    n = frames.shape[1]
    kept = replace(ranges, kinds=ranges.kinds[rows], slots=ranges.slots[rows], low=ranges.low[rows], high=ranges.high[rows])
    merits = np.zeros(len(WIDENINGS))
    for p, person in enumerate(people):
        own = np.ascontiguousarray(frames[groups == person])
        right = np.tile(np.arange(n), (len(own), 1))
        # Two or three wrong labels are the ones that widening lets through.
        choice = rng.integers(len(own), size=2000)
        wrong = draw_wrong_labellings(n, rng.integers(2, min(3, n) + 1, size=len(choice)), rng)
        for w, widen in enumerate(WIDENINGS):
            weak = kept.classifiers("widened", widen, np.arange(len(people)) != p)
            refused = count_rejected(own, np.arange(len(own)), right, weak.kinds, weak.slots, weak.low, weak.high)
            caught = count_rejected(own, choice, wrong, weak.kinds, weak.slots, weak.low, weak.high)
            # Accepting one's own frames and rejecting exchanges weigh alike.
            merits[w] += caught / len(choice) - refused / len(own)
    return WIDENINGS[int(np.argmax(merits))]


def classifiers_over(weak: WeakClassifiers, n_markers: int, markers: Ints | Sequence[int]) -> Ints:
    """Rows of the classifiers that read only the given markers and have a finite interval."""
    outside = np.ones(n_markers, dtype=np.bool_)
    outside[np.asarray(markers, dtype=np.int64)] = False
    reads_others = markers_read(weak.kinds, weak.slots, n_markers)[:, outside].any(axis=1)
    rows: Ints = np.nonzero(~reads_others & np.isfinite(weak.low))[0]
    return rows
