"""Where motion expects a marker that has no point, in numbers that can be done in the head."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from models import trained

from asterism.labelling.whole import short
from asterism.labelling.whole.short import ShortTrackletRules, expect_by_motion, label_short_points
from asterism.recording import NULL, Ints
from asterism.simulation import simulate_walks

RULES = ShortTrackletRules(acceleration=20.0, noise=0.003, max_spread=0.15)


def expected(seen: dict[int, list[int]], frames: int, rate: float = 100.0, wanted: Ints | None = None):
    """What is expected of markers that are seen in some frames, marker m at (t / 100, m, 1 - t / 100) m in frame t; a ghost beside them."""
    rows = [(t, m) for m, times in seen.items() for t in times]
    frame_of, label = np.array([*(t for t, _ in rows), 0]), np.array([*(m for _, m in rows), NULL])
    xyz = np.array([*((t / 100, m, 1 - t / 100) for t, m in rows), (9.0, 9.0, 9.0)])
    return expect_by_motion(xyz, frame_of, label, (frames, len(seen)), rate, RULES, wanted)


def test_a_marker_is_expected_on_the_line_between_its_neighbours_in_time() -> None:
    found = expected({0: [0, 1, 5, 6], 1: [0, 1, 2, 3, 4, 5, 6]}, 7)
    assert np.allclose(found.place[2:5, 0], [(t / 100, 0.0, 1 - t / 100) for t in (2, 3, 4)])
    # half of 20 m/s2 times 10 ms and 30 ms, or 20 ms and 20 ms; with 3 mm of noise
    assert found.spread[2:5, 0] == pytest.approx(np.hypot(0.003, [0.003, 0.004, 0.003]))
    shown = np.ones((7, 2), dtype=bool)
    shown[2:5, 0] = False
    assert np.isinf(found.spread[shown]).all(), "where a marker has its point, nothing is expected"


def test_before_the_first_and_after_the_last_point_nothing_is_expected() -> None:
    found = expected({0: [2, 3], 1: [0, 5]}, 6)
    assert np.isinf(found.spread[[0, 1, 4, 5], 0]).all()
    assert np.isfinite(found.spread[1:5, 1]).all()
    assert np.isfinite(found.place).all()


def test_some_frames_expect_what_all_frames_expect() -> None:
    seen = {0: [0, 1, 5, 6], 1: [0, 2, 3, 6], 2: [0, 6]}
    wanted = np.array([1, 2, 5])
    for some, every in zip(expected(seen, 7, wanted=wanted), expected(seen, 7), strict=True):
        np.testing.assert_array_equal(some, every[wanted])


def test_a_long_gap_expects_nothing_in_its_middle() -> None:
    """0.15 m at most: half of 20 m/s2 times the times to both ends is that at 0.1 s and 0.15 s."""
    found = expected({0: [0, 25]}, 26)
    near = np.isfinite(found.spread[:, 0])
    assert near[[1, 9, 16, 24]].all()
    assert not near[[10, 12, 15]].any()
    assert np.isfinite(expected({0: [0, 25]}, 26, rate=200.0).spread[1:25, 0]).all(), "at twice the rate the gap is half as long"


def test_few_frames_that_are_labelled_by_themselves_are_searched_longer(monkeypatch) -> None:
    walks = simulate_walks(subjects=3, frames=60, seed=2)
    labeller = trained(walks[:2], miner=None).body_labeller
    hasty = replace(labeller, settings=labeller.settings._replace(max_evaluations=10))
    clouds = walks[2].frames(slice(2)).clouds()
    none, every = np.full(30, NULL), np.ones(30, dtype=np.bool_)

    def labelled() -> int:
        return int((label_short_points(hasty, hasty.body, clouds, clouds.xyz, every, none, RULES).label != NULL).sum())

    assert labelled() == 30
    # Of many frames each has its share only.
    monkeypatch.setattr(short, "ALONE_EVALUATIONS", 20)
    assert labelled() == 0
