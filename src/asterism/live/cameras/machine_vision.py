"""A machine vision camera behind a GenTL producer (GenICam: USB3 Vision, GigE Vision and others) in; its images out."""

from __future__ import annotations

import logging
import math
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np

from asterism.errors import AsterismError
from asterism.live.addresses import Query
from asterism.live.camera_frames import LiveImage
from asterism.live.cameras.camera import BUFFERS, CameraAbout, CameraGone, LiveCamera
from asterism.live.cameras.features import Features
from asterism.live.cameras.numbering import FrameIds, NumbersByTime
from asterism.live.cameras.pixels import grey_of
from asterism.live.cameras.settings import SettingValue
from asterism.live.packages import packages_for

_PATHS = ("GENICAM_GENTL64_PATH", "GENICAM_GENTL32_PATH")
"""Where makers' installers say that their producers are, by the GenTL standard."""
_POLL = 1e-3
"""s from one look for an image to the next: while the binding waits it holds Python's lock, and all other threads would stand still.

Half of it takes twice the time of the processor (2 %); with twice as much an image is found a millisecond later.
"""
_LOOK = 1e-6
"""s that one look for an image may take: the binding takes none for ever. Half and double do as well."""


class GenicamCamera(LiveCamera):
    """genicam://SERIAL, or genicam:// for the only one; ?cti=/path/producer.cti where no installer has said where its producer is.

    Settings have the names of all cameras, and beside these each feature its own: ExposureTime is `exposure`, ReverseX is ReverseX.
    Numbers are the buffers', times those of the camera's clock where its producer gives them, else of the arrival.
    One process opens any number of them, but finds one that was unplugged only while it has no other open.

    Raises AsterismError where there is no such camera, another program has it, or harvesters is not installed.
    """

    def __init__(self, name: str, address: str) -> None:
        super().__init__(name, address)
        query = Query(address)
        serial, producer = unquote(address.partition("://")[2].partition("?")[0].strip("/")), query.text("cti", "")
        query.check_all_used()
        self._acquirer, self._model, self._serial = _PRODUCERS.open(self, serial, producer)
        self._features = Features(self._acquirer.remote_device.node_map)
        # A reader thread of another process may close it.
        self._lock = threading.RLock()
        self._numbers, self._ids, self._numbered = NumbersByTime(self._features.rate), FrameIds(), False
        self._clock, self._running, self._closed = "arrival", False, False
        self._acquirer.num_buffers = max(BUFFERS, self._acquirer.min_num_buffers)
        self._acquirer.timeout_period_on_update_event_data_call = 0

    @property
    def about(self) -> CameraAbout:
        """What is known of it."""
        if self._closed:
            return CameraAbout(self.name, self.address, self._model, self._serial)
        width, height = (self._features.value(what) for what in ("Width", "Height"))
        size = (int(width), int(height)) if isinstance(width, float) and isinstance(height, float) else (0, 0)
        return CameraAbout(self.name, self.address, self._model, self._serial, size, self._features.rate, self._clock)

    @property
    def own_settings(self) -> tuple[str, ...]:
        """Those of all cameras that it has."""
        return self._features.names()

    def knows(self, name: str) -> bool:
        """Whether it has such a setting, or a feature of this name."""
        return super().knows(name) or (name[:1].isupper() and self._features.has(name))

    @property
    def temperature(self) -> float:
        """Degrees Celsius within the camera, NaN where it does not say."""
        return self._features.temperature

    def get_own(self, name: str) -> SettingValue | None:
        """What the camera says."""
        return self._features.get(name)

    def set_own(self, name: str, value: SettingValue) -> None:
        """Set it; where the size or the format of images that run is set, they pause. Raises AsterismError where it cannot."""
        pauses = self._running and name in ("size", "format", "Width", "Height", "PixelFormat")
        if pauses:
            self.stop()
        try:
            self._features.set(name, value)
        finally:
            if pauses:
                self.start()
        self._numbers.rate = self._features.rate

    def start(self, at: float | None = None) -> None:
        """Begin with images. Raises AsterismError where the camera refuses."""
        if self._running:
            return
        try:
            self._acquirer.start()
        except Exception as problem:
            raise AsterismError(f"{self.name} ({self.address}) does not start: {_first_line(problem)}.") from problem
        self._running = True
        self._numbers.restarted()
        self._ids, self._numbered = FrameIds(), False

    def stop(self) -> None:
        """No images any more."""
        with self._lock:
            if self._running:
                self._running = False
                self._acquirer.stop()

    def close(self) -> None:
        """Let go of the camera."""
        with self._lock:
            if self._closed:
                return
            self._closed, self._running = True, False
            _PRODUCERS.close(self, self._acquirer)

    def read(self, timeout: float) -> LiveImage | None:
        """The next image. Raises CameraGone where the producer says that the camera is not there."""
        until = time.monotonic() + timeout
        while True:
            with self._lock:
                image = self._look() if self._running else None
            if image is not None or time.monotonic() >= until:
                return image
            time.sleep(_POLL)

    def _look(self) -> LiveImage | None:
        """An image that waits; None where there is none."""
        from genicam import gentl

        try:
            buffer = self._acquirer.try_fetch(timeout=_LOOK)
        except gentl.TimeoutException:
            return None
        except (gentl.GenericException, IndexError) as problem:
            raise CameraGone(f"{self.address} is gone ({_first_line(problem)}); look at its cable.") from problem
        if buffer is None:
            return None
        arrived = time.monotonic()
        try:
            return self._image(buffer, arrived)
        # Of a buffer that says nothing true of itself.
        except (gentl.GenericException, ValueError, IndexError, TypeError):
            self.damaged += 1
            return None
        finally:
            buffer.queue()

    def _image(self, buffer: Any, arrived: float) -> LiveImage | None:
        parts = [part for part in buffer.payload.components if part.data is not None and part.data.size and part.width]
        if not parts:
            self.damaged += 1
            return None
        part = parts[0]
        rows = np.asarray(part.represent_pixel_location())[: part.height]
        pixels = rows[:, : round(part.width * part.num_components_per_pixel)]
        grey = grey_of(str(part.data_format), pixels)
        # The memory is the producer's again as soon as the buffer is queued.
        grey = grey.copy() if np.shares_memory(grey, part.data) else grey
        stamp = _stamp(buffer)
        self._clock = "arrival" if math.isnan(stamp) else "camera"
        when = arrived if math.isnan(stamp) else stamp
        return LiveImage(self.name, self._number(buffer, when), when, arrived, grey)

    def _number(self, buffer: Any, when: float) -> int:
        """The number of the buffer's frame; by the times where it has none."""
        from genicam import gentl

        by_time = self._numbers.number(when)
        try:
            number = int(buffer.module.frame_id)
        except gentl.GenericException:
            return by_time
        # Some producers say 0 for all frames.
        self._numbered = self._numbered or number > 0
        return self._ids.number(number) if self._numbered else by_time


def _stamp(buffer: Any) -> float:
    """s on the camera's clock, NaN where its producer gives no time."""
    from genicam import genapi, gentl

    try:
        ticks, frequency = int(buffer.timestamp), float(buffer.timestamp_frequency)
    except (gentl.GenericException, genapi.GenericException, AttributeError):
        return math.nan
    return ticks / frequency if ticks > 0 and frequency > 0 else math.nan


def _first_line(problem: BaseException) -> str:
    """What a binding says of a failure, without the numbers around it."""
    line = (str(problem).splitlines() or [type(problem).__name__])[0]
    return line.partition("(Message")[0].removeprefix("GenTL exception: ").strip(" .")


@contextmanager
def _own_interrupts() -> Iterator[None]:
    """Whoever makes an acquirer keeps their own answer to Ctrl-C, which the library replaces by its own."""
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        if before is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, before)


class _Producers:
    """The GenTL producers of this process, which can be loaded once: shared by all its cameras, let go of with the last."""

    def __init__(self) -> None:
        self._lock, self._harvester, self._open = threading.Lock(), None, set[int]()
        self._loaded: tuple[str, ...] = ()

    def open(self, camera: object, serial: str, producer: str) -> tuple[Any, str, str]:
        """The acquirer of a camera, its model and its serial number."""
        with packages_for("genicam://"):
            from genicam import gentl
        with self._lock:
            harvester = self._listed(producer)
            known = [(info, _said(info, "serial_number"), _said(info, "model")) for info in harvester.device_info_list]
            fitting = [entry for entry in known if serial in ("", entry[1], _said(entry[0], "id_"), _said(entry[0], "user_defined_name"))]
            if len(fitting) != 1:
                there = ", ".join(f"{number} ({model})" for _, number, model in known) or "none"
                what = f"no camera {serial}" if serial else "more than one camera"
                raise CameraGone(f"genicam://{serial}: the producers show {what}; there are: {there}.")
            info, number, model = fitting[0]
            try:
                with _own_interrupts():
                    acquirer = harvester.create(info)
            except gentl.GenericException as problem:
                raise CameraGone(
                    f"genicam://{serial} does not open ({_first_line(problem)}); close the program that has it, or look at its cable."
                ) from problem
            self._open.add(id(camera))
            return acquirer, model, number

    def close(self, camera: object, acquirer: Any) -> None:
        """Let go of a camera, and of the producers with the last."""
        with self._lock:
            try:
                acquirer.destroy()
            except Exception:
                # A camera that is gone answers nothing; its memory goes with the producers.
                logging.getLogger(__name__).debug("a camera that is gone was let go of", exc_info=True)
            self._open.discard(id(camera))
            if not self._open and self._harvester is not None:
                self._harvester.reset()
                self._harvester, self._loaded = None, ()

    def found(self, producer: str = "") -> list[tuple[str, str]]:
        """(serial number, model) of all cameras. Raises AsterismError where there is no producer."""
        with self._lock:
            harvester = self._listed(producer)
            found = [(_said(info, "serial_number") or _said(info, "id_"), _said(info, "model")) for info in harvester.device_info_list]
            if not self._open:
                harvester.reset()
                self._harvester, self._loaded = None, ()
            return found

    def _listed(self, producer: str) -> Any:
        """The harvester with its list of cameras, looked for anew only while none is open: that would close them."""
        with packages_for("genicam://"):
            from harvesters.core import Harvester
        # It would print its warnings to standard error, where they mean nothing to a person.
        logging.getLogger("harvesters").addHandler(logging.NullHandler())
        files = producer_files(producer)
        if self._harvester is not None and (self._open or set(files) <= set(self._loaded)):
            if not set(files) <= set(self._loaded):
                raise AsterismError(
                    f"{producer}: cameras of another producer are open in this process; open those of each in one of its own."
                )
            if self._open:
                return self._harvester
        harvester = Harvester() if self._harvester is None else self._harvester
        for file in files:
            harvester.add_file(file)
        harvester.update()
        self._harvester, self._loaded = harvester, tuple(files)
        return harvester


def producer_files(given: str = "") -> list[str]:
    """The GenTL producers (.cti): the one that is given, else those in the folders that installers name. Raises AsterismError for none."""
    if given:
        if not Path(given).is_file():
            raise AsterismError(f"{given} does not exist; give the .cti file that came with the camera's driver.")
        return [given]
    folders = [Path(folder) for name in _PATHS for folder in os.environ.get(name, "").split(os.pathsep) if folder]
    found = sorted({str(file) for folder in folders if folder.is_dir() for file in folder.glob("*.cti")})
    if not found:
        raise AsterismError(
            f"no GenTL producer is installed: install the driver of the camera's maker, which sets {_PATHS[0]}, or name its file: "
            "genicam://SERIAL?cti=/path/to/producer.cti"
        )
    return found


def _said(info: Any, what: str) -> str:
    """What a producer says of a camera, "" where it does not."""
    from genicam import gentl

    try:
        value = getattr(info, what)
    except (gentl.GenericException, AttributeError):
        return ""
    return "" if value is None else str(value)


_PRODUCERS = _Producers()


def found_genicam(producer: str = "") -> list[CameraAbout]:
    """The cameras that GenTL producers show. Raises AsterismError where there is no producer, or harvesters is not installed."""
    words = f"?cti={quote(producer)}" if producer else ""
    return [
        CameraAbout(f"{model or 'camera'}-{serial}", f"genicam://{quote(serial, safe='')}{words}", model, serial)
        for serial, model in _PRODUCERS.found(producer)
    ]
