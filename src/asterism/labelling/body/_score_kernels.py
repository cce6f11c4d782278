"""Scores: a frame's points and a labelling in; its log evidence and every point's leave-one-out score as every marker out."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.geometry.shared_kernels import align_about_z, cofactors, symmetric_inverse
from asterism.labelling.body._workspace_kernels import LOG_2PI

NO_TAIL = 1e9
"""Degrees of freedom so many that the density has no tail beyond a normal one's, see `log_tail`."""
MAX_DISTANCE = 0.6
"""m; a point farther than this from where a marker is predicted scores -inf as that marker."""


@kernel
def _cholesky(matrix):
    """Upper triangle of a symmetric positive definite matrix A replaced by U with U' U = A; returns log det A. O(r^3 / 3).

    Four rows at a time, so that what is below them is read and written once for the four.
    """
    n = len(matrix)
    log_det, product = 0.0, 1.0
    for first in range(0, n, 4):
        end = min(first + 4, n)
        for j in range(first, end):
            for i in range(first, j):
                weight = matrix[i, j]
                for k in range(j, n):
                    matrix[j, k] -= weight * matrix[i, k]
            pivot = math.sqrt(matrix[j, j])
            # A product of pivots, and a logarithm only where it becomes large: logarithms cost more than the factor.
            product *= pivot
            if product > 1e100:
                log_det += 2.0 * math.log(product)
                product = 1.0
            scale = 1.0 / pivot
            matrix[j, j] = pivot
            for k in range(j + 1, n):
                matrix[j, k] *= scale
        for i in range(end, n):  # only after four whole rows
            a, b, c, d = matrix[first, i], matrix[first + 1, i], matrix[first + 2, i], matrix[first + 3, i]
            for k in range(i, n):
                matrix[i, k] -= a * matrix[first, k] + b * matrix[first + 1, k] + c * matrix[first + 2, k] + d * matrix[first + 3, k]
    return log_det + 2.0 * math.log(product)


@kernel
def log_tail(distance2, coordinates, freedom):
    """How much a squared Mahalanobis distance takes from the log density of so many coordinates: nats, 0 or below.

    Up to its expected value, one for each coordinate, as a normal distribution has it: minus half the distance. Beyond, the spread of the
    whole body may be larger than the training's, with the odds of a multivariate t distribution with `freedom` degrees of freedom: a body
    in a posture that the training lacks deviates everywhere. Continuous, and so is its slope.
    IN  distance2 >= 0; coordinates, their number; freedom > 0. Returns nats. O(1).
    """
    if distance2 <= coordinates:
        return -0.5 * distance2
    return -0.5 * (coordinates + (freedom + coordinates) * math.log((freedom + distance2) / (freedom + coordinates)))


@kernel
def evidence(body, k, points, point_of, settings, workspace):
    """How likely the labelled points are all together, under one key pose.

    IN   body BodyArrays; k key pose; points (n, 3); point_of (M,), -1 for none; settings FrameSettings
    OUT  workspace.aligned, residual, information (the factor of its upper triangle), latent (the latents' mean times that factor),
         deviation
    Markers flagged in workspace.outlier count with `settings.outlier_score` and say nothing of the body.
    Returns the labelling's score: log density of its points plus the rewards, in nats (0 is the empty labelling).
    O(M r^2 + r^3).
    """
    markers, latents = body.load.shape[1], body.load.shape[3]
    information, latent, factor = workspace.flat_information, workspace.latent, workspace.information
    align_about_z(points, point_of, body.mean[k], workspace.all_markers, workspace.aligned)
    counted = 0
    for m in range(markers):
        counted += point_of[m] >= 0 and not workspace.outlier[m]
    # The sum over all markers is at hand: where most are labelled, the few that are not are taken off it.
    most = 2 * counted > markers
    latent[:] = 0.0
    if most:
        for i in range(latents * latents):
            information[i] = body.full[k, i]
    else:
        information[:] = 0.0
        for i in range(latents):
            information[i * latents + i] = 1.0
    for m in range(markers):
        present = point_of[m] >= 0 and not workspace.outlier[m]
        # Only those that differ from what the sum began with.
        if present != most:
            sign = 1.0 if present else -1.0
            for i in range(latents * latents):
                information[i] += sign * body.gram[k, m, i]
    score, squares, labelled = body.log_weight[k], 0.0, 0
    for m in range(markers):
        row = point_of[m]
        if row < 0:
            continue
        labelled += 1
        # An outlier costs a fixed score and leaves the body's posterior alone.
        if workspace.outlier[m]:
            score += settings.outlier_score
            continue
        for a in range(3):
            total = 0.0
            # The whitening is triangular.
            for b in range(a + 1):
                total += body.whiten[k, m, a, b] * (workspace.aligned[row, b] - body.mean[k, m, b])
            workspace.residual[m, a] = total
            squares += total * total
        for i in range(latents):
            latent[i] += (
                body.load[k, m, 0, i] * workspace.residual[m, 0]
                + body.load[k, m, 1, i] * workspace.residual[m, 1]
                + body.load[k, m, 2, i] * workspace.residual[m, 2]
            )
        score += body.log_scale[k, m] - 1.5 * LOG_2PI + settings.reward
    # The first ghost costs, and no other one: a frame is with ghosts or without.
    if labelled < len(points):
        score -= settings.first_ghost_cost
    score -= 0.5 * _cholesky(factor)
    quadratic = 0.0
    # Forward substitution alone: the score needs the squared length, which the way back would not change.
    for i in range(latents):
        latent[i] /= factor[i, i]
        quadratic += latent[i] * latent[i]
        for j in range(i + 1, latents):
            latent[j] -= factor[i, j] * latent[i]
    workspace.deviation[0], workspace.deviation[1] = squares - quadratic, 3.0 * counted
    return score + log_tail(squares - quadratic, 3.0 * counted, settings.tail_freedom)


@kernel
def predict_markers(body, k, workspace):
    """Where the labelled points predict every marker, after `evidence`, in whitened units.

    OUT  workspace.centre, variance
    O(M r^2).
    """
    latents, markers = len(workspace.latent), body.load.shape[1]
    solved, factor, centre, variance = workspace.solved, workspace.information, workspace.centre, workspace.variance
    centre[:] = 0.0
    variance[:] = 0.0
    # forward substitution of all markers' coordinates at once
    for i in range(latents):
        for c in range(3 * markers):
            solved[i, c] = body.load_by_latent[k, i, c]
    for first in range(0, latents, 4):
        end = min(first + 4, latents)
        for i in range(first, end):
            for j in range(first, i):
                share = factor[j, i]
                for c in range(3 * markers):
                    solved[i, c] -= share * solved[j, c]
            # With the latents in the same basis, each solved row adds to all predictions at once.
            scale, weight = 1.0 / factor[i, i], workspace.latent[i]
            for c in range(3 * markers):
                solved[i, c] *= scale
                centre[c] += weight * solved[i, c]
            for m in range(markers):
                x, y, z = solved[i, m], solved[i, markers + m], solved[i, 2 * markers + m]
                # Six sums per marker: the covariance is symmetric.
                variance[0, m] += x * x
                variance[1, m] += x * y
                variance[2, m] += x * z
                variance[3, m] += y * y
                variance[4, m] += y * z
                variance[5, m] += z * z
        for j in range(end, latents):  # only after four whole rows
            s0, s1, s2, s3 = factor[first, j], factor[first + 1, j], factor[first + 2, j], factor[first + 3, j]
            for c in range(3 * markers):
                solved[j, c] -= s0 * solved[first, c] + s1 * solved[first + 1, c] + s2 * solved[first + 2, c] + s3 * solved[first + 3, c]


@kernel
def leave_one_out(m, counts, workspace):
    """Where all labelled points but its own predict marker m, after `predict_markers`, in whitened units.

    IN  counts, whether m's own point is among those that `evidence` has counted
    Returns (det, mean (3,), precision (6,)): the determinant of the inverse covariance, the mean, the inverse covariance. O(1).
    """
    markers, v, own = len(workspace.residual), workspace.variance, workspace.residual[m]
    x, y, z = workspace.centre[m], workspace.centre[markers + m], workspace.centre[2 * markers + m]
    # To leave a point out is to take its information off: the same formula with the other sign.
    sign = -1.0 if counts else 1.0
    xx, xy, xz = 1.0 + sign * v[0, m], sign * v[1, m], sign * v[2, m]
    yy, yz, zz = 1.0 + sign * v[3, m], sign * v[4, m], 1.0 + sign * v[5, m]
    # the covariance is I + H for a marker without a point, and (I - H)^-1 for a labelled one
    det, c_xx, c_xy, c_xz, c_yy, c_yz, c_zz = cofactors(xx, xy, xz, xy, yy, yz, xz, yz, zz)
    # A marker that alone holds the body in place leaves nothing when it is left out.
    det = max(det, 1e-9)
    c_xx, c_xy, c_xz, c_yy, c_yz, c_zz = c_xx / det, c_xy / det, c_xz / det, c_yy / det, c_yz / det, c_zz / det
    # No point of its own is in the posterior: the prediction is as it stands.
    if not counts:
        return 1.0 / det, (x, y, z), (c_xx, c_xy, c_xz, c_yy, c_yz, c_zz)
    # the mean is e - (I - H)^-1 (e - centre), e the residual of the marker's own point
    dx, dy, dz = own[0] - x, own[1] - y, own[2] - z
    x = own[0] - (c_xx * dx + c_xy * dy + c_xz * dz)
    y = own[1] - (c_xy * dx + c_yy * dy + c_yz * dz)
    z = own[2] - (c_xz * dx + c_yz * dy + c_zz * dz)
    return det, (x, y, z), (xx, xy, xz, yy, yz, zz)


@kernel
def place_on_body(body, k, m, at):
    """Where marker m of the placed body is, in m, for a whitened displacement `at` (3,). Returns (x, y, z). O(1)."""
    mean, spread = body.mean[k, m], body.spread[k, m]
    return (
        mean[0] + spread[0, 0] * at[0],
        mean[1] + spread[1, 0] * at[0] + spread[1, 1] * at[1],
        mean[2] + spread[2, 0] * at[0] + spread[2, 1] * at[1] + spread[2, 2] * at[2],
    )


@kernel
def _squared_distance(x, y, z, precision):
    """The squared Mahalanobis distance of a whitened residual. IN precision (6,). O(1)."""
    xx, xy, xz, yy, yz, zz = precision
    return x * (xx * x + 2.0 * (xy * y + xz * z)) + y * (yy * y + 2.0 * yz * z) + zz * z * z


@kernel
def _score_at(point, place, whiten, precision, peak, others, settings):
    """The score in nats of a placed point as a marker that is predicted at `place`.

    IN  point, place (3,) m; whiten (3, 3) and precision (6,) of the prediction; peak nats, the score of a point at the place itself, less
        what `log_tail` takes; others (2,), the `deviation` of the labelled points that predict the place
    O(1).
    """
    dx, dy, dz = point[0] - place[0], point[1] - place[1], point[2] - place[2]
    near2 = dx * dx + dy * dy + dz * dz
    # So far off no body would have the marker there, and the quadratic form is spared.
    if near2 > MAX_DISTANCE * MAX_DISTANCE:
        return -np.inf
    x = whiten[0, 0] * dx
    y = whiten[1, 0] * dx + whiten[1, 1] * dy
    z = whiten[2, 0] * dx + whiten[2, 1] * dy + whiten[2, 2] * dz
    distance2, coordinates = others
    # a point adds to the deviation of the others, so that in a foreign posture it may lie farther off
    score = peak + log_tail(distance2 + _squared_distance(x, y, z, precision), coordinates + 3.0, settings.tail_freedom)
    # A point near enough may still be the marker, badly seen.
    if score < settings.outlier_score and near2 < settings.outlier_radius * settings.outlier_radius:
        return settings.outlier_score
    return score


@kernel
def _deviation_without(m, at, precision, workspace):
    """The deviation (2,) of all labelled points but marker m's. IN at (3,), precision (6,): see `leave_one_out`. O(1)."""
    own = workspace.residual[m]
    distance2 = _squared_distance(own[0] - at[0], own[1] - at[1], own[2] - at[2], precision)
    return max(0.0, workspace.deviation[0] - distance2), workspace.deviation[1] - 3.0


@kernel
def leave_one_out_scores(body, k, point_of, settings, workspace):
    """Score every point as every marker, given all other labelled points (leave one out), after `predict_markers`.

    OUT workspace.scores (M, n): nats by which "point c is marker m" beats "m is hidden and c is a ghost"; -inf where far
    O(M n).
    """
    for m in range(body.load.shape[1]):
        counts = point_of[m] >= 0 and not workspace.outlier[m]
        det, at, precision = leave_one_out(m, counts, workspace)
        place, whiten = place_on_body(body, k, m, at), body.whiten[k, m]
        others = _deviation_without(m, at, precision, workspace) if counts else (workspace.deviation[0], workspace.deviation[1])
        peak = body.log_scale[k, m] - 1.5 * LOG_2PI + settings.reward + 0.5 * math.log(det)
        peak -= log_tail(others[0], others[1], settings.tail_freedom)
        for c in range(len(workspace.aligned)):
            workspace.scores[m, c] = _score_at(workspace.aligned[c], place, whiten, precision, peak, others, settings)


@kernel
def _without_marker(m, workspace, inverse, shift):
    """What changes for all predictions if a labelled marker says nothing of the body, after `predict_markers`.

    OUT inverse (6,): (I - H)^-1, H the marker's `variance`; shift (3,): that times the marker's residual from its prediction.
    Returns the deviation (2,) of all other labelled points. O(1).
    """
    v = workspace.variance
    _, xx, xy, xz, yy, yz, zz = symmetric_inverse((1.0 - v[0, m], -v[1, m], -v[2, m], 1.0 - v[3, m], -v[4, m], 1.0 - v[5, m]))
    inverse[0], inverse[1], inverse[2], inverse[3], inverse[4], inverse[5] = xx, xy, xz, yy, yz, zz
    _, at, precision = leave_one_out(m, True, workspace)
    for a in range(3):
        shift[a] = workspace.residual[m, a] - at[a]
    return _deviation_without(m, at, precision, workspace)


@kernel
def score_held_points(body, k, point_of, least, settings, workspace, scores):
    """Score the points that labelled markers hold as every hidden marker, given all other labelled points, after `rescore`.

    `leave_one_out_scores` predicts a hidden marker from all labelled points. A point that is scored as this marker must not be one of them:
    under its present label it has drawn the body towards itself.
    IN     as `leave_one_out_scores`; only what scores above `least` nats is scored anew; outliers have drawn nothing
    IN/OUT scores (M, n) nats
    O(M + hidden n r).

    Bounds: `entry` counts the six places of an upper triangle of 3 x 3.
    """
    markers = body.load.shape[1]
    solved, variance = workspace.solved, workspace.variance
    inverses, shifts, deviations = np.empty((markers, 6)), np.empty((markers, 3)), np.empty((markers, 2))
    cross, part, at, spread = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(6)
    for o in range(markers):
        # What each labelled marker's own point has drawn is worked out once for all hidden markers.
        if point_of[o] >= 0 and not workspace.outlier[o]:
            deviations[o, 0], deviations[o, 1] = _without_marker(o, workspace, inverses[o], shifts[o])
    for m in range(markers):
        if point_of[m] >= 0:
            continue
        for o in range(markers):
            c = point_of[o]
            # An outlier has drawn nothing; a low score does not matter.
            if c < 0 or workspace.outlier[o] or scores[m, c] <= least:
                continue
            # How the two markers' predictions move together, by the latents.
            cross[:] = 0.0
            for i in range(len(solved)):
                for a in range(3):
                    for b in range(3):
                        cross[a, b] += solved[i, a * markers + m] * solved[i, b * markers + o]
            v, entry = inverses[o], 0
            for a in range(3):
                part[a, 0] = cross[a, 0] * v[0] + cross[a, 1] * v[1] + cross[a, 2] * v[2]
                part[a, 1] = cross[a, 0] * v[1] + cross[a, 1] * v[3] + cross[a, 2] * v[4]
                part[a, 2] = cross[a, 0] * v[2] + cross[a, 1] * v[4] + cross[a, 2] * v[5]
                at[a] = workspace.centre[a * markers + m]
                at[a] -= cross[a, 0] * shifts[o, 0] + cross[a, 1] * shifts[o, 1] + cross[a, 2] * shifts[o, 2]
            for a in range(3):
                for b in range(a, 3):
                    # Without the other's point the prediction is wider.
                    spread[entry] = (1.0 if a == b else 0.0) + variance[entry, m]
                    spread[entry] += part[a, 0] * cross[b, 0] + part[a, 1] * cross[b, 1] + part[a, 2] * cross[b, 2]
                    entry += 1
            det, xx, xy, xz, yy, yz, zz = symmetric_inverse(spread)
            peak = body.log_scale[k, m] - 1.5 * LOG_2PI + settings.reward - 0.5 * math.log(max(det, 1e-9))
            others = (deviations[o, 0], deviations[o, 1])
            peak -= log_tail(others[0], others[1], settings.tail_freedom)
            place, precision = place_on_body(body, k, m, at), (xx, xy, xz, yy, yz, zz)
            scores[m, c] = _score_at(workspace.aligned[c], place, body.whiten[k, m], precision, peak, others, settings)


@kernel
def best_pose(body, points, point_of, settings, workspace):
    """The key pose under which a labelling scores best, and that score.

    IN as `evidence`. Returns (k, nats). O(K) calls of `evidence`.
    """
    best, best_score = 0, -np.inf
    for k in range(len(body.log_weight)):
        score = evidence(body, k, points, point_of, settings, workspace)
        # The first of equals, so that the order of key poses decides.
        if score > best_score:
            best, best_score = k, score
    return best, best_score


@kernel
def rescore(body, k, points, point_of, settings, workspace):
    """Score all points by a labelling under one key pose; labelled markers that lie too far from their prediction become outliers.

    A marker is an outlier where its point scores no more than `settings.outlier_score`, given all other points.
    IN   body BodyArrays; k key pose; points (n, 3) m; point_of (M,), -1 for none; settings FrameSettings
    OUT  workspace.scores, workspace.outlier. Returns the labelling's score in nats. O(M (r^2 + n) + r^3).
    """
    score = evidence(body, k, points, point_of, settings, workspace)
    predict_markers(body, k, workspace)
    leave_one_out_scores(body, k, point_of, settings, workspace)
    changed = False
    for m in range(len(point_of)):
        is_outlier = point_of[m] >= 0 and workspace.scores[m, point_of[m]] <= settings.outlier_score
        # Outliers have drawn the body towards themselves: without them all others are scored anew.
        if is_outlier != workspace.outlier[m]:
            workspace.outlier[m] = is_outlier
            changed = True
    if changed:
        score = evidence(body, k, points, point_of, settings, workspace)
        predict_markers(body, k, workspace)
        leave_one_out_scores(body, k, point_of, settings, workspace)
    return score
