"""Images and clouds made to break the kernels that read them: no kernel may write or read beyond its arrays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from asterism.detection import BlobSettings
from asterism.detection import _split_kernels as split_kernels
from asterism.detection.blobs import find_blobs
from asterism.errors import AsterismError
from asterism.garment.read import _growth_kernels as growth_kernels
from asterism.garment.read import _lattice_kernels as lattice_kernels
from asterism.garment.read import _patch_kernels as patch_kernels
from asterism.geometry.shared_kernels import clamped_index
from asterism.recording import Blobs, Clouds
from asterism.tracking import find_tracklets
from asterism.views._label_kernels import assign_best

pytestmark = pytest.mark.kernels
# In every check only what is read from images and clouds: each kernel more compiles anew there.


def images() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:90, :130]
    return {
        "one pixel": np.full((1, 1), 200, np.uint8),
        "one row": np.tile(np.array([200, 0], np.uint8), 150)[None],
        "one column": np.tile(np.array([200, 0], np.uint8), 150)[:, None],
        "chessboard": ((y + x) % 2 * 200).astype(np.uint8),
        "coarse chessboard": ((y // 3 + x // 3) % 2 * 200).astype(np.uint8),
        "columns": (x % 2 * 200).astype(np.uint8),
        "full": np.full((70, 90), 255, np.uint8),
        "noise": rng.integers(0, 256, (80, 100)).astype(np.uint8),
        "deep noise": rng.integers(0, 65536, (60, 70)).astype(np.uint16),
        "steps": (x % 2 * 30 + x % 4 // 3 * 60 + x % 8 // 7 * 90 + 40).astype(np.uint8),
        "odd width": np.tile(np.array([200, 0, 200], np.uint8), (5, 22))[:, :65],
    }


WAYS = [
    BlobSettings(threshold=0, min_size=0, max_size=1e3),
    BlobSettings(threshold=0, min_size=0, max_size=1e3, connectivity=4, split=1e-9),
    BlobSettings(threshold=0, min_size=0, max_size=1e3, step=1.0, min_peak=0),
    BlobSettings(threshold=10, min_size=0, max_size=4, nested_regions=True, contrast=1.0, weight_reference="background"),
]


@pytest.mark.parametrize("name", [pytest.param(name, marks=[] if "deep" in name else pytest.mark.bounds) for name in images()])
def test_blobs_of_unusual_images(name: str) -> None:
    image = images()[name]
    for way in WAYS:
        found = find_blobs(image, way)
        inside = (found.xy >= 0) & (found.xy <= np.array(image.shape[::-1]) - 1)
        assert inside.all() and len(found) <= image.size, "each blob has a pixel of its own"


@pytest.mark.bounds
@given(arrays(np.uint8, st.tuples(st.integers(1, 20), st.integers(1, 20)), elements=st.sampled_from([0, 1, 40, 41, 90, 255])))
@settings(max_examples=80)
def test_blobs_of_any_image(image: np.ndarray) -> None:
    for way in WAYS:
        assert len(find_blobs(image, way)) <= image.size


def test_a_least_peak_that_is_no_number_is_refused() -> None:
    with pytest.raises(AsterismError, match="least peak"):
        find_blobs(np.zeros((9, 9), np.uint8), BlobSettings(threshold=5, step=3.0, min_peak=np.nan))


@pytest.mark.parametrize("lowest", [-1.0, np.nan, np.inf])
def test_blobs_grow_from_no_pixel_without_weight(lowest: float) -> None:
    """More blobs than pixels of the component would be written beyond their arrays."""
    weight = np.zeros((12, 12), np.int64)
    weight[5, 5:8] = (3, 5, 3)
    ys, xs, label = np.empty(3, np.int64), np.empty(3, np.int64), np.full(weight.shape, -1)
    n, blobs = split_kernels.grow_from_peaks(weight, 1.0, lowest, ys, xs, label)
    assert (n, blobs) == ((3, 1) if lowest == -1.0 else (0, 0))


def clouds() -> dict[str, list[np.ndarray]]:
    rng = np.random.default_rng(1)
    same = np.tile([[0.1, 0.2, 1.0]], (150, 1))
    body = rng.uniform(-1, 1, (20, 3))
    return {
        "no frame": [],
        "empty frames": [np.empty((0, 3))] * 5,
        "one point": [np.zeros((1, 3))],
        "now and then": [body[: n % 7] for n in range(40)],
        "one place": [same[: 100 + n] for n in range(6)],
        "one place, then none": [same, np.empty((0, 3)), same, same[:1], same],
        "thousands, once": [body, rng.uniform(-1, 1, (1200, 3)), body, body],
        "on a line": [np.arange(60)[:, None] * [0.01, 0, 0] + 0.001 * n for n in range(8)],
        "huge": [1e150 * body, -1e150 * body, body, 1e-300 * body],
        "noise": [rng.uniform(-1, 1, (rng.integers(0, 30), 3)) for _ in range(30)],
    }


@pytest.mark.bounds
@pytest.mark.parametrize("name", clouds())
@pytest.mark.parametrize("numbered", [False, True])
@pytest.mark.filterwarnings("ignore:overflow encountered")
def test_tracklets_of_unusual_clouds(name: str, numbered: bool) -> None:
    frames = clouds()[name]
    rng = np.random.default_rng(2)
    numbers = [rng.permutation(3 * len(frame))[: len(frame)] - 1 for frame in frames] if numbered else None
    given_clouds = Clouds.from_points(frames, 100.0, tracks=numbers)
    tracklets = find_tracklets(given_clouds)
    assert len(tracklets.of_point) == sum(map(len, frames)) and (tracklets.of_point >= 0).all()
    frame = given_clouds.frame_of
    for tracklet in np.unique(tracklets.of_point)[:50]:
        at = frame[tracklets.of_point == tracklet]
        assert (np.diff(at) == 1).all(), "a tracklet has one point in each of its frames"


@pytest.mark.parametrize("offsets", [[], [0], [0, 3], [1, 4], [0, 5, 4], [0, 9], [0, -1, 4]])
def test_offsets_that_lie_are_refused(offsets: list[int]) -> None:
    """Kernels read the points of a frame where its offsets say, so these are checked once, where clouds and blobs are made."""
    clouds = Clouds.from_points([np.zeros((4, 3))], 100.0)
    with pytest.raises(AsterismError, match="do not rise from 0 to 4"):
        replace(clouds, offsets=np.array(offsets, np.int64))
    blobs = Blobs.from_rows(np.zeros(4, int), np.zeros(4, int), np.zeros((4, 2)), ["a"])
    with pytest.raises(AsterismError, match="do not rise from 0 to 4"):
        replace(blobs, offsets=np.array(offsets, np.int64))


@pytest.mark.parametrize(
    ("value", "index"),
    [(-np.inf, 0), (-3.7, 0), (0.9, 0), (1.0, 1), (6.99, 6), (7.0, 7), (9.3e18, 7), (1e300, 7), (np.inf, 7), (np.nan, 0)],
)
def test_a_place_becomes_an_index_that_is_there(value: float, index: int) -> None:
    """Converted before it is clamped, a number beyond 64 bits became the smallest integer, and read far before the array."""
    assert clamped_index(value, 0, 7) == index


@given(st.floats(allow_nan=True, allow_infinity=True), st.integers(-3, 3), st.integers(0, 100))
def test_any_number_becomes_an_index_within(value: float, low: int, more: int) -> None:
    index = clamped_index(value, low, low + more)
    assert low <= index <= low + more
    assert not low <= value <= low + more or index == int(value)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12, np.inf, np.nan])
def test_neighbours_of_unusual_circles(scale: float) -> None:
    """All in one place, too, and ellipses that reach across the whole image or nowhere."""
    rng = np.random.default_rng(3)
    for centres in (np.full((30, 2), 5.0), rng.uniform(0, 300, (30, 2)), np.empty((0, 2))):
        n = len(centres)
        found, offsets = np.full((n, 5), -1, np.int32), np.zeros((n, 5, 2))
        lattice_kernels.candidates(centres, np.tile(np.diag([scale, scale]), (n, 1, 1)), 1.9, 4.0, found, offsets)
        assert ((found >= -1) & (found < n)).all()


@pytest.mark.parametrize("reach", [0.0, 5.0, 1e30, np.inf, np.nan])
@pytest.mark.parametrize("middle", [-1e30, 0.0, 79.9, 1e30, np.nan])
def test_buckets_within_reach_are_there(middle: float, reach: float) -> None:
    first, last = growth_kernels.buckets_within.py_func(middle, reach, 8.0, 10)
    assert 0 <= first <= 10 and -1 <= last <= 9


@pytest.mark.parametrize("worth", [np.nan, np.inf, -np.inf, 1e308])
def test_assignments_end_where_gains_are_no_numbers(worth: float) -> None:
    """What a blob gains is a quotient: a search for a column must end also where nothing can be compared."""
    for gain in (np.full((4, 3), worth), np.array([[worth, 1.0], [1.0, worth], [2.0, 3.0]]), np.full((3, 1), worth), np.empty((2, 0))):
        chosen = np.empty(len(gain), np.int64)
        assign_best(gain, chosen)
        given_columns = chosen[chosen >= 0]
        assert len(set(given_columns.tolist())) == len(given_columns) and (given_columns < gain.shape[1]).all()


@pytest.mark.parametrize("least", [0, 1, 3])
def test_patches_of_hardly_any_circles(least: int) -> None:
    links = np.full((6, 4, 2), -1, np.int32)
    links[0, 0], links[1, 2] = (1, 2), (0, 0)
    read, colours = np.zeros(6, np.int64), np.zeros((3, 3), np.int8)
    cells, turns = np.full((6, 2), -1, np.int32), np.full(6, -1, np.int32)
    placed, taken = np.empty(6, np.int32), np.empty(6, np.int32)
    assert patch_kernels.place_patches(links, read, colours, least, 0, cells, turns, placed, taken) <= 6
