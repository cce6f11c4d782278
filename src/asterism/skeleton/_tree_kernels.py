"""A kinematic tree and the places of its markers over time in; its coordinates, frame by frame, out. Twins: tests/twins_skeleton.py.

The state of a tree is q (Q,), its coordinates, with turn (3, 3) and place (3,), the root's. A step changes D = 6 + Q numbers: the root's
place (m, room), the root's turn (rotation vector, rad, room), and the coordinates. What markers say of them is summed as for rigid bodies
with masses: a marker's weight is its mass, and the composite bodies of Featherstone's recursion give the normal equations in O(M + D depth)
instead of O(M D^2). The equations of branches do not touch, so their factor has no more entries than they have (Featherstone, Rigid Body
Dynamics Algorithms, 2008, ch. 6).
"""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.skeleton.pose_kernels import turned

ROOT = 6
"""Numbers of a step that belong to the root."""


@kernel(inline=True)
def evaluate_function(tree, function, q):
    """Value and slope of a joint's function of a coordinate: cubic pieces, straight before the first and behind the last knot.

    IN  function: its index, below 0 for q itself; q. O(log K), no allocation.
    """
    if function < 0:
        return q, 1.0
    first, last = tree.function_starts[function], tree.function_starts[function + 1]
    k = first
    while k + 1 < last and q >= tree.knots[k + 1]:
        k += 1
    u = q - tree.knots[k]
    a, b, c, d = tree.cubics[k, 0], tree.cubics[k, 1], tree.cubics[k, 2], tree.cubics[k, 3]
    if u < 0.0:
        return a + b * u, b
    return a + u * (b + u * (c + u * d)), b + u * (2.0 * c + u * 3.0 * d)


@kernel
def pose_tree(tree, q, turn, place, turned, joints, twists):
    """Where the bones of a tree are, and how each moves with the numbers of a step.

    IN  tree: `TreeArrays`; q (Q,); turn (3, 3), place (3,) m: the root's
    OUT turned (B, 3, 3) room from bone; joints (B, 3) m from the root's place; twists (N, 6): angular, then linear velocity at the root's
        place of all that hangs on the bone of an entry, per unit of its number
    O(B + E), no allocation but 3 x 3.
    """
    twists[:] = 0.0
    for k in range(3):
        twists[k, 3 + k] = 1.0
        # About the root's own place, which is the origin here.
        twists[3 + k, k] = 1.0
    for b in range(len(tree.parents)):
        parent = tree.parents[b]
        if parent < 0:
            turned[b] = turn
            joints[b] = 0.0
        else:
            for i in range(3):
                total = joints[parent, i]
                for k in range(3):
                    total += turned[parent, i, k] * tree.offsets[b, k]
                    turned[b, i, k] = (
                        turned[parent, i, 0] * tree.frames[b, 0, k]
                        + turned[parent, i, 1] * tree.frames[b, 1, k]
                        + turned[parent, i, 2] * tree.frames[b, 2, k]
                    )
                joints[b, i] = total
        for e in range(tree.element_starts[b], tree.element_starts[b + 1]):
            c, n = tree.coordinates[e], tree.entries[e]
            value, slope = evaluate_function(tree, tree.functions[e], q[c] if c >= 0 else 0.0)
            ax, ay, az = tree.axes[e, 0], tree.axes[e, 1], tree.axes[e, 2]
            wx = turned[b, 0, 0] * ax + turned[b, 0, 1] * ay + turned[b, 0, 2] * az
            wy = turned[b, 1, 0] * ax + turned[b, 1, 1] * ay + turned[b, 1, 2] * az
            wz = turned[b, 2, 0] * ax + turned[b, 2, 1] * ay + turned[b, 2, 2] * az
            if tree.slides[e]:
                joints[b, 0] += wx * value
                joints[b, 1] += wy * value
                joints[b, 2] += wz * value
                if n >= 0:
                    twists[n, 3] += wx * slope
                    twists[n, 4] += wy * slope
                    twists[n, 5] += wz * slope
                continue
            if n >= 0:
                px, py, pz = joints[b, 0], joints[b, 1], joints[b, 2]
                twists[n, 0] += wx * slope
                twists[n, 1] += wy * slope
                twists[n, 2] += wz * slope
                twists[n, 3] += (py * wz - pz * wy) * slope
                twists[n, 4] += (pz * wx - px * wz) * slope
                twists[n, 5] += (px * wy - py * wx) * slope
            cos, sin = math.cos(value), math.sin(value)
            versine = 1.0 - cos
            for i in range(3):
                u, v, w = turned[b, i, 0], turned[b, i, 1], turned[b, i, 2]
                turned[b, i, 0] = u * (cos + versine * ax * ax) + v * (sin * az + versine * ax * ay) + w * (versine * ax * az - sin * ay)
                turned[b, i, 1] = u * (versine * ax * ay - sin * az) + v * (cos + versine * ay * ay) + w * (sin * ax + versine * ay * az)
                turned[b, i, 2] = u * (sin * ay + versine * ax * az) + v * (versine * ay * az - sin * ax) + w * (cos + versine * az * az)


@kernel
def assemble(tree, solving, points, weights, q, place, turned, joints, twists, sums, hessian, gradient, misses):
    """The normal equations of one frame, without its damping. Gives the cost, nats.

    IN  solving: `Solving`; points (M, 3) m, NaN where not seen; weights (M,) m-2; q, place, turned, joints, twists: see `pose_tree`
    OUT sums (B, 16): working memory; hessian (D, D), filled where the tree's pattern is; gradient (D,): downhill; misses (M,) m, how far
        each marker is from where the tree has it, NaN where not seen
    O(M + sum of depths), no allocation. A marker that is far off pulls by Student's t (nu = `solving.tails`; 0: by its square).
    """
    bones, size = len(tree.parents), len(gradient)
    sums[:] = 0.0
    cost = 0.0
    for m in range(len(points)):
        if not (weights[m] > 0.0 and math.isfinite(points[m, 0])):
            misses[m] = np.nan
            continue
        b = tree.bones[m]
        x = joints[b, 0] + turned[b, 0, 0] * tree.places[m, 0] + turned[b, 0, 1] * tree.places[m, 1] + turned[b, 0, 2] * tree.places[m, 2]
        y = joints[b, 1] + turned[b, 1, 0] * tree.places[m, 0] + turned[b, 1, 1] * tree.places[m, 1] + turned[b, 1, 2] * tree.places[m, 2]
        z = joints[b, 2] + turned[b, 2, 0] * tree.places[m, 0] + turned[b, 2, 1] * tree.places[m, 1] + turned[b, 2, 2] * tree.places[m, 2]
        rx, ry, rz = points[m, 0] - place[0] - x, points[m, 1] - place[1] - y, points[m, 2] - place[2] - z
        square = rx * rx + ry * ry + rz * rz
        misses[m] = math.sqrt(square)
        w, far = weights[m], weights[m] * square
        if solving.tails > 0.0:
            # The maximum of Student's density by weighted squares (Lange, Little and Taylor 1989), three dimensions.
            cost += 0.5 * (solving.tails + 3.0) * math.log(1.0 + far / solving.tails)
            w *= (solving.tails + 3.0) / (solving.tails + far)
        else:
            cost += 0.5 * far
        sums[b, 0] += w
        sums[b, 1] += w * x
        sums[b, 2] += w * y
        sums[b, 3] += w * z
        sums[b, 4] += w * (y * y + z * z)
        sums[b, 5] += w * (x * x + z * z)
        sums[b, 6] += w * (x * x + y * y)
        sums[b, 7] -= w * x * y
        sums[b, 8] -= w * x * z
        sums[b, 9] -= w * y * z
        sums[b, 10] += w * rx
        sums[b, 11] += w * ry
        sums[b, 12] += w * rz
        sums[b, 13] += w * (y * rz - z * ry)
        sums[b, 14] += w * (z * rx - x * rz)
        sums[b, 15] += w * (x * ry - y * rx)
    # What hangs on a bone moves with it.
    for b in range(bones - 1, 0, -1):
        for k in range(16):
            sums[tree.parents[b], k] += sums[b, k]
    for k in range(size):
        gradient[k] = 0.0
        # What nothing says anything of stays where it is, and the equations can be solved.
        hessian[k, k] = solving.ridge
        for p in range(tree.row_starts[k], tree.row_starts[k + 1]):
            hessian[k, tree.row_columns[p]] = 0.0
    for b in range(bones):
        s = sums[b]
        for n in range(tree.entry_starts[b], tree.entry_starts[b + 1]):
            t, row = twists[n], tree.numbers[n]
            # Force and moment that the composite body's weights answer this motion with.
            fx = s[0] * t[3] + t[1] * s[3] - t[2] * s[2]
            fy = s[0] * t[4] + t[2] * s[1] - t[0] * s[3]
            fz = s[0] * t[5] + t[0] * s[2] - t[1] * s[1]
            mx = s[4] * t[0] + s[7] * t[1] + s[8] * t[2] + s[2] * t[5] - s[3] * t[4]
            my = s[7] * t[0] + s[5] * t[1] + s[9] * t[2] + s[3] * t[3] - s[1] * t[5]
            mz = s[8] * t[0] + s[9] * t[1] + s[6] * t[2] + s[1] * t[4] - s[2] * t[3]
            gradient[row] += t[0] * s[13] + t[1] * s[14] + t[2] * s[15] + t[3] * s[10] + t[4] * s[11] + t[5] * s[12]
            above = b
            while above >= 0:
                last = n + 1 if above == b else tree.entry_starts[above + 1]
                for o in range(tree.entry_starts[above], last):
                    v, column = twists[o], tree.numbers[o]
                    value = v[0] * mx + v[1] * my + v[2] * mz + v[3] * fx + v[4] * fy + v[5] * fz
                    if column == row and o != n:
                        value *= 2.0
                    if column <= row:
                        hessian[row, column] += value
                    else:
                        hessian[column, row] += value
                above = tree.parents[above]
    for j in range(len(q)):
        d = ROOT + j
        away = q[j] - tree.usual[j]
        cost += 0.5 * tree.precision[j] * away * away
        gradient[d] -= tree.precision[j] * away
        hessian[d, d] += tree.precision[j]
        beyond = q[j] - tree.high[j] if q[j] > tree.high[j] else q[j] - tree.low[j] if q[j] < tree.low[j] else 0.0
        if beyond != 0.0:
            cost += 0.5 * solving.limit_precision[j] * beyond * beyond
            gradient[d] -= solving.limit_precision[j] * beyond
            hessian[d, d] += solving.limit_precision[j]
    # Numbers that are held stay: an equation of their own, and none with others.
    for k in range(size):
        for p in range(tree.row_starts[k], tree.row_starts[k + 1]):
            if not (tree.moves[k] and tree.moves[tree.row_columns[p]]):
                hessian[k, tree.row_columns[p]] = 0.0
        if not tree.moves[k]:
            hessian[k, k], gradient[k] = 1.0, 0.0
    return cost


@kernel
def factorise(tree, hessian, damping, factor):
    """The factor L of H + damping diag H = L^T L, which has the pattern of H. Gives whether the matrix is positive definite.

    IN  hessian (D, D), where the pattern is; damping. OUT factor (D, D), there. O(sum of squared depths), no allocation.
    """
    size = len(hessian)
    for k in range(size):
        factor[k, k] = hessian[k, k] * (1.0 + damping)
        for p in range(tree.row_starts[k], tree.row_starts[k + 1]):
            factor[k, tree.row_columns[p]] = hessian[k, tree.row_columns[p]]
    for k in range(size - 1, -1, -1):
        if not factor[k, k] > 1e-12 * max(hessian[k, k], 1e-12):
            return False
        factor[k, k] = math.sqrt(factor[k, k])
        first, last = tree.row_starts[k], tree.row_starts[k + 1]
        for p in range(first, last):
            factor[k, tree.row_columns[p]] /= factor[k, k]
        for p in range(first, last):
            i = tree.row_columns[p]
            value = factor[k, i]
            for r in range(first, p + 1):
                factor[i, tree.row_columns[r]] -= value * factor[k, tree.row_columns[r]]
    return True


@kernel
def solve_factored(tree, factor, right):
    """x of L^T L x = right, in place. IN factor (D, D). OUT right (D,): the solution. O(entries of the pattern), no allocation."""
    size = len(right)
    for k in range(size - 1, -1, -1):
        # Branches that nothing pulls at.
        if right[k] == 0.0:
            continue
        right[k] /= factor[k, k]
        for p in range(tree.row_starts[k], tree.row_starts[k + 1]):
            right[tree.row_columns[p]] -= factor[k, tree.row_columns[p]] * right[k]
    for k in range(size):
        total = right[k]
        for p in range(tree.row_starts[k], tree.row_starts[k + 1]):
            total -= factor[k, tree.row_columns[p]] * right[tree.row_columns[p]]
        right[k] = total / factor[k, k]


@kernel
def inverse_diagonal(tree, factor, inverse, out):
    """The diagonal of (L^T L)^-1, by Takahashi's recursion on the pattern.

    IN  factor (D, D). OUT inverse (D, D): working memory, the inverse where the pattern is; out (D,)
    O(sum of squared depths), no allocation.
    """
    for k in range(len(out)):
        first, last = tree.row_starts[k], tree.row_starts[k + 1]
        total = 1.0 / factor[k, k]
        for p in range(first, last):
            j = tree.row_columns[p]
            value = 0.0
            for r in range(first, last):
                i = tree.row_columns[r]
                value -= factor[k, i] * (inverse[i, j] if i >= j else inverse[j, i])
            inverse[k, j] = value / factor[k, k]
            total -= factor[k, j] * inverse[k, j]
        inverse[k, k] = total / factor[k, k]
        out[k] = inverse[k, k]


@kernel
def step_state(q, turn, place, step, new_q, new_turn, new_place):
    """The state after a step; no coordinate turns by more than 0.7 rad at once, beyond which the equations say little.

    IN  q (Q,), turn (3, 3), place (3,), step (D,). OUT new_q, new_turn, new_place. O(Q), no allocation.
    """
    for k in range(3):
        new_place[k] = place[k] + step[k]
    for j in range(len(q)):
        new_q[j] = q[j] + min(max(step[ROOT + j], -0.7), 0.7)
    turned(turn, step[3], step[4], step[5], new_turn)


@kernel
def follow(tree, solving, points, weights, first, last, q, turns, places, costs, misses, variances, entries):
    """The state of each frame, which starts from that of the frame before; Levenberg and Marquardt.

    IN  points (T, M, 3) m; weights (T, M) m-2; first, last: frames that are solved. The state of `first` is given, a guess
    OUT q (T, Q), turns (T, 3, 3), places (T, 3); costs (T,) nats; misses (T, M) m; variances (T, D): the diagonal of the inverse of the
        normal equations; entries (T, P): these equations on the pattern, diagonal first. Gives the frame behind the last one that was
        solved: a frame whose markers are off by more than `solving.lost`, mean of squares in multiples of their weight, ends the run
    O(frames (M + D depth)); allocates (D, D) three times.
    """
    bones, size, markers = len(tree.parents), ROOT + len(tree.usual), points.shape[1]
    turned, joints = np.empty((bones, 3, 3)), np.empty((bones, 3))
    twists, sums = np.empty((len(tree.numbers), 6)), np.empty((bones, 16))
    hessian, factor, inverse = np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, size))
    gradient, step, new_misses = np.empty(size), np.empty(size), np.empty(markers)
    new_q, new_turn, new_place = np.empty(q.shape[1]), np.empty((3, 3)), np.empty(3)
    for t in range(first, last):
        if t > first:
            q[t], turns[t], places[t] = q[t - 1], turns[t - 1], places[t - 1]
        new_q[:], new_turn[:], new_place[:] = q[t], turns[t], places[t]
        best, damping, decrease = np.inf, 0.0, np.inf
        for _ in range(solving.steps):
            pose_tree(tree, new_q, new_turn, new_place, turned, joints, twists)
            cost = assemble(
                tree, solving, points[t], weights[t], new_q, new_place, turned, joints, twists, sums, hessian, gradient, new_misses
            )
            if cost <= best:
                q[t], turns[t], places[t], misses[t] = new_q, new_turn, new_place, new_misses
                best = cost
                damping *= 0.1
                if decrease < solving.least_decrease:
                    break
            else:
                # Worse by no more than rounding: done. Else again from the best state, with shorter steps.
                if decrease < solving.least_decrease:
                    break
                damping = max(8.0 * damping, 1e-3)
                if damping > 1e6:
                    break
                pose_tree(tree, q[t], turns[t], places[t], turned, joints, twists)
                assemble(tree, solving, points[t], weights[t], q[t], places[t], turned, joints, twists, sums, hessian, gradient, new_misses)
            while not factorise(tree, hessian, damping, factor):
                damping = max(10.0 * damping, 1e-9)
            step[:] = gradient
            solve_factored(tree, factor, step)
            decrease = 0.0
            for k in range(size):
                decrease += 0.5 * step[k] * gradient[k]
            step_state(q[t], turns[t], places[t], step, new_q, new_turn, new_place)
        pose_tree(tree, q[t], turns[t], places[t], turned, joints, twists)
        costs[t] = assemble(
            tree, solving, points[t], weights[t], q[t], places[t], turned, joints, twists, sums, hessian, gradient, new_misses
        )
        damping = 0.0
        while not factorise(tree, hessian, damping, factor):
            damping = max(10.0 * damping, 1e-12)
        inverse_diagonal(tree, factor, inverse, variances[t])
        for k in range(size):
            entries[t, k] = hessian[k, k]
            for p in range(tree.row_starts[k], tree.row_starts[k + 1]):
                entries[t, size + p] = hessian[k, tree.row_columns[p]]
        square, seen = 0.0, 0
        for m in range(markers):
            if math.isfinite(misses[t, m]):
                square += min(weights[t, m] * misses[t, m] ** 2, solving.lost_at_most)
                seen += 1
        if seen > 0 and square > 3.0 * solving.lost * seen:
            return t + 1
    return last


@kernel
def linearise(tree, solving, points, weights, q, turns, places, gradients, misses, entries):
    """The normal equations of given states. Gives the cost of all frames, nats.

    IN  points (T, M, 3) m, weights (T, M) m-2; q (T, Q), turns (T, 3, 3), places (T, 3)
    OUT gradients (T, D), misses (T, M) m, entries (T, P): see `follow`
    O(T (M + D depth)); allocates (D, D).
    """
    bones, size = len(tree.parents), gradients.shape[1]
    turned, joints = np.empty((bones, 3, 3)), np.empty((bones, 3))
    twists, sums, hessian = np.empty((len(tree.numbers), 6)), np.empty((bones, 16)), np.zeros((size, size))
    cost = 0.0
    for t in range(len(q)):
        pose_tree(tree, q[t], turns[t], places[t], turned, joints, twists)
        cost += assemble(
            tree, solving, points[t], weights[t], q[t], places[t], turned, joints, twists, sums, hessian, gradients[t], misses[t]
        )
        for k in range(size):
            entries[t, k] = hessian[k, k]
            for p in range(tree.row_starts[k], tree.row_starts[k + 1]):
                entries[t, size + p] = hessian[k, tree.row_columns[p]]
    return cost


@kernel
def pose_frames(tree, q, turns, places, turned, joints):
    """Where the bones are in each frame, in the room.

    IN  q (T, Q), turns (T, 3, 3), places (T, 3) m. OUT turned (T, B, 3, 3), joints (T, B, 3) m. O(T B); allocates (N, 6).
    """
    twists = np.empty((len(tree.numbers), 6))
    for t in range(len(q)):
        pose_tree(tree, q[t], turns[t], places[t], turned[t], joints[t], twists)
        for b in range(len(tree.parents)):
            for k in range(3):
                joints[t, b, k] += places[t, k]


@kernel
def shared_variances(tree, solving, points, weights, shared, q, turns, places, out):
    """What the numbers of given states vary by where all markers of a bone move together, as skin does.

    IN  points (T, M, 3) m, weights (T, M) m-2; shared (B,) m2, of each axis, independent from bone to bone; q, turns, places: the states
    OUT out (T, D). Of a state solved by weighted least squares, the answer to a shift is a solution of its normal equations.
    O(T B P); allocates (D, D) twice.
    """
    bones, size, markers = len(tree.parents), out.shape[1], points.shape[1]
    turned, joints = np.empty((bones, 3, 3)), np.empty((bones, 3))
    twists, sums, own = np.empty((len(tree.numbers), 6)), np.empty((bones, 16)), np.empty((bones, 4))
    hessian, factor, gradient = np.zeros((size, size)), np.zeros((size, size)), np.empty(size)
    misses, answer, force = np.empty(markers), np.empty(size), np.empty(3)
    for t in range(len(q)):
        pose_tree(tree, q[t], turns[t], places[t], turned, joints, twists)
        assemble(tree, solving, points[t], weights[t], q[t], places[t], turned, joints, twists, sums, hessian, gradient, misses)
        damping = 0.0
        while not factorise(tree, hessian, damping, factor):
            damping = max(10.0 * damping, 1e-12)
        # Composite bodies without what hangs on them are the bones' own again.
        own[:] = sums[:, :4]
        for b in range(bones - 1, 0, -1):
            for k in range(4):
                own[tree.parents[b], k] -= sums[b, k]
        out[t] = 0.0
        for b in range(bones):
            if not own[b, 0] > 1e-9 * sums[b, 0]:
                continue
            for axis in range(3):
                force[:] = 0.0
                force[axis] = own[b, 0]
                mx = own[b, 2] * (1.0 if axis == 2 else 0.0) - own[b, 3] * (1.0 if axis == 1 else 0.0)
                my = own[b, 3] * (1.0 if axis == 0 else 0.0) - own[b, 1] * (1.0 if axis == 2 else 0.0)
                mz = own[b, 1] * (1.0 if axis == 1 else 0.0) - own[b, 2] * (1.0 if axis == 0 else 0.0)
                answer[:] = 0.0
                above = b
                while above >= 0:
                    for n in range(tree.entry_starts[above], tree.entry_starts[above + 1]):
                        v, d = twists[n], tree.numbers[n]
                        if tree.moves[d]:
                            answer[d] += v[0] * mx + v[1] * my + v[2] * mz + v[3] * force[0] + v[4] * force[1] + v[5] * force[2]
                    above = tree.parents[above]
                solve_factored(tree, factor, answer)
                for d in range(size):
                    out[t, d] += shared[b] * answer[d] ** 2
