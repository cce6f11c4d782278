"""Rotation vectors, rotation matrices, and the rotation that makes a vertical the z axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

_STRAIGHT_DOWN = -1.0 + 1e-12
"""A vertical whose z is at most this counts as -z, for which the shortest rotation has no unique axis."""


def rotation_from_vector(vector: ArrayLike) -> Floats:
    """The rotation matrix (3, 3) of a rotation vector (3,) rad: its direction is the axis, its length the angle (Rodrigues).

    >>> quarter = rotation_from_vector(np.array([0.0, 0.0, np.pi / 2]))
    >>> (quarter @ np.array([1.0, 0.0, 0.0])).round(6) + 0.0
    array([0., 1., 0.])
    """
    from scipy.spatial.transform import Rotation

    matrix: Floats = Rotation.from_rotvec(np.asarray(vector, dtype=np.float64).ravel()).as_matrix()
    return matrix


def vector_from_rotation(matrix: ArrayLike) -> Floats:
    """The rotation vector (3,) rad, of length 0 to pi, of a rotation matrix (3, 3).

    >>> vector_from_rotation(rotation_from_vector(np.array([0.0, 0.3, 0.0]))).round(6) + 0.0
    array([0. , 0.3, 0. ])
    """
    from scipy.spatial.transform import Rotation

    vector: Floats = Rotation.from_matrix(np.asarray(matrix, dtype=np.float64)).as_rotvec()
    return vector


def nearest_orthogonal(matrices: Floats) -> Floats:
    """The orthogonal matrices nearest to matrices (..., 3, 3), by SVD. A matrix with a negative determinant gives a reflection."""
    left, _, right = np.linalg.svd(matrices)
    nearest: Floats = left @ right
    return nearest


def cross_matrix(vector: Floats) -> Floats:
    """(3, 3): the matrix M with M @ other = cross(vector, other).

    >>> cross_matrix(np.array([0.0, 0.0, 1.0])) @ np.array([1.0, 0.0, 0.0])
    array([0., 1., 0.])
    """
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def axis_rotations(axis: str, angles: Floats) -> Floats:
    """The rotations (T, 3, 3) about "x", "y" or "z" by angles (T,) rad, right-handed.

    >>> (axis_rotations("z", np.array([np.pi / 2])) @ np.array([1.0, 0.0, 0.0])).round(6) + 0.0
    array([[0., 1., 0.]])
    """
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    out = np.zeros((len(angles), 3, 3))
    out[:, i, i] = 1.0
    out[:, j, j] = out[:, k, k] = np.cos(angles)
    out[:, k, j] = np.sin(angles)
    out[:, j, k] = -out[:, k, j]
    return out


def z_up_rotation(vertical: Floats) -> Floats:
    """The shortest rotation (3, 3) that takes the unit vector `vertical` (3,) to +z; half a turn about x where it is -z.

    >>> (z_up_rotation(np.array([0.0, 1.0, 0.0])) @ np.array([0.0, 1.0, 0.0])).round(6) + 0.0
    array([0., 0., 1.])
    """
    x, y, z = vertical
    # Half a turn has no unique axis: x is taken.
    if z <= _STRAIGHT_DOWN:
        return np.diag([1.0, -1.0, -1.0])
    under = 1 + z if z > -0.5 else (x * x + y * y) / (1 - z)  # the same number; 1 + z loses its digits near -z
    return np.array([[1 - x * x / under, -x * y / under, -x], [-x * y / under, 1 - y * y / under, -y], [x, y, z]])


def rotate_z_up(points: Floats, vertical: Floats) -> Floats:
    """Points (..., 3) rotated by `z_up_rotation`. Points whose vertical is +z already are returned as they are, not copied."""
    # Most recordings stand along z already, and long ones are large.
    if vertical[2] == 1.0:
        return points
    if vertical[2] <= _STRAIGHT_DOWN:
        return points * np.array([1.0, -1.0, -1.0])
    rotated: Floats = points @ z_up_rotation(vertical).T
    return rotated
