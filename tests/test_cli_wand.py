"""`asterism calibrate wand` as a user drives it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from cold_starts import few_starts

from asterism.cameras import Rig
from asterism.cameras.files import read_rig, write_rig
from asterism.cli import main
from asterism.formats import write_blobs
from asterism.simulation.cameras import ImagingSettings, ring_rig, simulate_blobs, simulate_wand


@pytest.fixture(autouse=True)
def _few_starts() -> Iterator[None]:
    with few_starts():
        yield


def run(*args: object) -> int:
    return main([str(arg) for arg in args])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """wand.csv of four cameras, floor.csv of an L-frame, lenses.toml, dark.csv in which camera c3 saw nothing."""
    place = tmp_path_factory.mktemp("wand")
    rig = ring_rig(4, rng=np.random.default_rng(1))
    blobs, _ = simulate_wand(rig, settings=ImagingSettings(noise=0.2, outliers=0.01), frames=250, rng=np.random.default_rng(2), rate=20.0)
    write_blobs(blobs, place / "wand.csv")
    lines = (place / "wand.csv").read_text(encoding="utf-8").splitlines()
    kept = [line for line in lines if not line.startswith("#") and ",c3," not in line]
    (place / "dark.csv").write_text("\n".join([*kept, "0,c3,,,"]) + "\n", encoding="utf-8")
    frame = np.array([[0.0, 0, 0], [0.2, 0, 0], [0.6, 0, 0], [0, 0.4, 0]])
    write_blobs(
        simulate_blobs(rig, np.tile(frame, (10, 1, 1)), ImagingSettings(noise=0.2), rng=np.random.default_rng(3))[0], place / "floor.csv"
    )
    rows = ["point,camera,x,y"]
    for name, point in zip(["origin", "x", "y"], frame[[0, 2, 3]], strict=True):
        rows += [f"{name},{camera.name},{x},{y}" for camera in rig for x, y in [camera.project(point)]]
    (place / "points.csv").write_text("\n".join(rows), encoding="utf-8")
    write_rig(rig, place / "lenses.toml")
    return place


def places_miss(found: Rig, truth: Rig) -> float:
    return max(float(np.linalg.norm(camera.position - truth[camera.name].position)) for camera in found)


def test_from_2d_points_to_a_rig_on_an_l_frame(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = [tmp_path / name for name in ("rig.toml", "report.html", "told.json")]
    wand = ["calibrate", "wand", folder / "wand.csv", "--wand", "0.0", "0.2", "0.6", "--image-size", "1280x1024"]
    world = ["--floor", folder / "floor.csv", "--l-frame", "0,0 0.2,0 0.6,0 0,0.4"]
    assert run(*wand, *world, "-o", out[0], "--report", out[1], "--json", out[2]) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    assert "reprojection error 0.2" in shown.out
    assert "give --wand" not in shown.out
    told = json.loads(out[2].read_text(encoding="utf-8"))
    assert {"frames", "frames_used", "wand_length_mean_m", "wand_length_std_m", "reprojection_rms_px", "cameras"} <= set(told)
    assert told["wand_length_mean_m"] == pytest.approx(0.6, abs=3e-4)
    rig = read_rig(out[0])
    assert places_miss(rig, read_rig(folder / "lenses.toml")) < 0.01
    assert rig.metadata["world"] == "the L-frame of floor.csv"
    page = out[1].read_text(encoding="utf-8")
    assert "This calibration can be used" in page and all(camera.name in page for camera in rig)


def test_known_lenses_and_three_points(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "rig.toml"
    assert run("calibrate", "wand", folder / "wand.csv", "--rig", folder / "lenses.toml", "--points", folder / "points.csv", "-o", out) == 0
    assert places_miss(read_rig(out), read_rig(folder / "lenses.toml")) < 0.01


def test_a_dark_camera_is_named(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "rig.toml"
    assert run("calibrate", "wand", folder / "dark.csv", "--image-size", "1280x1024", "-o", out) == 1
    said = capsys.readouterr()
    assert "camera c3 is not in the rig: it saw nothing" in said.err
    assert "taken to be at 0 0.2 0.6 m; where yours are not, give --wand" in said.out
    assert read_rig(out).names == ("c1", "c2", "c4")


def test_a_calibration_that_should_not_be_used_is_not_written(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "rig.toml"
    wrong = ["calibrate", "wand", folder / "wand.csv", "--image-size", "1280x1024", "--wand", "0", "0.23", "0.6", "-o", out]
    assert run(*wrong) == 2
    assert not out.exists()
    said = capsys.readouterr().err
    assert ("inner marker sits 20" in said or "inner marker sits 19" in said) and "do not use this" in said
    assert run(*wrong, "--anyway") == 1
    assert read_rig(out).metadata["usable"] is False


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--wand", "0", "200", "600", "--image-size", "1280x1024"], "millimetres"),
        (["--wand", "long", "--image-size", "1280x1024"], "--wand long"),
        (["--image-size", "1280"], "--image-size 1280"),
        (["--image-size", "c9=1280x1024"], "no camera c9"),
        ([], "size of its images"),
        (["--l-frame", "0,0 1,0 0,1"], "--floor"),
        (["--image-size", "1280x1024", "--distance", "c1"], "--distance c1"),
    ],
)
def test_refusals_are_one_sentence(folder: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str) -> None:
    assert run("calibrate", "wand", folder / "wand.csv", *words) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
