"""The gait report: what a clinician reads first is first, curves are drawn as they are, and each number leads to its frames."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import in_node, needs_chromium, needs_node, opened

import asterism
from asterism.cli import main
from asterism.findings import Finding, Severity
from asterism.gait import GaitAnalysis, analyse_gait, band_of, compare_sessions
from asterism.gait.bands import other_models
from asterism.gait.parameters import Parameter
from asterism.motion.analysis import analyse_motion
from asterism.recording import ForcePlate, Recording
from asterism.report.cycle_panels import CurvesOfSide, CycleCurve, CyclePanel, drawn_panels
from asterism.report.gait import gait_report
from asterism.report.gait_session import GaitSession
from asterism.report.gait_steps import drawn_steps
from asterism.report.limb_names import limb_names
from asterism.report.player import ShownRecording, pack_recordings
from asterism.report.recording import labelling_by_names
from asterism.simulation import simulate_walks


@pytest.fixture(scope="module")
def walks() -> list[GaitAnalysis]:
    return [analyse_gait(walk) for walk in simulate_walks(3, frames=300, markers="helen-hayes", seed=5)]


def headings(page: str) -> list[str]:
    return re.findall(r"<h2>(.*?)</h2>", page)


def test_the_person_and_the_parameters_come_first_and_the_player_last(tmp_path: Path, walks: list[GaitAnalysis]) -> None:
    band = band_of(walks, ["a", "b", "c"])
    slow = replace(walks[0], parameters=tuple(replace(one, value=3 * one.value) for one in walks[0].parameters))
    gait_report(tmp_path / "p.html", [("walk.c3d", slow)], band=band)
    page = (tmp_path / "p.html").read_text()
    wanted = "The person|Parameters|Angles over the gait cycle|How certain the angles are|Scores|Quality|What to know|Each cycle|Events"
    assert headings(page) == [*wanted.split("|"), "The recordings"]
    assert len(re.findall('<figure class="panel"', page)) == 12 and page.count('class="off left"') == 12
    row = page[page.index('<td class="text">cadence, steps/min<') :].split("</tr>")[0]
    usual, spread = band.parameters["cadence"]
    assert f"{usual:.1f} ± {spread:.1f}" in row and row.count("--warn-rgb") == 2, "both sides are far from the controls"
    assert 'id="plotly"' not in page and len(page) < 400_000
    assert band.log_score is not None
    usual = f"{np.degrees(np.exp(band.log_score[0])):.1f}"
    score = page.split('<td class="text">Gait Profile Score<')[1].split("</tr>")[0]
    assert f">{usual} (" in score and f"controls {usual}°" in page, "what a score is to be held against stands beside it"


def test_what_was_found_stands_once_without_the_path_that_pushed_it_out_of_view(tmp_path: Path, walks: list[GaitAnalysis]) -> None:
    results = []
    for number in range(2):
        file = f"/a/very/long/path/of/a/laboratory/walk{number}.c3d"
        finding = Finding("clinical-marker-diameter", Severity.WARNING, file, f"{file}: its markers are large.", "Measure <b>one</b>.")
        recording = replace(walks[0].recording, metadata={"file": file})
        results.append((f"walk{number}.c3d", replace(walks[0], recording=recording, findings=(finding,), curves={}, clinical=None)))
    gait_report(tmp_path / "p.html", results)
    table = (tmp_path / "p.html").read_text().split("<h2>What to know</h2>")[1].split("</section>")[0]
    assert table.count("Its markers are large.") == 1 and "walk0.c3d, walk1.c3d" in table
    assert "/a/very" not in table and "&lt;b&gt;" in table and "<b>" not in table


def test_a_number_leads_to_the_frames_of_its_cycle(tmp_path: Path, walks: list[GaitAnalysis]) -> None:
    gait_report(tmp_path / "p.html", [("first", walks[1]), ("second", walks[0])])
    page = (tmp_path / "p.html").read_text()
    rate = walks[0].recording.rate
    frames = {(one.side, round(one.strike.time * rate), round(one.next_strike.time * rate)) for one in walks[0].cycles}
    names = dict(L="left", R="right")
    for side, begin, end in frames:
        assert re.search(
            rf'class="cycle {names[side]}" d="[^"]+" data-name="{names[side]}, second, cycle \d" data-go="1:{begin}:{end}"', page
        )
    for row in re.findall(r'<td class="text" data-go="1:(\d+):(\d+)">(left|right), second, cycle', page):
        assert (row[2][0].upper(), int(row[0]), int(row[1])) in frames
    stance = page[page.index('<td class="text">stance, %<') :].split("</tr>")[0]
    assert len(re.findall(r'data-go="[01]:\d+:\d+"', stance)) == 2


def test_steps_stand_where_the_foot_is_on_the_floor_and_lead_there(walks: list[GaitAnalysis]) -> None:
    drawing = drawn_steps([GaitSession("", [("first", walks[1]), ("<second>", walks[0])])])
    assert drawing.count("<figure>") == 2 and "&lt;second&gt;" in drawing and "plates" not in drawing.split('class="steps"')[1]
    rate, seconds = walks[0].recording.rate, len(walks[0].recording) / walks[0].recording.rate
    bars = re.findall(r'x="([\d.]+)" y="2" width="([\d.]+)" height="12" fill="#d1344b" data-go="1:(\d+):(\d+)"', drawing)
    strikes, offs = (walks[0].walking.of("L", label) for label in ("Foot Strike", "Foot Off"))
    wanted = [(strike.time, next(off.time for off in offs if off.time > strike.time)) for strike in strikes if strike.time < offs[-1].time]
    assert len(bars) == len(wanted) > 1
    for (x, wide, first, last), (begins, ends) in zip(bars, wanted, strict=True):
        assert (int(first), int(last)) == (round(rate * begins), round(rate * ends))
        assert float(x) == pytest.approx(60 + 940 * begins / seconds, abs=0.1)
        assert float(wide) == pytest.approx(940 * (ends - begins) / seconds, abs=0.1)


@needs_node
def test_a_curve_is_drawn_as_it_is_and_broken_where_it_is_unknown(tmp_path: Path) -> None:
    """What the page's own script reads out of a line is the curve, to a thousandth of the axis."""
    values = 50 * np.sin(np.linspace(0, 7, 101))
    values[40:50] = np.nan
    drawing = drawn_panels([CyclePanel("knee", "°", [CurvesOfSide("left", [CycleCurve(values, "<walk>")], 60.0)])])
    assert "&lt;walk&gt;" in drawing and drawing.count("<figure") == drawing.count("</figure>") == 1
    (path,) = re.findall(r'class="cycle left" d="([^"]+)"', drawing)
    low, high = (float(re.findall(rf'data-{name}="([^"]+)"', drawing)[0]) for name in ("low", "high"))
    script = (Path(__file__).parent.parent / "src/asterism/report/templates/panels.js").read_text()
    function = script[script.index("  function heightsOf") : script.index('  const tip = make("div"')]
    constants = re.findall(r"const LEFT.*;", script)[0]
    heights = in_node(f"{constants}{function} return [...heightsOf({{ getAttribute: () => path }})];", tmp_path, path=path)
    read = np.array([np.nan if height is None else low + (1660 - height) / 1600 * (high - low) for height in heights])
    np.testing.assert_allclose(read, values, atol=(high - low) / 1000)


def test_cycles_of_turns_are_pale_and_neither_in_the_mean_nor_in_the_axes() -> None:
    straight, turn = CycleCurve(np.linspace(0, 1, 101)), CycleCurve(np.linspace(0, 90, 101), "left, cycle 2, a turn", counts=False)
    side = CurvesOfSide("left", [straight, turn])
    np.testing.assert_array_equal(side.mean, straight.values)
    drawing = drawn_panels([CyclePanel("pelvic rotation", "°", [side])])
    assert drawing.count('class="cycle left turn"') == 1 and "in no mean" in drawing
    assert float(re.findall(r'data-high="([^"]+)"', drawing)[0]) < 2
    # where it is all that there is, it has its axes, and no mean
    alone = drawn_panels([CyclePanel("knee power", "W", [CurvesOfSide("left", [turn])])])
    assert float(re.findall(r'data-high="([^"]+)"', alone)[0]) > 90 and re.findall(r'class="mean left" d=""', alone)


def test_the_table_of_cycles_says_which_turn(walks: list[GaitAnalysis], tmp_path: Path) -> None:
    first, *others = walks[0].cycles
    marked = (replace(first, turns=True), *(replace(cycle, turns=False) for cycle in others))
    gait_report(tmp_path / "gait.html", [("walk", replace(walks[0], cycles=marked))])
    page = (tmp_path / "gait.html").read_text()
    assert page.count("turns, in no mean") == 1 and page.count(">straight<") == len(others) and "1 of them the person turns" in page


def test_what_no_cycle_shows_has_no_axes_and_many_cycles_leave_their_mean_in_view() -> None:
    unknown, known = np.full(101, np.nan), np.linspace(0, 1, 101)
    drawing = drawn_panels([CyclePanel("ankle", "°", [CurvesOfSide("left", [CycleCurve(unknown)] * 2)])])
    assert "not known in any cycle" in drawing and "<path" not in drawing.split('class="panels"')[1]
    faint = [
        float(
            re.findall(
                r'<g opacity="([^"]+)"', drawn_panels([CyclePanel("knee", "°", [CurvesOfSide("left", [CycleCurve(known)] * many)])])
            )[0]
        )
        for many in (4, 50)
    ]
    assert faint == [1.0, 0.2]
    curves = [CycleCurve(np.full(101, float(n))) for n in range(500)]
    crowded = drawn_panels([CyclePanel("knee", "°", [CurvesOfSide("left", curves)])])
    assert 40 < crowded.count('class="cycle left"') <= 60 and "60 of them at most" in crowded
    low, high = (float(re.findall(rf'data-{name}="([^"]+)"', crowded)[0]) for name in ("low", "high"))
    mean = int(re.findall(r'class="mean left" d="M430 (\d+)', crowded)[0])
    assert low + (1660 - mean) / 1600 * (high - low) == pytest.approx(249.5, abs=1.0), "of all cycles"


def test_labels_are_as_certain_as_their_file_says(tmp_path: Path) -> None:
    walk = simulate_walks(1, frames=100, markers="helen-hayes", seed=5)[0]
    clouds = walk.clouds()
    certain = np.full(walk.visible.shape, 1.0)
    certain[:10] = 0.5
    labelling = replace(labelling_by_names(walk), confidence=np.where(walk.visible, certain, 0.0))
    asterism.write(tmp_path / "walk.c3d", Recording.from_clouds(clouds, labelling), labelling=labelling)
    gait_report(tmp_path / "p.html", [("walk", analyse_gait(asterism.read(tmp_path / "walk.c3d")))])
    quality = (tmp_path / "p.html").read_text().split("<h2>Quality</h2>")[1].split("</section>")[0]
    assert "90.0 % certain (99 % or more)" in quality and "as in the file" not in quality


def test_a_page_without_cycles_or_angles_is_a_page(tmp_path: Path, walks: list[GaitAnalysis]) -> None:
    standing = replace(walks[0].recording, positions=np.repeat(walks[0].recording.positions[:1], 60, axis=0), metadata={"file": "<b>.c3d"})
    few = walks[0].recording.select(["LHEE", "LTOE", "SACR"])
    gait_report(tmp_path / "p.html", [("<b>.c3d", analyse_gait(standing)), ("few", analyse_gait(few))], compare=[("third", walks[1])])
    page = (tmp_path / "p.html").read_text()
    assert "<b>.c3d" not in page.split("<script")[0] and "&lt;b&gt;.c3d" in page
    assert "Angles over the gait cycle" in headings(page), "the third walk has some"
    gait_report(tmp_path / "q.html", [("few", analyse_gait(standing))])
    assert headings((tmp_path / "q.html").read_text())[-1] == "The recordings"


def test_bands_of_controls_and_of_the_measurement_are_told_apart() -> None:
    curve = np.linspace(0, 1, 101)
    side = CurvesOfSide("right", [CycleCurve(curve)], interval=(curve - 1, curve + 1))
    drawing = drawn_panels([CyclePanel("knee", "°", [side], (curve - 2, curve + 2))])
    assert (
        'class="control"' in drawing and 'class="interval right"' in drawing and "controls, mean" in drawing and "95 % interval" in drawing
    )
    bare = drawn_panels([CyclePanel("knee", "°", [CurvesOfSide("right", [CycleCurve(curve)])])])
    assert 'class="control"' not in bare and "95 % interval" not in bare


def test_a_difference_counts_where_it_is_larger_than_chance() -> None:
    def cycles(values: list[float], sigma: float) -> list[Parameter]:
        return [Parameter("stance", "L", value, sigma, 0.0, 1.0) for value in values]

    same = compare_sessions(cycles([60.0, 62.0, 64.0], 0.1), cycles([61.0, 63.0, 65.0], 0.1))[0]
    assert same.difference == pytest.approx(1.0) and same.interval > 3 and not same.exceeds
    changed = compare_sessions(cycles([60.0, 62.0, 64.0], 0.1), cycles([71.0, 73.0, 75.0], 0.1))[0]
    assert changed.exceeds
    # cycles that agree by chance are as far off as their events may be
    lucky = compare_sessions(cycles([60.0], 2.0), cycles([62.0, 62.0], 2.0))[0]
    assert lucky.interval == pytest.approx(1.96 * np.sqrt(4 + 2), rel=1e-3) and not lucky.exceeds
    assert compare_sessions(cycles([60.0], 2.0), []) == []


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """before/a.c3d and after/a.c3d, the second of a person who walks with the same steps a quarter faster."""
    folder = tmp_path_factory.mktemp("sessions")
    walk = replace(simulate_walks(1, frames=500, markers="helen-hayes", seed=5)[0], metadata={"subject": "ann"})
    for name, rate in (("before", walk.rate), ("after", 1.25 * walk.rate)):
        (folder / name).mkdir()
        asterism.write(folder / name / "a.c3d", replace(walk, rate=rate, metadata={"subject": "ann"}))
    return folder


def test_two_sessions_are_compared_and_what_changed_is_marked(sessions: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = (str(sessions / name / "a.c3d") for name in ("before", "after"))
    words = ["gait", first, "--compare", second, "--report", str(tmp_path / "p.html"), "--json", str(tmp_path / "p.json")]
    assert main([*words, "--measure", "BodyMass=50", "--compare-measure", "BodyMass=54"]) == 0
    assert "Two sessions" in capsys.readouterr().out
    content = json.loads((tmp_path / "p.json").read_text())
    assert [content[session][0]["measures"]["mass"] for session in ("files", "compared")] == [50, 54]
    changes = {(one["parameter"], one["side"]): one for one in content["changes"]}
    for side in "LR":
        speed, length = changes["walking speed", side], changes["stride length", side]
        assert speed["second"] == pytest.approx(1.25 * speed["first"], rel=0.02) and speed["exceeds"]
        assert not length["exceeds"] and length["difference"] == pytest.approx(0.0, abs=0.03)
    page = (tmp_path / "p.html").read_text()
    assert "left, before" in page and "right, after" in page and headings(page)[:2] == ["The person", "Parameters of two sessions"]
    assert 'class="mean left earlier"' in page
    for earlier, recording in ((" earlier", "0"), ("", "1")):
        places = re.findall(rf'class="cycle left{earlier}" d="[^"]*" data-name="[^"]*" data-go="(\d+):', page)
        assert places and set(places) == {recording}, "each session leads to its own recording"


def test_angles_of_two_sessions_differ_where_they_exceed_their_intervals(tmp_path: Path, walks: list[GaitAnalysis]) -> None:
    """A knee that is bent by 40 degrees more in the first half of the cycle, and a walk that is the same."""
    more = np.where(np.arange(101) <= 50, np.radians(40.0), 0.0)[:, None] * [1.0, 0.0, 0.0]
    bent = replace(walks[0], curves={name: curves + more if name == "LKneeAngles" else curves for name, curves in walks[0].curves.items()})
    bent.__dict__["bands"] = walks[0].bands
    gait_report(tmp_path / "p.html", [("first", walks[0])], compare=[("second", bent)])
    section = (tmp_path / "p.html").read_text().split("<h2>Angles of two sessions</h2>")[1].split("</section>")[0]
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", section, re.DOTALL)[1:]]
    (changed,) = [row for row in rows if row[6] != "no part"]
    assert changed[:2] == ["knee flexion", "left"] and changed[3] == "+40.0" and changed[6] == "50 % of the cycle"
    assert float(changed[2]) == pytest.approx(40 * 51 / 101, abs=0.1) and len(rows) > 12


def test_a_page_says_how_certain_its_angles_are_in_this_session_and_in_another(tmp_path: Path, walks: list[GaitAnalysis]) -> None:
    gait_report(tmp_path / "p.html", [("first", walks[0])])
    section = (tmp_path / "p.html").read_text().split("<h2>How certain the angles are</h2>")[1].split("</section>")[0]
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", section, re.DOTALL)[1:]]
    (knee,) = [row for row in rows if row[0] == "knee flexion"]
    band = walks[0].bands["LKneeAngles"]
    low, high = band.same_placement
    stated = [np.degrees(np.mean((top - bottom)[:, 0])) / 2 for bottom, top in ((low, high), (band.low, band.high))]
    assert [float(knee[1]), float(knee[3])] == pytest.approx(stated, abs=0.06) and stated[0] < stated[1]
    assert len(rows) == 12 and re.fullmatch(r"(measures|placement|strikes), \d+ %", knee[5])


def test_all_files_behind_compare_are_of_the_second_session(sessions: Path, tmp_path: Path) -> None:
    """However it is written: as words, with a sign of equality, as a folder, or as a pattern that the shell left alone."""
    few = replace(asterism.read(sessions / "before" / "a.c3d").frames(slice(40)), source=None)
    (tmp_path / "after").mkdir()
    first, *both = (str(tmp_path / name) for name in ("a.c3d", "after/b.c3d", "after/c.c3d"))
    for path in (first, *both):
        asterism.write(path, few)
    after, found = tmp_path / "after", tmp_path / "found.json"
    for words in (["--compare", *both], [f"--compare={both[0]}", both[1]], [f"--compare={after}"], ["--compare", f"{after}/*.c3d"]):
        main(["gait", first, *words, "--json", str(found), "--overwrite"])
        content = json.loads(found.read_text())
        assert [Path(one["file"]).name for one in content["compared"]] == ["b.c3d", "c.c3d"], words
        assert [one["file"] for one in content["files"]] == [first]


def test_sessions_that_cannot_be_told_apart_are_refused(sessions: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = (str(sessions / name / "a.c3d") for name in ("before", "after"))
    for words, said in (
        ([first, "--compare", second, first], "is in both sessions"),
        ([first, "--compare", str(sessions)], "is in both sessions"),
        ([first, "--static", first, "--compare", second], "--compare-static"),
        ([first, "--compare-static", second], "whose walks are missing"),
    ):
        assert main(["gait", *words]) == 2
        assert said in capsys.readouterr().err


def test_walks_of_several_people_in_one_report_are_said(sessions: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk = asterism.read(sessions / "before" / "a.c3d").frames(slice(80))
    for name in ("ann", "ben"):
        asterism.write(tmp_path / f"{name}.c3d", replace(walk, source=None, metadata={"subject": name}))
    words = ["gait", str(tmp_path / "ann.c3d"), str(tmp_path / "ben.c3d"), "--report", str(tmp_path / "p.html")]
    assert main(words) == 1
    assert "ann, ben" in capsys.readouterr().err


@needs_chromium
def test_a_report_is_printed_or_the_browser_that_is_missing_named(
    sessions: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    walk, pdf, written = str(tmp_path / "short.c3d"), tmp_path / "p.pdf", asterism.read(sessions / "before" / "a.c3d").frames(slice(80))
    asterism.write(walk, replace(written, source=None))
    assert main(["gait", walk, "--pdf", str(pdf)]) == 1, "it shows no whole cycle"
    assert pdf.read_bytes().startswith(b"%PDF") and len(list(tmp_path.iterdir())) == 2
    monkeypatch.setattr("asterism.report.pdf.shutil.which", lambda name: None)
    monkeypatch.setattr("asterism.report.pdf._PLACES", {})
    capsys.readouterr()
    assert main(["gait", walk, "--pdf", str(tmp_path / "q.pdf")]) == 2
    assert "Chromium" in capsys.readouterr().err and not (tmp_path / "q.pdf").exists()


def plate(frames: int) -> ForcePlate:
    """Half a metre square, loaded from the tenth frame on by 700 N upwards and 50 N ahead, 10 cm beside its middle."""
    force = np.zeros((10 * frames, 3))
    force[100:] = [50.0, 0.0, 700.0]
    corners = np.array([[0.25, 0.25, 0], [-0.25, 0.25, 0], [-0.25, -0.25, 0], [0.25, -0.25, 0]])
    moment = np.cross([0.1, 0.0, 0.0], force)
    return ForcePlate(1, corners, force, moment, 1000.0, np.array([0.0, 0.0, 1.0]))


@needs_node
def test_the_player_has_each_frames_force_where_it_acts(tmp_path: Path, walks: list[GaitAnalysis]) -> None:
    recording = walks[0].recording
    shown = ShownRecording("walk", labelling_by_names(recording), recording.clouds(), plates=[plate(len(recording))])
    (packed,) = pack_recordings([shown])
    sent: dict[str, Any] = json.loads(json.dumps(packed, default=lambda value: value.tolist()))
    code = "const r = await Asterism.unpack(packed); return [5, 200].map(t => r.plates[0].at(t)).concat([r.plates[0].corners]);"
    before, loaded, corners = in_node(code, tmp_path, packed=sent)
    assert before is None and loaded["force"] == [50, 0, 700]
    np.testing.assert_allclose(loaded["from"], [0.1, 0.0, 0.0], atol=5e-4)
    np.testing.assert_allclose(corners, plate(300).corners)


@needs_chromium
def test_a_click_shows_the_frames_and_the_player_goes_backwards(tmp_path: Path, walks: list[GaitAnalysis]) -> None:
    gait_report(tmp_path / "p.html", [("first", walks[1]), ("second", walks[0])])
    page = (tmp_path / "p.html").read_text()
    begin = round(walks[0].cycles[0].strike.time * walks[0].recording.rate)
    act = f"""<script>setTimeout(async () => {{
      const cell = document.querySelector('td[data-go^="1:{begin}:"] button'), shown = Asterism.shownRecordings[0];
      cell.click();
      await new Promise(done => setTimeout(done, 300));
      const at = shown.player.frame, where = shown.where.textContent, lines = document.querySelectorAll('.panel .now[d^="M"]').length;
      // The browser's clock is virtual here, and paints nothing.
      let clock = 0;
      globalThis.requestAnimationFrame = tick => setTimeout(() => tick(clock += 16), 1);
      shown.player.toggle(-1);
      for (let i = 0; i < 40 && shown.player.frame === at; i++) await new Promise(done => setTimeout(done, 20));
      const {{ frame, playing }} = shown.player;
      document.body.append(`ACTED ${{shown.current}} ${{at}} ${{frame - at}} ${{playing}} ${{lines > 11}} ${{where}}`);
    }}, 300)</script></body>"""
    (tmp_path / "p.html").write_text(page.replace("</body>", act))
    elements = opened((tmp_path / "p.html").as_uri(), tmp_path, "ACTED")
    assert re.search(rf"ACTED 1 {begin} -[1-9][0-9]* -1 true .* 0 % of its cycle, on the floor", elements), elements[-500:]


def test_the_page_on_motion_has_cycles_first_and_no_numbers_of_limbs(tmp_path: Path) -> None:
    """A walk's hips, knees and ankles over the cycle, then the limbs that were found, called by the markers on them."""
    walk = simulate_walks(1, frames=300, markers="plug-in-gait", seed=1)[0]
    asterism.write(tmp_path / "walk.c3d", walk)
    assert main(["motion", str(tmp_path / "walk.c3d"), "--limbs", "5", "--report", str(tmp_path / "p.html")]) in (0, 1)
    page = (tmp_path / "p.html").read_text()
    found = headings(page)
    assert (
        found[0] == "walk.c3d: hips, knees and ankles over the gait cycle"
        and "limb 1" not in page.split('<script type="application/json"')[0]
    )
    panels = page.split("<h2>")[1]
    assert panels.count('<figure class="panel"') == 9 and panels.count('class="mean left"') == 9
    assert any("left thigh" in one or "left shank" in one or "left foot" in one for one in re.findall("<figcaption>(.*?) <small>", page))


def test_limbs_of_points_without_known_names_are_called_by_their_points() -> None:
    walk = simulate_walks(1, frames=80, markers="plug-in-gait", seed=1)[0]
    analysis = analyse_motion(
        walk, {"limb 1": ["LTHI", "LKNE", "LASI"], "my arm": ["LELB", "LWRA", "LWRB"], "limb 3": ["LTIB", "LANK", "LHEE"]}
    )
    assert limb_names(analysis) == ["left thigh and pelvis", "my arm", "left shank and left foot"]
    plain = replace(analysis, recording=replace(analysis.recording, labels=tuple(f"P{n}" for n in range(len(walk.labels)))))
    names = limb_names(plain)
    assert names[1] == "my arm" and re.match(r"P\d+", names[0]) and len(set(names)) == 3


def test_who_has_no_name_in_the_file_is_called_as_the_folder_is(tmp_path: Path, walks: list[GaitAnalysis]) -> None:
    folder = tmp_path / "bert"
    folder.mkdir()
    (folder / "walk.c3d").touch()
    for metadata, said in (
        ({"file": str(folder / "walk.c3d")}, "bert (the folder)"),
        ({"file": str(folder / "walk.c3d"), "subject": "ann"}, ">ann<"),
        ({"file": "simulated walk"}, ">–<"),
    ):
        gait_report(tmp_path / "p.html", [("walk", replace(walks[0], recording=replace(walks[0].recording, metadata=metadata)))])
        row = (tmp_path / "p.html").read_text().split('<td class="text">person<')[1].split("</tr>")[0]
        assert said in row and ("bert" in row) == ("bert" in said)


def test_scores_against_a_band_of_another_model_say_so(
    tmp_path: Path, walks: list[GaitAnalysis], capsys: pytest.CaptureFixture[str]
) -> None:
    band = band_of(walks, ["a", "b", "c"])
    assert band.models == ("Plug-in-Gait",) and other_models(walks, band) == ""
    assert other_models(walks, replace(band, models=())) == "", "a band of an older version does not say"
    other = replace(band, models=("the gait protocol of somebody",))
    other.save(tmp_path / "other.band")
    asterism.write(tmp_path / "walk.c3d", walks[0].recording)
    words = ["gait", str(tmp_path / "walk.c3d"), "--band", str(tmp_path / "other.band"), "--report", str(tmp_path / "p.html")]
    assert main(words) == 1
    (told,) = [line for line in capsys.readouterr().err.splitlines() if "gait-band-model" in line]
    assert "by the gait protocol of somebody, these by Plug-in-Gait" in told
    assert "these by Plug-in-Gait" in (tmp_path / "p.html").read_text()
