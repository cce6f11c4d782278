"""Kernel that evaluates a partial solver: its proposals on frames with hidden markers, counted against the truth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.labelling.partial._full_solver_kernels import agreed_points
from asterism.labelling.partial._pair_search_kernels import load_frame, search_by_pairs


class ValidationFrames(NamedTuple):
    """Labelled frames on which a solver is evaluated, E times.

    frames            (N, M, 3) m, z up, NaN where missing, or with their motion (N, M, WIDTH)
    chosen            (E,) frame of each evaluation
    hidden            (E, M) bool, markers hidden
    motion_unknown    (E, M) bool, markers whose motion is not known
    """

    frames: np.ndarray
    chosen: np.ndarray
    hidden: np.ndarray
    motion_unknown: np.ndarray


class EvaluationLimits(NamedTuple):
    """What ends an evaluation early.

    budget        feature evaluations per frame, after which the solver proposes nothing
    max_failures  wrong proposals of a marker, beyond which its hit rate cannot reach the target
    """

    budget: int
    max_failures: int


class ProposalCounts(NamedTuple):
    """Proposals by marker, (M,) int each: right ones, wrong ones, and frames with all the solver's markers in sight without a proposal."""

    hits: np.ndarray
    failures: np.ndarray
    abstentions: np.ndarray


@kernel
def _in_sight(validation, e, m):
    """Returns whether evaluation e shows marker m: it was seen in the frame, and is not hidden. O(1)."""
    return not validation.hidden[e, m] and not np.isnan(validation.frames[validation.chosen[e], m, 0])


@kernel
def _load_evaluation(validation, e, kinds, points, marker_of, workspace):
    """Load the markers that evaluation e shows into the workspace, as points without labels.

    IN  validation ValidationFrames; kinds, the pair features that the search needs
    OUT points (M, 3 or WIDTH); marker_of (M,) the marker of each point; workspace SearchWorkspace
    Returns the number of points. O(M^2 kinds)

    Bounds: a point for each marker in sight: M.
    """
    frame = validation.frames[validation.chosen[e]]
    n = 0
    for m in range(len(frame)):
        if _in_sight(validation, e, m):
            points[n] = frame[m]
            # A hidden marker takes the motion of its neighbours' tracks with it.
            if validation.motion_unknown[e, m]:
                points[n, 3:] = np.nan
            marker_of[n] = m
            n += 1
    load_frame(points, n, kinds, workspace)
    return n


@kernel
def evaluate_solver(solvers, pairs, s, validation, limits, workspace, first_id, counts):
    """Evaluate one solver on frames some of whose markers are hidden, and count its proposals against the truth (section 4.5.1, hit rates).

    A solver proposes a point for a marker where all labellings that it found agree on it. A proposal of the marker's point is a hit. A
    proposal of any other point is a failure. No proposal is an abstention.

    IN  solvers, pairs, s as in `search_by_pairs`; validation ValidationFrames; limits EvaluationLimits; workspace SearchWorkspace
        first_id, as many numbers from here on as there are evaluations are new to the workspace (`frame_id` of `search_by_pairs`)
    OUT counts ProposalCounts, set for all markers; abstentions only of frames in which all markers of the solver are in sight
    Returns the number of evaluations made. It stops where every marker of the solver has more than `max_failures` failures, or more than
    50 abstentions that are more than four times its hits.
    O(E times a search). Twin: `evaluate_solver` in tests/twins_partial.py
    """
    markers, width = validation.frames.shape[1:]
    first = solvers.first_depth[s]
    depths = solvers.first_depth[s + 1] - first
    points, marker_of = np.empty((markers, width)), np.empty(markers, dtype=np.int64)
    counts.hits[:] = 0
    counts.failures[:] = 0
    counts.abstentions[:] = 0
    for e in range(len(validation.chosen)):
        n = _load_evaluation(validation, e, pairs.kinds, points, marker_of, workspace)
        # A solver that lacks a marker may keep silent: that is no abstention.
        all_in_sight = True
        for k in range(depths):
            all_in_sight = all_in_sight and _in_sight(validation, e, solvers.markers[first + k])
        solutions = search_by_pairs(solvers, pairs, s, n, first_id + e, limits.budget, workspace)
        agreed_points(workspace.found, solutions, depths, workspace.agreed)
        out_of_reach = True
        for k in range(depths):
            m = solvers.markers[first + k]
            if workspace.agreed[k] < 0:
                counts.abstentions[m] += all_in_sight
            elif marker_of[workspace.order[workspace.agreed[k]]] == m:
                counts.hits[m] += 1
            else:
                # A solver that answers so seldom is useless, however right it is.
                counts.failures[m] += 1
            abstains = counts.abstentions[m] > 50 and counts.abstentions[m] > 4 * counts.hits[m]
            out_of_reach = out_of_reach and (counts.failures[m] > limits.max_failures or abstains)
        # No marker of it can reach the target any more.
        if out_of_reach:
            return e + 1
    return len(validation.chosen)


@kernel
def handed_in_points(solvers, pairs, validation, budget, workspace, first_id, out):
    """The points that solvers hand in on frames some of whose markers are hidden: those of all their labellings (section 4.5.4).

    A frame is loaded once for all solvers, and what its pairs of points allow is worked out once.

    IN  as `evaluate_solver`, for all solvers in the arrays; at most 64 markers
    OUT out (E, D) uint64, bit m where the point of marker m is handed in for the marker of this depth, the depths of all solvers in a row
    O(E times a search of each solver). Twin: `handed_in_points` in tests/twins_partial.py
    """
    markers, width = validation.frames.shape[1:]
    points, marker_of = np.empty((markers, width)), np.empty(markers, dtype=np.int64)
    out[:] = 0
    for e in range(len(validation.chosen)):
        n = _load_evaluation(validation, e, pairs.kinds, points, marker_of, workspace)
        for s in range(len(solvers.first_depth) - 1):
            first = solvers.first_depth[s]
            solutions = search_by_pairs(solvers, pairs, s, n, first_id + e, budget, workspace)
            for i in range(solutions):
                for k in range(solvers.first_depth[s + 1] - first):
                    # Points are named by their marker: the truth of a hand-in is a bit.
                    out[e, first + k] |= np.uint64(1) << np.uint64(marker_of[workspace.order[workspace.found[i, k]]])
