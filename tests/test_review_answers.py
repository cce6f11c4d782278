"""Answers without a browser: the list as a table, and the table, filled in, as corrected files."""

from __future__ import annotations

import csv
import io
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from correcting import model, recorded, walks, written

from asterism import formats
from asterism.cli import main
from asterism.errors import AsterismError
from asterism.labelling.correction import Answer, Correction, question_row, read_answers, table_text, touches_of
from asterism.recording import Recording


def questions(folder: Path, files: list[Path]) -> list[dict[str, str]]:
    """The table that the command writes."""
    table = folder / "items.csv"
    words = ["review", *map(str, files), "--model", str(folder / "gait.model"), "--csv", str(table), "--top", "60", "--overwrite"]
    assert main(words) in (0, 1)
    return list(csv.DictReader(io.StringIO(table.read_text(encoding="utf-8-sig"))))


@cache
def _asked() -> tuple[dict[str, str], ...]:
    """The rows of the first file of `written`, as the command writes them."""
    with tempfile.TemporaryDirectory() as made:
        return tuple(questions(Path(made), written(Path(made))))


def asked_of(file: Path) -> list[dict[str, str]]:
    """The same rows, for a file wherever it is."""
    return [{**row, "file": str(file)} for row in _asked()]


def filled(path: Path, rows: list[dict[str, str]], delimiter: str = ",") -> Path:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), delimiter=delimiter)
        writer.writeheader()
        writer.writerows(rows)
    return path


def answered(folder: Path, files: list[Path], table: Path, *more: str) -> int:
    model_file = str(folder / "gait.model")
    return main(["review", *map(str, files), "--model", model_file, "--answers", str(table), "-o", str(folder / "out"), *more])


@pytest.fixture(scope="module")
def walk() -> tuple[Recording, list[str]]:
    """The walk in the file, and the true name of each of its columns, "ghost" for ghosts."""
    recording, marker = recorded(walks()[4])
    return recording, [walks()[4].labels[m] if m >= 0 else "ghost" for m in marker]


@pytest.fixture(scope="module")
def correction(walk: tuple[Recording, list[str]]) -> Correction:
    """The walk, labelled; no test here changes it."""
    return Correction(model(), walk[0])


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_a_table_is_read_with_the_delimiter_of_any_spreadsheet(delimiter: str, correction: Correction, tmp_path: Path) -> None:
    table = table_text([[*question_row("walk.c3d", correction, item)[:-1], "right"] for item in correction.items()])
    answers = read_answers(filled(tmp_path / "answers.csv", list(csv.DictReader(io.StringIO(table.removeprefix("\ufeff")))), delimiter))
    assert len(answers) > 3 and answers == _read(table)


def test_every_question_answered_gives_the_truth(
    tmp_path: Path, walk: tuple[Recording, list[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    [file] = written(tmp_path)
    recording, names = walk
    rows = questions(tmp_path, [file])
    assert len(rows) > 3 and all(row["answer"] == "" for row in rows)
    for row in rows:
        row["answer"] = names[recording.labels.index(row["point"].lstrip("'"))]
    assert answered(tmp_path, [file], filled(tmp_path / "answers.csv", rows)) == 1  # the model is brief: the person is not like its own
    said = capsys.readouterr()
    assert f"{len(rows)} answers" in said.out and "[label-foreign-recording]" in said.err
    done = formats.read(tmp_path / "out" / file.name)
    for column, name in enumerate(names):
        if name != "ghost":
            there = recording.visible[:, column]
            np.testing.assert_allclose(done.positions[there, done.labels.index(name)], recording.positions[there, column], atol=1e-6)
    assert done.log[-1].action == "corrected" and done.log[-1].settings["touches"] == len(rows)
    assert not any(ghost in done.labels for ghost in ("ghost",))


def test_a_cut_a_swap_and_right_are_understood(walk: tuple[Recording, list[str]], correction: Correction) -> None:
    recording, _ = walk
    pieces = correction.pieces
    one, other = (int(piece) for piece in pieces.id[(pieces.first == 0) & (pieces.last == 119)][:2])
    text = question_row("walk.c3d", correction, correction.items()[0])
    marker = correction.names[pieces.marker[pieces.place_of(one)]]
    point = recording.labels[int(correction.clouds.columns[other])]
    said = ("lasi cut@40 ghost Cut @ 60 right", f"swap@91 with {point}")
    table = table_text([[*text[:2], str(one), *text[3:-1], answer] for answer in said])
    answers = _read(table)
    assert tuple(answer.text for answer in answers) == said
    cut = touches_of(answers[:1], correction)
    assert [touch.kind for touch in cut] == ["cut", "cut", "name", "ghost", "right"]
    assert [touch.cuts[0].frame for touch in cut[:2]] == [29, 49], "the file's first frame is 11"
    assert [marker for touch in cut[2:] for _, marker in touch.labels] == ["LASI", None, marker]
    [swap] = touches_of(answers[1:], correction)
    assert swap.kind == "swap" and {cut.frame for cut in swap.cuts} == {80}
    by_label = _read(table.replace(f"with {point}", f"with {correction.names[pieces.marker[pieces.place_of(other)]]}"))
    assert touches_of(by_label[1:], correction) == [swap]


def _read(table: str) -> list[Answer]:
    with tempfile.TemporaryDirectory() as made:
        path = Path(made) / "answers.csv"
        path.write_text(table, encoding="utf-8")
        return read_answers(path)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ("nobody", "'nobody' is no answer"),
        ("cut@11", "does not cut frames"),
        ("cut@60 cut@40", "does not cut frames"),
        ("cut@99999999999999999999", "does not cut frames"),
        ("swap@60 with nothing", "is no answer"),
        ("swap@1 with *2", "not there in frame 1"),
        ("=cmd()", "is no answer"),
    ],
)
def test_an_answer_that_cannot_be_names_its_line(answer: str, said: str, correction: Correction) -> None:
    pieces = correction.pieces
    one = int(pieces.id[(pieces.first == 0) & (pieces.last == 119)][0])
    row = question_row("walk.c3d", correction, correction.items()[0])
    with pytest.raises(AsterismError, match="line 2: ") as problem:
        touches_of(_read(table_text([[*row[:2], str(one), *row[3:-1], answer]])), correction)
    assert said in str(problem.value)


def test_answers_for_another_recording_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = written(tmp_path, 2)
    rows = asked_of(files[0])
    for row in rows:
        row["answer"] = "right"
        row["file"] = str(files[1])
    assert answered(tmp_path, files, filled(tmp_path / "answers.csv", rows)) == 1
    assert "the answer belongs to another recording than walk2.c3d is now" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["walk1.c3d"], "the other file is still labelled"


def test_a_table_of_files_that_were_not_given_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = written(tmp_path, 2)
    rows = asked_of(files[0])
    rows[0]["answer"] = "right"
    assert answered(tmp_path, files[1:], filled(tmp_path / "answers.csv", rows)) == 2
    assert "walk1.c3d is not among the files given" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "has no column file"),
        (b"file,recording,piece\n", "has no column answer"),
        (b"file,recording,piece,answer\na,b,-1,right\n", "line 2: the column piece"),
        (b"file,recording,piece,answer\na,b,1e5,right\n", "line 2: the column piece"),
        (b'file,recording,piece,answer\na,b,1,"' + b"x" * 200_000 + b'"\n', "is no table of answers"),
    ],
)
def test_a_damaged_table_is_one_sentence(content: bytes, said: str, tmp_path: Path) -> None:
    path = tmp_path / "answers.csv"
    path.write_bytes(content)
    with pytest.raises(AsterismError, match=said):
        read_answers(path)


def test_a_name_that_a_spreadsheet_would_run_is_quoted(walk: tuple[Recording, list[str]]) -> None:
    recording, _ = walk
    hostile = Recording(recording.positions, ("=cmd()", "+1", "@x", *recording.labels[3:]), recording.rate, recording.vertical)
    correction = Correction(model(), hostile)
    rows = [question_row("-walk.c3d", correction, item) for item in correction.items()]
    cells = [cell for row in rows for cell in row]
    assert "'-walk.c3d" in cells and not any(cell.startswith(("=", "+", "-", "@")) for cell in cells)
    rows[0][-1] = "right"
    [answer] = _read(table_text(rows))
    assert answer.file == "-walk.c3d"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--answers", "a.csv"], "say where with -o"),
        (["--answers", "a.csv", "--csv", "b.csv", "-o", "out"], "leave out --csv"),
        (["--serve", "--csv", "b.csv"], "leave out --csv and --answers"),
        (["--csv", "b.csv", "--frame-wise"], "leave out --frame-wise"),
        (["--csv", "b.csv", "--keep-labels", "--known-labels", "check"], "--keep-labels contradicts"),
        (["--serve", "--report", "b.html"], "leave out --report and --json"),
    ],
)
def test_options_that_contradict_each_other(words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["review", "walk.c3d", "--model", "gait.model", *words]) == 2
    assert said in capsys.readouterr().err


def test_an_existing_file_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    [file] = written(tmp_path)
    rows = asked_of(file)
    rows[0]["answer"] = "right"
    table = filled(tmp_path / "answers.csv", rows)
    assert answered(tmp_path, [file], table) == 1
    assert answered(tmp_path, [file], table) == 2
    assert "exists; choose another folder with -o, or replace it with --overwrite" in capsys.readouterr().err
    assert answered(tmp_path, [file], table, "--overwrite") == 1


def test_a_folder_is_corrected_into_a_tree(tmp_path: Path, walk: tuple[Recording, list[str]]) -> None:
    [file] = written(tmp_path)
    rows = asked_of(file)[:1]
    rows[0]["answer"] = walk[1][walk[0].labels.index(rows[0]["point"].lstrip("'"))]
    table = filled(tmp_path / "answers.csv", rows)
    (tmp_path / "lab" / "Ann").mkdir(parents=True)
    file.rename(tmp_path / "lab" / "Ann" / file.name)
    assert answered(tmp_path, [tmp_path / "lab"], table) == 1
    assert (tmp_path / "out" / "Ann" / file.name).is_file()
