"""Plain twins of the geometry kernels: NumPy's solvers and loops over groups, nothing clever."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def cofactors(matrix):
    """Determinant and upper cofactors of a 3 x 3 matrix by their definition: signed determinants of what a row and a column leave."""
    parts = [(-1) ** (i + j) * np.linalg.det(np.delete(np.delete(matrix, j, axis=0), i, axis=1)) for i in range(3) for j in range(i, 3)]
    return (np.linalg.det(matrix), *parts)


def nearest_to_rays(origins, rays):
    """The point with the least sum of squared distances to rays: each gives three equations."""
    a = np.concatenate([np.eye(3) - np.outer(d, d) for d in rays])
    b = np.concatenate([(np.eye(3) - np.outer(d, d)) @ o for o, d in zip(origins, rays, strict=True)])
    return np.linalg.lstsq(a, b, rcond=None)[0]


def where_lines_approach(d, e, o):
    """The multiples of d and e whose ends, from 0 and from o, are nearest to each other."""
    return np.linalg.lstsq(np.stack([d, -e], axis=1), o, rcond=None)[0]


def rotate_by(rotation, vector, own_axes):
    step = Rotation.from_rotvec(vector).as_matrix()
    return rotation @ step if own_axes else step @ rotation


def fit_about_z(points, targets):
    """The turn about z and the two centres that lay points on targets: Procrustes by SVD in the plane."""
    here, there = points.mean(axis=0), targets.mean(axis=0)
    u, _, v = np.linalg.svd((targets - there)[:, :2].T @ (points - here)[:, :2])
    turn = np.eye(3)
    turn[:2, :2] = u @ np.diag([1.0, np.linalg.det(u @ v)]) @ v
    return turn, here, there


def best_rotation_by_quaternion(points, targets):
    """Horn 1987: the rotation that lays centred points on centred targets is the greatest eigenvector of a 4 x 4 matrix."""
    s = points.T @ targets
    c = np.array([s[1, 2] - s[2, 1], s[2, 0] - s[0, 2], s[0, 1] - s[1, 0]])
    n = np.block([[np.array([[np.trace(s)]]), c[None]], [c[:, None], s + s.T - np.trace(s) * np.eye(3)]])
    w, x, y, z = np.linalg.eigh(n)[1][:, -1]
    return Rotation.from_quat([x, y, z, w]).as_matrix()
