"""Which tracklet is which marker: every tracklet's gain for every marker in, the labels of the greatest total gain out.

The problem is an integer program: choose for every tracklet j at most one marker m,

    maximise  sum of gain[j, m] x[j, m]    over x[j, m] in {0, 1},
    sum over m of x[j, m] <= 1,            sum of x[j, m] over the tracklets that are there at time t <= 1  for every m and t.

Where the best markers of all tracklets do not conflict, they are the solution. Otherwise the tracklets in conflict are solved exactly by
themselves, as if all others kept their best markers and could share them: this relaxation is an upper bound. If its solution takes a marker
that another tracklet has at the same time, that one joins, and it is solved again; if not, it is the best labelling of all. Few tracklets
are solved by branch and bound, many that are all there at one time as a linear assignment, others by HiGHS.

Where nearly any tracklet could be any marker, as of a body that the model does not know, hundreds are in conflict, and an exact solution
may take hours. Above a size, which does not depend on the machine, the best labels that an ascent marker by marker finds are taken; which
tracklets these are is told.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, linear_sum_assignment, milp
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from asterism.labelling.whole._kernels import assign_roughly, branch_and_bound, overlaps, settle_dominant
from asterism.recording import NULL, Floats, Ints

BRANCHES = 20_000
"""Steps of the branch and bound, some milliseconds, after which HiGHS takes over."""

FEW_ROUNDS = 2
"""Rounds in which only tracklets join that conflict; from then on all do that could. Joining one by one takes up to ten rounds, and each
takes as long as the last. The labels are the same."""

DOMINANT_ROUNDS = 20
"""How often tracklets whose best marker no other use can outweigh are looked for; what is left is solved exactly."""


EXACT_CHOICES = 2_500
"""Gains above 0 among tracklets in conflict up to which HiGHS solves the program exactly, in less than a second."""

NODES = 50
"""Nodes of the search tree of HiGHS; nearly all programs need one."""


@dataclass(frozen=True)
class Assignment:
    """Labels (J,) of the greatest total gain, -1 for none; and whether each is one of those that could not be compared exactly (J,)."""

    label: Ints
    rough: NDArray[np.bool_]


def assign_tracklets(gain: Floats, first: Ints, last: Ints) -> Assignment:
    """The labels of the greatest total gain.

    gain (J, L) for each of L markers (of all bodies), only what is above 0 is ever taken; first, last (J,) frames of the tracklets.
    O(J L) where nothing conflicts. The same on any machine.
    """
    gain = gain.copy()
    order = np.argsort(first, kind="stable")
    pairs = overlaps(gain, first, last, order)
    settle_dominant(gain, pairs, DOMINANT_ROUNDS)
    best = np.argmax(gain, axis=1) if gain.shape[1] else np.zeros(len(gain), dtype=np.int64)
    label = np.where(gain[np.arange(len(gain)), best] > 0, best, NULL).astype(np.int64) if gain.shape[1] else np.full(len(gain), NULL)
    free = np.zeros(len(gain), dtype=np.bool_)
    solved: dict[bytes, tuple[Ints, bool]] = {}
    rough = np.zeros(len(gain), dtype=np.bool_)
    for turn in count():
        clash = pairs[(label[pairs[:, 0]] == label[pairs[:, 1]]) & (label[pairs[:, 0]] != NULL)]
        if not len(clash):
            break
        free[clash.ravel()] = True
        if turn >= FEW_ROUNDS:
            free[pairs[free[pairs].any(axis=1)].ravel()] = True
        inside = pairs[free[pairs].all(axis=1)]
        links = coo_array((np.ones(len(inside)), (inside[:, 0], inside[:, 1])), shape=(len(gain), len(gain)))
        part = connected_components(links, directed=False)[1]
        for p in np.unique(part[free]):
            members = np.nonzero((part == p) & free)[0]
            if members.tobytes() not in solved:
                solved[members.tobytes()] = _solve(gain[members], first[members], last[members])
            label[members], rough[members] = solved[members.tobytes()]
    return Assignment(label, rough)


def _solve(gain: Floats, first: Ints, last: Ints) -> tuple[Ints, bool]:
    """The integer program itself: its labels, and whether they may not be the best."""
    label = np.empty(len(gain), dtype=np.int64)
    order = np.argsort(-gain.max(axis=1), kind="stable")
    done = branch_and_bound(gain[order], first[order], last[order], BRANCHES, label)
    if not done:
        if first.max() <= last.min():
            return _solve_at_once(gain), False
        best = _solve_by_highs(gain, first, last) if (gain > 0).sum() <= EXACT_CHOICES else None
        return (_solve_roughly(gain, first, last), True) if best is None else (best, False)
    found = np.empty_like(label)
    found[order] = label
    return found, False


def _solve_at_once(gain: Floats) -> Ints:
    """The program of tracklets that are all there at one time: each marker is one tracklet's at most. O(J^2 L)."""
    track, marker = linear_sum_assignment(np.maximum(gain, 0.0), maximize=True)
    label = np.full(len(gain), NULL, dtype=np.int64)
    taken = gain[track, marker] > 0
    label[track[taken]] = marker[taken]
    return label


def _solve_roughly(gain: Floats, first: Ints, last: Ints) -> Ints:
    """Labels of a great total gain: see `assign_roughly`."""
    label, by_end = np.empty(len(gain), dtype=np.int64), np.argsort(last, kind="stable")
    assign_roughly(gain, by_end, np.searchsorted(last[by_end], first[by_end]), label)
    return label


def _solve_by_highs(gain: Floats, first: Ints, last: Ints) -> Ints | None:
    """The integer program with every variable and constraint written out; None where that needs more nodes than allowed."""
    track, marker = np.nonzero(gain > 0)
    label = np.full(len(gain), NULL, dtype=np.int64)
    # without a choice that gains anything there is no program to solve
    if not len(track):
        return label
    rows, columns, count = [], [], 0
    for j in np.unique(track):
        members = np.nonzero(track == j)[0]
        rows.append(np.full(len(members), count))
        columns.append(members)
        count += 1
    for m in np.unique(marker):
        members = np.nonzero(marker == m)[0]
        starts = np.unique(first[track[members]])
        for time, next_time in zip(starts, [*starts[1:], np.inf], strict=True):
            there = members[(first[track[members]] <= time) & (last[track[members]] >= time)]
            # where none of them ends before the next one begins, the next constraint holds all of them
            if len(there) > 1 and last[track[there]].min() < next_time:
                rows.append(np.full(len(there), count))
                columns.append(there)
                count += 1
    row, column = np.concatenate(rows), np.concatenate(columns)
    limits = coo_array((np.ones(len(row)), (row, column)), shape=(count, len(track))).tocsr()
    found = milp(
        -gain[track, marker],
        constraints=LinearConstraint(limits, -np.inf, 1.0),
        integrality=np.ones(len(track)),
        bounds=Bounds(0, 1),
        options={"node_limit": NODES},
    )
    if not found.success:
        return None
    taken = found.x > 0.5
    label[track[taken]] = marker[taken]
    return label
