"""Labelled frames in; streams of the Lab Streaming Layer out: trajectories, values, and events with what the person is told."""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Sequence
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np

from asterism.errors import AsterismError
from asterism.live.addresses import Query
from asterism.live.analysis import AnalysedFrame
from asterism.live.clock import SourceClock
from asterism.live.lsl_library import lsl_library

_KEPT = 2
"""s of samples that are kept for a receiver that is slow; the library drops the oldest. Twice as many are too old; half of them are too few
for a program that stores them in pieces."""

_OTHERS = 0.5
"""s in which another session of the same name answers, on this machine. Half of it misses one that is busy; twice as much is a wait."""


class ToLsl:
    """Sends labelled frames as streams that any program of the Lab Streaming Layer records.

    NAME         type MoCap: x, y, z of each marker in m, and its confidence; by XDF's convention. NaN where it is not seen.
    NAME values  type Kinematics: a channel for each value, with its name and unit. NaN where it is not known.
    NAME events  type Markers: texts, "left heel strike" at the time at which it happened, "squat depth on" and "off"

    A stream begins when what it holds is known, and anew where the markers or values become others. Time stamps are times of the source
    on this machine's clock. address: lsl://NAME; rate: frames per second, NaN where it is not known. Raises AsterismError where pylsl is
    missing, or the address has no name.
    """

    def __init__(self, address: str, rate: float) -> None:
        pylsl = lsl_library()
        parts = urlsplit(address)
        self.name = address
        self._title = unquote(parts.netloc + parts.path)
        Query(address).check_all_used()
        if not self._title:
            raise AsterismError(f"{address} names no stream; write for example lsl://Asterism.")
        self._lsl, self._rate = pylsl, rate if math.isfinite(rate) else pylsl.IRREGULAR_RATE
        self._clock = SourceClock()
        self._markers: tuple[str, ...] = ()
        self._values: tuple[str, ...] = ()
        self._places: Any = None
        self._numbers: Any = None
        # Two senders of one identity would be mixed by who receives them.
        if pylsl.resolve_byprop("source_id", self._identity("events"), timeout=_OTHERS):
            raise AsterismError(f"{address} is sent by another session on this machine already; give this one another name.")
        # A program that records begins before anything happens.
        self._texts: Any = self._outlet("events", "Markers", [("event", "Marker", "", "")], pylsl.IRREGULAR_RATE, pylsl.cf_string)
        self._on: set[str] = set()

    def send(self, frame: AnalysedFrame) -> None:
        """Give a frame to the library, which sends it in threads of its own."""
        labelled, analysis = frame.labelled, frame.analysis
        self._clock.lateness(labelled.frame.time, labelled.frame.arrived)
        # The library's clock and that of `arrived` may have other zeros.
        ahead = self._clock.offset + self._lsl.local_clock() - time.monotonic()
        at = labelled.frame.time + ahead
        if labelled.markers:
            if labelled.markers != self._markers:
                self._markers = labelled.markers
                self._places = self._outlet("", "MoCap", _marker_channels(self._markers), self._rate)
            sure = np.where(labelled.indices >= 0, labelled.confidence, 0.0)
            self._places.push_sample(np.column_stack([labelled.places, sure]).ravel().tolist(), at)
        if analysis.values:
            # Values that are left out for a while keep their channels; one that is new makes the stream another one.
            if not set(analysis.values) <= set(self._values):
                self._values = tuple(dict.fromkeys((*self._values, *analysis.values)))
                channels = [(name, "Value", analysis.units.get(name, ""), "") for name in self._values]
                self._numbers = self._outlet("values", "Kinematics", channels, self._rate)
            self._numbers.push_sample([analysis.values.get(name, math.nan) for name in self._values], at)
        for event in analysis.events:
            self._texts.push_sample([f"{event.side} {event.kind}".strip()], event.time + ahead)
        for cue in frame.cues:
            # What speaks of instants may begin again before it has ended.
            if cue.began or cue.on != (cue.rule.name in self._on):
                (self._on.add if cue.on else self._on.discard)(cue.rule.name)
                self._texts.push_sample([f"{cue.rule.name} {'on' if cue.on else 'off'}"], at)

    def _outlet(self, part: str, kind: str, channels: Sequence[tuple[str, str, str, str]], rate: float, form: int | None = None) -> Any:
        """A stream; channels: (label, type, unit, marker) of each."""
        name = f"{self._title} {part}".strip()
        identity = self._identity(part)
        info = self._lsl.StreamInfo(name, kind, len(channels), rate, self._lsl.cf_float32 if form is None else form, identity)
        listed = info.desc().append_child("channels")
        for label, of, unit, marker in channels:
            channel = listed.append_child("channel")
            for key, value in (("label", label), ("marker", marker), ("type", of), ("unit", unit)):
                if value:
                    channel.append_child_value(key, value)
        info.desc().append_child("acquisition").append_child_value("manufacturer", "Asterism")
        return self._lsl.StreamOutlet(info, 0, _KEPT)

    def _identity(self, part: str) -> str:
        """By which who records finds the stream again when this program was started anew."""
        return f"asterism {socket.gethostname()} {self._title} {part}".strip()

    def close(self) -> None:
        """End the streams."""
        self._places = self._numbers = self._texts = None


def _marker_channels(markers: Sequence[str]) -> list[tuple[str, str, str, str]]:
    kinds = (("X", "PositionX", "meters"), ("Y", "PositionY", "meters"), ("Z", "PositionZ", "meters"), ("C", "Confidence", "normalized"))
    return [(f"{marker}_{letter}", kind, unit, marker) for marker in markers for letter, kind, unit in kinds]
