"""Assignment: scores of every point as every marker in; one point per marker out."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel


@kernel
def assign_greedily(scores, first_ghost_cost, point_of):
    """Give points to markers, best score first; what scores below 0 stays null, unless that saves the only ghosts.

    IN  scores (M, n) nats; first_ghost_cost nats that may be paid to leave no point over
    OUT point_of (M,), -1 for none
    O(M n + labels * M), and n more each time that another marker takes the point that was best for one: O(M^2 n) at worst.

    Bounds: each label takes a marker and a point: min(M, n).
    """
    markers, n = scores.shape
    point_of[:] = -1
    best_point, best_score = np.empty(markers, dtype=np.int64), np.empty(markers)
    taken = np.zeros(n, dtype=np.bool_)
    for m in range(markers):
        best_point[m], best_score[m] = _best_free_point(scores, m, taken, first_ghost_cost)
    given, positive = 0, -1
    order = np.empty(min(markers, n), dtype=np.int64)
    credit = first_ghost_cost
    while True:
        # The first of equals, by marker and then by point, so that their order decides.
        best, m = -first_ghost_cost, -1
        for o in range(markers):
            if best_score[o] > best:
                best, m = best_score[o], o
        # From here on labels cost more than they are worth, unless they leave no ghost.
        if positive < 0 and (m < 0 or best <= 0.0):
            positive = given
        # With more points than markers, some are left over whatever is paid.
        if m < 0 or (best <= 0.0 and n > markers):
            break
        if best <= 0.0:
            # They may cost together what the first ghost costs.
            credit += best
            if credit <= 0.0:
                break
        c = best_point[m]
        point_of[m], taken[c], order[given] = c, True, m
        given += 1
        best_score[m] = -np.inf
        for o in range(markers):
            # Whoever liked the same point best looks for another one.
            if best_score[o] > -np.inf and best_point[o] == c:
                best_point[o], best_score[o] = _best_free_point(scores, o, taken, first_ghost_cost)
    # Points are left all the same: then nothing was saved, and the costly labels are taken back.
    if given < n:
        for g in range(positive, given):
            point_of[order[g]] = -1


@kernel
def _best_free_point(scores, m, taken, first_ghost_cost):
    """The point that is best for marker m among those not taken, and its score; -1 and -inf where each costs more than a ghost. O(n)."""
    chosen, best = -1, -np.inf
    for c in range(len(taken)):
        # What costs more than a ghost can never be worth a label.
        if scores[m, c] > -first_ghost_cost and scores[m, c] > best and not taken[c]:
            chosen, best = c, scores[m, c]
    return chosen, best


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
