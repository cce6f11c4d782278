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
    known = np.empty((0, len(point_of)), dtype=np.int64)
    return refine_until_known(body, k, points, point_of, known, 0, -np.inf, 0.0, settings, workspace)[0]


@kernel
def refine_until_known(body, k, points, point_of, known, count, least, marker_gain, settings, workspace):
    """`refine` that stops as soon as it arrives at one of the first `count` rows of `known` (H, M), labellings refined before.

    And as soon as it is below `least` nats even if each marker without a point earned marker_gain nats for one: it seldom rises again.
    Returns the score in nats, and the row of `known` that it stopped at, -1 for none; the score is NaN where it stopped at one.
    O(M r^2 + r^3 + M n + H M) per round, at most MAX_ROUNDS rounds.
    """
    markers, n = len(point_of), len(points)
    score, one_ago = -np.inf, -np.inf
    # The labels and outliers that the last two rounds began with.
    previous, before = np.empty_like(point_of), np.empty_like(point_of)
    outlier, outlier_before = workspace.outlier.copy(), workspace.outlier.copy()
    workspace.outlier[:] = False
    only_unambiguous, settled_since = True, MAX_ROUNDS
    for step in range(MAX_ROUNDS):
        # Most labellings that do not settle go to and fro between two: where they were two rounds ago, they end at one of these.
        if step >= 3 and settled_since <= step - 2 and _same_state(point_of, workspace.outlier, before, outlier_before):
            if (MAX_ROUNDS - 1 - step) % 2 == 0:
                copy_labels(outlier, workspace.outlier)
                return one_ago, -1
            copy_labels(previous, point_of)
            return score, -1
        copy_labels(previous, before)
        copy_labels(outlier, outlier_before)
        copy_labels(point_of, previous)
        copy_labels(workspace.outlier, outlier)
        one_ago = score
        # Two points leave the body's turn open.
        if count_labelled(point_of) < 3:
            point_of[:] = -1
            return -np.inf, -1
        # The key pose is chosen once some labels are clear: the first ones came from three points.
        if step == 1:
            k, _ = best_pose(body, points, point_of, settings, workspace)
        score = rescore(body, k, points, point_of, settings, workspace)
        if not only_unambiguous and score + marker_gain * (min(markers, n) - count_labelled(point_of)) < least:
            return score, -1
        # Clear labels first: they narrow down where the others must be, and a wrong one would draw the body along.
        if only_unambiguous:
            assign_unambiguous(workspace.scores, settings.assign_margin, point_of)
            only_unambiguous = count_labelled(point_of) > count_labelled(previous) and step < MAX_ROUNDS // 2
        if not only_unambiguous:
            settled_since = min(settled_since, step + 1)
            assign_greedily(workspace.scores, settings.first_ghost_cost, point_of)
        # Settled: another round would change nothing.
        same = True
        for m in range(markers):
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


@kernel
def _same_state(labels, outlier, other_labels, other_outlier):
    """Whether two rounds begin with the same labels (M,) and the same outliers (M,). O(M)."""
    same = True
    for m in range(len(labels)):
        same = same and labels[m] == other_labels[m] and outlier[m] == other_outlier[m]
    return same
