"""Anchors: the points of three markers in; scores of every point as every other marker out.

The plain twins are in `tests/twins_body.py`.
"""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel
from asterism.geometry._kernels import align_about_z, fit_about_z
from asterism.labelling.body._workspace_kernels import LOG_2PI


@kernel
def _anchor_displacement(model, a, k, points, anchor_points, workspace):
    """How far an anchor's points lie from its markers in a key pose, once placed onto them.

    IN   model FrameModel; a anchor; k key pose; points (n, 3) m; anchor_points (3,) points of the anchor's markers
    OUT  workspace.displacement. Returns its squared Mahalanobis distance. O(81).
    """
    anchors, body, delta = model.anchors, model.body, workspace.displacement
    cos, sin, here, there = fit_about_z(points, anchor_points, body.mean[k], anchors.markers[a])
    for i in range(3):
        m, row = anchors.markers[a, i], anchor_points[i]
        x, y = points[row, 0] - here[0], points[row, 1] - here[1]
        delta[3 * i] = cos * x - sin * y + there[0] - body.mean[k, m, 0]
        delta[3 * i + 1] = sin * x + cos * y + there[1] - body.mean[k, m, 1]
        delta[3 * i + 2] = points[row, 2] - here[2] + there[2] - body.mean[k, m, 2]
    distance = 0.0
    for i in range(9):
        total = 0.5 * anchors.precision[k, a, i, i] * delta[i]
        for j in range(i):
            total += anchors.precision[k, a, i, j] * delta[j]
        distance += 2.0 * total * delta[i]
    return distance


@kernel(inline=True)
def anchor_key_pose(model, a, points, anchor_points, workspace):
    """The key pose that fits an anchor's own points best: (k, log density in nats, squared Mahalanobis distance).

    IN   model FrameModel; a anchor; points (n, 3) m; anchor_points (3,). OUT workspace.displacement is overwritten. O(81 K).
    """
    best, best_log, best_distance = 0, -np.inf, np.inf
    for k in range(len(model.body.log_weight)):
        distance = _anchor_displacement(model, a, k, points, anchor_points, workspace)
        log_density = model.anchors.log_peak[k, a] - 0.5 * distance
        if log_density > best_log:
            best, best_log, best_distance = k, log_density, distance
    return best, best_log, best_distance


@kernel
def score_from_anchor(model, a, k, points, anchor_points, workspace):
    """Score every point as every marker from an anchor alone.

    The anchor's own markers score 50 nats for their points, and -inf for all others.
    IN   model FrameModel; a anchor; k key pose; points (n, 3) m; anchor_points (3,) points of the anchor's markers
    OUT  workspace.scores (M, n) nats, -inf where the point is too far to score above 0; workspace.aligned. O(M n).
    """
    anchors, body, delta = model.anchors, model.body, workspace.displacement
    markers, n = body.load.shape[1], len(points)
    _anchor_displacement(model, a, k, points, anchor_points, workspace)
    align_about_z(points, anchor_points, body.mean[k], anchors.markers[a], workspace.aligned)
    for m in range(markers):
        mx, my, mz = body.mean[k, m, 0], body.mean[k, m, 1], body.mean[k, m, 2]
        for i in range(9):
            mx += anchors.gain[k, a, m, 0, i] * delta[i]
            my += anchors.gain[k, a, m, 1, i] * delta[i]
            mz += anchors.gain[k, a, m, 2, i] * delta[i]
        w = anchors.whiten[k, a, m]
        base = anchors.log_scale[k, a, m] - 1.5 * LOG_2PI + model.settings.reward
        # no score above 0 beyond sqrt(2 base) standard deviations
        reach2 = 2.0 * max(base, 0.0) * anchors.max_variance[k, a, m]
        for c in range(n):
            dx, dy, dz = workspace.aligned[c, 0] - mx, workspace.aligned[c, 1] - my, workspace.aligned[c, 2] - mz
            if dx * dx + dy * dy + dz * dz > reach2:
                workspace.scores[m, c] = -np.inf
                continue
            x = w[0, 0] * dx
            y = w[1, 0] * dx + w[1, 1] * dy
            z = w[2, 0] * dx + w[2, 1] * dy + w[2, 2] * dz
            workspace.scores[m, c] = base - 0.5 * (x * x + y * y + z * z)
    for i in range(3):
        m = anchors.markers[a, i]
        for c in range(n):
            workspace.scores[m, c] = -np.inf
        workspace.scores[m, anchor_points[i]] = 50.0
