"""A grid of colours in; a pattern with the identity of each circle out, and its files: a lookup (NPZ) and a description (TOML)."""

from __future__ import annotations

import io
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.errors import AsterismError, guarded_reading
from asterism.files.atomic import utf8, write_atomically
from asterism.files.npz import arrays_of_npz
from asterism.files.text import read_bytes
from asterism.files.toml import read_toml, toml_line
from asterism.garment.identities import RING, count_rings, grid_identities, identities
from asterism.recording import Floats, Ints

FORMAT = "asterism-garment"
FORMAT_VERSION = 1
_PITCH, _DIAMETER = 0.018, 0.010
_LARGEST_PITCH = 1.0
"""m: a larger one was given in millimetres."""
_REMADE = "write it again with asterism garment print"
_FOUR_HUES = (0.0, 75 / 360, 165 / 360, 255 / 360)
"""Red, yellow, green and blue, as the paper names them, moved apart: at least 75 degrees between two."""


def spread_hues(colours: int) -> Floats:
    """HSV (colours, 3) of as many colours, each from 0 to 1, full saturation and value, with hues as far apart as they can be named."""
    hues = _FOUR_HUES if colours == 4 else tuple(k / colours for k in range(colours))
    return np.array([(hue, 1.0, 1.0) for hue in hues])


@dataclass(frozen=True)
class Piece:
    """A rectangle of the sheet that is one piece of the garment: a front, a sleeve, a trouser leg.

    name           what the description calls it
    row, column    the sheet's cell that is its upper left
    rows, columns  its size in cells; its outline within them is where the pattern has colours
    """

    name: str
    row: int
    column: int
    rows: int
    columns: int

    @property
    def cells(self) -> tuple[slice, slice]:
        """Its rows and columns, as an index of the sheet's arrays."""
        return slice(self.row, self.row + self.rows), slice(self.column, self.column + self.columns)


@dataclass(frozen=True)
class Pattern:
    """Circles of a few colours on a square grid, in which every inner circle is known by its own colour and its eight neighbours'.

    colours   (rows, cols) int8, from 0; -1 outside the mask
    hsv       (q, 3) hue, saturation and value of the colours, each from 0 to 1
    pitch     m, between neighbouring circles on the flat sheet
    diameter  m, of a circle
    pieces    rectangles that hold all of it, with a gap of one cell or more between them; empty: one piece, "sheet"
    ids       (rows, cols) int32, computed: the identity (`garment.identities`), -1 where the 3 x 3 block is incomplete

    An identity occurs once on the whole sheet, so also pieces have disjoint identities, and no ring of neighbours has a rotational period.
    Raises AsterismError where that is not so, naming the cells.
    """

    colours: NDArray[np.int8]
    hsv: Floats = field(default_factory=lambda: spread_hues(4))
    pitch: float = _PITCH
    diameter: float = _DIAMETER
    pieces: tuple[Piece, ...] = ()
    ids: NDArray[np.int32] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        hsv = np.array(self.hsv, dtype=np.float64)
        given = np.asarray(self.colours)
        if hsv.ndim != 2 or hsv.shape[1] != 3 or not ((hsv >= 0) & (hsv <= 1)).all():
            raise AsterismError("the pattern's hsv is not (colours, 3) with values from 0 to 1.")
        if given.ndim != 2 or given.dtype.kind not in "iu" or given.size == 0 or given.min() < -1 or given.max() >= len(hsv):
            raise AsterismError(f"the pattern's colours are not a grid of whole numbers from -1 to {len(hsv) - 1}.")
        if not 0 < self.diameter < self.pitch < _LARGEST_PITCH:
            raise AsterismError(
                f"circles of {self.diameter:g} m at a pitch of {self.pitch:g} m are not possible; give metres, such as 0.010 and 0.018."
            )
        # Identities are computed from the colours, never taken from a file, so the two cannot contradict each other.
        colours = given.astype(np.int8)
        ids = grid_identities(colours, len(hsv))
        _check_unique(colours, ids)
        pieces = tuple(self.pieces) or (Piece("sheet", 0, 0, *colours.shape),)
        _check_pieces(colours, pieces)
        # A pattern is shared by readers and caches, so nobody may change its arrays.
        for array in (colours, hsv, ids):
            array.setflags(write=False)
        for name, value in (("colours", colours), ("hsv", hsv), ("ids", ids), ("pieces", pieces)):
            object.__setattr__(self, name, value)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the sheet."""
        return self.colours.shape[0], self.colours.shape[1]

    @property
    def q(self) -> int:
        """How many colours it is made of."""
        return len(self.hsv)

    @cached_property
    def known(self) -> NDArray[np.int32]:
        """The identities that occur, ascending, (ids,)."""
        return np.sort(self.ids[self.ids >= 0])

    @cached_property
    def cell_of(self) -> NDArray[np.int32]:
        """The flat index of each possible identity's cell, (q * rings,); -1 where it does not occur."""
        cells = np.full(self.q * count_rings(self.q), -1, dtype=np.int32)
        inner = np.flatnonzero(self.ids.ravel() >= 0)
        cells[self.ids.ravel()[inner]] = inner
        cells.setflags(write=False)
        return cells

    def identity(self, centre: ArrayLike, ring: ArrayLike) -> NDArray[np.int32]:
        """The identities of blocks read somewhere, -1 where they do not occur in this pattern.

        centre (...,) colours; ring (..., 8) colours of the neighbours, clockwise on the printed side, from any of them; -1 is unknown.
        """
        number = identities(centre, ring, self.q)
        return np.where(self.cell_of[number] >= 0, number, -1).astype(np.int32)

    def cells(self, ids: ArrayLike) -> Ints:
        """Rows and columns of identities, (..., 2); -1, -1 for one that does not occur."""
        number = np.asarray(ids, dtype=np.int64)
        # An unknown identity points to place 0 here, and is masked in the next line.
        possible = (number >= 0) & (number < len(self.cell_of))
        flat = np.where(possible, self.cell_of[np.where(possible, number, 0)], -1).astype(np.int64)
        cell = np.stack([flat // self.shape[1], flat % self.shape[1]], axis=-1)
        return np.where(flat[..., None] >= 0, cell, -1)

    def positions(self) -> Floats:
        """Where the circles are on the flat sheet, (rows, cols, 3) m: x along a row, y along a column, z = 0; NaN outside the mask.

        The printed side shows x to the right and y down; z points away from who looks at it, into the cloth.
        """
        rows, cols = self.shape
        row, col = np.mgrid[0:rows, 0:cols]
        places = np.stack([col * self.pitch, row * self.pitch, np.zeros((rows, cols))], axis=-1)
        return np.where(self.colours[..., None] >= 0, places, np.nan)

    def neighbours(self, identity: int) -> NDArray[np.int32]:
        """The identities of the eight circles around one, (8,) clockwise on the printed side from the upper left.

        -1 for a neighbour whose own block is incomplete. Raises AsterismError for an identity that does not occur.
        """
        row, col = (int(v) for v in self.cells(identity))
        if row < 0:
            raise AsterismError(f"identity {identity} does not occur in this pattern.")
        return np.array([self.ids[row + dr, col + dc] for dr, dc in RING], dtype=np.int32)

    def piece_of(self, ids: ArrayLike) -> Ints:
        """The place in `pieces` of each identity, -1 for one that does not occur."""
        number = np.asarray(ids)
        cell = self.cells(number)
        found = np.full(number.shape, -1, dtype=np.int64)
        for place, piece in enumerate(self.pieces):
            inside = (cell - (piece.row, piece.column) >= 0) & (cell - (piece.row, piece.column) < (piece.rows, piece.columns))
            found[inside.all(axis=-1) & (cell[..., 0] >= 0)] = place
        return found

    def save(self, path: str | Path) -> Path:
        """Write the description PATH.toml and the lookup PATH.npz beside it; PATH may end in either. Returns the description's path.

        The lookup holds `colours`, `ids`, `hsv`, `pitch`, `diameter` and `pieces`; the description names it. A pitch or diameter that was
        measured on the cloth may be written over the planned one in the description. Raises AsterismError where one cannot be written.
        """
        path = Path(path)
        description, lookup = path.with_suffix(".toml"), path.with_suffix(".npz")
        stored: dict[str, Any] = {
            "asterism": FORMAT_VERSION,
            "kind": "garment",
            "colours": self.colours,
            "ids": self.ids,
            "hsv": self.hsv,
            "pitch": self.pitch,
            "diameter": self.diameter,
            "piece_names": np.array([piece.name for piece in self.pieces], dtype=str),
            "piece_cells": np.array([(p.row, p.column, p.rows, p.columns) for p in self.pieces], dtype=np.int32),
        }
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **stored)
        lines = [toml_line("format", FORMAT), toml_line("version", FORMAT_VERSION), toml_line("lookup", lookup.name)]
        lines += [toml_line("units", "m; hsv from 0 to 1; rows and columns from 0"), toml_line("pitch", self.pitch)]
        lines += [toml_line("diameter", self.diameter), toml_line("hsv", self.hsv.tolist())]
        lines += [toml_line("identities", len(self.known))]
        for piece in self.pieces:
            lines += ["", "[[piece]]", *(toml_line(k, getattr(piece, k)) for k in ("name", "row", "column", "rows", "columns"))]
        # The lookup first: a description that is there names a lookup that is there.
        write_atomically(lookup, buffer.getvalue())
        write_atomically(description, utf8("\n".join(lines) + "\n"))
        return description

    @classmethod
    def load(cls, path: str | Path) -> Pattern:
        """Read a pattern from its description (.toml) or from its lookup (.npz) alone.

        Raises AsterismError, naming the file, where one is missing, damaged or of a later version, or where its colours and identities
        contradict each other.
        """
        path = Path(path)
        if path.suffix.lower() != ".toml":
            return _from_lookup(path)
        table = read_toml(path)
        if table.get("format") != FORMAT:
            raise AsterismError(f"{path} does not describe a garment; give the file that asterism garment print wrote.")
        _check_version(path, table.get("version"))
        with guarded_reading(path, _REMADE):
            # The lookup is looked for beside its description alone, whatever path the file names.
            pattern = _from_lookup(path.with_name(Path(str(table["lookup"])).name))
            return replace(pattern, pitch=float(table["pitch"]), diameter=float(table["diameter"]))


def _from_lookup(path: Path) -> Pattern:
    """A pattern from its NPZ file."""
    with guarded_reading(path, _REMADE):
        stored = arrays_of_npz(read_bytes(path))
        if str(stored.get("kind")) != "garment":
            raise AsterismError(f"{path} is not a garment's lookup; give the file that asterism garment print wrote.")
        _check_version(path, stored["asterism"].item())
        names, cells = stored["piece_names"], stored["piece_cells"]
        pieces = tuple(Piece(str(name), *(int(v) for v in cell)) for name, cell in zip(names, cells, strict=True))
        pattern = Pattern(stored["colours"], stored["hsv"], float(stored["pitch"]), float(stored["diameter"]), pieces)
        # A changed colour changes identities, so a damaged file shows.
        if not np.array_equal(pattern.ids, stored["ids"]):
            raise AsterismError(f"{path} is damaged: its colours and its identities contradict each other; {_REMADE}.")
        return pattern


def _check_version(path: Path, version: object) -> None:
    if not isinstance(version, int) or version < 1:
        raise AsterismError(f"{path} is damaged: its format version is {version!r}; {_REMADE}.")
    if version > FORMAT_VERSION:
        raise AsterismError(f"{path} was written by a later Asterism (garment format {version}); update Asterism.")


def _check_unique(colours: NDArray[np.int8], ids: NDArray[np.int32]) -> None:
    """Raise AsterismError for a ring with a period and for an identity that occurs twice."""
    inside = np.pad(colours >= 0, 1)
    rows, cols = colours.shape
    whole = np.logical_and.reduce([inside[1 + dr : 1 + dr + rows, 1 + dc : 1 + dc + cols] for dr, dc in (*RING, (0, 0))])
    periodic = np.argwhere(whole & (ids < 0))
    if len(periodic):
        row, col = periodic[0]
        raise AsterismError(f"the ring around row {row}, column {col} has a rotational period; change one of its colours.")
    # Sorted identities lie side by side where they occur twice.
    order = np.argsort(ids, axis=None, kind="stable")
    ascending = ids.ravel()[order]
    twice = np.flatnonzero((ascending[1:] == ascending[:-1]) & (ascending[1:] >= 0))
    if len(twice):
        places = [f"row {cell // cols}, column {cell % cols}" for cell in (int(order[twice[0]]), int(order[twice[0] + 1]))]
        raise AsterismError(f"the blocks around {places[0]} and {places[1]} have the same identity; make the pattern again.")


def _check_pieces(colours: NDArray[np.int8], pieces: tuple[Piece, ...]) -> None:
    """Raise AsterismError where pieces lie outside the sheet, touch, have one name, or leave circles to no piece."""
    names = [piece.name for piece in pieces]
    if len(set(names)) < len(names) or not all(names):
        raise AsterismError(f"the pieces are called {', '.join(names)}; give each a name of its own.")
    # A border of one cell, so that touching can be seen without asking for the sheet's edge.
    owner = np.zeros(np.add(colours.shape, 2), dtype=np.int32)
    for place, piece in enumerate(pieces, 1):
        past = (piece.row + piece.rows, piece.column + piece.columns)
        if (
            min(piece.row, piece.column) < 0
            or min(piece.rows, piece.columns) < 1
            or past[0] > colours.shape[0]
            or past[1] > colours.shape[1]
        ):
            raise AsterismError(f"piece {piece.name} lies outside the sheet of {colours.shape[0]} x {colours.shape[1]} cells.")
        if owner[piece.row : past[0] + 2, piece.column : past[1] + 2].any():
            raise AsterismError(f"piece {piece.name} touches another; leave a row or column between pieces.")
        # Row and column 0 of the owners are the border, so pieces are shifted by one.
        owner[piece.row + 1 : past[0] + 1, piece.column + 1 : past[1] + 1] = place
    if ((colours >= 0) & (owner[1:-1, 1:-1] == 0)).any():
        raise AsterismError("some circles of the pattern belong to no piece; make the pieces larger.")
