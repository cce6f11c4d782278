"""The address of OptiTrack Motive in; its frames (NatNet), and what is known of it, out.

The package `natnet` was tried first: a damaged packet makes it ask for gigabytes, it reads nothing before the server has answered, believes
whatever version the server says, and knows no latency, which versions before 3 send.
"""

from __future__ import annotations

import errno
import ipaddress
import select
import socket
import struct
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.live.addresses import in_words
from asterism.live.analog import AnalogSamples
from asterism.live.clock import StreamTimes
from asterism.live.datagrams import RECEIVE_BUFFER, DatagramReader, HostPort, overflow
from asterism.live.frames import LiveFrame, SourceAbout
from asterism.live.natnet_packets import FRAME, NatNetFrames, NatNetServer, server_of_packet
from asterism.live.reporting import axis_unknown, labels_given, reconnected, times_made

COMMANDS = 1510
"""The port at which Motive takes commands unless its settings say otherwise."""
_CONNECT, _REQUEST, _RESPONSE, _KEEP_ALIVE, _UNKNOWN = 0, 2, 3, 10, 100
"""Kinds of messages to and from Motive."""
_PATIENCE = 3.0
"""s until a server that does not answer is given up: three questions. Half of it loses to a busy Windows; twice as much is a wait."""
_ANSWER = 0.25
"""s for the answer to a question that need not be answered: a hundred times what a network takes. Half and double do as well."""
_ALIVE = 1.0
"""s between two signs of life; a server that sends to one client alone stops after some seconds without. Half of it only sends more; twice
as much is near what some servers wait for."""
_SILENT = 2.0
"""s without a frame after which the server is greeted again, each second: one that was started again does not know its clients. Half of it
greets in a pause; with twice as much four seconds are lost."""
_EARLY = 400
"""Frames that are kept while questions are asked: 0.75 s at 500 Hz. The oldest are left out, and counted as lost by their numbers. Half of
them lose frames at 500 Hz; twice as many do as well."""


class FromNatNet:
    """A source that reads Motive's stream.

    place  of the machine on which Motive runs, and its port for commands
    local  address of this machine in that network; "" for whichever leads there
    rate   frames per second; NaN for what Motive says

    Rate, unit and the axis that points up are asked for. Where Motive does not answer that, it is m and y up. A server that is silent is
    greeted again. Frames of other servers in the same group are counted, and not used. Raises AsterismError where nobody answers, or a port
    is taken.
    """

    def __init__(self, place: HostPort, local: str = "", rate: float = float("nan")) -> None:
        self.damaged, self.others, self._again, self._known = 0, 0, 0, set[str]()
        self._place, self._local, self._sender, self._stand_in, self._own = place, local, "", "", False
        self._early = deque[tuple[bytes, str, float]](maxlen=_EARLY)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self._readers = [DatagramReader(self._socket)]
        try:
            self._socket.bind((local, 0))
            self.server = self._greeted()
            self._join()
            told, scale, axis = (self._asked(question, layout) for question, layout in _QUESTIONS)
        except OSError as problem:
            self.close()
            if problem.errno == errno.EADDRNOTAVAIL:
                raise AsterismError(f"{local} is no address of this machine; give its own in the network of Motive, or none.") from problem
            raise AsterismError(f"{place.host}: cannot be reached ({in_words(problem)}); look at the address and the network.") from problem
        except AsterismError:
            self.close()
            raise
        self._scale = 1e-3 * scale if scale is not None and 1e-3 < scale < 1e5 else 1.0
        self._unit_told, up = scale is not None, int(axis) if axis in (0, 1, 2) else None
        self._axis_told = up is not None
        if not rate > 0 and told is not None and 1 <= told <= 1e4:
            rate = float(told)
        program = ".".join(str(part) for part in self.server.program[:2])
        self.about = SourceAbout(f"{self.server.name} {program} at {place.host}", rate, np.eye(3)[1 if up is None else up])
        self._frames, self._times = NatNetFrames(self.server.stream, self._scale), StreamTimes(rate)
        self._samples = AnalogNumbers(rate)
        self._said = self._heard = time.monotonic()

    def _greeted(self) -> NatNetServer:
        until = time.monotonic() + _PATIENCE
        while time.monotonic() < until:
            self._say(_CONNECT, b"Ping\0")
            for data, sender in self._answers(min(1.0, _PATIENCE / 3)):
                server = server_of_packet(data)
                if server is not None:
                    self._sender = sender
                    return server
        raise AsterismError(
            f"nobody answers at {self._place.host}, port {self._place.port}; in Motive switch on streaming (Settings, Streaming), with the "
            "network interface that leads here, and let a firewall pass its ports 1510 and 1511."
        )

    def _answers(self, seconds: float) -> Iterator[tuple[bytes, str]]:
        """Packets to the port of commands, each with who sent it, until so many seconds have passed; frames are kept for later."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            self._socket.settimeout(left)
            try:
                data, (sender, *_), arrived = self._readers[0].read()
            except TimeoutError:
                return
            except ConnectionError:
                # The system was told that nobody has this port; it may come.
                time.sleep(min(left, 0.2))
                continue
            if data[:2] == struct.pack("<H", FRAME):
                self._early.append((data, sender, arrived))
            yield data, sender

    def _asked(self, question: bytes, layout: str) -> float | None:
        """The answer to a question, a number; None where there is none."""
        self._say(_REQUEST, question + b"\0")
        for data, _ in self._answers(_ANSWER):
            kind = struct.unpack_from("<H", data)[0] if len(data) >= 4 else None
            if kind == _UNKNOWN:
                return None
            if kind == _RESPONSE and len(data) == 4 + struct.calcsize(layout):
                return float(struct.unpack_from(layout, data, 4)[0])
        return None

    def _join(self) -> None:
        """Listen to the group to which the server sends, where it does."""
        for each in self._readers[1:]:
            each.close()
        del self._readers[1:]
        if not self.server.group:
            return
        try:
            group = _in_group(self.server.group, self.server.port, self._local or _own_address(self._sender))
            self._readers.append(DatagramReader(group))
        except OSError as problem:
            if problem.errno == errno.EADDRINUSE:
                raise AsterismError(
                    f"port {self.server.port} of this machine, to which Motive sends, is taken by another program; close that, or have "
                    "Motive send to another port (Settings, Streaming)."
                ) from problem
            # Where it may send to each client alone, nothing is lost yet.
            if self.server.group_told:
                raise

    def _say(self, kind: int, text: bytes) -> None:
        self._socket.sendto(struct.pack("<HH", kind, len(text)) + text, (self._place.host, self._place.port))

    def read(self, timeout: float) -> LiveFrame | None:
        """The next frame that is whole."""
        until = time.monotonic() + timeout
        while (left := until - time.monotonic()) > 0:
            try:
                data, sender, arrived = self._early.popleft() if self._early else self._received(left)
            except (OSError, ValueError):
                # closed meanwhile
                return None
            if data[:2] != struct.pack("<H", FRAME) or not self._is_ours(sender, arrived):
                continue
            frame = self._frames.frame(data, arrived)
            if frame is None:
                self.damaged += 1
                continue
            at = self._times.of(frame.number, frame.time, arrived)
            analog = tuple(self._samples.numbered(part, frame.number, at) for part in frame.analog)
            return replace(frame, time=at, analog=analog)
        return None

    def _received(self, left: float) -> tuple[bytes, str, float]:
        """The next packet, who sent it, and when it came; b"" for none."""
        now = time.monotonic()
        silent = now - self._heard > _SILENT
        if now - self._said > _ALIVE and (silent or not self.server.group or not self.server.group_told):
            self._said = now
            self._say(_CONNECT if silent else _KEEP_ALIVE, b"Ping\0" if silent else b"\0")
        ready, _, _ = select.select(self._readers, [], [], min(left, _ALIVE))
        if not ready:
            return b"", "", now
        data, (sender, *_), arrived = ready[0].read()
        server = server_of_packet(data)
        if server is not None and sender == self._sender and silent and server != self.server:
            # It was started again, and with other settings.
            self.server = server
            self._frames = NatNetFrames(server.stream, self._scale)
            self._join()
        return data, sender, arrived

    def _is_ours(self, sender: str, arrived: float) -> bool:
        """Whether a frame is of the server that answered, or of who stands in for it."""
        silent = arrived - self._heard > _SILENT
        self._again += silent and self._own and sender == self._sender
        if sender == self._sender:
            self._own = True
        elif self._own or not (silent or self._stand_in) or self._stand_in not in ("", sender):
            self.others += 1
            self._known.add(sender)
            return False
        else:
            # Who answers and who sends may be two network interfaces of one machine: another is heard where this one never sent a frame.
            self._stand_in = sender
        self._heard = arrived
        return True

    def findings(self) -> list[Finding]:
        """What a person should know of it so far."""
        name, found = self.about.name, list[Finding]()
        if (version := self._frames.contradiction) and self._frames.used is not None:
            mend = "Look whether all markers are there; update Asterism, or choose another bitstream version in Motive."
            found.append(Finding("live-version", Severity.WARNING, name, f"{name}: {version}.", mend))
        if not self._unit_told:
            sentence = f"{name}: it does not say its unit; metres are believed."
            found.append(Finding("live-unit-unknown", Severity.NOTE, name, sentence, "Look at the size of the body on the page."))
        if not self._axis_told:
            found.append(axis_unknown(name, "y"))
        if self._frames.labelled:
            found.append(labels_given(name))
        if self._times.made:
            found.append(times_made(name))
        if self._again:
            found.append(reconnected(name, self._again, "Look at the cable, and whether Motive was closed."))
        if self.others:
            sentence = f"{name}: {self.others} frames of {len(self._known)} other servers in the same group were not used."
            mend = "Give each Motive a multicast address of its own (Settings, Streaming)."
            found.append(Finding("live-other-server", Severity.WARNING, name, sentence, mend))
        return [*found, *overflow(name, self.overflowed)]

    @property
    def overflowed(self) -> int:
        """Frames that came while this machine was too busy to read them."""
        return sum(reader.overflowed for reader in self._readers)

    def close(self) -> None:
        """Stop listening."""
        for each in self._readers:
            each.close()


@dataclass
class AnalogNumbers:
    """Numbers samples that come with frames, as many with each, on the clock of the frames.

    rate  of the frames, NaN where it is not known

    A device that has not as many samples in each frame has no rate that could be known: its samples are counted as they come.

    >>> from asterism.live.analog import AnalogDevice
    >>> numbers, plate = AnalogNumbers(100.0), AnalogDevice("plate", float("nan"), ("Fz",), ("N",))
    >>> found = [numbers.numbered(AnalogSamples(plate, 0, np.zeros((10, 1))), n, 5.0 + n / 100) for n in (0, 1, 3)]
    >>> [each.first for each in found], found[0].device.rate
    ([5000, 5010, 5030], 1000.0)
    """

    rate: float
    _of: dict[str, tuple[int, int]] = field(default_factory=dict)
    """by a device's name how many samples it has in a frame, and the number of the first one of frame 0; or 0, and that of the next one"""

    def numbered(self, part: AnalogSamples, number: int, at: float) -> AnalogSamples:
        """The samples of the frame of this number, at so many s."""
        count, name = len(part.values), part.device.name
        each, begin = self._of.get(name, (count, 0))
        rate = each * self.rate
        if each != count or not rate > 0:
            begin += number * each
            self._of[name] = 0, begin + count
            return AnalogSamples(part.device, begin, part.values)
        # Numbers that begin anew, as those of a take that is played again, are another begin.
        if name not in self._of or abs(begin + number * each - at * rate) > each:
            begin = round(at * rate) - number * each
            self._of[name] = each, begin
        return AnalogSamples(replace(part.device, rate=rate), begin + number * each, part.values)


_QUESTIONS = ((b"FrameRate", "<f"), (b"UnitsToMillimeters", "<f"), (b"UpAxis", "<i"))
"""What Motive is asked, and the number that it answers."""


def _own_address(other: str) -> str:
    """The address of this machine in the network that leads to another; "" where none does."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as way:
        try:
            way.connect((other, COMMANDS))
            return str(way.getsockname()[0])
        except OSError:
            return ""


def _in_group(group: str, port: int, local: str) -> socket.socket:
    """A socket that gets what is sent to a group of machines, or to all of them."""
    listening = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        if not ipaddress.ip_address(group).is_multicast:
            listening.bind(("", port))
            return listening
        # Windows binds to no group.
        try:
            listening.bind((group, port))
        except OSError:
            listening.bind(("", port))
        own = socket.inet_aton(local) if local else struct.pack("=I", socket.INADDR_ANY)
        listening.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + own)
    except OSError:
        listening.close()
        raise
    return listening
