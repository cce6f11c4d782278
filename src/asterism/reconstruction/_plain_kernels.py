"""The thesis' composition and merging, frame by frame on flat arrays: the baseline that `method="plain"` names."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.geometry._kernels import symmetric_inverse
from asterism.reconstruction._kernels import END, FEWEST, FIRST, GATE, NOISE, add_ray, clear, fit, frame_arrays, meeting, within
from asterism.reconstruction._order_kernels import ascending


@kernel
def _composed(rig, frame, rays, points, spreads):
    """Algorithm 3.1: every pair of blobs of every pair of cameras whose rays meet within the sensitivity.

    OUT rays (n, C), points (n, 3) m, spreads (n,) m2, the trace of each point's covariance
    Returns how many there are; the arrays are filled as far as they reach. O(all pairs of blobs).
    """
    rig_cameras = len(rig.cameras)
    one, x, h, g = np.empty(rig_cameras, np.int64), np.empty(3), np.empty(6), np.empty(3)
    limit = rig.setting[GATE] ** 2
    count = 0
    for pair in range(len(rig.pairs)):
        a, b = rig.pairs[pair, 0], rig.pairs[pair, 1]
        for i in range(int(frame.grid[a, FIRST]), int(frame.grid[a, END])):
            for j in range(int(frame.grid[b, FIRST]), int(frame.grid[b, END])):
                if not meeting(rig, frame, a, b, i, j, x):
                    continue
                for c in range(rig_cameras):
                    one[c] = -1
                one[a], one[b] = i, j
                square = fit(rig, frame, one, x, h, g, 1)[0]
                if not (square <= limit and within(rig, x)):
                    continue
                if count < len(points):
                    _, i0, _, _, i3, _, i5 = symmetric_inverse(h)
                    rays[count], points[count], spreads[count] = one, x, i0 + i3 + i5
                count += 1
    return count


@kernel
def _merged(rays, points, spreads, count, limit):
    """Algorithm 3.2: versions of a point nearer than the sensitivity and without different blobs of one camera become one.

    As printed, every pair of versions gives a point of its own; here each version joins the nearest group it may, so that, as the text
    asks, there is only one. The group's place is the mean of its versions. Groups are written over the versions; returns how many.
    """
    groups = 0
    members = np.empty(count, np.int64)
    order = ascending(spreads, count)
    out_rays, out_points, out_spreads = np.empty_like(rays[:count]), np.empty_like(points[:count]), np.empty(count)
    for n in order:
        nearest, group = np.inf, -1
        for k in range(groups):
            apart = 0.0
            for axis in range(3):
                apart += (points[n, axis] - out_points[k, axis]) ** 2
            if apart >= nearest or apart >= limit * (spreads[n] + out_spreads[k]):
                continue
            fits = True
            for c in range(rays.shape[1]):
                fits = fits and (rays[n, c] < 0 or out_rays[k, c] < 0 or rays[n, c] == out_rays[k, c])
            if fits:
                nearest, group = apart, k
        if group < 0:
            out_rays[groups], out_points[groups], out_spreads[groups], members[groups] = rays[n], points[n], spreads[n], 1
            groups += 1
            continue
        members[group] += 1
        out_points[group] += (points[n] - out_points[group]) / members[group]
        for c in range(rays.shape[1]):
            out_rays[group, c] = max(out_rays[group, c], rays[n, c])
    rays[:groups], points[:groups] = out_rays[:groups], out_points[:groups]
    return groups


@kernel
def plain_frame(rig, flat, slopes, first, rays, points, covariance, residual):
    """One frame by algorithms 3.1 and 3.2: no triangulation from all rays, and a blob may serve many points.

    IN  flat (B, 2), slopes (B, 4), first (C + 1,)
    OUT rays (n, C) blob numbers of the frame, points (n, 3) m, covariance (n, 3, 3) m2, residual (n,) px
    Returns the points merged and the versions composed; where these are more than n, nothing else is written.
    """
    spreads = np.empty(len(points))
    frame = frame_arrays(flat, slopes, first)
    versions = _composed(rig, frame, rays, points, spreads)
    if versions > len(points):
        return 0, versions
    groups = _merged(rays, points, spreads, versions, rig.setting[GATE] ** 2)
    h, g = np.empty(6), np.empty(3)
    kept = 0
    for n in range(groups):
        many, pixels = 0, 0.0
        clear(h)
        for c in range(rays.shape[1]):
            if rays[n, c] >= 0:
                many += 1
                pixels += add_ray(rig, frame, c, rays[n, c], points[n], h, g) * rig.cameras[c, NOISE] ** 2
        determinant, i0, i1, i2, i3, i4, i5 = symmetric_inverse(h)
        if many < rig.setting[FEWEST] or not (determinant > 0.0 and pixels < np.inf):
            continue
        rays[kept], points[kept], residual[kept] = rays[n], points[n], math.sqrt(pixels / many)
        v = covariance[kept]
        v[0, 0], v[0, 1], v[0, 2] = i0, i1, i2
        v[1, 0], v[1, 1], v[1, 2] = i1, i3, i4
        v[2, 0], v[2, 1], v[2, 2] = i2, i4, i5
        kept += 1
    return kept, versions
