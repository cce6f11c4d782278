"""The benchmarks' framework: what is kept, how it is judged, and that the page of tables is what the kept figures say."""

from __future__ import annotations

import json
import re
import sys
from datetime import date
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from asterism.errors import AsterismError
from asterism.hiding import hide_and_haunt
from asterism.recording import NULL, Labelling, Recording

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
benchmark_data, docs, figures, peer, score = (import_module(f"benchmarks.{name}") for name in ("data", "docs", "figures", "peer", "score"))


def test_kept_figures_have_the_agreed_form() -> None:
    entries = json.loads((ROOT / "benchmarks" / "figures.json").read_text(encoding="utf-8"))
    for entry in entries:
        assert list(entry) == ["issue", "row", "asked", "measured", "unit", "n", "command", "date"]
        assert entry["asked"] == "none" or re.fullmatch(r"(<=|>=|<|>|==) [-+.e\d]+", entry["asked"]), entry
        assert isinstance(entry["measured"], int | float) and np.isfinite(entry["measured"])
        assert entry["n"] > 0 and entry["unit"] and entry["command"].startswith("python -m benchmarks")
        date.fromisoformat(entry["date"])
    assert len({(entry["issue"], entry["row"]) for entry in entries}) == len(entries)


def test_page_of_tables_is_up_to_date() -> None:
    written = (ROOT / "docs" / "figures.md").read_text(encoding="utf-8")
    assert written == docs.text(figures.load()), "run `python -m benchmarks docs`"


def test_a_run_replaces_what_it_measured_and_keeps_the_rest(tmp_path: Path) -> None:
    path = tmp_path / "figures.json"
    figures.record("issue", [figures.Figure("a", "<= 0.5", 0.4, "fraction", 10), figures.Figure("b", "none", 2, "s", 1)], "run 1", path)
    figures.record("issue", [figures.Figure("a", "<= 0.5", 0.6, "fraction", 20)], "run 2", path)
    a, b = figures.load(path)
    assert (a.measured, a.n, a.command) == (0.6, 20, "run 2")
    assert (b.measured, b.command) == (2, "run 1")
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(ValueError, match="no number"):
        figures.record("issue", [figures.Figure("a", "none", float("nan"), "s", 1)], "run 3", path)
    assert figures.load(path) == [a, b]


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
    clouds, truth = hide_and_haunt(recording, 2, 1, seed=3)
    chosen = np.array([1, 4, 8])
    few, few_truth = score.some_frames(clouds, truth, chosen)
    assert len(few) == 3
    for place, frame in enumerate(chosen):
        np.testing.assert_array_equal(few[place], clouds[frame])
        np.testing.assert_array_equal(few_truth[place], truth[frame])


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
    clouds, truth = hide_and_haunt(test, 0, 0, seed=0)
    easy = score.Tally()
    easy.add(key_poses.label(clouds), truth)
    assert easy.right_share == 1.0
    clouds, truth = hide_and_haunt(test, 2, 2, seed=0)
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
            entry("table 5.4, subjects seen, 1 occlusion, target 99 %: FA", "< 0.08", 0.01),
            entry("table 5.4, subjects seen, 1 occlusion, target 99.9 %: FA", "< 0.01", 0.02),
            entry("movement, cmu41, 85 not seen, 3 occlusions: FA", "<= 0.005", 0.001),
            entry("movement, pig39, test not seen, test_movement as recorded: missed", "none", 0.5),
        ]
    )
    assert "| 1 occlusion | 1 % (asked < 8 %) | **2 % (asked < 1 %)** |" in page
    assert "| cmu41, 85 not seen | 0.1 % (asked <= 0.5 %) |  |" in page
    assert "2 of 3 figures asked for are reached" in page
