"""The choice of partial solvers for the printed labelling matrix: candidates in; those that together label most, out (thesis 4.5.3).

Under the printed rules one ambiguous solver takes a marker's label from all others, so solvers cannot be chosen one by one for what they
know. Here they are chosen for what the matrix gives with them, on frames of the training with hidden markers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from asterism.recording import Ints

Points = NDArray[np.unsignedinteger]
"""Sets of points, each named by the marker whose point it is: bit m for the point of marker m."""

_ONE = np.uint64(1)


class Matrix:
    """The labelling matrices of frames with hidden markers.

    cells   (M, K) points handed in for each marker
    hidden  (M, K) bool; `wrong_cost`: false occlusions that a false assignment weighs, both as shares (section 5.3)
    """

    def __init__(self, hidden: NDArray[np.bool_], wrong_cost: float) -> None:
        self.hidden, self.wrong_cost = np.ascontiguousarray(hidden), wrong_cost
        self.number = hidden.sum(axis=0)
        self.own = _ONE << np.arange(len(hidden), dtype=np.uint64)
        self.cells: Points = np.zeros(hidden.shape, dtype=word_for(len(hidden)))

    def cost(self, cells: Points) -> float:
        """False occlusions, and `wrong_cost` times the false assignments, of a matrix: means over the numbers h of hidden markers.

        The occlusions at h hidden weigh 1 / h^2. Without these weights the choice gives up the frames with one hidden marker for those with
        five, where more labels are to be had: on the gait recordings 17.6 instead of 13.3 % at one, and 31.0 instead of 32.1 % at five.
        """
        given, right = self.labels(cells)
        missed, labels, good = (~given & ~self.hidden).sum(axis=0), given.sum(axis=0), right.sum(axis=0)
        lost, made, kept, frames = (
            np.bincount(self.number, weights=counts, minlength=1) for counts in (missed, labels, good, np.ones(len(missed)))
        )
        numbers = np.nonzero(frames[1:])[0] + 1
        occlusions = lost[numbers] / (lost[numbers] + numbers * frames[numbers])
        assignments = (made[numbers] - kept[numbers]) / np.maximum(made[numbers], 1)
        weights = 1.0 / numbers**2.0
        if not len(numbers):
            return 0.0
        return float(weights @ occlusions / weights.sum() + self.wrong_cost * assignments.mean())

    def labels(self, cells: Points) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which markers get a label by the safe rules of section 4.5.4, and which the right one: (M, K) each."""
        once, twice = np.zeros_like(cells[0]), np.zeros_like(cells[0])
        for row in cells:
            twice |= once & row
            once |= row
        given = (cells != 0) & ((cells & (cells - cells.dtype.type(1))) == 0) & ((cells & twice) == 0)
        return given, given & (cells == self.own.astype(cells.dtype)[:, None])

    def with_points(self, markers: Ints, points: Points) -> Points:
        """The cells with points (D, K) handed in for markers (D,) as well."""
        cells = self.cells.copy()
        cells[markers] |= points
        return cells


def word_for(markers: int) -> type[np.unsignedinteger]:
    """The smallest word with a bit for each of up to 64 markers."""
    return np.uint16 if markers <= 16 else np.uint32 if markers <= 32 else np.uint64


def best_addition(matrix: Matrix, candidates: Sequence[tuple[Ints, Points]], gains: NDArray[np.float64]) -> int:
    """The candidate (markers, points handed in) that lowers the cost most, or -1 where none does.

    gains (S,): of each candidate when it was last tried, inf for new ones, -inf for those that are out. A gain that has become smaller is
    found out only where the candidate could still be the best. OUT gains.
    """
    now = matrix.cost(matrix.cells)
    best, most = -1, 0.0
    for s in np.argsort(-gains, kind="stable"):
        if gains[s] <= most:
            break
        gains[s] = now - matrix.cost(matrix.with_points(*candidates[s]))
        if gains[s] > most:
            best, most = int(s), float(gains[s])
    return best
