"""Plain twins of the kernels of limbs' motion: slow, obvious, and what the kernels must equal."""

from __future__ import annotations

import numpy as np


def fit_frame(template, points, weights):
    """Kabsch by the textbook: the singular value decomposition of the weighted covariance, with the determinant."""
    seen = np.isfinite(points).all(axis=1) & np.isfinite(template).all(axis=1) & (weights > 0)
    if seen.sum() < 3:
        return np.full((3, 3), np.nan), np.full(3, np.nan)
    p, x, w = template[seen], points[seen], weights[seen]
    here, there = w @ p / w.sum(), w @ x / w.sum()
    u, _, vt = np.linalg.svd((w[:, None] * (x - there)).T @ (p - here))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return rotation, there - rotation @ here


def local_positions(positions, rotations, translations):
    """R'(x - t), one point at a time."""
    return np.array([[r.T @ (x - t) for x in frame] for frame, r, t in zip(positions, rotations, translations, strict=True)])


def point_spread(positions, rotations, translations):
    """Mean place of each point in the limb's axes, mean squared distance from it, and frames."""
    local = local_positions(positions, rotations, translations)
    means, squares, counts = [], [], []
    for n in range(local.shape[1]):
        own = local[np.isfinite(local[:, n]).all(axis=1), n]
        means.append(own.mean(axis=0) if len(own) else np.full(3, np.nan))
        squares.append(((own - own.mean(axis=0)) ** 2).sum(axis=1).mean() if len(own) else np.nan)
        counts.append(len(own))
    return np.array(means), np.array(squares), np.array(counts)


def inertia(points, weights):
    """Eigenvalues of the weighted inertia tensor about the weighted mean."""
    seen = weights > 0
    p, w = points[seen], weights[seen]
    p = p - w @ p / w.sum()
    tensor = sum(wi * (pi @ pi * np.eye(3) - np.outer(pi, pi)) for wi, pi in zip(w, p, strict=True))
    return np.linalg.eigvalsh(tensor)
