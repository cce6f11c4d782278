"""The kernels of the reading equal their slow twins, on few circles and on none."""

from __future__ import annotations

import numpy as np
import pytest
import twins_garment_read as twins
from garment_scenes import grid_links, photos, sleeve

from asterism.garment.identities import ring_classes
from asterism.garment.read import _circle_kernels as circle_kernels
from asterism.garment.read import _colour_kernels as colour_kernels
from asterism.garment.read import _growth_kernels as growth_kernels
from asterism.garment.read import _identity_kernels as identity_kernels
from asterism.garment.read import _lattice_kernels as lattice_kernels
from asterism.garment.read import _patch_kernels as patch_kernels
from asterism.garment.read import _weight_kernels as weight_kernels
from asterism.garment.read.circles import grey_levels, linear_light

pytestmark = pytest.mark.kernels

LIMITS = np.array([4.0, 6000.0, 0.88, 12.0, 120.0, 0.45])
SIDE, SQUARE, FIT = np.array([0.6, 1.6]), 0.7, 0.34


def found_regions(image: np.ndarray, lowest: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Colourfulness, runs and regions of an image by the kernels."""
    grey = np.empty(image.shape[:2], np.uint8)
    for smooth in (True, False):
        circle_kernels.colourfulness(image.reshape(len(image), -1), smooth, grey)
        np.testing.assert_array_equal(grey, twins.colourfulness(image, smooth))
    regions = np.empty((5000, 8), np.int32)
    count, held = circle_kernels.find_regions(grey, lowest, LIMITS, regions)
    return grey, held, regions[:count]


@pytest.mark.parametrize(("noise", "lowest"), [(0.005, 20), (0.1, 45)])
def test_regions_and_what_is_measured_of_them(noise: float, lowest: int) -> None:
    image = photos(noise=noise)[0].image[170:290, 220:360].copy()
    grey, held, regions = found_regions(image, lowest)
    assert {tuple(r[:6].tolist()) for r in regions} == twins.regions(grey, lowest, LIMITS) and len(regions) > 20
    assert len(set(regions[:, 5].tolist())) > 3, "thresholds that had to rise"
    linear, measured = linear_light(np.arange(256) / 255.0), np.empty((len(regions), 12))
    circle_kernels.measure(image, linear, grey, held, regions, 255 * noise, measured)
    np.testing.assert_allclose(measured, twins.measure(image, linear, grey, held, regions, 255 * noise), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("width", [8, 47, 64])
def test_regions_in_noise(width: int) -> None:
    """Runs that end at borders of eight pixels and at none, parts that meet from two sides, and regions that many thresholds cut."""
    rng = np.random.default_rng(width)
    for smooth in (0, 1, 4):
        noise = rng.normal(size=(60, width, 3))
        for _ in range(smooth):
            noise = noise + np.roll(noise, 1, 0) + np.roll(noise, 1, 1) + np.roll(noise, (1, 1), (0, 1))
        image = np.clip(128 + 90 * noise / noise.std(), 0, 255).astype(np.uint8)
        grey, held, regions = found_regions(image, 10)
        assert {tuple(r[:6].tolist()) for r in regions} == twins.regions(grey, 10, LIMITS)
        assert len(held) == (regions[-1, 7] if len(regions) else 0)


def test_noise_is_counted() -> None:
    image = np.random.default_rng(0).integers(0, 256, (21, 40, 3)).astype(np.uint8)
    counts = np.empty(511, np.int64)
    circle_kernels.count_bends(image, counts)
    np.testing.assert_array_equal(counts, twins.count_bends(image))


def test_an_image_without_circles_has_no_regions() -> None:
    image = np.zeros((20, 30, 3), np.uint8)
    grey, held, regions = found_regions(image, 20)
    assert len(regions) == 0 == len(twins.regions(grey, 20, LIMITS))
    circle_kernels.measure(image, np.zeros(256), grey, held, regions, 1.0, np.empty((0, 12)))


def lattice(seed: int, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Circles on a bent lattice with gaps and strays: centres, whitening matrices, candidates and their offsets."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:9, 0:9]
    bent = np.stack([20 * x + 3 * y + 2 * np.sin(y), 17 * y - 2 * x], axis=-1).reshape(-1, 2) + rng.normal(0, 1.2, (81, 2)) + 20
    centres = np.concatenate([bent[rng.random(81) < 0.85], rng.uniform(20, 180, (12, 2))])[:n]
    whiten = np.tile(np.linalg.inv([[20.0, 3], [-2, 17]]), (len(centres), 1, 1)) + rng.normal(0, 0.003, (len(centres), 2, 2))
    found, offsets = np.empty((len(centres), 12), np.int32), np.zeros((len(centres), 12, 2))
    lattice_kernels.candidates(centres, whiten, 1.9, 17.0, found, offsets)
    return centres, whiten, found, offsets


@pytest.mark.parametrize(("seed", "n"), [(0, 99), (1, 99), (2, 99), (3, 1), (4, 2), (5, 0)])
def test_lattices(seed: int, n: int) -> None:
    centres, whiten, found, offsets = lattice(seed, n)
    np.testing.assert_array_equal(found, twins.candidates(centres, whiten, 1.9, 12))
    count = len(centres)
    frames, scores = np.empty((count, 2, 2)), np.empty(count)
    lattice_kernels.first_frames(found, offsets, whiten, SIDE, SQUARE, FIT, frames, scores)
    expected = twins.first_frames(found, offsets, whiten, SIDE, SQUARE, FIT)
    np.testing.assert_allclose(scores, expected[1], rtol=1e-9)
    np.testing.assert_allclose(frames, expected[0], rtol=1e-9, atol=1e-9)
    links = np.empty((count, 4, 2), np.int32)
    lattice_kernels.link(centres, found, frames, FIT, np.empty((count, 4), np.int32), links)
    np.testing.assert_array_equal(links, twins.link(centres, found, frames, FIT))
    refined = np.empty_like(frames)
    lattice_kernels.refine_frames(centres, found, links, frames, FIT, refined)
    np.testing.assert_allclose(refined, twins.refine_frames(centres, found, links, frames, FIT), rtol=1e-9, atol=1e-9)
    if n == 99:
        linked = links[:, :, 0] >= 0
        assert linked.sum() > 100 and (~linked.any(axis=1) & np.isfinite(refined[:, 0, 0])).any()
    ends, rise = np.array([0.65, 1.25]), np.array([0.08, 20.0, 16.0, 12.0, 12.0])
    y, x = np.mgrid[0:220, 0:240]
    grey = (120 + 60 * np.cos(x / 4.0 + seed) * np.cos(y / 5.0)).astype(np.uint8)
    checked = np.full((count, 4), -1, np.int32)
    for _ in range(2):  # the second time by what was kept
        cut = links.copy()
        lattice_kernels.cut_skipping(*grey_levels(grey), centres, whiten, ends, rise, checked, cut)
        np.testing.assert_array_equal(cut, twins.cut_skipping(grey, centres, whiten, ends, rise, links))
    if n == 99:
        assert 0 < (cut != links).any(axis=2).sum() < linked.sum()


@pytest.mark.parametrize("n", [300, 0])
def test_scattered_circles_have_the_nearest_candidates(n: int) -> None:
    rng = np.random.default_rng(2)
    centres, shape = rng.uniform(0, 200, (n, 2)), rng.normal(size=(n, 2, 2)) * 0.02 + 0.06 * np.eye(2)
    found, offsets = np.empty((n, 12), np.int32), np.zeros((n, 12, 2))
    lattice_kernels.candidates(centres, shape, 1.9, 17.0, found, offsets)
    np.testing.assert_array_equal(found, twins.candidates(centres, shape, 1.9, 12))


@pytest.mark.parametrize("seed", range(4))
def test_identities_are_carried_on(seed: int) -> None:
    """A grid with cut links and turned circles, of whose blocks some were read wrongly and some not at all."""
    rng = np.random.default_rng(seed)
    links, _ = grid_links(9, 11)
    n = len(links)
    for i, d in zip(rng.integers(0, n, 25), rng.integers(0, 4, 25), strict=True):
        j, back = links[i, d]
        links[i, d] = -1
        if j >= 0:
            links[j, back] = -1
    ring = np.empty((n, 8), np.int32)
    identity_kernels.rings(links, ring)
    np.testing.assert_array_equal(ring, twins.rings(links))
    colours = rng.integers(0, 4, (9, 11)).astype(np.int8)
    colours[rng.random((9, 11)) < 0.05] = -1
    cells = np.stack(np.mgrid[0:9, 0:11], axis=-1).reshape(-1, 2).astype(np.int32)
    turns = (-np.random.default_rng(8).integers(0, 4, (9, 11)).ravel() % 4).astype(np.int32)
    assert (twins.agreeing(links, cells, turns) == links[:, :, 0]).all(), "the truth agrees everywhere"
    wrong = rng.choice(n, 12, replace=False)
    cells[wrong[:6]], turns[wrong[6:]] = cells[wrong[:6]][::-1], (turns[wrong[6:]] + 1) % 4
    unread = (rng.random(n) < 0.3) | (colours[cells[:, 0], cells[:, 1]] < 0)
    cells[unread], turns[unread] = -1, -1
    agree_on_cells(links, colours, cells, turns, rng)


def agree_on_cells(links, colours, cells, turns, rng) -> None:
    """Every kernel that follows the look-up, and its twin, on the same circles."""
    n = len(links)
    roots = np.empty(n, np.int32)
    identity_kernels.groups(links, cells, turns, roots)
    np.testing.assert_array_equal(roots, twins.groups(links, cells, turns))
    likelihood = rng.normal(0.7, 1.0, (n, 4))
    order = rng.permutation(np.flatnonzero(turns >= 0)).astype(np.int32)
    expected = twins.spread(links, colours, likelihood, order, cells, turns)
    before = (turns >= 0).sum()
    identity_kernels.spread(links, colours, likelihood, order, cells, turns, np.empty(n, np.int32))
    np.testing.assert_array_equal(cells, expected[0])
    np.testing.assert_array_equal(turns, expected[1])
    if n:
        assert (turns >= 0).sum() > before


@pytest.mark.parametrize("seed", range(3))
def test_blocks_are_looked_up(seed: int) -> None:
    """A sheet of which circles are turned, links cut and some colours misread."""
    rng = np.random.default_rng(seed)
    pattern = sleeve().pattern
    rows, cols = pattern.shape
    links, _ = grid_links(rows, cols)
    off = pattern.colours.ravel() < 0
    links[off | (off[links[:, :, 0]] & (links[:, :, 0] >= 0)).any(axis=1)] = -1
    ring, read = np.empty((len(links), 8), np.int32), np.maximum(pattern.colours.ravel(), 0).astype(np.int64)
    misread = rng.integers(0, len(read), len(read) // 30)
    read[misread] = rng.integers(0, pattern.q, len(misread))
    identity_kernels.rings(links, ring)
    ring[::3] = np.roll(ring[::3], 1, axis=1)  # an odd shift: corners at the sides
    cells, turns = np.empty((len(read), 2), np.int32), np.empty(len(read), np.int32)
    counts = identity_kernels.look_up(ring, read, pattern.q, ring_classes(pattern.q), pattern.cell_of, pattern.colours, cells, turns)
    expected = twins.look_up(ring, read, pattern)
    np.testing.assert_array_equal(cells, expected[0])
    np.testing.assert_array_equal(turns, expected[1])
    assert counts == expected[2] and 100 < counts[1] < counts[0]
    assert len(set(turns.tolist())) == 5


def test_no_circles_no_identities() -> None:
    none = np.empty((0, 4, 2), np.int32)
    ring = np.empty((0, 8), np.int32)
    identity_kernels.rings(none, ring)
    assert len(twins.rings(none)) == 0
    cells, turns = np.empty((0, 2), np.int32), np.empty(0, np.int32)
    agree_on_cells(none, np.zeros((3, 3), np.int8), cells, turns, np.random.default_rng(0))


@pytest.mark.parametrize("n", [400, 5, 0])
def test_colours_of_a_mixture(n: int) -> None:
    rng = np.random.default_rng(5)
    places = np.array([[0.2, 0.2], [0.7, 0.1], [0.1, 0.7], [5.0, 5.0]])
    points = places[rng.integers(0, 3, n)] + rng.multivariate_normal([0, 0], [[0.004, 0.001], [0.001, 0.002]], n)
    spreads = np.tile([[0.02, 0.005], [0.005, 0.01]], (4, 1, 1))
    out = np.empty((n, 4))
    colour_kernels.posteriors(points, places, spreads, 1e-3, out)
    np.testing.assert_allclose(out, twins.posteriors(points, places, spreads, 1e-3), rtol=1e-10)
    fitted = places.copy(), spreads.copy()
    colour_kernels.fit_mixture(points, 0.02, 1e-3, 6, *fitted, np.empty((n, 4)))
    expected = twins.fit_mixture(points, 0.02, 1e-3, 6, places, spreads)
    for mine, twin in zip(fitted, expected, strict=True):
        np.testing.assert_allclose(mine, twin, rtol=1e-8)
    assert n != 400 or (np.abs(fitted[0] - places).max() > 1e-3 and (fitted[0][3] == places[3]).all())


def test_lamps_are_balanced() -> None:
    shares = np.random.default_rng(3).dirichlet([2.0, 1.0, 1.5], 200)
    wanted, gains = np.array([0.3, 0.4, 0.3]), np.ones(3)
    colour_kernels.balance(shares, wanted, 12, gains)
    np.testing.assert_allclose(gains, twins.balance(shares, wanted, 12), rtol=1e-10)
    seen = shares * gains
    np.testing.assert_allclose((seen / seen.sum(axis=1, keepdims=True)).mean(axis=0), wanted, atol=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_patches_are_placed_by_their_colours(seed: int) -> None:
    """Two columns and a stray part of a sheet, one colour of them misread, links cut at random."""
    rng = np.random.default_rng(seed)
    colours = rng.integers(0, 4, (14, 9)).astype(np.int8)
    colours[rng.random(colours.shape) < 0.03] = -1
    links, _ = grid_links(14, 9)
    n = len(links)
    read = np.maximum(colours.ravel(), 0).astype(np.int64)
    read[rng.integers(0, n, 3)] = rng.integers(0, 4, 3)
    cells, turns = np.full((n, 2), -1, np.int32), np.full(n, -1, np.int32)
    known = np.arange(n) % 9 > 3
    turns[known] = 0
    places = twins.gather(links, turns, 0, 14)
    members, place, taken = np.empty(14, np.int32), np.empty((14, 3), np.int32), np.full(n, -1, np.int32)
    count = patch_kernels.gather(links, turns, 0, members, place, taken)
    assert [tuple(p) for p in place[:count].tolist()] == list(places.values()) and members[:count].tolist() == list(places)
    found = np.empty(3, np.int32)
    best, second = patch_kernels.locate(members, place, count, read, colours, 2, found)
    expected = twins.locate(places, read, colours, 2)
    assert (min(best, 3), second) == (min(expected[0][0], 3), expected[1])
    placed, queue = np.empty(n, np.int32), np.empty(n, np.int32)
    expected = twins.place_patches(links, read, colours, 11, 2, cells, turns)
    count = patch_kernels.place_patches(links, read, colours, 11, 2, cells, turns, placed, queue)
    np.testing.assert_array_equal(cells, expected[0])
    np.testing.assert_array_equal(turns, expected[1])
    assert placed[:count].tolist() == expected[2] and count > 11
    there = cells[:, 0] >= 0
    np.testing.assert_array_equal(cells[there] @ [9, 1], np.flatnonzero(there))


@pytest.mark.parametrize("seed", range(3))
def test_cells_grow_and_are_weighed(seed: int) -> None:
    """A bent sheet with gaps and strays, whose middle is known and of which two circles have each other's cell."""
    rng = np.random.default_rng(seed)
    rows, cols = 9, 10
    y, x = np.mgrid[0:rows, 0:cols]
    bent = np.stack([30 + 14 * x + 2 * np.sin(y / 2), 30 + 13 * y - 2 * np.cos(x / 2)], axis=-1).reshape(-1, 2)
    centres = bent + rng.normal(0, 0.4, bent.shape)
    colours = rng.integers(0, 4, (rows, cols)).astype(np.int8)
    colours[rng.random(colours.shape) < 0.02] = -1
    centres = np.concatenate([centres[rng.random(len(centres)) < 0.93], rng.uniform(30, 140, (5, 2))])
    n = len(centres)
    cells = np.full((n, 2), -1, np.int32)
    for i in range(n):
        row, col = round((centres[i, 1] - 29) / 13), round((centres[i, 0] - 31) / 14)
        if 2 <= row < 6 and 2 <= col < 6 and colours[row, col] >= 0 and (row, col) not in {tuple(c) for c in cells.tolist()}:
            cells[i] = row, col
    known = np.flatnonzero(cells[:, 0] >= 0)
    cells[known[0]], cells[known[1]] = cells[known[1]].copy(), cells[known[0]].copy()
    likelihood, own, fits = rng.normal(1.5, 0.8, (n, 4)), rng.normal(1.0, 1.0, n), rng.random(n) < 0.97
    at, heads, following = np.empty((rows, cols), np.int32), np.empty((25, 25), np.int32), np.empty(n, np.int32)
    growth_kernels.occupy(cells, at)
    np.testing.assert_array_equal(at, twins.occupy(cells, at.shape))
    growth_kernels.bucket_circles(centres, 8.0, heads, following)
    expected = twins.grow(centres, likelihood, colours, 0.3, cells, at, fits)
    growth_kernels.grow(centres, likelihood, colours, heads, following, 8.0, 0.3, cells, at, fits, np.empty(n, np.int32))
    for mine, twin in zip((cells, at, fits), expected, strict=True):
        np.testing.assert_array_equal(mine, twin)
    assert (cells[:, 0] >= 0).sum() > len(known) + 10
    rival, around, off, bump = np.empty(n), np.empty((n, 2)), np.empty((n, 3)), np.empty(n)
    growth_kernels.rivals(centres, colours, heads, following, 8.0, cells, at, fits, rival)
    np.testing.assert_allclose(rival, twins.rivals(centres, colours, cells, at, fits), atol=1e-9)
    weight_kernels.evidence(at, fits, cells, own, 2, around)
    np.testing.assert_allclose(around, twins.evidence(at, fits, cells, own, 2), atol=1e-9)
    weight_kernels.smoothness(centres, at, fits, cells, off)
    np.testing.assert_allclose(off, twins.smoothness(centres, at, fits, cells), atol=1e-9)
    area, usual = rng.uniform(20, 60, n), np.empty(n)
    weight_kernels.usual_areas(area, cells, at, usual)
    np.testing.assert_allclose(usual, twins.usual_areas(area, cells, at))
    roots, slant = rng.normal(0, 2, (n, 2, 2)), np.empty(n)
    moments = roots @ roots.transpose(0, 2, 1) + 0.5 * np.eye(2)
    weight_kernels.slants(centres, moments, at, fits, cells, slant)
    np.testing.assert_allclose(slant, twins.slants(centres, moments, at, fits, cells), atol=1e-9)
    stretch = np.empty(n)
    weight_kernels.stretches(moments, cells, at, stretch)
    np.testing.assert_allclose(stretch, twins.stretches(moments, cells, at), atol=1e-6)
    assert 0 < (stretch > 0.5).sum() < n
    y, x = np.mgrid[0:200, 0:220]
    grey = (120 + 60 * np.cos(x / 4.0 + seed) * np.cos(y / 5.0)).astype(np.uint8)
    weight_kernels.bumps(*grey_levels(grey), centres, at, fits, cells, np.array([0.12, 4.0, 3.0, 5.0, 5.0]), bump)
    np.testing.assert_allclose(bump, twins.bumps(grey, centres, at, fits, cells, (0.12, 4.0, 3.0, 5.0, 5.0)), atol=1e-9)
    assert (rival < 1).any() and (off[:, 2] == 4).any() and 0 < (slant > 0).sum() < n and 0 < (bump > 0).sum() < n
