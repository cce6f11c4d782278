"""Scores: a frame's points and a labelling in; its log evidence and every point's leave-one-out score as every marker out."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.geometry._kernels import align_about_z, cofactors, symmetric_inverse
from asterism.labelling.body._workspace_kernels import LOG_2PI

MAX_DISTANCE = 0.6
"""m; a point farther than this from where a marker is predicted scores -inf as that marker."""


@kernel
def _cholesky(matrix, column):
    """Lower triangle of a symmetric positive definite matrix replaced by its Cholesky factor; returns log det. O(r^3 / 3)."""
    n = len(matrix)
    log_det = 0.0
    for j in range(n):
        pivot = math.sqrt(matrix[j, j])
        log_det += 2.0 * math.log(pivot)
        matrix[j, j] = pivot
        for i in range(j + 1, n):
            matrix[i, j] /= pivot
            column[i] = matrix[i, j]
        for i in range(j + 1, n):
            weight = column[i]
            for k in range(j + 1, i + 1):
                matrix[i, k] -= weight * column[k]
    return log_det


@kernel
def _inverse_of_factor(factor, inverse):
    """OUT inverse (r, r) of factor factor'. O(r^3 / 2)."""
    n = len(factor)
    # the factor's inverse, row by row, into the lower triangle
    for i in range(n):
        inverse[i, : i + 1] = 0.0
        for k in range(i):
            weight = factor[i, k]
            for j in range(k + 1):
                inverse[i, j] -= weight * inverse[k, j]
        inverse[i, i] = 1.0
        for j in range(i + 1):
            inverse[i, j] /= factor[i, i]
    # its transpose times itself: sums over rows i >= max(a, b), which are overwritten last
    for a in range(n):
        for b in range(a + 1, n):
            inverse[a, b] = 0.0
        for i in range(a + 1, n):
            weight = inverse[i, a]
            for b in range(a + 1, i + 1):
                inverse[a, b] += weight * inverse[i, b]
        total = 0.0
        for i in range(a, n):
            total += inverse[i, a] * inverse[i, a]
        inverse[a, a] = total
    for a in range(n):
        for b in range(a):
            inverse[a, b] = inverse[b, a]


@kernel
def evidence(body, k, points, point_of, settings, workspace):
    """How likely the labelled points are all together, under one key pose.

    IN   body BodyArrays; k key pose; points (n, 3); point_of (M,), -1 for none; settings FrameSettings
    OUT  workspace.aligned, residual, moment, information (its Cholesky factor)
    Markers flagged in workspace.outlier count with `settings.outlier_score` and say nothing of the body.
    Returns the labelling's score: log density of its points plus the rewards, in nats (0 is the empty labelling).
    O(M r^2 + r^3).
    """
    markers, latents = body.load.shape[1], body.load.shape[3]
    align_about_z(points, point_of, body.mean[k], workspace.all_markers, workspace.aligned)
    workspace.moment[:] = 0.0
    counted = 0
    for m in range(markers):
        counted += point_of[m] >= 0 and not workspace.outlier[m]
    if 2 * counted > markers:
        for i in range(latents):
            for j in range(latents):
                workspace.information[i, j] = body.full[k, i, j]
    else:
        workspace.information[:] = 0.0
        for i in range(latents):
            workspace.information[i, i] = 1.0
    for m in range(markers):
        present = point_of[m] >= 0 and not workspace.outlier[m]
        if present != (2 * counted > markers):
            sign = 1.0 if present else -1.0
            for i in range(latents):
                for j in range(i + 1):
                    workspace.information[i, j] += sign * body.gram[k, m, i, j]
    score, squares, labelled = body.log_weight[k], 0.0, 0
    for m in range(markers):
        row = point_of[m]
        if row < 0:
            continue
        labelled += 1
        if workspace.outlier[m]:
            score += settings.outlier_score
            continue
        for a in range(3):
            total = 0.0
            for b in range(3):
                total += body.whiten[k, m, a, b] * (workspace.aligned[row, b] - body.mean[k, m, b])
            workspace.residual[m, a] = total
            squares += total * total
        for i in range(latents):
            workspace.moment[i] += (
                body.load[k, m, 0, i] * workspace.residual[m, 0]
                + body.load[k, m, 1, i] * workspace.residual[m, 1]
                + body.load[k, m, 2, i] * workspace.residual[m, 2]
            )
        score += body.log_scale[k, m] - 1.5 * LOG_2PI + settings.reward
    if labelled < len(points):
        score -= settings.first_ghost_cost
    score -= 0.5 * _cholesky(workspace.information, workspace.latent)
    quadratic = 0.0
    for i in range(latents):
        total = workspace.moment[i]
        for j in range(i):
            total -= workspace.information[i, j] * workspace.latent[j]
        workspace.latent[i] = total / workspace.information[i, i]
        quadratic += workspace.latent[i] * workspace.latent[i]
    return score + 0.5 * (quadratic - squares)


@kernel
def posterior(workspace):
    """What the labelled points say of the latents, after `evidence`. OUT workspace.covariance, latent. O(r^3)."""
    _inverse_of_factor(workspace.information, workspace.covariance)
    latents = len(workspace.latent)
    workspace.latent[:] = 0.0
    for j in range(latents):
        weight = workspace.moment[j]
        for i in range(latents):
            workspace.latent[i] += weight * workspace.covariance[j, i]


@kernel
def leave_one_out_scores(body, k, point_of, settings, workspace):
    """Score every point as every marker, given all other labelled points (leave one out), after `posterior`.

    OUT workspace.scores (M, n): nats by which "point c is marker m" beats "m is hidden and c is a ghost"; -inf where far
    O(M (r^2 + n)).
    """
    markers, latents, n = body.load.shape[1], body.load.shape[3], len(workspace.aligned)
    h, inverse = np.empty((3, 3)), np.empty((3, 3))
    centre, shift = np.empty(3), np.empty(3)
    for m in range(markers):
        for a in range(3):
            workspace.slope[a] = 0.0
            for j in range(latents):
                weight = body.load[k, m, a, j]
                for i in range(latents):
                    workspace.slope[a, i] += weight * workspace.covariance[j, i]
        # nine sums side by side: one alone would wait for each of its additions
        h00, h01, h02, h10, h11, h12, h20, h21, h22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        x, y, z = 0.0, 0.0, 0.0
        for i in range(latents):
            load_x, load_y, load_z = body.load[k, m, 0, i], body.load[k, m, 1, i], body.load[k, m, 2, i]
            slope = workspace.slope[0, i]
            h00 += slope * load_x
            h01 += slope * load_y
            h02 += slope * load_z
            slope = workspace.slope[1, i]
            h10 += slope * load_x
            h11 += slope * load_y
            h12 += slope * load_z
            slope = workspace.slope[2, i]
            h20 += slope * load_x
            h21 += slope * load_y
            h22 += slope * load_z
            x += load_x * workspace.latent[i]
            y += load_y * workspace.latent[i]
            z += load_z * workspace.latent[i]
        h[0, 0], h[0, 1], h[0, 2] = h00, h01, h02
        h[1, 0], h[1, 1], h[1, 2] = h10, h11, h12
        h[2, 0], h[2, 1], h[2, 2] = h20, h21, h22
        centre[0], centre[1], centre[2] = x, y, z
        counts = point_of[m] >= 0 and not workspace.outlier[m]
        sign = -1.0 if counts else 1.0
        for a in range(3):
            for b in range(3):
                h[a, b] = (1.0 if a == b else 0.0) + sign * h[a, b]
        # predictive covariance (whitened): I + h for a hidden marker; (I - h)^-1 leave-one-out for a labelled one
        det, c00, c01, c02, c11, c12, c22 = cofactors(h[0, 0], h[0, 1], h[0, 2], h[1, 0], h[1, 1], h[1, 2], h[2, 0], h[2, 1], h[2, 2])
        det = max(det, 1e-9)
        inverse[0, 0], inverse[0, 1], inverse[0, 2] = c00 / det, c01 / det, c02 / det
        inverse[1, 0], inverse[1, 1], inverse[1, 2] = c01 / det, c11 / det, c12 / det
        inverse[2, 0], inverse[2, 1], inverse[2, 2] = c02 / det, c12 / det, c22 / det
        base = body.log_scale[k, m] - 1.5 * LOG_2PI + settings.reward
        if counts:
            # leave-one-out centre: e - (I - h)^-1 (e - centre)
            base += 0.5 * math.log(det)
            for a in range(3):
                shift[a] = workspace.residual[m, a]
                for b in range(3):
                    shift[a] -= inverse[a, b] * (workspace.residual[m, b] - centre[b])
            q = h
        else:
            base -= 0.5 * math.log(det)
            for a in range(3):
                shift[a] = centre[a]
            q = inverse
        at_x = body.mean[k, m, 0] + body.spread[k, m, 0, 0] * shift[0]
        at_y = body.mean[k, m, 1] + body.spread[k, m, 1, 0] * shift[0] + body.spread[k, m, 1, 1] * shift[1]
        at_z = body.mean[k, m, 2] + body.spread[k, m, 2, 0] * shift[0] + body.spread[k, m, 2, 1] * shift[1]
        at_z += body.spread[k, m, 2, 2] * shift[2]
        for c in range(n):
            dx, dy, dz = workspace.aligned[c, 0] - at_x, workspace.aligned[c, 1] - at_y, workspace.aligned[c, 2] - at_z
            near2 = dx * dx + dy * dy + dz * dz
            if near2 > MAX_DISTANCE * MAX_DISTANCE:
                workspace.scores[m, c] = -np.inf
                continue
            dx = workspace.aligned[c, 0] - body.mean[k, m, 0]
            dy = workspace.aligned[c, 1] - body.mean[k, m, 1]
            dz = workspace.aligned[c, 2] - body.mean[k, m, 2]
            x = body.whiten[k, m, 0, 0] * dx + body.whiten[k, m, 0, 1] * dy + body.whiten[k, m, 0, 2] * dz - shift[0]
            y = body.whiten[k, m, 1, 0] * dx + body.whiten[k, m, 1, 1] * dy + body.whiten[k, m, 1, 2] * dz - shift[1]
            z = body.whiten[k, m, 2, 0] * dx + body.whiten[k, m, 2, 1] * dy + body.whiten[k, m, 2, 2] * dz - shift[2]
            score = base - 0.5 * (
                x * (q[0, 0] * x + q[0, 1] * y + q[0, 2] * z)
                + y * (q[1, 0] * x + q[1, 1] * y + q[1, 2] * z)
                + z * (q[2, 0] * x + q[2, 1] * y + q[2, 2] * z)
            )
            if score < settings.outlier_score and near2 < settings.outlier_radius * settings.outlier_radius:
                score = settings.outlier_score
            workspace.scores[m, c] = score


@kernel(inline=True)
def _slope(body, k, m, workspace):
    """A marker's load times the covariance, after `posterior`. OUT workspace.slope (3, r). O(r^2)."""
    latents = len(workspace.latent)
    for a in range(3):
        workspace.slope[a] = 0.0
        for j in range(latents):
            weight = body.load[k, m, a, j]
            for i in range(latents):
                workspace.slope[a, i] += weight * workspace.covariance[j, i]


@kernel(inline=True)
def _slope_times(slope, load, out):
    """OUT out (3, 3): slope (3, r) times a marker's load (3, r) turned over. Nine sums side by side, as none waits for another. O(r)."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(slope.shape[1]):
        load_x, load_y, load_z = load[0, i], load[1, i], load[2, i]
        xx += slope[0, i] * load_x
        xy += slope[0, i] * load_y
        xz += slope[0, i] * load_z
        yx += slope[1, i] * load_x
        yy += slope[1, i] * load_y
        yz += slope[1, i] * load_z
        zx += slope[2, i] * load_x
        zy += slope[2, i] * load_y
        zz += slope[2, i] * load_z
    out[0, 0], out[0, 1], out[0, 2] = xx, xy, xz
    out[1, 0], out[1, 1], out[1, 2] = yx, yy, yz
    out[2, 0], out[2, 1], out[2, 2] = zx, zy, zz


@kernel
def _predicted(body, k, m, workspace, centre):
    """Where the latents put a marker. OUT centre (3,), whitened. O(r)."""
    x, y, z = 0.0, 0.0, 0.0
    for i in range(len(workspace.latent)):
        x += body.load[k, m, 0, i] * workspace.latent[i]
        y += body.load[k, m, 1, i] * workspace.latent[i]
        z += body.load[k, m, 2, i] * workspace.latent[i]
    centre[0], centre[1], centre[2] = x, y, z


@kernel
def _without_marker(body, k, m, workspace, inverse, shift):
    """What changes for all predictions if a labelled marker says nothing of the body, after `posterior`.

    OUT inverse (6,): (I - H)^-1, H = load covariance load', xx, xy, xz, yy, yz, zz; shift (3,): that times the marker's residual from its
    prediction; workspace.slope. O(r^2).
    """
    h, error = np.empty((3, 3)), np.empty(3)
    _slope(body, k, m, workspace)
    _slope_times(workspace.slope, body.load[k, m], h)
    _predicted(body, k, m, workspace, error)
    for a in range(3):
        error[a] = workspace.residual[m, a] - error[a]
    left = (1.0 - h[0, 0], -h[0, 1], -h[0, 2], 1.0 - h[1, 1], -h[1, 2], 1.0 - h[2, 2])
    _, xx, xy, xz, yy, yz, zz = symmetric_inverse(left)
    inverse[0], inverse[1], inverse[2], inverse[3], inverse[4], inverse[5] = xx, xy, xz, yy, yz, zz
    shift[0] = xx * error[0] + xy * error[1] + xz * error[2]
    shift[1] = xy * error[0] + yy * error[1] + yz * error[2]
    shift[2] = xz * error[0] + yz * error[1] + zz * error[2]


@kernel
def _score_at(body, k, m, point, centre, covariance, settings):
    """The score of a placed point as a marker that is predicted at `centre` (3,) with this covariance (6,), both whitened. Returns nats."""
    w, s, mean = body.whiten[k, m], body.spread[k, m], body.mean[k, m]
    dx, dy, dz = point[0] - mean[0], point[1] - mean[1], point[2] - mean[2]
    away_x = dx - s[0, 0] * centre[0]
    away_y = dy - s[1, 0] * centre[0] - s[1, 1] * centre[1]
    away_z = dz - s[2, 0] * centre[0] - s[2, 1] * centre[1] - s[2, 2] * centre[2]
    near2 = away_x * away_x + away_y * away_y + away_z * away_z
    if near2 > MAX_DISTANCE * MAX_DISTANCE:
        return -np.inf
    x = w[0, 0] * dx + w[0, 1] * dy + w[0, 2] * dz - centre[0]
    y = w[1, 0] * dx + w[1, 1] * dy + w[1, 2] * dz - centre[1]
    z = w[2, 0] * dx + w[2, 1] * dy + w[2, 2] * dz - centre[2]
    det, xx, xy, xz, yy, yz, zz = symmetric_inverse(covariance)
    square = x * (xx * x + 2.0 * (xy * y + xz * z)) + y * (yy * y + 2.0 * yz * z) + z * zz * z
    score = body.log_scale[k, m] - 1.5 * LOG_2PI + settings.reward - 0.5 * (math.log(max(det, 1e-9)) + square)
    if score < settings.outlier_score and near2 < settings.outlier_radius * settings.outlier_radius:
        return settings.outlier_score
    return score


@kernel
def score_held_points(body, k, point_of, least, settings, workspace, scores):
    """Score the points that labelled markers hold as every hidden marker, given all other labelled points, after `rescore`.

    `leave_one_out_scores` predicts a hidden marker from all labelled points. A point that is scored as this marker must not be one of them:
    under its present label it has drawn the body towards itself.
    IN     as `leave_one_out_scores`; only what scores above `least` nats is scored anew; outliers have drawn nothing
    IN/OUT scores (M, n) nats
    O(M r^2 + hidden (r^2 + n r)).
    """
    markers, hidden = body.load.shape[1], 0
    for m in range(markers):
        hidden += point_of[m] < 0
    if hidden == 0:
        return
    inverses, shifts = np.empty((markers, 6)), np.empty((markers, 3))
    own, cross, part = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    centre, at, spread = np.empty(3), np.empty(3), np.empty(6)
    for o in range(markers):
        if point_of[o] >= 0 and not workspace.outlier[o]:
            _without_marker(body, k, o, workspace, inverses[o], shifts[o])
    for m in range(markers):
        if point_of[m] >= 0:
            continue
        _slope(body, k, m, workspace)
        _slope_times(workspace.slope, body.load[k, m], own)
        _predicted(body, k, m, workspace, centre)
        for o in range(markers):
            c = point_of[o]
            if c < 0 or workspace.outlier[o] or scores[m, c] <= least:
                continue
            _slope_times(workspace.slope, body.load[k, o], cross)
            v, entry = inverses[o], 0
            for a in range(3):
                part[a, 0] = cross[a, 0] * v[0] + cross[a, 1] * v[1] + cross[a, 2] * v[2]
                part[a, 1] = cross[a, 0] * v[1] + cross[a, 1] * v[3] + cross[a, 2] * v[4]
                part[a, 2] = cross[a, 0] * v[2] + cross[a, 1] * v[4] + cross[a, 2] * v[5]
                at[a] = centre[a] - cross[a, 0] * shifts[o, 0] - cross[a, 1] * shifts[o, 1] - cross[a, 2] * shifts[o, 2]
            for a in range(3):
                for b in range(a, 3):
                    spread[entry] = (1.0 if a == b else 0.0) + own[a, b]
                    spread[entry] += part[a, 0] * cross[b, 0] + part[a, 1] * cross[b, 1] + part[a, 2] * cross[b, 2]
                    entry += 1
            scores[m, c] = _score_at(body, k, m, workspace.aligned[c], at, spread, settings)


@kernel
def best_pose(body, points, point_of, settings, workspace):
    """The key pose under which a labelling scores best, and that score.

    IN as `evidence`. Returns (k, nats). O(K) calls of `evidence`.
    """
    best, best_score = 0, -np.inf
    for k in range(len(body.log_weight)):
        score = evidence(body, k, points, point_of, settings, workspace)
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
    posterior(workspace)
    leave_one_out_scores(body, k, point_of, settings, workspace)
    changed = False
    for m in range(len(point_of)):
        is_outlier = point_of[m] >= 0 and workspace.scores[m, point_of[m]] <= settings.outlier_score
        if is_outlier != workspace.outlier[m]:
            workspace.outlier[m] = is_outlier
            changed = True
    if changed:
        score = evidence(body, k, points, point_of, settings, workspace)
        posterior(workspace)
        leave_one_out_scores(body, k, point_of, settings, workspace)
    return score
