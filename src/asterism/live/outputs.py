"""Labelled frames in; datagrams for other programs out."""

from __future__ import annotations

import json
import math
import socket
import sys
import threading
from collections import deque
from collections.abc import Callable
from functools import lru_cache
from typing import Any, TextIO, TypeVar

import numpy as np

from asterism.live.analysis import AnalysedFrame, LiveEvent
from asterism.live.cues import Cue
from asterism.live.datagrams import LARGEST, HostPort, socket_for
from asterism.live.running import LiveOutput

T = TypeVar("T")


# Several outputs send the same text of a frame.
@lru_cache(maxsize=1)
def labels_as_json(analysed: AnalysedFrame) -> bytes:
    """A labelled frame as `frame_of_json` reads frames, with the confidence of each label, the latency in ms, angles, events and cues."""
    frame = analysed.labelled
    confidence = np.zeros(len(frame.frame.points))
    given = frame.indices >= 0
    confidence[frame.indices[given]] = frame.confidence[given]
    content: dict[str, Any] = {
        "frame": frame.frame.number,
        "time": frame.frame.time,
        "unit": "m",
        "points": np.round(frame.frame.points, 6).tolist(),
        "names": list(frame.names),
        "confidence": np.round(confidence, 4).tolist(),
        "latency_ms": round(1000 * (frame.done - frame.frame.arrived), 2),
    }
    if analysed.analysis.values:
        content["values"] = {name: None if math.isnan(value) else round(value, 4) for name, value in analysed.analysis.values.items()}
    if analysed.analysis.events:
        content["events"] = [event_as_json(event) for event in analysed.analysis.events]
    if analysed.cues:
        content["feedback"] = [cue_as_json(cue) for cue in analysed.cues]
    return json.dumps(content, separators=(",", ":")).encode()


def event_as_json(event: LiveEvent) -> dict[str, Any]:
    """An event as plain values; a standard deviation that is not known is null."""
    return {
        "kind": event.kind,
        "side": event.side,
        "time": round(event.time, 5),
        "told_after_ms": round(1000 * event.told_after, 2),
        "sd_ms": None if math.isnan(event.sd) else round(1000 * event.sd, 2),
    }


def cue_as_json(cue: Cue) -> dict[str, Any]:
    """What a rule says, as plain values; a value that is not known is null."""
    return {
        "name": cue.rule.name,
        "value": None if math.isnan(cue.value) else round(cue.value, 4),
        "unit": cue.unit,
        "on": cue.on,
        "began": cue.began,
        "text": cue.text,
        "colour": cue.rule.colour,
        "sound": cue.rule.sound,
        "tone": None if math.isnan(cue.tone) else round(cue.tone, 3),
    }


WAITING = 32
"""Frames that wait for a receiver at most, 0.16 s at 200 Hz. Half of them are lost while a browser tidies its memory; twice as many show
what is old."""


class ToDatagrams:
    """Sends each frame as JSON to a UDP port. Raises AsterismError where the address is none."""

    def __init__(self, place: HostPort) -> None:
        self.name = f"udp://{place}"
        self._socket, self._address = socket_for(place, "udp://127.0.0.1:5001")
        # A full buffer of the network must not hold the next frame back.
        self._socket.setblocking(False)
        # All machines of a network may be meant, as by udp://192.168.1.255:5001.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)

    def send(self, frame: AnalysedFrame) -> None:
        """Send a frame; a datagram that is too large raises OSError, as one that the network does not take."""
        data = labels_as_json(frame)
        if len(data) > LARGEST:
            raise OSError(f"frame {frame.labelled.frame.number} has {len(data)} bytes, more than a datagram holds")
        self._socket.sendto(data, self._address)

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()


def leave_one_out(waiting: deque[tuple[bool, T]]) -> None:
    """Leave the oldest out of what waits; of what says something that no later frame says, (True, ...), only where all do."""
    for at, (matters, _) in enumerate(waiting):
        if not matters:
            del waiting[at]
            return
    waiting.popleft()


def tells_more(frame: AnalysedFrame) -> bool:
    """Whether a frame says what no later one does: events, cues that begin."""
    return bool(frame.analysis.events) or any(cue.began for cue in frame.cues)


class InOwnThread:
    """Passes frames on to an output that may have to wait, in a thread of its own, so that nobody waits for it.

    Where it takes them too slowly the oldest that waits is left out, one with events last, and counted in `dropped`; so is one that it does
    not take.
    """

    def __init__(self, output: LiveOutput) -> None:
        self.name, self.dropped = str(getattr(output, "name", type(output).__name__)), 0
        self._output, self._ended = output, False
        self._waiting: deque[tuple[bool, AnalysedFrame]] = deque()
        self._there = threading.Condition()
        self._thread = threading.Thread(target=self._pass_on, name=self.name, daemon=True)
        self._thread.start()

    def send(self, frame: AnalysedFrame) -> None:
        """Put a frame into the queue."""
        with self._there:
            self._waiting.append((tells_more(frame), frame))
            if len(self._waiting) > WAITING:
                leave_one_out(self._waiting)
                self.dropped += 1
            self._there.notify()

    def _pass_on(self) -> None:
        while True:
            with self._there:
                while not self._waiting and not self._ended:
                    self._there.wait()
                if not self._waiting:
                    return
                _, frame = self._waiting.popleft()
            try:
                self._output.send(frame)
            except OSError:
                self.dropped += 1

    def close(self) -> None:
        """Close the output, once it has what waits for it or a second is over."""
        with self._there:
            self._ended = True
            self._there.notify()
        self._thread.join(timeout=1.0)
        with self._there:
            self.dropped += len(self._waiting)
            self._waiting.clear()
        # One that still waits is left to itself: it ends with the program.
        if not self._thread.is_alive():
            self._output.close()


class ToLines:
    """Writes each frame as a line of JSON.

    on_left  called where who read them is gone, as `head` is after its lines: they want no more, and nothing is lost. None where frames go
             elsewhere, too, and the session goes on: those that are not written are counted
    """

    name = "--lines"

    def __init__(self, stream: TextIO | None = None, on_left: Callable[[], None] | None = None) -> None:
        self._stream, self.on_left = stream or sys.stdout, on_left

    def send(self, frame: AnalysedFrame) -> None:
        """Write a line. Raises OSError where it is not taken."""
        try:
            self._stream.write(labels_as_json(frame).decode() + "\n")
            self._stream.flush()
        except BrokenPipeError:
            if self.on_left is None:
                raise
            self.on_left()

    def close(self) -> None:
        """Nothing is kept back."""
