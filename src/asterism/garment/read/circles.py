"""A colour image in; circles on dark cloth with their ellipses and colours out (GaMoCap 2.2)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from asterism.garment.read import _circle_kernels as kernels
from asterism.garment.read.rules import ReadRules
from asterism.recording import Floats

_LEVELS = 4
"""An image and three halves: for ways of up to 180 px, which is more than the largest circles are apart."""
_LEAST_CLOTH = 200
"""Pixels of dark cloth from which its noise can be told to a tenth."""
_LEFT, _LEFT_OF_MORE = 0.375, 0.28
"""What smoothing leaves of the noise: 3 x 3, and 5 x 5 pixels."""


@dataclass(frozen=True)
class Circles:
    """Circles that were found, and what is around them is not known yet.

    centres     (n, 2) px
    covariance  (n, 2, 2) px2 of the centres
    moments     (n, 2, 2) px2, second moments of the filled ellipse: a quarter of its squared semi-axes
    light       (n, 3) mean light within: red, green, blue, linear, 1 is the image's highest value
    grey        (h, w) uint8 colourfulness, smoothed
    noise       standard deviation of a pixel's value, of 255
    lowest      colourfulness below which nothing is taken for a circle
    """

    centres: Floats
    covariance: Floats
    moments: Floats
    light: Floats
    grey: NDArray[np.uint8]
    noise: float
    lowest: float

    @cached_property
    def levels(self) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """The colourfulness at full size and halved again and again, for ways of any length, as `grey_levels` gives it."""
        return grey_levels(self.grey)

    @cached_property
    def cloth_noise(self) -> Floats:
        """(levels,) standard deviation of the colourfulness of cloth without a circle, at each level; 0 where there is none to be seen."""
        flat, sizes = self.levels
        return np.array([_cloth_noise(flat[begin : begin + w * h].reshape(h, w), self.lowest) for begin, w, h in sizes.tolist()])

    def rises(self, share: float, least: float, of_noise: float) -> Floats:
        """(1 + levels,) of the colourfulness that are more than noise: a share of a circle's own, and at each level at least so much."""
        return np.concatenate([[share], np.maximum(least, of_noise * self.cloth_noise)])


def _cloth_noise(grey: NDArray[np.uint8], lowest: float) -> float:
    """From second differences of pixels two apart: between neighbours, noise that the camera's colour filter has spread would hide."""
    # Every fourth row is enough, and what is as colourful as a circle is left out.
    rows = grey[::4].astype(np.int16)
    left, middle, right = rows[:, :-4], rows[:, 2:-2], rows[:, 4:]
    dark = np.maximum(np.maximum(left, middle), right) <= lowest
    if dark.sum() < _LEAST_CLOTH:
        return 0.0
    # Mean of the absolute values: those of small whole numbers have a coarse median.
    return float(np.abs(left + right - 2 * middle)[dark].mean() * np.sqrt(np.pi / 12))


def grey_levels(grey: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """An image (h, w) and its halves, means of 2 x 2 pixels.

    Gives all their pixels (n,) row by row, and for each (levels, 3) where it begins, its width and height.
    """
    levels = [np.ascontiguousarray(grey)]
    while len(levels) < _LEVELS and min(levels[-1].shape) >= 8:
        height, width = (side // 2 for side in levels[-1].shape)
        levels.append(cv2.resize(levels[-1][: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA))
    begins = np.cumsum([0, *(level.size for level in levels[:-1])])
    sizes = np.array([(begin, level.shape[1], level.shape[0]) for begin, level in zip(begins, levels, strict=True)], np.int64)
    return np.concatenate([level.ravel() for level in levels]), sizes


def find_circles(image: NDArray[np.uint8], rules: ReadRules) -> Circles:
    """The circles of an image (h, w, 3) uint8, blue, green, red.

    The paper finds edges and their contours, which takes longer and loses circles that touch in the image. Here circles are regions of
    pixels whose largest and smallest channels differ: dark cloth, grey walls and white light have little of that. A threshold rises
    within a region until its parts have the shape of an ellipse. The centre is that of the pixels' coverage.
    """
    noise = image_noise(image)
    # Noise has colours, too: noisy images are smoothed more, and their threshold is raised by what smoothing leaves.
    noisy = noise > rules.noisy
    left = noise * (_LEFT_OF_MORE if noisy else _LEFT)
    height, width = image.shape[:2]
    grey = np.empty((height, width), np.uint8)
    seen = cv2.GaussianBlur(image, (5, 5), 1.0) if noisy else image
    kernels.colourfulness(seen.reshape(height, 3 * width), not noisy, grey)
    lowest = int(min(rules.least_colour + rules.noise_factor * left, 120))
    sizes = (
        rules.least_area,
        rules.largest_area,
        rules.least_fill,
        rules.least_height + rules.noise_height * left,
        rules.longest_side,
        rules.bound,
    )
    limits = np.array(sizes)
    regions = np.empty((rules.most_circles, 8), np.int32)
    count, held = kernels.find_regions(grey, lowest, limits, regions)
    measured = np.empty((count, 12))
    kernels.measure(image, _LINEAR, grey, held, regions[:count], noise, measured)
    covariance = _symmetric(measured[:, 2:5]) + rules.centre_floor**2 * np.eye(2)
    # Lens, pixels and smoothing widen an ellipse, and are taken off again.
    moments = _symmetric(measured[:, 5:8]) - rules.blur_moment * np.eye(2)
    return Circles(
        measured[:, :2].copy(), covariance, _at_least(moments, rules.least_moment), measured[:, :8:-1].copy(), grey, noise, lowest
    )


def image_noise(image: NDArray[np.uint8]) -> float:
    """Standard deviation of a pixel's green value, of 255: from the median of second differences along every eighth row."""
    if image.shape[1] < 3:
        return 0.5
    counts = np.empty(511, np.int64)
    kernels.count_bends(image, counts)
    # Second differences of Gaussian noise have sqrt(6) times its deviation; 0.6745 turns a median into a deviation.
    below = np.searchsorted(np.cumsum(counts), 0.5 * counts.sum()) + 0.5
    return float(max(below / (0.6745 * np.sqrt(6.0)), 0.5))


def _symmetric(three: Floats) -> Floats:
    return np.ascontiguousarray(three[:, [0, 1, 1, 2]]).reshape(-1, 2, 2)


def _at_least(moments: Floats, least: float) -> Floats:
    """Symmetric matrices (n, 2, 2) with their eigenvalues raised to a least one."""
    # The eigenvalues are raised and the axes kept, so that a thin ellipse stays one.
    values, angle = ellipse_axes(moments)
    cos, sin = np.cos(angle), np.sin(angle)
    long, short = np.maximum(values, least).T
    xy = (long - short) * cos * sin
    return np.stack([long * cos**2 + short * sin**2, xy, xy, long * sin**2 + short * cos**2], axis=1).reshape(-1, 2, 2)


def ellipse_axes(moments: Floats) -> tuple[Floats, Floats]:
    """The eigenvalues (n, 2) of symmetric matrices (n, 2, 2), larger first, and the angle (n,) of the larger one's vector."""
    half, turn = 0.5 * (moments[:, 0, 0] - moments[:, 1, 1]), moments[:, 0, 1]
    mean, apart = 0.5 * (moments[:, 0, 0] + moments[:, 1, 1]), np.hypot(half, turn)
    return np.stack([mean + apart, mean - apart], axis=1), 0.5 * np.arctan2(turn, half)


def linear_light(shown: Floats) -> Floats:
    """The light of values 0 to 1 by the curve of sRGB."""
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


_LINEAR = linear_light(np.arange(256) / 255.0)
