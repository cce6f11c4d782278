"""Cameras that are not triggered together: their blobs at common instants against where the markers were then."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism.errors import AsterismError
from asterism.recording import Blobs
from asterism.synchronization import to_common_clock

RATE = 100.0


def where(time: np.ndarray, markers: int) -> np.ndarray:
    """Markers on ellipses through the image, up to some 10 px a frame, never nearer than 60 px: (..., markers, 2) px."""
    number = np.arange(markers)
    angle = 2 * np.pi * (0.7 + 0.05 * number) * np.asarray(time)[..., None] + number
    return np.stack([200 + 250 * number + 80 * np.sin(angle), 300 + 150 * np.cos(angle)], axis=-1)


def seen(times: np.ndarray, markers: int = 3, noise: float = 0.0, strays: int = 0, gone: float = 0.0, seed: int = 0) -> Blobs:
    """What cameras see that take their frames at times (T, C) s."""
    rng = np.random.default_rng(seed)
    rows = []
    for t, row in enumerate(times):
        for c, time in enumerate(row):
            if np.isfinite(time):
                xy = where(time, markers) + rng.normal(0, noise, (markers, 2)) if noise else where(time, markers)
                xy = np.concatenate([xy[rng.random(markers) >= gone], rng.uniform(0, 1000, (strays, 2))])
                rows += [(t, c, *place) for place in rng.permutation(xy)]
    frame, camera, x, y = np.array(rows).T
    names = [f"c{c}" for c in range(times.shape[1])]
    return Blobs.from_rows(frame, camera, np.column_stack([x, y]), names, rate=RATE, times=times, frames=len(times), sizes=5 + x / 1000)


def misses(blobs: Blobs, markers: int = 3) -> np.ndarray:
    """How far each blob is from the nearest marker at the instant of its frame, px."""
    assert blobs.times is not None
    truth = where(blobs.times[blobs.frame_of, blobs.camera_of], markers)
    return np.linalg.norm(truth - blobs.xy[:, None], axis=2).min(axis=1)


@given(st.integers(0, 10_000), st.integers(1, 4), st.integers(1, 4))
@settings(max_examples=25, deadline=None)
def test_blobs_are_where_the_markers_were_at_the_instant(seed: int, cameras: int, markers: int) -> None:
    """Offsets of up to 0.4 periods each, and jitter: cubic interpolation leaves hundredths of a pixel; uninterpolated it were several."""
    rng = np.random.default_rng(seed)
    times = np.arange(60)[:, None] / RATE + rng.uniform(-0.4, 0.4, cameras) / RATE + rng.uniform(-0.05, 0.05, (60, cameras)) / RATE
    common = to_common_clock(seen(times, markers, seed=seed))
    assert len(common) == 60
    assert common.times is not None and np.ptp(common.times, axis=1).max() == 0
    inner = (common.frame_of > 1) & (common.frame_of < 58)
    assert misses(common, markers)[inner].max() < 0.05
    assert (common.counts[2:-2] == markers).all()
    assert np.allclose(common.sizes, 5 + common.xy[:, 0] / 1000, atol=0.01)


def test_without_interpolation_they_are_elsewhere() -> None:
    times = np.arange(60)[:, None] / RATE + np.array([0.0, 0.4]) / RATE
    moved = seen(times)
    pretended = Blobs(moved.xy, moved.offsets, moved.cameras, RATE, moved.sizes, np.repeat(times[:, :1], 2, axis=1))
    assert misses(pretended).max() > 2.0


def test_cameras_of_other_rates_share_evenly_spaced_instants() -> None:
    """100, 100 and 50 frames/s, started at different times: the instants lie where all three run."""
    times = np.full((200, 3), np.nan)
    times[:, 0], times[:, 1] = np.arange(200) / RATE, 0.503 + np.arange(200) / RATE
    times[:90, 2] = 0.2 + np.arange(90) / 50
    common = to_common_clock(seen(times))
    assert common.times is not None
    assert common.rate == pytest.approx(RATE)
    assert common.times[0, 0] == pytest.approx(0.503)
    assert np.allclose(np.diff(common.times[:, 0]), 1 / RATE)
    assert common.times[-1, 0] <= min(1.99, 0.2 + 89 / 50) + 1e-9
    assert misses(common).max() < 0.2
    assert (common.counts == 3).mean() > 0.98


def test_a_slow_camera_beside_a_fast_one_keeps_its_blobs() -> None:
    """Two cameras, 60 and 20 frames/s: neither rate is the mean of both, and the slow one's frames are no gaps."""
    times = np.full((120, 2), np.nan)
    times[:, 0], times[:40, 1] = np.arange(120) / 60, 0.003 + np.arange(40) / 20
    common = to_common_clock(seen(times))
    assert common.rate == pytest.approx(60.0)
    assert (common.counts[3:-3] == 3).all()
    assert misses(common).max() < 2.0
    times[1:, 1] = np.nan
    assert (to_common_clock(seen(times)).counts[:, 1] == 0).all()


def test_strays_and_missing_blobs_do_not_lead_astray() -> None:
    times = np.arange(300)[:, None] / RATE + np.array([0.0, 0.37, -0.3]) / RATE
    common = to_common_clock(seen(times, noise=0.2, strays=2, gone=0.05, seed=1))
    wrong = misses(common) > 2.0
    kept = (~wrong).sum() / (300 * 3 * 3 * 0.95)
    assert kept > 0.85, f"{kept:.2f} of the markers are left"
    assert wrong.mean() < 0.03, f"{wrong.mean():.3f} of the blobs are no marker"


def test_frames_that_a_camera_dropped_are_bridged_when_short() -> None:
    times = np.arange(60)[:, None] / RATE + np.array([0.0, 0.3]) / RATE
    times[20, 1] = np.nan
    times[30:34, 1] = np.nan
    common = to_common_clock(seen(times))
    assert misses(common)[common.frame_of > 1].max() < 0.1
    assert common.counts[20, 1] == 3
    assert (common.counts[31:33, 1] == 0).all()


def test_one_trigger_needs_no_interpolation() -> None:
    blobs = seen(np.repeat(np.arange(5)[:, None] / RATE, 2, axis=1), noise=3.0, strays=1)
    again = to_common_clock(blobs)
    assert np.array_equal(again.xy, blobs.xy)
    assert np.array_equal(again.offsets, blobs.offsets)
    alone = Blobs(blobs.xy, blobs.offsets, blobs.cameras, RATE, blobs.sizes)
    assert to_common_clock(alone) is alone


def test_common_clock_twice_is_once() -> None:
    times = np.arange(40)[:, None] / RATE + np.array([0.0, 0.4, 0.1]) / RATE
    once = to_common_clock(seen(times))
    twice = to_common_clock(once)
    assert np.array_equal(once.xy, twice.xy) and np.array_equal(once.offsets, twice.offsets)


def test_times_that_cannot_be_are_refused() -> None:
    times = np.repeat(np.arange(5)[:, None] / RATE, 2, axis=1)
    times[3, 1] = times[1, 1]
    with pytest.raises(AsterismError, match="camera c1, frame 3"):
        to_common_clock(seen(times))
    apart = np.arange(10)[:, None] / RATE + np.array([0.0, 5.0])
    with pytest.raises(AsterismError, match="camera c0 ends before"):
        to_common_clock(seen(apart))
