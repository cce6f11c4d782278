"""Hypotheses that want the same blobs in; the same hypotheses without the blobs that they share, added, out."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel
from asterism.reconstruction._fit_kernels import fit, fit_workspace
from asterism.reconstruction._hypothesis_kernels import append_hypothesis, holders_by_blob, same_rays
from asterism.reconstruction._input_kernels import FEWEST, inside_volume
from asterism.reconstruction._score_kernels import score

MULTI_CAMERA = 3
"""Hypotheses of at least this many cameras lose and claim blobs: two rays meet too easily by chance."""
LEAST_RIVAL = 0.25
"""The share of a hypothesis' score that a rival must have at least."""


@kernel
def add_without_shared(rig, frame, found, count):
    """Add each hypothesis again without the blobs that a rival of three cameras or more also has, so that both can be chosen.

    Two markers that one camera sees as one blob share it. The marker that does not get it is still there by its other cameras.

    IN  found: Hypotheses, of which the first `count` count
    Returns Hypotheses and how many there are now. O(hypotheses * rivals of each * C). Twin: tests/twins_reconstruction.py
    """
    cameras, blobs = found.rays.shape[1], len(frame.blobs)
    multi_camera = _multi_camera(found, count)
    starts, holders = holders_by_blob(found.rays, multi_camera, blobs)
    rays, work = np.empty(cameras, np.int64), fit_workspace()
    total = count
    for n in multi_camera:
        begin = total
        for c in range(cameras):
            blob = found.rays[n, c]
            if blob < 0:
                continue
            for place in range(starts[blob], starts[blob + 1]):
                rival = holders[place]
                # A much weaker rival takes no blob from it: what it would lose decides nothing.
                if rival == n or found.scores[rival] < LEAST_RIVAL * found.scores[n]:
                    continue
                left = _without_shared(found, n, rival, rays)
                # Two rays are a point only where the settings allow two cameras.
                if left < max(2, rig.limits[FEWEST]) or _is_among(found, begin, total, rays):
                    continue
                # The fit begins at the old place, which lies near.
                for axis in range(3):
                    work.point[axis] = found.points[n, axis]
                square = fit(rig, frame, rays, work, 2)[0]
                worth = score(rig, frame, rays, work, square)
                # What is no likelier than strays cannot be chosen anyway.
                if worth > 0.0 and inside_volume(rig, work.point):
                    found = append_hypothesis(found, total, rays, work.point, worth)
                    total += 1
    return found, total


@kernel
def _multi_camera(found, count):
    """Returns the hypotheses of MULTI_CAMERA cameras or more, in their order. O(count * C).

    Bounds: some of `count` hypotheses.
    """
    out = np.empty(count, np.int64)
    total = 0
    for n in range(count):
        many = 0
        for c in range(found.rays.shape[1]):
            many += found.rays[n, c] >= 0
        if many >= MULTI_CAMERA:
            out[total] = n
            total += 1
    return out[:total]


@kernel
def _without_shared(found, n, rival, rays):
    """OUT rays (C,): those of hypothesis n without those that a rival has too. Returns how many are left. O(C)."""
    left = 0
    for c in range(len(rays)):
        # Only the same blob of the same camera is shared.
        shared = found.rays[n, c] >= 0 and found.rays[n, c] == found.rays[rival, c]
        rays[c] = -1 if shared else found.rays[n, c]
        left += rays[c] >= 0
    return left


@kernel
def _is_among(found, begin, end, rays):
    """Returns whether one of the hypotheses from `begin` to `end` has exactly these rays. O((end - begin) * C)."""
    known = False
    for n in range(begin, end):
        known = known or same_rays(found, n, rays)
    return known
