"""A webcam or a video stream of the network in; its images as OpenCV reads them, with the kernel's times where it has them, out."""

from __future__ import annotations

import math
import os
import sys
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.live.addresses import Query, without_password
from asterism.live.camera_frames import LiveImage
from asterism.live.cameras.camera import BUFFERS, CameraAbout, CameraGone, LiveCamera
from asterism.live.cameras.found_webcams import quietly, webcam_model
from asterism.live.cameras.numbering import NumbersByTime
from asterism.live.cameras.pixels import DepthByImages
from asterism.live.cameras.settings import SettingValue, size_of

NETWORK = ("http", "https", "rtsp")
"""Cameras in the network, as telephones are with a camera server."""
_PATIENCE = 2
"""s that a driver waits for an image until the camera counts as gone, where OpenCV waits ten. The longest exposure of a webcam is a second:
half of it would lose such a camera, with twice as much a cable that was out for a moment costs four seconds."""
_FAILING = 0.5
"""s of nothing but failures after which a camera is gone; one image that is damaged is passed over.

Half of it reopens a camera for a burst of errors on the bus; with twice as much it is missing for a second longer.
"""
_STALE = 1.0
"""s by which a kernel's stamp may be older than the image's arrival and still be of this machine's clock; never newer. Four buffers at 5
images/s wait for 0.8 s. Half of it doubts a slow camera's clock; twice as much believes one that began a second after this machine's."""
_YIELD = 1e-3
"""s that the next image waits for a setting: a tenth of an image at 100 Hz; half and double do as well."""
_TENTH_MS = 0.1
"""ms that are one step of a webcam's exposure under Linux (V4L2: units of 100 µs)."""
_MANUAL, _AUTOMATIC = {"linux": (1.0, 3.0), "win32": (0.25, 0.75)}.get(sys.platform, (0.0, 1.0))
"""What OpenCV's backends call an exposure that is set and one that the camera chooses: V4L2's menu, DirectShow's halves, and a switch."""


class OpenCvCamera(LiveCamera):
    """camera://0, camera:///dev/video2, or a stream such as http://192.168.1.7:8080/video.

    A thread of its own fetches images; `BUFFERS` of them wait. Times are the kernel's where its stamps are of this machine's clock, else
    those of the arrival. The camera does not number its images: see `NumbersByTime`.
    Raises AsterismError where there is no such camera, or another program has it.
    """

    def __init__(self, name: str, address: str) -> None:
        super().__init__(name, address)
        # FFmpeg's own lines say of each damaged image what is counted and told here.
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
        import cv2

        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
        if sys.platform.startswith("linux"):
            os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", str(_PATIENCE))
        scheme, _, where = address.partition("://")
        self._in_network = scheme.lower() in NETWORK
        # The options of a stream are those of who sends it.
        if not self._in_network:
            Query(address).check_all_used()
        self._device = Path(f"/dev/video{where}") if where.isdigit() else Path(where)
        if self._in_network:
            patience = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, 1000 * _PATIENCE, cv2.CAP_PROP_READ_TIMEOUT_MSEC, 1000 * _PATIENCE]
            capture = quietly(lambda: cv2.VideoCapture(address, cv2.CAP_FFMPEG, patience))
        elif sys.platform.startswith("linux"):
            # The name is followed each time: a camera that was plugged in again has another number.
            capture = quietly(lambda: cv2.VideoCapture(str(self._device.resolve()), cv2.CAP_V4L2))
        elif where.isdigit():
            capture = quietly(lambda: cv2.VideoCapture(int(where)))
        else:
            raise AsterismError(f"{address}: give the number of the camera, as in camera://0.")
        if not capture.isOpened():
            capture.release()
            raise CameraGone(f"{without_password(address)}: {self._why_not()}")
        self._capture = capture
        self._model, self._serial = ("", "") if self._in_network else webcam_model(self._device)
        self._depth = DepthByImages()
        self._numbers = NumbersByTime(self._said_rate())
        self._images: deque[LiveImage] = deque(maxlen=BUFFERS)
        self._there = threading.Condition()
        self._running, self._gone, self._clock = False, False, "arrival"
        self._thread: threading.Thread | None = None
        # A driver that is set while another thread fetches an image may be reset under it.
        self._lock, self._setting = threading.Lock(), threading.Event()

    @property
    def about(self) -> CameraAbout:
        """What is known of it."""
        import cv2

        width, height = (int(self._ask(what)) for what in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        size = (max(0, width), max(0, height))
        return CameraAbout(self.name, without_password(self.address), self._model, self._serial, size, self._said_rate(), self._clock)

    @property
    def own_settings(self) -> tuple[str, ...]:
        """What webcams have; a stream has none."""
        return () if self._in_network else ("exposure", "gain", "rate", "size", "format", "white-balance", "focus")

    def get_own(self, name: str) -> SettingValue | None:
        """What the driver says; None where it says nothing."""
        import cv2

        if name == "rate":
            rate = self._said_rate()
            return None if math.isnan(rate) else rate
        if name == "size":
            return "{}x{}".format(*self.about.size)
        if name == "format":
            return _four_letters(self._ask(cv2.CAP_PROP_FOURCC))
        automatic, number, _ = _PROPERTIES[name]
        if automatic is not None and self._ask(_of(automatic)) == (_AUTOMATIC if name == "exposure" else 1.0):
            return "auto"
        value = self._ask(_of(number))
        if name == "exposure":
            return _milliseconds(value)
        return None if value < 0 else value

    def set_own(self, name: str, value: SettingValue) -> None:
        """Ask the driver for it, with what is automatic switched off first. Raises AsterismError where it refuses."""
        import cv2

        if name == "size":
            width, height = size_of(value)
            self._tell(cv2.CAP_PROP_FRAME_WIDTH, width)
            self._tell(cv2.CAP_PROP_FRAME_HEIGHT, height)
        elif name == "format":
            if len(str(value)) != 4:
                raise AsterismError("a format has four letters, as MJPG and YUYV.")
            self._tell(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*str(value).upper()))
        elif name == "rate":
            self._tell(cv2.CAP_PROP_FPS, float(value))
            self._numbers.rate = self._said_rate()
        else:
            automatic, number, help_ = _PROPERTIES[name]
            if value == "auto":
                if automatic is None:
                    raise AsterismError("it cannot be automatic on its own; set the exposure to auto.")
                self._tell(_of(automatic), _AUTOMATIC if name == "exposure" else 1.0, help_)
                return
            if automatic is not None:
                self._tell(_of(automatic), _MANUAL if name == "exposure" else 0.0)
            self._tell(_of(number), _steps(float(value)) if name == "exposure" else float(value), help_)

    def start(self, at: float | None = None) -> None:
        """Begin with images."""
        if self._running:
            return
        self._running = True
        self._numbers.restarted()
        self._thread = threading.Thread(target=self._fetch, name=f"camera {self.name}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """No images any more."""
        self._running = False
        if self._thread is not None:
            self._thread.join(2 * _PATIENCE)
            self._thread = None
        self._images.clear()

    def close(self) -> None:
        """Let go of the camera. A driver that hangs keeps its thread, which lets go when the driver answers."""
        self._running = False
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(2 * _PATIENCE)
        if self._thread is None or not self._thread.is_alive():
            with self._lock:
                self._capture.release()

    def read(self, timeout: float) -> LiveImage | None:
        """The next image. Raises CameraGone where the driver gives none any more."""
        with self._there:
            if not self._images and not self._gone:
                self._there.wait(timeout)
            if self._images:
                return self._images.popleft()
            if self._gone:
                raise CameraGone(f"{self.name} ({without_password(self.address)}) gives no images any more; look at its cable.")
            return None

    def _fetch(self) -> None:
        """The thread that fetches images as they come."""
        failing = math.inf
        while self._running:
            # The lock alone would be taken again before who waits for it wakes.
            while self._setting.is_set():
                time.sleep(_YIELD)
            with self._lock:
                there = self._capture.grab()
                arrived = time.monotonic()
                stamp = self._kernel_time(arrived) if there else math.nan
                there, image = self._capture.retrieve() if there else (False, None)
            if not there or image is None:
                failing = min(failing, arrived)
                if time.monotonic() - failing > _FAILING:
                    with self._there:
                        self._gone = self._running
                        self._there.notify_all()
                    break
                time.sleep(_YIELD)
                continue
            if failing < math.inf:
                self.damaged, failing = self.damaged + 1, math.inf
            self._clock = "arrival" if math.isnan(stamp) else "system"
            when = arrived if math.isnan(stamp) else stamp
            found = _grey_or_colour(np.asarray(image), self._depth)
            if found is None:
                self.damaged += 1
                continue
            with self._there:
                self.dropped += len(self._images) == BUFFERS
                self._images.append(LiveImage(self.name, self._numbers.number(when), when, arrived, found))
                self._there.notify_all()

    def _kernel_time(self, arrived: float) -> float:
        """s of the image that was grabbed on this machine's monotonic clock, NaN where the driver's stamp is not of it."""
        import cv2

        if self._in_network:
            return math.nan
        stamp = 1e-3 * float(self._capture.get(cv2.CAP_PROP_POS_MSEC))
        return stamp if arrived - _STALE <= stamp <= arrived else math.nan

    def _said_rate(self) -> float:
        import cv2

        # Of a stream FFmpeg says 25 where it does not know.
        rate = math.nan if self._in_network else float(self._capture.get(cv2.CAP_PROP_FPS))
        return rate if 0 < rate < 1e5 else math.nan

    def _ask(self, what: int) -> float:
        return float(self._capture.get(what))

    def _tell(self, what: int, value: float, help_: str = "") -> None:
        self._setting.set()
        with self._lock:
            self._setting.clear()
            taken = self._capture.set(what, value)
        if not taken:
            raise AsterismError(f"the driver does not take it{help_}.")

    def _why_not(self) -> str:
        """Why it could not be opened, and what to do."""
        if self._in_network:
            return "no video comes from there; look whether a browser or a video player opens it on this machine."
        if not sys.platform.startswith("linux"):
            return "there is no such camera, or another program has it; asterism live cameras list shows what is there."
        if not self._device.exists():
            return "there is no such camera; asterism live cameras list shows what is there."
        if not os.access(self._device, os.R_OK | os.W_OK):
            return f"{self._device} may not be read by you; add yourself to the group that owns it (video)."
        return "another program has it, or it gives no images; close what shows its picture."


_PROPERTIES: dict[str, tuple[str | None, str, str]] = {
    "exposure": ("CAP_PROP_AUTO_EXPOSURE", "CAP_PROP_EXPOSURE", "; not every webcam can be given an exposure"),
    "gain": (None, "CAP_PROP_GAIN", "; not every webcam has a gain"),
    "white-balance": ("CAP_PROP_AUTO_WB", "CAP_PROP_WB_TEMPERATURE", ""),
    "focus": ("CAP_PROP_AUTOFOCUS", "CAP_PROP_FOCUS", "; its lens may be fixed"),
}
"""For each setting the property of OpenCV that makes it automatic, None for none; that of its number; and what to say if it is refused."""


def _of(name: str) -> int:
    import cv2

    return int(getattr(cv2, name))


def _milliseconds(value: float) -> float | None:
    """An exposure as the driver says it, in ms; None where it says none."""
    if sys.platform.startswith("linux"):
        return value * _TENTH_MS if value > 0 else None
    return float(1000.0 * 2.0**value) if sys.platform == "win32" and -20 < value < 5 else None


def _steps(milliseconds: float) -> float:
    """An exposure in the driver's steps: 100 µs under Linux, powers of two of a second under Windows."""
    if sys.platform.startswith("linux"):
        return max(1, round(milliseconds / _TENTH_MS))
    if sys.platform == "win32":
        return round(math.log2(max(milliseconds, 1e-3) / 1000.0))
    raise AsterismError("this system's driver does not take an exposure; set it in the system's camera settings.")


def _four_letters(code: float) -> str | None:
    """The name of a pixel format, as MJPG."""
    letters = (int(code) & 0xFFFFFFFF).to_bytes(4, "little")
    return letters.decode() if all(32 < letter < 127 for letter in letters) else None


def _grey_or_colour(image: NDArray[Any], depth: DepthByImages) -> NDArray[np.uint8] | None:
    """An image as OpenCV gives it, as 8 bits grey or BGR; None where it is neither, as JPEG that was not decoded."""
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    if image.dtype.kind != "u" or image.dtype.itemsize > 2 or image.size == 0:
        return None
    if image.ndim == 3 and image.shape[2] == 2:
        # Of YUYV the first of two is the brightness.
        return np.ascontiguousarray(image[..., 0])
    if image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3):
        return depth.eight_bits(image)
    return None
