"""Blobs in images: the kernel against OpenCV, centroids against rendered truth, and images that are none."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import twins_detection
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from twins_detection import grown

from asterism.detection import BlobSettings, Flag, _region_kernels, automatic_threshold, find_blobs, static_mask
from asterism.detection import _moment_kernels as moments
from asterism.detection._run_kernels import Runs, find_runs, group_runs
from asterism.detection._split_kernels import split_at_saddles
from asterism.errors import AsterismError

pytestmark = pytest.mark.kernels


def discs(places: np.ndarray, diameter: float = 8.0, shape: tuple[int, int] = (240, 320), **light: float) -> np.ndarray:
    """An image of soft-edged discs (y down, x right) on a dark noisy ground; light: peak, dark, noise, seed, top."""
    ys, xs = np.mgrid[: shape[0], : shape[1]]
    image = np.zeros(shape)
    for x, y in places:
        away = np.hypot(xs - x, ys - y) - diameter / 2
        image = np.maximum(image, light.get("peak", 180.0) / (1 + np.exp(np.clip(away / 0.4, -50, 50))))
    rng = np.random.default_rng(int(light.get("seed", 0)))
    image += light.get("dark", 10.0) + rng.normal(0, light.get("noise", 2.0), shape)
    top = light.get("top", 255.0)
    return np.clip(np.rint(image), 0, top).astype(np.uint8 if top <= 255 else np.uint16)


def apart(count: int, seed: int, distance: float = 20.0, shape: tuple[int, int] = (240, 320)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    places: list[np.ndarray] = []
    while len(places) < count:
        place = rng.uniform(15, np.array(shape[::-1]) - 15)
        if all(np.hypot(*(place - other)) > distance for other in places):
            places.append(place)
    return np.array(places)


def off(found: np.ndarray, places: np.ndarray) -> np.ndarray:
    """How far the nearest found blob is from each place, px."""
    return np.linalg.norm(places[:, None] - found[None], axis=2).min(axis=1)


@given(
    st.integers(0, 10_000), st.integers(1, 40), st.integers(1, 200), st.floats(0.02, 0.7), st.sampled_from([4, 8]), st.sampled_from([8, 16])
)
@settings(max_examples=80, deadline=None)
def test_components_equal_opencv(seed: int, height: int, width: int, share: float, connectivity: int, bits: int) -> None:
    rng = np.random.default_rng(seed)
    image = (rng.integers(0, 2**bits, (height, width)) * (rng.random((height, width)) < share)).astype(f"uint{bits}")
    threshold = 2 ** (bits - 2)
    found = find_blobs(image, BlobSettings(threshold=threshold, connectivity=connectivity, min_size=0, max_size=1e4, split=1.0))

    count, labels, stats, _ = cv2.connectedComponentsWithStats((image > threshold).astype(np.uint8), connectivity=connectivity)
    weights = np.maximum(image.astype(float) - threshold, 0).ravel()
    ys, xs = (axis.ravel() for axis in np.indices(image.shape))
    total, x, y = (np.bincount(labels.ravel(), weights * w, count)[1:] for w in (1.0, xs, ys))
    expected = np.column_stack([x / total, y / total, stats[1:, cv2.CC_STAT_AREA], total])
    measured = np.column_stack([found.xy, np.pi * found.size**2 / 4, found.weight])
    assert len(found) == count - 1
    assert np.allclose(np.sort(measured, axis=0), np.sort(expected, axis=0), rtol=1e-9, atol=1e-9)
    assert np.allclose(measured[np.lexsort(measured.T)], expected[np.lexsort(expected.T)], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("top", [255.0, 65535.0])
def test_centroids_of_rendered_markers(top: float) -> None:
    places = apart(40, 1)
    grey = top / 255
    image = discs(places, top=top, peak=180 * grey, dark=10 * grey, noise=2 * grey)
    found = find_blobs(image)
    rms = np.sqrt((off(found.xy, places) ** 2).mean() / 2)
    assert len(found) == 40
    assert rms < 0.02, f"{rms:.3f} px RMS per axis, allowed 0.02"
    assert np.abs(find_blobs(image, BlobSettings(threshold=100 * grey)).size - 8.0).max() < 0.5, "at half of their height"
    assert found.roundness.min() > 0.9
    assert not found.flags.any()


def test_a_shifted_image_has_shifted_blobs() -> None:
    """The other way round too: what is found follows the image, it is not made up."""
    image = discs(apart(10, 2))
    before, after = (
        find_blobs(image, BlobSettings(threshold=60)),
        find_blobs(np.roll(image, (3, -2), axis=(0, 1)), BlobSettings(threshold=60)),
    )
    assert np.allclose(after.xy, before.xy + np.array([-2, 3]), atol=1e-12)


def test_the_image_stays_as_it_is_however_it_lies_in_memory() -> None:
    image = discs(apart(10, 2), top=65535.0, peak=40_000.0, dark=2000.0, noise=300.0)
    frozen, plain = image.copy(), find_blobs(image, BlobSettings(threshold=9000))
    frozen.flags.writeable = False
    for same in (frozen, image.astype(">u2"), np.asfortranarray(image), np.dstack([image] * 3)):
        assert np.array_equal(find_blobs(same, BlobSettings(threshold=9000)).xy, plain.xy)
    assert np.array_equal(image, frozen)


@pytest.mark.parametrize("distance", [7.2, 8.0, 10.0])
def test_overlapping_markers_are_split(distance: float) -> None:
    """Discs of 8 px that overlap or touch, in all directions: both are found and said to overlap."""
    for turn in np.linspace(0, np.pi, 7):
        places = 100 + 0.5 * distance * np.array([[np.cos(turn), np.sin(turn)], [-np.cos(turn), -np.sin(turn)]])
        found = find_blobs(discs(places, seed=int(100 * turn)), BlobSettings(threshold=20))
        assert len(found) == 2, f"{len(found)} blobs at {np.degrees(turn):.0f} degrees"
        assert off(found.xy, places).max() < 0.15, f"{off(found.xy, places)} px"
        assert distance > 8.0 or (found.flags & Flag.OVERLAPPING).all()


def test_a_streak_is_flagged_not_split() -> None:
    streak = discs(100 + np.linspace(-6, 6, 40)[:, None] * [1.0, 0.3])
    found = find_blobs(streak)
    assert len(found) == 1
    assert found.flags[0] & Flag.UNROUND
    assert len(find_blobs(streak, BlobSettings(min_roundness=0.6))) == 0


def test_flags_say_what_is_doubtful() -> None:
    image = discs(np.array([[1.0, 100.0], [100.0, 100.0], [200.0, 100.0]]))
    image[95:106, 195:206] = np.where(image[95:106, 195:206] > 100, 255, image[95:106, 195:206])
    found = find_blobs(image)
    flags = {round(float(x), -1): Flag(int(flag)) & ~Flag.UNROUND for (x, _), flag in zip(found.xy, found.flags, strict=True)}
    assert flags == {0.0: Flag.AT_BORDER, 100.0: Flag(0), 200.0: Flag.SATURATED}


def test_windows_and_hot_pixels_are_left_out() -> None:
    places = apart(5, 3)
    places = places[(places[:, 0] < 200)]
    image = discs(places)
    image[20:220, 230:310] = 200
    image[3, 3] = 255
    assert off(find_blobs(image, BlobSettings(threshold=60)).xy, places).max() < 0.1
    assert len(find_blobs(image, BlobSettings(threshold=60))) == len(places)


def test_uneven_light_is_taken_off() -> None:
    places = apart(15, 4)
    image = discs(places, peak=60).astype(float) + np.linspace(0, 120, 320)[None]
    image = np.clip(image, 0, 255).astype(np.uint8)
    found = find_blobs(image, BlobSettings(background=31, threshold=20))
    assert len(found) == 15
    assert off(found.xy, places).max() < 0.3
    empty = np.broadcast_to(10 + np.linspace(0, 120, 320), (240, 320)).astype(np.uint8)
    assert off(find_blobs(image, BlobSettings(background=empty, threshold=20)).xy, places).max() < 0.15


def test_static_reflections_are_masked() -> None:
    still = np.array([[50.0, 60.0], [250.0, 180.0]])
    frames = [discs(np.concatenate([still, [[20.0 + 14 * k, 120.0]]]), seed=k) for k in range(20)]
    mask = static_mask(frames)
    for k, frame in enumerate(frames):
        found = find_blobs(frame, BlobSettings(mask=mask))
        assert len(found) == 1, f"frame {k}: {len(found)} blobs"
        assert off(found.xy, np.array([[20.0 + 14 * k, 120.0]])).max() < 0.1
    assert len(find_blobs(frames[0])) == 3
    passing = find_blobs(discs(np.concatenate([still, [[57.0, 60.0]]])), BlobSettings(mask=mask))
    assert (passing.flags & Flag.AT_BORDER).all(), "a marker half behind a mask is where nobody knows"


def test_automatic_threshold_stands_between_dark_and_markers() -> None:
    image = discs(apart(30, 5), dark=30, noise=4)
    assert 45 < automatic_threshold(image) < 90


def test_dark_flat_and_full_images_have_no_blobs() -> None:
    for value in (0, 7, 255):
        assert len(find_blobs(np.full((50, 70), value, np.uint8))) == 0
    assert len(find_blobs(np.zeros((1, 1), np.uint16))) == 0


@pytest.mark.parametrize(
    ("image", "settings", "message"),
    [
        (np.zeros((4, 4)), {}, "8 or 16 bit"),
        (np.zeros((4, 4), np.int16), {}, "8 or 16 bit"),
        (np.zeros(4, np.uint8), {}, "not a grey image"),
        (np.zeros((0, 4), np.uint8), {}, "not a grey image"),
        (np.dstack([np.eye(4, dtype=np.uint8), *2 * [np.zeros((4, 4), np.uint8)]]), {}, "not a grey image"),
        (np.zeros((4, 4), np.uint8), {"threshold": 255}, "grey scale"),
        (np.zeros((4, 4), np.uint8), {"threshold": -1}, "grey scale"),
        (np.zeros((4, 4), np.uint8), {"threshold": np.nan}, "grey scale"),
        (np.zeros((4, 4), np.uint8), {"connectivity": 6}, "4 or 8"),
        (np.zeros((4, 4), np.uint8), {"min_size": 5, "max_size": 4}, "smallest"),
        (np.zeros((4, 4), np.uint8), {"split": 0}, "split"),
        (np.zeros((4, 4), np.uint8), {"mask": np.zeros((4, 5))}, "mask"),
        (np.zeros((4, 4), np.uint8), {"background": 4}, "odd"),
        (np.zeros((4, 4), np.uint8), {"background": np.zeros((5, 4), np.uint8)}, "background"),
        (np.zeros((4, 4), np.uint8), {"weight_reference": "peak"}, "weigh"),
    ],
)
def test_images_and_settings_that_cannot_be_are_refused(image: np.ndarray, settings: dict, message: str) -> None:
    with pytest.raises(AsterismError, match=message):
        find_blobs(image, BlobSettings(**settings))


@given(st.integers(0, 10_000), st.integers(3, 16), st.integers(3, 16), st.floats(0.5, 60), st.integers(0, 60))
@settings(max_examples=60, deadline=None)
def test_blobs_grown_by_steps_equal_their_twin(seed: int, height: int, width: int, step: float, lowest: int) -> None:
    rng = np.random.default_rng(seed)
    image = np.maximum(rng.integers(-60, 100, (height, width)), 0).astype(np.uint8)
    image = np.maximum(image, cv2.GaussianBlur(image, (3, 3), 0) // 2 * (image > 0)).astype(np.uint8)
    found = find_blobs(image, BlobSettings(threshold=0, min_peak=lowest, step=step, min_size=0, max_size=1e3))
    expected = []
    for pixels in grown(image, step, lowest):
        places = np.array(sorted(pixels))
        weights = image[tuple(places.T)].astype(float)
        expected.append((*np.average(places[:, ::-1], axis=0, weights=weights), len(pixels), weights.sum(), weights.max()))
    measured = np.column_stack([found.xy, np.pi * found.size**2 / 4, found.weight, found.peak])
    assert len(measured) == len(expected)
    assert np.allclose(sorted(map(tuple, np.round(measured, 6))), sorted(map(tuple, np.round(expected, 6))), atol=1e-5)


def component(seed: int, height: int, width: int) -> np.ndarray:
    """The weights (h, w) of the largest component of a smooth random image, 0 around it."""
    rng = np.random.default_rng(seed)
    smooth = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), 1.5)
    weight = np.pad(np.maximum(np.rint(40 * smooth / smooth.std()), 0).astype(np.int64), 1)
    assume(weight.any())
    labels, _ = twins_detection.label_regions(weight > 0, np.ones((3, 3)))
    return np.where(labels == np.argmax(np.bincount(labels.ravel())[1:]) + 1, weight, 0)


@given(st.integers(0, 10_000), st.integers(6, 24), st.integers(6, 24), st.floats(0.02, 0.6))
@settings(max_examples=60, deadline=None)
def test_components_part_at_saddles_as_by_the_twin(seed: int, height: int, width: int, share: float) -> None:
    weight = component(seed, height, width)
    ys, xs, label = np.empty(weight.size, np.int64), np.empty(weight.size, np.int64), np.full(weight.shape, -1)
    count, parts = split_at_saddles(weight, share, ys, xs, label)
    assert count == (weight > 0).sum()
    places = list(zip(ys[:count].tolist(), xs[:count].tolist(), strict=True))
    found = [{place for place in places if label[place] == part} for part in range(parts)] if parts > 1 else [set(places)]
    assert {frozenset(blob) for blob in found} == {frozenset(blob) for blob in twins_detection.parted(weight, share)}


@pytest.mark.parametrize("seed", range(3))
def test_pixels_of_overlapping_blobs_are_shared_as_by_the_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = np.array([[9.0, 10.0], [15.0, 11.0], [11.0, 16.0]]) + rng.uniform(-0.5, 0.5, (3, 2))
    weight = np.rint(discs(places, 6.0, (26, 26), seed=seed).astype(float)).astype(np.int64)
    ys, xs = np.nonzero(weight > 0)
    out = np.zeros((3, moments.COLUMNS))
    out[:, [moments.X, moments.Y]] = places + rng.uniform(-1, 1, (3, 2))
    out[:, [moments.XX, moments.YY, moments.WEIGHT]] = [4.0, 4.0, 1000.0]
    expected = twins_detection.shared(weight[ys, xs], np.stack([xs, ys], axis=1), out[:, [moments.X, moments.Y]], 4.0, moments.SETTLED_PX)
    moments.share_pixels(weight, ys, xs, 10**9, out)
    assert np.allclose(out[:, [moments.X, moments.Y]], expected, atol=1e-9)


@given(st.integers(0, 10_000), st.integers(20, 110), st.integers(20, 110), st.sampled_from([8, 16]))
@settings(max_examples=20, deadline=None)
def test_large_areas_that_are_raised_equal_their_twin(seed: int, height: int, width: int, bits: int) -> None:
    rng = np.random.default_rng(seed)
    smooth = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), 6)
    image = np.clip(2 ** (bits - 2) * (1 + smooth / smooth.std()) + rng.normal(0, 3, smooth.shape), 0, 2**bits - 1).astype(f"uint{bits}")
    level = np.full_like(image, 2 ** (bits - 2))
    expected = twins_detection.raised(image, level, 50, 1.5, _region_kernels.SAMPLE)
    runs = Runs(*(np.empty(image.size, np.int32) for _ in range(4)))
    components = group_runs(runs, find_runs(image, level, 1, runs))
    before = level.copy()
    changed = _region_kernels.raise_threshold(image, level, components, 50.0, 1.5, 2**bits - 1)
    assert changed == (level != before).any()
    assert np.array_equal(level, expected)


@pytest.mark.parametrize("seed", range(4))
def test_what_stands_out_equals_its_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 255, (40, 50)).astype(np.uint8)
    blobs = np.zeros((30, moments.COLUMNS))
    blobs[:, [moments.X, moments.Y]] = rng.uniform(0, [49, 39], (30, 2))
    blobs[:, [moments.WIDE, moments.TALL]] = rng.integers(1, 12, (30, 2))
    out = np.empty(30, np.bool_)
    _region_kernels.stands_out(image, blobs, 110.0, out)
    assert 0 < out.sum() < 30
    for blob, distinct in zip(blobs, out, strict=True):
        place, extent = blob[[moments.X, moments.Y]], blob[[moments.WIDE, moments.TALL]]
        assert distinct == (twins_detection.contrast(image, place, extent) > 110)


@pytest.mark.parametrize(("skin", "rough"), [(10, 1.5), (30, 4), (60, 8)])
def test_markers_on_a_body_that_shines_are_found(skin: float, rough: float) -> None:
    """A body, brighter than the dark by far more than its noise, is no marker, but those on it are; a threshold that is given stands."""
    rng = np.random.default_rng(int(skin))
    body = cv2.GaussianBlur(cv2.ellipse(np.zeros((300, 300)), (150, 150), (60, 120), 0, 0, 360, 1.0, -1), (0, 0), 3)
    texture = cv2.GaussianBlur(rng.normal(size=body.shape), (0, 0), 3)
    image = 10 + body * (skin + rough * texture / texture.std())
    places = np.array([[150.0, 80.3], [120.4, 130.0], [180.0, 150.7], [150.6, 220.0], [20.0, 20.2], [280.0, 250.0]])
    ys, xs = np.mgrid[:300, :300]
    for x, y in places:
        image += 150 / (1 + np.exp(np.clip((np.hypot(xs - x, ys - y) - 3) / 0.4, -50, 50)))
    grey = np.clip(np.rint(image + rng.normal(0, 2, image.shape)), 0, 255).astype(np.uint8)
    found = find_blobs(grey)
    assert len(found) == len(places)
    assert off(found.xy, places).max() < 0.3
    assert len(find_blobs(grey, BlobSettings(threshold=25))) != len(places)


def test_a_bright_particle_does_not_swallow_a_dim_one() -> None:
    """A dim particle on the flank of one 200 grey values brighter, without a valley between them: a step parts them, a valley cannot."""
    ys, xs = np.mgrid[:40, :40]
    image = 8 + 230.0 * np.exp(-((xs - 20) ** 2 + (ys - 20) ** 2) / 2.0) + 30.0 * np.exp(-((xs - 15) ** 2 + (ys - 17) ** 2) / 3.0)
    image = np.rint(image).astype(np.uint8)
    found = find_blobs(image, BlobSettings(threshold=14, step=100, weight_reference="background", background=np.full_like(image, 8)))
    assert off(found.xy, np.array([[20.0, 20.0], [15.0, 17.0]])).max() < 0.3


def test_background_is_exceeded_by_more_than_the_threshold_exactly() -> None:
    """The local mean is rounded so that integers compare with it as with the mean itself."""
    image = np.random.default_rng(6).integers(0, 60, (50, 80)).astype(np.uint8)
    mean = cv2.blur(image.astype(float), (5, 5))
    found = find_blobs(image, BlobSettings(background=5, threshold=12, min_size=0, max_size=1e3, split=1.0))
    assert np.pi * (found.size**2).sum() / 4 == pytest.approx((image - mean > 12 + 1e-9).sum())


def test_particles_of_a_peer_are_found(data: Path) -> None:
    """With the peer's own thresholds; its pixel centres are at a half."""
    folder = data / "cameras" / "particles-4cam"
    image = cv2.imread(str(folder / "images" / "cam1.10001"), cv2.IMREAD_UNCHANGED)
    peer = np.loadtxt(folder / "images" / "cam1.10001_targets", skiprows=1)
    how = {"background": 25, "threshold": 9, "weight_reference": "background", "min_peak": 18, "step": 100}
    found = find_blobs(image, BlobSettings(**how, min_size=2.25, max_size=25.25, min_width=2, min_weight=151))
    kept = found.xy[found.flags & Flag.AT_BORDER == 0]
    away, back = off(kept, peer[:, 1:3] - 0.5), off(peer[:, 1:3] - 0.5, kept)
    assert (away < 1).mean() > 0.99
    assert (back < 1).mean() > 0.99
    assert np.median(away) < 0.001
