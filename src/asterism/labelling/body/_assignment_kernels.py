"""Assignment: scores of every point as every marker in; one point per marker out."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel


@kernel
def assign_greedily(scores, first_ghost_cost, point_of):
    """Give points to markers, best score first; what scores below 0 stays null, unless that saves the only ghosts.

    IN  scores (M, n) nats; first_ghost_cost nats that may be paid to leave no point over
    OUT point_of (M,), -1 for none
    O(M n + labels * entries above -first_ghost_cost).

    Bounds: each pair of a marker and a point is an entry once: M n. A label takes a marker and a point: min(M, n).
    """
    markers, n = scores.shape
    point_of[:] = -1
    entry_marker = np.empty(markers * n, dtype=np.int64)
    entry_row = np.empty(markers * n, dtype=np.int64)
    entries = 0
    for m in range(markers):
        for c in range(n):
            # What costs more than a ghost can never be worth a label.
            if scores[m, c] > -first_ghost_cost:
                entry_marker[entries], entry_row[entries] = m, c
                entries += 1
    taken = np.zeros(n, dtype=np.bool_)
    given, positive = 0, -1
    order = np.empty(min(markers, n), dtype=np.int64)
    credit = first_ghost_cost
    while True:
        # Entries whose marker or point is given fall out, so that each round is shorter.
        best, chosen, kept = -first_ghost_cost, -1, 0
        for e in range(entries):
            m, c = entry_marker[e], entry_row[e]
            if point_of[m] >= 0 or taken[c]:
                continue
            entry_marker[kept], entry_row[kept] = m, c
            if scores[m, c] > best:
                best, chosen = scores[m, c], kept
            kept += 1
        entries = kept
        # From here on labels cost more than they are worth, unless they leave no ghost.
        if positive < 0 and (chosen < 0 or best <= 0.0):
            positive = given
        if chosen < 0:
            break
        if best <= 0.0:
            # They may cost together what the first ghost costs.
            credit += best
            if credit <= 0.0:
                break
        m = entry_marker[chosen]
        point_of[m] = entry_row[chosen]
        taken[point_of[m]] = True
        order[given] = m
        given += 1
    # Points are left all the same: then nothing was saved, and the costly labels are taken back.
    if given < n:
        for g in range(positive, given):
            point_of[order[g]] = -1


@kernel
def assign_unambiguous(scores, gap, point_of):
    """Give points to markers only where nothing else comes near: best both ways, and by `gap` nats over the next best and over null.

    IN  scores (M, n) nats. OUT point_of (M,), -1 for none. O(M n).
    """
    markers, n = scores.shape
    best_marker, best_score, rival = np.full(n, -1, dtype=np.int64), np.zeros(n), np.zeros(n)
    # The best and the second best marker of each point ...
    for c in range(n):
        for m in range(markers):
            if scores[m, c] > best_score[c]:
                rival[c] = best_score[c]
                best_score[c] = scores[m, c]
                best_marker[c] = m
            elif scores[m, c] > rival[c]:
                rival[c] = scores[m, c]
    # ... and of each marker its points: both must be clear.
    for m in range(markers):
        best, second, chosen = 0.0, 0.0, -1
        for c in range(n):
            if scores[m, c] > best:
                second = best
                best = scores[m, c]
                chosen = c
            elif scores[m, c] > second:
                second = scores[m, c]
        clear = chosen >= 0 and best_marker[chosen] == m and best - second > gap and best - rival[chosen] > gap
        point_of[m] = chosen if clear else -1
