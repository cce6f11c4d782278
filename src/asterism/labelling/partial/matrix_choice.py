"""The choice of partial solvers for the printed labelling matrix: candidates in; those that together label most, out (thesis 4.5.3).

Under the printed rules one ambiguous solver takes a marker's label from all others, so solvers cannot be chosen one by one for what they
know. Here they are chosen for what the matrix gives with them, on frames of the training with hidden markers.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

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
        # Numbers of hidden markers that no frame has would divide by zero.
        numbers = np.nonzero(counts[1:, 0])[0] + 1
        if not len(numbers):
            return 0.0
        frames, missed, given, right = counts[numbers].T
        occlusions = missed / (missed + numbers * frames)
        assignments = (given - right) / np.maximum(given, 1)
        # One hidden marker is the commonest case, and weighs most.
        weights = 1.0 / numbers**2.0
        return float(weights @ occlusions / weights.sum() + self.wrong_cost * assignments.mean())

    def emptied(self) -> Matrix:
        """The same frames, with nothing handed in."""
        return Matrix(self.hidden, self.wrong_cost)


def word_for(markers: int) -> type[np.unsignedinteger]:
    """The smallest word with a bit for each of up to 64 markers."""
    return np.uint16 if markers <= 16 else np.uint32 if markers <= 32 else np.uint64


def choose_solvers(
    matrix: Matrix,
    markers: Sequence[Ints],
    points: Sequence[Points],
    most: int,
    *,
    without: Collection[int] = (),
    confirm: Callable[[int], NDArray[np.bool_]] | None = None,
) -> list[int]:
    """Which solvers, one after the other, lower the cost most, until none does or there are `most`.

    Each hands in its points (D, K) for its markers (D,). `without` are out. `confirm` says of the solver to be taken for which of its
    markers (D,) it may hand in points; where that is not for all, it must be the best with these only.
    OUT matrix; points, 0 where not confirmed.
    """
    gains = np.full(len(points), np.inf)
    gains[list(without)] = -np.inf
    chosen: list[int] = []
    while len(chosen) < most:
        best = best_addition(matrix, markers, points, gains)
        if best < 0:
            break
        # What is not confirmed would take labels from others: the solver must do without it.
        if confirm is not None and points[best][denied := ~confirm(best)].any():
            points[best][denied] = 0
            continue
        matrix.cells[markers[best]] |= points[best]
        gains[best] = -np.inf
        chosen.append(best)
    return chosen


def best_addition(matrix: Matrix, markers: Sequence[Ints], points: Sequence[Points], gains: NDArray[np.float64]) -> int:
    """The solver that lowers the cost most, or -1 where none does.

    gains (S,): of each solver when it was last tried, inf for new ones, -inf for those that are out. A gain that has become smaller is
    found out only where the solver could still be the best. OUT gains.
    """
    now = matrix.cost()
    best, most = -1, 0.0
    for s in np.argsort(-gains, kind="stable"):
        # Gains only fall as solvers are added: beyond this one none can be better.
        if gains[s] <= most:
            break
        gains[s] = now - matrix.cost(markers[s], points[s])
        if gains[s] > most:
            best, most = int(s), float(gains[s])
    return best
