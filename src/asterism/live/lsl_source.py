"""A stream of the Lab Streaming Layer in; the points of each sample, numbered and on this machine's clock, out."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.formats import metres_per_unit
from asterism.formats.mocap_channels import ChannelLayout, layout_of_channels
from asterism.live.addresses import Query
from asterism.live.clock import SampleNumbers
from asterism.live.frames import FARTHEST, MOST_POINTS, LiveFrame, SourceAbout
from asterism.live.lsl_library import lsl_library
from asterism.live.reporting import axis_unknown, labels_given, reconnected
from asterism.recording import Floats
from asterism.recording.display import significant

_FIND = 5.0
"""s in which a stream is sought. Its sender answers within tenths; half of it loses to a busy network, twice as much is a wait."""
_OTHERS = 0.5
"""s for which others of the same name are awaited. One round of questions takes as long; half of it misses who answers late."""
_OPEN = 2.0
"""s in which a stream that was found must open, and its clock be compared, which takes 0.6. Half of it loses to a busy network; with twice
as much sessions end late."""
_KEPT = 2
"""s of samples that wait in this machine; with half of it those are lost that come while a stream opens, twice as many are too old."""
_SILENT = 5.0
"""s without a sample after which it is looked whether another stream took its place: a machine that lost its power says no goodbye. Half of
it asks the network in each pause; with twice as much ten seconds are lost."""
_CLOCK = 2.0
"""s between two questions how the clocks differ, which the library measures as often. Half of it gives the same answer twice; with twice as
much a drift of 100 ppm adds up to 0.4 ms."""
_TO_UNIT = 20
"""Samples by whose size a unit is chosen that is not given. One would do; some show nobody. Half and double do as well."""
_STILL = 5
"""Samples in a row after which a channel that should count does not. Half of them may be sent twice; twice as many are wasted."""
_WHOLE = 8
"""Points by which the size of a body is judged. Half of them may be a hand; twice as many are never seen of a sparse set."""
_KEYS = ("name", "type", "host", "source_id", "uid")


@dataclass(frozen=True)
class StreamChoice:
    """Which stream is meant: what its properties are to be, by their names in `_KEYS`.

    >>> StreamChoice.of("lsl://?type=MoCap&host=lab-pc").wanted
    {'type': 'MoCap', 'host': 'lab-pc'}
    """

    wanted: Mapping[str, str]

    @classmethod
    def of(cls, address: str) -> StreamChoice:
        """The choice that an address makes. Raises AsterismError where it makes none that is known."""
        query, parts = Query(address), urlsplit(address)
        wanted = {key: value for key in _KEYS if (value := query.text(key, ""))}
        query.check_all_used()
        if name := unquote(parts.netloc + parts.path):
            wanted["name"] = name
        return cls(wanted)

    def fits(self, properties: Mapping[str, str]) -> bool:
        """Whether a stream of these properties is meant; letters of a type may be small or capital."""
        return all(
            properties[key].casefold() == value.casefold() if key in ("type", "host") else properties[key] == value
            for key, value in self.wanted.items()
        )

    def __str__(self) -> str:
        return "lsl://" + self.wanted.get("name", "") + "".join(f" {key}={self.wanted[key]}" for key in _KEYS[1:] if key in self.wanted)


def _channels_of(info: Any) -> Iterator[dict[str, str]]:
    channel = info.desc().child("channels").child("channel")
    for _ in range(min(info.channel_count(), 4 * MOST_POINTS)):
        if channel.empty():
            return
        yield {key: channel.child_value(key).strip() for key in ("label", "marker", "object", "type", "unit")}
        channel = channel.next_sibling("channel")


def _properties(info: Any) -> dict[str, str]:
    values = (info.name(), info.type(), info.hostname(), info.source_id(), info.uid())
    return dict(zip(_KEYS, values, strict=True))


@dataclass(eq=False)
class _OpenStream:
    """One that is open."""

    inlet: Any
    info: Any
    layout: ChannelLayout
    scale: float = math.nan
    waiting: deque[tuple[Floats, float, float]] = field(default_factory=lambda: deque(maxlen=_TO_UNIT))
    """samples with their stamps and arrivals, while the unit is not known"""
    correction: float = 0.0
    asked: float = 0.0
    since: float = field(default_factory=time.monotonic)
    counted: float = math.nan
    still: int = 0


class FromLsl:
    """A source that reads a stream of point coordinates; each sample is a frame.

    address  lsl://NAME, or lsl://?type=MoCap&host=NAME and what else `StreamChoice` knows
    rate     frames per second; NaN for what the stream says

    Times are those of the samples, on this machine's clock by the library's own comparison. Numbers are those of a channel that counts,
    else by `SampleNumbers`; without a rate they are one after the other. A point is missing where a coordinate is NaN, or where all three
    are 0, as some systems write it. A stream that is lost is sought and opened again; it is never another one than what was chosen.
    Raises AsterismError where pylsl is missing, no stream or more than one fits, or what fits are no points.
    """

    def __init__(self, address: str, rate: float = float("nan")) -> None:
        self._lsl = lsl_library()
        self._guard = threading.Lock()
        self._closed = False
        self.damaged, self._lost, self._clock_unknown, self._counter_broken = 0, 0, False, False
        self._choice = StreamChoice.of(address)
        self._resolver: Any = None
        self._kept: deque[LiveFrame] = deque()
        self._number, self._by_time = -1, -1
        self._stream: _OpenStream | None = None
        self._away = False
        self._layout: ChannelLayout | None = None
        self._unit_findings = list[Finding]()
        self._size: str | None = None
        info = self._found(_FIND)
        nominal = info.nominal_srate()
        self._rate = rate if math.isfinite(rate) else nominal if 0 < nominal < 1e5 else math.nan
        self.about = SourceAbout(f"{info.name()} ({info.type() or 'no type'}) at {info.hostname()}", self._rate)
        self._numbers = SampleNumbers(self._rate)
        self._stream = self._opened(info)
        self._found_first = _properties(info)

    def _visible(self) -> list[Any]:
        if self._resolver is None:
            # A stream that is gone is forgotten soon: it shall not be taken for one that came back.
            self._resolver = self._lsl.ContinuousResolver(forget_after=2.0)
        return [info for info in self._resolver.results() if info.channel_format() != self._lsl.cf_string and info.channel_count() >= 3]

    def _found(self, patience: float) -> Any:
        """The stream that is meant. Raises AsterismError where none is there in time, or several are."""
        until, since = time.monotonic() + patience, math.inf
        while True:
            there = self._visible()
            fitting = [info for info in there if self._choice.fits(_properties(info))]
            since = min(since, time.monotonic()) if fitting else math.inf
            if time.monotonic() > min(until, since + _OTHERS):
                break
            time.sleep(0.02)
        # Programs give motion capture and what belongs to it one name.
        moving = [info for info in fitting if info.type().casefold() == "mocap"]
        fitting = moving or fitting
        if len(fitting) == 1:
            self._resolver = None
            return fitting[0]
        listed = "; ".join(_told(info) for info in fitting or there[:20]) or "none"
        self._resolver = None
        if fitting:
            raise AsterismError(
                f"{self._choice} fits {len(fitting)} streams, which are never mixed: {listed}. "
                "Add what tells yours from the others, as in lsl://?name=NAME&source_id=ID (or host, type, uid)."
            )
        raise AsterismError(
            f"{self._choice}: no such stream of numbers is in the network; there are: {listed}. Look whether it has begun, and whether a "
            "firewall lets the ports 16571 to 16604 pass (UDP and TCP)."
        )

    def _opened(self, info: Any) -> _OpenStream:
        """The stream, open, its layout and its unit known. Raises AsterismError where it does not open, or has no points."""
        name = self.about.name
        inlet = self._lsl.StreamInlet(info, max_buflen=_KEPT, recover=False)
        try:
            whole = inlet.info(_OPEN)
            inlet.open_stream(_OPEN)
        except RuntimeError as problem:
            raise AsterismError(f"{name} was found and does not open ({problem}); look whether a firewall lets TCP pass.") from problem
        layout = layout_of_channels(list(_channels_of(whole)), whole.channel_count())
        if layout is None or len(layout.columns) > MOST_POINTS:
            raise AsterismError(
                f"{name} has {whole.channel_count()} channels, and they are no places of markers; have its sender describe them by the "
                "types PositionX, PositionY and PositionZ, as in XDF's convention for motion capture."
            )
        stream = _OpenStream(inlet, whole, layout)
        self._layout = layout
        try:
            stream.correction = inlet.time_correction(_OPEN)
        except RuntimeError:
            self._clock_unknown = True
        stream.asked = time.monotonic()
        if layout.unit is not None:
            self._settle_unit(stream)
        # What is believed of the unit is said before the session begins, where anything is sent.
        until = time.monotonic() + _OPEN
        while math.isnan(stream.scale) and time.monotonic() < until and not self._closed:
            try:
                self._pull(stream, 0.1)
            except RuntimeError:
                # lost already, as the next read finds
                break
        return stream

    def _settle_unit(self, stream: _OpenStream) -> None:
        """Metres per unit: as written, else by the size of the samples that wait for it."""
        columns, unit, name = stream.layout.columns, stream.layout.unit, self.about.name
        raw = np.array([sample[columns] for sample, _, _ in stream.waiting]) if stream.waiting else np.full((1, 1, 3), np.nan)
        stream.scale, unit, found = metres_per_unit(name, unit, raw)
        self._unit_findings = [
            Finding("live-unit-assumed", Severity.NOTE, name, f"{name}: {finding.sentence}; lengths are read as {unit}.", finding.mend)
            for finding in found
        ]
        while stream.waiting:
            self._keep(stream, *stream.waiting.popleft())

    def read(self, timeout: float) -> LiveFrame | None:
        """The next frame."""
        until = time.monotonic() + timeout
        with self._guard:
            if self._closed:
                return None
            while not self._kept:
                left = until - time.monotonic()
                if self._stream is None:
                    self._seek(max(0.0, left))
                else:
                    try:
                        self._pull(self._stream, max(0.0, left))
                    except RuntimeError:
                        self._drop()
                if left <= 0:
                    break
            return self._kept.popleft() if self._kept else None

    def _pull(self, stream: _OpenStream, timeout: float) -> None:
        """Keep the next sample. Raises RuntimeError where the stream is lost."""
        values, stamp = stream.inlet.pull_sample(timeout)
        now = time.monotonic()
        if now - stream.asked > _CLOCK and not self._clock_unknown:
            stream.asked = now
            # Where they were not compared meanwhile the last difference holds.
            with suppress(RuntimeError):
                stream.correction = stream.inlet.time_correction(0.0)
        if values is not None:
            stream.since, self._resolver = now, None
            self._keep(stream, np.array(values, dtype=np.float64), stamp, now)
        elif now - stream.since > _SILENT:
            there = {info.uid(): info for info in self._visible()}
            if stream.info.uid() not in there and any(self._same(info) for info in there.values()):
                raise RuntimeError("another stream took its place")

    def _drop(self) -> None:
        self._stream, self._away = None, True
        self._lost += 1

    def _same(self, info: Any) -> bool:
        """Whether a stream is the chosen one that came back: one that fits, with the source's own identity where it has one."""
        own = _properties(info)
        return self._choice.fits(own) and all(own[key] == self._found_first[key] for key in ("name", "type", "source_id"))

    def _seek(self, timeout: float) -> None:
        back = [info for info in self._visible() if self._same(info)]
        if len(back) != 1:
            time.sleep(min(timeout, 0.05))
            return
        self._resolver = None
        try:
            self._stream, self._away = self._opened(back[0]), False
        except AsterismError:
            # It is gone again, or somebody else's; it is sought on.
            self._stream = None

    def _keep(self, stream: _OpenStream, sample: Floats, stamp: float, arrived: float) -> None:
        layout, at = stream.layout, stamp + stream.correction
        if not math.isfinite(at):
            self.damaged += 1
            return
        if math.isnan(stream.scale):
            # A sample that shows nobody says nothing of a unit.
            raw = sample[layout.columns]
            if (np.isfinite(raw) & (raw != 0)).all(axis=1).any():
                stream.waiting.append((sample, stamp, arrived))
            if len(stream.waiting) == _TO_UNIT:
                self._settle_unit(stream)
            return
        if self._size is None:
            self._judge_size(layout, sample)
        with np.errstate(over="ignore", invalid="ignore"):
            points = stream.scale * sample[layout.columns]
        there = ((np.abs(points) < FARTHEST).all(axis=1) & (points != 0).any(axis=1)).nonzero()[0]
        names = tuple(layout.names[row] for row in there.tolist()) if any(layout.names) else ()
        self._number = self._next_number(stream, sample, at, arrived)
        self._kept.append(LiveFrame(self._number, at, arrived, points[there], names))

    def _judge_size(self, layout: ChannelLayout, sample: Floats) -> None:
        """Whether what is written of the unit can be, by the first sample that shows a whole body."""
        raw = sample[layout.columns]
        if layout.unit is None or (np.isfinite(raw) & (raw != 0)).all(axis=1).sum() < _WHOLE:
            return
        self._size = ""
        try:
            metres_per_unit(self.about.name, layout.unit, raw[None])
        except AsterismError as problem:
            self._size = str(problem)

    def _next_number(self, stream: _OpenStream, sample: Floats, at: float, arrived: float) -> int:
        """What the stream counts itself; where it does not, or stands still, as many more than the last as time says."""
        before, self._by_time = self._by_time, self._numbers.next(at, arrived) if math.isfinite(self._rate) else self._by_time + 1
        if stream.layout.counter is not None and not self._counter_broken:
            count = float(sample[stream.layout.counter])
            counts = count != stream.counted and abs(count) < 2**53 and count == round(count)
            stream.counted, stream.still = count, 0 if counts else stream.still + 1
            if counts:
                return int(count)
            # A sample may be sent twice; a row of them is no counter.
            self._counter_broken = stream.still >= _STILL
        return self._number + self._by_time - before

    def findings(self) -> list[Finding]:
        """What was believed, and what happened to the stream."""
        name, layout = self.about.name, self._layout
        found = [axis_unknown(name, "z"), *self._unit_findings]
        if layout is not None and any(layout.names):
            found.append(labels_given(name))
        if self._size:
            mend = "Have its sender write the unit in which it sends."
            found.append(Finding("live-unit-doubtful", Severity.WARNING, name, self._size, mend))
        if layout is not None and layout.guessed:
            sentence = f"{name}: nothing says what its channels are; they are read as x, y, z of {len(layout.columns)} points."
            mend = "Look whether a body is seen; have the sender describe its channels."
            found.append(Finding("live-channels-assumed", Severity.NOTE, name, sentence, mend))
        if layout is not None and layout.bodies:
            sentence = f"{name}: {layout.bodies} rigid bodies are passed over; markers alone are read."
            found.append(Finding("live-bodies", Severity.NOTE, name, sentence))
        if not math.isfinite(self._rate):
            sentence = f"{name} has no rate, so that samples which are lost are not noticed."
            found.append(Finding("live-irregular", Severity.NOTE, name, sentence, "Give its rate with --rate where it has one."))
        elif self._numbers.is_off and (layout is None or layout.counter is None):
            said, true = significant(self._rate, 4), significant(self._numbers.measured_rate, 4)
            sentence = f"{name} has not {said} samples/s but {true}; the difference counts as lost."
            found.append(Finding("live-rate", Severity.WARNING, name, sentence, "Give the true rate with --rate."))
        elif self._numbers.spread > 1 / 6 and (layout is None or layout.counter is None):
            sentence = (
                f"{name}: its time stamps scatter by {self._numbers.spread:.0%} of a frame, so that single lost samples are not noticed."
            )
            found.append(
                Finding("live-stamps", Severity.NOTE, name, sentence, "Have the sender stamp when a frame is taken, or count frames.")
            )
        if self._numbers.late >= 1 and (layout is None or layout.counter is None):
            sentence = f"{name}: about {self._numbers.late:.0f} of the frames that count as lost came late, all at once."
            mend = "Its sender stops and catches up; close other programs there, and have it stamp when a frame is taken."
            found.append(Finding("live-caught-up", Severity.NOTE, name, sentence, mend))
        if self._clock_unknown:
            sentence = f"{name}: its clock could not be compared with this machine's; its own times are used."
            found.append(Finding("live-clock", Severity.NOTE, name, sentence, "Let a firewall pass the UDP ports 16571 to 16604."))
        if self._counter_broken:
            sentence = f"{name}: its channel that counts stands still; samples are numbered as they come."
            found.append(Finding("live-counter", Severity.WARNING, name, sentence, "Have the sender mend it."))
        if self._lost:
            found.append(reconnected(name, self._lost, "Look at the network and the sender.", is_back=not self._away))
        return found

    def close(self) -> None:
        """Let go of the stream, when no sample is being read."""
        self._closed = True
        with self._guard:
            self._stream = self._resolver = None


def _told(info: Any) -> str:
    own = _properties(info)
    return (
        f"{own['name']} (type {own['type'] or 'none'}, host {own['host']}, source_id {own['source_id'] or 'none'}, uid {own['uid']}, "
        f"{info.channel_count()} channels)"
    )
