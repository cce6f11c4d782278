"""Frames and one solver of all markers in; the labels on which all its feasible labellings agree out (thesis 5.2)."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel
from asterism.labelling.features.feature_kernels import point_distances
from asterism.labelling.features.search_kernels import TreeWorkspace, search_frame


@kernel
def agreed_points(found, solutions, depths, out):
    """Where all labellings that a solver found agree.

    IN  found (>= solutions, >= depths) rows of points
    OUT out (>= depths,) the row of each depth, -1 where they differ or there is no labelling
    O(solutions depths).
    """
    for k in range(depths):
        out[k] = found[0, k] if solutions > 0 else -1
        for i in range(1, solutions):
            if found[i, k] != found[0, k]:
                out[k] = -1
                break


@kernel
def sort_highest_first(points, n, order):
    """Sort the first n points by height.

    IN  points (>= n, 3 or more) m, z up
    OUT order (>= n,) rows, highest first, equal heights in row order
    O(n^2); n is small.
    """
    for i in range(n):
        j = i
        while j > 0 and points[order[j - 1], 2] < points[i, 2]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = i


@kernel
def label_by_full_solver(solvers, lowest_first, xyz, offsets, budget, indices, first, total):
    """Label frames with solver 0 alone: a marker is given where all feasible labellings of the frame agree on its point.

    IN  lowest_first, whether low points are tried first, else high ones; xyz (P, 3) m, offsets (T + 1,)
        budget, feature evaluations per frame
    OUT indices (T, M) by marker, -1 for none; first, total (T,) evaluations until the first feasible labelling (-1 without one), and in all
    O(frames times a search), no allocation per frame. Section 5.2. Twin: `label_by_full_solver` in tests/twins_partial.py
    """
    depths = solvers.first_depth[1]
    # Memory for the largest frame, once for all.
    most = 0
    for t in range(len(offsets) - 1):
        most = max(most, offsets[t + 1] - offsets[t])
    path, tried = np.empty(depths, dtype=np.int64), np.empty(depths, dtype=np.int64)
    used, order = np.empty(most, dtype=np.bool_), np.empty(most, dtype=np.int64)
    found, agreed = np.empty((64, depths), dtype=np.int64), np.empty(depths, dtype=np.int64)
    counters, distance = np.zeros(2, dtype=np.int64), np.empty((most, most))
    workspace = TreeWorkspace(distance, order, path, tried, used, found, counters)
    indices[:] = -1
    for t in range(len(offsets) - 1):
        points, n = xyz[offsets[t] : offsets[t + 1]], offsets[t + 1] - offsets[t]
        sort_highest_first(points, n, order)
        # A tree that begins at a low marker finds it among the first points then.
        # Which end goes first is the thesis' comparison; the labellings found are the same.
        if lowest_first:
            order[:n] = order[:n][::-1].copy()
        point_distances(points, n, distance)
        counters[0] = 0
        solutions = search_frame(solvers, 0, points, n, budget, workspace)
        total[t] = counters[0]
        first[t] = counters[1] if solutions > 0 else -1
        agreed_points(found, solutions, depths, agreed)
        for k in range(depths):
            indices[t, solvers.markers[k]] = agreed[k]
