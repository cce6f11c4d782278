"""Wand calibration against simulated rigs whose truth is known, and against what people feed it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import twins_wand
from cold_starts import few_starts
from computed import computed

from asterism.calibration.wand import (
    WandCalibration,
    in_world,
    initialise,
    two_view,
    world_from_floor_wand,
    world_from_l_frame,
    world_from_points,
)
from asterism.calibration.wand import calibrate_wand as calibrate_anew
from asterism.calibration.wand.identify import identify, wand_of
from asterism.calibration.wand.poses import WandPoses, locate_wand
from asterism.calibration.wand.synchronise import estimate_lags
from asterism.cameras import Camera, Rig
from asterism.cameras.aim import looking
from asterism.cameras.bundle import Sightings, locate
from asterism.errors import AsterismError
from asterism.geometry import rotation_from_vector
from asterism.recording import Blobs
from asterism.simulation.cameras import ImagingSettings, random_rig, ring_rig, simulate_blobs, simulate_wand

WAND = (0.0, 0.2, 0.6)
SIZE = (1280, 1024)


@pytest.fixture
def cold_start() -> None:
    """Asked for by tests of the cold start itself: they begin from all pairs and focal lengths."""


@pytest.fixture(autouse=True)
def _few_starts(request: pytest.FixtureRequest) -> Iterator[None]:
    if "cold_start" in request.fixturenames:
        yield
        return
    with few_starts():
        yield


def rng_of(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def a_rig(cameras: int = 4, seed: int = 1) -> Rig:
    return ring_rig(cameras, rng=rng_of(seed))


def calibrate_wand(blobs: Blobs, lengths: object, **settings: object) -> WandCalibration:
    """What `calibrate_anew` gives; a second or two for most rigs, so that it is worked out once for the same sources."""
    return computed(calibrate_anew, blobs, lengths, beside=(initialise.RULES, two_view.RULES), **settings)


@cache
def waved(
    cameras: int = 4, frames: int = 250, seed: int = 2, outliers: float = 0.0, lengths: tuple[float, ...] = WAND
) -> tuple[Rig, Blobs]:
    rig = a_rig(cameras)
    return rig, simulate_wand(rig, lengths, frames, settings=ImagingSettings(noise=0.2, outliers=outliers), rng=rng_of(seed), rate=20.0)[0]


@cache
def calibrated() -> tuple[Rig, WandCalibration]:
    rig, blobs = waved()
    return rig, calibrate_wand(blobs, WAND, sizes=SIZE)


def unseen_error(rig: Rig, found: Rig, scaled: bool = False) -> float:
    """m, RMS over points in the middle of the volume that the calibration has not seen, after laying one world on the other."""
    points = rng_of(9).uniform([-0.8, -0.8, 0.3], [0.8, 0.8, 1.6], (200, 3))
    xy = np.stack([rig[name].project(points) for name in found.names], axis=1)[:, :, None]
    there = locate(found.cameras, Sightings.from_array(xy), 200, 1)[:, 0]
    a, b = points - points.mean(axis=0), there - there.mean(axis=0)
    u, sizes, vt = np.linalg.svd(a.T @ b)
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    scale = sizes.sum() / np.square(b).sum() if scaled else 1.0
    return float(np.sqrt(np.square(a - scale * b @ turn.T).sum(axis=1).mean()))


def focal_error(rig: Rig, found: Rig) -> float:
    return max(abs(camera.focal[0] / rig[camera.name].focal[0] - 1) for camera in found)


def edited(blobs: Blobs, edit: Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Blobs:
    """The blobs with rows of frame, camera, xy changed by `edit`."""
    frame, camera, xy = edit(blobs.frame_of.copy(), blobs.camera_of.copy(), blobs.xy.copy())
    good = (frame >= 0) & (frame < len(blobs))
    return Blobs.from_rows(frame[good], camera[good], xy[good], blobs.cameras, rate=blobs.rate, frames=len(blobs))


def sentences(made: WandCalibration) -> str:
    return " ".join(str(finding) for finding in made.findings)


@pytest.mark.usefixtures("cold_start")
def test_a_ring_is_found_from_nothing() -> None:
    rig, blobs = waved()
    made = calibrate_wand(blobs, WAND, sizes=SIZE)
    assert made.usable, sentences(made)
    assert focal_error(rig, made.rig) < 0.002
    assert unseen_error(rig, made.rig) < 0.0005
    assert made.noise == pytest.approx(0.2, rel=0.05)
    assert np.nanmean(made.lengths) == pytest.approx(0.6, abs=2e-4)
    assert np.nanstd(made.lengths) < 0.002


def test_the_same_again_bit_for_bit() -> None:
    _, blobs = waved()
    again = calibrate_anew(blobs, WAND, sizes=SIZE)
    assert all(np.array_equal(a.lens, b.lens) for a, b in zip(again.rig, calibrated()[1].rig, strict=True))
    assert all(np.array_equal(a.translation, b.translation) for a, b in zip(again.rig, calibrated()[1].rig, strict=True))


@pytest.mark.usefixtures("cold_start")
@pytest.mark.parametrize("seed", [3, pytest.param(20, marks=pytest.mark.slow)])
def test_rigs_of_all_kinds_with_outliers(seed: int) -> None:
    rng = rng_of(seed)
    rig = random_rig(rng=rng)
    blobs = simulate_wand(
        rig,
        WAND,
        300,
        settings=ImagingSettings(noise=0.2, outliers=0.05, strays=0.1, missed=0.02, dropped=0.01, reflections=1),
        rng=rng,
        rate=20.0,
    )[0]
    made = calibrate_wand(blobs, WAND, sizes={camera.name: camera.size for camera in rig})
    assert len(made.rig) == len(rig)
    assert made.usable, sentences(made)
    assert unseen_error(rig, made.rig) < 0.002


def test_an_unlucky_first_look_is_not_believed() -> None:
    """What single images take for the wand is right nearly always, and what cameras agree on is right always."""
    rig = a_rig(5)
    blobs, truth = simulate_wand(rig, WAND, 200, settings=ImagingSettings(noise=0.2, outliers=0.1, strays=1.0), rng=rng_of(4), rate=20.0)
    wand = wand_of(WAND)
    detections = identify(blobs, wand)
    shown = (detections >= 0).all(axis=2)
    wrong = (truth.identity[detections[shown]] != np.arange(3)).any(axis=1).mean()
    assert 0 < wrong < 0.06
    poses = locate_wand(blobs, detections, wand, list(rig), 2.0)
    used = poses.observations >= 0
    assert (truth.identity[poses.observations[used]] == np.nonzero(used)[2]).mean() > 0.998
    assert used.sum() > 0.96 * (truth.identity >= 0).sum()


@pytest.mark.parametrize("middle", [0.2, 0.28], ids=["ratio", "alike from both ends"])
def test_the_wand_in_each_image_equals_the_plain_search(middle: float) -> None:
    blobs, _ = simulate_wand(
        a_rig(3), (0.0, middle, 0.6), 60, settings=ImagingSettings(noise=0.2, outliers=0.1, strays=2.0), rng=rng_of(21)
    )
    wand = wand_of([0.0, middle, 0.6])
    detections = identify(blobs, wand)
    for t in range(len(blobs)):
        for c in range(3):
            plain = twins_wand.find_wand(blobs.of(t, c), middle / 0.6, wand.symmetric)
            first = blobs.offsets[3 * t + c]
            assert (detections[t, c].tolist() == [-1] * 3) if plain is None else ((detections[t, c] - first).tolist() == plain)


@pytest.mark.parametrize(
    "lengths", [(0.0, 0.2, 0.6), (0.0, 0.28, 0.6), (0.0, 0.5), (0.0,)], ids=["three", "alike from both ends", "two", "one"]
)
@pytest.mark.parametrize("unposed", [None, 0], ids=["all posed", "one not posed"])
def test_what_cameras_agree_on_equals_the_plain_search_in_all_frames(lengths: tuple[float, ...], unposed: int | None) -> None:
    rig = a_rig(4)
    strays = 1.0 if len(lengths) == 3 else 0.1
    blobs, _ = simulate_wand(rig, lengths, 40, settings=ImagingSettings(noise=0.2, outliers=0.1, strays=strays), rng=rng_of(22))
    wand, cameras = wand_of(lengths), [None if c == unposed else camera for c, camera in enumerate(rig)]
    detections = identify(blobs, wand)
    poses = locate_wand(blobs, detections, wand, cameras, 6.0)
    plain = twins_wand.locate_wand(blobs, detections, wand, cameras, 6.0)
    for t, (start, direction, observations) in enumerate(plain):
        assert np.array_equal(poses.observations[t], observations), f"frame {t}"
        assert np.allclose(poses.starts[t], start, atol=1e-7, equal_nan=True), f"frame {t}"
        assert np.allclose(poses.directions[t], direction, atol=1e-6, equal_nan=True), f"frame {t}"
    located = np.isfinite(poses.starts[:, 0])
    assert located.sum() > 20, "the search finds the wand"


def test_the_ratio_tells_the_ends_apart_in_perspective_too() -> None:
    """A wand that points at the camera: the near part looks longer, and still the short arm is known."""
    camera = Camera("one", SIZE, (1100.0, 1100.0), (640.0, 512.0))
    along = np.array([0.5, 0.1, 0.86]) / np.linalg.norm([0.5, 0.1, 0.86])
    for way in (1, -1):
        points = np.array([0.0, 0.0, 2.0]) + way * along * (np.array(WAND)[:, None] - 0.3)
        xy = camera.project(points)
        blobs = Blobs.from_rows([0, 0, 0], [0, 0, 0], xy[[2, 0, 1]], ["one"])
        assert identify(blobs, wand_of(WAND))[0, 0].tolist() == [1, 2, 0]


@pytest.mark.usefixtures("cold_start")
@pytest.mark.parametrize("lengths", [(0.0, 0.5), (0.0, 0.25, 0.5)], ids=["two markers", "alike from both ends"])
def test_wands_that_look_alike_from_both_ends(lengths: tuple[float, ...]) -> None:
    rig, blobs = waved(4, 250, 5, 0.01, lengths)
    made = calibrate_wand(blobs, lengths, sizes=SIZE)
    assert made.usable, sentences(made)
    assert len(made.rig) == 4
    assert unseen_error(rig, made.rig) < 0.001


@pytest.mark.usefixtures("cold_start")
def test_one_moved_marker_gives_the_rig_up_to_scale_and_a_distance_the_scale() -> None:
    rig, blobs = waved(8, 350, 6, 0.01, (0.0,))
    distance = float(np.linalg.norm(rig[0].position - rig[1].position))
    made = calibrate_wand(blobs, [0.0], sizes=SIZE, distance=(rig[0].name, rig[1].name, distance))
    assert made.usable, sentences(made)
    assert unseen_error(rig, made.rig) < 0.008
    without = calibrate_wand(blobs, [0.0], sizes=SIZE)
    assert not without.usable
    assert "no size" in sentences(without)
    assert unseen_error(rig, without.rig, scaled=True) < 0.008


def test_known_lenses_help() -> None:
    rig, blobs = waved()
    made = calibrate_wand(blobs, WAND, known=rig)
    assert unseen_error(rig, made.rig) < 0.0005


def test_cameras_that_are_not_triggered_together() -> None:
    """Delays of up to half a frame at 100 frames per second: without the times the wand would bend by centimetres."""
    rig = a_rig(4)
    delays = np.array([0.0, 0.003, -0.002, 0.004])
    blobs, _ = simulate_wand(rig, WAND, 800, settings=ImagingSettings(noise=0.2, delays=delays), rng=rng_of(7), rate=100.0)
    made = calibrate_wand(blobs, WAND, sizes=SIZE)
    assert made.usable, sentences(made)
    assert made.noise < 0.25
    assert unseen_error(rig, made.rig) < 0.001
    careless = calibrate_wand(replace(blobs, times=None), WAND, sizes=SIZE)
    assert "frames late" in sentences(careless) and "Check its trigger" in sentences(careless)


@pytest.mark.parametrize("late", [pytest.param(-3, marks=pytest.mark.slow), 5, pytest.param(61, marks=pytest.mark.slow)])
def test_a_camera_out_of_step_is_named_and_its_images_moved(late: int) -> None:
    rig = a_rig(4)
    blobs, _ = simulate_wand(rig, WAND, 800, rng=rng_of(8), rate=100.0)
    mixed = edited(blobs, lambda frame, camera, xy: (np.where(camera == 2, frame - late, frame), camera, xy))
    made = calibrate_wand(mixed, WAND, sizes=SIZE)
    assert made.lag_frames.tolist() == [0, 0, late, 0]
    assert f"camera {rig[2].name} started {abs(late)} frames {'late' if late > 0 else 'early'}" in sentences(made)
    assert unseen_error(rig, made.rig) < 0.001


def test_two_cameras_out_of_step_hide_nothing() -> None:
    """What a lag moves lies nearly all along the epipolar lines of two cameras, where the place of the wand takes it in."""
    rig = a_rig(2, 5)
    blobs, _ = simulate_wand(rig, WAND, 600, rng=rng_of(6), rate=60.0)
    mixed = edited(blobs, lambda frame, camera, xy: (np.where(camera == 1, frame - 1, frame), camera, xy))
    made = calibrate_wand(mixed, WAND, sizes=SIZE)
    assert made.lag_frames.tolist() == [0, 1]
    assert unseen_error(rig, made.rig) < 0.002


@pytest.mark.parametrize("lengths", [WAND, (0.0, 0.25, 0.5)], ids=["ratio", "alike from both ends"])
def test_a_part_of_a_frame_is_measured_and_mended(lengths: tuple[float, ...]) -> None:
    rig = a_rig(3)
    delays = np.array([0.0, 0.004, 0.0])
    blobs, _ = simulate_wand(rig, lengths, 600, settings=ImagingSettings(noise=0.2, delays=delays), rng=rng_of(17), rate=100.0)
    made = calibrate_wand(replace(blobs, times=None), lengths, sizes=SIZE)
    assert made.usable, sentences(made)
    said = re.search(rf"camera {rig[1].name} takes its images (\S+) frames late", sentences(made))
    assert said and abs(float(said[1]) - 0.4) < 0.06
    assert unseen_error(rig, made.rig) < 0.001


def test_lags_are_told_though_the_ends_of_a_wand_change_from_frame_to_frame() -> None:
    """A wand that looks alike from both ends may be named either way in each frame: its markers do not jump for that."""
    rig, wand = a_rig(4), wand_of((0.0, 0.25, 0.5))
    blobs, _ = simulate_wand(
        rig, (0.0, 0.25, 0.5), 300, settings=ImagingSettings(noise=0.2, delays=np.array([0.0, 0.003, 0.0, 0.0])), rng=rng_of(30), rate=100.0
    )
    found = locate_wand(blobs, identify(blobs, wand), wand, list(rig), 15.0)
    turned = rng_of(31).random(300) < 0.5
    starts = np.where(turned[:, None], found.starts + 0.5 * found.directions, found.starts)
    directions = np.where(turned[:, None], -found.directions, found.directions)
    named = WandPoses(starts, directions, np.where(turned[:, None, None], found.observations[:, :, ::-1], found.observations))
    late, spread = estimate_lags(list(rig), wand, named.sightings(blobs), starts, directions)
    assert np.abs(late - [0.0, 0.3, 0.0, 0.0]).max() < 0.02
    assert spread.max() < 0.01


def test_a_camera_that_loses_frames_is_named() -> None:
    rig = a_rig(4)
    blobs, _ = simulate_wand(rig, WAND, 800, rng=rng_of(18), rate=100.0)
    lost = edited(blobs, lambda frame, camera, xy: (np.where((camera == 2) & (frame > 400), frame - 1, frame), camera, xy))
    made = calibrate_wand(lost, WAND, sizes=SIZE)
    assert not made.usable
    assert re.search(rf"camera {rig[2].name} takes its images (0\.[789]|1\.\d) frames later in the last third", sentences(made)), sentences(
        made
    )


def test_times_may_be_missing_where_a_camera_saw_nothing() -> None:
    rig = a_rig(4)
    blobs, _ = simulate_wand(
        rig, WAND, 700, settings=ImagingSettings(noise=0.2, delays=np.array([0.0, 0.006, -0.004, 0.008])), rng=rng_of(28), rate=50.0
    )
    times = np.where(rng_of(29).random((700, 4)) < 0.1, np.nan, blobs.times)
    times[0, 1] = times[-1, 2] = np.nan
    made = calibrate_wand(replace(blobs, times=times), WAND, sizes=SIZE)
    assert made.usable, sentences(made)
    assert unseen_error(rig, made.rig) < 0.001
    times[:, 3] = np.nan
    with pytest.raises(AsterismError, match=f"camera {rig[3].name}: its rows have no times"):
        calibrate_wand(replace(blobs, times=times), WAND, sizes=SIZE)


def test_times_do_not_turn_a_wand_around_that_was_out_of_sight() -> None:
    """Which end is which is told by each image; from the image before only where wands look alike from both ends."""
    rig = a_rig(4)
    blobs, _ = simulate_wand(
        rig, WAND, 500, settings=ImagingSettings(noise=0.2, delays=np.zeros(4), dropped=0.1), rng=rng_of(19), rate=15.0
    )
    step = np.diff(blobs.times[:, 0]).min()
    staggered = replace(blobs, times=blobs.times + 0.002 * step * np.arange(4))
    made = calibrate_wand(staggered, WAND, sizes=SIZE)
    assert made.usable, sentences(made)
    assert made.mean_rejected_share < 0.05


@pytest.mark.usefixtures("cold_start")
def test_cameras_that_saw_nothing_or_share_no_view_are_named_and_the_rest_is_calibrated() -> None:
    rig, blobs = waved(6, 400, 10)

    def lost(frame: np.ndarray, camera: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        # camera 1 is dark; camera 4 sees only what nobody else sees
        gone = (camera == 1) | ((camera == 4) & (frame < 300)) | ((camera != 4) & (frame >= 300))
        return np.where(gone, -1, frame), camera, xy

    made = calibrate_wand(edited(blobs, lost), WAND, sizes=SIZE)
    assert set(made.excluded) == {rig[1].name, rig[4].name}
    assert "saw nothing" in made.excluded[rig[1].name][0]
    assert "shares only" in made.excluded[rig[4].name][0]
    assert unseen_error(rig, made.rig) < 0.001


@pytest.mark.usefixtures("cold_start")
def test_a_chain_of_cameras_in_which_each_sees_the_wand_with_its_neighbours_only() -> None:
    """No place is seen by three cameras, so that no camera can be posed from points; the hall is far longer than wide, and not a line."""
    cameras = []
    for c in range(4):
        rotation, translation = looking(np.array([3.2 * c, -4.0, 2.0]), np.array([3.2 * c, 0.0, 1.0]))
        cameras.append(Camera(f"c{c}", SIZE, (1020.0, 1020.0), (645.0, 508.0), rotation, translation, (-0.1, 0.01)))
    rng = rng_of(22)
    middle = rng.uniform([-0.5, -0.8, 0.4], [10.0, 1.0, 1.8], (700, 3))
    along = rng.normal(size=(700, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    points = middle[:, None] + along[:, None] * (np.array(WAND)[:, None] - 0.3)
    rig = Rig(tuple(cameras), vertical=np.array([0.0, 0.0, 1.0]))
    blobs, _ = simulate_blobs(rig, points, ImagingSettings(noise=0.2), rng=rng)
    assert ((blobs.counts == 3).sum(axis=1) <= 2).all()
    made = calibrate_wand(blobs, WAND, sizes=SIZE)
    assert made.usable, sentences(made)
    assert made.rig.names == rig.names
    far = np.linalg.norm(made.rig["c0"].position - made.rig["c3"].position)
    assert abs(far - 9.6) < 0.05


def test_lights_that_never_move_are_no_wand() -> None:
    rig, blobs = waved(4, 400)
    lamps = np.array([[300.0, 300.0], [333.0, 366.0], [400.0, 500.0]])
    frame, camera, lamp = (part.ravel() for part in np.meshgrid(np.arange(400), np.arange(4), np.arange(3), indexing="ij"))
    xy = lamps[lamp] + rng_of(23).normal(0.0, 0.05, (len(lamp), 2))
    both = [np.concatenate(part) for part in ((blobs.frame_of, frame), (blobs.camera_of, camera), (blobs.xy, xy))]
    made = calibrate_wand(Blobs.from_rows(*both, rig.names, frames=400), WAND, sizes=SIZE)
    assert made.static_lights.tolist() == [3, 3, 3, 3]
    assert unseen_error(rig, made.rig) < 0.0008
    with pytest.raises(AsterismError, match="never moves"):
        calibrate_wand(Blobs.from_rows(frame, camera, xy, rig.names), WAND, sizes=SIZE)


def test_two_markers_are_found_beside_lights_that_never_move() -> None:
    rig = a_rig(4)
    blobs, _ = simulate_wand(rig, (0.0, 0.5), 400, settings=ImagingSettings(noise=0.2, reflections=2), rng=rng_of(24), rate=20.0)
    made = calibrate_wand(blobs, (0.0, 0.5), sizes=SIZE)
    assert made.usable, sentences(made)
    assert unseen_error(rig, made.rig) < 0.001


def test_one_marker_before_two_cameras_is_not_enough() -> None:
    rig = a_rig(2)
    blobs, _ = simulate_wand(rig, (0.0,), 400, rng=rng_of(25), rate=20.0)
    apart = float(np.linalg.norm(rig[0].position - rig[1].position))
    made = calibrate_wand(blobs, (0.0,), sizes=SIZE, distance=(*rig.names, apart))
    assert not made.usable
    assert "hardly determines their lenses" in sentences(made)


@pytest.mark.parametrize(
    ("waved_with", "given", "message"),
    [
        (WAND, (0.0, 0.6), "only .* images show the 2 markers of the wand; most show 3 blobs"),
        ((0.0, 0.6), WAND, "only 0 images show the 3 markers of the wand; most show 2 blobs"),
        ((0.0, 0.3, 0.6), WAND, r"inner of three markers sits at 0\.4\d of the length, by the wand's lengths it should at 0\.33"),
    ],
)
def test_another_wand_than_the_one_given_is_said(waved_with: tuple[float, ...], given: tuple[float, ...], message: str) -> None:
    with pytest.raises(AsterismError, match=message):
        calibrate_wand(waved(4, 250, 5, 0.0, waved_with)[1], given, sizes=SIZE)


@pytest.mark.parametrize(
    ("lengths", "message"),
    [
        ((0.0, 200.0, 600.0), r"millimetres; give metres: 0 0\.2 0\.6"),
        ((0.0, 20.0, 60.0), "centimetres"),
        ((0.0, 0.2, 0.4, 0.6), "4 markers"),
        ((0.0, 0.0, 0.6), "one place"),
        ((0.0, np.nan), "markers"),
        ((0.0, 0.001), "too short"),
    ],
)
def test_impossible_wands_are_refused(lengths: tuple[float, ...], message: str) -> None:
    with pytest.raises(AsterismError, match=message):
        calibrate_wand(waved()[1], lengths, sizes=SIZE)


def test_markers_given_in_another_order_are_the_same_wand() -> None:
    assert wand_of([0.6, 0.0, 0.2]).lengths.tolist() == [0.0, 0.2, 0.6]
    rig, blobs = waved()
    assert unseen_error(rig, calibrate_wand(blobs, [0.0, 0.4, 0.6], sizes=SIZE).rig) < 0.0005, "the same, from the other end"


def test_a_wrong_inner_marker_is_noticed() -> None:
    made = calibrate_wand(waved()[1], [0.0, 0.22, 0.6], sizes=SIZE)
    assert "inner marker" in sentences(made)
    with pytest.raises(
        AsterismError, match=r"inner of three markers sits at 0\.3\d of the length, by the wand's lengths it should at 0\.08"
    ):
        calibrate_wand(waved()[1], [0.0, 0.05, 0.6], sizes=SIZE)


def test_a_wand_waved_in_a_plane_is_not_trusted() -> None:
    rig = a_rig(4)
    rng = rng_of(11)
    angle, middle = rng.uniform(0, 2 * np.pi, 300), rng.uniform(-0.8, 0.8, (300, 2))
    along = np.stack([np.cos(angle), np.sin(angle), np.zeros(300)], axis=1)
    points = np.concatenate([middle, np.full((300, 1), 1.0)], axis=1)[:, None] + along[:, None] * (np.array(WAND)[:, None] - 0.3)
    blobs, _ = simulate_blobs(rig, points, ImagingSettings(noise=0.2), rng=rng)
    made = calibrate_wand(blobs, WAND, sizes=SIZE)
    assert not made.usable
    assert "in a plane only" in sentences(made)


def test_blobs_outside_the_image_are_refused() -> None:
    with pytest.raises(AsterismError, match="outside its image of 640 x 480 px"):
        calibrate_wand(waved()[1], WAND, sizes=(640, 480))


def test_an_image_size_that_differs_from_the_rigs_is_refused() -> None:
    rig, blobs = waved()
    with pytest.raises(AsterismError, match="image size given is 1280 x 960, but the rig says 1280 x 1024"):
        calibrate_wand(blobs, WAND, sizes=(1280, 960), known=rig)
    with pytest.raises(AsterismError, match="size of its images is not known"):
        calibrate_wand(blobs, WAND)


def bumped(cameras: int, turn: float, at: int, frames: int = 400) -> tuple[Rig, Blobs]:
    """A rig whose second camera is turned by so many radians at frame `at`, and what it saw of a wand."""
    rig = a_rig(cameras)
    axis = rotation_from_vector(turn * np.array([0.37, 0.93, 0.0]))
    turned = replace(rig[1], rotation=axis @ rig[1].rotation, translation=axis @ rig[1].translation)
    later = replace(rig, cameras=(rig[0], turned, *rig.cameras[2:]))
    both = [simulate_wand(of, WAND, frames, rng=rng_of(2), rate=20.0)[0] for of in (rig, later)]
    parts = [(blobs.frame_of, blobs.camera_of, blobs.xy, blobs.frame_of >= at) for blobs in both]
    parts = [tuple(part[late == n] for part in rest) for n, (*rest, late) in enumerate(parts)]
    frame, camera, xy = (np.concatenate(part) for part in zip(*parts, strict=True))
    return rig, Blobs.from_rows(frame, camera, xy, rig.names, frames=frames)


def test_a_camera_moved_while_recording_is_named() -> None:
    rig, blobs = bumped(4, 0.011, 150, 250)
    made = calibrate_wand(blobs, WAND, sizes=SIZE)
    assert not made.usable
    assert re.search(f"(what )?camera {rig[1].name} (saw contradicts the others|sees things)", sentences(made)), sentences(made)


def test_a_slight_turn_is_seen_in_the_order_of_residuals() -> None:
    """A fifth of a degree: the reprojection error hardly shows it."""
    rig, blobs = bumped(3, 0.0035, 200)
    made = calibrate_wand(blobs, WAND, sizes=SIZE)
    assert made.rms < 0.5
    said = re.search(rf"camera {rig[1].name} sees things (\S+) px elsewhere after (\d+) % of the recording", sentences(made))
    assert said and abs(int(said[2]) - 50) <= 10, sentences(made)
    still = calibrate_wand(bumped(3, 0.0, 200)[1], WAND, sizes=SIZE)
    assert still.usable and "moved" not in sentences(still)


def test_a_camera_moved_at_the_end_is_not_delivered_where_it_stood() -> None:
    rig, blobs = bumped(4, 0.02, 360)
    made = calibrate_wand(blobs, WAND, sizes=SIZE)
    assert not made.usable
    assert f"camera {rig[1].name} saw contradicts the others, most of it between 90 and 100 %" in sentences(made)


def test_a_camera_noisier_than_the_others_is_not_accused() -> None:
    rig, blobs = waved(4, 400)
    rng = rng_of(21)

    def shaken(frame: np.ndarray, camera: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return frame, camera, xy + np.where(camera == 3, 1.0, 0.0)[:, None] * rng.normal(size=xy.shape)

    made = calibrate_wand(edited(blobs, shaken), WAND, sizes=SIZE)
    assert made.usable, sentences(made)
    assert made.rejected_share.max() < 0.02
    assert unseen_error(rig, made.rig) < 0.0008


@pytest.mark.usefixtures("cold_start")
def test_a_mirrored_camera_is_left_out_and_named() -> None:
    rig, blobs = waved(5)

    def mirror(frame: np.ndarray, camera: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        xy[camera == 3, 0] = 1279 - xy[camera == 3, 0]
        return frame, camera, xy

    made = calibrate_wand(edited(blobs, mirror), WAND, sizes=SIZE)
    assert set(made.excluded) == {rig[3].name}
    assert "mirrored" in made.excluded[rig[3].name][1]
    assert unseen_error(rig, made.rig) < 0.001


def test_empty_recordings_are_refused() -> None:
    with pytest.raises(AsterismError, match="0 images show"):
        calibrate_wand(Blobs.from_rows([], [], np.empty((0, 2)), ["a", "b"], frames=100), WAND, sizes=SIZE)


def test_a_wrong_image_size_is_seen_in_the_principal_points() -> None:
    assert "Check the image size." in sentences(calibrate_wand(waved()[1], WAND, sizes=(1920, 1080)))
    assert "image size" not in sentences(calibrated()[1])


def test_a_wand_that_stayed_in_one_place_says_nothing_about_others() -> None:
    rig = a_rig(4)
    rng = rng_of(26)
    along = rng.normal(size=(250, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    points = rng.uniform(0.9, 1.1, (250, 3))[:, None] + along[:, None] * (np.array(WAND)[:, None] - 0.3)
    made = calibrate_wand(simulate_blobs(rig, points, ImagingSettings(noise=0.2), rng=rng)[0], WAND, sizes=SIZE)
    assert re.search(r"stayed in a small part of the volume, 0\.\d x 0\.\d x 0\.\d m", sentences(made)), sentences(made)


def test_one_camera_is_refused() -> None:
    _, blobs = waved()
    own = blobs.camera_of == 0
    with pytest.raises(AsterismError, match="one camera"):
        calibrate_wand(Blobs.from_rows(blobs.frame_of[own], np.zeros(own.sum(), int), blobs.xy[own], ["one"]), WAND, sizes=SIZE)


def test_noise_is_no_wand() -> None:
    rng = rng_of(12)
    cells = np.repeat(np.arange(400), 3)
    blobs = Blobs.from_rows(cells // 2, cells % 2, rng.uniform(0, 1000, (1200, 2)), ["a", "b"])
    with pytest.raises(AsterismError):
        calibrate_wand(blobs, WAND, sizes=SIZE)


def test_contradictions_are_not_delivered_as_a_rig() -> None:
    """Each camera's frames shuffled by themselves: every image shows a wand, and no two the same one."""
    _, blobs = waved()
    rng = rng_of(13)
    orders = [rng.permutation(len(blobs)) for _ in blobs.cameras]
    mixed = edited(blobs, lambda frame, camera, xy: (np.array([orders[c][f] for f, c in zip(frame, camera, strict=True)]), camera, xy))
    try:
        made = calibrate_wand(mixed, WAND, sizes=SIZE)
    except AsterismError as refused:
        assert "contradict" in str(refused) or "agree" in str(refused)
    else:
        assert not made.usable, sentences(made)


L_FRAME = np.array([[0.0, 0, 0], [0.2, 0, 0], [0.6, 0, 0], [0, 0.4, 0]])


def lying(rig: Rig, points: np.ndarray, seed: int = 14) -> Blobs:
    return simulate_blobs(rig, np.tile(points, (20, 1, 1)), ImagingSettings(noise=0.2, strays=0.2), rng=rng_of(seed))[0]


def test_the_world_from_an_l_frame() -> None:
    rig, made = calibrated()
    turn, shift = rotation_from_vector([0.0, 0.0, 0.7]), np.array([0.3, -0.2, 0.02])
    still = lying(rig, L_FRAME @ turn.T + shift)
    world = in_world(made.rig, world_from_l_frame(made.rig, still, L_FRAME), "L-frame")
    truth = rig.moved(turn.T, -turn.T @ shift)
    for camera in world:
        assert np.linalg.norm(camera.position - truth[camera.name].position) < 0.01
    assert np.allclose(world.vertical, [0, 0, 1])


def test_a_mirrored_world_is_not_delivered() -> None:
    """Images whose y runs upwards give a consistent mirrored rig; on the floor, its cameras hang below."""
    rig, blobs = waved()
    still = lying(rig, L_FRAME)

    def flipped(of: Blobs) -> Blobs:
        return edited(of, lambda frame, camera, xy: (frame, camera, np.stack([xy[:, 0], 1023 - xy[:, 1]], axis=1)))

    made = calibrate_wand(flipped(blobs), WAND, sizes=SIZE)
    assert "the rig is mirrored" in sentences(made)
    assert "mirrored" not in sentences(calibrated()[1])
    with pytest.raises(AsterismError, match=r"upside down.*mirrored"):
        world_from_l_frame(made.rig, flipped(still), L_FRAME)
    along = np.array(WAND)[:, None]
    twice = np.concatenate([np.tile(along * way, (15, 1, 1)) for way in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0])])
    with pytest.raises(AsterismError, match="y is counted from the bottom"):
        world_from_floor_wand(made.rig, flipped(simulate_blobs(rig, twice, ImagingSettings(noise=0.2), rng=rng_of(27))[0]), WAND)
    swapped = world_from_points([0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0])
    with pytest.raises(AsterismError, match=r"upside down.*x and y are swapped"):
        in_world(rig, swapped, "three points")


@pytest.mark.parametrize(
    ("markers", "message"),
    [
        (L_FRAME[:3], "not in a line"),
        (L_FRAME * 2, "no still markers lie"),
        (np.array([[0.0, 0, 0], [0.4, 0, 0], [0, 0.4, 0]]), "alike|no still"),
    ],
)
def test_l_frames_that_are_not_there(markers: np.ndarray, message: str) -> None:
    rig, made = calibrated()
    with pytest.raises(AsterismError, match=message):
        world_from_l_frame(made.rig, lying(rig, L_FRAME), markers)


def test_an_l_frame_with_equal_arms_is_refused() -> None:
    rig, made = calibrated()
    equal = np.array([[0.0, 0, 0], [0.4, 0, 0], [0, 0.4, 0]])
    with pytest.raises(AsterismError, match="alike"):
        world_from_l_frame(made.rig, lying(rig, equal), equal)


def test_the_world_from_a_wand_on_the_floor() -> None:
    rig, made = calibrated()
    along = np.array(WAND)[:, None]
    first = np.array([0.1, 0.2, 0.0]) + along * [1.0, 0, 0]
    second = np.array([0.1, 0.2, 0.0]) + along * [0.0, -1.0, 0]
    blobs, _ = simulate_blobs(
        rig, np.concatenate([np.tile(first, (15, 1, 1)), np.tile(second, (15, 1, 1))]), ImagingSettings(noise=0.2), rng=rng_of(15)
    )
    world = in_world(made.rig, world_from_floor_wand(made.rig, blobs, WAND), "floor")
    for camera in world:
        assert np.linalg.norm(camera.position - rig[camera.name].position + [0.1, 0.2, 0.0]) < 0.02
    carried = [np.array([0.1 * (1 - t), 0.2, 0.4 * t]) + along * [np.cos(2 * t), -np.sin(2 * t), 0.3] for t in np.linspace(0.2, 0.8, 9)]
    blobs, _ = simulate_blobs(
        rig, np.concatenate([carried[5:], [first] * 60, carried, [second] * 8]), ImagingSettings(noise=0.2), rng=rng_of(17)
    )
    picked_up = in_world(made.rig, world_from_floor_wand(made.rig, blobs, WAND), "floor")
    for camera in picked_up:
        assert np.linalg.norm(camera.position - world[camera.name].position) < 0.01, "one recording, the wand carried in between"
    sloping = np.array([0.1, 0.2, 0.0]) + along * [0.0, 0.8, 0.6]
    aslant, _ = simulate_blobs(
        rig, np.concatenate([np.tile(first, (15, 1, 1)), np.tile(sloping, (15, 1, 1))]), ImagingSettings(noise=0.2), rng=rng_of(15)
    )
    with pytest.raises(AsterismError, match=r"camera c\d would stand \d\.\d\d m below the floor"):
        world_from_floor_wand(made.rig, aslant, WAND)
    one_way, _ = simulate_blobs(rig, np.tile(first, (15, 1, 1)), ImagingSettings(noise=0.2), rng=rng_of(16))
    with pytest.raises(AsterismError, match="two directions"):
        world_from_floor_wand(made.rig, one_way, WAND)


def test_the_world_from_three_points() -> None:
    rotation, translation, scale = world_from_points([1, 1, 1], [1, 3, 1], [1, 1, 2])
    assert np.allclose(rotation @ [1, 1, 1] + translation, 0)
    assert np.allclose(rotation @ [1, 3, 1] + translation, [2, 0, 0])
    assert np.allclose(rotation @ [1, 1, 2] + translation, [0, 1, 0])
    assert scale == 1.0
    with pytest.raises(AsterismError, match="in a line"):
        world_from_points([0, 0, 0], [1, 0, 0], [2, 0, 0])
