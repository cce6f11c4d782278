"""Kernel of the choice of partial solvers: what the labels of a labelling matrix are worth."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel


@kernel
def count_labels(cells, markers, points, hidden, number, counts):
    """Count the labels that the safe rules of section 4.5.4 give with points handed in for some markers as well, beside the truth.

    A marker gets a label where one point is handed in for it, which is handed in for no other marker.

    IN  cells (M, K) unsigned, bit m for the point of marker m; markers (D,) and points (D, K) unsigned, handed in besides
        hidden (M, K) bool; number (K,) how many markers are hidden
    OUT counts (H, 4) int: by number of hidden markers the frames, markers in sight without a label, labels, right labels
    O(K M). Twin: `matrix` in tests/twins.py

    Bounds: a word has 64 bits, so at most 64 markers (`MOST_IN_A_WORD`); H is one more than the most that `number` has.
    """
    m_count = len(cells)
    row, place = np.empty(m_count, dtype=np.uint64), np.full(m_count, -1, dtype=np.int64)
    for d in range(len(markers)):
        place[markers[d]] = d
    counts[:] = 0
    for k in range(cells.shape[1]):
        once = twice = np.uint64(0)
        for m in range(m_count):
            row[m] = np.uint64(cells[m, k])
            if place[m] >= 0:
                row[m] |= np.uint64(points[place[m], k])
            # A point handed in for two markers is safe for neither.
            twice |= once & row[m]
            once |= row[m]
        missed = given = right = 0
        for m in range(m_count):
            # Exactly one bit, and in no other row.
            single = row[m] != 0 and row[m] & (row[m] - np.uint64(1)) == 0 and row[m] & twice == 0
            given += single
            right += single and row[m] == np.uint64(1) << np.uint64(m)
            missed += not single and not hidden[m, k]
        h = number[k]
        counts[h, 0] += 1
        counts[h, 1] += missed
        counts[h, 2] += given
        counts[h, 3] += right
