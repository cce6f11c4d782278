"""The cloth's surface from points: triangles of the right size, no speckles, wrong points out; files that others read."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from garment_scenes import arm_rig, photos, sheet, sleeve, true_positions

from asterism.errors import AsterismError
from asterism.garment.dense import DensePoints, dense_points
from asterism.garment.surface import SurfaceRules, consistent_points, surface, write_surface
from asterism.simulation.garment import simulated_reading


@cache
def points() -> DensePoints:
    reads = [simulated_reading(photo.truth, 0.05, rng=np.random.default_rng(i)) for i, photo in enumerate(photos())]
    return dense_points(arm_rig(), reads)


def moved(index: int, by: tuple[float, float, float]) -> DensePoints:
    positions = points().positions.copy()
    positions[index] += by
    return replace(points(), positions=positions)


def test_right_points_all_stay() -> None:
    assert len(consistent_points(points(), sleeve().pattern)) == len(points())


def test_a_point_that_cloth_contradicts_is_dropped_and_no_other() -> None:
    for index in (5, len(points()) // 2, len(points()) - 7):
        kept = consistent_points(moved(index, (0.03, 0.02, 0.0)), sleeve().pattern)
        assert len(kept) == len(points()) - 1
        assert points().ids[index] not in kept.ids
        np.testing.assert_array_equal(kept.positions, np.delete(points().positions, index, axis=0))
        assert len(kept.covariance) == len(kept.cameras) == len(kept.misfit) == len(kept)


def test_two_wrong_neighbours_leave_together() -> None:
    pattern = sleeve().pattern
    cells = {tuple(cell): i for i, cell in enumerate(pattern.cells(points().ids).tolist())}
    first = next(i for (row, col), i in cells.items() if all((row + a, col + b) in cells for a in (-1, 0, 1) for b in (-1, 0, 1, 2)))
    row, col = pattern.cells(points().ids)[first]
    second = cells[row, col + 1]
    both = moved(first, (0.05, 0.0, 0.03))
    both.positions[second] += (0.05, 0.0, 0.03)
    kept = consistent_points(both, pattern)
    assert set(points().ids.tolist()) - set(kept.ids.tolist()) == {int(points().ids[first]), int(points().ids[second])}


def test_an_uncertain_distance_is_allowed_more() -> None:
    far = moved(5, (0.03, 0.02, 0.0))
    covariance = far.covariance.copy()
    covariance[5] = 0.02**2 * np.eye(3)
    assert len(consistent_points(replace(far, covariance=covariance), sleeve().pattern)) == len(points())


def test_the_surface_is_that_of_the_arm() -> None:
    """Its triangles look outward, have the print's density, and their corners are neighbours on the cloth."""
    cloth = surface(points(), sleeve().pattern)
    assert 28 < cloth.density < 36, f"{cloth.density:.1f} points per 100 cm2; a pitch of 18 mm gives 30.9"
    a, b, c = (cloth.points[cloth.triangles[:, k]] for k in range(3))
    towards = np.mean([camera.position for camera in arm_rig()], axis=0)
    assert np.mean(np.einsum("ti,ti->t", np.cross(b - a, c - a), towards - a) > 0) > 0.98
    cells = sleeve().pattern.cells(cloth.ids)[cloth.triangles]
    assert np.abs(np.diff(cells, axis=1)).max() == 1
    edges = {frozenset(pair) for triangle in cloth.triangles.tolist() for pair in zip(triangle, triangle[1:] + triangle[:1], strict=True)}
    count = len(cloth.points) - len(edges) + len(cloth.triangles)
    assert 0 <= count <= 3, "a sheet with few holes has an Euler number near 1"
    assert len({frozenset(triangle) for triangle in cloth.triangles.tolist()}) == len(cloth.triangles)


def test_a_flat_sheet_has_the_area_that_it_has() -> None:
    pattern = sheet(7, 9)
    inner = pattern.ids >= 0
    order = np.argsort(pattern.ids[inner])
    ids, flat = pattern.ids[inner][order], pattern.positions()[inner][order]
    empty = np.empty((0, 2), dtype=np.int64)
    given = DensePoints(
        ids,
        flat,
        np.tile(1e-8 * np.eye(3), (len(ids), 1, 1)),
        np.full(len(ids), 2),
        np.zeros(len(ids)),
        1.0,
        len(ids),
        empty,
        empty,
        np.ones(2, int),
    )
    cloth = surface(given, pattern)
    assert cloth.area == pytest.approx(4 * 6 * 0.068**2)
    assert len(cloth.triangles) == 2 * 4 * 6
    assert cloth.density == pytest.approx(0.01 / 0.068**2)
    middle = np.flatnonzero((pattern.cells(ids) == [3, 4]).all(axis=1))[0]
    holed = replace(
        given, **{name: np.delete(getattr(given, name), middle, axis=0) for name in ("ids", "positions", "covariance", "cameras", "misfit")}
    )
    assert len(surface(holed, pattern).triangles) == 2 * 4 * 6 - 8 + 4


def test_speckles_are_left_out() -> None:
    pattern = sleeve().pattern
    cells = pattern.cells(points().ids)
    rows = np.flatnonzero((cells[:, 0] <= cells[:, 0].min() + 1) | (cells[:, 0] >= cells[:, 0].min() + 4))
    few = np.flatnonzero((cells[:, 0] == cells[:, 0].min()) & (cells[:, 1] <= np.sort(cells[cells[:, 0] == cells[:, 0].min(), 1])[2]))
    chosen = np.union1d(few, rows[cells[rows, 0] >= cells[:, 0].min() + 4])
    part = replace(points(), **{name: getattr(points(), name)[chosen] for name in ("ids", "positions", "covariance", "cameras", "misfit")})
    assert not np.isin(points().ids[few], surface(part, pattern).ids).any()
    assert np.isin(points().ids[few], surface(part, pattern, SurfaceRules(least=1)).ids).all()


def test_nothing_gives_an_empty_surface() -> None:
    nothing = replace(points(), **{name: getattr(points(), name)[:0] for name in ("ids", "positions", "covariance", "cameras", "misfit")})
    cloth = surface(nothing, sleeve().pattern)
    assert len(cloth.points) == len(cloth.triangles) == 0 and np.isnan(cloth.density)
    assert len(consistent_points(nothing, sleeve().pattern)) == 0


def test_files_hold_the_surface(tmp_path) -> None:
    cloth = surface(points(), sleeve().pattern)
    data = write_surface(tmp_path / "a.ply", cloth, sleeve().pattern).read_bytes()
    head, body = data.split(b"end_header\n", 1)
    assert f"element vertex {len(cloth.points)}".encode() in head and f"element face {len(cloth.triangles)}".encode() in head
    vertices = np.frombuffer(body[: 19 * len(cloth.points)], dtype=[("xyz", "<f4", 3), ("ink", "u1", 3), ("id", "<i4")])
    np.testing.assert_allclose(vertices["xyz"], cloth.points, atol=1e-6)
    np.testing.assert_array_equal(vertices["id"], cloth.ids)
    assert len(np.unique(vertices["ink"], axis=0)) == 4
    faces = np.frombuffer(body[19 * len(cloth.points) :], dtype=[("count", "u1"), ("corners", "<i4", 3)])
    np.testing.assert_array_equal(faces["corners"], cloth.triangles)
    text = write_surface(tmp_path / "a.obj", cloth).read_text().splitlines()
    corners = np.array([[int(part) for part in line.split()[1:]] for line in text if line.startswith("f ")])
    np.testing.assert_array_equal(corners - 1, cloth.triangles)
    with pytest.raises(AsterismError, match=r"\.ply or \.obj"):
        write_surface(tmp_path / "a.stl", cloth)


def test_another_garments_points_are_said() -> None:
    unknown = np.setdiff1d(np.arange(32640), sleeve().pattern.known)[:1].astype(np.int32)
    with pytest.raises(AsterismError, match=f"identity {unknown[0]} does not occur"):
        surface(replace(points(), ids=np.concatenate([unknown, points().ids[1:]])), sleeve().pattern)
    assert true_positions(sleeve()).keys() == set(sleeve().pattern.known.tolist())
