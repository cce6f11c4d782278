"""Kernels of the tree search: solvers as flat arrays and the points of a frame in, all labellings that a solver accepts out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.labelling.features.feature_kernels import G2, G4, G19, feature_value


class SolverArrays(NamedTuple):
    """Solvers, one after the other in flat arrays: what `search` walks over.

    markers        marker of each depth; solver s has markers[first_depth[s]:first_depth[s + 1]]
    first_feature  (depths + 1,) classifiers that become computable at a depth
    kinds, slots   feature, and the depths (within the solver) of its points: (C,), (C, 4)
    low, high      (C,) interval of each classifier
    """

    first_depth: np.ndarray
    markers: np.ndarray
    first_feature: np.ndarray
    kinds: np.ndarray
    slots: np.ndarray
    low: np.ndarray
    high: np.ndarray


class TreeWorkspace(NamedTuple):
    """Memory of `search_frame` for frames of up to n points and solvers of up to D markers.

    distance  (n, n) m between the points, or empty (0, 0): then every distance is computed where it is needed
    order     (n,) rows of the points in the order in which to try them
    path      (D,) row of the point at each depth; tried (D,) how many rows were tried there; used (n,) bool rows on the path
    found     (S, D) rows of the points by depth, one labelling per row
    counters  (2,) evaluations made (added to), evaluations until the first labelling
    """

    distance: np.ndarray
    order: np.ndarray
    path: np.ndarray
    tried: np.ndarray
    used: np.ndarray
    found: np.ndarray
    counters: np.ndarray


@kernel
def search(solvers, s, points, order, budget, found, counters):
    """All labellings of one solver's markers that every weak classifier accepts: the tree search of section 4.4.2.

    A classifier is evaluated at the first depth at which its points are assigned; the first that rejects cuts the branch.

    IN   solvers SolverArrays; s which of them; points (n, 3) m, z up; order (n,) rows in the order in which to try them
         budget, feature evaluations after which the search gives up
    OUT  found (S, >= depth) rows of `points` by depth; counters (2,): evaluations made (added to), evaluations until the first solution
    Returns the number of labellings found, or -1 where the budget or S did not suffice: then nothing may be concluded.
    O(n ** depth) at worst, in practice about n per depth and living branch; no memory but the path. Twin: `labellings` in tests/twins.py
    """
    depths = solvers.first_depth[s + 1] - solvers.first_depth[s]
    n = len(points)
    path, tried = np.empty(depths, dtype=np.int64), np.empty(depths, dtype=np.int64)
    workspace = TreeWorkspace(np.empty((0, 0)), order, path, tried, np.empty(n, dtype=np.bool_), found, counters)
    return search_frame(solvers, s, points, n, budget, workspace)


@kernel
def count_search(solvers, xyz, offsets, budget, found, evaluations, labellings):
    """What the search of each solver takes in each of some frames, and how many labellings it finds.

    IN   solvers SolverArrays; xyz (P, 3) m, z up; offsets (T + 1,) where the points of each frame begin; budget as in `search`; found as
         in `search`, overwritten
    OUT  evaluations (solvers, T) int; labellings (solvers, T) int, -1 where budget or room did not suffice
    O(solvers T) searches. Twin: tests/test_body.py
    """
    counters = np.zeros(2, dtype=np.int64)
    for t in range(len(offsets) - 1):
        points = xyz[offsets[t] : offsets[t + 1]]
        order = np.arange(len(points))
        for s in range(len(evaluations)):
            counters[:] = 0
            labellings[s, t] = search(solvers, s, points, order, budget, found, counters)
            evaluations[s, t] = counters[0]


@kernel
def search_frame(solvers, s, points, n, budget, workspace):
    """`search` over the first n points, in the caller's memory.

    IN  solvers, s, points (>= n, 3), budget as in `search`; workspace TreeWorkspace with its distance, order and counters
    OUT workspace.found, workspace.counters
    Returns the same as `search`, O(n ** depth) at worst like it. Twin: `labellings` in tests/twins.py

    Bounds: where `found` is full, it returns -1, so that nothing is concluded from a part of the labellings. Depths are 0 to D - 1.
    """
    distance, order, path, tried, used, found, counters = workspace
    first = solvers.first_depth[s]
    depths = solvers.first_depth[s + 1] - first
    # Every marker of a solver must be in sight, or it says nothing.
    if n < depths:
        return 0
    known = len(distance) > 0
    tried[:depths] = 0
    used[:n] = False
    depth, solutions, evaluations = 0, 0, counters[0]
    while depth >= 0:
        # The row that this depth had before is free again.
        if tried[depth] > 0:
            used[path[depth]] = False
        accepted = False
        begin, end = solvers.first_feature[first + depth], solvers.first_feature[first + depth + 1]
        # Depth first: the first row that all classifiers of this depth accept.
        while tried[depth] < n and not accepted:
            row = order[tried[depth]]
            tried[depth] += 1
            if used[row]:
                continue
            # Before the classifiers, which read this depth's row from the path.
            path[depth] = row
            accepted = True
            for f in range(begin, end):
                evaluations += 1
                kind = solvers.kinds[f]
                a, b = path[solvers.slots[f, 0]], path[solvers.slots[f, 1]]
                # The three commonest kinds are written out, because a call costs as much as they do.
                if known and kind == G2:
                    value = distance[a, b]
                elif kind == G4:
                    value = points[a, 2] - points[b, 2]
                elif kind == G19:
                    c = path[solvers.slots[f, 2]]
                    value = (points[b, 0] - points[a, 0]) * (points[c, 1] - points[a, 1])
                    value -= (points[b, 1] - points[a, 1]) * (points[c, 0] - points[a, 0])
                else:
                    value = feature_value(kind, points, a, b, path[solvers.slots[f, 2]], path[solvers.slots[f, 3]])
                if value < solvers.low[f] or value > solvers.high[f]:
                    accepted = False
                    break
        # Counted, not timed: every machine gives up at the same place.
        if evaluations > budget:
            counters[0] = evaluations
            return -1
        if not accepted:
            # `path[depth]` still names the last rejected row, which is not in use: clear the level and step back.
            tried[depth] = 0
            depth -= 1
            continue
        used[path[depth]] = True
        if depth == depths - 1:
            if solutions == 0:
                counters[1] = evaluations
            # Some of the labellings would conclude what all of them might not.
            if solutions == len(found):
                counters[0] = evaluations
                return -1
            for k in range(depths):
                found[solutions, k] = path[k]
            solutions += 1
        else:
            depth += 1
    counters[0] = evaluations
    return solutions
