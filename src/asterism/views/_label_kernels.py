"""A posed body and the blobs of one frame in; which blob is which marker, and how sure that is, out. Twins: tests/twins_views.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.geometry.shared_kernels import symmetric_inverse
from asterism.skeleton.pose_kernels import place_bones, place_points, point_jacobian, solve_damped
from asterism.views._fit_kernels import add_sight, project_linear

_NEVER = 1e6
"""nats: no gain comes near."""


@kernel
def assign_best(gain, chosen):
    """The one-to-one assignment of rows to columns with the greatest total gain; what would not gain stays without (shortest paths).

    IN  gain (M, K) nats
    OUT chosen (M,): the column of each row, -1 for none
    O(M K + C M (M + K)) for C rows whose best column another row has; allocates (M + K,).

    Bounds: a row is contested once: M. Each row has a column of its own that costs nothing (M more columns), so a way to a free column is
    always found.
    """
    rows, columns = gain.shape
    # A column of no blob for each row, so that a marker without a blob is an assignment like any other.
    wide = columns + rows
    u, v = np.zeros(rows + 1), np.zeros(wide + 1)
    owner, way = np.zeros(wide + 1, dtype=np.int64), np.zeros(wide + 1, dtype=np.int64)
    least, used = np.empty(wide + 1), np.empty(wide + 1, dtype=np.bool_)
    contested, count = np.empty(rows, dtype=np.int64), 0
    for i in range(1, rows + 1):  # each row has its best column, where no row before it has
        best = columns + i
        for j in range(columns):
            if -gain[i - 1, j] < u[i]:
                u[i], best = -gain[i - 1, j], j + 1
        # Most markers have a best blob of their own; only what is contested needs a search.
        if owner[best] == 0:
            owner[best] = i
        else:
            contested[count] = i
            count += 1
    for n in range(count):
        i = contested[n]
        owner[0] = i
        here = 0
        # Shortest path from the contested row to a free column, over rows that would have to change theirs.
        least[:] = np.inf
        used[:] = False
        while True:
            used[here] = True
            row, step, following = owner[here], np.inf, 0
            for j in range(1, wide + 1):
                if used[j]:
                    continue
                cost = -gain[row - 1, j - 1] if j <= columns else 0.0 if j - columns == row else _NEVER
                # Reduced by the prices so far, costs are never negative, as shortest paths need.
                cost -= u[row] + v[j]
                if cost < least[j]:
                    least[j] = cost
                    way[j] = here
                if least[j] < step:
                    step = least[j]
                    following = j
            if following == 0:  # gains without a number lead nowhere: the row stays without
                here = 0
                break
            for j in range(wide + 1):
                if used[j]:
                    # The new prices keep all costs at or above zero, and those on the path at zero.
                    u[owner[j]] += step
                    v[j] -= step
                else:
                    least[j] -= step
            here = following
            if owner[here] == 0:
                break
        # Along the path each row gives its column to the one before.
        while here != 0:
            before = way[here]
            owner[here] = owner[before]
            here = before
    chosen[:] = -1
    for j in range(1, columns + 1):
        if owner[j] > 0:
            chosen[owner[j] - 1] = j - 1


@kernel
def margins(gain, chosen, out):
    """How much more each given label gains than the best change of it: to no blob, to a free blob, or exchanged with another marker.

    IN  gain (M, K) nats, chosen (M,) an assignment
    OUT out (M,) nats, 0 where nothing was chosen; an upper bound of the true margin, which may need longer chains of changes
    O(M (M + K)).
    """
    rows, columns = gain.shape
    holder = np.full(columns, -1, dtype=np.int64)
    for m in range(rows):
        if chosen[m] >= 0:
            holder[chosen[m]] = m
    for m in range(rows):
        out[m] = 0.0
        k = chosen[m]
        if k < 0:
            continue
        own = gain[m, k]
        best = 0.0
        for other in range(columns):
            # A free blob can be taken without loss to another marker.
            if other != k and holder[other] < 0:
                best = max(best, gain[m, other])
        rival = best
        for other in range(rows):
            if other == m:
                continue
            theirs = chosen[other]
            # What the other marker gives up is what the exchange costs.
            before = gain[other, theirs] if theirs >= 0 else 0.0
            # The other marker takes this blob; this marker takes the other's, a free one, or none.
            instead = best
            if theirs >= 0:
                instead = max(instead, gain[m, theirs])
            rival = max(rival, gain[other, k] - before + instead)
        out[m] = max(own - rival, 0.0)


@kernel
def blob_gains(uv, slopes, shares, means, covariances, xy, first, last, camera, observing, gain):
    """What it gains to label a blob of one camera as a marker, against a stray and a marker without a blob.

    IN  uv (C, M, 2), slopes (C, M, 2, 3): of the model; shares (C, M); means (M, 3) m, covariances (M, 3, 3) m2: where the marker is
        off the model's place; xy (P, 2) px; first, last: the camera's blobs
    OUT gain (M, last - first) nats
    O(M K), no allocation.
    """
    noise = observing.noise * observing.noise
    for m in range(len(means)):
        for k in range(last - first):
            gain[m, k] = -_NEVER
        # Behind the camera there is no place to compare with.
        if not math.isfinite(uv[camera, m, 0]):
            continue
        s = slopes[camera, m]
        u = uv[camera, m, 0] + s[0, 0] * means[m, 0] + s[0, 1] * means[m, 1] + s[0, 2] * means[m, 2]
        v = uv[camera, m, 1] + s[1, 0] * means[m, 0] + s[1, 1] * means[m, 1] + s[1, 2] * means[m, 2]
        # Covariance in the image: the blob's noise, and where the marker may be.
        a, b, c = noise, 0.0, noise
        for i in range(3):
            for j in range(3):
                a += s[0, i] * covariances[m, i, j] * s[0, j]
                b += s[0, i] * covariances[m, i, j] * s[1, j]
                c += s[1, i] * covariances[m, i, j] * s[1, j]
        determinant = a * c - b * b
        # Never quite sure, so that one blob at an unlikely place can be outweighed by others.
        share = min(max(shares[camera, m], 1e-3), 0.999)
        # Seen against hidden, and the blob's density as this marker against that of a stray.
        usual = math.log(share / (1.0 - share)) - math.log(2.0 * math.pi * math.sqrt(determinant)) - math.log(observing.strays)
        for k in range(last - first):
            du, dv = xy[first + k, 0] - u, xy[first + k, 1] - v
            gain[m, k] = usual - 0.5 * (c * du * du - 2.0 * b * du * dv + a * dv * dv) / determinant


@kernel
def invert_each(matrices, out):
    """The inverses of symmetric 3 x 3 matrices. IN matrices (M, 3, 3). OUT out (M, 3, 3), 0 where one is not positive definite. O(M)."""
    h = np.empty(6)
    for m in range(len(matrices)):
        invert_symmetric(matrices[m], h, out[m])


@kernel(inline=True)
def invert_symmetric(matrix, h, out):
    """The inverse of a symmetric matrix (3, 3). OUT h (6,): working memory; out (3, 3). O(1)."""
    h[0], h[1], h[2], h[3], h[4], h[5] = matrix[0, 0], matrix[0, 1], matrix[0, 2], matrix[1, 1], matrix[1, 2], matrix[2, 2]
    _, xx, xy, xz, yy, yz, zz = symmetric_inverse(h)
    out[0, 0], out[1, 1], out[2, 2] = xx, yy, zz
    out[0, 1] = out[1, 0] = xy
    out[0, 2] = out[2, 0] = xz
    out[1, 2] = out[2, 1] = yz


@kernel
def combine_sights(uv, slopes, chosen, xy, offsets, without, weight, information, means, covariances):
    """Where markers are off their model places, by the model and the blobs that they have in other cameras.

    IN  uv (C, M, 2), slopes (C, M, 2, 3); chosen (C, M): the blob of each marker in each camera, -1 for none; without: the camera that
        does not count, -1 for none; weight px-2 of a blob; information (M, 3, 3) m-2: how exactly the model knows each place
    OUT means (M, 3) m, covariances (M, 3, 3) m2
    O(C M); allocates 3 x 3.
    """
    sum_of, pull, h = np.empty((3, 3)), np.empty(3), np.empty(6)
    for m in range(len(means)):
        sum_of[:] = information[m]
        pull[:] = 0.0
        for c in range(len(uv)):
            k = chosen[c, m]
            # The camera whose blobs are to be labelled must not confirm itself.
            if c != without and k >= 0:
                row = offsets[c] + k
                add_sight(slopes[c, m], weight, weight * (xy[row, 0] - uv[c, m, 0]), weight * (xy[row, 1] - uv[c, m, 1]), sum_of, pull)
        covariance = covariances[m]
        invert_symmetric(sum_of, h, covariance)
        for i in range(3):
            means[m, i] = covariance[i, 0] * pull[0] + covariance[i, 1] * pull[1] + covariance[i, 2] * pull[2]


@kernel
def label_globally(cameras, observing, shares, points, priors, xy, offsets, rounds, together, labels, margin, means, covariances):
    """Blobs to markers in all cameras at once: each camera assigns exactly, by what the other cameras' blobs say of where a marker is.

    IN  shares (C, M); points (M, 3) m, priors (M, 3, 3) m2: where the posed body has its markers, and how exactly; xy (P, 2) px,
        offsets (C + 1,); rounds: how often each camera assigns at most; together: whether cameras inform each other
    OUT labels (P,): the marker of each blob, -1 for none; margin (P,) nats: gain beyond the best change; means (M, 3) m off `points`,
        covariances (M, 3, 3) m2: markers by all their blobs. Returns the total gain, nats
    O(rounds C M^2 (M + K)). Coordinate ascent on the joint probability of labels and places; it ends where nothing changes.
    """
    count, markers = len(cameras.eyes), len(points)
    uv, slopes = np.empty((count, markers, 2)), np.empty((count, markers, 2, 3))
    project_linear(cameras, points, uv, slopes)
    information = np.empty((markers, 3, 3))
    invert_each(priors, information)
    chosen, before = np.full((count, markers), -1, dtype=np.int64), np.empty((count, markers), dtype=np.int64)
    by_marker = np.empty(markers)
    weight = 1.0 / (observing.noise * observing.noise)
    labels[:] = -1
    margin[:] = 0.0
    total = 0.0
    for turn in range(rounds + 1):
        total = 0.0
        before[:] = chosen
        for c in range(count):
            first, last = offsets[c], offsets[c + 1]
            # In the first round nothing is known of other cameras' labels.
            if together and turn > 0:
                combine_sights(uv, slopes, chosen, xy, offsets, c, weight, information, means, covariances)
            else:
                means[:] = 0.0
                covariances[:] = priors
            # Each camera assigns exactly; only the cameras' influence on each other is iterated.
            gain = np.empty((markers, last - first))
            blob_gains(uv, slopes, shares, means, covariances, xy, first, last, c, observing, gain)
            assign_best(gain, chosen[c])
            margins(gain, chosen[c], by_marker)
            for k in range(first, last):
                labels[k] = -1
                margin[k] = 0.0
            for m in range(markers):
                if chosen[c, m] >= 0:
                    total += gain[m, chosen[c, m]]
                    labels[first + chosen[c, m]] = m
                    margin[first + chosen[c, m]] = by_marker[m]
        # Nothing has changed, so that nothing would.
        if turn > 0 and (before == chosen).all():
            break
    combine_sights(uv, slopes, chosen, xy, offsets, -1, weight, information, means, covariances)
    return total


@kernel
def place_priors(body, pose, rotation, hessian, free, points, priors):
    """Where a posed body has its markers, and how exactly: the pose's own inexactness and the marker's spread.

    IN  hessian (D, D) lower triangle, of the pose; free (F,): which numbers were fitted
    OUT points (M, 3) m, priors (M, 3, 3) m2; returns whether the pose is determined
    O(F^3 + M F^2); allocates (F, F).
    """
    size, bones, hinges, fitted = len(pose), len(body.parents), len(body.axes), len(free)
    turned, moved, by_scale = np.empty((bones, 3, 3)), np.empty((bones, 3)), np.empty((bones, 3, 3))
    axes, pivots = np.empty((hinges, 3)), np.empty((hinges, 3))
    place_bones(body.parents, body.pivots, body.hinge_starts, body.axes, pose, rotation, turned, moved, by_scale, axes, pivots)
    place_points(body.bones, body.places, pose, turned, moved, points)
    jacobian, factor, step = np.empty((3, size)), np.empty((size, size)), np.empty(size)
    # The factor is all that is wanted of it: the step is not taken.
    known = solve_damped(hessian, step, free, 1e-9, factor, step)
    part = np.empty((3, fitted))
    for m in range(len(points)):
        b = body.bones[m]
        point_jacobian(b, body.places[m], points[m], pose, turned, by_scale, axes, pivots, body.moves[b], jacobian)
        # With H = L L', the covariance J inverse(H) J' is the square of inverse(L) J'.
        for i in range(3):
            for p in range(fitted):
                total = jacobian[i, free[p]]
                # Forward substitution: the inverse itself is never made.
                for q in range(p):
                    total -= factor[p, q] * part[i, q]
                part[i, p] = total / factor[p, p] if known else 0.0
        for i in range(3):
            for k in range(3):
                total = body.spreads[m] ** 2 if i == k else 0.0
                for p in range(fitted):
                    total += part[i, p] * part[k, p]
                priors[m, i, k] = total
    return known


@kernel
def unseen_cost(shares):
    """What it costs (nats) that no camera would have a blob of any marker, the base of gains. IN shares (C, M). O(C M)."""
    cost = 0.0
    for c in range(shares.shape[0]):
        for m in range(shares.shape[1]):
            # A share of 1 would cost infinitely: no camera sees for sure.
            cost -= math.log(1.0 - min(shares[c, m], 0.999))
    return cost
