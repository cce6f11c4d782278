"""Intervals, wrong labellings, the boosted choice and the strong classifier."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import twins
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism import AsterismError
from asterism.labelling.features.registry import FEATURES, markers_read
from asterism.labelling.partial._bit_kernels import popcount
from asterism.labelling.partial.weak import (
    FeatureRanges,
    StrongClassifier,
    WrongLabellings,
    choose_widening,
    classifiers_over,
    draw_wrong_labellings,
)

pytestmark = pytest.mark.kernels


def bodies(people=4, frames=60, markers=7, seed=0):
    """(N, M, 3) m random bodies: one shape, a size per person, jitter per frame, turned about z; and whose each frame is."""
    rng = np.random.default_rng(seed)
    shape = rng.uniform(-0.5, 0.5, size=(markers, 3)) + np.array([0.0, 0.0, 1.0])
    sizes = rng.uniform(0.85, 1.15, size=people)
    groups = np.repeat(np.arange(people), frames)
    out = shape[None] * sizes[groups, None, None] + rng.normal(scale=0.01, size=(people * frames, markers, 3))
    turn = rng.uniform(0, 2 * np.pi, size=len(out))
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    return np.stack([cos * out[..., 0] - sin * out[..., 1], sin * out[..., 0] + cos * out[..., 1], out[..., 2]], axis=2), groups


FRAMES, GROUPS = bodies()
SPREAD = FeatureRanges.measure(FRAMES, GROUPS)


def test_range_accepts_all_of_training_and_is_tight():
    weak = SPREAD.classifiers("range")
    right = np.tile(np.arange(7), (len(FRAMES), 1))
    strong = StrongClassifier(weak, np.ones(len(weak)), 7)
    assert strong.accepts(FRAMES, right).all()
    distance = np.linalg.norm(FRAMES[:, 0] - FRAMES[:, 1], axis=1)
    row = np.nonzero((weak.kinds == 1) & (weak.slots[:, 0] == 0) & (weak.slots[:, 1] == 1))[0][0]
    assert (weak.low[row], weak.high[row]) == (pytest.approx(distance.min()), pytest.approx(distance.max()))


def test_widened_moves_each_end_by_its_own_spread_over_people():
    plain, wide = SPREAD.classifiers("range"), SPREAD.classifiers("widened", 1.0)
    lows = np.array([[np.linalg.norm(FRAMES[g == GROUPS][:, 0] - FRAMES[g == GROUPS][:, 1], axis=1).min() for g in range(4)]])
    row = np.nonzero((plain.kinds == 1) & (plain.slots[:, 0] == 0) & (plain.slots[:, 1] == 1))[0][0]
    assert plain.low[row] - wide.low[row] == pytest.approx(lows.std(ddof=1))
    assert (SPREAD.classifiers("widened", 0.0).low == plain.low).all()
    assert (SPREAD.classifiers("widened", 2.0).high >= wide.high).all()


def test_one_person_widens_by_a_share_of_the_range():
    weak, wide = SPREAD.classifiers("range", people=[0]), SPREAD.classifiers("widened", 1.0, people=[0])
    assert np.allclose(weak.low - wide.low, 0.1 * (weak.high - weak.low))


def test_a_feature_never_seen_accepts_everything():
    frames = FRAMES.copy()
    frames[:, 0] = np.nan
    weak = FeatureRanges.measure(frames, GROUPS).classifiers("range")
    unseen = (weak.slots[:, 0] == 0) & (weak.kinds != 8)
    assert np.isinf(weak.low[unseen]).all()
    assert not np.isin(np.nonzero(unseen)[0], classifiers_over(weak, 7, range(7))).any()


def test_unknown_rule_is_refused():
    with pytest.raises(AsterismError, match="rule"):
        SPREAD.classifiers("median")


@given(n=st.integers(2, 12), seed=st.integers(0, 1000))
@settings(max_examples=40, deadline=None)
def test_wrong_labellings_have_exactly_their_severity(n, seed):
    rng = np.random.default_rng(seed)
    severities = rng.integers(2, n + 1, size=50)
    labels = draw_wrong_labellings(n, severities, rng)
    assert (np.sort(labels, axis=1) == np.arange(n)).all()
    assert ((labels != np.arange(n)).sum(axis=1) == severities).all()


@given(word=st.integers(0, 2**64 - 1))
def test_popcount(word):
    assert popcount(np.uint64(word)) == word.bit_count()


def slow_boost(rejects, moved, weight, rows, markers, most):
    """Section 4.4.1 with sets of booleans: rejects (F, K), moved (M, K), weight (K,)."""
    wrong = moved[list(markers)].any(axis=0)
    left, chosen = wrong.copy(), []
    while len(chosen) < most:
        gains = {f: int((weight * (rejects[f] & left)).sum()) for f in rows if f not in chosen}
        if not gains:
            break
        best = max(gains, key=lambda f: (gains[f], -list(rows).index(f)))
        if gains[best] == 0:
            if (left == wrong).all():
                break
            left = wrong.copy()
            continue
        chosen.append(best)
        left = left & ~rejects[best]
    return chosen


@pytest.mark.parametrize("markers", [range(7), (0, 2, 3, 5)])
def test_boosting_equals_its_twin(markers):
    weak = SPREAD.classifiers("range")
    trial = WrongLabellings.draw(FRAMES, weak, np.random.default_rng(0), 256)
    bits = np.unpackbits(trial.table.view(np.uint8), axis=1, bitorder="little").astype(bool)
    moved = np.unpackbits(trial.wrong_markers.view(np.uint8), axis=1, bitorder="little").astype(bool)
    rows = classifiers_over(weak, 7, list(markers))
    chosen, gains, once = trial.boost(rows, list(markers), 12)
    assert chosen.tolist() == slow_boost(bits, moved, np.repeat(trial.weight, 64), rows, markers, 12)
    assert (np.diff(gains[:once]) <= 0).all(), "within a round each adds no more than the one before"


def test_labellings_with_few_wrong_markers_weigh_most():
    """Section 4.4.1: a classifier that rejects exchanges of two markers goes before one that rejects as many shuffled labellings."""
    weak = SPREAD.classifiers("range")
    trial = WrongLabellings.draw(FRAMES, weak, np.random.default_rng(0), 1024)
    severity = (trial.labels != np.arange(7)).sum(axis=1).reshape(-1, 64)
    assert (severity == severity[:, :1]).all(), "the labellings of a word are equally wrong"
    assert trial.weight.tolist() == (8 - severity[:, 0]).tolist()
    slight, severe = severity[:, 0] == 2, severity[:, 0] == 7
    table = np.zeros((2, len(severity)), dtype=np.uint64)
    table[0, severe] = table[1, np.nonzero(slight)[0][: severe.sum()]] = ~np.uint64(0)
    rows, gains, _ = replace(trial, table=table).boost(np.arange(2), range(7), 2)
    assert rows.tolist() == [1, 0]
    assert gains[0] == 6 * gains[1], "of equally many labellings, 7 + 1 - 2 against 7 + 1 - 7 each"


def test_a_strong_classifier_ignores_what_it_cannot_evaluate():
    """Eq. 4.5 over a partial labelling (4.4.2): a marker without a point takes its classifiers out of both sums."""
    weak = SPREAD.classifiers("range")
    weights = np.random.default_rng(0).integers(1, 9, size=len(weak)).astype(float)
    strong = StrongClassifier(weak, weights, 7)
    labels = np.tile([1, 0, 2, 3, 4, 5, -1], (len(FRAMES), 1))
    usable = ~markers_read(weak.kinds, weak.slots, 7)[:, 6]
    accepts = np.empty((len(weak), len(FRAMES)))
    for f in np.nonzero(usable)[0]:
        points = [FRAMES[:, labels[0, slot]] for slot in weak.slots[f]]
        values = np.array([twins.feature(FEATURES[weak.kinds[f]].name, list(frame)) for frame in np.stack(points, axis=1)])
        accepts[f] = (values >= weak.low[f]) & (values <= weak.high[f])
    expected = (weights[usable] @ accepts[usable]) / weights[usable].sum()
    assert strong.score(FRAMES, labels) == pytest.approx(expected, abs=1e-12)
    assert expected.min() < 1.0
    missing = FRAMES.copy()
    missing[:, 6] = np.nan
    given = np.where(labels < 0, 6, labels)
    assert strong.score(missing, given) == pytest.approx(expected, abs=1e-12), "a point that is missing is no point"
    assert (strong.score(FRAMES, np.full((len(FRAMES), 7), -1)) == 1.0).all(), "nothing assigned, nothing rejected"


def test_strong_classifier_rejects_and_its_score_counts_weights():
    weak = SPREAD.classifiers("range")
    trial = WrongLabellings.draw(FRAMES, weak, np.random.default_rng(0), 1024)
    rows, gains, _ = trial.boost(np.arange(len(weak)), range(7), 20)
    strong = StrongClassifier(weak.take(rows), gains.astype(float), 7)
    assert strong.accuracy(FRAMES, wrong=20_000) > 0.99
    weaker = StrongClassifier(weak.take(rows[:2]), gains[:2].astype(float), 7)
    assert weaker.accuracy(FRAMES, wrong=20_000) < strong.accuracy(FRAMES, wrong=20_000)
    wrong = np.tile([1, 0, 2, 3, 4, 5, 6], (len(FRAMES), 1))
    scores = strong.score(FRAMES, wrong)
    assert ((scores >= 0) & (scores < 1)).all()
    assert not strong.accepts(FRAMES, wrong).any()


def test_accuracy_is_the_same_for_the_same_seed_and_needs_whole_frames():
    strong = StrongClassifier(SPREAD.classifiers("range").take(np.arange(3)), np.ones(3), 7)
    assert strong.accuracy(FRAMES, 5000, seed=4) == strong.accuracy(FRAMES, 5000, seed=4)
    with pytest.raises(AsterismError, match="no frame shows all markers"):
        strong.accuracy(np.full((3, 7, 3), np.nan), 100)


def test_missing_points_are_ignored():
    frames = FRAMES[:4].copy()
    frames[:, 2] = np.nan
    strong = StrongClassifier(SPREAD.classifiers("range"), np.ones(len(SPREAD.kinds)), 7)
    assert strong.accepts(frames, np.tile(np.arange(7), (4, 1))).all()


def test_widening_is_chosen_larger_when_people_differ_more():
    rows = np.arange(len(SPREAD.kinds))
    alike = np.tile(FRAMES[GROUPS == 0], (2, 1, 1))
    groups = np.repeat([0, 1], len(alike) // 2)
    same = choose_widening(FeatureRanges.measure(alike, groups), alike, groups, rows)
    assert choose_widening(SPREAD, FRAMES, GROUPS, rows) > same
    assert choose_widening(SPREAD, FRAMES, np.zeros(len(FRAMES), dtype=int), rows) == 1.0
