"""Kernels of the reconstruction that decide: each equals its slow twin, or what trying all possibilities gives."""

from __future__ import annotations

import numpy as np
import pytest
import twins_reconstruction as twins
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism.cameras import Camera, Rig
from asterism.cameras.accuracy.sensitivity import sensitivity
from asterism.reconstruction import ReconstructionSettings, _pack_kernels, reconstruct
from asterism.reconstruction._compose_kernels import compose
from asterism.reconstruction._fit_kernels import FitWorkspace, closest_point, fit, fit_and_prune, fit_workspace
from asterism.reconstruction._frame_kernels import attach_available, count_visibility
from asterism.reconstruction._hypothesis_kernels import holders_by_blob
from asterism.reconstruction._input_kernels import END, FIRST, GATE, FrameArrays, RigArrays, first_of_duplicates, frame_arrays
from asterism.reconstruction._order_kernels import ascending
from asterism.reconstruction._plain_kernels import _compose_pairs, merge_versions
from asterism.reconstruction._score_kernels import best_blob, score
from asterism.reconstruction._shared_kernels import add_without_shared
from asterism.reconstruction.problem import ObservationModel, ReconstructionProblem, image_bounds
from asterism.reconstruction.rays import to_rays
from asterism.recording import Blobs
from asterism.simulation.cameras import ImagingSettings, ring_rig, simulate_blobs

pytestmark = pytest.mark.kernels

EVERYWHERE = np.array([[-np.inf] * 3, [np.inf] * 3])
Case = tuple[Rig, Blobs, RigArrays, FrameArrays, np.ndarray]


def crowd(seed: int, cameras: int = 5, markers: int = 14) -> Case:
    """One frame of markers within half a metre, so that blobs overlap, hide and belong to several hypotheses."""
    rng = np.random.default_rng(seed)
    rig = ring_rig(cameras, rng=rng)
    points = rng.uniform([-0.25, -0.25, 0.6], [0.25, 0.25, 1.1], (markers, 3))
    blobs, _ = simulate_blobs(rig, points, ImagingSettings(noise=0.5, missed=0.15, strays=2.0), rng=rng)
    bounds = image_bounds(blobs, rig)
    model = ObservationModel(np.full(cameras, 0.5), np.full(cameras, 0.7), np.full(cameras, 0.5), 30.0, 50.0)
    arrays = ReconstructionProblem(rig, bounds, EVERYWHERE, 50.0, 2, 4.0).arrays(model)
    rays, _, _ = to_rays(blobs, rig)
    return rig, rays.blobs, arrays, frame_arrays(rays.normalised, rays.jacobian, rays.blobs.offsets), bounds


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_duplicates_are_those_of_the_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    offsets = np.concatenate([[0], np.cumsum(rng.integers(0, 9, 4))])
    xy = rng.integers(0, 3, (offsets[-1], 2)).astype(float)
    out = np.empty(len(xy), np.bool_)
    first_of_duplicates(xy, offsets, out)
    assert out.tolist() == twins.first_of_duplicates(xy, offsets)


@pytest.mark.parametrize("depth", [1.02e-9, 1e-6, 1.0, 1e300])
@pytest.mark.parametrize("aside", [0.0, 10.0, -10.0, 1e12, -1e12, 1e300])
@pytest.mark.parametrize("exact", [1e-300, 1.0, 1e40])
def test_a_place_however_far_aside_has_a_blob_or_none(depth: float, aside: float, exact: float) -> None:
    """Nearly in a camera's focal plane a place lies so far aside in its image that no whole number holds the cell."""
    rng = np.random.default_rng(0)
    rig = ring_rig(3, rng=rng)
    blobs, _ = simulate_blobs(rig, np.array([[0.0, 0.0, 1.0]]), ImagingSettings(noise=0.5, strays=0.0, missed=0.0), rng=rng)
    model = ObservationModel(np.full(3, 0.5), np.full(3, 0.7), np.full(3, 0.5), 30.0, 50.0)
    arrays = ReconstructionProblem(rig, image_bounds(blobs, rig), EVERYWHERE, 50.0, 2, 4.0).arrays(model)
    rays, _, _ = to_rays(blobs, rig)
    frame, work = frame_arrays(rays.normalised, rays.jacobian, rays.blobs.offsets), fit_workspace()
    camera = arrays.cameras[0]
    work.point[:] = camera[:9].reshape(3, 3).T @ (np.array([aside, frame.blobs[0, 1] * depth, depth]) - camera[9:12])
    work.information[:] = exact * np.array([1.0, 0, 0, 1.0, 0, 1.0])
    blob, square = best_blob(arrays, frame, 0, work, np.ones(len(frame.blobs), np.bool_))
    assert (blob == -1 and square > 0) or 0 <= blob < len(frame.blobs)


@pytest.mark.parametrize("seed", range(4))
def test_rays_that_do_not_fit_are_dropped_as_by_the_twin(seed: int) -> None:
    _, _, arrays, frame, _ = crowd(seed)
    found, count, _ = compose(arrays, frame)
    rng = np.random.default_rng(seed)
    left = []
    for n in range(count):
        rays = found.rays[n].copy()
        for c in rng.integers(0, len(rays), 2):
            others = np.arange(frame.grid[c, FIRST], frame.grid[c, END], dtype=np.int64)
            rays[c] = rng.choice(others)
        if (rays >= 0).sum() < 2:
            continue
        expected, fits = twins.pruned(arrays, frame, rays, found.points[n], 6)
        work = fit_workspace()
        work.point[:] = found.points[n]
        square, many = fit_and_prune(arrays, frame, rays, work, 6)
        assert (square < np.inf) == fits
        assert not fits or rays.tolist() == expected
        assert not fits or many == (np.array(expected) >= 0).sum()
        left.append(many if fits else 0)
    assert len(set(left)) > 2, "some lose rays, and some are lost"


@pytest.mark.parametrize("axis", range(3))
def test_a_fit_from_far_off_ends_where_its_residuals_are_least(axis: int) -> None:
    """There the twin's next step is none, and the sum of squares is the twin's."""
    _, _, arrays, frame, _ = crowd(1)
    found, count, _ = compose(arrays, frame)
    for n in range(count):
        for off in (-0.4, 0.4):
            work = fit_workspace()
            work.point[:] = found.points[n] + off * np.eye(3)[axis]
            square, largest, camera = fit(arrays, frame, found.rays[n], work, 30)
            information, gradient, squares = twins.normal_equations(arrays, frame, found.rays[n], work.point)
            assert np.linalg.norm(np.linalg.solve(information, gradient)) < 1e-6
            assert square == pytest.approx(sum(squares.values()), abs=1e-6)
            assert squares[camera] == pytest.approx(largest, abs=1e-3)


def test_rays_that_do_not_determine_a_point_in_front_of_their_cameras_fit_nowhere() -> None:
    rig = Rig(
        (Camera("a", None, (800.0, 800.0), (500.0, 400.0)), Camera("b", None, (800.0, 800.0), (500.0, 400.0), translation=[-1, 0, 0]))
    )
    blobs = Blobs.from_rows([0, 0], [0, 1], [[500.0, 400.0], [300.0, 400.0]], rig.names)
    model = ObservationModel(np.full(2, 0.5), np.full(2, 0.7), np.full(2, 0.5), 30.0, 50.0)
    arrays = ReconstructionProblem(rig, image_bounds(blobs, rig), EVERYWHERE, 50.0, 2, 4.0).arrays(model)
    rays, _, _ = to_rays(blobs, rig)
    frame = frame_arrays(rays.normalised, rays.jacobian, rays.blobs.offsets)
    for some, z, fits in (([0, 1], 4.0, True), ([0, -1], 4.0, False), ([-1, -1], 4.0, False), ([0, 1], -4.0, False)):
        work = fit_workspace()
        work.point[:] = 0.0, 0.0, z
        assert np.isfinite(fit(arrays, frame, np.array(some), work, 3)[:2]).all() == fits, (some, z)


def test_pairs_of_rays_are_composed_with_the_spread_of_the_twin() -> None:
    """The trace of the inverse of both rays' information, where they come nearest."""
    _, _, arrays, frame, _ = crowd(2, cameras=4, markers=8)
    rays, points, spreads = np.empty((5000, 4), np.int64), np.empty((5000, 3)), np.empty(5000)
    count = _compose_pairs(arrays, frame, rays, points, spreads)
    assert 20 < count < 5000
    assert ((rays[:count] >= 0).sum(axis=1) == 2).all()
    for n in range(count):
        information = twins.normal_equations(arrays, frame, rays[n], points[n])[0]
        assert spreads[n] == pytest.approx(np.trace(np.linalg.inv(information)), rel=1e-6)


def test_two_rays_stay_where_both_together_fit() -> None:
    _, _, arrays, frame, _ = crowd(3)
    a, b = arrays.pairs[0]
    together = 0
    for i in range(int(frame.grid[a, FIRST]), int(frame.grid[a, END])):
        for j in range(int(frame.grid[b, FIRST]), int(frame.grid[b, END])):
            rays, start = np.full(5, -1), np.empty(3)
            rays[a], rays[b] = i, j
            if not closest_point(arrays, frame, 0, i, j, start):
                continue
            work = fit_workspace()
            work.point[:] = start
            square, _ = fit_and_prune(arrays, frame, rays.copy(), work, 6)
            assert (square < np.inf) == twins.pruned(arrays, frame, rays, start, 6)[1]
            squares = twins.normal_equations(arrays, frame, rays, work.point)[2].values()
            together += max(squares) < 16.0 < sum(squares)
    assert together, "no pair fits in each camera and not in both"


@pytest.mark.parametrize("seed", range(4))
def test_the_score_is_that_of_the_twin(seed: int) -> None:
    rig, _, arrays, frame, bounds = crowd(seed)
    found, count, _ = compose(arrays, frame)
    rng = np.random.default_rng(seed)
    for n in range(count):
        rays = np.where(rng.random(len(rig)) < 0.3, -1, found.rays[n])
        work = fit_workspace()
        work.point[:] = found.points[n] + rng.normal(0, 0.3, 3) * (n % 2)
        square = fit(arrays, frame, found.rays[n], work, 0)[0]
        expected = twins.scored(arrays, rig, frame, rays, work, square, bounds)
        assert score(arrays, frame, rays, work, square) == pytest.approx(expected, rel=1e-9)
    assert score(arrays, frame, found.rays[0], FitWorkspace(np.zeros(3), np.zeros(6), np.zeros(3)), 1.0) == -np.inf


@pytest.mark.parametrize("seed", range(6))
def test_composition_finds_what_trying_all_pairs_of_blobs_finds(seed: int) -> None:
    _, _, arrays, frame, _ = crowd(seed)
    found, count, gated = compose(arrays, frame)
    expected, passing = twins.composed(arrays, frame)
    assert gated == passing
    assert [tuple(rays) for rays in found.rays[:count].tolist()] == expected
    assert count > 14, "nothing to decide"


def test_pairs_of_a_wide_gate_are_all_composed_however_many_there_are() -> None:
    """Two cameras, all blobs of one with all of the other: more pairs than there is room for at once."""
    _, _, arrays, frame, _ = crowd(0, cameras=2, markers=20)
    arrays.limits[GATE] = 1e4
    found, count, gated = compose(arrays, frame)
    expected, pairs = twins.composed(arrays, frame)
    fullest = int((frame.grid[:, END] - frame.grid[:, FIRST]).max())
    assert gated == pairs > 16 * fullest
    assert [tuple(row) for row in found.rays[:count].tolist()] == expected


def test_hypotheses_without_shared_blobs_are_those_of_the_twin() -> None:
    added = 0
    for seed in range(8):
        _, _, arrays, frame, _ = crowd(seed)
        found, count, _ = compose(arrays, frame)
        rays, points, scores = found.rays[:count].copy(), found.points[:count].copy(), found.scores[:count].copy()
        more, total = add_without_shared(arrays, frame, found, count)
        expected = twins.without_shared(arrays, frame, rays, points, scores)
        assert [tuple(row) for row in more.rays[count:total].tolist()] == [row for row, _ in expected]
        assert more.scores[count:total].tolist() == [worth for _, worth in expected]
        assert np.array_equal(more.rays[:count], rays)
        added += len(expected)
    assert added > 8, "nothing was shared"


def test_available_blobs_are_attached_as_by_the_twin() -> None:
    gained = kept = exchanged = 0
    for seed in range(6):
        _, _, arrays, frame, _ = crowd(seed)
        found, count, _ = compose(arrays, frame)
        rng = np.random.default_rng(seed)
        for n in range(count):
            rays = np.where(rng.random(found.rays.shape[1]) < 0.4, -1, found.rays[n])
            seeing = np.flatnonzero(rays >= 0)
            if len(seeing) < 2:
                continue
            if n % 2:
                c = rng.choice(seeing)
                own = np.arange(frame.grid[c, FIRST], frame.grid[c, END], dtype=np.int64)
                away = np.linalg.norm(frame.blobs[own, :2] - frame.blobs[rays[c], :2], axis=1)
                rays[c] = own[np.argsort(away)[min(1, len(own) - 1)]]
            before = rays.copy()
            available = rng.random(len(frame.blobs)) < 0.7
            available[rays[rays >= 0]] = False
            expected, free = twins.attached(arrays, frame, rays.copy(), found.points[n], set(np.flatnonzero(available).tolist()))
            work = fit_workspace()
            work.point[:] = found.points[n]
            attach_available(arrays, frame, rays, work, available)
            assert tuple(rays.tolist()) == expected
            assert set(np.flatnonzero(available).tolist()) == free
            gained += (rays >= 0).sum() > (before >= 0).sum()
            kept += (rays == before).all()
            exchanged += ((before >= 0) & (rays < 0)).any() and (rays >= 0).sum() == (before >= 0).sum()
    assert gained and kept and exchanged, "some get a blob, some do not, some exchange one for another"


def test_visibility_is_counted_as_by_the_rigs_own_projection() -> None:
    rng = np.random.default_rng(2)
    rig = ring_rig(6, rng=rng)
    points = rng.uniform([-2.5, -2.5, -0.5], [2.5, 2.5, 3], (400, 3))
    rays = rng.integers(-1, 2, (400, 6))
    bounds = image_bounds(Blobs.from_rows([], [], np.empty((0, 2)), rig.names), rig)
    model = ObservationModel(np.full(6, 0.5), np.full(6, 0.7), np.full(6, 0.5), 30.0, 50.0)
    expected, seen = np.zeros(6, np.int64), np.zeros(6, np.int64)
    count_visibility(ReconstructionProblem(rig, bounds, EVERYWHERE, 50.0, 2, 4.0).arrays(model), points, rays, expected, seen)
    twin = twins.visibility(rig, points, rays, bounds)
    assert (expected.tolist(), seen.tolist()) == (twin[0].tolist(), twin[1].tolist())
    assert 0 < seen.sum() < expected.sum() < 2400


def merging(seed: int, count: int) -> tuple[Rig, RigArrays, np.ndarray, np.ndarray, np.ndarray]:
    """Versions of points of two cameras each in a cube of 20 cm, some of which share blobs: rig, rays, places and spreads."""
    rng = np.random.default_rng(seed)
    rig = ring_rig(4, rng=np.random.default_rng(0))
    bounds = image_bounds(Blobs.from_rows([], [], np.empty((0, 2)), rig.names), rig)
    model = ObservationModel(np.full(4, 5.0), np.full(4, 0.7), np.full(4, 0.5), 30.0, 50.0)
    rays = rng.integers(0, 3, (count, 4))
    for row in rays:
        row[rng.permutation(4)[:2]] = -1
    points, spreads = rng.uniform([-0.1, -0.1, 0.9], [0.1, 0.1, 1.1], (count, 3)), rng.uniform(0.00001, 0.001, count)
    return rig, ReconstructionProblem(rig, bounds, EVERYWHERE, 50.0, 2, 4.0).arrays(model), rays, points, spreads


@given(st.integers(0, 2**32 - 1), st.integers(1, 25))
@settings(max_examples=60, deadline=None)
def test_versions_are_merged_by_covariance_as_by_the_twin(seed: int, count: int) -> None:
    _, arrays, rays, points, spreads = merging(seed, count)
    order = np.argsort(spreads, kind="stable").tolist()
    expected = twins.merged(rays, points, order, lambda n, first, _: 4.0 * (spreads[n] + spreads[first]) ** 0.5)
    groups = merge_versions(arrays, rays, points, spreads, count, True)
    assert [tuple(row) for row in rays[:groups].tolist()] == [row for row, _ in expected]
    assert np.allclose(points[:groups], [point for _, point in expected], atol=1e-12)


@given(st.integers(0, 2**32 - 1), st.integers(1, 25))
@settings(max_examples=60, deadline=None)
def test_versions_are_merged_by_the_sensitivity_as_by_the_twin(seed: int, count: int) -> None:
    """S is that of `asterism.cameras.accuracy` for the cameras of both, for pixels moved by four deviations of 5 px."""
    rig, arrays, rays, points, spreads = merging(seed, count)
    cameras = [rig.select([rig.names[c] for c in np.flatnonzero(row >= 0)]) for row in rays]

    def limit(n: int, first: int, place: np.ndarray) -> float:
        return float(np.mean([sensitivity(cameras[of], place, 4.0 * 5.0).effective for of in (n, first)]))

    expected = twins.merged(rays, points, list(range(count)), limit)
    groups = merge_versions(arrays, rays, points, spreads, count, False)
    assert [tuple(row) for row in rays[:groups].tolist()] == [row for row, _ in expected]
    assert np.allclose(points[:groups], [point for _, point in expected], atol=1e-12)


def test_both_rules_merge_some_versions_and_not_the_same_ones() -> None:
    found = []
    for by_covariance in (False, True):
        _, arrays, rays, points, spreads = merging(1, 25)
        groups = merge_versions(arrays, rays, points, spreads, 25, by_covariance)
        assert 2 < groups < 25
        assert ((rays[:groups] >= 0).sum(axis=1) > 2).any(), "no group has more than two cameras"
        found.append({tuple(row) for row in rays[:groups].tolist()})
    assert found[0] != found[1]


def test_the_plain_method_gives_every_pair_of_rays_that_meets() -> None:
    """Two cameras: each version is one pair, and none is merged, so that the plain method gives the gated pairs one by one."""
    rng = np.random.default_rng(4)
    rig = ring_rig(2, rng=rng)
    blobs, _ = simulate_blobs(
        rig, rng.uniform([-0.5, -0.5, 0.5], [0.5, 0.5, 1.5], (12, 3)), ImagingSettings(noise=0.5, merging=False), rng=rng
    )
    result = reconstruct(blobs, rig, ReconstructionSettings(method="plain", noise=0.5))
    expected = set()
    for i, one in enumerate(blobs.of(0, 0)):
        for j, other in enumerate(blobs.of(0, 1)):
            p, q, d, e = rig[0].position, rig[1].position, rig[0].rays(one), rig[1].rays(other)
            s, t = np.linalg.lstsq(np.stack([d, -e], axis=1), q - p, rcond=None)[0]
            x = (p + s * d + q + t * e) / 2
            for _ in range(5):
                step = 1e-6 * np.eye(3)
                pixels = lambda at: np.concatenate([rig[0].project(at), rig[1].project(at)])  # noqa: E731
                residual = np.concatenate([one, other]) - pixels(x)
                jacobian = np.array([pixels(x + h) - pixels(x - h) for h in step]).T / 2e-6
                x = x + np.linalg.lstsq(jacobian, residual, rcond=None)[0]
            square = ((np.concatenate([one, other]) - pixels(x)) ** 2).sum() / 0.25
            if s > 0 and t > 0 and square <= 16:
                expected.add((i, len(blobs.of(0, 0)) + j))
    assert {tuple(rays) for rays in result.rays.tolist()} == expected
    assert len(expected) > 12, "ghosts as well"


@given(st.integers(0, 2**32 - 1), st.integers(2, 4), st.integers(1, 10))
@settings(max_examples=80, deadline=None)
def test_packing_is_as_good_as_the_best_of_all_sets(seed: int, cameras: int, hypotheses: int) -> None:
    rays, scores, blobs = conflicts(seed, cameras, hypotheses)
    chosen, unproved = _pack_kernels.pack(rays, scores, hypotheses, blobs, float(_pack_kernels.MOST_WORK))
    assert twins.conflict_free(rays, tuple(np.flatnonzero(chosen).tolist()))
    assert unproved == 0
    assert scores[chosen].sum() == pytest.approx(twins.best_set(rays, scores), abs=1e-9)


@given(st.integers(0, 2**32 - 1), st.integers(2, 4), st.integers(1, 10))
@settings(max_examples=80, deadline=None)
def test_the_search_in_a_component_finds_the_best_of_all_sets(seed: int, cameras: int, hypotheses: int) -> None:
    rays, scores, blobs = conflicts(seed, cameras, hypotheses)
    problem, component = packing(rays, scores, blobs)
    chosen = np.zeros(hypotheses, np.bool_)
    assert _pack_kernels._search(problem, component, chosen)
    assert twins.conflict_free(rays, tuple(np.flatnonzero(chosen).tolist()))
    assert scores[chosen].sum() == pytest.approx(twins.best_set(rays, scores), abs=1e-9)


@given(st.integers(0, 2**32 - 1), st.integers(2, 4), st.integers(1, 30))
@settings(max_examples=80, deadline=None)
def test_exchanges_are_those_of_the_twin(seed: int, cameras: int, hypotheses: int) -> None:
    rays, scores, blobs = conflicts(seed, cameras, hypotheses)
    problem, component = packing(rays, scores, blobs)
    rng = np.random.default_rng(seed)
    start: set[int] = set()
    for k in rng.permutation(hypotheses).tolist():
        if twins.conflict_free(rays, (*start, k)):
            start.add(k)
    best = np.isin(np.arange(hypotheses), list(start))
    _pack_kernels._exchange(problem, component, best)
    assert set(np.flatnonzero(best).tolist()) == twins.exchanged(rays, scores, start)


@pytest.mark.parametrize("many", [200, 4000])
def test_exchanges_end_when_they_have_looked_at_rivals_often_enough(many: int) -> None:
    """All want blob 0 or 2 beside the best one; only the two worst do not want the same, and together are worth more than the best."""
    rays = np.tile([0, 2], (many, 1))
    rays[-2:] = [[0, 3], [1, 2]]
    scores = np.concatenate([[10.0], np.linspace(9.0, 7.0, many - 3), [6.0, 6.0]])
    problem, component = packing(rays, scores, 4)
    best = np.arange(many) == 0
    _pack_kernels._exchange(problem, component, best)
    looks = 2 * many * many
    exchanged = [many - 2, many - 1] if looks < _pack_kernels.MOST_WORK else [0]
    assert np.flatnonzero(best).tolist() == exchanged


def conflicts(seed: int, cameras: int, hypotheses: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Hypotheses (n, C) by falling score that want the same few blobs, their scores, and how many blobs there are."""
    rng = np.random.default_rng(seed)
    each = int(rng.integers(2, 6))
    rays = rng.integers(-1, each, (hypotheses, cameras))
    rays[:, 0] = np.maximum(rays[:, 0], 0)
    rays = np.where(rays >= 0, rays + np.arange(cameras) * each, -1)
    return rays, np.sort(rng.uniform(0.1, 10.0, hypotheses))[::-1].copy(), cameras * each


def packing(rays: np.ndarray, scores: np.ndarray, blobs: int) -> tuple[_pack_kernels.Packing, _pack_kernels.Component]:
    """All hypotheses, which are by falling score, as one component."""
    order = ascending(-scores, len(scores))
    starts, holders = holders_by_blob(rays, order, blobs)
    return _pack_kernels.Packing(rays, scores, starts, holders, float(_pack_kernels.MOST_WORK)), _pack_kernels.Component(
        order, np.arange(len(scores))
    )
