"""Folders of recordings: what is found in them, where the outputs go, which standing trial is used, and a run that goes on."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from models import trained

from asterism import formats
from asterism.cli import _console, main
from asterism.cli._folders import trials
from asterism.errors import AsterismError
from asterism.recording import MarkerSet, Recording
from asterism.session.standing import StandingTrials, is_standing_name, stands
from asterism.simulation import simulate_standing, simulate_walks

MARKERS = "helen-hayes"


def run(*args: object) -> int:
    return main([str(arg) for arg in args])


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")


def found(*given: Path, without: Path | None = None) -> list[str]:
    return [trial.place.as_posix() for trial in trials(given, _console.Batch("read"), without=without)]


# What is found, and where it goes


def test_a_folder_is_walked_and_keeps_its_places(tmp_path: Path) -> None:
    touch(tmp_path, "b/walk.c3d", "a/day 1/walk.trc", "a/static.c3d", "a/notes.txt", "a/.walk.c3d.77.part", ".trash/old.c3d", "top.npz")
    assert found(tmp_path) == ["top.npz", "a/static.c3d", "a/day 1/walk.trc", "b/walk.c3d"]
    assert found(tmp_path / "a") == ["static.c3d", "day 1/walk.trc"]
    assert found(tmp_path / "a", tmp_path / "b") == ["a/static.c3d", "a/day 1/walk.trc", "b/walk.c3d"]
    assert found(tmp_path / "a", tmp_path / "top.npz") == ["a/static.c3d", "a/day 1/walk.trc", "top.npz"]


def test_files_go_to_the_top_unless_two_have_one_name(tmp_path: Path) -> None:
    touch(tmp_path, "a/walk.c3d", "b/walk.c3d", "b/turn.c3d")
    assert found(tmp_path / "a/walk.c3d", tmp_path / "b/turn.c3d") == ["walk.c3d", "turn.c3d"]
    assert found(tmp_path / "a/walk.c3d", tmp_path / "b/walk.c3d") == ["a/walk.c3d", "b/walk.c3d"]
    assert found(tmp_path / "a/walk.c3d", tmp_path / "a/walk.c3d") == ["walk.c3d"], "named twice is meant once"


def test_names_that_differ_in_capital_letters_are_refused(tmp_path: Path) -> None:
    touch(tmp_path, "walk.c3d", "Walk.c3d")
    if len(list(tmp_path.iterdir())) < 2:
        pytest.skip("this file system does not distinguish capital letters")
    with pytest.raises(AsterismError, match="would both become"):
        found(tmp_path)


def test_outputs_inside_the_folder_are_no_inputs(tmp_path: Path) -> None:
    touch(tmp_path, "walk.c3d", "labelled/walk.c3d")
    assert found(tmp_path, without=tmp_path / "labelled") == ["walk.c3d"]
    with pytest.raises(AsterismError, match="holds no recording"):
        found(tmp_path / "labelled", without=tmp_path / "labelled")


@pytest.mark.skipif(os.name == "nt", reason="links need rights on Windows")
@pytest.mark.parametrize("verb", ["info", "motion", "segment"])
def test_a_link_to_itself_is_named_and_the_others_are_done(tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: str) -> None:
    link, walk = tmp_path / "loop.npz", tmp_path / "walk.npz"
    try:
        link.symlink_to(link.name)
    except OSError:
        pytest.skip("this file system has no links")
    formats.write(walk, simulate_walks(1, 20, 50.0, markers=MARKERS)[0])
    assert found(link, walk) == ["loop.npz", "walk.npz"]
    assert run(verb, link, walk, "--json", tmp_path / "told.json") == 1
    shown = capsys.readouterr().err
    assert "loop.npz cannot be read" in shown and "fault" not in shown and "Traceback" not in shown


def test_a_link_to_a_folder_above_ends(tmp_path: Path) -> None:
    touch(tmp_path, "a/walk.c3d", "elsewhere/turn.c3d")
    (tmp_path / "a" / "back").symlink_to(tmp_path / "a")
    (tmp_path / "a" / "more").symlink_to(tmp_path / "elsewhere")
    assert found(tmp_path / "a") == ["walk.c3d", "more/turn.c3d"]


# Standing trials


@pytest.mark.parametrize(
    "name",
    ["static", "Static 1", "ann-static", "auc_static", "cal01", "Cal", "S1_standing_2", "ech_anat_pose", "T-pose", "n_pose", "StaticCal"],
)
def test_names_of_standing_trials(name: str) -> None:
    assert is_standing_name(Path(f"{name}.c3d")) or name == "StaticCal"


@pytest.mark.parametrize("name", ["walk", "scale", "instance", "wand cal", "knee_cal", "functional_cal", "turn", "upstanding", "escalator"])
def test_names_of_other_trials(name: str) -> None:
    assert not is_standing_name(Path(f"{name}.c3d"))


def test_a_standing_person_stands_and_a_walking_one_does_not() -> None:
    [standing], [walk] = simulate_standing(1, 60, 50.0, seed=1), simulate_walks(1, 60, 50.0, seed=1)
    assert stands(standing) and not stands(walk)
    pointer = np.concatenate([standing.positions, walk.positions[:, :1]], axis=1)
    assert stands(Recording(pointer, (*standing.labels, "pointer"), 50.0)), "one marker that moves is not the person"
    assert not stands(standing.frames(slice(0, 3))), "three frames show no posture"
    assert not stands(replace(standing, positions=np.full_like(standing.positions, np.nan)))


def _chosen(files: list[str], of: str, **options: object) -> str | None:
    standing = StandingTrials([Path(name) for name in files], **options)  # type: ignore[arg-type]
    trial = standing.of(Path(of))
    return None if trial is None else trial.as_posix()


LAB = [
    "/lab/s1/static.c3d",
    "/lab/s1/walk.c3d",
    "/lab/s1/day2/Static.c3d",
    "/lab/s1/day2/walk.c3d",
    "/lab/s2/cal/cal1.c3d",
    "/lab/s2/gait/walk.c3d",
]


def test_the_nearest_standing_trial_counts() -> None:
    assert _chosen(LAB, "/lab/s1/walk.c3d") == "/lab/s1/static.c3d"
    assert _chosen(LAB, "/lab/s1/day2/walk.c3d") == "/lab/s1/day2/Static.c3d"
    assert _chosen(LAB, "/lab/s2/gait/walk.c3d") == "/lab/s2/cal/cal1.c3d"
    assert _chosen(LAB, "/lab/s1/static.c3d") is None, "a standing trial is not narrowed by itself"
    assert _chosen(LAB, "/lab/s1/walk.c3d", automatic=False) is None


def test_people_in_one_folder_are_told_by_the_start_of_the_name() -> None:
    files = ["/lab/ann-static.c3d", "/lab/ann-walk.c3d", "/lab/ben_static2.c3d", "/lab/ben_walk.c3d", "/lab/cem-walk.c3d"]
    assert _chosen(files, "/lab/ann-walk.c3d") == "/lab/ann-static.c3d"
    assert _chosen(files, "/lab/ben_walk.c3d") == "/lab/ben_static2.c3d"
    assert _chosen(files, "/lab/cem-walk.c3d") is None


def test_another_persons_folder_gives_no_standing_trial() -> None:
    files = ["/lab/s1/static.c3d", "/lab/s1/walk.c3d", "/lab/s2/walk.c3d"]
    assert _chosen(files, "/lab/s2/walk.c3d") is None


def test_a_named_subject_counts_for_all_and_several_by_folder() -> None:
    assert _chosen(LAB, "/lab/s2/gait/walk.c3d", given=[Path("/x/ann.c3d")]) == "/x/ann.c3d"
    both = [Path("/lab/s1/static.c3d"), Path("/lab/s2/cal/cal1.c3d")]
    assert _chosen(LAB, "/lab/s2/gait/walk.c3d", given=both) == "/lab/s2/cal/cal1.c3d"
    assert _chosen(LAB, "/lab/s1/day2/walk.c3d", given=both) == "/lab/s1/static.c3d"


# A laboratory's folder through `asterism label`


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two people's folders: a standing trial by name, one by posture; a damaged file, joint angles, forces of no marker; and a model."""
    place = tmp_path_factory.mktemp("lab")
    walks, standing = simulate_walks(5, 60, 50.0, markers=MARKERS, seed=3), simulate_standing(5, 30, 50.0, seed=3)
    trained(walks[:3], miner=None).save(place / "walks.model")
    for person, static in ((3, "trial07.c3d"), (4, "static.c3d")):
        folder = place / "lab" / f"s{person}"
        folder.mkdir(parents=True)
        formats.write(folder / "walk.c3d", Recording.from_clouds(walks[person].clouds()))
        formats.write(folder / static, standing[person].select(walks[0].labels))
    (place / "lab" / "s3" / "broken.c3d").write_bytes((place / "lab" / "s3" / "walk.c3d").read_bytes()[:300])
    (place / "lab" / "s4" / "angles.mot").write_text(
        "angles\nversion=1\nnRows=2\nnColumns=2\ninDegrees=yes\nendheader\ntime\tknee_angle_r\n0\t1\n0.01\t2\n", encoding="utf-8"
    )
    return place


def test_a_laboratorys_folder_is_labelled_as_it_is(lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, told = tmp_path / "out", tmp_path / "label.json"
    words = ("label", lab / "lab", "-m", lab / "walks.model", "-o", out, "--json", told)
    assert run(*words) == 1
    shown = capsys.readouterr()
    assert sorted(path.relative_to(out).as_posix() for path in out.rglob("*.c3d")) == [
        "s3/trial07.c3d",
        "s3/walk.c3d",
        "s4/static.c3d",
        "s4/walk.c3d",
    ]
    assert "broken.c3d is not a C3D file" in shown.err and "5 files: 4 labelled, 1 failed" in shown.err
    assert "1 file in the folders holds no markers and was passed over" in shown.err and "angles.mot" in shown.err
    assert "4 recordings" in shown.out
    content = json.loads(told.read_text(encoding="utf-8"))
    used = {Path(row["output"]).relative_to(out).as_posix(): row["subject"] and Path(row["subject"]).name for row in content["files"]}
    assert used == {"s3/trial07.c3d": None, "s3/walk.c3d": None, "s4/static.c3d": None, "s4/walk.c3d": "static.c3d"}
    [other] = [finding for finding in content["findings"] if finding["code"] == "label-other-subject"]
    assert "trial07.c3d is not of this body" in other["sentence"] and other["severity"] == "note", "found by posture, and refused"
    assert [Path(name).name for name in content["passed_over"]] == ["angles.mot"]
    for row in content["files"]:
        assert np.mean([marker["labelled"] for marker in row["markers"].values()]) == pytest.approx(row["labelled"])
    ready = {row["readiness"]: row["use"] for row in content["files"]}
    assert ready["ready"] == "ready" and {"ready", "look", "do-not-use"} >= set(ready)
    assert "use" in shown.out and " ready" in shown.out
    plain = tmp_path / "plain"
    assert run("label", lab / "lab", "-m", lab / "walks.model", "-o", plain, "--no-static", "--json", tmp_path / "plain.json") == 1
    assert {row["subject"] for row in json.loads((tmp_path / "plain.json").read_text())["files"]} == {None}


def test_a_run_that_was_stopped_goes_on(lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    source.mkdir()
    for name, walk in (("a.c3d", "s3"), ("b.c3d", "s4")):
        (source / name).write_bytes((lab / "lab" / walk / "walk.c3d").read_bytes())
    words = ("label", source, "-m", lab / "walks.model", "-o", out)
    assert run(*words) == 0
    first = capsys.readouterr().out.splitlines()[0]
    made = (out / "a.c3d").read_bytes()
    (out / "b.c3d").unlink()
    assert run(*words) == 0
    shown = capsys.readouterr().out
    again, new = shown.splitlines()[:2]
    assert again == f"{first}; labelled by an earlier run, {out / 'a.c3d'} stays" and "earlier run" not in new
    assert "100.00 %" in shown.partition("recordings")[2], "the table has the results of the earlier run"
    assert (out / "a.c3d").read_bytes() == made and (out / "b.c3d").exists()
    changed = made[:-1] + bytes([made[-1] ^ 1])
    (out / "a.c3d").write_bytes(changed)
    assert run(*words) == 0
    assert "changed since" in capsys.readouterr().out and (out / "a.c3d").read_bytes() == changed


@pytest.mark.parametrize("how", ["other source", "other option", "no record", "cut record", "odd record"])
def test_what_was_made_otherwise_is_not_taken_for_finished(how: str, lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = tmp_path / "walk.c3d", tmp_path / "out"
    source.write_bytes((lab / "lab" / "s3" / "walk.c3d").read_bytes())
    words = ["label", source, "-m", lab / "walks.model", "-o", out]
    assert run(*words) == 0
    record = out / "asterism-label.jsonl"
    if how == "other source":
        source.write_bytes((lab / "lab" / "s4" / "walk.c3d").read_bytes())
    elif how == "other option":
        words.append("--frame-wise")
    elif how == "no record":
        record.unlink()
    elif how == "odd record":
        record.write_text(re.sub(r'"(use|severity)": "[^"]*"', r'"\1 ": 0', record.read_text()))
    else:
        record.write_bytes(record.read_bytes()[:40])
    before = (out / "walk.c3d").read_bytes()
    assert run(*words) == 2
    assert "exists; choose another folder" in capsys.readouterr().err
    assert (out / "walk.c3d").read_bytes() == before


def test_a_run_that_was_killed_after_writing_has_finished_the_file(lab: Path, tmp_path: Path) -> None:
    source, out = lab / "lab" / "s3" / "walk.c3d", tmp_path / "out"
    words = ("label", source, "-m", lab / "walks.model", "-o", out)
    assert run(*words) == 0
    record = out / "asterism-label.jsonl"
    begun = record.read_text().splitlines()[0]
    record.write_text(begun + "\n" + '{"event": "writ', encoding="utf-8")
    assert run(*words) == 0
    assert record.read_text().splitlines()[0] == begun
    # whatever a clock that was set says
    os.utime(out / "walk.c3d", ns=(0, 0))
    assert run(*words) == 0
    found = (out / "walk.c3d").stat()
    before = {**json.loads(begun), "before": [found.st_size, found.st_mtime_ns, found.st_ino]}
    record.write_text(json.dumps(before) + "\n", encoding="utf-8")
    assert run(*words) == 2, "an output that was there before the run was killed is not what it would have written"


@pytest.mark.parametrize("verb", ["audit", "review", "info"])
def test_other_commands_take_folders_too(verb: str, lab: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [verb, lab / "lab", *(["-m", lab / "walks.model"] if verb == "review" else []), "--json", "-"]
    run(*words)
    shown = capsys.readouterr()
    files = [Path(entry["file"] if isinstance(entry, dict) else entry).name for entry in json.loads(shown.out)["files"]]
    assert {"static.c3d", "trial07.c3d"} <= set(files), shown.err
    assert "broken.c3d" in shown.err


def test_labelled_files_are_written_for_the_next_program(lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("label", lab / "lab" / "s3" / "walk.c3d", "-m", lab / "walks.model", "-o", tmp_path / "out", "--for", "opensim")
    assert run(*words) == 0
    [written] = (tmp_path / "out").glob("*.trc")
    recording = formats.read(written, vertical="y")
    truth = formats.read(lab / "lab" / "s3" / "walk.c3d")
    heights = [np.nanmax(each.positions @ each.vertical) for each in (recording, truth)]
    assert set(recording.labels) == set(MarkerSet.load(MARKERS).names) and heights[0] == pytest.approx(heights[1], abs=1e-4)
    capsys.readouterr()
    assert run(*words) == 0
    assert "labelled by an earlier run" in capsys.readouterr().out


def test_a_batch_counts_a_file_once_and_as_failed_where_one_of_its_steps_failed(capsys: pytest.CaptureFixture[str]) -> None:
    batch = _console.Batch("moved")
    good, bad, unreadable = Path("good.c3d"), Path("bad.c3d"), Path("unreadable.c3d")
    for path in (good, bad, unreadable):
        with batch.file(path):
            if path == unreadable:
                raise AsterismError("unreadable.c3d is empty.")
    for path in (good, bad):
        with batch.file(path):
            if path == bad:
                raise AsterismError("bad.c3d shows nobody.")
    assert batch.close() == 1
    assert "3 files: 1 moved, 2 failed: unreadable.c3d, bad.c3d" in " ".join(capsys.readouterr().err.split())

    alone = _console.Batch("moved")
    with alone.file(bad):
        pass
    with alone.file(bad):
        raise AsterismError("bad.c3d shows nobody.")
    assert alone.close() == 2, "what was read and then failed is not done"
