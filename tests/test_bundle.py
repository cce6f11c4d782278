"""Bundle adjustment: its Jacobians against finite differences, its steps against dense least squares, its answers against the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from asterism.cameras import Camera
from asterism.cameras.bundle import PARAMETERS, AdjustSettings, Sightings, _kernels, adjust, free_parameters, triangulate
from asterism.errors import AsterismError
from asterism.geometry import place_objects, rotation_from_vector

pytestmark = pytest.mark.kernels

WAND = np.array([[0.0, 0, 0], [0.2, 0, 0], [0.6, 0, 0]])
BOARD = np.array([[x, y, 0.0] for x in (0.0, 0.1, 0.2, 0.3) for y in (0.0, 0.1, 0.2)])
DOT = np.zeros((1, 3))


def a_ring(cameras: int = 4) -> list[Camera]:
    rig = []
    for c in range(cameras):
        angle = 2 * np.pi * c / cameras
        position = np.array([4 * np.cos(angle), 4 * np.sin(angle), 2.0 + 0.3 * (c % 2)])
        z = -position / np.linalg.norm(position)
        x = np.cross(z, [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x)
        rotation = np.array([x, np.cross(z, x), z])
        lens = {"radial": (-0.1 + 0.02 * c, 0.05, 0.0), "tangential": (0.001, -0.0005)}
        rig.append(
            Camera(f"c{c}", (1280, 1024), (1100.0 + 50 * c, 1105.0 + 50 * c), (640.0, 510.0), rotation, -rotation @ position, **lens)
        )
    return rig


def moved_about(template: np.ndarray, frames: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rotations = np.array([rotation_from_vector(rng.normal(size=3) * 1.5) for _ in range(frames)])
    translations = rng.uniform(-0.8, 0.8, (frames, 3))
    return rotations, translations, np.einsum("tij,kj->tki", rotations, template) + translations[:, None]


def seen(rig: list[Camera], points: np.ndarray, noise: float | np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(T, C, K, 2) px."""
    xy = np.stack([camera.project(points) for camera in rig], axis=1)
    return xy + rng.normal(size=xy.shape) * noise


def shaken(rig: list[Camera], rng: np.random.Generator) -> list[Camera]:
    return [
        replace(
            camera,
            focal=(camera.focal[0] * 1.03, camera.focal[1] * 1.03),
            rotation=rotation_from_vector(rng.normal(size=3) * 0.01) @ camera.rotation,
            translation=camera.translation + rng.normal(size=3) * 0.02,
        )
        for camera in rig
    ]


def test_jacobians_equal_finite_differences() -> None:
    camera = replace(a_ring()[1], denominator=(0.02, -0.01, 0.005), radial=(-0.2, 0.08, 0.03))
    point = np.array([0.3, -0.4, 0.5])
    by_camera, by_point, pixel = np.empty((2, 15)), np.empty((2, 3)), np.empty(2)
    assert _kernels.project_with_derivatives(camera.lens, camera.rotation, camera.translation, point, pixel, by_camera, by_point)
    assert np.allclose(pixel, camera.project(point), atol=1e-9)

    def projected(step: np.ndarray) -> np.ndarray:
        fx = camera.focal[0] + step[6]
        return replace(
            camera,
            rotation=rotation_from_vector(step[:3]) @ camera.rotation,
            translation=camera.translation + step[3:6],
            focal=(fx, fx * (camera.focal[1] / camera.focal[0] + step[7])),
            centre=(camera.centre[0] + step[8], camera.centre[1] + step[9]),
            radial=tuple(np.array(camera.radial) + step[10:13]),
            tangential=tuple(np.array(camera.tangential) + step[13:15]),
        ).project(point)

    for p, name in enumerate(PARAMETERS):
        step = np.zeros(15)
        step[p] = 1e-6
        difference = (projected(step) - projected(-step)) / 2e-6
        assert np.allclose(by_camera[:, p], difference, rtol=1e-5, atol=1e-4), name
    for axis in range(3):
        shift = np.eye(3)[axis] * 1e-6
        assert np.allclose(by_point[:, axis], (camera.project(point + shift) - camera.project(point - shift)) / 2e-6, rtol=1e-5, atol=1e-4)
    assert not _kernels.project_with_derivatives(
        camera.lens, camera.rotation, camera.translation, 3 * camera.position, pixel, by_camera, by_point
    )


@pytest.mark.parametrize(
    "template", [WAND, BOARD, WAND @ rotation_from_vector([0.3, 0.5, 1.0]).T + 0.1], ids=["wand", "board", "askew wand"]
)
def test_a_noiseless_rig_is_found_again(template: np.ndarray) -> None:
    rng = np.random.default_rng(2)
    rig = a_ring()
    _, _, points = moved_about(template, 120, rng)
    sightings = Sightings.from_array(seen(rig, points, 0.0, rng))
    start = [rig[0], *shaken(rig[1:], rng)]
    placed = place_objects(template, triangulate(start, sightings, 120, len(template)))
    free = free_parameters(4, "pose", "focal", "centre", "k1", "k2", "tangential")
    free[0] = False
    result = adjust(start, template, sightings, *placed, free=free, settings=AdjustSettings(scale=50.0, tolerance=1e-16))
    assert result.rms < 1e-5, f"{result.rms} px"
    for truth, found in zip(rig, result.cameras, strict=True):
        assert np.abs(found.position - truth.position).max() < 1e-6
        assert abs(found.focal[0] - truth.focal[0]) < 1e-3


def test_lenses_are_found_from_none() -> None:
    """Of cameras that were given without any lens, all coefficients are found: k1 to k3, and both tangential ones."""
    rng = np.random.default_rng(12)
    rig = [replace(camera, radial=(-0.1 + 0.02 * c, 0.05, -0.02)) for c, camera in enumerate(a_ring())]
    rotations, translations, points = moved_about(BOARD, 60, rng)
    points, translations = points + translations[:, None], 2 * translations
    bare = [replace(camera, radial=(), tangential=(0.0, 0.0)) for camera in rig]
    free = free_parameters(4, "k1", "k2", "k3", "tangential")
    sightings = Sightings.from_array(seen(rig, points, 0.0, rng))
    result = adjust(
        bare, BOARD, sightings, rotations, translations, free=free, settings=AdjustSettings(scale=500.0, tolerance=1e-16, steps=200)
    )
    for truth, found in zip(rig, result.cameras, strict=True):
        assert np.allclose(found.radial, truth.radial, atol=1e-4)
        assert np.allclose(found.tangential, truth.tangential, atol=1e-5)


def test_a_moved_dot_gives_the_rig_up_to_its_size() -> None:
    rng = np.random.default_rng(3)
    rig = a_ring()
    _, _, points = moved_about(DOT, 200, rng)
    sightings = Sightings.from_array(seen(rig, points, 0.0, rng))
    start = [rig[0], *shaken(rig[1:], rng)]
    result = adjust(
        start,
        DOT,
        sightings,
        *place_objects_of_dots(start, sightings, 200),
        settings=AdjustSettings(scale=50.0, tolerance=1e-16, steps=200),
    )
    lengths = [np.linalg.norm(camera.position - result.cameras[0].position) for camera in result.cameras[1:]]
    true = [np.linalg.norm(camera.position - rig[0].position) for camera in rig[1:]]
    assert np.ptp(np.array(lengths) / true) < 1e-6
    assert result.free.sum() == 3 * 7 + 1 - 1


def place_objects_of_dots(cameras: list[Camera], sightings: Sightings, frames: int) -> tuple[np.ndarray, np.ndarray]:
    return np.tile(np.eye(3), (frames, 1, 1)), triangulate(cameras, sightings, frames, 1)[:, 0]


@pytest.mark.parametrize("relative", [(1.0, 1.0, 1.0), (1.0, 2.0, 0.5)], ids=["cameras alike", "cameras of different noise"])
def test_the_minimum_and_its_covariance_equal_dense_least_squares(relative: tuple[float, ...]) -> None:
    rng = np.random.default_rng(4)
    rig = a_ring(3)
    rotations, translations, points = moved_about(BOARD, 6, rng)
    sightings = Sightings.from_array(seen(rig, points, 0.3 * np.array(relative)[:, None, None], rng))
    free = free_parameters(3, "pose", "focal", "k1")
    free[0, :6] = False
    result = adjust(
        rig,
        BOARD,
        sightings,
        rotations,
        translations,
        free=free,
        settings=AdjustSettings(scale=50.0, relative_noise=relative, tolerance=1e-15),
    )

    def misses(x: np.ndarray) -> np.ndarray:
        step = np.zeros((3, 15))
        step[free] = x[: free.sum()]
        rest = x[free.sum() :].reshape(6, 6)
        cameras = [
            replace(
                c,
                rotation=rotation_from_vector(s[:3]) @ c.rotation,
                translation=c.translation + s[3:6],
                focal=(c.focal[0] + s[6], (c.focal[0] + s[6]) * c.focal[1] / c.focal[0]),
                radial=(c.radial[0] + s[10], *c.radial[1:]),
            )
            for c, s in zip(rig, step, strict=True)
        ]
        world = np.array(
            [rotations[t] @ rotation_from_vector(rest[t, :3]) @ BOARD.T + (translations[t] + rest[t, 3:])[:, None] for t in range(6)]
        )
        projected = np.stack([camera.project(world.transpose(0, 2, 1)) for camera in cameras], axis=1)
        missed = sightings.xy - projected[sightings.frame, sightings.camera, sightings.point]
        return (missed / np.array(relative)[sightings.camera, None]).ravel()

    dense = least_squares(misses, np.zeros(free.sum() + 36), x_scale="jac", xtol=1e-15, ftol=1e-15)
    assert result.cost == pytest.approx(dense.cost, rel=1e-6)
    sigma = np.sqrt(np.diag(np.linalg.inv(dense.jac.T @ dense.jac))[: free.sum()]) * result.noise
    assert np.allclose(result.sigma[free], sigma, rtol=1e-2)
    assert result.noise == pytest.approx(0.3, rel=0.1)


def test_errors_are_as_large_as_the_covariance_says() -> None:
    """Over many noises, error / sigma of the focal lengths has a spread of 1."""
    rig = a_ring()
    rotations, translations, points = moved_about(WAND, 60, np.random.default_rng(5))
    ratios, places = [], []
    for seed in range(40):
        sightings = Sightings.from_array(seen(rig, points, 0.2, np.random.default_rng(seed)))
        result = adjust(rig, WAND, sightings, rotations, translations, settings=AdjustSettings(scale=5.0))
        ratios += [(a.focal[0] - b.focal[0]) / s for a, b, s in zip(result.cameras, rig, result.sigma[:, 6], strict=True)]
        # laid on the true places, since nobody knows where the world begins
        true, found = (np.array([camera.position for camera in cameras]) for cameras in (rig, result.cameras))
        turn, shift = place_objects(found, true[None])
        miss = np.linalg.norm(found @ turn[0].T + shift[0] - true, axis=1)
        places.append(np.mean(np.square(miss / result.position_sigma)))
    assert 0.85 < np.std(ratios) < 1.15, np.std(ratios)
    assert 0.7 < np.mean(places) < 1.4, np.mean(places)


@pytest.mark.parametrize(("loss", "allowed"), [("cauchy", 0.002), ("huber", 0.01)])
def test_a_robust_loss_forgets_outliers(loss: str, allowed: float) -> None:
    rng = np.random.default_rng(6)
    rig = a_ring()
    rotations, translations, points = moved_about(WAND, 150, rng)
    xy = seen(rig, points, 0.2, rng)
    wrong = rng.random(xy.shape[:3]) < 0.05
    xy[wrong] += rng.uniform(-100, 100, (int(wrong.sum()), 2))
    sightings = Sightings.from_array(xy)
    robust = adjust(rig, WAND, sightings, rotations, translations, settings=AdjustSettings(loss=loss, scale=1.0))
    plain = adjust(rig, WAND, sightings, rotations, translations, settings=AdjustSettings(scale=1e6))
    error = [max(abs(a.focal[0] / b.focal[0] - 1) for a, b in zip(r.cameras, rig, strict=True)) for r in (robust, plain)]
    assert error[0] < allowed < error[1]


def test_what_is_expected_holds_what_is_not_seen() -> None:
    """Without any image of the border, k2 stays where it is expected, and its sigma is the one expected."""
    rng = np.random.default_rng(7)
    rig = a_ring()
    rotations, translations, points = moved_about(0.2 * WAND, 100, rng)
    points = (points - translations[:, None]) + 0.1 * translations[:, None]
    sightings = Sightings.from_array(seen(rig, points, 0.2, rng))
    expected, spread = np.zeros((4, 15)), np.full((4, 15), np.inf)
    expected[:, 11], spread[:, 11] = 0.05, 0.1
    result = adjust(
        rig, 0.2 * WAND, sightings, rotations, 0.1 * translations, free=free_parameters(4, "pose", "k2"), prior=(expected, spread)
    )
    assert np.abs([camera.radial[1] - 0.05 for camera in result.cameras]).max() < 0.05
    assert np.allclose(result.sigma[:, 11], 0.1 * result.noise, rtol=0.2)


def test_points_behind_a_camera_do_no_harm() -> None:
    rng = np.random.default_rng(8)
    rig = a_ring()
    rotations, translations, points = moved_about(WAND, 50, rng)
    xy = seen(rig, points, 0.2, rng)
    translations[7] = 3 * rig[0].position
    result = adjust(rig, WAND, Sightings.from_array(xy), rotations, translations, settings=AdjustSettings(loss="cauchy"))
    assert np.isfinite(result.cameras[1].position).all()
    assert np.nanmedian(np.linalg.norm(result.residuals, axis=1)) < 0.5


def test_nothing_seen_is_said() -> None:
    with pytest.raises(AsterismError, match="no sightings"):
        adjust(a_ring(), WAND, Sightings.from_array(np.full((2, 4, 3, 2), np.nan)), np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3)))


def test_rays_meet_as_least_squares_says() -> None:
    rng = np.random.default_rng(9)
    rig = a_ring()
    _, _, points = moved_about(WAND, 5, rng)
    xy = seen(rig, points, 2.0, rng)
    xy[0, 2:] = np.nan
    xy[1, 1:, 2] = np.nan
    found = triangulate(rig, Sightings.from_array(xy), 5, 3)
    for t in range(5):
        for k in range(3):
            rays = [(c.rays(xy[t, i, k]), c.position) for i, c in enumerate(rig) if np.isfinite(xy[t, i, k, 0])]
            if len(rays) < 2:
                assert np.isnan(found[t, k]).all()
                continue
            a = np.concatenate([np.eye(3) - np.outer(d, d) for d, _ in rays])
            b = np.concatenate([(np.eye(3) - np.outer(d, d)) @ o for d, o in rays])
            assert np.allclose(found[t, k], np.linalg.lstsq(a, b, rcond=None)[0], atol=1e-9)
