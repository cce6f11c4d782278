"""A whole session in one command: what it writes, that it goes on, what depends on what, and the processes that share it."""

from __future__ import annotations

import csv
import errno
import html
import json
import os
import pickle
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import asterism
from asterism import AsterismError, formats
from asterism.cli import main
from asterism.cli._process_tasks import _Kept, _not_analysed, _page
from asterism.findings import Severity
from asterism.gait.feet import feet_of
from asterism.recording import Recording
from asterism.session import FileLabeller, FolderSettings, Outcome, in_order, plan_session, spread
from asterism.session.memory import BASE, need_of, that_fit
from asterism.simulation import simulate_walks


@cache
def walk(person: int) -> Recording:
    (recording,) = simulate_walks(1, frames=300, markers="helen-hayes", seed=person)
    return recording


def standing(person: int) -> Recording:
    """A person who stands as in one frame of the walk, and sways."""
    sway = np.random.default_rng(person).normal(0.0, 0.0005, (40, 15, 3))
    return replace(walk(person), positions=walk(person).positions[40] + sway, events=())


def anonymous(recording: Recording) -> Recording:
    return replace(recording, labels=tuple(f"*{m + 1}" for m in range(len(recording.labels))))


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two persons, each with a standing trial and a walk, without names."""
    folder = tmp_path_factory.mktemp("session") / "people"
    for person in (1, 2):
        (folder / f"p{person}").mkdir(parents=True)
        asterism.write(folder / f"p{person}" / "static.c3d", anonymous(standing(person)))
        asterism.write(folder / f"p{person}" / "walk.c3d", anonymous(walk(person)))
    return folder


def run(*words: str | Path) -> int:
    return main(["process", *map(str, words)])


def times(folder: Path) -> dict[str, int]:
    """When each result was written; the pages and tables of all are written with each run."""
    below = ("labelled", "gait", "reports")
    return {path.relative_to(folder).as_posix(): path.stat().st_mtime_ns for one in below for path in (folder / one).rglob("*.*")}


@pytest.fixture(scope="module")
def done(session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("done") / "out"
    assert run(session, "-o", out, "--markers", "helen-hayes", "--json", out.parent / "all.json") in (0, 1)
    return out


def test_a_session_is_labelled_analysed_and_reported(done: Path) -> None:
    with (done / "session.csv").open(newline="") as file:
        rows = {Path(row["file"]).relative_to(Path(row["file"]).parents[1]).as_posix(): row for row in csv.DictReader(file)}
    assert sorted(rows) == ["p1/static.c3d", "p1/walk.c3d", "p2/static.c3d", "p2/walk.c3d"]
    assert {(row["kind"], row["person"]) for row in rows.values()} == {(k, p) for k in ("standing", "walk") for p in ("p1", "p2")}
    for person in (1, 2):
        row = rows[f"p{person}/walk.c3d"]
        assert float(row["labelled"]) > 0.99 and int(row["cycles"]) >= 2 and 50 < float(row["cadence"]) < 200
        labelled = asterism.read(done / "labelled" / f"p{person}" / "walk.c3d")
        np.testing.assert_allclose(labelled.select(walk(person).labels).positions, walk(person).positions, atol=1e-6)
        outputs = asterism.read(done / "gait" / f"p{person}" / "walk.c3d")
        assert len(outputs) == len(walk(person))
        assert f"p{person}" in (done / row["report"]).read_text(encoding="utf-8")
        assert row["report"] in (done / "index.html").read_text(encoding="utf-8")
    with (done / "parameters.csv").open(newline="") as file:
        assert len({row["file"] for row in csv.DictReader(file)}) == 2
    told = json.loads((done.parent / "all.json").read_text())
    assert len(told["files"]) == 4 and told["failed"] == []


def test_a_second_run_does_nothing_and_says_the_same(session: Path, done: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before, first = times(done), json.loads((done.parent / "all.json").read_text())
    assert len(before) > 8
    run(session, "-o", done, "--markers", "helen-hayes", "--json", "-")
    again = json.loads(capsys.readouterr().out)
    assert times(done) == before
    assert again["findings"] == first["findings"]
    shown = ("file", "person", "kind", "labelled", "use", "look_at", "cycles", "cadence", "speed", "report")
    assert [[row.get(name) for name in shown] for row in again["files"]] == [[row.get(name) for name in shown] for row in first["files"]]


def test_what_was_corrected_stays_and_only_its_person_is_made_anew(session: Path, tmp_path: Path, done: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(done, out)
    target = out / "labelled" / "p1" / "walk.c3d"
    corrected = asterism.read(target).frames(slice(0, 250))
    asterism.write(target, corrected)
    before, content = times(out), target.read_bytes()
    run(session, "-o", out, "--markers", "helen-hayes")
    changed = {name for name, when in times(out).items() if when != before[name]}
    assert target.read_bytes() == content
    assert changed and all("p1" in name for name in changed), changed
    # other options would label it anew: what a person has made is not replaced
    assert run(session, "-o", out, "--markers", "helen-hayes", "--vertical", "z") == 1
    assert target.read_bytes() == content


def test_two_processes_give_the_same_bytes(session: Path, done: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(session, "-o", out, "--markers", "helen-hayes", "--workers", "2")
    for folder in ("labelled", "gait"):
        one, other = ({path.relative_to(at): path.read_bytes() for path in (at / folder).rglob("*.c3d")} for at in (done, out))
        assert len(one) >= 2 and one == other


def test_a_dry_run_says_what_would_be_done(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(session, "-o", tmp_path / "out", "--dry-run", "--json", "-") == 0
    persons = json.loads(capsys.readouterr().out)["persons"]
    assert [(one["person"], len(one["recordings"]), Path(one["static"]).name) for one in persons] == [
        ("p1", 2, "static.c3d"),
        ("p2", 2, "static.c3d"),
    ]
    assert not (tmp_path / "out").exists()


def test_a_file_that_fails_costs_itself(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "people").mkdir()
    (tmp_path / "people" / "broken.c3d").write_bytes(b"\x02\x50" + bytes(600))
    asterism.write(tmp_path / "people" / "walk.c3d", anonymous(walk(1)).frames(slice(0, 60)))
    assert run(tmp_path / "people", "-o", tmp_path / "out", "--markers", "helen-hayes") == 1
    out, err = capsys.readouterr()
    assert "broken.c3d" in err and "walk.c3d" in out
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    (why,) = {line.rpartition("broken.c3d")[2] for line in err.splitlines() if "broken.c3d" in line and "2 files" not in line}
    assert "1 could not be processed" in page and why and why in html.unescape(page), why
    assert (tmp_path / "out" / "labelled" / "walk.c3d").exists()


def test_two_runs_do_not_write_to_one_folder(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fcntl = pytest.importorskip("fcntl")
    with (tmp_path / "asterism-process.lock").open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert run(session, "-o", tmp_path) == 2
    assert "another run" in capsys.readouterr().err


def test_settings_of_a_folder_hold_below_it(tmp_path: Path) -> None:
    inner = tmp_path / "people" / "ann"
    inner.mkdir(parents=True)
    (tmp_path / "people" / "session.toml").write_text(
        'markers = "cmu"\nleave_out = ["wand*"]\nperson = "x"\n[measures]\nBodyMass = 50\nlkneewidth = 90'
    )
    (inner / "session.toml").write_text('markers = "helen-hayes"\n[measures]\nLKneeWidth = 102.5\n')
    files = [(inner / name, Path("ann") / name) for name in ("wand 1.c3d", "walk.c3d")]
    (person,) = plan_session(files, [tmp_path / "people"])
    assert [trial.path.name for trial in person.trials] == ["walk.c3d"]
    assert person.name == "ann", "what a folder calls its person is not what those below it are called"
    assert person.settings.markers == "helen-hayes"
    assert person.settings.measures == {"BodyMass": 50.0, "LKneeWidth": 102.5}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('marker = "cmu"', "did you mean markers"),
        ("markers = 3", "markers must be a text"),
        ('[measures]\nBodyMass = "fifty"', "measures must be a table of numbers"),
        ('model = "none.model"', "does not exist"),
        ("[", "no TOML"),
        ('markers = "none"', "session.toml: marker set 'none' is neither shipped"),
        ('static = ""', "session.toml: static is empty"),
        ('static = "."', "which is a folder"),
        ("[measures]\nLKneeWidth = 102\nLkneewidth = 104", "given twice"),
    ],
)
def test_settings_that_cannot_be_used_are_told(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "session.toml").write_text(text)
    with pytest.raises(AsterismError, match=said):
        plan_session([(tmp_path / "walk.c3d", Path("walk.c3d"))], [tmp_path])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('vertical = "up"', "'up' is not an axis"),
        ('vertical = "1,2"', "three finite numbers"),
        ('fill = "much"', "give none, auto"),
        ("[measures]\nLKneeWidht = 102", "no measure of a person"),
        ("[measures]\nLKneeWidth = 10", "from 20 to 250"),
        ("[measures]\nLKneeWidth = nan", "no name and number"),
        ('leave_out = ["*"]', "leaves out all of its recordings"),
    ],
)
def test_a_setting_that_an_option_could_not_have_ends_the_run_before_it_begins(
    text: str, said: str, session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    people = tmp_path / "people"
    shutil.copytree(session / "p1", people / "ann")
    (people / "ann" / "session.toml").write_text(text)
    # the nearest file is not the one to blame
    (people / "ann" / "later").mkdir()
    shutil.copy(session / "p1" / "walk.c3d", people / "ann" / "later")
    (people / "ann" / "later" / "session.toml").write_text('known_labels = "keep"')
    assert run(people, "-o", tmp_path / "out") == 2
    told = capsys.readouterr().err
    assert said in told and str(people / "ann") in told and "later" not in told
    assert not (tmp_path / "out").exists()


def test_a_folder_whose_recordings_are_all_left_out_is_told(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(session, tmp_path / "people")
    (tmp_path / "people" / "p1" / "session.toml").write_text('leave_out = ["*"]')
    assert run(tmp_path / "people", "-o", tmp_path / "out", "--dry-run") == 0
    assert "p1: leave_out in session.toml leaves out all" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("places", "said"),
    [
        (("a/b/walk.c3d", "a-b/walk.c3d"), "the person a/b and the person a-b"),
        (("ann/walk.c3d", "ann/Walk.c3d"), "would both become walk.c3d"),
    ],
)
def test_what_would_replace_the_results_of_another_ends_the_run(
    places: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for place in places:
        (tmp_path / "people" / place).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "people" / place).touch()
    assert run(tmp_path / "people", "-o", tmp_path / "out", "--dry-run") == 2
    assert said in capsys.readouterr().err


def test_results_that_lie_in_the_session_are_no_persons(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(session, tmp_path / "people")
    results = tmp_path / "people" / "results"
    shutil.copytree(session, results / "labelled")
    (results / "asterism-process.lock").touch()
    assert run(tmp_path / "people", "-o", tmp_path / "out", "--dry-run", "--json", "-") == 0
    told = capsys.readouterr()
    assert [person["person"] for person in json.loads(told.out)["persons"]] == ["p1", "p2"]
    assert f"{results} holds results of asterism process and is left out" in told.err
    # results beside the session, in the folder above it, say nothing of it
    (tmp_path / "asterism-process.lock").touch()
    assert run(tmp_path / "people", "-o", tmp_path, "--dry-run") == 0
    assert run(results, "-o", tmp_path / "out", "--dry-run") == 2


def test_a_result_that_could_not_be_written_is_tried_again(
    session: Path, done: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    shutil.copytree(done, out)
    target, what = out / "gait" / "p1" / "walk.c3d", (session, "-o", out, "--markers", "helen-hayes")
    target.unlink()
    # nothing can be written under this name, as on a disk that is full
    target.mkdir()
    shutil.rmtree(out / "records" / "gait")
    assert run(*what) == 1
    told = capsys.readouterr().err
    assert f"{target} cannot be written" in told and "session-no-gait" not in told
    target.rmdir()
    run(*what)
    assert "cannot be written" not in capsys.readouterr().err
    assert target.is_file()


def test_what_shows_no_gait_is_told_from_what_could_not_be_analysed() -> None:
    """Nothing need be done where nobody walks; a missing measure is to be mended, and not called so."""
    [walk] = simulate_walks(1, frames=30, markers="helen-hayes", seed=0)
    kept = _Kept()
    for name, lacking in (("reach.c3d", ("HEE", "TOE")), ("lie.c3d", ("ASI", "ACR"))):
        with kept.file(Path(name)):
            columns = [place for place, label in enumerate(walk.labels) if not label.endswith(lacking)]
            labels = tuple(walk.labels[place] for place in columns)
            feet_of(replace(walk, positions=walk.positions[:, columns], labels=labels, source=None, metadata={"file": name}))
    with kept.file(Path("walk.c3d")):
        raise AsterismError("LKneeWidth is 0.1; give it in mm.")
    assert list(kept.problems) == ["walk.c3d"] and "no foot with a marker of heel" in kept.no_gait["reach.c3d"]
    assert "no marker of the pelvis" in kept.no_gait["lie.c3d"]
    quiet = _not_analysed("reach.c3d", kept.no_gait["reach.c3d"], True)
    assert (quiet.code, quiet.severity) == ("session-no-gait", Severity.NOTE) and "heels, toes and the pelvis" in quiet.mend
    told = _not_analysed("walk.c3d", kept.problems["walk.c3d"], False)
    assert (told.code, told.severity) == ("session-not-analysed", Severity.WARNING) and "walks" not in told.mend


def test_the_page_of_a_walk_called_as_its_person_is_another(tmp_path: Path) -> None:
    page = _page(tmp_path, Path("ann.c3d"), tmp_path / "reports" / "Ann.html")
    assert page == tmp_path / "reports" / "ann (walk).html"
    assert _page(tmp_path, Path("walk.c3d"), tmp_path / "reports" / "Ann.html").name == "walk.html"


def test_people_of_one_folder_are_told_by_their_standing_trials() -> None:
    names = ("ann-static", "ann-walk", "bob-static", "bob-walk 1", "bob-walk 2")
    persons = plan_session([(Path("all") / f"{name}.c3d", Path(f"{name}.c3d")) for name in names], [Path("all")])
    assert [(person.name, len(person.trials)) for person in persons] == [("all ann", 2), ("all bob", 3)]
    assert [person.standing for person in persons] == [Path("all/ann-static.c3d"), Path("all/bob-static.c3d")]
    assert persons[0].settings == FolderSettings()


@pytest.fixture
def one_person(session: Path, tmp_path: Path) -> Path:
    """A session of one person, which a test may change."""
    shutil.copytree(session / "p1", tmp_path / "people" / "p1")
    return tmp_path / "people"


@pytest.fixture
def memory() -> Iterator[Any]:
    """A file system in memory, empty."""
    system = pytest.importorskip("fsspec").filesystem("memory")
    system.store.clear()
    yield system
    system.store.clear()


def test_a_session_at_an_address_gives_the_same_at_another(
    one_person: Path, done: Path, memory: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (one_person / "session.toml").write_text('markers = "helen-hayes"')
    shutil.make_archive(str(tmp_path / "all"), "zip", one_person.parent, "people")
    what = (f"zip://people::{tmp_path / 'all.zip'}", "-o", "memory://lab/out")
    assert run(*what, "--json", tmp_path / "all.json") in (0, 1)
    told = capsys.readouterr()
    for place in ("labelled/p1/static.c3d", "labelled/p1/walk.c3d", "gait/p1/walk.c3d"):
        assert memory.cat_file(f"/lab/out/{place}") == (done / place).read_bytes(), place
    content = {path: memory.cat_file(path) for path in memory.find("/lab/out")}
    assert not [path for path in content if path.endswith(".part")]
    # what a person reads names addresses, not temporary files
    named = [told.out, told.err, (tmp_path / "all.json").read_text()]
    named += [data.decode() for path, data in content.items() if path.endswith((".csv", ".html"))]
    assert not any(tempfile.gettempdir() + "/asterism-" in text for text in named)
    assert f"{what[0]}/p1/walk.c3d" in content["/lab/out/session.csv"].decode()
    # again: nothing is made anew; a correction at the address is, with all that depends on it, and stays
    ours = ("labelled", "gait", "reports")
    before = {path: memory.modified(path) for path in content if path.split("/")[3] in ours}
    assert run(*what) in (0, 1)
    assert before == {path: memory.modified(path) for path in before}
    asterism.write(tmp_path / "walk.c3d", asterism.read(done / "labelled" / "p1" / "walk.c3d").frames(slice(0, 250)))
    memory.put_file(str(tmp_path / "walk.c3d"), "/lab/out/labelled/p1/walk.c3d")
    run(*what)
    assert memory.cat_file("/lab/out/labelled/p1/walk.c3d") == (tmp_path / "walk.c3d").read_bytes()
    assert memory.cat_file("/lab/out/gait/p1/walk.c3d") != content["/lab/out/gait/p1/walk.c3d"]


def test_a_run_that_was_killed_between_record_and_output_goes_on(one_person: Path, done: Path, memory: Any, tmp_path: Path) -> None:
    what = (one_person, "-o", "memory://lab/out", "--markers", "helen-hayes")
    assert run(*what) in (0, 1)
    before = memory.cat_file("/lab/out/labelled/p1/walk.c3d")
    asterism.write(one_person / "p1" / "walk.c3d", asterism.read(one_person / "p1" / "walk.c3d").frames(slice(0, 200)))
    run(*what)
    # the record of the second output is there, and the output is still the first one
    memory.pipe_file("/lab/out/labelled/p1/walk.c3d", before)
    run(*what)
    memory.get_file("/lab/out/labelled/p1/walk.c3d", str(tmp_path / "walk.c3d"))
    assert len(asterism.read(tmp_path / "walk.c3d")) == 200


@pytest.mark.parametrize("full", ["labelled", "gait"])
def test_a_full_disk_ends_the_run_which_goes_on_later(
    full: str, one_person: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    what = (one_person, "-o", tmp_path / "out", "--markers", "helen-hayes")
    with monkeypatch.context() as patched:
        replace_ = os.replace

        def no_room(source: Path, target: Path) -> None:
            if full in Path(target).parts and "walk" in str(target):
                raise OSError(errno.ENOSPC, "No space left on device")
            replace_(source, target)

        patched.setattr(os, "replace", no_room)
        assert run(*what) == 1
    said = capsys.readouterr().err
    assert "No space left on device" in said and "run the same command again" in said and "tasks" in said
    assert not (tmp_path / "out" / "index.html").exists() and not list((tmp_path / "out").rglob("*.part"))
    assert run(*what) in (0, 1)
    assert (tmp_path / "out" / full / "p1" / "walk.c3d").is_file()
    assert "No space" not in capsys.readouterr().err


def test_a_recording_that_changes_meanwhile_is_not_labelled(
    one_person: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    label, walked = FileLabeller.label, one_person / "p1" / "walk.c3d"

    def changing(labeller: FileLabeller, path: Path, *more: Any) -> Any:
        found = label(labeller, path, *more)
        if path == walked:
            path.write_bytes(path.read_bytes() + bytes(512))
        return found

    what = (one_person, "-o", tmp_path / "out", "--markers", "helen-hayes")
    with monkeypatch.context() as patched:
        patched.setattr(FileLabeller, "label", changing)
        assert run(*what) == 1
    assert f"{walked} was changed while it was labelled" in capsys.readouterr().err
    assert not (tmp_path / "out" / "labelled" / "p1" / "walk.c3d").exists()
    run(*what)
    assert (tmp_path / "out" / "labelled" / "p1" / "walk.c3d").exists()


def test_results_of_recordings_that_have_gone_are_told_until_they_are_moved(
    one_person: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    what = (one_person, "-o", out, "--markers", "helen-hayes")
    (one_person / "p1" / "walk.c3d").unlink()
    shutil.copy(one_person / "p1" / "static.c3d", one_person / "p1" / "static 2.c3d")
    assert run(*what) == 0
    (one_person / "p1" / "static 2.c3d").rename(one_person / "p1" / "static 3.c3d")
    for _ in range(2):
        capsys.readouterr()
        assert run(*what) == 1
        said = capsys.readouterr().err
        assert "labelled/p1/static 2.c3d" in said and "[session-left-over]" in said and "static 3" not in said
    assert "session-left-over" not in said.replace("[session-left-over]", "") and "static 2.c3d" in (out / "index.html").read_text()
    with (out / "session.csv").open(newline="") as file:
        assert {Path(row["file"]).name for row in csv.DictReader(file)} == {"static.c3d", "static 3.c3d"}
    # the results of another session in the same folder are none that were left over
    shutil.copytree(one_person, tmp_path / "others")
    run(tmp_path / "others" / "p1", "-o", out, "--markers", "helen-hayes")
    assert "session-left-over" not in capsys.readouterr().err
    (out / "labelled" / "p1" / "static 2.c3d").unlink()
    assert run(*what) == 0


def test_what_tasks_are_told_does_not_grow_with_the_folder(session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = list[int]()

    def only_measured(function: Any, tasks: Any, **how: Any) -> Iterator[Any]:
        sizes.append(max(len(pickle.dumps(task)) for task in tasks))
        return iter([(place, Outcome(None, "not done.")) for place in range(len(tasks))])

    monkeypatch.setattr("asterism.session.spread", only_measured)
    for count in (2, 200):
        folder = tmp_path / str(count) / "people"
        folder.mkdir(parents=True)
        for number in range(count):
            (folder / f"walk {number}.c3d").touch()
        assert run(tmp_path / str(count), "-o", tmp_path / f"out {count}") == 2
    assert max(sizes) < 500 and max(sizes) - min(sizes) < 50


def test_a_messy_folder_is_one_person_with_one_standing_trial(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    people = tmp_path / "Gang Labor" / "2026-11-03" / "Müller, Jörg (v1.2)"
    shutil.copytree(session / "p1", people)
    (people / "static.c3d").rename(people / "static 1.c3d")
    shutil.copy(people / "static 1.c3d", people / "Static 2.c3d")
    shutil.copy(session / "p2" / "walk.c3d", people / "Gehen langsam.01.c3d")
    (people / "session.toml").write_text('static = "static 1.c3d"')
    for copy in ("Gehen langsam.01.trc", "gehen langsam.01.csv", "walk.TSV"):
        (people / copy).write_text("exported")
    for hidden in ("._walk.c3d", ".sync.c3d", "Thumbs.db"):
        (people / hidden).write_bytes(b"x")
    (people / "empty.c3d").touch()
    (people / "gone.c3d").symlink_to("nowhere.c3d")
    (people.parent / "loop").symlink_to(tmp_path / "Gang Labor")
    out = tmp_path / "out"
    assert run(tmp_path / "Gang Labor", "-o", out, "--markers", "helen-hayes") == 1
    told = capsys.readouterr().err
    assert "3 files" in told and "walk.TSV" in told and "[session-copies]" in told and "empty.c3d is empty" in told and "gone.c3d" in told
    with (out / "session.csv").open(newline="", encoding="utf-8") as file:
        rows = {Path(row["file"]).name: row for row in csv.DictReader(file)}
    kinds = {name: row["kind"] for name, row in rows.items()}
    assert kinds == {"Gehen langsam.01.c3d": "walk", "walk.c3d": "walk", "static 1.c3d": "standing", "Static 2.c3d": "standing, not used"}
    assert {Path(rows[name]["subject"]).name for name in ("walk.c3d", "Gehen langsam.01.c3d", "Static 2.c3d")} <= {"static 1.c3d", ""}
    assert Path(rows["walk.c3d"]["subject"]).name == "static 1.c3d", "labels and analysis have one standing trial"
    assert [path.name for path in (out / "reports").glob("*.html")] == ["2026-11-03-Müller- Jörg -v1.2-.html"]


def test_a_save_on_the_page_of_review_makes_its_person_anew_and_nobody_else(
    session: Path, done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("websockets", "starlette", "uvicorn"):
        pytest.importorskip(name)
    from correcting import longest, served

    out = tmp_path / "out"
    shutil.copytree(done, out)
    before, content = times(out), (out / "labelled" / "p1" / "walk.c3d").read_bytes()

    def sits(sitting: Any, address: Any, say: Any) -> None:
        with served(sitting) as browser:
            (trial,) = [one for one in browser.get("/api/trials")["trials"] if str(one["path"]).endswith("p1/walk.c3d")]
            at = f"/api/trials/{trial['id']}"
            state = browser.get(f"{at}/state")
            piece = longest(state["pieces"]["id"], state["pieces"]["first"], state["pieces"]["last"])
            event = {"kind": "name", "piece": piece, "marker": "SACR"}
            browser.post(f"{at}/touch", {"revision": state["revision"], "event": event})
            saved = browser.post(f"{at}/save", {})
        assert Path(saved["path"]) == out / "labelled" / "p1" / "walk.c3d"

    monkeypatch.setattr("asterism.web.serve", sits)
    words = ["review", session, "--serve", "-o", out / "labelled", "--overwrite", "--markers", "helen-hayes"]
    words += ["--log-folder", tmp_path]
    assert main([*map(str, words)]) == 0
    corrected = (out / "labelled" / "p1" / "walk.c3d").read_bytes()
    assert corrected != content
    run(session, "-o", out, "--markers", "helen-hayes")
    assert (out / "labelled" / "p1" / "walk.c3d").read_bytes() == corrected
    changed = {name for name, when in times(out).items() if when != before[name]}
    assert {"labelled/p1/walk.c3d", "gait/p1/walk.c3d", "reports/p1.html"} <= changed
    assert all("p1" in name for name in changed), changed


@pytest.mark.parametrize("where", ["labelling", "analysing", "writing"])
def test_ctrl_c_leaves_nothing_half_written_and_the_next_run_goes_on(
    where: str, one_person: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    what = (one_person, "-o", out, "--markers", "helen-hayes")
    place = {
        "labelling": "asterism.session.FileLabeller.label",
        "analysing": "asterism.cli._process_tasks.analysed",
        "writing": "os.replace",
    }[where]

    def interrupted(*given: Any, **_: Any) -> Any:
        if where != "writing" or "walk.c3d" in str(given[-1]):
            raise KeyboardInterrupt
        return os.rename(*given)

    with monkeypatch.context() as patched:
        patched.setattr(place, interrupted)
        assert run(*what) == 130
    assert "interrupted" in capsys.readouterr().err
    assert not list(out.rglob("*.part")) and not (out / "index.html").exists()
    assert run(*what) in (0, 1)
    assert (out / "gait" / "p1" / "walk.c3d").exists() and "another run" not in capsys.readouterr().err


def test_a_person_whose_trials_are_of_another_set_is_told_and_others_go_on(
    one_person: Path, session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a standing trial, and with a wand among the walks."""
    (one_person / "p1" / "static.c3d").unlink()
    wand = replace(walk(1).frames(slice(0, 60)), positions=walk(1).positions[:60, :3] * 0.2, labels=("*1", "*2", "*3"), events=())
    asterism.write(one_person / "p1" / "wand.c3d", wand)
    assert run(one_person, "-o", tmp_path / "out", "--markers", "helen-hayes", "--json", "-") == 1
    told = json.loads(capsys.readouterr().out)
    rows = {Path(row["file"]).name: row for row in told["files"]}
    assert rows["walk.c3d"]["kind"] == "walk" and rows["walk.c3d"]["use"] == "ready"
    assert rows["wand.c3d"]["use"] != "ready" and rows["wand.c3d"]["cycles"] == 0


def test_a_folder_without_rights_costs_itself(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = os.scandir

    def denied(folder: Any) -> Any:
        if Path(folder).name == "p2":
            raise PermissionError(errno.EACCES, "Permission denied", str(folder))
        return scan(folder)

    monkeypatch.setattr(os, "scandir", denied)
    assert run(session, "-o", tmp_path / "out", "--dry-run", "--json", "-") == 1
    told = capsys.readouterr()
    assert [person["person"] for person in json.loads(told.out)["persons"]] == ["p1"]
    assert f"{session / 'p2'}: permission denied" in told.err


def test_each_walk_has_its_skeleton_where_it_is_asked_for(one_person: Path, done: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(done, out)
    for _ in range(2):
        assert run(one_person, "-o", out, "--markers", "helen-hayes", "--skeleton") in (0, 1)
        bones = formats.read_skeleton(out / "skeleton" / "p1" / "walk.bvh").motion
        assert len(bones) == len(walk(1)) and any("thigh" in name for name in bones.names)
        with (out / "skeleton" / "p1.csv").open(newline="", encoding="utf-8") as file:
            assert len(list(csv.DictReader(file))) > len(walk(1))
        # a result that was deleted is made again
        (out / "skeleton" / "p1" / "walk.bvh").unlink()
    assert not (out / "skeleton" / "p2.csv").exists()


def test_a_recording_whose_disk_stalls_costs_itself(
    one_person: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As in a folder of a network whose server has gone: opening a file never returns."""
    (one_person / "p1" / "walk.c3d").rename(one_person / "p1" / "dead.c3d")
    released, opens = threading.Event(), Path.open

    def stalled(path: Path, *more: Any, **other: Any) -> Any:
        if path.name == "dead.c3d" and "people" in path.parts:
            released.wait(60.0)
        return opens(path, *more, **other)

    monkeypatch.setattr("asterism.files.stalls.STALLED", 0.2)
    monkeypatch.setattr(Path, "open", stalled)
    assert run(one_person, "-o", tmp_path / "out", "--markers", "helen-hayes") == 1
    released.set()
    assert f"{one_person / 'p1' / 'dead.c3d'}: its disk has not answered" in capsys.readouterr().err
    assert (tmp_path / "out" / "labelled" / "p1" / "static.c3d").exists()


def test_as_many_processes_work_as_the_memory_holds(
    one_person: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert [that_fit(4, BASE, free) for free in (None, 0.0, BASE / 0.79, 2.1 * BASE / 0.8, 1e12)] == [4, 1, 1, 2, 4]
    assert need_of([]) == BASE and need_of([10**9]) > 20e9, "a long recording needs more"
    assert need_of([10**9] * 2) < 2 * need_of([10**9]), "one is worked on at a time"
    used = list[int]()

    def none_done(function: Any, tasks: Any, *, workers: int, dask: str | None) -> Iterator[Any]:
        used.append(workers)
        return iter([(place, Outcome(None, "not done.")) for place in range(len(tasks))])

    monkeypatch.setattr("asterism.session.spread", none_done)
    monkeypatch.setattr("asterism.session.memory.free_memory", lambda: 2.4 * BASE)
    run(one_person, "-o", tmp_path / "out", "--workers", "3")
    assert used[0] == 1
    assert "1 of 3 processes: one may need 0.4 GB, for p1, and 1.0 GB of memory are free" in capsys.readouterr().err


def square(task: tuple[int, Path]) -> int:
    """A task; 3 fails, 5 kills its process once, 7 each time."""
    number, folder = task
    if number == 3:
        raise AsterismError("three is none.")
    if number == 7 or (number == 5 and not (folder / "five").exists()):
        (folder / "five").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number**2


@pytest.mark.skipif(os.name != "posix", reason="processes are killed by a signal")
@pytest.mark.parametrize("how", ["workers", pytest.param("dask", marks=pytest.mark.slow)])
def test_a_task_that_kills_its_process_costs_itself(how: str, tmp_path: Path) -> None:
    pytest.importorskip("distributed") if how == "dask" else None
    tasks = [(number, tmp_path) for number in (2, 3, 5, 7, 8)]
    shared = {"workers": 2} if how == "workers" else {"dask": "local:2"}
    found = list(in_order(spread(square, tasks, **shared)))  # type: ignore[arg-type]
    assert [outcome.value for outcome in found] == [4, None, 25, None, 64]
    assert found[1].problem == "three is none."
    assert "SIGKILL" in found[3].problem


class EndsItsProcess:
    """A function that ends a process as soon as that learns of it."""

    def __call__(self, task: int) -> int:
        return task

    def __reduce__(self) -> Any:
        return os._exit, (3,)


def test_a_process_that_ends_before_its_first_task_is_told() -> None:
    found = list(in_order(spread(EndsItsProcess(), [1, 2], workers=2)))
    assert [outcome.value for outcome in found] == [None, None]
    assert all("ended twice, with status 3" in outcome.problem for outcome in found)


def slowly(task: tuple[int, Path]) -> int:
    """A task of a tenth of a second that says that it was begun."""
    time.sleep(0.1)
    (task[1] / f"{task[0]} {os.getpid()}").touch()
    return task[0]


@pytest.mark.slow
def test_a_scheduler_that_starts_anew_is_asked_again(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}

    def start(kind: str, *words: str) -> subprocess.Popen[bytes]:
        given = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *words, "--no-dashboard"]
        return subprocess.Popen(given, cwd=tmp_path, env=environment, stderr=subprocess.DEVNULL)

    def anew() -> list[subprocess.Popen[bytes]]:
        scheduler = start("scheduler", "--host", "127.0.0.1", "--port", address.rpartition(":")[2])
        return [scheduler, start("worker", address, "--nthreads", "1", "--no-nanny")]

    running, found = anew(), list[int]()
    try:
        for place, outcome in spread(slowly, [(number, tmp_path) for number in range(40)], dask=address):
            assert outcome.value == place
            found.append(place)
            if len(found) == 10:
                for process in running:
                    process.kill()
                    process.wait()
                running = anew()
    finally:
        for process in running:
            process.kill()
            process.wait()
    assert sorted(found) == list(range(40))
    begun = [path.name.split()[0] for path in tmp_path.glob("* *")]
    assert len(begun) - len(set(begun)) <= 2, "only what was not answered is begun again"


def test_one_process_gives_what_each_task_gives(tmp_path: Path) -> None:
    found = list(spread(square, [(number, tmp_path) for number in range(4)]))
    assert [(place, outcome.value) for place, outcome in found] == [(0, 0), (1, 1), (2, 4), (3, None)]


@pytest.mark.parametrize("address", ["local:", "local:0", "local:two"])
def test_a_cluster_that_is_none_is_told(address: str) -> None:
    with pytest.raises(AsterismError, match="local:2"):
        list(spread(abs, [1, 2], dask=address))
