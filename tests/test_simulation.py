"""Simulated people: plausible bodies, feet on the floor, known truth; and the hiding of markers and adding of ghosts."""

from __future__ import annotations

import numpy as np
import pytest
from counting import calls
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism.errors import AsterismError
from asterism.labelling.simulated_occlusions import GHOST_RADIUS, simulate_occlusions
from asterism.recording import Floats, Labelling, MarkerSet, Recording
from asterism.simulation import simulate_standing, simulate_walks, simulated_markers

EVERYTHING = list(simulated_markers())


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    """Six people, three walks each (straight, turn, curve), with every marker that there is."""
    return simulate_walks(subjects=6, frames=400, trials=3, markers=EVERYTHING, seed=5)


def track(recording: Recording, name: str) -> Floats:
    return recording.positions[:, recording.labels.index(name)]


def length(recording: Recording, a: str, b: str) -> Floats:
    return np.linalg.norm(track(recording, a) - track(recording, b), axis=1)


def ahead(recording: Recording) -> Floats:
    """(T, 2) where the pelvis faces, on the floor, Z up."""
    facing = (0.5 * (track(recording, "LASI") + track(recording, "RASI")) - track(recording, "SACR"))[:, :2]
    return facing / np.linalg.norm(facing, axis=1, keepdims=True)


# Who walks


@pytest.mark.parametrize("name", ["helen-hayes", "plug-in-gait", "oxford-foot"])
def test_every_shipped_marker_set_can_be_worn(name: str) -> None:
    for recording in (*simulate_walks(2, 50, markers=name), *simulate_standing(2, 50, markers=name)):
        assert recording.labels == MarkerSet.load(name).names
        assert recording.positions.shape == (50, len(recording.labels), 3)
        assert recording.visible.all()


def test_subjects_trials_and_sizes_are_told_and_spread() -> None:
    recordings = simulate_walks(subjects=8, frames=20, trials=2, seed=1)
    assert [r.metadata["subject"] for r in recordings] == [f"S{i:02d}" for i in range(1, 9) for _ in range(2)]
    assert len({(r.metadata["subject"], r.metadata["trial"]) for r in recordings}) == 16
    heights = sorted({r.metadata["height"] for r in recordings})
    assert heights[0] < 1.39, f"the shortest of eight is {heights[0]} m"
    assert heights[-1] > 1.86, f"the tallest of eight is {heights[-1]} m"
    assert min(np.diff(heights)) > 0


def test_the_same_seed_gives_the_same_recordings_and_another_seed_others() -> None:
    first, again, other = (simulate_walks(2, 30, seed=seed) for seed in (4, 4, 5))
    assert all(np.array_equal(a.positions, b.positions) and a.events == b.events for a, b in zip(first, again, strict=True))
    assert not any(np.allclose(a.positions, b.positions, atol=0.01) for a, b in zip(first, other, strict=True))


def test_a_subset_of_markers_is_the_same_body() -> None:
    whole, part = simulate_walks(1, 200, markers=EVERYTHING, seed=2)[0], simulate_walks(1, 200, markers=["LKNE", "LTHI"], seed=2)[0]
    assert abs(length(whole, "LKNE", "LTHI").mean() - length(part, "LKNE", "LTHI").mean()) < 0.02


def test_standing_and_walking_are_the_same_person() -> None:
    for walk, stand in zip(simulate_walks(5, 200, seed=9), simulate_standing(5, 100, seed=9), strict=True):
        assert walk.metadata["subject"] == stand.metadata["subject"] and walk.metadata["height"] == stand.metadata["height"]
        assert abs(np.median(length(walk, "LASI", "RASI")) - np.median(length(stand, "LASI", "RASI"))) < 0.015
        assert np.ptp(track(stand, "SACR"), axis=0).max() < 0.05, "a standing person moves by more than 5 cm"
        assert stand.events == ()


# How they walk


def test_heads_are_where_heads_are(walks: list[Recording]) -> None:
    for walk in walks:
        top = track(walk, "LFHD")[:, 2].mean() / walk.metadata["height"]
        assert 0.86 < top < 1.02, f"the head of {walk.metadata['subject']} is at {top:.2f} of the height"


def test_people_walk_forward_at_walking_speed(walks: list[Recording]) -> None:
    for walk in walks:
        velocity = np.diff(track(walk, "SACR")[:, :2], axis=0) * walk.rate
        speed = float(np.einsum("ti,ti->t", velocity, ahead(walk)[1:]).mean())
        assert 0.6 < speed < 2.2, f"{walk.metadata['file']}: {speed:.2f} m/s"


def test_paths_turn_as_they_say(walks: list[Recording]) -> None:
    turned = {"straight": [], "turn": [], "curve": []}
    for walk in walks:
        facing = np.unwrap(np.arctan2(*ahead(walk).T[::-1]))
        turned[walk.metadata["path"]].append(abs(np.degrees(facing[-20:].mean() - facing[:20].mean())))
    assert max(turned["straight"]) < 15
    assert all(70 < angle < 110 for angle in turned["turn"]), turned["turn"]
    assert min(turned["curve"]) > 15


def test_nobody_sinks_into_the_floor_or_flies(walks: list[Recording]) -> None:
    for walk in walks:
        assert walk.positions[:, :, 2].min() > -0.02
        lowest = np.minimum(track(walk, "LHEE")[:, 2], track(walk, "RHEE")[:, 2])
        lowest = np.minimum(lowest, np.minimum(track(walk, "LTOE")[:, 2], track(walk, "RTOE")[:, 2]))
        assert lowest.max() < 0.09, f"both feet are {lowest.max():.3f} m above the floor"


def test_knees_bend_and_bones_do_not(walks: list[Recording]) -> None:
    for walk in walks:
        assert np.ptp(length(walk, "LTUB", "LANK")) < 0.06, "two markers of one shank move apart by more than skin slides"
        hip, knee, ankle = (track(walk, name) for name in ("LASI", "LKNE", "LANK"))
        thigh, shank = knee - hip, ankle - knee
        cosine = np.einsum("ti,ti->t", thigh, shank) / np.linalg.norm(thigh, axis=1) / np.linalg.norm(shank, axis=1)
        bends = np.ptp(np.degrees(np.arccos(cosine)))
        assert 25 < bends < 90, f"the line from pelvis to knee to ankle bends by {bends:.0f} degrees"


def test_left_is_left(walks: list[Recording]) -> None:
    for walk in walks:
        left = np.stack([-ahead(walk)[:, 1], ahead(walk)[:, 0]], axis=1)
        for name in ("ASI", "SHO", "KNE", "THI", "ELB"):
            apart = (track(walk, "L" + name) - track(walk, "R" + name))[:, :2]
            assert (np.einsum("ti,ti->t", apart, left) > 0).all(), name


def test_events_are_where_heels_land_and_toes_leave(walks: list[Recording]) -> None:
    for walk in walks:
        kinds = {(event.label, event.context) for event in walk.events}
        assert kinds == {(label, side) for label in ("Foot Strike", "Foot Off") for side in ("Left", "Right")}
        assert list(walk.events) == sorted(walk.events, key=lambda event: event.time)
        for event in walk.events:
            assert 0 <= event.time <= (len(walk) - 1) / walk.rate
            heel = track(walk, event.context[0] + "HEE")[round(event.time * walk.rate), 2]
            if event.label == "Foot Strike":
                assert heel < 0.10, f"{event.context} heel strikes {heel:.3f} m above the floor"
            else:
                assert heel > 0.10, f"{event.context} foot leaves with its heel at {heel:.3f} m"


def test_the_measurement_shakes_by_half_a_millimetre(walks: list[Recording]) -> None:
    stand = simulate_standing(1, 400, seed=3)[0]
    shake = np.diff(stand.positions, n=3, axis=0).std() / np.sqrt(20)
    assert 0.0004 < shake < 0.0006, f"{1000 * shake:.2f} mm"


@pytest.mark.parametrize("vertical", ["y", "-z", "x", (1.0, 1.0, 0.5)])
def test_a_room_with_another_vertical_is_turned_and_not_mirrored(vertical: str | tuple[float, float, float]) -> None:
    upright, other = simulate_walks(2, 40, seed=7)[1], simulate_walks(2, 40, seed=7, vertical=vertical)[1]
    np.testing.assert_allclose(other.positions @ other.vertical, upright.positions[:, :, 2], atol=1e-9)
    a, b = (np.linalg.det(r.positions[:, 1:4] - r.positions[:, :1]) for r in (upright, other))
    np.testing.assert_allclose(a, b, atol=1e-9)


def test_no_function_is_called_per_frame() -> None:
    """Ten times the frames: the same calls, on longer arrays, but for the steps and turns that a longer walk has more of."""
    short, long = (calls(lambda frames=frames: simulate_walks(subjects=4, frames=frames)).total() for frames in (300, 3000))
    assert long < 1.2 * short < 20_000, f"{short} calls for 300 frames, {long} for 3,000"


@pytest.mark.parametrize("wrong", [{"subjects": 0}, {"frames": -1}, {"rate": 0.0}, {"trials": 0}, {"rate": float("nan")}])
def test_numbers_that_make_no_sense_are_named(wrong: dict[str, float]) -> None:
    with pytest.raises(AsterismError, match=next(iter(wrong))):
        simulate_walks(**wrong)  # type: ignore[arg-type]


def test_a_marker_that_cannot_be_placed_is_named() -> None:
    with pytest.raises(AsterismError, match="TAIL"):
        simulate_walks(1, 10, markers=["LKNE", "TAIL"])


def test_one_frame_is_a_recording_too() -> None:
    assert np.isfinite(simulate_walks(1, 1)[0].positions).all()
    assert np.isfinite(simulate_standing(1, 1)[0].positions).all()


# Hiding and haunting


def gappy(frames: int, markers: int, seed: int) -> Recording:
    """Random points a metre apart or so, a fifth of them missing."""
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(frames, markers, 3))
    positions[rng.random((frames, markers)) < 0.2] = np.nan
    return Recording(positions, tuple(f"m{i}" for i in range(markers)), 100.0)


@given(st.integers(0, 12), st.integers(1, 9), st.integers(0, 9), st.integers(0, 4), st.integers(0, 99))
@settings(max_examples=80, deadline=None)
def test_truth_and_clouds_agree(frames: int, markers: int, occlusions: int, ghosts: int, seed: int) -> None:
    recording, occlusions = gappy(frames, markers, seed), min(occlusions, markers)
    clouds, truth = simulate_occlusions(recording, occlusions, ghosts, seed)
    seen = recording.visible.sum(axis=1)
    left = np.maximum(seen - occlusions, 0)
    np.testing.assert_array_equal((truth >= 0).sum(axis=1), left)
    np.testing.assert_array_equal(clouds.counts, left + ghosts * (seen > 0))
    labelled = Labelling(truth, np.ones(truth.shape), recording.labels).positions(clouds)
    given_points = truth >= 0
    np.testing.assert_array_equal(labelled[given_points], recording.positions[given_points])
    for t in range(frames):
        haunting = np.delete(clouds[t], truth[t][truth[t] >= 0], axis=0)
        host = recording.positions[t][recording.visible[t]]
        if len(haunting):
            assert np.linalg.norm(haunting[:, None] - host[None], axis=2).min(axis=1).max() <= GHOST_RADIUS


def test_ghosts_fill_the_ball_evenly_and_haunt_every_marker() -> None:
    recording = Recording(np.tile(np.arange(5.0)[None, :, None], (4000, 1, 3)), tuple("abcde"), 100.0)
    clouds, truth = simulate_occlusions(recording, 5, 2, seed=1)
    assert (truth == -1).all()
    host = np.rint(clouds.xyz.mean(axis=1))
    assert np.bincount(host.astype(int), minlength=5).min() > 1400
    share_inside = np.mean(np.linalg.norm(clouds.xyz - host[:, None], axis=1) < GHOST_RADIUS * 0.5 ** (1 / 3))
    assert abs(share_inside - 0.5) < 0.03, f"{share_inside:.3f} of the ghosts are in the inner half of the ball's volume"


def test_points_are_shuffled_and_every_marker_is_hidden_as_often() -> None:
    recording = simulate_walks(1, 3000)[0]
    clouds, truth = simulate_occlusions(recording, 3, 2, seed=0)
    hidden = (truth < 0).mean(axis=0)
    assert np.abs(hidden - 0.2).max() < 0.04
    mean_place = np.array([truth[truth[:, m] >= 0, m].mean() for m in range(15)])
    assert np.abs(mean_place - 6.5).max() < 0.5, "a marker's place in the cloud betrays it"
    assert (clouds.columns == -1).all()


def test_hiding_repeats_with_its_seed_only() -> None:
    recording = simulate_walks(1, 50)[0]
    one, same, other = (simulate_occlusions(recording, 2, 2, seed) for seed in (1, 1, 2))
    assert np.array_equal(one[0].xyz, same[0].xyz) and np.array_equal(one[1], same[1])
    assert not np.array_equal(one[1], other[1])


def test_hiding_calls_no_function_per_frame() -> None:
    few, many = (calls(lambda frames=frames: simulate_occlusions(gappy(frames, 15, 0), 3, 3)).total() for frames in (100, 10_000))
    assert many <= few < 1000, f"{few} calls for 100 frames, {many} for 10,000"


@pytest.mark.parametrize(("occlusions", "ghosts"), [(-1, 0), (16, 0), (0, -1)])
def test_impossible_hiding_is_refused(occlusions: int, ghosts: int) -> None:
    with pytest.raises(AsterismError, match="ask for 0"):
        simulate_occlusions(simulate_walks(1, 5)[0], occlusions, ghosts)


@given(st.integers(0, 8), st.integers(1, 6), st.integers(0, 50))
@settings(max_examples=40, deadline=None)
def test_an_anonymous_recording_holds_the_clouds_as_they_are(frames: int, markers: int, seed: int) -> None:
    clouds, truth = simulate_occlusions(gappy(frames, markers, seed), 1, 1, seed)
    recording = Recording.from_clouds(clouds)
    again = recording.clouds()
    np.testing.assert_array_equal(again.xyz, clouds.xyz)
    np.testing.assert_array_equal(again.offsets, clouds.offsets)
    labelling = Labelling(truth, np.ones(truth.shape), tuple(f"m{i}" for i in range(markers)))
    named = recording.with_labelling(labelling)
    np.testing.assert_array_equal(named.positions[:, :markers], labelling.positions(clouds))
    assert named.visible.sum() == len(clouds.xyz), "a point got lost"
