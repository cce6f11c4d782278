"""Rays with identities: the paper's fused mid-points, and the point of least reprojection error. Twins: tests/twins_garment.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.geometry.shared_kernels import symmetric_inverse

STEPS, STILL, LEAST_DEPTH = 0, 1, 2
"""Places in the rules of `refine_points`."""


@kernel
def fuse_midpoints(origins, rays, starts, parallel, out):
    """For each group of rays the mean of its pairs' mid-points, weighted by the inverse square of the rays' distance (GaMoCap 2.2).

    IN  origins (n, 3) m; rays (n, 3) of length 1; starts (m + 1,): group g is rows starts[g] to starts[g + 1]; parallel: pairs whose rays
        meet at a smaller sine do not count
    OUT out (m, 3) m, NaN where no pair counts
    O(sum of squares of the groups), no allocation. Two rays that meet exactly would have an infinite weight: distances below 1e-9 m count
    as 1e-9 m.
    """
    for g in range(len(starts) - 1):
        total, x, y, z = 0.0, 0.0, 0.0, 0.0
        for i in range(starts[g], starts[g + 1]):
            for j in range(i + 1, starts[g + 1]):
                dot = rays[i, 0] * rays[j, 0] + rays[i, 1] * rays[j, 1] + rays[i, 2] * rays[j, 2]
                square = 1.0 - dot * dot
                # Rays nearly in line meet anywhere along them.
                if not square > parallel * parallel:
                    continue
                dx, dy, dz = origins[j, 0] - origins[i, 0], origins[j, 1] - origins[i, 1], origins[j, 2] - origins[i, 2]
                along_i = rays[i, 0] * dx + rays[i, 1] * dy + rays[i, 2] * dz
                along_j = rays[j, 0] * dx + rays[j, 1] * dy + rays[j, 2] * dz
                s = (along_i - dot * along_j) / square
                t = (dot * along_i - along_j) / square
                ax, ay, az = origins[i, 0] + s * rays[i, 0], origins[i, 1] + s * rays[i, 1], origins[i, 2] + s * rays[i, 2]
                bx, by, bz = origins[j, 0] + t * rays[j, 0], origins[j, 1] + t * rays[j, 1], origins[j, 2] + t * rays[j, 2]
                apart = (ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2
                weight = 1.0 / max(apart, 1e-18)
                total += weight
                x += weight * 0.5 * (ax + bx)
                y += weight * 0.5 * (ay + by)
                z += weight * 0.5 * (az + bz)
        if total > 0.0:
            out[g, 0], out[g, 1], out[g, 2] = x / total, y / total, z / total
        else:
            out[g, 0] = out[g, 1] = out[g, 2] = np.nan


@kernel(inline=True)
def _linearise(rotation, translation, seen, weight, camera, used, first, last, x, y, z, least_depth, h, b):
    """Normal equations of one point at (x, y, z): h (6,) and b (3,) filled; returns the weighted sum of squares, or infinity."""
    h[:] = 0.0
    b[:] = 0.0
    cost = 0.0
    for i in range(first, last):
        if not used[i]:
            continue
        r, t = rotation[camera[i]], translation[camera[i]]
        cx = r[0, 0] * x + r[0, 1] * y + r[0, 2] * z + t[0]
        cy = r[1, 0] * x + r[1, 1] * y + r[1, 2] * z + t[1]
        cz = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z + t[2]
        # Behind a camera: no step may go there.
        if not cz > least_depth:
            return math.inf
        u, v = cx / cz, cy / cz
        du, dv = seen[i, 0] - u, seen[i, 1] - v
        wa, wb, wc = weight[i, 0], weight[i, 1], weight[i, 2]
        cost += wa * du * du + 2.0 * wb * du * dv + wc * dv * dv
        ux, uy, uz = (r[0, 0] - u * r[2, 0]) / cz, (r[0, 1] - u * r[2, 1]) / cz, (r[0, 2] - u * r[2, 2]) / cz
        vx, vy, vz = (r[1, 0] - v * r[2, 0]) / cz, (r[1, 1] - v * r[2, 1]) / cz, (r[1, 2] - v * r[2, 2]) / cz
        pu, pv = wa * du + wb * dv, wb * du + wc * dv
        b[0] += ux * pu + vx * pv
        b[1] += uy * pu + vy * pv
        b[2] += uz * pu + vz * pv
        h[0] += wa * ux * ux + wb * (ux * vx + vx * ux) + wc * vx * vx
        h[1] += wa * ux * uy + wb * (ux * vy + vx * uy) + wc * vx * vy
        h[2] += wa * ux * uz + wb * (ux * vz + vx * uz) + wc * vx * vz
        h[3] += wa * uy * uy + wb * (uy * vy + vy * uy) + wc * vy * vy
        h[4] += wa * uy * uz + wb * (uy * vz + vy * uz) + wc * vy * vz
        h[5] += wa * uz * uz + wb * (uz * vz + vz * uz) + wc * vz * vz
    return cost


@kernel
def _descend(rotation, translation, seen, weight, camera, used, first, last, rules, point, h, b):
    """Gauss-Newton from `point` (3,), in place, with h (6,) and b (3,) as working memory; the cost there, infinity where there is none."""
    nearest = rules[LEAST_DEPTH]
    cost = _linearise(rotation, translation, seen, weight, camera, used, first, last, point[0], point[1], point[2], nearest, h, b)
    if not math.isfinite(cost):
        return math.inf
    for _ in range(int(rules[STEPS])):
        determinant, xx, xy, xz, yy, yz, zz = symmetric_inverse(h)
        # The rays leave a direction open.
        if not determinant > 0.0:
            return math.inf
        sx, sy, sz = xx * b[0] + xy * b[1] + xz * b[2], xy * b[0] + yy * b[1] + yz * b[2], xz * b[0] + yz * b[1] + zz * b[2]
        point[0] += sx
        point[1] += sy
        point[2] += sz
        cost = _linearise(rotation, translation, seen, weight, camera, used, first, last, point[0], point[1], point[2], nearest, h, b)
        if not math.isfinite(cost):
            return math.inf
        # So short a step that the place is found.
        if sx * sx + sy * sy + sz * sz < rules[STILL] * rules[STILL]:
            break
    return cost


@kernel
def refine_points(rotation, translation, seen, weight, camera, starts, chi2, rules, points, used, covariance, cost_of):
    """Each point where the weighted sum of squared reprojection errors is least, without the rays that do not fit.

    IN  rotation (C, 3, 3), translation (C, 3) m; seen (n, 2) undistorted coordinates on the normalised plane; weight (n, 3) the inverse of
        their covariance: xx, xy, yy; camera (n,); starts (m + 1,) rows of each point; chi2 (d + 1,) the largest sum of squares allowed by
        degrees of freedom; rules (3,): most steps, m below which a step ends the search, m of the least depth
    OUT points (m, 3) m, where to begin and the result, NaN where none is left; used (n,) bool, all true before; covariance (m, 6) m2: xx,
        xy, xz, yy, yz, zz; cost_of (m,) the sum of squares that is left
    While a point's sum of squares is too large, the ray is left out without which it becomes smallest; a point of two rays that do not meet
    is dropped. O(rays x rays) of a point at worst, O(rays) where all fit; allocates working memory once.
    """
    h, b = np.empty(6), np.empty(3)
    trial, best = np.empty(3), np.empty(3)
    for g in range(len(starts) - 1):
        first, last = starts[g], starts[g + 1]
        count = 0
        for i in range(first, last):
            count += used[i]
        cost = math.inf
        if count >= 2 and math.isfinite(points[g, 0]):
            cost = _descend(rotation, translation, seen, weight, camera, used, first, last, rules, points[g], h, b)
        # The limit grows with the rays, so that many good ones do not fail by their number.
        while count > 2 and not cost <= chi2[min(2 * count - 3, len(chi2) - 1)]:
            least, worst = math.inf, -1
            for i in range(first, last):
                if not used[i]:
                    continue
                used[i] = False
                trial[:] = points[g]
                left = _descend(rotation, translation, seen, weight, camera, used, first, last, rules, trial, h, b)
                # Not the ray with the largest residual, but the one without which the others agree best: a bad ray draws the point to
                # itself.
                if left < least:
                    least, worst = left, i
                    best[:] = trial
                used[i] = True
            # None can be spared.
            if worst < 0:
                break
            used[worst] = False
            count -= 1
            points[g] = best
            cost = _descend(rotation, translation, seen, weight, camera, used, first, last, rules, points[g], h, b)
        cost_of[g] = cost
        fits = count >= 2 and cost <= chi2[min(2 * count - 3, len(chi2) - 1)]
        determinant = 0.0
        if fits:
            determinant, xx, xy, xz, yy, yz, zz = symmetric_inverse(h)
        if determinant > 0.0:
            covariance[g, 0], covariance[g, 1], covariance[g, 2] = xx, xy, xz
            covariance[g, 3], covariance[g, 4], covariance[g, 5] = yy, yz, zz
        else:
            for i in range(first, last):
                used[i] = False
            points[g] = np.nan
            covariance[g] = np.nan
