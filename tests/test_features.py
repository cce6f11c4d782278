"""The registry of features, the pool over all subsets, and the kernels against their plain twins."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
import twins
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism import AsterismError
from asterism.labelling.features import feature_kernels
from asterism.labelling.features.motion_kernels import G9, G10, G18, WIDTH
from asterism.labelling.features.registry import FEATURES, TEMPORAL, describe, feature_pool, markers_read, needs_motion

pytestmark = pytest.mark.kernels

coordinates = st.floats(-2.0, 2.0, allow_nan=False).map(lambda x: round(x, 3))
four_moving_points = st.integers(0, 10**6).map(lambda seed: np.round(np.random.default_rng(seed).uniform(-2, 2, (4, WIDTH)), 3))
four_points = st.lists(st.tuples(coordinates, coordinates, coordinates), min_size=4, max_size=4, unique=True).map(np.array)


def test_registry_is_in_the_kernels_order():
    assert [feature.name for feature in FEATURES] == [f"g{i}" for i in (*range(1, 9), 19, *range(10, 19), 9)]
    kernels = feature_kernels
    assert (kernels.G1, kernels.G2, kernels.G19, kernels.LAST_INLINED, G10, G18, G9) == (0, 1, 8, 8, 9, 17, 18)
    assert tuple(f"g{i}" for i in range(10, 19)) == TEMPORAL
    assert [needs_motion(np.array([kind])) for kind in range(19)] == [False] * 9 + [True] * 9 + [False]


@pytest.mark.parametrize("kind", range(len(FEATURES)), ids=[feature.name for feature in FEATURES])
@given(points=four_points, moving=four_moving_points)
@settings(max_examples=60, deadline=None)
def test_kernel_equals_twin(kind, points, moving):
    if np.linalg.norm(points[:, None] - points[None], axis=2)[np.triu_indices(4, 1)].min() < 1e-2:
        return
    if FEATURES[kind].moving:
        points = np.concatenate([points, moving[:, 3:]], axis=1)
    expected = twins.feature(FEATURES[kind].name, list(points))
    # Near 0 and pi an angle is only as good as the root of the cosine's rounding.
    assert feature_kernels.feature_value(kind, points, 0, 1, 2, 3) == pytest.approx(expected, abs=1e-6)


def test_pool_of_the_thesis_has_665():
    kinds, slots = feature_pool(15, ("g2", "g4", "g9"))
    assert len(kinds) == 665 == 105 + 105 + 455
    assert slots.shape == (665, 4)


@pytest.mark.parametrize(
    ("name", "count"),
    [("g1", 30), ("g2", 10), ("g3", 15), ("g4", 10), ("g5", 30), ("g6", 15), ("g7", 10), ("g8", 10), ("g13", 10), ("g18", 10)],
)
def test_pool_sizes_of_five_markers(name, count):
    assert len(feature_pool(5, (name,))[0]) == count


@pytest.mark.parametrize("feature", FEATURES, ids=lambda feature: feature.name)
def test_arrangements_are_all_there_is_and_none_twice(feature):
    """Over all orders of a subset's points there are as many values, up to sign and the angle's supplement, as arrangements."""
    points = np.random.default_rng(1).normal(size=(4, WIDTH))

    def essence(order):
        value = twins.feature(feature.name, [points[i] for i in order])
        if feature.name in ("g6", "g7"):
            value = np.cos(value)
        return round(min(abs(value), 1 / abs(value)) if feature.name == "g5" else abs(value), 9)

    values = {essence(order) for order in permutations(range(feature.points))}
    listed = [essence(order) for order in feature.arrangements]
    assert len(set(listed)) == len(listed)
    assert set(listed) == values


def test_many_markers_sample_four_point_features():
    kinds, slots = feature_pool(30, ("g2", "g3"), seed=3)
    assert (kinds == 1).sum() == 435
    assert 15_000 < (kinds == 2).sum() <= 20_000
    again = feature_pool(30, ("g2", "g3"), seed=3)
    assert np.array_equal(slots, again[1])
    assert all(len(set(row)) == 4 for row in slots[kinds == 2][:200].tolist())


@pytest.mark.parametrize(("kind", "of_double_size"), [(feature_kernels.G19, 4.0), (G9, 1.0)], ids=["g19", "g9"])
def test_g9_and_g19_tell_a_body_from_its_mirror_image(kind, of_double_size):
    """Only g19 counts the size of the triangle."""
    points = np.array([[0.0, 0, 1], [1.0, 0, 1], [0.0, 1, 1]])
    mirrored = points * [-1, 1, 1]
    assert feature_kernels.feature_value(kind, points, 0, 1, 2, 0) == pytest.approx(1.0)
    assert feature_kernels.feature_value(kind, mirrored, 0, 1, 2, 0) == pytest.approx(-1.0)
    assert feature_kernels.feature_value(kind, 2.0 * points, 0, 1, 2, 0) == pytest.approx(of_double_size)


@pytest.mark.parametrize("kind", range(len(FEATURES)), ids=[feature.name for feature in FEATURES])
def test_missing_point_gives_nan_and_coincident_points_a_number(kind):
    points = np.random.default_rng(0).normal(size=(4, WIDTH))
    points[1] = np.nan
    assert np.isnan(feature_kernels.feature_value(kind, points, 0, 1, 2, 3))
    assert np.isfinite(feature_kernels.feature_value(kind, np.ones((4, WIDTH)), 0, 1, 2, 3))


def test_unknown_or_repeated_feature_is_refused():
    with pytest.raises(AsterismError, match="g20"):
        feature_pool(5, ("g2", "g20"))
    with pytest.raises(AsterismError, match="once"):
        feature_pool(5, ("g2", "g2"))


def test_members_and_words():
    kinds, slots = feature_pool(4, ("g4", "g9"))
    reads = markers_read(kinds, slots, 4)
    assert reads.sum(axis=1).tolist() == [2] * 6 + [3] * 4
    assert describe(kinds[0], slots[0], ["A", "B", "C", "D"]) == "height difference (A, B)"
