"""The address of a Vicon DataStream server (Nexus, Tracker, Shogun, Evoke) in; its markers, frame by frame, out.

The layout is that of the vendor's public client (Vicon DataStream SDK, MIT). The package `motioncapture`, which wraps it, was tried first:
its Python part gives rigid bodies and no markers, no frame numbers, and never returns where nobody answers.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import time
from dataclasses import dataclass, field

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.live.addresses import in_words
from asterism.live.datagrams import HostPort
from asterism.live.frames import MOST_POINTS, DamagedPacket, LiveFrame, SourceAbout, believable, joined
from asterism.live.reporting import axis_unknown, labels_given, reconnected, times_made
from asterism.recording import Floats

PORT = 801
"""Where Vicon's programs serve the stream."""
_OBJECTS, _KINDS, _REQUEST, _CONTENTS = 0x1A2B0001, 100001, 100002, 100004
_STREAM, _FRAME, _LABELLED, _UNLABELLED, _APPLICATION = 1, 5, 6, 7, 37
"""Kinds of objects of the stream."""
_WANTED = (_STREAM, _FRAME, _LABELLED, _UNLABELLED, _APPLICATION)
_TICKS = 135e6
"""Of the stream's clock in a second, by which the length of a frame is told."""
_PLACE = {_LABELLED: 16, _UNLABELLED: 8}
"""Bytes before the place (x, y, z as double, mm) of a marker: subject, marker and radius, or the radius alone. What is behind the place has
grown with versions, so that the size of a marker is that of the list by the number of markers."""
_MOST_BYTES = 1 << 24
"""Bytes of a packet that are believed: `MOST_POINTS` markers are 0.2 MB. Half and double do as well."""
_PATIENCE = 3.0
"""s for an answer. Half of it loses to a busy Windows; twice as much is a wait."""
_AGAIN = 1.0
"""s between two tries to reach a server that is gone. Half of it asks twice for nothing; with twice as much it is missed for a second
longer."""


@dataclass
class ViconState:
    """What the stream has said: objects that do not change are not sent again.

    rate      frames per second; NaN where it was not told
    vertical  (3,) what points up; None where it was not told
    """

    rate: float = float("nan")
    vertical: Floats | None = None
    _lists: dict[int, Floats] = field(default_factory=dict)

    def frame(self, packet: bytes, arrived: float) -> tuple[LiveFrame, int] | None:
        """The frame in a packet (without its 8 bytes of kind and length) and how many of its points have a label; None where it has none.

        Times are 0: they are those of the numbers. Raises DamagedPacket; then nothing has changed.
        """
        objects = dict(_objects(packet))
        lists = {kind: self._lists.get(kind, np.empty((0, 3))) for kind in _unchanged(objects.get(_CONTENTS, b""))}
        lists |= {kind: _markers(objects[kind], _PLACE[kind]) for kind in _PLACE if kind in objects}
        (period,) = _unpacked("<q", objects.get(_STREAM, bytes(8)))
        (axis,) = _unpacked("<b", objects.get(_APPLICATION, b"\xff"))
        number = None if _FRAME not in objects else int(_unpacked("<I", objects[_FRAME])[0])
        none = np.empty((0, 3))
        labelled = lists.get(_LABELLED, none)
        points = joined(labelled, lists.get(_UNLABELLED, none))
        if len(points) > MOST_POINTS:
            raise DamagedPacket
        if period > 0 and 1 <= _TICKS / period <= 1e4:
            self.rate = _TICKS / period
        if axis in (0, 1):
            self.vertical = np.eye(3)[2 - axis]
        if number is None:
            return None
        self._lists = lists
        return LiveFrame(number, 0.0, arrived, points), len(labelled)


def _unpacked(layout: str, content: bytes) -> tuple[int, ...]:
    if len(content) < struct.calcsize(layout):
        raise DamagedPacket
    return struct.unpack_from(layout, content)


def _objects(packet: bytes) -> list[tuple[int, bytes]]:
    """The kind and the content of each object of a packet."""
    found, at = list[tuple[int, bytes]](), 0
    while at < len(packet):
        kind, size = _unpacked("<II", packet[at : at + 8])
        if at + 8 + size > len(packet):
            raise DamagedPacket
        found.append((kind, packet[at + 8 : at + 8 + size]))
        at += 8 + size
    return found


def _kinds(content: bytes) -> set[int]:
    """A set of kinds of objects."""
    (count,) = _unpacked("<I", content)
    if 4 + 4 * count > len(content):
        raise DamagedPacket
    return set(struct.unpack_from(f"<{count}I", content, 4))


def _unchanged(content: bytes) -> set[int]:
    """Kinds of objects that are as in the frame before: how many there are of each comes first."""
    if not content:
        return set()
    return _kinds(content[4 + 8 * _unpacked("<I", content)[0] :])


def _markers(content: bytes, place: int) -> Floats:
    """(n, 3) m of a list of markers."""
    (count,) = _unpacked("<I", content)
    size = (len(content) - 4) // count if count else 0
    if count > MOST_POINTS or (count and size < place + 24):
        raise DamagedPacket
    rows = np.frombuffer(content, dtype=np.uint8, count=count * size, offset=4).reshape(count, size)
    with np.errstate(invalid="ignore", over="ignore"):
        return believable(1e-3 * rows[:, place : place + 24].copy().view("<f8").reshape(-1, 3))


def _packet(kind: int, content: bytes) -> bytes:
    """A packet of one object."""
    return struct.pack("<IIII", _OBJECTS, 8 + len(content), kind, len(content)) + content


class FromVicon:
    """A source that reads the markers of Vicon's stream, with and without Vicon's labels, which are passed over.

    place  of the machine that runs Nexus, Tracker or another of Vicon's programs, and its port
    rate   frames per second, NaN for what the stream says

    The server sends each frame as soon as it is there. A connection that breaks is made again. Frames have numbers and no times: times are
    those of the numbers. Raises AsterismError where nobody answers, or something else does.
    """

    def __init__(self, place: HostPort, rate: float = float("nan")) -> None:
        self.damaged, self._place, self._rate, self._closed = 0, place, rate, False
        self._reconnected, self._labelled, self._without = 0, False, False
        self._bytes, self._tried = bytearray(), -np.inf
        self._state = ViconState()
        self._socket = self._connected()
        self._first = self._next(time.monotonic() + 1.0)
        self._begin: tuple[int, float] | None = None

    @property
    def about(self) -> SourceAbout:
        """What is known so far: a program that is not live tells nothing yet."""
        rate = self._rate if self._rate > 0 else self._state.rate
        return SourceAbout(f"Vicon at {self._place.host}", rate, self._state.vertical)

    def _connected(self, patience: float = _PATIENCE) -> socket.socket:
        """Connect, and ask for markers as they come; patience: s."""
        self._tried = time.monotonic()
        where = f"{self._place.host}, port {self._place.port}"
        try:
            made = socket.create_connection((self._place.host, self._place.port), timeout=patience)
        except (OSError, OverflowError) as problem:
            raise AsterismError(
                f"no Vicon program answers at {where} ({in_words(problem)}); start Nexus or Tracker there, and let a firewall pass port "
                f"{self._place.port} (TCP)."
            ) from problem
        try:
            made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            _ask_whether_alive(made)
            self._bytes.clear()
            offered = self._offered(made, time.monotonic() + patience)
            if not offered & {_LABELLED, _UNLABELLED}:
                raise AsterismError(f"Vicon at {where} offers no markers; switch on labelled and unlabelled markers in its data stream.")
            self._without = _UNLABELLED not in offered
            wanted = sorted(offered & {*_WANTED, _CONTENTS})
            made.sendall(_packet(_KINDS, struct.pack(f"<{len(wanted) + 1}I", len(wanted), *wanted)))
            made.sendall(_packet(_REQUEST, b"\1"))
        except (OSError, DamagedPacket) as problem:
            made.close()
            raise AsterismError(
                f"what answers at {where} is not Vicon's DataStream ({in_words(problem)}); its port is {PORT} unless it was changed."
            ) from problem
        except AsterismError:
            made.close()
            raise
        return made

    def _offered(self, made: socket.socket, until: float) -> set[int]:
        """The kinds of objects that the server has, which it tells first."""
        while (packet := self._cut()) is None:
            made.settimeout(max(0.01, until - time.monotonic()))
            data = made.recv(1 << 16)
            if not data:
                raise DamagedPacket
            self._bytes += data
        return _kinds(dict(_objects(packet)).get(_KINDS, b""))

    def _cut(self) -> bytes | None:
        """The next packet that is whole, without its kind and length."""
        if len(self._bytes) < 8:
            return None
        kind, size = struct.unpack_from("<II", self._bytes)
        if kind != _OBJECTS or size > _MOST_BYTES:
            raise DamagedPacket
        if len(self._bytes) < 8 + size:
            return None
        packet = bytes(self._bytes[8 : 8 + size])
        del self._bytes[: 8 + size]
        return packet

    def read(self, timeout: float) -> LiveFrame | None:
        """The next frame."""
        frame, self._first = self._first or self._next(time.monotonic() + timeout), None
        if frame is None:
            return None
        # A server that was started again begins its numbers anew.
        if self._begin is None or frame.number < self._begin[0]:
            self._begin = (frame.number, frame.arrived)
        since = frame.number - self._begin[0]
        rate = self.about.rate
        at = since / rate if rate > 0 else frame.arrived - self._begin[1]
        return LiveFrame(frame.number, at, frame.arrived, frame.points)

    def _next(self, until: float) -> LiveFrame | None:
        while not self._closed and (left := until - time.monotonic()) > 0:
            try:
                packet = self._cut()
            except DamagedPacket:
                # Nobody knows any more where a packet begins: the stream is begun anew.
                self.damaged += 1
                self._bytes.clear()
                self._socket.close()
                continue
            if packet is None:
                self._filled(left)
                continue
            try:
                found = self._state.frame(packet, time.monotonic())
            except DamagedPacket:
                self.damaged += 1
                continue
            if found is not None:
                frame, labelled = found
                self._labelled = self._labelled or labelled > 0
                return frame
        return None

    def _filled(self, left: float) -> None:
        """Wait for bytes; connect again where the connection is gone."""
        try:
            ready, _, _ = select.select([self._socket], [], [], left)
            data = self._socket.recv(1 << 18) if ready else None
        except (OSError, ValueError):
            data = b""
        if data is None:
            return
        self._bytes += data
        if data or self._closed:
            return
        # closed by the other side, or the cable is out
        wait = min(left, self._tried + _AGAIN - time.monotonic())
        if wait > 0:
            time.sleep(wait)
            return
        self._socket.close()
        with contextlib.suppress(AsterismError):
            # Half a second: whoever ends the session waits for it.
            self._socket = self._connected(_AGAIN / 2)
            self._reconnected += 1
        if self._closed:
            self._socket.close()

    def findings(self) -> list[Finding]:
        """What a person should know of it so far."""
        name, found = self.about.name, list[Finding]()
        if self._begin is None and self._first is None:
            mend = "Go live in Nexus or Tracker, or play a trial there."
            found.append(Finding("live-idle", Severity.NOTE, name, f"{name}: no frames come yet.", mend))
        if self._without:
            mend = "Switch on unlabelled markers in the data stream of the program."
            sentence = f"{name}: only markers with a label are streamed."
            found.append(Finding("live-not-streamed", Severity.WARNING, name, sentence, mend))
        if self._reconnected:
            found.append(reconnected(name, self._reconnected, "Look at the cable, and whether the program was closed."))
        if self._labelled:
            found.append(labels_given(name))
        if self.about.vertical is None and self._begin is not None:
            found.append(axis_unknown(name, "z"))
        if not self.about.rate > 0 and self._begin is not None:
            found.append(times_made(name))
        return found

    def close(self) -> None:
        """End the connection."""
        self._closed = True
        self._socket.close()


def _ask_whether_alive(made: socket.socket) -> None:
    """Have the system notice after five seconds that a cable is out, where it can."""
    made.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in (("TCP_KEEPIDLE", 2), ("TCP_KEEPALIVE", 2), ("TCP_KEEPINTVL", 1), ("TCP_KEEPCNT", 3)):
        with contextlib.suppress(OSError):
            if hasattr(socket, option):
                made.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
