"""A body in, the outlines of a suit's pieces out; a printed pattern that it wears in, the cloth's mesh and its circles in space out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.garment.pattern import Pattern, Piece
from asterism.recording import Floats, Ints
from asterism.simulation.garment.tubes import Folds, girths, tube_surface
from asterism.simulation.garment.wearer import Motion, Tube, wearer_joints, wearer_tubes

Bools = NDArray[np.bool_]

_FINER = 3
"""Vertices of the mesh per pitch. A chord of 6 mm lies 0.1 mm below an arc of 45 mm; circles follow the mesh, so their truth does, too."""
_SEAM = 0.25
"""Of the pitch: how far a circle's edge stays from the seam at least."""
CLOTH, SKIN = 0, 1
"""Materials of the mesh."""


@dataclass(frozen=True)
class Mesh:
    """A surface of triangles.

    vertices   (v, 3) m
    normals    (v, 3) outward, of length 1
    sheet      (v, 2) row and column on the garment's sheet, NaN for skin
    triangles  (t, 3) int32 vertices, counter-clockwise as seen from outside
    piece      (t,) int32 the place of the garment's piece, -1 for skin
    """

    vertices: Floats
    normals: Floats
    sheet: Floats
    triangles: NDArray[np.int32]
    piece: NDArray[np.int32]


@dataclass(frozen=True)
class Wearer:
    """Who wears the garment, and how.

    stature  m
    motion   what the wearer does, see `wearer_joints`
    seed     the way of moving
    folds    of the cloth
    parts    names of the tubes that are there; empty: all
    """

    stature: float = 1.85
    motion: Motion = "walk"
    seed: int = 0
    folds: Folds = field(default_factory=Folds)
    parts: tuple[str, ...] = ()

    @property
    def tubes(self) -> tuple[Tube, ...]:
        """The tubes that are there. Raises AsterismError where a part has none."""
        tubes = wearer_tubes(self.stature)
        strangers = set(self.parts) - {tube.name for tube in tubes}
        if strangers:
            raise AsterismError(f"a wearer has no {sorted(strangers)[0]}; choose from {', '.join(tube.name for tube in tubes)}.")
        return tuple(tube for tube in tubes if not self.parts or tube.name in self.parts)

    def at(self, time: float) -> dict[str, Floats]:
        """The joints at a moment, s."""
        return dict(wearer_joints(self.motion, time, self.stature, seed=self.seed))


def suit_masks(wearer: Wearer, pitch: float = 0.018, diameter: float = 0.010) -> dict[str, Bools]:
    """The outline of each piece of a suit for this wearer: name -> (rows, cols) bool, an odd number of columns, the middle one in front.

    Each piece is a tube with a seam at the back (of sleeves and legs: at the back of a hanging arm). A row runs around it, with as many
    circles as its girth has room for.
    """
    masks: dict[str, Bools] = {}
    for tube in wearer.tubes:
        if tube.dressed is None:
            continue
        first, last = tube.dressed
        along = np.arange(first + 0.5 * pitch, last - 0.5 * diameter, pitch)
        # A row has as many circles as its girth has room for, less the seam.
        half = (0.5 * girths(tube, along)[2] - 0.5 * diameter - _SEAM * pitch) / pitch
        widest = int(half.max())
        masks[tube.name] = np.abs(np.arange(-widest, widest + 1)) <= half[:, None]
    return masks


def sheet_of(masks: dict[str, Bools]) -> tuple[Bools, tuple[Piece, ...]]:
    """All pieces side by side on one sheet, a column between them: the mask (rows, cols) and the pieces."""
    # Side by side with a column between: no block of circles spans two pieces.
    rows = max(mask.shape[0] for mask in masks.values())
    sheet = np.zeros((rows, sum(mask.shape[1] + 1 for mask in masks.values()) - 1), dtype=bool)
    pieces, column = [], 0
    for name, mask in masks.items():
        sheet[: mask.shape[0], column : column + mask.shape[1]] = mask
        pieces.append(Piece(name, 0, column, *mask.shape))
        column += mask.shape[1] + 1
    return sheet, tuple(pieces)


@dataclass(frozen=True)
class WornGarment:
    """A pattern on a wearer: the mesh at each moment and where its circles are. Made by `wear`.

    pattern  what is printed; its pieces have the names of the wearer's tubes
    wearer   who wears it
    """

    pattern: Pattern
    wearer: Wearer

    def mesh(self, time: float) -> Mesh:
        """The surface of cloth and skin at a moment, s."""
        joints = self.wearer.at(time)
        return _joined([_tube_mesh(self, tube, joints) for tube in self.wearer.tubes])

    def circles(self, time: float) -> Floats:
        """Where the middle of each circle is at a moment: (rows, cols, 3) m, NaN outside the mask. It lies on the mesh."""
        joints = self.wearer.at(time)
        out = np.full((*self.pattern.shape, 3), np.nan)
        for place, piece in enumerate(self.pattern.pieces):
            tube = next(tube for tube in self.wearer.tubes if tube.name == piece.name)
            grid = _piece_grid(self, tube, place)
            points = tube_surface(tube, joints, grid.along, grid.around, self.wearer.folds)
            rows = grid.first_row + _FINER * np.arange(piece.rows)
            steps = (np.arange(piece.columns) - piece.columns // 2) * self.pattern.pitch
            # The vertex left of the circle, and how far it is to the next one.
            where = (steps / grid.around[rows][:, -1:] + 1.0) * 0.5 * (grid.around.shape[1] - 1)
            left = np.clip(where.astype(np.int64), 0, grid.around.shape[1] - 2)
            share = (where - left)[..., None]
            ring = points[rows]
            taken = np.take_along_axis(ring, left[..., None], 1) * (1 - share) + np.take_along_axis(ring, left[..., None] + 1, 1) * share
            inside = self.pattern.colours[piece.cells] >= 0
            out[piece.cells] = np.where(inside[..., None], taken, np.nan)
        return out


def wear(pattern: Pattern, wearer: Wearer) -> WornGarment:
    """Put a pattern on. Raises AsterismError where its pieces are not those of a suit for this wearer (`suit_masks`)."""
    masks = suit_masks(wearer, pattern.pitch, pattern.diameter)
    for piece in pattern.pieces:
        if piece.name not in masks:
            raise AsterismError(f"the wearer has no part called {piece.name} to put a piece on; it has {', '.join(masks)}.")
        outline = masks[piece.name]
        if outline.shape != (piece.rows, piece.columns) or (pattern.colours[piece.cells][~outline] >= 0).any():
            raise AsterismError(f"the piece {piece.name} does not fit this wearer; make it from suit_masks of the same wearer and pitch.")
    return WornGarment(pattern, wearer)


@dataclass(frozen=True)
class _Grid:
    """Where the vertices of a tube are: along (n,) m, around (n, m) m with the seam at both ends, and the row of the first circles."""

    along: Floats
    around: Floats
    first_row: int
    sheet: Floats


def _piece_grid(worn: WornGarment, tube: Tube, place: int) -> _Grid:
    """The vertices of a dressed tube: circles of a row lie on a row of vertices, between two of them."""
    assert tube.dressed is not None
    pitch = worn.pattern.pitch
    first = tube.dressed[0] + 0.5 * pitch
    # Circles lie on rows of vertices, so that their truth lies on the mesh.
    step = pitch / _FINER
    before = int(np.ceil((first - tube.sections[0][0]) / step))
    after = int(np.ceil((tube.sections[-1][0] - first) / step))
    along: Floats = first + step * np.arange(-before, after + 1, dtype=np.float64)
    girth = girths(tube, along)[2]
    count = int(np.ceil(girth.max() / step)) + 1
    around = 0.5 * girth[:, None] * np.linspace(-1.0, 1.0, count)
    piece = worn.pattern.pieces[place] if place >= 0 else None
    row, column = (piece.row, piece.column + piece.columns // 2) if piece else (-1000, -1000)
    sheet = np.stack(np.broadcast_arrays(row + (np.arange(len(along)) - before)[:, None] / _FINER, column + around / pitch), axis=-1)
    return _Grid(along, around, before, sheet)


def _tube_mesh(worn: WornGarment, tube: Tube, joints: dict[str, Floats]) -> Mesh:
    """The mesh of one tube, closed at both ends."""
    names = [piece.name for piece in worn.pattern.pieces]
    place = names.index(tube.name) if tube.name in names else -1
    if tube.dressed is not None:
        grid = _piece_grid(worn, tube, place)
        along, around, sheet = grid.along, grid.around, grid.sheet
    else:
        along = np.linspace(tube.sections[0][0], tube.sections[-1][0], 17)
        around = 0.5 * girths(tube, along)[2][:, None] * np.linspace(-1.0, 1.0, 33)
        sheet = np.full((*around.shape, 2), np.nan)
    points = tube_surface(tube, joints, along, around, worn.wearer.folds)
    normals = _normals(points)
    n, m = around.shape
    triangles = grid_triangles(n, m)
    vertices, normals, sheet = points.reshape(-1, 3), normals.reshape(-1, 3), sheet.reshape(-1, 2)
    # Closed ends: nobody looks into a sleeve.
    for ring, sign in ((0, 1), (n - 1, -1)):
        middle = len(vertices)
        rim = ring * m + np.arange(m)
        vertices = np.concatenate([vertices, vertices[rim].mean(axis=0, keepdims=True)])
        towards = vertices[middle] - points[1 if ring == 0 else n - 2].mean(axis=0)
        normals = np.concatenate([normals, (towards / np.linalg.norm(towards))[None]])
        sheet = np.concatenate([sheet, np.full((1, 2), np.nan)])
        fan = np.stack([rim[:-1], rim[1:], np.full(m - 1, middle)], axis=1)
        triangles = np.concatenate([triangles, fan if sign > 0 else fan[:, [1, 0, 2]]])
    kind = place if tube.dressed is not None else -1
    owner = np.full(len(triangles), kind, dtype=np.int32)
    if tube.dressed is not None:
        sheet[np.isnan(sheet[:, 0])] = -1000.0
        owner[:] = max(place, 0)
    return Mesh(vertices, normals, sheet, triangles.astype(np.int32), owner)


def grid_triangles(rows: int, columns: int) -> Ints:
    """(t, 3): two triangles for each cell of a grid of vertices that are numbered row by row."""
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    upper, lower = [corner, corner + columns, corner + 1], [corner + 1, corner + columns, corner + columns + 1]
    return np.concatenate([np.stack(upper, 1), np.stack(lower, 1)])


def _normals(points: Floats) -> Floats:
    """Outward unit normals of a tube (n, m, 3) whose first and last column are the same seam."""
    down = np.gradient(points, axis=0)
    # First and last column are one seam: differences go around it.
    wrapped = np.concatenate([points[:, -2:-1], points, points[:, 1:2]], axis=1)
    right = wrapped[:, 2:] - wrapped[:, :-2]
    normal = np.cross(down, right)
    unit: Floats = normal / np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-12)
    return unit


def _joined(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one."""
    starts: Ints = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.sheet for mesh in meshes]),
        np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)]).astype(np.int32),
        np.concatenate([mesh.piece for mesh in meshes]),
    )
