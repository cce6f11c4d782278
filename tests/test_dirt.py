"""The guarantee in clutter: the whole recording has as many right and no more wrong than its frames, and the clutter of the benchmarks."""

from __future__ import annotations

import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from models import trained

import asterism
from asterism.labelling.whole.short import ShortTrackletRules, long_points
from asterism.recording import NULL, Clouds, Ints, Labelling, MarkerSet, Recording
from asterism.simulation import Clutter, add_clutter, displace_marker, simulate_gaps_and_ghosts, simulate_walks
from asterism.tracking.linking import Tracklets

sys.path.insert(0, str(Path(__file__).parents[1]))
accuracy, walks_of, figures = (import_module(f"benchmarks.{name}") for name in ("recordings.gaps", "recordings.walks", "figures"))

ALLOWED = 0.001
"""Share of markers that the whole recording may lose, or label wrongly, against its frames."""


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    return simulate_walks(subjects=5, frames=120, seed=4)


@pytest.fixture(scope="module")
def ensemble(walks: list[Recording]) -> asterism.MarkerModel:
    return trained(walks[:4], miner=None)


def in_clutter(walk: Recording, clutter: Clutter, hidden: int, seed: int, number_tracks: bool = True) -> tuple[Clouds, Ints]:
    clouds, truth = simulate_gaps_and_ghosts(walk, hidden, 0, seed=seed, number_tracks=number_tracks)
    return add_clutter(walk, clouds, truth, clutter, seed=seed)


def rates(labelling: Labelling, truth: Ints) -> tuple[float, float]:
    """Share of the markers in view that are right, and of the labels given that are wrong."""
    given_, right = labelling.indices != NULL, (labelling.indices == truth) & (truth != NULL)
    return right.sum() / (truth != NULL).sum(), 1.0 - right.sum() / max(1, given_.sum())


@pytest.mark.parametrize("number_tracks", [True, False], ids=["numbered", "bare"])
@pytest.mark.parametrize(
    ("clutter", "hidden"),
    [
        (Clutter(3.0, 1, "beside", 0.08), 0),
        (Clutter(3.0, 1, "beside", 0.03), 3),
        (Clutter(3.0, 3, "beside", 0.03), 3),
        (Clutter(1.0, 25, "beside", 0.03), 2),
        (Clutter(30.0, 1, "fixed"), 3),
        (Clutter(3.0, None, "fixed"), 5),
        (Clutter(3.0, 50, "crossing"), 1),
    ],
    ids=["flicker", "flicker near", "three frames", "riding", "volume", "reflections", "crossing"],
)
def test_the_whole_recording_is_never_worse_than_its_frames(
    ensemble: asterism.MarkerModel, walks: list[Recording], clutter: Clutter, hidden: int, number_tracks: bool
) -> None:
    clouds, truth = in_clutter(walks[4], clutter, hidden, 7, number_tracks)
    right, wrong = rates(ensemble.label(clouds), truth)
    own_right, own_wrong = rates(ensemble.label_frames(clouds), truth)
    assert right >= own_right - ALLOWED, f"{100 * right:.2f} % right, frame by frame {100 * own_right:.2f} %"
    assert wrong <= own_wrong + ALLOWED, f"{100 * wrong:.2f} % wrong, frame by frame {100 * own_wrong:.2f} %"
    assert right > 0.9, "neither finds the markers"


@pytest.mark.parametrize(
    ("markers", "seen", "ghosts", "long"),
    [(15, 100, 30, 15), (15, 100, 3, 18), (45, 100, 0, 45), (15, 10, 30, 45)],
    ids=["crowd", "few ghosts", "a person with more markers", "markers in pieces"],
)
def test_ghosts_that_last_are_short_only_where_they_crowd_round_long_paths(markers: int, seen: int, ghosts: int, long: int) -> None:
    """100 frames of markers that are seen for so many frames at a time, and of ghosts of 10 frames; a model of 15 markers."""
    piece = np.concatenate([np.full(markers, seen), np.full(ghosts, 10)])
    number = np.arange(len(piece)) * 100 + np.arange(100)[:, None] // piece
    _, of_point = np.unique(number.ravel(), return_inverse=True)
    frame = np.repeat(np.arange(100), len(piece))
    first, last = np.full(of_point.max() + 1, 100), np.zeros(of_point.max() + 1, dtype=np.int64)
    np.minimum.at(first, of_point, frame)
    np.maximum.at(last, of_point, frame)
    clouds = Clouds.from_points([np.zeros((len(piece), 3))] * 100, 100.0)
    assert long_points(clouds, Tracklets(of_point, first, last), 15, ShortTrackletRules()).sum() == 100 * long


def test_an_oddly_worn_marker_costs_no_other_marker(ensemble: asterism.MarkerModel, walks: list[Recording]) -> None:
    moved, name = displace_marker(walks[4], MarkerSet.load("helen-hayes"), (0.04, 0.04), seed=2)
    clouds, truth = simulate_gaps_and_ghosts(moved, 0, 0, seed=1)
    labelling = ensemble.label(clouds)
    others = np.array(labelling.names) != name
    assert (labelling.indices == truth)[:, others].mean() > 0.99
    given_ = labelling.indices[:, ~others] != NULL
    assert (labelling.indices == truth)[:, ~others][given_].all(), "another point has its name"


@settings(max_examples=10)
@given(
    per_frame=st.sampled_from([1.0, 5.0]),
    life=st.sampled_from([1, 3, 20, None]),
    place=st.sampled_from(["beside", "fixed", "crossing"]),
    number_tracks=st.booleans(),
    seed=st.integers(0, 1000),
)
def test_the_order_of_the_points_plays_no_part_in_clutter(
    ensemble: asterism.MarkerModel,
    walks: list[Recording],
    per_frame: float,
    life: int | None,
    place: str,
    number_tracks: bool,
    seed: int,
) -> None:
    walk = walks[4].frames(slice(0, 60))
    clouds, _ = in_clutter(walk, Clutter(per_frame, life, place, 0.03), 2, seed, number_tracks)
    order = np.lexsort((np.random.default_rng(seed).random(len(clouds.xyz)), clouds.frame_of))
    tracks = None if clouds.tracks is None else clouds.tracks[order]
    shuffled = replace(clouds, xyz=clouds.xyz[order], columns=clouds.columns[order], tracks=tracks)
    one, other = ensemble.label(clouds), ensemble.label(shuffled)
    assert np.array_equal(one.positions(clouds), other.positions(shuffled), equal_nan=True)
    assert np.array_equal(one.confidence, other.confidence)


def test_the_same_clouds_in_every_run_and_a_person_wears_one_marker_oddly_in_all_walks() -> None:
    walk = simulate_walks(subjects=1, frames=50, seed=1)[0]
    condition = walks_of.Condition(2, 1, Clutter(2.0), displaced=True)
    one, same, other = (
        walks_of.sample(walk, condition, 3, 1),
        walks_of.sample(walk, condition, 3, 1),
        walks_of.sample(walk, condition, 4, 1),
    )
    np.testing.assert_array_equal(one.clouds.xyz, same.clouds.xyz)
    np.testing.assert_array_equal(one.walk.positions, other.walk.positions)
    assert not np.array_equal(one.clouds.xyz, other.clouds.xyz)
    shown = one.truth != NULL
    points = one.clouds.xyz[(one.clouds.offsets[:-1, None] + one.truth)[shown]]
    np.testing.assert_array_equal(points, one.walk.positions[shown])
    assert (one.walk.positions != walk.positions).any(axis=2).all(axis=0).sum() == 1


def test_a_recording_that_is_refused_counts_as_unlabelled(ensemble: asterism.MarkerModel, walks: list[Recording]) -> None:
    class Refusing:
        marker_set = ensemble.marker_set

        def label(self, clouds: Clouds) -> Labelling:
            raise asterism.AsterismError("two people")

    clouds, truth = simulate_gaps_and_ghosts(walks[4], 0, 0)
    labelling = walks_of.label_whole(Refusing(), clouds, truth)
    assert labelling.indices.shape == truth.shape and (labelling.indices == NULL).all()


def test_what_is_asked_is_asked_of_conditions_that_are_measured() -> None:
    conditions = {f"clutter, {name}" for name in accuracy.FLICKER} | {f"gaps, {name}" for name in accuracy.GAPS}
    assert set(accuracy.ASKED) == {*conditions, "59 markers, 3 hidden"}
    assert all(figures.reached(asked, 0.5) is not None for pair in accuracy.ASKED.values() for asked in pair)
