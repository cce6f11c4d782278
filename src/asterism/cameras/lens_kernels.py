"""The camera model on flat arrays: lens distortion, its inverse, projection. Twins: OpenCV, in tests/test_cameras.py.

A lens is one array: (LENS,) = fx, fy, cx, cy (px), p1, p2, k4, k5, k6, then k1, k2, k3 and any further radial coefficients.
k4 to k6 are OpenCV's radial denominator, 0 for the thesis' model.
"""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel

FX, FY, CX, CY, P1, P2, DENOMINATOR, RADIAL = 0, 1, 2, 3, 4, 5, 6, 9
NEWTON_STEPS = 30


@kernel(inline=True)
def _radial(lens, square):
    """The radial factor at r2 = `square`, and its derivative by r2."""
    top, top_slope, power = 1.0, 0.0, 1.0
    for i in range(RADIAL, len(lens)):
        top_slope += (i - RADIAL + 1) * lens[i] * power
        power *= square
        top += lens[i] * power
    a, b, c = lens[DENOMINATOR], lens[DENOMINATOR + 1], lens[DENOMINATOR + 2]
    # The thesis' model has no denominator: the division is spared.
    if a == 0.0 and b == 0.0 and c == 0.0:
        return top, top_slope
    under = 1.0 + square * (a + square * (b + square * c))
    under_slope = a + square * (2.0 * b + square * 3.0 * c)
    return top / under, (top_slope - top / under * under_slope) / under


@kernel(inline=True)
def distorted(lens, x, y):
    """Where the lens puts a point of the normalized plane, and how that moves with it: u, v, du/dx, du/dy, dv/dx, dv/dy.

    IN lens (LENS,); x, y on the normalized plane. O(coefficients).

    Thesis eqs 3.3 and 3.4, with the tangential coefficients in OpenCV's order and sign.
    """
    square = x * x + y * y
    factor, slope = _radial(lens, square)
    p1, p2 = lens[P1], lens[P2]
    u = x * factor + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)
    v = y * factor + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y
    cross = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    return (
        u,
        v,
        factor + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
        cross,
        cross,
        factor + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
    )


@kernel
def project_points(lens, rotation, translation, points, out):
    """Project points into one camera.

    IN  lens (LENS,); rotation (3, 3), translation (3,) m: camera from world; points (n, 3) m
    OUT out (n, 2) px; NaN where the point is NaN, behind the camera, or so far aside that the lens model folds back on itself
    O(n * coefficients), no allocation. Thesis eqs 3.1 to 3.5. Twin: cv2.projectPoints
    """
    for i in range(len(points)):
        out[i, 0] = out[i, 1] = np.nan
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        z = rotation[2, 0] * px + rotation[2, 1] * py + rotation[2, 2] * pz + translation[2]
        if not z > 0.0:
            continue
        x = (rotation[0, 0] * px + rotation[0, 1] * py + rotation[0, 2] * pz + translation[0]) / z
        y = (rotation[1, 0] * px + rotation[1, 1] * py + rotation[1, 2] * pz + translation[1]) / z
        u, v, ux, uy, vx, vy = distorted(lens, x, y)
        # Where the model folds back, one pixel would show two directions.
        if ux * vy - uy * vx > 0.0 and ux + vy > 0.0:
            out[i, 0] = lens[FX] * u + lens[CX]
            out[i, 1] = lens[FY] * v + lens[CY]


@kernel
def undistort_points(lens, pixels, out):
    """The normalized plane's point behind each pixel: the inverse of the lens, by Newton's method.

    IN  lens (LENS,); pixels (n, 2) px
    OUT out (n, 2), x/z and y/z; NaN where the pixel is NaN or the lens model reaches it from nowhere
    O(n * steps * coefficients), no allocation; mostly 3 to 5 steps. Twin: cv2.undistortPoints
    """
    for i in range(len(pixels)):
        out[i, 0] = out[i, 1] = np.nan
        u = (pixels[i, 0] - lens[CX]) / lens[FX]
        v = (pixels[i, 1] - lens[CY]) / lens[FY]
        # NaN would go through all steps.
        if not (math.isfinite(u) and math.isfinite(v)):
            continue
        x, y = u, v
        for _ in range(NEWTON_STEPS):
            gu, gv, ux, uy, vx, vy = distorted(lens, x, y)
            determinant = ux * vy - uy * vx
            if not (determinant > 0.0 and ux + vy > 0.0):
                # Beyond the fold: from nearer the axis the way is monotonous.
                x, y = 0.5 * x, 0.5 * y
                continue
            du, dv = u - gu, v - gv
            step_x, step_y = (vy * du - uy * dv) / determinant, (ux * dv - vx * du) / determinant
            x, y = x + step_x, y + step_y
            # Relative to the place, since wide lenses reach far out.
            if math.fabs(step_x) + math.fabs(step_y) < 1e-14 * (1.0 + math.fabs(x) + math.fabs(y)):
                break
        # The steps may have run out somewhere else: what comes back must be the pixel.
        gu, gv, ux, uy, vx, vy = distorted(lens, x, y)
        if ux * vy - uy * vx > 0.0 and ux + vy > 0.0 and math.fabs(gu - u) + math.fabs(gv - v) < 1e-9:
            out[i, 0], out[i, 1] = x, y


@kernel
def pixel_jacobian(lens, normalised, out):
    """How far a blob moves in the image when its ray does.

    IN  lens (LENS,); normalised (n, 2) undistorted coordinates
    OUT out (n, 4) px: du/dx, du/dy, dv/dx, dv/dy
    O(n), no allocation.
    """
    for i in range(len(normalised)):
        _, _, ux, uy, vx, vy = distorted(lens, normalised[i, 0], normalised[i, 1])
        out[i, 0], out[i, 1] = lens[FX] * ux, lens[FX] * uy
        out[i, 2], out[i, 3] = lens[FY] * vx, lens[FY] * vy
