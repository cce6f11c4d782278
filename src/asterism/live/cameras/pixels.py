"""Pixels as a camera sends them in; 8 bit images, grey or BGR, out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.detection.grey import saturated_from


def eight_bits(image: NDArray[Any], bits: int | None = None) -> NDArray[np.uint8]:
    """An image of 8 to 16 bits as one of 8: the lower bits are left out.

    bits: of the camera; None where it is not known: all 16, or as many as the brightest pixel fills
    """
    if image.dtype == np.uint8:
        return image
    used = int(saturated_from(image)).bit_length() if bits is None else bits
    return np.right_shift(image, used - 8).astype(np.uint8)
