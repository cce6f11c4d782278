"""Plain twins of the whole-body kernels: full covariances, scipy's densities and loops, nothing clever."""

from __future__ import annotations

import numpy as np
from scipy.stats import multivariate_normal

from asterism.labelling.body._score_kernels import MAX_DISTANCE


def placement(points, rows, mean, markers):
    """The rotation about z and the two centres that bring points[rows] best onto mean[markers] (Procrustes, by SVD in the plane)."""
    here = np.array([points[row] for row in rows if row >= 0])
    there = np.array([mean[m] for m, row in zip(markers, rows, strict=True) if row >= 0])
    a, b = here - here.mean(axis=0), there - there.mean(axis=0)
    u, _, v = np.linalg.svd(b[:, :2].T @ a[:, :2])
    turn = np.eye(3)
    turn[:2, :2] = u @ np.diag([1.0, np.linalg.det(u @ v)]) @ v
    return turn, here.mean(axis=0), there.mean(axis=0)


def place_points(points, rows, mean, markers):
    """All points, placed."""
    turn, here, there = placement(points, rows, mean, markers)
    return (points - here) @ turn.T + there


def coordinates(markers):
    """Places of the markers' coordinates in the flat body."""
    return np.array([3 * m + axis for m in markers for axis in range(3)], dtype=np.int64)


def covariance(model, k):
    """(3M, 3M) m2, of the placed body: latents and noise together, block by block."""
    size = 3 * len(model.mean[k])
    out = np.zeros((size, size))
    for a, one in enumerate(model.load[k]):
        for b, other in enumerate(model.load[k]):
            own = model.noise[k, a] if a == b else 0.0
            out[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] = one @ other.T + own
    return out


def log_density(deviation, spread):
    """Of a normal distribution about 0; 0 for no numbers at all."""
    return multivariate_normal(np.zeros(len(deviation)), spread).logpdf(deviation) if len(deviation) else 0.0


def conditional(joint, wanted, known, deviation):
    """Mean and covariance of the coordinates `wanted`, given those `known` deviate so much."""
    if not len(known):
        return np.zeros(len(wanted)), joint[np.ix_(wanted, wanted)]
    gain = np.linalg.solve(joint[np.ix_(known, known)], joint[np.ix_(known, wanted)]).T
    return gain @ deviation, joint[np.ix_(wanted, wanted)] - gain @ joint[np.ix_(known, wanted)]


def observed(k, points, rows, outlier, model):
    """The markers that say something of the body, and how far they all deviate from the mean: names, flat deviation."""
    aligned = place_points(points, rows, model.mean[k], range(len(rows)))
    markers = [m for m in range(len(rows)) if rows[m] >= 0 and not outlier[m]]
    deviation = [aligned[rows[m]] - model.mean[k, m] for m in markers]
    return markers, np.concatenate(deviation) if markers else np.empty(0)


def evidence(model, k, points, rows, outlier, settings):
    """Joint log density of the placed points, the latents integrated out, and the rewards."""
    markers, deviation = observed(k, points, rows, outlier, model)
    at = coordinates(markers)
    score = model.log_weight[k] + log_density(deviation, covariance(model, k)[np.ix_(at, at)])
    score += settings.reward * len(markers) + settings.outlier_score * sum(outlier[m] for m in range(len(rows)) if rows[m] >= 0)
    return score - settings.first_ghost_cost if sum(row >= 0 for row in rows) < len(points) else score


def posterior(model, k, points, rows, outlier):
    """Mean and covariance of the latents, from their joint distribution with the points."""
    markers, deviation = observed(k, points, rows, outlier, model)
    load = model.load[k].reshape(-1, model.load.shape[3])
    joint = np.block([[covariance(model, k), load], [load.T, np.eye(load.shape[1])]])
    return conditional(joint, len(load) + np.arange(load.shape[1]), coordinates(markers), deviation)


def leave_one_out_scores(model, k, points, rows, outlier, settings):
    """Every point as every marker, each marker predicted from the others' points alone, at most `MAX_DISTANCE` away: (M, n)."""
    aligned = place_points(points, rows, model.mean[k], range(len(rows)))
    out = np.empty((len(rows), len(points)))
    for m in range(len(rows)):
        without = [-1 if other == m else row for other, row in enumerate(rows)]
        markers = [other for other in range(len(rows)) if without[other] >= 0 and not outlier[other]]
        deviation = np.concatenate([np.empty(0), *(aligned[rows[other]] - model.mean[k, other] for other in markers)])
        centre, spread = conditional(covariance(model, k), coordinates([m]), coordinates(markers), deviation)
        for c, point in enumerate(aligned):
            away = point - model.mean[k, m] - centre
            score = settings.reward + log_density(away, spread)
            if np.linalg.norm(away) < settings.outlier_radius:
                score = max(score, settings.outlier_score)
            out[m, c] = score if np.linalg.norm(away) <= MAX_DISTANCE else -np.inf
    return out


def placed_anchor(model, k, points, rows3, triple):
    """All points, placed by an anchor's three, and how far these deviate from a key pose: (n, 3), (9,)."""
    aligned = place_points(points, rows3, model.mean[k], triple)
    return aligned, np.concatenate([aligned[row] - model.mean[k, m] for m, row in zip(triple, rows3, strict=True)])


def anchor_density(model, k, points, rows3, triple):
    """Log density of an anchor's own three points under a key pose, with that pose's weight; and their squared distance."""
    _, deviation = placed_anchor(model, k, points, rows3, triple)
    at = coordinates(triple)
    own = covariance(model, k)[np.ix_(at, at)]
    return model.log_weight[k] + log_density(deviation, own), deviation @ np.linalg.solve(own, deviation)


def score_from_anchor(model, k, points, rows3, triple, settings):
    """Every point as every marker that is not the anchor's, given the anchor's nine coordinates: (M, n), NaN for the anchor's own."""
    aligned, deviation = placed_anchor(model, k, points, rows3, triple)
    out = np.full((len(model.mean[k]), len(points)), np.nan)
    for m in set(range(len(out))) - set(triple.tolist()):
        centre, spread = conditional(covariance(model, k), coordinates([m]), coordinates(triple), deviation)
        for c, point in enumerate(aligned):
            out[m, c] = settings.reward + log_density(point - model.mean[k, m] - centre, spread)
    return out


def assign_greedily(scores, first_ghost):
    """Best pair first. Pairs that score nothing are added only if they leave no point over, and cost less than the first ghost."""

    def best_first(rows, worth):
        free = [
            (scores[m, c], m, c)
            for m in range(len(scores))
            for c in range(scores.shape[1])
            if rows[m] < 0 and c not in rows and worth(scores[m, c])
        ]
        return max(free, default=None)

    gains = [-1] * len(scores)
    while pair := best_first(gains, lambda score: score > 0.0):
        gains[pair[1]] = pair[2]
    complete, paid = list(gains), 0.0
    while pair := best_first(complete, lambda score: score > -first_ghost):
        paid -= pair[0]
        if paid >= first_ghost:
            break
        complete[pair[1]] = pair[2]
    return complete if set(range(scores.shape[1])) <= set(complete) else gains


def assign_unambiguous(scores, gap):
    """Pairs that beat every other pair of their marker and of their point, and null (0), by more than `gap`."""
    rows = [-1] * len(scores)
    for m in range(len(scores)):
        for c in range(scores.shape[1]):
            rivals = [0.0, *np.delete(scores[m], c), *np.delete(scores[:, c], m)]
            if scores[m, c] - max(rivals) > gap:
                rows[m] = c
    return rows
