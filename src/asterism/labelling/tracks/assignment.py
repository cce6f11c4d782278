"""Which tracklet is which marker: every tracklet's gain for every marker in, the labels of the greatest total gain out.

The problem is an integer program: choose for every tracklet j at most one marker m,

    maximise  sum of gain[j, m] x[j, m]    over x[j, m] in {0, 1},
    sum over m of x[j, m] <= 1,            sum of x[j, m] over the tracklets that are there at time t <= 1  for every m and t.

Where each tracklet's own best marker is free of conflicts, taking it is optimal. Else the tracklets that conflict, with all that they
could push aside, are solved exactly (HiGHS; the constraints of one marker are those of intervals, so relaxations are nearly always whole).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from asterism.labelling.tracks._kernels import overlaps
from asterism.recording import NULL, Floats, Ints


def assign_tracklets(gain: Floats, first: Ints, last: Ints) -> Ints:
    """Labels (J,) of the greatest total gain, -1 for none.

    gain (J, L) for each of L markers (of all bodies), only what is above 0 is ever taken; first, last (J,) frames of the tracklets.
    O(J L) where nothing conflicts.
    """
    best = np.argmax(gain, axis=1) if gain.shape[1] else np.zeros(len(gain), dtype=np.int64)
    label = np.where(gain[np.arange(len(gain)), best] > 0, best, NULL).astype(np.int64) if gain.shape[1] else np.full(len(gain), NULL)
    order = np.argsort(first, kind="stable")
    pairs = overlaps(gain, first, last, order)
    clash = pairs[label[pairs[:, 0]] == label[pairs[:, 1]]]
    clash = clash[label[clash[:, 0]] != NULL]
    if not len(clash):
        return label
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(gain), len(gain)))
    _, part = connected_components(links, directed=False)
    for p in np.unique(part[clash[:, 0]]):
        own = np.nonzero(part == p)[0]
        label[own] = _solve(gain[own], first[own], last[own])
    return label


def _solve(gain: Floats, first: Ints, last: Ints) -> Ints:
    """The integer program itself."""
    track, marker = np.nonzero(gain > 0)
    rows, columns, count = [], [], 0
    for j in np.unique(track):
        own = np.nonzero(track == j)[0]
        rows.append(np.full(len(own), count))
        columns.append(own)
        count += 1
    for m in np.unique(marker):
        own = np.nonzero(marker == m)[0]
        for time in np.unique(first[track[own]]):
            there = own[(first[track[own]] <= time) & (last[track[own]] >= time)]
            if len(there) > 1:
                rows.append(np.full(len(there), count))
                columns.append(there)
                count += 1
    row, column = np.concatenate(rows), np.concatenate(columns)
    limits = coo_array((np.ones(len(row)), (row, column)), shape=(count, len(track))).tocsr()
    found = milp(
        -gain[track, marker], constraints=LinearConstraint(limits, -np.inf, 1.0), integrality=np.ones(len(track)), bounds=Bounds(0, 1)
    )
    label = np.full(len(gain), NULL, dtype=np.int64)
    taken = found.x > 0.5
    label[track[taken]] = marker[taken]
    return label
