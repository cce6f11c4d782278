"""Frames on flat arrays: blobs in, chosen points with residual, covariance and rays out."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.geometry._kernels import symmetric_inverse
from asterism.reconstruction._compose_kernels import compose, with_reduced
from asterism.reconstruction._kernels import (
    NOISE,
    add_ray,
    best_blob,
    clear,
    fit,
    frame_arrays,
    in_view,
    settle,
    within,
)
from asterism.reconstruction._order_kernels import ascending
from asterism.reconstruction._pack_kernels import pack

FINAL_STEPS = 6


@kernel
def reconstruct_frames(rig, flat, slopes, offsets, begin, end, out_rays, out_points, out_covariance, out_residual, counts, notes):
    """Compose, merge and choose the points of frames `begin` to `end`, each frame by itself.

    IN  rig RigArrays; flat (B, 2), slopes (B, 4), offsets (T * C + 1,) as in Blobs
    OUT out_rays (P, C) blob numbers or -1, out_points (P, 3) m, out_covariance (P, 3, 3) m2, out_residual (P,) px
        counts (T,) points of each frame; notes (T, 2): pairs that passed the gate, tangles of hypotheses not solved to the end
    P is at least half the number of blobs. Returns the number of points. Twins of its steps: tests/test_reconstruction.py
    """
    cameras = len(rig.cameras)
    x, h, g, out = np.empty(3), np.empty(6), np.empty(3), np.empty(1)
    total = 0
    for t in range(begin, end):
        first = offsets[t * cameras : (t + 1) * cameras + 1] - offsets[t * cameras]
        here = offsets[t * cameras]
        blobs = first[cameras]
        counts[t - begin] = 0
        notes[t - begin, :] = 0
        if blobs < 2:
            continue
        frame = frame_arrays(flat[here : here + blobs], slopes[here : here + blobs], first)
        found, count, gated = compose(rig, frame)
        notes[t - begin, 0] = gated
        if count == 0:
            continue
        found, count = with_reduced(rig, frame, found, count)
        chosen, unproved = pack(found.rays, found.scores, count, blobs)
        notes[t - begin, 1] = unproved
        free = np.ones(blobs, np.bool_)
        for n in range(count):
            if chosen[n]:
                for c in range(cameras):
                    if found.rays[n, c] >= 0:
                        free[found.rays[n, c]] = False
        order = ascending(-found.scores, count)
        for n in order:
            if not chosen[n]:
                continue
            rays = found.rays[n]
            for axis in range(3):
                x[axis] = found.points[n, axis]
            _join(rig, frame, rays, x, h, g, free, out)
            square = fit(rig, frame, rays, x, h, g, FINAL_STEPS)[0]
            if not (square < np.inf and within(rig, x)):
                continue
            _, i0, i1, i2, i3, i4, i5 = symmetric_inverse(h)
            many, pixels = 0, 0.0
            for c in range(cameras):
                out_rays[total, c] = -1
                if rays[c] >= 0:
                    out_rays[total, c] = here + rays[c]
                    many += 1
                    clear(h)
                    pixels += add_ray(rig, frame, c, rays[c], x, h, g) * rig.cameras[c, NOISE] ** 2
            for axis in range(3):
                out_points[total, axis] = x[axis]
            out_residual[total] = math.sqrt(pixels / many)
            v = out_covariance[total]
            v[0, 0], v[0, 1], v[0, 2] = i0, i1, i2
            v[1, 0], v[1, 1], v[1, 2] = i1, i3, i4
            v[2, 0], v[2, 1], v[2, 2] = i2, i4, i5
            counts[t - begin] += 1
            total += 1
    return total


@kernel
def _join(rig, frame, rays, x, h, g, free, out):
    """Give a chosen point the free blobs that it fits in the cameras that it lacks, unless that costs it others.

    OUT rays (C,), x (3,) m and free (B,), changed in place
    """
    fit(rig, frame, rays, x, h, g, 1)
    before, many = rays.copy(), 0
    for c in range(len(rays)):
        many += rays[c] >= 0
        if rays[c] < 0:
            rays[c] = best_blob(rig, frame, c, x, h, free, out)
    square, left = settle(rig, frame, rays, x, h, g, 1)
    kept = square < np.inf and left >= many
    for c in range(len(rays)):
        if not kept:
            rays[c] = before[c]
        elif rays[c] >= 0:
            free[rays[c]] = False
        elif before[c] >= 0:
            free[before[c]] = True


@kernel
def seen_shares(rig, points, rays, in_sight, seen):
    """Count how often each camera saw what it should.

    IN  points (P, 3) m; rays (P, C)
    OUT in_sight, seen (C,) int: points of three other rays or more inside the camera's image, and those among them that it saw
    """
    for p in range(len(points)):
        many = 0
        for c in range(rays.shape[1]):
            many += rays[p, c] >= 0
        for c in range(rays.shape[1]):
            has = rays[p, c] >= 0
            if many - has >= 3 and in_view(rig, c, points[p])[0]:
                in_sight[c] += 1
                seen[c] += has
