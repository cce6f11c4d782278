"""`asterism train` says what a model does not know: movements after standing trials alone, and strangers after few people."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from models import BRIEF, training_with

import asterism
from asterism.cli import main
from asterism.recording import Recording
from asterism.simulation import simulate_standing, simulate_walks

MARKERS = "helen-hayes"


def train(folder: Path, recordings: Sequence[Recording], virtual_people: int = 0) -> tuple[int, dict[str, str]]:
    """The exit status of `asterism train`, and the sentences of its findings by their codes; each recording is another person's."""
    files = []
    for number, recording in enumerate(recordings):
        (folder / f"p{number}").mkdir()
        asterism.write(folder / f"p{number}" / "trial.c3d", recording)
        files.append(str(folder / f"p{number}"))
    with training_with(replace(BRIEF, virtual_people=virtual_people)):
        status = main(["train", *files, "-o", str(folder / "m.model"), "--markers", MARKERS, "--json", str(folder / "j.json")])
    found = json.loads((folder / "j.json").read_text())["findings"]
    return status, {finding["code"]: finding["sentence"] for finding in found}


def test_a_standing_trial_alone_is_a_warning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, found = train(tmp_path, simulate_standing(subjects=1, frames=60, markers=MARKERS, seed=1))
    assert status == 1 and set(found) == {"train-standing", "train-few-people"}
    assert "no label of a movement will be sure" in found["train-standing"]
    assert "train-standing" in capsys.readouterr().err
    walk = simulate_walks(subjects=2, frames=60, markers=MARKERS, seed=2)[1]
    labelling = asterism.MarkerModel.load(tmp_path / "m.model").label(walk)
    assert (labelling.confidence[labelling.indices >= 0] < 0.99).all(), "what the warning says"


def test_a_walk_beside_it_is_not(tmp_path: Path) -> None:
    standing = simulate_standing(subjects=2, frames=60, markers=MARKERS, seed=1)
    status, found = train(tmp_path, [standing[0], simulate_walks(subjects=2, frames=60, markers=MARKERS, seed=1)[1]])
    assert status == 0 and set(found) == {"train-few-people"}
    assert "2 people show little of how others differ" in found["train-few-people"]


def test_five_people_need_no_word(tmp_path: Path) -> None:
    status, found = train(tmp_path, simulate_walks(subjects=5, frames=40, markers=MARKERS, seed=1))
    assert status == 0 and not found


def test_virtual_people_know_movements(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, found = train(tmp_path, simulate_standing(subjects=1, frames=60, markers=MARKERS, seed=1), virtual_people=20)
    assert status == 0 and not found
    assert "movements are known from the virtual people alone" in capsys.readouterr().out
