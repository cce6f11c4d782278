"""Confidence: monotone in the margin, honest on data with known chances, and never exactly sure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from models import SHORT, trained

from asterism.labelling import MarkerModel, TrainingRules
from asterism.labelling.evaluation import expected_calibration_error
from asterism.labelling.reliability import ConfidenceTally
from asterism.labelling.simulated_occlusions import simulate_occlusions
from asterism.labelling.training.calibration import (
    IN_FRAMES,
    IN_TIME,
    LARGEST,
    Calibration,
    LabelCalibration,
    LabelTrials,
    stream_curves_of_virtual,
)
from asterism.labelling.training.learning import least_confidence
from asterism.simulation import simulate_walks


def chance(margin):
    """The true share of right labels at a margin: a logistic curve from one third to one."""
    return (1.0 + 2.0 / (1.0 + np.exp(-(margin - 4.0) / 2.0))) / 3.0


def drawn(count, seed):
    rng = np.random.default_rng(seed)
    margin = rng.gamma(2.0, 4.0, count)
    return margin, rng.random(count) < chance(margin)


@given(seed=st.integers(0, 10_000), count=st.integers(1, 400), share=st.floats(0.0, 1.0))
@settings(max_examples=50, deadline=None)
def test_confidence_never_falls_with_the_margin_and_is_never_certain(seed, count, share):
    rng = np.random.default_rng(seed)
    curve = Calibration.fit(rng.normal(0.0, 30.0, count), rng.random(count) < share)
    said = curve.confidence(np.linspace(-2 * LARGEST, 2 * LARGEST, 999))
    assert (np.diff(said) >= -1e-12).all()
    assert (said >= 0.0).all() and (said < 1.0).all()


@pytest.mark.parametrize("seed", range(3))
def test_confidence_is_the_share_that_is_right(seed):
    curve = Calibration.fit(*drawn(20_000, seed))
    margin, right = drawn(20_000, seed + 100)
    error, _ = expected_calibration_error(curve.confidence(margin), right)
    assert error < 0.02, f"expected calibration error {error:.4f}, allowed 0.02"
    far = np.abs(curve.confidence(margin) - chance(margin))
    assert far.mean() < 0.02, f"mean distance from the true chance {far.mean():.4f}, allowed 0.02"


def test_a_curve_from_other_data_is_noticed():
    margin, right = drawn(20_000, 1)
    error, _ = expected_calibration_error(Calibration.fit(margin, np.ones(len(margin))).confidence(margin), right)
    assert error > 0.1


def test_rare_errors_among_sure_labels_are_told_from_none():
    """One wrong label in a thousand at margins from 5 to 15, none in ten thousand from 35 to 45."""
    rng = np.random.default_rng(0)
    margin = np.concatenate([rng.uniform(5.0, 15.0, 10_000), rng.uniform(35.0, 45.0, 10_000)])
    right = np.ones(20_000)
    right[:10_000:1000] = 0.0
    curve = Calibration.fit(margin, right)
    wrong = 1.0 - curve.confidence(margin)
    assert 0.5e-3 < wrong[:10_000].mean() < 1.5e-3
    assert wrong[10_000:].mean() < 1e-4


def test_the_confidence_is_flat_beyond_what_was_seen():
    curve = Calibration.fit(*drawn(5000, 3))
    assert curve.confidence(1e9) == curve.confidence(curve.margin[-1])
    assert curve.confidence(-np.inf) == curve.confidence(curve.margin[0])


def test_infinite_margins_are_learned_from_too():
    curve = Calibration.fit([np.inf] * 50 + [-np.inf] * 50, [1] * 50 + [0] * 50)
    assert curve.confidence(LARGEST) > 0.75
    assert curve.confidence(-LARGEST) < 0.25


def test_all_right_is_not_certainty_and_grows_with_the_evidence():
    few, many = (Calibration.fit(np.linspace(0, 30, n), np.ones(n)).confidence(30.0) for n in (20, 2000))
    assert few < many < 1.0


def test_all_wrong_is_no_confidence():
    assert Calibration.fit(np.linspace(0, 30, 100), np.zeros(100)).confidence(30.0) < 0.05


def test_nothing_to_learn_from_gives_one_half():
    assert Calibration.fit([], []).confidence([-5.0, 0.0, 50.0]).tolist() == [0.5, 0.5, 0.5]


# From margin and fit


def true_chance(margin, fit, left_over):
    """Where points are left over a poor fit betrays a ghost; elsewhere only the margin counts."""
    return 1.0 / (1.0 + np.exp(-(0.4 * np.clip(margin, -5, 10) + left_over * 0.5 * np.clip(fit, -8, 0))))


def drawn_labels(count, seed):
    rng = np.random.default_rng(seed)
    margin, fit, left_over = rng.gamma(2.0, 4.0, count), rng.normal(1.0, 3.0, count), rng.integers(0, 2, count)
    return LabelTrials(margin, fit, left_over, (rng.random(count) < true_chance(margin, fit, left_over)).astype(float), np.ones(count))


def test_margin_and_fit_say_what_share_is_right():
    """20,000 trials of 200 people: the confidence of 20,000 other labels, by level, and against the best constant."""
    curve, other = LabelCalibration.fitted(drawn_labels(20_000, 1), 200, IN_FRAMES), drawn_labels(20_000, 2)
    stated = curve.confidence(other.margin, other.fit, other.left_over)
    far = np.abs(stated - true_chance(other.margin, other.fit, other.left_over)).mean()
    assert far < 0.02, f"mean distance from the true chance {far:.4f}, allowed 0.02"
    tally = ConfidenceTally()
    tally.add(stated[:, None], np.ones((20_000, 1), dtype=bool), other.right[:, None] > 0)
    score = tally.score()
    assert score.beats_constant and score.log_score < 0.8 * score.constant_log_score
    assert all(abs(level.confidence - level.right) < 0.02 for level in score.levels)


def test_the_fit_is_used_where_points_are_left_over():
    curve = LabelCalibration.fitted(drawn_labels(20_000, 3), 200, IN_FRAMES)
    poor, good = (curve.confidence(10.0, fit, 1) for fit in (-8.0, 0.0))
    assert poor < 0.7 < 0.95 < good
    assert curve.confidence(10.0, -8.0, 0) > 0.95


def test_labels_of_a_long_recording_are_each_as_certain_as_alone():
    """150,000 labels, more than are held at once, as a table and one by one."""
    curve, many = LabelCalibration.fitted(drawn_labels(2000, 5), 10, IN_TIME), drawn_labels(150_000, 6)
    table = [values.reshape(1000, 150) for values in (many.margin, many.fit, many.left_over)]
    stated = curve.confidence(*table)
    assert stated.shape == (1000, 150)
    for place in ((0, 0), (436, 135), (436, 136), (436, 137), (873, 122), (999, 149)):
        assert stated[place] == curve.confidence(*(values[place] for values in table))


@given(seed=st.integers(0, 10_000), count=st.integers(0, 300), people=st.integers(1, 20), share=st.floats(0.0, 1.0))
@settings(max_examples=40, deadline=None)
def test_confidence_never_falls_with_margin_or_fit(seed, count, people, share):
    rng = np.random.default_rng(seed)
    trials = LabelTrials(
        rng.normal(0, 20, count),
        rng.normal(0, 6, count),
        rng.integers(0, 2, count),
        (rng.random(count) < share).astype(float),
        np.ones(count),
    )
    curve = LabelCalibration.fitted(trials, people, IN_TIME)
    ramp = np.linspace(-100.0, 100.0, 401)
    for side in (0, 1):
        for said in (
            curve.confidence(ramp, np.full(401, 1.0), np.full(401, side)),
            curve.confidence(np.full(401, 8.0), ramp, np.full(401, side)),
        ):
            assert (np.diff(said) >= -1e-12).all() and (said >= 0).all() and (said <= 1).all()


def test_trials_of_more_people_count_more():
    trials = drawn_labels(200, 4)
    shares = [LabelCalibration.fitted(trials, people, IN_FRAMES).share for people in (1, 2, 5, 10)]
    assert shares == sorted(shares) and shares[0] < 0.5 < shares[-1] < 1.0
    nothing = LabelCalibration.fitted(LabelTrials.together([]), 3, IN_FRAMES)
    assert nothing.confidence(-10.0, 0.0, 0) < 0.5 and nothing.confidence(30.0, 2.0, 0) > 0.99


def test_a_wrong_label_of_a_simulated_walk_is_said(tmp_path):
    """Walkers whom the model does not know, ghosts beside hidden markers: the confidence knows more of wrong labels than any constant."""
    walks = simulate_walks(subjects=4, frames=60, markers="helen-hayes", seed=5)
    model = trained(walks[:3], seed=0, subjects=["a", "b", "c"], training=replace(SHORT, trials=TrainingRules().trials, folds=3))
    tally = ConfidenceTally()
    for seed in range(3):
        clouds, truth = simulate_occlusions(walks[3], 3, 3, seed)
        labelling = model.label_frames(clouds)
        tally.add(labelling.confidence, labelling.indices >= 0, labelling.indices == truth)
    score = tally.score()
    assert score.constant_log_score > 0, "no label is wrong: nothing to say"
    assert score.beats_constant
    model.save(tmp_path / "a.model")
    again = MarkerModel.load(tmp_path / "a.model").label_frames(clouds)
    np.testing.assert_array_equal(again.confidence, labelling.confidence)


def test_streams_of_virtual_people_give_what_is_likely_and_call_nothing_sure():
    """As often right as they say, see `VIRTUAL_IN_STREAMS`. A level stretch of the curve had kept back every fifth right label."""
    given = least_confidence(0.999)
    for curve, likely in zip(stream_curves_of_virtual(), (5.0, 8.5), strict=True):
        stated = curve.confidence(np.arange(-30.0, 60.0, 0.5))
        assert (np.diff(stated) >= 0.0).all()
        assert curve.confidence(0.0) < 0.5
        assert curve.confidence(likely - 1.0) < given < curve.confidence(likely)
        assert 0.95 < stated[-1] < 0.99
