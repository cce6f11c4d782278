"""Images of thin lines, single pixels and one row or column: as many runs as pixels, which no estimate of the readers' memory may miss."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest
import twins_garment_read as twins
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from asterism.errors import AsterismError
from asterism.garment import Pattern, design_pattern
from asterism.garment.read import _circle_kernels as kernels
from asterism.garment.read import read_image

pytestmark = [pytest.mark.kernels, pytest.mark.bounds]

LOWEST, LIMITS = 18, np.array([4.0, 6000.0, 0.88, 12.0, 120.0, 0.45])


@cache
def pattern() -> Pattern:
    return design_pattern((12, 12))


def coloured(grey: np.ndarray) -> np.ndarray:
    """An image whose colourfulness is `grey` where that is not smoothed."""
    image = np.zeros((*grey.shape, 3), np.uint8)
    image[..., 2] = grey
    return image


def lines(degrees: float, height: int = 300, width: int = 200) -> np.ndarray:
    """Lines one pixel wide, 12 px apart, so faint that smoothing leaves them one pixel wide."""
    grey = np.zeros((height, width), np.uint8)
    along = 2.0 * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))]) * max(height, width)
    for k in range(-40, 41):
        middle = np.array([width, height]) / 2 + 12 * k * np.array([-along[1], along[0]]) / np.hypot(*along)
        cv2.line(grey, tuple(np.rint(middle - along).astype(int)), tuple(np.rint(middle + along).astype(int)), 66)
    return grey


def spiral(gap: int, size: int = 160) -> np.ndarray:
    """One line that winds inwards: one part with nearly as many runs as pixels in its columns."""
    grey = np.zeros((size, size), np.uint8)
    left, right, top, bottom = 2, size - 3, 2, size - 3
    while right - left > 2 * gap and bottom - top > 2 * gap:
        grey[top, left : right + 1] = grey[bottom, left + gap : right + 1] = 66
        grey[top : bottom + 1, right] = grey[top + gap : bottom + 1, left + gap] = 66
        left, right, top, bottom = left + gap, right - gap, top + gap, bottom - gap
    return grey


def comb(upright: bool, size: int = 160) -> np.ndarray:
    """A bar with a tooth at every other pixel: the bar hangs all of the teeth together."""
    grey = np.zeros((size, size), np.uint8)
    grey[2:-2, 2:-2:2] = 66
    grey[-4, 2:-2] = 66
    return grey if upright else np.ascontiguousarray(grey.T)


def chessboard(side: int, size: int = 128) -> np.ndarray:
    y, x = np.mgrid[:size, :size]
    return (((y // side + x // side) % 2) * 200).astype(np.uint8)


def pixels(share: float, size: int = 160) -> np.ndarray:
    """Single pixels at random places, of random heights."""
    rng = np.random.default_rng(int(100 * share))
    return np.where(rng.random((size, size)) < share, rng.integers(20, 256, (size, size)), 0).astype(np.uint8)


def steps_of_teeth(size: int = 120) -> np.ndarray:
    """Every other pixel of an area is higher, and of these every other one again: each threshold divides runs as often as it can."""
    grey = np.full((size, size), 30, np.uint8)
    for step, value in ((2, 80), (4, 140), (8, 200), (16, 250)):
        grey[:, ::step] = value
    return grey


SHAPES = {
    **{f"lines at {degrees} degrees": lines(degrees) for degrees in (0, 7, 30, 45, 60, 83, 90, 135)},
    "a tall line": np.pad(np.full((900, 1), 66, np.uint8), ((20, 40), (9, 10))),
    "a wide line": np.pad(np.full((1, 900), 66, np.uint8), ((9, 10), (20, 40))),
    **{f"a spiral of gap {gap}": spiral(gap) for gap in (2, 3, 7)},
    "an upright comb": comb(True),
    "a lying comb": comb(False),
    **{f"a chessboard of {side} px": chessboard(side) for side in (1, 2, 3, 8)},
    **{f"single pixels, {share:.0%}": pixels(share) for share in (0.01, 0.2, 0.5, 0.9)},
    "teeth within teeth": steps_of_teeth(),
    "full": np.full((90, 90), 255, np.uint8),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_images_of_thin_shapes_are_read(shape: str) -> None:
    """Also their parts one pixel smaller each way, so that shapes touch borders."""
    grey = SHAPES[shape]
    for image in (grey, grey[1:, 1:], grey[:-1, :-1], 255 - grey):
        read = read_image(coloured(image), pattern())
        assert (read.ids < 0).all(), "nothing here is a circle of the cloth"
        assert ((read.centres >= 0) & (read.centres <= np.array(image.shape[::-1]) - 1)).all()


@pytest.mark.parametrize(
    "shape", ["lines at 83 degrees", "a spiral of gap 3", "a chessboard of 3 px", "single pixels, 20%", "teeth within teeth"]
)
def test_regions_of_thin_shapes_equal_their_twin(shape: str) -> None:
    grey = np.ascontiguousarray(SHAPES[shape][:60, :60])
    assert regions_of(grey) == twins.regions(grey, LOWEST, LIMITS)


def regions_of(grey: np.ndarray) -> set[tuple[int, ...]]:
    """What `find_regions` finds in a colourfulness (h, w), whose outermost rows and columns are set to 0 as those of images are."""
    grey[0] = grey[-1] = grey[:, 0] = grey[:, -1] = 0
    regions = np.empty((4000, 8), np.int32)
    count, held = kernels.find_regions(grey, LOWEST, LIMITS, regions)
    assert len(held) == (regions[count - 1, 7] if count else 0)
    return {tuple(region[:6].tolist()) for region in regions[:count]}


@given(arrays(np.uint8, st.tuples(st.integers(1, 24), st.integers(1, 24)), elements=st.sampled_from([0, 30, 60, 120, 250])))
@settings(max_examples=100)
def test_regions_of_any_pixels_equal_their_twin(grey: np.ndarray) -> None:
    assert regions_of(grey) == twins.regions(grey, LOWEST, LIMITS)


PLACE = st.tuples(st.integers(0, 27), st.integers(0, 27))


@given(st.lists(st.tuples(PLACE, PLACE, st.sampled_from([40, 66, 130, 250])), min_size=1, max_size=6))
@settings(max_examples=150)
def test_regions_of_any_thin_lines_equal_their_twin(drawn: list) -> None:
    """Lines one pixel wide between any two pixels, which cross and join."""
    grey = np.zeros((28, 28), np.uint8)
    for begin, end, value in drawn:
        cv2.line(grey, begin, end, value)
    assert regions_of(grey) == twins.regions(grey, LOWEST, LIMITS)


@given(arrays(np.uint8, st.tuples(st.integers(8, 40), st.integers(8, 40), st.just(3)), elements=st.sampled_from([0, 20, 66, 130, 255])))
@settings(max_examples=60)
def test_any_image_is_read(image: np.ndarray) -> None:
    read = read_image(image, pattern())
    assert len(read.centres) == len(read.ids) <= image.shape[0] * image.shape[1] // 4, "a circle has four pixels at least"


@pytest.mark.parametrize("shape", [(1, 900), (900, 1), (7, 7), (0, 40), (40, 0)])
def test_what_is_smaller_than_a_circle_is_refused(shape: tuple[int, int]) -> None:
    with pytest.raises(AsterismError, match="at least 8 pixels a side"):
        read_image(coloured(np.full(shape, 66, np.uint8)), pattern())
