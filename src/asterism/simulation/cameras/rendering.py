"""Blobs in; the grey images that would have shown them out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.recording import Blobs
from asterism.simulation.cameras import _kernels


@dataclass(frozen=True)
class RenderSettings:
    """What images of blobs look like.

    shape       "disc", with edges one pixel soft, or "gaussian", whose width at half of its height is the blob's size
    bits        8 to 16: the brightest grey value is 2^bits - 1
    peak, background, noise  shares of the brightest value: a blob's height over the background, the background, and the
                standard deviation of each pixel
    diameter    px, of blobs whose size is not known
    """

    shape: str = "disc"
    bits: int = 8
    peak: float = 0.85
    background: float = 0.06
    noise: float = 0.01
    diameter: float = 6.0


def render_images(
    blobs: Blobs, camera: int, size: tuple[int, int], settings: RenderSettings | None = None, *, rng: np.random.Generator
) -> Iterator[NDArray[np.uint8] | NDArray[np.uint16]]:
    """The images of one camera, frame by frame: (height, width) uint8, or uint16 where they have more than 8 bits.

    camera  its place in `blobs.cameras`; size: (width, height) px

    Raises AsterismError where an argument is out of range.
    """
    settings = RenderSettings() if settings is None else settings
    shape, bits = settings.shape, settings.bits
    if shape not in ("disc", "gaussian") or not 8 <= bits <= 16 or not 0 <= camera < len(blobs.cameras) or min(size) < 1:
        raise AsterismError("images are rendered of disc or gaussian blobs, in 8 to 16 bits, of a camera of the blobs, in a positive size.")
    full = 2**bits - 1
    cells = np.arange(len(blobs)) * len(blobs.cameras) + camera
    # One image at a time: a session of hours has no room in memory.
    for cell in cells:
        here = slice(blobs.offsets[cell], blobs.offsets[cell + 1])
        sizes = np.where(np.isfinite(blobs.sizes[here]), blobs.sizes[here], settings.diameter)
        image = np.zeros((size[1], size[0]))
        _kernels.draw(blobs.xy[here], sizes, shape == "gaussian", settings.peak * full, image)
        # Noise on every pixel, also where no light falls.
        image += settings.background * full + settings.noise * full * rng.standard_normal(image.shape, dtype=np.float32)
        grey = np.clip(np.rint(image), 0, full)
        yield grey.astype(np.uint8) if bits == 8 else grey.astype(np.uint16)
