"""Whole sequences: simulated cameras rendered to videos, folders and TIFFs, and what `asterism detect` makes of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import twins_detection

from asterism.cameras import Rig
from asterism.cameras.files import write_rig
from asterism.cli import main
from asterism.detection import BlobSettings, DetectionSettings, detect, find_blobs
from asterism.detection.alignment import common_rate
from asterism.detection.sources import Source
from asterism.errors import AsterismError
from asterism.findings import Finding
from asterism.formats import read_blobs
from asterism.recording import Blobs
from asterism.simulation.cameras import ImagingSettings, RenderSettings, render_images, ring_rig, simulate_wand
from asterism.synchronization import _sync_kernels, lags
from asterism.synchronization.lags import out_of_step, slips

pytestmark = pytest.mark.kernels

SIZE = (320, 256)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return ring_rig(cameras=3, size=SIZE, rng=np.random.default_rng(1))


@pytest.fixture(scope="module")
def waved(rig: Rig) -> Blobs:
    return wand(rig, np.zeros(3), 2)


def wand(rig: Rig, delays: np.ndarray, seed: int, frames: int = 40) -> Blobs:
    """A waved wand whose blobs are 6 px wide; cameras take their images so many s late."""
    rng = np.random.default_rng(seed)
    blobs, _ = simulate_wand(rig, settings=ImagingSettings(noise=0.0, merging=False, delays=delays), frames=frames, rng=rng, rate=50.0)
    return replace(blobs, sizes=np.full(len(blobs.xy), 6.0))


@pytest.fixture(scope="module")
def folders(waved: Blobs, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """One folder of PNGs for each camera, numbered 8, 9, 10, ..., and frame 20 of the second camera lost."""
    root = tmp_path_factory.mktemp("session")
    for c, name in enumerate(waved.cameras):
        (root / name).mkdir()
        for t, image in enumerate(render_images(waved, c, SIZE, rng=np.random.default_rng(c))):
            if (t, c) != (12, 1):
                cv2.imwrite(str(root / name / f"img_{t + 8}.png"), image)
    return [root / name for name in waved.cameras]


def misses(found: Blobs, truth: Blobs, shift: int = 0) -> np.ndarray:
    """How far each true blob that stands alone is from the nearest one found in its frame and camera, px."""
    out = []
    for t in range(len(truth) - shift):
        for c in range(len(truth.cameras)):
            xy, there = truth.of(t + shift, c), found.of(t, c)
            inside = ((xy > 8) & (xy < np.array(SIZE) - 8)).all(axis=1)
            if len(xy) > 1:
                apart = np.linalg.norm(xy[:, None] - xy[None], axis=2) + 1e9 * np.eye(len(xy))
                inside &= apart.min(axis=1) > 12
            for place in xy[inside]:
                out.append(np.linalg.norm(there - place, axis=1).min(initial=99.0))
    return np.array(out)


def test_a_folder_of_images_per_camera(folders: list[Path], waved: Blobs) -> None:
    result = detect(folders, workers=2)
    assert result.blobs.cameras == waved.cameras
    assert (len(result.blobs), result.blobs.first_frame) == (40, 8)
    assert result.blobs.counts[12, 1] == 0
    away = misses(result.blobs, waved)
    lost = away > 1
    assert lost.mean() < 0.03
    assert np.sqrt((away[~lost] ** 2).mean() / 2) < 0.05
    again = detect(folders)
    assert np.array_equal(result.blobs.xy, again.blobs.xy)
    assert result.findings == ()


def test_videos_agree_with_images(folders: list[Path], waved: Blobs, tmp_path: Path) -> None:
    for c, name in enumerate(waved.cameras):
        out = cv2.VideoWriter(str(tmp_path / f"{name}.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 50.0, SIZE)
        for image in render_images(waved, c, SIZE, rng=np.random.default_rng(c)):
            out.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
        out.release()
    result = detect([tmp_path / f"{name}.avi" for name in waved.cameras])
    assert result.blobs.rate == pytest.approx(50.0)
    away = misses(result.blobs, waved)
    assert (away > 1).mean() < 0.03
    assert np.median(away) < 0.1

    broken = tmp_path / "broken.avi"
    whole = (tmp_path / f"{waved.cameras[0]}.avi").read_bytes()
    broken.write_bytes(whole[: int(0.6 * len(whole))])
    result = detect([broken])
    assert 0 < result.cameras[0].frames < 40
    assert f"{result.cameras[0].frames} of 40 frames can be read" in result.findings[0].sentence


def test_pages_of_16_bits_and_series(waved: Blobs, tmp_path: Path) -> None:
    pages = list(render_images(waved, 0, SIZE, RenderSettings(bits=16), rng=np.random.default_rng(0)))[:10]
    cv2.imwritemulti(str(tmp_path / "cam.tif"), pages)
    for t, image in enumerate(pages):
        (tmp_path / f"shot.{t + 1}").write_bytes(cv2.imencode(".tif", image)[1].tobytes())
    by_pages, by_series = detect([tmp_path / "cam.tif"]).blobs, detect([tmp_path / "shot.%d"]).blobs
    assert len(by_pages) == len(by_series) == 10
    assert np.array_equal(by_pages.xy, by_series.xy)
    assert by_series.cameras == ("shot",)
    direct = find_blobs(pages[3], BlobSettings(threshold=detect([tmp_path / "cam.tif"]).cameras[0].threshold))
    assert set(map(tuple, by_pages.of(3, 0))) <= set(map(tuple, direct.xy))


def test_times_bring_cameras_to_a_common_clock(rig: Rig, tmp_path: Path) -> None:
    late = np.array([0.0, 0.008, 0.004])
    moved = wand(rig, late, 5)
    rows = ["camera,frame,time"]
    for c, name in enumerate(rig.names):
        (tmp_path / name).mkdir()
        for t, image in enumerate(render_images(moved, c, SIZE, rng=np.random.default_rng(c))):
            cv2.imwrite(str(tmp_path / name / f"{t}.png"), image)
            rows.append(f"{name},{t},{t / 50 + late[c]}")
    (tmp_path / "times.csv").write_text("\n".join(rows))
    result = detect([tmp_path / name for name in rig.names], DetectionSettings(times=tmp_path / "times.csv"))
    common = result.blobs
    assert common.times is not None and np.ptp(common.times, axis=1).max() == 0
    truth = wand(rig, np.full(3, late.mean()), 5)
    ours, raw = misses(common, truth)[10:-10], misses(detect([tmp_path / name for name in rig.names]).blobs, truth)[10:-10]
    assert np.median(ours) < 0.1
    assert np.median(ours) < 0.3 * np.median(raw)


def test_cameras_out_of_step_are_named(rig: Rig) -> None:
    blobs, _ = simulate_wand(
        ring_rig(cameras=4, rng=np.random.default_rng(3)),
        settings=ImagingSettings(noise=0.2, strays=0.2),
        frames=700,
        rng=np.random.default_rng(4),
        rate=60.0,
    )
    true = ring_rig(cameras=4, rng=np.random.default_rng(3))
    for offsets in ([0, 0, 0, 0], [0, 6, 0, 0]):
        frame = blobs.frame_of + np.array(offsets)[blobs.camera_of]
        kept = frame < len(blobs)
        moved = Blobs.from_rows(frame[kept], blobs.camera_of[kept], blobs.xy[kept], blobs.cameras, frames=len(blobs))
        assert lags(moved, true).tolist() == offsets
        told = lags(moved)
        assert np.nanmax(np.abs(told - offsets)) <= 1
        assert np.isfinite(told).sum() >= 3


def test_the_sentence_says_which_frames_belong_together() -> None:
    assert out_of_step("c2", 6)[0] == "camera c2 is 6 frames out of step: its frame 200 is the others' frame 194."
    assert out_of_step("c2", -1)[0] == "camera c2 is 1 frame out of step: its frame 200 is the others' frame 201."


def test_a_camera_that_loses_an_image_on_the_way_is_named(rig: Rig, tmp_path: Path) -> None:
    blobs = wand(rig, np.zeros(3), 6, frames=150)
    assert slips(blobs, rig).tolist() == [0, 0, 0]
    for c, name in enumerate(rig.names):
        video = cv2.VideoWriter(str(tmp_path / f"{name}.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 50.0, SIZE, isColor=False)
        for t, image in enumerate(render_images(blobs, c, SIZE, rng=np.random.default_rng(c))):
            if (c, t) != (1, 80):
                video.write(image)
        video.release()
    found = detect([tmp_path / f"{name}.avi" for name in rig.names], rig=rig)
    assert found.blobs.rate == 50 and not found.rate_assumed
    [lost] = [finding for finding in found.findings if finding.code == "detect-lost-images"]
    assert lost.sentence == "camera c2 lost 1 image on the way and is out of step from there on."
    assert np.isnan(slips(wand(rig, np.zeros(3), 6), rig)).all(), "40 frames are too few to tell"


@pytest.mark.parametrize("seed", range(5))
def test_blobs_on_epipolar_lines_are_counted_as_by_the_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, 6, 3 * 20)
    offsets = np.concatenate([[0], np.cumsum(counts)])
    given = (rng.normal(size=(offsets[-1], 2)), offsets, 3, 0, 2, np.arange(0, 20, 2), rng.normal(size=(3, 3)), 0.2, 12, 4, 3)
    scores = np.zeros(25)
    _sync_kernels.crossing(*given, scores)
    assert np.allclose(scores, twins_detection.crossing(*given), atol=1e-12, equal_nan=True)
    assert (scores > 0).any()


def test_cameras_some_hundred_frames_out_of_step_are_named() -> None:
    true = ring_rig(cameras=3, rng=np.random.default_rng(3))
    blobs, _ = simulate_wand(true, frames=800, rng=np.random.default_rng(4), rate=60.0)
    frame = blobs.frame_of + np.array([0, 200, 0])[blobs.camera_of]
    kept = frame < len(blobs)
    moved = Blobs.from_rows(frame[kept], blobs.camera_of[kept], blobs.xy[kept], blobs.cameras, frames=len(blobs))
    assert lags(moved, true).tolist() == [0, 200, 0]


def test_nothing_is_said_of_steps_where_nothing_moves() -> None:
    still = Blobs.from_rows(np.repeat(np.arange(500), 2), np.tile([0, 1], 500), np.tile([[50.0, 60.0], [80.0, 20.0]], (500, 1)), ["a", "b"])
    assert np.isnan(lags(still)).all()


def test_command_line(folders: list[Path], rig: Rig, waved: Blobs, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_rig(rig, tmp_path / "rig.toml")
    arguments = ["detect", *map(str, folders), "-o", str(tmp_path / "2d.csv"), "--rig", str(tmp_path / "rig.toml"), "--mask-static"]
    status = main([*arguments, "--json", str(tmp_path / "2d.json"), "--report", str(tmp_path / "page.html")])
    said = capsys.readouterr()
    assert status == 0, said.err
    assert said.err == ""
    assert "40 frames at 100 frames/s, which nothing says: give --rate;" in said.out
    blobs, told = read_blobs(tmp_path / "2d.csv"), json.loads((tmp_path / "2d.json").read_text())
    assert len(blobs.xy) == told["blobs"] == sum(camera["blobs"] for camera in told["cameras"])
    assert told["findings"] == []
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert page.count("data:image/jpeg;base64") == 3
    capsys.readouterr()
    assert main([*arguments, "--overwrite", "--threshold", "40,50,250"]) == 1
    assert f"camera {waved.cameras[2]}: no marker in 40 images at a threshold of 250" in capsys.readouterr().err
    assert read_blobs(tmp_path / "2d.csv").counts.sum(axis=0)[2] == 0
    assert main([*arguments, "--overwrite", "--threshold", "a"]) == 2
    capsys.readouterr()
    assert main(arguments) == 2
    assert "--overwrite" in capsys.readouterr().err


def test_a_lost_image_leaves_with_one(folders: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "cam").mkdir()
    for file in sorted(folders[0].iterdir())[:6]:
        (tmp_path / "cam" / file.name).write_bytes(file.read_bytes())
    spoilt = sorted((tmp_path / "cam").iterdir())[2]
    spoilt.write_bytes(spoilt.read_bytes()[:60])
    assert main(["detect", str(tmp_path / "cam"), "-o", str(tmp_path / "2d.csv")]) == 1
    assert "1 of 6 images cannot be read" in capsys.readouterr().err
    assert read_blobs(tmp_path / "2d.csv").cameras == ("cam",)


def test_hostile_sequences(folders: list[Path], rig: Rig, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.mp4").write_text("no video")
    (tmp_path / "nothing.png").write_bytes(b"")
    (tmp_path / "cut.png").write_bytes(next(folders[0].iterdir()).read_bytes()[:50])
    (tmp_path / "mixed").mkdir()
    for i, wide in enumerate((20, 30)):
        cv2.imwrite(str(tmp_path / "mixed" / f"{i}.png"), np.zeros((20, wide), np.uint8))
    bare = "camera,frame,time\n"
    hours = {"none.csv": "", "names.csv": "a,b\n1,2\n", "word.csv": bare + "a,b,c\n", "few.csv": bare + f"{folders[0].name},0,0.5\n"}
    for name, text in hours.items():
        (tmp_path / name).write_text(text)
    other = ring_rig(cameras=3, size=(640, 480), rng=np.random.default_rng(1))
    for paths, given, message in [
        ([tmp_path / "empty"], {}, "holds no images"),
        ([tmp_path / "gone"], {}, "does not exist"),
        ([tmp_path / "none.%d"], {}, "no image of that name"),
        ([tmp_path / "text.mp4"], {}, "cannot be opened as an image or a video"),
        ([tmp_path / "nothing.png"], {}, "none of its images"),
        ([tmp_path / "cut.png"], {}, "none of its images"),
        ([tmp_path / "mixed"], {}, "30 x 20 after images of 20 x 20"),
        ([folders[0], folders[0]], {}, "its own"),
        ([], {}, "no camera"),
        (folders, {"thresholds": [30, 40]}, "2 thresholds for 3 cameras"),
        (folders, {"rig": other}, "the rig says 640 x 480"),
        ([tmp_path / "mixed"], {"rig": rig}, "no camera mixed"),
        (folders[:1], {"times": tmp_path / "none.csv"}, "none.csv is empty"),
        (folders[:1], {"times": tmp_path / "names.csv"}, "no column"),
        (folders[:1], {"times": tmp_path / "word.csv"}, "line 2"),
        (folders[:1], {"times": tmp_path / "gone.csv"}, "gone.csv"),
        (folders[:1], {"times": tmp_path / "few.csv"}, "1 times"),
        (folders[1:2], {"times": tmp_path / "few.csv"}, "no times of camera"),
    ]:
        options = dict(given)
        of_rig = options.pop("rig", None)
        with pytest.raises(AsterismError, match=message):
            detect(paths, DetectionSettings(**options), rig=of_rig)


@pytest.mark.slow
def test_real_videos_and_their_times(data: Path) -> None:
    folder = data / "cameras" / "charuco-4cam"
    result = detect(
        [folder / f"cam_{c}.mp4" for c in range(2)], DetectionSettings(BlobSettings(threshold=250), times=folder / "timestamps.csv")
    )
    assert (len(result.blobs), result.blobs.first_frame) == (111, 26)
    assert result.blobs.rate == pytest.approx(6.0, abs=0.1)
    assert all(camera.frames == 111 and camera.size == (1280, 720) for camera in result.cameras)


@pytest.mark.parametrize(
    ("rates", "frames", "apart"),
    [
        ((30.0, 29.97), 3600, "3.6 frames apart"),
        ((30.0, 29.97), 400, ""),
        ((30000 / 1001, 29.97), 100_000, ""),
        ((25.0, 30.0), 12, "2.4 frames apart"),
        ((30.0, 29.97, float("nan")), 3600, "3.6 frames apart"),
    ],
)
def test_rates_of_videos_are_held_against_their_length(rates: tuple[float, ...], frames: int, apart: str) -> None:
    sources = [Source(Path(f"{c}.mp4"), str(c), "video", np.arange(frames), rate=rate) for c, rate in enumerate(rates)]
    findings: list[Finding] = []
    common_rate(sources, None, None, [source.name for source in sources], findings)
    assert [apart in finding.sentence for finding in findings] == ([True] if apart else [])
