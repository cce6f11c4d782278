"""Labelled, likely, unsure, hidden: one definition for all commands."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from asterism.recording import SURE, Clouds, Labelling, label_shares, label_states

NAMES = ("LKNE", "RKNE", "SACR")


def _frame(points: int, indices: list[int], confidence: list[float]) -> tuple[Labelling, Clouds]:
    clouds = Clouds.from_points([np.arange(3.0 * points).reshape(points, 3)], rate=100.0)
    return Labelling(np.array([indices]), np.array([confidence]), NAMES), clouds


@pytest.mark.parametrize(
    ("points", "indices", "confidence", "expected"),
    [
        (3, [0, 1, 2], [1.0, SURE, 0.5], (2, 1, 0, 0)),
        (3, [0, -1, -1], [1.0, 0.4, 0.4], (1, 0, 2, 0)),
        (3, [0, -1, -1], [1.0, 0.4, 0.001], (1, 0, 1, 1)),
        (3, [0, -1, -1], [1.0, np.nan, 0.02], (1, 0, 2, 0)),
        (3, [-1, -1, -1], [0.0, 0.0, 0.0], (0, 0, 3, 0)),
        (1, [0, -1, -1], [0.98, 0.0, 0.0], (0, 1, 0, 2)),
        (0, [-1, -1, -1], [0.0, 0.0, 0.0], (0, 0, 0, 3)),
        (2, [0, 1, -1], [np.nan, 0.999, np.nan], (1, 1, 0, 1)),
    ],
    ids=[
        "by-confidence",
        "points-left",
        "ghost-left",
        "unknown-chance",
        "nothing-labelled",
        "no-point-left",
        "empty-frame",
        "unknown-confidence",
    ],
)
def test_a_marker_is_one_of_four_things(points: int, indices: list[int], confidence: list[float], expected: tuple[int, ...]) -> None:
    shares = label_shares(*_frame(points, indices, confidence))
    np.testing.assert_allclose(tuple(vars(shares).values()), np.array(expected) / 3)


def test_no_frames_have_no_shares() -> None:
    clouds = Clouds.from_points([], rate=100.0)
    shares = label_shares(Labelling(np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3)), NAMES), clouds)
    assert np.isnan(list(vars(shares).values())).all()


@given(st.integers(0, 2**32 - 1))
def test_the_four_leave_no_marker_out_and_overlap_nowhere(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, indices = [], []
    for _ in range(5):
        count = int(rng.integers(0, 5))
        points.append(rng.normal(size=(count, 3)))
        order = rng.permutation(max(count, 3))[:3]
        indices.append(np.where((order < count) & (rng.random(3) < 0.7), order, -1))
    labelling = Labelling(np.array(indices), rng.random((5, 3)), NAMES)
    states = label_states(labelling, Clouds.from_points(points, rate=100.0))
    np.testing.assert_array_equal(sum(state.astype(int) for state in vars(states).values()), 1)
    assert (states.labelled <= (labelling.confidence >= SURE)).all()
