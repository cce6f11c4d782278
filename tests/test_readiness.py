"""Whether labels can be used, in words: what is new to the model is said, and what to do, wherever labels are capped."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from correcting import model, walks
from hypothesis import given, settings
from hypothesis import strategies as st

import asterism
from asterism.cli import main
from asterism.findings import Finding, Severity
from asterism.labelling.correction.readiness import DO_NOT_USE, DOUBTS, LOOK, READY, Readiness, readiness
from asterism.labelling.review import review
from asterism.recording import Clouds, Labelling
from asterism.recording.verdict import CERTAIN, FITS, OTHER_BODY, OTHER_MARKERS, OTHER_PERSON, UNKNOWN, Verdict

FRAMES = 100


def verdict(kind: str, exchangeable: tuple[tuple[str, ...], ...] = ()) -> Verdict:
    return Verdict(kind, 0.07, 0.06, 1.0, 1.0, 0.0, exchangeable)


def judged(
    kind: str | None, confidence: float, doubtful: float | None = None, bodies: int = 1, given: bool = True, found: tuple[str, ...] = ()
) -> Readiness:
    """A walk under its true labels, with this confidence, and the last marker's if it is another one."""
    clouds: Clouds = walks()[4].frames(slice(0, FRAMES)).clouds()
    certain = np.full((FRAMES, 15), confidence)
    certain[:, -1] = confidence if doubtful is None else doubtful
    indices = np.tile(np.arange(15) if given else np.full(15, -1), (FRAMES, 1))
    labelling = Labelling(indices, certain if given else 0.0 * certain, walks()[4].labels, bodies=bodies)
    labelling = replace(labelling, verdict=None if kind is None else verdict(kind))
    findings = [Finding(code, Severity.WARNING, "walk.c3d", f"walk.c3d: {code}.") for code in found]
    return readiness(labelling, clouds, review(labelling, clouds), findings)


def test_a_stranger_whose_labels_agree_is_looked_at_once_and_taught() -> None:
    found = judged(OTHER_PERSON, CERTAIN)
    assert (found.kind, found.look_at, found.words) == (LOOK, 0, "look once")
    assert found.sentence == (
        "Look once: the labels agree with each other, but this body, or its movement, is new to the model, so that none of the "
        "model's labels is above 98.99 %; then teach them with `asterism learn`."
    )


@pytest.mark.parametrize("kind", [UNKNOWN, OTHER_MARKERS])
def test_what_a_model_cannot_judge_is_said_without_teaching(kind: str) -> None:
    found = judged(kind, CERTAIN)
    assert found.kind == LOOK and "98.99 %" in found.sentence and "learn" not in found.sentence


def test_a_doubtful_piece_of_a_stranger_is_counted() -> None:
    found = judged(OTHER_PERSON, CERTAIN, doubtful=0.9)
    assert (found.kind, found.look_at, found.words) == (LOOK, 1, "look at 1")
    assert found.sentence.startswith("Look at 1 piece of tracks: this body") and "agree" not in found.sentence


def test_what_a_person_has_confirmed_is_ready() -> None:
    assert judged(OTHER_PERSON, 1.0).kind == READY
    assert judged(OTHER_PERSON, 1.0, doubtful=CERTAIN).kind == LOOK


def test_a_body_that_fits_is_ready_and_says_no_more() -> None:
    found = judged(FITS, 0.999)
    assert (found.kind, found.why, found.sentence) == (READY, "", "Ready: no label needs a look.")
    assert judged(FITS, 0.999, doubtful=0.9).sentence == "Look at 1 piece of tracks."


def test_a_second_person_is_said_before_pieces() -> None:
    found = judged(FITS, 0.999, bodies=2)
    assert found.kind == LOOK and "give the model once for each" in found.sentence


@pytest.mark.parametrize("kind", [FITS, UNKNOWN, OTHER_PERSON, OTHER_BODY])
def test_without_a_label_nothing_is_ready(kind: str) -> None:
    found = judged(kind, 0.0, given=False)
    assert found.kind == DO_NOT_USE and "no label was given" in found.sentence
    assert ("no body that the model knows" in found.sentence) == (kind == OTHER_BODY)


OF_THE_VERDICT = {
    "label-foreign-recording": "the verdict's kind",
    "label-exchangeable": "the verdict's exchangeable markers",
    "label-two-bodies": "the number of bodies",
    "label-nothing": "the number of labels",
    "label-do-not-use": "the readiness itself",
    "model-earlier-version": "the verdict, which is not there",
}
"""Findings that follow from what `readiness` asks itself."""
BESIDE_READY = {
    "label-other-subject": "the file was labelled without the trial",
    "label-in-stretches": "the labels are those of the whole recording",
    "label-computed-outdated": "it is about points that another program computed",
    "label-two-sets": "each body was labelled and judged",
    "label-wider-set": "the labels asked for are there",
    "model-uncovered-markers": "it is about solvers, whose labels are not judged",
    "format-not-carried": "it is about the copy",
    "format-cut-off": "the frames that are there are whole",
    "format-units-assumed": "the unit fits the size of the body",
    "format-vertical-assumed": "the likeliest vertical; the verdict tells what is no body under it",
    "format-rate-conflict": "two of three agree on the rate",
    "format-header-conflict": "the file's length decides",
    "format-events-outside": "it is about events",
    "format-short-rows": "samples are missing",
    "format-moved-cells": "samples are missing",
    "format-events-unread": "it is about events",
    "format-values-left-out": "it is about columns that are no positions",
    "format-missing-samples": "samples are missing",
    "format-frame-numbers": "samples are missing, or the lines are as they were written",
    "format-force-plate": "it is about forces",
    "format-analog-overflow": "it is about analog samples",
    "format-damaged-parts": "samples are missing",
    "format-several-streams": "the stream that is read is whole",
    "format-clock-set": "it is about times, which go on",
    "format-gaps-left-out": "samples are missing",
    "format-text-encoding": "it is about letters",
    "format-point-names": "the labels are by the points",
    "format-repeated-names": "the labels are by the points",
    "format-nothing-seen": "there are no labels",
    "recording-several-people": "each body is labelled",
    "recordings-differ": "it is about training",
    "train-standing": "it is about training",
    "train-few-people": "it is about training",
    "train-markers-absent": "it is about training",
    "format-rig-assumed": "it is about cameras",
    "format-bones-rigid": "it is about skeletons",
}
"""Findings beside which labels may be ready, and why."""


def documented(*headings: str) -> set[str]:
    """The codes that docs/findings.md lists under these headings."""
    text = (Path(__file__).parents[1] / "docs" / "findings.md").read_text(encoding="utf-8")
    sections = re.split(r"^## ", text, flags=re.MULTILINE)
    found = {section.partition("\n")[0]: re.findall(r"^\| ([a-z0-9-]+-[a-z0-9-]+) \|", section, re.MULTILINE) for section in sections}
    return {code for heading in headings for code in found[heading]}


def test_of_each_finding_it_is_decided_whether_labels_are_ready_beside_it() -> None:
    decided = [set(DOUBTS), set(OF_THE_VERDICT), set(BESIDE_READY)]
    assert set.union(*decided) == documented("label", "train, info", "Files")
    assert sum(map(len, decided)) == len(set.union(*decided)), "a finding has two decisions"


@pytest.mark.parametrize("code", DOUBTS)
def test_what_puts_all_labels_in_doubt_is_said_in_words(code: str) -> None:
    found = judged(FITS, 0.999, found=("format-cut-off", code))
    assert (found.kind, found.words, found.sentence) == (LOOK, "look once", f"Look once: {DOUBTS[code]}.")
    # who has confirmed every label has looked
    assert judged(FITS, 1.0, found=(code,)).kind == READY
    assert judged(FITS, 0.999, doubtful=0.9, found=(code,)).words == "look at 1"


def test_ready_stands_beside_all_other_findings() -> None:
    assert judged(FITS, 0.999, found=tuple(BESIDE_READY)).kind == READY


def test_labels_of_which_few_are_sure_are_not_ready() -> None:
    """In five frames no piece gains enough samples to be worth a look, and none of the labels has the confidence that is promised."""
    clouds = walks()[4].frames(slice(0, 5)).clouds()
    certain = np.full((5, 15), 0.985)
    for sure, kind in ((0, LOOK), (7, LOOK), (8, READY), (15, READY)):
        certain[:, :sure] = 0.995
        labelling = Labelling(np.tile(np.arange(15), (5, 1)), certain, walks()[4].labels, verdict=verdict(FITS))
        found = readiness(labelling, clouds, review(labelling, clouds))
        assert (found.kind, found.look_at) == (kind, 0)
        share = {0: "no label has", 7: "47 % of the labels have"}.get(sure, "")
        assert not share or found.sentence == f"Look once: {share} a confidence of 99 % or more; compare some with the person."


@settings(max_examples=25, deadline=None)
@given(
    kind=st.sampled_from([FITS, UNKNOWN, OTHER_PERSON, OTHER_MARKERS]),
    confidence=st.sampled_from([0.6, 0.9, 0.985, CERTAIN, 0.995, 1.0]),
    doubtful=st.sampled_from([0.6, 0.9, 0.985, CERTAIN, 0.995, 1.0]),
    found=st.sets(st.sampled_from(sorted([*DOUBTS, *BESIDE_READY])), max_size=3),
    more=st.sets(st.sampled_from(sorted(DOUBTS)), max_size=2),
)
def test_what_speaks_against_labels_never_makes_them_readier(
    kind: str, confidence: float, doubtful: float, found: set[str], more: set[str]
) -> None:
    """Neither does a label that is less sure; and the reason is said wherever pieces are not all there is to say."""
    order = [DO_NOT_USE, LOOK, READY]
    some = judged(kind, confidence, doubtful, found=tuple(found))
    assert order.index(judged(kind, confidence, doubtful, found=tuple(found | more)).kind) <= order.index(some.kind)
    assert order.index(judged(kind, confidence, min(confidence, doubtful), found=tuple(found)).kind) <= order.index(some.kind)
    assert some.kind != LOOK or some.why or some.look_at


def test_a_model_that_does_not_know_its_training_makes_nothing_ready() -> None:
    assert judged(None, 0.999).sentence.startswith("Look once: this model does not tell whether it knows the body")
    assert judged(None, 1.0).kind == READY


def test_every_door_explains_the_cap(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A person whose segments are a fifth longer and shorter than those of the model's people: all labels are right, and none is sure."""
    walk = walks()[4]
    stranger = walk.positions * np.array([1.0, 1.0, 1.0])
    stranger[:, [m for m, name in enumerate(walk.labels) if name[1:] in ("TOE", "HEE", "ANK", "TIB")], 2] *= 0.3
    asterism.write(tmp_path / "raw.npz", Clouds.from_points(list(stranger), rate=100.0, vertical="z"))
    model().save(tmp_path / "m.model")
    words = ["--model", str(tmp_path / "m.model")]
    assert main(["label", str(tmp_path / "raw.npz"), "-o", str(tmp_path / "out"), "--json", str(tmp_path / "l.json"),
                 "--report", str(tmp_path / "page.html"), *words]) == 1  # fmt: skip
    (row,) = json.loads((tmp_path / "l.json").read_text())["files"]
    assert row["verdict"] == OTHER_PERSON and row["max_confidence"] == CERTAIN and row["limited_by"] in row["why"]
    line = capsys.readouterr().out
    assert row["why"] in line and "98.99 %" in line
    assert row["why"] in (tmp_path / "page.html").read_text().replace("&#x27;", "'").replace("&#39;", "'")
    assert main(["review", str(tmp_path / "raw.npz"), *words]) == 1
    assert row["why"] in capsys.readouterr().out
