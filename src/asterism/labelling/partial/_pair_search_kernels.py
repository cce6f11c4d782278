"""Kernels of the tree search for an ensemble: rules for pairs of markers, that all solvers share, are looked up as bits of points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.labelling.features.feature_kernels import LAST_INLINED, feature_or_cosine, later_feature, point_distances
from asterism.labelling.features.motion_kernels import motion_feature
from asterism.labelling.partial._bit_kernels import popcount, set_first_bits
from asterism.labelling.partial._full_solver_kernels import sort_highest_first


class PairRules(NamedTuple):
    """Intervals that two markers' points must keep, the same for all solvers of an ensemble: `search_by_pairs` checks them first.

    near, far     (M, M) m, distance; -inf and inf where nothing is known
    below, above  (M, M) m, height of the first marker over the second
    kinds         (K,) features of two points' motion that the solvers use, none for a solver of single frames
    low, high     (K, M, M) their intervals; an unknown value (NaN) keeps them
    """

    near: np.ndarray
    far: np.ndarray
    below: np.ndarray
    above: np.ndarray
    kinds: np.ndarray
    low: np.ndarray
    high: np.ndarray


class PairSearchWorkspace(NamedTuple):
    """Memory of `search_by_pairs` for frames of up to n points and solvers of up to D markers, W = ceil(n / 64).

    points    (n, 3) m, the frame's points, highest first, with their motion (n, WIDTH) where solvers need it; order (n,) their rows
    distance  (n, n) m; motion (K, n, n) the features of two points' motion
    rows      (M, M, n, W) bits: with marker a at point i, which points marker b may have; stamp (M, M, n) number of the frame for which
              they were computed
    mask      (D, W) points still to try at each depth; path (D,) point at each depth
    found     (32, D) labellings; agreed (D,) where they agree
    counters  (2,) feature evaluations so far, until the first labelling
    """

    points: np.ndarray
    order: np.ndarray
    distance: np.ndarray
    motion: np.ndarray
    rows: np.ndarray
    stamp: np.ndarray
    mask: np.ndarray
    path: np.ndarray
    found: np.ndarray
    agreed: np.ndarray
    counters: np.ndarray


@kernel
def make_search_workspace(markers, n, depths, width, motions):
    """Allocate the memory of `search_by_pairs`.

    IN  markers M; n points at most; depths D of the largest solver; width, numbers of a point (3 or WIDTH); motions K, features of two
        points' motion
    Returns SearchWorkspace. O(M^2 n^2 / 64) memory.
    """
    words = (n + 63) // 64
    return PairSearchWorkspace(
        np.empty((n, width)),
        np.empty(n, dtype=np.int64),
        np.empty((n, n)),
        np.empty((motions, n, n)),
        np.empty((markers, markers, n, words), dtype=np.uint64),
        np.full((markers, markers, n), -1, dtype=np.int64),
        np.empty((depths, words), dtype=np.uint64),
        np.empty(depths, dtype=np.int64),
        np.empty((32, depths), dtype=np.int64),
        np.empty(depths, dtype=np.int64),
        np.zeros(2, dtype=np.int64),
    )


@kernel
def load_frame(points, n, kinds, workspace):
    """Put a frame's points into the workspace, with their distances and features of motion.

    IN  points (>= n, width) m, the first n of them; kinds (K,) features of two points' motion
    OUT workspace.points, order (highest first), distance, motion
    O(n^2 K).
    """
    # Solvers begin at markers that are often the highest: their points are then tried first.
    sort_highest_first(points, n, workspace.order)
    for i in range(n):
        for axis in range(workspace.points.shape[1]):
            workspace.points[i, axis] = points[workspace.order[i], axis]
    point_distances(workspace.points, n, workspace.distance)
    # Motion of pairs, as distances, once for all solvers.
    for k in range(len(kinds)):
        for i in range(n):
            for j in range(n):
                workspace.motion[k, i, j] = motion_feature(kinds[k], workspace.points, i, j, 0)


@kernel
def search_by_pairs(solvers, pairs, s, n, frame_id, budget, workspace):
    """`search` for an ensemble: the points that pairs of markers allow are bits, computed when first needed and shared by all solvers.

    IN  solvers SolverArrays without the classifiers in `pairs`, angles as cosines, kinds after LAST_INLINED last at their depth
        (`solver.factor_pair_rules`)
        s which of them; n points in the workspace; frame_id, a number that this workspace has had for no other frame
        budget, feature evaluations for this solver on this frame; distance and height of a pair of points count as one
    OUT workspace.found (rows of workspace.points) by depth; workspace.counters, both from 0
    Returns the number of labellings found, or -1 where the budget or the memory for labellings did not suffice.
    O(n ** depth) at worst. Twin: `labellings` in tests/twins.py

    Bounds: where `found` is full, the search returns -1 and the solver proposes nothing, so nothing is concluded from a part of its
    labellings. A depth has a row of `mask` and `path`.
    """
    first = solvers.first_depth[s]
    depths = solvers.first_depth[s + 1] - first
    workspace.counters[0] = 0
    # Each marker needs a point of its own.
    if n < depths:
        return 0
    words = (n + 63) // 64
    points, path, mask = workspace.points, workspace.path, workspace.mask
    # The first marker may have any point.
    set_first_bits(mask, 0, n)
    depth, solutions, evaluations = 0, 0, 0
    while depth >= 0:
        row = -1
        for w in range(words):
            if mask[depth, w] != 0:
                # The lowest bit that is set is the next point to try.
                lowest = mask[depth, w] & (~mask[depth, w] + np.uint64(1))
                mask[depth, w] ^= lowest
                row = 64 * w + popcount(lowest - np.uint64(1))
                break
        # All points of this depth were tried: back to the one before.
        if row < 0:
            depth -= 1
            continue
        path[depth] = row
        accepted = True
        later = end = solvers.first_feature[first + depth + 1]
        # Kinds that the kernel has not inlined come last and are evaluated by a call.
        for f in range(solvers.first_feature[first + depth], end):
            if solvers.kinds[f] > LAST_INLINED:
                later = f
                break
            evaluations += 1
            value = feature_or_cosine(
                solvers.kinds[f],
                points,
                path[solvers.slots[f, 0]],
                path[solvers.slots[f, 1]],
                path[solvers.slots[f, 2]],
                path[solvers.slots[f, 3]],
            )
            if value < solvers.low[f] or value > solvers.high[f]:
                accepted = False
                break
        if accepted and later < end:
            accepted, made = later_accepted(solvers, later, end, points, path)
            evaluations += made
        # Silence by budget is the same on every machine, unlike a limit in seconds.
        if evaluations > budget:
            workspace.counters[0] = evaluations
            return -1
        if not accepted:
            continue
        if depth == depths - 1:
            if solutions == 0:
                workspace.counters[1] = evaluations
            # More labellings than there is memory for are as good as none.
            if solutions == len(workspace.found):
                workspace.counters[0] = evaluations
                return -1
            for k in range(depths):
                workspace.found[solutions, k] = path[k]
            solutions += 1
            continue
        depth += 1
        b = solvers.markers[first + depth]
        set_first_bits(mask, depth, n)
        # Every marker placed so far narrows the points of the next one.
        for e in range(depth):
            a, i = solvers.markers[first + e], path[e]
            # The stamp tells whether another solver has worked this out for the frame already.
            if workspace.stamp[a, b, i] != frame_id:
                workspace.stamp[a, b, i] = frame_id
                evaluations += find_allowed_points(pairs, a, b, i, n, workspace)
                if len(pairs.kinds) > 0:
                    evaluations += exclude_by_motion(pairs, a, b, i, n, workspace)
            living = np.uint64(0)
            for w in range(words):
                mask[depth, w] &= workspace.rows[a, b, i, w]
                living |= mask[depth, w]
            # No point is left: the branch dies before a feature is computed.
            if living == 0:
                break
    workspace.counters[0] = evaluations
    return solutions


@kernel
def later_accepted(solvers, begin, end, points, path):
    """Whether the classifiers begin to end, all of kinds after LAST_INLINED, accept the points of a path.

    IN  solvers SolverArrays; begin, end of its classifiers; points (n, 3), or (n, WIDTH) for motion; path (D,) rows by depth
    Returns (accepted, evaluations made). O(end - begin).
    """
    for f in range(begin, end):
        slots = solvers.slots[f]
        value = later_feature(solvers.kinds[f], points, path[slots[0]], path[slots[1]], path[slots[2]])
        if value < solvers.low[f] or value > solvers.high[f]:
            return False, f + 1 - begin
    return True, end - begin


@kernel
def find_allowed_points(pairs, a, b, i, n, workspace):
    """The points that marker b may have while marker a has point i, by distance and height.

    IN  pairs PairRules; n points in the workspace
    OUT workspace.rows[a, b, i]
    Returns the evaluations made. O(n).
    """
    near, far, below, above = pairs.near[a, b], pairs.far[a, b], pairs.below[a, b], pairs.above[a, b]
    height = workspace.points[i, 2]
    for w in range((n + 63) // 64):
        bits = np.uint64(0)
        for j in range(64 * w, min(n, 64 * w + 64)):
            # Distance and height are looked up, not computed: all solvers share them.
            d, h = workspace.distance[i, j], height - workspace.points[j, 2]
            # Without a branch, so that the loop runs in vector registers; a point is never two markers.
            fits = (d >= near) & (d <= far) & (h >= below) & (h <= above) & (i != j)
            bits |= np.uint64(fits) << np.uint64(j - 64 * w)
        workspace.rows[a, b, i, w] = bits
    return n


@kernel
def exclude_by_motion(pairs, a, b, i, n, workspace):
    """Remove from the allowed points those whose motion does not go with that of point i.

    IN  pairs PairRules; n points in the workspace
    OUT workspace.rows[a, b, i]
    Returns the evaluations made. O(n K). Apart from `find_allowed_points`, whose loop would be slower with it.
    """
    evaluations = 0
    for k in range(len(pairs.kinds)):
        low, high = pairs.low[k, a, b], pairs.high[k, a, b]
        for j in range(n):
            # Only points that distance and height allow are asked for their motion.
            bit = np.uint64(1) << np.uint64(j & 63)
            if workspace.rows[a, b, i, j >> 6] & bit != 0:
                evaluations += 1
                value = workspace.motion[k, i, j]
                if value < low or value > high:
                    workspace.rows[a, b, i, j >> 6] ^= bit
    return evaluations
