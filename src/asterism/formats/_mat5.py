"""MATLAB's MAT files of version 5 to 7: bytes in; structs as dictionaries, cells as lists, text, and arrays out.

SciPy's reader trusts what a file says about itself and can crash the interpreter on a damaged one; this one checks every length.
"""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _COMPRESSED, _UTF8, _UTF16, _UTF32 = 14, 15, 16, 17, 18
_CELL, _STRUCT, _CHAR = 1, 2, 4
_NUMERIC = range(6, 16)
_DEEPEST = 24
_MOST_BYTES = 256 << 20


def variables_of(data: bytes) -> dict[str, Any]:
    """The variables of a MAT file by name. Arrays keep MATLAB's shape (numbers as float64 or uint8); what is not a number, text, cell or
    struct (function handles, sparse matrices, objects) is None.

    Raises ValueError where the file is not what it says, or would unpack to far more than it holds.
    """
    # The mark of the byte order is the only sure sign of the format.
    if len(data) < 136 or data[126:128] not in (b"IM", b"MI"):
        raise ValueError("it has no header of MATLAB 5")
    order = "<" if data[126:128] == b"IM" else ">"
    found: dict[str, Any] = {}
    place = 128
    while place + 8 <= len(data):
        kind, body, place = _element(data, place, order)
        if kind == _COMPRESSED:
            kind, body, _ = _element(_unpacked(body), 0, order)
        if kind == _MATRIX and body:
            name, value = _matrix(body, order, 0)
            found[name] = value
    return found


def _unpacked(body: bytes) -> bytes:
    # Small files may unpack freely; beyond that, only as far as numbers can be packed.
    most = max(_MOST_BYTES, 100 * len(body))
    try:
        unpacker = zlib.decompressobj()
        out = unpacker.decompress(body, most)
    except zlib.error as problem:
        raise ValueError("a compressed part of it is damaged") from problem
    # What is left over would go on: the part claims too much.
    if unpacker.unconsumed_tail:
        raise ValueError("a part of it unpacks to far more than it should")
    return out


def _element(data: bytes, place: int, order: str) -> tuple[int, bytes, int]:
    """Type and content of the element at `place`, and where the next one begins."""
    if place + 8 > len(data):
        raise ValueError("it ends within an element")
    kind, size = struct.unpack_from(order + "II", data, place)
    # A small element keeps type, size and content in eight bytes.
    if kind >> 16:
        size, kind = kind >> 16, kind & 0xFFFF
        if size > 4:
            raise ValueError("a small element is too large")
        return kind, data[place + 4 : place + 4 + size], place + 8
    if place + 8 + size > len(data):
        raise ValueError("it ends within an element")
    end = place + 8 + size
    # Elements begin at multiples of 8; compressed ones do not.
    return kind, data[place + 8 : end], end if kind == _COMPRESSED else min(len(data), end + -size % 8)


def _matrix(body: bytes, order: str, depth: int) -> tuple[str, Any]:
    """Name and value of one matrix element."""
    # A file can claim any depth, and each level costs stack.
    if depth > _DEEPEST:
        raise ValueError("its cells and structs are nested too deeply")
    _, flags, place = _element(body, 0, order)
    _, sizes, place = _element(body, place, order)
    _, name, place = _element(body, place, order)
    if len(flags) < 4 or len(sizes) % 4:
        raise ValueError("the head of a variable is damaged")
    kind = struct.unpack_from(order + "I", flags)[0] & 0xFF
    shape = struct.unpack(f"{order}{len(sizes) // 4}i", sizes)
    count = 1
    for length in shape:
        # A negative size would make a count that looks small.
        if length < 0:
            raise ValueError("an array has a negative size")
        count *= length
    label = name.decode("latin-1")
    if kind == _CELL:
        return label, _cells(body, place, order, count, depth)[0]
    if kind == _STRUCT:
        return label, _structs(body, place, order, count, depth)
    if kind == _CHAR:
        return label, _text(*_element(body, place, order)[:2], order) if count else ""
    if kind in _NUMERIC:
        return label, _numbers(body, place, order, shape, count)
    return label, None


def _cells(body: bytes, place: int, order: str, count: int, depth: int) -> tuple[list[Any], int]:
    # Every cell takes eight bytes at least: more are a false claim.
    if count > (len(body) - place) // 8:
        raise ValueError("a cell array or struct claims more than it holds")
    values = []
    for _ in range(count):
        kind, content, place = _element(body, place, order)
        if kind != _MATRIX:
            raise ValueError("a cell holds no matrix")
        values.append(_matrix(content, order, depth + 1)[1] if content else np.empty((0, 0)))
    return values, place


def _structs(body: bytes, place: int, order: str, count: int, depth: int) -> Any:
    """A dictionary for one struct, a list of dictionaries for several."""
    _, length, place = _element(body, place, order)
    _, names, place = _element(body, place, order)
    width = struct.unpack_from(order + "i", length)[0] if len(length) >= 4 else 0
    if width <= 0 and names:
        raise ValueError("the field names of a struct are damaged")
    fields = [names[i : i + width].split(b"\x00")[0].decode("latin-1") for i in range(0, len(names), width)] if names else []
    values, _ = _cells(body, place, order, count * len(fields), depth)
    # Structs of several elements hold their fields element by element.
    each = [dict(zip(fields, values[i * len(fields) : (i + 1) * len(fields)], strict=True)) for i in range(count if fields else 0)]
    return each[0] if count == 1 and each else each


def _text(kind: int, content: bytes, order: str) -> str:
    wide = {_UTF16: "utf-16", 4: "utf-16", 3: "utf-16", _UTF32: "utf-32"}.get(kind)
    encoding = "utf-8" if wide is None else f"{wide}-{'le' if order == '<' else 'be'}"
    return content.decode(encoding, errors="replace")


def _numbers(body: bytes, place: int, order: str, shape: tuple[int, ...], count: int) -> NDArray[Any]:
    kind, content, _ = _element(body, place, order)
    if kind not in _NUMBERS:
        raise ValueError("an array is of no known type")
    values = np.frombuffer(content, dtype=order + _NUMBERS[kind], count=len(content) // int(_NUMBERS[kind][1]))
    # Too few numbers would be read from what follows.
    if len(values) != count:
        raise ValueError("an array has another length than it says")
    # Whole bytes keep their type: they are flags, such as the kind of a sample.
    return values.astype(np.uint8 if kind == 2 else np.float64).reshape(shape, order="F")
