"""Groups of points named by clicking: what the page's server answers, the files that it saves, and the page itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import in_node, needs_chromium, needs_node, opened
from correcting import Browser, drive, recorded, served, walks
from test_review_page import script

from asterism import formats
from asterism.cli import main
from asterism.labelling.correction.group_naming import GroupNaming
from asterism.labelling.naming import group_tracklets, mirrored_groups
from asterism.recording import MarkerSet, Recording
from asterism.recording.sides import mirrored_name

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

from asterism.session import LabellingOptions
from asterism.web import CorrectionSession, SessionOptions


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    """A walk as a camera system gives it, two of fifteen markers hidden at a time."""
    formats.write(tmp_path / "first.c3d", recorded(walks()[4])[0])
    return tmp_path / "first.c3d"


def sitting(file: Path, **options: Any) -> CorrectionSession:
    return CorrectionSession([file], (), SessionOptions((), **options))


def state(browser: Browser) -> dict[str, Any]:
    return dict(browser.get("/api/trials/0/state"))


def named(browser: Browser, group: int, marker: str | None) -> dict[str, Any]:
    event = {"kind": "name", "piece": group, "marker": marker}
    return dict(browser.post("/api/trials/0/touch", {"revision": state(browser)["revision"], "event": event}))


def true_names(file: Path) -> list[str]:
    """What each group of the walk is, by the simulation."""
    _, marker_of = recorded(walks()[4])
    clouds = formats.read(file).clouds()
    groups = group_tracklets(clouds)
    columns = [clouds.columns[np.argmax(groups.of_point == group)] for group in range(len(groups))]
    return [walks()[4].labels[marker_of[column]] if marker_of[column] >= 0 else "ghost" for column in columns]


def test_names_given_on_the_page_make_the_file_that_the_command_makes(walk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = true_names(walk)
    with served(sitting(walk, by_hand=True)) as browser:
        begun = state(browser)
        assert begun["naming"] and begun["verdict"]["look_at"] == len(begun["items"]) == len(begun["markers"]) >= 15
        assert not browser.get("/api/trials")["trials"][0]["saved"] and not list(walk.parent.glob("*.jsonl")), "a look writes nothing"
        named(browser, 0, "  wrong ")
        named(browser, 0, None)
        for item in begun["items"]:
            if names[item["piece"]] != "ghost":
                answer = named(browser, item["piece"], names[item["piece"]])
        assert answer["changed"] == [answer["changed"][0] | {"before": None, "by_person": True}]
        undone = browser.post("/api/trials/0/undo", {"revision": answer["revision"]})
        assert undone["changed"][0]["after"] is None
        browser.post("/api/trials/0/redo", {"revision": undone["revision"]})
        saved = browser.post("/api/trials/0/save", {})
        assert "asterism train" in saved["sentence"] and state(browser)["saved"]
    table, out = walk.parent / "corrected" / "first.names.csv", walk.parent / "by_command.c3d"
    assert main(["name", str(walk), "--names", str(table), "-o", str(out)]) == 0
    assert Path(saved["path"]).read_bytes() == out.read_bytes()
    assert set(walks()[4].labels) <= set(formats.read(out).labels)


def test_names_are_taken_up_again_and_the_file_is_known(walk: Path) -> None:
    with served(sitting(walk, by_hand=True)) as browser:
        named(browser, 0, "LASI")
        named(browser, 1, "RASI")
        browser.post("/api/trials/0/undo", {"revision": state(browser)["revision"]})
        browser.post("/api/trials/0/save", {})
    with served(sitting(walk, by_hand=True)) as browser:
        again = state(browser)
        assert again["saved"] and again["can_redo"] and [again["markers"][0], again["markers"][1]] == ["LASI", "2"]
        named(browser, 1, "SACR")
        assert not state(browser)["saved"]
        browser.post("/api/trials/0/save", {})
    (walk.parent / "corrected" / "first.names.csv").write_text("1,mine\n")
    with served(sitting(walk, by_hand=True)) as browser:
        status, body, _ = browser.ask("/api/trials/0/save", {})
        assert status == 400 and "first.names.csv exists" in json.loads(body)["error"]


def test_names_of_other_groups_are_not_taken_up(walk: Path) -> None:
    with served(sitting(walk, by_hand=True)) as browser:
        named(browser, 0, "LASI")
    log = walk.parent / "first.c3d.asterism-names.jsonl"
    header, *rest = log.read_text().splitlines()
    log.write_text("\n".join([json.dumps(json.loads(header) | {"model": "0" * 64}), *rest, ""]))
    with served(sitting(walk, by_hand=True)) as browser:
        [trial] = browser.get("/api/trials")["trials"]
        assert trial["state"] == "failed" and "other groups of points" in trial["error"]


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"kind": "name", "piece": 0, "marker": " "}, "is not a marker's name"),
    ({"kind": "name", "piece": 0, "marker": "*7"}, "is not a marker's name"),
    ({"kind": "name", "piece": 0, "marker": "a\u202eb"}, "is not a marker's name"),
    ({"kind": "name", "piece": 0, "marker": "\ud800"}, "is not a marker's name"),
    ({"kind": "name", "piece": 0, "marker": "x" * 101}, "is not a marker's name"),
    ({"kind": "name", "piece": 1, "marker": "LASI"}, "group 1 is LASI already, and both are seen in frame"),
    ({"kind": "name", "piece": 10**30, "marker": "A"}, "there is no such group"),
    ({"kind": "name", "piece": True, "marker": "A"}, "number of a group"),
    ({"kind": "name", "piece": 0, "marker": 7}, "only named"),
    ({"kind": "ghost", "piece": 0}, "only named"),
]


def test_a_name_that_cannot_be_is_a_sentence(walk: Path) -> None:
    with served(sitting(walk, by_hand=True)) as browser:
        named(browser, 0, "LASI")
        for event, said in REFUSED:
            status, body, _ = browser.ask("/api/trials/0/touch", {"revision": state(browser)["revision"], "event": event})
            assert status == 400 and said in json.loads(body)["error"], event
        assert state(browser)["touches"] == 1
        assert browser.ask("/api/teach", {"trials": ["0"], "model_out": None})[0] == 400


def test_nothing_is_saved_without_a_name(walk: Path) -> None:
    with served(sitting(walk, by_hand=True)) as browser:
        status, body, _ = browser.ask("/api/trials/0/save", {})
    assert status == 400 and "no group has a name" in json.loads(body)["error"] and not list(walk.parent.glob("corrected/*"))


def test_points_like_no_shipped_set_are_named(tmp_path: Path) -> None:
    """A prop of four points: nobody has a set for it, and the page opens all the same."""
    path = np.cumsum(np.full((100, 3), [0.01, 0.0, 0.0]), axis=0)[:, None] + np.random.default_rng(0).uniform(-0.2, 0.2, (4, 3))
    formats.write(tmp_path / "prop.trc", Recording(path, ("*1", "*2", "*3", "*4"), 100.0))
    with served(sitting(tmp_path / "prop.trc")) as browser:
        [trial] = browser.get("/api/trials")["trials"]
        assert trial["naming"] and any("points" in note for note in trial["notes"]) and len(state(browser)["items"]) == 4
        named(browser, 0, "tip")
        assert browser.post("/api/trials/0/save", {})["path"].endswith("prop.c3d")
    assert "tip" in formats.read(tmp_path / "corrected" / "prop.c3d").labels


def test_names_are_offered_mirrored_first_then_the_sets_then_those_given(walk: Path, tmp_path: Path) -> None:
    names = true_names(walk)
    left, right = names.index("LKNE"), names.index("RKNE")
    session = CorrectionSession([walk], (), SessionOptions((), labelling=LabellingOptions(markers=["helen-hayes"]), by_hand=True))
    with served(session) as browser:
        assert browser.get("/api/sets")["sets"][0] == "helen-hayes" and browser.get("/api/sets")["given"] == 1
        answer = named(browser, left, "Lknee")
        assert answer["state"]["mirrored"][str(left)] == right
        offered = browser.get(f"/api/trials/0/candidates?piece={right}&set=helen-hayes")["candidates"]
        assert offered[0] == ["Rknee", "mirrored"] and offered[1] == [MarkerSet.load("helen-hayes").names[0], ""]
        assert offered[-1] == ["Lknee", f"group {left + 1}"]
        for name in ("../secret", "nothing", ""):
            assert browser.get(f"/api/trials/0/candidates?piece={right}&set={name}")["candidates"][1:] == [["Lknee", f"group {left + 1}"]]


def test_a_body_that_stands_has_sides_once_a_pair_is_named() -> None:
    walk = walks()[3]
    still = Recording(np.repeat(walk.positions[:1], 50, axis=0), tuple(f"*{i}" for i in range(len(walk.labels))), walk.rate)
    naming = GroupNaming(still)
    of = {walk.labels[column]: int(naming.groups.of_point[column]) for column in range(len(walk.labels))}
    assert all(naming.mirrored(group) is None for group in of.values())
    naming.apply(of["LASI"], "LASI")
    naming.apply(of["RASI"], "RASI")
    assert naming.mirrored(of["LTHI"]) == of["RTHI"] and naming.mirrored(of["SACR"]) is None
    naming.apply(of["LTHI"], "L.Thigh")
    assert naming.mirrored_name(of["RTHI"]) == "R.Thigh" and naming.mirrored_name(of["LKNE"]) is None
    naming.apply(of["RKNE"], "R.Thigh")
    assert naming.mirrored_name(of["RTHI"]) is None, "that name is given already"


def test_a_mirror_image_is_told_by_places_both_ways() -> None:
    places = np.array([[0.0, 0.2, 1.0], [0.0, -0.2, 1.0], [0.1, 0.0, 1.5], [0.0, 0.1, 0.5]])
    assert mirrored_groups(places, np.array([1.0, 0.0])) == {0: 1, 1: 0}, "the last has no other side, and the third is its own"
    assert mirrored_groups(places, np.full(2, np.nan)) == {} == mirrored_groups(places[:0], np.array([1.0, 0.0]))


@pytest.mark.parametrize(
    ("name", "other"),
    [("RTOE", "LTOE"), ("Left Heel", "Right Heel"), ("L", None), ("T10", None), ("LEFT_KNEE", "RIGHT_KNEE"), ("膝", None)],
)
def test_the_other_sides_name(name: str, other: str | None) -> None:
    assert mirrored_name(name) == other


@needs_node
def test_any_name_can_be_typed_and_none_is_taken_by_accident(tmp_path: Path) -> None:
    got = in_node(
        """const element = () => ({ value: "", addEventListener() {}, setAttribute() {}, replaceChildren() {} });
        globalThis.document = { createElement: () => ({ style: {}, append() {}, setAttribute() {} }) };
        const taken = [], input = element(), box = new Asterism.NameBox(input, element(), name => taken.push(name));
        box.free = true;
        const enter = text => { input.value = text; box.at = 0; box.draw(); box.key({ key: "Enter", preventDefault() {} }); };
        box.set([["LASI", ""]]); enter(""); enter("tip"); enter("las"); enter("LAS");
        box.set([["RASI", "mirrored"]]); enter("");
        return taken;""",
        tmp_path,
        scripts=script("labels.js") + script("panel.js"),
    )
    assert got == ["tip", "LASI", "LASI", "RASI"]


DRIVER = """(async () => {
  const { page } = Asterism, at = id => document.getElementById(id);
  const until = met => new Promise(ok => { const timer = setInterval(() => { if (met()) { clearInterval(timer); ok(); } }, 20); });
  const press = key => document.activeElement.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
  await until(() => document.querySelector("#list .current") && at("set").options.length > 1);
  while (page.labels.state.can_undo) await page.undo();  // the browser's clock may have run out before
  const first = +Object.keys(page.labels.state.mirrored)[0];
  page.select(first, page.labels.pieces.first[first]);
  const pick = page.labels.pointAt(first, page.player.frame);
  page.unselect();
  page.pickPoint(pick, {});
  press("n");
  at("name").value = "Lhip";
  at("name").dispatchEvent(new Event("input"));
  press("Enter");
  await until(() => page.labels.state.touches === 1 && page.selected !== first && at("candidates").textContent.includes("mirrored"));
  press("Enter");
  await until(() => page.labels.state.touches === 2 && document.activeElement === at("name"));
  at("unname").click();
  await until(() => page.labels.state.touches === 2);
  at("save").click();
  await until(() => page.labels.state.saved);
  const names = page.player.scene.short.filter(name => !/^\\d/.test(name));
  const shown = ["right", "teach", "set"].map(id => at(id).offsetParent !== null);
  document.body.append(Asterism.make("p", { textContent: `driven ${names} ${shown} driven` }));
})();"""


@needs_chromium
def test_a_person_clicks_a_group_types_a_name_and_takes_its_mirror_image(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive(monkeypatch, DRIVER)
    with served(sitting(walk, by_hand=True)) as browser:
        elements = opened(browser.address, tmp_path, "driven .* driven")
    assert "driven Lhip,Rhip false,false,true driven" in elements
    assert {"Lhip", "Rhip"} <= set(formats.read(tmp_path / "corrected" / "first.c3d").labels)
