"""Images of printed cloth are read: every identity given is right, and what makes an image unreadable is said."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest
import twins_garment_read as twins
from garment_scenes import coded, photos, sleeve

from asterism.errors import AsterismError
from asterism.garment import Pattern, Piece
from asterism.garment.read import ReadCircles, ReadRules, read_image
from asterism.garment.read import _circle_kernels as circle_kernels
from asterism.garment.read import _colour_kernels as colour_kernels
from asterism.garment.read import _identity_kernels as identity_kernels
from asterism.garment.read import _lattice_kernels as lattice_kernels
from asterism.garment.read.findings import chance_share
from asterism.garment.read.identify import identify
from asterism.simulation.garment import Photo
from benchmarks.garment.warps import warped


def judged(read: ReadCircles, photo: Photo, diameter: float = 6.0) -> tuple[int, int, float]:
    """Identities given, wrong ones, and the share of the readable circles that was given rightly."""
    truth = photo.truth
    place = {int(number): k for k, number in enumerate(truth.ids) if number >= 0}
    given = np.flatnonzero(read.ids >= 0)
    rows = np.array([place[int(number)] for number in read.ids[given]], dtype=int)
    right = np.linalg.norm(truth.centres[rows] - read.centres[given], axis=1) < 0.5 * truth.diameters[rows, 0]
    wanted = truth.ids[truth.readable(diameter) & (truth.ids >= 0)]
    return len(given), int((~right).sum()), float(np.isin(wanted, read.ids[given][right]).mean())


@pytest.mark.parametrize("noise", [0.005, 0.1], ids=["clean", "20 dB"])
def test_a_sleeve_is_read(noise: float) -> None:
    for photo in photos(noise=noise):
        read = read_image(photo.image, sleeve().pattern)
        given, wrong, recall = judged(read, photo)
        assert given > 50 and wrong == 0
        assert recall > 0.75, recall
        assert read.existing >= 0.95 * read.windows and not read.findings


def test_identities_of_another_pattern_are_not_given() -> None:
    other = coded(np.ones((24, 24), dtype=bool), (Piece("sheet", 0, 0, 24, 24),), seed=5)
    for photo in photos():
        assert (read_image(photo.image, other).ids < 0).all()


@pytest.mark.parametrize("value", [0, 90, 255])
def test_an_empty_image_has_no_circles(value: int) -> None:
    read = read_image(np.full((120, 160, 3), value, np.uint8), sleeve().pattern)
    assert len(read) == 0 and [f.code for f in read.findings][-1] == "garment-no-circles"


def test_a_black_and_white_image_has_no_identities() -> None:
    image = cv2.cvtColor(cv2.cvtColor(photos()[0].image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    read = read_image(image, sleeve().pattern)
    assert (read.ids < 0).all() and read.findings[0].code == "garment-no-colours"


def test_what_is_no_colour_image_is_refused() -> None:
    with pytest.raises(AsterismError, match="cannot be read"):
        read_image(np.zeros((20, 20), np.uint8), sleeve().pattern)


@cache
def sheet() -> Pattern:
    return coded(np.ones((16, 20), dtype=bool), (Piece("sheet", 0, 0, 16, 20),), seed=2)


@pytest.mark.parametrize(("tilt", "noise", "jpeg"), [(0, 0.01, 0), (30, 0.03, 90), (50, 0.01, 80), (20, 0.1, 0)])
def test_a_print_through_other_hands_is_read(tilt: float, noise: float, jpeg: int) -> None:
    """Drawn and warped by OpenCV, with a cast, gamma, motion blur and JPEG: our renderer has no part in it."""
    for seed in range(3):
        warp = warped(sheet(), (480, 360), tilt, noise, jpeg, rng=np.random.default_rng([9, seed]))
        read = read_image(warp.image, sheet())
        given = np.flatnonzero(read.grid[:, 0] >= 0)
        cell = tuple(read.grid[given].T)
        off = np.linalg.norm(warp.centres[cell] - read.centres[given], axis=1)
        assert off.max() < 2.0 and np.sqrt(np.mean(off**2)) < 0.35
        np.testing.assert_array_equal(read.ids[given], sheet().ids[cell])
        assert len(given) > 0.85 * warp.readable().sum()


def test_a_mirrored_image_is_not_read() -> None:
    warp = warped(sheet(), (480, 360), 10.0, 0.01, 0, rng=np.random.default_rng(1))
    assert (read_image(warp.image, sheet()).ids >= 0).sum() > 100
    mirrored = read_image(np.ascontiguousarray(warp.image[:, ::-1]), sheet())
    assert (mirrored.ids < 0).all() and mirrored.findings[0].code == "garment-other-pattern"


def test_two_sheets_of_one_print_are_told() -> None:
    warp = warped(sheet(), (480, 360), 10.0, 0.01, 0, rng=np.random.default_rng(1))
    read = read_image(np.concatenate([warp.image, warp.image], axis=1), sheet())
    assert (read.ids < 0).all() and "garment-twice" in [f.code for f in read.findings]


def test_misread_colours_are_corrected_and_never_make_a_wrong_identity() -> None:
    """Colours of single circles are changed: all keep their place on the sheet."""
    rows, cols = sheet().shape
    links, centres = grid_links(rows, cols)
    rng = np.random.default_rng(0)
    corrected = 0
    for _ in range(100):
        colours = sheet().colours.ravel().astype(int)
        changed = rng.choice(rows * cols, 4, replace=False)
        colours[changed] = (colours[changed] + rng.integers(1, 4, 4)) % 4
        found = identify(centres, links, np.eye(4)[colours], sheet(), ReadRules())
        given = found.ids >= 0
        np.testing.assert_array_equal(found.ids[given], sheet().ids.ravel()[given])
        corrected += int(given[changed].sum())
        assert given.mean() > 0.7
    assert corrected > 200, corrected


def test_chance_is_not_believed() -> None:
    """Random colours: no identity, and the share of blocks in the pattern is that of chance."""
    rng = np.random.default_rng(3)
    links, centres = grid_links(30, 30)
    windows = existing = 0
    for _ in range(20):
        found = identify(centres, links, np.eye(4)[rng.integers(0, 4, 900)], sheet(), ReadRules())
        assert (found.ids < 0).all()
        windows, existing = windows + found.windows, existing + found.existing
    assert abs(existing / windows - chance_share(sheet())) < 0.004


def grid_links(rows: int, cols: int) -> tuple[np.ndarray, np.ndarray]:
    """Links of a whole grid, each circle's directions turned by any quarter, and centres 10 px apart."""
    turn = np.random.default_rng(8).integers(0, 4, (rows, cols))
    links = np.full((rows, cols, 4, 2), -1, np.int32)
    for row, col in np.ndindex(rows, cols):
        for d, (down, right) in enumerate(((0, 1), (1, 0), (0, -1), (-1, 0))):
            r, c = row + down, col + right
            if 0 <= r < rows and 0 <= c < cols:
                links[row, col, (d + turn[row, col]) % 4] = r * cols + c, (d + 2 + turn[r, c]) % 4
    y, x = np.mgrid[0:rows, 0:cols]
    return links.reshape(-1, 4, 2), np.stack([x, y], axis=-1).reshape(-1, 2) * 10.0


def test_kernels_and_their_twins_agree() -> None:
    image = photos()[0].image[150:330, 200:420].copy()
    grey, highest = np.empty(image.shape[:2], np.uint8), np.empty((len(image), image.shape[1] // 16 + 1), np.uint8)
    circle_kernels.colourfulness(image, grey, highest)
    expected = twins.colourfulness(image)
    np.testing.assert_array_equal(grey, expected[0])
    np.testing.assert_array_equal(highest, expected[1])
    limits = np.array([4.0, 6000.0, 0.8, 12.0, 120.0, 0.0])
    labels, regions = np.zeros(grey.shape, np.int32), np.empty((5000, 7), np.int32)
    count = circle_kernels.find_regions(grey, highest, 60, limits, labels, np.empty((grey.size, 3), np.int32), regions)
    whole = {tuple(r[:5].tolist()) for r in regions[:count] if r[5] == 60}
    assert whole == twins.first_regions(grey, 60, limits) and len(whole) > 20
    rng = np.random.default_rng(2)
    centres = rng.uniform(0, 200, (300, 2))
    shape = rng.normal(size=(300, 2, 2)) * 0.02 + 0.06 * np.eye(2)
    found, offsets = np.empty((300, 12), np.int32), np.zeros((300, 12, 2))
    lattice_kernels.candidates(centres, shape, 1.9, 17.0, found, offsets)
    np.testing.assert_array_equal(found, twins.candidates(centres, shape, 1.9, 12))
    links = grid_links(6, 7)[0]
    links[rng.integers(0, 42, 10), rng.integers(0, 4, 10)] = -1
    ring = np.empty((42, 8), np.int32)
    identity_kernels.rings(links, ring)
    np.testing.assert_array_equal(ring, twins.rings(links))
    points, spreads = rng.uniform(0, 1, (50, 2)), np.tile([[0.02, 0.005], [0.005, 0.01]], (4, 1, 1))
    out = np.empty((50, 4))
    colour_kernels.posteriors(points, points[:4].copy(), spreads, 1e-3, out)
    np.testing.assert_allclose(out, twins.posteriors(points, points[:4], spreads, 1e-3), rtol=1e-10)


def test_a_coloured_lamp_does_not_change_what_is_read() -> None:
    image = photos()[0].image
    plain = read_image(image, sleeve().pattern)
    tinted = read_image((image * np.array([0.45, 0.8, 1.0])).astype(np.uint8), sleeve().pattern)
    both = np.intersect1d(plain.ids[plain.ids >= 0], tinted.ids[tinted.ids >= 0])
    assert len(both) > 0.9 * (plain.ids >= 0).sum()
    at = [np.array([np.flatnonzero(r.ids == k)[0] for k in both]) for r in (plain, tinted)]
    assert np.abs(plain.centres[at[0]] - tinted.centres[at[1]]).max() < 0.5
    assert tinted.gains[2] > 1.5 * plain.gains[2]
