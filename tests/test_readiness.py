"""Whether labels can be used, in words: what is new to the model is said, and what to do, wherever labels are capped."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from correcting import model, walks

import asterism
from asterism.cli import main
from asterism.labelling.correction.readiness import DO_NOT_USE, LOOK, READY, Readiness, readiness
from asterism.labelling.review import review
from asterism.recording import Clouds, Labelling
from asterism.recording.verdict import CERTAIN, FITS, OTHER_BODY, OTHER_MARKERS, OTHER_PERSON, UNKNOWN, Verdict

FRAMES = 100


def verdict(kind: str, exchangeable: tuple[tuple[str, ...], ...] = ()) -> Verdict:
    return Verdict(kind, 0.07, 0.06, 1.0, 1.0, 0.0, exchangeable)


def judged(kind: str, confidence: float, doubtful: float | None = None, bodies: int = 1, given: bool = True) -> Readiness:
    """A walk under its true labels, with this confidence, and the last marker's if it is another one."""
    clouds: Clouds = walks()[4].frames(slice(0, FRAMES)).clouds()
    certain = np.full((FRAMES, 15), confidence)
    certain[:, -1] = confidence if doubtful is None else doubtful
    indices = np.tile(np.arange(15) if given else np.full(15, -1), (FRAMES, 1))
    labelling = Labelling(indices, certain if given else 0.0 * certain, walks()[4].labels, verdict=verdict(kind), bodies=bodies)
    return readiness(labelling, clouds, review(labelling, clouds))


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
