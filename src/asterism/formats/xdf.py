"""A recording of the Lab Streaming Layer (XDF) in; the motion capture in it, on the recorder's clock, out.

The layout is that of XDF 1.0 (sccn/xdf): chunks of a length, a tag and a content. Clocks of streams are compared with the recorder's every
few seconds, which is in the file: what was set back is known by it.
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError, NoMarkers
from asterism.files.text import read_bytes
from asterism.findings import Finding, Severity
from asterism.formats._columns import Points, as_metres, metres_per_unit
from asterism.formats.mocap_channels import ChannelLayout, layout_of_channels
from asterism.recording import Floats, Ints
from asterism.recording.display import counted, listed
from asterism.recording.rates import rate_of_times

MAGIC = b"XDF:"
_STREAM, _SAMPLES, _CLOCK, _BOUNDARY = 2, 3, 4, 5
_BOUNDARY_MARK = bytes.fromhex("43a546dccbf5410fb30ed5467383cbe4")
"""What a chunk of tag 5 holds: after damage reading goes on behind the next one."""
_TYPES = {"float32": "<f4", "double64": "<f8", "int8": "i1", "int16": "<i2", "int32": "<i4", "int64": "<i8"}
_JUMP = 1.0
"""s by which a clock that was set differs from what is expected, as of live sources: see `asterism.live.clock.JUMP`."""
_GAP = 1.0
"""s without a sample after which some are missing: LSL loses none while it is connected, so that shorter ones are late stamps. Half of it
takes a sender's pause for a loss; with twice as much a cable that was out for a second shortens the recording."""
_MOST_EMPTY = 10
"""Frames without points that gaps may leave for each sample: breaks between trials are longer than these at times. Half of it closes some
of them; twice as much lets a damaged file ask for twice as much memory. Where there were more, frames follow directly, which is told."""
_FARTHEST = 1e6
"""s: no gap is longer, so that numbers of frames stay numbers. Half and double do as well: it is eleven days."""
_ROUNDS, _CLOSE = 10, 1.345
"""Rounds in which measurements of a clock that do not fit a line lose their weight, and standard deviations from which on they do (Huber):
where 1.345 are 95 % as precise as least squares. Half and double of either do as well."""


@dataclass
class XdfStream:
    """A stream of numbers: id, name, kind, rate (NaN for none), what is said of each channel, and their count, as its header has them."""

    id: int
    name: str
    kind: str
    rate: float
    channels: list[dict[str, str]]
    count: int
    dtype: np.dtype[np.generic]
    _stamps: list[Floats] = field(default_factory=list)
    _values: list[NDArray[Any]] = field(default_factory=list)
    _measured: list[tuple[float, float]] = field(default_factory=list)
    _last: float = 0.0

    @property
    def stamps(self) -> Floats:
        """(n,) s on the sender's clock, in the order in which they were recorded."""
        return np.concatenate([np.empty(0), *self._stamps])

    @property
    def values(self) -> NDArray[Any]:
        """(n, c) as they were sent."""
        return np.concatenate([np.empty((0, self.count), dtype=self.dtype), *self._values])

    @property
    def measured(self) -> Floats:
        """(m, 2) s on the sender's clock, and how far the recorder's was ahead."""
        return np.array(self._measured, dtype=np.float64).reshape(-1, 2)

    def add_samples(self, content: memoryview) -> None:
        """Take a chunk of samples. Raises ValueError where it is damaged."""
        number, at = _varlen(content, 4)
        width = self.count * self.dtype.itemsize
        if number * (1 + width) > len(content) - at:
            raise ValueError("a chunk has fewer samples than it says")
        stamps, rows = self._with_stamps(content[at:], number, width)
        finite = np.isfinite(stamps)
        # A sample without a stamp follows the one before it at the stream's rate.
        for n in np.flatnonzero(~finite).tolist():
            stamps[n] = (stamps[n - 1] if n else self._last) + (1.0 / self.rate if self.rate > 0 else 0.0)
        self._last = float(stamps[-1]) if number else self._last
        self._stamps.append(stamps)
        # As it stands in the file: of streams that nobody asks for nothing is copied.
        self._values.append(rows)

    def _with_stamps(self, content: memoryview, number: int, width: int) -> tuple[Floats, NDArray[Any]]:
        """(number,) stamps, NaN where a sample has none, and (number, c) values."""
        stamped = np.dtype([("flag", "u1"), ("stamp", "<f8"), ("values", self.dtype, (self.count,))])
        if len(content) == number * stamped.itemsize:
            whole = np.frombuffer(content, dtype=stamped, count=number)
            if (whole["flag"] == 8).all():
                return whole["stamp"].astype(np.float64), whole["values"]
        stamps, rows, at = np.full(number, np.nan), np.empty((number, self.count), dtype=self.dtype), 0
        for n in range(number):
            flag, at = content[at], at + 1
            if flag == 8:
                (stamps[n],) = struct.unpack_from("<d", content, at)
            elif flag:
                raise ValueError("a sample has no stamp of 8 bytes")
            at += flag
            rows[n] = np.frombuffer(content, dtype=self.dtype, count=self.count, offset=at)
            at += width
        return stamps, rows

    def add_clock(self, content: memoryview) -> None:
        """Take a comparison of the clocks. Raises ValueError where it is damaged."""
        at, ahead = struct.unpack_from("<dd", content, 4)
        if np.isfinite(at) and np.isfinite(ahead):
            self._measured.append((at, ahead))

    def times(self) -> tuple[Floats, int]:
        """(n,) s of the samples on the recorder's clock, and how often the sender's was set. O(n)."""
        stamps, measured = self.stamps, self.measured
        if not len(measured) or not len(stamps):
            return stamps, 0
        # Between two comparisons both clocks go on by as much, unless one was set.
        ends = [0, *(np.flatnonzero(np.abs(np.diff(measured[:, 1])) > _JUMP) + 1).tolist(), len(measured)]
        spans = [measured[begin:end] for begin, end in pairwise(ends)]
        times, first = np.empty(len(stamps)), 0
        for begin, end in _runs(stamps):
            some = stamps[begin:end]
            # The clock as it was compared nearest to these stamps, and never one before what was used already.
            away = [max(0.0, float(span[0, 0] - some[-1]), float(some[0] - span[-1, 0])) for span in spans[first:]]
            first += int(np.argmin(away))
            times[begin:end] = some + _ahead(spans[first], some)
        return times, len(spans) - 1


def _runs(stamps: Floats) -> Iterator[tuple[int, int]]:
    """Stretches of stamps without a leap: begin and end."""
    ends = [0, *(np.flatnonzero(np.abs(np.diff(stamps)) > _JUMP) + 1).tolist(), len(stamps)]
    yield from pairwise(ends)


def _ahead(measured: Floats, at: Floats) -> Floats:
    """(n,) s by which the recorder's clock is ahead at times of the sender's: the line through what was measured, without its outliers."""
    when, ahead = measured.T
    middle = when.mean()
    weights, slope, level = np.ones(len(when)), 0.0, float(np.median(ahead))
    for _ in range(_ROUNDS if len(when) > 2 else 0):
        x = when - (weights * when).sum() / weights.sum()
        spread = float((weights * x * x).sum())
        slope = float((weights * x * ahead).sum() / spread) if spread > 0 else 0.0
        level = float((weights * (ahead - slope * (when - middle))).sum() / weights.sum())
        off = np.abs(ahead - level - slope * (when - middle))
        usual = 1.4826 * float(np.median(off))
        weights = np.minimum(1.0, _CLOSE * usual / np.maximum(off, 1e-12)) if usual > 0 else weights
    return level + slope * (at - middle)


def xdf_streams(path: Path) -> tuple[list[XdfStream], int]:
    """The streams of numbers of a file, and how many of its bytes could not be read. O(bytes), memory of the file.

    Raises AsterismError where it is no XDF file.
    """
    data = memoryview(read_bytes(path))
    if bytes(data[:4]) != MAGIC:
        raise AsterismError(f"{path} is no XDF file, which begins with XDF:.")
    streams, at, unread = dict[int, XdfStream](), 4, 0
    while at < len(data):
        try:
            size, begin = _varlen(data, at)
            if not 2 <= size <= len(data) - begin:
                raise ValueError("a chunk is longer than the file")
            _take(streams, int.from_bytes(data[begin : begin + 2], "little"), data[begin + 2 : begin + size])
            at = begin + size
        except (ValueError, struct.error, IndexError, TypeError, ET.ParseError):
            mark = data.obj.find(_BOUNDARY_MARK, at)  # type: ignore[attr-defined]
            following = len(data) if mark < 0 else mark + len(_BOUNDARY_MARK)
            unread, at = unread + following - at, following
    return list(streams.values()), unread


def _take(streams: dict[int, XdfStream], tag: int, content: memoryview) -> None:
    """Take a chunk. Raises ValueError, or what reading XML raises, where it is damaged."""
    if tag not in (_STREAM, _SAMPLES, _CLOCK):
        return
    (number,) = struct.unpack_from("<I", content)
    if tag == _STREAM:
        stream = _stream_of(number, bytes(content[4:]))
        # Texts are no motion capture, and are passed over with their samples.
        if stream is not None:
            streams[number] = stream
    elif number in streams and tag == _SAMPLES:
        streams[number].add_samples(content)
    elif number in streams:
        streams[number].add_clock(content)


def _stream_of(number: int, header: bytes) -> XdfStream | None:
    """The stream of a header; None for one of texts."""
    root = ET.fromstring(header.decode("utf-8", "replace").strip("\x00 \r\n\t"))
    said = {key: (root.findtext(key) or "").strip() for key in ("name", "type", "channel_count", "nominal_srate", "channel_format")}
    count, rate = int(said["channel_count"]), float(said["nominal_srate"] or 0.0)
    if said["channel_format"] not in _TYPES or not 0 < count < 1 << 16:
        return None
    channels = [
        {key: (channel.findtext(key) or "").strip() for key in ("label", "marker", "object", "type", "unit")}
        for channel in root.iterfind("desc/channels/channel")
    ]
    rate = rate if 0 < rate < 1e5 else float("nan")
    return XdfStream(number, said["name"], said["type"], rate, channels, count, np.dtype(_TYPES[said["channel_format"]]))


def _varlen(data: memoryview, at: int) -> tuple[int, int]:
    """A number of 1, 4 or 8 bytes, as the byte before it says, and where it ends. Raises ValueError where it is none."""
    width = data[at]
    if width not in (1, 4, 8) or at + 1 + width > len(data):
        raise ValueError("a length has neither 1, 4 nor 8 bytes")
    return int.from_bytes(data[at + 1 : at + 1 + width], "little"), at + 1 + width


def read_xdf(path: Path, wanted: str | None = None) -> Points:
    """The markers of a stream of motion capture, a frame a sample; gaps leave frames without points.

    wanted: the stream's name, or its number in the file; None for the stream with the most markers.
    Raises AsterismError where the file is none, or has not one such stream, NoMarkers where no stream holds places of markers.
    """
    streams, unread = xdf_streams(path)
    found = list[Finding]()
    if unread:
        sentence = f"{unread:,} bytes could not be read, and what they held is missing."
        found.append(Finding("format-damaged-parts", Severity.WARNING, "", sentence, "Copy the file again."))
    moving = [(stream, layout) for stream in streams if (layout := _layout_of(stream)) is not None and len(stream.stamps)]
    if wanted is not None and moving:
        moving = [_chosen(path, moving, wanted)]
    # A stream that says what it holds comes before one whose channels are guessed.
    moving.sort(key=lambda each: (each[1].guessed, each[0].kind.casefold() != "mocap", -len(each[1].columns)))
    if not moving:
        there = listed([f"{stream.name} ({stream.kind or 'no type'}, {counted(stream.count, 'channel')})" for stream in streams]) or "none"
        raise NoMarkers(f"{path} holds no stream of motion capture; its streams of numbers: {there}.")
    stream, layout = moving[0]
    if len(moving) > 1:
        others = listed([other.name for other, _ in moving[1:]])
        sentence = f"of {len(moving)} streams of motion capture {stream.name} is read, with the most markers; not read: {others}."
        found.append(Finding("format-several-streams", Severity.NOTE, "", sentence, "Choose another with --stream NAME."))
    times, resets = stream.times()
    if resets:
        sentence = f"the clock of {stream.name} was set {counted(resets, 'time')} while it was recorded; its times go on."
        found.append(Finding("format-clock-set", Severity.NOTE, "", sentence, "Nothing needs to be done."))
    rate = stream.rate if np.isfinite(stream.rate) else rate_of_times(np.arange(len(times)), times).rate
    if not np.isfinite(rate):
        raise AsterismError(f"{path}: {stream.name} has no rate, and its times do not grow; record it again.")
    row = _rows(times, rate)
    if row[-1] > _MOST_EMPTY * len(row):
        row = np.arange(len(times))
        sentence = f"the samples of {stream.name} are {times[-1] - times[0]:.0f} s apart with long gaps, which are left out."
        found.append(Finding("format-gaps-left-out", Severity.WARNING, "", sentence, "Look at the times of the stream."))
    raw = np.full((int(row[-1]) + 1, *layout.columns.shape), np.nan)
    raw[row] = stream.values[:, layout.columns.ravel()].reshape(-1, *layout.columns.shape)
    scale, unit, about = metres_per_unit(path, layout.unit, raw)
    positions, missing = as_metres(raw, scale, zero_is_missing=True)
    names = [name or f"*{n + 1}" for n, name in enumerate(layout.names)]
    return Points(
        positions,
        tuple(names),
        rate,
        "XDF",
        units=unit,
        findings=(*found, *about, *missing),
        first_time=float(times[0]) if len(times) else None,
    )


def _chosen(path: Path, moving: list[tuple[XdfStream, ChannelLayout]], wanted: str) -> tuple[XdfStream, ChannelLayout]:
    """The stream of a name, or of a number where no name is it."""
    of_name = [each for each in moving if each[0].name.casefold() == wanted.casefold()]
    fitting = of_name or [each for each in moving if str(each[0].id) == wanted]
    if len(fitting) == 1:
        return fitting[0]
    there = listed([f"{stream.name} (number {stream.id}, {counted(len(layout.columns), 'marker')})" for stream, layout in moving])
    sentence = (
        f"{len(fitting)} streams of motion capture are called {wanted}" if fitting else f"no stream of motion capture is called {wanted}"
    )
    raise AsterismError(f"{path}: {sentence}; choose by name or number from: {there}.")


def _layout_of(stream: XdfStream) -> ChannelLayout | None:
    """Where the stream has places of markers; channels that nobody describes count only where the stream calls itself motion capture."""
    layout = layout_of_channels(stream.channels, stream.count)
    return None if layout is not None and layout.guessed and stream.kind.casefold() != "mocap" else layout


def _rows(times: Floats, rate: float) -> Ints:
    """(n,) the frame of each sample: the next one, unless more than a second lies between."""
    steps = np.diff(times)
    lost = np.where(steps > _GAP, np.maximum(1.0, np.rint(np.minimum(steps, _FARTHEST) * rate)), 1.0)
    return np.concatenate([[0], np.cumsum(lost)]).astype(np.int64)
