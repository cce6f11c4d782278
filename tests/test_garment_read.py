"""Images of printed cloth are read: every identity given is right, and what makes an image unreadable is said."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from garment_scenes import coded, grid_links, photos, sleeve

from asterism.errors import AsterismError
from asterism.garment import Pattern, Piece, design_pattern
from asterism.garment.read import ReadCircles, ReadRules, read_image
from asterism.garment.read.circles import Circles
from asterism.garment.read.findings import chance_share
from asterism.garment.read.identify import identify
from asterism.simulation.garment import Photo
from tests.garment_warps import warped


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


def test_circles_left_out_are_said() -> None:
    image = photos()[0].image
    few, all_of_them = (read_image(image, sleeve().pattern, ReadRules(most_circles=most)) for most in (30, 20_000))
    assert len(few) == 30 < len(all_of_them)
    assert few.findings[0].code == "garment-many-circles" and not all_of_them.findings


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


def test_an_image_of_a_few_pixels_is_refused_as_too_small() -> None:
    with pytest.raises(AsterismError, match="an image of 2 x 1 pixels shows no garment"):
        read_image(np.zeros((1, 2, 3), np.uint8), sleeve().pattern)


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


def test_a_circle_that_is_covered_in_part_says_that_its_centre_is_uncertain() -> None:
    """A finger's width of black over the outer third of one circle."""
    warp = warped(sheet(), (480, 360), 0, 0.01, 0, rng=np.random.default_rng(7))
    row, column = 8, 10
    (x, y), wide = warp.centres[row, column], warp.diameters[row, column, 0]
    image = warp.image.copy()
    cv2.rectangle(image, (round(x + 0.15 * wide), round(y - wide)), (round(x + 0.6 * wide), round(y + wide)), (20, 20, 20), -1)
    before, after = (read_image(picture, sheet()) for picture in (warp.image, image))
    sigma = []
    for read in (before, after):
        [n] = np.flatnonzero((read.grid == (row, column)).all(axis=1))
        sigma.append(float(np.sqrt(np.trace(read.covariance[n]) / 2)))
    assert sigma[1] > 2 * sigma[0], sigma


def test_a_mirrored_image_and_exchanged_channels_are_named_and_not_read() -> None:
    warp = warped(sheet(), (480, 360), 10.0, 0.01, 0, rng=np.random.default_rng(1))
    assert (read_image(warp.image, sheet()).ids >= 0).sum() > 100
    for image, codes in (
        (warp.image[:, ::-1], ["garment-mirrored"]),
        (warp.image[::-1], ["garment-mirrored"]),
        (warp.image[..., ::-1], ["garment-channels-swapped"]),
        (warp.image[:, ::-1, ::-1], ["garment-mirrored", "garment-channels-swapped"]),
        (warp.image[..., [1, 2, 0]], ["garment-other-pattern"]),
    ):
        read = read_image(image, sheet())
        assert (read.ids < 0).all() and [finding.code for finding in read.findings] == codes


def test_two_sheets_of_one_print_are_told() -> None:
    warp = warped(sheet(), (480, 360), 10.0, 0.01, 0, rng=np.random.default_rng(1))
    read = read_image(np.concatenate([warp.image, warp.image], axis=1), sheet())
    assert (read.ids < 0).all() and "garment-twice" in [f.code for f in read.findings]


def plain_circles(centres: np.ndarray) -> Circles:
    """Circles of 4 px on dark cloth."""
    n, (width, height) = len(centres), (centres.max(axis=0) + 20).astype(int)
    nothing = np.zeros((height, width), np.uint8)
    return Circles(centres, np.tile(0.01 * np.eye(2), (n, 1, 1)), np.tile(np.eye(2), (n, 1, 1)), np.ones((n, 3)), nothing, 1.0, 18.0)


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
        found = identify(plain_circles(centres), links, np.eye(4)[colours], sheet(), ReadRules())
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
        found = identify(plain_circles(centres), links, np.eye(4)[rng.integers(0, 4, 900)], sheet(), ReadRules())
        assert (found.ids < 0).all()
        windows, existing = windows + found.windows, existing + found.existing
    assert abs(existing / windows - chance_share(sheet())) < 0.004


def test_a_coloured_lamp_does_not_change_what_is_read() -> None:
    image = photos()[0].image
    plain = read_image(image, sleeve().pattern)
    tinted = read_image((image * np.array([0.45, 0.8, 1.0])).astype(np.uint8), sleeve().pattern)
    both = np.intersect1d(plain.ids[plain.ids >= 0], tinted.ids[tinted.ids >= 0])
    assert len(both) > 0.85 * (plain.ids >= 0).sum(), "the lamp takes half of the blue light, and so some blue circles at the rims"
    at = [np.array([np.flatnonzero(r.ids == k)[0] for k in both]) for r in (plain, tinted)]
    assert np.abs(plain.centres[at[0]] - tinted.centres[at[1]]).max() < 0.5
    assert tinted.gains[2] > 1.5 * plain.gains[2]


def test_a_saturated_lamp_hides_circles_and_makes_none() -> None:
    """A lamp near the cloth drives one side to white: what is left there of colours gives no wrong identity, and the other side is read."""
    warp = warped(sheet(), (480, 360), 15.0, 0.01, 0, rng=np.random.default_rng(5))
    x, y = np.meshgrid(np.arange(480.0), np.arange(360.0))
    seen = 0
    for strength in (0.0, 300.0, 900.0, 2000.0):
        glare = strength * np.exp(-((x - 60) ** 2 + (y - 180) ** 2) / (2 * 110.0**2))
        read = read_image(np.clip(warp.image + glare[..., None], 0, 255).astype(np.uint8), sheet())
        given = np.flatnonzero(read.grid[:, 0] >= 0)
        off = np.linalg.norm(warp.centres[tuple(read.grid[given].T)] - read.centres[given], axis=1)
        assert off.max(initial=0) < 2.0, strength
        assert strength == 0 or 0 < len(given) < seen, "each circle that is lost was in the glare"
        seen = len(given)
        assert ("garment-overexposed" in [f.code for f in read.findings]) == (strength > 800)


def test_an_exposure_that_is_too_long_is_said() -> None:
    """Inks burn out to white one channel after the other: what is given is right, in the end nothing is, and the image says why."""
    warp = warped(sheet(), (480, 360), 15.0, 0.01, 0, rng=np.random.default_rng(5))
    counts = []
    for factor in (1.0, 2.0, 8.0, 60.0):
        read = read_image(np.clip(warp.image * factor, 0, 255).astype(np.uint8), sheet())
        given = np.flatnonzero(read.grid[:, 0] >= 0)
        off = np.linalg.norm(warp.centres[tuple(read.grid[given].T)] - read.centres[given], axis=1)
        assert off.max(initial=0) < 3.0
        counts.append(len(given))
    assert counts[0] > 250 and counts[-1] == 0 and read.findings[0].code == "garment-overexposed"


@pytest.mark.parametrize(("tilt", "least"), [(60.0, 800), (70.0, 400), (80.0, 0), (88.0, 0)])
def test_a_sheet_seen_from_its_edge_gives_no_wrong_identity(tilt: float, least: int) -> None:
    """Of three times 320 circles. At 80 degrees circles of 9 px are 1.5 px wide, and the image says that it shows none."""
    counts, wrong = 0, 0
    for seed in range(3):
        warp = warped(sheet(), (480, 360), tilt, 0.01, 0, rng=np.random.default_rng([7, seed]))
        read = read_image(warp.image, sheet())
        given = np.flatnonzero(read.grid[:, 0] >= 0)
        off = np.linalg.norm(warp.centres[tuple(read.grid[given].T)] - read.centres[given], axis=1)
        counts, wrong = counts + len(given), wrong + int((off > 2.5).sum())
    assert wrong == 0 and counts >= least
    assert (counts == 0) == bool(read.findings) and [f.code for f in read.findings] in ([], ["garment-no-circles"])


def test_no_confidence_is_above_what_was_measured() -> None:
    """A whole sheet without noise: circles inside have the doubt that the measured images leave (Poisson), those at its corners more."""
    links, centres = grid_links(*sheet().shape)
    colours = np.eye(4)[sheet().colours.ravel()]
    for shown, doubt in (((36_090, 2), 6.296 / 36_090), ((1000, 0), 2.996 / 1000)):
        found = identify(plain_circles(centres), links, colours, sheet(), ReadRules(validated_count=shown[0], validated_wrong=shown[1]))
        confidence = found.confidence.reshape(sheet().shape)
        assert 1 - confidence[8, 10] == pytest.approx(doubt, rel=0.05)
        assert confidence[8, 10] == confidence.max() and (confidence > 0).mean() > 0.9
        assert 0 < confidence[0, 1] < confidence[8, 10]


def test_a_patch_without_whole_blocks_is_placed() -> None:
    """Two columns of a sheet, as between a seam and the rim of an arm: no block of nine, but only one place has their colours."""
    rows, cols = sheet().shape
    links, centres = grid_links(rows, cols)
    strip = np.flatnonzero((np.arange(rows * cols) % cols) // 2 == 3)
    number = np.full(rows * cols + 1, -1)
    number[strip] = np.arange(len(strip))
    part = links[strip].copy()
    part[..., 0] = number[part[..., 0]]
    part[part[..., 0] < 0] = -1
    colours = np.eye(4)[sheet().colours.ravel()[strip]]
    found = identify(plain_circles(centres[strip]), part, colours, sheet(), ReadRules())
    assert found.windows == 0
    given = found.grid[:, 0] >= 0
    np.testing.assert_array_equal(found.grid[given] @ [cols, 1], strip[given])
    assert given.mean() > 0.7
    part[14:] = -1
    part[part[..., 0] >= 14] = -1
    few = identify(plain_circles(centres[strip]), part, colours, sheet(), ReadRules())
    assert (few.grid < 0).all(), "fourteen colours fit in several places"


def _part(cells: np.ndarray) -> tuple[Circles, np.ndarray, np.ndarray]:
    """Circles of some cells of the sheet, the links among them, and their colours."""
    links, centres = grid_links(*sheet().shape)
    number = np.full(len(centres) + 1, -1)
    number[cells] = np.arange(len(cells))
    part = links[cells].copy()
    part[..., 0] = number[part[..., 0]]
    part[part[..., 0] < 0] = -1
    return plain_circles(centres[cells]), part, np.eye(4)[sheet().colours.ravel()[cells]]


def test_a_small_patch_is_believed_where_the_garment_is_sure() -> None:
    """Sixteen colours alone are 15 nats for one map of 1,280: too few without a block, enough beside half of the sheet."""
    rows, cols = sheet().shape
    row, col = np.divmod(np.arange(rows * cols), cols)
    strip = (col // 2 == 8) & (row < 8)
    for body, given in ((False, 0), (True, 16)):
        cells = np.flatnonzero(strip | (body & (col < 10)))
        found = identify(*_part(cells), sheet(), ReadRules(odds=-50.0))
        there = found.grid[:, 0] >= 0
        np.testing.assert_array_equal(found.grid[there] @ [cols, 1], cells[there])
        assert there[strip[cells]].sum() == given


@pytest.mark.parametrize(("beside", "given"), [(1, 0), (2, 2)])
def test_a_circle_that_hangs_at_the_end_of_a_row_alone_has_no_identity(beside: int, given: int) -> None:
    """It has its own cell's colour, and lies where the row goes on; two such close a square."""
    row, col = np.divmod(np.arange(sheet().colours.size), sheet().shape[1])
    cells = np.flatnonzero(((col < 10) & (row > 0)) | ((col == 10) & (row >= 5) & (row < 5 + beside)))
    circles, links, colours = _part(cells)
    found = identify(circles, links, colours, sheet(), ReadRules(odds=-50.0))
    assert (found.grid[col[cells] == 10, 0] >= 0).sum() == given
    inside = (col[cells] > 0) & (col[cells] < 9) & (row[cells] > 1) & (row[cells] < 15)
    assert (found.grid[inside, 0] >= 0).all()


@pytest.mark.parametrize("place", [3, 23], ids=["at the border", "inside"])
def test_a_slanted_circle_has_no_identity_at_an_end(place: int) -> None:
    """Neighbours that are not at right angles by a circle's own ellipse: a blob of several, unless others hold it from all sides."""
    rows, cols = sheet().shape
    circles, links, colours = _part(np.arange(rows * cols))
    moments = circles.moments.copy()
    moments[place] = np.array([[1.0, 0.8], [0.8, 1.0]])
    found = identify(replace(circles, moments=moments), links, colours, sheet(), ReadRules(odds=-50.0))
    assert (found.grid[place, 0] >= 0) == (place == 23) and (found.grid[[2, 4, 22, 24], 0] >= 0).all()


INKS = np.array([(60, 60, 165), (60, 150, 160), (95, 125, 70), (125, 65, 75)], float)
"""Of a washed print: blue, green, red."""


def washed_print(diameter: float, noise: float, spread: float = 0.7, slanted: tuple[int, int] | None = None) -> np.ndarray:
    """A sheet of 9 x 11 circles of so many px, with noise that a colour filter has spread over neighbours; one may be an ellipse."""
    pattern, pitch = washed_pattern(), 1.8 * diameter
    image = np.full((int(11 * pitch), int(13 * pitch), 3), 38.0)
    for cell, colour in np.ndenumerate(pattern.colours):
        middle = tuple(round((place + 2) * pitch * 16) for place in cell[::-1])
        if cell == slanted:
            # of the same area, and turned against all others
            axes = (round(8 * diameter * 1.45), round(8 * diameter / 1.45))
            cv2.ellipse(image, middle, axes, 40.0, 0, 360, INKS[colour].tolist(), -1, cv2.LINE_AA, 4)
        else:
            cv2.circle(image, middle, round(8 * diameter), INKS[colour].tolist(), -1, cv2.LINE_AA, 4)
    grain = cv2.GaussianBlur(np.random.default_rng(0).standard_normal(image.shape), (0, 0), spread)
    return np.clip(cv2.GaussianBlur(image, (0, 0), 0.7) + grain * noise / grain.std(), 0, 255).astype(np.uint8)


@cache
def washed_pattern() -> Pattern:
    return design_pattern((9, 11), seed=2)


def right_and_wrong(read: ReadCircles, diameter: float) -> tuple[int, int]:
    """Identities that are where they were drawn, and others."""
    given = read.ids >= 0
    cells = np.rint(read.centres[given, ::-1] / (1.8 * diameter) - 2).astype(int)
    right = (washed_pattern().ids[tuple(cells.T)] == read.ids[given]) & (read.grid[given] == cells).all(axis=1)
    return int(right.sum()), int((~right).sum())


@pytest.mark.parametrize(("diameter", "noise"), [(10, 5), (14, 5), (20, 5), (30, 5), (40, 5), (20, 7), (95, 3)])
def test_circles_of_any_size_are_read_through_noise(diameter: float, noise: float) -> None:
    pattern = washed_pattern()
    read = read_image(washed_print(diameter, noise), pattern)
    right, wrong = right_and_wrong(read, diameter)
    # Noise of 8 of 255 hides single circles, and never gives a wrong identity.
    assert right >= (1.0 if noise <= 5 else 0.8) * len(pattern.known) and not wrong and not read.findings
    # Centres of the large ones, which are read at a quarter of the size, are where they were drawn, in px.
    off = read.centres / (1.8 * diameter) - 2
    off = (off - np.rint(off)) * 1.8 * diameter
    assert np.abs(np.median(off, axis=0)).max() < 0.2 and np.abs(off).max() < 1


def test_a_circle_whose_slant_contradicts_its_neighbours_has_no_identity() -> None:
    cell = (4, 5)
    for slanted, expected in ((None, True), (cell, False)):
        read = read_image(washed_print(16, 2, slanted=slanted), washed_pattern())
        assert (read.grid == cell).all(axis=1).any() == expected
        assert right_and_wrong(read, 16) == (len(washed_pattern().known) - (not expected), 0)
