"""The reports: self-contained pages whose tables say what the data say, also without scripts and for odd input."""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.labelling import ConfidenceScore, ConfidenceTally, Reliability
from asterism.labelling.partial.capturability import TargetRates
from asterism.labelling.partial.full_solver_study import ChosenClassifier, SolverSize
from asterism.labelling.simulated_occlusions import simulate_occlusions
from asterism.recording import Clouds, Ints, Labelling, MarkerSet, Recording, label_states
from asterism.report import (
    LabelledRecording,
    capturability_report,
    evaluation_report,
    label_report,
    marker_bones,
    marker_sides,
    plot_recording,
)
from asterism.report.player import PageRules, ShownRecording, pack_recordings
from asterism.simulation import simulate_walks


class Reader(HTMLParser):
    """A page as a reader without scripts has it: text, tables as lists of rows, and what the page would load."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tables: list[list[list[str]]] = []
        self.loads: list[str] = []
        self.text = ""
        self.json = ""
        self._stack: list[str] = []
        self._kind = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.loads += [str(given[name]) for name in ("src", "href", "action", "data", "srcset") if name in given]
        if tag == "script":
            self._kind = given.get("type") or "code"
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
        if tag not in ("meta", "input", "link", "br", "circle", "path"):
            self._stack.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag in self._stack:
            while self._stack.pop() != tag:
                pass

    def handle_data(self, data: str) -> None:
        if self._stack and self._stack[-1] == "script":
            self.json += data if self._kind == "application/json" else ""
        elif self._stack and self._stack[-1] != "style":
            self.text += data
            if self._stack[-1] in ("td", "th"):
                self.tables[-1][-1][-1] += data

    def table(self, first: str) -> dict[str, list[str]]:
        """The rows of the table whose head starts with `first`, by their first cell."""
        rows = next(rows for rows in self.tables if rows[0][0] == first)
        return {row[0]: row[1:] for row in rows}


def read(path: Path) -> Reader:
    return Reader(path.read_text(encoding="utf-8"))


def labelled(recording: Recording, seed: int = 0) -> tuple[Clouds, Ints, Labelling]:
    """Two hidden, two ghosts; LTHI and RTHI swapped in the first ten frames, LKNE left out in the next five."""
    clouds, truth = simulate_occlusions(recording, 2, 2, seed)
    indices, confidence = truth.copy(), np.where(truth >= 0, 0.995, 0.1)
    left, right, knee = (recording.labels.index(name) for name in ("LTHI", "RTHI", "LKNE"))
    indices[:10, [left, right]] = indices[:10, [right, left]]
    indices[10:15, knee] = -1
    return clouds, truth, Labelling(indices, confidence, recording.labels)


@pytest.fixture(scope="module")
def walk() -> Recording:
    return simulate_walks(1, frames=150, seed=2)[0]


def make_label_page(path: Path, walk: Recording, **changes: Any) -> Reader:
    clouds, truth, labelling = labelled(walk)
    arguments: dict[str, Any] = {
        "title": "A walk",
        "files": [{"file": "folder/walk.c3d", "frames": len(clouds), "frames_per_second": 1234.0}],
        "model_info": {"model": "gait.model", "seed": 7},
    }
    shown = {"labelling": labelling, "clouds": clouds, "truth": truth}
    shown.update({key: value for key, value in changes.items() if key in shown})
    arguments.update({key: value for key, value in changes.items() if key not in shown})
    label_report(path, LabelledRecording(**shown), **arguments)
    return read(path)


# What a labelled recording's page says


def test_the_label_page_tells_right_wrong_and_missed(tmp_path: Path, walk: Recording) -> None:
    _, truth, labelling = labelled(walk)
    page = make_label_page(tmp_path / "page.html", walk)
    told = page.table("")
    given, seen = labelling.indices >= 0, truth >= 0
    right = given & (labelling.indices == truth)
    assert told["right label"][0] == f"{right.sum():,}"
    wrong = int(told["wrong label: the marker is at another point"][0]) + int(told["wrong label: the marker was hidden"][0])
    assert wrong == (given & ~right).sum() > 0
    assert told["missed: visible, but no label"][0] == str((seen & ~given).sum())
    markers = page.table("marker")
    assert set(markers) == {"marker", *walk.labels}
    column = markers["marker"].index("wrong")
    assert {name for name, row in markers.items() if row[column] not in ("wrong", "0")} == {"LTHI", "RTHI"}


def test_the_label_page_names_file_model_seed_and_version(tmp_path: Path, walk: Recording) -> None:
    page = make_label_page(tmp_path / "page.html", walk)
    for expected in ("A walk", "walk.c3d", "gait.model", "seed", "7", "1,234", "Asterism", "written"):
        assert expected in page.text
    assert page.table("file")["walk.c3d"][0] == "150"


def test_without_the_truth_nothing_is_called_right(tmp_path: Path, walk: Recording) -> None:
    page = make_label_page(tmp_path / "page.html", walk, truth=None)
    assert "right label" not in page.text
    assert page.table("marker")["marker"][-1] == "lowest confidence"


def test_several_files_are_summed_up_by_their_frames(tmp_path: Path, walk: Recording) -> None:
    files = [
        {"file": "a.c3d", "frames": 300, "labelled": 1.0, "unsure": 0.0, "hidden": 0.0, "frames_per_second": 100.0},
        {"file": "b.c3d", "frames": 100, "labelled": 0.2, "unsure": 0.8, "hidden": 0.0, "frames_per_second": 50.0},
    ]
    page = make_label_page(tmp_path / "page.html", walk, files=files)
    assert "80.00 %" in page.text  # labelled: (300 * 1 + 100 * 0.2) / 400
    assert re.search(r"\b80\s*frames per second", page.text)  # 400 frames in 3 s + 2 s


def test_the_table_of_files_says_which_can_be_used(tmp_path: Path, walk: Recording) -> None:
    shares = {"frames": 100, "labelled": 1.0, "unsure": 0.0, "hidden": 0.0, "frames_per_second": 100.0}
    files = [
        {"file": "a.c3d", **shares, "verdict": "fits", "readiness": "ready", "use": "ready"},
        {"file": "b.c3d", **shares, "verdict": "other person or movement", "readiness": "look", "use": "look at 3"},
    ]
    rows = make_label_page(tmp_path / "page.html", walk, files=files).table("file")
    assert rows["a.c3d"][0] == "ready" and rows["b.c3d"][0] == "look at 3, other person or movement"


# What every page is


def test_the_label_page_says_what_was_found(tmp_path: Path, walk: Recording) -> None:
    assert "What to know" not in "".join(make_label_page(tmp_path / "without.html", walk).text)
    found = Finding("label-vertical", Severity.WARNING, "walk.c3d", "walk.c3d: y is up & not z.", "Say it.")
    text = "".join(make_label_page(tmp_path / "with.html", walk, findings=[found]).text)
    assert "What to know before using it" in text and "y is up & not z." in text


def test_pages_are_self_contained_and_small(tmp_path: Path, walk: Recording) -> None:
    path = tmp_path / "page.html"
    page = make_label_page(path, walk)
    assert page.loads == []
    assert path.stat().st_size < 0.5e6
    assert list(tmp_path.iterdir()) == [path]
    assert "@import" not in path.read_text(encoding="utf-8").split("</style>")[0]


def shown_in(page: Reader) -> list[dict[str, Any]]:
    """The recordings of a page's player."""
    (recordings,) = json.loads(page.json)["players"].values()
    return list(recordings)


@pytest.mark.slow
def test_a_page_of_thirteen_recordings_stays_small_and_shows_all(tmp_path: Path) -> None:
    """Thirteen of 3,000 frames and 39 markers are 1.5 million points."""
    rng = np.random.default_rng(1)
    long = simulate_walks(1, frames=3000, markers="plug-in-gait")[0]
    shown = []
    for _ in range(13):
        noisy = replace(long, positions=long.positions + rng.normal(0.0, 0.002, long.positions.shape))
        clouds, truth = simulate_occlusions(noisy, 0, 0)
        shown.append(LabelledRecording(Labelling(truth, np.full(truth.shape, 0.995), long.labels), clouds, first_frame=501))
    label_report(tmp_path / "page.html", shown, title="Many", files=[{"file": f"{i}.c3d"} for i in range(13)])
    assert (tmp_path / "page.html").stat().st_size < 2.5e6
    recordings = shown_in(read(tmp_path / "page.html"))
    assert len(recordings) == 13
    for packed in recordings:
        assert len(packed["bones"]) == 38, "the bones join all 39 markers"
        assert packed["timeline"]["columns"] <= 600 and packed["firstFrame"] == 501
        assert packed["rate"] / packed["step"] >= 2.0 and packed["frames"] == -(-3000 // packed["step"])


@pytest.mark.parametrize("name", ["</script><script>alert(1)</script>.c3d", "a<b>&\"'.c3d", "Jürgen – 歩行.c3d"])
def test_names_of_files_and_markers_cannot_break_the_page(tmp_path: Path, walk: Recording, name: str) -> None:
    _, _, labelling = labelled(walk)
    odd = Labelling(labelling.indices, labelling.confidence, (name, *labelling.names[1:]))
    page = make_label_page(tmp_path / "page.html", walk, files=[{"file": name}], labelling=odd, title=name)
    assert name in page.table("marker")
    assert shown_in(page)[0]["markers"][0] == name


def test_names_that_turn_the_text_are_shown_as_they_are(tmp_path: Path, walk: Recording) -> None:
    page = make_label_page(tmp_path / "page.html", walk, files=[{"file": "walk\u202egnp.c3d"}], title="a\u2066b\x1b[31m")
    assert "walk\ufffdgnp.c3d" in page.table("file") and "a\ufffdb\ufffd[31m" in page.text


def unpacked(packed: dict[str, Any]) -> dict[str, Any]:
    """What the player makes of a packed recording, in NumPy: frame, place, series, code and marks of each point."""
    data = zlib.decompress(base64.b64decode(packed["points"]["data"]))
    ends = np.cumsum([0, *packed["points"]["lengths"]])
    parts = [data[a:b] for a, b in pairwise(ends)]
    counts = packed["counts"]

    def numbers(part: bytes) -> list[int]:
        out, value, shift = [], 0, 0
        for byte in part:
            value, shift = value | (byte & 127) << shift, shift + 7
            if byte < 128:
                out.append(value)
                value, shift = 0, 0
        return out

    def summed(values: list[int], order: int) -> np.ndarray[Any, Any]:
        out, first = np.array(values, dtype=np.int64), 0
        for count in counts:
            for done in range(order, 0, -1):
                out[first + done - 1 : first + count] = np.cumsum(out[first + done - 1 : first + count])
            first += count
        return out

    signed = [[-(v + 1) // 2 if v % 2 else v // 2 for v in numbers(part)] for part in parts[1:4]]
    return {
        "frame": summed(numbers(parts[0]), 1),
        "xyz": np.stack([summed(axis, 2) for axis in signed], axis=1) * packed["unit"],
        "marker": np.repeat(packed["series"], counts),
        "code": np.frombuffer(parts[4], dtype=np.uint8),
        "marks": np.frombuffer(parts[5], dtype=np.uint8),
    }


@pytest.mark.parametrize("scale", [1.0, 0.05, 300.0])
def test_positions_in_the_player_are_those_of_the_labels(tmp_path: Path, scale: float) -> None:
    """Upright whatever the vertical, not mirrored, all points, at the file's frames; a mouse as well as a stadium."""
    sideways = simulate_walks(1, frames=120, vertical="-y", seed=3)[0]
    sideways = replace(sideways, positions=scale * sideways.positions)
    clouds, truth = simulate_occlusions(sideways, 2, 3, seed=1)
    labelling = Labelling(truth, np.where(truth >= 0, 0.99, 0.0), sideways.labels)
    page = make_label_page(tmp_path / "p.html", sideways, labelling=labelling, clouds=clouds, truth=truth)
    (packed,) = shown_in(page)
    points = unpacked(packed)
    assert len(points["frame"]) == len(clouds.xyz) and packed["step"] == 1
    order = np.argsort(points["frame"], kind="stable")
    np.testing.assert_array_equal(points["frame"][order], clouds.frame_of)
    tolerance = 0.5 * packed["unit"] + 1e-9
    assert packed["unit"] == (1e-5 if scale == 0.05 else 1e-3)
    for t in range(0, 120, 7):
        own = points["frame"] == t
        for m in range(len(sideways.labels)):
            there = points["xyz"][own & (points["marker"] == m)]
            assert len(there) == (truth[t, m] >= 0)
        np.testing.assert_allclose(np.sort(points["xyz"][own][:, 2]), np.sort(clouds[t] @ sideways.vertical), atol=tolerance)
        shown = points["xyz"][own & (points["marker"] >= 0)]
        true = clouds[t][truth[t][truth[t] >= 0]]
        np.testing.assert_allclose(*(np.linalg.norm(p[:, None] - p[None], axis=2) for p in (shown, true)), atol=4 * tolerance)
        assert np.sign(np.linalg.det(shown[1:4] - shown[0])) == np.sign(np.linalg.det(true[1:4] - true[0])), "the body is mirrored"


def test_wrong_labels_are_marked_where_they_are(tmp_path: Path, walk: Recording) -> None:
    clouds, truth, labelling = labelled(walk)
    (packed,) = shown_in(make_label_page(tmp_path / "page.html", walk))
    points = unpacked(packed)
    wrong = (labelling.indices >= 0) & (labelling.indices != truth)
    marked = points["marks"] == 1
    found = np.zeros_like(wrong)
    found[points["frame"][marked], points["marker"][marked]] = True
    np.testing.assert_array_equal(found, wrong)
    stated = np.array([2 + round(198 * -np.log10(1 - confidence) / 4) for confidence in (0.995, 0.1)])
    np.testing.assert_array_equal(np.unique(points["code"][points["marker"] >= 0]), np.sort(stated))
    assert not points["code"][points["marker"] < 0].any()
    codes = np.frombuffer(zlib.decompress(base64.b64decode(packed["timeline"]["data"])), dtype=np.uint8).reshape(len(walk.labels), -1)
    np.testing.assert_array_equal(codes.T == 255, wrong)
    np.testing.assert_array_equal(codes.T == 1, label_states(labelling, clouds).unsure)


def test_a_block_of_the_timeline_shows_its_lowest_confidence_and_what_most_of_it_is(walk: Recording) -> None:
    """150 frames in 15 columns of ten: one doubtful frame shows, four missing ones of ten do not, six do."""
    clouds, truth = simulate_occlusions(walk, 0, 0)
    indices, confidence = truth.copy(), np.full(truth.shape, 0.9999)
    confidence[25, 0], indices[30:34, 1], indices[40:46, 1], indices[50:56, 2] = 0.5, -1, -1, -1
    unsure = np.zeros(truth.shape, dtype=np.bool_)
    unsure[50:56, 2] = True
    shown = ShownRecording("a", Labelling(indices, confidence, walk.labels), clouds, unsure=unsure)
    (packed,) = pack_recordings([shown], PageRules(columns=15))
    codes = np.frombuffer(zlib.decompress(base64.b64decode(packed["timeline"]["data"])), dtype=np.uint8).reshape(len(walk.labels), 15)
    expected = np.full(codes.shape, 200)
    expected[0, 2], expected[1, 4], expected[2, 5] = 2 + round(198 * np.log10(2) / 4), 0, 1
    np.testing.assert_array_equal(codes, expected)


def test_more_files_than_a_page_holds_are_named_with_their_timelines(walk: Recording) -> None:
    clouds, _, labelling = labelled(walk)
    shown = [ShownRecording(str(i), labelling, clouds, unsure=np.zeros(labelling.indices.shape, dtype=np.bool_)) for i in range(20)]
    packed = pack_recordings(shown, PageRules(bytes=40_000))
    assert [one["name"] for one in packed] == [one.name for one in shown] and all(one["timeline"] for one in packed)
    assert sum(len(one["points"]["data"]) for one in packed if one["points"]) <= 40_000
    assert all(one["step"] > 1 for one in packed if one["points"])
    none = pack_recordings(shown[:2], PageRules(bytes=1_000))
    assert [one["points"] for one in none] == [None, None]


def test_sides_and_bones_need_no_marker_set() -> None:
    names = [
        "LKNE",
        "RKNE",
        "Ann:LTHI",
        "Ann:RTHI",
        "CLAV",
        "R.Elbow",
        "KneeOut_L",
        "KneeOut_R",
        "left_heel",
        "LUMB",
        "C7",
        "MLHE",
        "MRHE",
        "RBAK2",
        "",
    ]
    expected = ["left", "right"] * 2 + ["middle", "right", "left", "right", "left", "middle", "middle", "left", "right", "middle", "middle"]
    assert marker_sides(names) == expected
    assert marker_sides(["LKNE", "RKNE"], MarkerSet(("LKNE", "RKNE"), pairs=(("RKNE", "LKNE"),))) == ["right", "left"]
    rng = np.random.default_rng(0)
    path = np.cumsum(rng.normal(0, 0.02, (80, 1, 3)), axis=0)
    rigid = np.concatenate([path + np.array([[0, 0, 0], [0, 0, 0.2], [0, 0, 0.4]]), path[::-1] + 0.3], axis=1)
    rigid[10:40, 1] = np.nan
    assert {tuple(sorted(bone)) for bone in marker_bones(rigid[:, :3], ["a", "b", "c"])} == {(0, 1), (1, 2)}
    assert len(marker_bones(rigid, list("abcd"))) == 3 and marker_bones(rigid * np.nan, list("abcd")) == []


def nothing(frames: int) -> dict[str, Any]:
    clouds = Clouds.from_points([np.empty((0, 3))] * frames, rate=100.0)
    labelling = Labelling(np.full((frames, 2), -1), np.zeros((frames, 2)), ("A", "B"))
    return {"clouds": clouds, "labelling": labelling, "truth": np.full((frames, 2), -1)}


def test_a_recording_plots_itself_under_its_own_labels(tmp_path: Path, walk: Recording) -> None:
    positions = walk.positions.copy()
    positions[3:9, 2] = np.nan
    recording = replace(walk, positions=positions, labels=(*walk.labels[:-1], "*1"), first_frame=41)
    shown = plot_recording(recording, tmp_path / "walk.html")
    page = Reader(shown.path.read_text(encoding="utf-8"))
    (packed,) = shown_in(page)
    points = unpacked(packed)
    assert packed["markers"] == list(walk.labels[:-1]) and packed["firstFrame"] == 41
    for m in range(len(walk.labels) - 1):
        assert (points["marker"] == m).sum() == recording.visible[:, m].sum()
    assert (points["marker"] == -1).sum() == recording.visible[:, -1].sum()
    assert not page.loads and "<iframe" in shown._repr_html_() and plot_recording(recording).path.exists()
    with pytest.raises(AsterismError, match="nothing to plot"):
        plot_recording(replace(recording, positions=positions[:0]))


@pytest.mark.parametrize("frames", [0, 1, 5])
def test_a_recording_without_points_has_a_page_too(tmp_path: Path, walk: Recording, frames: int) -> None:
    page = make_label_page(tmp_path / "page.html", walk, files=[], **nothing(frames))
    assert set(page.table("marker")) == {"marker", "A", "B"}
    assert "nan" not in page.text.casefold()


def test_points_without_any_label_are_no_trouble(tmp_path: Path, walk: Recording) -> None:
    _, truth, labelling = labelled(walk)
    none = Labelling(np.full_like(truth, -1), np.zeros(truth.shape), labelling.names)
    page = make_label_page(tmp_path / "page.html", walk, labelling=none, truth=None)
    assert page.table("file")["walk.c3d"][1:4] == ["0.00 %", "0.00 %", "100.00 %"]


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path, walk: Recording) -> None:
    with pytest.raises(AsterismError, match=r"missing.*cannot be written"):
        make_label_page(tmp_path / "missing" / "page.html", walk)


# Evaluation


def evaluation() -> Any:
    """Two markers, three conditions; NaN where there were no nulls."""
    conditions = []
    for hidden, ghosts in ((0, 0), (3, 0), (3, 2)):
        markers = {
            "LKNE": {"fa": 0.001 * hidden, "fo": 0.25 if hidden else float("nan"), "missed": 0.01 * ghosts},
            "RKNE": {"fa": 0.0, "fo": float("nan"), "missed": 0.0},
        }
        conditions.append(
            SimpleNamespace(
                occlusions=hidden,
                ghosts=ghosts,
                frames=1000,
                visible=2000,
                given=1990,
                right=0.9934,
                fa=0.00123,
                fo=0.5,
                missed=0.0071,
                perfect=0.98,
                ece=0.004,
                reliability=[(0.5, 0.55, 10), (0.999, 1.0, 1980), (0.2, float("nan"), 0)],
                per_marker=markers,
                frames_per_second=5432.0,
                evaluations_per_frame=float("nan"),
                confidence=ConfidenceScore(1990, 0.0123, 0.04, 0.005, 0.006, 0.9, [Reliability(0.9, 0.95, 50, 0.93, 0.9, 0.8, 0.96)]),
            )
        )
    pooled = conditions[0].confidence
    return SimpleNamespace(markers=("LKNE", "RKNE"), conditions=conditions, subjects=["Ann", "Bo"], rules="whole-body", confidence=pooled)


def test_the_evaluation_page_holds_the_tables_of_the_thesis(tmp_path: Path) -> None:
    path = tmp_path / "evaluation.html"
    evaluation_report(path, evaluation(), settings={"seed": 3})
    page = read(path)
    by_marker = [rows for rows in page.tables if rows[0][0] == "marker"]
    assert [rows[0] for rows in by_marker] == [["marker", "0", "3", "3 + 2"]] * 3
    fa, fo, missed = ({row[0]: row[1:] for row in rows} for rows in by_marker)
    assert fa["LKNE"] == ["0.000 %", "0.300 %", "0.300 %"]
    assert fa["mean of the markers"] == ["0.000 %", "0.150 %", "0.150 %"]
    assert fo["LKNE"] == ["–", "25.0 %", "25.0 %"] and fo["RKNE"] == ["–"] * 3
    assert missed["LKNE"] == ["0.00 %", "0.00 %", "2.00 %"]
    summary = next(rows for rows in page.tables if rows[0][0] == "hidden")
    assert summary[1] == ["0", "0", "1,000", "99.340 %", "0.123 %", "50.0 %", "0.71 %", "98.00 %", "0.0123", "0.0400", "5,432", "–"]
    levels = next(rows for rows in page.tables if rows[0][0] == "confidence" and "stated" in rows[0])
    assert levels[1] == ["0.9 to 0.95", "50", "93.000 %", "90.000 %", "80.000 % to 96.000 %"]
    assert "Ann" in page.text and "whole-body" in page.text and "nan" not in page.text.casefold()


def test_the_reliability_curve_lies_on_the_line_where_confidence_is_honest(tmp_path: Path) -> None:
    honest = evaluation()
    honest.conditions[0].reliability = [(share, share, 100) for share in (0.3, 0.9, 0.99, 0.9999)]
    evaluation_report(tmp_path / "e.html", honest)
    figures = json.loads(read(tmp_path / "e.html").json)["figures"].values()
    (curves,) = (figure for figure in figures if "yaxis2" in figure["layout"])
    line = next(trace for trace in curves["data"] if trace["name"] == "0 hidden")
    np.testing.assert_allclose(line["x"], line["y"])
    assert line["x"][1] == pytest.approx(1) and line["x"][2] == pytest.approx(2)
    counts = next(trace for trace in curves["data"] if trace["name"] == "0 hidden" and trace.get("yaxis") == "y2")
    assert counts["y"] == [100] * 4


def test_an_evaluation_without_conditions_or_subjects_has_a_page(tmp_path: Path) -> None:
    empty = SimpleNamespace(markers=(), conditions=[], subjects=[], rules="thesis", confidence=ConfidenceTally().score())
    evaluation_report(tmp_path / "e.html", empty)
    assert "0 markers of 0 subjects" in read(tmp_path / "e.html").text


# Capturability


def capturability() -> Any:
    return SimpleNamespace(
        markers=("A", "B", "C"),
        hit_rates=np.array([0.99, 0.8, 1.0]),
        confusion=np.array([[0.99, 0.01, 0.0], [0.2, 0.8, 0.0], [0.0, 0.0, 1.0]]),
        by_occlusions=[(0, 0.93, np.array([0.99, 0.8, 1.0])), (1, 0.7, np.array([0.9, 0.5, float("nan")]))],
        changes=[
            SimpleNamespace(action="drop", marker="C", description="without C", hit_rate_before=0.93, hit_rate_after=0.9),
            SimpleNamespace(action="move", marker="B", description="3 cm up", hit_rate_before=0.93, hit_rate_after=0.97),
        ],
        verdict="B is taken for A; move it.",
        judged="Judged are single frames.",
        by_target=[TargetRates(0.99, 1, 0.02, 0.1), TargetRates(0.99, 2, 0.01, 0.2), TargetRates(0.999, 1, 0.001, 0.3)],
        first_classifiers=[ChosenClassifier("distance (A, B)", 0.6), ChosenClassifier("height difference (A, C)", 0.25)],
        solver_sizes=[SolverSize(1, 0.6, 1000.0), SolverSize(2, 0.85, 90.0)],
    )


def test_the_capturability_page_says_what_is_confused_and_what_helps(tmp_path: Path) -> None:
    path = tmp_path / "capturability.html"
    capturability_report(path, capturability(), settings={"seed": 0})
    page = read(path)
    pairs = next(rows for rows in page.tables if rows[0][0] == "the point of")
    assert pairs[1:] == [["B", "A", "20.000 %"], ["A", "B", "1.000 %"]]
    hidden = next(rows for rows in page.tables if rows[0][0] == "hidden")
    assert hidden[2] == ["1", "70.000 %", "B", "50.000 %"]
    changes = next(rows for rows in page.tables if rows[0][0] == "change")
    assert [row[1] for row in changes[1:]] == ["B", "C"], "the best change comes first"
    assert changes[1][-1] == "+4.000 points"
    assert "B is taken for A; move it." in page.text and "It finds each marker" not in page.text
    assert page.loads == []


def test_the_capturability_page_has_the_thesis_table_and_figures(tmp_path: Path) -> None:
    """Table 5.1 with its sums, figure 5.1 with evaluations on a logarithmic axis, figure 5.2 with a line for each number of hidden ones."""
    capturability_report(tmp_path / "c.html", capturability())
    page = read(tmp_path / "c.html")
    chosen = next(rows for rows in page.tables if rows[0][1:2] == ["weak classifier"])
    assert chosen[1:] == [["1", "distance (A, B)", "60.00 %", "60.00 %"], ["2", "height difference (A, C)", "25.00 %", "85.00 %"]]
    rates = next(rows for rows in page.tables if rows[0][0] == "target hit rate")
    assert rates[3] == ["99.900 %", "1", "0.100 %", "30.00 %"]
    figures = json.loads(page.json)["figures"].values()
    trade = next(one for one in figures if [line.get("name") for line in one["data"]] == ["1 hidden", "2 hidden"])
    assert (trade["data"][0]["x"], trade["data"][0]["y"]) == (pytest.approx([2.0, 0.1]), pytest.approx([10.0, 30.0]))
    effort = next(one for one in figures if [line.get("name") for line in one["data"]] == ["accuracy", "evaluations"])
    assert effort["data"][0]["y"] == pytest.approx([60.0, 85.0]) and effort["data"][1]["y"] == [1000.0, 90.0]
    axis = effort["layout"]["yaxis2"]
    assert axis["type"] == "log" and axis["range"] == pytest.approx([np.log10(90.0) - 0.1, 3.1])
    ticks = dict(zip(axis["ticktext"], axis["tickvals"], strict=True))
    assert {"100": 100.0, "200": 200.0, "500": 500.0, "1,000": 1000.0}.items() <= ticks.items()


def test_the_confusion_picture_shows_rows_as_truth_and_no_diagonal(tmp_path: Path) -> None:
    capturability_report(tmp_path / "c.html", capturability())
    figures = json.loads(read(tmp_path / "c.html").json)["figures"].values()
    heat = next(figure["data"][0] for figure in figures if figure["data"][0]["type"] == "heatmap")
    assert heat["y"] == ["A", "B", "C"] and heat["customdata"][1][0] == 20.0
    assert [heat["z"][i][i] for i in range(3)] == [None] * 3


def test_a_marker_set_without_any_confusion_has_a_page(tmp_path: Path) -> None:
    perfect = capturability()
    perfect.confusion, perfect.hit_rates, perfect.changes, perfect.by_occlusions = np.eye(3), np.ones(3), [], []
    perfect.by_target, perfect.first_classifiers, perfect.solver_sizes = [], [], []
    capturability_report(tmp_path / "c.html", perfect)
    page = read(tmp_path / "c.html")
    assert ["no marker", "any other", "0.0 %"] in [row for rows in page.tables for row in rows]
    assert "It finds each marker in every frame." in page.text
    bars = [one for one in json.loads(page.json)["figures"].values() if one["data"][0]["type"] == "bar"]
    assert bars == [], "a chart of nothing is not drawn"
