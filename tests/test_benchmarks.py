"""The benchmarks' framework: what is kept, how it is judged, and that the page of tables is what the kept figures say."""

from __future__ import annotations

import json
import re
import sys
from datetime import date
from importlib import import_module
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from asterism.errors import AsterismError
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts, simulate_occlusions
from asterism.recording import NULL, Clouds, Labelling, Recording
from asterism.tracking import LinkRules

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
benchmark_data, docs, figures, peer, runs, score, tracking, structure, sensitivity, ablation, dirt, loop_picture, main = (
    import_module(f"benchmarks.{name}")
    for name in (
        *("data", "docs", "figures", "peer", "runs", "score", "tracking"),
        *(
            "house.structure",
            "recordings.sensitivity",
            "recordings.ablation",
            "recordings.dirt",
            "recordings.loop_picture",
            "__main__",
        ),
    )
)


def test_kept_figures_have_the_agreed_form() -> None:
    entries = json.loads((ROOT / "benchmarks" / "figures.json").read_text(encoding="utf-8"))
    for entry in entries:
        assert list(entry) == ["issue", "row", "asked", "measured", "unit", "n", "command", "date", "draws", "ours", "commit", "sources"]
        assert entry["asked"] == "none" or re.fullmatch(r"(<=|>=|<|>|==) [-+.e\d]+", entry["asked"]), entry
        assert isinstance(entry["measured"], int | float) and np.isfinite(entry["measured"])
        assert entry["n"] > 0 and entry["unit"] and entry["command"].startswith("python -m benchmarks")
        date.fromisoformat(entry["date"])
    assert len({(entry["issue"], entry["row"]) for entry in entries}) == len(entries)


def test_pages_with_tables_are_up_to_date() -> None:
    entries = figures.load()
    page, key_page, recordings, readme = (
        (ROOT / name).read_text(encoding="utf-8") for name in ("docs/figures-all.md", "docs/figures.md", "docs/recordings.md", "README.md")
    )
    never, stale = (
        docs.never_in(page),
        docs.stale_in(page),
    )  # those that were when the page was written: it need not be written again after each change of the code
    assert page == docs.text(entries, stale, list(runs.load().values()), never), "run `python -m benchmarks docs`"
    assert key_page == docs.key_text(entries, stale), "run `python -m benchmarks docs`"
    for name, made in (("confidence", docs.with_reliability), ("cameras", docs.with_numbers)):
        written = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
        assert written == made(written, entries, stale), "run `python -m benchmarks docs`"
    assert readme == docs.with_results(readme, entries, stale), "run `python -m benchmarks docs`"
    assert recordings == docs.with_ablation(recordings, entries, stale), "run `python -m benchmarks docs`"


def test_every_row_of_the_benchmark_has_figures_or_is_named_as_one_without_and_every_figure_has_a_row() -> None:
    rows = {f"python -m benchmarks {name} --rows {row}" for name, chapter in main.CHAPTERS.items() for row in chapter.ROWS}
    measured = {entry.command for entry in figures.load()}
    assert measured <= rows
    assert set(docs.never_in((ROOT / "docs" / "figures-all.md").read_text(encoding="utf-8"))) == rows - measured


def test_every_row_of_the_page_of_key_figures_has_been_measured() -> None:
    measured = {entry.row for entry in figures.load()}
    rows = [row for _, _, rows in docs.KEY_SECTIONS for row in rows]
    assert len(rows) == len(set(rows)) == 25
    assert [row for row in rows if row not in measured] == []
    assert all((ROOT / "docs" / re.search(r"\((.*)\)", plot)[1]).exists() for _, plot, _ in docs.KEY_SECTIONS)


def test_numbers_in_sentences_are_those_of_their_rows() -> None:
    entry = figures.Entry("issue", "a, b: right", "none", 0.5, "fraction", 100, "run", "2026-01-01")
    page = "Of all <!-- row: a, b: right -->?<!-- end --> are right, and <!-- row: a, b: right -->3 %<!-- end --> again."
    marked = "<!-- row: a, b: right -->50 %{}<!-- end -->"
    for stale, note in (([], ""), (["run"], " (stale)")):
        shown = marked.format(note)
        assert docs.with_numbers(page, [entry], stale) == f"Of all {shown} are right, and {shown} again."
    with pytest.raises(ValueError, match="a, b: right"):
        docs.with_numbers(page, [])


def test_the_table_of_reliability_has_a_line_for_each_model_and_way() -> None:
    def entry(row: str, measured: float) -> figures.Entry:
        return figures.Entry("issue", f"reliability, {row}", "none", measured, "fraction", 100, "run", "2026-01-01")

    empty = docs.with_reliability(docs._RELIABILITY_BEGIN + docs._RELIABILITY_END, [])
    assert "has not been run" in empty
    rows = ("gait, ten taught, frame by frame: right at 0.99 to 0.999", "gait, ten taught, frame by frame: stated at 0.99 to 0.999")
    full = docs.with_reliability(empty, [entry(row, measured) for row, measured in zip(rows, (0.5, 0.75), strict=True)])
    assert "| gait, ten taught, frame by frame | 75 % | 50 % |  |  |  |" in full


def test_the_ablation_stands_in_the_page_about_recordings_once_it_is_measured() -> None:
    page = (ROOT / "docs" / "recordings.md").read_text(encoding="utf-8")

    def entry(row: str, measured: float) -> figures.Entry:
        return figures.Entry("issue", row, "none", measured, "fraction", 100, "run", "2026-01-01")

    bare = docs.with_ablation(page, [])
    assert "| frame only |" not in bare and docs.with_ablation(bare, []) == bare
    rows = ("ablation, frame only, 3 hidden: right", "ablation, + tracks, 3 hidden: right", "ablation, + own calibration, 3 hidden: right")
    full = docs.with_ablation(bare, [entry(row, 0.5) for row in rows])
    assert "| frame only | 50 % |\n| + tracks | 50 % |\n| + own calibration | 50 % |\n" in full
    assert docs.with_ablation(full, []) == bare


def test_a_run_replaces_what_it_measured_and_keeps_the_rest(tmp_path: Path) -> None:
    path = tmp_path / "figures.json"
    figures.record("issue", [figures.Figure("a", "<= 0.5", 0.4, "fraction", 10), figures.Figure("b", "none", 2, "s", 1)], "run 1", path)
    figures.record("issue", [figures.Figure("a", "<= 0.5", 0.6, "fraction", 20)], "run 2", path)
    a, b = figures.load(path)
    assert (a.measured, a.n, a.command) == (0.6, 20, "run 2")
    assert (b.measured, b.command) == (2, "run 1")
    assert list(tmp_path.iterdir()) == [path]


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
    assert tally.perfect_share == 0
    assert tally.calibration_error == pytest.approx(0.9 - 4 / 6)


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


def _crossing(frames: int = 100) -> Recording:
    """Three markers 0.2 m apart at 2 m/s; the third passes closely under the second, at right angles."""
    t = np.arange(frames) / 100.0
    straight = np.stack([2 * t, 0 * t, 0 * t + 1], axis=1)
    across = np.stack([2 * t, 2 * (t - 0.5) + 0.2, 0 * t + 0.95], axis=1)
    return Recording(np.stack([straight, straight + np.array([0, 0.2, 0]), across], axis=1), ("a", "b", "c"), 100.0)


def test_tracking_keeps_its_velocity_over_a_crossing_and_a_short_gap_but_loses_who_turns_in_a_long_one() -> None:
    recording = _crossing()
    clouds, truth = simulate_gaps_and_ghosts(recording, 0, 0, seed=0)
    assert (tracking.follow(recording.positions[0], clouds, recording.labels).indices == truth).all()
    gone = recording.positions.copy()
    gone[30:40, 0] = np.nan
    clouds, truth = simulate_gaps_and_ghosts(Recording(gone, recording.labels, 100.0), 0, 0, seed=0)
    assert (tracking.follow(recording.positions[0], clouds, recording.labels).indices == truth).all()
    turned = recording.positions.copy()
    turned[60:, 0, 0] = turned[60, 0, 0] - 5 * (turned[60:, 0, 0] - turned[60, 0, 0])
    turned[30:80, 0] = np.nan
    clouds, truth = simulate_gaps_and_ghosts(Recording(turned, recording.labels, 100.0), 0, 0, seed=0)
    indices = tracking.follow(recording.positions[0], clouds, recording.labels).indices
    assert (indices[80:, 0] != truth[80:, 0]).all() and (indices[:, 1:] == truth[:, 1:]).all()


def test_tracks_vote_and_the_loser_of_a_marker_stays_null() -> None:
    # Track 0 has four frames, three of them labelled a; track 1 has four frames, two labelled b and one a: no majority.
    # Track 2 lives beside track 0 in its last two frames and claims a too, with fewer votes.
    points = [np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((3, 3)), np.zeros((3, 3))]
    clouds = Clouds.from_points(points, 100.0, tracks=[[0, 1], [1, 0], [0, 1, 2], [2, 1, 0]])
    indices = np.array([[0, 1], [1, 0], [0, NULL], [0, 1]])
    voted = ablation.by_majority(Labelling(indices, np.full((4, 2), 0.9), ("a", "b")), clouds)
    np.testing.assert_array_equal(voted.indices[:, 0], [0, 1, 0, 2])
    np.testing.assert_array_equal(voted.indices[:, 1], [1, 0, 1, 1])
    doubtful = ablation.by_majority(Labelling(indices, np.full((4, 2), 0.6), ("a", "b")), clouds)
    assert (doubtful.indices == NULL).all()


def test_pieces_that_can_be_no_marker_are_counted_apart() -> None:
    # Two markers, two pieces: the first piece lives while both markers are there, the second while marker b is gone.
    truth = np.array([[0, 1, 2, NULL], [0, 1, 2, NULL], [0, NULL, NULL, 1], [0, NULL, NULL, 1]])
    labelling = Labelling(np.array([[0, 1], [2, 1], [0, 1], [0, NULL]]), np.ones((4, 2)), ("a", "b"))
    np.testing.assert_array_equal(dirt._pieces(labelling, truth), [4, 2, 2, 1])


def test_halves_share_no_frame_and_lose_none() -> None:
    trial = Recording(np.arange(31.0 * 3).reshape(31, 1, 3), ("a",), 100.0)
    one, other = benchmark_data._halves("set", "file", trial)
    for fold in (one, other):
        tested = trial.positions[fold.test[0].frames]
        assert sorted([*fold.train[0].positions[:, 0, 0], *tested[:, 0, 0]]) == sorted(trial.positions[:, 0, 0])
        assert len(tested) in (15, 16) and (np.diff(fold.test[0].frames) == 1).all()


def test_unknown_rows_are_refused_and_known_ones_belong_to_their_chapter(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main.main(["labelling", "--rows", "gaps"])
    assert "there is no row 'gaps' in labelling" in capsys.readouterr().err
    for chapter in main.CHAPTERS.values():
        assert chapter.ISSUE and chapter.ROWS


def _stick_figures(frames: int, seed: int) -> Recording:
    """Eight markers that keep their heights, turned and moved anywhere, 5 mm of noise."""
    rng = np.random.default_rng(seed)
    body = np.array(
        [
            [0.0, 0, 1.7],
            [0.1, 0.2, 1.4],
            [0.1, -0.25, 1.4],
            [0, 0.15, 0.9],
            [0, -0.12, 0.95],
            [0.1, 0.1, 0.5],
            [0.05, -0.1, 0.45],
            [0.2, 0.1, 0.1],
        ]
    )
    turn = rng.uniform(0, 2 * np.pi, frames)
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    turned = np.stack(
        [cos * body[:, 0] - sin * body[:, 1], sin * body[:, 0] + cos * body[:, 1], np.broadcast_to(body[:, 2], (frames, 8))], axis=2
    )
    moved = turned + np.concatenate([rng.uniform(-2, 2, (frames, 1, 2)), np.zeros((frames, 1, 1))], axis=2)
    return Recording(moved + rng.normal(0, 0.005, moved.shape), tuple("abcdefgh"), 100.0)


@pytest.mark.parametrize("vertical", [(0.0, 0.0, 1.0), (0.0, 1.0, 0.0)])
def test_the_peer_labels_what_is_easy_and_has_no_doubt(vertical: tuple[float, float, float]) -> None:
    train, test = _stick_figures(60, seed=1), _stick_figures(12, seed=2)
    if vertical[1]:
        train, test = (Recording(r.positions[:, :, [0, 2, 1]] * [-1, 1, 1], r.labels, r.rate, np.array(vertical)) for r in (train, test))
    key_poses = peer.KeyPoses.fit([train])
    clouds, truth = simulate_occlusions(test, 0, 0, seed=0)
    easy = score.Tally()
    easy.add(key_poses.label(clouds), truth)
    assert easy.right_share == 1.0
    clouds, truth = simulate_occlusions(test, 2, 2, seed=0)
    haunted = score.Tally()
    haunted.add(key_poses.label(clouds), truth)
    assert haunted.false_assignments > 0.02, "ghosts must mislead a method that always answers"


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


def test_page_shows_cells_where_they_belong_and_what_was_missed() -> None:
    def entry(row: str, asked: str, measured: float) -> object:
        return figures.Entry("issue", row, asked, measured, "fraction", 7, "python -m benchmarks", "2026-01-01")

    page = docs.text(
        [
            entry("table 5.4, thesis rules, subjects seen, 1 occlusion, target 99 %: FA", "< 0.08", 0.01),
            entry("table 5.4, thesis rules, subjects seen, 1 occlusion, target 99.9 %: FA", "< 0.01", 0.02),
            entry("movement, cmu41, 85 not seen, 3 occlusions: FA", "<= 0.005", 0.001),
            entry("movement, pig39, test not seen, test_movement as recorded: missed", "none", 0.5),
            entry("gaps, 3 hidden, backwards in time, whole recording: right", "none", 0.99),
            entry("gaps, 3 hidden + 3 ghosts, tracking: FA", "none", 0.25),
            entry("change, 3 hidden, backwards in time: FA gained", "<= 0.001", -0.0002),
            entry("ablation, + tracks, 3 hidden + 3 ghosts: right", "none", 0.5),
            entry("movement, cmu41, 02 not seen, 3 hidden, frame by frame: FA", "none", 0.03),
        ]
    )
    assert "| thesis rules, subjects seen, 1 occlusion | 1 % (asked < 8 %) | **2 % (asked < 1 %)** |" in page
    assert "| cmu41, 85 not seen | 0.1 % (asked <= 0.5 %) |  |" in page
    assert "| 3 hidden, backwards in time | 99 % |" in page and "| 3 hidden + 3 ghosts |  | 25 % |" in page
    assert "| 3 hidden, backwards in time | -0.02 % (asked <= 0.1 %) |" in page
    assert "| + tracks | 50 % |" in page and "3 hidden, frame by frame: FA |" in page
    assert "3 of 4 figures asked for are reached" in page


def test_arguments_lines_and_complexity_are_counted_as_the_row_says(tmp_path: Path) -> None:
    source = tmp_path / "room.py"
    branches = "\n".join(f"    if a == {n}:\n        return {n}" for n in range(16))
    source.write_text(
        'class A:\n    def f(self, a, b, *c, d=1, **e):\n        """Text\n\n        more."""\n        # a comment\n\n        return a\n\n\n'
        f"@kernel\ndef k(a):\n    return a\n\n\ndef branched(a):\n{branches}\n",
        encoding="utf-8",
    )
    found = {function.name: function for function in structure.functions(tmp_path)}
    assert (found["f"].arguments, found["f"].lines) == (5, 2)
    assert found["k"].kernel and not found["f"].kernel
    assert structure.too_complex(tmp_path) == {(source, found["branched"].line)}


def test_a_tuned_number_is_changed_for_a_while_wherever_it_stands() -> None:
    standing = LinkRules()
    with sensitivity.multiplied(LinkRules, "ratio_test", 0.5):
        assert (standing.ratio_test, LinkRules().ratio_test, LinkRules(ratio_test=7.0).ratio_test) == (1.25, 1.25, 7.0)
        assert LinkRules().noise == 0.002
    assert standing == LinkRules() and standing.ratio_test == 2.5
    for rules, field in sensitivity.NUMBERS:
        assert getattr(rules(), field) != 0


def test_the_picture_of_the_loop_shows_every_round() -> None:
    line, picture = loop_picture.Line, loop_picture.picture
    lines = [line("Ann", False, [(0.0, 0.1), (0.001, 0.01), (0.004, 0.0)]), line("Ben, named", True, [(0.0, 0.05), (0.0, 0.0)])]
    drawn = ElementTree.fromstring(picture(lines, 11))
    space = "{http://www.w3.org/2000/svg}"
    dots = [(float(dot.get("cx", "")), float(dot.get("cy", ""))) for dot in drawn.iter(f"{space}circle")]
    assert len(dots) == 5
    assert dots[0][0] < dots[1][0] < dots[2][0] and dots[0][1] < dots[1][1] < dots[2][1], "more hand work to the right, fewer errors below"
    words = [text.text or "" for text in drawn.iter(f"{space}text")]
    assert {"from Ann", "from Ben, named"} <= set(words) and any("11 people" in word for word in words)
    picture([line("nobody", False, [(0.0, 0.0)])], 1)


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
    assert (figure.n, figure.draws, figure.measured, figure.unit) == (8, 17, 1.0, "fraction")
    once = score.Tally()
    once.add(labelling, truth)
    assert once.figure("a", "none", 1.0).draws == 0
