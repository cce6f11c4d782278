"""Bundle adjustment on flat arrays: residuals, their Jacobians, the normal equations with each frame's object eliminated.

A camera has PARAMETERS of them: a small turn and a small shift of its axes (rad, m), fx (px; fy follows with the aspect), aspect fy / fx,
cx, cy (px), k1, k2, k3, p1, p2. An object has six: a small turn about its own axes (rad) and a shift in the world (m).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.cameras.lens_kernels import CX, CY, DENOMINATOR, FX, FY, distorted
from asterism.geometry.shared_kernels import rotate_by

PARAMETERS = 15
FOCAL, ASPECT, CENTRE, K1, TANGENTIAL = 6, 7, 8, 10, 13
HUBER, CAUCHY = 0, 1
BEHIND = 1e4
"""px, the residual of a point behind its camera: a step that moves one there is no step down."""


class BundleCameras(NamedTuple):
    """Cameras: lens (C, LENS), see `cameras.lens_kernels`; rotation (C, 3, 3), translation (C, 3) m: camera from world."""

    lens: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray


class ObjectArrays(NamedTuple):
    """Rigid objects: turned (T, 3, 3), placed (T, 3) m: world from object; template (K, 3) m, the points of all of them."""

    turned: np.ndarray
    placed: np.ndarray
    template: np.ndarray


class SightingArrays(NamedTuple):
    """Sightings by frame: frame, camera, point (n,) and xy (n, 2) px; starts (T + 1,): frame t owns rows starts[t] to starts[t + 1]."""

    frame: np.ndarray
    starts: np.ndarray
    camera: np.ndarray
    point: np.ndarray
    xy: np.ndarray


class Loss(NamedTuple):
    """A robust loss: kind HUBER or CAUCHY, scale px; relative (C,) each camera's noise, by which residuals are divided."""

    kind: int
    scale: float
    relative: np.ndarray


class NormalArrays(NamedTuple):
    """Normal equations of F free camera parameters and T objects of D freedoms.

    blocks (C, PARAMETERS, PARAMETERS), gradient (F,): the cameras' alone. With V = F F' the damped matrix of a frame's object:
    reduced (T, D, F) = F^-1 W', factors (T, D, D) = F, shifted (T, D) = F^-1 g
    """

    blocks: np.ndarray
    gradient: np.ndarray
    reduced: np.ndarray
    factors: np.ndarray
    shifted: np.ndarray


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
    # No image behind the camera, nor in its centre.
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
    # The radial coefficients act on powers of the distance from the axis, over OpenCV's denominator.
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
    # Huber's loss is convex, so that a start far off is led back; Cauchy's forgets what is wrong for good.
    if kind == HUBER:
        if size <= scale:
            return 0.5 * size * size, 1.0
        return scale * (size - 0.5 * scale), scale / size
    part = size / scale
    return 0.5 * scale * scale * math.log1p(part * part), 1.0 / (1.0 + part * part)


@kernel
def residuals_and_cost(cameras, objects, sightings, loss, residuals, weights):
    """What each sighting misses, and the sum of the losses.

    IN  cameras CameraArrays; objects ObjectArrays; sightings SightingArrays; loss Loss
    OUT residuals (n, 2) px, seen minus projected, NaN behind a camera; weights (n,). Returns the cost, px2
    O(n * coefficients), no allocation. Twin: Camera.project
    """
    turned, placed, template, xy = objects.turned, objects.placed, objects.template, sightings.xy
    cost = 0.0
    for i in range(len(sightings.frame)):
        t, c, k = sightings.frame[i], sightings.camera[i], sightings.point[i]
        wx = turned[t, 0, 0] * template[k, 0] + turned[t, 0, 1] * template[k, 1] + turned[t, 0, 2] * template[k, 2] + placed[t, 0]
        wy = turned[t, 1, 0] * template[k, 0] + turned[t, 1, 1] * template[k, 1] + turned[t, 1, 2] * template[k, 2] + placed[t, 1]
        wz = turned[t, 2, 0] * template[k, 0] + turned[t, 2, 1] * template[k, 1] + turned[t, 2, 2] * template[k, 2] + placed[t, 2]
        r, shift, lens = cameras.rotation[c], cameras.translation[c], cameras.lens[c]
        z = r[2, 0] * wx + r[2, 1] * wy + r[2, 2] * wz + shift[2]
        # A high cost, not none: else the cameras would be turned away from what does not fit.
        if not z > 1e-6:
            residuals[i, 0] = residuals[i, 1] = np.nan
            weights[i] = 0.0
            cost += _loss(loss.kind, loss.scale, BEHIND)[0]
            continue
        x = (r[0, 0] * wx + r[0, 1] * wy + r[0, 2] * wz + shift[0]) / z
        y = (r[1, 0] * wx + r[1, 1] * wy + r[1, 2] * wz + shift[1]) / z
        u, v, _, _, _, _ = distorted(lens, x, y)
        residuals[i, 0] = xy[i, 0] - lens[FX] * u - lens[CX]
        residuals[i, 1] = xy[i, 1] - lens[FY] * v - lens[CY]
        # Each camera by its own noise, before the loss decides what is an outlier.
        size = math.sqrt(residuals[i, 0] ** 2 + residuals[i, 1] ** 2) / loss.relative[c]
        share, weight = _loss(loss.kind, loss.scale, size)
        weights[i] = weight / loss.relative[c] ** 2
        cost += share
    return cost


@kernel(inline=True)
def _by_object(turn, model, by_point, by_object):
    """By the world's point (2, 3) px/m to by an object's six parameters, OUT (2, 6): turns about its own axes are -turn [model]x."""
    for e in range(2):
        o0 = by_point[e, 0] * turn[0, 0] + by_point[e, 1] * turn[1, 0] + by_point[e, 2] * turn[2, 0]
        o1 = by_point[e, 0] * turn[0, 1] + by_point[e, 1] * turn[1, 1] + by_point[e, 2] * turn[2, 1]
        o2 = by_point[e, 0] * turn[0, 2] + by_point[e, 1] * turn[1, 2] + by_point[e, 2] * turn[2, 2]
        by_object[e, 0] = o2 * model[1] - o1 * model[2]
        by_object[e, 1] = o0 * model[2] - o2 * model[0]
        by_object[e, 2] = o1 * model[0] - o0 * model[1]
        by_object[e, 3], by_object[e, 4], by_object[e, 5] = by_point[e, 0], by_point[e, 1], by_point[e, 2]


@kernel(inline=True)
def _add_sighting(columns, axes, weight, r0, r1, by_camera, by_object, local, wanted, block, gradient, v, g, w):
    """Add one sighting to the camera's block (PARAMETERS, PARAMETERS) and gradient, and to its object's v (D, D), g (D,), w (D, F).

    IN  columns (PARAMETERS,) of its camera; axes (D,); weight; r0, r1 weighted residual; by_camera (2, PARAMETERS), by_object (2, 6)
    OUT local (2, PARAMETERS), wanted (PARAMETERS,): working memory; block, gradient, v, g, w: added to in place

    Bounds: `free` counts parameters of one camera, PARAMETERS at most.
    """
    free = 0
    for p in range(PARAMETERS):
        # Fixed parameters have no column; the free ones are gathered so that the loops below are dense.
        if columns[p] >= 0:
            wanted[free] = p
            local[0, free], local[1, free] = by_camera[0, p], by_camera[1, p]
            free += 1
    for a in range(free):
        j0, j1 = weight * local[0, a], weight * local[1, a]
        gradient[columns[wanted[a]]] += local[0, a] * r0 + local[1, a] * r1
        row = block[wanted[a]]
        for b in range(a, free):
            row[wanted[b]] += j0 * local[0, b] + j1 * local[1, b]
    for d in range(len(axes)):
        o0, o1 = by_object[0, axes[d]], by_object[1, axes[d]]
        g[d] += o0 * r0 + o1 * r1
        o0, o1 = weight * o0, weight * o1
        # The lower triangle is enough for Cholesky's factor.
        for e in range(d + 1):
            v[d, e] += o0 * by_object[0, axes[e]] + o1 * by_object[1, axes[e]]
        line = w[d]
        for a in range(free):
            line[columns[wanted[a]]] += o0 * local[0, a] + o1 * local[1, a]


@kernel(inline=True)
def _eliminate(v, g, w, damping):
    """An object's matrix v (D, D), damped, to its Cholesky factor F; g (D,) to F^-1 g and w (D, n_free) to F^-1 w, all in place."""
    dof, unknowns = w.shape
    for d in range(dof):
        # The addend keeps an object that is hardly seen from having no inverse.
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
        # Rounding may take what is left below zero.
        v[d, d] = math.sqrt(max(entry, 1e-12))
        g[d] /= v[d, d]
        for a in range(unknowns):
            w[d, a] /= v[d, d]


@kernel
def linearise(cameras, objects, sightings, residuals, weights, columns, axes, damping, out):
    """The damped normal equations of all cameras, and of each frame's object with the object already eliminated (Schur complement).

    IN  cameras CameraArrays; objects ObjectArrays; sightings SightingArrays; residuals (n, 2) px and weights (n,) of
        `residuals_and_cost`; columns (C, PARAMETERS): the unknown's place, -1 where it is fixed; axes (D,): which of an object's six
        parameters are free; damping: Levenberg-Marquardt's, a share of the diagonal
    OUT out NormalArrays, which must come as zeros
    O(n * free * (free + D) + T * D^2 * n_free). Levenberg 1944, Marquardt 1963; Schur as in Triggs et al. 2000. Twin: dense least squares
    """
    by_camera, by_point, pixel, world = np.empty((2, PARAMETERS)), np.empty((2, 3)), np.empty(2), np.empty(3)
    by_object, local, wanted = np.empty((2, 6)), np.empty((2, PARAMETERS)), np.empty(PARAMETERS, np.int64)
    for t in range(len(sightings.starts) - 1):
        turn = objects.turned[t]
        v, g, w = out.factors[t], out.shifted[t], out.reduced[t]
        for i in range(sightings.starts[t], sightings.starts[t + 1]):
            # Behind its camera, see `residuals_and_cost`.
            if weights[i] == 0.0:
                continue
            c, model = sightings.camera[i], objects.template[sightings.point[i]]
            for j in range(3):
                world[j] = turn[j, 0] * model[0] + turn[j, 1] * model[1] + turn[j, 2] * model[2] + objects.placed[t, j]
            if not project_with_derivatives(
                cameras.lens[c], cameras.rotation[c], cameras.translation[c], world, pixel, by_camera, by_point
            ):
                continue
            _by_object(turn, model, by_point, by_object)
            weight = weights[i]
            r0, r1 = weight * residuals[i, 0], weight * residuals[i, 1]
            _add_sighting(columns[c], axes, weight, r0, r1, by_camera, by_object, local, wanted, out.blocks[c], out.gradient, v, g, w)
        # With its frame's object out of the way, only the cameras are left to solve for together.
        _eliminate(v, g, w, damping)
    for c in range(len(out.blocks)):
        for p in range(PARAMETERS):
            for q in range(p):
                out.blocks[c, p, q] = out.blocks[c, q, p]


@kernel
def move_objects(turned, placed, factors, remaining, axes):
    """Solve each frame's object for its step and take it.

    IN  factors (T, D, D), remaining (T, D): F^-1 (g - W' times the cameras' step)
    OUT turned (T, 3, 3) and placed (T, 3) m, in place. Returns the largest shift, m. O(T D^2).
    """
    dof, largest = len(axes), 0.0
    step = np.zeros(6)
    for t in range(len(placed)):
        step[:] = 0.0
        # Back substitution: F is triangular.
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
