"""Cameras: what is asked of them by name, images of simulated, played and streamed ones, and what is found of them while they run."""

import io
import json
import math
import signal
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import import_module
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from browser import Tab, needs_chromium
from rich.console import Console

from asterism.cli import main
from asterism.cli.live_cameras import watch
from asterism.errors import AsterismError
from asterism.files.toml import read_toml
from asterism.findings import Severity
from asterism.live import LiveFrame, LiveSession, SourceAbout, SourceEnded
from asterism.live.camera_frames import LiveImage
from asterism.live.cameras import (
    CameraGone,
    CameraGroup,
    CameraHealth,
    CameraSpec,
    CameraWatch,
    LiveCamera,
    camera_findings,
    load_cameras,
    open_camera,
    parse_setting,
    reopening,
    save_cameras,
)
from asterism.live.cameras.camera import BUFFERS
from asterism.live.cameras.features import Features
from asterism.live.cameras.found_webcams import found_webcams
from asterism.live.cameras.machine_vision import found_genicam
from asterism.live.cameras.numbering import NumbersByTime
from asterism.live.cameras.pixels import grey_of
from asterism.live.cameras.reopening import ReopeningCamera
from asterism.live.cameras.settings import setting_value
from asterism.live.cameras.simulated import SimulatedCamera

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
    "text", ["exposure", "exposure=", "exposure=4kg", "exposure=-1", "exposure=nan", "shutter=4ms", "size=640", "size=0x1", "gain=1e300"]
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
    # Of 4099 grey values that a camera of 14 bits saw, and of 4103, the same upper 8 bits are left.
    assert camera.damaged == 1 and {(str(image.image.dtype), int(image.image.max())) for image in taken} == {("uint8", 4096 >> 6)}


class Stream:
    """A camera in the network, as MJPEG over HTTP; `unplugged` breaks it off."""

    def __init__(self) -> None:
        self.unplugged = threading.Event()
        jpeg = cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1].tobytes()
        part = b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%s\r\n" % (len(jpeg), jpeg)
        unplugged = self.unplugged
        self.spoiled = spoiled = threading.Event()
        torn = part[: len(part) // 2] + bytes(len(part) - len(part) // 2)

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
                    for number in count():
                        if unplugged.wait(0.01):
                            break
                        self.wfile.write(torn if spoiled.is_set() and number % 3 == 0 else part)
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
    camera = open_camera(CameraSpec("phone", stream.address, {"threshold": 40.0}))
    camera.start()
    taken = images_of(camera, 5)
    assert np.abs(taken[-1].image.astype(int) - 90).max() <= 2 and not camera.damaged
    # An image that is damaged costs itself.
    stream.spoiled.set()
    assert len(images_of(camera, 12)) == 12 and camera.damaged
    stream.spoiled.clear()
    assert (np.diff([image.number for image in taken]) > 0).all() and camera.about.clock == "arrival"
    assert camera.get("threshold") == 40 and "exposure" not in camera.settings
    stream.unplugged.set()
    with pytest.raises(CameraGone, match="phone"):
        images_of(camera, 10**6)
    camera.close()
    assert not any(thread.name == "camera phone" for thread in threading.enumerate())


@pytest.mark.parametrize(
    "address", ["camera://97", "warp://1", "nowhere.mp4", "simulated://?dots=-1", "simulated://?size=9999x9999", "simulated://?dust=1"]
)
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


def test_a_camera_whose_cable_was_out_comes_back_with_numbers_that_go_on(stream):
    camera = CameraSpec("phone", stream.address, {"threshold": 40.0}).open()
    before = images_of(camera, 3)[-1]
    stream.unplugged.set()
    until = time.monotonic() + 60
    while not camera.problem and time.monotonic() < until:
        camera.read(0.05)
    assert "phone" in camera.problem and camera.get("threshold") is None
    stream.unplugged.clear()
    after = images_of(camera, 1)[0]
    camera.close()
    assert camera.reopened == 1 and not camera.problem and camera.get("threshold") == 40
    assert after.number > before.number and after.time > before.time
    assert not any(thread.name == "camera phone" for thread in threading.enumerate())


class Acted(SimulatedCamera):
    """A simulated camera whose images a test gives, one at each read, with its own clock."""

    def __init__(self, images: list[LiveImage | None], rate: float = 10.0) -> None:
        super().__init__("left", "simulated://?size=8x8")
        self.set("rate", rate)
        self.images = images

    def read(self, timeout: float) -> LiveImage | None:
        """The next one. Raises CameraGone where there are no more."""
        if not self.images:
            raise CameraGone("left is gone.")
        return self.images.pop(0)


def image(number: int, time: float, arrived: float, grey: int = 50) -> LiveImage:
    shown = np.full((48, 64), grey, np.uint8)
    shown[0, :8] = number % 16 + min(grey, 200)
    return LiveImage("left", number, time, arrived, shown)


def test_what_was_missed_counts_and_the_clock_of_a_camera_goes_on(monkeypatch):
    monkeypatch.setattr(reopening, "_EVERY", 0.0)
    first, second = [image(7, 100.7, 10.0), image(8, 100.8, 10.1)], [image(0, 0.5, 12.1), image(1, 0.6, 12.2)]
    acts = [Acted(first), Acted(second)]
    camera = ReopeningCamera(lambda: acts.pop(0))
    taken = [found for found in (camera.read(0.0) for _ in range(6)) if found is not None][:4]
    assert [found.number for found in taken] == [7, 8, 28, 29]
    assert np.allclose([found.time for found in taken], [100.7, 100.8, 102.8, 102.9])
    assert camera.reopened == 1


def watched(shown: list[LiveImage], rate: float = 10.0) -> CameraHealth:
    camera = Acted([], rate)
    watch = CameraWatch(camera)
    watch._began = shown[0].arrived
    for given in shown:
        watch.image(given)
        watch.blobs(given.number % 3)
    return watch.health(shown[-1].arrived + 0.01)


@pytest.mark.parametrize(
    ("trouble", "grey", "number", "step"),
    [
        ("black", 0, lambda n: 0, 0.1),
        ("frozen", 90, lambda n: 3, 0.1),
        ("saturated", 255, lambda n: n, 0.1),
        ("slow", 90, lambda n: n, 0.2),
        ("", 90, lambda n: n, 0.1),
        # Each image comes twice.
        ("", 90, lambda n: n // 2, 0.1),
    ],
)
def test_troubles_of_a_camera_are_told_one_by_one(trouble, grey, number, step):
    shown = [replace(image(number(n), n * step, 50 + n * step, grey), number=n) for n in range(int(3 / step))]
    health = watched(shown)
    told = [kind for kind, seconds in health.seconds.items() if seconds > 1]
    assert told == ([trouble] if trouble else [])
    assert [found.code for found in camera_findings([health])] == ([f"live-camera-{trouble}"] if trouble else [])
    assert bool(health.problem) == bool(trouble) and health.brightness == pytest.approx(grey, abs=12)
    assert health.rate == pytest.approx(1 / step, rel=0.15) and health.blobs == pytest.approx(1.0, abs=0.4)


def test_the_drift_of_a_camera_s_clock_and_its_lost_images_are_told():
    rng = np.random.default_rng(0)
    kept = [n for n in range(400) if n % 50 != 7]
    shown = [image(n, 0.1 * n * (1 + 80e-6), 50 + 0.1 * n + rng.exponential(1e-3)) for n in kept]
    health = watched(shown)
    assert abs(health.drift - 80) < 3 * health.drift_sd < 45 and health.lost == 8
    assert [found.code for found in camera_findings([health])] == ["live-camera-lost"]


def test_a_camera_that_gives_nothing_is_told_and_one_that_waits_for_its_trigger_is_not_gone():
    camera = CameraSpec("left", "simulated://?size=8x8", {"trigger": "line1"}).open(time.monotonic() - 99)
    watch = CameraWatch(camera)
    watch._began -= 99
    assert camera.read(0.0) is None and not camera.problem
    assert "trigger" in watch.health().problem and math.isinf(watch.health().last_seen)
    assert [(found.code, found.severity) for found in camera_findings([watch.health()])] == [("live-camera-silent", Severity.ERROR)]


def test_a_file_of_cameras_is_read_with_what_is_set_on_all_and_written_with_what_they_have(tmp_path, film):
    path = tmp_path / "cameras.toml"
    path.write_text(
        f"""
[all]
rate = 50
exposure = "4000 us"
threshold = 80

[[camera]]
name = "left"
address = "simulated://?size=64x48"
gain = 6.04

[[camera]]
name = "film"
address = "{film.name}?speed=2"
threshold = "auto"

[[camera]]
name = "gone"
address = "camera://97"
"""
    )
    specs = load_cameras(path)
    assert specs[0] == CameraSpec("left", "simulated://?size=64x48", {"rate": 50.0, "exposure": 4.0, "threshold": 80.0, "gain": 6.04})
    assert specs[1].address == f"{film}?speed=2" and specs[1].settings["threshold"] == "auto"
    group = CameraGroup(specs)
    group.start()
    assert [camera.name for camera in group.cameras] == ["left", "film"] and "97" in group.failed["gone"]
    assert [camera.set("gain", 3.0).as_asked for camera in group.cameras] == [True, False]
    assert all(images_of(camera, 1) for camera in group.cameras)
    save_cameras(tmp_path / "session.toml", specs, group.said())
    group.close()
    assert load_cameras(tmp_path / "session.toml") == specs
    said = read_toml(tmp_path / "session.toml")["camera"]
    assert said[0]["has"]["gain"] == 3.0 and said[0]["has"]["clock"] == "camera" and "has" not in said[2]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "camera = 3",
        '[[camera]]\naddress = ""',
        '[[camera]]\naddress = "camera://0"\nexposure = "4kg"',
        '[[camera]]\naddress = "camera://0"\nshutter = 4',
        '[[camera]]\naddress = "camera://0"\ngain = ' + 400 * "9",
        '[[camera]]\naddress = "camera://0"\n[[camera]]\naddress = "camera://0"',
        '[all]\nrate = [1]\n[[camera]]\naddress = "camera://0"',
        '[[camera]]\nname = "a"\naddress = "camera://0"\n[[camera]]\nname = "a"\naddress = "camera://1"',
        'cameras = 1\n[[camera]]\naddress = "camera://0"',
    ],
)
def test_a_file_that_is_none_of_cameras_is_refused_with_its_name(tmp_path, text):
    path = tmp_path / "cameras.toml"
    path.write_text(text)
    with pytest.raises(AsterismError, match=r"cameras\.toml"):
        load_cameras(path)


def test_webcams_of_linux_are_found_without_opening_them(tmp_path):
    system, by_id, usb = tmp_path / "class", tmp_path / "by-id", tmp_path / "usb" / "1-1"
    by_id.mkdir()
    usb.mkdir(parents=True)
    (usb / "serial").write_text("A1B2\n")
    (usb / "1-1:1.0").mkdir()
    for number, index in ((0, 0), (1, 1), (10, 0)):
        node = system / f"video{number}"
        node.mkdir(parents=True)
        (node / "index").write_text(f"{index}\n")
        (node / "name").write_text("HD webcam\n")
        (node / "device").symlink_to(usb / "1-1:1.0")
        (tmp_path / f"video{number}").touch()
    (by_id / "usb-HD_webcam-index0").symlink_to(tmp_path / "video10")
    found = found_webcams(system, by_id)
    assert [about.address for about in found] == ["camera:///dev/video0", f"camera://{by_id}/usb-HD_webcam-index0"]
    assert (found[0].model, found[0].serial) == ("HD webcam", "A1B2")


@pytest.mark.parametrize(
    ("pixel_format", "pixels", "grey"),
    [
        ("Mono8", np.full((4, 6), 77, np.uint8), 77),
        ("Mono12p", np.full((4, 6), 77 << 4, np.uint16), 77),
        ("Mono16", np.full((4, 6), 77 << 8, np.uint16), 77),
        ("BayerRG10", np.full((4, 6), 77 << 2, np.uint16), 77),
        ("BGRa8", np.full((4, 6 * 4), 77, np.uint8), 77),
        ("YUV422_8", np.tile(np.array([77, 128], np.uint8), (4, 6)), 77),
        ("YCbCr422_8_CbYCrY", np.tile(np.array([128, 77], np.uint8), (4, 6)), 77),
    ],
)
def test_pixels_of_machine_vision_cameras_become_grey(pixel_format, pixels, grey):
    found = grey_of(pixel_format, pixels)
    assert found.shape == (4, 6) and found.dtype == np.uint8 and (found == grey).all()


def test_red_of_a_mosaic_weighs_as_red_and_other_formats_are_refused():
    mosaic = np.zeros((8, 8), np.uint8)
    mosaic[0::2, 0::2] = 200
    # In RGGB the first pixel is a red one: red weighs 0.3, blue 0.1.
    assert grey_of("BayerRG8", mosaic)[3:5, 3:5].mean() == pytest.approx(0.299 * 200, abs=3)
    assert grey_of("BayerBG8", mosaic)[3:5, 3:5].mean() == pytest.approx(0.114 * 200, abs=3)
    with pytest.raises(AsterismError, match=r"Coord3D_ABC32f.*Mono8"):
        grey_of("Coord3D_ABC32f", mosaic)


NODES = """<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="Test" VendorName="Asterism" ToolTip="" StandardNameSpace="None" SchemaMajorVersion="1"
 SchemaMinorVersion="1"
 SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0" ProductGuid="00000000-0000-0000-0000-000000000000"
 VersionGuid="00000000-0000-0000-0000-000000000000" xmlns="http://www.genicam.org/GenApi/Version_1_1">
 <Float Name="ExposureTime"><Value>5000</Value><Min>20</Min><Max>30000</Max><Unit>us</Unit></Float>
 <Enumeration Name="ExposureAuto"><EnumEntry Name="Off"><Value>0</Value></EnumEntry>
  <EnumEntry Name="Continuous"><Value>1</Value></EnumEntry><Value>1</Value></Enumeration>
 <Integer Name="GainRaw"><Value>4</Value><Min>4</Min><Max>36</Max><Inc>8</Inc></Integer>
 <Boolean Name="AcquisitionFrameRateEnable"><Value>0</Value><OnValue>1</OnValue><OffValue>0</OffValue></Boolean>
 <Float Name="AcquisitionFrameRate"><Value>30</Value><Min>1</Min><Max>100</Max></Float>
 <Float Name="ResultingFrameRate"><ImposedAccessMode>RO</ImposedAccessMode><Value>28.5</Value></Float>
 <Enumeration Name="TriggerMode"><EnumEntry Name="Off"><Value>0</Value></EnumEntry>
  <EnumEntry Name="On"><Value>1</Value></EnumEntry><Value>0</Value></Enumeration>
 <Enumeration Name="TriggerSource"><EnumEntry Name="Software"><Value>0</Value></EnumEntry>
  <EnumEntry Name="Line1"><Value>1</Value></EnumEntry><Value>0</Value></Enumeration>
 <Float Name="DeviceTemperature"><ImposedAccessMode>RO</ImposedAccessMode><Value>41.5</Value></Float>
 <Boolean Name="ReverseX"><Value>0</Value><OnValue>1</OnValue><OffValue>0</OffValue></Boolean>
</RegisterDescription>
"""


def test_settings_of_a_machine_vision_camera_have_the_names_of_all_cameras():
    genapi = pytest.importorskip("genicam.genapi", reason="the binding of GenICam is not installed")
    nodes = genapi.NodeMap()
    nodes.load_xml_from_string(NODES)
    features = Features(nodes)
    assert features.names() == ("exposure", "gain", "rate", "trigger")
    assert features.get("exposure") == "auto" and features.get("trigger") == "off"
    for name, value, has in (
        ("exposure", 4.0, 4.0),  # ms, with the automatic one switched off
        ("exposure", 400.0, 30.0),
        ("exposure", "auto", "auto"),
        ("gain", 21.0, 20.0),  # steps of 8 from 4
        ("gain", 99.0, 36.0),
        ("rate", 80.0, 80.0),
        ("trigger", "line1", "line1"),
        ("trigger", "off", "off"),
        ("ReverseX", True, True),
    ):
        features.set(name, value)
        assert features.get(name) == has, name
    assert nodes.AcquisitionFrameRateEnable.value is True and features.rate == 28.5 and features.temperature == 41.5
    for name, value, said in (
        ("trigger", "line7", "choose from Software, Line1"),
        ("gain", "auto", "cannot be automatic"),
        ("DeviceTemperature", 20.0, "does not take it"),
        ("size", "640x480", "no feature Width"),
        ("ReverseX", "sideways", "ReverseX"),
    ):
        with pytest.raises(AsterismError, match=said):
            features.set(name, value)


def test_a_machine_vision_camera_is_set_and_read_through_a_producer():
    """The producer is a real one, a game that comes with the binding: its camera is played by nobody."""
    genicam = pytest.importorskip("genicam", reason="the binding of GenICam is not installed")
    pytest.importorskip("harvesters", reason="harvesters is not installed")
    producer = Path(genicam.__file__).with_name("viky.cti")
    if not producer.exists():
        pytest.skip("this release of the binding comes without a producer")
    asked = {"rate": 500.0, "format": "mono8", "size": "200x104", "exposure": 4.0, "BouncingBallSize": 30.0}
    spec = CameraSpec("game", f"genicam://1?cti={producer}", asked)
    interrupts = signal.getsignal(signal.SIGINT)
    camera, second = spec.open(), CameraSpec("other", f"genicam://2?cti={producer}", {"format": "RGBa8"}).open()
    assert signal.getsignal(signal.SIGINT) is interrupts, "the library takes Ctrl-C for itself"
    told = {outcome.setting: outcome for outcome in camera.outcomes}
    assert told["rate"].has == 200 and not told["rate"].as_asked and "no such setting" in told["exposure"].problem
    assert all(told[name].as_asked for name in ("format", "size", "BouncingBallSize"))
    taken = images_of(camera, 4)
    assert taken[0].image.shape == (104, 200) and camera.about.model == "Viky" and camera.about.serial == "1"
    assert (np.diff([image.number for image in taken]) > 0).all()
    # The ball is black on white.
    assert taken[-1].image.min() < 50 and np.median(taken[-1].image) > 200
    assert images_of(second, 1)[0].image.shape == (400, 400)
    with pytest.raises(AsterismError, match="already in use"):
        open_camera(spec)
    with pytest.raises(AsterismError, match=r"no camera 9; there are: 0 \(Viky\)"):
        open_camera(CameraSpec("none", f"genicam://9?cti={producer}"))
    camera.close()
    second.close()
    # What was let go of can be had again.
    assert [about.serial for about in found_genicam(str(producer))] == ["0", "1", "2"]
    again = spec.open()
    assert images_of(again, 1)
    again.close()


def test_without_a_producer_it_is_said_what_to_install(monkeypatch):
    pytest.importorskip("harvesters", reason="harvesters is not installed")
    monkeypatch.setenv("GENICAM_GENTL64_PATH", "/nowhere")
    with pytest.raises(AsterismError, match="driver of the camera's maker"):
        open_camera(CameraSpec("left", "genicam://1"))


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    status = main(["live", "cameras", *map(str, words)])
    shown = capsys.readouterr()
    return status, shown.out, shown.err


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    path = tmp_path / "cameras.toml"
    path.write_text(
        '[all]\nrate = 200\n[[camera]]\nname = "left"\naddress = "simulated://?size=64x48&seed=1"\n'
        '[[camera]]\nname = "right"\naddress = "simulated://?size=64x48&seed=2"\n'
    )
    return path


def test_cameras_are_set_by_name_and_kept_in_a_file(capsys, tmp_path, rig_file):
    kept = tmp_path / "dark.toml"
    status, out, err = run(capsys, "set", "exposure=2ms", "gain=6.04", "--cameras", rig_file, "--only", "right", "-o", kept)
    assert status == 0 and "right: gain: asked 6.04 dB, has 6 dB." in out and "left" not in out and not err
    assert [spec.settings for spec in load_cameras(kept)] == [{"rate": 200.0}, {"rate": 200.0, "exposure": 2.0, "gain": 6.04}]
    status, out, err = run(capsys, "set", "focus=3", "--cameras", kept, "--json", "-")
    told = json.loads(out)
    assert status == 1 and [row["camera"] for row in told["settings"] if row["setting"] == "focus"] == ["left", "right"]
    assert {row["has"] for row in told["settings"] if row["setting"] == "exposure"} <= {2.0} and "[live-camera-setting]" in err
    for words, said in (
        (("set", "shutter=1"), "there is no setting"),
        (("set", "gain=1", "--cameras", kept, "--only", "middle"), "no camera middle"),
        (("set", "gain=1", "--cameras", kept, "-o", kept), "--overwrite"),
        (("set", "gain=1", "--cameras", kept, "--address", "camera://0"), "once"),
        (("watch", "--address", "camera://97"), "no such camera"),
    ):
        status, out, err = run(capsys, *words)
        assert status == 2 and said in err and not out


def test_cameras_are_listed_with_what_can_be_set(capsys, rig_file):
    status, out, _ = run(capsys, "list", "--cameras", rig_file, "--settings")
    assert status == 0 and "rate 200 Hz" in out and "64 x 48" in out
    status, out, _ = run(capsys, "list", "--cameras", rig_file, "--settings", "--json", "-")
    assert [camera["has"]["exposure"] for camera in json.loads(out)["cameras"]] == [4.0, 4.0]


def test_cameras_that_are_named_are_listed_as_there_or_not(capsys, tmp_path):
    listed = tmp_path / "listed.toml"
    status, out, err = run(capsys, "list", "--address", "simulated://", "--address", "camera://97", "-o", listed)
    assert status == 1 and "Asterism simulated" in out and "camera2: camera://97" in err
    assert 'model = "Asterism simulated"' in listed.read_text() and "gain =" not in listed.read_text()
    status, out, err = run(capsys, "list", "--address", "nonsense://x")
    assert status == 2 and "nonsense://x is no camera" in err and not out


def test_cameras_are_watched_to_their_end_and_one_that_is_gone_costs_itself(capsys, monkeypatch, tmp_path, film):
    monkeypatch.setattr(import_module("asterism.cli.live_cameras.watch"), "_EVERY", 0.05)
    rig = tmp_path / "cameras.toml"
    rig.write_text(
        "".join(
            f'[[camera]]\nname = "{name}"\naddress = "{address}"\nthreshold = 100\n'
            for name, address in (("left", f"{film}?wait=1"), ("right", f"{film}?speed=0"), ("gone", "camera://97"))
        )
    )
    status, out, err = run(capsys, "watch", "--cameras", rig, "--lines", "--json", tmp_path / "told.json")
    assert {json.loads(line)["camera"] for line in out.splitlines()} == {"left", "right"}
    told = json.loads((tmp_path / "told.json").read_text())
    assert status == 1 and told["findings"][0]["code"] == "live-camera-not-opened" and "gone" in err
    assert [camera["images"] for camera in told["cameras"]] == [12, 12] and all(camera["blobs"] == 1 for camera in told["cameras"])
    assert not any(thread.name.startswith("watch") for thread in threading.enumerate())
    status, out, err = run(capsys, "watch", "--address", f"{film}?wait=1")
    assert status == 0 and "camera1: " in out and " brightness, " in out and not err


def test_kernels_are_compiled_before_cameras_are_opened(capsys, monkeypatch) -> None:
    """An image that waits for them counts as one that does not come; an image without blobs calls only some of them."""
    running, clock = import_module("asterism.detection.running"), import_module("asterism.live.blobs.camera_clock")
    blobs, lines, at_opening = list[int](), list[object](), list[tuple[int, int]]()
    find, fit = running.find_blobs, clock.fit_line
    monkeypatch.setattr(running, "find_blobs", lambda *given: blobs.append(len(found := find(*given))) or found)
    monkeypatch.setattr(clock, "fit_line", lambda *given: lines.append(found := fit(*given)) or found)

    def opened(*_: object) -> None:
        at_opening.append((max(blobs, default=0), len(lines)))
        raise AsterismError("opened.")

    monkeypatch.setattr(import_module("asterism.cli.live_cameras.watch"), "opened_cameras", opened)
    assert run(capsys, "watch", "--address", "simulated://")[0] == 2
    assert at_opening == [(3, 1)]


@pytest.mark.parametrize("words", [["--help"], ["list", "--help"], ["set", "--help"], ["watch", "--help"]], ids=" ".join)
def test_commands_of_cameras_have_help(capsys, words):
    status, out, _ = run(capsys, *words)
    assert status == 0 and "cameras" in out and "..." not in out.partition("[ARGS]...")[2]
    assert main(["live", "--help"]) == 0 and "live cameras" in capsys.readouterr().out


class Driver:
    """Stands for OpenCV's V4L2 backend, as its source reads: there is no webcam here. Controls have UVC's units, stamps are ms."""

    def __init__(self, device: str, backend: int) -> None:
        self.controls = {cv2.CAP_PROP_AUTO_EXPOSURE: 3.0, cv2.CAP_PROP_EXPOSURE: 156.0, cv2.CAP_PROP_FPS: 30.0}
        self.controls |= {cv2.CAP_PROP_FRAME_WIDTH: 640.0, cv2.CAP_PROP_FRAME_HEIGHT: 480.0, cv2.CAP_PROP_FOURCC: 0x56595559}
        self.controls |= {cv2.CAP_PROP_AUTO_WB: 1.0, cv2.CAP_PROP_WB_TEMPERATURE: 4000.0}
        self.told: list[tuple[int, float]] = []
        self.stamp = 0.0
        drivers.append(self)

    def isOpened(self) -> bool:
        return True

    def get(self, what: int) -> float:
        return self.stamp if what == cv2.CAP_PROP_POS_MSEC else self.controls.get(what, -1.0)

    def set(self, what: int, value: float) -> bool:
        self.told.append((what, value))
        if what not in self.controls:
            return False
        # The driver has exposures up to 200 units, and 60 images/s with MJPG alone.
        fast = self.controls[cv2.CAP_PROP_FOURCC] == cv2.VideoWriter.fourcc(*"MJPG")
        most = {cv2.CAP_PROP_EXPOSURE: 200.0, cv2.CAP_PROP_FPS: 60.0 if fast else 30.0}
        value = min(value, most.get(what, math.inf))
        self.controls[what] = value
        return True

    def grab(self) -> bool:
        time.sleep(0.002)
        self.stamp = 1e3 * (time.monotonic() - self.behind)
        return True

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, np.full((480, 640, 3), 50, np.uint8)

    def release(self) -> None:
        pass

    behind = 0.004


drivers: list[Driver] = []


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the settings of other systems' drivers have other units")
def test_a_webcam_is_set_in_the_units_of_its_driver_with_what_is_automatic_off_first(monkeypatch):
    monkeypatch.setattr(cv2, "VideoCapture", Driver)
    asked = {"exposure": 4.03, "rate": 60.0, "format": "mjpg", "white-balance": 4500.0, "gain": 3.0, "size": "640x480"}
    camera = open_camera(CameraSpec("left", "camera:///dev/null", asked))
    told = {outcome.setting: outcome for outcome in camera.outcomes}
    assert str(told["exposure"]) == "left: exposure: asked 4.03 ms, has 4 ms."
    assert "does not take it" in told["gain"].problem
    # The format is set first, or the rate would not fit.
    assert all(told[name].as_asked for name in ("rate", "format", "white-balance", "size"))
    exposures = [step for step in drivers[-1].told if step[0] in (cv2.CAP_PROP_AUTO_EXPOSURE, cv2.CAP_PROP_EXPOSURE)]
    assert exposures == [(cv2.CAP_PROP_AUTO_EXPOSURE, 1.0), (cv2.CAP_PROP_EXPOSURE, 40)]
    assert camera.set("exposure", "auto").as_asked and camera.get("exposure") == "auto"
    assert camera.set("exposure", "1 s").has == 20.0
    camera.start()
    for behind, clock in ((0.004, "system"), (5000.0, "arrival"), (-5.0, "arrival")):
        drivers[-1].behind = behind
        images_of(camera, 2 * BUFFERS)
        taken = images_of(camera, 1)[0]
        # The kernel's stamps count only where they are of this machine's clock.
        assert camera.about.clock == clock and taken.time == pytest.approx(taken.arrived, abs=1.0)
        # A setting is taken between two images.
        assert camera.set("exposure", 2.0).has == 2.0
    camera.close()


def test_a_session_does_not_overwrite_what_cameras_had_in_another(capsys, tmp_path, rig_file):
    (tmp_path / "walk.cameras.toml").touch()
    words = ["live", "--cameras", str(rig_file), "--rig", str(tmp_path / "none.toml"), "-o", str(tmp_path / "walk.c3d")]
    assert main(words) == 2 and "walk.cameras.toml exists" in capsys.readouterr().err
    assert main([*words, "--overwrite"]) == 2 and "none.toml" in capsys.readouterr().err


class Watched:
    """A session's source whose cameras say that one is black, and keep what is set."""

    about = SourceAbout("2 cameras", 60.0)
    damaged = 0

    def __init__(self) -> None:
        self.asked: list[tuple[str, object]] = []
        self.control = self

    def read(self, timeout: float) -> LiveFrame | None:
        return None

    def close(self) -> None:
        pass

    def camera_numbers(self) -> list[dict[str, object]]:
        return []

    def camera_states(self) -> list[dict[str, object]]:
        told = [f"left: {name} is not set." for name, _ in self.asked]
        seen = {"rate": 60.0, "lost": 0, "brightness": 9.5, "saturated": 0.0, "blobs": None, "problem": "its images are black."}
        return [
            {"camera": "left", **seen, "has": {"exposure": 4.0}, "told": told},
            {"camera": "right", "problem": "", "has": {"exposure": 2.0}, "told": []},
        ]

    def set(self, setting: str, value: object) -> None:
        self.asked.append((setting, setting_value(setting, value)))


@pytest.fixture
def served() -> Iterator[tuple[Watched, str]]:
    pytest.importorskip("uvicorn", reason="the extra web is not installed")
    from asterism.web.live_page import ToPage, serve_live
    from asterism.web.serving import PageAddress

    source, page, said = Watched(), ToPage(), list[str]()
    stop = serve_live(LiveSession(source, lambda rate, up: None, [page]), page, PageAddress(), said.append)
    yield source, said[0].rpartition(" ")[2]
    stop()


def test_the_page_sets_cameras_but_not_what_changes_their_calibration(served):
    connect = pytest.importorskip("websockets.sync.client").connect
    source, address = served
    with connect(address.replace("http", "ws").replace("/?", "/ws?")) as socket:

        def next_of(kind: str) -> object:
            return next(news[kind] for news in iter(lambda: json.loads(socket.recv(timeout=60)), None) if kind in news)

        assert [camera["problem"] for camera in next_of("cameras")] == ["its images are black.", ""]
        for words in ('{"set": 3}', '{"set": {"size": "8x8", "rate": 9, "ReverseX": true}}', '{"set": {"exposure": "4000us"}}'):
            socket.send(words)
        socket.send('{"set": {"gain": "loud"}}')
        assert "gain = loud" in next_of("refused")
        assert source.asked == [("exposure", 4.0)]


@needs_chromium
def test_the_page_shows_cameras_and_what_became_of_what_was_set(served, tmp_path):
    pytest.importorskip("websockets", reason="the tests talk to Chromium by a socket")
    source, address = served
    with Tab(address, 800, 900) as tab:
        tab.wait("document.querySelectorAll('#cameras tbody tr').length === 3")
        words = tab.value("document.getElementById('cameras').textContent")
        assert "its images are black." in words and "–" in words
        assert tab.value("document.querySelector('#cameras [name=exposure]').placeholder") == "4, 2"
        tab.value("document.querySelector('#cameras [name=gain]').value = ' 6 '")
        tab.value("document.querySelector('#cameras button').click()")
        tab.wait("document.getElementById('cameras').textContent.includes('gain is not set.')")
    assert source.asked == [("gain", 6.0)]


@pytest.mark.parametrize("columns", [72, 80, 140])
def test_a_table_of_cameras_cuts_no_word_and_says_what_is_wrong_below(columns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a narrow terminal headings go below each other, and what says nothing of any camera has no column."""
    written = io.StringIO()
    monkeypatch.setattr(watch._console, "console", lambda: Console(file=written, width=columns, height=24, force_terminal=True))
    well = CameraHealth("left", 900, 0, 0, 0, 0, 0, 60.0, 41.0, 0.0, 12.0, math.nan, -8.0, 31.0, 0.0, {}, "")
    table = watch._LiveTable()
    table([well, replace(well, camera="right", drift=math.nan)])
    first = written.getvalue()
    assert "lost" not in first or columns > 100
    table([replace(well, lost=17, dropped=1234, saturated=0.12, temperature=41.0, last_seen=2.0, problem="no image comes.")])
    table([])
    said = written.getvalue()
    assert "\N{HORIZONTAL ELLIPSIS}" not in said and "left: no image comes." in said
    assert "-8 ± 31" in first
    for word in ("camera", "images/s", "brightness", "fetched", "saturated", "1,234", "12.0", *(("°C", "ago") if columns > 100 else ())):
        assert word in said.removeprefix(first)
