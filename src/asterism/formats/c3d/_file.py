"""A C3D file as a whole: its bytes in, header, parameters, points and analog samples out, whatever the vendor.

Source: the public C3D format specification.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError, guarded_reading
from asterism.findings import Finding
from asterism.formats._columns import METRES_PER_UNIT, body_size
from asterism.formats._findings import header_conflict, header_doubt, rate_conflict
from asterism.formats.c3d._layout import BLOCK, Header, Layout, find_layout, first_frame_of, header_of
from asterism.formats.c3d._numbers import PC, PROCESSORS, Processor, Words
from asterism.formats.c3d._parameters import Parameters
from asterism.recording import Event, Floats
from asterism.recording.arrays import missing_codes

KEY = 0x50
_NOWHERE = 1e8
_SAME_SCALE = 1e-3
"""Scales that differ by less move the points of a person by 2 mm at most."""
_PERSON = (0.3, 3.0)
"""m, the size of what a person wears: from the markers of a leg of a child to a tall person who stretches."""
_FRAMES_AT_ONCE = 10_000
"""What is converted at a time: a recording of an hour is in memory once, not three times."""


def ranges(frames: int) -> Iterator[slice]:
    """Ranges of frames that together are all, each as many as are converted at once."""
    return (slice(start, min(start + _FRAMES_AT_ONCE, frames)) for start in range(0, frames, _FRAMES_AT_ONCE))


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
        return self._scale[0]

    @cached_property
    def _scale(self) -> tuple[float, Finding | None]:
        """The header's scale, unless the points are as large as a person only by POINT:SCALE; a finding where the two differ."""
        claims = (self.header.scale, self.parameters.number("POINT", "SCALE") or 0.0)
        # A scale of 0 would put all points into the origin.
        scales = [abs(scale) for scale in claims if np.isfinite(scale) and scale != 0]
        if not scales and not self.layout.real:
            return 1.0, header_doubt("neither the header nor POINT:SCALE gives the length of an integer step; one unit was used")
        if self.layout.real or len(scales) < 2 or abs(scales[0] / scales[1] - 1) < _SAME_SCALE:
            return (scales or [1.0])[0], None
        some = slice(None, None, max(1, self.layout.frames // 200))
        steps = self.processor.integers(self.point_words[some, :, :3]).astype(np.float64)
        steps[(self.residuals_of(some) < 0) | ~steps.any(axis=2)] = np.nan
        metres = body_size(steps) * METRES_PER_UNIT.get(self.parameters.text("POINT", "UNITS").casefold(), 0.001)
        persons = [_PERSON[0] <= metres * scale <= _PERSON[1] for scale in scales]
        scale = scales[1] if persons == [False, True] else scales[0]
        sentence = f"the scale is {scales[0]:.6g} by the header and {scales[1]:.6g} by POINT:SCALE; {scale:.6g} was used"
        if persons[0] == persons[1]:
            return scale, header_doubt(sentence)
        return scale, header_conflict(f"{sentence}, which makes the points as large as a person")

    def residuals_of(self, frames: slice) -> NDArray[np.floating[Any]]:
        """(frames, points) the fourth word as a signed number; negative means missing, mostly."""
        fourth = np.ascontiguousarray(self.point_words[frames, :, 3])
        return self.processor.floats(fourth) if self.layout.real else self.processor.integers(fourth).astype(np.float32)

    @cached_property
    def _negative(self) -> NDArray[np.bool_]:
        """(frames, points) whether the residual is negative."""
        return np.concatenate(
            [np.zeros((0, self.layout.points), bool), *(self.residuals_of(some) < 0 for some in ranges(self.layout.frames))]
        )

    @cached_property
    def _signs_of_residuals(self) -> tuple[bool, bool]:
        """Whether some, and whether all residuals are negative."""
        return bool(self._negative.any()), bool(self._negative.all())

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
        if self.layout.frames <= _FRAMES_AT_ONCE:
            return self.coordinates_of(slice(None))
        values = np.empty((self.layout.frames, self.layout.points, 3))
        for some in ranges(self.layout.frames):
            values[some] = self.coordinates_of(some)
        return values

    def coordinates_of(self, frames: slice, points: slice | list[int] = slice(None)) -> Floats:
        """`coordinates` of some frames and points, by default all."""
        xyz = np.ascontiguousarray(self.point_words[frames, points, :3])
        with np.errstate(invalid="ignore", over="ignore"):
            stored = self.processor.floats(xyz) if self.layout.real else self.processor.integers(xyz)
            values = stored.astype(np.float64)
            if not self.layout.real:
                values *= self.scale
            # Compared this way round, NaN is missing, too.
            x, y, z = np.moveaxis(np.abs(values) < _NOWHERE, 2, 0)
            missing = ~(x & y & z) | missing_codes(stored)
            # Scaled integers may give such a number as well.
            if not self.layout.real:
                missing |= missing_codes(values)
        if not self.residuals_are_unused:
            missing |= self._negative[frames][:, points]
        # Many programs write zeros for missing points and leave the residual at 0.
        if self.zeros_are_missing:
            missing |= (xyz[..., 0] | xyz[..., 1] | xyz[..., 2]) & self._not_sign == 0
        values[missing] = np.nan
        return values

    @cached_property
    def coded(self) -> Floats:
        """(N, 3) the samples, as they are stored, that no residual marks as missing, but a number such as -9999."""
        found = []
        for some in ranges(self.layout.frames):
            xyz = self.point_words[some, :, :3]
            stored = self.processor.floats(np.ascontiguousarray(xyz)) if self.layout.real else self.processor.integers(xyz)
            found.append(stored[missing_codes(stored) & ~self._negative[some]])
        return np.concatenate([np.empty((0, 3)), *found])

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
            samples -= offsets
            samples *= scales
            if general not in (None, 1.0):
                samples *= general
        return samples

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
        found = [self.parameters.text_of(raw) for raw in self.raw_labels]
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
        return self._rate[0]

    @cached_property
    def _rate(self) -> tuple[float, Finding | None]:
        """POINT:RATE, unless the header and the rate of the analog samples agree on another one; a finding where they differ."""
        samples = self.layout.analog / self.analog_channels if self.analog_channels else 0.0
        analog = self.parameters.number("ANALOG", "RATE") or 0.0
        claims = {
            "POINT:RATE": self.parameters.number("POINT", "RATE") or 0.0,
            "the header": self.header.rate,
            "ANALOG:RATE": analog / samples if samples else 0.0,
        }
        rates = {name: rate for name, rate in claims.items() if np.isfinite(rate) and 0 < rate < 1e7}
        if not rates.keys() - {"ANALOG:RATE"}:
            raise AsterismError(f"{self.path}: neither the header nor POINT:RATE gives a frame rate; write the right one into POINT:RATE.")
        # Rates agree where they come apart by less than half a frame until the recording ends.
        votes = {name: sum(abs(rate / other - 1) * self.layout.frames <= 0.5 for other in rates.values()) for name, rate in rates.items()}
        name = max(rates, key=lambda name: votes[name])
        if votes[name] == len(rates):
            return rates[name], None
        said = ", ".join(f"{rate:.6g} by {name}" for name, rate in rates.items())
        sentence = f"there are several frame rates: {said}; {rates[name]:.6g} was used"
        return rates[name], rate_conflict(sentence) if votes[name] > 1 else header_doubt(sentence)

    @cached_property
    def first_frame(self) -> int:
        """The number of the first stored frame, 1 for the first of the trial."""
        return self._first_frame[0]

    @cached_property
    def _first_frame(self) -> tuple[int, Finding | None]:
        return first_frame_of(self.header, self.parameters, self.layout, self.events, self.rate)

    @cached_property
    def doubts(self) -> tuple[Finding, ...]:
        """What the file contradicts itself in beyond its layout: scale, rate and the number of the first frame."""
        return tuple(finding for _, finding in (self._scale, self._rate, self._first_frame) if finding is not None)

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """What the EVENT group marks, else what the header marks."""
        return tuple(events_of_group(self.parameters)) or self.header.events


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
    parameters, layout, found = find_layout(raw, path, processor, header)
    return C3DFile(path, raw, processor, header, parameters, layout, (*findings, *found, *parameters.findings))


def _likely_processor(raw: bytes | bytearray) -> Processor:
    def sane(processor: Processor) -> bool:
        # A frame rate is a sane number in one byte order only.
        rate = processor.float_at(raw, 20)
        return np.isfinite(rate) and 0.1 <= rate <= 1e5

    return next((processor for processor in PROCESSORS.values() if sane(processor)), PC)


def events_of_group(parameters: Parameters) -> Iterator[Event]:
    """The events of the group EVENT, in their order."""
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
