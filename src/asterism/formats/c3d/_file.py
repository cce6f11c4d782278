"""A C3D file as a whole: its bytes in, header, parameters, points and analog samples out, whatever the vendor.

Headers and parameters of real files contradict each other. What they say about the data block (points, analog samples, frames,
number format) is treated as a set of claims; those that agree with the length of the file are used.
Source: the public C3D format specification.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError, guarded_reading
from asterism.findings import Finding
from asterism.formats._findings import cut_off, header_conflict
from asterism.formats.c3d._numbers import PC, PROCESSORS, Processor, Words
from asterism.formats.c3d._parameters import Parameters, parse_parameters, text_of
from asterism.recording import Event, Floats

BLOCK = 512
KEY = 0x50
_LABEL_KEY = 12345
_NOWHERE = 1e8
_FRAMES_AT_ONCE = 10_000
"""What is converted at a time: a recording of an hour is in memory once, not three times."""


def ranges(frames: int) -> Iterator[slice]:
    """Ranges of frames that together are all, each as many as are converted at once."""
    return (slice(start, min(start + _FRAMES_AT_ONCE, frames)) for start in range(0, frames, _FRAMES_AT_ONCE))


@dataclass(frozen=True)
class Header:
    """The first block, with its numbers as they are, right or wrong."""

    parameters_at: int
    points: int
    analog_per_frame: int
    first_frame: int
    last_frame: int
    scale: float
    data_at: int
    analog_per_point_frame: int
    rate: float
    events: tuple[Event, ...]


@dataclass(frozen=True)
class Layout:
    """What the data block holds: `frames` of `points` times four words and `analog` words each, from byte `start` on.

    cut: whether the file breaks off before the frames that it declares.
    """

    start: int
    frames: int
    points: int
    analog: int
    real: bool
    cut: bool = False

    @property
    def width(self) -> int:
        """Words per frame."""
        return 4 * self.points + self.analog

    @property
    def stop(self) -> int:
        """The byte behind the last frame."""
        return self.start + self.frames * self.width * (4 if self.real else 2)


@dataclass(frozen=True)
class C3DFile:
    """A parsed file. `raw` is all of it; everything else is a view on it."""

    path: str
    raw: bytes | bytearray
    processor: Processor
    header: Header
    parameters: Parameters
    layout: Layout
    findings: tuple[Finding, ...]

    def __reduce__(self) -> tuple[Any, ...]:
        return parse_c3d, (self.raw, self.path)

    @cached_property
    def words(self) -> Words:
        """(frames, width) the data block as raw bit patterns."""
        count = self.layout.frames * self.layout.width
        read = self.processor.words32 if self.layout.real else self.processor.words16
        # A copy is only made where the byte order asks for one.
        return read(self.raw, count, self.layout.start).reshape(self.layout.frames, self.layout.width)

    @cached_property
    def point_words(self) -> Words:
        """(frames, points, 4) raw bit patterns of x, y, z and the fourth word (residual and cameras)."""
        return self.words[:, : 4 * self.layout.points].reshape(self.layout.frames, self.layout.points, 4)

    @cached_property
    def scale(self) -> float:
        """The length of one integer step in the file's unit, positive."""
        # A scale of 0 would put all points into the origin.
        for scale in (self.header.scale, self.parameters.number("POINT", "SCALE") or 0.0):
            if np.isfinite(scale) and scale != 0:
                return abs(scale)
        return 1.0

    def residuals_of(self, frames: slice) -> NDArray[np.floating[Any]]:
        """(frames, points) the fourth word as a signed number; negative means missing, mostly."""
        fourth = np.ascontiguousarray(self.point_words[frames, :, 3])
        return self.processor.floats(fourth) if self.layout.real else self.processor.integers(fourth).astype(np.float32)

    @cached_property
    def _signs_of_residuals(self) -> tuple[bool, bool]:
        """Whether some, and whether all residuals are negative."""
        negative = [self.residuals_of(some) < 0 for some in ranges(self.layout.frames)]
        return any(some.any() for some in negative), all(some.all() for some in negative)

    @cached_property
    def residuals_are_unused(self) -> bool:
        """Whether every residual is negative although the file has coordinates, as SIMI writes them."""
        return self._signs_of_residuals[1] and any(
            bool((self.point_words[some, :, :3] & self._not_sign).any()) for some in ranges(self.layout.frames)
        )

    @cached_property
    def zeros_are_missing(self) -> bool:
        """Whether a point at exactly (0, 0, 0) is missing: where no residual is negative, except in files of Asterism."""
        return self.residuals_are_unused or not (self.by_asterism or self._signs_of_residuals[0])

    @cached_property
    def by_asterism(self) -> bool:
        """Whether Asterism wrote this file."""
        return self.parameters.text("MANUFACTURER", "SOFTWARE").startswith("Asterism")

    @property
    def coordinates(self) -> Floats:
        """(frames, points, 3) in the file's unit, NaN where a point is missing, not finite or impossibly far away; made anew each time."""
        values = np.empty((self.layout.frames, self.layout.points, 3))
        for some in ranges(self.layout.frames):
            values[some] = self.coordinates_of(some)
        return values

    def coordinates_of(self, frames: slice) -> Floats:
        """`coordinates` of some frames."""
        xyz = np.ascontiguousarray(self.point_words[frames, :, :3])
        with np.errstate(invalid="ignore", over="ignore"):
            stored = self.processor.floats(xyz) if self.layout.real else self.processor.integers(xyz)
            values = stored.astype(np.float64) * (1.0 if self.layout.real else self.scale)
            # Compared this way round, NaN is missing, too.
            missing = ~(np.abs(values) < _NOWHERE).all(axis=2)
        if not self.residuals_are_unused:
            missing |= self.residuals_of(frames) < 0
        # Many programs write zeros for missing points and leave the residual at 0.
        if self.zeros_are_missing:
            missing |= ~(xyz & self._not_sign).any(axis=2)
        values[missing] = np.nan
        return values

    @property
    def _not_sign(self) -> np.unsignedinteger[Any]:
        if not self.layout.real:
            return np.uint16(0xFFFF)
        # The sign bit of a VAX float lies in its first half, which comes second.
        return np.uint32(0xFFFF7FFF) if self.processor.vax else np.uint32(0x7FFFFFFF)

    @cached_property
    def analog(self) -> Floats:
        """(frames * samples per frame, channels) in the channels' units: (sample - offset) * scale * general scale."""
        channels = self.analog_channels
        if not channels:
            return np.empty((0, 0))
        words = np.ascontiguousarray(self.words[:, 4 * self.layout.points :]).reshape(-1, channels)
        general = self.parameters.number("ANALOG", "GEN_SCALE")
        unsigned = self.parameters.text("ANALOG", "FORMAT").upper() == "UNSIGNED"
        scales, offsets = self._per_channel("SCALE", 1.0), self._per_channel("OFFSET", 0.0)
        if self.layout.real:
            samples = self.processor.floats(words).astype(np.float64)
        else:
            samples = (words if unsigned else self.processor.integers(words)).astype(np.float64)
        record = self.parameters.find("ANALOG", "OFFSET")
        # Offsets of unsigned samples are unsigned as well, and read as negative ones.
        if unsigned and record is not None and record.kind == 2:
            offsets = np.where(offsets < 0, offsets + 65536, offsets)
        # Damaged scales may overflow; the samples are then infinite, and nothing else suffers.
        with np.errstate(all="ignore"):
            return (samples - offsets) * scales * (1.0 if general is None else general)

    def _per_channel(self, name: str, default: float) -> Floats:
        values = self.parameters.values("ANALOG", name)[: self.analog_channels]
        return np.concatenate([values, np.full(self.analog_channels - len(values), default)])

    @cached_property
    def analog_channels(self) -> int:
        """Number of analog channels in the data block."""
        analog = self.layout.analog
        # Of several counts the one that divides the samples is right.
        for channels in (self.parameters.count("ANALOG", "USED"), self._channels_by_header()):
            if channels and analog and analog % channels == 0:
                return channels
        return analog

    def _channels_by_header(self) -> int:
        each = self.header.analog_per_point_frame
        return self.layout.analog // each if each and self.layout.analog % each == 0 else 0

    @cached_property
    def raw_labels(self) -> list[bytes]:
        """One label per point as it lies in the file (LABELS, LABELS2, ...), empty where the file has none."""
        return self._per_point("LABELS")

    @cached_property
    def labels(self) -> list[str]:
        """One label per point; a point without one is called `*` and its place, counted from 1."""
        found = [text_of(raw) for raw in self.raw_labels]
        return [label or f"*{place + 1}" for place, label in enumerate(found)]

    @cached_property
    def descriptions(self) -> list[bytes]:
        """One description per point as it lies in the file, empty where the file has none."""
        return self._per_point("DESCRIPTIONS")

    def _per_point(self, name: str) -> list[bytes]:
        # Labels beyond 255 are in LABELS2, LABELS3 and so on.
        found = [raw for key in numbered(self.parameters, "POINT", name) for raw in self.parameters.raw_strings("POINT", key)]
        return [*found[: self.layout.points], *[b""] * (self.layout.points - len(found))]

    @cached_property
    def rate(self) -> float:
        """Frames per second. Raises AsterismError where neither the header nor POINT:RATE says it."""
        for rate in (self.parameters.number("POINT", "RATE"), self.header.rate):
            if rate is not None and np.isfinite(rate) and 0 < rate < 1e7:
                return float(rate)
        raise AsterismError(f"{self.path}: neither the header nor POINT:RATE gives a frame rate; write the right one into POINT:RATE.")

    @cached_property
    def first_frame(self) -> int:
        """The number of the first stored frame, 1 for the first of the trial."""
        start = self.parameters.counts("TRIAL", "ACTUAL_START_FIELD")
        # The header's number has 16 bits only.
        return start[0] + 65536 * start[1] if len(start) >= 2 else self.header.first_frame

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """What the EVENT group marks, else what the header marks."""
        return tuple(_events_of_group(self.parameters)) or self.header.events


def numbered(parameters: Parameters, group: str, name: str) -> list[str]:
    """LABELS, LABELS2, LABELS3, ... as far as they go without a gap."""
    names = [name]
    while parameters.find(group, f"{name}{len(names) + 1}") is not None:
        names.append(f"{name}{len(names) + 1}")
    return names


def open_c3d(path: Path) -> C3DFile:
    """Parse a file. Raises AsterismError where it cannot be opened or is not a C3D file."""
    with guarded_reading(path):
        raw = path.read_bytes()
    return parse_c3d(raw, str(path))


def parse_c3d(raw: bytes | bytearray, path: str) -> C3DFile:
    """Parse a file's bytes; `path` names it in messages. Raises AsterismError where this is not a C3D file, or holds no data."""
    if not raw:
        raise AsterismError(f"{path} is empty; export or copy it again.")
    # The second byte is the same in every C3D file.
    if len(raw) < BLOCK or raw[1] != KEY:
        why = f"it is only {len(raw)} bytes long" if len(raw) < BLOCK else "its second byte is not the C3D mark"
        raise AsterismError(f"{path} is not a C3D file ({why}); export or copy it again.")
    findings: list[Finding] = []
    parameters_at = max(raw[0] - 1, 1) * BLOCK
    if parameters_at + 4 > len(raw):
        raise AsterismError(f"{path} breaks off before its parameters; export or copy it again.")
    # The byte order is stated in the fourth byte of the parameters.
    processor = PROCESSORS.get(raw[parameters_at + 3])
    if processor is None:
        processor = _likely_processor(raw)
        findings.append(header_conflict(f"processor type {raw[parameters_at + 3]} is unknown; {processor.name} is assumed"))
    header = header_of(raw, processor, parameters_at)
    data_at = _data_start(raw, processor, header, findings)
    # Parameters end where the data begin, or where their own count says.
    stop = data_at if data_at > parameters_at else min(len(raw), parameters_at + BLOCK * max(raw[parameters_at + 2], 1))
    parameters = parse_parameters(bytes(raw[parameters_at:stop]), processor)
    # The other pointer to the data, which vendors fill in more or less well.
    data_start = (parameters.count("POINT", "DATA_START") or 0) * BLOCK - BLOCK
    if not header.data_at and parameters_at < data_start <= len(raw):
        data_at = data_start
        parameters = parse_parameters(bytes(raw[parameters_at:data_at]), processor)
    elif data_start != data_at:
        findings.append(
            header_conflict(
                f"POINT:DATA_START says block {data_start // BLOCK + 1}, the header {data_at // BLOCK + 1}; the header was used"
            )
        )
    layout = _layout(path, len(raw), data_at, header, parameters, findings)
    return C3DFile(path, raw, processor, header, parameters, layout, (*findings, *parameters.findings))


def _likely_processor(raw: bytes | bytearray) -> Processor:
    def sane(processor: Processor) -> bool:
        # A frame rate is a sane number in one byte order only.
        rate = processor.float_at(raw, 20)
        return np.isfinite(rate) and 0.1 <= rate <= 1e5

    return next((processor for processor in PROCESSORS.values() if sane(processor)), PC)


def header_of(raw: bytes | bytearray, processor: Processor, parameters_at: int) -> Header:
    """The header of a file's bytes."""

    def word(number: int) -> int:
        return processor.unsigned_at(raw, 2 * number - 2)

    return Header(
        parameters_at=parameters_at,
        points=word(2),
        analog_per_frame=word(3),
        first_frame=word(4),
        last_frame=word(5),
        scale=processor.float_at(raw, 12),
        data_at=max(word(9) - 1, 0) * BLOCK,
        analog_per_point_frame=word(10),
        rate=processor.float_at(raw, 20),
        events=tuple(_events_of_header(raw, processor)),
    )


def _data_start(raw: bytes | bytearray, processor: Processor, header: Header, findings: list[Finding]) -> int:
    if BLOCK <= header.data_at <= len(raw) and header.data_at != header.parameters_at:
        return header.data_at
    # The count of parameter blocks is the last resort.
    counted = header.parameters_at + BLOCK * raw[header.parameters_at + 2]
    if header.data_at:
        findings.append(
            header_conflict(f"the header says that data begin in block {header.data_at // BLOCK + 1}, which the file does not have")
        )
    return min(counted, len(raw))


def _layout(path: str, size: int, start: int, header: Header, parameters: Parameters, findings: list[Finding]) -> Layout:
    room = size - start
    claims = list(_claims(header, parameters, start))
    fits = [(claim, room - (claim.stop - start)) for claim in claims]
    # A layout that fills the file but for its last block is the true one.
    best = next((claim for claim, left in fits if 0 <= left < BLOCK and claim.frames), None)
    if best is None:
        # Else the one that leaves least of the file unread.
        best = next((claim for claim, left in sorted(fits, key=lambda fit: fit[1]) if left >= 0 and claim.frames and claim.width), None)
    if best is None:
        # None fits into the file: it was cut off, and holds as many frames as are whole.
        claim = next((c for c in claims if c.width and c.frames), claims[0])
        frames = room // (claim.width * (4 if claim.real else 2)) if claim.width else 0
        if claim.frames and claim.width and not frames:
            raise AsterismError(f"{path} breaks off before its first frame ends; export or copy it again.")
        best = Layout(start, min(frames, claim.frames), claim.points, claim.analog, claim.real, cut=frames < claim.frames)
        if best.cut:
            findings.append(cut_off(f"the file breaks off: it holds {best.frames} of {claim.frames} frames"))
    first = claims[0]
    for noun, declared, found in (
        ("points", header.points, best.points),
        ("analog samples per frame", header.analog_per_frame, best.analog),
        ("points", parameters.count("POINT", "USED"), best.points),
        ("frames", first.frames, best.frames),
    ):
        # What was cut off contradicts every count; saying so once is enough.
        if declared is not None and declared != found and not any("breaks off:" in finding.sentence for finding in findings):
            findings.append(header_conflict(f"{declared} {noun} are declared, the data hold {found}"))
    return best


def _claims(header: Header, parameters: Parameters, start: int) -> Iterator[Layout]:
    """Every layout of the data block that some part of the file declares, the most reliable first."""
    used = parameters.count("POINT", "USED")
    channels, rates = parameters.count("ANALOG", "USED"), [parameters.number(group, "RATE") for group in ("ANALOG", "POINT")]
    analog = [header.analog_per_frame]
    if channels is not None:
        analog.append(channels * header.analog_per_point_frame)
        if rates[0] and rates[1]:
            analog.append(channels * min(max(round(rates[0] / rates[1]), 0), 65535))
    begin, end = parameters.counts("TRIAL", "ACTUAL_START_FIELD"), parameters.counts("TRIAL", "ACTUAL_END_FIELD")
    # Frames are counted in three places, with 16 bits in two of them.
    frames = [header.last_frame - header.first_frame + 1]
    if len(begin) >= 2 and len(end) >= 2:
        frames.append(end[0] + 65536 * end[1] - begin[0] - 65536 * begin[1] + 1)
    frames += [count for name in ("LONG_FRAMES", "FRAMES") if (count := parameters.count("POINT", name)) is not None]
    # 65535 is what a 16-bit count shows of more frames: it comes last.
    frames = sorted(dict.fromkeys(count for count in frames if count > 0), key=lambda count: count == 65535) or [0]
    scale = parameters.number("POINT", "SCALE")
    signs = [header.scale] if np.isfinite(header.scale) and header.scale != 0 else []
    signs += [scale] if scale else []
    # Without a sign both number formats are tried.
    reals = dict.fromkeys([sign < 0 for sign in signs] or [True, False])
    points = [header.points] + ([used] if used is not None else [])
    for real, count, samples, length in product(reals, dict.fromkeys(points), dict.fromkeys(analog), frames):
        yield Layout(start, length, count, samples, real)


# Labels of header events are only there with this key.
def _events_of_header(raw: bytes | bytearray, processor: Processor) -> Iterator[Event]:
    if processor.unsigned_at(raw, 298) != _LABEL_KEY:
        return
    for place in range(min(processor.unsigned_at(raw, 300), 18)):
        time = processor.float_at(raw, 304 + 4 * place)
        label = raw[396 + 4 * place : 400 + 4 * place].decode("latin-1").strip("\0 ")
        if np.isfinite(time):
            yield Event(label, time)


def _events_of_group(parameters: Parameters) -> Iterator[Event]:
    labels, contexts = ([s for key in numbered(parameters, "EVENT", name) for s in parameters.strings("EVENT", key)]
                        for name in ("LABELS", "CONTEXTS"))  # fmt: skip
    times = np.concatenate([parameters.values("EVENT", key) for key in numbered(parameters, "EVENT", "TIMES")])
    # An odd number of values is a damaged list: its last one is dropped.
    times = times[: len(times) // 2 * 2].reshape(-1, 2)
    used = parameters.count("EVENT", "USED")
    for place, (minutes, seconds) in enumerate(times[: used if used is not None else len(times)]):
        if np.isfinite(minutes) and np.isfinite(seconds):
            label, context = (texts[place] if place < len(texts) else "" for texts in (labels, contexts))
            yield Event(label, float(minutes * 60 + seconds), context)
