"""A body, cameras and the blobs of one frame in; the pose that explains the blobs out. Twins: tests/twins_views.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.skeleton.pose_kernels import (
    HINGES,
    add_priors,
    gather,
    place_bones,
    place_points,
    point_jacobian,
    solve_damped,
    take_step,
)
from asterism.views._visibility_kernels import sight_depths, visible_shares

_FAR = 5.0
"""Standard deviations beyond which a blob says nothing about a marker."""


@kernel
def project_linear(cameras, points, uv, slopes):
    """Where markers are in the undistorted images, and how that moves with them.

    IN  cameras: `CameraArrays`; points (M, 3) m
    OUT uv (C, M, 2) px from the principal point, NaN behind a camera; slopes (C, M, 2, 3) px/m
    O(C M), no allocation.
    """
    for c in range(len(cameras.eyes)):
        r, t = cameras.rotations[c], cameras.translations[c]
        fx, fy = cameras.focals[c, 0], cameras.focals[c, 1]
        for m in range(len(points)):
            x, y, z = points[m, 0], points[m, 1], points[m, 2]
            depth = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z + t[2]
            # Behind the camera, or at its centre, there is no image.
            if not depth > 0.05:
                uv[c, m] = np.nan
                slopes[c, m] = 0.0
                continue
            u = (r[0, 0] * x + r[0, 1] * y + r[0, 2] * z + t[0]) / depth
            v = (r[1, 0] * x + r[1, 1] * y + r[1, 2] * z + t[1]) / depth
            uv[c, m, 0], uv[c, m, 1] = fx * u, fy * v
            for k in range(3):
                slopes[c, m, 0, k] = fx / depth * (r[0, k] - u * r[2, k])
                slopes[c, m, 1, k] = fy / depth * (r[1, k] - v * r[2, k])


@kernel
def predict_visible(body, cameras, observing, pose, rotation, shares):
    """The probability that each camera has a blob of each marker of a posed body.

    IN  body, cameras, observing: see `arrays`; pose (D,), rotation (3, 3)
    OUT shares (C, M): `observing.hidden` also outside the image, each times `cameras.detected`
    O(B + C M K); allocates the bones.
    """
    bones, hinges, markers, capsules = len(body.parents), len(body.axes), len(body.bones), len(body.radii)
    turned, moved, by_scale = np.empty((bones, 3, 3)), np.empty((bones, 3)), np.empty((bones, 3, 3))
    place_bones(
        body.parents,
        body.pivots,
        body.hinge_starts,
        body.axes,
        pose,
        rotation,
        turned,
        moved,
        by_scale,
        np.empty((hinges, 3)),
        np.empty((hinges, 3)),
    )
    points, ends = np.empty((markers, 3)), np.empty((2 * capsules, 3))
    place_points(body.bones, body.places, pose, turned, moved, points)
    # Nothing hides, so that no line of sight need be followed.
    if math.isinf(observing.occlusion_tolerance):
        shares[:] = observing.shown
    else:
        place_points(body.capsule_bones, body.capsule_ends, pose, turned, moved, ends)
        girth = (pose[0] + pose[1] + pose[2]) / 3.0
        depths = np.empty(shares.shape)
        sight_depths(cameras.eyes, points, ends[:capsules], ends[capsules:], girth * body.radii, observing.clearance, depths)
        visible_shares(depths, observing.occlusion_tolerance, observing.softness, observing.hidden, observing.shown, shares)
    uv, slopes = np.empty((len(shares), markers, 2)), np.empty((len(shares), markers, 2, 3))
    project_linear(cameras, points, uv, slopes)
    for c in range(len(shares)):
        for m in range(markers):
            u, v = uv[c, m, 0], uv[c, m, 1]
            inside = u > cameras.limits[c, 0] and u < cameras.limits[c, 1] and v > cameras.limits[c, 2] and v < cameras.limits[c, 3]
            # Not 0: the pose may be wrong, and then a blob of the marker may be there.
            if not inside:
                shares[c, m] = min(shares[c, m], observing.hidden)
            # A camera that loses many blobs anyway says little by what it does not show.
            shares[c, m] *= cameras.detected[c]


@kernel
def share_blobs(uv, slopes, shares, spreads, xy, offsets, sigma, observing, information, pull):
    """How blobs pull at markers: each blob is shared among the markers near it and the strays (the E step of a Gaussian mixture).

    IN  uv (C, M, 2) px, slopes (C, M, 2, 3) px/m; shares (C, M); spreads (M,) m; xy (P, 2) px, offsets (C + 1,); sigma px
    OUT information (M, 3, 3) m-2, pull (M, 3) m-1, added to in place; returns the cost, minus the log of the blobs' probability
    O(P M); allocates (M,).
    """
    markers = uv.shape[1]
    part, variance, weight = np.empty(markers), np.empty(markers), np.empty(markers)
    toward = np.empty((markers, 2))
    cost = 0.0
    for c in range(len(uv)):
        for m in range(markers):
            # The mean of both axes: how much wider a marker's spread makes its blob in this image.
            gain = 0.5 * (slopes[c, m, 0, 0] ** 2 + slopes[c, m, 0, 1] ** 2 + slopes[c, m, 0, 2] ** 2)
            gain += 0.5 * (slopes[c, m, 1, 0] ** 2 + slopes[c, m, 1, 1] ** 2 + slopes[c, m, 1, 2] ** 2)
            variance[m] = sigma * sigma + gain * spreads[m] * spreads[m]
            weight[m] = 0.0
            toward[m, 0] = toward[m, 1] = 0.0
        for k in range(offsets[c], offsets[c + 1]):
            # A blob that no marker explains is a stray, and then pulls at none.
            total = observing.strays
            for m in range(markers):
                du, dv = xy[k, 0] - uv[c, m, 0], xy[k, 1] - uv[c, m, 1]
                square = du * du + dv * dv
                part[m] = 0.0
                # So far off the exponential is nothing, and costs as much as a near one.
                if square < _FAR * _FAR * variance[m]:
                    part[m] = shares[c, m] * math.exp(-0.5 * square / variance[m]) / (2.0 * math.pi * variance[m])
                    total += part[m]
            cost -= math.log(total)
            for m in range(markers):
                if part[m] > 0.0:
                    # In proportion to the probability that the blob is this marker's.
                    pulling = part[m] / (total * variance[m])
                    weight[m] += pulling
                    toward[m, 0] += pulling * (xy[k, 0] - uv[c, m, 0])
                    toward[m, 1] += pulling * (xy[k, 1] - uv[c, m, 1])
        for m in range(markers):
            if weight[m] > 0.0:
                add_sight(slopes[c, m], weight[m], toward[m, 0], toward[m, 1], information[m], pull[m])
    return cost


@kernel(inline=True)
def add_sight(slope, weight, toward_u, toward_v, information, pull):
    """Add what one camera says about one marker.

    IN  slope (2, 3) px/m, weight px-2, toward px-1
    OUT information (3, 3), pull (3,), added to in place
    O(1).
    """
    for i in range(3):
        pull[i] += slope[0, i] * toward_u + slope[1, i] * toward_v
        for k in range(3):
            information[i, k] += weight * (slope[0, i] * slope[0, k] + slope[1, i] * slope[1, k])


@kernel
def nearest_blobs(uv, slopes, shares, xy, offsets, sigma, observing, information, pull):
    """The paper's eq. 7: each visible marker is pulled by the blob nearest to it, where that is within `observing.reach`.

    IN  as `share_blobs`; a marker counts as visible from a probability of one half on
    OUT information (M, 3, 3) m-2, pull (M, 3) m-1, added to in place; returns half the squared distances (as Levenberg-Marquardt needs
        them) over sigma squared
    O(P M), no allocation.
    """
    cost, weight = 0.0, 1.0 / (sigma * sigma)
    for c in range(len(uv)):
        for m in range(uv.shape[1]):
            if shares[c, m] < 0.5:
                continue
            # Where no blob is within reach, the reach itself is paid: so losing a blob is never cheaper than having it far off.
            best, chosen = observing.reach * observing.reach, -1
            for k in range(offsets[c], offsets[c + 1]):
                square = (xy[k, 0] - uv[c, m, 0]) ** 2 + (xy[k, 1] - uv[c, m, 1]) ** 2
                if square < best:
                    best, chosen = square, k
            cost += 0.5 * weight * best
            if chosen >= 0:
                du, dv = xy[chosen, 0] - uv[c, m, 0], xy[chosen, 1] - uv[c, m, 1]
                add_sight(slopes[c, m], weight, weight * du, weight * dv, information[m], pull[m])
    return cost


@kernel
def given_blobs(uv, slopes, spreads, xy, offsets, labels, sigma, information, pull):
    """How blobs with labels pull at their markers. IN labels (P,), -1 for none. OUT and cost as `share_blobs`. O(P)."""
    cost = 0.0
    for c in range(len(uv)):
        for k in range(offsets[c], offsets[c + 1]):
            m = labels[k]
            # A marker behind the camera cannot be pulled.
            if m >= 0 and math.isfinite(uv[c, m, 0]):
                gain = 0.0
                for i in range(3):
                    gain += 0.5 * (slopes[c, m, 0, i] ** 2 + slopes[c, m, 1, i] ** 2)
                weight = 1.0 / (sigma * sigma + gain * spreads[m] * spreads[m])
                du, dv = xy[k, 0] - uv[c, m, 0], xy[k, 1] - uv[c, m, 1]
                cost += 0.5 * weight * (du * du + dv * dv)
                add_sight(slopes[c, m], weight, weight * du, weight * dv, information[m], pull[m])
    return cost


@kernel
def evaluate(body, cameras, known, observing, shares, xy, offsets, labels, pose, rotation, sigma, hessian, gradient):
    """The cost of a pose (nats) and its normal equations.

    IN  labels (P,): which marker each blob shows, or an empty array where that is not known; others: see `arrays` and `share_blobs`
    OUT hessian (D, D) lower triangle, gradient (D,): downhill
    O(P M + M D^2); allocates (M, C) arrays.
    """
    bones, hinges, markers, count = len(body.parents), len(body.axes), len(body.bones), len(cameras.eyes)
    turned, moved, by_scale = np.empty((bones, 3, 3)), np.empty((bones, 3)), np.empty((bones, 3, 3))
    axes, pivots = np.empty((hinges, 3)), np.empty((hinges, 3))
    place_bones(body.parents, body.pivots, body.hinge_starts, body.axes, pose, rotation, turned, moved, by_scale, axes, pivots)
    points = np.empty((markers, 3))
    place_points(body.bones, body.places, pose, turned, moved, points)
    uv, slopes = np.empty((count, markers, 2)), np.empty((count, markers, 2, 3))
    project_linear(cameras, points, uv, slopes)
    information, pull = np.zeros((markers, 3, 3)), np.zeros((markers, 3))
    if len(labels):
        cost = given_blobs(uv, slopes, body.spreads, xy, offsets, labels, sigma, information, pull)
    elif observing.nearest:
        cost = nearest_blobs(uv, slopes, shares, xy, offsets, sigma, observing, information, pull)
    else:
        cost = share_blobs(uv, slopes, shares, body.spreads, xy, offsets, sigma, observing, information, pull)
    hessian[:] = 0.0
    gradient[:] = 0.0
    jacobian = np.empty((3, HINGES + hinges))
    for m in range(markers):
        # A marker without blobs adds nothing, and its Jacobian costs most.
        if information[m, 0, 0] + information[m, 1, 1] + information[m, 2, 2] > 0.0:
            b = body.bones[m]
            point_jacobian(b, body.places[m], points[m], pose, turned, by_scale, axes, pivots, body.moves[b], jacobian)
            gather(jacobian, information[m], pull[m], hessian, gradient)
    cost += add_priors(
        pose,
        rotation,
        known.vertical,
        body.usual,
        body.precision,
        known.scale_usual,
        known.scale_precision,
        known.tilt_precision,
        hessian,
        gradient,
    )
    return cost


@kernel
def minimise(body, cameras, known, observing, xy, offsets, labels, sigmas, steps, free, pose, rotation, hessian):
    """Levenberg-Marquardt over scale, place, rotation and hinge angles, with a blur of the blobs that shrinks from stage to stage.

    IN  sigmas (S,) px, of each stage; steps: tries in each; free (F,): which of the 9 + J numbers move; others: see `evaluate`
    OUT pose (D,), rotation (3, 3): the start, then the result; hessian (D, D) lower triangle there. Returns the cost at the last stage.
        Visibility is predicted anew at each stage
    O(S steps (P M + M D^2 + F^3)).
    """
    size = len(pose)
    gradient, next_gradient, next_hessian = np.empty(size), np.empty(size), np.empty((size, size))
    factor, step = np.empty((size, size)), np.empty(size)
    next_pose, next_rotation = np.empty(size), np.empty((3, 3))
    shares = np.empty((len(cameras.eyes), len(body.bones)))
    current = np.empty((size, size))
    cost = 0.0
    # From a wide blur to the blobs' own: a wide one leads from afar, a narrow one is exact.
    for s in range(len(sigmas)):
        # Anew at each stage, since what hides what depends on the pose.
        if len(labels) == 0:
            predict_visible(body, cameras, observing, pose, rotation, shares)
        damping = 1e-3
        cost = evaluate(body, cameras, known, observing, shares, xy, offsets, labels, pose, rotation, sigmas[s], current, gradient)
        for _ in range(steps):
            # Not positive definite: more damping makes it so.
            if not solve_damped(current, gradient, free, damping, factor, step):
                damping = 10.0 * damping + 1e-6
                continue
            take_step(pose, rotation, step, 0.3, body.low, body.high, next_pose, next_rotation)
            next_cost = evaluate(
                body,
                cameras,
                known,
                observing,
                shares,
                xy,
                offsets,
                labels,
                next_pose,
                next_rotation,
                sigmas[s],
                next_hessian,
                next_gradient,
            )
            # Only downhill; a step that failed leaves pose and equations as they were.
            if next_cost < cost:
                small = cost - next_cost < 1e-3
                cost = next_cost
                pose[:] = next_pose
                rotation[:] = next_rotation
                # The equations at the new pose are made already.
                gradient, next_gradient = next_gradient, gradient
                current, next_hessian = next_hessian, current
                damping *= 0.2
                if small:
                    break
            else:
                damping = 8.0 * damping + 1e-4
                # So short a step that nothing is left to gain.
                if damping > 1e4:
                    break
    hessian[:] = current
    return cost
