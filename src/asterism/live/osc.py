"""Labelled frames in; Open Sound Control for the programs of artists out."""

from __future__ import annotations

import math
import re
import socket
import struct
from collections.abc import Iterator

from asterism.live.analysis import AnalysedFrame
from asterism.live.datagrams import HostPort, socket_for
from asterism.live.packages import packages_for

_LARGEST = 1400
"""Bytes of a datagram: Ethernet takes 1,500 with the headers, tunnels and radio a little less. Twice as many would be sent in parts, where
the loss of one loses all; half of it sends twice as many datagrams."""
_BUNDLE = b"#bundle\0" + struct.pack(">Q", 1)
"""The head of a bundle that is due at once."""
_WRAP = 2**31
"""From which number of a frame on it begins with 0 again: integers of OSC have 32 bits."""
_MOST = 1e30
"""A value beyond it is none, and near what 32 bits cannot hold."""
_PATTERN = re.compile(r"[^!-~]|[#*,/?\[\]{}]")
"""What an address of OSC cannot hold, or gives a meaning of its own."""


class ToOsc:
    """Sends each frame as bundles of OSC messages, as many as it needs, each in a datagram of its own.

    /asterism/frame NUMBER TIME                    first in each bundle: a whole number, and s since the first frame that was sent
    /asterism/marker/NAME X Y Z CONFIDENCE         m in the source's axes, and in [0, 1]; markers that are not seen are left out
    /asterism/value/NAME VALUE                     an angle in degrees, or in the unit of the value; left out where it is not known
    /asterism/event/KIND/SIDE TIME DELAY           s since the first frame, and s from then to this frame
    /asterism/cue/NAME ON TONE                     1 while the person is told, else 0; the tone in [0, 1], -1 for none
    /asterism/cue/NAME/began 1                     in the frame with which it begins
    /asterism/cue/NAME/value VALUE                 left out where it is not known

    All numbers but NUMBER and ON are floats of 32 bits, which all programs read; so times begin with 0. A space and what OSC does not allow
    in a name becomes "_". Raises AsterismError where the address is none, or python-osc is not installed.
    """

    def __init__(self, place: HostPort) -> None:
        self.name = f"osc://{place}"
        with packages_for("osc://"):
            from pythonosc.osc_message_builder import OscMessageBuilder
        self._build = OscMessageBuilder
        self._socket, self._address = socket_for(place, "osc://127.0.0.1:9000")
        self._socket.setblocking(False)
        # All machines of a stage may be meant, as by osc://192.168.1.255:9000.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self._begin: float | None = None
        self._heads: dict[tuple[str, ...], bytes] = {}
        self._words: dict[str, str] = {}

    def send(self, frame: AnalysedFrame) -> None:
        """Send a frame. Raises OSError where the network does not take it."""
        for bundle in self.bundles(frame):
            self._socket.sendto(bundle, self._address)

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()

    def bundles(self, frame: AnalysedFrame) -> Iterator[bytes]:
        """The bundles of a frame, each of at most `_LARGEST` bytes."""
        at = frame.labelled.frame.time
        self._begin = at if self._begin is None else self._begin
        number = frame.labelled.frame.number % _WRAP
        head = _BUNDLE + _sized(self._head("if", "frame") + struct.pack(">if", number, _held(at - self._begin)))
        parts, size = [head], len(head)
        for message in self._messages(frame, self._begin):
            part = _sized(message)
            if size + len(part) > _LARGEST and len(parts) > 1:
                yield b"".join(parts)
                parts, size = [head], len(head)
            parts.append(part)
            size += len(part)
        yield b"".join(parts)

    def _messages(self, frame: AnalysedFrame, begin: float) -> Iterator[bytes]:
        labelled, analysis = frame.labelled, frame.analysis
        given = (labelled.indices >= 0).nonzero()[0]
        places = labelled.frame.points[labelled.indices[given]].tolist()
        for marker, place, sure in zip(given.tolist(), places, labelled.confidence[given].tolist(), strict=True):
            yield self._head("ffff", "marker", labelled.markers[marker]) + struct.pack(">4f", *place, sure)
        for name, value in analysis.values.items():
            if abs(value) < _MOST:
                yield self._head("f", "value", name) + struct.pack(">f", value)
        for event in analysis.events:
            yield self._head("ff", "event", event.kind, event.side) + struct.pack(">2f", _held(event.time - begin), event.told_after)
        for cue in frame.cues:
            tone = -1.0 if math.isnan(cue.tone) else cue.tone
            yield self._head("if", "cue", cue.rule.name) + struct.pack(">if", cue.on, tone)
            if cue.began:
                yield self._head("i", "cue", cue.rule.name, "began") + struct.pack(">i", 1)
            if abs(cue.value) < _MOST:
                yield self._head("f", "cue", cue.rule.name, "value") + struct.pack(">f", cue.value)

    def _head(self, types: str, *names: str) -> bytes:
        """A message without its numbers, which take 4 bytes each: they alone change from frame to frame."""
        head = self._heads.get(names)
        if head is None:
            builder = self._build("/".join(("/asterism", *(self._word(name) for name in names))))
            for kind in types:
                builder.add_arg(0, kind)
            head = self._heads[names] = builder.build().dgram[: -4 * len(types)]
        return head

    def _word(self, name: str) -> str:
        """The name as a part of an address; another one for each name."""
        word = self._words.get(name)
        if word is None:
            clean = _PATTERN.sub("_", name)[:100] or "_"
            word, count = clean, 1
            while word in self._words.values():
                count += 1
                word = f"{clean}_{count}"
            self._words[name] = word
        return word


def _held(seconds: float) -> float:
    """A time that 32 bits hold: of a damaged one the rest of its frame is right."""
    return max(-_MOST, min(_MOST, seconds))


def _sized(message: bytes) -> bytes:
    return struct.pack(">i", len(message)) + message
