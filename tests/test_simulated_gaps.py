"""Gaps and riding ghosts: as many hidden as asked at every moment, the truth true, tracks never across two markers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ground_truth import owners
from hypothesis import given, settings
from hypothesis import strategies as st

import asterism
from asterism.errors import AsterismError
from asterism.labelling.simulated_occlusions import GHOST_RADIUS, simulate_gaps, simulate_gaps_and_ghosts
from asterism.recording import NULL, Recording

RATE = 100.0


def recording_of(frames: int, markers: int, seed: int = 0, missing: float = 0.0) -> Recording:
    """Markers 0.3 to 1 m apart that drift together at 1 m/s, some of them missing for stretches of about a quarter of a second."""
    rng = np.random.default_rng(seed)
    body = rng.uniform(-0.5, 0.5, (markers, 3)) + np.arange(markers)[:, None] * [0.3, 0.0, 0.0]
    positions = body + np.arange(frames)[:, None, None] / RATE * [0.0, 1.0, 0.0]
    away = rng.random((frames // 25 + 1, markers)) < missing
    positions[np.repeat(away, 25, axis=0)[:frames]] = np.nan
    return Recording(positions, tuple(f"m{i}" for i in range(markers)), RATE)


def stretches(mask: np.ndarray) -> list[tuple[int, int]]:
    """First and last frame of each unbroken stretch."""
    edges = np.diff(np.concatenate([[0], mask.astype(np.int64), [0]]))
    return list(zip(np.nonzero(edges == 1)[0], np.nonzero(edges == -1)[0] - 1, strict=True))


many = st.fixed_dictionaries(
    {
        "frames": st.integers(1, 260),
        "markers": st.integers(1, 12),
        "missing": st.sampled_from([0.0, 0.1, 0.6]),
        "ghosts": st.integers(0, 4),
        "seed": st.integers(0, 2**32 - 1),
    }
)


@settings(max_examples=60, deadline=None)
@given(case=many, data=st.data())
def test_everything_that_the_docstring_promises(case: dict, data: st.DataObject) -> None:
    recording = recording_of(case["frames"], case["markers"], case["seed"] % 97, case["missing"])
    hidden = data.draw(st.integers(0, case["markers"]))
    clouds, truth = simulate_gaps_and_ghosts(recording, hidden, case["ghosts"], seed=case["seed"])
    owner = owners(recording, clouds, truth)
    shown = recording.visible.sum(axis=1)
    gone = (recording.visible & (truth == NULL)).sum(axis=1)
    np.testing.assert_array_equal(gone, np.minimum(hidden, shown))
    assert not ((truth != NULL) & ~recording.visible).any()

    frame_of = np.repeat(np.arange(len(clouds)), clouds.counts)
    np.testing.assert_array_equal(np.bincount(frame_of[owner < 0], minlength=len(clouds)), np.where(shown > 0, case["ghosts"], 0))
    assert (clouds.tracks >= 0).all() and (clouds.columns == -1).all()
    for track in np.unique(clouds.tracks):
        points = np.nonzero(clouds.tracks == track)[0]
        assert len(set(owner[points])) == 1, "a track joins two markers, or a marker and a ghost"
        np.testing.assert_array_equal(np.diff(frame_of[points]), 1, "a track has a hole, or two points in one frame")
        if owner[points[0]] < 0:
            _rides(recording, clouds.xyz[points], frame_of[points])
    for marker in range(case["markers"]):
        numbers = clouds.tracks[owner == marker]
        assert len(set(numbers)) == len(stretches(truth[:, marker] != NULL)), "a marker came back under its old number, or changed it"


def _rides(recording: Recording, places: np.ndarray, frames: np.ndarray) -> None:
    offsets = places[:, None] - recording.positions[frames]
    keeps = np.abs(offsets - offsets[:1]).max(axis=(0, 2)) < 1e-9
    near = np.linalg.norm(offsets, axis=2).max(axis=0) <= GHOST_RADIUS + 1e-9
    assert (keeps & near).any(), "a ghost rides on no marker"
    assert len(frames) <= 0.5 * RATE


def test_gaps_and_ghosts_last_as_long_as_asked() -> None:
    recording = recording_of(4000, 12)
    clouds, truth = simulate_gaps_and_ghosts(recording, 3, 2, seed=1)
    inner = [(a, b) for m in range(12) for a, b in stretches(truth[:, m] == NULL) if a > 0 and b < 3999]
    lengths = np.array([b - a + 1 for a, b in inner]) / RATE
    assert lengths.min() >= 0.1 and lengths.max() <= 1.0, f"gaps of {lengths.min()} to {lengths.max()} s"
    assert lengths.min() < 0.15 and lengths.max() > 0.95 and abs(lengths.mean() - 0.55) < 0.07, "gaps are not uniform over 0.1 to 1 s"
    frame_of, owner = np.repeat(np.arange(4000), clouds.counts), owners(recording, clouds, truth)
    ghosts = [frame_of[clouds.tracks == track] for track in np.unique(clouds.tracks[owner < 0])]
    lasted = np.array([len(frames) for frames in ghosts if frames[0] > 0 and frames[-1] < 3999]) / RATE
    assert lasted.min() >= 0.05 and lasted.max() <= 0.5 and abs(lasted.mean() - 0.275) < 0.03
    short, short_truth = simulate_gaps_and_ghosts(recording, 3, 0, seed=1, gap_seconds=(0.02, 0.02))
    assert {b - a + 1 for m in range(12) for a, b in stretches(short_truth[:, m] == NULL) if a > 0 and b < 3999} == {2}
    assert len(np.unique(short.tracks)) > len(np.unique(clouds.tracks[owner >= 0]))


def test_every_marker_is_hidden_about_as_often() -> None:
    _, truth = simulate_gaps_and_ghosts(recording_of(20000, 10), 3, 0, seed=2)
    share = (truth == NULL).mean(axis=0)
    assert abs(share - 0.3).max() < 0.06, share


def test_ghosts_fill_their_ball_and_not_only_its_shell_or_centre() -> None:
    recording = recording_of(20000, 1)
    clouds, truth = simulate_gaps_and_ghosts(recording, 1, 3, seed=3)
    assert (truth == NULL).all()
    frame_of = np.repeat(np.arange(len(clouds)), clouds.counts)
    first = np.unique(clouds.tracks, return_index=True)[1]
    radius = np.linalg.norm(clouds.xyz[first] - recording.positions[frame_of[first], 0], axis=1)
    assert abs((radius < GHOST_RADIUS / 2).mean() - 1 / 8) < 0.03, "the inner half of the radius holds an eighth of a ball"


def test_same_seed_same_bits_and_track_numbers_are_all_that_goes_without_them() -> None:
    recording = recording_of(300, 8, missing=0.1)
    clouds, truth = simulate_gaps_and_ghosts(recording, 3, 2, seed=5)
    again, same = simulate_gaps_and_ghosts(recording, 3, 2, seed=np.random.default_rng(5))
    bare, bare_truth = simulate_gaps_and_ghosts(recording, 3, 2, seed=5, number_tracks=False)
    other, _ = simulate_gaps_and_ghosts(recording, 3, 2, seed=6)
    for one in (again, bare):
        np.testing.assert_array_equal(one.xyz, clouds.xyz)
        np.testing.assert_array_equal(one.offsets, clouds.offsets)
    np.testing.assert_array_equal(again.tracks, clouds.tracks)
    assert np.array_equal(truth, same) and np.array_equal(truth, bare_truth)
    assert bare.tracks is None
    assert not np.array_equal(other.xyz, clouds.xyz)


def test_neither_order_nor_numbers_tell_who_is_who() -> None:
    recording = recording_of(2000, 6)
    clouds, truth = simulate_gaps_and_ghosts(recording, 2, 0, seed=7)
    owner = owners(recording, clouds, truth)
    place = np.arange(len(owner)) - np.repeat(clouds.offsets[:-1], clouds.counts)
    seen = np.bincount(owner)
    for marker in range(6):
        share = np.bincount(place[owner == marker], minlength=4)[:4] / seen[marker]
        assert abs(share - 0.25).max() < 0.06, f"marker {marker} prefers a place: {share}"
    tracks, first = np.unique(clouds.tracks, return_index=True)
    assert abs(np.corrcoef(tracks, first)[0, 1]) < 0.2, "track numbers tell when a track began"


def test_a_few_gaps_are_a_few_gaps() -> None:
    recording = recording_of(600, 15)
    for seed in range(10):
        clouds, truth = simulate_gaps(recording, 5, seed=seed)
        owners(recording, clouds, truth)
        gone = [b - a + 1 for m in range(15) for a, b in stretches(truth[:, m] == NULL)]
        assert 1 <= len(gone) <= 5 and min(gone) >= 10
        if len(gone) == 5:
            assert max(gone) <= 100
        assert len(np.unique(clouds.tracks)) == sum(len(stretches(truth[:, m] != NULL)) for m in range(15))
    clouds, truth = simulate_gaps(recording, 0, seed=0)
    assert (truth != NULL).all() and len(np.unique(clouds.tracks)) == 15


def test_gaps_longer_than_the_recording_and_hardly_any_recording() -> None:
    recording = recording_of(5, 4)
    _, truth = simulate_gaps_and_ghosts(recording, 2, 0, seed=0, gap_seconds=(10.0, 20.0))
    assert ((truth == NULL) == (truth[0] == NULL)).all() and (truth[0] == NULL).sum() == 2
    clouds, truth = simulate_gaps(recording, 1, seed=0, gap_seconds=(10.0, 20.0))
    assert (truth == NULL).all(axis=0).sum() == 1
    for frames, markers in ((0, 3), (1, 1), (3, 0)):
        clouds, truth = simulate_gaps_and_ghosts(recording_of(frames, markers), 0, 2, seed=0)
        assert len(clouds) == frames and truth.shape == (frames, markers)
        assert clouds.counts.sum() == frames * (markers + 2 * (markers > 0))


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda r: simulate_gaps_and_ghosts(r, -1), "cannot hide -1 of 4 markers"),
        (lambda r: simulate_gaps_and_ghosts(r, 5), "cannot hide 5 of 4 markers"),
        (lambda r: simulate_gaps_and_ghosts(r, 1, -2), "cannot add -2 ghosts"),
        (lambda r: simulate_gaps_and_ghosts(r, 1, gap_seconds=(1.0, 0.1)), "gaps of 1.0 to 0.1 s"),
        (lambda r: simulate_gaps_and_ghosts(r, 1, gap_seconds=(0.0, 1.0)), "gaps of 0.0 to 1.0 s"),
        (lambda r: simulate_gaps_and_ghosts(r, 1, 1, ghost_seconds=(float("nan"), 1.0)), "ghosts of nan to 1.0 s"),
        (lambda r: simulate_gaps(r, -1), "cannot make -1 gaps"),
        (lambda r: simulate_gaps(r, 1, gap_seconds=(1.0, float("inf"))), "gaps of 1.0 to inf s"),
        (lambda r: simulate_gaps(Recording(np.zeros((3, 0, 3)), (), RATE), 1), "no markers to make gaps in"),
    ],
)
def test_nonsense_is_named(call, said: str) -> None:
    with pytest.raises(AsterismError, match=said):
        call(recording_of(20, 4))


def test_real_walks_with_gaps_of_their_own(data: Path) -> None:
    for number, path in enumerate(sorted((data / "gait").glob("HC00*/*.c3d"))):
        recording = asterism.read(path, markers="helen-hayes")
        clouds, truth = simulate_gaps_and_ghosts(recording, 3, 3, seed=number)
        owner = owners(recording, clouds, truth)
        np.testing.assert_array_equal((recording.visible & (truth == NULL)).sum(axis=1), np.minimum(3, recording.visible.sum(axis=1)))
        assert (owner < 0).sum() == 3 * len(recording)
        for track in np.unique(clouds.tracks):
            assert len(set(owner[clouds.tracks == track])) == 1
