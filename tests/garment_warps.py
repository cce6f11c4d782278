"""A pattern in; pictures of its print that the renderer has no part in, made by OpenCV's drawing and warps, and their truth out."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from asterism.garment import Pattern
from asterism.recording import Floats

_CELL, _SUPER = 40, 8
"""Pixels of a cell of the drawn sheet; a circle is drawn in so many parts of a pixel (as powers of two: 3 bits)."""


@dataclass(frozen=True)
class Warp:
    """A picture (h, w, 3) uint8; of each cell of the sheet its centre and its circle's diameters, (rows, cols, 2) px each."""

    image: NDArray[np.uint8]
    centres: Floats
    diameters: Floats

    def readable(self, diameter: float = 6.0, steepest: float = 60.0) -> NDArray[np.bool_]:
        """Circles of at least so many px within so many degrees that are wholly in the image."""
        height, width = self.image.shape[:2]
        room = 0.5 * self.diameters[..., :1] + 2
        with np.errstate(invalid="ignore"):
            inside = ((self.centres > room) & (self.centres < np.array([width, height]) - 1 - room)).all(axis=-1)
            flat = self.diameters[..., 1] >= np.cos(np.radians(steepest)) * self.diameters[..., 0]
            return np.asarray(inside & flat & (self.diameters[..., 0] >= diameter))


def warped(pattern: Pattern, size: tuple[int, int], tilt: float, noise: float, jpeg: int, *, rng: np.random.Generator) -> Warp:
    """The flat print, bent by waves, turned, tilted by so many degrees, in coloured light that changes across the image, then a camera.

    noise  standard deviation of a pixel as a share of 255; jpeg 0 is none. Gamma, colour cast and motion blur are drawn from `rng`.
    """
    sheet = _drawn(pattern)
    to_sheet, from_sheet = _pose(sheet.shape[1::-1], size, tilt, rng)
    x, y = np.meshgrid(np.arange(size[0], dtype=np.float64), np.arange(size[1], dtype=np.float64))
    waves = [(rng.uniform(0.8, 2.0) * 2 * np.pi / size[0], rng.uniform(0, 6.3), rng.uniform(1.5, 3.0)) for _ in range(2)]

    def source(places: Floats) -> Floats:
        """Where in the sheet a place (..., 2) of the picture comes from."""
        bent = places + np.stack([waves[0][2] * np.sin(waves[0][0] * places[..., 1] + waves[0][1]),
                                  waves[1][2] * np.sin(waves[1][0] * places[..., 0] + waves[1][1])], axis=-1)  # fmt: skip
        one = np.concatenate([bent, np.ones((*bent.shape[:-1], 1))], axis=-1) @ to_sheet.T
        return np.asarray(one[..., :2] / one[..., 2:])

    whence = source(np.stack([x, y], axis=-1)).astype(np.float32)
    picture = cv2.remap(cv2.GaussianBlur(sheet, (0, 0), 1.5), whence[..., 0], whence[..., 1], cv2.INTER_LINEAR, borderValue=(40, 40, 40))
    picture = _camera(picture, x / size[0], noise, jpeg, rng)
    rows, cols = pattern.shape
    wanted = (np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1) + 1.0) * _CELL
    centres = cv2.perspectiveTransform(wanted.reshape(1, -1, 2), from_sheet).reshape(rows, cols, 2)
    for _ in range(8):
        jacobian = _jacobian(source, centres)
        centres = centres - np.linalg.solve(jacobian, (source(centres) - wanted)[..., None])[..., 0]
    spread = np.linalg.svd(np.linalg.inv(_jacobian(source, centres)), compute_uv=False)
    return Warp(picture, centres, spread * _CELL * pattern.diameter / pattern.pitch)


def _drawn(pattern: Pattern) -> NDArray[np.uint8]:
    """The print, black cloth with circles."""
    rows, cols = pattern.shape
    sheet = np.full(((rows + 1) * _CELL, (cols + 1) * _CELL, 3), 12, np.uint8)
    hsv = (pattern.hsv * (180, 235, 225) % (180.0001, 256, 256)).astype(np.uint8)
    inks = cv2.cvtColor(hsv[None], cv2.COLOR_HSV2BGR)[0]
    radius = round(0.5 * _CELL * pattern.diameter / pattern.pitch * _SUPER)
    for row, col in np.argwhere(pattern.colours >= 0):
        centre = (int((col + 1) * _CELL * _SUPER), int((row + 1) * _CELL * _SUPER))
        ink = tuple(int(v) for v in inks[pattern.colours[row, col]])
        cv2.circle(sheet, centre, radius, ink, -1, cv2.LINE_AA, 3)
    return sheet


def _pose(sheet: tuple[int, int], size: tuple[int, int], tilt: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Homographies of the picture to the sheet and back: tilted about an axis in its plane, filling most of the picture."""
    about, spin = rng.uniform(0, np.pi), rng.uniform(0, 2 * np.pi)
    turn = cv2.Rodrigues(np.radians(tilt) * np.array([np.cos(about), np.sin(about), 0.0]))[0] @ cv2.Rodrigues(np.array([0, 0, spin]))[0]
    far = 3.0
    scale = 0.95 * min(size) / max(sheet)
    middle = np.array([[1, 0, -0.5 * sheet[0]], [0, 1, -0.5 * sheet[1]], [0, 0, max(sheet)]], dtype=np.float64)
    plane = np.column_stack([turn[:, 0], turn[:, 1], [0, 0, far]])
    lens = np.array([[scale * far * max(sheet), 0, 0.5 * size[0]], [0, scale * far * max(sheet), 0.5 * size[1]], [0, 0, 1]])
    from_sheet = lens @ plane @ middle
    return np.linalg.inv(from_sheet), from_sheet


def _camera(picture: NDArray[np.uint8], across: Floats, noise: float, jpeg: int, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Cast, a change of light across the picture, gamma, motion blur, noise and JPEG."""
    cast, fall, gamma = rng.uniform(0.65, 1.0, 3), rng.uniform(0.5, 1.0), rng.uniform(0.8, 1.25)
    light = (picture / 255.0) ** gamma * cast * (1.0 - (1.0 - fall) * across[..., None])
    reach = int(rng.integers(0, 2))
    kernel = np.zeros((3, 3))
    kernel[1, 1 - reach : 2 + reach] = 1.0 / (1 + 2 * reach)
    shown = 255 * cv2.filter2D(light, -1, kernel) + 255 * noise * rng.standard_normal(light.shape)
    image = np.clip(np.rint(shown), 0, 255).astype(np.uint8)
    if jpeg:
        image = np.asarray(cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, jpeg])[1], cv2.IMREAD_COLOR), dtype=np.uint8)
    return image


def _jacobian(function, places: Floats) -> Floats:  # type: ignore[no-untyped-def]
    """Derivatives (..., 2, 2) of a map of the plane, by differences of a hundredth of a pixel."""
    steps = [(function(places + step) - function(places - step)) / 0.02 for step in (np.array([0.01, 0]), np.array([0, 0.01]))]
    return np.stack(steps, axis=-1)
