"""Tables whose lines stand twice, or out of the order of their frames: the frames that are there, each once, and a word on it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from asterism import formats
from asterism.cli import main
from asterism.errors import AsterismError
from asterism.formats._tables import lines_in_order
from asterism.recording import Recording

NUMBER = 30


def walk() -> Recording:
    positions = np.random.default_rng(0).normal(1.0, 0.3, (NUMBER, 3, 3)).round(4)
    return Recording(positions, ("LKNE", "LTOE", "RKNE"), 50.0)


def written(path: Path) -> tuple[list[str], list[str]]:
    """A table, its header and its lines of frames."""
    formats.write(path, walk())
    lines = path.read_text(encoding="utf-8").splitlines()
    return lines[:-NUMBER], lines[-NUMBER:]


def orders(lines: list[str]) -> dict[str, list[str]]:
    return {
        "a part twice": lines[:20] + lines[10:],
        "each line twice": [line for line in lines for _ in range(2)],
        "backwards": lines[::-1],
        "the second half first": lines[15:] + lines[:15],
    }


@pytest.mark.parametrize("suffix", [".csv", ".trc", ".tsv", ".mot"])
@pytest.mark.parametrize("order", orders([]))
def test_each_frame_is_read_once_in_its_place(tmp_path: Path, suffix: str, order: str) -> None:
    path = tmp_path / f"walk{suffix}"
    head, lines = written(path)
    if suffix == ".mot" and order == "each line twice":
        pytest.skip("a table of times alone does not say that a time which stands twice is not two frames of a fast camera")
    path.write_text("\n".join([*head, *orders(lines)[order]]) + "\n", encoding="utf-8")
    read = formats.read(path, vertical="z")
    assert (read.rate, len(read)) == (50.0, NUMBER)
    np.testing.assert_allclose(read.positions, walk().positions, atol=1e-6)
    assert "format-frame-numbers" in {finding.code for finding in formats.describe(path)["findings"]}


def test_two_recordings_in_one_table_are_not_joined(tmp_path: Path) -> None:
    head, lines = written(tmp_path / "a.csv")
    other = [",".join([*line.split(",")[:2], *(f"{float(cell) + 1.0:.4f}" for cell in line.split(",")[2:])]) for line in lines]
    (tmp_path / "a.csv").write_text("\n".join([*head, *lines, *other]) + "\n", encoding="utf-8")
    read = formats.read(tmp_path / "a.csv", vertical="z")
    assert len(read) == 2 * NUMBER
    assert any("do not rise" in finding.sentence for finding in formats.describe(tmp_path / "a.csv")["findings"])


@given(st.lists(st.integers(0, 40), min_size=1, max_size=60))
def test_what_is_in_order_holds_each_number_once(numbers: list[int]) -> None:
    """Lines that are equal where their numbers are."""
    values = np.array(numbers, dtype=float)[:, None] * [1.0, 3.0]
    ordered, found = lines_in_order(values, values[:, 0])
    assert ordered[:, 0].tolist() == sorted(set(numbers))
    assert bool(found) == (numbers != sorted(set(numbers)))
    assert lines_in_order(ordered, ordered[:, 0])[1] == []


@pytest.mark.parametrize(("text", "said"), [
    ("frame,time,LKNE_x,LKNE_y,LKNE_z\n", "has no frame below its header"),
    ("frame,time,LKNE_x,LKNE_y,LKNE_z\n1,0,1,2,3\n2,0.5,1,2,3\n3,0.6,1,2,4\n4,2,1,2,5\n", "times are not even steps"),
    ("frame,LKNE_x,LKNE_y,LKNE_z\n1,1,2,3\n2,1,2,4\n", "add the rate to its header or a time column"),
])  # fmt: skip
def test_info_and_label_say_the_same_of_positions_without_a_rate(
    tmp_path: Path, text: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(AsterismError, match=said):
        formats.read(path)
    for words in (["info", str(path)], ["label", str(path), "-o", str(tmp_path / "out")]):
        assert main(words) == 2
        assert said in capsys.readouterr().err


def test_a_table_of_values_is_still_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "angles.csv").write_text("time,knee_angle_r,hip_flexion_r\n0,1,2\n0.5,2,3\n3,3,4\n", encoding="utf-8")
    assert main(["info", str(tmp_path / "angles.csv"), "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["files"][0]["format"] == "CSV table"
