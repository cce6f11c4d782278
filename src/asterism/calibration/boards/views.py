"""Footage and a board in; which of its points each camera saw where, in which frame, out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from asterism.calibration.boards.board import Board, Finder
from asterism.calibration.boards.footage import Footage
from asterism.cameras.bundle import Sightings
from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.progress import Progress
from asterism.recording import Ints

Row = tuple[int, int, int, float, float]
"""frame, camera, point, x and y (px)."""
_UNNUMBERED_STEP = 1_000_000
"""Images without a frame number get numbers of their own, so far apart from camera to camera."""
LEAST_POINTS = 6
"""A view with fewer points does not constrain the lens."""


@dataclass(frozen=True)
class BoardViews:
    """Where cameras saw a board.

    cameras   (C,) names
    sizes     (C,) (width, height) px of each camera's images
    frames    (T,) the number of each frame in which the board was seen, ascending; negative for images without a frame number
    seen      sightings, frame counting `frames`, point counting the board's points
    images    (C,) how many images were searched
    findings  what is wrong with files
    """

    board: Board
    cameras: tuple[str, ...]
    sizes: tuple[tuple[int, int], ...]
    frames: Ints
    seen: Sightings
    images: tuple[int, ...]
    findings: tuple[Finding, ...] = ()

    @property
    def counts(self) -> Ints:
        """(T, C) points seen of the board."""
        return np.bincount(self.seen.frame * len(self.cameras) + self.seen.camera, minlength=len(self.frames) * len(self.cameras)).reshape(
            len(self.frames), len(self.cameras)
        )


def find_board(footage: Sequence[Footage], board: Board, *, every: int = 1, progress: Progress | None = None) -> BoardViews:
    """Look for a board in all footage; every: look at each n-th image only.

    Views with less than six points or with all of them in a line are left out, and images of another size than most of their camera's.
    Raises AsterismError where no camera saw the board.
    """
    finder = Finder(board)
    total, done = max(1, sum(len(one) for one in footage)), 0
    found: list[_CameraViews] = []
    for c, camera in enumerate(footage):

        def report(count: int, name: str = camera.name, done: int = done) -> None:
            if progress is not None:
                progress(min(1.0, (done + count * every) / total), f"looking for the board, camera {name}")

        found.append(_find_in(camera, c, finder, every, report))
        done += len(camera)
    rows = [row for one in found for row in one.rows]
    if not rows:
        # Where no image could be read, that is what to mend.
        unread = next((finding for camera in footage for finding in camera.findings), None)
        if unread is not None and not any(one.images for one in found):
            raise AsterismError(str(unread))
        how = {
            "chessboard": "it counts inner corners, and needs a white border",
            "charuco": "it counts squares, columns first; check the dictionary, and that images are not mirrored",
        }.get(board.kind, "it counts circles, columns first")
        raise AsterismError(
            f"no camera saw the board ({board}) in {sum(one.images for one in found)} images; check its size and kind: {how}."
        )
    frames, frame = np.unique(np.array([row[0] for row in rows], dtype=np.int64), return_inverse=True)
    seen = Sightings.of(frame, [row[1] for row in rows], [row[2] for row in rows], [row[3:] for row in rows])
    return BoardViews(
        board,
        tuple(one.name for one in footage),
        tuple(one.size for one in found),
        frames,
        seen,
        tuple(one.images for one in found),
        (*(finding for one in footage for finding in one.findings), *(finding for one in found for finding in one.findings)),
    )


@dataclass(frozen=True)
class _CameraViews:
    """One camera's views: rows of frame, camera, point, x and y (px); the size of its images, how many there are, and what is wrong."""

    rows: list[Row]
    size: tuple[int, int]
    images: int
    findings: list[Finding]


def _find_in(camera: Footage, number: int, finder: Finder, every: int, report: Callable[[int], None]) -> _CameraViews:
    """The views of one camera, of those images that have the size of most."""
    places = finder.board.points[:, :2]
    rows: dict[tuple[int, int], list[Row]] = {}
    frames: dict[tuple[int, int], list[int]] = {}
    count = 0
    for frame, image in islice(camera, 0, None, every):
        count += 1
        size = (int(image.shape[1]), int(image.shape[0]))
        frames.setdefault(size, []).append(frame)
        point, xy = finder.find(image)
        # Points in a line fit a board turned about that line at any angle: such a view has no pose.
        if len(point) >= LEAST_POINTS and np.linalg.matrix_rank(places[point] - places[point].mean(axis=0), tol=1e-9) == 2:
            own = frame if frame >= 0 else frame - _UNNUMBERED_STEP * number
            rows.setdefault(size, []).extend((own, number, int(p), float(x), float(y)) for p, (x, y) in zip(point, xy, strict=True))
        report(count)
    # A camera has one lens, and a lens is calibrated for one size of image: the one of most images.
    usual = max(frames, key=lambda size: len(frames[size]), default=(0, 0))
    findings = [
        Finding(
            "board-image-size",
            Severity.WARNING,
            str(camera.image(frame)),
            f"{camera.image(frame)} is {size[0]} x {size[1]}, other images of {camera.name} {usual[0]} x {usual[1]}; it was left out.",
            "Film with one camera in one size.",
        )
        for size, others in frames.items()
        for frame in others
        if size != usual
    ]
    return _CameraViews(rows.get(usual, []), usual, count, findings)
