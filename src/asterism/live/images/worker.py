"""A process that opens cameras, finds the blobs in their images, newest first, and sends them."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from asterism.detection.blobs import BlobSettings
from asterism.detection.running import RunningBlobs, RunningDetection
from asterism.errors import AsterismError
from asterism.live.camera_frames import LiveBlobs, LiveImage
from asterism.live.cameras import LiveCamera
from asterism.live.frames import SourceEnded

_TIMEOUT = 0.1
"""s after which a reader looks whether it shall stop."""
_AGAIN = 1.0
"""s after which a camera that failed is opened again. USB needs about as long to find one; at half, a camera that is out is asked twice as
often; at double, one that is back is waited for."""
_TELL = 0.25
"""s between what is told of a camera: a page shows it four times a second. Half of it costs twice the messages."""
_OLD = 0.02
"""s for which an image waits at most where a newer one of its camera is there. Half of it drops images whenever the system lets another program
run; at double an image is searched when its labels should be there, 40 ms after it came."""
_QUEUE = 8
"""Images of a camera that wait at most: 20 ms at 400 Hz. A slower camera never has as many; at double a fast one holds twice the memory."""
_LEAVING = 2.0
"""s after which a process whose parent is gone ends in any case: a driver may hang while its camera is closed."""


class CameraPlace(Protocol):
    """Where a camera is and how it is set, as plain values that another process can open: `CameraSpec`, or what tests and benchmarks play."""

    @property
    def name(self) -> str:
        """In the rig."""

    def open(self, at: float | None = None) -> LiveCamera:
        """The camera, open and started. Raises AsterismError."""


@dataclass(frozen=True, eq=False)
class WorkerSettings:
    """How images are searched.

    blobs      what is a blob; a camera's own setting `threshold` goes before its threshold
    empty      s during which nobody is in view: see `RunningDetection`
    pictures   newest images per second and camera that are shown, 0 for none: each costs as much as ten images' blobs
    sizes      (width, height) px of cameras by name: other images are not used, since the rig is not theirs
    """

    blobs: BlobSettings = field(default_factory=BlobSettings)
    empty: float = 0.0
    pictures: float = 0.0
    sizes: Mapping[str, tuple[int, int]] = field(default_factory=dict)


@dataclass
class CameraCounts:
    """What is counted of one camera while it runs.

    images      that came
    searched    images whose blobs were sent
    dropped     images that were not searched, since newer ones waited
    missed      images that the camera itself left out, since they were not fetched in time
    damaged     images that could not be read, or of another size than the rig's
    opened      times that it was opened
    crowded     images with more blobs than are passed on
    blobs       in the last image
    brightness  mean grey value of the last image; saturated: share of its pixels at the end of the grey scale
    threshold   grey values above the background that a blob's pixels exceed, NaN where each image has its own
    masked      share of the image under the mask
    rate        images per second, of the last second
    seconds     (mean, longest) s that an image was searched, since the counts were told before
    size        (width, height) px
    problem     why there are no blobs, "" where there are
    ended       whether it was a file that was played to its end
    """

    images: int = 0
    searched: int = 0
    dropped: int = 0
    missed: int = 0
    damaged: int = 0
    opened: int = 0
    crowded: int = 0
    blobs: int = 0
    brightness: float = float("nan")
    saturated: float = float("nan")
    threshold: float = float("nan")
    masked: float = 0.0
    rate: float = 0.0
    seconds: tuple[float, float] = (0.0, 0.0)
    size: tuple[int, int] = (0, 0)
    problem: str = ""
    ended: bool = False


@dataclass(frozen=True, eq=False)
class WorkerReady:
    """A worker has compiled what it needs, and waits until all have."""


@dataclass(frozen=True, eq=False)
class CameraReport:
    """What is counted of a camera, its rate, and its newest image where that is shown."""

    camera: str
    counts: CameraCounts
    rate: float
    picture: NDArray[Any] | None = None


@dataclass
class _CameraReader:
    """Reads one camera in a thread of its own, and keeps its newest images until they are searched."""

    place: CameraPlace
    wake: threading.Condition
    stop: threading.Event
    at: float | None
    counts: CameraCounts = field(default_factory=CameraCounts)
    rate: float = float("nan")
    threshold: object = None
    images: deque[LiveImage] = field(default_factory=deque)
    _begin: float = 0.0
    _before: int = 0

    def run(self) -> None:
        """Open the camera and read it until it ends or all is over; one that fails is opened again."""
        try:
            while not self.stop.is_set():
                try:
                    self._read()
                except SourceEnded:
                    self.counts.ended = True
                    return
                # A driver may raise anything: it is told, and the other cameras go on.
                except Exception as problem:
                    self.counts.problem = str(problem) if isinstance(problem, AsterismError) else f"{type(problem).__name__}: {problem}"
                self.stop.wait(_AGAIN)
        finally:
            with self.wake:
                self.wake.notify_all()

    def _read(self) -> None:
        camera = self.place.open(self.at)
        missed, damaged = self.counts.missed, 0
        self.counts.opened += 1
        self.counts.problem = ""
        try:
            self.rate, self.threshold = camera.rate, camera.get("threshold")
            while not self.stop.is_set():
                image = camera.read(_TIMEOUT)
                self.counts.missed = missed + camera.dropped
                # Images of another size are counted by whoever searches them.
                self.counts.damaged += camera.damaged - damaged
                damaged = camera.damaged
                if image is None:
                    continue
                self._count(image.arrived)
                with self.wake:
                    # A file that is to be searched whole waits; of a camera the oldest goes.
                    while camera.waits and self.images and not self.stop.is_set():
                        self.wake.wait(_TIMEOUT)
                    if len(self.images) == _QUEUE:
                        self.images.popleft()
                        self.counts.dropped += 1
                    self.images.append(image)
                    self.wake.notify_all()
        finally:
            camera.close()

    def next(self) -> LiveImage | None:
        """The image to search now, with `wake` held: the oldest one that is not too old, or the newest."""
        now = time.monotonic()
        while len(self.images) > 1 and now - self.images[0].arrived > _OLD:
            self.images.popleft()
            self.counts.dropped += 1
        return self.images.popleft() if self.images else None

    def _count(self, now: float) -> None:
        self.counts.images += 1
        if now - self._begin >= 1.0:
            self.counts.rate = (self.counts.images - self._before) / (now - self._begin) if self._begin else 0.0
            self._begin, self._before = now, self.counts.images


class _CameraSearch:
    """Finds the blobs in the images of one camera, and counts."""

    def __init__(self, reader: _CameraReader, settings: WorkerSettings, out: Connection[Any, Any]) -> None:
        self.reader, self._settings, self._out = reader, settings, out
        self._detection: RunningDetection | None = None
        self._due = self._picture_due = self._spent = self._longest = 0.0
        self._searches = 0

    def search(self, image: LiveImage) -> None:
        """Send the blobs of an image; and what is counted, where that is due."""
        counts, begin = self.reader.counts, time.perf_counter()
        found = self._found(image)
        took = time.perf_counter() - begin
        self._spent, self._longest, self._searches = self._spent + took, max(self._longest, took), self._searches + 1
        if found is not None:
            counts.searched += 1
            counts.crowded += found.crowded
            counts.blobs, counts.brightness, counts.saturated = len(found.blobs), found.brightness, found.saturated
            self._out.send(LiveBlobs(image.camera, image.number, image.time, image.arrived, found.blobs.xy, found.blobs.size))
        self.tell(image)

    def _found(self, image: LiveImage) -> RunningBlobs | None:
        counts = self.reader.counts
        if self._detection is None:
            self._detection = RunningDetection(_with_threshold(self._settings.blobs, self.reader.threshold), self._settings.empty)
        height, width = image.image.shape[:2]
        counts.size = (width, height)
        of_rig = self._settings.sizes.get(image.camera)
        try:
            if of_rig is not None and of_rig != counts.size:
                raise AsterismError(
                    f"its images are {width} x {height}, the rig says {of_rig[0]} x {of_rig[1]}; set its size, or give the rig of these images."
                )
            found = self._detection.find(image.image, image.time)
        except AsterismError as problem:
            counts.damaged += 1
            counts.problem = str(problem)
            return None
        counts.problem = ""
        counts.threshold = float("nan") if self._detection.threshold is None else self._detection.threshold
        counts.masked = self._detection.masked
        return found

    def tell(self, image: LiveImage | None = None) -> None:
        """Send what is counted, where that is due, and the image where one is to be shown."""
        now, counts = time.monotonic(), self.reader.counts
        shown = image is not None and self._settings.pictures > 0 and now >= self._picture_due
        if now < self._due and not shown:
            return
        self._due = now + _TELL
        counts.seconds = (self._spent / max(self._searches, 1), self._longest)
        self._spent, self._longest, self._searches = 0.0, 0.0, 0
        picture = None
        if image is not None and shown:
            self._picture_due, picture = now + 1.0 / self._settings.pictures, image.image
        self._out.send(CameraReport(self.reader.place.name, replace(counts), self.reader.rate, picture))

    def finish(self) -> None:
        """Send what is counted at the end."""
        self._due = 0.0
        self.tell()


def _with_threshold(blobs: BlobSettings, own: object) -> BlobSettings:
    """What is a blob, with the threshold that is set on the camera: a number, "auto", or None for what is set for all."""
    if own is None:
        return blobs
    return replace(blobs, threshold=float(own) if isinstance(own, int | float) else None)


def work(places: Sequence[CameraPlace], settings: WorkerSettings, out: Connection[Any, Any], orders: Connection[Any, Any]) -> None:
    """What the process does: read cameras and search their images until `orders` is closed, as it is when the parent dies."""
    # Ctrl-C reaches all processes of a terminal: the parent decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import cv2

    # Threads of OpenCV in each process would fight for the same cores.
    cv2.setNumThreads(1)
    warm = RunningDetection(settings.blobs)
    for shade in (0, 255):
        dots = np.full((64, 64), 20, np.uint8)
        dots[20:26, 20:26], dots[30:36, 24:30], dots[0:4, 0:4] = 200, 210, shade
        warm.find(dots, 0.0)
    stop, wake = threading.Event(), threading.Condition()
    # The parent closes its ends, or is dead, and takes nothing any more.
    with suppress(OSError, EOFError):
        out.send(WorkerReady())
        at = orders.recv()
        threading.Thread(target=_until_closed, args=(orders, stop, wake), name="orders", daemon=True).start()
        readers = [_CameraReader(place, wake, stop, at) for place in places]
        threads = [threading.Thread(target=reader.run, name=f"camera {reader.place.name}", daemon=True) for reader in readers]
        for thread in threads:
            thread.start()
        _search(readers, settings, out)
        for thread in threads:
            thread.join(_LEAVING)
    stop.set()
    out.close()


def _search(readers: Sequence[_CameraReader], settings: WorkerSettings, out: Connection[Any, Any]) -> None:
    """Search the images of all cameras of this process, those first that have waited longest, until all have ended or all is over."""
    searchers = {id(reader): _CameraSearch(reader, settings, out) for reader in readers}
    wake, stop = readers[0].wake, readers[0].stop
    while not stop.is_set():
        image, oldest = None, None
        with wake:
            waiting = [reader for reader in readers if reader.images]
            if waiting:
                oldest = min(waiting, key=lambda reader: reader.images[0].arrived)
                image = oldest.next()
                wake.notify_all()
            elif all(reader.counts.ended for reader in readers):
                break
            else:
                wake.wait(_TIMEOUT)
        if oldest is not None and image is not None:
            searchers[id(oldest)].search(image)
        # Of a camera that gives nothing the counts are told, too.
        for searcher in searchers.values():
            searcher.tell()
    for searcher in searchers.values():
        searcher.finish()


def _until_closed(orders: Connection[Any, Any], stop: threading.Event, wake: threading.Condition) -> None:
    """Wait until the parent closes its end or dies; then see to it that this process ends."""
    with suppress(OSError, EOFError):
        orders.recv()
    stop.set()
    with wake:
        wake.notify_all()
    time.sleep(_LEAVING)
    os._exit(1)
