"""Smooth paths: against the truth, against a slow twin, and what must not change them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter1d
from typer.testing import CliRunner

from asterism import AsterismError
from asterism.cameras import Rig
from asterism.cameras.files import write_rig
from asterism.cli import command_line
from asterism.formats import read_clouds, write_blobs
from asterism.motion import smooth_paths
from asterism.motion._kernels import THIRD, JerkModel, smooth_path
from asterism.reconstruction import Reconstruction, ReconstructionSettings, reconstruct
from asterism.recording import Clouds
from asterism.simulation import simulate_walks
from asterism.simulation.cameras import ImagingSettings, ring_rig, simulate_blobs, walker_capsules

pytestmark = pytest.mark.kernels

Case = tuple[Rig, np.ndarray, Reconstruction]


@pytest.fixture(scope="module")
def walk() -> Case:
    """A walker before seven cameras with 0.3 px of noise: the rig, the true markers (T, M, 3) m, and the points.

    The measurement noise of half a millimetre that simulated walks have is no motion, and is taken off.
    """
    rng = np.random.default_rng(5)
    rig, recording = ring_rig(7, rng=rng), simulate_walks(1, frames=150, seed=5)[0]
    truth = gaussian_filter1d(recording.positions, 2.0, axis=0)
    blobs, _ = simulate_blobs(rig, truth, ImagingSettings(noise=0.3, strays=0.3), body=walker_capsules(recording), rng=rng)
    return rig, truth, reconstruct(blobs, rig, ReconstructionSettings(noise=0.3))


def errors(clouds: Clouds, truth: np.ndarray) -> np.ndarray:
    """(P,) m, how far each point is from the nearest marker."""
    return np.concatenate(
        [np.linalg.norm(points[:, None] - truth[t][None], axis=2).min(axis=1) for t, points in enumerate(clouds) if len(points)]
    )


def some_path(frames: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A path with a kink: measured (n, 3) m, covariances (n, 3, 3) m2 that differ, and the truth."""
    time = np.arange(frames) / 100
    truth = np.stack([np.abs(time - time.mean()), 0.3 * np.sin(5 * time), 0.1 * time], axis=1)
    spread = rng.normal(size=(frames, 3, 3)) * 4e-4
    covariance = spread @ spread.transpose(0, 2, 1) + 1e-7 * np.eye(3)
    return truth + np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), rng.normal(size=(frames, 3))), covariance, truth


def test_smoothing_halves_the_error_and_says_how_exact_it_is(walk: Case) -> None:
    rig, truth, result = walk
    paths = smooth_paths(result.clouds, result.covariance)
    before, after = errors(result.clouds, truth), errors(paths.clouds, truth)
    real = before < 0.02
    assert np.sqrt(np.mean(after[real] ** 2)) < 0.6 * np.sqrt(np.mean(before[real] ** 2))
    deviation = np.sqrt(np.trace(paths.covariance, axis1=1, axis2=2))[real]
    assert 0.8 < np.sqrt(np.mean(after[real] ** 2)) / np.sqrt(np.mean(deviation**2)) < 1.3
    np.testing.assert_allclose(paths.moved, np.linalg.norm(paths.clouds.xyz - result.clouds.xyz, axis=1))
    smooth = result.with_points(paths.clouds, paths.covariance, rig)
    again = result.with_points(result.clouds, result.covariance, rig)
    np.testing.assert_allclose(again.residual, result.residual, atol=1e-4)
    assert smooth.residual.mean() > result.residual.mean()


def test_a_path_is_that_of_the_dense_twin() -> None:
    frames, floor, trust, rounds = 15, 1e-9, 1.0, 4
    measured, covariance, _ = some_path(frames, np.random.default_rng(0))
    weights = np.exp(-0.5 * np.arange(-3, 4) ** 2 / 2.0)
    information = np.linalg.inv(covariance)
    differences = np.zeros((3 * (frames - 3), 3 * frames))
    for t in range(frames - 3):
        for axis in range(3):
            differences[3 * t + axis, 3 * t + axis : 3 * t + axis + 12 : 3] = THIRD
    told = np.zeros((3 * frames, 3 * frames))
    for t in range(frames):
        told[3 * t : 3 * t + 3, 3 * t : 3 * t + 3] = information[t]
    variance = np.full(frames - 3, np.mean(3.0 / np.trace(information, axis1=1, axis2=2)))
    for done in range(rounds):
        inverse = np.linalg.inv(told + differences.T @ np.diag(1 / np.repeat(variance, 3)) @ differences)
        mean = inverse @ told @ measured.ravel()
        if done < rounds - 1:
            square = ((differences @ mean) ** 2 + np.diag(differences @ inverse @ differences.T)).reshape(-1, 3).sum(axis=1)
            for t in range(frames - 3):
                near = [(weights[k + 3], t + k) for k in range(-3, 4) if 0 <= t + k < frames - 3]
                variance[t] = (trust * floor + sum(w * square[i] for w, i in near)) / (trust + 3 * sum(w for w, _ in near))
    path, known = np.empty((frames, 3)), np.empty((frames, 3, 3))
    rows, columns = np.triu_indices(3)
    smooth_path(measured, np.ascontiguousarray(information[:, rows, columns]), JerkModel(floor, trust, weights, rounds), path, known)
    np.testing.assert_allclose(path, mean.reshape(-1, 3), atol=1e-9)
    expected = [inverse[3 * t : 3 * t + 3, 3 * t : 3 * t + 3] for t in range(frames)]
    np.testing.assert_allclose(known, expected, rtol=1e-6, atol=1e-12)


def test_a_marker_that_stops_dead_is_not_carried_on() -> None:
    rng = np.random.default_rng(1)
    time = np.arange(200) / 200
    truth = np.stack([np.minimum(time, 0.5) * 2.0, 0 * time, 0 * time], axis=1)
    measured = truth + rng.normal(scale=3e-4, size=truth.shape)
    clouds = Clouds.from_points(list(measured[:, None]), 200.0)
    after = np.linalg.norm(smooth_paths(clouds, np.tile(9e-8 * np.eye(3), (200, 1, 1))).clouds.xyz - truth, axis=1)
    assert after.max() < 1.2e-3
    assert np.sqrt(np.mean(after[120:] ** 2)) < 0.5 * 3e-4 * np.sqrt(3)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000))
def test_the_order_of_points_and_where_the_world_stands_change_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    frames, apart = 25, np.array([0.0, 0.4, 0.0])
    measured, covariance, _ = some_path(frames, rng)
    turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    clouds = Clouds.from_points([np.stack([point, point + apart]) for point in measured], 100.0)
    other = Clouds.from_points([(np.stack([point + apart, point]) @ turned.T) + 1.0 for point in measured], 100.0)
    spread = np.repeat(covariance, 2, axis=0)
    one, two = smooth_paths(clouds, spread), smooth_paths(other, turned @ spread @ turned.T)
    swapped = two.clouds.xyz.reshape(frames, 2, 3)[:, ::-1].reshape(-1, 3)
    assert one.paths == two.paths > 0
    np.testing.assert_allclose(swapped, one.clouds.xyz @ turned.T + 1.0, atol=1e-8)


def test_points_that_hang_on_no_path_stay_where_they_are() -> None:
    rng = np.random.default_rng(2)
    clouds = Clouds.from_points([rng.uniform(-3, 3, (count, 3)) for count in (3, 0, 5, 1, 0)], 100.0)
    spread = np.tile(1e-6 * np.eye(3), (len(clouds.xyz), 1, 1))
    paths = smooth_paths(clouds, spread)
    assert paths.paths == 0
    np.testing.assert_array_equal(paths.clouds.xyz, clouds.xyz)
    np.testing.assert_array_equal(paths.covariance, spread)
    assert len(smooth_paths(Clouds.from_points([], 100.0), np.empty((0, 3, 3))).clouds) == 0


def test_covariances_that_are_none_are_refused() -> None:
    clouds = Clouds.from_points([np.zeros((1, 3))] * 8, 100.0)
    with pytest.raises(AsterismError, match="8 points"):
        smooth_paths(clouds, np.tile(np.eye(3), (7, 1, 1)))
    for bad in (np.zeros((3, 3)), np.diag([1.0, 1.0, -1.0]), np.full((3, 3), np.nan)):
        with pytest.raises(AsterismError, match="positive definite"):
            smooth_paths(clouds, np.tile(bad, (8, 1, 1)))


def test_reconstruct_smooths_when_asked(walk: Case, tmp_path: Path) -> None:
    rig, truth, result = walk
    write_rig(rig, tmp_path / "rig.toml")
    write_blobs(result.blobs, tmp_path / "2d.csv")
    given = ["reconstruct", str(tmp_path / "2d.csv"), "--rig", str(tmp_path / "rig.toml"), "--noise", "0.3"]
    for name, more in (("raw.npz", []), ("smooth.npz", ["--smooth"])):
        told = CliRunner().invoke(command_line(), [*given, "-o", str(tmp_path / name), *more])
        assert told.exit_code == 0, told.output
        assert ("paths, points moved by" in told.output) == bool(more)
    raw, smooth = read_clouds(tmp_path / "raw.npz"), read_clouds(tmp_path / "smooth.npz")
    np.testing.assert_array_equal(raw.counts, smooth.counts)
    near = errors(raw, truth) < 0.02
    assert errors(smooth, truth)[near].mean() < 0.7 * errors(raw, truth)[near].mean()
