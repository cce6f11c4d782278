"""How well the motions of several limbs carry each point, on flat arrays. Twin: tests/twins_motion.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.motion.rigid._kernels import point_spread


@kernel
def stray_from_motions(positions, rotations, translations, out):
    """How far each point strays from its own mean place in the axes of each limb.

    IN  positions (T, N, 3) m, NaN for missing; rotations (L, T, 3, 3), translations (L, T, 3) m, NaN where a limb's motion is missing
    OUT out (N, L) m, root of the mean squared distance; infinite where a point and a limb share fewer than two frames
    O(L T N), no memory beside the result.
    """
    points = positions.shape[1]
    means, squares, counts = np.empty((points, 3)), np.empty(points), np.empty(points, dtype=np.int64)
    for limb in range(len(rotations)):
        point_spread(positions, rotations[limb], translations[limb], means, squares, counts)
        for n in range(points):
            # One frame says nothing of straying; infinite keeps the point from this limb.
            out[n, limb] = math.sqrt(squares[n]) if counts[n] > 1 else np.inf
