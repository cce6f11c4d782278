"""Points as JSON over UDP, one frame a datagram: the plain way in for whoever writes their own sender, and the plain way out."""

from __future__ import annotations

import json
import math
import socket
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.live.clock import StreamTimes
from asterism.live.found import times_made
from asterism.live.frames import FARTHEST, MOST_POINTS, LiveFrame, SourceAbout

LARGEST = 65_507
"""Bytes of the largest UDP datagram."""
_METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_LARGEST_NUMBER = 2**53


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
    try:
        content = json.loads(data.decode("utf-8"))
        number, at, scale, rows = content["frame"], float(content["time"]), _METRES[content.get("unit", "m")], content["points"]
        names = content.get("names", [])
        if type(number) is not int or abs(number) > _LARGEST_NUMBER or not math.isfinite(at) or len(rows) > MOST_POINTS:
            return None
        if not isinstance(names, list) or len(names) not in (0, len(rows)) or not all(isinstance(name, str) for name in names):
            return None
        points = np.array(rows, dtype=np.float64).reshape(-1, 3) if rows else np.empty((0, 3))
        if len(points) != len(rows):
            return None
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
        return None
    there = np.nonzero((np.abs(scale * points) < FARTHEST).all(axis=1))[0]
    kept = tuple(names[row] for row in there.tolist()) if names else ()
    return LiveFrame(number, at, arrived, scale * points[there], kept)


@dataclass(frozen=True)
class HostPort:
    """A host and a UDP port; "0.0.0.0" listens to the whole network, "127.0.0.1" to this machine only."""

    host: str
    port: int


_OTHERS = 16
"""Other senders that are told by their addresses; more are counted together."""
_GONE = 1.0
"""s of silence of the sender after which another one is heard: it was begun anew, or another machine took over. With half of it a pause of
the network brings in a stranger; with twice as much a sender that was begun anew is missed for 2 s."""


class JsonDatagrams:
    """A source of frames that arrive as JSON, see `frame_of_json`.

    place  where to listen
    rate   frames per second that the sender was told to send

    One sender is heard. Another address takes its place where it goes on with the very next frame, as a program does that opens a socket
    for each, or where the one that is heard has been silent for a second. Frames of others are counted by address, and never mixed in.
    Raises AsterismError where the address is none of this machine's, or the port is taken.
    """

    def __init__(self, place: HostPort, rate: float = float("nan")) -> None:
        self.damaged = 0
        self.about = SourceAbout(f"JSON at {place.host}:{place.port}", rate)
        self._socket = bound(place)
        self._times = StreamTimes(rate)
        self._heard: str = ""
        self._last, self._at = 0, -math.inf
        self._others = dict[str, int]()

    @property
    def port(self) -> int:
        """The port that is listened to: a free one where 0 was asked for."""
        return int(self._socket.getsockname()[1])

    def read(self, timeout: float) -> LiveFrame | None:
        """The next frame that is whole."""
        until = time.monotonic() + timeout
        while (left := until - time.monotonic()) > 0:
            self._socket.settimeout(left)
            try:
                data, sender = self._socket.recvfrom(LARGEST + 1)
            except OSError:
                # nothing came, or the socket was closed meanwhile
                return None
            frame = frame_of_json(data, time.monotonic())
            if frame is None:
                self.damaged += 1
            elif self._hears(f"{sender[0]}:{sender[1]}", frame):
                return replace(frame, time=self._times.of(frame.number, frame.time, frame.arrived))
        return None

    def findings(self) -> list[Finding]:
        """Other senders, and frames without times."""
        found, where = [times_made(self.about.name)] if self._times.made else [], self.about.name
        if self._others:
            others = ", ".join(f"{address} ({count} frames)" for address, count in self._others.items())
            sentence = f"{where}: several programs send to it. {self._heard} is heard; these were not: {others}."
            mend = "Stop the others, or give each a port of its own."
            found.append(Finding("live-other-sender", Severity.WARNING, where, sentence, mend))
        return found

    def close(self) -> None:
        """Stop listening."""
        self._socket.close()

    def _hears(self, sender: str, frame: LiveFrame) -> bool:
        """Whether this is the sender that is heard."""
        goes_on = not self._heard or frame.number == self._last + 1 or frame.arrived - self._at > _GONE
        if sender != self._heard and not goes_on:
            key = sender if sender in self._others or len(self._others) < _OTHERS else "others"
            self._others[key] = self._others.get(key, 0) + 1
            return False
        self._heard, self._last, self._at = sender, frame.number, frame.arrived
        return True


def socket_for(place: HostPort, example: str) -> tuple[socket.socket, Any]:
    """A UDP socket of the family of an address, and the address as sockets take it; example: of one. Raises AsterismError."""
    try:
        family, kind, _, _, address = socket.getaddrinfo(place.host, place.port, type=socket.SOCK_DGRAM)[0]
        return socket.socket(family, kind), address
    except (OSError, OverflowError) as problem:
        raise AsterismError(f"{place.host}:{place.port} is no address; write for example {example}.") from problem


def bound(place: HostPort, *, buffer: int = 1 << 20) -> socket.socket:
    """A UDP socket that listens there; buffer: bytes that the system keeps while we are busy, 0.3 s of 59 markers at 200 Hz as JSON."""
    listening, address = socket_for(place, "udp://127.0.0.1:5000")
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        listening.bind(address)
    except OSError as problem:
        listening.close()
        raise AsterismError(
            f"{place.host}:{place.port} cannot be listened to ({problem.strerror}): another program has the port, or the address is not of "
            "this machine. Give another one."
        ) from problem
    return listening
