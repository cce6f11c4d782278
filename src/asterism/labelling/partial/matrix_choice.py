"""The choice of partial solvers for the printed labelling matrix: candidates in; those that together label most, out (thesis 4.5.3).

Under the printed rules one ambiguous solver takes a marker's label from all others, so solvers cannot be chosen one by one for what they
know. Here they are chosen for what the matrix gives with them, on frames of the training with hidden markers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from asterism.labelling.partial._choice_kernels import count_labels
from asterism.recording import Ints

Points = NDArray[np.unsignedinteger]
"""Sets of points, each named by the marker whose point it is: bit m for the point of marker m."""

NO_MARKERS = np.empty(0, dtype=np.int64)


class Matrix:
    """The labelling matrices of frames with hidden markers.

    cells   (M, K) points handed in for each marker
    hidden  (M, K) bool; `wrong_cost`: false occlusions that a false assignment weighs, both as shares (section 5.3)
    """

    def __init__(self, hidden: NDArray[np.bool_], wrong_cost: float) -> None:
        self.hidden, self.wrong_cost = np.ascontiguousarray(hidden), wrong_cost
        self.number = hidden.sum(axis=0)
        self.cells: Points = np.zeros(hidden.shape, dtype=word_for(len(hidden)))

    def cost(self, markers: Ints = NO_MARKERS, points: Points | None = None) -> float:
        """False occlusions, and `wrong_cost` times the false assignments: means over the numbers h of hidden markers.

        With `points` (D, K) handed in for `markers` (D,) as well.

        The occlusions at h hidden weigh 1 / h^2. Without these weights the choice gives up the frames with one hidden marker for those with
        five, where more labels are to be had: on the gait recordings 17.6 instead of 13.3 % at one, and 31.0 instead of 32.1 % at five.
        """
        counts = np.zeros((len(self.hidden) + 1, 4), dtype=np.int64)
        count_labels(self.cells, markers, self.cells[:0] if points is None else points, self.hidden, self.number, counts)
        numbers = np.nonzero(counts[1:, 0])[0] + 1
        if not len(numbers):
            return 0.0
        frames, missed, given, right = counts[numbers].T
        occlusions = missed / (missed + numbers * frames)
        assignments = (given - right) / np.maximum(given, 1)
        weights = 1.0 / numbers**2.0
        return float(weights @ occlusions / weights.sum() + self.wrong_cost * assignments.mean())

    def add(self, markers: Ints, points: Points) -> None:
        """Hand in points (D, K) for markers (D,)."""
        self.cells[markers] |= points


def word_for(markers: int) -> type[np.unsignedinteger]:
    """The smallest word with a bit for each of up to 64 markers."""
    return np.uint16 if markers <= 16 else np.uint32 if markers <= 32 else np.uint64


def best_addition(matrix: Matrix, candidates: Sequence[tuple[Ints, Points]], gains: NDArray[np.float64]) -> int:
    """The candidate (markers, points handed in) that lowers the cost most, or -1 where none does.

    gains (S,): of each candidate when it was last tried, inf for new ones, -inf for those that are out. A gain that has become smaller is
    found out only where the candidate could still be the best. OUT gains.
    """
    now = matrix.cost()
    best, most = -1, 0.0
    for s in np.argsort(-gains, kind="stable"):
        if gains[s] <= most:
            break
        gains[s] = now - matrix.cost(*candidates[s])
        if gains[s] > most:
            best, most = int(s), float(gains[s])
    return best
