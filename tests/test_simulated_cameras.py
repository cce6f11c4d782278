"""Simulated rigs, wands, images and shadows: what is claimed about them must hold in the blobs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components

from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.recording import Floats, Recording
from asterism.simulation import simulate_walks
from asterism.simulation.cameras import (
    MERGED,
    STRAY,
    Capsules,
    ImagingSettings,
    RenderSettings,
    _kernels,
    random_rig,
    render_images,
    ring_rig,
    simulate_blobs,
    simulate_wand,
    walker_capsules,
)

pytestmark = pytest.mark.kernels


def _one_capsule(start: list[float], end: list[float], radius: float, frames: int = 1) -> Capsules:
    return Capsules(np.tile(start, (frames, 1, 1)), np.tile(end, (frames, 1, 1)), np.array([radius]), ("limb",))


def test_every_camera_of_a_ring_looks_at_the_volume() -> None:
    rig = ring_rig(8, rng=np.random.default_rng(0))
    xy = rig.project([0.0, 0.0, 0.9])
    assert np.abs(xy - (640, 512)).max() < 200
    assert all(camera.position[2] > 1.5 for camera in rig)
    below = rig.project([0.0, 0.0, 0.2])
    assert (below[:, 1] > xy[:, 1]).all(), "down in the room is down in the image"


@pytest.mark.parametrize("seed", range(20))
def test_every_camera_of_a_random_rig_sees_the_wand(seed: int) -> None:
    rig = random_rig(rng=np.random.default_rng(seed))
    assert 3 <= len(rig) <= 12
    blobs, truth = simulate_wand(rig, frames=300, rate=30, rng=np.random.default_rng(seed))
    whole = np.zeros((300, len(rig)), dtype=int)
    np.add.at(whole, (blobs.frame_of, blobs.camera_of), truth.identity >= 0)
    share = (whole == 3).mean(axis=0)
    assert share.min() > 0.08, f"camera {rig.names[share.argmin()]} sees the whole wand in {share.min():.0%} of the frames"


def test_the_wand_keeps_its_lengths_and_blobs_lie_where_markers_are() -> None:
    rig = ring_rig(6, rng=np.random.default_rng(1))
    blobs, truth = simulate_wand(
        rig, (0.0, 0.2, 0.6), 500, settings=ImagingSettings(noise=0.2, merging=False), rng=np.random.default_rng(2)
    )
    gaps = np.linalg.norm(np.diff(truth.positions, axis=1), axis=2)
    assert np.abs(gaps - (0.2, 0.4)).max() < 1e-12
    speed = np.linalg.norm(np.diff(truth.positions[:, 1], axis=0), axis=1) * 100
    assert 0.8 < speed.mean() < 2.5, f"{speed.mean():.1f} m/s"
    expected = rig.project(truth.positions)[blobs.camera_of, blobs.frame_of, truth.identity]
    miss = blobs.xy - expected
    assert abs(miss.std() - 0.2) < 0.01
    assert abs(miss.mean()) < 0.01


def test_same_generator_same_blobs() -> None:
    rig = random_rig(5, rng=np.random.default_rng(3))
    made = [
        simulate_wand(
            rig, settings=ImagingSettings(noise=0.2, strays=2, outliers=0.05, dropped=0.1), frames=100, rng=np.random.default_rng(4)
        )
        for _ in range(2)
    ]
    assert np.array_equal(made[0][0].xy, made[1][0].xy)
    assert np.array_equal(made[0][1].identity, made[1][1].identity)
    other = simulate_wand(rig, frames=100, rng=np.random.default_rng(5))[0]
    assert not np.array_equal(made[0][0].xy[:10], other.xy[:10])


def test_what_is_asked_for_is_what_is_in_the_blobs() -> None:
    rig = ring_rig(4)
    still = np.tile(np.array([[0.0, 0, 0.9], [0.3, 0, 1.2]]), (2000, 1, 1))
    blobs, identity = simulate_blobs(
        rig, still, ImagingSettings(dropped=0.1, missed=0.2, outliers=0.05, strays=0.5), rng=np.random.default_rng(0)
    )
    assert abs((blobs.counts == 0).mean() - 0.1 - 0.9 * 0.04 * np.exp(-0.5)) < 0.01
    arrived = blobs.counts > 0
    per_image = np.zeros(arrived.shape)
    np.add.at(per_image, (blobs.frame_of, blobs.camera_of), identity >= 0)
    assert abs(per_image.mean() - 0.9 * 2 * 0.8 * 0.95) < 0.02
    lights = (identity == STRAY).sum() / (0.9 * arrived.size)
    assert abs(lights - 0.5 - 2 * 0.8 * 0.05) < 0.03


def test_outside_the_image_and_missing_there_are_no_blobs() -> None:
    rig = ring_rig(3)
    blobs, identity = simulate_blobs(rig, [[[0.0, 0, 0.9], [0.0, 0, 50.0], [np.nan, 0, 0]]], rng=np.random.default_rng(0))
    assert set(identity.tolist()) == {0}
    assert (blobs.counts == 1).all()


def test_blobs_in_an_image_stand_from_top_to_bottom_and_tell_nothing_else() -> None:
    rig = ring_rig(3)
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 20, 3)) + np.array([0, 0, 0.9])
    blobs, identity = simulate_blobs(rig, points, rng=np.random.default_rng(0))
    for t in range(50):
        assert (np.diff(blobs.of(t, 1)[:, 1]) >= 0).all()
    assert np.corrcoef(identity[:-1], identity[1:])[0, 1] < 0.1


def test_a_limb_hides_what_is_behind_it_and_on_its_far_side_only() -> None:
    rig = ring_rig(4, height=0.9)  # cameras at +x, +y, -x, -y, level with the limb's middle
    limb = _one_capsule([0, 0, 0.5], [0, 0, 1.3], 0.05)
    markers = [[[0.057, 0, 0.9], [-0.5, 0, 0.9], [0.02, 0, 0.9], [0, 0, 1.6]]]
    _, identity = simulate_blobs(rig, markers, ImagingSettings(merging=False), body=limb, rng=np.random.default_rng(0))
    blobs, _ = simulate_blobs(rig, markers, ImagingSettings(merging=False), body=limb, rng=np.random.default_rng(0))
    seen = {(int(c), int(m)) for c, m in zip(blobs.camera_of, identity, strict=True)}
    assert {m for c, m in seen if c == 0} == {0, 2, 3}, "from +x the marker half a metre behind the limb is hidden"
    assert {m for c, m in seen if c == 2} == {1, 3}, "from -x those on the limb's far side are; one under its skin is hidden by its core"
    assert {m for c, m in seen if c == 1} == {0, 1, 2, 3}, "from the side nothing is"


@given(st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_hidden_equals_its_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    eye, points = rng.uniform(-3, 3, 3), rng.uniform(-1, 1, (2, 4, 3))
    starts, ends, radii = rng.uniform(-1, 1, (2, 3, 3)), rng.uniform(-1, 1, (2, 3, 3)), rng.uniform(0.05, 0.4, 3)
    starts[1, 0] = np.nan
    out = np.empty((2, 4), dtype=bool)
    _kernels.hidden(eye, points, starts, ends, radii, 0.01, out)
    along = np.linspace(0, 1, 801)[:, None]
    for t, m in np.ndindex(2, 4):
        nearest = []
        for k in range(3):
            own = _to_segment(points[t, m][None], starts[t, k], ends[t, k])[0]
            radius = min(radii[k], own - 0.01)
            gap = _to_segment(eye + along * (points[t, m] - eye), starts[t, k], ends[t, k]).min()
            nearest.append(gap - radius if radius > 0 else np.inf)
        margin = np.nanmin(nearest)
        if abs(margin) > 1e-4:
            assert out[t, m] == (margin < 0)


def _to_segment(points: Floats, start: Floats, end: Floats) -> Floats:
    share = np.clip((points - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
    return np.linalg.norm(points - start - share[:, None] * (end - start), axis=1)


@given(st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_merge_equals_connected_components(seed: int) -> None:
    rng = np.random.default_rng(seed)
    offsets = np.array([0, 7, 7, 30])
    xy, sizes = rng.uniform(0, 40, (30, 2)), rng.uniform(2, 9, 30)
    out = np.empty(30, dtype=np.int64)
    _kernels.merge(offsets, xy, sizes, out)
    cell = np.repeat([0, 1, 2], np.diff(offsets))
    near = np.linalg.norm(xy[:, None] - xy, axis=2) < 0.5 * (sizes[:, None] + sizes)
    heap = connected_components(near & (cell[:, None] == cell))[1]
    assert np.array_equal(out, [np.nonzero(heap == h)[0][0] for h in heap])


def test_two_markers_in_a_line_with_a_camera_become_one_blob_between_them() -> None:
    rig = ring_rig(2, height=0.9)
    pair = [[[0.0, 0, 0.9], [0.3, 0.004, 0.9]]]
    blobs, identity = simulate_blobs(rig, pair, ImagingSettings(noise=0.0), rng=np.random.default_rng(0))
    assert identity.tolist() == [MERGED, MERGED]
    apart, _ = simulate_blobs(rig, pair, ImagingSettings(noise=0.0, merging=False), rng=np.random.default_rng(0))
    low, high = apart.of(0, 0).min(axis=0), apart.of(0, 0).max(axis=0)
    assert ((low <= blobs.of(0, 0)[0]) & (blobs.of(0, 0)[0] <= high)).all()
    assert blobs.sizes[0] > apart.sizes.min()


def test_a_late_camera_shows_where_the_marker_has_got_to() -> None:
    rig = ring_rig(2)
    time = np.arange(200) / 100
    points = np.stack([0.5 * time - 0.5, 0.1 * time, 0.9 + 0 * time], axis=1)[:, None]
    blobs, _ = simulate_blobs(rig, points, ImagingSettings(noise=0.0, delays=[0.0, 0.0035]), rng=np.random.default_rng(0))
    assert blobs.times is not None
    assert np.allclose(blobs.times[:, 1] - time, 0.0035)
    late = rig[1].project(points[:, 0] + 0.0035 * np.array([0.5, 0.1, 0]))
    assert np.abs(blobs.xy[blobs.camera_of == 1] - late).max() < 1e-6


def test_a_body_hides_a_walkers_markers_and_leaves_most_of_them() -> None:
    """Seen from all sides a marker on the skin is visible from about half of the directions; without its body, from all."""
    walk = simulate_walks(1, frames=60, markers="plug-in-gait", seed=1)[0]
    rig = ring_rig(8, radius=5.0, size=(2048, 2048), focal=900)
    shares = [
        np.bincount(identity, minlength=len(walk.labels)) / (60 * 8)
        for identity in (
            simulate_blobs(rig, walk.positions, ImagingSettings(merging=False), body=body, rng=np.random.default_rng(0))[1]
            for body in (None, walker_capsules(walk))
        )
    ]
    assert shares[0].min() > 0.99
    assert 0.5 < shares[1].mean() < 0.8
    assert shares[1].min() > 0.3, f"{walk.labels[shares[1].argmin()]} is seen from {shares[1].min():.0%} of the directions"


def test_a_real_walk_with_clusters_has_a_body(data) -> None:
    import asterism

    walk = asterism.read(data / "cameras" / "vicon-rig-walk" / "walking_1.c3d")
    body = walker_capsules(walk)
    assert {"thigh", "shank", "foot", "trunk", "head"} <= set(body.names)
    thighs = [i for i, name in enumerate(body.names) if name == "thigh"]
    length = np.nanmean(np.linalg.norm(body.starts - body.ends, axis=2), axis=0)[thighs]
    assert ((length > 0.33) & (length < 0.50)).all(), length


def test_a_subjects_name_before_the_markers_changes_nothing() -> None:
    walk = simulate_walks(1, frames=5, seed=1)[0]
    named = replace(walk, labels=tuple(f"Ann:{name}" for name in walk.labels))
    assert np.array_equal(walker_capsules(named).ends, walker_capsules(walk).ends, equal_nan=True)


def test_markers_without_a_pelvis_have_no_body() -> None:
    with pytest.raises(AsterismError, match="pelvis"):
        walker_capsules(Recording(np.zeros((3, 1, 3)), ("LKNE",), 100.0, "z"))


@pytest.mark.parametrize("gaussian", [False, True])
def test_blobs_are_drawn_as_by_the_twin(gaussian: bool) -> None:
    """The twin looks at every pixel of the image, not only at those near a blob; a Gaussian is cut off where it is 0.2 % of its height."""
    rng = np.random.default_rng(1)
    xy, sizes = rng.uniform(-3, 43, (12, 2)), rng.uniform(2, 9, 12)
    image = np.full((40, 40), 5.0)
    _kernels.draw(xy, sizes, gaussian, 200.0, image)
    row, column = np.mgrid[:40, :40]
    away = np.hypot(column - xy[:, 0, None, None], row - xy[:, 1, None, None])
    radius = 0.5 * sizes[:, None, None]
    light = 200.0 * (0.5 ** ((away / radius) ** 2) if gaussian else np.clip(radius + 0.5 - away, 0, 1))
    assert np.allclose(image, np.maximum(light.max(axis=0), 5.0), atol=200 * 0.002)


@pytest.mark.parametrize("bits", [8, 12])
@pytest.mark.parametrize("shape", ["disc", "gaussian"])
def test_rendered_blobs_have_their_centroids_where_the_blobs_are(bits: int, shape: str) -> None:
    rig = ring_rig(1, size=(640, 480))
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (3, 1, 3)) + np.array([0, 0, 0.9])
    blobs, _ = simulate_blobs(rig, points, ImagingSettings(noise=0.0, diameter=0.04), rng=np.random.default_rng(0))
    images = list(
        render_images(blobs, 0, (640, 480), RenderSettings(shape=shape, bits=bits, noise=0.0, background=0.0), rng=np.random.default_rng(0))
    )
    assert images[0].dtype == (np.uint8 if bits == 8 else np.uint16)
    assert images[0].shape == (480, 640)
    for t, image in enumerate(images):
        row, column = np.nonzero(image)
        weight = image[row, column].astype(float)
        centroid = np.array([column @ weight, row @ weight]) / weight.sum()
        assert np.abs(centroid - blobs.of(t, 0)[0]).max() < 0.03
    noisy = next(render_images(blobs, 0, (640, 480), RenderSettings(shape=shape, bits=bits, noise=0.02), rng=np.random.default_rng(0)))
    dark = noisy[:100, :100].astype(float) / (2**bits - 1)
    assert abs(dark.std() - 0.02) < 0.003
    assert abs(dark.mean() - 0.06) < 0.002


def test_a_reflection_stays_where_it_is() -> None:
    settings, nothing = ImagingSettings(reflections=1, noise=0.2), np.full((50, 1, 3), np.nan)
    blobs, identity = simulate_blobs(ring_rig(2), nothing, settings, rng=np.random.default_rng(0))
    assert (identity == STRAY).all()
    assert (blobs.counts <= 1).all()
    own = blobs.xy[blobs.camera_of == 0]
    assert len(own) == 0 or own.std(axis=0).max() < 0.1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"settings": ImagingSettings(noise=-1.0)}, "noise"),
        ({"settings": ImagingSettings(dropped=1.5)}, "dropped"),
        ({"settings": ImagingSettings(delays=[0.1])}, "delays"),
        ({"body": _one_capsule([0, 0, 0], [0, 0, 1], 0.1, frames=2)}, "frames"),
        ({"positions": np.zeros((1, 2, 2))}, "shape"),
    ],
)
def test_arguments_out_of_range_are_refused(change: dict, message: str) -> None:
    with pytest.raises(AsterismError, match=message):
        simulate_blobs(ring_rig(3), **({"positions": np.zeros((1, 1, 3)), "rng": np.random.default_rng(0)} | change))


def test_a_camera_without_an_image_size_is_named() -> None:
    rig = ring_rig(2)
    blind = Rig((rig[0], replace(rig[1], size=None)))
    with pytest.raises(AsterismError, match="camera c2"):
        simulate_blobs(blind, np.zeros((1, 1, 3)), rng=np.random.default_rng(0))


def test_cameras_back_to_back_have_no_volume_for_a_wand() -> None:
    rig = ring_rig(2, radius=1.0, height=0.9, focal=5000)
    turned = np.diag([-1.0, 1.0, -1.0])
    away = Rig(tuple(replace(c, rotation=turned @ c.rotation, translation=turned @ c.translation) for c in rig))
    with pytest.raises(AsterismError, match="turn them"):
        simulate_wand(away, frames=10, rng=np.random.default_rng(0))
