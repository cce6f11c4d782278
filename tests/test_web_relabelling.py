"""Labelling again with the model that a sitting has taught: what it changes, what a person said, a stop half-way, and the log."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from correcting import Browser, model, quick_learner, served, walks, written

from asterism.labelling import MarkerModel
from asterism.labelling.correction import Correction
from asterism.session import FileLabeller, LabelledFile

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

from asterism.web import CorrectionSession, SessionOptions
from asterism.web.relabelling import SittingModel


@cache
def learned() -> MarkerModel:
    """What the model becomes by one more walk."""
    return quick_learner().learn([walks()[4]])


def sitting(folder: Path, count: int = 1) -> CorrectionSession:
    """A sitting that has taught a model before, as its second one."""
    session = CorrectionSession(written(folder, count), model(), SessionOptions((folder / "gait.model",)))
    session.models.append(SittingModel("gait-2.model", FileLabeller((learned(),), session.labeller.options, session.labeller.files)))
    return session


def said(browser: Browser, marker: str, which: int = 0, trial: str = "0") -> tuple[int, int]:
    """Name a long piece; which one it was, by its first frame and track."""
    state = browser.get(f"/api/trials/{trial}/state")
    pieces = state["pieces"]
    order = np.argsort([first - last for first, last in zip(pieces["first"], pieces["last"], strict=True)], kind="stable")
    place = int(order[which])
    event = {"kind": "name", "piece": pieces["id"][place], "marker": marker}
    browser.post(f"/api/trials/{trial}/touch", {"revision": state["revision"], "event": event})
    return pieces["first"][place], pieces["track"][place]


def by_person(state: dict[str, Any]) -> dict[tuple[int, int], str]:
    """What a person said of pieces, by their first frames and tracks."""
    pieces = state["pieces"]
    rows = zip(pieces["first"], pieces["track"], pieces["marker"], pieces["person"], strict=True)
    return {(first, track): state["markers"][marker] for first, track, marker, person in rows if person}


def wait(browser: Browser) -> dict[str, Any]:
    while (found := browser.get("/api/relabel"))["running"]:
        pass
    return dict(found)


def test_the_taught_model_labels_again_and_what_a_person_said_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # one lesson for all tests here
    taught = learned()
    monkeypatch.setattr(MarkerModel, "learn", lambda *given: taught)
    session = CorrectionSession(written(tmp_path, 2), model(), SessionOptions((tmp_path / "gait.model",)))
    with served(session) as browser:
        browser.post("/api/trials/0/save", {})
        number = browser.post("/api/teach", {"trials": ["0"], "model_out": None})["model"]
        assert browser.get("/api/trials")["models"] == ["gait.model", "gait-2.model"]
        # a wrong answer on purpose: no model would give it
        answered = [said(browser, "SACR", trial="1"), said(browser, "LANK", 1, trial="1")]
        before = browser.get("/api/trials/1/state")
        browser.post("/api/relabel", {"trials": ["1"], "model": number})
        found = wait(browser)
        after, changed = browser.get("/api/trials/1/state"), browser.get("/api/trials/1/changed")
        assert by_person(after) == dict(zip(answered, ["SACR", "LANK"], strict=True)) == by_person(before)
        assert after["relabelled"] and after["revision"] == before["revision"] + 1 and not after["saved"]
        assert found["sentence"].startswith("1 recording labelled again with gait-2.model: ") and found["failed"] == 0
        assert changed["about"].startswith("Labelled again with gait-2.model: ") and not any(one["by_person"] for one in changed["changed"])
        # answers go on, and what was said before can be taken back
        undone = browser.post("/api/trials/1/undo", {"revision": after["revision"]})["state"]
        assert undone["touches"] == 1 and list(by_person(undone).values()) == ["SACR"]
        assert not undone["relabelled"] and browser.get("/api/trials/1/changed")["changed"] == []
    log = [json.loads(line) for line in (tmp_path / "walk2.c3d.asterism-log.jsonl").read_text().splitlines()]
    assert [entry["kind"] for entry in log[1:]] == ["name", "name", "relabelled", "undo"]
    assert log[3]["model"] != log[0]["model"]


@pytest.mark.parametrize("last", [False, True])
def test_a_sitting_begins_again_with_either_model(last: bool, tmp_path: Path) -> None:
    with served(sitting(tmp_path)) as browser:
        answered = said(browser, "SACR")
        browser.post("/api/relabel", {"trials": ["0"], "model": 1})
        wait(browser)
        browser.post("/api/trials/0/save", {})
        labels = browser.get("/api/trials/0/state")["pieces"]["marker"]
    again = CorrectionSession([tmp_path / "walk1.c3d"], learned() if last else model(), SessionOptions((tmp_path / "any.model",)))
    with served(again) as browser:
        [trial] = browser.get("/api/trials")["trials"]
        state = browser.get("/api/trials/0/state")
        assert by_person(state) == {answered: "SACR"}
        # the saved file has the labels of the model that labelled last
        assert state["saved"] == last
        assert any("given with another model" in note for note in trial["notes"]) == (not last)
        if last:
            assert state["pieces"]["marker"] == labels


class Held:
    """Labelling that waits half-way for the test."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.begun, self.go_on = threading.Event(), threading.Event()
        label = FileLabeller.label

        def held(labeller: FileLabeller, path: Path, progress: Callable[[float, str], None] | None = None) -> LabelledFile:
            if progress is not None:
                progress(0.25, "labelling")
                self.begun.set()
                assert self.go_on.wait(60)
                progress(0.5, "labelling")
            return label(labeller, path, progress)

        monkeypatch.setattr(FileLabeller, "label", held)


def test_a_stop_half_way_leaves_the_trials_as_they_were(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with served(sitting(tmp_path, 2)) as browser:
        said(browser, "SACR")
        states, log = [browser.get(f"/api/trials/{n}/state") for n in "01"], tmp_path / "walk1.c3d.asterism-log.jsonl"
        lines = log.read_bytes()
        held = Held(monkeypatch)
        browser.post("/api/relabel", {"trials": ["0", "1"], "model": 1})
        assert held.begun.wait(60)
        running = browser.get("/api/relabel")
        assert (running["running"], running["trial"], running["share"], running["of"]) == (True, "walk1.c3d", 0.25, 2)
        status, body, _ = browser.ask("/api/relabel", {"trials": ["0"], "model": 1})
        assert status == 400 and "being labelled again already" in json.loads(body)["error"]
        browser.post("/api/relabel/stop", {})
        held.go_on.set()
        assert "Stopped: 2 recordings kept as they were." in wait(browser)["sentence"]
        assert [browser.get(f"/api/trials/{n}/state") for n in "01"] == states and log.read_bytes() == lines


def test_an_answer_that_comes_meanwhile_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with served(sitting(tmp_path)) as browser:
        held = Held(monkeypatch)
        browser.post("/api/relabel", {"trials": ["0"], "model": 1})
        assert held.begun.wait(60)
        answered = said(browser, "SACR")
        held.go_on.set()
        wait(browser)
        state = browser.get("/api/trials/0/state")
        assert by_person(state) == {answered: "SACR"} and state["relabelled"]


def test_an_answer_that_would_be_lost_keeps_the_labels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with served(sitting(tmp_path)) as browser:
        said(browser, "SACR")
        before, solve = browser.get("/api/trials/0/state"), Correction._solve
        monkeypatch.setattr(Correction, "_solve", lambda correction, touches: solve(correction, []))
        browser.post("/api/relabel", {"trials": ["0"], "model": 1})
        assert "an answer would be lost" in wait(browser)["sentence"]
        monkeypatch.undo()
        assert browser.get("/api/trials/0/state") == before


def test_a_log_that_cannot_be_written_keeps_the_labels(tmp_path: Path) -> None:
    with served(sitting(tmp_path)) as browser:
        said(browser, "SACR")
        before = browser.get("/api/trials/0/state")
        (tmp_path / "walk1.c3d.asterism-log.jsonl").write_text("notes")
        browser.post("/api/relabel", {"trials": ["0"], "model": 1})
        assert "was changed or replaced" in wait(browser)["sentence"]
        assert browser.get("/api/trials/0/state") == before


def test_a_file_that_fails_costs_itself_only(tmp_path: Path) -> None:
    with served(sitting(tmp_path, 2)) as browser:
        with (tmp_path / "walk1.c3d").open("ab") as file:
            file.write(b"more")
        browser.post("/api/relabel", {"trials": ["0", "1"], "model": 1})
        found = wait(browser)
        assert found["failed"] == 1 and "walk1.c3d has changed on the disk" in found["sentence"]
        assert [browser.get(f"/api/trials/{n}/state")["relabelled"] for n in "01"] == [False, True]


def test_a_request_for_no_trial_or_no_model_is_a_sentence(tmp_path: Path) -> None:
    given: list[dict[str, Any]] = [{"trials": ["0"], "model": model} for model in (2, -1, True)]
    given += [{"trials": trials, "model": 0} for trials in (["9"], [], "0")]
    with served(sitting(tmp_path)) as browser:
        for one in given:
            status, body, _ = browser.ask("/api/relabel", one)
            assert status == 400 and json.loads(body)["error"].endswith("."), one
