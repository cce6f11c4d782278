"""Bundle adjustment on flat arrays: residuals, their Jacobians, the normal equations with each frame's object eliminated.

A camera has PARAMETERS of them: a small turn and a small shift of its axes (rad, m), fx (px; fy follows with the aspect), aspect fy / fx,
cx, cy (px), k1, k2, k3, p1, p2. An object has six: a small turn about its own axes (rad) and a shift in the world (m).
"""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.cameras._kernels import CX, CY, DENOMINATOR, FX, FY, distorted
from asterism.geometry._kernels import rotate_by

PARAMETERS = 15
FOCAL, ASPECT, CENTRE, K1, TANGENTIAL = 6, 7, 8, 10, 13
HUBER, CAUCHY = 0, 1
BEHIND = 1e4
"""px, the residual of a point behind its camera: a step that moves one there is no step down."""


@kernel
def project_with_derivatives(lens, rotation, translation, point, pixel, by_camera, by_point):
    """Where a camera sees a point of the world, and how that moves with the camera and with the point.

    IN  lens (LENS,) with at least k1 to k3; rotation (3, 3), translation (3,) m; point (3,) m
    OUT pixel (2,) px; by_camera (2, PARAMETERS); by_point (2, 3) px/m. Returns False, and writes nothing, behind the camera
    O(coefficients), no allocation. Thesis eqs 3.1 to 3.5. Twin: finite differences
    """
    ax = rotation[0, 0] * point[0] + rotation[0, 1] * point[1] + rotation[0, 2] * point[2]
    ay = rotation[1, 0] * point[0] + rotation[1, 1] * point[1] + rotation[1, 2] * point[2]
    az = rotation[2, 0] * point[0] + rotation[2, 1] * point[1] + rotation[2, 2] * point[2]
    z = az + translation[2]
    if not z > 1e-6:
        return False
    x, y = (ax + translation[0]) / z, (ay + translation[1]) / z
    u, v, ux, uy, vx, vy = distorted(lens, x, y)
    fx, fy = lens[FX], lens[FY]
    pixel[0] = fx * u + lens[CX]
    pixel[1] = fy * v + lens[CY]
    for i in range(2):
        f = fx if i == 0 else fy
        dx, dy = (ux, uy) if i == 0 else (vx, vy)
        # by the point in the camera's axes
        cx, cy, cz = f * dx / z, f * dy / z, -f * (dx * x + dy * y) / z
        by_camera[i, 0] = cz * ay - cy * az
        by_camera[i, 1] = cx * az - cz * ax
        by_camera[i, 2] = cy * ax - cx * ay
        by_camera[i, 3], by_camera[i, 4], by_camera[i, 5] = cx, cy, cz
        for j in range(3):
            by_point[i, j] = cx * rotation[0, j] + cy * rotation[1, j] + cz * rotation[2, j]
    square = x * x + y * y
    under = 1.0 + square * (lens[DENOMINATOR] + square * (lens[DENOMINATOR + 1] + square * lens[DENOMINATOR + 2]))
    by_camera[0, FOCAL], by_camera[1, FOCAL] = u, v * fy / fx
    by_camera[0, ASPECT], by_camera[1, ASPECT] = 0.0, v * fx
    by_camera[0, CENTRE], by_camera[1, CENTRE] = 1.0, 0.0
    by_camera[0, CENTRE + 1], by_camera[1, CENTRE + 1] = 0.0, 1.0
    power = 1.0
    for k in range(3):
        power *= square
        by_camera[0, K1 + k], by_camera[1, K1 + k] = fx * x * power / under, fy * y * power / under
    by_camera[0, TANGENTIAL], by_camera[1, TANGENTIAL] = fx * 2.0 * x * y, fy * (square + 2.0 * y * y)
    by_camera[0, TANGENTIAL + 1], by_camera[1, TANGENTIAL + 1] = fx * (square + 2.0 * x * x), fy * 2.0 * x * y
    return True


@kernel(inline=True)
def _loss(kind, scale, size):
    """Cost and weight of a residual of this size, both px: Huber, or Cauchy which forgets what is far off."""
    if kind == HUBER:
        if size <= scale:
            return 0.5 * size * size, 1.0
        return scale * (size - 0.5 * scale), scale / size
    part = size / scale
    return 0.5 * scale * scale * math.log1p(part * part), 1.0 / (1.0 + part * part)


@kernel
def residuals_and_cost(
    lens, rotation, translation, turned, placed, template, frame, camera, point, xy, kind, scale, relative, residuals, weights
):  # fmt: skip
    """What each sighting misses, and the sum of the losses.

    IN  lens (C, LENS), rotation (C, 3, 3), translation (C, 3) m; turned (T, 3, 3), placed (T, 3) m: world from object; template (K, 3) m;
        frame, camera, point (n,) and xy (n, 2) px of each sighting; kind and scale (px) of the loss; relative (C,): each camera's noise,
        residuals count divided by it
    OUT residuals (n, 2) px, seen minus projected, NaN behind a camera; weights (n,). Returns the cost, px2
    O(n * coefficients), no allocation. Twin: Camera.project
    """
    cost = 0.0
    for i in range(len(frame)):
        t, c, k = frame[i], camera[i], point[i]
        wx = turned[t, 0, 0] * template[k, 0] + turned[t, 0, 1] * template[k, 1] + turned[t, 0, 2] * template[k, 2] + placed[t, 0]
        wy = turned[t, 1, 0] * template[k, 0] + turned[t, 1, 1] * template[k, 1] + turned[t, 1, 2] * template[k, 2] + placed[t, 1]
        wz = turned[t, 2, 0] * template[k, 0] + turned[t, 2, 1] * template[k, 1] + turned[t, 2, 2] * template[k, 2] + placed[t, 2]
        r = rotation[c]
        z = r[2, 0] * wx + r[2, 1] * wy + r[2, 2] * wz + translation[c, 2]
        if not z > 1e-6:
            residuals[i, 0] = residuals[i, 1] = np.nan
            weights[i] = 0.0
            cost += _loss(kind, scale, BEHIND)[0]
            continue
        x = (r[0, 0] * wx + r[0, 1] * wy + r[0, 2] * wz + translation[c, 0]) / z
        y = (r[1, 0] * wx + r[1, 1] * wy + r[1, 2] * wz + translation[c, 1]) / z
        u, v, _, _, _, _ = distorted(lens[c], x, y)
        residuals[i, 0] = xy[i, 0] - lens[c, FX] * u - lens[c, CX]
        residuals[i, 1] = xy[i, 1] - lens[c, FY] * v - lens[c, CY]
        loss, weight = _loss(kind, scale, math.sqrt(residuals[i, 0] ** 2 + residuals[i, 1] ** 2) / relative[c])
        weights[i] = weight / relative[c] ** 2
        cost += loss
    return cost


@kernel
def linearise(
    lens, rotation, translation, turned, placed, template, starts, camera, point, residuals, weights, columns, axes, damping,
    blocks, gradient, reduced, factors, shifted,
):  # fmt: skip
    """The damped normal equations of all cameras, and of each frame's object with the object already eliminated (Schur complement).

    IN  as residuals_and_cost, sightings sorted by frame with starts (T + 1,); residuals (n, 2) px and weights (n,) of it;
        columns (C, PARAMETERS): the unknown's place, -1 where it is fixed; axes (D,): which of an object's six parameters are free;
        damping: Levenberg-Marquardt's, a share of the diagonal
    OUT blocks (C, PARAMETERS, PARAMETERS) and gradient (n_free,): the cameras' own; with V = F F' the damped matrix of a frame's object,
        reduced (T, D, n_free) = F^-1 W', shifted (T, D) = F^-1 g, factors (T, D, D) = F. Those of the objects must come as zeros
    O(n * free * (free + D) + T * D^2 * n_free). Levenberg 1944, Marquardt 1963; Schur as in Triggs et al. 2000. Twin: dense least squares
    """
    unknowns = reduced.shape[2]
    dof = len(axes)
    by_camera, by_point, pixel, world = np.empty((2, PARAMETERS)), np.empty((2, 3)), np.empty(2), np.empty(3)
    by_object, local, wanted = np.empty((2, 6)), np.empty((2, PARAMETERS)), np.empty(PARAMETERS, np.int64)
    for t in range(len(starts) - 1):
        turn = turned[t]
        v, g, w = factors[t], shifted[t], reduced[t]
        for i in range(starts[t], starts[t + 1]):
            if weights[i] == 0.0:
                continue
            c, model = camera[i], template[point[i]]
            for j in range(3):
                world[j] = turn[j, 0] * model[0] + turn[j, 1] * model[1] + turn[j, 2] * model[2] + placed[t, j]
            if not project_with_derivatives(lens[c], rotation[c], translation[c], world, pixel, by_camera, by_point):
                continue
            for e in range(2):
                # by a turn of the object about its own axes: -turn [model]x
                o0 = by_point[e, 0] * turn[0, 0] + by_point[e, 1] * turn[1, 0] + by_point[e, 2] * turn[2, 0]
                o1 = by_point[e, 0] * turn[0, 1] + by_point[e, 1] * turn[1, 1] + by_point[e, 2] * turn[2, 1]
                o2 = by_point[e, 0] * turn[0, 2] + by_point[e, 1] * turn[1, 2] + by_point[e, 2] * turn[2, 2]
                by_object[e, 0] = o2 * model[1] - o1 * model[2]
                by_object[e, 1] = o0 * model[2] - o2 * model[0]
                by_object[e, 2] = o1 * model[0] - o0 * model[1]
                by_object[e, 3], by_object[e, 4], by_object[e, 5] = by_point[e, 0], by_point[e, 1], by_point[e, 2]
            free = 0
            for p in range(PARAMETERS):
                if columns[c, p] >= 0:
                    wanted[free] = p
                    local[0, free], local[1, free] = by_camera[0, p], by_camera[1, p]
                    free += 1
            weight = weights[i]
            r0, r1 = weight * residuals[i, 0], weight * residuals[i, 1]
            for a in range(free):
                j0, j1 = weight * local[0, a], weight * local[1, a]
                gradient[columns[c, wanted[a]]] += local[0, a] * r0 + local[1, a] * r1
                block = blocks[c, wanted[a]]
                for b in range(a, free):
                    block[wanted[b]] += j0 * local[0, b] + j1 * local[1, b]
            for d in range(dof):
                o0, o1 = by_object[0, axes[d]], by_object[1, axes[d]]
                g[d] += o0 * r0 + o1 * r1
                o0, o1 = weight * o0, weight * o1
                for e in range(d + 1):
                    v[d, e] += o0 * by_object[0, axes[e]] + o1 * by_object[1, axes[e]]
                line = w[d]
                for a in range(free):
                    line[columns[c, wanted[a]]] += o0 * local[0, a] + o1 * local[1, a]
        for d in range(dof):
            v[d, d] = v[d, d] * (1.0 + damping) + 1e-12
        for d in range(dof):
            for e in range(d):
                entry = v[d, e]
                for k in range(e):
                    entry -= v[d, k] * v[e, k]
                v[d, e] = entry / v[e, e]
                g[d] -= v[d, e] * g[e]
                for a in range(unknowns):
                    w[d, a] -= v[d, e] * w[e, a]
            entry = v[d, d]
            for k in range(d):
                entry -= v[d, k] * v[d, k]
            v[d, d] = math.sqrt(max(entry, 1e-12))
            g[d] /= v[d, d]
            for a in range(unknowns):
                w[d, a] /= v[d, d]
    for c in range(len(blocks)):
        for p in range(PARAMETERS):
            for q in range(p):
                blocks[c, p, q] = blocks[c, q, p]


@kernel
def move_objects(turned, placed, factors, remaining, axes):
    """Solve each frame's object for its step and take it.

    IN  factors (T, D, D), remaining (T, D): F^-1 (g - W' times the cameras' step)
    OUT turned (T, 3, 3) and placed (T, 3) m, in place. Returns the largest shift, m
    """
    dof, largest = len(axes), 0.0
    step = np.zeros(6)
    for t in range(len(placed)):
        step[:] = 0.0
        for d in range(dof - 1, -1, -1):
            entry = remaining[t, d]
            for e in range(d + 1, dof):
                entry -= factors[t, e, d] * step[axes[e]]
            step[axes[d]] = entry / factors[t, d, d]
        rotate_by(turned[t], step[0], step[1], step[2], True)
        for j in range(3):
            placed[t, j] += step[3 + j]
            largest = max(largest, abs(step[3 + j]))
    return largest
