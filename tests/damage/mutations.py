"""The bytes of a whole file and a random generator in; the bytes of a damaged copy out."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable

import numpy as np

Generator = np.random.Generator
Mutation = Callable[[bytes, Generator], bytes]

_EXTREMES = (b"\x00\x00\x00\x00", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\x00\x00\x00\x80", b"\x00\x00\x80\x7f", b"\x00\x00\xc0\x7f")
_NUMBERS = (
    *("0", "-1", "1e308", "-1e308", "1e-320", "nan", "inf", "-inf", "1e400"),
    *(str(2**31), str(2**63), "9" * 400, "0x10", "1_0", "", ".", "1e"),
)
_VALUES = ('"text"', "[1, 2]", "[]", "{}", "{a = 1}", "true", "null", "2026-11-22", "'", '"', "[[[[", "!!binary x", "\u202etext", "=1+1")
_LONG = (
    *("9" * 20_000, " " * 20_000, '"' * 999, "[" * 50_000, "{" * 50_000),
    *("- " * 20_000, "(" * 5_000, "_" * 20_000, "1," * 20_000, "ab:" * 9_000),
)
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[\w.\-*]+")


def damaged(content: bytes, rng: Generator, packed: bool) -> bytes:
    """A damaged copy: one to three mutations; of a zip archive (`packed`) mostly within a member, whose checksum is right again."""
    text = b"\x00" not in content[:2000]
    for _ in range(int(rng.integers(1, 4))):
        if packed and rng.random() < 0.7:
            content = _in_member(content, rng)
        else:
            kinds = _OF_BYTES + (_OF_TEXT if text else ())
            content = kinds[int(rng.integers(len(kinds)))](content, rng)
    return content


def _place(content: bytes, rng: Generator) -> int:
    """A place in the file, more often near its beginning."""
    return int(len(content) * rng.random() ** (2 if rng.random() < 0.5 else 1))


def _flip(content: bytes, rng: Generator) -> bytes:
    changed = bytearray(content)
    for _ in range(int(rng.integers(1, 20))):
        if changed:
            changed[min(_place(content, rng), len(changed) - 1)] = int(rng.integers(256))
    return bytes(changed)


def _cut_off(content: bytes, rng: Generator) -> bytes:
    return content[: _place(content, rng)]


def _leave_out(content: bytes, rng: Generator) -> bytes:
    at = _place(content, rng)
    return content[:at] + content[at + int(rng.integers(1, 200)) :]


def _repeat(content: bytes, rng: Generator) -> bytes:
    at, length = _place(content, rng), int(rng.integers(1, 400))
    return content[:at] + content[at : at + length] * int(rng.integers(2, 5)) + content[at + length :]


def _insert(content: bytes, rng: Generator) -> bytes:
    at = _place(content, rng)
    return content[:at] + rng.bytes(int(rng.integers(1, 60))) + content[at:]


def _extreme(content: bytes, rng: Generator) -> bytes:
    at = _place(content, rng) // 2 * 2
    value = _EXTREMES[int(rng.integers(len(_EXTREMES)))][: int(rng.choice([1, 2, 4]))]
    return content[:at] + value + content[at + len(value) :]


def _exchange(content: bytes, rng: Generator) -> bytes:
    first, second = sorted((_place(content, rng), _place(content, rng)))
    length = min(int(rng.integers(1, 100)), second - first)
    a, b = content[first : first + length], content[second : second + length]
    return content[:first] + b + content[first + length : second] + a + content[second + length :]


def _number(content: bytes, rng: Generator) -> bytes:
    return _replaced(content, rng, _NUMBER, _NUMBERS)


def _value(content: bytes, rng: Generator) -> bytes:
    return _replaced(content, rng, _WORD, _VALUES)


def _long(content: bytes, rng: Generator) -> bytes:
    return _replaced(content, rng, _WORD, _LONG)


def _separators(content: bytes, rng: Generator) -> bytes:
    old, new = (bytes([int(code)]) for code in rng.choice(list(b',;\t \n"\x00=:'), 2))
    return content.replace(old, new, int(rng.integers(1, 50)))


def _line_again(content: bytes, rng: Generator) -> bytes:
    lines = content.split(b"\n")
    at, to = (int(rng.integers(len(lines))) for _ in range(2))
    lines.insert(to, lines[at])
    return b"\n".join(lines)


def _line_gone(content: bytes, rng: Generator) -> bytes:
    lines = content.split(b"\n")
    del lines[int(rng.integers(len(lines)))]
    return b"\n".join(lines)


_OF_BYTES: tuple[Mutation, ...] = (_flip, _cut_off, _leave_out, _repeat, _insert, _extreme, _exchange)
_OF_TEXT: tuple[Mutation, ...] = (_number, _number, _value, _value, _long, _separators, _line_again, _line_gone)


def _replaced(content: bytes, rng: Generator, pattern: re.Pattern[bytes], values: tuple[str, ...]) -> bytes:
    found = list(pattern.finditer(content, 0, 50_000))
    if not found:
        return content
    match = found[int(rng.integers(len(found)))]
    value = values[int(rng.integers(len(values)))].encode()
    return content[: match.start()] + value + content[match.end() :]


def _in_member(content: bytes, rng: Generator) -> bytes:
    """A zip archive in which one member is damaged, left out, exchanged with another or named anew; archives that are none stay."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # damaged before, by a mutation of its bytes
        return content
    if not members:
        return content
    names = list(members)
    chosen = names[int(rng.integers(len(names)))]
    action = rng.random()
    if action < 0.1:
        del members[chosen]
    elif action < 0.2:
        other = names[int(rng.integers(len(names)))]
        members[chosen], members[other] = members[other], members[chosen]
    elif action < 0.3:
        members[chosen] = _array_of(rng)
    else:
        kinds = (_flip, _extreme, _number, _value, _cut_off, _repeat)
        members[chosen] = kinds[int(rng.integers(len(kinds)))](members[chosen], rng)
    methods = [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA]
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", int(rng.choice(methods))) as out:
        for name, member in members.items():
            out.writestr(name, member)
    return packed.getvalue()


def _array_of(rng: Generator) -> bytes:
    """An array of a random type and shape, as a member."""
    shape = tuple(int(side) for side in rng.choice([0, 1, 2, 3, 15, 40], int(rng.integers(0, 4))))
    kind = str(rng.choice(["f8", "i8", "u1", "f4", "c16", "U3", "M8[s]", "?"]))
    values = rng.choice([0.0, 1.0, -1.0, np.nan, np.inf, 1e30], shape) if kind[0] == "f" else rng.integers(-3, 60, shape)
    out = io.BytesIO()
    np.save(out, np.asarray(values).astype(kind))
    return out.getvalue()
