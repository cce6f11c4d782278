"""Calibration by a sheet of coded circles: right to a tenth of a millimetre, from views that show a part of it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from garment_scenes import coded, read_target, sheet

from asterism.calibration.boards import Board, BoardCalibration, BoardViews, calibrate_board
from asterism.calibration.coded_target import CodedTarget, calibrate_target, centre_offsets, target_poses, target_views
from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.garment.target import coded_target
from asterism.simulation import compare_rigs
from asterism.simulation.garment import PhotoSettings, Wearer, garment_rig, photograph, sheet_of, suit_masks
from asterism.simulation.garment.target import wave_target

NOISE = 0.03


@cache
def rig() -> Rig:
    return garment_rig(5, (1280, 960), 1.6, rng=np.random.default_rng(5))


@cache
def views(noise: float = NOISE, count: int = 40, steepest: float = 70.0) -> BoardViews:
    waved = wave_target(sheet(), rig(), count, reach=0.6, rng=np.random.default_rng(6))
    reads = read_target(waved, rig(), noise, rng=np.random.default_rng(7), steepest=steepest)
    return target_views(coded_target(sheet()), reads, rig().names, [camera.size for camera in rig()])


@cache
def calibrated() -> BoardCalibration:
    return calibrate_target(views())


def test_the_rig_comes_out_from_partly_seen_targets() -> None:
    counts = views().counts
    assert np.mean(counts[counts > 0] < len(coded_target(sheet()).ids)) > 0.2, "views should be partial"
    made = calibrated()
    assert made.rms < 1.1 * np.sqrt(2) * NOISE, f"{made.rms:.4f} px"
    found = compare_rigs(made.rig, rig())
    assert found.position.max() < 0.001, f"{1000 * found.position.max():.2f} mm, allowed 1"
    assert found.focal.max() < 0.001


def test_uncorrected_centres_make_it_worse() -> None:
    """The centres of ellipses taken for images of centres: the error left grows, and with larger circles the more."""
    plain, corrected = calibrate_board(views(noise=0.003)), calibrate_target(views(noise=0.003))
    assert plain.rms > 1.5 * corrected.rms, f"{plain.rms:.4f} px, corrected {corrected.rms:.4f}"
    assert compare_rigs(plain.rig, rig()).position.mean() > 2 * compare_rigs(corrected.rig, rig()).position.mean()


def test_the_covariance_is_that_of_the_lenses() -> None:
    """Errors of the focal lengths and positions are as large as their standard deviations say: none beyond four of them."""
    made = calibrated()
    sigma = made.adjustment.sigma[:, 6]
    off = np.array([found.focal[0] - true.focal[0] for found, true in zip(made.rig, rig(), strict=True)])
    assert (np.abs(off) < 4 * sigma).all() and np.sqrt(np.mean((off / sigma) ** 2)) > 0.1
    assert (compare_rigs(made.rig, rig()).position < 4 * made.adjustment.position_sigma).all()
    assert made.adjustment.covariance.shape == (made.adjustment.free.sum(),) * 2


def test_the_offset_of_an_ellipse_is_that_of_its_outline() -> None:
    """Against the mean of 20,000 projected points of the outline, weighted as an area: the centre of the ellipse, by its definition."""
    camera = replace(rig().cameras[0], radial=())
    angles = np.linspace(0, 2 * np.pi, 20_000, endpoint=False)
    for tilt in (0.0, 0.5, 1.1):
        turn = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
        place = np.array([0.1, -0.2, 1.5])
        ring = (turn @ np.array([0.05 * np.cos(angles), 0.05 * np.sin(angles), 0 * angles])).T + place
        lens = replace(camera, rotation=np.eye(3), translation=np.zeros(3))
        xy = lens.project(ring)
        cross = xy[:, 0] * np.roll(xy[:, 1], -1) - np.roll(xy[:, 0], -1) * xy[:, 1]
        centre = ((xy + np.roll(xy, -1, axis=0)) * cross[:, None]).sum(axis=0) / (3 * cross.sum())
        offset = centre_offsets(camera, turn[None], place[None], 0.05)[0]
        np.testing.assert_allclose(offset, centre - lens.project(place), atol=1e-5)
    assert np.abs(offset).max() > 0.1


def test_a_photographed_sheet_has_the_offset_too() -> None:
    """The mean of the bright pixels of a near, tilted circle is its ellipse's centre, not its truth."""
    pattern, camera = sheet(), replace(rig().cameras[1], radial=())
    waved = wave_target(pattern, rig(), 2, reach=0.0, rng=np.random.default_rng(1))
    turn = np.array([[1, 0, 0], [0, np.cos(1.0), -np.sin(1.0)], [0, np.sin(1.0), np.cos(1.0)]])
    turns = camera.rotation.T @ turn
    middle = pattern.positions()[3, 4]
    place = camera.position + 0.9 * camera.rotation[2] - turns @ middle
    scene = replace(waved, rotations=turns[None], translations=place[None])
    settings = PhotoSettings(noise=0.0, blur=0.0, bleeding=1e-5, samples=6, clutter=0, lamps=(), ambient=(1.0, 1.0, 1.0), vignetting=0.0)
    photo = photograph(scene, camera, 0.0, settings, rng=np.random.default_rng(0))
    cell = (photo.truth.cells == [3, 4]).all(axis=1)
    at = np.rint(photo.truth.centres[cell][0]).astype(int)
    half = 34
    window = np.ptp(photo.image[at[1] - half : at[1] + half + 1, at[0] - half : at[0] + half + 1].astype(float), axis=2)
    below, right = np.mgrid[-half : half + 1, -half : half + 1]
    label = cv2.connectedComponents((window > 20).astype(np.uint8))[1]
    weight = np.where(label == label[half, half], window, 0.0)
    centre = at + np.array([(weight * right).sum(), (weight * below).sum()]) / weight.sum()
    inside = scene.circles(0)[3, 4] @ camera.rotation.T + camera.translation
    expected = centre_offsets(camera, (camera.rotation @ turns)[None], inside[None], 0.5 * pattern.diameter)[0]
    assert np.linalg.norm(expected) > 0.1
    np.testing.assert_allclose(centre - photo.truth.centres[cell][0], expected, atol=0.02)


def test_three_circles_give_a_pose() -> None:
    target, camera = coded_target(sheet()), rig().cameras[0]
    waved = wave_target(sheet(), rig(), 1, reach=0.1, rng=np.random.default_rng(8))
    read = read_target(waved, rig(), 0.0, rng=np.random.default_rng(0))[0][0]
    true = camera.rotation @ waved.rotations[0], camera.rotation @ waved.translations[0] + camera.translation
    turns = np.tile(true[0], (len(read.ids), 1, 1))
    points = target.places[target.view(read)[0]] @ true[0].T + true[1]
    seen, centres = target.view(read)
    read = replace(read, ids=target.ids[seen], centres=centres - centre_offsets(camera, turns, points, 0.5 * target.diameter))
    for chosen in ([0, 3, 11], [0, 3, 11, 14], list(range(len(read.ids)))):
        part = replace(read, centres=read.centres[chosen], covariance=read.covariance[chosen], ids=read.ids[chosen])
        found = target_poses(camera, target, part)
        assert 1 <= len(found) <= 4
        assert min(np.linalg.norm(place - true[1]) for _, place, _ in found) < 1e-3
        assert all(error < 1e-2 for _, _, error in found[:1])
    assert target_poses(camera, target, replace(read, centres=read.centres[:2], ids=read.ids[:2])) == []
    line = np.flatnonzero(np.abs(target.places[seen, 1] - target.places[seen, 1].min()) < 1e-6)
    assert target_poses(camera, target, replace(read, centres=read.centres[line], ids=read.ids[line])) == []


def test_a_camera_that_shares_no_view_is_named() -> None:
    seen = views().seen
    frames = len(views().frames)
    alone = 4
    kept = np.where(seen.camera == alone, seen.frame < frames // 2, seen.frame >= frames // 2)
    made = calibrate_target(replace(views(), seen=seen.select(kept)))
    assert made.excluded == ("c5",)
    assert "board-camera-unlinked" in [finding.code for finding in made.findings]


def test_a_target_seen_edge_on_is_said() -> None:
    """Circles are there only at grazing angles: a person is told, whether a lens can still be had or not."""
    waved = wave_target(sheet(), rig(), 32, reach=0.2, rng=np.random.default_rng(9))
    steep = np.array([[1, 0, 0], [0, np.cos(1.4), -np.sin(1.4)], [0, np.sin(1.4), np.cos(1.4)]])
    looks = [rig().cameras[t % 5].rotation.T @ steep for t in range(32)]
    middle = sheet().positions()[3, 4]
    places = [waved.rotations[t] @ middle + waved.translations[t] - looks[t] @ middle for t in range(32)]
    scene = replace(waved, rotations=np.array(looks), translations=np.array(places))
    reads = read_target(scene, rig(), NOISE, rng=np.random.default_rng(1), steepest=85.0)
    only = [[read if c == t % 5 else None for c, read in enumerate(frame)] for t, frame in enumerate(reads)]
    sizes = [camera.size for camera in rig()]
    found = target_views(coded_target(sheet()), only, rig().names, sizes)
    made = calibrate_target(found, known=rig())
    assert "target-edge-on" in [finding.code for finding in made.findings]
    assert "target-edge-on" not in [finding.code for finding in calibrated().findings]
    none = [[None] * 5 for _ in only]
    with pytest.raises(AsterismError, match="no camera sees it only edge-on"):
        target_views(coded_target(sheet()), none, rig().names, sizes)


def test_a_target_that_is_none() -> None:
    with pytest.raises(AsterismError, match="at least 6 circles"):
        CodedTarget.of([1, 2, 3], np.zeros((3, 3)), 0.068, 0.038)
    with pytest.raises(AsterismError, match="different identities"):
        CodedTarget.of([1, 2, 3, 4, 5, 6, 6], np.random.default_rng(0).normal(size=(7, 3)) * [1, 1, 0], 0.068, 0.038)
    with pytest.raises(AsterismError, match="flat"):
        CodedTarget.of(range(7), np.random.default_rng(0).normal(size=(7, 3)), 0.068, 0.038)
    two = suit_masks(Wearer(parts=("left arm", "right arm")))
    with pytest.raises(AsterismError, match="not a calibration target"):
        coded_target(coded(*sheet_of(two)))
    with pytest.raises(AsterismError, match="not of a coded target"):
        calibrate_target(replace(views(), board=Board("chessboard", 9, 6, 0.03)))
    assert not coded_target(sheet()).turns_alike and "coded target" in str(coded_target(sheet()))


def test_an_image_without_the_target_and_strangers_identities() -> None:
    target, frame = (
        coded_target(sheet()),
        read_target(wave_target(sheet(), rig(), 1, rng=np.random.default_rng(0)), rig(), 0.0, rng=np.random.default_rng(0)),
    )
    read = frame[0][0]
    doubled = replace(
        read, centres=np.concatenate([read.centres, read.centres[:1] + 9, [[1, 1]]]), ids=np.concatenate([read.ids, read.ids[:1], [32639]])
    )
    points, _ = target.view(doubled)
    assert len(points) == len(read.ids) - 1
