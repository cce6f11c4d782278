"""`asterism info` on points without names: what a raw file has, and why its unit and vertical were believed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from correcting import recorded, walks

import asterism
from asterism.cli import main
from asterism.recording import Clouds, Recording


def shown(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """What `asterism info` prints."""
    main(["info", *map(str, words)])
    return capsys.readouterr().out


def facts(capsys: pytest.CaptureFixture[str], path: Path) -> tuple[dict[str, str], dict[str, Any]]:
    """The rows of a file as text, and its JSON."""
    kept = path.with_suffix(".json")
    rows = dict(line.strip().split("  ", 1) for line in shown(capsys, path, "--json", kept).splitlines()[1:] if "  " in line.strip())
    (content,) = json.loads(kept.read_text())["files"]
    return {name: text.strip() for name, text in rows.items()}, content


def raw() -> Recording:
    return recorded(walks()[4], hidden=2, ghosts=1)[0]


def test_a_raw_file_shows_its_points_pieces_and_people(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = raw()
    asterism.write(tmp_path / "raw.c3d", recording)
    rows, content = facts(capsys, tmp_path / "raw.c3d")
    counts = recording.visible.sum(axis=1)
    lengths = recording.visible.sum(axis=0)
    assert content["points_per_frame"] == {"fewest": counts.min(), "median": np.median(counts), "most": counts.max()}
    assert content["pieces"]["number"] == len(lengths) and content["pieces"]["median_frames"] == np.median(lengths)
    assert content["pieces"]["median_seconds"] == pytest.approx(np.median(lengths) / recording.rate)
    height = recording.positions[:, :, 2]
    usual = [np.median(np.nanmin(height, axis=1)), np.median(np.nanmax(height, axis=1))]
    np.testing.assert_allclose(content["heights"], usual, atol=1e-3)
    (person,) = content["people"]
    assert person["name"] == "helen-hayes" and rows["people"] == f"1: {person['words']}"
    assert rows["points per frame"].startswith(f"{np.median(counts):g} in a usual frame")
    # shares of named markers would read as if nothing were missing
    assert "gaps" not in rows and "missing" not in rows


def test_two_people_are_two(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, other = walks()[4].positions, walks()[3].positions + np.array([0.0, 2.0, 0.0])
    both = [np.concatenate(frame) for frame in zip(one, other, strict=True)]
    asterism.write(tmp_path / "two.npz", Clouds.from_points([*both, np.zeros((0, 3))], rate=100.0, vertical="z"))
    rows, content = facts(capsys, tmp_path / "two.npz")
    assert len(content["people"]) == 2 and rows["people"].startswith("2: helen-hayes")
    assert content["empty_frames"] == 1 and rows["points per frame"].endswith("1 frame without a point")


def test_points_that_are_no_body_are_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    still = np.tile(np.random.default_rng(1).uniform(0.0, 2.0, (5, 3)), (40, 1, 1))
    asterism.write(tmp_path / "few.npz", Clouds.from_points(list(still), rate=100.0, vertical="z"))
    rows, content = facts(capsys, tmp_path / "few.npz")
    assert content["people"] == [] and rows["people"].startswith("none found: it has no frame with 8 points")


def test_why_unit_and_vertical_were_believed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asterism.write(tmp_path / "said.c3d", replace(raw(), labels=tuple(f"*{m}" for m in range(len(raw().labels)))))
    rows, _ = facts(capsys, tmp_path / "said.c3d")
    assert rows["units"] == "mm (the file says so)" and rows["vertical"] == "0, 0, 1 (the file says so)"
    lines = ["# rate=100", "frame,time,marker,x,y,z"]
    for t, frame in enumerate(walks()[4].positions[:40]):
        lines += [f"{t + 1},{t / 100},*{m + 1},{x:.4f},{y:.4f},{z:.4f}" for m, (x, y, z) in enumerate(frame)]
    (tmp_path / "unsaid.csv").write_text("\n".join(lines) + "\n")
    rows, content = facts(capsys, tmp_path / "unsaid.csv")
    assert rows["units"] == "m (it fits the size of the body)" and content["units_from"] == "data"
    assert rows["vertical"] == "0, 0, 1 (its points show it)"


def test_a_file_whose_points_all_have_names_is_shown_as_before(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asterism.write(tmp_path / "named.c3d", walks()[4])
    rows, content = facts(capsys, tmp_path / "named.c3d")
    assert "people" not in content and "points per frame" not in rows and rows["gaps"] == "0"
