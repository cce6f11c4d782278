"""Recordings, clouds, blobs and labellings: parts of them, their clock, their processing log, and how they show themselves."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import asterism
from asterism import AsterismError, Clouds, Event, Labelling, Recording
from asterism.cameras import Camera, Rig
from asterism.recording import Blobs, ProcessingStep, SkeletonMotion, log_as_text, log_from_text

RATE = 100.0


def recording(frames: int = 50, first_frame: int = 11, **more: object) -> Recording:
    """Two markers on straight paths; the heel strike lies at the file's frame 31, which is 0.3 s on its clock."""
    t = np.arange(frames)[:, None, None]
    positions = t * np.array([0.01, 0.0, 0.0]) + np.array([[0.0, 0.0, 1.0], [0.0, 0.2, 1.0]])
    return Recording(positions, ("LKNE", "RKNE"), RATE, events=(Event("Foot Strike", 0.3, "Left"),), first_frame=first_frame, **more)


def clouds(seed: int = 0, frames: int = 12) -> Clouds:
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, 5, frames)
    return Clouds.from_points([rng.normal(size=(n, 3)) for n in counts], RATE, tracks=[rng.permutation(n) for n in counts])


def blobs(seed: int = 0, frames: int = 9) -> Blobs:
    rng = np.random.default_rng(seed)
    frame, camera = rng.integers(0, frames, 40), rng.integers(0, 3, 40)
    times = np.arange(frames)[:, None] / RATE + np.array([0.0, 0.001, 0.002])
    return Blobs.from_rows(frame, camera, rng.normal(size=(40, 2)), ("a", "b", "c"), frames=frames, times=times)


# --- frames of a recording: the clock goes on


def test_a_later_part_of_a_recording_keeps_its_clock() -> None:
    part = recording().frames(slice(15, 30))
    assert part.first_frame == 26
    np.testing.assert_allclose(part.times, np.arange(25, 40) / RATE)
    assert [event.time for event in part.events] == [0.3], "the strike is in frame 31, which the part has"


@pytest.mark.parametrize("part", [slice(0, 15), slice(30, 50), slice(0, 0)], ids=["before", "after", "nothing"])
def test_an_event_goes_with_its_frame(part: slice) -> None:
    assert recording().frames(part).events == ()


def test_every_second_frame_has_half_the_rate_and_the_same_clock() -> None:
    whole, half = recording(), recording().frames(slice(1, None, 2))
    assert half.rate == 50.0
    np.testing.assert_allclose(half.times, whole.times[1::2])
    assert half.frames(slice(3, None)).times[0] == pytest.approx(whole.times[7])


def test_joined_pieces_carry_an_event_to_its_frame() -> None:
    joined = recording().frames([0, 1, 2, 19, 20, 21])
    assert joined.rate == RATE
    [event] = joined.events
    assert event.time == pytest.approx(joined.times[4]), "the strike's frame, number 20 of the recording, is number 4 here"


def test_a_part_written_and_read_again_has_the_same_clock(tmp_path: Path) -> None:
    part = recording().frames(slice(15, 30))
    for suffix in ("c3d", "npz", "csv", "tsv", "trc"):
        asterism.write(tmp_path / f"part.{suffix}", part)
        back = asterism.read(tmp_path / f"part.{suffix}", vertical="z")
        assert back.first_frame == 26, suffix
        np.testing.assert_allclose(back.times, part.times, atol=1e-6)


# --- the processing log


@pytest.mark.parametrize("suffix", ["c3d", "npz"])
def test_the_log_survives_a_file_and_grows(suffix: str, tmp_path: Path) -> None:
    done = recording().logged("filled", "asterism 0.1.0", longest_gap_s=0.1)
    asterism.write(tmp_path / f"one.{suffix}", done)
    back = asterism.read(tmp_path / f"one.{suffix}", vertical="z")
    assert back.log == (ProcessingStep("filled", "asterism 0.1.0", {"longest_gap_s": 0.1}),)
    asterism.write(tmp_path / f"two.{suffix}", back.logged("filtered", cutoff_hz=6.0))
    assert [step.action for step in asterism.read(tmp_path / f"two.{suffix}", vertical="z").log] == ["filled", "filtered"]
    assert asterism.formats.describe(tmp_path / f"two.{suffix}")["log"][1] == "filtered (cutoff_hz 6.0)"


def test_a_file_without_a_log_is_written_without_one(tmp_path: Path) -> None:
    asterism.write(tmp_path / "plain.c3d", recording())
    assert b"ASTERISM" not in (tmp_path / "plain.c3d").read_bytes()


def test_a_log_longer_than_c3d_holds_loses_its_oldest_steps(tmp_path: Path) -> None:
    long = recording()
    for number in range(400):
        long = long.logged("filtered", "x" * 100, number=number)
    asterism.write(tmp_path / "long.c3d", long)
    log = asterism.read(tmp_path / "long.c3d", vertical="z").log
    assert 100 < len(log) < 400
    assert log[-1].settings["number"] == 399


@given(st.text())
def test_any_text_is_a_log_or_an_empty_one(text: str) -> None:
    log = log_from_text(text)
    assert log_from_text(log_as_text(log)) == log


def test_labelling_is_logged() -> None:
    whole = recording()
    labelling = Labelling(np.zeros((50, 1), dtype=np.int64), np.ones((50, 1)), ("SACR",))
    assert str(whole.with_labelling(labelling, by="gait.model").log[-1]) == "labelled by gait.model"


# --- parts of clouds and blobs against plain loops


@given(st.integers(0, 2**31))
def test_some_points_of_clouds(seed: int) -> None:
    whole = clouds(seed)
    kept = np.random.default_rng(seed + 1).random(len(whole.xyz)) < 0.5
    some = whole.select(kept)
    for t in range(len(whole)):
        here = whole.frame_of == t
        np.testing.assert_array_equal(some[t], whole.xyz[here & kept])
        np.testing.assert_array_equal(some.tracks[some.frame_of == t], whole.tracks[here & kept])


@given(st.integers(0, 2**31))
def test_some_frames_of_clouds(seed: int) -> None:
    whole = clouds(seed)
    which = np.random.default_rng(seed + 1).integers(0, len(whole), 5)
    some = whole.frames(which)
    assert len(some) == 5
    for place, t in enumerate(which):
        np.testing.assert_array_equal(some[place], whole[t])
    assert whole.frames(slice(0, 0)).xyz.shape == (0, 3)


@given(st.integers(0, 2**31))
def test_some_blobs_frames_and_cameras(seed: int) -> None:
    whole = blobs(seed)
    kept = np.random.default_rng(seed + 1).random(len(whole.xy)) < 0.5
    some, later, pair = whole.select(kept), whole.frames(slice(4, 8)), whole.select_cameras(["c", "a"])
    assert (later.first_frame, pair.cameras) == (4, ("c", "a"))
    for t in range(len(whole)):
        for c in range(3):
            here = (whole.frame_of == t) & (whole.camera_of == c)
            np.testing.assert_array_equal(some.of(t, c), whole.xy[here & kept])
            if 4 <= t < 8:
                np.testing.assert_array_equal(later.of(t - 4, c), whole.of(t, c))
        np.testing.assert_array_equal(pair.of(t, 0), whole.of(t, 2))
    np.testing.assert_array_equal(later.times, whole.times[4:8])
    np.testing.assert_array_equal(pair.times, whole.times[:, [2, 0]])


def test_a_camera_without_blobs_is_named() -> None:
    with pytest.raises(AsterismError, match="no camera d; the blobs are of a, b, c"):
        blobs().select_cameras(["a", "d"])


@given(st.integers(0, 2**31))
def test_clouds_become_a_recording_and_clouds_again(seed: int) -> None:
    whole = clouds(seed)
    back = Recording.from_clouds(whole).clouds()
    np.testing.assert_array_equal(back.xyz, whole.xyz)
    np.testing.assert_array_equal(back.offsets, whole.offsets)


def test_clouds_and_their_labels_become_a_labelled_recording() -> None:
    points = Clouds.from_points([[[0, 0, 1], [0, 1, 1]], [[0, 1, 2]]], RATE)
    labelled = Recording.from_clouds(points, Labelling(np.array([[1], [-1]]), np.ones((2, 1)), ("SACR",)))
    assert labelled.labels[0] == "SACR"
    np.testing.assert_array_equal(labelled.positions[0, 0], [0, 1, 1])
    assert labelled.visible.sum() == 3


# --- what a person sees


def test_the_nouns_show_themselves_briefly() -> None:
    whole = recording(metadata={"file": "a<b>.c3d"})
    labelling = Labelling(np.array([[0, -1]]), np.array([[0.98, 0.4]]), ("LKNE", "RKNE"))
    rig = Rig((Camera("left", None, (500.0, 500.0), (320.0, 240.0)), Camera("right", (640, 480), (500.0, 500.0), (320.0, 240.0))))
    assert repr(whole) == "Recording(file: a<b>.c3d, frames: 50 at 100 Hz (0.5 s), first frame: 11, labels: LKNE, RKNE, events: 1)"
    assert repr(labelling) == "Labelling(frames: 1, markers: LKNE, RKNE, labelled: 50 % of 2, lowest confidence: 0.980)"
    for noun in (whole, clouds(), blobs(), labelling, rig):
        html = noun._repr_html_()
        assert html.startswith("<table>"), type(noun).__name__
        assert "<b>" not in html, "what a file is called is no markup"
        assert len(repr(noun)) < 300


def test_data_frames_and_xarrays_where_they_are_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = recording()
    for module, call in (("pandas", whole.to_dataframe), ("xarray", whole.to_xarray)):
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(AsterismError, match=f"pip install {module}"):
            call()


def test_a_data_frame_has_times_and_labels() -> None:
    pytest.importorskip("pandas")
    table = recording().to_dataframe()
    assert table.index[0] == pytest.approx(0.1)
    np.testing.assert_array_equal(table["RKNE"].to_numpy(), recording().positions[:, 1])


def test_an_xarray_has_times_and_labels() -> None:
    pytest.importorskip("xarray")
    array = recording().to_xarray()
    np.testing.assert_array_equal(array.sel(label="RKNE", axis="y"), 0.2)
    assert float(array.time[0]) == pytest.approx(0.1)


def two_bones(turn: float, parents: tuple[int, ...] = (-1, 0), scale: float = 1.0) -> SkeletonMotion:
    """A thigh turned about y, and a shank of 0.4 m turned back by as much."""
    about = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    offsets, ends = np.array([[0, 0, 0], [0, 0, -0.5]]), np.array([[np.nan] * 3, [0, 0, -0.4]])
    return SkeletonMotion(
        ("thigh", "shank"), parents, offsets, ends, scale * np.stack([about, about.T])[None], np.array([[0, 0, 1.0]]), RATE
    )


def test_the_joints_of_a_skeleton_follow_its_rotations() -> None:
    motion = two_bones(np.pi / 2)
    np.testing.assert_allclose(motion.joints[0], [[0, 0, 1], [-0.5, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(motion.tips[0, 1], [-0.5, 0, 0.6], atol=1e-12)
    np.testing.assert_allclose(motion.lengths, [0.5, 0.4])


def test_a_skeleton_out_of_order_or_with_a_scaled_rotation_is_refused() -> None:
    with pytest.raises(AsterismError, match="each bone behind its parent"):
        two_bones(0.1, parents=(-1, 1))
    with pytest.raises(AsterismError, match="give rotations only"):
        two_bones(0.1, scale=1.01)
