"""Points as JSON over UDP, one frame a datagram: the plain way in for whoever writes their own sender, and the plain way out."""

from __future__ import annotations

import json
import math
import select
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.live.clock import StreamTimes
from asterism.live.frames import FARTHEST, MOST_POINTS, LiveFrame, SourceAbout
from asterism.live.json_reading import json_of
from asterism.live.reporting import times_made
from asterism.recording.display import counted, listed

LARGEST = 65_507
"""Bytes of the largest UDP datagram."""
_METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Metres of each unit that a sender may say."""
LARGEST_NUMBER = 2**53
"""The largest number of a frame: JSON of some programs has floats alone, which are exact up to it. At 200 Hz it is never reached."""
NO_JSON = "it is no JSON in UTF-8 without a byte order mark, or was cut"
"""What is wrong with a message of something else."""
_COORDINATE = {int, float, type(None)}


def frame_as_json(frame: LiveFrame) -> bytes:
    """A frame as a datagram that `frame_of_json` reads: metres, with micrometres."""
    content: dict[str, Any] = {"frame": frame.number, "time": frame.time, "unit": "m", "points": np.round(frame.points, 6).tolist()}
    if frame.names:
        content["names"] = list(frame.names)
    return json.dumps(content, separators=(",", ":")).encode()


def frame_of_json(data: bytes, arrived: float) -> LiveFrame | None:
    """The frame in a datagram; None where it is damaged, or no frame at all. Never raises.

    {"frame": 12, "time": 0.12, "unit": "mm", "points": [[x, y, z], ...], "names": ["LASI", "", ...]}: unit is m, cm or mm, m where it is
    left out; names may be left out. A point with null or NaN is a missing one.
    """
    read = _read(data, arrived)
    return read if isinstance(read, LiveFrame) else None


def whole_number(value: object) -> int | None:
    """A number of a frame, which programs that know floats alone write as 12.0; None where it is none, or too large."""
    number = int(value) if type(value) is float and value.is_integer() else value
    return number if type(number) is int and abs(number) <= LARGEST_NUMBER else None


def why_damaged(data: bytes) -> str:
    """What is wrong with a datagram that `frame_of_json` does not take, for a person who writes a sender; "" where nothing is."""
    read = _read(data, 0.0)
    return read if isinstance(read, str) else ""


@dataclass
class DamagedJson:
    """What could not be read of what a sender sent.

    explain   what is wrong with a message
    count     messages
    numbered  those of them that had a number of a frame: it is missing among those that were read, and nothing was lost on the way
    why       what is wrong with the first, "" for none
    """

    explain: Callable[[bytes], str] = why_damaged
    count: int = 0
    numbered: int = 0
    why: str = ""

    def add(self, data: bytes) -> None:
        """Count a message."""
        self.count += 1
        self.why = self.why or self.explain(data)
        with suppress(ValueError, RecursionError):
            content = json.loads(data.decode("utf-8"))
            self.numbered += isinstance(content, dict) and whole_number(content.get("frame")) is not None

    def findings(self, where: str) -> list[Finding]:
        """How many, and what is wrong with the first."""
        sentence = f"{where}: {counted(self.count, 'packet')} could not be read; of the first, {self.why}."
        return [Finding("live-format", Severity.WARNING, where, sentence, "Send JSON as docs/live-sources.md says.")] if self.why else []


def _read(data: bytes, arrived: float) -> LiveFrame | str:
    """The frame, or what is wrong with it."""
    try:
        content = json_of(data)
    except (ValueError, RecursionError):
        return NO_JSON
    if not isinstance(content, dict):
        return "it is no object with frame, time and points"
    for key in ("frame", "time", "points"):
        if key not in content:
            return f'it has no "{key}", but {keys_of(content)}'
    at, rows, unit, names = content["time"], content["points"], content.get("unit", "m"), content.get("names", [])
    if (number := whole_number(content["frame"])) is None:
        return 'its "frame" is no whole number below 2^53'
    # Text and true would become numbers: a sender that mixes them is wrong, and is told.
    if type(at) not in (int, float) or not abs(at) < math.inf:
        return 'its "time" is no number'
    if not isinstance(unit, str) or unit not in _METRES:
        return 'its "unit" is not m, cm or mm'
    if not isinstance(rows, list) or len(rows) > MOST_POINTS:
        return f'its "points" are no list of at most {MOST_POINTS} [x, y, z]'
    if not all(isinstance(row, list) and len(row) == 3 and {type(value) for value in row} <= _COORDINATE for row in rows):
        return 'one of its "points" is not [x, y, z] in numbers or null'
    if not isinstance(names, list) or len(names) not in (0, len(rows)) or not all(isinstance(name, str) for name in names):
        return 'its "names" are not one text for each point'
    try:
        points, at, scale = np.array(rows, dtype=np.float64).reshape(-1, 3), float(at), _METRES[unit]
    except OverflowError:
        return "one of its numbers is too large"
    there = np.nonzero((np.abs(scale * points) < FARTHEST).all(axis=1))[0]
    # Millimetres that are called metres: such a frame is not an empty room.
    if 2 * len(there) < np.isfinite(points).all(axis=1).sum():
        return f"most of its points are farther than {FARTHEST:g} m, so that its unit is wrong or missing"
    kept = tuple(names[row] for row in there.tolist()) if names else ()
    return LiveFrame(number, at, arrived, scale * points[there], kept)


def keys_of(content: dict[str, Any]) -> str:
    """The keys of a message, a few of them, as a person reads them: one of them is often the one that lacks, misspelt."""
    return listed([f'"{key[:_KEY]}"' for key in content]) or "nothing"


_KEY = 20
"""Letters of a key that are told. Half of them cut those that are usual; double fills the terminal where something else sends."""


@dataclass(frozen=True)
class HostPort:
    """A host and a UDP port; "0.0.0.0" listens to the whole network, "127.0.0.1" to this machine only."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


_OTHERS = 16
"""Other senders that are told by their addresses; more are counted together. Half and double do as well: more are a network that is
misconfigured."""
_GONE = 1.0
"""s of silence of the sender after which another one is heard: it was begun anew, or another machine took over. With half of it a pause of
the network brings in a stranger; with twice as much a sender that was begun anew is missed for 2 s."""


_SINGLE, _NEAR = 3, 1000
"""Addresses in a row with a single frame each, after which a program opens a socket for each; and how far the number of the next one may be
from the last one then. Twice as many lose a second of a session that begins with a lost frame; half of them are two senders that take turns
by chance. Half or double the distance do as well: the network holds no frame back for long."""


class JsonSource:
    """What sources of JSON frames have in common: the counts of what could not be read."""

    def __init__(self) -> None:
        self._damaged = DamagedJson()

    @property
    def damaged(self) -> int:
        """Packets that could not be read."""
        return self._damaged.count

    @property
    def unread(self) -> int:
        """Frames that came and could not be read."""
        return self._damaged.numbered


class JsonDatagrams(JsonSource):
    """A source of frames that arrive as JSON, see `frame_of_json`.

    place  where to listen
    rate   frames per second that the sender was told to send

    One sender is heard. Another address takes its place where the one that is heard has been silent for a second. So does a new address
    that sends the very next number, as a program does that opens a socket for each frame; of such a program also numbers near it are taken.
    Frames of others are counted by address, and never mixed in.
    Raises AsterismError where the address is none of this machine's, or the port is taken.
    """

    def __init__(self, place: HostPort, rate: float = float("nan")) -> None:
        super().__init__()
        self.about = SourceAbout(f"JSON at {place}", rate)
        self._socket = ListeningSocket(place)
        self._times = StreamTimes(rate)
        self._heard: str = ""
        self._last, self._at = 0, -math.inf
        self._frames, self._single = 0, 0
        """frames of the address that is heard, and how many addresses in a row before it sent a single one"""
        self._others = dict[str, int]()
        self._waiting, self._taken_over = dict[str, int](), 0
        """frames that were not used, by address, since the last one of the address that is heard; those of addresses that took its place"""

    @property
    def port(self) -> int:
        """The port that is listened to: a free one where 0 was asked for."""
        return self._socket.port

    @property
    def overflowed(self) -> int:
        """Frames that came while this machine was too busy to read them."""
        return self._socket.overflowed

    def read(self, timeout: float) -> LiveFrame | None:
        """The next frame that is whole."""
        for data, sender, arrived in self._socket.received(timeout):
            frame = frame_of_json(data, arrived)
            if frame is None:
                self._damaged.add(data)
            elif self._hears(sender, frame):
                return replace(frame, time=self._times.of(frame.number, frame.time, frame.arrived))
        return None

    def findings(self) -> list[Finding]:
        """Other senders, frames without times, and what is wrong with the first datagram that could not be read."""
        found, where = [times_made(self.about.name)] if self._times.made else [], self.about.name
        if self._others:
            others = ", ".join(f"{address} ({count} frames)" for address, count in dict(self._others).items())
            sentence = f"{where}: several programs send to it. {self._heard} is heard; these were not: {others}."
            mend = "Stop the others, or give each a port of its own."
            found.append(Finding("live-other-sender", Severity.WARNING, where, sentence, mend))
        if waited := self._taken_over + sum(self._waiting.copy().values()):
            sentence = f"{where}: {counted(waited, 'frame')} came from a new address while the one before may still have sent: not used."
            found.append(Finding("live-new-sender", Severity.NOTE, where, sentence, "A sender that is begun anew is heard after a second."))
        return [*found, *overflow(where, self.overflowed), *self._damaged.findings(where)]

    def close(self) -> None:
        """Stop listening."""
        self._socket.close()

    def _hears(self, sender: str, frame: LiveFrame) -> bool:
        """Whether this is the sender that is heard."""
        if sender == self._heard:
            self._frames += 1
            # It goes on, so that the others are no sender that was begun anew.
            for other, count in self._waiting.items():
                key = other if other in self._others or len(self._others) < _OTHERS else "others"
                self._others[key] = self._others.get(key, 0) + count
            self._waiting = {}
        elif self._takes_over(sender, frame):
            self._single, self._frames = self._single + 1 if self._frames == 1 else 0, 1
            self._taken_over += self._waiting.pop(sender, 0)
        else:
            counts = self._others if sender in self._others else self._waiting
            key = sender if sender in counts or len(counts) < _OTHERS else "others"
            counts[key] = counts.get(key, 0) + 1
            return False
        self._heard, self._last, self._at = sender, frame.number, frame.arrived
        return True

    def _takes_over(self, sender: str, frame: LiveFrame) -> bool:
        """Whether an address takes the place of the one that is heard."""
        if not self._heard or frame.arrived - self._at > _GONE:
            return True
        if sender in self._others or sender in self._waiting:
            # It sends beside the other one, and its number is the next one by chance.
            return False
        near = abs(frame.number - self._last) < _NEAR and self._single >= _SINGLE
        return near or frame.number == self._last + 1


def socket_for(place: HostPort, example: str) -> tuple[socket.socket, Any]:
    """A UDP socket of the family of an address, and the address as sockets take it; example: of one. Raises AsterismError."""
    try:
        found = socket.getaddrinfo(place.host, place.port, type=socket.SOCK_DGRAM)
        # Of a name with both, such as localhost, most programs mean the address of four numbers.
        family, kind, _, _, address = min(found, key=lambda each: each[0] != socket.AF_INET)
        return socket.socket(family, kind), address
    except (OSError, OverflowError) as problem:
        raise AsterismError(f"{place} is no address; write for example {example}.") from problem


RECEIVE_BUFFER = 1 << 20
"""Bytes that the system keeps while we are busy: 0.3 s of 59 markers at 200 Hz as JSON. Half of it loses frames at each pause of a busy
machine; with twice as much what waits is older than what is shown may be."""


_TIMESTAMPS = 35
"""SO_TIMESTAMPNS of Linux, which `socket` has no name for: the system says with each datagram when it came."""
_OVERFLOWS = 40
"""SO_RXQ_OVFL, the same for how many datagrams it has left out, since no more of them could wait."""
_TIMESPEC, _COUNT = struct.Struct("@ll"), struct.Struct("@I")
_NOTES = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(_COUNT.size) if hasattr(socket, "CMSG_SPACE") else 0
"""Bytes of both, as the system lays them out; Windows has none."""


class DatagramReader:
    """Reads datagrams, each with when it came: by the system's own stamp where it gives one, as Linux does, else when it is read.

    A datagram that waited in the socket, while this program started or was busy, is told as old as it is. A wall clock that is set
    meanwhile moves none before the one ahead of it, nor behind now.

    overflowed  datagrams that the system left out, since no more could wait to be read; 0 where it does not say so
    """

    def __init__(self, listening: socket.socket) -> None:
        self._socket, self._stamps, self.overflowed = listening, False, 0
        if sys.platform == "linux":
            with suppress(OSError):
                for option in (_TIMESTAMPS, _OVERFLOWS):
                    listening.setsockopt(socket.SOL_SOCKET, option, 1)
                self._stamps = True
        self._last = time.monotonic()

    def fileno(self) -> int:
        """For `select`."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def read(self, most: int = LARGEST) -> tuple[bytes, Any, float]:
        """A datagram of so many bytes at most, its sender's address, and s on this machine's clock; raises what the socket does."""
        if not self._stamps:
            data, sender = self._socket.recvfrom(most)
            return data, sender, time.monotonic()
        data, notes, _, sender = self._socket.recvmsg(most, _NOTES)
        came = now = time.monotonic()
        for level, kind, note in notes:
            if level == socket.SOL_SOCKET and kind == _TIMESTAMPS and len(note) == _TIMESPEC.size:
                seconds, nanoseconds = _TIMESPEC.unpack(note)
                came = now - 1e-9 * (time.time_ns() - 1_000_000_000 * seconds - nanoseconds)
            elif level == socket.SOL_SOCKET and kind == _OVERFLOWS and len(note) == _COUNT.size:
                (self.overflowed,) = _COUNT.unpack(note)
        self._last = min(now, max(self._last, came))
        return data, sender, self._last


def overflow(where: str, count: int) -> list[Finding]:
    """That the system left datagrams out, where it did."""
    sentence = f"{where}: {counted(count, 'packet')} came while this machine was too busy to read them, and were lost."
    mend = "Close other programs, or lower the rate: neither cable nor network lost them."
    return [Finding("live-overflow", Severity.WARNING, where, sentence, mend)] if count else []


class ListeningSocket:
    """A UDP socket that listens. Raises AsterismError where the address is none of this machine's, or the port is taken."""

    def __init__(self, place: HostPort) -> None:
        self._socket, address = socket_for(place, "udp://127.0.0.1:5000")
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            # Of a burst each is read by a single call of the system.
            self._socket.setblocking(False)
            self._reader = DatagramReader(self._socket)
            self._socket.bind(address)
        except OSError as problem:
            self._socket.close()
            raise AsterismError(
                f"{place} cannot be listened to ({problem.strerror}): another program has the port, or the address is not of this machine. "
                "Give another one."
            ) from problem

    @property
    def port(self) -> int:
        """The port that is listened to: a free one where 0 was asked for."""
        return int(self._socket.getsockname()[1])

    @property
    def overflowed(self) -> int:
        """See `DatagramReader`."""
        return self._reader.overflowed

    def received(self, timeout: float) -> Iterator[tuple[bytes, str, float]]:
        """Datagrams that come within so many seconds, each with the address of its sender and when it came, see `DatagramReader`; fewer
        where the socket is closed meanwhile."""
        until = time.monotonic() + timeout
        while True:
            try:
                data, sender, arrived = self._reader.read(LARGEST + 1)
            except BlockingIOError:
                left = until - time.monotonic()
                try:
                    if left <= 0 or not select.select([self._socket], [], [], left)[0]:
                        return
                except (OSError, ValueError):
                    # it was closed
                    return
            except OSError:
                return
            else:
                yield data, f"{sender[0]}:{sender[1]}", arrived
                if time.monotonic() >= until:
                    return

    def close(self) -> None:
        """Stop listening."""
        self._socket.close()
