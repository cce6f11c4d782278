"""Anchors: the points of three markers in; scores of every point as every other marker out.

The plain twins are in `tests/twins_body.py`.
"""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel
from asterism.geometry.shared_kernels import fit_about_z
from asterism.labelling.body._workspace_kernels import LOG_2PI


@kernel
def search_anchor(solvers, a, points, distance, budget, found, counters):
    """The points that an anchor's three markers may be: what `features.search_kernels.search` finds with `anchors.CHECKS`, written out.

    IN   solvers SolverArrays of `Anchors.solvers`; a which anchor; points (n, 3) m, z up; distance (n, n) m between them
         budget, feature evaluations after which the search gives up
    OUT  found (S, 3) points of the markers, in ascending order; counters (1 or more,), the first: evaluations made (added to)
    Returns the number of triples found, or -1 where the budget or S did not suffice: then nothing may be concluded.
    O(n^2), and O(n) for each pair of points that the first two markers may be.

    Bounds: where `found` is full, it returns -1.
    """
    n, first = len(points), solvers.first_feature[solvers.first_depth[a]]
    low, high = solvers.low[first : first + 6], solvers.high[first : first + 6]
    solutions, evaluations = 0, counters[0]
    for i in range(n):
        for j in range(n):
            if j == i:
                continue
            # Height difference and distance of the first two ...
            evaluations += 1
            value = points[i, 2] - points[j, 2]
            if value < low[0] or value > high[0]:
                continue
            evaluations += 1
            value = distance[i, j]
            if value < low[1] or value > high[1]:
                continue
            # Counted, not timed: every machine gives up at the same place.
            if evaluations > budget:
                counters[0] = evaluations
                return -1
            # ... then of the third from both, and the signed triangle seen from above.
            for k in range(n):
                if k in (i, j):
                    continue
                evaluations += 1
                value = points[i, 2] - points[k, 2]
                if value < low[2] or value > high[2]:
                    continue
                evaluations += 1
                value = distance[i, k]
                if value < low[3] or value > high[3]:
                    continue
                evaluations += 1
                value = distance[j, k]
                if value < low[4] or value > high[4]:
                    continue
                evaluations += 1
                value = (points[j, 0] - points[i, 0]) * (points[k, 1] - points[i, 1])
                value -= (points[j, 1] - points[i, 1]) * (points[k, 0] - points[i, 0])
                if value < low[5] or value > high[5]:
                    continue
                # Some of the triples would conclude what all of them might not.
                if evaluations > budget or solutions == len(found):
                    counters[0] = evaluations
                    return -1
                found[solutions, 0], found[solutions, 1], found[solutions, 2] = i, j, k
                solutions += 1
            if evaluations > budget:
                counters[0] = evaluations
                return -1
        if evaluations > budget:
            counters[0] = evaluations
            return -1
    counters[0] = evaluations
    return solutions


@kernel
def _place(points, anchor_points, mean, markers, out):
    """Lay an anchor's points onto its markers in a mean body: (cos, sin, from, onto), as `fit_about_z` has them.

    IN  points (n, 3) m; anchor_points (3,) points of the anchor's markers; mean (M, 3) m; markers (3,)
    OUT out (9,) m, how far the placed points lie from the markers. O(1).
    """
    cos, sin, here, there = fit_about_z(points, anchor_points, mean, markers)
    for i in range(3):
        m, row = markers[i], anchor_points[i]
        x, y = points[row, 0] - here[0], points[row, 1] - here[1]
        out[3 * i] = cos * x - sin * y + there[0] - mean[m, 0]
        out[3 * i + 1] = sin * x + cos * y + there[1] - mean[m, 1]
        out[3 * i + 2] = points[row, 2] - here[2] + there[2] - mean[m, 2]
    return cos, sin, here, there


@kernel
def _squared_distance(factor, displacement, most):
    """|factor displacement|^2, or some number above `most` where it is above it. IN factor (9, 9), upper; displacement (9,). O(81)."""
    distance = 0.0
    for i in range(9):
        total = 0.0
        for j in range(i, 9):
            total += factor[i, j] * displacement[j]
        distance += total * total
        # It can only grow, and farther than the best key pose decides nothing.
        if distance > most:
            break
    return distance


@kernel(inline=True)
def anchor_key_pose(model, a, points, anchor_points, workspace):
    """The key pose that fits an anchor's own points best: (k, log density in nats, squared Mahalanobis distance).

    IN   model FrameModel; a anchor; points (n, 3) m; anchor_points (3,). OUT workspace.displacement is overwritten. O(81 K).
    """
    anchors, body = model.anchors, model.body
    markers, displacement = anchors.markers[a], workspace.displacement
    best, best_log, best_distance = 0, -np.inf, np.inf
    for k in range(len(body.log_weight)):
        _place(points, anchor_points, body.mean[k], markers, displacement)
        peak = anchors.log_peak[k, a]
        # With the distance at which it would be no better than the best so far.
        distance = _squared_distance(anchors.precision_factor[k, a], displacement, 2.0 * (peak - best_log))
        log_density = peak - 0.5 * distance
        if log_density > best_log:
            best, best_log, best_distance = k, log_density, distance
    return best, best_log, best_distance


@kernel
def score_from_anchor(model, a, k, points, anchor_points, workspace):
    """Score every point as every marker from an anchor alone.

    The anchor's own markers score 50 nats for their points, and -inf for all others.
    IN   model FrameModel; a anchor; k key pose; points (n, 3) m; anchor_points (3,) points of the anchor's markers
    OUT  workspace.scores (M, n) nats, -inf where the point is too far to score above 0; workspace.aligned; workspace.centre is
         overwritten. O(M n).
    """
    anchors, delta, aligned, scores, centre = model.anchors, workspace.displacement, workspace.aligned, workspace.scores, workspace.centre
    mean, gain = model.body.mean[k], anchors.gain[k, a]
    markers, n = len(mean), len(points)
    # Three points place the body about the vertical; the gain says how it then differs from the mean.
    cos, sin, here, there = _place(points, anchor_points, mean, anchors.markers[a], delta)
    for c in range(n):
        x, y = points[c, 0] - here[0], points[c, 1] - here[1]
        aligned[c, 0] = cos * x - sin * y + there[0]
        aligned[c, 1] = sin * x + cos * y + there[1]
        aligned[c, 2] = points[c, 2] - here[2] + there[2]
    centre[:] = 0.0
    for i in range(9):
        for c in range(3 * markers):
            centre[c] += gain[i, c] * delta[i]
    for m in range(markers):
        mx, my, mz = mean[m, 0] + centre[m], mean[m, 1] + centre[markers + m], mean[m, 2] + centre[2 * markers + m]
        w = anchors.whiten[k, a, m]
        base = anchors.log_scale[k, a, m] - 1.5 * LOG_2PI + model.settings.reward
        # no score above 0 beyond sqrt(2 base) standard deviations
        reach2 = 2.0 * max(base, 0.0) * anchors.max_variance[k, a, m]
        for c in range(n):
            dx, dy, dz = aligned[c, 0] - mx, aligned[c, 1] - my, aligned[c, 2] - mz
            # No quadratic form for points that are too far by any direction.
            if dx * dx + dy * dy + dz * dz > reach2:
                scores[m, c] = -np.inf
                continue
            x = w[0, 0] * dx
            y = w[1, 0] * dx + w[1, 1] * dy
            z = w[2, 0] * dx + w[2, 1] * dy + w[2, 2] * dz
            scores[m, c] = base - 0.5 * (x * x + y * y + z * z)
    for i in range(3):
        m = anchors.markers[a, i]
        for c in range(n):
            scores[m, c] = -np.inf
        # The anchor's own labels are given, so that nothing outweighs them.
        scores[m, anchor_points[i]] = 50.0
