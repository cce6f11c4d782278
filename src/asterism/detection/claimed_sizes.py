"""The bytes of an image file in; the width and height that its header claims, before memory is asked for them, out."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError

MOST_PIXELS = 2**28
"""Of one image: 268 million, twice as many as the largest cameras have. Decoding takes up to five bytes for each."""

_NO_SIZE = (0.0, 0.0)
_HEAD = 1 << 16
_PNG = b"\x89PNG\r\n\x1a\n"
_SPARE = 1 << 20
"""Bytes by which a chunk of a PNG that was cut off may go beyond its end: decoding says what it finds of such a file."""


def check_claimed_size(file: Path, width: float, height: float) -> None:
    """Raise AsterismError where an image of so many px would have more pixels than any camera's."""
    if width * height > MOST_PIXELS:
        raise AsterismError(
            f"{file} claims to be {width:,.0f} x {height:,.0f} pixels, more than any camera's image; it is damaged, record it again."
        )


def check_claimed_chunks(file: Path, content: NDArray[np.uint8]) -> None:
    """Raise AsterismError where a chunk of a PNG claims far more bytes than the file has left; OpenCV would ask for memory for them all."""
    if content[:8].tobytes() != _PNG:
        return
    at = 8
    while at + 8 <= len(content):
        length = int.from_bytes(content[at : at + 4].tobytes(), "big")
        #
        if length > len(content) - at + _SPARE:
            raise AsterismError(
                f"{file} is damaged: a part of it claims {length:,} bytes, more than the file has; record or copy it again."
            )
        at += 12 + length


def claimed_size(content: NDArray[np.uint8], page: int = 0) -> tuple[float, float]:
    """Width and height in the header of a PNG, JPEG, BMP, PGM, WebP, JPEG 2000 or TIFF file; zeros where it is none of these or cut off.

    page  where the page of a TIFF is described; 0 for its first
    """
    head = content[:_HEAD].tobytes()
    try:
        if head[:8] == _PNG:
            return _pair(">II", head, 16)
        if head[:2] == b"BM":
            # A negative height says that rows run from the top.
            width, height = struct.unpack_from("<ii", head, 18)
            return float(abs(width)), float(abs(height))
        if head[:2] == b"\xff\xd8":
            return _of_jpeg(content)
        if head[:4] in (b"II*\0", b"MM\0*"):
            return _of_tiff(content, "<" if head[:2] == b"II" else ">", page)
        if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
            return _of_webp(head)
        if head[4:8] == b"jP  ":
            at = head.find(b"ihdr")
            return _pair(">II", head, at + 4)[::-1] if at > 0 else _NO_SIZE
        if head[:1] == b"P":
            found = re.match(rb"P[1-7]\s++(?:#[^\n]*+\n\s*+)*+(\d{1,12})\s++(\d{1,12})\s", head)
            return (float(found[1]), float(found[2])) if found else _NO_SIZE
    except struct.error:
        pass
    return _NO_SIZE


def _pair(kind: str, data: bytes, at: int) -> tuple[float, float]:
    first, second = struct.unpack_from(kind, data, at)
    return float(first), float(second)


def _of_jpeg(content: NDArray[np.uint8]) -> tuple[float, float]:
    """The largest of its frames: the markers one after the other up to the first scan."""
    at, size = 2, _NO_SIZE
    while at + 9 < len(content) and content[at] == 0xFF:
        marker, length = int(content[at + 1]), int(content[at + 2]) << 8 | int(content[at + 3])
        if marker == 0xFF:
            at += 1
            continue
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", content[at + 5 : at + 9].tobytes())
            size = max(size, (float(width), float(height)), key=lambda pair: pair[0] * pair[1])
        if marker == 0xDA:
            break
        at += 2 + length
    return size


def _of_tiff(content: NDArray[np.uint8], order: str, page: int) -> tuple[float, float]:
    """The tags 256 and 257 of a page."""
    at = page or struct.unpack_from(order + "I", content.data, 4)[0]
    count = struct.unpack_from(order + "H", content.data, at)[0]
    found = {}
    for entry in range(at + 2, at + 2 + 12 * count, 12):
        tag, kind = struct.unpack_from(order + "HH", content.data, entry)
        if tag in (256, 257):
            found[tag] = struct.unpack_from(order + ("H" if kind == 3 else "I"), content.data, entry + 8)[0]
    return float(found.get(256, 0)), float(found.get(257, 0))


def _of_webp(head: bytes) -> tuple[float, float]:
    if head[12:16] == b"VP8X":
        return 1.0 + int.from_bytes(head[24:27], "little"), 1.0 + int.from_bytes(head[27:30], "little")
    return _NO_SIZE  # the others have 14 bits for each side
