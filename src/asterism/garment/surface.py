"""Points of a garment at one moment in; those that fit the cloth, and its surface as triangles, out: also as PLY and OBJ files."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from asterism.errors import AsterismError
from asterism.files.atomic import utf8, write_atomically
from asterism.garment.dense import DensePoints
from asterism.garment.pattern import Pattern
from asterism.recording import Floats, Ints

Bools = NDArray[np.bool_]

_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Rows and columns to half of a circle's neighbours; the other half are theirs."""


@dataclass(frozen=True)
class SurfaceRules:
    """What cloth can do.

    stretch   factor on the distance of neighbours on the flat sheet beyond which they cannot both be right; simulated folds and joints
              stretch the print by 1.15 at most
    certain   standard deviations of the distance that are allowed on top
    least     points that hang together; smaller groups are speckles
    """

    stretch: float = 1.35
    certain: float = 4.0
    least: int = 4


@dataclass(frozen=True)
class Surface:
    """The cloth at one moment.

    ids        (m,) int32
    points     (m, 3) m
    triangles  (t, 3) int32 places in `points`, counter-clockwise as seen from outside
    """

    ids: NDArray[np.int32]
    points: Floats
    triangles: NDArray[np.int32]

    @property
    def area(self) -> float:
        """m2, of all triangles."""
        a, b, c = (self.points[self.triangles[:, k]] for k in range(3))
        return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())

    @property
    def density(self) -> float:
        """Points per 100 cm2 of cloth: half as many as triangles, of a grid without borders; NaN where there are none."""
        return 0.5 * len(self.triangles) / (self.area / 0.01) if len(self.triangles) else float("nan")


def consistent_points(points: DensePoints, pattern: Pattern, rules: SurfaceRules | None = None) -> DensePoints:
    """The points without those that cloth contradicts.

    Neighbours on the sheet are at most `stretch` times as far apart as they are printed. Where two are farther, one is wrong: points leave
    one after the other, always the one with the largest share of its neighbours too far away (of equal ones that with fewer good
    neighbours, then the least certain), until none is. A point without neighbours stays. What two cameras see along a common plane cannot
    be told by reprojection; this tells it. O(m log m).
    """
    rules = rules or SurfaceRules()
    grid = _grid_of(points, pattern)
    edges = [_edge(points, grid, pattern, rules, step) for step in range(len(_STEPS))]
    wrong, right = (
        np.concatenate([np.stack([edge.one[which(edge)], edge.other[which(edge)]], axis=1) for edge in edges])
        for which in (lambda edge: edge.far, lambda edge: edge.good)
    )
    bad = np.bincount(wrong.ravel(), minlength=len(points)).astype(np.float64)
    good = np.bincount(right.ravel(), minlength=len(points)).astype(np.float64)
    size = np.trace(points.covariance, axis1=1, axis2=2)
    kept = np.ones(len(points), dtype=np.bool_)
    # The worst neighbour leaves first and the others are counted again, because one wrong point accuses all around it.
    while (bad[kept] > 0).any():
        rows = np.flatnonzero(kept & (bad > 0))
        share = bad[rows] / (bad[rows] + good[rows])
        # Ties go to the point with fewer good neighbours, then to the less certain one.
        worst = rows[np.lexsort((-size[rows], good[rows], -share))[0]]
        kept[worst] = False
        for pairs, count in ((wrong, bad), (right, good)):
            touched = pairs[(pairs[:, 0] == worst) | (pairs[:, 1] == worst)]
            others = touched[touched != worst]
            count[others] -= 1.0
        bad[worst] = 0.0
    return _selected(points, kept)


def surface(points: DensePoints, pattern: Pattern, rules: SurfaceRules | None = None) -> Surface:
    """Triangles between neighbours on the cloth, without speckles: groups of fewer than `least` points that hang together.

    Of four neighbours in a square the shorter diagonal is taken; three make one triangle. No triangle has a side that cloth cannot have.
    The seams between pieces, and between the two edges of a piece, stay open. O(m).
    """
    rules = rules or SurfaceRules()
    grid = _grid_of(points, pattern)
    edges = [_edge(points, grid, pattern, rules, step) for step in range(len(_STEPS))]
    held = np.concatenate([np.stack([edge.one[edge.good], edge.other[edge.good]], axis=1) for edge in edges])
    count = len(points)
    # Points that hang together form groups; small groups on their own are speckles.
    hang = coo_array((np.ones(len(held)), (held[:, 0], held[:, 1])), shape=(count, count))
    group = connected_components(hang, directed=False)[1] if count else np.empty(0, dtype=np.int64)
    large = np.bincount(group, minlength=1)[group] >= rules.least if count else np.empty(0, dtype=np.bool_)
    triangles = _triangles(points.positions, grid, edges)
    triangles = triangles[large[triangles].all(axis=1)]
    number = np.cumsum(large) - 1
    return Surface(points.ids[large], points.positions[large], number[triangles].astype(np.int32).reshape(-1, 3))


def write_surface(path: str | Path, cloth: Surface, pattern: Pattern | None = None) -> Path:
    """Write a surface as PLY (binary, with the inks as colours where the pattern is given) or OBJ, by the suffix, in metres.

    Raises AsterismError for any other suffix and where the file cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".ply", ".obj"):
        raise AsterismError(f"{path}: a surface is written as .ply or .obj; choose one of them.")
    write_atomically(path, _ply(cloth, pattern) if suffix == ".ply" else _obj(cloth))
    return path


def _ply(cloth: Surface, pattern: Pattern | None) -> bytes:
    inks = np.full((len(cloth.ids), 3), 200, dtype=np.uint8)
    if pattern is not None:
        # Vertices carry their ink, so that a viewer shows the print.
        shown = np.array([colorsys.hsv_to_rgb(*colour) for colour in pattern.hsv])
        cells = pattern.cells(cloth.ids)
        inks = np.rint(255 * shown[pattern.colours[cells[:, 0], cells[:, 1]]]).astype(np.uint8)
    vertices = np.empty(len(cloth.ids), dtype=[("xyz", "<f4", 3), ("ink", "u1", 3), ("id", "<i4")])
    vertices["xyz"], vertices["ink"], vertices["id"] = cloth.points, inks, cloth.ids
    faces = np.empty(len(cloth.triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, cloth.triangles
    head = [
        "ply", "format binary_little_endian 1.0", "comment metres; id is the circle's identity", f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"), *(f"property uchar {ink}" for ink in ("red", "green", "blue")), "property int id",
        f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header",
    ]  # fmt: skip
    return utf8("\n".join(head) + "\n") + vertices.tobytes() + faces.tobytes()


def _obj(cloth: Surface) -> bytes:
    lines = ["# metres", *(f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in cloth.points.tolist())]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in cloth.triangles.tolist()]
    return utf8("\n".join(lines) + "\n")


def _grid_of(points: DensePoints, pattern: Pattern) -> Ints:
    """(rows + 2, cols + 2) the place of each cell's point, -1 where there is none; one cell of margin on all sides.

    Raises AsterismError where an identity is not of the pattern.
    """
    cells = pattern.cells(points.ids)
    if len(cells) and cells[:, 0].min() < 0:
        stranger = int(points.ids[int(np.argmin(cells[:, 0]))])
        raise AsterismError(f"identity {stranger} does not occur in this pattern; give the garment that was captured.")
    # A margin of one cell, so that neighbours can be taken without asking for the border.
    grid = np.full((pattern.shape[0] + 2, pattern.shape[1] + 2), -1, dtype=np.int64)
    grid[cells[:, 0] + 1, cells[:, 1] + 1] = np.arange(len(points))
    return grid


@dataclass(frozen=True)
class _Edge:
    """One kind of neighbours on the sheet, by cell (rows + 1, cols + 2): the two points, and whether both are there, near or far."""

    one: Ints
    other: Ints
    good: Bools
    far: Bools


def _edge(points: DensePoints, grid: Ints, pattern: Pattern, rules: SurfaceRules, step: int) -> _Edge:
    """The neighbours of one of `_STEPS`."""
    down, right = _STEPS[step]
    one = grid[:-1, 1:-1]
    other = grid[down : down + one.shape[0], 1 + right : 1 + right + one.shape[1]]
    both = (one >= 0) & (other >= 0)
    first, second = one[both], other[both]
    between = points.positions[second] - points.positions[first]
    distance = np.sqrt(between[:, 0] ** 2 + between[:, 1] ** 2 + between[:, 2] ** 2)
    beyond = distance - rules.stretch * pattern.pitch * float(np.hypot(down, right))
    # The error along the edge is only needed where cloth would have to stretch.
    doubtful = np.flatnonzero(beyond > 0)
    along = between[doubtful] / distance[doubtful, None]
    spread = points.covariance[first[doubtful]] + points.covariance[second[doubtful]]
    sigma = np.sqrt((along * (spread @ along[:, :, None])[:, :, 0]).sum(axis=1))
    far = np.zeros(one.shape, dtype=np.bool_)
    apart = np.zeros(len(first), dtype=np.bool_)
    apart[doubtful] = beyond[doubtful] > rules.certain * sigma
    far[both] = apart
    return _Edge(one, other, both & ~far, far)


def _triangles(positions: Floats, grid: Ints, edges: list[_Edge]) -> Ints:
    """Triangles (t, 3) of all squares of the grid with three or four points: a b over c d."""
    right, down, falling, rising = (edge.good for edge in edges)
    a, b, c, d = grid[:-1, 1:-2], grid[:-1, 2:-1], grid[1:, 1:-2], grid[1:, 2:-1]
    right_below = np.concatenate([right[1:], np.zeros((1, right.shape[1]), dtype=np.bool_)])
    ab, ac, bd, cd = right[:, :-1], down[:, :-1], down[:, 1:], right_below[:, :-1]
    ad, bc = falling[:, :-1], rising[:, 1:]
    all_four = (a >= 0) & (b >= 0) & (c >= 0) & (d >= 0)
    # Of a square with four corners the shorter diagonal is the fold's; three corners make one triangle.
    shorter = np.zeros(a.shape, dtype=np.bool_)
    lengths = [np.linalg.norm(positions[one[all_four]] - positions[two[all_four]], axis=1) for one, two in ((a, d), (b, c))]
    shorter[all_four] = lengths[0] <= lengths[1]
    by_ad, by_bc = shorter | ~all_four, ~shorter | ~all_four
    kinds = (
        ((a, c, d), ac & cd & ad & by_ad),
        ((a, d, b), ad & bd & ab & by_ad),
        ((a, c, b), ac & bc & ab & by_bc),
        ((b, c, d), bc & cd & bd & by_bc),
    )
    return np.concatenate([np.stack([corner[there] for corner in corners], axis=1) for corners, there in kinds])


def _selected(points: DensePoints, kept: Bools) -> DensePoints:
    return replace(
        points, ids=points.ids[kept], positions=points.positions[kept], covariance=points.covariance[kept], cameras=points.cameras[kept],
        misfit=points.misfit[kept],
    )  # fmt: skip
