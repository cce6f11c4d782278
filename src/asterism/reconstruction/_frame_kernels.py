"""Frames on flat arrays: blobs in, chosen points with residual, covariance and rays out."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.geometry.shared_kernels import symmetric_inverse
from asterism.reconstruction._compose_kernels import compose
from asterism.reconstruction._fit_kernels import add_ray, fit, fit_and_prune, fit_workspace, set_zero
from asterism.reconstruction._input_kernels import MOST_WORK, NOISE, frame_arrays, inside_volume
from asterism.reconstruction._order_kernels import ascending
from asterism.reconstruction._pack_kernels import pack
from asterism.reconstruction._score_kernels import best_blob, in_view
from asterism.reconstruction._shared_kernels import add_without_shared

FINAL_STEPS = 6
"""Gauss-Newton steps of a chosen point at most."""


class RayArrays(NamedTuple):
    """The B blobs of T frames of C cameras: normalised (B, 2); jacobian (B, 4) px; offsets (T * C + 1,) as in Blobs."""

    normalised: np.ndarray
    jacobian: np.ndarray
    offsets: np.ndarray


class PointArrays(NamedTuple):
    """Where points are written: rays (P, C) blob numbers or -1, points (P, 3) m, covariance (P, 3, 3) m2, residual (P,) px."""

    rays: np.ndarray
    points: np.ndarray
    covariance: np.ndarray
    residual: np.ndarray


@kernel
def reconstruct_frames(rig, rays, begin, end, out, counts, notes):
    """Compose, merge and choose the points of frames `begin` to `end`, each frame by itself.

    IN  rig RigArrays; rays RayArrays
    OUT out PointArrays, with room for at least half as many points as there are blobs; blobs are counted over all frames
        counts (T,) points of each frame
        notes (T, 2): pairs that passed the gate; components of conflicting hypotheses that were not solved to the end
    Returns the number of points. O(gated pairs * C) for each frame, and the search of `pack`. Twins of its steps:
    tests/test_reconstruction.py, tests/twins_reconstruction.py

    Bounds: a chosen point has two blobs or more and shares none, so a frame of B blobs gives B // 2 points at most; the sum of B // 2 is no
    larger than half of all.
    """
    cameras = len(rig.cameras)
    total = 0
    for t in range(begin, end):
        first = rays.offsets[t * cameras : (t + 1) * cameras + 1] - rays.offsets[t * cameras]
        here = rays.offsets[t * cameras]
        blobs = first[cameras]
        counts[t - begin] = 0
        notes[t - begin, :] = 0
        # One blob is no point.
        if blobs < 2:
            continue
        frame = frame_arrays(rays.normalised[here : here + blobs], rays.jacobian[here : here + blobs], first)
        found, count, gated = compose(rig, frame)
        notes[t - begin, 0] = gated
        if count == 0:
            continue
        found, count = add_without_shared(rig, frame, found, count)
        chosen, unproved = pack(found.rays, found.scores, count, blobs, rig.limits[MOST_WORK])
        notes[t - begin, 1] = unproved
        many = _write_chosen(rig, frame, found, chosen, here, out, total)
        counts[t - begin] = many
        total += many
    return total


@kernel
def _write_chosen(rig, frame, found, chosen, here, out, total):
    """Give chosen hypotheses the blobs that are free, fit them to the end, and write them behind the first `total` points.

    IN  chosen (n,) bool; here: the number of the frame's first blob
    OUT out PointArrays
    Returns how many were written. O(n log n + chosen * C).
    """
    work = fit_workspace()
    # What a chosen hypothesis has is not to be had by another.
    available = np.ones(len(frame.blobs), np.bool_)
    for n in range(len(chosen)):
        if chosen[n]:
            for c in range(found.rays.shape[1]):
                if found.rays[n, c] >= 0:
                    available[found.rays[n, c]] = False
    many = 0
    # Surest first: where two want a blob that is free, it gets it.
    for n in ascending(-found.scores, len(chosen)):
        if not chosen[n]:
            continue
        for axis in range(3):
            work.point[axis] = found.points[n, axis]
        attach_available(rig, frame, found.rays[n], work, available)
        square = fit(rig, frame, found.rays[n], work, FINAL_STEPS)[0]
        if square < np.inf and inside_volume(rig, work.point):
            write_point(rig, frame, found.rays[n], here, work, out, total + many)
            many += 1
    return many


@kernel
def write_point(rig, frame, rays, here, work, out, at):
    """Write a fitted point to its place, with covariance and residual.

    IN  rays (C,) blobs of the frame or -1; here: added to their numbers; work: the point and its information
    OUT out PointArrays, row `at`; work.information is overwritten
    O(C), no allocation.
    """
    _, i0, i1, i2, i3, i4, i5 = symmetric_inverse(work.information)
    many, pixels = 0, 0.0
    for c in range(len(rays)):
        out.rays[at, c] = -1
        if rays[c] >= 0:
            out.rays[at, c] = here + rays[c]
            many += 1
            # Only the residual is wanted of `add_ray`; the information was inverted before.
            set_zero(work.information)
            pixels += add_ray(rig, frame, c, rays[c], work) * rig.cameras[c, NOISE] ** 2
    for axis in range(3):
        out.points[at, axis] = work.point[axis]
    out.residual[at] = math.sqrt(pixels / many)
    v = out.covariance[at]
    v[0, 0], v[0, 1], v[0, 2] = i0, i1, i2
    v[1, 0], v[1, 1], v[1, 2] = i1, i3, i4
    v[2, 0], v[2, 1], v[2, 2] = i2, i4, i5


@kernel
def attach_available(rig, frame, rays, work, available):
    """Give a chosen point the available blobs that it fits in the cameras that it lacks, unless it loses other rays by that.

    OUT rays (C,), work.point and available (B,), changed in place
    O(C), and the blobs near the point. Twin: tests/twins_reconstruction.py
    """
    fit(rig, frame, rays, work, 1)
    before, many = rays.copy(), 0
    for c in range(len(rays)):
        many += rays[c] >= 0
        if rays[c] < 0:
            rays[c] = best_blob(rig, frame, c, work, available)[0]
    # With a ray more, the worst may be another one: it must not cost a ray that was there.
    square, left = fit_and_prune(rig, frame, rays, work, 1)
    kept = square < np.inf and left >= many
    for c in range(len(rays)):
        if not kept:
            rays[c] = before[c]
        elif rays[c] >= 0:
            available[rays[c]] = False
        # A ray that was dropped is free for the next point.
        elif before[c] >= 0:
            available[before[c]] = True


@kernel
def count_visibility(rig, points, rays, expected, seen):
    """Count how often each camera saw what it should have seen.

    IN  points (P, 3) m; rays (P, C)
    OUT expected, seen (C,) int, added to: points of three other rays or more inside the camera's image, and those among them that it saw
    O(P C), no allocation. Twin: tests/twins_reconstruction.py
    """
    for p in range(len(points)):
        many = 0
        for c in range(rays.shape[1]):
            many += rays[p, c] >= 0
        for c in range(rays.shape[1]):
            has = rays[p, c] >= 0
            # Three other rays, so that the place is sure whether or not this camera saw it.
            if many - has >= 3 and in_view(rig, c, points[p])[0]:
                expected[c] += 1
                seen[c] += has
