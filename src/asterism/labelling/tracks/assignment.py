"""Which tracklet is which marker: every tracklet's gain for every marker in, the labels of the greatest total gain out.

The problem is an integer program: choose for every tracklet j at most one marker m,

    maximise  sum of gain[j, m] x[j, m]    over x[j, m] in {0, 1},
    sum over m of x[j, m] <= 1,            sum of x[j, m] over the tracklets that are there at time t <= 1  for every m and t.

Where each tracklet's own best marker is free of conflicts, taking it is optimal. Else the tracklets that conflict, with all that they could
push aside, are solved exactly (HiGHS; the constraints of one marker are those of intervals, so relaxations are nearly always whole already).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

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
    found = milp(-gain[track, marker], constraints=LinearConstraint(limits, -np.inf, 1.0), integrality=np.ones(len(track)), bounds=Bounds(0, 1))
    label = np.full(len(gain), NULL, dtype=np.int64)
    taken = found.x > 0.5
    label[track[taken]] = marker[taken]
    return label


@njit(cache=True)
def overlaps(gain, first, last, order):
    """Pairs (n, 2) of tracklets that are there at the same time and both gain by a common marker.

    IN  gain (J, L); first, last (J,); order (J,) by first frame. O(J * tracklets there at once * L).
    """
    tracks, markers = gain.shape
    pairs = np.empty((max(16, tracks), 2), dtype=np.int64)
    count = 0
    there = np.empty(tracks, dtype=np.int64)
    n_there = 0
    for o in range(tracks):
        j = order[o]
        any_gain = False
        for m in range(markers):
            if gain[j, m] > 0.0:
                any_gain = True
                break
        if not any_gain:
            continue
        kept = 0
        for s in range(n_there):
            if last[there[s]] >= first[j]:
                there[kept] = there[s]
                kept += 1
        n_there = kept
        for s in range(n_there):
            i = there[s]
            for m in range(markers):
                if gain[j, m] > 0.0 and gain[i, m] > 0.0:
                    if count == len(pairs):
                        grown = np.empty((2 * count, 2), dtype=np.int64)
                        grown[:count] = pairs
                        pairs = grown
                    pairs[count, 0], pairs[count, 1] = i, j
                    count += 1
                    break
        there[n_there] = j
        n_there += 1
    return pairs[:count]


@njit(cache=True)
def margins_of(gain, label, first, last, order):
    """By how much each tracklet's label beats what it or its neighbours in time could have been instead.

    For a labelled tracklet: against no label, every other marker (pushing its holder out, or swapping with it), and every other tracklet
    that could take its marker. For one without a label: its best gain less what the present holder would lose, negative.
    IN  gain (J, L); label (J,); first, last (J,); order (J,) by first frame
    OUT margin (J,) nats, rival (J,) the best other marker (for a null: the best marker), -1 for none
    O(J * tracklets there at once * L).
    """
    tracks, markers = gain.shape
    margin, rival = np.empty(tracks), np.full(tracks, -1, dtype=np.int64)
    taken = np.zeros((tracks, markers))
    # what it costs to free each marker for a tracklet: the sum over its holders at that time of their gain over their best way out
    there = np.empty(tracks, dtype=np.int64)
    n_there = 0
    for o in range(tracks):
        j = order[o]
        kept = 0
        for s in range(n_there):
            if last[there[s]] >= first[j]:
                there[kept] = there[s]
                kept += 1
        n_there = kept
        for s in range(n_there):
            i = there[s]
            if label[i] >= 0 and label[i] != label[j]:
                out = max(0.0, gain[i, label[j]]) if label[j] >= 0 else 0.0
                taken[j, label[i]] += gain[i, label[i]] - out
            if label[j] >= 0 and label[i] != label[j]:
                out = max(0.0, gain[j, label[i]]) if label[i] >= 0 else 0.0
                taken[i, label[j]] += gain[j, label[j]] - out
        there[n_there] = j
        n_there += 1
    for j in range(tracks):
        best = -np.inf
        for m in range(markers):
            if m != label[j] and gain[j, m] - taken[j, m] > best:
                best, rival[j] = gain[j, m] - taken[j, m], m
        margin[j] = gain[j, label[j]] - max(best, 0.0) if label[j] >= 0 else min(0.0, best)
    # a tracklet without a label that could have taken a labelled one's marker
    n_there = 0
    for o in range(tracks):
        j = order[o]
        kept = 0
        for s in range(n_there):
            if last[there[s]] >= first[j]:
                there[kept] = there[s]
                kept += 1
        n_there = kept
        for s in range(n_there):
            i = there[s]
            if label[i] >= 0 and label[j] < 0:
                margin[i] = min(margin[i], max(0.0, gain[i, label[i]] - max(0.0, gain[j, label[i]])))
            if label[j] >= 0 and label[i] < 0:
                margin[j] = min(margin[j], max(0.0, gain[j, label[j]] - max(0.0, gain[i, label[j]])))
        there[n_there] = j
        n_there += 1
    return margin, rival
