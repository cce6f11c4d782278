"""Grey images in; the thresholds that stand out from their noise, and the light that lies unevenly over them, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.detection._region_kernels import QUARTILE
from asterism.detection.grey import Grey, as_grey, background_of
from asterism.recording import Floats


@dataclass(frozen=True)
class ThresholdRules:
    """How thresholds are estimated.

    What they must give is in tests/test_detection.py and tests/test_detect_hostile.py: dim markers whole, markers before uneven light and
    on bodies that shine, noise that is cut off at black.


    min_noise      grey values of noise that every image is taken to have: compression leaves such where a camera has less
    peak_sigmas    standard deviations of the noise above the median that a blob's brightest pixel must have.
    blob_sigmas    the same for the other pixels of a blob, so that dim blobs are whole
    lit_share      share of bright pixels above which an image shows more than markers
    uneven_sigmas  the darker half of an image is uneven where it differs by more than this times the noise
    every          pixels from one that is looked at to the next, and rows
    block_px       side of the blocks whose light is estimated
    around_px      side of the square whose mean is the background where light has texture; odd
    """

    min_noise: float = 1.5
    peak_sigmas: float = 6.0
    blob_sigmas: float = 4.0
    lit_share: float = 0.03
    uneven_sigmas: float = 2.0
    every: int = 4
    block_px: int = 64
    around_px: int = 25


RULES = ThresholdRules()


@dataclass(frozen=True)
class Thresholds:
    """Grey values above the background, of one image.

    blob    what a blob's pixels exceed
    peak    what its brightest pixel exceeds
    noise   standard deviation of the dark
    uneven  whether the dark is uneven, or more stands out than markers would: see `estimate_background`
    """

    blob: float
    peak: float
    noise: float
    uneven: bool


def automatic_threshold(image: ArrayLike, background: ArrayLike | int | None = None) -> float:
    """Grey values above the background that stand out from an image's dark: six times its noise above the median.

    The noise is estimated from the pixels below the median, which markers do not touch, and from how pixels differ from those beside them.
    Every fourth pixel of every fourth row is looked at.
    """
    return estimate_thresholds(as_grey(image), background).peak


def estimate_thresholds(grey: Grey, background: ArrayLike | int | None = None) -> Thresholds:
    """The thresholds of an image, by every fourth pixel of every fourth row.

    A blob reaches down to four times the noise, so that dim ones are whole; that is lower only where there is more noise than compression
    leaves.
    """
    few, most = _sampled(grey), int(np.iinfo(grey.dtype).max)
    dark = few if background is None else few - _sampled(background_of(grey, background))
    lowest = int(dark.min())
    # Above a background the dark may be negative, and a histogram counts from nought.
    found = _from_histogram(np.bincount((dark - lowest).ravel()), _pixel_noise(grey, few))
    blob, peak = (float(min(max(value + lowest, 0), most - 1)) for value in (found.blob, found.peak))
    return Thresholds(blob, peak, found.noise, found.uneven or found.lit)


def estimate_background(images: Sequence[ArrayLike]) -> Grey | int | None:
    """How to take off light that lies unevenly over images of one camera: a background for `BlobSettings`; None where it is even.

    It is uneven where the darker half of the pixels differ by more than twice the noise of pixels side by side, or where more than 3 % are
    brighter than six times the noise. The light is the lower quartile of each 64 by 64 pixels of the median image, with straight lines
    between their centres, so that markers are no part of it. Where that leaves those 3 %, it is the mean of 25 by 25 pixels around each
    if the darker half was uneven, since the light has texture; else, as with a bright window, nothing is taken off.
    """
    import cv2

    first = as_grey(images[0])
    # In the images' own type, whose median takes half as long.
    every = slice(None, None, RULES.every)
    few = _sampled(first) if len(images) == 1 else np.median([as_grey(image)[every, every] for image in images], axis=0).astype(np.int64)
    noise = _pixel_noise(first, _sampled(first))
    before = _from_histogram(np.bincount(few.ravel()), noise)
    if not before.uneven and not before.lit:
        return None
    side = RULES.block_px // RULES.every
    tall, wide = (max(round(length / side), 1) for length in few.shape)
    # Stretched to whole blocks, so that those at the border are as large as the others.
    even = np.asarray(cv2.resize(few.astype(np.float32), (wide * side, tall * side), interpolation=cv2.INTER_NEAREST))
    # The lower quartile: markers cover less than a quarter of any block, and shadows more than nothing.
    blocks = np.quantile(even.reshape(tall, side, wide, side), 0.25, axis=(1, 3))
    smooth = _interpolation(first.shape[0], tall) @ blocks @ _interpolation(first.shape[1], wide).T
    light = np.clip(np.rint(smooth), 0, np.iinfo(first.dtype).max).astype(first.dtype)
    left = few - _sampled(light)
    after = _from_histogram(np.bincount((left - left.min()).ravel()), noise)
    # A background that does not lower the threshold only adds its own errors.
    if not after.lit and after.peak + left.min() < before.peak:
        return light
    return RULES.around_px if before.uneven else None


def _interpolation(length: int, blocks: int) -> Floats:
    """(length, blocks) the weight of each equal block's value at each pixel: straight lines between the centres, continued outside."""
    place = (np.arange(length) + 0.5) * blocks / length - 0.5
    low = np.clip(np.floor(place), 0, max(blocks - 2, 0)).astype(np.int64)
    shares = np.zeros((length, blocks))
    shares[np.arange(length), low] = 1.0
    if blocks > 1:
        shares[np.arange(length), low] -= place - low
        shares[np.arange(length), low + 1] = place - low
    return shares


def _sampled(grey: Grey) -> NDArray[np.int64]:
    return grey[:: RULES.every, :: RULES.every].astype(np.int64)


@dataclass(frozen=True)
class _Histogram:
    """Thresholds as in `Thresholds`, counted from 0; whether the darker half is uneven, and whether more stands out than markers would."""

    blob: int
    peak: int
    noise: float
    uneven: bool
    lit: bool


def _from_histogram(counts: NDArray[np.int64], noise: float) -> _Histogram:
    """Thresholds of grey values that are counted from 0; noise: of pixels side by side."""
    shares = np.cumsum(counts) / counts.sum()
    # Markers and lamps lie in the upper half; the lower one is the dark with its noise.
    quarter, middle = (int(np.searchsorted(shares, share, side="right")) for share in (0.25, 0.5))
    spread = (middle - quarter) / QUARTILE
    noise = max(noise, RULES.min_noise)
    most = max(spread, noise)
    peak = int(middle + RULES.peak_sigmas * most) + 1
    blob = int(middle + max(RULES.blob_sigmas * most, RULES.peak_sigmas * RULES.min_noise)) + 1
    lit = peak < len(counts) and bool(1.0 - shares[peak] > RULES.lit_share)
    return _Histogram(blob, peak, most, spread > RULES.uneven_sigmas * noise, lit)


def _pixel_noise(grey: Grey, few: NDArray[np.int64]) -> float:
    """The standard deviation of the noise, by how pixels differ from those to their right: nine of ten by less than 2.33 times that.

    Where a quarter of the pixels is black, the noise below is cut off, and they differ by that much less.
    """
    beside = grey[:: RULES.every, 1 :: RULES.every]
    # Neighbours share the light and differ by noise alone, whatever the scene; edges are the tenth that is left out.
    steps = np.bincount(np.abs(few[:, : beside.shape[1]] - beside).ravel(), minlength=1)
    cut = 1.6 if np.count_nonzero(few) < 0.75 * few.size else 1.0
    return cut * float(np.searchsorted(np.cumsum(steps), 0.9 * steps.sum())) / 2.33
