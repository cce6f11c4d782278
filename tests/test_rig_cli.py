"""`asterism rig report` and `asterism rig plan`: tables, pages, JSON, exit status, and what they say of bad input."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from asterism.cameras import Rig
from asterism.cameras.aim import looking
from asterism.cameras.files import read_rig, write_rig
from asterism.cli import main
from asterism.formats import write_blobs
from asterism.simulation.cameras import ImagingSettings, ring_rig, simulate_blobs, simulate_wand


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """ring.toml, and its wand.csv and still.csv; idle.toml, whose camera c2 looks away; one.toml with a single camera."""
    place = tmp_path_factory.mktemp("rigs")
    rig = ring_rig(5, rng=np.random.default_rng(0))
    write_rig(rig, place / "ring.toml")
    write_blobs(simulate_wand(rig, frames=300, rate=30, rng=np.random.default_rng(1))[0], place / "wand.csv")
    still = np.tile([[0.2, 0.3, 0.02], [-0.5, 0.1, 0.9]], (100, 1, 1))
    write_blobs(simulate_blobs(rig, still, ImagingSettings(noise=0.2), rng=np.random.default_rng(2))[0], place / "still.csv")
    rotation, translation = looking(rig[1].position, 3 * rig[1].position)
    away = replace(rig[1], rotation=rotation, translation=translation)
    write_rig(replace(rig, cameras=(rig[0], away, *rig.cameras[2:])), place / "idle.toml")
    write_rig(Rig(rig.cameras[:1]), place / "one.toml")
    return place


def run(*words: object) -> int:
    return main([str(word) for word in words])


def test_a_report_says_what_a_rig_measures(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, told = tmp_path / "rig.html", tmp_path / "rig.json"
    words = ["--volume", "2x2x2", "--noise", "0.2", "--blobs", folder / "wand.csv", "--wand", "0", "0.2", "0.6"]
    assert run("rig", "report", folder / "ring.toml", *words, "--still", folder / "still.csv", "-o", page, "--json", told) == 0
    shown = capsys.readouterr()
    assert "5 cameras" in shown.out
    assert "Wand, " in shown.out
    assert "Still markers" in shown.out
    assert shown.err == ""
    content = json.loads(told.read_text())
    assert content["map"]["volume_m"] == [[-1, -1, 0], [1, 1, 2]]
    assert content["map"]["coverage"]["3"] > 0.9
    assert content["map"]["noise_px"] == 0.2
    assert len(content["cameras"]) == 5
    assert len(content["pairs"]) == 10
    assert len(content["pairs"][0]["scalars_m"]["x"]) == 4
    assert content["idle"] == []
    # 0.2 px noise at 4 m and 1,100 px: 0.7 mm per ray
    assert abs(content["wand"]["mean_error"]) < 0.0002
    assert 0.0002 < content["wand"]["mean_absolute"] < 0.001
    assert len(content["repeatability_m"]) == 2
    assert 0.0003 < min(content["repeatability_m"]) <= max(content["repeatability_m"]) < 0.0012
    html = page.read_text(encoding="utf-8")
    assert all(camera.name in html for camera in read_rig(folder / "ring.toml"))
    assert "Accuracy against the wand" in html
    assert "Repeatability" in html


def test_a_camera_that_looks_away_is_named(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("rig", "report", folder / "idle.toml", "--volume", "2x2x2") == 1
    assert "camera c2 sees next to nothing" in capsys.readouterr().err


def test_a_rig_without_a_vertical_says_which_was_taken(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_rig(replace(read_rig(folder / "ring.toml"), vertical=None), tmp_path / "up.toml")
    assert run("rig", "report", tmp_path / "up.toml", "--volume", "2x2x2") == 0
    assert "which way is up: z was taken" in capsys.readouterr().err


def test_a_volume_that_one_camera_sees_cannot_be_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left, right = ring_rig(2, rng=np.random.default_rng(0))
    rotation, translation = looking(right.position, 3 * right.position)
    write_rig(Rig((left, replace(right, rotation=rotation, translation=translation)), np.array([0.0, 0.0, 1.0])), tmp_path / "two.toml")
    assert run("rig", "report", tmp_path / "two.toml", "--volume", "1x1x1") == 1
    assert "no place of the volume can be measured" in capsys.readouterr().err


def test_image_sizes_that_a_rig_lacks_can_be_given(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = read_rig(folder / "ring.toml")
    path = tmp_path / "sizeless.toml"
    write_rig(replace(rig, cameras=tuple(replace(camera, size=None) for camera in rig), lacks=("image sizes",)), path)
    assert run("rig", "report", path, "--volume", "2x2x2") == 2
    assert "--image-size" in capsys.readouterr().err
    assert run("rig", "report", path, "--volume", "2x2x2", "--image-size", "1280x1024") == 0
    sized = capsys.readouterr().out
    assert "not in the file" in sized
    assert "image sizes" in sized


def test_a_plan_is_a_rig_file_and_a_comparison(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made, page, told = tmp_path / "rig.toml", tmp_path / "plan.html", tmp_path / "plan.json"
    words = ["--volume", "3x2x2", "--cameras", 3, "--focal-mm", 5.5, "--pixel-um", 4.8, "--room", "6x5x3", "--heights", "1.5:2.5"]
    assert run("rig", "plan", *words, "-o", made, "--report", page, "--json", told) == 0
    shown = capsys.readouterr()
    assert "tilted down" in shown.out
    rig = read_rig(made)
    assert len(rig) == 3
    assert all(1.5 - 1e-9 <= camera.position[2] <= 2.5 + 1e-9 for camera in rig)
    assert np.isclose(rig[0].focal[0], 5500 / 4.8)
    content = json.loads(told.read_text())
    assert content["worth"] >= content["ring"]["worth"]
    assert "Against the plain ring" in page.read_text(encoding="utf-8")
    assert run("rig", "report", made, "--volume", "3x2x2", "--json", "-") == 0
    again = json.loads(capsys.readouterr().out)
    assert np.isclose(again["map"]["error_median_m"], content["map"]["error_median_m"])
    assert run("rig", "plan", *words, "-o", made) == 2, "an existing rig is not overwritten"


PLAN = ["plan", "--volume", "3x2x2", "--cameras", "3", "-o", "{}/new.toml"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["report", "{}/nowhere.toml"], "nowhere.toml"),
        (["report", "{}/one.toml", "--volume", "2x2x2"], "at least two"),
        (["report", "{}/ring.toml", "--volume", "2x2"], "volume '2x2'"),
        (["report", "{}/ring.toml", "--noise", "0"], "noise"),
        (["report", "{}/ring.toml", "--blobs", "{}/wand.csv"], "--wand"),
        (["report", "{}/ring.toml", "--blobs", "{}/wand.csv", "--wand", "0,200,600"], "millimetres"),
        (["report", "{}/ring.toml", "--blobs", "{}/wand.csv", "--wand", "long"], "--wand long"),
        (["report", "{}/ring.toml", "--still", "{}/wand.csv"], "stands still"),
        (PLAN, "--fov"),
        ([*PLAN, "--fov", "60", "--cameras", "1"], "cameras"),
        ([*PLAN, "--fov", "60", "--image-size", "large"], "--image-size large"),
        ([*PLAN, "--fov", "60", "--heights", "2"], "--heights 2"),
        ([*PLAN, "--fov", "60", "--room", "2x2x2"], "room"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_input_leaves_with_2_and_one_sentence(words: list[str], said: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("rig", *(word.format(folder) for word in words)) == 2
    shown = capsys.readouterr()
    assert shown.err.count("\n") == 1
    assert said in shown.err
    assert not (folder / "new.toml").exists()
