"""The light of circles in; which of a pattern's colours each has out. The tints of lamps and camera are learnt from the image."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.garment.read import _colour_kernels as kernels
from asterism.garment.read.circles import linear_light
from asterism.recording import Floats

_BALANCING, _FITTING = 12, 6
_LEAST_SPREAD = 0.02
"""Standard deviation of a share of light: clusters are never taken for narrower."""
_OUTLIERS = 1e-3
_CLOTH = 0.03
"""What an ink reflects of the light that it should not, as a share: ink on dark cloth is never pure."""


@dataclass(frozen=True)
class ColourClasses:
    """The colours of one image's circles.

    posterior  (n, q) probability of each colour
    gains      (3,) factors on red, green and blue that make the inks look as under white light; their product is 1
    spread     standard deviation of the circles' shares of light in their own class
    grey       whether the image has no colours to read
    """

    posterior: Floats
    gains: Floats
    spread: float
    grey: bool


def classify(light: Floats, reliable: NDArray[np.bool_], hsv: Floats, least_chroma: float = 0.1) -> ColourClasses:
    """Learn the colours of circles from their light (n, 3), red, green, blue, where `reliable` (n,), and give those of all.

    Lamps and the camera's white balance multiply the three channels. A pattern has its colours in about equal numbers, so the factors are
    known: after them, the mean share of each channel is that of the inks (hsv, (q, 3)). The inks then claim the nearest circles, and
    their places and spreads are fitted (a mixture of q normal distributions of the shares of red and blue).
    The paper takes fixed hues under constant neon light (GaMoCap 2.2).
    """
    q = len(hsv)
    shares = light / np.maximum(light.sum(axis=1, keepdims=True), 1e-9)
    # Circles on a lattice are of the garment; where they are too few, all circles have to do.
    chosen = reliable if reliable.sum() >= 4 * q else np.ones(len(light), dtype=bool)
    known = shares[chosen]
    # Fewer circles than four a colour show no clusters.
    if len(known) < 4 * q:
        return ColourClasses(np.full((len(light), q), 1.0 / q), np.ones(3), np.nan, False)
    red, green, blue = known.T
    # Shares of one hue mean a grey image, however bright it is.
    chroma = np.maximum(np.maximum(red, green), blue) - np.minimum(np.minimum(red, green), blue)
    if float(np.median(chroma)) < least_chroma or _is_one_line(known):
        return ColourClasses(np.full((len(light), q), 1.0 / q), np.ones(3), np.nan, True)
    # Ink on dark cloth reflects a little of everything.
    bright = _CLOTH + (1 - _CLOTH) * linear_light(np.array([colorsys.hsv_to_rgb(*colour) for colour in hsv]))
    inks = bright / bright.sum(axis=1, keepdims=True)
    gains = np.ones(3)
    # Lamps and white balance multiply the channels; colours in equal numbers tell by how much.
    kernels.balance(known, inks.mean(axis=0), _BALANCING, gains)
    balanced = shares * gains
    # Two of the three shares: the third is what is left of 1.
    balanced = (balanced / np.maximum(balanced.sum(axis=1, keepdims=True), 1e-9))[:, [0, 2]]
    posterior, spread = _mixture(balanced, chosen, inks[:, [0, 2]])
    return ColourClasses(posterior, gains, spread, False)


def _is_one_line(shares: Floats) -> bool:
    """Whether the shares differ in less than two ways: a toned black-and-white image."""
    spread = np.linalg.svd(np.cov(shares.T), compute_uv=False)
    return bool(spread[1] < 1e-3)


def _mixture(points: Floats, chosen: NDArray[np.bool_], centres: Floats) -> tuple[Floats, float]:
    """Posteriors (n, q) of points (n, 2) in q normal distributions fitted to the chosen ones, and their spread in the mean."""
    q, known = len(centres), points[chosen]
    centres, spreads = np.ascontiguousarray(centres), np.tile(0.1**2 * np.eye(2), (q, 1, 1))
    kernels.fit_mixture(known, _LEAST_SPREAD, _OUTLIERS, _FITTING, centres, spreads, np.empty((len(known), q)))
    posterior = np.empty((len(points), q))
    kernels.posteriors(np.ascontiguousarray(points), centres, spreads, _OUTLIERS, posterior)
    return posterior, float(np.sqrt(np.trace(spreads, axis1=1, axis2=2).mean() / 2))
