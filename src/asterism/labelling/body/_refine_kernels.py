"""Refinement: a labelling in; the labelling that the whole body settles on out."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel
from asterism.labelling.body._assignment_kernels import assign_greedily, assign_unambiguous
from asterism.labelling.body._score_kernels import best_pose, rescore
from asterism.labelling.body._workspace_kernels import copy_labels, count_labelled, index_of

MAX_ROUNDS = 8
"""Relabellings after which a labelling that still changes is taken as it is."""


@kernel
def refine(body, k, points, point_of, settings, workspace):
    """Relabel by the whole body until nothing changes: posterior, leave-one-out scores, assignment.

    First only clear labels are taken (`assign_unambiguous`), which narrow down where the others must be; then all.
    IN k key pose to begin with; IN/OUT point_of (M,). Returns the score of the labelling, in nats.
    O(M r^2 + r^3 + M n) per round, at most MAX_ROUNDS rounds.
    """
    return refine_until_known(body, k, points, point_of, np.empty((0, len(point_of)), dtype=np.int64), 0, settings, workspace)[0]


@kernel
def refine_until_known(body, k, points, point_of, known, count, settings, workspace):
    """`refine` that stops as soon as it arrives at one of the first `count` rows of `known` (H, M), labellings refined before.

    Returns the score in nats, and the row of `known` that it stopped at, -1 for none; the score is NaN where it stopped at one.
    O(M r^2 + r^3 + M n + H M) per round, at most MAX_ROUNDS rounds.
    """
    score = -np.inf
    previous = np.empty_like(point_of)
    workspace.outlier[:] = False
    only_unambiguous = True
    for step in range(MAX_ROUNDS):
        copy_labels(point_of, previous)
        # Two points leave the body's turn open.
        if count_labelled(point_of) < 3:
            point_of[:] = -1
            return -np.inf, -1
        # The key pose is chosen once some labels are clear: the first ones came from three points.
        if step == 1:
            k, _ = best_pose(body, points, point_of, settings, workspace)
        score = rescore(body, k, points, point_of, settings, workspace)
        # Clear labels first: they narrow down where the others must be, and a wrong one would draw the body along.
        if only_unambiguous:
            assign_unambiguous(workspace.scores, settings.assign_margin, point_of)
            only_unambiguous = count_labelled(point_of) > count_labelled(previous) and step < MAX_ROUNDS // 2
        if not only_unambiguous:
            assign_greedily(workspace.scores, settings.first_ghost_cost, point_of)
        # Settled: another round would change nothing.
        same = True
        for m in range(len(point_of)):
            if point_of[m] != previous[m]:
                same = False
                break
        if same:
            return score, -1
        if not only_unambiguous:
            # Refined before from the same labels, so that the rest of the way is known.
            row = index_of(known, count, point_of)
            if row >= 0:
                return np.nan, row
    copy_labels(previous, point_of)
    return score, -1
