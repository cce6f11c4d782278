"""Kernels of the labelling matrix: the proposals of all solvers in, labels by safe rules out; and the strong classifier of all markers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.labelling.features.feature_kernels import LAST_INLINED, feature_or_cosine, later_feature
from asterism.labelling.partial._full_solver_kernels import agreed_points
from asterism.labelling.partial._pair_search_kernels import load_frame, make_search_workspace, search_by_pairs


class StrongClassifierArrays(NamedTuple):
    """The strong classifier of all markers, in an order that allows to check one marker at a time.

    first         (M + 1,) marker m has classifiers first[m]:first[m + 1], which read it; those that reject most come first. (1,) for none
    kinds, slots  (C,), (C, 4) markers, the first `points` of them in use
    points        (C,) number of points that a classifier reads
    low, high     (C,) as in `search_by_pairs`, angles as cosines
    """

    first: np.ndarray
    kinds: np.ndarray
    slots: np.ndarray
    points: np.ndarray
    low: np.ndarray
    high: np.ndarray


class MatrixRules(NamedTuple):
    """How proposals become labels.

    outvote    a proposal stands against others where it has more than this many times their votes
    slack      share of an interval by which a value may miss it and still count as a near miss
    min_tests  classifiers that must have had known values before a marker is accepted
    rounds     completions at most; labels given in one round count in the next
    budget     feature evaluations per frame and solver, after which a solver proposes nothing
    hand_in_all  whether a solver that finds several labellings proposes the points of all of them, else those on which they agree
    """

    outvote: int
    slack: float
    min_tests: int
    rounds: int
    budget: int
    hand_in_all: bool


class VoteArrays(NamedTuple):
    """What `label_by_matrix` gives.

    indices      (T, M) point of each marker, -1 for none
    votes        (T, M) of the solvers trusted with the marker the share that propose this point; for -1, the most proposed point
    evaluations  (T,) feature evaluations
    """

    indices: np.ndarray
    votes: np.ndarray
    evaluations: np.ndarray


@kernel
def check_marker(strong, m, place, points, slack, min_tests):
    """How well marker m at its point goes with all the markers that have a point.

    IN  strong StrongClassifierArrays; place (M,) row of `points` of each marker, -1 for none; points (n, 3) m, z up, or (n, WIDTH)
        slack, min_tests as in `MatrixRules`
    Returns (level, evaluations made). Level 2: all classifiers whose points are placed accept, and `min_tests` of them have a known value;
    1: none is missed by more than the slack; 0: one is. A value that is not known (NaN) accepts, and counts for nothing.
    O(classifiers that read m). Twin: `check_marker` in tests/twins_partial.py
    """
    evaluations, known, level = 0, 0, 2
    for f in range(strong.first[m], strong.first[m + 1]):
        a, b, c, d = place[strong.slots[f, 0]], place[strong.slots[f, 1]], place[strong.slots[f, 2]], place[strong.slots[f, 3]]
        used = strong.points[f]
        # A classifier whose points are not all placed says nothing (section 4.4.2).
        if a < 0 or b < 0 or (used > 2 and c < 0) or (used > 3 and d < 0):
            continue
        evaluations += 1
        kind = strong.kinds[f]
        value = feature_or_cosine(kind, points, a, b, c, d) if kind <= LAST_INLINED else later_feature(kind, points, a, b, c)
        # NaN is unequal to itself: an unknown value is no test that was passed.
        known += value == value
        low, high = strong.low[f], strong.high[f]
        if value < low or value > high:
            level = 1
            # A near miss still forbids other markers to take the point.
            room = slack * (high - low)
            if value < low - room or value > high + room:
                return 0, evaluations
    return level if known >= min_tests else min(level, 1), evaluations


@kernel
def complete_labels(strong, points, n, place, taken, levels, rules):
    """Give free points to markers without one, where the strong classifier of all markers leaves no choice.

    A marker gets a point that is accepted with the markers that have theirs, if no other free point is nearly accepted for it, and if the
    point is nearly accepted for no other marker that lacks one: the safe rules of the labelling matrix, stricter.

    IN  strong, points as in `check_marker`; n points; rules MatrixRules; levels (M, >= n) int is memory
    OUT place (M,), taken (n,) bool: completed
    Returns the evaluations made. O(rounds M n times `check_marker`). Twin: `complete_labels` in tests/twins_partial.py
    """
    markers, evaluations = len(place), 0
    for _ in range(rules.rounds):
        for m in range(markers):
            for c in range(n):
                # Tried as if it were placed, and taken back: the check reads all placed markers.
                levels[m, c] = 0
                if place[m] < 0 and not taken[c]:
                    place[m] = c
                    levels[m, c], made = check_marker(strong, m, place, points, rules.slack, rules.min_tests)
                    evaluations += made
                    place[m] = -1
        changed = False
        for m in range(markers):
            if place[m] >= 0:
                continue
            near, only = 0, -1
            for c in range(n):
                near += levels[m, c] > 0
                if levels[m, c] == 2:
                    only = c
            # Two possible points, or one that only nearly fits, leave a choice.
            if near != 1 or only < 0:
                continue
            rivals = 0
            for other in range(markers):
                rivals += levels[other, only] > 0
            # The point must be possible for no other marker that lacks one.
            if rivals == 1:
                place[m], taken[only], changed = only, True, True
        # A label given in one round may make another clear in the next.
        if not changed:
            break
    return evaluations


@kernel
def label_by_matrix(solvers, pairs, trusted, strong, rules, xyz, offsets, out):
    """Label frames with an ensemble of partial solvers through the labelling matrix and its safe rules (section 4.5.4).

    A solver proposes points for the markers that it is trusted with: all of its labellings (the printed rule, `MatrixRules.hand_in_all`),
    or the points on which these agree. A column with proposals of two points, and a row with proposals of two markers, give null.

    IN  solvers, pairs as in `search_by_pairs`; trusted (D,) bool whether the solver may propose the marker of this depth
        strong StrongClassifierArrays: a label then takes two solvers that propose it (where there are two), or more than `outvote` times as
        many as propose otherwise, and `complete_labels` decides last, by rules MatrixRules; without markers: the thesis' rules alone
        xyz (P, 3) m, or (P, WIDTH) with their motion; offsets (T + 1,)
    OUT out VoteArrays
    O(T times solvers times a search), no allocation per frame. Twins: `matrix` in tests/twins.py, `label_by_matrix` in
    tests/twins_partial.py
    """
    indices, votes, evaluations = out
    frames, markers = indices.shape
    count = len(solvers.first_depth) - 1
    most, deepest = 1, 1
    for t in range(frames):
        most = max(most, offsets[t + 1] - offsets[t])
    able = np.zeros(markers, dtype=np.int64)
    for s in range(count):
        deepest = max(deepest, solvers.first_depth[s + 1] - solvers.first_depth[s])
        for k in range(solvers.first_depth[s], solvers.first_depth[s + 1]):
            # Votes are shares of the solvers that may vote on a marker.
            able[solvers.markers[k]] += trusted[k]
    workspace = make_search_workspace(markers, most, deepest, xyz.shape[1], len(pairs.kinds))
    matrix, handed_in = np.empty((markers, most), dtype=np.int64), np.empty(most, dtype=np.bool_)
    single = np.empty(markers, dtype=np.int64)
    place, taken, levels = np.empty(markers, dtype=np.int64), np.empty(most, dtype=np.bool_), np.empty((markers, most), dtype=np.int64)
    completing = len(strong.first) > 1
    for t in range(frames):
        n = offsets[t + 1] - offsets[t]
        # Distances and motion once per frame, for all solvers.
        load_frame(xyz[offsets[t] : offsets[t + 1]], n, pairs.kinds, workspace)
        matrix[:, :n] = 0
        evaluations[t] = 0
        for s in range(count):
            solutions = search_by_pairs(solvers, pairs, s, n, t, rules.budget, workspace)
            evaluations[t] += workspace.counters[0]
            add_proposals(solvers, s, trusted, solutions, (n, rules.hand_in_all), workspace, handed_in, matrix)
        place[:] = -1
        taken[:n] = False
        _choose_by_votes(matrix, n, able, (completing, rules.outvote), place, taken, single, votes[t])
        # The strong classifier decides last, over labels that the votes have given.
        if completing:
            evaluations[t] += complete_labels(strong, workspace.points, n, place, taken, levels, rules)
            evaluations[t] += _accept_single(strong, workspace.points, rules, single, place, taken)
        for m in range(markers):
            indices[t, m] = workspace.order[place[m]] if place[m] >= 0 else -1


@kernel
def add_proposals(solvers, s, trusted, solutions, how, workspace, handed_in, matrix):
    """Add one solver's proposals to the labelling matrix: each point once per marker, however many labellings give it.

    IN  solvers, s, trusted as in `label_by_matrix`; solutions rows of workspace.found; how: number of points, `MatrixRules.hand_in_all`
        handed_in (>= n,) bool is memory
    OUT matrix (M, >= n) int: added to
    O(depths (n + solutions)). Twin: `proposals` in tests/twins_partial.py
    """
    n, hand_in_all = how
    first = solvers.first_depth[s]
    depths = solvers.first_depth[s + 1] - first
    agreed_points(workspace.found, solutions, depths, workspace.agreed)
    for k in range(depths):
        # A solver proposes only markers with which it was weighed in the choice.
        if not trusted[first + k]:
            continue
        m = solvers.markers[first + k]
        if not hand_in_all:
            if workspace.agreed[k] >= 0:
                matrix[m, workspace.agreed[k]] += 1
            continue
        handed_in[:n] = False
        for i in range(solutions):
            c = workspace.found[i, k]
            # However many labellings give a point, it is one vote.
            matrix[m, c] += not handed_in[c]
            handed_in[c] = True


@kernel
def _choose_by_votes(matrix, n, able, how, place, taken, single, votes):
    """Labels by the safe rules; how: whether labels will be completed, and `MatrixRules.outvote`.

    OUT place (M,), taken (n,); single (M,) a candidate that one solver alone proposed, -1 for none; votes (M,)
    """
    completing, outvote = how
    for m in range(len(place)):
        votes[m], single[m] = 0.0, -1
        best, rivals = -1, 0
        for c in range(n):
            rivals += matrix[m, c]
            if matrix[m, c] > 0 and (best < 0 or matrix[m, c] > matrix[m, best]):
                best = c
        if best < 0:
            continue
        most_votes = matrix[m, best]
        votes[m] = most_votes / able[m]
        for other in range(len(place)):
            rivals += matrix[other, best]
        # The winner's own votes were counted in its column and in its row.
        rivals -= 2 * most_votes
        # A single solver may be wrong alone: the strong classifier decides on it last.
        if rivals == 0 and most_votes == 1 and able[m] > 1 and completing:
            single[m] = best
        elif rivals == 0 or (completing and most_votes > outvote * rivals):
            place[m], taken[best] = best, True


@kernel
def _accept_single(strong, points, rules, single, place, taken):
    """Give markers without a point the one that a single solver proposed, where the strong classifier accepts. Returns the evaluations."""
    evaluations = 0
    for m in range(len(place)):
        # What was completed in the meantime stays.
        if place[m] < 0 and single[m] >= 0 and not taken[single[m]]:
            place[m] = single[m]
            level, made = check_marker(strong, m, place, points, rules.slack, rules.min_tests)
            evaluations += made
            taken[single[m]] = level == 2
            # A point that the others reject is given back.
            if level < 2:
                place[m] = -1
    return evaluations


@kernel
def count_confusions(strong, frames, chosen, known, taken_for, shown):
    """Count the frames in which a marker's point could be taken for another marker, when only some labels are known, and these are right.

    It could if no classifier rejects the move (the other marker gets the point, the first one none) or the swap of the two.

    IN  strong StrongClassifierArrays; frames (N, M, 3) m, NaN where missing; chosen (K,) frames; known (K, M) bool, labels known in each
    OUT taken_for (M, M) int, row the marker whose point it is, column the marker that it is taken for; shown (M,) frames with the marker;
        both added to
    O(K M^2), most pairs end at the first classifier. Twin: `count_confusions` in tests/twins_partial.py
    """
    markers = frames.shape[1]
    place = np.empty(markers, dtype=np.int64)
    for k in range(len(chosen)):
        points = frames[chosen[k]]
        for a in range(markers):
            if np.isnan(points[a, 0]):
                continue
            shown[a] += 1
            taken_for[a, a] += 1
            for b in range(markers):
                if a == b:
                    continue
                for m in range(markers):
                    place[m] = m if known[k, m] and not np.isnan(points[m, 0]) else -1
                # First the move: b takes a's point, and a has none.
                place[a], place[b] = -1, a
                possible = check_marker(strong, b, place, points, 0.0, 1)[0] == 2
                # Then the swap, which is only possible where b has a point, too.
                if not possible and not np.isnan(points[b, 0]):
                    place[a] = b
                    possible = (
                        check_marker(strong, b, place, points, 0.0, 1)[0] == 2 and check_marker(strong, a, place, points, 0.0, 1)[0] == 2
                    )
                taken_for[a, b] += possible
