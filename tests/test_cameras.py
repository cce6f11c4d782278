"""The camera model against OpenCV, and rigs as rigid things."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism.cameras import Camera, Rig
from asterism.cameras.files import read_rig, write_rig
from asterism.errors import AsterismError
from asterism.geometry import rotation_from_vector, vector_from_rotation

MATRIX = np.array([[1500.0, 0, 640], [0, 1490.0, 500], [0, 0, 1]])
LENSES = {
    "no distortion": [],
    "two radial": [-0.25, 0.08, 0.0, 0.0],
    "five": [-0.28, 0.1, 0.0011, -0.0007, 0.02],
    "rational": [0.3, -0.2, 0.001, 0.0004, 0.01, 0.55, -0.1, 0.03],
    "only the second below": [-0.2, 0.05, 0.0, 0.0, 0.0, 0.0, 0.15, 0.0],
}


def a_camera(lens: str = "five") -> Camera:
    return Camera.from_opencv("one", MATRIX, LENSES[lens], [0.2, -0.4, 0.1], [0.1, -0.2, 3.0], (1280, 1024))


@pytest.mark.parametrize("lens", LENSES)
def test_projection_equals_opencv(lens: str) -> None:
    camera = a_camera(lens)
    points = np.random.default_rng(1).uniform(-0.8, 0.8, (500, 3))
    expected = cv2.projectPoints(
        points, vector_from_rotation(camera.rotation), camera.translation, MATRIX, np.array(LENSES[lens] or [0.0] * 4)
    )[0]
    assert np.abs(camera.project(points) - expected[:, 0]).max() < 1e-9


@pytest.mark.parametrize("lens", LENSES)
def test_undistortion_equals_opencv_iterated_to_the_end(lens: str) -> None:
    camera = a_camera(lens)
    pixels = np.random.default_rng(2).uniform([0, 0], [1280, 1024], (500, 2))
    end = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-15)
    arguments = (pixels[:, None], MATRIX, np.array(LENSES[lens] or [0.0] * 4))
    iterate = getattr(cv2, "undistortPointsIter", None)  # OpenCV 4; OpenCV 5 takes the criteria in undistortPoints
    expected = iterate(*arguments, None, None, end) if iterate else cv2.undistortPoints(*arguments, criteria=end)
    assert np.abs(camera.undistort(pixels) - expected[:, 0]).max() * MATRIX[0, 0] < 1e-9


@given(st.integers(0, 10_000), st.floats(-0.3, 0.3), st.floats(-0.1, 0.1), st.floats(-0.002, 0.002))
@settings(max_examples=50, deadline=None)
def test_undistortion_undoes_the_lens(seed: int, k1: float, k2: float, p1: float) -> None:
    camera = Camera("one", None, (1500.0, 1490.0), (640.0, 500.0), radial=(k1, k2), tangential=(p1, -p1))
    flat = np.random.default_rng(seed).uniform(-0.4, 0.4, (50, 2))
    pixels = camera.project(np.concatenate([flat, np.ones((50, 1))], axis=1))
    assert np.abs(camera.undistort(pixels) - flat).max() < 1e-12


def test_rays_lead_back_to_the_point() -> None:
    camera = a_camera()
    points = np.random.default_rng(3).uniform(-0.8, 0.8, (100, 3))
    depth = np.linalg.norm(points - camera.position, axis=1, keepdims=True)
    assert np.abs(camera.position + depth * camera.rays(camera.project(points)) - points).max() < 1e-9


def test_a_point_behind_the_camera_is_not_seen() -> None:
    camera = Camera("one", None, (1000.0, 1000.0), (500.0, 500.0))
    seen = camera.project([[0.1, 0.1, 1.0], [0.1, 0.1, -1.0], [0.1, 0.1, 0.0], [np.nan, 0, 1]])
    assert np.isfinite(seen[0]).all()
    assert np.isnan(seen[1:]).all()


def test_beyond_the_fold_of_the_lens_nothing_is_seen() -> None:
    """With k1 = -0.4 the image radius r (1 - 0.4 r2) is largest at r = 0.913: further out the model would fold back into the image."""
    camera = Camera("one", None, (1000.0, 1000.0), (500.0, 500.0), radial=(-0.4,))
    assert np.isfinite(camera.project([[0.9, 0, 1.0]])).all()
    assert np.isnan(camera.project([[0.95, 0, 1.0]])).all()
    assert np.isnan(camera.undistort([[500 + 650.0, 500.0]])).all()


@pytest.mark.parametrize("lens", LENSES)
def test_parameters_pass_both_ways(lens: str) -> None:
    camera = a_camera(lens)
    again = Camera.from_opencv("one", camera.matrix, camera.distortion, camera.rotation, camera.translation, camera.size)
    assert np.array_equal(again.lens, camera.lens)
    assert np.array_equal(again.rotation, camera.rotation)


def test_more_radial_coefficients_than_opencv_has_are_refused_to_it() -> None:
    camera = Camera("one", None, (1000.0, 1000.0), (500.0, 500.0), radial=(-0.2, 0.1, 0.0, 0.05))
    with pytest.raises(AsterismError, match="4 radial"):
        _ = camera.distortion


def test_another_world_frame_leaves_the_images_as_they_are() -> None:
    rig = Rig((a_camera(), Camera.from_opencv("two", MATRIX, [], [0.0, 0.5, 0.0], [0.0, 0.1, 2.5])), vertical="z")
    rotation, translation = rotation_from_vector([0.3, 1.0, -0.2]), np.array([1.0, -2.0, 0.5])
    points = np.random.default_rng(4).uniform(-0.5, 0.5, (20, 3))
    moved = rig.moved(rotation, translation, 2.0)
    assert np.nanmax(np.abs(moved.project(2.0 * points @ rotation.T + translation) - rig.project(points))) < 1e-9
    assert np.allclose(moved.vertical, rotation[:, 2])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"focal": (-1.0, 1.0)}, "focal length"),
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "mirrored"),
        ({"rotation": 2 * np.eye(3)}, "orthonormal"),
        ({"translation": np.array([np.nan, 0, 0])}, "finite"),
        ({"size": (0, 10)}, "image size"),
    ],
)
def test_a_camera_that_cannot_be_is_refused(changes: dict, message: str) -> None:
    with pytest.raises(AsterismError, match=message):
        Camera(**{"name": "one", "size": None, "focal": (1000.0, 1000.0), "centre": (0.0, 0.0)} | changes)


def test_two_cameras_of_one_name_are_refused() -> None:
    with pytest.raises(AsterismError, match="called one"):
        Rig((a_camera(), a_camera()))


def test_numbers_are_plain_whatever_they_were_given_as(tmp_path: Path) -> None:
    focal = np.array([1100.8, 1100.2])
    camera = Camera("9", (1280, 1024), (focal[0], focal[1]), (focal[0] / 2, focal[1] / 2), error=focal[0] / 1e4)
    assert {type(value) for value in (*camera.focal, *camera.centre, *camera.tangential, camera.error)} == {float}
    write_rig(Rig((camera,)), tmp_path / "rig.xcp")
    assert read_rig(tmp_path / "rig.xcp")["9"].focal == pytest.approx(camera.focal)
