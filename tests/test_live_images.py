"""Images one after the other: the blobs that the whole recording gives off line, in processes that end with the one that began them."""

from __future__ import annotations

import math
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from asterism import AsterismError
from asterism.cameras.files import read_rig, write_rig
from asterism.cli import main
from asterism.detection import BlobSettings, DetectionSettings, RunningDetection, detect
from asterism.detection.running import MOST_BLOBS
from asterism.files.toml import read_toml
from asterism.live import Health, session_findings
from asterism.live.blobs import RigSource
from asterism.live.camera_frames import LiveBlobs, LiveImage
from asterism.live.cameras import CameraHealth, CameraSpec, LiveCamera, load_cameras
from asterism.live.cameras.reopening import ReopeningCamera
from asterism.live.cameras.simulated import SimulatedCamera
from asterism.live.frames import LiveFrame, SourceEnded
from asterism.live.images import CameraWorkers, WorkerSettings, videos_together
from asterism.reconstruction import reconstruct
from asterism.simulation.cameras import ImagingSettings, render_images, ring_rig, simulate_wand

SIZE = (320, 240)
PATIENCE = 60.0
"""s after which a test gives up, on a machine as busy as it may be."""


def scene(number: int, dark: float = 20.0, slope: float = 0.0, dots: int = 8, seed: int = 0) -> np.ndarray:
    """Markers on their way before a dark ground with noise; slope: grey values that the ground grows by from left to right."""
    rng = np.random.default_rng((seed, number))
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    image = dark + slope * x / SIZE[0] + rng.normal(0, 2.0, x.shape)
    for dot in range(dots):
        at = (40 + 30 * dot + 12 * np.sin(0.2 * number + dot), 120 + 80 * np.sin(0.11 * number + 2.0 * dot))
        image += 170 * np.exp(-0.5 * ((x - at[0]) ** 2 + (y - at[1]) ** 2) / 2.0**2)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def saved(folder: Path, images: list[np.ndarray]) -> Path:
    folder.mkdir(parents=True)
    for number, image in enumerate(images):
        cv2.imwrite(str(folder / f"{number:04d}.png"), image)
    return folder


def read_all(workers: CameraWorkers) -> list[LiveBlobs]:
    out, until = [], time.monotonic() + PATIENCE
    with suppress(SourceEnded):
        while time.monotonic() < until:
            blobs = workers.read(0.1)
            out += [] if blobs is None else [blobs]
    return out


def until(workers: CameraWorkers, happened: Callable[[], object]) -> list[LiveBlobs]:
    """What is read until something has happened."""
    out, end = [], time.monotonic() + PATIENCE
    while not happened():
        assert time.monotonic() < end, workers.healths()
        blobs = workers.read(0.05)
        out += [] if blobs is None else [blobs]
    return out


@dataclass(frozen=True)
class Odd:
    """A camera that another process makes: its images change their size, or its driver takes the process with it."""

    name: str
    how: str = ""

    def ready(self) -> LiveCamera:
        return ReopeningCamera(partial(_Odd, self.name, self.how))


class _Odd(SimulatedCamera):
    def __init__(self, name: str, how: str) -> None:
        super().__init__(name, "simulated://?size=160x120&dots=3")
        self.how = how

    def read(self, timeout: float) -> LiveImage | None:
        image = super().read(timeout)
        if image is None or image.number < 20 or (self.how and image.number > 40):
            return image
        if self.how == "dies":
            os._exit(3)
        if self.how == "hangs":
            threading.Event().wait()
        if self.how == "fails":
            raise RuntimeError("the driver has a fault")
        return LiveImage(image.camera, image.number, image.time, image.arrived, image.image[:60].copy())


def health_of(workers: CameraWorkers, name: str) -> CameraHealth:
    return next(health for health in workers.healths() if health.camera == name)


@pytest.mark.parametrize("how", ["dark", "uneven", "colour"])
def test_one_image_at_a_time_gives_the_blobs_of_the_whole_recording(tmp_path: Path, how: str) -> None:
    images = [scene(number, slope=80.0 if how == "uneven" else 0.0) for number in range(60)]
    if how == "colour":
        # What is green is not as bright as what is white: the weights of colours count.
        images = [cv2.merge([image // 2, image, image // 3]) for image in images]
    off_line = detect([saved(tmp_path / "left", images)]).blobs
    running = RunningDetection(BlobSettings())
    frames = [running.find(image, number / 60.0) for number, image in enumerate(images)]
    far = 0.0
    # The first thresholds are those of one image; from then on they hardly differ.
    for number, frame in enumerate(frames):
        xy = off_line.of(number, 0)
        assert len(frame.blobs) == len(xy), number
        # In the order of their first pixels, which noise may exchange.
        apart = np.linalg.norm(frame.blobs.xy[:, None] - xy[None], axis=2)
        far = max(far, float(apart.min(axis=1).max()))
    assert far < 0.05, f"{far:.3f} px from what is found off line, allowed 0.05"


def test_light_that_changes_is_learnt_at_once() -> None:
    running = RunningDetection(BlobSettings())
    for number in range(40):
        running.find(scene(number), number / 60.0)
    # Somebody opens a curtain: all is brighter by more than a marker's threshold was, and the camera is not stopped by it.
    found = [len(running.find(scene(number, dark=70.0), number / 60.0).blobs) for number in range(40, 80)]
    assert found == [8] * 40
    assert [len(running.find(np.zeros(SIZE[::-1], np.uint8), number / 60.0).blobs) for number in range(80, 100)] == [0] * 20
    assert [len(running.find(scene(number), number / 60.0).blobs) for number in range(100, 140)] == [8] * 40
    # The sun falls on the floor, beside the markers.
    spot = np.zeros(SIZE[::-1], np.uint8)
    cv2.ellipse(spot, (70, 230), (75, 14), 0, 0, 360, 255, -1)
    found = [
        len(running.find(np.maximum(scene(number, dots=5), cv2.GaussianBlur(spot, (0, 0), 2)), number / 60.0).blobs)
        for number in range(140, 180)
    ]
    assert found == [5] * 40


def test_lights_of_the_empty_room_are_masked() -> None:
    lamp = np.zeros(SIZE[::-1], np.uint8)
    cv2.circle(lamp, (160, 20), 5, 255, -1)
    running, bare = RunningDetection(BlobSettings(), empty=1.0), RunningDetection(BlobSettings())
    for number in range(90):
        running.find(np.maximum(scene(number, dots=0), lamp), number / 60.0)
    image = np.maximum(scene(90), lamp)
    assert len(running.find(image, 1.5).blobs) == 8
    assert len(bare.find(image, 1.5).blobs) == 9
    assert 0 < running.masked < 0.01


def test_other_sizes_are_refused_and_a_lit_room_is_cut() -> None:
    running = RunningDetection(BlobSettings(threshold=60.0, min_size=1.0, max_size=64.0))
    crowd = np.full((480, 640), 20, np.uint8)
    crowd[4:-4:8, 4:-4:8] = 200
    crowd[240:243, 320:323] = 250
    found = running.find(crowd, 0.0)
    assert found.crowded
    assert len(found.blobs) == MOST_BLOBS
    # The heaviest is among them.
    assert np.abs(found.blobs.xy - (321.0, 241.0)).max(axis=1).min() < 1.0
    with pytest.raises(AsterismError, match="320 x 240 uint8 after images of 640 x 480"):
        running.find(crowd[:240, :320], 0.1)


def test_processes_find_what_is_found_off_line(tmp_path: Path) -> None:
    folders = [saved(tmp_path / name, [scene(number, seed=seed) for number in range(30)]) for seed, name in enumerate(("left", "right"))]
    off_line = detect(folders, DetectionSettings(BlobSettings(threshold=40.0))).blobs
    specs = [CameraSpec(folder.name, f"{folder}?wait=1", {"rate": 300.0}) for folder in folders]
    workers = CameraWorkers(specs, WorkerSettings(BlobSettings(threshold=40.0), by_number=True), workers=2)
    try:
        assert (workers.cameras, workers.rate, workers.name) == (("left", "right"), 300.0, "2 cameras")
        came = read_all(workers)
        # In the order of their numbers, whichever process was faster.
        assert sorted((blobs.number, blobs.camera) for blobs in came) == [(n, name) for n in range(30) for name in workers.cameras]
        assert [blobs.number for blobs in came] == sorted(blobs.number for blobs in came)
        for blobs in came:
            expected = off_line.of(blobs.number, workers.cameras.index(blobs.camera))
            np.testing.assert_allclose(blobs.xy, expected, atol=1e-9)
            assert blobs.time == pytest.approx(blobs.number / 300.0)
        assert workers.findings() == []
        with pytest.raises(SourceEnded):
            workers.read(0.1)
    finally:
        workers.close()
    assert all(not alive(pid) for pid in workers.processes)


def alive(pid: int | None) -> bool:
    """Whether a process runs, and is no zombie whose parent is gone."""
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False


@pytest.fixture(scope="module")
def odd() -> Iterator[CameraWorkers]:
    """Two cameras in one process: one is whole, the images of the other change their size."""
    workers = CameraWorkers([Odd("size"), CameraSpec("whole", "simulated://?size=160x120&dots=3")], workers=1)
    yield workers
    workers.close()


def test_images_of_another_size_are_counted_and_not_used(odd: CameraWorkers) -> None:
    until(odd, lambda: odd.searches()["size"].refused)
    came = until(odd, lambda: odd.searches()["whole"].searched > 40)
    assert max((blobs.number for blobs in came if blobs.camera == "size"), default=0) < 20
    assert "160 x 60" in odd.searches()["size"].problem
    assert "live-camera-size" in {found.code for found in odd.findings() if found.where == "size"}
    assert odd.damaged > 0


def test_cameras_are_set_while_they_run_and_kept_beside_the_recording(odd: CameraWorkers, tmp_path: Path) -> None:
    odd.set("gain", "6.04 dB", ["whole"])
    odd.set("threshold", 60)
    until(odd, lambda: [outcome.setting for outcome in odd.outcomes()].count("threshold") == 2 and odd.searches()["whole"].threshold == 60)
    assert [outcome.has for outcome in odd.outcomes() if outcome.setting == "gain"] == [pytest.approx(6.0)]
    odd.save(tmp_path / "walk.cameras.toml")
    [whole] = load_cameras(tmp_path / "walk.cameras.toml")
    assert whole.settings == {"gain": 6.04, "threshold": 60.0}
    assert read_toml(tmp_path / "walk.cameras.toml")["camera"][0]["has"]["gain"] == pytest.approx(6.0)
    with pytest.raises(AsterismError, match="no camera middle"):
        odd.set("gain", 1, ["middle"])


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_a_process_that_is_killed_is_begun_anew(odd: CameraWorkers) -> None:
    before = odd.processes
    odd.set("rate", 50, ["whole"])
    until(odd, lambda: odd.searches()["whole"].searched)
    searched = odd.searches()["whole"].searched
    assert before[0] is not None
    os.kill(before[0], signal.SIGKILL)
    until(odd, lambda: odd.processes != before)
    assert "SIGKILL" in health_of(odd, "whole").problem
    until(odd, lambda: odd.searches()["whole"].searched > searched + 10)
    assert "SIGKILL" not in health_of(odd, "whole").problem
    until(odd, lambda: health_of(odd, "whole").images > searched)
    assert [outcome.has for outcome in odd.outcomes() if (outcome.camera, outcome.setting) == ("whole", "rate")] == [50.0]
    assert "live-camera-process" in {found.code for found in odd.findings() if found.where == "whole"}


def test_a_camera_that_fails_is_opened_again_and_the_others_go_on() -> None:
    gone = CameraSpec("gone", "simulated://?size=160x120&gone=0.3&gone-for=0.2")
    workers = CameraWorkers([Odd("fault", "fails"), Odd("hung", "hangs"), gone], workers=1)
    try:
        until(workers, lambda: {health.camera for health in workers.healths() if health.reopened} == {"fault", "gone"})
        assert {found.where for found in workers.findings() if found.code == "live-camera-reopened"} == {"fault", "gone"}
        until(workers, lambda: "does not answer" in health_of(workers, "hung").problem)
        assert ("live-camera-silent", "hung") in {(found.code, found.where) for found in workers.findings()}
    finally:
        workers.close()


def test_what_cannot_be_opened_is_said() -> None:
    with pytest.raises(AsterismError, match="cameras are named left, left"):
        CameraWorkers([CameraSpec("left", "a"), CameraSpec("left", "b")])
    with pytest.raises(AsterismError, match=r"camera right: .*nowhere\.mp4"):
        CameraWorkers([CameraSpec("left", "simulated://"), CameraSpec("right", "nowhere.mp4")], workers=1)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="cameras have other addresses")
def test_a_camera_that_is_not_there_costs_itself() -> None:
    workers = CameraWorkers([CameraSpec("left", "simulated://?size=160x120"), CameraSpec("gone", "camera://97")], workers=1)
    try:
        assert until(workers, lambda: workers.searches()["left"].searched > 5)
        assert [(found.code, found.where) for found in workers.findings()] == [("live-camera-not-opened", "gone")]
        assert "no such camera" in str(workers.camera_states()[1]["problem"])
    finally:
        workers.close()


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="processes are looked up in /proc")
def test_nothing_is_left_behind_when_the_first_process_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "run.py"
    script.write_text(
        "from asterism.live.cameras import CameraSpec\n"
        "from asterism.live.images import CameraWorkers\n"
        "if __name__ == '__main__':\n"
        "    workers = CameraWorkers([CameraSpec(n, 'simulated://?size=160x120') for n in 'ab'], workers=1)\n"
        "    print(*workers.processes, flush=True)\n"
        "    while True:\n"
        "        workers.read(1.0)\n",
        encoding="utf-8",
    )
    process = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    pids = [int(word) for word in process.stdout.readline().split()]
    assert len(pids) == 1
    assert alive(pids[0])
    process.kill()
    end = time.monotonic() + PATIENCE
    while any(alive(pid) for pid in pids):
        assert time.monotonic() < end
        time.sleep(0.02)
    assert "resource_tracker" not in process.communicate(timeout=PATIENCE)[1]


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Path], Path]:
    """A waved wand as three cameras film it, and their rig."""
    root, rng = tmp_path_factory.mktemp("filmed"), np.random.default_rng(4)
    rig = ring_rig(cameras=3, size=(320, 256), rng=np.random.default_rng(1))
    blobs, _ = simulate_wand(rig, settings=ImagingSettings(noise=0.0, merging=False), frames=40, rng=rng, rate=50.0)
    blobs = replace(blobs, sizes=np.full(len(blobs.xy), 6.0))
    for c, name in enumerate(rig.names):
        saved(root / name, list(render_images(blobs, c, (320, 256), rng=np.random.default_rng(c))))
    write_rig(rig, root / "rig.toml")
    return [root / name for name in rig.names], root / "rig.toml"


def test_from_images_to_points_as_off_line(filmed: tuple[list[Path], Path]) -> None:
    folders, rig_file = filmed
    rig = read_rig(rig_file)
    expected = reconstruct(detect(folders, rig=rig).blobs, rig).clouds
    workers = CameraWorkers(
        videos_together(folders, rig, speed=math.inf), WorkerSettings(by_number=True), workers=1, numbered_together=True
    )
    source, frames = RigSource(workers, rig, waits=True), list[LiveFrame]()
    try:
        with suppress(SourceEnded):
            while True:
                frame = source.read(PATIENCE)
                assert frame is not None
                frames.append(frame)
        assert source.findings() == []
    finally:
        source.close()
    assert [frame.number for frame in frames] == list(range(40))
    # Thresholds and noise are learnt on the way, so that points differ by hundredths of a pixel, and single weak ones are not there.
    apart = [
        np.linalg.norm(points[:, None] - frame.points[None], axis=2).min(axis=1, initial=9.0)
        for frame, points in zip(frames, expected, strict=True)
    ]
    assert np.median(np.concatenate(apart)) < 1e-3
    assert (np.concatenate(apart) < 5e-3).mean() > 0.9
    assert sum(len(frame.points) for frame in frames) == pytest.approx(sum(len(points) for points in expected), rel=0.1)


def test_one_fault_of_a_video_is_one_finding(filmed: tuple[list[Path], Path], tmp_path: Path) -> None:
    """One of three videos ends early, and the images of another are not those of the rig."""
    folders, rig_file = filmed
    rig = read_rig(rig_file)
    short, small = (tmp_path / folder.name for folder in folders[1:])
    shutil.copytree(folders[1], short, ignore=lambda _, names: sorted(names)[20:])
    saved(small, [np.zeros((128, 160), np.uint8)] * 40)
    workers = CameraWorkers(
        videos_together([folders[0], short, small], rig, speed=math.inf),
        WorkerSettings(by_number=True, sizes=dict.fromkeys(rig.names, (320, 256))),
        workers=1,
        numbered_together=True,
    )
    source = RigSource(workers, rig, waits=True)
    try:
        with suppress(SourceEnded):
            while source.read(PATIENCE) is not None:
                pass
    finally:
        source.close()
    found = session_findings(Health(frames=40, labelled=40, markers=1, shown=40, damaged=source.damaged), source.about.name, None, [source])
    assert {(finding.code, finding.where) for finding in found} == {("live-camera-ended", short.name), ("live-camera-size", small.name)}
    sentences = " ".join(finding.sentence for finding in found)
    assert "ends after 20 images" in sentences and "has 40" in sentences and "40 images not searched: images are 160 x 128" in sentences


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--replay", "0", "1"], "add --rig FILE"),
        (["0", "1", "--rig", "rig"], "several videos are played with --replay"),
        (["--replay", "0", "nowhere.avi", "--rig", "rig"], "nowhere.avi does not exist"),
        (["--replay", "0", "--rig", "rig"], "points need two"),
        (["--cameras", "cameras.toml"], "add --rig FILE"),
        (["--replay", "0", "1", "--cameras", "cameras.toml", "--rig", "rig"], "give one source"),
        (["--replay", "0", "1", "--speed", "-1", "--rig", "rig"], "plays nothing"),
    ],
)
def test_what_cannot_be_played_is_said(
    filmed: tuple[list[Path], Path], capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    folders, rig_file = filmed
    places = {"0": str(folders[0]), "1": str(folders[1]), "rig": str(rig_file)}
    assert main(["live", *(places.get(word, word) for word in words)]) == 2
    assert said in " ".join(capsys.readouterr().err.split())


def test_each_public_name_of_the_room_is_found_when_it_is_used() -> None:
    from asterism import live

    assert [name for name in live.__all__ if getattr(live, name).__module__.split(".")[:2] != ["asterism", "live"]] == []
    with pytest.raises(AttributeError, match="no attribute 'Nothing'"):
        _ = live.Nothing
