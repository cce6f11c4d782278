"""Lines in; the points that are nearest to several of them out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from asterism.geometry import shared_kernels

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_PARALLEL = 1e-10
"""Of the normal equations' determinant per cubed number of rays: rays below it count as parallel."""


def intersect_rays(origins: Floats, directions: Floats, starts: Ints) -> Floats:
    """For each group of rays the point nearest to all of them, by least squares of the distances: (m, 3) m.

    origins (n, 3) m; directions (n, 3) of length 1, NaN for a ray that does not count; starts (m + 1,): group g is rows starts[g] to
    starts[g + 1]. NaN where fewer than two rays count or all are parallel. O(n).

    >>> origins = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])  # two cameras see one marker
    >>> directions = np.array([[0.6, 0.8, 0.0], [-0.6, 0.8, 0.0]])
    >>> intersect_rays(origins, directions, np.array([0, 2])).round(4) + 0.0
    array([[1.    , 1.3333, 0.    ]])
    """
    out = np.empty((len(starts) - 1, 3))
    shared_kernels.intersect_rays(np.ascontiguousarray(origins), np.ascontiguousarray(directions), starts, _PARALLEL, out)
    return out


def nearest_point_to_lines(origins: Floats, directions: Floats) -> Floats:
    """(3,) m: the point nearest to all lines, given by origins (n, 3) m and directions (n, 3) of length 1, by least squares.

    Of parallel lines it is the best point that is nearest to the world's origin.

    >>> origins = np.array([[0.0, 0.0, 1.0], [2.0, 0.0, 0.0]])
    >>> directions = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> nearest_point_to_lines(origins, directions).round(6) + 0.0
    array([2., 0., 1.])
    """
    # What is left of each direction across the line: its distance from a point squares with it.
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    # Least squares give the smallest solution where the lines are parallel.
    point: Floats = np.linalg.lstsq(across.sum(axis=0), np.einsum("cij,cj->i", across, origins), rcond=None)[0]
    return point
