"""The address of Qualisys Track Manager (QTM) in; its 3D points, or the blobs of its cameras, frame by frame, out.

The package `qtm-rt` sends commands and pairs them with their answers. Data packets are read in `qtm_packets`: the package's own parser
reads a damaged component again and again, and loses a frame that has a component which it does not know.
"""

from __future__ import annotations

import asyncio
import contextlib
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from qtm_rt import QRTCommandException, QRTConnection
from qtm_rt.protocol import QTMProtocol

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.live.addresses import in_words
from asterism.live.analog import AnalogSamples
from asterism.live.camera_frames import LiveBlobs
from asterism.live.clock import StreamTimes
from asterism.live.datagrams import HostPort
from asterism.live.frames import LiveFrame, SourceAbout
from asterism.live.qtm_packets import MOST_BYTES, QtmSettings, blobs_of_packet, points_of_packet, settings_of_xml
from asterism.live.reporting import axis_unknown, labels_given, reconnected, times_made

PORT = 22223
"""Where QTM speaks this protocol with little-endian numbers: its base port and 1."""
_VERSIONS = ("1.20", "1.13", "1.8")
"""Of the protocol, asked for in this order. QTM keeps to the version that was asked for, so that later ones change nothing here."""
_ERROR, _DATA, _NO_MORE_DATA, _EVENT, _ANSWERS = 0, 3, 4, 6, (0, 1, 2)
"""Kinds of packets."""
_BEGINNINGS = (b"\x01", b"\x03", b"\x08", b"\x0b")
"""Events after which settings may be others: cameras connected, a capture or a file begun, settings of cameras changed."""
_PATIENCE = 3.0
"""s for an answer. Half of it loses to a QTM that is calibrating; twice as much is a wait."""
_QUIET = 2.0
"""s without a byte after which QTM is asked whether it is still there. Half of it asks between two slow frames; with twice as much a cable
that was pulled out is noticed after seven seconds."""
_AGAIN = 1.0
"""s between two tries to reach a QTM that is gone. Half of it asks twice for nothing; with twice as much it is missed for a second
longer."""
_KEPT = 400
"""Packets that wait to be read at most, 2 s at 200 Hz; the oldest are left out, and counted as lost by their numbers. Half of them are lost
at a pause of a second; twice as many are old."""
_MOST_ANALOG = 100
"""Groups of samples that wait for a frame with points at most: those of ten devices in ten packets. Half and double do as well."""
_TO_STEP = 10
"""Frames by which it is seen whether QTM sends each frame or, as its real-time rate says, each second or third one. Half of them may all
lie beside a lost one; with twice as many a session at 50 Hz begins 0.2 s later."""


class _Packets(QTMProtocol):
    """Cuts the stream into packets; answers go to the package, data to `take`."""

    def __init__(self, take: Callable[[bytes, float], None], gone: Callable[[], None]) -> None:
        super().__init__(on_disconnect=lambda _: gone())
        self.idle, self.unreadable, self.changed, self.refused, self.last = False, False, False, "", time.monotonic()
        self._take, self._bytes = take, bytearray()

    def data_received(self, data: bytes) -> None:
        self.last = time.monotonic()
        self._bytes += data
        while len(self._bytes) >= 8:
            size, kind = struct.unpack_from("<II", self._bytes)
            if not 8 <= size <= MOST_BYTES:
                self.unreadable = True
                self.abort()
                return
            if len(self._bytes) < size:
                return
            packet = bytes(self._bytes[:size])
            del self._bytes[:size]
            if kind == _DATA:
                self.changed, self.idle = self.changed or self.idle, False
                self._take(packet[8:], self.last)
            elif kind == _NO_MORE_DATA:
                self.idle = True
            elif kind == _EVENT:
                self.changed = self.changed or packet[8:9] in _BEGINNINGS
            elif kind in _ANSWERS:
                self.refused = packet[8:].decode("utf-8", "replace").strip("\0 ")[:200] if kind == _ERROR else self.refused
                super().data_received(packet)

    def abort(self) -> None:
        """Let go of the connection at once."""
        if self.transport is not None:
            self.transport.abort()


class QtmLink:
    """A connection to QTM in a thread of its own, made anew where it breaks; packets wait in a queue that is bounded.

    place       of the machine that runs QTM, and its port
    components  what it shall send, in its own words

    Raises AsterismError where nobody answers, or something else does.
    """

    def __init__(self, place: HostPort, components: str) -> None:
        self.settings, self.reconnected, self.version, self.unreadable = QtmSettings(), 0, "", 0
        self._place, self._components = place, components
        self._packets = deque[tuple[bytes, float]](maxlen=_KEPT)
        self._there, self._opened = threading.Condition(), threading.Event()
        self._problem = ""
        self._failed: Exception | None = None
        self._protocol: _Packets | None = None
        self._loop = asyncio.new_event_loop()
        self._task = self._loop.create_task(self._serve())
        self._thread = threading.Thread(target=self._run, name="live qtm", daemon=True)
        self._thread.start()
        self._opened.wait()
        if self._problem:
            self._thread.join()
            raise AsterismError(self._problem)

    @property
    def idle(self) -> bool:
        """Whether QTM says that no measurement is running."""
        return self._protocol is not None and self._protocol.idle

    def read(self, timeout: float) -> tuple[bytes, float] | None:
        """The next data packet, and when it arrived; None where none came in time. Raises what ended the connection for good."""
        if self._failed is not None:
            raise self._failed
        with self._there:
            if not self._packets:
                self._there.wait(timeout)
            return self._packets.popleft() if self._packets else None

    def close(self) -> None:
        """End the connection and its thread."""
        # A loop that has ended takes nothing any more.
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join(timeout=_PATIENCE)
        with self._there:
            self._there.notify_all()

    def _run(self) -> None:
        try:
            with contextlib.suppress(asyncio.CancelledError):
                self._loop.run_until_complete(self._task)
        except Exception as problem:  # told by whoever reads: a thread that ends is not seen
            self._failed = problem
        finally:
            self._opened.set()
            self._loop.close()

    def _take(self, packet: bytes, arrived: float) -> None:
        with self._there:
            self._packets.append((packet, arrived))
            self._there.notify()

    async def _serve(self) -> None:
        """Connect, and again where the connection breaks; return only where the first one fails."""
        try:
            while True:
                gone = asyncio.Event()
                problem = await self._connected(gone)
                if problem and not self._opened.is_set():
                    self._problem = problem
                    return
                if not problem:
                    self.reconnected += self._opened.is_set()
                    self._opened.set()
                    await self._watched(gone)
                self._abort()
                await asyncio.sleep(_AGAIN)
        finally:
            self._abort()
            await asyncio.sleep(0)

    def _abort(self) -> None:
        if self._protocol is not None:
            self._protocol.abort()

    async def _connected(self, gone: asyncio.Event) -> str:
        """Connect and begin the stream; what is wrong where that fails."""
        host, port = self._place.host, self._place.port
        try:
            made = self._loop.create_connection(lambda: _Packets(self._take, gone.set), host, port)
            _, protocol = await asyncio.wait_for(made, _PATIENCE)
        except (OSError, OverflowError) as problem:
            return (
                f"QTM does not answer at {host}, port {port} ({in_words(problem)}); start QTM there, look at Project Options, "
                "Input/Output, Real-Time Output, for its base port (the one to give is 1 higher), and let a firewall pass it (TCP)."
            )
        self._protocol = protocol
        try:
            await self._begun(protocol)
        except (QRTCommandException, OSError) as problem:
            said = protocol.refused or in_words(problem)
            self._abort()
            return (
                f"what answers at {host}, port {port}, is not QTM's real-time protocol with little-endian numbers ({said}); "
                "give its base port and 1, which is 22223 unless it was changed."
            )
        return ""

    async def _begun(self, protocol: _Packets) -> None:
        """Agree on a version, ask for the settings, and begin the stream."""
        for version in _VERSIONS:
            with contextlib.suppress(QRTCommandException):
                if (await asyncio.wait_for(protocol.send_command(f"version {version}"), _PATIENCE)).startswith(b"Version set"):
                    break
        else:
            raise QRTCommandException("no common version")
        connection = QRTConnection(protocol, timeout=_PATIENCE)
        self.version = (await connection.qtm_version()).decode("utf-8", "replace").removeprefix("QTM Version is ")[:40]
        await self._set(connection)
        protocol.refused = ""
        protocol.send_command(f"streamframes allframes {self._components}", callback=False)

    async def _set(self, connection: QRTConnection) -> None:
        """Ask for the settings, of which there are none before cameras are connected or a file is open."""
        with contextlib.suppress(QRTCommandException):
            self.settings = settings_of_xml(await connection.get_parameters(["general", "3d", "analog"])) or self.settings

    async def _watched(self, gone: asyncio.Event) -> None:
        """Return when the connection is gone, or QTM does not answer any more."""
        protocol = self._protocol
        assert protocol is not None
        connection = QRTConnection(protocol, timeout=_PATIENCE)
        while not gone.is_set():
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(gone.wait(), _QUIET / 20)
            if protocol.changed:
                protocol.changed = False
                with contextlib.suppress(OSError):
                    await self._set(connection)
            if time.monotonic() - protocol.last > _QUIET:
                try:
                    await connection.qtm_version()
                except (QRTCommandException, OSError):
                    break
        self.unreadable += protocol.unreadable

    def findings(self, name: str) -> list[Finding]:
        """What a person should know of the connection."""
        found = list[Finding]()
        if self.idle:
            mend = "Press File, New in QTM (Ctrl+N), or play a file with Play, Play with Real-Time Output (Ctrl+Shift+Space)."
            found.append(Finding("live-idle", Severity.NOTE, name, f"{name}: no measurement is running.", mend))
        if self._protocol is not None and self._protocol.refused:
            sentence = f"{name}: QTM refuses {self._components} ({self._protocol.refused})."
            mend = "Switch it on in Project Options, Processing, Real-time actions."
            found.append(Finding("live-not-streamed", Severity.WARNING, name, sentence, mend))
        if self.reconnected:
            found.append(reconnected(name, self.reconnected, "Look at the cable, and whether QTM was closed."))
        return found


class FromQtm:
    """A source that reads QTM's 3D points, with and without QTM's labels, which are passed over.

    place  of the machine that runs QTM, and its port
    rate   frames per second, NaN for what QTM says

    Raises AsterismError where nobody answers, or something else does.
    """

    def __init__(self, place: HostPort, rate: float = float("nan")) -> None:
        self._link = QtmLink(place, "3D 3DNoLabels Analog")
        self._analog: tuple[AnalogSamples, ...] = ()
        self._bad, self._labelled, self._step, self._begin = 0, False, 1, deque[LiveFrame]()
        self._place, self._rate, self._times = place, rate, StreamTimes(rate)
        try:
            self._seen_begin()
        except BaseException:
            self.close()
            raise

    @property
    def about(self) -> SourceAbout:
        """What is known so far: without a measurement QTM tells nothing yet."""
        settings = self._link.settings
        rate = self._rate if self._rate > 0 else settings.rate / self._step
        return SourceAbout(f"QTM {self._link.version} at {self._place.host}", rate, settings.vertical)

    def _seen_begin(self) -> None:
        """Look at the first frames, where some come: which step their numbers have."""
        until = time.monotonic() + 1.0
        while len(self._begin) < _TO_STEP and (left := until - time.monotonic()) > 0 and not self._link.idle:
            frame = self._next(min(left, 0.1))
            if frame is not None:
                self._begin.append(frame)
        steps = [after.number - before.number for before, after in zip(self._begin, list(self._begin)[1:], strict=False)]
        # One lost frame is no step: all are as long as the shortest, or a multiple of it.
        if len(self._begin) == _TO_STEP and min(steps) > 1 and all(step % min(steps) == 0 for step in steps):
            self._step = min(steps)

    @property
    def damaged(self) -> int:
        """Packets that could not be read."""
        return self._bad + self._link.unreadable

    def read(self, timeout: float) -> LiveFrame | None:
        """The next frame."""
        frame = self._begin.popleft() if self._begin else self._next(timeout)
        if frame is None:
            return None
        number = frame.number // self._step
        self._times.rate = self.about.rate
        return replace(frame, number=number, time=self._times.of(number, frame.time, frame.arrived))

    def _next(self, timeout: float) -> LiveFrame | None:
        until = time.monotonic() + timeout
        while (left := until - time.monotonic()) > 0:
            packet = self._link.read(left)
            if packet is None:
                continue
            points = points_of_packet(*packet, self._link.settings)
            if points is None:
                self._bad += 1
                continue
            self._labelled = self._labelled or points.labelled > 0
            self._analog = (*self._analog, *points.analog)[-_MOST_ANALOG:]
            if points.frame is not None:
                frame, self._analog = replace(points.frame, analog=self._analog), ()
                return frame
        return None

    def findings(self) -> list[Finding]:
        """What a person should know of it so far."""
        name = self.about.name
        found = self._link.findings(name)
        if self._labelled:
            found.append(labels_given(name))
        if self._step > 1:
            sentence = f"{name}: each {self._step}. frame of the cameras is sent, {self.about.rate:g} per second."
            mend = "For all of them set Project Options, Processing, Real-time actions, to the rate of the cameras."
            found.append(Finding("live-rate-divided", Severity.NOTE, name, sentence, mend))
        if self.about.vertical is None and not self._link.idle:
            found.append(axis_unknown(name, "z"))
        if self._times.made:
            found.append(times_made(name))
        return found

    def close(self) -> None:
        """End the connection."""
        self._link.close()


class QtmBlobs:
    """The blobs of QTM's cameras, as the sensors saw them: not linearized. Numbers are of one exposure of all cameras.

    place  of the machine that runs QTM, and its port
    Raises AsterismError where nobody answers, or something else does.
    """

    numbered_together = True

    def __init__(self, place: HostPort) -> None:
        self._link = QtmLink(place, "2D")
        self._bad, self._waiting = 0, deque[LiveBlobs]()
        self.name = f"QTM {self._link.version} at {place.host}"
        self._times = StreamTimes(self.rate)

    @property
    def cameras(self) -> tuple[str, ...]:
        """Serial numbers, as QTM's calibration export names its cameras."""
        return self._link.settings.cameras

    @property
    def rate(self) -> float:
        """Frames per second of each camera; NaN where QTM does not say it."""
        return self._link.settings.rate

    @property
    def damaged(self) -> int:
        """Packets that could not be read."""
        return self._bad + self._link.unreadable

    def read(self, timeout: float) -> LiveBlobs | None:
        """The next blobs of some camera."""
        until = time.monotonic() + timeout
        while not self._waiting and (left := until - time.monotonic()) > 0:
            packet = self._link.read(left)
            if packet is None:
                continue
            blobs = blobs_of_packet(*packet, self.cameras)
            if blobs is None:
                self._bad += 1
                continue
            self._waiting.extend(replace(each, time=self._times.of(each.number, each.time, each.arrived)) for each in blobs)
        return self._waiting.popleft() if self._waiting else None

    def findings(self) -> list[Finding]:
        """What a person should know of it so far."""
        return self._link.findings(self.name) + ([times_made(self.name)] if self._times.made else [])

    def close(self) -> None:
        """End the connection."""
        self._link.close()
