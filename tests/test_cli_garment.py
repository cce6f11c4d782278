"""`asterism garment calibrate` and `capture` on rendered pictures: what they write, and what they say about bad input."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from garment_scenes import arm_rig, coded, photos, sleeve, true_positions

import asterism
from asterism.cameras.files import read_rig, write_rig
from asterism.cli import main
from asterism.garment import Piece
from asterism.garment.dense import DenseTrajectories
from asterism.garment.rig_covariance import RigCovariance
from asterism.simulation import compare_rigs
from asterism.simulation.garment import PhotoSettings, Wearer, photograph, sheet_of, suit_masks
from asterism.simulation.garment.target import wave_target

POSES = 10


def run(*words: object) -> int:
    return main([str(word) for word in words])


def write_images(folder: Path, images: list[list[np.ndarray | None]]) -> Path:
    for t, moment in enumerate(images):
        for camera, image in zip(arm_rig(), moment, strict=True):
            (folder / camera.name).mkdir(parents=True, exist_ok=True)
            if image is not None:
                cv2.imwrite(str(folder / camera.name / f"{t:03d}.png"), image)
    return folder


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two moments of a sleeve, its pattern and the rig."""
    folder = tmp_path_factory.mktemp("garment")
    write_images(folder / "walk", [[photo.image for photo in photos()], [photo.image for photo in photos(seed=1)]])
    sleeve().pattern.save(folder / "suit.toml")
    write_rig(arm_rig(), folder / "rig.toml")
    return folder


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures of a small waved target: rendering them takes five seconds."""
    folder = tmp_path_factory.mktemp("target")
    pattern = coded(np.ones((7, 9), dtype=bool), (Piece("sheet", 0, 0, 7, 9),), seed=3, pitch=0.030, diameter=0.017)
    pattern.save(folder / "target.toml")
    scene = wave_target(pattern, arm_rig(), POSES, reach=0.1, rng=np.random.default_rng(4))
    settings = PhotoSettings(clutter=2, noise=0.005, ambient=(0.6, 0.6, 0.6), samples=2)
    rng = np.random.default_rng(5)
    images = [[photograph(scene, camera, float(t), settings, rng=rng).image for camera in arm_rig()] for t in range(POSES)]
    write_images(folder / "images", images)
    return folder


def test_a_capture_is_written(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [tmp_path / name for name in ("dense.npz", "out.json", "report.html", "surfaces")]
    words = ["garment", "capture", place / "walk", "--rig", place / "rig.toml", "--garment", place / "suit.toml", "-o", files[0]]
    assert run(*words, "--json", files[1], "--report", files[2], "--surfaces", files[3], "--rate", 25, "--workers", 2) == 0
    shown = capsys.readouterr()
    assert "2 frames" in shown.out and "c3" in shown.out
    found, told = DenseTrajectories.load(files[0]), json.loads(files[1].read_text())
    true = true_positions(sleeve())
    off = np.linalg.norm(found.positions - np.array([true[i] for i in found.ids.tolist()]), axis=2)
    assert np.sqrt(np.nanmean(off**2)) < 0.0005 and len(found.ids) > 60
    assert told["frames"] == 2 and told["points_per_frame"] > 60 and told["findings"] == []
    assert asterism.read(files[0]).rate == 25
    assert sorted(path.name for path in files[3].iterdir()) == ["000000.ply", "000001.ply"]
    assert "Which circles were captured" in files[2].read_text()
    assert run(*words) == 2 and "--overwrite" in capsys.readouterr().err


def test_a_rig_is_calibrated(target: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [tmp_path / name for name in ("rig.toml", "out.json", "rig.html", "covariance.npz")]
    words = ["garment", "calibrate", target / "images", "--target", target / "target.toml", "-o", files[0]]
    status = run(*words, "--json", files[1], "--report", files[2], "--covariance", files[3])
    told = json.loads(files[1].read_text())
    assert status in (0, 1) and told["usable"] and told["reprojection_rms_px"] < 0.2, told
    assert compare_rigs(read_rig(files[0]), arm_rig()).position.max() < 0.003
    covariance = RigCovariance.load(files[3])
    assert covariance.names == ("c1", "c2", "c3") and len(covariance.matrix) == covariance.free.sum() > 30
    assert files[2].exists() and "c2" in capsys.readouterr().out
    known = tmp_path / "known.toml"
    write_rig(arm_rig(), known)
    assert run(*words[:-1], tmp_path / "posed.toml", "--rig", known, "--origin", 0, "--every", 2) in (0, 1)
    assert read_rig(tmp_path / "posed.toml")["c1"].focal == arm_rig()["c1"].focal
    capsys.readouterr()


@pytest.mark.parametrize(
    "what", ["another garment", "black and white", "another size", "dark", "no such camera", "damaged lookup", "a whole suit"]
)
def test_bad_input_is_one_sentence(what: str, place: Path, target: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images, rig, suit = place / "walk", place / "rig.toml", place / "suit.toml"
    first = [photo.image for photo in photos()]
    said = {
        "another garment": "does not show this garment",
        "black and white": "does not show this garment",
        "another size": "c1 are 320 x 240, the rig was calibrated for 640 x 480",
        "dark": "no circle of this garment",
        "no such camera": "the rig has a camera c9",
        "damaged lookup": "suit",
        "a whole suit": "not a calibration target",
    }[what]
    if what == "another garment":
        pattern = sleeve().pattern
        other = coded(pattern.colours >= 0, pattern.pieces, seed=9)
        suit = other.save(tmp_path / "other.toml")
    elif what == "black and white":
        images = write_images(tmp_path / "grey", [[np.repeat(cv2.cvtColor(i, cv2.COLOR_BGR2GRAY)[..., None], 3, axis=2) for i in first]])
    elif what == "another size":
        images = write_images(tmp_path / "small", [[cv2.resize(image, (320, 240)) for image in first]])
    elif what == "dark":
        images = write_images(tmp_path / "dark", [[np.zeros_like(image) for image in first]])
    elif what == "no such camera":
        rig = tmp_path / "more.toml"
        write_rig(replace(arm_rig(), cameras=(*arm_rig().cameras, replace(arm_rig().cameras[0], name="c9"))), rig)
    elif what == "damaged lookup":
        suit = tmp_path / "suit.toml"
        suit.write_bytes((place / "suit.toml").read_bytes())
        (tmp_path / "suit.npz").write_bytes((place / "suit.npz").read_bytes()[:300])
    output = tmp_path / "none.npz"
    if what == "a whole suit":
        suit = coded(*sheet_of(suit_masks(Wearer(parts=("left arm", "right arm"))))).save(tmp_path / "two.toml")
        status = run("garment", "calibrate", target / "images", "--target", suit, "-o", output)
    else:
        status = run("garment", "capture", images, "--rig", rig, "--garment", suit, "-o", output)
    told = capsys.readouterr().err
    assert status == 2 and said in told, told
    assert not output.exists() and "Traceback" not in told


def test_a_view_that_breaks_off_is_named(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One camera has no images of the second moment, and another's file is no image: the capture goes on with the rest."""
    images = write_images(tmp_path / "walk", [[photo.image for photo in photos()], [photos()[0].image, photos()[1].image, None]])
    (images / "c1" / "001.png").write_bytes(b"no image")
    output = tmp_path / "dense.npz"
    status = run("garment", "capture", images, "--rig", place / "rig.toml", "--garment", place / "suit.toml", "-o", output)
    told = capsys.readouterr().err
    assert status == 1 and "001.png cannot be read as an image" in told and told.count("001.png") == 1
    found = DenseTrajectories.load(output)
    assert np.isfinite(found.positions[0, :, 0]).sum() > 60 and not np.isfinite(found.positions[1, :, 0]).any()


def test_a_size_that_no_sheet_has_is_refused_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """10,000 million circles took all memory before they were counted."""
    assert run("garment", "print", "--rows", 100_000, "--cols", 100_000, "-o", tmp_path / "suit.svg") == 2
    assert "9999" in capsys.readouterr().err
