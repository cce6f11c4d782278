"""A colour image and a pattern in; the circles of the printed cloth with their identities out (GaMoCap 2.2)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.garment.pattern import Pattern
from asterism.garment.read.circles import Circles, ellipse_axes, find_circles
from asterism.garment.read.colours import classify
from asterism.garment.read.findings import CHANGES, reading_findings
from asterism.garment.read.identify import identify
from asterism.garment.read.lattice import link_circles
from asterism.garment.read.rules import ReadRules
from asterism.recording import Floats

__all__ = ["ReadCircles", "ReadRules", "read_image"]

_LEAST_SIDE = 8
"""px a side that an image has at least: a circle needs 4, and one circle tells nothing."""


@dataclass(frozen=True)
class ReadCircles:
    """The circles of one image.

    centres     (n, 2) px, centres of the ellipses; the image of a circle's middle is a little off (`calibration.coded_target`)
    covariance  (n, 2, 2) px2 of the centres; larger where a circle's area is not that of its neighbours, as of one that is covered in part
    ids         (n,) int32 identities, -1 unknown
    confidence  (n,) probability that row and column are right; 0 where unknown. At most 0.99998: of 254,185 identities of rendered suits
                one was wrong, which shows no more than that (95 %). Real cloth has not been measured
    colours     (n,) int8 as read, of the pattern's colours; -1 where the image has no colours
    axes        (n, 3) longer and shorter semi-axis px, and the angle rad of the longer from x towards y
    grid        (n, 2) int32 row and column on the sheet, -1 where unknown; circles at a border of the cloth have them without an identity
    windows     3 x 3 blocks that were read whole, whether believed or not
    existing    of them, those that the pattern has
    gains       (3,) factors on red, green and blue that the image needed
    findings    what speaks against the image
    """

    centres: Floats
    covariance: Floats
    ids: NDArray[np.int32]
    confidence: Floats
    colours: NDArray[np.int8]
    axes: Floats
    grid: NDArray[np.int32]
    windows: int
    existing: int
    gains: Floats
    findings: tuple[Finding, ...] = ()

    def __len__(self) -> int:
        return len(self.centres)


def read_image(image: NDArray[np.uint8], pattern: Pattern, rules: ReadRules | None = None) -> ReadCircles:
    """Find the circles of an image (h, w, 3) uint8 blue, green, red, and say which circles of the pattern they are.

    Pixel (0, 0) has its middle at (0, 0). Circles come in the order of their regions from the upper left. The result depends on the image
    alone: no randomness, no state. Cost: O(pixels + circles); memory some 2 bytes a pixel, and some 50 for each run of coloured pixels in
    a row. Without a lattice it is read at half its size, too: circles may be larger than `rules.longest_side`. One of another pattern is
    read mirrored and with red and blue exchanged, too, to say so. What makes an image unreadable is in `findings`: no circles, no colours,
    another pattern. Raises AsterismError where the image is not (h, w, 3) uint8, or has fewer than 8 pixels a side.
    """
    rules = rules or ReadRules()
    image = np.asarray(image)
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        size = " x ".join(map(str, image.shape))
        raise AsterismError(f"an image of {size} {image.dtype} cannot be read; give (height, width, 3) uint8, as OpenCV loads it.")
    if min(image.shape[:2]) < _LEAST_SIDE:
        height, width = image.shape[:2]
        raise AsterismError(
            f"an image of {width} x {height} pixels shows no garment; give a photo of at least {_LEAST_SIDE} pixels a side."
        )
    read = _read(np.ascontiguousarray(image), pattern, rules)
    codes = [finding.code for finding in read.findings]
    if "garment-no-circles" in codes and min(image.shape[:2]) >= 2 * _LEAST_SIDE:
        height, width = (side // 2 for side in image.shape[:2])
        half = read_image(cv2.resize(image[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA), pattern, rules)
        if "garment-no-circles" not in [finding.code for finding in half.findings]:
            axes = half.axes * [2.0, 2.0, 1.0]
            return replace(half, centres=2.0 * half.centres + 0.5, covariance=4.0 * half.covariance, axes=axes)
    if "garment-other-pattern" in codes:
        for change, findings in CHANGES:
            changed = _read(np.ascontiguousarray(change(image)), pattern, rules)
            if not any(finding.severity is Severity.ERROR for finding in changed.findings) and (changed.ids >= 0).any():
                return replace(read, findings=(*(f for f in read.findings if f.code != "garment-other-pattern"), *findings))
    return read


def _read(image: NDArray[np.uint8], pattern: Pattern, rules: ReadRules) -> ReadCircles:
    """The circles of an image as it is."""
    circles = find_circles(image, rules)
    links, _ = link_circles(circles, pattern.diameter / pattern.pitch, rules)
    # Three links: a chance neighbour makes one or two.
    linked = (links[:, :, 0] >= 0).sum(axis=1) >= 3
    classes = classify(circles.light, linked, pattern.hsv)
    found = identify(circles, links, classes.posterior, pattern, rules)
    axes = _axes(circles)
    # A circle whose area is not that of its neighbours is covered in part, so its centre is off by a share of its size.
    off = rules.covered * axes[:, 0] * np.where(found.ids >= 0, found.apart, 0.0)
    colours = np.full(len(linked), -1) if classes.grey else classes.posterior.argmax(axis=1)
    return ReadCircles(
        circles.centres,
        circles.covariance + (off**2)[:, None, None] * np.eye(2),
        found.ids,
        found.confidence,
        colours.astype(np.int8),
        axes,
        found.grid,
        found.windows,
        found.existing,
        classes.gains,
        reading_findings(image, linked, classes.grey, found, pattern, rules.most_circles),
    )


def _axes(circles: Circles) -> Floats:
    """Semi-axes and angle (n, 3) of ellipses by their second moments."""
    values, angle = ellipse_axes(circles.moments)
    return np.column_stack([2 * np.sqrt(values), angle])
