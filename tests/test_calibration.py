"""Confidence: monotone in the margin, honest on data with known chances, and never exactly sure."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism.labelling.evaluation import expected_calibration_error
from asterism.labelling.training.calibration import LARGEST, Calibration


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
