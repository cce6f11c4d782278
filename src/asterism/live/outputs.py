"""Labelled frames in; datagrams for other programs out."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from typing import Any, TextIO

import numpy as np

from asterism.live.chain import LabelledFrame
from asterism.live.datagrams import LARGEST, HostPort, socket_for
from asterism.live.feedback import Cue


def labels_as_json(frame: LabelledFrame, cues: Sequence[Cue] = ()) -> bytes:
    """A labelled frame as `frame_of_json` reads frames, with the confidence of each label, the latency in ms, and what is told."""
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
    if cues:
        content["feedback"] = [cue_as_json(cue) for cue in cues]
    return json.dumps(content, separators=(",", ":")).encode()


def cue_as_json(cue: Cue) -> dict[str, Any]:
    """What a rule says, as plain values; a value that is not known is null."""
    return {
        "name": cue.rule.name,
        "value": None if math.isnan(cue.value) else round(cue.value, 4),
        "unit": cue.rule.unit,
        "on": cue.on,
        "began": cue.began,
        "text": cue.rule.text,
        "colour": cue.rule.colour,
        "sound": cue.rule.sound,
        "tone": None if math.isnan(cue.tone) else round(cue.tone, 3),
    }


class ToDatagrams:
    """Sends each frame as JSON to a UDP port. Raises AsterismError where the address is none."""

    def __init__(self, place: HostPort) -> None:
        self._socket, self._address = socket_for(place, "udp://127.0.0.1:5001")
        # A full buffer of the network must not hold the next frame back.
        self._socket.setblocking(False)

    def send(self, frame: LabelledFrame, cues: Sequence[Cue]) -> None:
        """Send a frame; a datagram that is too large raises OSError, as one that the network does not take."""
        data = labels_as_json(frame, cues)
        if len(data) > LARGEST:
            raise OSError(f"frame {frame.frame.number} has {len(data)} bytes, more than a datagram holds")
        self._socket.sendto(data, self._address)

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()


class ToLines:
    """Writes each frame as a line of JSON."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stdout

    def send(self, frame: LabelledFrame, cues: Sequence[Cue]) -> None:
        """Write a line."""
        self._stream.write(labels_as_json(frame, cues).decode() + "\n")
        self._stream.flush()

    def close(self) -> None:
        """Nothing is kept back."""
