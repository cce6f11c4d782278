"""One file, one answer: exit status, findings, counts and verdict by every command, again, as JSON, in Python and on the page."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from characters import character
from models import trained

from asterism import formats, labelling
from asterism.cli import _EXAMPLES, main
from asterism.cli._labelling import labelled_row
from asterism.files.plain import as_json
from asterism.findings import exit_status
from asterism.labelling import MarkerModel
from asterism.labelling.audit.names import NamesAsked
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.recording import LABEL_STATES, Recording
from asterism.session import label_file
from asterism.simulation import simulate_walks
from asterism.web.plain import plain_trials
from asterism.web.session import CorrectionSession, SessionOptions

FILES = ("raw", "stranger", "two", "turned", "tenfold", "nothing", "named", "sides", "few", "cut", "torn")
"""What laboratories bring: points without names, of a known and of another body, of two, with another axis up, in another unit, of no body;
a labelled file, one whose names of left and right are exchanged, and one of five frames; and one of either kind that breaks off."""
COUNTED = ("frames", *LABEL_STATES, "readiness", "use", "look_at", "verdict", "known_labels", "subject")
RECORD = "asterism-label.jsonl"


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model, and the files in a folder."""
    place = tmp_path_factory.mktemp("doors")
    (place / "lab").mkdir()
    walks = simulate_walks(5, 60, 50.0, markers="helen-hayes", seed=3)
    trained(walks[:3], miner=None).save(place / "walks.model")
    known, other, rng = walks[3], walks[4], np.random.default_rng(0)
    nameless = Recording.from_clouds(known.clouds())
    beside = np.concatenate([known.positions, other.positions + np.array([0.0, 1.5, 0.0])], axis=1)
    moved = replace(other, positions=other.positions + rng.normal(0.0, 0.03, (1, len(other.labels), 3)))
    files = {
        "raw": Recording.from_clouds(simulate_gaps_and_ghosts(known, 2, 1, seed=1)[0]),
        "stranger": Recording.from_clouds(moved.clouds()),
        "two": Recording(beside, tuple(f"*{i + 1}" for i in range(beside.shape[1])), known.rate),
        "turned": replace(nameless, positions=nameless.positions[:, :, [1, 2, 0]]),
        "tenfold": replace(nameless, positions=10.0 * nameless.positions),
        "nothing": Recording(rng.uniform(-1.0, 1.0, (60, 30, 3)), tuple(f"*{i + 1}" for i in range(30)), 50.0),
        "named": known,
        "sides": replace(
            known, labels=tuple({"L": "R", "R": "L"}[label[0]] + label[1:] if label != "SACR" else label for label in known.labels)
        ),
        "few": nameless.frames(slice(0, 5)),
    }
    formats.write_skeleton(place / "character.bvh", character())
    for name, recording in files.items():
        formats.write(place / "lab" / f"{name}.c3d", recording)
    for name, whole in (("cut", "raw"), ("torn", "named")):
        data = (place / "lab" / f"{whole}.c3d").read_bytes()
        (place / "lab" / f"{name}.c3d").write_bytes(data[: int(0.7 * len(data))])
    return place


@dataclass(frozen=True)
class Answer:
    """What is said of a file: the exit status, the codes of what was found, the counts and the verdict."""

    status: int
    codes: list[str]
    row: dict[str, Any]

    @classmethod
    def of(cls, status: int, codes: Sequence[str], row: dict[str, Any]) -> Answer:
        # what a format cannot carry is said of the output, which not every door has
        known = {key: as_json(row[key]) for key in COUNTED}
        return cls(status, sorted(code for code in codes if code != "format-not-carried"), known)

    @classmethod
    def of_json(cls, status: int, content: dict[str, Any]) -> Answer:
        [row] = content["files"]
        return cls.of(status, [finding["code"] for finding in content["findings"]], row)


@dataclass(frozen=True)
class Shown:
    """What a command printed."""

    status: int
    out: str
    codes: list[str]


class Doors:
    """The commands, as somebody calls them."""

    def __init__(self, place: Path, out: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.model, self.out, self.capsys = place / "walks.model", out, capsys

    def run(self, *words: object) -> Shown:
        self.capsys.readouterr()
        status = main([str(word) for word in words])
        shown = self.capsys.readouterr()
        return Shown(status, shown.out, sorted(re.findall(r"\[([a-z0-9-]+)\]$", shown.err, re.MULTILINE)))


@pytest.fixture
def doors(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Doors:
    return Doors(place, tmp_path, capsys)


@pytest.mark.parametrize("name", FILES)
def test_every_door_says_the_same_of_a_file(name: str, place: Path, tmp_path: Path, doors: Doors) -> None:
    file, told = place / "lab" / f"{name}.c3d", tmp_path / "told.json"
    words = ("label", file, "-m", doors.model, "-o", tmp_path / "out")
    first = doors.run(*words)
    line = first.out.strip()
    record = (tmp_path / "out" / RECORD).read_text(encoding="utf-8").splitlines()
    again = doors.run(*words)
    assert (again.status, again.codes) == (first.status, first.codes) and again.out.startswith(f"{line}; labelled by an earlier run, ")
    # a run that was killed between the output and the note that it is complete
    (tmp_path / "out" / RECORD).write_text(record[0] + "\n", encoding="utf-8")
    answers = {}
    for door, path in (("killed, and gone on with", file), ("again, by another path", file.parent / ".." / "lab" / file.name)):
        shown = doors.run("label", path, *words[2:], "--json", "-")
        content = json.loads(shown.out)
        answers[door] = Answer.of_json(shown.status, content)
        assert shown.codes == first.codes or "format-not-carried" in first.codes
        assert content["files"][0]["finished_before"] and all(found["where"].startswith(str(path)) for found in content["findings"])
    new = doors.run(*words[:4], "-o", tmp_path / "new", "--json", told)
    answers["label"] = Answer.of_json(new.status, json.loads(told.read_text(encoding="utf-8")))
    # a file is as fast as the computer is free
    assert re.sub(r"[\d,]+ frames/s", "", new.out.strip()) == re.sub(r"[\d,]+ frames/s", "", line)
    assert new.codes == first.codes and first.status == new.status

    shown = doors.run("review", file, "-m", doors.model, "--json", told, "--overwrite")
    content = json.loads(told.read_text(encoding="utf-8"))
    answers["review"] = Answer.of_json(shown.status, content)
    assert shown.out.splitlines()[0] == re.sub(r" [\d,]+ frames/s,?", "", line).replace("hidden,;", "hidden;"), "one line of a file"
    assert content["pieces"] == content["files"][0]["look_at"] >= len(content["items"])

    model = MarkerModel.load(doors.model)
    labelled = label_file(file, model)
    codes = [finding.code for finding in labelled.findings]
    answers["Python"] = Answer.of(exit_status(labelled.findings), codes, labelled_row(labelled))
    assert len(labelled.to_look_at) == labelled.readiness.look_at

    session = CorrectionSession([file], model, SessionOptions((doors.model,), log_folder=tmp_path / "logs"))
    session.start().join()
    [trial] = plain_trials(session)["trials"]
    session.close()
    expected = answers["label"]
    assert sorted(found["code"] for found in trial["findings"]) == expected.codes
    assert (trial["verdict"]["kind"], trial["verdict"]["look_at"]) == (expected.row["readiness"], expected.row["look_at"])
    assert [trial[state] for state in LABEL_STATES] == pytest.approx([expected.row[state] for state in LABEL_STATES], abs=1e-6)
    assert answers == dict.fromkeys(answers, expected)


def test_a_folder_and_its_files_in_any_order_are_the_same(place: Path, tmp_path: Path, doors: Doors) -> None:
    files = sorted((place / "lab").glob("*.c3d"))
    how, contents = ("-m", doors.model, "--no-static"), list[dict[str, Any]]()
    for given, out in (([place / "lab"], "a"), (files, "a"), (files[::-1], "b"), ([place / "lab"], "b")):
        shown = doors.run("label", *given, *how, "-o", tmp_path / out, "--json", "-")
        assert shown.status == 1
        contents.append(json.loads(shown.out))

    def plain(content: dict[str, Any]) -> Any:
        rows = {Path(row["file"]).name: {key: row[key] for key in COUNTED} for row in content["files"]}
        return rows, sorted(json.dumps(found).replace(str(tmp_path / "b"), str(tmp_path / "a")) for found in content["findings"])

    assert plain(contents[0]) == plain(contents[1]) == plain(contents[2]) == plain(contents[3])
    assert len(contents[0]["files"]) == len(files) and not any(
        "finished_before" in row for row in contents[0]["files"] + contents[2]["files"]
    )
    assert all(row["finished_before"] for row in contents[1]["files"] + contents[3]["files"])


READERS = {
    "info": (),
    "audit": ("--markers", "helen-hayes"),
    "mend": ("--markers", "helen-hayes", "-o", "OUT"),
    "name": (),
    "motion": (),
    "segment": (),
    "convert": ("OUT.trc",),
    "evaluate": ("-m", "MODEL", "--occlusions", "0"),
    "gait": (),
    "skeleton": ("--model", "gait15"),
    "opensim": ("-o", "OUT"),
    "retarget": ("-c", "CHARACTER", "-o", "OUT.bvh"),
    "events": ("--rules", "squat"),
    "train": ("-o", "OUT.model", "--markers", "helen-hayes", "--no-audit"),
    "learn": ("-o", "OUT.model"),
    "review": ("-m", "MODEL"),
    "label": ("-m", "MODEL", "-o", "OUT"),
}
"""Commands that read recordings, and what they need beside one."""
OTHERS = {"demo", "warm-up", "detect", "reconstruct", "label-views", "capturability", "process", "live"}
"""Commands that read none, or bones; one that takes minutes and reads as `evaluate` does; one that takes folders, and labels as `label`
does; and one that plays recordings."""


def test_every_command_that_reads_recordings_is_asked() -> None:
    assert set(_EXAMPLES) == READERS.keys() | OTHERS


@pytest.mark.parametrize("verb", READERS)
def test_what_the_reader_found_is_said_by_every_command(
    verb: str, place: Path, tmp_path: Path, doors: Doors, monkeypatch: pytest.MonkeyPatch
) -> None:
    # what is learned, and whether names are exchanged, is not asked here
    monkeypatch.setattr(MarkerModel, "learn", lambda model, recordings, **given: model)
    monkeypatch.setattr(MarkerModel, "fit", lambda recordings, **given: MarkerModel.load(doors.model))
    monkeypatch.setattr(labelling, "check_names", lambda *given, **more: NamesAsked((), None, "not asked"))
    told, shown = tmp_path / "told.json", dict[tuple[str, str], Shown]()
    for name, way in (("named", "text"), ("torn", "text"), ("torn", "json")):
        # another output each time, so that nothing stands in the way
        words = list(READERS[verb])
        for key, path in (("MODEL", doors.model), ("OUT", tmp_path / f"{name}-{way}"), ("CHARACTER", place / "character.bvh")):
            words = [word.replace(key, str(path)) for word in words]
        words += ["--json", str(told)] if way == "json" else []
        file = place / "lab" / f"{name}.c3d"
        shown[name, way] = doors.run(verb, *([doors.model] if verb == "learn" else []), file, *words)
    whole, torn, as_values = shown.values()
    # a second of walking holds no squat, which is a warning
    assert "format-cut-off" not in whole.codes and whole.status == (verb == "events")
    assert torn.codes.count("format-cut-off") == 1 and torn.status == 1
    content = json.loads(told.read_text(encoding="utf-8"))
    assert sorted(found["code"] for found in content["findings"]) == as_values.codes == torn.codes
    assert as_values.status == torn.status
