"""The arithmetic of reliability, log score and Brier score against answers known beforehand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from asterism.labelling import ConfidenceTally
from asterism.labelling.reliability import LEAST_ERROR


def tally(stated, right, groups=1):
    """Labels of one marker, cut into so many groups of equal size."""
    out = ConfidenceTally()
    stated, right = np.asarray(stated, dtype=float), np.asarray(right, dtype=bool)
    for g, rows in enumerate(np.array_split(np.arange(len(stated)), groups)):
        out.add(stated[rows, None], np.ones((len(rows), 1), dtype=bool), right[rows, None], str(g))
    return out


def drawn(stated, seed=0, shift=0.0):
    """Whether labels with these confidences are right, where the confidence is `shift` nats of log odds too low."""
    odds = np.log(stated / (1 - stated)) + shift
    return np.random.default_rng(seed).random(len(stated)) < 1 / (1 + np.exp(-odds))


def test_scores_as_computed_by_hand():
    """Three right labels at 0.9 and one wrong at 0.6: the best constant is three quarters."""
    score = tally([0.9, 0.9, 0.9, 0.6], [1, 1, 1, 0]).score()
    assert score.labels == 4
    assert score.log_score == pytest.approx((-3 * np.log(0.9) - np.log(0.4)) / 4)
    assert score.constant_log_score == pytest.approx(-0.75 * np.log(0.75) - 0.25 * np.log(0.25))
    assert score.brier == pytest.approx((3 * 0.1**2 + 0.6**2) / 4)
    assert score.constant_brier == pytest.approx(0.75 * 0.25)
    assert [(each.least, each.labels) for each in score.levels] == [(0.0, 1), (0.9, 3)]
    assert score.at(0.92).right == 1.0 and score.at(0.3).right == 0.0 and score.at(0.97) is None


@pytest.mark.parametrize("constant", [0.5, 0.9, 0.97, 0.99])
def test_no_constant_scores_better_than_the_one_that_is_named(constant):
    right = np.arange(1000) < 970
    score = tally(np.full(1000, constant), right).score()
    assert score.log_score >= score.constant_log_score - 1e-12
    assert score.brier >= score.constant_brier - 1e-12
    assert not score.beats_constant or constant == 0.97


def test_a_level_holds_its_lower_end_and_not_its_upper_one():
    score = tally([0.9, 0.95, 0.99, 0.999, 1.0], np.ones(5)).score()
    assert [(each.least, each.labels) for each in score.levels] == [(0.9, 1), (0.95, 1), (0.99, 1), (0.999, 2)]


def test_an_honest_confidence_lies_in_its_interval_and_a_boast_does_not():
    """200,000 labels of 20 people from 0.9 to 0.9999; then the same where the odds of an error are e times what is stated."""
    stated = 1.0 - 10.0 ** -np.random.default_rng(1).uniform(1.0, 4.0, 200_000)
    honest, boast = (tally(stated, drawn(stated, shift=shift), groups=20).score() for shift in (0.0, -1.0))
    assert all(level.holds for level in honest.levels) and len(honest.levels) == 4
    assert all(level.too_high for level in boast.levels)
    assert honest.beats_constant
    assert honest.log_score < boast.log_score


def test_always_saying_one_loses_against_the_constant():
    """What the calibration error cannot see: 0.2 % wrong at full confidence is an error of 0.2 %, and costs 13.8 nats each."""
    right = np.arange(10_000) >= 20
    score = tally(np.ones(10_000), right).score()
    assert score.log_score == pytest.approx(0.002 * -np.log(LEAST_ERROR), rel=1e-3)
    assert not score.beats_constant


def test_people_who_differ_widen_the_interval():
    """Ten people; one in ten labels is wrong, evenly or all of them one person's."""
    stated = np.full(5000, 0.92)
    even, one = np.arange(5000) % 10 > 0, np.arange(5000) >= 500
    narrow, wide = (tally(stated, right, groups=10).score().at(0.92) for right in (even, one))
    assert narrow.right == wide.right == 0.9
    assert wide.high - wide.low > 3 * (narrow.high - narrow.low)
    assert wide.low < 0.75 and wide.high == pytest.approx(1.0, abs=0.01)


def test_frames_of_one_run_count_once_where_nothing_is_wrong():
    """Ten markers right throughout 1000 frames prove as much as ten labels, not as ten thousand."""
    out = ConfidenceTally()
    out.add(np.full((1000, 10), 0.95), np.ones((1000, 10), dtype=bool), np.ones((1000, 10), dtype=bool), "Ann")
    level = out.score().at(0.95)
    assert level.right == level.high == 1.0
    assert 0.75 < level.low < 0.9
    assert level.holds


def test_the_share_that_can_be_given_at_999_right():
    """Of 4000 labels the 2000 most confident have one error (99.95 %); the next 2000 are wrong every tenth time."""
    stated = np.repeat([0.999, 0.95], 2000)
    right = np.ones(4000, dtype=bool)
    right[0], right[2000::10] = False, False
    assert tally(stated, right).score().share_at_999 == pytest.approx(0.5)
    assert tally(stated, ~right).score().share_at_999 == 0.0
    assert tally(stated, np.ones(4000)).score().share_at_999 == 1.0


def test_no_label_has_no_score():
    empty = ConfidenceTally()
    empty.add(np.zeros((3, 2)), np.zeros((3, 2), dtype=bool), np.zeros((3, 2), dtype=bool))
    for out in (empty, ConfidenceTally()):
        score = out.score()
        assert score.labels == 0 and np.isnan(score.log_score) and score.levels == [] and not score.beats_constant


def test_labels_without_a_confidence_are_not_judged():
    score = tally([0.9, np.nan, 0.6], [1, 0, 1]).score()
    assert score.labels == 2 and score.constant_log_score == 0.0


@given(
    arrays(np.float64, st.tuples(st.integers(1, 30), st.integers(1, 4)), elements=st.floats(0, 1)),
    st.integers(0, 2**32 - 1),
    st.integers(1, 3),
)
def test_counts_add_up_over_recordings(confidence, seed, groups):
    """Two tallies together are the tally of all recordings, in any order."""
    rng = np.random.default_rng(seed)
    shown, right = rng.random(confidence.shape) < 0.8, rng.random(confidence.shape) < 0.7
    rows = np.array_split(np.arange(len(confidence)), groups)
    whole, parts = ConfidenceTally(), [ConfidenceTally() for _ in rows]
    for number, own in enumerate(rows):
        whole.add(confidence[own], shown[own], right[own], str(number % 2))
        parts[number].add(confidence[own], shown[own], right[own], str(number % 2))
    joined = ConfidenceTally()
    for part in parts:
        joined += part
    one, other = whole.score(), joined.score()
    assert one.labels == other.labels == shown.sum()
    assert one.levels == other.levels
    if one.labels:
        assert one.log_score == pytest.approx(other.log_score) and one.share_at_999 == other.share_at_999
        assert all(0 <= level.low <= level.right <= level.high <= 1 for level in one.levels)
