"""The parameter section of a C3D file: its bytes in, records that remember where they lay out, and bytes again.

A section is a chain of records, each a group (negative id) or a parameter (id of its group), each pointing to the next.
Records that nobody changes are carried as their bytes, so that rewriting a file keeps what this code does not understand.
Source: the public C3D format specification, "The parameter section".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import prod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.files.text import JAPANESE, LATIN, encoding_of
from asterism.findings import Finding
from asterism.formats._findings import header_conflict, text_encoding
from asterism.formats.c3d._numbers import Processor

CHARACTER, BYTE, INTEGER, FLOAT = -1, 1, 2, 4
_MOST_VALUES = 1 << 20
_HEADER = 4


class Record(NamedTuple):
    """One group or parameter: its bytes `raw`, from its name's length up to the next record, and what they say."""

    raw: bytes
    name: str
    group: int
    is_group: bool
    last: bool
    kind: int = 0
    dimensions: tuple[int, ...] = ()
    data: bytes = b""
    cut: bool = False


@dataclass(frozen=True)
class Parameters:
    """A parsed section: `records` in file order, `tail` the bytes after the last of them, `findings` what was wrong.

    encoding: that of its texts that are no UTF-8.
    """

    head: bytes
    records: tuple[Record, ...]
    tail: bytes
    processor: Processor
    findings: tuple[Finding, ...] = ()
    encoding: str = LATIN
    _index: Mapping[tuple[str, str], int] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        names: dict[int, str] = {}
        for record in self.records:
            if record.is_group:
                # The first of two groups with one number names it, as in the vendors' readers.
                names.setdefault(record.group, record.name.upper())
        index: dict[tuple[str, str], int] = {}
        for place, record in enumerate(self.records):
            if not record.is_group and record.group in names:
                # Of repeated parameters the first counts.
                index.setdefault((names[record.group], record.name.upper()), place)
        object.__setattr__(self, "_index", index)

    @cached_property
    def groups(self) -> dict[str, list[str]]:
        """Group name -> names of its parameters, both in capitals, in file order."""
        found: dict[str, list[str]] = {r.name.upper(): [] for r in self.records if r.is_group}
        for group, name in self._index:
            found[group].append(name)
        return found

    def group_id(self, group: str) -> int | None:
        """The id of a group, or None where there is no such group."""
        return next((r.group for r in self.records if r.is_group and r.name.upper() == group), None)

    def find(self, group: str, name: str) -> Record | None:
        """A parameter's record, or None."""
        place = self._index.get((group, name))
        return None if place is None else self.records[place]

    def strings(self, group: str, name: str) -> list[str]:
        """A character parameter as strings without padding; empty where absent."""
        return [self.text_of(raw) for raw in self.raw_strings(group, name)]

    def text_of(self, raw: bytes) -> str:
        """A character string of the file as text."""
        return text_of(raw, self.encoding)

    def raw_strings(self, group: str, name: str) -> list[bytes]:
        """A character parameter as byte strings, padding included; empty where absent."""
        record = self.find(group, name)
        if record is None or record.kind != CHARACTER:
            return []
        if not record.dimensions:
            return [record.data[:1]]
        width, count = record.dimensions[0], prod(record.dimensions[1:])
        return [record.data[i * width : (i + 1) * width] for i in range(count)]

    def text(self, group: str, name: str) -> str:
        """The first string of a character parameter, empty where absent."""
        return next(iter(self.strings(group, name)), "")

    def values(self, group: str, name: str) -> NDArray[np.float64]:
        """A numeric parameter, flat and as it lies in the file; empty where absent."""
        record = self.find(group, name)
        if record is None:
            return np.empty(0)
        if record.kind == FLOAT:
            return self.processor.floats(self.processor.words32(record.data[: len(record.data) // 4 * 4])).astype(np.float64)
        if record.kind == INTEGER:
            return self.processor.integers(self.processor.words16(record.data[: len(record.data) // 2 * 2])).astype(np.float64)
        if record.kind == BYTE:
            return np.frombuffer(record.data, np.uint8).astype(np.float64)
        return np.empty(0)

    def counts(self, group: str, name: str) -> list[int]:
        """A numeric parameter as counts: 16-bit integers without sign, floats where they are whole; empty where absent."""
        record = self.find(group, name)
        values = self.values(group, name)
        if record is not None and record.kind == INTEGER:
            # Sixteen bits without their sign count up to 65535, as newer files do.
            values = np.where(values < 0, values + 65536, values)
        return [int(value) for value in values if np.isfinite(value) and 0 <= value < 2**31 and value == int(value)]

    def count(self, group: str, name: str) -> int | None:
        """The first of `counts`, or None."""
        return next(iter(self.counts(group, name)), None)

    def number(self, group: str, name: str) -> float | None:
        """The first value of a numeric parameter if it is finite, or None."""
        return next((float(value) for value in self.values(group, name)[:1] if np.isfinite(value)), None)

    def replaced(self, changes: Mapping[tuple[str, str], Record | None]) -> Parameters:
        """The section with parameters changed, added behind their group (a new group at the front) or, where None, removed."""
        records: list[Record] = list(self.records)
        key_of = {place: key for key, place in self._index.items()}
        # From the back, so that earlier places stay right.
        for place in sorted((self._index[key] for key in changes if key in self._index), reverse=True):
            change = changes[key_of[place]]
            if change is None:
                del records[place]
            else:
                records[place] = change
        for key, change in changes.items():
            if key not in self._index and change is not None:
                if change.is_group:
                    records.insert(0, change)
                    continue
                # A new parameter stands behind its group, where readers look for it.
                after = next((i for i, r in enumerate(records) if r.is_group and r.group == change.group), -1)
                records.insert(after + 1, change)
        return self._of(records)

    def without(self, group: str) -> Parameters:
        """The section without a group and its parameters."""
        number = self.group_id(group)
        return self._of([record for record in self.records if record.group != number])

    def _of(self, records: Sequence[Record]) -> Parameters:
        # A chain that ended by its link needs a zero record once something follows.
        ended_by_link = bool(self.records) and self.records[-1].last
        tail = b"\0\0" + self.tail[2:] if ended_by_link else self.tail
        return replace(self, records=tuple(records), tail=tail)

    def repaired(self) -> Parameters:
        """The section with a last parameter that the data cut short filled up with blanks, so that something can follow it."""
        if not self.records or not self.records[-1].cut or self.records[-1].last:
            return self
        last = self.records[-1]
        data = last.data.ljust(prod(last.dimensions) * abs(last.kind), b" " if last.kind == CHARACTER else b"\0")
        whole = make_parameter(last.name, last.group, last.kind, last.dimensions, data, processor=self.processor)
        return replace(self, records=(*self.records[:-1], whole), tail=b"")

    def to_bytes(self) -> bytes:
        """The section with its four-byte head, as long as its records need and ended by a zero record."""
        end = len(self.records) - 1
        chain = b"".join(self._linked(record, last=i == end and record.last) for i, record in enumerate(self.records))
        return self.head + chain + self.tail.rstrip(b"\0").ljust(2, b"\0")

    def _linked(self, record: Record, last: bool) -> bytes:
        # Records that nobody changed are carried bit by bit.
        if last == record.last:
            return record.raw
        at = 2 + abs(int.from_bytes(record.raw[:1], "little", signed=True))
        return record.raw[:at] + self.processor.bytes_of_unsigned(0 if last else len(record.raw) - at) + record.raw[at + 2 :]


def parse_parameters(section: bytes, processor: Processor) -> Parameters:
    """The records of a section (its four-byte head included), up to the first that cannot be read."""
    records: list[Record] = []
    findings: list[Finding] = []
    at = _HEADER
    while at + 2 <= len(section):
        # A negative length marks a locked name.
        size = _signed(section[at])
        if size == 0:
            break
        record, problem = _record_at(section, at, abs(size), processor)
        if problem:
            findings.append(header_conflict(problem))
        if record is None:
            break
        records.append(record)
        at += len(record.raw)
        if record.last or record.cut:
            break
    parameters = Parameters(section[:_HEADER], tuple(records), section[at:], processor, tuple(findings))
    foreign = _foreign(parameters)
    encoding = encoding_of(foreign) if foreign else LATIN
    if encoding == JAPANESE:
        findings.append(text_encoding("the names are in Shift-JIS, which is not what the format has, and were read as such"))
    elif encoding is None:
        # The first such name, as it is shown, tells a person what is meant.
        shown = text_of(foreign[0])[:20]
        findings.append(text_encoding(f"the encoding of the names is not known, such as of {shown!r}; their letters are shown wrong"))
    return replace(parameters, encoding=encoding or LATIN, findings=tuple(findings))


def _foreign(parameters: Parameters) -> list[bytes]:
    """The names of points, channels, events and subjects that are no UTF-8."""
    strings = (
        _unpadded(raw)
        for group in ("POINT", "ANALOG", "EVENT", "SUBJECTS")
        for name in parameters.groups.get(group, ())
        for raw in parameters.raw_strings(group, name)
        if not raw.isascii()
    )
    return [raw for raw in strings if _utf8(raw) is None]


def _signed(byte: int) -> int:
    return byte - 256 if byte > 127 else byte


def _record_at(section: bytes, at: int, size: int, processor: Processor) -> tuple[Record | None, str]:
    group = _signed(section[at + 1])
    link = at + 2 + size
    if link + 2 > len(section):
        return None, f"the parameter section breaks off at byte {at}"
    name = text_of(section[at + 2 : link])
    step = processor.unsigned_of(section[link : link + 2])
    # Groups have negative numbers; parameters the number of their group.
    if group <= 0:
        # A link of 0 ends the chain, so that the length comes from the record itself.
        stop = link + step if step else min(len(section), link + 3 + section[link + 2] if link + 2 < len(section) else link + 2)
        if step in (1, 2) or stop > len(section):
            return None, f"the parameter section breaks off in group {name}"
        return Record(section[at:stop], name, -group, True, step == 0), ""
    if link + 4 > len(section):
        return None, f"the parameter section breaks off in parameter {name}"
    kind = _signed(section[link + 2])
    rank = section[link + 3]
    dimensions = tuple(section[link + 4 : link + 4 + rank])
    count = prod(dimensions)
    begin, room = link + 4 + rank, len(section)
    needed = count * abs(kind)
    # An unknown type cannot be measured: its link alone says where it ends.
    if kind not in (CHARACTER, BYTE, INTEGER, FLOAT) or len(dimensions) < rank or prod(dimensions[1:]) > _MOST_VALUES:
        if step < 4 or link + step > room:
            return None, f"the parameter section breaks off in parameter {name}"
        return Record(section[at : link + step], name, group, False, False), f"parameter {name} has an unknown type; it is left as it is"
    data = section[begin : begin + needed]
    own_end = min(room, begin + needed + 1 + (section[begin + needed] if begin + needed < room else 0))
    # The data begin before the parameter ends: it is kept as far as it goes.
    if len(data) < needed:
        return Record(section[at:], name, group, False, False, kind, dimensions, data, cut=True), f"parameter {name} is cut by the data"
    stop = own_end if step == 0 else link + step
    # A link that points into the record, or out of the section, ends the chain here.
    if stop > room or stop < begin + needed:
        return Record(section[at:own_end], name, group, False, True, kind, dimensions, data, cut=True), f"parameter {name} points nowhere"
    return Record(section[at:stop], name, group, False, step == 0, kind, dimensions, data), ""


def make_group(name: str, group: int, description: str = "", *, processor: Processor) -> Record:
    """A new group record."""
    # Names have 127 bytes at most.
    text = name.encode("utf-8")[:127]
    note = description.encode("utf-8")[:255]
    link = processor.bytes_of_unsigned(3 + len(note))
    raw = bytes([len(text), 256 - group]) + text + link + bytes([len(note)]) + note
    return Record(raw, name, group, True, False)


def make_parameter(
    name: str, group: int, kind: int, dimensions: Sequence[int], data: bytes, *, processor: Processor, like: Record | None = None
) -> Record:
    """A new parameter record; from `like` come the spelling and lock of the name, and the description."""
    text, size, note = name.encode("utf-8")[:127], len(name.encode("utf-8")[:127]), b"\0"
    if like is not None:
        # The sign of the length is the lock of the name, which stays.
        old = int.from_bytes(like.raw[:1], "little", signed=True)
        text, size = like.raw[2 : 2 + abs(old)], old
        begin = 2 + abs(old) + 4 + len(like.dimensions) + len(like.data)
        note = like.raw[begin : begin + 1 + like.raw[begin]] if begin < len(like.raw) else b"\0"
    body = kind.to_bytes(1, "little", signed=True) + bytes([len(dimensions), *dimensions]) + data + note
    raw = size.to_bytes(1, "little", signed=True) + bytes([group]) + text + processor.bytes_of_unsigned(2 + len(body)) + body
    return Record(raw, name, group, False, False, kind, tuple(dimensions), data)


def text_of(raw: bytes, encoding: str = LATIN) -> str:
    """Characters of a file as text: UTF-8 where it is, else that encoding; blanks and NUL padding taken off."""
    raw = _unpadded(raw)
    # Nearly all texts are ASCII, of which nothing need be tried.
    if raw.isascii():
        return raw.decode("ascii").strip()
    text = _utf8(raw)
    return raw.decode(encoding, errors="replace").strip() if text is None else text


def _unpadded(raw: bytes) -> bytes:
    # NUL pads as blanks do; what stands behind it is left from before.
    return raw.split(b"\0", 1)[0].strip()


def _utf8(raw: bytes) -> str | None:
    """The text of UTF-8, also where the width of its field cut the last character of several; None of anything else."""
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError as problem:
        before = raw[: problem.start].decode("utf-8")
        return before if problem.reason == "unexpected end of data" and not before.isascii() else None
