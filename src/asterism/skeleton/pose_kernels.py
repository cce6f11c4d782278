"""A body's bones and a pose in; world positions of its markers and capsules, and their derivatives, out. Twins: tests/twins_views.py.

A pose is one array (9 + J,): scales sx, sy, sz; the root's place tx, ty, tz (m); three numbers that stay 0 (the rotation's increment of a
step); J hinge angles (rad). The rotation itself is a matrix (3, 3) beside it. In a step all 9 + J numbers change.
"""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel

SCALE, PLACE, TURN, HINGES = 0, 3, 6, 9


@kernel
def place_bones(parents, pivots, hinge_starts, axes, pose, rotation, turned, moved, by_scale, hinge_axes, hinge_pivots):
    """World motion of each bone: a rest point X of bone b, relative to the root's pivot, goes to turned[b] (S X) + moved[b].

    IN  parents (B,), -1 for the root, which is first; pivots (B, 3) rest m, the root's is 0; hinge_starts (B + 1,): bone b turns about
        axes hinge_starts[b] to hinge_starts[b + 1], in this order; axes (J, 3) unit, rest; pose (9 + J,); rotation (3, 3) world from body
    OUT turned (B, 3, 3); moved (B, 3) m; by_scale (B, 3, 3): derivative of moved by the three scales; hinge_axes (J, 3), hinge_pivots
        (J, 3) m: the hinges in the world
    O(B + J), no allocation but 3 x 3. The paper's eq. 6 with the rotation, which is missing in print: R (S X) + T, bones turned below it.
    """
    # Parents come before their children.
    for b in range(len(parents)):
        parent = parents[b]
        px, py, pz = pose[0] * pivots[b, 0], pose[1] * pivots[b, 1], pose[2] * pivots[b, 2]
        for i in range(3):
            for k in range(3):
                turned[b, i, k] = rotation[i, k] if parent < 0 else turned[parent, i, k]
        for i in range(3):
            above = pose[PLACE + i] if parent < 0 else moved[parent, i]
            moved[b, i] = turned[b, i, 0] * px + turned[b, i, 1] * py + turned[b, i, 2] * pz + above
            for k in range(3):
                by_scale[b, i, k] = turned[b, i, k] * pivots[b, k] + (0.0 if parent < 0 else by_scale[parent, i, k])
        for j in range(hinge_starts[b], hinge_starts[b + 1]):
            ax, ay, az = axes[j, 0], axes[j, 1], axes[j, 2]
            cos, sin = math.cos(pose[HINGES + j]), math.sin(pose[HINGES + j])
            versine = 1.0 - cos
            for i in range(3):
                u, v, w = turned[b, i, 0], turned[b, i, 1], turned[b, i, 2]
                # The axis in the world as it is before this hinge turns: its own turn leaves it where it is.
                hinge_axes[j, i] = u * ax + v * ay + w * az
                hinge_pivots[j, i] = moved[b, i]
                # A turn about one axis, written out: no matrix product per hinge.
                turned[b, i, 0] = u * (cos + versine * ax * ax) + v * (sin * az + versine * ax * ay) + w * (versine * ax * az - sin * ay)
                turned[b, i, 1] = u * (versine * ax * ay - sin * az) + v * (cos + versine * ay * ay) + w * (sin * ax + versine * ay * az)
                turned[b, i, 2] = u * (sin * ay + versine * ax * az) + v * (versine * ay * az - sin * ax) + w * (cos + versine * az * az)
        for i in range(3):
            # About the pivot, not about the origin.
            moved[b, i] -= turned[b, i, 0] * px + turned[b, i, 1] * py + turned[b, i, 2] * pz
            for k in range(3):
                by_scale[b, i, k] -= turned[b, i, k] * pivots[b, k]


@kernel
def place_points(bones, places, pose, turned, moved, out):
    """World positions of points on bones.

    IN  bones (N,); places (N, 3) rest m, relative to the root's pivot; pose (9 + J,); turned, moved: see `place_bones`
    OUT out (N, 3) m
    O(N), no allocation.
    """
    for n in range(len(bones)):
        b = bones[n]
        x, y, z = pose[0] * places[n, 0], pose[1] * places[n, 1], pose[2] * places[n, 2]
        for i in range(3):
            out[n, i] = turned[b, i, 0] * x + turned[b, i, 1] * y + turned[b, i, 2] * z + moved[b, i]


@kernel
def point_jacobian(bone, place, point, pose, turned, by_scale, hinge_axes, hinge_pivots, moves, out):
    """Derivative of one marker's position by all 9 + J numbers of a step.

    IN  bone; place (3,) rest m; point (3,) m, where it is; turned, by_scale, hinge_axes, hinge_pivots: see `place_bones`;
        moves (J,) bool: whether a hinge moves this bone
    OUT out (3, 9 + J); turns are rotation vectors in the world about the root's place
    O(J), no allocation.
    """
    for i in range(3):
        for k in range(3):
            out[i, k] = turned[bone, i, k] * place[k] + by_scale[bone, i, k]
            out[i, PLACE + k] = 1.0 if i == k else 0.0
    x, y, z = point[0] - pose[PLACE], point[1] - pose[PLACE + 1], point[2] - pose[PLACE + 2]
    out[0, TURN], out[1, TURN], out[2, TURN] = 0.0, -z, y
    out[0, TURN + 1], out[1, TURN + 1], out[2, TURN + 1] = z, 0.0, -x
    out[0, TURN + 2], out[1, TURN + 2], out[2, TURN + 2] = -y, x, 0.0
    for j in range(len(moves)):
        # A hinge moves only what hangs on it.
        if moves[j]:
            dx, dy, dz = point[0] - hinge_pivots[j, 0], point[1] - hinge_pivots[j, 1], point[2] - hinge_pivots[j, 2]
            out[0, HINGES + j] = hinge_axes[j, 1] * dz - hinge_axes[j, 2] * dy
            out[1, HINGES + j] = hinge_axes[j, 2] * dx - hinge_axes[j, 0] * dz
            out[2, HINGES + j] = hinge_axes[j, 0] * dy - hinge_axes[j, 1] * dx
        else:
            out[0, HINGES + j] = out[1, HINGES + j] = out[2, HINGES + j] = 0.0


@kernel
def gather(jacobian, information, pull, hessian, gradient):
    """Add one marker's normal equations: its Jacobian (3, D), its information matrix (3, 3) m-2 and its pull (3,) m-1.

    OUT hessian (D, D), lower triangle, and gradient (D,), added to in place. O(D^2), no allocation.
    """
    size = jacobian.shape[1]
    for p in range(size):
        a, b, c = jacobian[0, p], jacobian[1, p], jacobian[2, p]
        # Most hinges do not move a marker.
        if a == 0.0 and b == 0.0 and c == 0.0:
            continue
        gradient[p] += a * pull[0] + b * pull[1] + c * pull[2]
        u = information[0, 0] * a + information[0, 1] * b + information[0, 2] * c
        v = information[1, 0] * a + information[1, 1] * b + information[1, 2] * c
        w = information[2, 0] * a + information[2, 1] * b + information[2, 2] * c
        # The lower triangle is enough: the matrix is symmetric.
        for q in range(p + 1):
            hessian[p, q] += u * jacobian[0, q] + v * jacobian[1, q] + w * jacobian[2, q]


@kernel
def solve_damped(hessian, gradient, free, damping, factor, step):
    """The damped step of the free numbers: (H + damping diag H) step = gradient, by Cholesky's factor.

    IN  hessian (D, D) lower triangle; gradient (D,); free (F,) which numbers move; damping
    OUT factor (D, D): working memory; step (D,), 0 for what is not free; returns whether the matrix was positive definite
    O(F^3), no allocation.
    """
    size = len(free)
    step[:] = 0.0
    for i in range(size):
        for j in range(i + 1):
            p, q = max(free[i], free[j]), min(free[i], free[j])
            # A share of the diagonal (Marquardt), so that metres and radians are damped alike.
            total = hessian[p, q] * (1.0 + damping if i == j else 1.0)
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j:
                # No positive definite matrix, also for NaN; the caller damps more.
                if not total > 1e-12:
                    return False
                factor[i, i] = math.sqrt(total)
            else:
                factor[i, j] = total / factor[j, j]
    for i in range(size):
        total = gradient[free[i]]
        for k in range(i):
            total -= factor[i, k] * step[free[k]]
        step[free[i]] = total / factor[i, i]
    for i in range(size - 1, -1, -1):
        total = step[free[i]]
        for k in range(i + 1, size):
            total -= factor[k, i] * step[free[k]]
        step[free[i]] = total / factor[i, i]
    return True


@kernel
def add_priors(pose, rotation, vertical, usual, precision, scale_usual, scale_precision, tilt_precision, hessian, gradient):
    """What is known before any image: angles, scales, and that a body is upright. Returns its cost (nats).

    IN  pose (9 + J,), rotation (3, 3); vertical (3,) unit; usual (J,) rad, precision (J,) rad-2; scale_usual (3,); scale_precision (2,):
        of the common scale, and of each scale's difference from the mean; tilt_precision rad-2 of the body's z axis
    OUT hessian (D, D) lower triangle, gradient (D,), added to in place
    O(J), no allocation.
    """
    cost = 0.0
    # The common scale varies more among people than the differences of the three, so they have priors of their own.
    mean = 0.0
    for k in range(3):
        mean += (pose[k] - scale_usual[k]) / 3.0
    cost += 0.5 * scale_precision[0] * mean * mean
    for k in range(3):
        own = pose[k] - scale_usual[k] - mean
        cost += 0.5 * scale_precision[1] * own * own
        gradient[k] -= scale_precision[0] * mean / 3.0 + scale_precision[1] * own
        for q in range(k + 1):
            hessian[k, q] += scale_precision[0] / 9.0 + scale_precision[1] * ((1.0 if k == q else 0.0) - 1.0 / 3.0)
    ux, uy, uz = rotation[0, 2], rotation[1, 2], rotation[2, 2]
    vx, vy, vz = vertical[0], vertical[1], vertical[2]
    # The turn that would set the body upright, and its derivative by a turn: 1 across the vertical, 0 about it.
    tilt = (uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx)
    for k in range(3):
        cost += 0.5 * tilt_precision * tilt[k] * tilt[k]
        gradient[TURN + k] += tilt_precision * tilt[k]
        for q in range(k + 1):
            hessian[TURN + k, TURN + q] += tilt_precision * ((1.0 if k == q else 0.0) - vertical[k] * vertical[q])
    # Beyond a right angle the sine falls again: upside down would cost nothing.
    if ux * vx + uy * vy + uz * vz < 0.0:
        cost += tilt_precision
    for j in range(len(usual)):
        away = pose[HINGES + j] - usual[j]
        cost += 0.5 * precision[j] * away * away
        gradient[HINGES + j] -= precision[j] * away
        hessian[HINGES + j, HINGES + j] += precision[j]
    return cost


@kernel
def turned(rotation, x, y, z, out):
    """Turn a body by a rotation vector in the room's axes.

    IN  rotation (3, 3); x, y, z rad. OUT out (3, 3), another array. O(1), no allocation, as the loops of fits need it; where an array more
    does not matter, `asterism.geometry.shared_kernels.rotate_by` turns in place.
    """
    x, y, z = 0.5 * x, 0.5 * y, 0.5 * z
    length = math.sqrt(x * x + y * y + z * z)
    # The limit of sin x / x at 0.
    sine = 1.0 if length < 1e-9 else math.sin(length) / length
    w, x, y, z = math.cos(length), sine * x, sine * y, sine * z
    for k in range(3):
        a, b, c = rotation[0, k], rotation[1, k], rotation[2, k]
        out[0, k] = (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c
        out[1, k] = 2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z - w * x) * c
        out[2, k] = 2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c


@kernel
def take_step(pose, rotation, step, smallest, low, high, new_pose, new_rotation):
    """The pose after a step: scales and angles within their ranges, the rotation turned by a unit quaternion.

    IN  pose (D,), rotation (3, 3), step (D,); smallest scale; low, high (J,) rad
    OUT new_pose (D,), new_rotation (3, 3)
    O(D), no allocation.
    """
    for p in range(len(pose)):
        new_pose[p] = pose[p] + step[p]
    for k in range(3):
        # A scale that passes zero would turn the body inside out.
        new_pose[k] = max(new_pose[k], smallest)
        new_pose[TURN + k] = 0.0
    for j in range(len(low)):
        new_pose[HINGES + j] = min(max(new_pose[HINGES + j], low[j]), high[j])
    turned(rotation, step[TURN], step[TURN + 1], step[TURN + 2], new_rotation)


@kernel
def fit_positions(body, known, positions, noise, steps, free, pose, rotation):
    """The pose of a body whose markers' positions are known: Levenberg-Marquardt in space.

    IN  positions (M, 3) m, NaN where missing; noise m, beside each marker's own spread; free (F,)
    OUT pose (D,), rotation (3, 3): the start, then the result. Returns the cost (nats)
    O(steps (M D^2 + F^3)).
    """
    size, bones, hinges, markers = len(pose), len(body.parents), len(body.axes), len(body.bones)
    turned, moved, by_scale = np.empty((bones, 3, 3)), np.empty((bones, 3)), np.empty((bones, 3, 3))
    axes, pivots, points = np.empty((hinges, 3)), np.empty((hinges, 3)), np.empty((markers, 3))
    hessian, gradient, factor, step = np.empty((size, size)), np.empty(size), np.empty((size, size)), np.empty(size)
    new_pose, new_rotation = pose.copy(), rotation.copy()
    jacobian, information, pull = np.empty((3, size)), np.zeros((3, 3)), np.empty(3)
    best, damping = np.inf, 1e-3
    for _ in range(steps):
        place_bones(body.parents, body.pivots, body.hinge_starts, body.axes, new_pose, new_rotation, turned, moved, by_scale, axes, pivots)
        place_points(body.bones, body.places, new_pose, turned, moved, points)
        cost = 0.0
        next_hessian, next_gradient = np.zeros((size, size)), np.zeros(size)
        for m in range(markers):
            # Missing markers say nothing.
            if math.isfinite(positions[m, 0]):
                weight = 1.0 / (noise * noise + body.spreads[m] * body.spreads[m])
                for k in range(3):
                    pull[k] = weight * (positions[m, k] - points[m, k])
                    information[k, k] = weight
                    cost += 0.5 * weight * (positions[m, k] - points[m, k]) ** 2
                b = body.bones[m]
                point_jacobian(b, body.places[m], points[m], new_pose, turned, by_scale, axes, pivots, body.moves[b], jacobian)
                gather(jacobian, information, pull, next_hessian, next_gradient)
        cost += add_priors(
            new_pose,
            new_rotation,
            known.vertical,
            body.usual,
            body.precision,
            known.scale_usual,
            known.scale_precision,
            known.tilt_precision,
            next_hessian,
            next_gradient,
        )
        # Else the next try begins from the best pose with more damping.
        if cost < best:
            done = best - cost < 1e-9 * (1.0 + cost)
            best = cost
            pose[:], rotation[:] = new_pose, new_rotation
            hessian, gradient = next_hessian, next_gradient
            damping *= 0.2
            if done:
                break
        else:
            damping = 8.0 * damping + 1e-4
        if not solve_damped(hessian, gradient, free, damping, factor, step):
            damping = 10.0 * damping + 1e-6
            step[:] = 0.0
        take_step(pose, rotation, step, 0.3, body.low, body.high, new_pose, new_rotation)
    return best
