"""Cameras: what is asked of them by name, images of simulated, played and streamed ones, and what is found of them while they run."""

import math
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from asterism.errors import AsterismError
from asterism.live import SourceEnded
from asterism.live.camera_frames import LiveImage
from asterism.live.cameras import CameraGone, CameraSpec, LiveCamera, open_camera, parse_setting
from asterism.live.cameras.numbering import NumbersByTime

cv2 = pytest.importorskip("cv2")


def images_of(camera: LiveCamera, count: int, patience: float = 60.0) -> list[LiveImage]:
    """The next so many images of a camera, or all where it ends before."""
    taken, until = list[LiveImage](), time.monotonic() + patience
    try:
        while len(taken) < count and time.monotonic() < until:
            image = camera.read(0.2)
            if image is not None:
                taken.append(image)
    except SourceEnded:
        pass
    return taken


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("exposure=4ms", 4.0),
        ("exposure=4000 us", 4.0),
        ("exposure=0.004s", 4.0),
        ("exposure=AUTO", "auto"),
        ("rate=60fps", 60.0),
        ("gain=6dB", 6.0),
        ("size=640 x 480", "640x480"),
        ("trigger=Line1", "line1"),
        ("ReverseX=true", True),
    ],
)
def test_settings_are_read_in_any_unit_and_kept_in_one(text, value):
    assert parse_setting(text)[1] == value


@pytest.mark.parametrize(
    "text", ["exposure", "exposure=", "exposure=4kg", "exposure=-1", "exposure=nan", "shutter=4ms", "size=640", "size=0x1"]
)
def test_what_is_no_setting_is_refused_with_a_sentence(text):
    with pytest.raises(AsterismError, match=r"\."):
        parse_setting(text)


def test_a_simulated_camera_rounds_what_it_is_asked_and_says_so():
    camera = open_camera(CameraSpec("left", "simulated://?size=80x60", {"gain": 6.04, "exposure": 400.0, "rate": 100.0, "focus": 3.0}))
    rate, exposure, gain, focus = camera.outcomes
    # The rate comes before the exposure, which no longer fits.
    assert rate.as_asked and exposure.has == pytest.approx(10.0) and gain.has == pytest.approx(6.0)
    assert str(exposure) == "left: exposure: asked 400 ms, has 10 ms."
    assert "no such setting" in str(focus) and not focus.as_asked


def test_a_simulated_camera_shows_its_dots_where_they_are_and_as_bright_as_it_is_set():
    camera = open_camera(CameraSpec("left", "simulated://?size=160x120&dots=1&seed=4"))
    still = np.zeros((120, 160), np.float32)
    for exposure in (1.0, 2.0):
        camera.set("exposure", exposure)
        image = camera.image(1.0, still).astype(float)
        assert image.max() == pytest.approx(200 * exposure / 4, abs=1)
        rows, columns = np.nonzero(image > image.max() / 2)
        assert np.abs([columns.mean(), rows.mean()] - camera.dots(1.0)[0]).max() < 0.3
    camera.set("gain", 20.0)
    assert camera.image(1.0, still).max() == 255


def test_images_that_are_lost_on_purpose_leave_their_numbers_out():
    camera = CameraSpec("left", "simulated://?size=32x24&lost=0.3&seed=1", {"rate": 500.0}).open()
    numbers = [image.number for image in images_of(camera, 60)]
    camera.close()
    steps = np.diff(numbers)
    assert (steps > 0).all() and 0.1 < (steps > 1).mean() < 0.6


@pytest.fixture
def film(tmp_path: Path) -> Path:
    """Twelve images of 50 a second, in which a bar of light goes to the right."""
    path = tmp_path / "left.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 50, (64, 48))
    for step in range(12):
        image = np.zeros((48, 64, 3), np.uint8)
        image[:, 4 * step : 4 * step + 4] = 220
        writer.write(image)
    writer.release()
    return path


def test_a_video_is_played_with_its_own_times_and_several_begin_together(film):
    at = time.monotonic() + 0.05
    camera = CameraSpec("left", f"{film}?wait=1").open(at)
    taken = images_of(camera, 99)
    assert [image.number for image in taken] == list(range(12))
    assert np.allclose([image.time for image in taken], np.arange(12) / 50)
    # None is shown before it is due, which another process reckons alike.
    assert all(image.arrived >= at + image.time for image in taken)
    bar = [float(np.argmax(image.image.mean(axis=0))) for image in taken]
    assert np.allclose(bar, 4 * np.arange(12) + 1.5, atol=2.5)
    assert camera.rate == 50 and camera.about.size == (64, 48)


def test_a_video_begins_again_with_numbers_and_times_that_go_on(film):
    taken = images_of(CameraSpec("left", f"{film}?speed=0&loop=1").open(), 30)
    assert [image.number for image in taken] == list(range(30))
    assert np.allclose(np.diff([image.time for image in taken]), 1 / 50)


def test_a_film_that_is_fetched_too_slowly_loses_images_as_a_camera_does(film):
    # A thousandth of its rate: an image is due each 20 s, and ten are.
    camera = CameraSpec("left", f"{film}?speed=0.001").open(time.monotonic() - 190)
    assert [image.number for image in images_of(camera, 4)] == [6, 7, 8, 9] and camera.dropped == 6


def test_a_folder_has_the_numbers_of_its_files_the_times_of_a_table_and_counts_what_is_damaged(tmp_path):
    folder = tmp_path / "cam1"
    folder.mkdir()
    for number in (3, 4, 6, 7):
        cv2.imwrite(str(folder / f"image_{number}.png"), np.full((8, 8), 4096 + number, np.uint16))
    (folder / "image_6.png").write_bytes(b"no image")
    (tmp_path / "times.csv").write_text("camera,frame,time\n" + "".join(f"cam1,{n},{0.1 * n:.3f}\n" for n in (3, 4, 6, 7)))
    camera = CameraSpec("cam1", f"{folder}?speed=0&times={tmp_path / 'times.csv'}").open()
    taken = images_of(camera, 99)
    assert [(image.number, round(image.time, 3)) for image in taken] == [(0, 0.3), (1, 0.4), (4, 0.7)]
    assert camera.damaged == 1 and taken[0].image.dtype == np.uint8


class Stream:
    """A camera in the network, as MJPEG over HTTP; `unplugged` breaks it off."""

    def __init__(self) -> None:
        self.unplugged = threading.Event()
        jpeg = cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1].tobytes()
        part = b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%s\r\n" % (len(jpeg), jpeg)
        unplugged = self.unplugged

        class Handler(BaseHTTPRequestHandler):
            def log_message(self, *words: object) -> None:
                pass

            def do_GET(self) -> None:
                if unplugged.is_set():
                    self.send_error(503)
                    return
                self.send_response(200)
                self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
                self.end_headers()
                try:
                    while not unplugged.wait(0.01):
                        self.wfile.write(part)
                except OSError:
                    pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.server.daemon_threads = True
        self.address = f"http://127.0.0.1:{self.server.server_port}/video"
        threading.Thread(target=self.server.serve_forever, args=(0.05,), daemon=True).start()


@pytest.fixture
def stream() -> Iterator[Stream]:
    served = Stream()
    yield served
    served.unplugged.set()
    served.server.shutdown()
    served.server.server_close()


def test_a_camera_in_the_network_is_read_through_opencv_until_it_is_gone(stream):
    camera = CameraSpec("phone", stream.address, {"threshold": 40.0}).open()
    taken = images_of(camera, 5)
    assert np.abs(taken[-1].image.astype(int) - 90).max() <= 2
    assert (np.diff([image.number for image in taken]) > 0).all() and camera.about.clock == "arrival"
    assert camera.get("threshold") == 40 and "exposure" not in camera.settings
    stream.unplugged.set()
    with pytest.raises(CameraGone, match="phone"):
        images_of(camera, 10**6)
    camera.close()
    assert not any(thread.name == "camera phone" for thread in threading.enumerate())


@pytest.mark.parametrize("address", ["camera://97", "warp://1", "nowhere.mp4", "simulated://?dots=-1", "simulated://?dust=1"])
def test_what_is_no_camera_is_refused_with_a_sentence(address):
    with pytest.raises(AsterismError, match=r"\."):
        open_camera(CameraSpec("left", address))


def test_images_are_numbered_by_their_times():
    rng = np.random.default_rng(0)
    numbers, kept = NumbersByTime(60.0), np.flatnonzero(rng.random(600) > 0.05)
    # Kernel stamps scatter by a millisecond; the true rate is 1 % off what the camera says.
    times = 100.0 + kept / 59.4 + rng.normal(0, 1e-3, len(kept))
    assert np.array_equal(np.diff([numbers.number(time) for time in times]), np.diff(kept))


def test_a_webcam_that_halves_its_rate_loses_no_more_than_a_second_of_images():
    numbers, times = NumbersByTime(60.0), np.concatenate([np.arange(60) / 60, 1 + np.arange(120) / 30])
    given = [numbers.number(time) for time in times]
    assert given[-1] - given[-61] == 60
    assert math.isclose(numbers.period, 1 / 30, rel_tol=1e-6)
