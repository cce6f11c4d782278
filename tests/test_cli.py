"""The command line, driven as a user drives it: what it prints, writes, refuses, and with which status it leaves."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from models import BRIEF, SHORT, examining_briefly, training_with

from asterism import MarkerModel, formats
from asterism.cli import _EXAMPLES, _GROUPS, _HEADINGS, _console, main
from asterism.cli.demo import DemoPart
from asterism.recording import Recording
from asterism.simulation import simulate_walks

ROOT = Path(__file__).parent.parent
VERBS = (
    "demo",
    "opensim",
    "name",
    "audit",
    "mend",
    "train",
    "label",
    "review",
    "learn",
    "evaluate",
    "capturability",
    "reconstruct",
    "info",
    "convert",
    "warm-up",
    "detect",
)
TWO_WORDS = (
    *("calibrate refine", "calibrate wand", "calibrate board", "rig report", "rig plan"),
    *("live cameras list", "live cameras set", "live cameras watch"),
)
MARKERS = "helen-hayes"


def run(*args: object) -> int:
    return main([str(arg) for arg in args])


def asterism(*args: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "asterism.cli", *map(str, args)], capture_output=True, text=True, cwd=cwd, timeout=120)


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    """Five people of different sizes walk for a second."""
    return simulate_walks(subjects=5, frames=100, markers=MARKERS, seed=3)


@pytest.fixture(scope="module")
def folder(walks: list[Recording], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """walk-0.c3d to walk-4.c3d, labelled; nameless.c3d, walk-4 without its labels; broken.c3d."""
    place = tmp_path_factory.mktemp("recordings")
    for i, walk in enumerate(walks):
        formats.write(place / f"walk-{i}.c3d", walk)
    formats.write(place / "nameless.c3d", Recording.from_clouds(walks[4].clouds()))
    (place / "broken.c3d").write_bytes((place / "walk-0.c3d").read_bytes()[:300])
    return place


@pytest.fixture(scope="module")
def model(folder: Path) -> Path:
    """What `asterism train` makes of the first four, in short trials."""
    path = folder / "walks.model"
    with training_with(SHORT):
        assert run("train", *(folder / f"walk-{i}.c3d" for i in range(4)), "-o", path, "--markers", MARKERS) == 0
    return path


# What the command says about itself


def test_help_names_every_command() -> None:
    shown = asterism("--help")
    assert shown.returncode == 0
    assert [verb for verb in VERBS if not re.search(rf"^  {verb} ", shown.stdout, re.MULTILINE)] == []


def test_help_loads_no_heavy_room() -> None:
    code = (
        "import sys; from asterism.cli import main; main(['--help']); print([m for m in ('numba', 'scipy', 'plotly') if m in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert shown.stdout.splitlines()[-1] == "[]", shown.stderr


def _options(verb: str, capsys: pytest.CaptureFixture[str]) -> set[str]:
    assert run(*verb.split(), "--help") == 0
    text = capsys.readouterr().out
    assert f"Example: asterism {verb}" in text
    return set(re.findall(r"^  (?:-\w, )?(--[a-z-]+)", text, re.MULTILINE)) - {"--help"}


@pytest.mark.parametrize("verb", [*VERBS, *TWO_WORDS])
def test_every_command_and_option_is_documented(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    pages = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8").split("\n## ")
    [page] = [page for page in pages if page.startswith(f"`asterism {verb}`")]
    options = _options(verb, capsys)
    assert f"```sh\nasterism {verb}" in page
    assert {option for option in options if f"`{option}" not in page} == set()
    table = "\n".join(line for line in page.splitlines() if line.startswith("|"))
    assert set(re.findall(r"`(--[a-z-]+)", table)) <= options, "documented, but not there"


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--version") == 0
    assert re.fullmatch(r"asterism \d+\S*\n", capsys.readouterr().out)


def test_the_module_is_the_command(tmp_path: Path) -> None:
    told = subprocess.run([sys.executable, "-m", "asterism", "info", "none.c3d"], cwd=tmp_path, capture_output=True, text=True)
    assert told.returncode == 2
    assert told.stdout == ""
    assert told.stderr.startswith("asterism: none.c3d")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["lable"], "lable"),
        (["label", "a.c3d"], "--output"),
        (["info"], "FILES"),
        (["train", "a.c3d", "-o", "m", "--partial-solvers", "sideways"], "sideways"),
        (["train", "a.c3d", "-o", "m", "--target-hit-rate", "99.9"], "--target-hit-rate 99.9"),
        (["train", "a.c3d", "-o", "m", "--features", "g2,g77"], "g77"),
        (["train", "a.c3d", "-o", "no/such/m"], "folder"),
        (["evaluate", "a.c3d"], "--leave-one-subject-out"),
        (["evaluate", "a.c3d", "--model", "m", "--leave-one-subject-out"], "one of them"),
        (["evaluate", "a.c3d", "--leave-one-subject-out", "--occlusions", "many"], "--occlusions many"),
        (["convert", "a.c3d", "b.trc", "--vertical", "1,2,up"], "--vertical 1,2,up"),
        (["info", "nowhere.c3d"], "nowhere.c3d"),
        (["info", "nowhere.c3d", "--json", "no/such/folder.json"], "folder.json"),
        (["label", "nowhere.c3d", "-m", "no.model", "-o", "out"], "no.model"),
        (["label", "nowhere.c3d", "-m", "no.model", "-o", "out", "--report", "no/such/page.html"], "page.html"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, list) else "",
)
def test_wrong_words_leave_with_2_and_one_sentence(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*words) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.count("\n") == 1 and said in shown.err


# info and convert


def test_info_shows_a_recording(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("info", folder / "walk-0.c3d") == 0
    shown = capsys.readouterr()
    assert "C3D" in shown.out and "100" in shown.out and "RKNE" in shown.out
    assert shown.err == ""


def test_a_file_that_breaks_off_is_a_warning(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cut = tmp_path / "cut.c3d"
    cut.write_bytes((folder / "walk-0.c3d").read_bytes()[:-4000])
    assert run("info", folder / "walk-0.c3d") == 0 and capsys.readouterr().err == ""
    assert run("info", cut, "--json", "-") == 1
    shown = capsys.readouterr()
    [finding] = json.loads(shown.out)["files"][0]["findings"]
    assert (finding["code"], finding["severity"], finding["where"]) == ("format-cut-off", "warning", str(cut))
    assert "of 100 frames" in finding["sentence"] and "[format-cut-off]" in shown.err
    assert [f.code for f in formats.read(cut).metadata["findings"]] == ["format-cut-off"]


def test_json_on_standard_output_is_all_there_is(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("info", folder / "walk-0.c3d", folder / "nameless.c3d", "--json", "-") == 0
    found = json.loads(capsys.readouterr().out)
    assert [entry["frames"] for entry in found["files"]] == [100, 100]


def test_a_batch_goes_on_after_a_bad_file_and_names_it(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("info", folder / "walk-0.c3d", folder / "broken.c3d", folder / "walk-1.c3d") == 1
    shown = capsys.readouterr()
    assert "walk-0.c3d" in shown.out and "walk-1.c3d" in shown.out
    first, last = shown.err.splitlines()
    assert "broken.c3d" in first and "3 files: 2 shown, 1 failed" in last and "broken.c3d" in last
    assert run("info", folder / "broken.c3d") == 2


def test_a_pattern_that_the_shell_left_means_its_files(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("info", folder / "walk-[01].c3d", "--json", "-") == 0
    found = json.loads(capsys.readouterr().out)["files"]
    assert [Path(entry["file"]).name for entry in found] == ["walk-0.c3d", "walk-1.c3d"]


@pytest.mark.parametrize("suffix", ["c3d", "trc", "csv", "npz"])
def test_convert_keeps_the_positions(suffix: str, folder: Path, walks: list[Recording], tmp_path: Path) -> None:
    target = tmp_path / f"walk.{suffix}"
    assert run("convert", folder / "walk-0.c3d", target) == 0
    again = formats.read(target)
    assert again.labels == walks[0].labels
    np.testing.assert_allclose(again.positions, walks[0].positions, atol=1e-5)


def test_convert_replaces_a_file_only_when_asked(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "walk.trc"
    target.write_text("mine")
    assert run("convert", folder / "walk-0.c3d", target) == 2
    assert target.read_text() == "mine" and "--overwrite" in capsys.readouterr().err
    assert run("convert", folder / "walk-0.c3d", target, "--overwrite") == 0
    assert len(formats.read(target)) == 100


def test_convert_takes_some_markers(folder: Path, tmp_path: Path) -> None:
    assert run("convert", folder / "walk-0.c3d", tmp_path / "knees.trc", "--markers", "LKNE,RKNE") == 0
    assert formats.read(tmp_path / "knees.trc").labels == ("LKNE", "RKNE")


# train


def test_train_learns_a_marker_from_the_files_that_have_it(
    folder: Path, walks: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    formats.write(tmp_path / "kneeless.c3d", walks[1].select([name for name in walks[1].labels if name != "LKNE"]))
    files = [folder / "walk-0.c3d", tmp_path / "kneeless.c3d"]
    with training_with(BRIEF):
        assert run("train", *files, "-o", tmp_path / "m.model", "--markers", MARKERS) == 0
    assert "not all of the 2 files have each marker, which is learned from those that do: LKNE (in 1)." in capsys.readouterr().err
    assert len(MarkerModel.load(tmp_path / "m.model").state.markers) == len(walks[0].labels)


def test_train_names_the_file_that_lacks_most_markers_and_a_marker_that_no_file_has(
    folder: Path, walks: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    formats.write(tmp_path / "pelvis.c3d", walks[1].select(walks[1].labels[:5]))
    assert run("train", folder / "walk-0.c3d", tmp_path / "pelvis.c3d", "-o", tmp_path / "m.model", "--markers", MARKERS) == 2
    assert "pelvis.c3d has 5 of the 15 markers, fewer than half" in capsys.readouterr().err
    names = ",".join([*walks[0].labels, "LFHD"])
    assert run("train", folder / "walk-0.c3d", "-o", tmp_path / "m.model", "--markers", names) == 2
    assert "no file has the marker LFHD" in capsys.readouterr().err
    assert not (tmp_path / "m.model").exists()


@pytest.mark.slow
def test_train_is_the_same_again(folder: Path, model: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.model"
    report = tmp_path / "train.json"
    files = [folder / f"walk-{i}.c3d" for i in range(4)]
    with training_with(SHORT):
        assert run("train", *files, "-o", again, "--markers", MARKERS, "--json", report) == 0
    assert again.read_bytes() == model.read_bytes()
    told = json.loads(report.read_text())
    assert len(told["markers"]) == 15 and len(told["subjects"]) == 4 and 200 <= told["frames"] <= 400


# label


def test_label_names_the_points_of_a_stranger(
    folder: Path, model: Path, walks: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = folder / "nameless.c3d"
    before = source.read_bytes()
    assert run("label", source, "--model", model, "-o", tmp_path / "out", "--report", tmp_path / "report.html") == 0
    line = capsys.readouterr().out
    assert re.search(
        r"nameless\.c3d: 100 frames, z up, [\d.]+ % labelled, [\d.]+ % likely, [\d.]+ % unsure, [\d.]+ % hidden, [\d,]+ frames/s", line
    ), line
    labelled = formats.read(tmp_path / "out" / "nameless.c3d", markers=MARKERS)
    given = labelled.visible
    assert given.mean() > 0.7, f"{given.mean():.1%} of the markers labelled"
    wrong = np.linalg.norm(labelled.positions - walks[4].positions, axis=2)[given] > 1e-4
    assert wrong.mean() <= 0.01, f"{wrong.mean():.2%} of the labels wrong"
    assert source.read_bytes() == before
    assert "</html>" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_a_trial_of_the_subject_helps_and_one_of_someone_else_is_said(
    folder: Path, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    walk, told = folder / "walk-4.c3d", tmp_path / "label.json"
    assert run("label", walk, "--model", model, "-o", tmp_path / "own", "--subject", folder / "nameless.c3d") == 0
    capsys.readouterr()
    assert run("label", walk, "--model", model, "-o", tmp_path / "other", "--subject", folder / "walk-0.c3d", "--json", told) == 1
    assert "walk-0.c3d is not of this body" in capsys.readouterr().err
    [finding] = json.loads(told.read_text())["findings"]
    assert (finding["code"], finding["where"]) == ("label-other-subject", str(walk))
    assert run("label", walk, "--model", model, "-o", tmp_path / "plain") == 0
    assert (tmp_path / "other" / "walk-4.c3d").read_bytes() == (tmp_path / "plain" / "walk-4.c3d").read_bytes()
    assert run("label", walk, "--model", model, "--model", model, "-o", tmp_path / "two", "--subject", folder / "walk-0.c3d") == 2
    assert run("label", walk, "--model", model, "-o", tmp_path / "none", "--subject", folder / "broken.c3d") == 2
    assert run("label", walk, "--model", model, "-o", tmp_path / "none", "--subject", folder / "walk-0.c3d", "--rules", "thesis") == 2
    assert "broken.c3d" in capsys.readouterr().err


def test_label_goes_on_after_a_bad_file(folder: Path, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    files = (folder / "walk-3.c3d", folder / "broken.c3d", folder / "walk-4.c3d")
    assert run("label", *files, "--model", model, "-o", out, "--json", tmp_path / "label.json") == 1
    assert sorted(p.name for p in out.iterdir()) == ["asterism-label.jsonl", "walk-3.c3d", "walk-4.c3d"]
    assert "3 files: 2 labelled, 1 failed" in capsys.readouterr().err
    told = json.loads((tmp_path / "label.json").read_text())
    assert [Path(row["file"]).name for row in told["files"]] == ["walk-3.c3d", "walk-4.c3d"]
    assert [Path(path).name for path in told["failed"]] == ["broken.c3d"]
    for row in told["files"]:
        assert row["labelled"] + row["likely"] + row["unsure"] + row["hidden"] == pytest.approx(1.0)


def test_label_never_writes_over_its_input(folder: Path, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "walk.c3d"
    source.write_bytes((folder / "nameless.c3d").read_bytes())
    assert run("label", source, "--model", model, "-o", tmp_path) == 2
    assert "input itself" in capsys.readouterr().err
    assert source.read_bytes() == (folder / "nameless.c3d").read_bytes()
    assert run("label", source, "--model", model, "-o", tmp_path, "--overwrite") == 0
    assert "RKNE" in formats.read(source).labels


def test_two_files_of_one_name_keep_their_folders(folder: Path, model: Path, tmp_path: Path) -> None:
    for name, walk in (("ann", 3), ("ben", 4)):
        (tmp_path / "lab" / name).mkdir(parents=True)
        (tmp_path / "lab" / name / "walk.c3d").write_bytes((folder / f"walk-{walk}.c3d").read_bytes())
    out, files = tmp_path / "out", [tmp_path / "lab" / name / "walk.c3d" for name in ("ann", "ben")]
    assert run("label", *files, "--model", model, "-o", out) == 0
    assert sorted(path.relative_to(out).as_posix() for path in out.rglob("*.c3d")) == ["ann/walk.c3d", "ben/walk.c3d"]
    assert (out / "ann" / "walk.c3d").read_bytes() != (out / "ben" / "walk.c3d").read_bytes()


def test_keep_leaves_the_labels_of_the_file(folder: Path, model: Path, walks: list[Recording], tmp_path: Path) -> None:
    swapped = dict(LKNE="RKNE", RKNE="LKNE", LTOE="*1", RTOE="Pointer")
    worn = walks[4]
    formats.write(
        tmp_path / "mixed.c3d", Recording(worn.positions, tuple(swapped.get(n, n) for n in worn.labels), worn.rate, worn.vertical)
    )
    for keep, lkne in (((), "LKNE"), (("--keep",), "RKNE")):
        status = run("label", tmp_path / "mixed.c3d", "--model", model, "-o", tmp_path / f"out{len(keep)}", *keep)
        assert status == (0 if keep else 1), "a file that names some points is checked, and the exchanged knees are told"
        labelled = formats.read(tmp_path / f"out{len(keep)}" / "mixed.c3d")
        knee = labelled.positions[:, labelled.labels.index("LKNE")]
        given = ~np.isnan(knee[:, 0])
        right = np.abs(knee - worn.positions[:, worn.labels.index(lkne)]).max(axis=1)[given] < 1e-4
        assert given.mean() > 0.5 and right.mean() > 0.99
        assert not keep or (given.all() and right.all())
        assert ("Pointer" in labelled.labels) == bool(keep), "without --keep-labels, the model finds that it is the toe"


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_anonymous_clouds_are_labelled_too(suffix: str, folder: Path, model: Path, walks: list[Recording], tmp_path: Path) -> None:
    formats.write(tmp_path / f"cloud.{suffix}", Recording.from_clouds(walks[4].clouds()))
    assert run("label", tmp_path / f"cloud.{suffix}", "--model", model, "-o", tmp_path / "out") == 0
    labelled = formats.read(tmp_path / "out" / f"cloud.{suffix}", markers=MARKERS)
    assert labelled.visible.mean() > 0.8


@pytest.mark.parametrize("damage", [b"", b"not a model", None], ids=["empty", "text", "cut"])
def test_a_damaged_model_is_refused_in_one_sentence(
    damage: bytes | None, folder: Path, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.model"
    bad.write_bytes(model.read_bytes()[:-500] if damage is None else damage)
    assert run("label", folder / "walk-4.c3d", "--model", bad, "-o", tmp_path / "out") == 2
    said = capsys.readouterr().err
    assert "bad.model" in said and said.count("\n") == 1
    assert not (tmp_path / "out").exists()


# evaluate and capturability


def test_evaluate_a_model(folder: Path, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("evaluate", "--model", model, folder / "walk-4.c3d", "--occlusions", "0", "2", "--ghosts", "0", "3")
    assert run(*words, "--json", tmp_path / "e.json", "--report", tmp_path / "e.html") == 0
    shown = capsys.readouterr().out
    assert "Wrong labels, of those given" in shown and "Markers in view, of those without a label" in shown and "RKNE" in shown
    told = json.loads((tmp_path / "e.json").read_text())
    conditions = told["evaluation"]["conditions"]
    assert sorted((c["occlusions"], c["ghosts"]) for c in conditions) == [(0, 0), (0, 3), (2, 0), (2, 3)]
    assert max(c["fa"] for c in conditions) <= 0.05
    assert "</html>" in (tmp_path / "e.html").read_text(encoding="utf-8")


def test_evaluate_goes_on_after_a_bad_file(folder: Path, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("evaluate", "--model", model, "--occlusions", "1", "--json", tmp_path / "e.json")
    assert run(*words, folder / "walk-4.c3d", folder / "broken.c3d") == 1
    assert "broken.c3d" in capsys.readouterr().err.splitlines()[-1]
    assert [Path(path).name for path in json.loads((tmp_path / "e.json").read_text())["failed"]] == ["broken.c3d"]
    assert run("evaluate", "--model", model, folder / "broken.c3d") == 2


def test_more_cannot_be_hidden_than_there_is(folder: Path, model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("evaluate", "--model", model, folder / "walk-4.c3d", "--occlusions", "16") == 2
    assert "15 markers" in capsys.readouterr().err


def test_capturability(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [folder / f"walk-{i}.c3d" for i in range(3)]
    few = "RASI,LASI,SACR,RKNE,RANK,RTOE,LTOE"
    with examining_briefly():
        assert run("capturability", *files, "--markers", few, "--json", tmp_path / "c.json", "--report", tmp_path / "c.html") == 0
    assert "RKNE" in capsys.readouterr().out
    content = json.loads((tmp_path / "c.json").read_text())
    assert content["findings"] == []
    told = content["capturability"]
    assert len(told["markers"]) == 7
    assert "</html>" in (tmp_path / "c.html").read_text(encoding="utf-8")


# As a real process


def besides_compiling(said: str) -> list[str]:
    """Lines on standard error; without the one that a run says whose kernels no earlier run has compiled."""
    return [
        line
        for line in said.splitlines()
        if not line.startswith("Compiling the numerical kernels of this command; this happens once (about ")
    ]


def test_piped_output_has_no_escape_codes_and_no_bar(folder: Path, model: Path, tmp_path: Path) -> None:
    shown = asterism("label", folder / "walk-4.c3d", "--model", model, "-o", tmp_path / "out")
    assert shown.returncode == 0, shown.stderr
    assert "\x1b" not in shown.stdout + shown.stderr and besides_compiling(shown.stderr) == []
    assert shown.stdout.count("\n") == 1


def test_the_list_of_commands_cuts_no_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--help") == 0
    assert [line for line in capsys.readouterr().out.splitlines() if line.endswith("...") and not line.startswith("Usage")] == []


def test_the_help_of_the_demo_names_all_its_demos(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("demo", "--help") == 0
    first, *rest = capsys.readouterr().out.splitlines()
    for part in DemoPart:
        if part is not DemoPart.LABELLING:
            assert part in first and f"`asterism demo {part}`" in " ".join(" ".join(rest).split()), part


def test_the_demo_labels_whole_recordings_as_label_does(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = tmp_path / "demo"
    assert run("demo", "-o", place, "--json", tmp_path / "demo.json") == 0
    shown = json.loads((tmp_path / "demo.json").read_text())
    assert [(row["hidden"], row["ghosts"]) for row in shown["conditions"]] == [(0, 0), (2, 0), (4, 0), (2, 3)]
    for row in shown["conditions"]:
        assert row["right"] > 0.97 * row["visible"] and row["wrong"] < 0.01 * row["visible"], row
    assert "each labelled as a whole" in capsys.readouterr().out
    unlabelled = place / "walk-unlabelled.c3d"
    assert run("label", unlabelled, "-m", place / "walkers.model", "-o", place / "again") == 0
    labelled, again = (formats.read(path, markers=MARKERS) for path in (place / "walk-labelled.c3d", place / "again" / unlabelled.name))
    np.testing.assert_array_equal(labelled.positions, again.positions)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no SIGINT to a single process")
def test_interrupting_leaves_no_half_file(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "asterism.cli", "demo", "-o", str(tmp_path / "demo")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background job starts with SIGINT ignored
    )
    assert process.stdout is not None and process.stderr is not None
    assert "Training" in process.stdout.readline()
    process.send_signal(signal.SIGINT)
    said = process.stderr.read()
    assert process.wait(timeout=60) == 130
    [line] = besides_compiling(said)
    assert "interrupted" in line
    assert list((tmp_path / "demo").iterdir()) == []
    process.stdout.close()
    process.stderr.close()


def test_an_interruption_within_a_callback_of_a_library_is_not_lost() -> None:
    """Python only prints what a C library's callback raises: a batch went on after Ctrl-C."""
    from ctypes import CFUNCTYPE

    from asterism.cli import _interrupted_elsewhere

    @CFUNCTYPE(None)
    def callback() -> None:
        raise KeyboardInterrupt

    before, sys.unraisablehook = sys.unraisablehook, _interrupted_elsewhere
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job starts with SIGINT ignored
    try:
        with pytest.raises(KeyboardInterrupt):
            callback()
            # the signal is taken between steps of Python
            for _ in range(1000):
                time.sleep(0.01)
    finally:
        signal.signal(signal.SIGINT, handler)
        sys.unraisablehook = before


@pytest.mark.parametrize("width", [60, 80, 200])
@pytest.mark.parametrize("cameras", [2, 30])
def test_a_narrow_terminal_cuts_no_number(
    width: int, cameras: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    columns = ["camera", "size", "images", "threshold", "blobs", "per image", "overlapping", "cut by edge", "frames behind"]
    _console.table(
        "Blobs", columns, [[f"cam{c}", "1280 x 1024", "3000", "21", f"{108900 + c:,}", "3.0", "59", "25", "0"] for c in range(cameras)]
    )
    shown = capsys.readouterr().out
    words = shown.split()
    assert words.count("1024") == words.count("3000") == cameras
    assert all(f"cam{c}" in words and f"{108900 + c:,}" in words for c in range(cameras))
    assert cameras > 2 or max(map(len, shown.splitlines())) <= width


def test_every_command_is_under_a_heading_of_the_help_and_no_sentence_is_cut(capsys: pytest.CaptureFixture[str]) -> None:
    headings = [word for commands in _HEADINGS.values() for word in commands]
    assert sorted(headings) == sorted([*_EXAMPLES, *_GROUPS])
    for words in ([], *([group] for group in _GROUPS)):
        assert main([*words, "--help"]) == 0
        text = capsys.readouterr().out.partition("[ARGS]...")[2]
        assert text and "..." not in text
        assert all(f"{heading}:" in text for heading in _HEADINGS) == (not words)
