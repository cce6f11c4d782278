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

from asterism.detection.blobs import BlobSettings
from asterism.detection.running import RunningDetection, compile_search
from asterism.errors import AsterismError, sentence_of
from asterism.live.blobs.camera_clock import compile_fit
from asterism.live.camera_frames import LiveBlobs, LiveImage
from asterism.live.cameras import CameraGone, CameraHealth, CameraWatch, LiveCamera, SettingOutcome, SettingValue
from asterism.live.frames import TURN, SourceEnded

_AGAIN = 1.0
"""s after which a camera that could not be opened is tried again, as `ReopeningCamera` does. Half of it asks a system twice for nothing;
with twice as much a camera is missing for a second longer."""
_TELL = 0.25
"""s between what is told of a camera: a page shows it four times a second. Half of it costs twice the messages; at double it is seen."""
_OLD = 0.02
"""s for which an image waits at most where a newer one of its camera is there. Half of it drops images whenever the system lets another
program run; at double an image is searched when its labels should be there, 40 ms after it came."""
_QUEUE = 8
"""Images of a camera that wait at most: 20 ms at 400 Hz. A slower camera never has as many; at double a fast one holds twice the memory."""
_HANGS = 3.0
"""s after which a driver that was asked for an image within a tenth of one, and has not come back, is said to hang. Half of it is a machine
that swaps; at double the person looks for the fault elsewhere for longer."""
_LEAVING = 2.0
"""s after which a process whose parent is gone ends in any case: a driver may hang while its camera is closed. Half of it breaks off one
that only takes its time; at double a camera that is begun anew finds its device taken for longer."""


class CameraPlace(Protocol):
    """Where a camera is and how it is set, in plain values with which another process opens it: `CameraSpec`, or what a test plays."""

    @property
    def name(self) -> str:
        """In the rig."""

    def ready(self) -> LiveCamera:
        """The camera, open and set. Raises AsterismError."""


@dataclass(frozen=True, eq=False)
class WorkerSettings:
    """How images are searched.

    blobs      what is a blob; a camera's own setting `threshold` goes before its threshold
    empty      s during which nobody is in view: see `RunningDetection`
    sizes      (width, height) px of cameras by name: other images are not used, since the rig is not theirs
    by_number  whether the images of all cameras are searched in the order of their numbers, as of videos that wait: the same blobs come in
               the same order, however fast each is read; else as they come
    """

    blobs: BlobSettings = field(default_factory=BlobSettings)
    empty: float = 0.0
    sizes: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    by_number: bool = False

    def rank(self, image: LiveImage | LiveBlobs) -> float:
        """What decides which image is searched first."""
        return image.number if self.by_number else image.arrived


@dataclass
class SearchCounts:
    """What is counted of the search in one camera's images.

    searched   images whose blobs were sent
    dropped    images that were not searched, since newer ones waited
    refused    images that were not searched, since they are of another size than the rig's, or than those before
    crowded    images with more blobs than are passed on
    threshold  grey values above the background that a blob's pixels exceed, NaN where each image has its own
    masked     share of the image under the mask
    seconds    (mean, longest) s that an image took, since it was told before
    problem    why the last image was refused, "" where it was not
    """

    searched: int = 0
    dropped: int = 0
    refused: int = 0
    crowded: int = 0
    threshold: float = float("nan")
    masked: float = 0.0
    seconds: tuple[float, float] = (0.0, 0.0)
    problem: str = ""


@dataclass(frozen=True)
class SettingOrder:
    """What is to be set on cameras while they run.

    names  of the cameras
    """

    setting: str
    value: SettingValue
    names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class WorkerReady:
    """The process has compiled what it needs, and waits until all have."""


@dataclass(frozen=True, eq=False)
class CameraReport:
    """What is known of a camera now.

    health    how it does; None before it is open
    search    what is counted of the search
    rate      images per second that it says, NaN where it does not
    outcomes  what became of its settings
    said      what it says of itself and of its settings
    problem   why it is not open, "" where it is
    is_missing whether that is since it is not there, and may come
    ended     whether it was a file that was played to its end
    """

    camera: str
    health: CameraHealth | None
    search: SearchCounts
    rate: float
    outcomes: tuple[SettingOutcome, ...]
    said: dict[str, SettingValue]
    problem: str
    is_missing: bool
    ended: bool


class _CameraReader:
    """Reads one camera in a thread of its own, and keeps its newest images until they are searched."""

    def __init__(self, place: CameraPlace, wake: threading.Condition, stop: threading.Event, at: float | None) -> None:
        self.place, self.wake = place, wake
        self.images: deque[LiveImage] = deque()
        self.dropped, self.blobs = 0, 0
        self.health: CameraHealth | None = None
        self.rate = float("nan")
        self.threshold: SettingValue | None = None
        self.outcomes: tuple[SettingOutcome, ...] = ()
        self.said: dict[str, SettingValue] = {}
        self.orders: deque[SettingOrder] = deque()
        self.problem, self.is_missing, self.ended = "", False, False
        self.asked = time.monotonic()
        """s on `time.monotonic` when the driver was asked for an image."""
        self._stop, self._at = stop, at

    def run(self) -> None:
        """Open the camera, and read it until it ends or all is over."""
        try:
            while not self._stop.is_set():
                try:
                    camera = self.place.ready()
                # A driver may raise anything: it is told, and the other cameras go on.
                except Exception as problem:
                    self.is_missing = isinstance(problem, CameraGone)
                    self.problem = sentence_of(problem)
                    self._stop.wait(_AGAIN)
                    continue
                try:
                    camera.start(self._at)
                    self._read(camera)
                except SourceEnded:
                    self.ended = True
                    return
                except Exception as problem:
                    self.problem = sentence_of(problem)
                    self._stop.wait(_AGAIN)
                finally:
                    camera.close()
        finally:
            with self.wake:
                self.wake.notify_all()

    def _read(self, camera: LiveCamera) -> None:
        watch, due = CameraWatch(camera), 0.0
        self.threshold, self.outcomes, self.said = camera.get("threshold"), camera.outcomes, camera.said()
        try:
            while not self._stop.is_set():
                while self.orders:
                    self._set(camera, self.orders.popleft())
                self.asked = time.monotonic()
                image = camera.read(TURN)
                if image is not None:
                    watch.blobs(self.blobs)
                    watch.image(image)
                    self._keep(image, camera.waits)
                now = time.monotonic()
                if now >= due:
                    self.rate, self.problem, self.health, due = camera.rate, "", watch.health(), now + _TELL
        finally:
            self.health = watch.health()

    def _set(self, camera: LiveCamera, order: SettingOrder) -> None:
        """Set what was asked for while the camera runs; it is told with the next report."""
        try:
            outcome = camera.set(order.setting, order.value)
        except AsterismError as problem:
            outcome = SettingOutcome(camera.name, order.setting, order.value, None, str(problem))
        self.outcomes = (*(other for other in self.outcomes if other.setting != order.setting), outcome)
        self.threshold, self.said = camera.get("threshold"), camera.said()

    def _keep(self, image: LiveImage, waits: bool) -> None:
        with self.wake:
            # A file that is to be searched whole waits; of a camera the oldest goes.
            while waits and self.images and not self._stop.is_set():
                self.wake.wait(TURN)
            if len(self.images) == _QUEUE:
                self.images.popleft()
                self.dropped += 1
            self.images.append(image)
            self.wake.notify_all()

    def next(self) -> LiveImage | None:
        """The image to search now, with `wake` held: the oldest that is not too old, or the newest."""
        now = time.monotonic()
        while len(self.images) > 1 and now - self.images[0].arrived > _OLD:
            self.images.popleft()
            self.dropped += 1
        return self.images.popleft() if self.images else None


class _CameraSearch:
    """Finds the blobs in the images of one camera, and counts."""

    def __init__(self, reader: _CameraReader, settings: WorkerSettings, out: Connection[Any, Any]) -> None:
        self._reader, self._settings, self._out = reader, settings, out
        self._detection: RunningDetection | None = None
        self._threshold: SettingValue | None = None
        self._counts = SearchCounts()
        self._due = self._spent = self._longest = 0.0
        self._searches = 0

    def search(self, image: LiveImage) -> None:
        """Send the blobs of an image."""
        begin = time.perf_counter()
        own = self._reader.threshold
        if self._detection is None or own != self._threshold:
            # A camera's own threshold is a number, "auto", or None for that of all.
            self._threshold, blobs = own, self._settings.blobs
            blobs = blobs if own is None else replace(blobs, threshold=own if isinstance(own, float) else None)
            self._detection = RunningDetection(blobs, self._settings.empty)
        counts, (height, width) = self._counts, image.image.shape[:2]
        wide, tall = self._settings.sizes.get(image.camera, (width, height))
        try:
            if (wide, tall) != (width, height):
                raise AsterismError(f"images are {width} x {height}, the rig says {wide} x {tall}; set its size, or give the rig of them.")
            found = self._detection.find(image.image, image.time)
        except AsterismError as problem:
            counts.refused, counts.problem = counts.refused + 1, str(problem)
        else:
            counts.searched, counts.crowded, counts.problem = counts.searched + 1, counts.crowded + found.crowded, ""
            self._reader.blobs = len(found.blobs)
            self._out.send(LiveBlobs(image.camera, image.number, image.time, image.arrived, found.blobs.xy, found.blobs.size))
        took = time.perf_counter() - begin
        self._spent, self._longest, self._searches = self._spent + took, max(self._longest, took), self._searches + 1

    def tell(self, *, at_end: bool = False) -> None:
        """Send what is counted, where that is due."""
        now = time.monotonic()
        if now < self._due and not at_end:
            return
        self._due = now + _TELL
        counts, reader, detection = self._counts, self._reader, self._detection
        if detection is not None:
            counts.threshold = float("nan") if detection.threshold is None else detection.threshold
            counts.masked = detection.masked
        counts.dropped, counts.seconds = reader.dropped, (self._spent / max(self._searches, 1), self._longest)
        self._spent, self._longest, self._searches = 0.0, 0.0, 0
        health, hung = reader.health, now - reader.asked
        # Whoever waits for the driver cannot say so.
        if health is not None and hung > _HANGS and not reader.ended and not reader.images:
            why = health.problem or "its driver does not answer."
            health = replace(health, last_seen=health.last_seen + hung, rate=0.0, problem=why)
        known = (health, replace(counts), reader.rate, reader.outcomes, reader.said, reader.problem, reader.is_missing, reader.ended)
        self._out.send(CameraReport(reader.place.name, *known))


def work(places: Sequence[CameraPlace], settings: WorkerSettings, out: Connection[Any, Any], orders: Connection[Any, Any]) -> None:
    """What the process does: read cameras and search their images until `orders` is closed, as it is when the parent dies."""
    # Ctrl-C reaches all processes of a terminal: the parent decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import cv2

    # Threads of OpenCV in each process would fight for the same cores.
    cv2.setNumThreads(1)
    compile_search()
    compile_fit()
    stop, wake, threads = threading.Event(), threading.Condition(), list[threading.Thread]()
    # The parent closes its ends, or is dead, and takes nothing any more.
    with suppress(OSError, EOFError):
        out.send(WorkerReady())
        at = orders.recv()
        readers = [_CameraReader(place, wake, stop, at) for place in places]
        threading.Thread(target=_obey, args=(orders, readers, stop, wake), name="orders", daemon=True).start()
        for reader in readers:
            threads.append(threading.Thread(target=reader.run, name=f"camera {reader.place.name}", daemon=True))
            threads[-1].start()
        _search(readers, settings, out, stop)
    stop.set()
    out.close()
    for thread in threads:
        thread.join(_LEAVING)


def _search(readers: Sequence[_CameraReader], settings: WorkerSettings, out: Connection[Any, Any], stop: threading.Event) -> None:
    """Search the images of all cameras of this process, those first that have waited longest, until all have ended or all is over."""
    searches = {reader: _CameraSearch(reader, settings, out) for reader in readers}
    wake = readers[0].wake
    while not stop.is_set():
        image, oldest = None, None
        with wake:
            waiting = [reader for reader in readers if reader.images]
            if settings.by_number and not all(reader.images or reader.ended for reader in readers):
                wake.wait(TURN)
            elif waiting:
                oldest = min(waiting, key=lambda reader: settings.rank(reader.images[0]))
                image = oldest.next()
                wake.notify_all()
            elif all(reader.ended for reader in readers):
                break
            else:
                wake.wait(TURN)
        if oldest is not None and image is not None:
            searches[oldest].search(image)
        # Of a camera that gives nothing the counts are told, too.
        for search in searches.values():
            search.tell()
    for search in searches.values():
        search.tell(at_end=True)


def _obey(orders: Connection[Any, Any], readers: Sequence[_CameraReader], stop: threading.Event, wake: threading.Condition) -> None:
    """Pass settings on until the parent closes its end or dies; then see to it that this process ends."""
    with suppress(OSError, EOFError):
        while True:
            order = orders.recv()
            for reader in readers:
                if isinstance(order, SettingOrder) and reader.place.name in order.names:
                    reader.orders.append(order)
    stop.set()
    with wake:
        wake.notify_all()
    time.sleep(_LEAVING)
    os._exit(1)
