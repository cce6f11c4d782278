"""Clutter: as many points as asked, as long and where asked, the truth true, tracks whole; and markers worn oddly."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ground_truth import owners
from hypothesis import given
from hypothesis import strategies as st

import asterism
from asterism.errors import AsterismError
from asterism.labelling.simulated_clutter import CROSSING_SPEED
from asterism.recording import NULL, Clouds, Ints, MarkerSet, Recording
from asterism.simulation import Clutter, add_clutter, displace_marker, simulate_gaps_and_ghosts, simulate_walks

RATE = 100.0
LEGS = MarkerSet(("hip", "knee", "ankle", "heel", "head"), segments={"thigh": ("hip", "knee"), "shank": ("knee", "ankle", "heel")})


def recording_of(frames: int, markers: int, seed: int = 0, missing: float = 0.0) -> Recording:
    """Markers 0.3 m apart in a row along x that drift together at 1 m/s along y, some missing for a quarter of a second."""
    positions = np.zeros((frames, markers, 3)) + np.arange(markers)[:, None] * [0.3, 0.0, 0.1]
    positions = positions + np.arange(frames)[:, None, None] / RATE * [0.0, 1.0, 0.0]
    away = np.random.default_rng(seed).random((frames // 25 + 1, markers)) < missing
    positions[np.repeat(away, 25, axis=0)[:frames]] = np.nan
    return Recording(positions, tuple(f"m{i}" for i in range(markers)), RATE)


def cluttered(recording: Recording, clutter: Clutter, seed: int = 0, hidden: int = 0, number_tracks: bool = True) -> tuple[Clouds, Ints]:
    clouds, truth = simulate_gaps_and_ghosts(recording, hidden, 0, seed=seed, number_tracks=number_tracks)
    return add_clutter(recording, clouds, truth, clutter, seed=seed + 1)


kinds = st.builds(
    Clutter,
    per_frame=st.sampled_from([0.0, 0.3, 2.0, 9.0]),
    life=st.sampled_from([None, 1, 2, 7, 1000]),
    place=st.sampled_from(["beside", "fixed", "crossing"]),
    spread=st.sampled_from([0.0, 0.03, 0.15]),
)


@given(
    clutter=kinds,
    frames=st.integers(0, 120),
    markers=st.integers(0, 8),
    missing=st.sampled_from([0.0, 0.3, 1.0]),
    hidden=st.integers(0, 8),
    seed=st.integers(0, 2**32 - 1),
)
def test_markers_stay_and_each_track_of_the_clutter_is_whole(
    clutter: Clutter, frames: int, markers: int, missing: float, hidden: int, seed: int
) -> None:
    recording = recording_of(frames, markers, seed % 97, missing)
    before, was = simulate_gaps_and_ghosts(recording, min(hidden, markers), 0, seed=seed)
    clouds, truth = add_clutter(recording, before, was, clutter, seed=seed)
    assert len(clouds) == frames and clouds.xyz.shape == (clouds.offsets[-1], 3) and np.isfinite(clouds.xyz).all()
    np.testing.assert_array_equal(truth != NULL, was != NULL)
    owner = owners(recording, clouds, truth)
    assert (clouds.columns == -1).all() and clouds.rate == recording.rate
    at, marker = np.nonzero(truth != NULL)
    old, new = before.tracks[before.offsets[at] + was[at, marker]], clouds.tracks[clouds.offsets[at] + truth[at, marker]]
    assert len(set(zip(old, new, strict=True))) == len(set(old)) == len(set(new)), "a marker's track was cut or joined"
    for track in np.unique(clouds.tracks[owner < 0]):
        points = np.nonzero(clouds.tracks == track)[0]
        assert (owner[points] < 0).all(), "a track joins clutter and a marker"
        there = clouds.frame_of[points]
        assert (np.diff(there) >= 1).all(), "two points of a track in one frame"
        assert np.ptp(there) < (frames if clutter.life is None else clutter.life)


@pytest.mark.parametrize("place", ["beside", "fixed", "crossing"])
@pytest.mark.parametrize(("per_frame", "life"), [(3.0, 1), (3.0, 3), (0.5, 20), (30.0, 1)])
def test_there_are_as_many_as_asked_from_the_first_frame_to_the_last(place: str, per_frame: float, life: int) -> None:
    recording = recording_of(4000, 6)
    clouds, _ = cluttered(recording, Clutter(per_frame, life, place))
    extra = clouds.counts - 6
    independent = 4000 / life
    assert abs(extra.mean() - per_frame) < 4 * np.sqrt(per_frame / independent)
    for part in (extra[: 20 * life], extra[-20 * life :]):
        assert abs(part.mean() - per_frame) < 5 * np.sqrt(per_frame / 20), "thinner at an end of the recording"
    assert abs(extra.var() / per_frame - 1) < 0.5, "the numbers of points are not Poisson distributed"


@pytest.mark.parametrize("life", [1, 3, 20])
def test_each_lives_as_long_as_asked(life: int) -> None:
    recording = recording_of(500, 4)
    clouds, truth = cluttered(recording, Clutter(2.0, life))
    mine = owners(recording, clouds, truth) < 0
    lasted = np.bincount(clouds.tracks[mine])
    inner = [n for track, n in enumerate(lasted) if n and not {0, 499} & set(clouds.frame_of[clouds.tracks == track])]
    assert set(inner) == {life}


def test_a_life_of_the_whole_recording_is_all_its_frames() -> None:
    recording = recording_of(300, 4)
    numbers = []
    for seed in range(200):
        clouds, truth = cluttered(recording.frames(slice(0, 3)), Clutter(2.0, None, "fixed"), seed)
        assert len(set(clouds.counts)) == 1
        numbers.append(clouds.counts[0] - 4)
    assert abs(np.mean(numbers) - 2) < 0.4 and np.std(numbers) > 1, "not Poisson distributed"
    clouds, truth = cluttered(recording, Clutter(4.0, None, "fixed"), 5)
    assert (clouds.counts == clouds.counts[0]).all() and clouds.counts[0] > 4
    mine = owners(recording, clouds, truth) < 0
    for track in np.unique(clouds.tracks[mine]):
        assert np.ptp(clouds.xyz[clouds.tracks == track], axis=0).max() == 0, "a reflection does not move"


def test_points_beside_a_marker_lie_as_far_as_asked_from_any_marker_in_view_and_go_with_it() -> None:
    recording = recording_of(3000, 5)
    clouds, truth = cluttered(recording, Clutter(3.0, 5, "beside", 0.03), hidden=2)
    mine = owners(recording, clouds, truth) < 0
    offset = clouds.xyz[mine, None] - recording.positions[clouds.frame_of[mine]]
    nearest = np.linalg.norm(offset, axis=2).argmin(axis=1)
    own = offset[np.arange(len(offset)), nearest]
    assert np.abs(own.std(axis=0) - 0.03).max() < 0.002 and np.abs(own.mean(axis=0)).max() < 0.002
    assert np.abs(np.bincount(nearest) / len(nearest) - 0.2).max() < 0.05
    tracks, frame = clouds.tracks[mine], clouds.frame_of[mine]
    for track in np.unique(tracks)[:200]:
        one = tracks == track
        assert len(set(nearest[one])) == 1
        assert np.ptp(own[one], axis=0).max() < 1e-9
        assert (truth[frame[one].min(), nearest[one][0]] != NULL) or frame[one].min() == 0, "it began beside a marker that was hidden"


def test_points_in_the_volume_fill_the_box_of_the_markers_and_those_that_cross_go_their_way() -> None:
    recording = recording_of(1000, 5)
    for place, speed in (("fixed", 0.0), ("crossing", CROSSING_SPEED)):
        clouds, truth = cluttered(recording, Clutter(6.0, 11, place))
        mine = owners(recording, clouds, truth) < 0
        tracks, places = clouds.tracks[mine], clouds.xyz[mine]
        middles, headings = [], []
        for track in np.unique(tracks):
            path = places[tracks == track]
            if len(path) == 11:
                np.testing.assert_allclose(np.linalg.norm(np.diff(path, axis=0), axis=1) * RATE, speed, atol=1e-9)
                assert np.ptp(path[:, 2]) < 1e-12, "it rises"
                middles.append(path[5])
                headings.append(np.arctan2(*(path[-1] - path[0])[:2]))
        middles = np.array(middles)
        low, high = recording.positions.min(axis=(0, 1)), recording.positions.max(axis=(0, 1))
        assert (middles >= low - 1e-9).all() and (middles <= high + 1e-9).all()
        share = (middles - low) / (high - low)
        assert np.abs(share.mean(axis=0) - 0.5).max() < 0.05 and np.abs(share.std(axis=0) - np.sqrt(1 / 12)).max() < 0.03
        if speed:
            assert np.abs(np.histogram(headings, 4, (-np.pi, np.pi))[0] / len(headings) - 0.25).max() < 0.08


def test_same_seed_same_bits_and_other_seeds_other_points() -> None:
    recording = recording_of(200, 6)
    one, truth = cluttered(recording, Clutter(2.0, 3), seed=4)
    same, same_truth = cluttered(recording, Clutter(2.0, 3), seed=4)
    bare, bare_truth = cluttered(recording, Clutter(2.0, 3), seed=4, number_tracks=False)
    other, _ = cluttered(recording, Clutter(2.0, 3), seed=5)
    assert bare.tracks is None
    for clouds in (same, bare):
        np.testing.assert_array_equal(clouds.xyz, one.xyz)
    np.testing.assert_array_equal(same.tracks, one.tracks)
    assert np.array_equal(truth, same_truth) and np.array_equal(truth, bare_truth)
    assert not np.array_equal(other.xyz, one.xyz)


def test_neither_order_nor_numbers_tell_what_is_clutter() -> None:
    recording = recording_of(3000, 6)
    clouds, truth = cluttered(recording, Clutter(6.0, 3), hidden=2)
    mine = owners(recording, clouds, truth) < 0
    place = np.arange(len(mine)) - np.repeat(clouds.offsets[:-1], clouds.counts)
    middle = (place + 0.5) / np.repeat(clouds.counts, clouds.counts)
    assert abs(middle[mine].mean() - middle[~mine].mean()) < 0.02
    tracks = [np.unique(clouds.tracks[which]) for which in (mine, ~mine)]
    assert abs(tracks[0].mean() - tracks[1].mean()) < 0.1 * clouds.tracks.max()
    assert sorted(np.concatenate(tracks)) == list(range(clouds.tracks.max() + 1))


def test_points_without_a_number_stay_without_one() -> None:
    recording = recording_of(50, 4)
    clouds, truth = simulate_gaps_and_ghosts(recording, 0, 0, seed=0)
    some = replace(clouds, tracks=np.where(clouds.tracks == 2, -1, clouds.tracks))
    after, moved = add_clutter(recording, some, truth, Clutter(2.0), seed=0)
    assert (after.tracks == -1).sum() == (some.tracks == -1).sum()
    marker = np.nonzero((some.tracks[some.offsets[:-1, None] + truth] == -1).all(axis=0))[0]
    assert (after.tracks[after.offsets[:-1, None] + moved[:, marker]] == -1).all()


def test_frames_without_a_marker_get_nothing_beside_it_and_empty_recordings_stay_empty() -> None:
    recording = recording_of(60, 3)
    positions = recording.positions.copy()
    positions[20:40] = np.nan
    clouds, truth = cluttered(replace(recording, positions=positions), Clutter(3.0, 1))
    assert (clouds.counts[20:40] == 0).all() and (clouds.counts[:20] >= 3).all() and (truth[20:40] == NULL).all()
    clouds, _ = cluttered(replace(recording, positions=positions), Clutter(3.0, 1, "fixed"))
    assert clouds.counts[20:40].sum() > 0, "a reflection needs no marker"
    for place in ("beside", "fixed", "crossing"):
        for frames, markers in ((0, 3), (0, 0), (4, 0)):
            clouds, truth = cluttered(recording_of(frames, markers), Clutter(3.0, None, place))
            assert len(clouds) == frames and truth.shape == (frames, markers) and len(clouds.xyz) == 0
        clouds, _ = cluttered(recording_of(40, 3, missing=1.0), Clutter(3.0, 2, place))
        assert len(clouds.xyz) == 0, "where no marker was ever seen there is no volume"


@pytest.mark.parametrize(
    "wrong",
    [
        {"per_frame": -1.0},
        {"per_frame": float("nan")},
        {"per_frame": float("inf")},
        {"per_frame": 1.0, "life": 0},
        {"per_frame": 1.0, "life": 2.5},
        {"per_frame": 1.0, "life": float("inf")},
        {"per_frame": 1.0, "spread": -0.1},
        {"per_frame": 1.0, "spread": float("nan")},
    ],
)
def test_clutter_that_cannot_be_drawn_is_named(wrong: dict) -> None:
    with pytest.raises(AsterismError, match="cannot be drawn"):
        Clutter(**wrong)


def test_places_and_clouds_that_do_not_go_together_are_named() -> None:
    with pytest.raises(AsterismError, match="no place 'above'"):
        Clutter(1.0, 1, "above")
    recording = recording_of(20, 4)
    clouds, truth = simulate_gaps_and_ghosts(recording, 0, 0, seed=0)
    for one, other, labels in (
        (recording.frames(slice(0, 10)), clouds, truth),
        (recording, clouds.frames(slice(0, 10)), truth),
        (recording, clouds, truth[:10]),
        (recording, clouds, truth[:, :3]),
    ):
        with pytest.raises(AsterismError, match="give those of one recording"):
            add_clutter(one, other, labels, Clutter(1.0))


def test_a_displaced_marker_moves_along_its_segment_by_the_same_distance_in_all_frames() -> None:
    walk = simulate_walks(subjects=1, frames=80, seed=3)[0]
    body = MarkerSet.load("helen-hayes")
    seen = set()
    for seed in range(40):
        moved, name = displace_marker(walk, body, seed=seed)
        column = walk.labels.index(name)
        others = np.arange(len(walk.labels)) != column
        np.testing.assert_array_equal(moved.positions[:, others], walk.positions[:, others])
        step = moved.positions[:, column] - walk.positions[:, column]
        far = np.linalg.norm(step, axis=1)
        assert np.ptp(far) < 1e-12 and 0.02 <= far[0] <= 0.10
        segment = next(names for names in body.segments.values() if name in names)
        lines = [walk.positions[:, walk.labels.index(other)] - walk.positions[:, column] for other in segment if other != name]
        assert any(np.abs(np.cross(step, line)).max() < 1e-9 for line in lines), "not along its segment"
        seen.add((name, np.sign((step[0] * lines[0][0]).sum())))
    assert len({name for name, _ in seen}) > 8 and {sign for _, sign in seen} == {-1.0, 1.0}
    again, _ = displace_marker(walk, body, seed=39)
    np.testing.assert_array_equal(again.positions, moved.positions)


def test_a_displaced_marker_is_missing_where_it_or_its_line_is() -> None:
    positions = np.random.default_rng(0).normal(size=(5, 5, 3))
    positions[0, 0] = positions[1, 1] = np.nan
    positions[2, 0] = positions[2, 1]
    thigh = MarkerSet(LEGS.names, segments={"thigh": ("hip", "knee")})
    for seed in range(6):
        moved, name = displace_marker(Recording(positions, LEGS.names, RATE), thigh, (0.05, 0.05), seed)
        gone = np.isnan(moved.positions[:, LEGS.names.index(name), 0])
        assert gone.tolist() == [True, True, True, False, False]


def test_what_cannot_be_displaced_is_named() -> None:
    recording = Recording(np.zeros((3, 2, 3)), ("hip", "head"), RATE)
    with pytest.raises(AsterismError, match="no two markers of one segment"):
        displace_marker(recording, LEGS)
    for metres in ((-0.1, 0.1), (0.1, 0.02), (0.0, float("inf")), (float("nan"), 0.1)):
        with pytest.raises(AsterismError, match="cannot be displaced"):
            displace_marker(recording, LEGS, metres)


def test_real_walks_keep_their_truth_in_clutter(data: Path) -> None:
    for number, path in enumerate(sorted((data / "gait").glob("HC00*/*.c3d"))):
        recording = asterism.read(path, markers="helen-hayes")
        moved, _ = displace_marker(recording, MarkerSet.load("helen-hayes"), seed=number)
        clouds, truth = cluttered(moved, Clutter(5.0, 3), seed=number, hidden=3)
        assert (owners(moved, clouds, truth) < 0).sum() > 3 * len(recording)
