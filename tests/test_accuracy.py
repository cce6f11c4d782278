"""Sensitivity, covariance, coverage and accuracy: claims of thesis 3.3 held against simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from asterism.cameras import Camera, Rig
from asterism.cameras.accuracy import (
    Volume,
    covariance,
    lines_of_sight_meet,
    map_rig,
    repeatability,
    sees,
    sensitivity,
    volume_of,
    wand_accuracy,
)
from asterism.cameras.accuracy.sensitivity import _jacobians
from asterism.errors import AsterismError
from asterism.recording import Floats
from asterism.simulation.cameras import random_rig, ring_rig, simulate_wand


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_pixel_jacobians_equal_finite_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rig = random_rig(3, rng=rng)
    points = rng.uniform(-0.5, 0.5, (5, 3)) + np.array([0, 0, 0.9])
    step = 1e-6
    moved = np.stack([(rig.project(points + step * e) - rig.project(points - step * e)) / (2 * step) for e in np.eye(3)], axis=-1)
    assert np.nanmax(np.abs(_jacobians(rig, points) - moved) / (1 + np.abs(moved))) < 1e-6


def test_one_at_a_time_equals_its_twin_by_least_squares() -> None:
    rng = np.random.default_rng(1)
    rig = random_rig(3, rng=rng)
    places = rng.uniform(-0.4, 0.4, (4, 3)) + np.array([0, 0, 0.9])
    result = sensitivity(rig, places, 0.5, "one-at-a-time")
    for q, (a, b) in enumerate(result.pairs):
        both = Rig((rig[int(a)], rig[int(b)]))
        for n, place in enumerate(places):
            pixels = both.project(place).ravel()
            for moved in range(4):
                ends = [_composed(both, pixels + sign * 0.5 * np.eye(4)[moved], place) for sign in (1, -1)]
                assert np.abs(np.abs(ends[0] - ends[1]) - result.scalars[q, n, :, moved]).max() < 1e-7


def _composed(rig: Rig, pixels: Floats, near: Floats) -> Floats:
    return least_squares(lambda x: rig.project(x).ravel() - pixels, near, xtol=1e-15, ftol=1e-15, gtol=1e-15).x


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_the_analytic_scalars_are_those_of_one_at_a_time(seed: int) -> None:
    """To first order: the smaller the shift the nearer; at 0.1 px the largest difference of any well-composed place is far below 1 %."""
    rng = np.random.default_rng(seed)
    rig = random_rig(4, rng=rng)
    places = rng.uniform(-0.5, 0.5, (10, 3)) + np.array([0, 0, 0.9])
    exact, first = (sensitivity(rig, places, 0.1, method) for method in ("one-at-a-time", "analytic"))
    good = np.isfinite(exact.effective) & (exact.effective < 0.002)
    assert good.any()
    assert np.abs(exact.effective / first.effective - 1)[good].max() < 0.01


def test_the_covariance_is_what_noise_does() -> None:
    """Points composed 4,000 times from noisy pixels of all cameras scatter as the covariance says."""
    rig = ring_rig(4, rng=np.random.default_rng(0))
    place = np.array([0.3, -0.2, 1.1])
    told = covariance(rig, place[None], 0.5)[0]
    rng = np.random.default_rng(1)
    jacobians = _jacobians(rig, place[None])[:, 0].reshape(-1, 3)
    pixels = rig.project(place).ravel()
    points = []
    for _ in range(4000):
        aim, x = pixels + 0.5 * rng.normal(size=len(pixels)), place
        for _ in range(2):
            x = x + np.linalg.lstsq(jacobians, aim - rig.project(x).ravel(), rcond=None)[0]
        points.append(x)
    seen = np.cov(np.array(points).T)
    assert np.abs(seen / np.trace(told) - told / np.trace(told)).max() < 0.03


def test_two_cameras_on_a_line_with_the_place_compose_nothing_there() -> None:
    """Head on, each sees the other: along the line between them the depth is open."""
    rig = ring_rig(2, height=0.9)
    on, off = np.array([[0.0, 0, 0.9]]), np.array([[0.0, 0, 1.9]])
    assert np.isnan(covariance(rig, on)).all()
    assert np.isnan(sensitivity(rig, on).scalars).all()
    assert np.isfinite(covariance(rig, off)).all()


def test_more_cameras_never_measure_worse() -> None:
    rig = ring_rig(8)
    volume = Volume.parse("2x2x2")
    few, many = map_rig(Rig(rig.cameras[:5]), volume, noise=0.3), map_rig(rig, volume, noise=0.3)
    both = np.isfinite(few.error)
    assert (many.error[both] <= few.error[both] + 1e-12).all()
    assert (many.seen_by >= few.seen_by).all()
    assert (many.facing >= few.facing).all()


def test_noise_scales_the_error_and_the_focal_length_divides_it() -> None:
    volume = Volume.parse("1x1x1")
    one = map_rig(ring_rig(5, distortion=False), volume, noise=0.3)
    assert np.allclose(map_rig(ring_rig(5, distortion=False), volume, noise=0.6).error, 2 * one.error)
    near = map_rig(ring_rig(5, focal=2 * 0.86 * 1280, size=(2560, 2048), distortion=False), volume, noise=0.3)
    assert np.abs(near.error / one.error - 0.5).max() < 0.01


def test_the_noise_of_a_calibrated_rig_is_what_its_calibration_left() -> None:
    rig = ring_rig(4)
    calibrated = Rig(tuple(replace(camera, error=0.4) for camera in rig))
    volume = Volume.parse("1x1x1")
    assert map_rig(rig, volume).noise == 0.3
    assert np.isclose(map_rig(calibrated, volume).noise, 0.4 / np.sqrt(2))
    assert map_rig(calibrated, volume, noise=0.5).noise == 0.5


def test_what_a_camera_sees_ends_at_its_image() -> None:
    rig = Rig((Camera("one", (1000, 500), (500.0, 500.0), (499.5, 249.5)),))
    seen = sees(rig, [[0.99, 0, 1], [1.01, 0, 1], [0, 0.49, 1], [0, 0.51, 1], [0, 0, -1]])
    assert seen[0].tolist() == [True, False, True, False, False]


def test_a_ring_meets_and_covers_the_middle() -> None:
    rig = ring_rig(8, radius=4.0)
    assert np.abs(lines_of_sight_meet(rig) - (0, 0, 0.9)).max() < 1e-9
    volume = volume_of(rig)
    assert volume.low[2] == 0.0
    assert (volume.low < [-1, -1, 0.1]).all()
    assert (volume.high > [1, 1, 1.5]).all()
    result = map_rig(rig)
    assert result.coverage(3) > 0.6
    # level cameras around: height from all 8, each horizontal axis from half of them; 0.3 px are 1.1 mm in one camera 4.1 m away
    level = map_rig(ring_rig(8, radius=4.1, height=0.9, distortion=False), Volume.parse("-0.1:0.1,-0.1:0.1,0.8:1"), noise=0.3)
    assert np.isclose(level.median_error, 0.3 * 4.1 / (0.86 * 1280) * np.sqrt(1 / 8 + 2 / 4), rtol=0.01)
    assert result.grid(result.seen_by).shape == tuple(len(axis) for axis in result.axes)


def test_a_small_rig_has_a_small_volume() -> None:
    """A rig of centimetres measures what one of metres does, a hundred times as exactly."""
    rig = ring_rig(5)
    large, small = map_rig(rig), map_rig(rig.moved(np.eye(3), np.zeros(3), 0.01))
    assert np.allclose(100 * small.volume.size, large.volume.size, atol=0.4)
    assert small.coverage(3) > 0.8
    assert 100 * small.median_error == pytest.approx(large.median_error, rel=0.1)


def test_turned_rooms_have_turned_maps() -> None:
    rig = ring_rig(6, rng=np.random.default_rng(2))
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # z up becomes y up: (x, y, z) to (x, z, -y)
    turned = map_rig(rig.moved(turn, np.zeros(3)), Volume.parse("2x3x1.5", "y"), step=0.25)
    plain = map_rig(rig, Volume.parse("2x3x1.5"), step=0.25)
    for name in ("error", "facing", "seen_by"):
        assert np.allclose(np.sort(getattr(turned, name)), np.sort(getattr(plain, name))), name


def test_wand_errors_are_found_where_they_are() -> None:
    """A scale that is wrong by 1 % at x > 0 only."""
    _, truth = simulate_wand(ring_rig(6), rng=np.random.default_rng(0))
    positions = truth.positions.copy()
    right = positions[:, :, 0].min(axis=1) > 0
    positions[right] *= 1.01
    positions[:100, 1] = np.nan
    result = wand_accuracy(positions, (0.0, 0.2, 0.6))
    assert result.frames == 1900
    lengths = np.array([0.2, 0.6, 0.4])
    assert np.allclose(result.pair_errors, 0.01 * lengths * right[100:].mean())
    assert np.isclose(result.mean_error, result.pair_errors.mean())
    assert result.place_errors[result.places[:, 0] < 0].max() < 1e-9
    sure = (result.places[:, 0] > 0.5) & (result.place_frames > 5)
    assert np.allclose(result.place_errors[sure], 0.004, atol=1e-9)
    mirrored = wand_accuracy(0.98 * truth.positions, (0.0, 0.2, 0.6))
    assert np.isclose(mirrored.mean_error, -0.02 * 0.4)
    assert np.isclose(mirrored.mean_absolute, 0.02 * 0.4)
    assert mirrored.std < 1e-9


def test_repeatability_is_the_mean_distance_from_the_mean() -> None:
    rng = np.random.default_rng(0)
    still = rng.normal(0.0, 0.001, (20_000, 2, 3)) + np.array([[0.0, 0, 1], [1.0, 0, 0]])
    still[0, 0] = np.nan
    assert np.abs(repeatability(still) - 0.001 * np.sqrt(8 / np.pi)).max() < 2e-5
    assert np.isnan(repeatability(still[:1])).all()


@pytest.mark.parametrize(
    ("text", "vertical", "low", "high"),
    [
        ("6x4x2.5", "z", [-3, -2, 0], [3, 2, 2.5]),
        ("6x4x2.5", "y", [-3, 0, -2], [3, 2.5, 2]),
        ("6x4x2.5", "-z", [-3, -2, -2.5], [3, 2, 0]),
        ("-1:2,0:4,-0.5:1", "z", [-1, 0, -0.5], [2, 4, 1]),
    ],
)
def test_volumes_from_words(text: str, vertical: str, low: list[float], high: list[float]) -> None:
    volume = Volume.parse(text, vertical)
    assert volume.low.tolist() == low
    assert volume.high.tolist() == high


@pytest.mark.parametrize("text", ["6x4", "six", "6x4x-1", "1:0,0:1,0:1", "6x4xnan", ""])
def test_words_that_are_no_volume(text: str) -> None:
    with pytest.raises(AsterismError):
        Volume.parse(text)


def test_a_rig_that_has_no_map_says_why() -> None:
    rig = ring_rig(3)
    with pytest.raises(AsterismError, match="at least two"):
        map_rig(Rig(rig.cameras[:1]))
    with pytest.raises(AsterismError, match="camera c2: its pose"):
        map_rig(Rig((rig[0], replace(rig[1], posed=False))))
    with pytest.raises(AsterismError, match="camera c2: its image size"):
        map_rig(Rig((rig[0], replace(rig[1], size=None))))
    with pytest.raises(AsterismError, match="in one place"):
        map_rig(Rig((rig[0], replace(rig[0], name="again"))), Volume.parse("1x1x1"))
    with pytest.raises(AsterismError, match="noise of inf"):
        map_rig(rig, noise=np.inf)
    with pytest.raises(AsterismError, match="no frame shows"):
        wand_accuracy(np.full((5, 2, 3), np.nan), (0.0, 0.5))
    with pytest.raises(AsterismError, match="shape"):
        wand_accuracy(np.zeros((5, 3, 3)), (0.0, 0.5))
