"""Pixels as a camera sends them in; grey images of 8 bits, as markers are sought in, out."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError


def eight_bits(image: NDArray[Any], bits: int) -> NDArray[np.uint8]:
    """An image of 8 to 16 bits as one of 8: the lower ones are left out."""
    if image.dtype == np.uint8:
        return image
    return np.minimum(np.right_shift(image, max(0, bits - 8)), 255).astype(np.uint8)


class DepthByImages:
    """Makes images of 8 bits of those that have 16 and use fewer, as many as the brightest pixel of all so far needs.

    Cameras have 10, 12, 14 or 16 bits. One that shows nothing bright at first is taken for one of fewer, until it does.
    """

    def __init__(self) -> None:
        self._bits = 10

    def eight_bits(self, image: NDArray[Any]) -> NDArray[np.uint8]:
        """The next image, of uint8 or uint16."""
        while image.dtype != np.uint8 and self._bits < 16 and int(image.max()) >> self._bits:
            self._bits += 2
        return eight_bits(image, self._bits)


def grey_of(pixel_format: str, pixels: NDArray[Any]) -> NDArray[np.uint8]:
    """The grey image of pixels as GenICam's naming convention calls their format: Mono, Bayer, RGB, BGR and YUV 4:2:2.

    pixels: (height, width x values of a pixel) uint8 or uint16, unpacked
    Raises AsterismError for other formats, and names one to choose.
    """
    import cv2

    if match := re.fullmatch(r"Mono(8|10|12|14|16)(p|Packed|c3a\w*)?", pixel_format):
        return eight_bits(pixels, int(match[1]))
    if match := re.fullmatch(r"Bayer(RG|GR|GB|BG)(8|10|12|14|16)(p|Packed)?", pixel_format):
        mosaic = np.ascontiguousarray(eight_bits(pixels, int(match[2])))
        # OpenCV's newer names have the first two rows, as the convention's letters have the first.
        second = {"RG": "GB", "GR": "BG", "GB": "RG", "BG": "GR"}[match[1]]
        return np.asarray(cv2.cvtColor(mosaic, getattr(cv2, f"COLOR_Bayer{match[1]}{second}2GRAY")), dtype=np.uint8)
    if match := re.fullmatch(r"(RGB|BGR|RGBa|BGRa)(8|10|12|14|16)", pixel_format):
        colours = eight_bits(pixels, int(match[2])).reshape(len(pixels), -1, len(match[1]))
        return np.asarray(cv2.cvtColor(colours, getattr(cv2, f"COLOR_{match[1].upper()}2GRAY")), dtype=np.uint8)
    if re.fullmatch(r"(YUV422|YCbCr422|YCbCr601_422|YCbCr709_422)_8", pixel_format):
        return np.ascontiguousarray(pixels[:, 0::2], dtype=np.uint8)
    if re.fullmatch(r"(YUV422|YCbCr422|YCbCr601_422|YCbCr709_422)_8_(UYVY|CbYCrY)", pixel_format):
        return np.ascontiguousarray(pixels[:, 1::2], dtype=np.uint8)
    raise AsterismError(f"images of the format {pixel_format} cannot be read; choose another, as in format=Mono8.")
