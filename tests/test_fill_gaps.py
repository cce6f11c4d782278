"""Gaps of markers filled: known truth, stated uncertainty, what is refused, and filled samples that stay told apart in files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

import asterism
from asterism import formats
from asterism.cli import main
from asterism.errors import AsterismError
from asterism.motion.gaps import Filled, GapRules, fill_gaps, trials_of_person
from asterism.recording import Recording, filled_samples
from asterism.simulation import simulate_walks


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    return simulate_walks(subjects=3, frames=240, markers="plug-in-gait", seed=5)


def without(recording: Recording, *holes: tuple[str, slice]) -> Recording:
    positions = recording.positions.copy()
    for label, frames in holes:
        positions[frames, recording.labels.index(label)] = np.nan
    return replace(recording, positions=positions)


def off(fill: Filled, truth: Recording) -> np.ndarray:
    """m, the distance of each filled sample to the truth."""
    return np.linalg.norm(fill.recording.positions - truth.positions, axis=2)[fill.filled]


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), begin=st.integers(0, 60), length=st.integers(1, 40), many=st.integers(4, 9))
def test_a_rigid_cluster_is_filled_exactly(seed: int, begin: int, length: int, many: int) -> None:
    rng = np.random.default_rng(seed)
    cluster = rng.uniform(-0.2, 0.2, (many, 3))
    turns = Rotation.from_rotvec(np.linspace(0.0, 1.0, 100)[:, None] * rng.uniform(-2.0, 2.0, 3)).as_matrix()
    positions = np.einsum("tij,nj->tni", turns, cluster) + np.cumsum(rng.normal(0.0, 0.01, (100, 1, 3)), axis=0)
    whole = Recording(positions, tuple(f"M{i}" for i in range(many)), rate=100.0)
    fill = fill_gaps(without(whole, ("M0", slice(begin, begin + length))))
    assert fill.filled.sum() == length and not fill.findings
    assert off(fill, whole).max() < 1e-5


def test_the_interval_holds_as_often_as_it_says_and_a_spline_is_beaten(walks: list[Recording]) -> None:
    rng, inside, errors, splines = np.random.default_rng(1), list[bool](), [], []
    for walk in walks:
        for length in (10, 10, 50, 50):
            column, begin = int(rng.integers(len(walk.labels))), int(rng.integers(40, 140))
            gap = slice(begin, begin + length)
            fill = fill_gaps(without(walk, (walk.labels[column], gap)), limit=1.0)
            apart = fill.recording.positions[gap, column] - walk.positions[gap, column]
            inside += (np.abs(apart) < 1.96 * fill.deviation[gap, column][:, None]).ravel().tolist()
            errors.append(np.linalg.norm(apart, axis=1).mean())
            rest = np.setdiff1d(np.arange(len(walk)), np.arange(begin, begin + length))
            spline = CubicSpline(rest, walk.positions[rest, column])(np.arange(begin, begin + length))
            splines.append(np.linalg.norm(spline - walk.positions[gap, column], axis=1).mean())
    assert 0.90 < np.mean(inside) < 0.995, f"{np.mean(inside):.3f} of the coordinates within 95 %"
    assert np.mean(errors) < 0.004, f"{1000 * np.mean(errors):.2f} mm"
    assert (np.array(errors) <= np.array(splines) * 1.1).all()


def test_what_was_measured_stays_and_the_flags_say_what_was_filled(walks: list[Recording]) -> None:
    holes = (("LKNE", slice(50, 70)), ("LTIB", slice(60, 65)), ("LANK", slice(55, 60)))
    given_ = without(walks[0], *holes)
    fill = fill_gaps(given_, limit=0.05)
    assert fill.gaps == 3 and fill.by_marker()["LKNE"][0] == 20
    np.testing.assert_array_equal(fill.filled, ~given_.visible)
    np.testing.assert_array_equal(fill.recording.positions[given_.visible], given_.positions[given_.visible])
    np.testing.assert_array_equal(np.isfinite(filled_samples(fill.recording)), fill.filled)
    # What is filled is known of any piece of the recording, at any rate.
    np.testing.assert_array_equal(np.isfinite(filled_samples(fill.recording.frames(slice(51, 90, 3)))), fill.filled[51:90:3])


def test_a_gap_that_is_too_uncertain_is_left_and_said(walks: list[Recording]) -> None:
    given_ = without(walks[0], ("LWRA", slice(0, 120)), ("RKNE", slice(80, 84)))
    fill = fill_gaps(given_, limit=0.0015)
    assert not fill.filled[:, walks[0].labels.index("LWRA")].any()
    [finding] = [one for one in fill.findings if one.where == "LWRA"]
    assert finding.code == "gap-not-filled" and "frames 1 to 120" in finding.sentence
    assert fill_gaps(given_, limit=1.0).filled.sum() == 124, "the limit alone has kept it"


def test_a_marker_that_is_never_seen_is_said(walks: list[Recording]) -> None:
    fill = fill_gaps(without(walks[0], ("LKNE", slice(None))))
    assert [finding.code for finding in fill.findings] == ["gap-never-seen"]
    assert fill.gaps == 0 and not fill.recording.log


def test_other_trials_show_poses_that_the_recording_does_not() -> None:
    first, second = simulate_walks(subjects=1, frames=200, markers="plug-in-gait", trials=2, seed=8)
    labels = ("LKNE", "LTHI", "RWRA", "LELB", "CLAV")
    # In all but the last 40 frames the marker is away: what it does is known from the other trial alone.
    holes = [without(first, (label, slice(0, 160))) for label in labels]
    alone = np.mean([off(fill_gaps(one, limit=9.0), first).mean() for one in holes])
    both = np.mean([off(fill_gaps(one, limit=9.0, others=[second]), first).mean() for one in holes])
    assert both < 0.8 * alone, f"{1000 * alone:.1f} mm alone, {1000 * both:.1f} mm with another trial"


@pytest.fixture(scope="module")
def people() -> list[Recording]:
    """Two people, three trials each."""
    return simulate_walks(subjects=2, frames=160, markers="plug-in-gait", trials=3, seed=11)


def test_other_people_and_copies_tell_nothing(people: list[Recording]) -> None:
    first, second, third, stranger = people[:4]
    guessed = replace(first, positions=first.positions + 1e-5)
    assert [one is second or one is third for one in trials_of_person(first, [second, guessed, stranger, third])] == [True, True]
    # Markers that were placed anew are other places on the skin.
    moved = replace(second, positions=second.positions + np.random.default_rng(0).normal(0.0, 0.02, (1, len(second.labels), 3)))
    few = second.select(second.labels[:3])
    assert trials_of_person(first, [moved, few]) == []


def test_a_marker_that_only_other_trials_show_is_predicted_and_said(people: list[Recording]) -> None:
    first, others = people[0], people[1:3]
    labels = ("LKNE", "RTIB", "LASI", "RELB")
    errors, inside = [], []
    for label in labels:
        fill = fill_gaps(without(first, (label, slice(None))), limit=1.0, others=[*others, people[3]])
        [finding] = fill.findings
        assert (finding.code, fill.trials, fill.filled.sum()) == ("gap-predicted", 2, len(first))
        column = first.labels.index(label)
        errors.append(off(fill, first).mean())
        apart = np.abs(fill.recording.positions - first.positions)[:, column]
        inside.append((apart < 1.96 * fill.deviation[:, [column]]).mean())
    assert np.max(errors) < 0.02 and 0.9 < np.mean(inside) < 0.995, (np.round(1000 * np.array(errors), 1), inside)
    # The pose alone tells: without other trials nothing does.
    assert not fill_gaps(without(first, ("LKNE", slice(None))), others=[people[3]]).gaps


def test_what_another_file_had_filled_is_not_taken_for_measured(people: list[Recording]) -> None:
    first, second = people[:2]
    guess = without(second, ("LKNE", slice(0, 150)))
    guess = fill_gaps(guess, limit=9.0).recording
    wrong = guess.positions + np.where(np.isfinite(filled_samples(guess)), 0.3, 0.0)[:, :, None]
    holed = without(first, ("LKNE", slice(40, 90)))
    clean = fill_gaps(holed, others=[guess], limit=9.0).recording
    np.testing.assert_array_equal(
        fill_gaps(holed, others=[replace(guess, positions=wrong)], limit=9.0).recording.positions, clean.positions
    )


@pytest.mark.parametrize("many", [1, 2, 3])
def test_few_markers_leave_time_alone(many: int) -> None:
    times = np.arange(200) / 100.0
    path = np.stack([np.sin(3.0 * times), 0.2 * np.cos(3.0 * times), 0.1 * times], axis=1)
    positions = np.stack([path + np.array([0.1 * i, 0.0, 0.0]) for i in range(many)], axis=1)
    whole = Recording(positions, tuple(f"M{i}" for i in range(many)), rate=100.0)
    fill = fill_gaps(without(whole, ("M0", slice(100, 104)), ("M0", slice(150, 200))))
    assert fill.filled[100:104, 0].all() and off(fill, whole).max() < 5e-4
    assert not fill.filled[150:, 0].any() and fill.findings


@pytest.mark.parametrize("frames", [0, 1, 2, 5, 9])
def test_short_recordings_end_in_a_finding_and_in_no_exception(walks: list[Recording], frames: int) -> None:
    short = walks[0].frames(slice(0, frames))
    fill = fill_gaps(without(short, ("LKNE", slice(0, 2)), ("RKNE", slice(1, None, 2))))
    assert len(fill.recording) == frames and (frames == 0 or fill.findings or fill.gaps)


@pytest.mark.parametrize(("label", "mate"), [("T10", "RBAK"), ("LTIB", "LANK")])
def test_a_neighbour_that_takes_another_label_in_the_gap_makes_the_fill_uncertain(walks: list[Recording], label: str, mate: str) -> None:
    positions, column = walks[0].positions.copy(), walks[0].labels.index(label)
    positions[150:, walks[0].labels.index(mate)] += np.array([0.0, 0.12, 0.10])
    positions[150:, column] = np.nan
    fill = fill_gaps(replace(walks[0], positions=positions), limit=1.0)
    inside = np.abs(fill.recording.positions - walks[0].positions)[150:, column] < 1.96 * fill.deviation[150:, [column]]
    assert inside.mean() > 0.9, f"{inside.mean():.2f} within {1000 * fill.reach:.1f} mm"


def test_frames_without_any_marker_stay_empty(walks: list[Recording]) -> None:
    positions = walks[0].positions.copy()
    positions[:60], positions[200:] = np.nan, np.nan
    fill = fill_gaps(replace(walks[0], positions=positions))
    assert not fill.filled[:30].any() and not fill.filled[230:].any()


@pytest.mark.parametrize("limit", [0.0, -1.0, np.nan, np.inf])
def test_a_limit_is_a_positive_length(walks: list[Recording], limit: float) -> None:
    with pytest.raises(AsterismError, match="positive length"):
        fill_gaps(walks[0], limit=limit)


def test_points_without_names_are_asked_to_be_labelled(walks: list[Recording]) -> None:
    with pytest.raises(AsterismError, match="asterism label"):
        fill_gaps(Recording.from_clouds(walks[0].clouds()))


def fourth(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(T, M) as ezc3d reads them: whether there is a position, the residual, and whether a camera is named."""
    data = ezc3d.c3d(str(path))["data"]
    meta = data["meta_points"]
    return np.isfinite(data["points"][0].T), meta["residuals"][0].T, meta["camera_masks"].any(axis=0).T


@pytest.mark.parametrize("measured", [0.0, 3.0], ids=["processed samples have 0", "measured samples have more"])
def test_filled_samples_are_told_from_measured_and_missing_ones_in_c3d(walks: list[Recording], measured: float, tmp_path: Path) -> None:
    walk = without(walks[0].select(walks[0].labels[:20]), (walks[0].labels[2], slice(50, 60)), (walks[0].labels[3], slice(0, 240)))
    formats.write(tmp_path / "walk.c3d", walk)
    raw = ezc3d.c3d(str(tmp_path / "walk.c3d"))
    raw["data"]["meta_points"]["residuals"][raw["data"]["meta_points"]["residuals"] == 0] = measured
    raw.write(str(tmp_path / "walk.c3d"))
    assert main(["convert", str(tmp_path / "walk.c3d"), str(tmp_path / "filled.c3d"), "--fill", "auto"]) == 1, "one marker is never seen"
    there, residuals, cameras = fourth(tmp_path / "filled.c3d")
    known, was, _ = fourth(tmp_path / "walk.c3d")
    filled = there & ~known
    assert filled.sum() == 10 and filled[50:60, 2].all()
    kinds = {name: {(r, c) for r, c in zip(residuals[one], cameras[one], strict=True)} for name, one in
             (("measured", known), ("filled", filled), ("missing", ~there))}  # fmt: skip
    assert not kinds["filled"] & kinds["measured"] and not kinds["filled"] & kinds["missing"], kinds
    np.testing.assert_array_equal(residuals[known], was[known])
    again = asterism.read(tmp_path / "filled.c3d")
    np.testing.assert_array_equal(np.isfinite(filled_samples(again)), filled)
    # A second round of writing keeps the flags.
    formats.write(tmp_path / "again.c3d", again)
    np.testing.assert_array_equal(fourth(tmp_path / "again.c3d")[1], residuals)


def test_convert_fills_and_says_so(walks: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    formats.write(tmp_path / "walk.c3d", without(walks[0], ("LKNE", slice(50, 60))))
    words = ["convert", str(tmp_path / "walk.c3d"), str(tmp_path / "out.trc"), "--fill", "8", "--json", str(tmp_path / "out.json")]
    assert main(words) == 0
    shown = capsys.readouterr()
    assert "1 gap (10 samples) filled" in shown.out and "which samples were filled" in shown.err
    assert json.loads((tmp_path / "out.json").read_text())["filled"]["markers"][0]["marker"] == "LKNE"
    assert asterism.read(tmp_path / "out.trc").visible.all()
    assert main([*words[:3], "--fill", "much", "--overwrite"]) == 2
    assert "--fill much" in capsys.readouterr().err


def test_convert_asks_the_trials_beside_and_names_them(people: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    holed, source = without(people[0], ("LKNE", slice(None))), tmp_path / "walk2.c3d"
    for name, trial in (("walk1", people[1]), ("walk2", holed), ("walk3", people[3])):
        formats.write(tmp_path / f"{name}.c3d", trial)
    (tmp_path / "walk0.c3d").write_bytes(b"damaged")
    words = ["convert", str(source), str(tmp_path / "out.c3d"), "--fill", "60", "--json", str(tmp_path / "out.json"), "--overwrite"]
    for choice, told in (([], ["walk1.c3d"]), (["none"], []), ([str(tmp_path / "walk3.c3d")], [])):
        assert main([*words, *(word for name in choice for word in ("--trials", name))]) == 1, "a marker that is never seen"
        assert json.loads((tmp_path / "out.json").read_text())["filled"]["trials"] == told
    assert main([*words, "--trials", "nowhere.c3d"]) == 2
    assert "nowhere.c3d" in capsys.readouterr().err


@pytest.mark.parametrize("length", [10, 50])
def test_a_spike_beside_the_gap_does_not_pull_the_fill_after_it(walks: list[Recording], length: int) -> None:
    spoilt = walks[0].positions.copy()
    spoilt[[98, 101 + length], walks[0].labels.index("LKNE")] += [[0.05], [-0.04]]
    gap = ("LKNE", slice(100, 100 + length))
    clean, beside = (off(fill_gaps(without(walk, gap)), walks[0]) for walk in (walks[0], replace(walks[0], positions=spoilt)))
    assert len(beside) == length and beside.mean() < 1.5 * clean.mean() + 0.0005, f"{1000 * beside.mean():.1f} mm"


def swinging_arm(seed: int) -> Recording:
    """A trunk that stands, and an arm of two rods that swings as it likes: poses in a gap are new, lengths are not."""
    rng = np.random.default_rng(seed)
    angles = gaussian_filter1d(rng.normal(size=(240, 4)), 25, axis=0)
    ahead, up, turn, lift = (0.6 * angles / angles.std(axis=0)).T

    def along(azimuth: np.ndarray, height: np.ndarray) -> np.ndarray:
        return np.stack([np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)], axis=1)

    trunk = np.broadcast_to([[0.0, 0.0, 0.0], [0.1, 0.2, 0.0], [0.0, -0.2, 0.1], [0.05, 0.0, 0.3]], (240, 4, 3))
    elbow = trunk[:, 1] + 0.3 * along(ahead, up - 1.0)
    wrist = elbow + 0.25 * along(turn, lift)
    arm = np.stack([elbow, wrist, wrist + 0.05 * along(turn + 1.0, lift)], axis=1)
    positions = np.concatenate([trunk, arm], axis=1) + rng.normal(0.0, 0.0002, (240, 7, 3))
    return Recording(positions, ("STRN", "RSHO", "LSHO", "C7", "RELB", "RWRA", "RFIN"), 100.0)


def test_distances_to_mates_mend_fills() -> None:
    arms = [swinging_arm(seed) for seed in range(6)]
    cut = [without(arm, ("RELB", slice(90, 130))) for arm in arms]
    told = [
        np.mean([off(fill_gaps(one, limit=9.0, rules=GapRules(lengths=many)), arm).mean() for one, arm in zip(cut, arms, strict=True)])
        for many in (0, 4)
    ]
    assert told[1] < 0.92 * told[0], f"{1000 * told[0]:.1f} mm without, {1000 * told[1]:.1f} mm with distances"


def test_a_segment_that_is_wholly_lost_is_left_and_said(walks: list[Recording]) -> None:
    leg = ("LKNE", "LTIB", "LANK", "LHEE", "LTOE")
    fill = fill_gaps(without(walks[0], *((label, slice(60, 180)) for label in (*leg, "LTHI"))))
    # The pelvis shows the upper end of the thigh.
    assert set(fill.by_marker()) <= {"LTHI"} and off(fill, walks[0]).max(initial=0.0) < 0.01
    assert set(leg) <= {finding.where for finding in fill.findings} and {finding.code for finding in fill.findings} == {"gap-not-filled"}


def test_mates_that_take_turns_to_be_missing_fill_a_gap_in_pieces(walks: list[Recording]) -> None:
    others = [label for label in walks[0].labels if label != "LTIB"]
    early, late = (
        tuple((label, frames) for label in part) for part, frames in ((others[:20], slice(70, 85)), (others[20:], slice(85, 100)))
    )
    fill = fill_gaps(without(walks[0], ("LTIB", slice(70, 100)), *early, *late), limit=1.0)
    column = walks[0].labels.index("LTIB")
    apart = np.linalg.norm(fill.recording.positions - walks[0].positions, axis=2)[70:100, column]
    assert fill.filled[70:100, column].all() and apart.max() < 0.04, f"{1000 * apart.max():.1f} mm"
