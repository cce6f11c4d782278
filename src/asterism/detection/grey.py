"""Grey images: what counts as one, the end of its grey scale, and the background that is taken off it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.errors import AsterismError

Grey = NDArray[np.unsignedinteger[Any]]


def as_grey(image: ArrayLike) -> Grey:
    """The image as rows of uint8 or uint16. Raises AsterismError for anything else; colour images whose channels agree are grey."""
    grey = np.asarray(image)
    if grey.ndim == 3 and grey.shape[2] in (3, 4) and (grey[..., 0] == grey[..., 1]).all() and (grey[..., 0] == grey[..., 2]).all():
        grey = grey[..., 0]
    if grey.ndim != 2 or not grey.size:
        raise AsterismError(f"an image of shape {grey.shape} is not a grey image; give rows and columns of grey values.")
    if grey.dtype.kind != "u" or grey.dtype.itemsize > 2:
        raise AsterismError(f"an image of {grey.dtype} values; give 8 or 16 bit grey values without sign.")
    return np.require(grey, grey.dtype.newbyteorder("="), ["C", "W"])


def grey_of_colour(image: NDArray[Any]) -> Grey:
    """An image as OpenCV gives it, (H, W), (H, W, 1) or (H, W, 3) BGR, as grey values. Raises AsterismError as `as_grey` does."""
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    elif image.ndim == 3 and image.shape[2] == 3 and image.size and image.dtype in (np.uint8, np.uint16):
        import cv2

        image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return as_grey(image)


def saturated_from(grey: Grey) -> int:
    """The end of the grey scale: where the brightest pixel has all of 9 to 15 bits set, a camera of as many bits wrote the image."""
    most, brightest = int(np.iinfo(grey.dtype).max), int(grey.max())
    return brightest if 255 < brightest < most and brightest & (brightest + 1) == 0 else most


def background_of(grey: Grey, background: ArrayLike | int | None) -> Grey:
    """The dark behind an image, of its shape and type: see `BlobSettings`. Raises AsterismError where it does not fit the image."""
    if background is None:
        return np.zeros_like(grey)
    if isinstance(background, int | np.integer):
        if background < 3 or background % 2 == 0:
            raise AsterismError(f"a background of {background} pixels; give an odd number from 3 on.")
        import cv2

        # Rounded down: an integer exceeds the mean by more than a threshold if and only if it exceeds the mean so rounded by more.
        sums = np.asarray(cv2.boxFilter(grey, cv2.CV_64F, (int(background), int(background)), normalize=False))
        sums /= int(background) ** 2
        return sums.astype(grey.dtype)
    base = as_grey(background)
    if base.shape != grey.shape or base.dtype != grey.dtype:
        raise AsterismError(
            f"the background is {size_text(base)} {base.dtype}, the image {size_text(grey)} {grey.dtype}; give one of this camera."
        )
    return base


def levels_of(grey: Grey, threshold: float, background: ArrayLike | int | None) -> tuple[Grey, Grey]:
    """Per pixel the grey value that must be exceeded, and the background, both of the image's type.

    Raises AsterismError where the threshold is outside the grey scale or the background does not fit.
    """
    base = background_of(grey, background)
    most = int(np.iinfo(grey.dtype).max)
    if not 0 <= threshold < most:
        raise AsterismError(f"threshold {threshold} is outside the grey scale; give 0 to {most - 1} for images of {grey.dtype}.")
    if background is None:
        return np.full_like(grey, int(threshold)), base
    import cv2

    return np.asarray(cv2.add(base, np.full_like(base, int(threshold)))), base


def size_text(image: NDArray[Any]) -> str:
    """Width x height."""
    return f"{image.shape[1]} x {image.shape[0]}"
