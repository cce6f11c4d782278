"""Blobs in; out come the grey images that would have shown them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.recording import Blobs
from asterism.simulation.cameras import _kernels


def render(
    blobs: Blobs,
    camera: int,
    size: tuple[int, int],
    *,
    rng: np.random.Generator,
    shape: str = "disc",
    bits: int = 8,
    peak: float = 0.85,
    background: float = 0.06,
    noise: float = 0.01,
    diameter: float = 6.0,
) -> Iterator[NDArray[np.uint8] | NDArray[np.uint16]]:
    """The images of one camera, frame by frame: (height, width) uint8, or uint16 where `bits` is more than 8.

    camera      its place in `blobs.cameras`; size: (width, height) px
    shape       "disc", with edges one pixel soft, or "gaussian", whose width at half of its height is the blob's size
    bits        8 to 16: the brightest grey value is 2^bits - 1
    peak, background, noise  shares of the brightest value: a blob's height over the background, the background, and the
                standard deviation of each pixel
    diameter    px, of blobs whose size is not known
    Raises AsterismError where an argument makes no sense.
    """
    if shape not in ("disc", "gaussian") or not 8 <= bits <= 16 or not 0 <= camera < len(blobs.cameras) or min(size) < 1:
        raise AsterismError("render takes disc or gaussian blobs, 8 to 16 bits, a camera of the blobs, and a positive image size.")
    full = 2**bits - 1
    cells = np.arange(len(blobs)) * len(blobs.cameras) + camera
    for cell in cells:
        own = slice(blobs.offsets[cell], blobs.offsets[cell + 1])
        wide = np.where(np.isfinite(blobs.sizes[own]), blobs.sizes[own], diameter)
        image = np.zeros((size[1], size[0]))
        _kernels.draw(blobs.xy[own], wide, shape == "gaussian", peak * full, image)
        image += background * full + noise * full * rng.standard_normal(image.shape, dtype=np.float32)
        grey = np.clip(np.rint(image), 0, full)
        yield grey.astype(np.uint8) if bits == 8 else grey.astype(np.uint16)
