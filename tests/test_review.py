"""What a person should look at first: doubts ranked by what one touch mends, touches that settle them, the command and its page."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from models import trained

from asterism import formats
from asterism.cli import main
from asterism.errors import AsterismError
from asterism.labelling import ReviewItem, apply_answers, review
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.labelling.training.calibration import IN_TIME, LabelCalibration, LabelTrials
from asterism.recording import Clouds, Ints, Labelling, Recording
from asterism.report import ReviewEntry, review_report
from asterism.simulation import simulate_walks


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    return simulate_walks(subjects=5, frames=120, markers="helen-hayes", seed=3)


def sure(truth: Ints, names: tuple[str, ...]) -> Labelling:
    """The truth, said at 0.999; the missing markers at 0."""
    return Labelling(truth.copy(), np.where(truth >= 0, 0.999, 0.0), names)


def truth_of_points(truth: Ints, clouds: Clouds) -> Ints:
    frames, markers = np.nonzero(truth >= 0)
    out = np.full(len(clouds.xyz), -1)
    out[clouds.offsets[frames] + truth[frames, markers]] = markers
    return out


def a_long_piece(clouds: Clouds, truth: Ints, least: int = 30) -> tuple[int, Ints]:
    """A marker, and the points of one of its tracks."""
    assert clouds.tracks is not None
    marker_of = truth_of_points(truth, clouds)
    for track in np.unique(clouds.tracks):
        points = np.nonzero(clouds.tracks == track)[0]
        if least <= len(points) < len(clouds) and marker_of[points[0]] >= 0:
            return int(marker_of[points[0]]), points
    raise AssertionError("no track is long enough")


def test_a_doubtful_label_comes_first_and_gains_what_is_doubted(walks: list[Recording]) -> None:
    clouds, truth = simulate_gaps_and_ghosts(walks[0], 2, 0, seed=1)
    labelling = sure(truth, walks[0].labels)
    marker, points = a_long_piece(clouds, truth)
    frames = np.searchsorted(clouds.offsets, points, side="right") - 1
    labelling.confidence[frames, marker] = 0.6
    labelling.confidence[frames[7], marker] = 0.3
    [first, *rest] = review(labelling, clouds)
    assert first.marker == walks[0].labels[marker] and first.samples == len(points)
    assert first.gain == pytest.approx(0.4 * (len(points) - 1) + 0.7)
    assert (first.first_frame, first.last_frame, first.frame) == (frames[0], frames[-1], frames[7])
    assert sum(item.gain for item in rest) <= 0.001 * len(clouds.xyz) + 1e-9


def test_a_point_without_a_label_is_offered_the_missing_marker(walks: list[Recording]) -> None:
    clouds, truth = simulate_gaps_and_ghosts(walks[0], 2, 0, seed=1)
    labelling = sure(truth, walks[0].labels)
    marker, points = a_long_piece(clouds, truth)
    frames = np.searchsorted(clouds.offsets, points, side="right") - 1
    labelling.indices[frames, marker], labelling.confidence[frames, marker] = -1, 0.45
    first = review(labelling, clouds)[0]
    assert first.marker is None and first.alternatives[0] == (walks[0].labels[marker], pytest.approx(0.45))
    assert first.gain == pytest.approx(0.45 * len(points))


def test_the_best_candidate_of_a_missing_marker_is_asked_for_before_all_others(walks: list[Recording]) -> None:
    """Forty points that belong to nobody are as near; the labelling says which point it nearly was."""
    rng = np.random.default_rng(2)
    own = walks[0].positions
    frames = [np.concatenate([rng.normal(own.mean(axis=(0, 1)), 0.3, (40, 3)), frame]) for frame in own]
    numbers = [np.arange(55)] * len(own)
    clouds = Clouds.from_points(frames, walks[0].rate, walks[0].vertical, tracks=numbers)
    labelling = sure(np.tile(40 + np.arange(15), (len(own), 1)), walks[0].labels)
    labelling.indices[:, 3], labelling.confidence[:, 3] = -1, 0.4
    blind = review(labelling, clouds)
    candidates = np.full(labelling.indices.shape, -1)
    candidates[:, 3] = 43
    first, second, *_ = review(replace(labelling, candidates=candidates), clouds)
    assert first.track == 43 and first.alternatives == ((walks[0].labels[3], pytest.approx(0.4)),)
    assert first.gain == pytest.approx(0.4 * len(own))
    assert second.gain < 0.1 * first.gain and blind[0].gain < 0.5 * first.gain


def test_a_whole_recording_says_its_best_candidates(walks: list[Recording]) -> None:
    model = trained(walks[1:], seed=0, subjects=["b", "c", "d", "e"], miner=None)
    clouds, truth = simulate_gaps_and_ghosts(walks[0], 3, 3, seed=4)
    labelling = model.label(clouds)
    assert labelling.candidates is not None
    assert (labelling.candidates[labelling.indices >= 0] == -1).all() and (labelling.candidates < clouds.counts[:, None]).all()
    taken_back = (labelling.indices == -1) & (truth >= 0)
    assert (labelling.candidates[taken_back] == truth[taken_back]).all() and (labelling.confidence[labelling.candidates >= 0] > 0).all()


def test_a_missing_marker_is_no_item_where_no_point_is_left(walks: list[Recording]) -> None:
    clouds, truth = simulate_gaps_and_ghosts(walks[0], 3, 0, seed=1)
    labelling = Labelling(truth, np.where(truth >= 0, 1.0, 0.5), walks[0].labels)
    assert review(labelling, clouds, least_gain=0.0) == []


def test_a_piece_with_two_names_is_doubted_however_sure_they_are(walks: list[Recording]) -> None:
    clouds, truth = walks[0].clouds(), np.tile(np.arange(15), (120, 1))
    labelling = sure(truth, walks[0].labels)
    left, right = (walks[0].labels.index(name) for name in ("LTHI", "RTHI"))
    labelling.indices[50:60, [left, right]] = labelling.indices[50:60, [right, left]]
    first, second, *_ = review(labelling, clouds)
    assert {first.marker, second.marker} == {"LTHI", "RTHI"} and {first.alternatives[0][0], second.alternatives[0][0]} == {"LTHI", "RTHI"}
    assert 50 <= first.frame < 60 and 9 <= first.gain <= 11
    mended = apply_answers(labelling, clouds, [(first, first.marker), (second, second.marker)])
    np.testing.assert_array_equal(mended.indices, truth)


def test_settling_all_that_is_listed_mends_the_labels(walks: list[Recording]) -> None:
    ensemble = trained(walks[:2], miner=None, subjects=["a", "b"])
    clouds, truth = simulate_gaps_and_ghosts(walks[4], 4, 0, seed=5)
    labelling = ensemble.label_frames(clouds)
    marker_of = truth_of_points(truth, clouds)
    wrong = int((labelling.indices != truth).sum())
    items = review(labelling, clouds)
    assert wrong > 20, "the trial is too easy to say anything"
    answers = [(item, walks[4].labels[marker_of[item.points[0]]]) for item in items]
    few = apply_answers(labelling, clouds, answers[:3])
    assert wrong - int((few.indices != truth).sum()) >= 0.25 * sum(item.gain for item in items[:3])
    left = int((apply_answers(labelling, clouds, answers).indices != truth).sum())
    assert left <= 0.02 * wrong, f"{left} of {wrong} are left"
    assert len(answers) <= len(np.unique(clouds.tracks))


def test_an_answer_takes_the_marker_from_another_point_and_none_takes_it_away() -> None:
    frames = [np.array([[0.0, 0, 1], [1, 0, 1]])] * 4
    clouds = Clouds.from_points(frames, 100.0, tracks=[[7, 9]] * 4)
    labelling = Labelling(np.tile([0, -1], (4, 1)), np.tile([0.6, 0.4], (4, 1)), ("A", "B"))
    items = review(labelling, clouds)
    assert {(item.track, item.marker) for item in items} == {(7, "A"), (9, None)}
    free = next(item for item in items if item.track == 9)
    taken = apply_answers(labelling, clouds, [(free, "A")])
    assert taken.indices.tolist() == [[1, -1]] * 4 and taken.confidence.tolist() == [[1.0, 0.4]] * 4
    own = next(item for item in items if item.track == 7)
    assert apply_answers(labelling, clouds, [(own, None)]).indices.tolist() == [[-1, -1]] * 4
    assert labelling.indices.tolist() == [[0, -1]] * 4, "the given labelling changed"


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**31), st.integers(0, 3), st.booleans())
def test_items_are_disjoint_ranked_and_never_promise_more_than_they_hold(seed: int, ghosts: int, tracks: bool) -> None:
    rng = np.random.default_rng(seed)
    walk = simulate_walks(subjects=1, frames=25, markers="helen-hayes", seed=1)[0]
    clouds, truth = simulate_gaps_and_ghosts(walk, 2, ghosts, rng, number_tracks=tracks)
    indices = np.where(rng.random(truth.shape) < 0.7, truth, -1)
    labelling = Labelling(indices, rng.random(truth.shape), walk.labels)
    items = review(labelling, clouds, least_gain=0.0)
    points = np.concatenate([item.points for item in items])
    assert len(np.unique(points)) == len(points) == sum(item.samples for item in items)
    gains = [item.gain for item in items]
    assert gains == sorted(gains, reverse=True) and all(0 < item.gain <= item.samples + 1e-9 for item in items)
    assert all(item.first_frame <= item.frame <= item.last_frame for item in items)
    assert all(0 <= chance <= 1 + 1e-9 for item in items for _, chance in (*item.alternatives, ("", item.confidence)))
    free, missing = (clouds.counts - (indices >= 0).sum(axis=1)).sum(), np.where(indices < 0, 1.0, 0.0).sum()
    doubted = np.where(indices >= 0, 1.0, 0.0).sum() + min(free, missing)
    assert sum(gains) <= doubted + 1e-6
    assert review(labelling, clouds, top=2, least_gain=0.0) == items[:2]


def with_trials(right: float, people: int) -> LabelCalibration:
    """Calibrated on 200 labels in time of growing margin and usual fit."""
    none = np.zeros(200)
    trials = LabelTrials(np.linspace(0.0, 30.0, 200), none, none.astype(np.int64), np.full(200, right), np.ones(200))
    return LabelCalibration.fitted(trials, people, IN_TIME)


def test_where_all_trials_failed_a_tracklet_is_still_offered() -> None:
    """Two people, one stands and one walks: tried on each other every label is wrong, which proves little about the third."""
    confidence = with_trials(0.0, 2).confidence(np.array([-20.0, 0.0, 20.0]), np.zeros(3), np.zeros(3, dtype=np.int64))
    assert 0.1 < confidence[2] < 0.9 and confidence[0] < 0.05 and (np.diff(confidence) > 0).all()
    points = np.zeros((50, 1, 3))
    clouds = Clouds.from_points(list(points), 100.0)
    [item] = review(Labelling(np.full((50, 1), -1), np.full((50, 1), confidence[2]), ("A",)), clouds)
    assert item.gain == pytest.approx(50 * confidence[2]) and item.alternatives[0][0] == "A"


def test_few_people_are_believed_less() -> None:
    """All trials went well: with one person that proves less of a poor fit than with ten."""
    one, ten = (with_trials(1.0, people).confidence(10.0, -4.0, 0) for people in (1, 10))
    assert one < ten


def test_bad_input_is_named(walks: list[Recording]) -> None:
    clouds, truth = simulate_gaps_and_ghosts(walks[0], 1, 0, seed=1)
    labelling = sure(truth, walks[0].labels)
    with pytest.raises(AsterismError, match="does not belong to these clouds"):
        review(labelling, walks[1].frames(slice(0, 50)).clouds())
    with pytest.raises(AsterismError, match="top is 0"):
        review(labelling, clouds, top=0)
    with pytest.raises(AsterismError, match="least_gain"):
        review(labelling, clouds, least_gain=float("nan"))
    [item] = review(replace(labelling, confidence=labelling.confidence * 0.9), clouds, top=1)
    with pytest.raises(AsterismError, match="'NOSE'"):
        apply_answers(labelling, clouds, [(item, "NOSE")])


def test_nothing_in_nothing_out() -> None:
    clouds = Clouds.from_points([np.zeros((0, 3))] * 3, 100.0)
    assert review(Labelling(np.full((3, 2), -1), np.zeros((3, 2)), ("A", "B")), clouds) == []
    none = Clouds.from_points([], 100.0)
    assert review(Labelling(np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)), ("A", "B")), none) == []


# The command and its page


def run(*args: object) -> int:
    return main([str(arg) for arg in args])


@pytest.fixture(scope="module")
def folder(walks: list[Recording], tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("review")
    trained(walks[:2], miner=None, subjects=["a", "b"]).save(place / "two.model")
    formats.write(place / "labelled.c3d", walks[4])
    clouds, _ = simulate_gaps_and_ghosts(walks[4], 4, 1, seed=2)
    formats.write(place / "raw.c3d", Recording.from_clouds(clouds))
    (place / "broken.c3d").write_bytes(b"no")
    return place


def test_the_command_lists_pieces_by_gain(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("review", folder / "raw.c3d", folder / "labelled.c3d", "-m", folder / "two.model", "--top", "5")
    assert run(*words, "--json", folder / "r.json", "--report", folder / "r.html") == 0
    shown = capsys.readouterr().out
    told = json.loads((folder / "r.json").read_text())
    assert len(told["items"]) == 5 <= told["pieces"] and {Path(item["file"]).name for item in told["items"]} <= {"raw.c3d", "labelled.c3d"}
    gains = [item["gain"] for item in told["items"]]
    assert gains == sorted(gains, reverse=True) and sum(gains) <= told["gain"]
    assert f"{gains[0]:.1f}" in shown and f"{told['pieces']:,} pieces of tracks to look at" in shown
    page = (folder / "r.html").read_text(encoding="utf-8")
    data = json.loads(page.split('id="data">')[1].split("</script>")[0])
    (drawn,) = data["players"].values()
    assert [one["name"].split()[0] for one in drawn] == ["1.", "2.", "3.", "4.", "5."] and page.count("data-opens") >= 5
    for one, item in zip(drawn, told["items"], strict=True):
        assert one["firstFrame"] + one["firstShown"] + one["step"] * one["start"] == item["look_at"]


def test_what_the_file_says_is_kept_when_asked(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("review", folder / "labelled.c3d", "-m", folder / "two.model", "--keep-labels") == 0
    shares, verdict = capsys.readouterr().out.splitlines()
    assert (
        shares.endswith("100.00 % labelled, 0.00 % likely, 0.00 % unsure, 0.00 % hidden; ready")
        and verdict == "No piece of a track stands out."
    )


def test_a_batch_goes_on_after_a_bad_file(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("review", folder / "broken.c3d", folder / "raw.c3d", "-m", folder / "two.model", "--json", "-") == 1
    shown = capsys.readouterr()
    assert [Path(path).name for path in json.loads(shown.out)["failed"]] == ["broken.c3d"]
    assert "1 failed" in shown.err
    assert run("review", folder / "broken.c3d", "-m", folder / "two.model") == 2
    assert capsys.readouterr().out == "", "of a file that cannot be read nobody knows what is in doubt"


def test_frames_are_counted_as_the_file_counts(folder: Path, walks: list[Recording], capsys: pytest.CaptureFixture[str]) -> None:
    source = formats.read(folder / "raw.c3d")
    formats.write(folder / "later.npz", replace(source, first_frame=501))
    for name, first in (("raw.c3d", 1), ("later.npz", 501)):
        assert run("review", folder / name, "-m", folder / "two.model", "--json", "-") == 0
        item = json.loads(capsys.readouterr().out)["items"][0]
        assert first <= item["first_frame"] <= item["look_at"] <= item["last_frame"] < first + 120


def test_the_page_tells_files_of_one_name_apart(tmp_path: Path) -> None:
    item = ReviewItem(0, 9, 3, 1, "LKNE", 0.5, (("LTHI", 0.2),), 10, 5.0, np.arange(10))
    review_report(tmp_path / "p.html", [ReviewEntry(file, item) for file in ("a/walk.c3d", "b/walk.c3d", "b/turn.c3d")])
    page = (tmp_path / "p.html").read_text(encoding="utf-8")
    assert "1. a/walk.c3d" in page and "2. b/walk.c3d" in page and "3. turn.c3d" in page
    assert "LKNE 50.0 %" in page and "LTHI 20.0 %" in page
