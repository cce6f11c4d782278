"""A posed body and the blobs of one frame in; which blob is which marker, and how sure that is, out. Twins: tests/twins_views.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.views._fit_kernels import add_sight, evaluate, minimise, predict_visible, project_linear
from asterism.views._pose_kernels import add_priors, place_bones, place_points, point_jacobian, solve_damped

_NEVER = 1e6
"""nats: no gain comes near."""


@kernel
def assign_best(gain, chosen):
    """The one-to-one assignment of rows to columns with the greatest total gain; what would not gain stays without (shortest paths).

    IN  gain (M, K) nats
    OUT chosen (M,): the column of each row, -1 for none
    O(M^2 (M + K)); allocates (M + K,).
    """
    rows, columns = gain.shape
    wide = columns + rows
    u, v = np.zeros(rows + 1), np.zeros(wide + 1)
    owner, way = np.zeros(wide + 1, dtype=np.int64), np.zeros(wide + 1, dtype=np.int64)
    least, used = np.empty(wide + 1), np.empty(wide + 1, dtype=np.bool_)
    for i in range(1, rows + 1):
        owner[0] = i
        here = 0
        least[:] = np.inf
        used[:] = False
        while True:
            used[here] = True
            row, step, following = owner[here], np.inf, 0
            for j in range(1, wide + 1):
                if used[j]:
                    continue
                cost = -gain[row - 1, j - 1] if j <= columns else 0.0 if j - columns == row else _NEVER
                cost -= u[row] + v[j]
                if cost < least[j]:
                    least[j] = cost
                    way[j] = here
                if least[j] < step:
                    step = least[j]
                    following = j
            for j in range(wide + 1):
                if used[j]:
                    u[owner[j]] += step
                    v[j] -= step
                else:
                    least[j] -= step
            here = following
            if owner[here] == 0:
                break
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
    """How much gain each given label is worth beyond the best change of it: to no blob, to a free blob, or exchanged with another marker.

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
            if other != k and holder[other] < 0:
                best = max(best, gain[m, other])
        rival = best
        for other in range(rows):
            if other == m:
                continue
            theirs = chosen[other]
            before = gain[other, theirs] if theirs >= 0 else 0.0
            # The other marker takes this blob; this marker takes the other's, a free one, or none.
            instead = best
            if theirs >= 0:
                instead = max(instead, gain[m, theirs])
            rival = max(rival, gain[other, k] - before + instead)
        out[m] = max(own - rival, 0.0)


@kernel
def blob_gains(body, uv, slopes, shares, means, covariances, xy, first, last, camera, observing, gain):
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
        if not math.isfinite(uv[camera, m, 0]):
            continue
        s = slopes[camera, m]
        u = uv[camera, m, 0] + s[0, 0] * means[m, 0] + s[0, 1] * means[m, 1] + s[0, 2] * means[m, 2]
        v = uv[camera, m, 1] + s[1, 0] * means[m, 0] + s[1, 1] * means[m, 1] + s[1, 2] * means[m, 2]
        a, b, c = noise, 0.0, noise
        for i in range(3):
            for j in range(3):
                a += s[0, i] * covariances[m, i, j] * s[0, j]
                b += s[0, i] * covariances[m, i, j] * s[1, j]
                c += s[1, i] * covariances[m, i, j] * s[1, j]
        determinant = a * c - b * b
        share = min(max(shares[camera, m], 1e-3), 0.999)
        usual = math.log(share / (1.0 - share)) - math.log(2.0 * math.pi * math.sqrt(determinant)) - math.log(observing.strays)
        for k in range(last - first):
            du, dv = xy[first + k, 0] - u, xy[first + k, 1] - v
            gain[m, k] = usual - 0.5 * (c * du * du - 2.0 * b * du * dv + a * dv * dv) / determinant


@kernel
def combine_sights(uv, slopes, chosen, xy, offsets, without, prior, noise, mean, covariance, m):
    """Where a marker is off its model place, by the model and the blobs that it has in other cameras.

    IN  chosen (C, M): the blob of each marker in each camera, -1 for none; without: the camera that does not count, -1 for none;
        prior (3, 3) m2: covariance of the model's place; noise px; m: the marker
    OUT mean (3,) m, covariance (3, 3) m2; returns how many cameras counted
    O(C); allocates 3 x 3.
    """
    information, pull = np.linalg.inv(prior), np.zeros(3)
    count = 0
    for c in range(len(uv)):
        k = chosen[c, m]
        if c == without or k < 0:
            continue
        count += 1
        weight = 1.0 / (noise * noise)
        row = offsets[c] + k
        add_sight(slopes[c, m], weight, weight * (xy[row, 0] - uv[c, m, 0]), weight * (xy[row, 1] - uv[c, m, 1]), information, pull)
    covariance[:] = np.linalg.inv(information)
    for i in range(3):
        mean[i] = covariance[i, 0] * pull[0] + covariance[i, 1] * pull[1] + covariance[i, 2] * pull[2]
    return count


@kernel
def label_globally(body, cameras, observing, shares, points, priors, xy, offsets, rounds, together, labels, worth, means, covariances):
    """Blobs to markers in all cameras at once: each camera assigns exactly, by what the other cameras' blobs say of where a marker is.

    IN  shares (C, M); points (M, 3) m, priors (M, 3, 3) m2: where the posed body has its markers, and how exactly; xy (P, 2) px,
        offsets (C + 1,); rounds: how often each camera assigns; together: whether cameras inform each other
    OUT labels (P,): the marker of each blob, -1 for none; worth (P,) nats: gain beyond the best change; means (M, 3) m off `points`,
        covariances (M, 3, 3) m2: markers by all their blobs. Returns the total gain, nats
    O(rounds C M^2 (M + K)). Coordinate ascent on the joint probability of labels and places.
    """
    count, markers = len(cameras.eyes), len(points)
    uv, slopes = np.empty((count, markers, 2)), np.empty((count, markers, 2, 3))
    project_linear(cameras, points, uv, slopes)
    chosen = np.full((count, markers), -1, dtype=np.int64)
    labels[:] = -1
    worth[:] = 0.0
    total = 0.0
    for turn in range(rounds + 1):
        total = 0.0
        for c in range(count):
            first, last = offsets[c], offsets[c + 1]
            for m in range(markers):
                if together and turn > 0:
                    combine_sights(uv, slopes, chosen, xy, offsets, c, priors[m], observing.noise, means[m], covariances[m], m)
                else:
                    means[m] = 0.0
                    covariances[m] = priors[m]
            gain = np.empty((markers, last - first))
            blob_gains(body, uv, slopes, shares, means, covariances, xy, first, last, c, observing, gain)
            assign_best(gain, chosen[c])
            for m in range(markers):
                if chosen[c, m] >= 0:
                    total += gain[m, chosen[c, m]]
            if turn == rounds:
                margin = np.empty(markers)
                margins(gain, chosen[c], margin)
                for k in range(first, last):
                    labels[k] = -1
                    worth[k] = 0.0
                for m in range(markers):
                    if chosen[c, m] >= 0:
                        labels[first + chosen[c, m]] = m
                        worth[first + chosen[c, m]] = margin[m]
    for m in range(markers):
        combine_sights(uv, slopes, chosen, xy, offsets, -1, priors[m], observing.noise, means[m], covariances[m], m)
    return total


@kernel
def place_priors(body, pose, rotation, hessian, free, points, priors):
    """Where a posed body has its markers, and how exactly: the pose's own inexactness and the marker's spread.

    IN  hessian (D, D) lower triangle, of the pose; free (F,): which numbers were fitted
    OUT points (M, 3) m, priors (M, 3, 3) m2; returns whether the pose is determined
    O(F^3 + M F^2); allocates (D, D).
    """
    size, bones, hinges = len(pose), len(body.parents), len(body.axes)
    turned, moved, by_scale = np.empty((bones, 3, 3)), np.empty((bones, 3)), np.empty((bones, 3, 3))
    axes, pivots = np.empty((hinges, 3)), np.empty((hinges, 3))
    place_bones(body.parents, body.pivots, body.hinge_starts, body.axes, pose, rotation, turned, moved, by_scale, axes, pivots)
    place_points(body.bones, body.places, pose, turned, moved, points)
    jacobian, factor, step, column = np.empty((3, size)), np.empty((size, size)), np.empty(size), np.zeros(size)
    whole = True
    for m in range(len(points)):
        b = body.bones[m]
        point_jacobian(b, body.places[m], points[m], pose, turned, by_scale, axes, pivots, body.moves[b], jacobian)
        for i in range(3):
            for p in range(size):
                column[p] = jacobian[i, p]
            known = solve_damped(hessian, column, free, 1e-9, factor, step)
            whole = whole and known
            for k in range(3):
                total = body.spreads[m] ** 2 if i == k else 0.0
                for p in range(size):
                    total += jacobian[k, p] * step[p]
                priors[m, i, k] = total
    return whole


@kernel
def settle(
    body, cameras, known, observing, xy, offsets, sigmas, steps, free, rounds, together, pose, rotation, labels, worth, means, covariances
):
    """Label the blobs by a fitted pose, fit the pose to the labels, and label again.

    IN  sigmas (1,) px: the blobs' noise; others: see `minimise` and `label_globally`
    OUT pose (D,), rotation (3, 3): the start, then the result; labels (P,), worth (P,) nats; means (M, 3) m: the markers' places,
        covariances (M, 3, 3) m2. Returns the labels' total gain less what the pose costs beforehand, nats
    O(labellings + minimisation).
    """
    size, markers = len(pose), len(body.bones)
    hessian, gradient = np.empty((size, size)), np.empty(size)
    points, priors = np.empty((markers, 3)), np.empty((markers, 3, 3))
    shares = np.empty((len(cameras.eyes), markers))
    nobody = np.empty(0, dtype=np.int64)
    gain = 0.0
    for turn in range(2):
        predict_visible(body, cameras, observing, pose, rotation, shares)
        given = nobody if turn == 0 else labels
        evaluate(body, cameras, known, observing, shares, xy, offsets, given, pose, rotation, sigmas[-1], hessian, gradient)
        place_priors(body, pose, rotation, hessian, free, points, priors)
        gain = label_globally(
            body, cameras, observing, shares, points, priors, xy, offsets, rounds, together, labels, worth, means, covariances
        )
        minimise(body, cameras, known, observing, xy, offsets, labels, sigmas, steps, free, pose, rotation, hessian)
    predict_visible(body, cameras, observing, pose, rotation, shares)
    place_priors(body, pose, rotation, hessian, free, points, priors)
    gain = label_globally(
        body, cameras, observing, shares, points, priors, xy, offsets, rounds, together, labels, worth, means, covariances
    )
    for m in range(markers):
        for i in range(3):
            means[m, i] += points[m, i]
    # What the scene should show and does not, and what the pose costs by itself.
    for c in range(len(shares)):
        for m in range(markers):
            gain += math.log(1.0 - min(shares[c, m], 0.999))
    hessian[:] = 0.0
    gradient[:] = 0.0
    gain -= add_priors(
        pose,
        rotation,
        known.vertical,
        body.usual,
        body.precision,
        known.scale_usual,
        known.scale_precision,
        known.tilt_precision,
        hessian,
        gradient,
    )
    return gain
