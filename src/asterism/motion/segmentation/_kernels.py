"""How well the motions of several limbs carry each point, on flat arrays. Twin: tests/twins_motion.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel


@kernel
def stray_from_motions(positions, rotations, translations, out):
    """How far each point strays from its own mean place in the axes of each limb.

    IN  positions (T, N, 3) m, NaN for missing; rotations (L, T, 3, 3), translations (L, T, 3) m, NaN where a limb's motion is missing
    OUT out (N, L) m, root of the mean squared distance; infinite where a point and a limb share fewer than two frames
    O(L T N), no memory beside the result.
    """
    limbs, frames, points = len(rotations), positions.shape[0], positions.shape[1]
    means, squares, counts = np.empty((points, 3)), np.empty(points), np.empty(points, dtype=np.int64)
    for limb in range(limbs):
        means[:] = 0.0
        squares[:] = 0.0
        counts[:] = 0
        for t in range(frames):
            r, s = rotations[limb, t], translations[limb, t]
            # The limb's motion is not known here.
            if math.isnan(r[0, 0]):
                continue
            for n in range(points):
                x, y, z = positions[t, n, 0] - s[0], positions[t, n, 1] - s[1], positions[t, n, 2] - s[2]
                if math.isnan(x):
                    continue
                counts[n] += 1
                for i in range(3):
                    local = r[0, i] * x + r[1, i] * y + r[2, i] * z
                    step = local - means[n, i]
                    means[n, i] += step / counts[n]
                    squares[n] += step * (local - means[n, i])
        for n in range(points):
            # One frame has no spread: it would be the steadiest of all.
            out[n, limb] = math.sqrt(squares[n] / counts[n]) if counts[n] > 1 else np.inf
