"""The benchmarks' framework: figures, tallies, splits, true names, peers, and what the command measures and prints."""

from __future__ import annotations

import json
import sys
from importlib import import_module
from inspect import isgeneratorfunction
from pathlib import Path

import numpy as np
import pytest

from asterism.errors import AsterismError
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts, simulate_occlusions
from asterism.recording import NULL, Labelling, Recording

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
benchmark_data, chapters, figures, score, script, worn, judged, rows = (
    import_module(f"benchmarks.{name}")
    for name in ("data", "chapters", "figures", "score", "script", "virtual.worn", "virtual.judged", "virtual.rows")
)


def test_every_row_of_every_chapter_is_a_generator_of_figures() -> None:
    for chapter, rows in chapters.CHAPTERS.items():
        for row in rows:
            assert isgeneratorfunction(chapters.row_of(chapter, row)), f"{chapter} {row}"


def test_unknown_rows_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        script.main(["labelling", "gaps"])
    assert "there is no row 'gaps' in labelling" in capsys.readouterr().err


def test_rows_are_printed_and_kept_and_a_row_that_fails_costs_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def measured(run: object) -> object:
        yield figures.Figure("a: right", ">= 0.9", 0.5, "fraction", 20)

    def failing(run: object) -> object:
        yield figures.Figure("b: time", "none", 2.0, "s", 1)
        raise AsterismError("no data")

    monkeypatch.setattr(script, "row_of", lambda chapter, row: {"stereo": measured, "charuco": failing}[row])
    assert script.main(["cameras", "charuco", "stereo", "--json", str(tmp_path / "rows.json")]) == 1
    told = capsys.readouterr()
    assert "MISSED" in told.out and "50 %" in told.out and "cameras charuco: AsterismError: no data" in told.err
    rows = json.loads((tmp_path / "rows.json").read_text(encoding="utf-8"))
    assert rows[1] == {"chapter": "cameras", "row": "a: right", "asked": ">= 0.9", "measured": 0.5, "unit": "fraction", "n": 20}
    assert rows[0]["row"] == "b: time"


def test_names_that_are_exchanged_in_a_file_are_put_right_before_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from asterism.formats import write

    recording = Recording(np.random.default_rng(0).normal(size=(5, 3, 3)), ("LKNE", "LTIB", "LANK"), 100.0)
    for place in ("gait/HC1", "gait/HC2"):
        (tmp_path / place).mkdir(parents=True)
        write(tmp_path / place / "walk.csv", recording)
    # ours and theirs may name one file; a hand of three goes round
    ours = '[[exchanged]]\nfile = "gait/HC2/walk.csv"\nnames = { LKNE = "LTIB", LTIB = "LANK", LANK = "LKNE" }\n'
    found = {"about": "names", "gait/HC1 (all files)": {"exchange": [["LKNE", "LTIB"]], "evidence": "by hand"}}
    (tmp_path / "corrections.json").write_text(json.dumps(found), encoding="utf-8")
    monkeypatch.setenv("ASTERISM_DATA", str(tmp_path))
    (tmp_path / "exchanged.toml").write_text(ours, encoding="utf-8")
    monkeypatch.setattr(benchmark_data, "OURS", tmp_path / "exchanged.toml")
    benchmark_data.corrections.cache_clear()
    one, other = (benchmark_data.true_names(tmp_path / f"gait/HC{n}/walk.csv") for n in (1, 2))
    chosen = benchmark_data.true_names(tmp_path / "gait/HC1/walk.csv", ["LTIB", "LANK"])
    benchmark_data.corrections.cache_clear()
    assert one.labels == ("LTIB", "LKNE", "LANK") and other.labels == ("LTIB", "LANK", "LKNE")
    assert chosen.labels == ("LTIB", "LANK")
    np.testing.assert_allclose(chosen.positions, recording.positions[:, [0, 2]], atol=1e-4)


@pytest.mark.parametrize(("measured", "unit", "n"), [(float("nan"), "s", 1), (1.0, "", 1), (1.0, "s", 0)])
def test_a_figure_without_number_unit_or_samples_is_refused(measured: float, unit: str, n: int) -> None:
    with pytest.raises(ValueError, match="needs a unit"):
        figures.Figure("a", "none", measured, unit, n)


@pytest.mark.parametrize(
    ("asked", "measured", "verdict"),
    [("<= 0.01", 0.01, True), ("< 0.01", 0.01, False), ("> 5", 6, True), (">= 25", 24, False), ("== 0", 0, True), ("none", 1, None)],
)
def test_asked_is_judged(asked: str, measured: float, verdict: bool | None) -> None:
    assert figures.reached(asked, measured) is verdict


def test_asked_must_be_an_expression() -> None:
    with pytest.raises(ValueError, match="expression"):
        figures.reached("about 3", 3)


def test_rates_are_those_of_a_frame_counted_by_hand() -> None:
    # Four markers: right, swapped for another point, visible but null, hidden and null; then a hidden marker that got a point.
    truth = np.array([[0, 1, 2, NULL], [0, 1, 2, NULL]])
    indices = np.array([[0, 3, NULL, NULL], [0, 1, 2, 3]])
    tally = score.Tally()
    tally.add(Labelling(indices, np.full((2, 4), 0.9), ("a", "b", "c", "d")), truth)
    assert tally.false_assignments == pytest.approx(2 / 6)
    assert tally.false_occlusions == pytest.approx(1 / 2)
    assert tally.missed_share == pytest.approx(1 / 6)
    assert tally.right_share == pytest.approx(4 / 6)


def test_some_frames_are_the_same_clouds_with_the_same_truth() -> None:
    rng = np.random.default_rng(0)
    recording = Recording(rng.normal(size=(9, 5, 3)), tuple("abcde"), 100.0)
    clouds, truth = simulate_occlusions(recording, 2, 1, seed=3)
    chosen = np.array([1, 4, 8])
    few, few_truth = score.some_frames(clouds, truth, chosen)
    assert len(few) == 3
    for place, frame in enumerate(chosen):
        np.testing.assert_array_equal(few[place], clouds[frame])
        np.testing.assert_array_equal(few_truth[place], truth[frame])


def test_frames_in_reverse_are_the_recording_backwards_with_its_tracks() -> None:
    recording = Recording(np.random.default_rng(0).normal(size=(60, 5, 3)), tuple("abcde"), 100.0)
    clouds, truth = simulate_gaps_and_ghosts(recording, 2, 1, seed=3)
    back, back_truth = score.some_frames(clouds, truth, np.arange(60)[::-1])
    np.testing.assert_array_equal(back_truth, truth[::-1])
    for frame in range(60):
        np.testing.assert_array_equal(back[frame], clouds[59 - frame])
        there, here = (slice(c.offsets[f], c.offsets[f + 1]) for c, f in ((clouds, 59 - frame), (back, frame)))
        np.testing.assert_array_equal(back.tracks[here], clouds.tracks[there])


def test_halves_share_no_frame_and_lose_none() -> None:
    trial = Recording(np.arange(31.0 * 3).reshape(31, 1, 3), ("a",), 100.0)
    one, other = benchmark_data._halves("set", "file", trial)
    for fold in (one, other):
        tested = trial.positions[fold.test[0].frames]
        assert sorted([*fold.train[0].positions[:, 0, 0], *tested[:, 0, 0]]) == sorted(trial.positions[:, 0, 0])
        assert len(tested) in (15, 16) and (np.diff(fold.test[0].frames) == 1).all()


def test_without_real_recordings_the_sentence_says_what_to_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ASTERISM_DATA", raising=False)
    with pytest.raises(AsterismError, match="set ASTERISM_DATA"):
        benchmark_data.folder()


def test_every_labelled_movement_file_is_tested_and_by_people_that_training_has_not_seen(data: Path) -> None:
    folds = list(benchmark_data.movement_folds())
    tested = {test.file for fold in folds for test in fold.test}
    index = json.loads((data / "movement" / "index.json").read_text(encoding="utf-8"))
    labelled = {file for file, entry in index.items() if entry.get("markers") and (data / "movement" / file).exists()}
    assert labelled - tested == {"qtm-fullbody/lem_static.trc"}, "the same trial as lem_static.c3d, and nothing else, is left out"
    for fold in folds:
        assert {recording.labels for recording in fold.train} == {test.recording.labels for test in fold.test}
        assert not fold.unseen or fold.person not in fold.train_people
        trained_on = {recording.positions.tobytes() for recording in fold.train}
        assert not any(test.recording.frames(test.frames).positions.tobytes() in trained_on for test in fold.test)


def test_blocks_of_ten_frames_share_no_frame_and_lose_none() -> None:
    recording = Recording(np.arange(47.0 * 3).reshape(47, 1, 3), ("a",), 100.0)
    even, odd = (benchmark_data.blocks(recording, odd=side).positions[:, 0, 0] / 3 for side in (False, True))
    assert sorted([*even, *odd]) == list(range(47))
    assert {int(frame) // 10 % 2 for frame in even} == {0} and {int(frame) // 10 % 2 for frame in odd} == {1}


def test_frames_hidden_anew_are_different_frames_once() -> None:
    truth = np.array([[0, 1], [0, 1], [0, 1]])
    labelling = Labelling(truth, np.ones((3, 2)), ("a", "b"))
    tally, other = score.Tally(), score.Tally()
    for _ in range(3):
        tally.add(labelling, truth, recording="walk")
    tally.add(Labelling(truth[:2], np.ones((2, 2)), ("a", "b")), truth[:2])
    assert (tally.frames, tally.distinct) == (11, 5)
    other.add(labelling, truth, recording="walk")
    other.add(labelling, truth, recording="turn")
    tally += other
    assert (tally.frames, tally.distinct) == (17, 8)
    figure = tally.figure("a", "none", tally.right_share)
    assert (figure.n, figure.measured, figure.unit) == (8, 1.0, "fraction")


def test_counts_of_a_file_by_how_sure_its_labels_were() -> None:
    # Five in view: one sure and wrong, one missed, three right; and a label of the one that is hidden, at 0.97.
    truth = np.array([[0, 1, 2], [0, 1, NULL]])
    labelling = Labelling(np.array([[0, 2, NULL], [0, 1, 2]]), np.array([[0.999, 0.995, 0.0], [0.92, 0.97, 0.97]]), ("a", "b", "c"))
    counts = judged.counted(labelling, truth)
    assert (counts.visible, counts.given, counts.right, counts.sure_and_wrong, counts.below) == (5, 5, 3, 1, 1)
    np.testing.assert_array_equal(counts.bins, [[1, 1], [2, 1], [2, 1]])
    both = judged.summed([counts, judged.counted(labelling, truth, refused=True)])
    assert (both.files, both.refused, both.right_share) == (2, 1, pytest.approx(3 / 5))
    np.testing.assert_array_equal(counts.bins, [[1, 1], [2, 1], [2, 1]])


def test_listed_recordings_wear_their_set_and_are_told_apart_by_person_and_split(data: Path) -> None:
    from asterism.recording import MarkerSet, shipped_marker_sets

    assert set(worn.sets()) <= set(shipped_marker_sets())
    for name in worn.sets():
        for one in worn.recordings_of(name)[:1]:
            labels = {MarkerSet.load(name).name_of(label) for label in one.everything().labels} - {None}
            assert len(labels) > 0.75 * len(MarkerSet.load(name)) or name == "helen-hayes", f"{one.file} wears {len(labels)} of {name}"
    assert {one.person for one in worn.recordings_of("cmu")} == {"cmu41 01 and 06", "cmu41 02", "cmu41 85"}
    assert all(
        one.split == (worn.JUDGE if "clinical" in one.file else worn.TUNE) for one in worn.recordings_of("plug-in-gait-lower", worn.TUNE)
    )
    assert {one.file.split("/")[0] for one in worn.recordings_of("helen-hayes", worn.TUNE)} == {"movement"}


def test_a_cloud_is_anonymous_and_its_truth_finds_each_marker_again(data: Path) -> None:
    one = next(one for one in worn.recordings_of("plug-in-gait") if one.file == "movement/pig39/test_movement.c3d")
    own, everything = worn.markers_only(one, 40), worn.with_extra_points(one, 40)
    for raw, hidden in ((False, 3), (True, 0)):
        clouds, truth = worn.anonymous(one, hidden, raw=raw, longest=40, seed=2)
        assert (clouds.columns == -1).all() and truth.shape == (40, 39)
        for frame in range(40):
            there = np.nonzero(truth[frame] != NULL)[0]
            assert len(there) == own.visible[frame].sum() - hidden
            np.testing.assert_array_equal(clouds[frame][truth[frame, there]], own.positions[frame, there])
        assert len(clouds[0]) == (int(everything.visible[0].sum()) if raw else 36)
