"""A video or a folder of images in; the images of a camera that takes them now, at the rate at which they were taken, out."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from asterism.detection.sources import images, open_source
from asterism.detection.times import read_times
from asterism.errors import AsterismError
from asterism.live.addresses import Query
from asterism.live.camera_frames import LiveImage
from asterism.live.cameras.camera import BUFFERS, CameraAbout, LiveCamera
from asterism.live.cameras.pixels import DepthByImages
from asterism.live.cameras.settings import SettingValue
from asterism.live.frames import SourceEnded
from asterism.recording import Floats
from asterism.recording.rates import rate_of_times

_RATE = 100.0
"""Hz at which a folder of images is played that nobody tells the rate of, as `asterism detect` takes it."""


class PlayedCamera(LiveCamera):
    """Plays `walk.mp4`, or `walk.mp4?speed=2&loop=1&wait=1&times=times.csv`, or a folder of images.

    speed  times its own rate, 0 for as fast as images are taken
    loop   1: begins again at the end, its numbers and times going on
    wait   1: waits until its images are taken, as no camera does; else those that are not taken in time are left out and counted
    times  a CSV file of when each image was taken, as of `asterism detect --times`; rows are found by the camera's name

    Times are the file's, from 0, so that several files that were taken together are in step whenever each begins.
    Images that cannot be decoded are counted as damaged. Raises AsterismError where there is nothing to play.
    """

    def __init__(self, name: str, address: str) -> None:
        super().__init__(name, address)
        self._path = path_of(address)
        query = Query("" if Path(address).exists() else address)
        self._speed = query.number("speed", 1.0) or math.inf
        self._loop, self._waits = query.whole("loop", 0) > 0, query.whole("wait", 0) > 0 or math.isinf(self._speed)
        times = query.text("times", "")
        query.check_all_used()
        self._source = open_source(self._path)
        self._given_rate, self._depth = math.nan, DepthByImages()
        self._stamps = None if not times else _stamps(Path(times), name, len(self._source))
        self._images: Iterator[tuple[int, LiveImage | None]] = iter(())
        self._size = (0, 0)
        self._began = math.nan
        self._pending: LiveImage | None = None
        self._to_pass: int | None = None
        self._ended = threading.Event()

    @property
    def about(self) -> CameraAbout:
        """What is known of it."""
        return CameraAbout(self.name, self.address, self._source.path.name, "", self._size, self._rate * self._factor, "file")

    @property
    def waits(self) -> bool:
        """As its address says."""
        return self._waits

    @property
    def own_settings(self) -> tuple[str, ...]:
        """A file can be asked for its rate, and a folder can be given one."""
        return ("rate",)

    @property
    def _rate(self) -> float:
        """Images per second by the file, what was given, or what is usual."""
        if self._stamps is not None and len(self._stamps) > 1:
            told = rate_of_times(np.arange(len(self._stamps)), self._stamps).rate
            if math.isfinite(told):
                return told
        own = self._source.rate
        return own if math.isfinite(own) else self._given_rate if math.isfinite(self._given_rate) else _RATE

    @property
    def _factor(self) -> float:
        return self._speed if math.isfinite(self._speed) else 1.0

    def get_own(self, name: str) -> SettingValue | None:
        """The rate."""
        return self._rate

    def set_own(self, name: str, value: SettingValue) -> None:
        """Give a folder of images its rate. Raises AsterismError where the file has one of its own."""
        if not isinstance(value, float) or not value > 0:
            raise AsterismError("give a rate above 0.")
        if self._stamps is not None or math.isfinite(self._source.rate):
            if not math.isclose(value, self._rate, rel_tol=1e-3):
                raise AsterismError("it was recorded at another rate; play it faster with ?speed=2.")
            return
        self._given_rate = value

    def start(self, at: float | None = None) -> None:
        """Begin to play, from the start."""
        self._began = time.monotonic() if at is None else at
        self._images, self._pending, self._to_pass = self._played(), None, None
        self._ended.clear()

    def stop(self) -> None:
        """No images any more."""
        self._began, self._images = math.nan, iter(())

    def close(self) -> None:
        """Let go of the file."""
        self._ended.set()

    def read(self, timeout: float) -> LiveImage | None:
        """The next image, when it is due. Raises SourceEnded at the end of the file."""
        if math.isnan(self._began) or self._ended.is_set():
            self._ended.wait(timeout)
            return None
        until = time.monotonic() + timeout
        while self._pending is None:
            try:
                _, self._pending = next(self._images)
            except StopIteration:
                raise SourceEnded(f"{self._source.path} was played to its end.") from None
            if self._pending is None:
                self.damaged += 1
                continue
            # Of a camera, images that nobody fetches are lost. As many are passed over as are due, and then one is shown in any case, or
            # a file that decodes more slowly than it plays would never be seen.
            if self._to_pass is None:
                behind = (time.monotonic() - self._due(self._pending.time)) * self._rate * self._factor
                self._to_pass = 0 if self._waits else max(0, math.floor(behind) - BUFFERS + 1)
            if self._to_pass > 0:
                self._to_pass, self._pending = self._to_pass - 1, None
                self.dropped += 1
        due, now = self._due(self._pending.time), time.monotonic()
        if due > now and (self._ended.wait(max(0.0, min(due, until) - now)) or time.monotonic() < due):
            return None
        image, self._pending, self._to_pass = self._pending, None, None
        # One that waits comes when it is due, however long somebody made it wait: the same file gives the same times.
        comes = self._began + image.time / self._factor if self._waits else time.monotonic()
        return replace(image, arrived=comes)

    def _due(self, seconds: float) -> float:
        """s on `time.monotonic` when the image of this time is due."""
        return self._began + seconds / self._speed

    def _played(self) -> Iterator[tuple[int, LiveImage | None]]:
        """All images with the numbers and times of the file; None for one that cannot be decoded."""
        numbers, later, added = self._source.numbers, 0.0, 0
        while True:
            stamps, last, number = list[float](), -1.0 / self._rate, -1
            for place, grey in images(self._source, stamps):
                number = int(numbers[place] - numbers[0]) if self._source.numbered else place
                stamp = stamps.pop() if stamps else math.nan
                if self._stamps is not None:
                    if place >= len(self._stamps):
                        break
                    stamp = float(self._stamps[place])
                # Videos without times of their own say 0 for all images.
                last = stamp if stamp > last else number / self._rate
                if grey is None:
                    yield place, None
                    continue
                self._size = (grey.shape[1], grey.shape[0])
                yield place, LiveImage(self.name, added + number, later + last, 0.0, self._depth.eight_bits(grey))
            if not self._loop or number < 0:
                return
            later, added = later + last + 1.0 / self._rate, added + number + 1


def path_of(address: str) -> Path:
    """The path in an address, which may have words after a question mark; a file that has a question mark in its name is itself."""
    whole = Path(address)
    return whole if whole.exists() else Path(address.partition("?")[0])


def _stamps(path: Path, name: str, length: int) -> Floats:
    """(N,) s when a camera took each of its images. Raises AsterismError where the file has not its times."""
    times = read_times(path)
    stamped = times.of([name])[0]
    if len(stamped) != length:
        raise AsterismError(f"{path} has {len(stamped)} times of camera {name}, which has {length} images; give the time of each image.")
    stamps: NDArray[np.float64] = times.time[stamped]
    if not (np.diff(stamps) > 0).all():
        raise AsterismError(f"{path}: the times of camera {name} do not grow from image to image; correct them.")
    return stamps
