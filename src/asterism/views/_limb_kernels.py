"""A posed body, blobs and many angles of one limb in; how well each explains the blobs out. Twins: tests/twins_views.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.skeleton.pose_kernels import HINGES, PLACE, place_bones, place_points
from asterism.views._fit_kernels import minimise, project_linear

_FAR = 4.0
"""Standard deviations beyond which a blob says nothing about a marker."""


@kernel
def add_densities(uv, slopes, spreads, share, xy, offsets, sigma, out):
    """Add the markers' densities at the blobs: normal distributions about their projections.

    IN  uv (C, M, 2) px, slopes (C, M, 2, 3) px/m; spreads (M,) m; share: the probability that a camera has a blob of a marker; xy (P, 2)
        px, offsets (C + 1,); sigma px
    OUT out (P,) px-2, added to in place
    O(P M), no allocation.
    """
    for c in range(len(uv)):
        for m in range(uv.shape[1]):
            # Behind this camera.
            if not math.isfinite(uv[c, m, 0]):
                continue
            gain = 0.0
            for i in range(3):
                gain += 0.5 * (slopes[c, m, 0, i] ** 2 + slopes[c, m, 1, i] ** 2)
            variance = sigma * sigma + gain * spreads[m] * spreads[m]
            height, reach = share / (2.0 * math.pi * variance), _FAR * _FAR * variance
            for k in range(offsets[c], offsets[c + 1]):
                du, dv = xy[k, 0] - uv[c, m, 0], xy[k, 1] - uv[c, m, 1]
                square = du * du + dv * dv
                if square < reach:
                    out[k] += height * math.exp(-0.5 * square / variance)


@kernel(inline=True)
def negative_log(densities):
    """Gives minus the sum of the logs, one log for eight densities. IN densities (P,) px-2. O(P), no allocation."""
    total, product = 0.0, 1.0
    for k in range(len(densities)):
        # Eight densities of pixels neither overflow nor vanish in a product, and logs are what costs.
        product *= densities[k]
        if k % 8 == 7:
            total -= math.log(product)
            product = 1.0
    return total - math.log(product)


@kernel
def screen_limb(body, limb, first, cameras, observing, xy, offsets, sigma, chosen, angles, pose, rotation, costs):
    """The cost (nats) of each of many angles of a limb, the rest of the body as it is; nothing is hidden.

    IN  body; limb: the bones, hinges and markers of the limb as a body of their own; first: its first bone in the body; cameras,
        observing: see `arrays`; xy (P, 2) px, offsets (C + 1,); sigma px; chosen (R,): the markers of the rest; angles (N, L) rad;
        pose (9 + J,), rotation (3, 3)
    OUT costs (N,): minus the log of the blobs' probability, and what the angles cost before any image
    O(P M + N (B + P L)) for a limb of B bones and L markers; allocates (P,), and the bones once.
    """
    bones, hinges, count = len(body.parents), len(body.axes), len(cameras.eyes)
    turned, moved, by_scale = np.empty((bones, 3, 3)), np.empty((bones, 3)), np.empty((bones, 3, 3))
    axes, pivots = np.empty((hinges, 3)), np.empty((hinges, 3))
    place_bones(body.parents, body.pivots, body.hinge_starts, body.axes, pose, rotation, turned, moved, by_scale, axes, pivots)
    # The rest of the body stays, so what it explains is worked out once for all angles.
    rest = np.empty((len(chosen), 3))
    place_points(body.bones[chosen], body.places[chosen], pose, turned, moved, rest)
    uv, slopes = np.empty((count, len(chosen), 2)), np.empty((count, len(chosen), 2, 3))
    project_linear(cameras, rest, uv, slopes)
    ready, present = np.full(len(xy), observing.strays), np.empty(len(xy))
    add_densities(uv, slopes, body.spreads[chosen], observing.shown, xy, offsets, sigma, ready)
    above = body.parents[first]
    tried, turn = np.empty(HINGES + angles.shape[1]), turned[above].copy()
    # The limb hangs on the bone above as a body on its root.
    tried[:HINGES] = pose[:HINGES]
    tried[PLACE : PLACE + 3] = moved[above]
    points = np.empty((len(limb.bones), 3))
    uv, slopes = np.empty((count, len(points), 2)), np.empty((count, len(points), 2, 3))
    for n in range(len(angles)):
        tried[HINGES:] = angles[n]
        place_bones(limb.parents, limb.pivots, limb.hinge_starts, limb.axes, tried, turn, turned, moved, by_scale, axes, pivots)
        place_points(limb.bones, limb.places, tried, turned, moved, points)
        project_linear(cameras, points, uv, slopes)
        # Each trial begins from what the rest explains.
        present[:] = ready
        add_densities(uv, slopes, limb.spreads, observing.shown, xy, offsets, sigma, present)
        costs[n] = negative_log(present)
        for j in range(angles.shape[1]):
            away = angles[n, j] - limb.usual[j]
            costs[n] += 0.5 * limb.precision[j] * away * away


@kernel
def fit_limb(limb, cameras, known, observing, xy, offsets, labels, sigmas, steps, rotation, poses, costs):
    """Fit a limb to blobs from many starts.

    IN  limb, cameras, known, observing: see `arrays`; xy (P, 2) px, offsets (C + 1,), labels (P,) markers of the limb, or an empty array
        where they are not known; sigmas (S,) px, steps: see `minimise`; rotation (3, 3) of the bone above
    OUT poses (N, 9 + L): the starts, then the results, of which the angles moved; costs (N,) nats
    O(N S steps (P M + M L^2 + L^3)).
    """
    size = poses.shape[1]
    free, hessian = np.arange(HINGES, size), np.empty((size, size))
    for n in range(len(poses)):
        # Only the angles are free, but the search writes to its rotation.
        turned = rotation.copy()
        costs[n] = minimise(limb, cameras, known, observing, xy, offsets, labels, sigmas, steps, free, poses[n], turned, hessian)
