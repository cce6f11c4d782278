"""`tools/merge_rows.py`: figures of two sessions, merged row by row."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tools.merge_rows import main, merge

A, B, C = ({"chapter": "dirt", "row": name, "measured": 1.0} for name in "abc")


def changed(row: dict[str, object]) -> dict[str, object]:
    return {**row, "measured": 2.0}


@pytest.mark.parametrize(
    ("ours", "theirs", "expected"),
    [
        ([changed(A), B], [A, changed(B)], [changed(A), changed(B)]),
        ([A, B, C], [B], [B, C]),
        ([B], [A, B, C], [B, C]),
        ([A, B], [A, B], [A, B]),
    ],
)
def test_a_change_of_one_side_is_taken(ours: list[dict[str, object]], theirs: list[dict[str, object]], expected: object) -> None:
    assert merge([A, B], ours, theirs) == (expected, [])


def test_a_row_that_both_sides_changed_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [tmp_path / name for name in ("base", "ours", "theirs")]
    for path, rows in zip(paths, ([A], [changed(A)], [{**A, "measured": 3.0}]), strict=True):
        path.write_text(json.dumps(rows), encoding="utf-8")
    assert main(*map(str, paths)) == 1
    assert json.loads(paths[1].read_text(encoding="utf-8")) == [changed(A)]
    assert "dirt a" in capsys.readouterr().err
