"""How pixels move with a point, and a point composed from two cameras with its pixels. Twins: tests/test_accuracy.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.cameras.lens_kernels import CX, CY, FX, FY, distorted

STEPS = 20


@kernel(inline=True)
def _seen(lens, rotation, translation, point, pixel, slope):
    """The pixel (2,) of a point (3,) m and how it moves with the point, slope (2, 3) px/m; False where it is behind the camera."""
    z = rotation[2, 0] * point[0] + rotation[2, 1] * point[1] + rotation[2, 2] * point[2] + translation[2]
    if not z > 0.0:
        return False
    x = (rotation[0, 0] * point[0] + rotation[0, 1] * point[1] + rotation[0, 2] * point[2] + translation[0]) / z
    y = (rotation[1, 0] * point[0] + rotation[1, 1] * point[1] + rotation[1, 2] * point[2] + translation[1]) / z
    u, v, ux, uy, vx, vy = distorted(lens, x, y)
    pixel[0], pixel[1] = lens[FX] * u + lens[CX], lens[FY] * v + lens[CY]
    for i in range(3):
        dx, dy = (rotation[0, i] - x * rotation[2, i]) / z, (rotation[1, i] - y * rotation[2, i]) / z
        slope[0, i], slope[1, i] = lens[FX] * (ux * dx + uy * dy), lens[FY] * (vx * dx + vy * dy)
    # Beyond the fold of the lens model no pixel belongs to the point.
    return ux * vy - uy * vx > 0.0 and ux + vy > 0.0


@kernel
def pixel_jacobians(lens, rotation, translation, points, out):
    """How a camera's pixel moves with the point that it shows.

    IN  lens (LENS,); rotation (3, 3), translation (3,) m: camera from world; points (n, 3) m
    OUT out (n, 2, 3) px/m; NaN where the camera cannot see the point
    O(n * coefficients). Thesis eqs 3.1 to 3.5, derived.
    """
    pixel, slope = np.empty(2), np.empty((2, 3))
    for i in range(len(points)):
        # Beforehand, for what the camera cannot see.
        out[i] = np.nan
        if _seen(lens, rotation, translation, points[i], pixel, slope):
            out[i] = slope


@kernel
def one_at_a_time(lens_a, rotation_a, translation_a, lens_b, rotation_b, translation_b, points, shift, out):
    """The 12 one-factor-at-a-time sensitivities of the composition of two cameras.

    Each of the four coordinates is moved by plus and minus `shift` px, the others stay; the point is composed again (least squares of
    the reprojection error in eq. 3.8, Gauss-Newton), and the places are compared.

    IN  lens (LENS,), rotation (3, 3), translation (3,) m of cameras a and b; points (n, 3) m; shift px
    OUT out (n, 3, 4) m: |f(+) - f(-)| per axis and coordinate (xa, ya, xb, yb); NaN where a camera cannot see the point or no place fits
    O(n * steps). Thesis 3.3, "Accuracy and sensitivity".
    """
    truth, pixels, jacobians = np.empty(4), np.empty(4), np.empty((4, 3))
    for i in range(len(points)):
        out[i] = np.nan
        seen = _seen(lens_a, rotation_a, translation_a, points[i], truth[:2], jacobians[:2])
        if not (seen and _seen(lens_b, rotation_b, translation_b, points[i], truth[2:], jacobians[2:])):
            continue
        for moved in range(4):
            ends = np.empty((2, 3))
            for side in range(2):
                aim = truth.copy()
                aim[moved] += shift if side == 0 else -shift
                # From the true place, which is near: the search stays in its own valley.
                place = points[i].copy()
                for _ in range(STEPS):
                    seen = _seen(lens_a, rotation_a, translation_a, place, pixels[:2], jacobians[:2])
                    if not (seen and _seen(lens_b, rotation_b, translation_b, place, pixels[2:], jacobians[2:])):
                        place[:] = np.nan
                        break
                    normal, right = jacobians.T @ jacobians, jacobians.T @ (aim - pixels)
                    # Rays that are nearly parallel determine no place.
                    if abs(np.linalg.det(normal)) < 1e-12 * max(np.trace(normal), 1e-300) ** 3:
                        place[:] = np.nan
                        break
                    step = np.linalg.solve(normal, right)
                    place += step
                    if math.sqrt(step @ step) < 1e-12:
                        break
                ends[side] = place
            for axis in range(3):
                out[i, axis, moved] = abs(ends[0, axis] - ends[1, axis])
