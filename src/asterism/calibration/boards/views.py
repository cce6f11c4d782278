"""Footage and a board in; which of its points each camera saw where, at which moment, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from asterism.calibration.boards.board import Board, Finder
from asterism.calibration.boards.footage import Footage
from asterism.cameras.bundle import Sightings
from asterism.errors import AsterismError
from asterism.progress import Progress
from asterism.recording import Ints

_ALONE_APART = 1_000_000
LEAST_POINTS = 6
"""A view with fewer points says nothing sure about the lens."""


@dataclass(frozen=True)
class BoardViews:
    """Where cameras saw a board.

    cameras   (C,) names
    sizes     (C,) (width, height) px of each camera's images
    moments   (T,) the number of each moment at which the board was seen, ascending; negative for images that stand alone
    seen      sightings, frame counting `moments`, point counting the board's points
    looked    (C,) how many images were looked at
    notes     what was strange about files, one sentence each
    """

    board: Board
    cameras: tuple[str, ...]
    sizes: tuple[tuple[int, int], ...]
    moments: Ints
    seen: Sightings
    looked: tuple[int, ...]
    notes: tuple[str, ...] = ()

    @property
    def counts(self) -> Ints:
        """(T, C) points seen of the board."""
        return np.bincount(self.seen.frame * len(self.cameras) + self.seen.camera, minlength=len(self.moments) * len(self.cameras)).reshape(
            len(self.moments), len(self.cameras)
        )


def find_board(footage: Sequence[Footage], board: Board, *, every: int = 1, progress: Progress | None = None) -> BoardViews:
    """Look for a board in all footage; every: look at each n-th image only.

    Views with less than six points or with all of them in a line are left out, and images of another size than most of their camera's.
    Raises AsterismError where no camera saw the board.
    """
    finder = Finder(board)
    places = board.points[:, :2]
    total, done = max(1, sum(len(one) for one in footage)), 0
    rows: list[tuple[int, int, int, float, float]] = []
    sizes: list[tuple[int, int]] = []
    looked: list[int] = []
    notes: list[str] = []
    for c, camera in enumerate(footage):
        by_size: dict[tuple[int, int], list[tuple[int, int, int, float, float]]] = {}
        moments_of: dict[tuple[int, int], list[int]] = {}
        count = 0
        for moment, image in islice(camera, 0, None, every):
            count += 1
            size = (int(image.shape[1]), int(image.shape[0]))
            moments_of.setdefault(size, []).append(moment)
            point, xy = finder.find(image)
            if len(point) >= LEAST_POINTS and np.linalg.matrix_rank(places[point] - places[point].mean(axis=0), tol=1e-9) == 2:
                own = moment if moment >= 0 else moment - _ALONE_APART * c
                by_size.setdefault(size, []).extend((own, c, int(p), float(x), float(y)) for p, (x, y) in zip(point, xy, strict=True))
            if progress is not None:
                progress(min(1.0, (done + count * every) / total), f"looking for the board, camera {camera.name}")
        done += len(camera)
        usual = max(moments_of, key=lambda size: len(moments_of[size]), default=(0, 0))
        notes += [
            f"{camera.image(moment)} is {size[0]} x {size[1]}, other images of {camera.name} {usual[0]} x {usual[1]}; it was left out."
            for size, odd in moments_of.items()
            for moment in odd
            if size != usual
        ]
        rows += by_size.get(usual, [])
        sizes.append(usual)
        looked.append(count)
    if not rows:
        how = {
            "chessboard": "it counts inner corners, and needs a white border",
            "charuco": "it counts squares, columns first; check the dictionary, and that images are not mirrored",
        }.get(board.kind, "it counts circles, columns first")
        raise AsterismError(f"no camera saw the board ({board}) in {sum(looked)} images; check its size and kind: {how}.")
    moments, frame = np.unique(np.array([row[0] for row in rows], dtype=np.int64), return_inverse=True)
    seen = Sightings.of(frame, [row[1] for row in rows], [row[2] for row in rows], [row[3:] for row in rows])
    return BoardViews(
        board,
        tuple(one.name for one in footage),
        tuple(sizes),
        moments,
        seen,
        tuple(looked),
        (*(note for one in footage for note in one.notes), *notes),
    )
