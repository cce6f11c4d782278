"""The player's script: what Python packs is what it draws, and its arithmetic on time, sides and names holds.

The script runs in Node where it is installed, and the pages in Chromium where that is.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import in_node, needs_chromium, needs_node, opened

from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.recording import Clouds, Ints, Labelling, Recording
from asterism.report import LabelledRecording, label_report, player_script, player_style
from asterism.report.figures import SIDES
from asterism.report.player import WRONG, ShownRecording, pack_recordings
from asterism.simulation import simulate_walks


def plain(packed: dict[str, Any]) -> dict[str, Any]:
    out: dict[str, Any] = json.loads(json.dumps(packed, default=lambda value: value.tolist()))
    return out


@pytest.fixture(scope="module")
def walk() -> Recording:
    return simulate_walks(1, frames=150, seed=2)[0]


@pytest.fixture(scope="module")
def hidden(walk: Recording) -> tuple[Clouds, Ints, Labelling]:
    clouds, truth = simulate_gaps_and_ghosts(walk, 3, 2, seed=1)
    confidence = np.where(truth >= 0, np.linspace(0.3, 1.0, truth.shape[1])[None], 0.2)
    return clouds, truth, Labelling(truth, confidence, walk.labels)


@needs_node
@pytest.mark.parametrize("step_bytes", [1_000_000, 2_500])
def test_the_player_unpacks_what_python_packed(tmp_path: Path, hidden: tuple[Clouds, Ints, Labelling], step_bytes: int) -> None:
    clouds, truth, labelling = hidden
    far = replace(clouds, xyz=clouds.xyz + np.array([4e4, -7.0, 0.0]))
    marks = np.zeros(len(clouds.xyz), dtype=np.int64)
    marks[[3, 700]] = WRONG
    rules = replace(pack_rules(), bytes=step_bytes)
    (packed,) = pack_recordings([ShownRecording("a", labelling, far, 101, marks=marks, chosen=(10, 140))], rules)
    step = packed["step"]
    assert (step == 1) == (step_bytes == 1_000_000)
    got = in_node(
        """const r = await Asterism.unpack(packed);
        return { offsets: [...r.offsets], xyz: [...r.xyz], marker: [...r.marker], confidence: [...r.confidence], marks: [...r.marks],
          number: r.number(3), at: r.at(r.number(3)), rate: r.rate, frameOf: [...r.frameOf] };""",
        tmp_path,
        packed=plain(packed),
    )
    frames = np.arange(10, 140, step)
    counts = clouds.counts[frames]
    np.testing.assert_array_equal(got["offsets"], np.concatenate([[0], np.cumsum(counts)]))
    assert got["number"] == 101 + frames[3] and got["at"] == 3 and got["rate"] == clouds.rate / step
    for k, t in enumerate(frames):
        own = slice(got["offsets"][k], got["offsets"][k + 1])
        assert set(got["frameOf"][own]) == {k}
        shown = np.array(got["xyz"]).reshape(-1, 3)[own]
        marker = np.array(got["marker"])[own]
        for m in range(len(labelling.names)):
            here = np.nonzero(marker == m)[0]
            assert len(here) == (truth[t, m] >= 0)
            if len(here):
                true = far.xyz[far.offsets[t] + truth[t, m]]
                np.testing.assert_allclose(shown[here[0]], true, atol=0.004)  # single precision at 40 km
                code = 2 + round(198 * min(4.0, -np.log10(max(1 - labelling.confidence[t, m], 1e-4))) / 4)
                assert got["confidence"][own.start + here[0]] == pytest.approx(1 - 10 ** (-4 * (code - 2) / 198), abs=1e-6)
        np.testing.assert_allclose(np.sort(shown[:, 2]), np.sort(far[int(t)][:, 2]), atol=0.001)
    marked = np.isin(clouds.frame_of[[3, 700]], frames)
    assert sum(got["marks"]) == WRONG * int(marked.sum())


def pack_rules() -> Any:
    from asterism.report.player import RULES

    return RULES


@needs_node
def test_numbers_of_any_size_survive(tmp_path: Path) -> None:
    from asterism.report.player import differences, varints, zigzag

    values = np.array([0, -1, 1, 63, -64, 64, 8191, -8192, 10**9, -(10**9), 10**9, 5, 5, 5])
    counts = [1, 10, 3]
    first = np.array([0, 1, 11])
    for order in (1, 2):
        data = varints(zigzag(differences(values, first, order)))
        got = in_node(
            "return [...Asterism.sums(Asterism.signed(Asterism.varints(Uint8Array.from(data), 14)), counts, order)]",
            tmp_path,
            data=data.tolist(),
            counts=counts,
            order=order,
        )
        assert got == values.tolist()


@needs_node
def test_the_player_finds_the_body_where_it_is(tmp_path: Path, walk: Recording, hidden: tuple[Clouds, Ints, Labelling]) -> None:
    """Its place, its direction, the side it faces, and where hidden markers are: half of them within 12 cm."""
    clouds, truth, labelling = hidden
    (packed,) = pack_recordings([ShownRecording("a", labelling, clouds)])
    got = in_node(
        """const r = await Asterism.unpack(packed), b = new Asterism.Body(r), frames = [20, 75, 120];
        return { origin: frames.map(t => b.origin(t)), walks: b.walks[b.knot(75)], facing: b.facing(75), size: b.size, floor: b.floor,
          expected: r.names.map((_, m) => frames.map(t => b.expected(m, t))) };""",
        tmp_path,
        packed=plain(packed),
    )
    true = walk.positions
    for place, t in zip(got["origin"], (20, 75, 120), strict=True):
        np.testing.assert_allclose(place[:2], np.median(true[t], axis=0)[:2], atol=0.1)
    way = np.median(true[95] - true[55], axis=0)[:2]
    way /= np.linalg.norm(way)
    assert np.dot(got["walks"], way) > 0.98 and np.dot(got["facing"], way) > 0.8
    assert 0.3 < got["size"] < 1.5 and abs(got["floor"]) < 0.1
    missing = [(m, k, t) for m in range(15) for k, t in enumerate((20, 75, 120)) if truth[t, m] < 0]
    assert missing
    for m, k, t in missing:
        assert np.linalg.norm(np.array(got["expected"][m][k]) - true[t, m]) < 0.4
    assert np.median([np.linalg.norm(np.array(got["expected"][m][k]) - true[t, m]) for m, k, t in missing]) < 0.12


@needs_node
def test_views_show_the_walker_from_the_side_that_they_name(tmp_path: Path) -> None:
    """Walking along (0.6, 0.8): from the side it goes to the right, from the front towards us, from the top up; higher is higher."""
    got = in_node(
        """const c = new Asterism.Camera(), out = {};
        Object.assign(c, { width: 400, height: 300, target: [1, 2, 1], size: 1 });
        for (const name of ["front", "side", "top"]) {
          c.view(name, [0.6, 0.8]);
          out[name] = [[1, 2, 1], [1.3, 2.4, 1], [1, 2, 1.5], [1.4, 1.7, 1]].map(p => c.project(...p));
        }
        c.view("front", [0.6, 0.8]);
        out.behind = c.project(1 + 60, 2 + 80, 1);
        return out;""",
        tmp_path,
    )
    for view in ("front", "side", "top"):
        assert got[view][0][:2] == pytest.approx([200, 150])
    middle, ahead, high, right = got["side"]
    assert ahead[0] > middle[0] + 20 and high[1] < middle[1] - 20 and right[2] > 1.01
    middle, ahead, high, right = got["front"]
    assert ahead[2] > 1.01 and high[1] < middle[1] - 20 and right[0] < middle[0] - 20, "its right hand is on our left"
    middle, ahead, high, right = got["top"]
    assert ahead[1] < middle[1] - 20 and right[0] > middle[0] + 20 and high[2] > 1.01
    assert got["behind"] is None


@needs_node
def test_a_timeline_shows_what_is_wrong_or_unsure_however_short(tmp_path: Path) -> None:
    got = in_node(
        """const row = (most, some, length) => Uint8Array.from({ length: 100 }, (_, i) => i < length ? some : most);
        const shown = (...given) => Asterism.worst(row(...given), 0, 100);
        return [shown(200, 255, 1), shown(200, 1, 1), shown(200, 90, 1), shown(200, 0, 60), shown(200, 0, 40), shown(254, 0, 40),
          Asterism.lanes([0, 5, 3, 20], [10, 8, 4, 30])];""",
        tmp_path,
    )
    assert got[:6] == [255, 1, 90, 0, 200, 254]
    lane = list(got[6]["lane"].values())
    assert got[6]["count"] == 2 and lane[0] != lane[1] and lane[0] != lane[2] and lane[3] == 0


@needs_node
def test_the_colours_of_a_timeline_are_explained_where_they_are_drawn(tmp_path: Path) -> None:
    got = in_node(
        """const colours = { codes: Array.from({ length: 256 }, (_, code) => `c${code}`), rest: "rest", ghost: "ghost" };
        const texts = (codes, bars = []) => Asterism.meanings({ codes: Uint8Array.from(codes) }, bars, colours);
        return [texts([0]), texts([90, 254, 255, 1], [{ ghost: true }, { ghost: false }])];""",
        tmp_path,
    )
    assert got[0] == [["", "c0", "hidden"]]
    assert [colour for _, colour, _ in got[1]] == ["linear-gradient(90deg, c2, c200)", "c254", "c255", "c1", "rest", "ghost"]


def test_left_and_right_have_one_colour_each_in_pictures_and_figures_and_shapes_beside_it() -> None:
    script, style = player_script(), player_style()
    for side, drawn in SIDES.items():
        assert f'of("{side}", "{drawn["color"]}")' in script and f"var(--player-{side}, {drawn['color']})" in style
    red, blue = (SIDES[side]["color"] for side in ("left", "right"))
    assert int(red[1:3], 16) > int(red[5:7], 16) and int(blue[5:7], 16) > int(blue[1:3], 16)
    assert SIDES["right"]["dash"] != SIDES["left"].get("dash", "solid")


@needs_node
def test_names_are_shown_without_marks_that_turn_or_hide_text(tmp_path: Path) -> None:
    names = ["LKNE", "a\u202eb", "\x1b[31mred", "歩行", "x" * 200, "<b>", "👍" * 70]
    got = in_node("return names.map(name => Asterism.plainText(name))", tmp_path, names=names)
    assert got[:4] == ["LKNE", "a\ufffdb", "\ufffd[31mred", "歩行"] and got[5] == "<b>"
    assert len(got[4]) == 60 and got[4].endswith("…") and got[6] == "👍" * 59 + "…"


def test_the_script_makes_no_request_and_writes_no_markup() -> None:
    """Text goes in as text; nothing is loaded."""
    script = player_script()
    assert not re.search(
        r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\b|fetch\(|XMLHttpRequest|https?://|import\s*\(", script
    )
    assert not re.search(r"url\(|@import|https?://", player_style())
    assert "</script" not in script.casefold()


@needs_chromium
def test_a_page_draws_its_recordings_in_a_browser(tmp_path: Path, hidden: tuple[Clouds, Ints, Labelling]) -> None:
    clouds, truth, labelling = hidden
    odd = Labelling(labelling.indices, labelling.confidence, ("<img src=x onerror=alert(1)>", *labelling.names[1:]))
    shown = [LabelledRecording(odd, clouds, truth=truth, first_frame=101), LabelledRecording(labelling, clouds)]
    label_report(tmp_path / "p.html", shown, title="Two", files=[{"file": "a<i>.c3d"}, {"file": "b.c3d"}])
    seen = int((truth[0] >= 0).sum())
    elements = opened((tmp_path / "p.html").as_uri(), tmp_path, f"a&lt;i&gt;.c3d: frame 101, {seen} of 15 markers")
    assert re.search(r"<canvas[^>]*aria-label=\"15 markers over 150 frames", elements)
    assert elements.count('class="opens"') == 2 and "too old" not in elements
    assert "<img" not in elements and "onerror" in elements, "the name is text"


@pytest.mark.slow
@needs_chromium
def test_a_recording_without_frames_or_points_opens_too(tmp_path: Path, hidden: tuple[Clouds, Ints, Labelling]) -> None:
    clouds, _, labelling = hidden
    nothing = Clouds.from_points([np.empty((0, 3))] * 5, rate=100.0)
    empty = Labelling(np.full((5, 15), -1), np.zeros((5, 15)), labelling.names)
    none = Labelling(np.full((0, 15), -1), np.zeros((0, 15)), labelling.names)
    shown = [LabelledRecording(empty, nothing), LabelledRecording(labelling, clouds), LabelledRecording(none, nothing.frames(slice(0, 0)))]
    for order in (shown, shown[::-1]):
        label_report(tmp_path / "p.html", order, title="Odd")
        elements = opened(
            (tmp_path / "p.html").as_uri(), tmp_path, r"<canvas[^>]*aria-label=\"recording 1: frame 1, 0 of 15 markers, 0 points"
        )
        assert "NaN" not in elements and "undefined" not in elements
