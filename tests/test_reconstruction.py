"""Points from simulated blobs of known markers: found, placed, chosen; and what must be refused in words."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path

import c3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import Bounds, LinearConstraint, least_squares, milp

from asterism import formats
from asterism.cameras import Camera, Rig
from asterism.cameras.files import read_rig, write_rig
from asterism.cli import main
from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.geometry import rotation_from_vector
from asterism.reconstruction import Reconstruction, ReconstructionSettings, reconstruct
from asterism.reconstruction._compose_kernels import compose
from asterism.reconstruction._fit_kernels import FitWorkspace
from asterism.reconstruction._input_kernels import FIRST, GAIN, HIGH, LENS, LOW, MISSING, NOISE, FrameArrays, RigArrays, frame_arrays
from asterism.reconstruction._order_kernels import ascending
from asterism.reconstruction._pack_kernels import pack
from asterism.reconstruction._score_kernels import best_blob
from asterism.reconstruction.observation_model import estimate_observation_model
from asterism.reconstruction.problem import ObservationModel, ReconstructionProblem, common_view, image_bounds
from asterism.reconstruction.rays import to_rays
from asterism.recording import Blobs, Clouds
from asterism.simulation.cameras import ImagingSettings, ring_rig, simulate_blobs, walker_capsules
from asterism.tracking.columns import columns_of

pytestmark = pytest.mark.kernels

EVERYWHERE = np.array([[-np.inf] * 3, [np.inf] * 3])


def markers(frames: int, count: int, seed: int, apart: float = 0.03) -> np.ndarray:
    """(T, M, 3) m, anywhere in two cubic metres, no two nearer than `apart`."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-0.8, -0.8, 0.2], [0.8, 0.8, 1.8], (frames, count, 3))
    for frame in points:
        for m in range(1, count):
            while np.linalg.norm(frame[:m] - frame[m], axis=1).min() < apart:
                frame[m] = rng.uniform([-0.8, -0.8, 0.2], [0.8, 0.8, 1.8])
    return points


def codes(findings: tuple[Finding, ...]) -> dict[str, str]:
    """The codes of findings that speak against a result, and where each was found."""
    return {finding.code: finding.where for finding in findings if finding.severity > Severity.NOTE}


def found(result: Reconstruction, truth: np.ndarray, within: float = 0.01) -> tuple[int, int, np.ndarray]:
    """Markers with a point within so many metres, points with no marker there, and the distances of those that have one."""
    hits, ghosts, off = 0, 0, []
    for t, points in enumerate(result.clouds):
        far = np.linalg.norm(points[:, None] - truth[t][None], axis=2)
        hits += int((far.min(axis=0, initial=np.inf) < within).sum())
        nearest = far.min(axis=1) if len(points) else np.empty(0)
        ghosts += int((nearest >= within).sum())
        off.append(nearest[nearest < within])
    return hits, ghosts, np.concatenate(off)


def images(cameras: int = 8, count: int = 30, frames: int = 20, seed: int = 0, **more: float) -> tuple[Rig, Blobs, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    rig = ring_rig(cameras, rng=rng)
    truth = markers(frames, count, seed)
    blobs, shows = simulate_blobs(rig, truth, ImagingSettings(**{"noise": 0.3, "merging": False} | more), rng=rng)
    return rig, blobs, truth, shows


def test_every_marker_is_found_and_nothing_else() -> None:
    rig, blobs, truth, shows = images()
    result = reconstruct(blobs, rig)
    hits, ghosts, off = found(result, truth)
    assert (hits, ghosts) == (600, 0)
    assert np.sqrt(np.mean(off**2)) < 1.2e-3
    assert result.proved.all()
    own = np.where(result.rays >= 0, shows[result.rays], -9)
    agree = np.array([np.ptp(row[row >= 0]) == 0 for row in own])
    assert agree.mean() > 0.99
    assert (result.unused.sum() + result.cameras.sum()) == len(blobs.xy)


def test_the_plain_algorithm_leaves_ghosts_that_the_global_choice_does_not() -> None:
    rig, blobs, truth, _ = images(frames=5)
    plain = reconstruct(blobs, rig, ReconstructionSettings(method="plain"))
    hits, ghosts, _ = found(plain, truth)
    assert hits == 150
    assert ghosts > 100, f"{ghosts} ghosts: this test compares nothing"
    assert found(reconstruct(blobs, rig), truth)[1] == 0


@pytest.mark.parametrize("method", ["plain", "plain-covariance"])
def test_the_plain_method_keeps_to_the_fewest_cameras_of_a_point(method: str) -> None:
    rig, blobs, truth, _ = images(4, 10, 2)
    two, three = (reconstruct(blobs, rig, ReconstructionSettings(method=method, noise=0.3, min_cameras=fewest)) for fewest in (2, 3))
    assert (two.cameras.sum(axis=1) == 2).any(), "nothing to leave out"
    enough = two.cameras.sum(axis=1) >= 3
    assert np.array_equal(three.rays, two.rays[enough])
    assert np.array_equal(three.clouds.xyz, two.clouds.xyz[enough])
    assert found(three, truth)[0] >= 19


@pytest.mark.parametrize("method", ["global", "plain", "plain-covariance"])
def test_rays_that_meet_behind_the_cameras_make_no_point(method: str) -> None:
    """Two cameras side by side look along z; what lies behind them is on the same straight lines as what they see."""
    rig = Rig(tuple(Camera(f"c{c + 1}", (1000, 800), (800.0, 800.0), (500.0, 400.0), translation=[-0.5 * c, 0, 0]) for c in range(2)))
    for z, count in ((-2.0, 0), (2.0, 1)):
        place = np.array([0.2, 0.1, z])
        xy = [(place - camera.position)[:2] / z * 800.0 + [500.0, 400.0] for camera in rig]
        blobs = Blobs.from_rows([0, 0], [0, 1], xy, rig.names)
        assert len(reconstruct(blobs, rig, ReconstructionSettings(method=method, noise=0.3)).clouds.xyz) == count


@pytest.mark.parametrize(("cameras", "missed", "strays"), [(8, 0.4, 1.0), (4, 0.1, 0.5), (3, 0.05, 0.3)])
def test_hidden_markers_and_strays(cameras: int, missed: float, strays: float) -> None:
    rig, blobs, truth, shows = images(cameras, 25, 40, missed=missed, strays=strays)
    result = reconstruct(blobs, rig)
    seen = np.zeros(truth.shape[:2], dtype=int)
    real = shows >= 0
    np.add.at(seen, (blobs.frame_of[real], shows[real]), 1)
    hits, ghosts, _ = found(result, truth)
    assert hits >= 0.99 * (seen >= 2).sum()
    assert ghosts <= 0.01 * hits


def test_pixel_noise_is_estimated_from_the_blobs() -> None:
    for noise in (0.1, 0.3, 1.0, 2.0):
        rig, blobs, _, _ = images(noise=noise)
        assert reconstruct(blobs, rig).noise == pytest.approx(noise, rel=0.1)


def test_the_observation_model_is_that_of_the_simulation() -> None:
    """Estimated from the true points of all frames, those of which two cameras or more have a blob."""
    rig, blobs, truth, shows = images(6, 40, 12, missed=0.2, strays=2.0)

    def run(_: RigArrays, begin: int, __: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rays = np.full((40, 6), -1)
        here = np.flatnonzero((blobs.frame_of == begin) & (shows >= 0))
        rays[shows[here], blobs.camera_of[here]] = here
        off = np.linalg.norm(rig.project(truth[begin]).transpose(1, 0, 2) - blobs.xy[rays], axis=2) ** 2
        residual = np.sqrt(np.where(rays >= 0, off, 0.0).sum(axis=1) / np.maximum((rays >= 0).sum(axis=1), 1))
        some = (rays >= 0).sum(axis=1) >= 2
        return rays[some], truth[begin][some], residual[some]

    bounds = image_bounds(blobs, rig)
    problem = ReconstructionProblem(rig, bounds, EVERYWHERE, common_view(rig, bounds, EVERYWHERE), 2, 4.0)
    model, known, _ = estimate_observation_model(problem, blobs.counts, run, 0.3)
    assert known and model.noise.tolist() == [0.3] * 6
    assert model.points_per_frame == pytest.approx(40, rel=0.05)
    assert model.detection_rate == pytest.approx([0.8] * 6, abs=0.06)
    assert model.stray_rate == pytest.approx([2.0] * 6, abs=1.0)
    box = 1.6**3
    assert box < model.space < 3 * box < problem.space, "the box of the markers, and not much more"


def test_what_a_camera_sees_and_misses_stands_in_the_columns_that_name_it() -> None:
    rig = ring_rig(3, rng=np.random.default_rng(0))
    bounds = np.array([[[1.0, 2], [3, 4], [5, 6]], [[601.0, 402], [703, 504], [805, 606]]])
    detection, strays = np.array([0.6, 0.7, 0.8]), np.array([0.5, 1.0, 2.0])
    model = ObservationModel(np.array([0.2, 0.3, 0.4]), detection, strays, 30.0, 50.0)
    rows = ReconstructionProblem(rig, bounds, np.array([[-1.0, -2, -3], [4, 5, 6]]), 50.0, 2, 4.0).arrays(model).cameras
    assert np.array_equal(rows[:, NOISE], model.noise)
    assert np.allclose(rows[:, MISSING], np.log([0.4, 0.3, 0.2]))
    density = strays / np.array([600 * 400, 700 * 500, 800 * 600])
    assert np.allclose(rows[:, GAIN], np.log(detection / density / (2 * np.pi * model.noise**2)))
    assert np.array_equal(rows[:, LOW : LOW + 2], bounds[0]) and np.array_equal(rows[:, HIGH : HIGH + 2], bounds[1])
    assert all(np.array_equal(row[LENS : LENS + len(camera.lens)], camera.lens) for row, camera in zip(rows, rig, strict=True))


def test_points_are_where_their_reprojection_error_is_least() -> None:
    rig, blobs, _, _ = images(frames=2)
    result = reconstruct(blobs, rig, ReconstructionSettings(noise=0.3))
    for p in range(0, len(result.residual), 7):
        rays = result.rays[p]
        used = np.flatnonzero(rays >= 0)

        def error(x: np.ndarray, rays: np.ndarray = rays, used: np.ndarray = used) -> np.ndarray:
            return np.concatenate([rig[c].project(x) - result.blobs.xy[rays[c]] for c in used])

        best = least_squares(error, result.clouds.xyz[p], xtol=1e-14, ftol=1e-14)
        assert np.linalg.norm(best.x - result.clouds.xyz[p]) < 2e-5, "the lens is taken to be even over the residual"
        assert np.sqrt(2 * best.cost / len(used)) == pytest.approx(result.residual[p], rel=0.01)
        assert np.allclose(result.covariance[p], 0.3**2 * np.linalg.inv(best.jac.T @ best.jac), rtol=0.02, atol=1e-10)


def test_covariance_says_how_far_off_points_are() -> None:
    rig, blobs, truth, _ = images(frames=60, count=15, seed=3)
    result = reconstruct(blobs, rig, ReconstructionSettings(noise=0.3))
    squares = []
    for t, points in enumerate(result.clouds):
        here = slice(result.clouds.offsets[t], result.clouds.offsets[t + 1])
        nearest = np.linalg.norm(points[:, None] - truth[t][None], axis=2).argmin(axis=1)
        off = points - truth[t][nearest]
        squares.append(np.einsum("pi,pij,pj->p", off, np.linalg.inv(result.covariance[here]), off))
    assert np.mean(np.concatenate(squares)) == pytest.approx(3.0, rel=0.1), "a chi-square of three numbers"


def arrays_of(rig: Rig, blobs: Blobs, noise: float = 0.3) -> tuple[RigArrays, FrameArrays]:
    """The first frame as the kernels take it."""
    rays, _, _ = to_rays(blobs, rig)
    cameras = len(rig)
    model = ObservationModel(np.full(cameras, noise), np.full(cameras, 0.7), np.full(cameras, 0.5), 30.0, 50.0)
    first = rays.blobs.offsets[: cameras + 1]
    frame = frame_arrays(rays.normalised[: first[-1]], rays.jacobian[: first[-1]], first)
    return ReconstructionProblem(rig, image_bounds(blobs, rig), EVERYWHERE, 50.0, 2, 4.0).arrays(model), frame


def test_the_epipolar_gate_passes_what_all_pairs_tried_one_by_one_would() -> None:
    """The twin triangulates every pair of blobs of every pair of cameras and looks at the reprojection error."""
    rig, blobs, _, _ = images(4, 10, 1)
    arrays, frame = arrays_of(rig, blobs)
    gated = compose(arrays, frame)[2]
    passing = 0
    for a in range(4):
        for b in range(a + 1, 4):
            for one in blobs.of(0, a):
                for other in blobs.of(0, b):
                    p, q = rig[a].position, rig[b].position
                    d, e = rig[a].rays(one), rig[b].rays(other)
                    s, t = np.linalg.lstsq(np.stack([d, -e], axis=1), q - p, rcond=None)[0]
                    start = (p + s * d + q + t * e) / 2

                    def error(x: np.ndarray, a: int = a, b: int = b, one: np.ndarray = one, other: np.ndarray = other) -> np.ndarray:
                        return np.concatenate([rig[a].project(x) - one, rig[b].project(x) - other]) / 0.3

                    if np.isfinite(error(start)).all():
                        passing += 2 * least_squares(error, start).cost <= 16.0
    assert abs(gated - passing) <= 0.02 * passing


@given(st.integers(0, 2**32 - 1), st.integers(2, 6), st.integers(1, 40))
@settings(max_examples=60, deadline=None)
def test_packing_is_as_good_as_an_integer_program(seed: int, cameras: int, hypotheses: int) -> None:
    rng = np.random.default_rng(seed)
    blobs_each = int(rng.integers(2, 12))
    rays = rng.integers(-1, blobs_each, (hypotheses, cameras))
    rays[:, 0] = np.maximum(rays[:, 0], 0)
    rays = np.where(rays >= 0, rays + np.arange(cameras) * blobs_each, -1)
    scores = rng.uniform(0.1, 10.0, hypotheses)
    chosen, unproved = pack(rays, scores, hypotheses, cameras * blobs_each, 5e6)
    uses = np.zeros((cameras * blobs_each, hypotheses))
    for n, row in enumerate(rays):
        uses[row[row >= 0], n] = 1
    assert (uses @ chosen <= 1).all()
    assert unproved == 0
    best = milp(-scores, constraints=LinearConstraint(uses, -np.inf, 1), integrality=np.ones(hypotheses), bounds=Bounds(0, 1))
    assert scores[chosen].sum() == pytest.approx(-best.fun, abs=1e-6)


def test_a_component_too_big_to_solve_is_still_packed_and_counted() -> None:
    rng = np.random.default_rng(0)
    rays = rng.integers(0, 60, (3000, 4)) + np.arange(4) * 60
    scores = rng.uniform(5.0, 6.0, 3000)
    chosen, unproved = pack(rays, scores, 3000, 240, 5e6)
    taken = rays[chosen]
    assert unproved == 1
    assert len(np.unique(taken)) == taken.size
    greedy, used = 0.0, set[int]()
    for n in np.argsort(-scores):
        if not used & set(rays[n].tolist()):
            used |= set(rays[n].tolist())
            greedy += scores[n]
    assert scores[chosen].sum() >= greedy


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_the_nearest_blob_in_the_grid_is_the_nearest_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rig, blobs, truth, _ = images(4, 20, 1, seed=seed % 50, noise=1.0)
    arrays, frame = arrays_of(rig, blobs, 1.0)
    x = truth[0, 3] + rng.normal(0, 0.01, 3)
    spread = np.diag(rng.uniform(1e-6, 1e-3, 3))
    information = np.linalg.inv(spread)
    c = int(rng.integers(4))
    work = FitWorkspace(x, information[np.triu_indices(3)], np.empty(3))
    blob, square = best_blob(arrays, frame, c, work, np.ones(len(frame.blobs), dtype=bool))
    step = 1e-6 * np.eye(3)
    jacobian = np.array([rig[c].project(x + d) - rig[c].project(x - d) for d in step]).T / 2e-6
    own = blobs.of(0, c) - rig[c].project(x)
    squares = np.einsum("bi,ij,bj->b", own, np.linalg.inv(jacobian @ spread @ jacobian.T + np.eye(2)), own)
    if blob >= 0:
        assert squares[blob - int(frame.grid[c, FIRST])] < squares.min() * 1.1 + 0.1
        assert square == pytest.approx(squares[blob - int(frame.grid[c, FIRST])], rel=0.1, abs=0.1)
    else:
        assert squares.min() > 16.0 * 0.9


def test_same_blobs_same_points_wherever_they_stand() -> None:
    rig, blobs, _, _ = images(frames=6, missed=0.2, strays=1.0)
    whole, again = reconstruct(blobs, rig, ReconstructionSettings(noise=0.3)), reconstruct(blobs, rig, ReconstructionSettings(noise=0.3))
    assert np.array_equal(whole.clouds.xyz, again.clouds.xyz)
    assert np.array_equal(whole.rays, again.rays)


def test_another_world_frame_moves_the_points_with_it() -> None:
    rig, blobs, _, _ = images(frames=4)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    here = reconstruct(blobs, rig, ReconstructionSettings(noise=0.3))
    there = reconstruct(blobs, rig.moved(turn, [1.0, 2.0, 3.0]), ReconstructionSettings(noise=0.3))
    assert np.array_equal(here.rays, there.rays)
    assert np.abs(here.clouds.xyz @ turn.T + [1.0, 2.0, 3.0] - there.clouds.xyz).max() < 1e-6


def test_empty_frames_and_a_camera_that_saw_nothing() -> None:
    rig, blobs, _, _ = images(5, 10, 8)
    kept = (blobs.camera_of != 2) & (blobs.frame_of != 3)
    part = Blobs.from_rows(blobs.frame_of[kept], blobs.camera_of[kept], blobs.xy[kept], blobs.cameras, frames=9)
    result = reconstruct(part, rig)
    assert result.clouds.counts.tolist() == [10, 10, 10, 0, 10, 10, 10, 10, 0]
    assert not result.cameras[:, 2].any()
    assert codes(result.findings) == {"reconstruct-empty-camera": "c3"}


def test_no_blobs_at_all() -> None:
    rig = ring_rig(3)
    for frames in (0, 4):
        result = reconstruct(Blobs.from_rows([], [], np.empty((0, 2)), rig.names, frames=frames), rig)
        assert (len(result.clouds), len(result.clouds.xyz)) == (frames, 0)
    plain = reconstruct(Blobs.from_rows([], [], np.empty((0, 2)), rig.names, frames=2), rig, ReconstructionSettings(method="plain"))
    assert plain.clouds.counts.tolist() == [0, 0]


def test_a_blob_that_stands_twice_is_used_once() -> None:
    rig, blobs, _, _ = images(5, 10, 4)
    twice = Blobs.from_rows(
        np.tile(blobs.frame_of, 2), np.tile(blobs.camera_of, 2), np.tile(blobs.xy, (2, 1)), blobs.cameras, frames=len(blobs)
    )
    result = reconstruct(twice, rig)
    assert np.array_equal(result.clouds.xyz, reconstruct(blobs, rig).clouds.xyz)
    assert codes(result.findings) == {"reconstruct-duplicate-blobs": ""}


def test_blobs_beyond_the_lens_are_left_out_and_said() -> None:
    rig, blobs, _, _ = images(4, 10, 4)
    wide = Rig((replace(rig[0], radial=(-0.9,)), *rig.cameras[1:]), rig.vertical)
    corner = Blobs.from_rows([*blobs.frame_of, 0], [*blobs.camera_of, 0], [*blobs.xy, (1e5, 1e5)], blobs.cameras)
    result = reconstruct(corner, wide)
    assert "reconstruct-no-ray" in codes(result.findings)


@pytest.mark.slow
def test_thousands_of_particles_in_a_frame() -> None:
    rig = ring_rig(4, radius=1.0, height=1.4)
    rng = np.random.default_rng(5)
    truth = rng.uniform([-0.15, -0.15, 0.8], [0.15, 0.15, 1.0], (1, 3000, 3))
    blobs, _ = simulate_blobs(rig, truth, ImagingSettings(noise=0.1, merging=False), rng=rng)
    result = reconstruct(blobs, rig, ReconstructionSettings(noise=0.1, min_cameras=3))
    hits, ghosts, _ = found(result, truth, 1e-3)
    assert hits > 0.98 * 3000
    assert ghosts < 0.02 * 3000


def test_cameras_that_take_turns_are_brought_to_one_clock() -> None:
    rig = ring_rig(4)
    t = np.arange(40)[:, None, None] / 100
    path = markers(1, 8, 2, apart=0.3) + np.concatenate([0.3 * np.sin(6 * t), 0.3 * np.cos(6 * t), 0.2 * t], axis=2)
    blobs, _ = simulate_blobs(
        rig, path, ImagingSettings(noise=0.05, merging=False, delays=[0.0, 0.002, 0.004, 0.006]), rng=np.random.default_rng(0)
    )
    result = reconstruct(blobs, rig)
    later = 0.003 * 100
    truth = path[5:-5] + later * (path[6:-4] - path[4:-6]) / 2
    inner = range(5, 35)
    off = [np.linalg.norm(result.clouds[f][:, None] - truth[f - 5], axis=2).min(axis=0).max() for f in inner]
    assert max(off) < 2e-3
    ignored = reconstruct(replace(blobs, times=None), rig)
    assert ignored.residual.mean() > 5 * result.residual.mean(), "a hand at 1.8 m/s moves 11 mm in 6 ms: leaving the times out must show"


def test_a_volume_keeps_points_inside() -> None:
    rig, blobs, truth, _ = images(frames=4)
    result = reconstruct(blobs, rig, ReconstructionSettings(volume=[[-2, -2, 0], [2, 0, 3]]))
    assert (result.clouds.xyz[:, 1] <= 0).all()
    assert abs(len(result.clouds.xyz) - (truth[:, :, 1] < 0).sum()) <= 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"method": "magic"}, "no method magic"),
        ({"noise": 0.0}, "pixel noise"),
        ({"noise": float("nan")}, "pixel noise"),
        ({"min_cameras": 1}, "at least 1"),
        ({"min_cameras": 9}, "from 2 to 8"),
        ({"gate": 0.0}, "gate"),
        ({"volume": [[0, 0, 0], [1, 1, 0]]}, "corners"),
    ],
)
def test_settings_out_of_range_are_refused(changes: dict, message: str) -> None:
    rig, blobs, _, _ = images(frames=1)
    with pytest.raises(AsterismError, match=message):
        reconstruct(blobs, rig, ReconstructionSettings(**changes))


def test_rigs_that_cannot_do_it() -> None:
    rig, blobs, _, _ = images(3, 5, 1)
    one = Blobs.from_rows([0, 0], [0, 0], [[1, 2], [3, 4]], ["c1"])
    with pytest.raises(AsterismError, match="two calibrated cameras"):
        reconstruct(one, rig)
    alone = blobs.camera_of == 1
    with pytest.raises(AsterismError, match="all blobs are of camera c2"):
        reconstruct(Blobs.from_rows(blobs.frame_of[alone], blobs.camera_of[alone], blobs.xy[alone], blobs.cameras), rig)
    with pytest.raises(AsterismError, match="no camera c3"):
        reconstruct(blobs, Rig(rig.cameras[:2]))
    with pytest.raises(AsterismError, match="pose for 1"):
        reconstruct(blobs, Rig((rig[0], *(replace(camera, posed=False) for camera in rig.cameras[1:]))))
    heap = Rig(tuple(replace(rig[0], name=camera.name) for camera in rig))
    with pytest.raises(AsterismError, match="in one place"):
        reconstruct(blobs, heap)


def test_a_camera_without_a_pose_is_left_out_and_said() -> None:
    rig, blobs, _, _ = images(4, 10, 5)
    part = reconstruct(
        blobs, Rig((rig[0], replace(rig[1], posed=False), *rig.cameras[2:]), rig.vertical), ReconstructionSettings(noise=0.3)
    )
    mine = blobs.camera_of != 1
    three = Blobs.from_rows(blobs.frame_of[mine], np.array([0, -1, 1, 2])[blobs.camera_of[mine]], blobs.xy[mine], ["c1", "c3", "c4"])
    assert part.blobs.cameras == ("c1", "c3", "c4")
    assert codes(part.findings) == {"reconstruct-no-pose": "c2"}
    assert np.array_equal(part.clouds.xyz, reconstruct(three, rig, ReconstructionSettings(noise=0.3)).clouds.xyz)


def test_the_space_in_view_is_what_trying_many_places_says() -> None:
    rig, blobs, _, _ = images(4, 200, 1)
    borders = image_bounds(blobs, rig)
    places = np.random.default_rng(0).uniform(-6, 6, (200_000, 3))
    seen = ((rig.project(places) >= borders[0][:, None]) & (rig.project(places) <= borders[1][:, None])).all(axis=2).sum(axis=0) >= 2
    assert common_view(rig, borders, EVERYWHERE) == pytest.approx(12.0**3 * seen.mean(), rel=0.3)


def test_image_sizes_need_not_be_known() -> None:
    rig, blobs, truth, _ = images(6, 20, 10, missed=0.2)
    bare = Rig(tuple(Camera(c.name, None, c.focal, c.centre, c.rotation, c.translation, c.radial, c.tangential) for c in rig))
    assert found(reconstruct(blobs, bare), truth)[0] >= 198


def test_points_survive_in_files_with_what_they_rest_on(tmp_path: Path) -> None:
    rig, blobs, _, _ = images(9, 12, 30, missed=0.2)
    result = reconstruct(blobs, rig)
    assert result.write(tmp_path / "clouds.npz") == []
    clouds, evidence = formats.read_clouds(tmp_path / "clouds.npz"), formats.read_evidence(tmp_path / "clouds.npz")
    assert np.array_equal(clouds.xyz, result.clouds.xyz)
    assert np.array_equal(evidence.covariance, result.covariance)
    assert np.array_equal(evidence.cameras, result.cameras)
    assert evidence.camera_names == rig.names
    lost = result.write(tmp_path / "clouds.c3d")
    assert any("c8, c9" in what for what in lost)
    with warnings.catch_warnings(), (tmp_path / "clouds.c3d").open("rb") as stream:
        warnings.simplefilter("ignore")
        words = np.array([points[:, 3:] for _, points, _ in c3d.Reader(stream).read_frames()])
    frames, columns = np.repeat(np.arange(30), clouds.counts), columns_of(clouds)
    masks = words[frames, columns, 1].astype(np.int64)
    assert np.array_equal((masks[:, None] >> np.arange(7)) & 1, result.cameras[:, :7])
    assert np.abs(words[frames, columns, 0] - 1000 * result.residual * result.scale).max() < 0.006
    back = formats.read(tmp_path / "clouds.c3d")
    assert np.nanmax(np.abs(back.positions[frames, columns] - clouds.xyz)) < 1e-6
    assert result.write(tmp_path / "clouds.trc") != []
    assert formats.read_evidence(tmp_path / "clouds.c3d") is None


def test_a_damaged_file_of_points_is_refused(tmp_path: Path) -> None:
    rig, blobs, _, _ = images(3, 4, 5)
    reconstruct(blobs, rig).write(tmp_path / "clouds.npz")
    held = dict(np.load(tmp_path / "clouds.npz"))
    for changes in ({"residual": held["residual"][1:]}, {"camera_names": held["camera_names"][:2]}, {"covariance": np.array(["x"])}):
        np.savez(tmp_path / "bad.npz", **(held | changes))
        with pytest.raises(AsterismError, match=r"bad\.npz is damaged"):
            formats.read_evidence(tmp_path / "bad.npz")


def test_columns_follow_a_point_and_hold_one_of_a_frame() -> None:
    t = np.arange(50)[:, None] / 100
    paths = [np.concatenate([start + speed * t, 0 * t, 0 * t], axis=1) for start, speed in ((0.0, 2.0), (1.2, -2.0), (3.0, 0.0))]
    paths[1] = paths[1] + [0, 0.1, 0]
    frames = [np.array([path[k] for path in paths]) for k in range(50)]
    frames[20] = frames[20][:2]
    shuffled = [frame[np.random.default_rng(k).permutation(len(frame))] for k, frame in enumerate(frames)]
    clouds = Clouds.from_points(shuffled, 100.0)
    columns = columns_of(clouds)
    frame_of = np.repeat(np.arange(50), clouds.counts)
    assert len(np.unique(frame_of * 1000 + columns)) == len(columns)
    still = columns[clouds.xyz[:, 0] == 3.0]
    assert len(np.unique(still)) == 2, "the gap ends one column, and another begins"
    assert len(np.unique(columns[np.abs(clouds.xyz[:, 1] - 0.1) < 1e-9])) == 1


def test_a_foot_in_swing_that_was_hidden_for_a_frame_keeps_a_column() -> None:
    """At 50 Hz and 4 m/s the next marker of the foot is nearer than the way of a frame; the foot's other markers tell the way."""
    t = np.arange(60) / 50
    way = np.where(t < 0.4, 5.0 * t**2, 0.8 + 4.0 * (t - 0.4))
    foot = np.tile([[0.0, 0, 0], [0.07, 0, 0], [0.03, 0.06, 0]], (60, 1, 1))
    foot[:, :, 0] += way[:, None]
    frames = [np.delete(foot[k], 1, axis=0) if k == 30 else foot[k] for k in range(60)]
    clouds = Clouds.from_points(frames, 50.0)
    columns = columns_of(clouds)
    heel = [columns[clouds.offsets[k] + 1] for k in range(60) if k != 30]
    assert len(set(heel[:30])) == len(set(heel[30:])) == 1


def test_the_command_makes_points_and_its_json_says_what_the_table_shows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, blobs, _, _ = images(4, 8, 20)
    write_rig(rig, tmp_path / "rig.toml")
    formats.write_blobs(blobs, tmp_path / "2d.csv")
    words = ["reconstruct", str(tmp_path / "2d.csv"), "--rig", str(tmp_path / "rig.toml"), "-o", str(tmp_path / "clouds.npz")]
    assert main([*words, "--json", str(tmp_path / "told.json")]) == 0
    told = json.loads((tmp_path / "told.json").read_text())
    assert told["points"] == 160 == len(formats.read_clouds(tmp_path / "clouds.npz").xyz)
    assert [camera["name"] for camera in told["cameras"]] == list(rig.names)
    assert 0.2 < told["residual_px"]["median"] < 0.5
    assert "160; 8 to 8 a frame" in capsys.readouterr().out
    assert main(words) == 2
    assert "exists" in capsys.readouterr().err
    assert main([*words, "--overwrite", "--volume", "-2:2,-2:0,0:2"]) in (0, 1)
    assert (formats.read_clouds(tmp_path / "clouds.npz").xyz[:, 1] <= 0).all()


def test_a_rig_that_is_not_the_recordings_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, blobs, _, _ = images(4, 8, 20)
    turned = replace(rig[1], rotation=rotation_from_vector([0.02, 0.0, 0.01]) @ rig[1].rotation)
    write_rig(Rig((rig[0], turned, *rig.cameras[2:]), rig.vertical), tmp_path / "bumped.toml")
    formats.write_blobs(blobs, tmp_path / "2d.csv")
    words = ["reconstruct", str(tmp_path / "2d.csv"), "--rig", str(tmp_path / "bumped.toml"), "-o", str(tmp_path / "clouds.npz")]
    assert main([*words, "--json", str(tmp_path / "told.json")]) == 1
    seen = {camera["name"]: camera["used"] for camera in json.loads((tmp_path / "told.json").read_text())["cameras"]}
    assert min(seen, key=seen.__getitem__) == "c2"
    assert "camera c2 does not fit the others: " in capsys.readouterr().err


@given(st.lists(st.sampled_from([-1.5, 0.0, 0.25, 3.0, np.inf]), max_size=60))
@settings(max_examples=50, deadline=None)
def test_sorting_is_numpys(values: list[float]) -> None:
    given_values = np.array(values, dtype=np.float64)
    assert np.array_equal(ascending(given_values, len(values)), np.argsort(given_values, kind="stable"))


@pytest.mark.slow
def test_real_particles_as_many_as_the_peer_matched(data: Path) -> None:
    """The four time steps of OpenPTV's cavity, its blobs, its tolerance: it has put 1,508 points into all four cameras."""
    folder = data / "cameras" / "particles-4cam"
    rig = read_rig(folder)
    files = [(t, c, folder / "images" / f"cam{c + 1}.{10001 + t}_targets") for t in range(4) for c in range(4)]
    spots = [(t, c, np.loadtxt(file, skiprows=1)[:, 1:3] - 0.5) for t, c, file in files]  # the peer counts from the first pixel's corner
    frame, camera = (np.concatenate([np.full(len(spot[2]), spot[which]) for spot in spots]) for which in (0, 1))
    blobs = Blobs.from_rows(frame, camera, np.concatenate([xy for _, _, xy in spots]), rig.names)
    result = reconstruct(blobs, rig, ReconstructionSettings(noise=2.5, min_cameras=4))
    assert len(result.residual) >= 1508
    used = result.rays.ravel()
    assert len(np.unique(used)) == len(used), "a blob shows one particle"


def test_a_walk_seen_by_a_real_rig(data: Path) -> None:
    folder = data / "cameras" / "vicon-rig-walk"
    rig, walk = read_rig(folder / "walking_1.xcp"), formats.read(folder / "walking_1.c3d").frames(slice(800, 840))
    rng = np.random.default_rng(0)
    blobs, _ = simulate_blobs(
        rig, walk.positions, ImagingSettings(noise=0.15, strays=0.3), body=walker_capsules(walk), rng=rng, rate=walk.rate
    )
    hits, ghosts, off = found(reconstruct(blobs, rig), walk.positions)
    assert hits >= 0.995 * walk.visible.sum()
    assert ghosts <= 2
    assert np.median(off) < 4e-4
