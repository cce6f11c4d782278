"""Mending: what the audit found is put right, and nothing else changes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import asterism
from asterism import Recording, formats
from asterism.cli import main
from asterism.labelling import audit
from asterism.labelling.audit import mend_errors
from asterism.simulation import simulate_walks

PEOPLE = ("Ann", "Ben", "Cem", "Dee", "Eva")
FRAMES = 150


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    return simulate_walks(subjects=5, frames=FRAMES, rate=100.0, seed=6)


def exchanged(recording: Recording, first: int, last: int, *names: str) -> Recording:
    """The points of the named markers pass to the next name, the last one's to the first."""
    columns = [recording.labels.index(name) for name in names]
    positions = recording.positions.copy()
    span = slice(first, last + 1)
    positions[span, columns] = recording.positions[span, np.roll(columns, 1)]
    return replace(recording, positions=positions)


def found(walks: list[Recording], number: int, damaged: Recording) -> list[asterism.labelling.LabelError]:
    errors = audit([*walks[:number], damaged, *walks[number + 1 :]], subjects=PEOPLE)
    return [error for error in errors if error.damage]


@pytest.mark.parametrize(
    ("first", "last", "names"),
    [
        (40, 60, ("LTHI", "LKNE")),
        (120, FRAMES - 1, ("LANK", "LHEE")),
        (70, 80, ("LTHI", "LKNE", "LTIB")),
        (0, FRAMES - 1, ("LKNE", "LANK")),
    ],
    ids=str,
)
def test_exchanged_labels_are_exchanged_back(walks: list[Recording], first: int, last: int, names: tuple[str, ...]) -> None:
    damaged = exchanged(walks[2], first, last, *names)
    errors = found(walks, 2, damaged)
    assert len(errors) == 1
    mended, done = mend_errors(damaged, errors)
    assert done == errors
    np.testing.assert_array_equal(mended.positions, walks[2].positions)


def test_a_label_that_jumps_is_taken_back_and_its_sample_stays(walks: list[Recording]) -> None:
    column = walks[1].labels.index("LTOE")
    positions = walks[1].positions.copy()
    positions[50:56, column] += [0.3, 0.0, 0.0]
    damaged = replace(walks[1], positions=positions)
    mended, done = mend_errors(damaged, found(walks, 1, damaged))
    assert len(done) == 1 and mended.labels == (*walks[1].labels, "*1")
    assert np.isnan(mended.positions[50:56, column]).all() and not np.isnan(mended.positions[:50, column]).any()
    np.testing.assert_array_equal(mended.positions[50:56, -1], positions[50:56, column])
    assert np.isnan(mended.positions[:50, -1]).all() and np.isnan(mended.positions[56:, -1]).all()


def test_three_labels_without_a_frame_before_and_after_stay(walks: list[Recording]) -> None:
    """No path tells which of the two other points is whose; nothing is guessed."""
    damaged = exchanged(walks[2], 0, FRAMES - 1, "LTHI", "LKNE", "LTIB")
    [error] = found(walks, 2, exchanged(walks[2], 70, 80, "LTHI", "LKNE", "LTIB"))
    mended, done = mend_errors(damaged, [replace(error, first_frame=0, last_frame=FRAMES - 1)])
    assert done == [] and mended is damaged


def test_hints_mend_nothing(walks: list[Recording]) -> None:
    [error] = found(walks, 2, exchanged(walks[2], 40, 60, "LTHI", "LKNE"))
    assert mend_errors(walks[2], [replace(error, kind="misplaced")]) == (walks[2], [])


@pytest.fixture
def folder(tmp_path: Path, walks: list[Recording]) -> Path:
    """Files of five people, of which one carries two exchanged labels, and a point that no model knows."""
    for number, (person, walk) in enumerate(zip(PEOPLE, walks, strict=True)):
        written = exchanged(walk, 40, 60, "LTHI", "LKNE") if number == 2 else walk
        extra = np.concatenate([written.positions, np.full((FRAMES, 1, 3), 0.5)], axis=1)
        (tmp_path / person).mkdir()
        formats.write(tmp_path / person / f"{person}.c3d", replace(written, positions=extra, labels=(*written.labels, "BOX")))
    return tmp_path


def test_the_command_writes_the_mended_file_only(folder: Path, walks: list[Recording], capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(folder / person / f"{person}.c3d") for person in PEOPLE]
    words = ["--markers", "helen-hayes", "-o", str(folder / "out"), "--json", str(folder / "mend.json")]
    assert main(["mend", *files, *words]) == 0
    assert [path.name for path in (folder / "out").iterdir()] == ["Cem.c3d"]
    shown = capsys.readouterr()
    assert "LTHI and LKNE exchanged for 21 frames" in shown.out and "Cem.c3d: mended" in shown.out
    said = json.loads((folder / "mend.json").read_text())
    assert len(said["errors"]) == 1 and said["left"] == [] and len(said["written"]) == 1
    before, after = asterism.read(files[2]), asterism.read(folder / "out" / "Cem.c3d")
    assert after.labels == before.labels and after.events == before.events
    assert [step.action for step in after.log] == ["mended"] and "LTHI and LKNE" in str(after.log[0])
    order = [after.labels.index(name) for name in walks[2].labels]
    np.testing.assert_allclose(after.positions[:, order], walks[2].positions, atol=1e-6)
    assert main(["mend", *files, *words, "--overwrite"]) == 0  # the same again


def test_clean_files_are_not_written(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clean = [str(folder / person / f"{person}.c3d") for person in PEOPLE if person != "Cem"]
    assert main(["mend", *clean, "-o", str(folder / "out")]) == 0
    assert not (folder / "out").exists() and "no error" in capsys.readouterr().out


def test_a_tree_is_mended_into_a_tree(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for person in PEOPLE:
        (folder / person / f"{person}.c3d").rename(folder / person / "walk.c3d")
    assert main(["mend", str(folder), "--markers", "helen-hayes", "-o", str(folder / "out")]) == 0
    assert [path.relative_to(folder / "out") for path in (folder / "out").rglob("*.c3d")] == [Path("Cem", "walk.c3d")]
    assert main(["mend", str(folder), "--markers", "helen-hayes", "-o", str(folder / "out")]) == 1
    assert "replace it with --overwrite" in capsys.readouterr().err
