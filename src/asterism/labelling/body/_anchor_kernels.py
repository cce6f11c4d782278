"""Anchors: the points of three markers in; scores of every point as every other marker out.

The plain twins are in `tests/twins_body.py`.
"""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.geometry.shared_kernels import fit_about_z
from asterism.labelling.body._workspace_kernels import LOG_2PI, copy_labels


@kernel
def search_anchor(model, a, points, workspace, counters):
    """The likeliest triples of points that an anchor's three markers may be, of all that its partial solver allows.

    Those are what `features.search_kernels.search` finds with `anchors.CHECKS`, written out. Models of virtual people know bodies of any
    size: thousands of triples pass an anchor's intervals, and most of them are left at the first coordinates that do not fit.

    IN   model FrameModel; a which anchor; points (n, 3) m, z up; workspace AnchorSearchWorkspace, whose `distance` is theirs
    OUT  workspace.likely, likeliest first, of equals the one found first; counters (1 or more,), the first: evaluations made (added to)
    Returns the number of triples kept, or -1 where `settings.max_evaluations` did not suffice: then nothing may be concluded.
    O(n^2), O(n) for each pair of points that the first two markers may be, and O(K) to O(81 K) for each triple.

    Bounds: where `likely` is full, its last one makes way for a likelier one.
    """
    solvers, likely, distance, budget = model.solvers, workspace.likely, workspace.distance, model.settings.max_evaluations
    n, first, most = len(points), solvers.first_feature[solvers.first_depth[a]], len(likely.density)
    low, high = solvers.low[first : first + 6], solvers.high[first : first + 6]
    # Taken out of the tuples once: to count the references of all their arrays for each triple would take longer than all else.
    mean, factor, peak = model.anchors.mean, model.anchors.precision_factor, model.anchors.log_peak
    displacement = workspace.body.displacement
    kept, evaluations, triple = 0, counters[0], np.empty(3, dtype=np.int64)
    # A triple whose best key pose is farther off than `max_anchor_distance2` lies as no one's markers do: less likely ones all are.
    most_distance2 = model.settings.max_anchor_distance2
    least = np.min(peak[:, a]) - 0.5 * most_distance2
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
                if evaluations > budget:
                    counters[0] = evaluations
                    return -1
                one, two = (points[i, 0], points[i, 1], points[i, 2]), (points[j, 0], points[j, 1], points[j, 2])
                three = (points[k, 0], points[k, 1], points[k, 2])
                pose, density, apart2 = anchor_key_pose(mean, factor, peak, a, one, two, three, least, displacement)
                if density >= least and apart2 <= most_distance2:
                    triple[0], triple[1], triple[2] = i, j, k
                    kept = _keep_likely(likely, kept, triple, pose, density)
                    # From now on a triple must be likelier than the last one.
                    if kept == most:
                        least = likely.density[kept - 1]
            if evaluations > budget:
                counters[0] = evaluations
                return -1
        if evaluations > budget:
            counters[0] = evaluations
            return -1
    counters[0] = evaluations
    return kept


@kernel
def _keep_likely(likely, kept, triple, pose, density):
    """Put a triple into its place among the first `kept` of `likely`, behind its equals. Returns how many are kept now. O(kept)."""
    place = kept
    while place > 0 and likely.density[place - 1] < density:
        place -= 1
    # Only as likely as the last one that there is room for.
    if place == len(likely.density):
        return kept
    for p in range(min(kept, len(likely.density) - 1), place, -1):
        likely.density[p], likely.pose[p] = likely.density[p - 1], likely.pose[p - 1]
        copy_labels(likely.points[p - 1], likely.points[p])
    likely.density[place], likely.pose[place] = density, pose
    copy_labels(triple, likely.points[place])
    return min(kept + 1, len(likely.density))


@kernel(inline=True)
def anchor_key_pose(mean, factor, peak, a, one, two, three, least, displacement):
    """The key pose that fits an anchor's own points best: (k, log density in nats, squared Mahalanobis distance).

    Where no key pose has a density of `least` nats or more, -inf and inf.

    IN   mean, factor, peak: see AnchorArrays; a anchor; one, two, three (3,) m, the points of the anchor's markers; least nats
    OUT  displacement (9,) is overwritten
    O(K) where the heights alone are unlikely, O(81 K) at most.
    """
    best, best_log, best_distance = 0, -np.inf, np.inf
    third = 1.0 / 3.0
    x, y, z = third * (one[0] + two[0] + three[0]), third * (one[1] + two[1] + three[1]), third * (one[2] + two[2] + three[2])
    x0, y0, z0, x1, y1, z1 = one[0] - x, one[1] - y, one[2] - z, two[0] - x, two[1] - y, two[2] - z
    x2, y2, z2 = three[0] - x, three[1] - y, three[2] - z
    for k in range(len(peak)):
        # With the distance at which it would be no better than the best so far, or than what is asked for: a sum of squares only grows.
        most = 2.0 * (peak[k, a] - max(best_log, least))
        # The heights first: the turn about the vertical, which takes a root, leaves them as they are.
        w0, w1, w2 = z0 - mean[k, a, 6], z1 - mean[k, a, 7], z2 - mean[k, a, 8]
        last = factor[k, a, 8, 8] * w2
        middle = factor[k, a, 7, 7] * w1 + factor[k, a, 7, 8] * w2
        first = factor[k, a, 6, 6] * w0 + factor[k, a, 6, 7] * w1 + factor[k, a, 6, 8] * w2
        distance = last * last + middle * middle + first * first
        if distance > most:
            continue
        u0, v0, u1, v1, u2, v2 = mean[k, a, 0], mean[k, a, 3], mean[k, a, 1], mean[k, a, 4], mean[k, a, 2], mean[k, a, 5]
        along = x0 * u0 + y0 * v0 + x1 * u1 + y1 * v1 + x2 * u2 + y2 * v2
        across = x0 * v0 - y0 * u0 + x1 * v1 - y1 * u1 + x2 * v2 - y2 * u2
        size = math.sqrt(along * along + across * across)
        cos, sin = (along / size, across / size) if size > 0.0 else (1.0, 0.0)
        displacement[0], displacement[3] = cos * x0 - sin * y0 - u0, sin * x0 + cos * y0 - v0
        displacement[1], displacement[4] = cos * x1 - sin * y1 - u1, sin * x1 + cos * y1 - v1
        displacement[2], displacement[5] = cos * x2 - sin * y2 - u2, sin * x2 + cos * y2 - v2
        displacement[6], displacement[7], displacement[8] = w0, w1, w2
        for row in range(6):
            i, total = 5 - row, 0.0
            for j in range(i, 9):
                total += factor[k, a, i, j] * displacement[j]
            distance += total * total
            if distance > most:
                break
        log_density = peak[k, a] - 0.5 * distance
        if distance <= most and log_density > best_log:
            best, best_log, best_distance = k, log_density, distance
    return best, best_log, best_distance


@kernel
def _place(points, anchor_points, mean, markers, out):
    """Lay an anchor's points onto its markers in a mean body: (cos, sin, from, onto), as `fit_about_z` has them.

    IN  points (n, 3) m; anchor_points (3,) points of the anchor's markers; mean (M, 3) m; markers (3,)
    OUT out (9,) m, how far the placed points lie from the markers: x of the three, then y, then z. O(1).
    """
    cos, sin, here, there = fit_about_z(points, anchor_points, mean, markers)
    for i in range(3):
        m, row = markers[i], anchor_points[i]
        x, y = points[row, 0] - here[0], points[row, 1] - here[1]
        out[i] = cos * x - sin * y + there[0] - mean[m, 0]
        out[3 + i] = sin * x + cos * y + there[1] - mean[m, 1]
        out[6 + i] = points[row, 2] - here[2] + there[2] - mean[m, 2]
    return cos, sin, here, there


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
