"""OptiTrack Motive's stream (NatNet 2.5 to 4.x): packets in; the points of each frame out.

The layout is that of the vendor's public depacketizing examples. The package `natnet` was tried first: a damaged packet makes it ask for
gigabytes, and it reads nothing before the server has answered.
"""

from __future__ import annotations

import socket
import struct
import time
from dataclasses import dataclass

import numpy as np

from asterism.errors import AsterismError
from asterism.live.datagrams import LARGEST, HostPort
from asterism.live.frames import MOST_POINTS, LiveFrame, SourceAbout, believable, joined

COMMANDS = 1510
"""The port at which Motive takes commands unless its settings say otherwise."""
_CONNECT, _SERVER_INFO, _FRAME, _KEEP_ALIVE = 0, 1, 7, 10
_PATIENCE = 3.0
"""s until a server that does not answer is given up: three questions. Half of it loses to a busy Windows; twice as much is a wait."""
_ALIVE = 1.0
"""s between two signs of life; a server that sends to one client alone stops after some seconds without."""
_LATEST = (4, 4)
"""A newer version is read as this one, since newer ones say how long their parts are."""


class _Damaged(Exception):
    """A packet ends before what it announces."""


class _Packet:
    """Reads a packet from the front; never beyond its end, and never more elements than it has bytes for."""

    def __init__(self, data: bytes, at: int = 0) -> None:
        self.data, self.at = data, at

    def take(self, layout: str) -> tuple[float, ...]:
        size = struct.calcsize(layout)
        if self.at + size > len(self.data):
            raise _Damaged
        values = struct.unpack_from(layout, self.data, self.at)
        self.at += size
        return values

    def count(self, least: int) -> int:
        """A number of elements of at least so many bytes."""
        count = int(self.take("<i")[0])
        if count < 0 or count * least > len(self.data) - self.at:
            raise _Damaged
        return count

    def skip(self, size: int) -> None:
        if size < 0 or self.at + size > len(self.data):
            raise _Damaged
        self.at += size

    def name(self) -> str:
        """A text that ends with a zero."""
        end = self.data.find(b"\0", self.at, self.at + 256)
        if end < 0:
            raise _Damaged
        text = self.data[self.at : end].decode("utf-8", "replace")
        self.at = end + 1
        return text

    def records(self, count: int, size: int) -> np.ndarray:
        """(count, size) bytes."""
        if count * size > len(self.data) - self.at:
            raise _Damaged
        found = np.frombuffer(self.data, dtype=np.uint8, count=count * size, offset=self.at).reshape(count, size)
        self.at += count * size
        return found


@dataclass(frozen=True)
class NatNetServer:
    """Who answers: the program and its version, the version of its stream, and to which group it sends, "" where to each client alone."""

    name: str
    program: tuple[int, ...]
    stream: tuple[int, int]
    group: str = ""
    port: int = 1511


def server_of_packet(data: bytes) -> NatNetServer | None:
    """The server that an answer to a greeting names; None where the packet is none."""
    try:
        packet = _Packet(data)
        kind, size = packet.take("<HH")
        if kind != _SERVER_INFO or size > len(data) - 4:
            return None
        name = bytes(packet.records(1, 256)[0]).partition(b"\0")[0].decode("utf-8", "replace")
        program, stream = packet.take("<4B"), packet.take("<4B")
    except _Damaged:
        return None
    group, port = "", 1511
    try:
        # Since version 3: the clock's frequency, and where frames are sent.
        _, port_said, is_group, *address = packet.take("<QHB4B")
        group, port = (".".join(str(int(part)) for part in address) if is_group else ""), int(port_said) or port
    except _Damaged:
        group = "239.255.42.99"
    return NatNetServer(name, tuple(int(part) for part in program), (int(stream[0]), int(stream[1])), group, port)


def frame_of_packet(data: bytes, version: tuple[int, int], arrived: float) -> LiveFrame | None:
    """The frame in a packet; None where the packet is of another kind, or damaged. Never raises.

    version  of the stream, as the server says it
    Points are all markers that cameras saw. A hidden marker has a place, too, which Motive fills in by its own model: it is left out.
    """
    try:
        packet = _Packet(data)
        kind, size = packet.take("<HH")
        if kind != _FRAME or size > len(data) - 4:
            return None
        return _frame(packet, version, arrived)
    except _Damaged:
        return None


def _frame(packet: _Packet, version: tuple[int, int], arrived: float) -> LiveFrame | None:
    number = int(packet.take("<i")[0])
    for _ in range(_part(packet, version, 5)):
        packet.name()
        packet.records(packet.count(12), 12)
    others = packet.records(_part(packet, version, 12), 12).copy().view("<f4").reshape(-1, 3)
    _pass_over_bodies(packet, version)
    seen = _seen_markers(packet, version)
    # Force plates since 2.9, devices since 2.11: a number, and channels with their samples.
    for _ in range((version >= (2, 9)) + (version >= (2, 11))):
        for _ in range(_part(packet, version, 8)):
            packet.take("<i")
            for _ in range(packet.count(4)):
                packet.records(packet.count(4), 4)
    packet.take("<II")
    at = float(packet.take("<d" if version >= (2, 7) else "<f")[0])
    # Numbers of a damaged packet may be none, and to convert them is then told as a warning.
    with np.errstate(invalid="ignore"):
        points = joined(believable(seen.astype(np.float64)), believable(others.astype(np.float64)))
    return LiveFrame(number, at, arrived, points) if np.isfinite(at) and len(points) <= MOST_POINTS else None


def _part(packet: _Packet, version: tuple[int, int], least: int) -> int:
    """How many elements the next part has, of at least so many bytes each."""
    count = packet.count(least)
    # Newer versions say the size of the part behind it.
    if version >= (4, 1):
        packet.take("<i")
    return count


def _pass_over_bodies(packet: _Packet, version: tuple[int, int]) -> None:
    """Rigid bodies, skeletons and, since 4.1, assets: nothing of them is a point that a camera saw."""
    for _ in range(_part(packet, version, 32)):
        _rigid_body(packet, version)
    if version > (2, 0):
        for _ in range(_part(packet, version, 8)):
            packet.take("<i")
            for _ in range(packet.count(32)):
                _rigid_body(packet, version)
    if version >= (4, 1):
        # A number, rigid bodies of 38 bytes, markers of 26.
        for _ in range(_part(packet, version, 12)):
            packet.take("<i")
            packet.records(packet.count(38), 38)
            packet.records(packet.count(26), 26)


def _seen_markers(packet: _Packet, version: tuple[int, int]) -> np.ndarray:
    """(n, 3) m, markers that are not hidden, of the list that versions since 2.3 have."""
    if version < (2, 3):
        return np.empty((0, 3))
    size = 20 + (2 if version >= (2, 6) else 0) + (4 if version >= (3, 0) else 0)
    markers = packet.records(_part(packet, version, size), size)
    places = markers[:, 4:16].copy().view("<f4").reshape(-1, 3)
    return places[markers[:, 20] & 1 == 0] if version >= (2, 6) else places


def _rigid_body(packet: _Packet, version: tuple[int, int]) -> None:
    packet.skip(32)
    if version < (3, 0):
        # Its markers: places, numbers and sizes.
        packet.records(packet.count(20), 20)
    packet.skip(4 + (2 if version >= (2, 6) else 0))


class NatNet:
    """A source that reads Motive's stream.

    place  of the machine on which Motive runs, and its port for commands
    local  address of this machine in that network; "" for whichever leads there
    rate   frames per second; Motive's stream does not say it

    Motive's axes: y up, unless its settings say z. Raises AsterismError where nobody answers, or a port is taken.
    """

    def __init__(self, place: HostPort, local: str = "", rate: float = float("nan")) -> None:
        self.damaged = 0
        self._place = place
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sockets = [self._socket]
        try:
            self._socket.bind((local, 0))
            self.server = self._greeted()
            if self.server.group:
                self._sockets.append(_in_group(self.server.group, self.server.port, local))
        except OSError as problem:
            self.close()
            raise AsterismError(f"{place.host}: cannot be reached ({problem}); look at the address and the network.") from problem
        except AsterismError:
            self.close()
            raise
        program = ".".join(str(part) for part in self.server.program[:2])
        self.about = SourceAbout(f"{self.server.name} {program} at {place.host}", rate, np.array([0.0, 1.0, 0.0]))
        self._said = time.monotonic()

    def _greeted(self) -> NatNetServer:
        until = time.monotonic() + _PATIENCE
        while time.monotonic() < until:
            self._say(_CONNECT, b"Ping\0")
            self._socket.settimeout(min(1.0, _PATIENCE / 3))
            try:
                data = self._socket.recv(LARGEST)
            except TimeoutError:
                continue
            except ConnectionError:
                time.sleep(0.2)
                continue
            server = server_of_packet(data)
            if server is not None:
                return server
        raise AsterismError(
            f"nobody answers at {self._place.host}, port {self._place.port}; in Motive switch on streaming (Settings, Streaming), with the "
            "network interface that leads here, and let a firewall pass its ports 1510 and 1511."
        )

    def _say(self, kind: int, text: bytes) -> None:
        self._socket.sendto(struct.pack("<HH", kind, len(text)) + text, (self._place.host, self._place.port))

    def read(self, timeout: float) -> LiveFrame | None:
        """The next frame that is whole."""
        import select

        until = time.monotonic() + timeout
        while (left := until - time.monotonic()) > 0:
            if not self.server.group and time.monotonic() - self._said > _ALIVE:
                self._said = time.monotonic()
                self._say(_KEEP_ALIVE, b"\0")
            try:
                ready, _, _ = select.select(self._sockets, [], [], left)
                data = ready[0].recv(LARGEST) if ready else b""
            except (OSError, ValueError):
                # closed meanwhile
                return None
            if not data:
                continue
            frame = frame_of_packet(data, min(self.server.stream, _LATEST), time.monotonic())
            if frame is not None:
                return frame
            if data[:2] == struct.pack("<H", _FRAME):
                self.damaged += 1
        return None

    def close(self) -> None:
        """Stop listening."""
        for each in self._sockets:
            each.close()


def _in_group(group: str, port: int, local: str) -> socket.socket:
    """A socket that gets what is sent to a group of machines."""
    listening = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    # Windows binds to no group.
    try:
        listening.bind((group, port))
    except OSError:
        listening.bind(("", port))
    own = socket.inet_aton(local) if local else struct.pack("=I", socket.INADDR_ANY)
    listening.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + own)
    return listening
