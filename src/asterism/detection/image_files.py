"""An image file in; its pixels in 8 bits out, or the name of a kind of file that is not read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.detection.claimed_sizes import check_claimed_chunks, check_claimed_size, claimed_size
from asterism.errors import AsterismError

_ENDS = 1 << 20
"""Bytes at either end of a file in which a film says how it is coded."""
_HEIC = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx"}
_DEPTHS = (8, 10, 12, 14, 16)
"""Bits of cameras' sensors."""


def read_eight_bits(path: Path, *, colour: bool) -> NDArray[np.uint8] | None:
    """An image, (h, w, 3) blue, green, red or (h, w) grey; None where it cannot be read. Images of 9 to 16 bits are scaled to 8.

    Raises AsterismError where the image claims more pixels than an image has, OSError where the file cannot be opened.
    """
    import cv2

    # Read as bytes first: OpenCV opens no path with letters beyond ASCII on Windows.
    content = np.fromfile(path, np.uint8)
    if not len(content):
        return None
    check_claimed_size(path, *claimed_size(content))
    check_claimed_chunks(path, content)
    image = cv2.imdecode(content, cv2.IMREAD_ANYDEPTH | (cv2.IMREAD_COLOR if colour else cv2.IMREAD_GRAYSCALE))
    return None if image is None else eight_bits(image)


def eight_bits(image: NDArray[Any]) -> NDArray[np.uint8] | None:
    """An image of 8 or 16 bits in 8; None of other values. The scale is that of the camera: 12 bits in a file of 16 fill 8.

    >>> eight_bits(np.array([[0, 4095]], np.uint16)).tolist(), eight_bits(np.array([[0, 65520]], np.uint16)).tolist()
    ([[0, 255]], [[0, 255]])
    """
    if image.dtype == np.uint8:
        return image
    if image.dtype != np.uint16:
        return None
    # Of the sensors that there are, the one with the fewest bits that hold the brightest pixel.
    bits = int(image.max(initial=0)).bit_length()
    shift = next(depth for depth in _DEPTHS if bits <= depth) - 8
    return (image >> np.uint16(shift)).astype(np.uint8)


def unread_kind(path: Path) -> str:
    """What a file is that is well and not read here, and what to make of it, as a phrase; "" where nothing is known of it."""
    try:
        with path.open("rb") as file:
            begin = file.read(_ENDS)
            file.seek(max(path.stat().st_size - _ENDS, 0))
            end = file.read()
    except OSError:
        return ""
    box = begin[: max(int.from_bytes(begin[:4], "big"), 16)] if begin[4:8] == b"ftyp" else b""
    # The first brand is at 8, the others from 16 on, four bytes each.
    if any(box[at : at + 4] in _HEIC for at in range(8, min(len(box), 128), 4)):
        return "is an HEIC photo, which is not read; export it as JPEG or PNG"
    if (box and (b"av01" in begin or b"av01" in end)) or b"V_AV1" in begin:
        return "is an AV1 video, which OpenCV cannot decode here; convert it to H.264 (ffmpeg -i in.mp4 -c:v libx264 -crf 10 out.mp4)"
    return ""


def refuse_unread(path: Path) -> None:
    """Raise AsterismError where a file is of a kind that is known and not read."""
    kind = unread_kind(path)
    if kind:
        raise AsterismError(f"{path} {kind}.")
