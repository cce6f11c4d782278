"""Calibration boards: chessboards, ChArUco boards and grids of circles; what is printed in, points in metres and a finder out."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import Floats, Ints

Kind = Literal["chessboard", "charuco", "circles", "asymmetric circles"]
_INNER_WINDOW, _LEAST_WINDOW, _MOST_WINDOW = 0.2, 2, 11
_WIDEST = 1.0
"""m, of squares: wider ones were given in centimetres or millimetres."""
_UNLIKE_PX = 0.3
_INCH_CM = 2.54
_END = (3, 50, 1e-4)
"""Corners are refined 50 times, or until they move by less than 0.0001 px (OpenCV's criteria: either)."""


@dataclass(frozen=True)
class Board:
    """A flat board with points at known places.

    kind        what is printed on it
    columns     points along x: inner corners of a chessboard, circles; for ChArUco squares
    rows        the same along y
    spacing     m between neighbouring points: a square's side; for asymmetric circles half the distance of two in a row
    dictionary  of ChArUco's markers, OpenCV's name ("DICT_4X4_50")
    marker      m, side of ChArUco's markers
    inverted    printed white on black
    """

    kind: Kind
    columns: int
    rows: int
    spacing: float
    dictionary: str = ""
    marker: float = 0.0
    inverted: bool = False

    def __post_init__(self) -> None:
        if not 1e-4 < self.spacing < _WIDEST:
            raise AsterismError(f"the board's squares are {self.spacing:g} m wide; give metres, such as 0.025 for 25 mm.")
        least = 3 if self.kind == "charuco" else 2
        if min(self.columns, self.rows) < least or self.columns * self.rows > 10_000:
            raise AsterismError(f"a {self.kind} of {self.columns} x {self.rows} is too small or too large to be a board.")
        if self.kind in ("chessboard", "circles") and self.columns == self.rows:
            raise AsterismError(f"{self.kind}, {self.columns} x {self.rows}: it looks the same from four sides; use one longer than wide.")
        if self.kind == "asymmetric circles" and self.rows % 2 == 0:
            raise AsterismError(
                f"{self.kind}, {self.columns} x {self.rows}: an even number of rows has no upper end; use an odd one, as 4x11."
            )
        if self.kind == "charuco" and not 0 < self.marker < self.spacing:
            raise AsterismError(
                f"the markers are {self.marker:g} m wide and the squares {self.spacing:g} m; markers must fit into squares."
            )

    @classmethod
    def from_toml(cls, path: str | Path) -> Board:
        """Caliscope's charuco.toml, or any board from a file with kind, columns, rows, square (m), and for ChArUco dictionary, marker (m).

        Raises AsterismError where a value is missing or impossible.
        """
        from asterism.files.toml import read_toml

        path = Path(path)
        table = read_toml(path)
        try:
            if "kind" in table:
                if table["kind"] not in ("chessboard", "charuco", "circles", "asymmetric circles"):
                    raise ValueError(f"there is no kind {str(table['kind'])[:40]!r}")
                return cls(
                    table["kind"],
                    int(table["columns"]),
                    int(table["rows"]),
                    float(table["square"]),
                    str(table.get("dictionary", "")),
                    float(table.get("marker", 0.0)),
                    bool(table.get("inverted", False)),
                )
            columns, rows = int(table["columns"]), int(table["rows"])
            return cls(
                "charuco",
                columns,
                rows,
                _caliscope_square(table, columns, rows),
                str(table["dictionary"]),
                _caliscope_square(table, columns, rows) * float(table.get("aruco_scale", 0.75)),
                bool(table.get("inverted", False)),
            )
        except AsterismError as problem:
            raise AsterismError(f"{path}: {problem}") from problem
        except (KeyError, TypeError, ValueError, ArithmeticError) as problem:
            raise AsterismError(
                f"{path} is no board ({problem}); give kind, columns, rows, square in metres, and for ChArUco dictionary and marker."
            ) from problem

    @property
    def turns_alike(self) -> bool:
        """Whether the board looks the same upside down, so that one image does not tell which of its ends is which."""
        if self.kind == "chessboard":
            return (self.columns + self.rows) % 2 == 0
        return self.kind == "circles"

    @property
    def points(self) -> Floats:
        """(K, 3) m, in the board's axes: x along the rows, y down the columns as printed, z = 0."""
        if self.kind == "asymmetric circles":
            # Every other row is shifted by half a step, which is what the spacing counts.
            places = [((2 * j + i % 2) * self.spacing, i * self.spacing) for i in range(self.rows) for j in range(self.columns)]
        elif self.kind == "charuco":
            places = [((j + 1) * self.spacing, (i + 1) * self.spacing) for i in range(self.rows - 1) for j in range(self.columns - 1)]
        else:
            places = [(j * self.spacing, i * self.spacing) for i in range(self.rows) for j in range(self.columns)]
        return np.column_stack([np.array(places), np.zeros(len(places))])

    def __str__(self) -> str:
        printed = f"{self.kind} {self.columns} x {self.rows}, {1000 * self.spacing:g} mm"
        return f"{printed}, {self.dictionary}, markers {1000 * self.marker:g} mm" if self.kind == "charuco" else printed


def size_of(text: str) -> tuple[int, int]:
    """Columns and rows from a text such as 9x6. Raises AsterismError for anything else.

    >>> size_of("9x6")
    (9, 6)
    """
    match = re.fullmatch(r"\s*(\d{1,3})\s*[xX×,]\s*(\d{1,3})\s*", text)
    if not match:
        raise AsterismError(f"board size {text!r} is not columns x rows, such as 9x6.")
    return int(match[1]), int(match[2])


def _caliscope_square(table: dict[str, Any], columns: int, rows: int) -> float:
    """The side of a square, m: as measured, else what fits on the sheet."""
    if table.get("square_size_override_cm"):
        return float(table["square_size_override_cm"]) / 100
    unit = {"inch": _INCH_CM, "cm": 1.0}[str(table.get("units", "cm"))] / 100
    return min(float(table["board_width"]) * unit / columns, float(table["board_height"]) * unit / rows)


class Finder:
    """Finds a board in images; the detectors of OpenCV are made once."""

    def __init__(self, board: Board) -> None:
        import cv2

        self.board = board
        self._charuco: list[Any] = []
        if board.kind == "charuco":
            number = getattr(cv2.aruco, board.dictionary, None)
            if not isinstance(number, int):
                raise AsterismError(f"OpenCV has no ArUco dictionary {board.dictionary!r}; name one, such as DICT_4X4_50.")
            dictionary = cv2.aruco.getPredefinedDictionary(number)
            if dictionary.bytesList.shape[0] < board.columns * board.rows // 2:
                raise AsterismError(f"{board.dictionary} has too few markers for a board of {board.columns} x {board.rows} squares.")
            # an even number of rows: OpenCV before 4.6, and what was printed with it, began with a marker instead of a dark square
            # Both prints are tried, and the one that the image shows is found.
            for before in (False, True) if board.rows % 2 == 0 else (False,):
                printed = cv2.aruco.CharucoBoard((board.columns, board.rows), board.spacing, board.marker, dictionary)
                printed.setLegacyPattern(before)
                self._charuco.append(cv2.aruco.CharucoDetector(printed))

    def find(self, image: Any) -> tuple[Ints, Floats]:
        """Which points of the board (n,) are where (n, 2) px in a grey image (H, W) uint8; both empty where it is not in sight."""
        # OpenCV's detectors look for dark on light.
        grey = 255 - image if self.board.inverted else image
        if self.board.kind == "charuco":
            return self._find_charuco(grey)
        found = self._find_chessboard(grey) if self.board.kind == "chessboard" else self._find_circles(grey)
        return (np.arange(len(found)), found) if len(found) else (np.empty(0, dtype=np.int64), np.empty((0, 2)))

    def _find_charuco(self, grey: Any) -> tuple[Ints, Floats]:
        for detector in self._charuco:
            corners, ids, *_ = detector.detectBoard(grey)
            if ids is not None and corners is not None:
                break
        else:
            return np.empty(0, dtype=np.int64), np.empty((0, 2))
        # A corner found twice is taken once: sightings hold one image per point.
        numbers, first = np.unique(np.asarray(ids).ravel(), return_index=True)
        return numbers.astype(np.int64), self._refined(grey, numbers, np.asarray(corners, dtype=np.float32).reshape(-1, 2)[first])

    def _refined(self, grey: Any, numbers: Ints, corners: Any) -> Floats:
        """ChArUco corners to a fraction of a pixel, in a window that stays clear of the markers: versions of OpenCV differ by half a pixel.

        A corner that would move otherwise than most is blurred, and moves as most do.
        """
        import cv2

        # Between a corner and the nearest marker lies half of what the marker leaves free of its square.
        clear = 0.5 * (1.0 - self.board.marker / self.board.spacing)
        places = self.board.points[numbers, :2]
        apart = np.linalg.norm(places[:, None] - places, axis=2)
        pixels = np.linalg.norm(corners[:, None] - corners, axis=2)
        neighbours = (apart > 0) & (apart < 1.01 * self.board.spacing)
        if not neighbours.any():
            return np.asarray(corners, dtype=np.float64)
        half = int(np.clip(clear * float(pixels[neighbours].min()), _LEAST_WINDOW, _MOST_WINDOW))
        refined = cv2.cornerSubPix(grey, corners.reshape(-1, 1, 2).copy(), (half, half), (-1, -1), _END).reshape(-1, 2)
        moved = np.asarray(refined, dtype=np.float64) - corners
        # The coarse corners are off by the same amount almost everywhere, by the version of OpenCV.
        usual = np.median(moved, axis=0)
        blurred = np.linalg.norm(moved - usual, axis=1) > _UNLIKE_PX
        moved[blurred] = usual
        return np.asarray(corners + moved, dtype=np.float64)

    def _find_chessboard(self, grey: Any) -> Floats:
        """Corners to a fraction of a pixel; the window around each stays well inside its four squares."""
        import cv2

        size = (self.board.columns, self.board.rows)
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
        found, corners = cv2.findChessboardCorners(grey, size, flags=flags)
        if not found or len(corners) != size[0] * size[1]:
            return np.empty((0, 2))
        grid = np.asarray(corners).reshape(size[1], size[0], 2)
        narrowest = min(float(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min()) for axis in (0, 1))
        half = int(np.clip(_INNER_WINDOW * narrowest, _LEAST_WINDOW, _MOST_WINDOW))
        found = np.asarray(cv2.cornerSubPix(grey, corners, (half, half), (-1, -1), _END), dtype=np.float64).reshape(-1, 2)
        # OpenCV begins at either end of the board; the colour of the first square says at which.
        return found if self.board.turns_alike or _first_is_dark(grey, grid) else np.ascontiguousarray(found[::-1])

    def _find_circles(self, grey: Any) -> Floats:
        import cv2

        layout = cv2.CALIB_CB_SYMMETRIC_GRID if self.board.kind == "circles" else cv2.CALIB_CB_ASYMMETRIC_GRID
        found, centres = cv2.findCirclesGrid(grey, (self.board.columns, self.board.rows), flags=layout)
        return np.asarray(centres, dtype=np.float64).reshape(-1, 2) if found else np.empty((0, 2))


def _first_is_dark(grey: Any, grid: Floats) -> bool:
    """Whether the square inside the first four corners of a grid (rows, columns, 2) px is a dark one: by all squares between corners."""
    middles = 0.25 * (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:])
    x, y = np.clip(np.round(middles).astype(int).reshape(-1, 2).T, 0, np.array(grey.shape)[::-1, None] - 1)
    # All squares vote, since glare or a finger may hide the first one.
    like_first = np.indices(middles.shape[:2]).sum(axis=0).ravel() % 2 == 0
    shades = grey[y, x].astype(np.float64)
    return bool(shades[like_first].mean() < shades[~like_first].mean())
