"""Files that are odd in one way each: every command says it, none says something false, and what one person is called stays theirs."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from correcting import model

from asterism import formats
from asterism.cli import main
from asterism.findings import Finding
from asterism.labelling import MarkerModel
from asterism.labelling.training.people import one_person_each
from asterism.recording import Recording
from asterism.session import labeller
from asterism.simulation import simulate_walks

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    return simulate_walks(2, 60, 50.0, markers="helen-hayes", seed=11)


@pytest.fixture(scope="module")
def taught(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("models") / "walks.model"
    model().save(path)
    return path


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    def command(*words: object) -> tuple[int, str, str]:
        capsys.readouterr()
        status = main([str(word) for word in words])
        return status, *capsys.readouterr()

    return command


def codes(err: str) -> list[str]:
    return sorted(re.findall(r"\[([a-z0-9-]+)\]$", err, re.MULTILINE))


def exchanged(walk: Recording, *names: str) -> Recording:
    """The walk with left and right names of these markers exchanged; without names, of all."""
    other = {"L": "R", "R": "L"}
    return replace(
        walk,
        labels=tuple(
            other[label[0]] + label[1:] if label != "SACR" and (not names or label[1:] in names) else label for label in walk.labels
        ),
    )


def pair(walks: list[Recording], one: str, two: str | None) -> Recording:
    """Two people 1.5 m apart, with this before their names; of the second, None for no names."""
    first, second = walks
    positions = np.concatenate([first.positions, second.positions + np.array([0.0, 1.5, 0.0])], axis=1)
    others = [f"*{i + 1}" if two is None else two + label for i, label in enumerate(second.labels)]
    return Recording(positions, (*(one + label for label in first.labels), *others), first.rate)


def test_another_vertical_without_labels_is_not_believed(
    walks: list[Recording], taught: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A body of half the size gets some labels in a few frames with another axis up, and none in all."""
    monkeypatch.setattr(labeller, "labelled_upright", lambda *_, every=False: np.array([0.0, 0.0, -1.0]) if every else None)
    formats.write(tmp_path / "half.c3d", replace(walks[0], positions=0.4 * walks[0].positions).frames(slice(0, 20)))
    _, out, err = run("label", tmp_path / "half.c3d", "-o", tmp_path / "out", "-m", taught)
    assert ", z up" in out and "no label was given" in out and "label-vertical" not in codes(err)


def test_a_size_that_nobody_has_is_said_where_no_set_is_found(walks: list[Recording], tmp_path: Path, run: Run) -> None:
    small = Recording.from_clouds(replace(walks[0], positions=0.05 * walks[0].positions).clouds())
    formats.write(tmp_path / "small.c3d", small)
    said = " ".join(run("info", tmp_path / "small.c3d")[1].split())
    assert "together they are as large as a body of 0.0" in said and "check the unit of length" in said


def test_label_repeats_what_is_wrong_with_a_file_that_it_refuses(walks: list[Recording], tmp_path: Path, run: Run) -> None:
    formats.write(tmp_path / "large.c3d", Recording.from_clouds(replace(walks[0], positions=10.0 * walks[0].positions).clouds()))
    status, _, err = run("label", tmp_path / "large.c3d", "-o", tmp_path / "out")
    assert status == 2 and "the unit of length is probably wrong" in err


@pytest.mark.parametrize("names", [("KNE",), ("HEE", "TOE"), ()])
def test_names_that_are_exchanged_are_a_warning_of_every_command(
    names: tuple[str, ...], walks: list[Recording], taught: Path, tmp_path: Path, run: Run
) -> None:
    file = tmp_path / "walk.c3d"
    formats.write(file, exchanged(walks[0], *names))
    for words in (("audit",), ("mend", "-o", tmp_path / "mended"), ("evaluate", "-m", taught, "--occlusions", "0")):
        status, _, _ = run(words[0], file, *words[1:], "--json", tmp_path / "told.json", "--overwrite")
        found = [one["code"] for one in json.loads((tmp_path / "told.json").read_text())["findings"]]
        assert status == 1 and "audit-names-differ" in found, words
    status, out, err = run("label", file, "-o", tmp_path / "out", "-m", taught)
    assert status == 1 and "label-names-differ" in codes(err) and "look once" in out


@pytest.mark.parametrize(("one", "two", "called"), [("", "2:", ("1", "2")), ("A:", "B:", ("A", "B")), ("A:", None, ("A", "2"))])
def test_two_people_of_a_file_keep_their_names(
    one: str, two: str | None, called: tuple[str, str], walks: list[Recording], tmp_path: Path, run: Run
) -> None:
    formats.write(tmp_path / "pair.c3d", pair(walks, one, two))
    sets = () if two is not None else ("--markers", "helen-hayes", "--markers", "helen-hayes")
    status, out, _ = run("label", tmp_path / "pair.c3d", "-o", tmp_path / "out", *sets)
    assert status == 0 and "100.00 % labelled" in out
    labelled = formats.read(tmp_path / "out" / "pair.c3d")
    truth = pair(walks, f"{called[0]}:", f"{called[1]}:")
    assert set(labelled.labels) == set(truth.labels)
    ordered = labelled.select(truth.labels)
    np.testing.assert_allclose(ordered.positions, truth.positions, atol=1e-3)


def test_learn_takes_two_people_as_train_does(
    walks: list[Recording], taught: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who is taught is tried in `test_people`; that takes long."""
    learned = list[Recording]()
    monkeypatch.setattr(MarkerModel, "learn", lambda model, recordings, **_: learned.extend(recordings) or model)
    formats.write(tmp_path / "pair.c3d", pair(walks, "A:", "B:"))
    for given in ((taught,), ()):
        assert run("learn", *given, tmp_path / "pair.c3d", "-o", tmp_path / "new.model", "--overwrite")[0] == 0
    truth = pair(walks, "A:", "B:")
    for recording in learned:
        assert recording.labels == truth.labels
        assert one_person_each([recording], ["duo"])[1] == ["duo A", "duo B"]


@pytest.mark.parametrize("verb", ["gait", "motion"])
def test_of_two_people_the_first_is_analysed_and_that_is_said(verb: str, walks: list[Recording], tmp_path: Path, run: Run) -> None:
    formats.write(tmp_path / "pair.c3d", pair(walks, "Ann:", "Bob:"))
    formats.write(tmp_path / "alone.c3d", walks[0])
    status, _, err = run(verb, tmp_path / "pair.c3d", "--json", tmp_path / "two.json")
    assert status == 1 and "2 people (Ann, Bob); Ann is analysed" in err
    run(verb, tmp_path / "alone.c3d", "--json", tmp_path / "one.json")
    two, one = (json.loads((tmp_path / name).read_text())["files"][0] for name in ("two.json", "one.json"))
    assert {key: value for key, value in two.items() if key != "file"} == {key: value for key, value in one.items() if key != "file"}


def test_what_clinical_angles_lack_is_a_finding(walks: list[Recording], tmp_path: Path, run: Run) -> None:
    formats.write(tmp_path / "walk.c3d", walks[0])
    _, out, err = run("motion", tmp_path / "walk.c3d", "--json", tmp_path / "told.json")
    found = {finding["code"] for finding in json.loads((tmp_path / "told.json").read_text())["findings"]}
    assert "clinical-measures" in found and "clinical-measures" in codes(err) and "widths" not in out


def test_an_empty_folder_costs_itself(walks: list[Recording], tmp_path: Path, run: Run) -> None:
    (tmp_path / "x.c3d").mkdir()
    formats.write(tmp_path / "walk.c3d", walks[0].frames(slice(0, 10)))
    for words in (("info",), ("label", "-o", tmp_path / "out"), ("audit",)):
        status, out, err = run(words[0], tmp_path / "x.c3d", tmp_path / "walk.c3d", *words[1:])
        assert status == 1 and "x.c3d holds no recording" in err and ("walk.c3d" in out or words == ("audit",))
        assert run(words[0], tmp_path / "x.c3d", *words[1:])[0] == 2


def found_by(run: Run, verb: str, file: Path, place: Path, *words: object) -> tuple[int, list[str]]:
    status, _, err = run(verb, file, *words, "--json", place / f"{verb}.json", "--overwrite")
    return status, [code for code in codes(err) if code.startswith("format-")]


@pytest.mark.parametrize(
    ("code", "change"),
    [
        ("format-repeated-names", lambda walk: replace(walk, labels=(*walk.labels[:-1], walk.labels[0]))),
        ("format-nothing-seen", lambda walk: replace(walk, positions=np.full_like(walk.positions, np.nan))),
    ],
)
def test_info_and_the_other_commands_find_the_same(
    code: str, change: Callable[[Recording], Recording], walks: list[Recording], taught: Path, tmp_path: Path, run: Run
) -> None:
    formats.write(tmp_path / "walk.c3d", change(walks[0].frames(slice(0, 20))))
    assert found_by(run, "info", tmp_path / "walk.c3d", tmp_path) == (1, [code])
    status, found = found_by(run, "label", tmp_path / "walk.c3d", tmp_path, "-m", taught, "-o", tmp_path / "out")
    # nothing can be labelled where nothing is seen
    assert (status, found) == ((1, [code]) if code == "format-repeated-names" else (2, []))
    assert isinstance(formats.describe(tmp_path / "walk.c3d")["findings"][0], Finding)


def test_a_unit_that_nobody_knows_is_not_believed_in_words(walks: list[Recording], tmp_path: Path, run: Run) -> None:
    formats.write(tmp_path / "walk.trc", walks[0].frames(slice(0, 5)))
    text = (tmp_path / "walk.trc").read_text(encoding="utf-8")
    header, line = text.split("\n", 3)[:3], text.split("\n")[2].split("\t")
    line[4] = "foo"
    (tmp_path / "walk.trc").write_text(text.replace(header[2], "\t".join(line), 1), encoding="utf-8")
    status, out, err = run("info", tmp_path / "walk.trc")
    assert status == 1 and codes(err) == ["format-units-unknown"] and "the file says so" not in out.split("units")[1].split("\n")[0]


def test_a_body_without_extent_is_not_learned(
    walks: list[Recording], taught: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was learned without a word, or ended in a singular matrix."""
    collapsed = replace(walks[0], positions=np.repeat(walks[0].positions[:, :1], 15, axis=1))
    formats.write(tmp_path / "one.c3d", collapsed)
    for words in (("learn", taught), ("train", "--virtual-people", "0", "--no-audit")):
        status, _, err = run(words[0], *words[1:], tmp_path / "one.c3d", "-o", tmp_path / "new.model")
        assert status == 2 and "one.c3d shows its labelled points all in one place" in err
    twice = walks[0].positions.copy()
    twice[:, 3] = twice[:, 4]
    formats.write(tmp_path / "two.c3d", replace(walks[0], positions=twice))
    monkeypatch.setattr(MarkerModel, "learn", lambda model, recordings, **_: model)
    status, _, err = run("learn", taught, tmp_path / "two.c3d", "-o", tmp_path / "new.model")
    assert status == 1 and "label-coincident" in codes(err)
