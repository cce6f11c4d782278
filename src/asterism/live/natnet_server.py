"""Labelled frames in; the stream of a NatNet 3.1 server, as Motive has it, out: for programs that read OptiTrack."""

from __future__ import annotations

import select
import socket
import struct
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.live.addresses import Query
from asterism.live.analysis import AnalysedFrame
from asterism.live.clock import SourceClock
from asterism.live.datagrams import LARGEST
from asterism.live.frames import TURN, SourceAbout

_VERSION = (3, 1, 0, 0)
_CONNECT, _SERVER_INFO, _REQUEST, _RESPONSE, _REQUEST_MODEL, _MODEL, _REQUEST_FRAME, _FRAME = range(8)
_DISCONNECT, _KEEP_ALIVE, _ECHO, _ECHO_BACK, _UNRECOGNIZED = 9, 10, 12, 13, 100
"""Kinds of messages, by their numbers in the protocol."""
_GROUP, _DATA = "239.255.42.99", 1511
"""Where Motive sends unless its settings say otherwise."""
_TICKS = 1_000_000_000
"""Of the clock of the time stamps in a second."""
_GONE = 10.0
"""s without a word after which a client is not sent to any more: clients speak each second. Half of it loses some that are busy; with twice
as much a network is flooded for longer."""
_CLIENTS = 16
"""Clients at once, where each is sent to. Twice as many take 30 MB/s; a multicast group has no limit."""
_SEEN, _OF_MODEL, _UNLABELLED = 0x02, 0x08, 0x10
"""Bits of a marker: cameras saw it, it belongs to a marker set, it has no label."""
_LABELLED = np.dtype([("id", "<i4"), ("place", "<f4", 3), ("size", "<f4"), ("flags", "<u2"), ("residual", "<f4")])
_TITLE = b"Asterism\0"
"""The name of the marker set."""
_FIRST_UNLABELLED = 50_000
"""The number from which markers without a label count in Motive."""


@dataclass(frozen=True)
class NatNetPlace:
    """Where a server is: address of this machine and port for commands; the group and the port of frames, "" for to each client alone."""

    host: str
    commands: int = 1510
    group: str = _GROUP
    data: int = _DATA

    @classmethod
    def of(cls, address: str) -> NatNetPlace:
        """The place of an address: natnet://127.0.0.1, with ?unicast=1, or ?multicast=239.255.42.99&data=1511. Raises AsterismError.

        >>> NatNetPlace.of("natnet://192.168.1.20?unicast=1")
        NatNetPlace(host='192.168.1.20', commands=1510, group='', data=1511)
        """
        query = Query(address, bare=True)
        group = "" if query.switch("unicast") else query.text("multicast", _GROUP)
        query.texts("multicast")
        data = query.whole("data", _DATA)
        query.check_all_used()
        try:
            parts = urlsplit(address)
            host, commands = parts.hostname or "", 1510 if parts.port is None else parts.port
            known = 0 < data < 1 << 16 and host and (not group or 224 <= socket.inet_aton(group)[0] < 240)
        except (ValueError, OSError):
            known = False
        if not known:
            raise AsterismError(
                f"{address} is no address at which frames can be sent as Motive does; write for example natnet://192.168.1.20 (this "
                "machine's), with ?unicast=1 to send to each client alone, or ?multicast=239.255.42.99&data=1511."
            )
        return cls(host, commands, group, data)


class ToNatNet:
    """Sends each labelled frame as Motive does: a marker set with its names, the labelled markers, and the others.

    Coordinates are m in the source's axes; a marker of the set that is not seen is NaN there, and is not among the labelled ones. Clients
    are answered by a thread of their own. Raises AsterismError where the port is taken, as on a machine on which Motive runs.
    """

    def __init__(self, address: str, about: SourceAbout) -> None:
        self.name, self._place, self._about = address.partition("?")[0], NatNetPlace.of(address), about
        self._commands = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._frames = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._commands.bind((self._place.host, self._place.commands))
            # A full buffer of the network must not hold the next frame back.
            self._commands.setblocking(False)
            self._frames.setblocking(False)
            if self._place.group:
                own = socket.gethostbyname(self._place.host)
                self._frames.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(own))
        except OSError as problem:
            self._commands.close()
            self._frames.close()
            raise AsterismError(
                f"{self.name} cannot be served ({problem.strerror or problem}): the address is not of this machine, or another program has "
                f"port {self._place.commands}, as Motive does; write another one, as in natnet://127.0.0.1:1610."
            ) from problem
        self._guard = threading.Lock()
        self._clients: dict[Any, float] = {}
        self._refused = 0
        self._clock = SourceClock()
        self._markers: tuple[str, ...] = ()
        self._changed = False
        self._last = b""
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=self.name, daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """The port for commands: a free one where 0 was asked for."""
        return int(self._commands.getsockname()[1])

    def send(self, frame: AnalysedFrame) -> None:
        """Send a frame to the group, or to each client. Raises OSError where the network does not take it."""
        data = self.packet(frame)
        if len(data) > LARGEST:
            raise OSError(f"frame {frame.labelled.frame.number} has {len(data)} bytes, more than a datagram holds")
        now = time.monotonic()
        with self._guard:
            self._last = data
            for client in [client for client, heard in self._clients.items() if now - heard > _GONE]:
                del self._clients[client]
            clients = list(self._clients)
        if self._place.group:
            self._frames.sendto(data, (self._place.group, self._place.data))
            return
        for client in clients:
            # Clients take frames where they sent their commands from, and from where they sent them to.
            self._commands.sendto(data, client)

    def packet(self, analysed: AnalysedFrame) -> bytes:
        """A frame of data, version 3.1."""
        labelled, frame = analysed.labelled, analysed.labelled.frame
        if labelled.markers != self._markers:
            # Clients ask for the names again when this is said.
            self._markers, self._changed = labelled.markers, True
        given = (labelled.indices >= 0).nonzero()[0]
        of_set = labelled.places.astype("<f4")
        free = np.ones(len(frame.points), dtype=bool)
        free[labelled.indices[given]] = False
        others = frame.points[free].astype("<f4")
        listed = np.zeros(len(given) + len(others), dtype=_LABELLED)
        listed["id"][: len(given)] = (1 << 16) + given + 1
        listed["id"][len(given) :] = _FIRST_UNLABELLED + np.arange(len(others))
        listed["place"][: len(given)], listed["place"][len(given) :] = of_set[given], others
        listed["flags"][: len(given)], listed["flags"][len(given) :] = _SEEN | _OF_MODEL, _SEEN | _UNLABELLED
        self._clock.lateness(frame.time, frame.arrived)
        ticks = [max(0, int(_TICKS * at)) for at in (frame.time + self._clock.offset, frame.arrived, time.monotonic())]
        flags, self._changed = 2 * self._changed, False
        parts = [
            struct.pack("<i", frame.number % (1 << 31)),
            struct.pack("<i", bool(self._markers)),
            (_TITLE + struct.pack("<i", len(of_set)) + of_set.tobytes()) if self._markers else b"",
            struct.pack("<i", len(others)) + others.tobytes(),
            # no rigid bodies and no skeletons
            struct.pack("<2i", 0, 0),
            struct.pack("<i", len(listed)) + listed.tobytes(),
            # no force plates, no devices, no time code
            struct.pack("<2i2I", 0, 0, 0, 0),
            struct.pack("<d3QHi", frame.time, *ticks, flags, 0),
        ]
        return _message(_FRAME, b"".join(parts))

    def _serve(self) -> None:
        """The thread that answers clients."""
        while not self._closed.is_set():
            if not select.select([self._commands], [], [], TURN)[0]:
                continue
            try:
                data, client = self._commands.recvfrom(LARGEST)
            except OSError:
                # Windows says here that a client is gone.
                continue
            answer = self.answer(data, client)
            if answer:
                with suppress(OSError):
                    self._commands.sendto(answer, client)

    def answer(self, data: bytes, client: Any) -> bytes:
        """What is answered to a client's message; nothing to one that is none. Never raises."""
        if len(data) < 4:
            return b""
        kind, size = struct.unpack_from("<HH", data)
        content = data[4 : 4 + size]
        if kind in (_CONNECT, _KEEP_ALIVE):
            with self._guard:
                if client in self._clients or len(self._clients) < _CLIENTS:
                    self._clients[client] = time.monotonic()
                else:
                    self._refused += 1
            return self._info() if kind == _CONNECT else b""
        if kind == _DISCONNECT:
            with self._guard:
                self._clients.pop(client, None)
        if kind == _REQUEST_MODEL:
            return _message(_MODEL, self._model())
        if kind == _REQUEST_FRAME:
            return self._last
        if kind == _ECHO and len(content) >= 8:
            return _message(_ECHO_BACK, content[:8] + struct.pack("<Q", time.monotonic_ns()))
        if kind == _REQUEST:
            return self._told(content.partition(b"\0")[0].strip().lower())
        return b""

    def _info(self) -> bytes:
        group = self._place.group
        return _message(
            _SERVER_INFO,
            b"Asterism".ljust(256, b"\0")
            + bytes((1, 0, 0, 0))
            + bytes(_VERSION)
            + struct.pack("<QHB4s", _TICKS, self._place.data, bool(group), socket.inet_aton(group or "0.0.0.0")),
        )

    def _model(self) -> bytes:
        markers = self._markers
        if not markers:
            return struct.pack("<i", 0)
        # One part, a marker set.
        names = b"".join(name.encode().replace(b"\0", b"")[:255] + b"\0" for name in markers)
        return struct.pack("<ii", 1, 0) + _TITLE + struct.pack("<i", len(markers)) + names

    def _told(self, question: bytes) -> bytes:
        """What a client may ask by a word."""
        vertical = self._about.vertical
        if question == b"framerate" and np.isfinite(self._about.rate):
            return _message(_RESPONSE, struct.pack("<f", self._about.rate))
        if question == b"unitstomillimeters":
            return _message(_RESPONSE, struct.pack("<f", 1000.0))
        if question == b"upaxis" and vertical is not None:
            return _message(_RESPONSE, struct.pack("<i", int(np.argmax(np.abs(vertical)))))
        return _message(_UNRECOGNIZED, b"")

    def findings(self) -> list[Finding]:
        """That clients were refused."""
        if not self._refused:
            return []
        sentence = f"{self.name}: clients were refused, since {_CLIENTS} at a time is the most."
        return [Finding("live-refused", Severity.WARNING, self.name, sentence, "Leave ?unicast away: a group has no limit.")]

    def close(self) -> None:
        """Stop serving."""
        self._closed.set()
        self._thread.join(timeout=2.0)
        self._commands.close()
        self._frames.close()


def _message(kind: int, content: bytes) -> bytes:
    # Larger than a datagram is refused where it is sent.
    return struct.pack("<HH", kind, min(len(content), 0xFFFF)) + content
