"""Gaps and gait events on the page: fills that a person accepts, events that they move, add and remove, and the file that is saved."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import needs_chromium, opened
from correcting import Browser, drive, model, served, walks

from asterism import formats
from asterism.cli import main
from asterism.gait import analyse_gait, find_events
from asterism.gait.said import walking_as_said, with_events_said
from asterism.motion.gaps import fill_gaps
from asterism.recording import Event, Recording, filled_samples

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

from asterism.web import CorrectionSession, SessionOptions


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    """A walk without names in which four markers are hidden for 40 to 120 ms."""
    positions = walks()[4].positions.copy()
    for column, first, end in ((3, 20, 30), (5, 40, 52), (8, 60, 64), (10, 100, 110)):
        positions[first:end, column] = np.nan
    names = tuple(f"*{column + 1}" for column in range(positions.shape[1]))
    formats.write(tmp_path / "walk.c3d", Recording(positions, names, walks()[4].rate, walks()[4].vertical, first_frame=11))
    return tmp_path / "walk.c3d"


def sitting(file: Path) -> CorrectionSession:
    return CorrectionSession([file], model(), SessionOptions((file.parent / "gait.model",)))


def told(browser: Browser, what: str) -> dict[str, Any]:
    return dict(browser.get(f"/api/trials/0/{what}"))


def say(browser: Browser, verb: str, **given: Any) -> dict[str, Any]:
    return dict(browser.post(f"/api/trials/0/{verb}", {"revision": told(browser, "state")["revision"], **given}))


def gap(row: dict[str, Any]) -> dict[str, Any]:
    return {name: row[name] for name in ("marker", "first", "last")}


def event(row: dict[str, Any], **changed: Any) -> dict[str, Any]:
    return {name: row[name] for name in ("label", "context", "time")} | changed


def test_an_accepted_fill_is_flagged_in_the_file_and_no_other_is_made(walk: Path) -> None:
    with served(sitting(walk)) as browser:
        plain = Path(browser.post("/api/trials/0/save", {})["path"])
        before = formats.read(plain)
        rows = told(browser, "gaps")["gaps"]
        first, second = rows[:2]
        assert not first["accepted"] and 0.0 < first["reach"] <= 10.0
        graph = told(browser, f"gap?marker={first['marker']}&first={first['first']}&last={first['last']}")
        at = first["first"] - graph["first"]
        inside = graph["reach"][at : at + first["last"] - first["first"] + 1]
        assert max(inside) == pytest.approx(first["reach"], abs=0.01) and all(graph["path"][at : at + len(inside)])
        touches = say(browser, "fill", gaps=[gap(first), gap(second)])["state"]["touches"]
        say(browser, "unfill", gaps=[gap(second)])
        assert touches == 1 and [row["accepted"] for row in told(browser, "gaps")["gaps"][:2]] == [True, False]
        browser.post("/api/trials/0/save", {})
    with served(sitting(walk)) as browser:
        assert [row["accepted"] for row in told(browser, "gaps")["gaps"][:2]] == [True, False], "the log keeps it"
        assert told(browser, "state")["saved"]
    saved = formats.read(plain)
    flagged = np.isfinite(filled_samples(saved))
    frames, columns = np.nonzero(flagged)
    assert {saved.labels[c] for c in columns} == {first["marker"]}
    assert frames.tolist() == list(range(first["first"], first["last"] + 1))
    column = saved.labels.index(first["marker"])
    np.testing.assert_allclose(saved.positions[flagged], fill_gaps(before).recording.positions[frames, column], atol=1e-5)
    np.testing.assert_array_equal(saved.visible, before.visible | flagged)


def test_events_are_moved_added_and_removed_and_gait_takes_them(walk: Path, tmp_path: Path) -> None:
    with served(sitting(walk)) as browser:
        begun = told(browser, "events")
        assert not begun["said"] and len(begun["events"]) >= 3 and begun["events"][0]["source"] == "markers"
        one, two = begun["events"][:2]
        say(browser, "events", removed=[event(one)], added=[event(one, time=one["time"] + 0.02)])
        say(browser, "events", removed=[event(two)])
        say(browser, "events", added=[{"label": "Foot Off", "context": "Left", "time": 0.0}])
        answer = say(browser, "undo")
        assert answer["state"]["touches"] == 2 and answer["changed"] == []
        say(browser, "redo")
        shown = told(browser, "events")
        assert shown["said"] and [row["source"] for row in shown["events"]].count("a person") == 2
        path = Path(browser.post("/api/trials/0/save", {})["path"])
    saved = formats.read(path)
    assert [saved_event.time for saved_event in saved.events] == pytest.approx(
        [row["time"] + saved.times[0] for row in shown["events"]], abs=1e-4
    )
    analysis = analyse_gait(saved)
    assert [(one.side, one.label) for one in analysis.walking.events] == [(row["context"][0], row["label"]) for row in shown["events"]]
    assert {one.source for one in analysis.walking.events} == {"a person", "markers"}
    assert main(["gait", str(path), "--json", str(tmp_path / "gait.json")]) in (0, 1)
    listed = json.loads((tmp_path / "gait.json").read_text())["files"][0]["events"]
    assert [one["source"] for one in listed].count("a person") == 2
    # another sitting begins with what the first one set
    with served(CorrectionSession([path], model(), SessionOptions((tmp_path / "gait.model",)))) as browser:
        again = told(browser, "events")
    assert not again["said"] and [row["time"] for row in again["events"]] == pytest.approx(
        [row["time"] for row in shown["events"]], abs=1e-4
    )


def test_other_events_of_the_file_stay_and_events_of_a_program_are_not_taken() -> None:
    walk = walks()[0]
    file = [Event("Foot Strike", 0.5, "Left"), Event("General", 0.3, "")]
    recording = replace(walk, events=tuple(file))
    found = find_events(recording)
    assert walking_as_said(recording, found) is found
    said = with_events_said(recording, [Event("Foot Off", 0.7, "Right")])
    assert [one.label for one in said.events] == ["General", "Foot Off"]
    [own] = walking_as_said(said, found).events
    assert (own.side, own.label, own.source) == ("R", "Foot Off", "a person") and own.sigma > 0


REFUSED: list[tuple[str, dict[str, Any], str]] = [
    ("fill", {"gaps": []}, "needs gaps"),
    ("fill", {"gaps": [{"marker": "LKNE", "first": 0, "last": True}]}, "whole numbers"),
    ("fill", {"gaps": [{"marker": "LKNE", "first": -5, "last": 10**20}]}, "no gap any more"),
    ("unfill", {"gaps": [{"marker": "LKNE", "first": 1, "last": 2}]}, "no gap any more"),
    ("events", {}, "no event was named"),
    ("events", {"added": [{"label": "Foot Strike", "context": "Left", "time": 1e9}]}, "outside the recording"),
    ("events", {"added": [{"label": "Foot Strike", "context": "Left", "time": float("nan")}]}, "outside the recording"),
    ("events", {"added": [{"label": "<b>", "context": "Left", "time": 0.1}]}, "needs a label"),
    ("events", {"added": "all"}, "lists of events"),
    ("events", {"removed": [{"label": "Foot Off", "context": "Right", "time": 0.12345}]}, "not there any more"),
]


def test_what_cannot_be_is_a_sentence(walk: Path) -> None:
    with served(sitting(walk)) as browser:
        for verb, given, said in REFUSED:
            status, body, _ = browser.ask(f"/api/trials/0/{verb}", {"revision": told(browser, "state")["revision"], **given})
            assert status == 400 and said in json.loads(body)["error"], (verb, given)
        assert told(browser, "state")["touches"] == 0
        assert browser.ask("/api/trials/0/gap?marker=LKNE&first=x")[0] == 400


DRIVER = """(async () => {
  const { page } = Asterism, at = id => document.getElementById(id);
  const until = met => new Promise(ok => { const timer = setInterval(() => { if (met()) { clearInterval(timer); ok(); } }, 20); });
  const press = key => page.player.canvas.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
  const { gaps, events } = page.panels;
  await until(() => page.labels);
  while (page.labels.state.can_undo) await page.undo();  // the browser's clock may have run out before
  press("e");
  await until(() => gaps.row && at("gap-about").textContent.startsWith("Enter"));
  press("Enter");
  await until(() => gaps.rows.some(row => row.accepted));
  const said = [at("gaps").querySelector("h2").textContent, page.timeline.overlay.filter(span => span.done).length];
  press("e");
  await until(() => page.mode === "events" && events.row);
  const { canvas } = page.timeline, box = canvas.getBoundingClientRect(), first = events.rows[0].time;
  const point = (type, frame) => canvas.dispatchEvent(new PointerEvent(type,
    { clientX: box.left + page.timeline.xOf(frame + 0.5), clientY: box.top + 30 }));
  canvas.setPointerCapture = () => {};
  const from = page.timeline.flags[0].frame, to = Math.round(from) + 7;
  point("pointerdown", from); point("pointermove", to); point("pointerup", to);
  await until(() => events.rows.some(row => row.source === "a person"));
  const moved = events.rows.find(row => row.source === "a person").time * page.labels.recording.rate;
  press("Delete");
  await until(() => !events.rows.some(row => row.source === "a person"));
  await page.undo();
  at("save").click();
  await until(() => page.labels.state.saved);
  document.body.append(Asterism.make("p", { textContent: `driven ${said}, ${(moved - to).toFixed(1)} driven` }));
})();"""


@needs_chromium
def test_enter_accepts_a_fill_and_an_event_is_dragged(walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drive(monkeypatch, DRIVER)
    with served(sitting(walk)) as browser:
        elements = opened(browser.address, tmp_path, "driven .* driven")
        assert [row["source"] for row in told(browser, "events")["events"]].count("a person") == 1
        open_gaps = sum(not row["accepted"] for row in told(browser, "gaps")["gaps"])
    assert f"driven Gaps to fill: {open_gaps},1, 0.0 driven" in elements
    saved = formats.read(tmp_path / "corrected" / "walk.c3d")
    assert np.isfinite(filled_samples(saved)).any() and any(step.action == "events set" for step in saved.log)
