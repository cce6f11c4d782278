"""Rigid motion of a set of points over all frames, and what is left of it, on flat arrays. Twins: tests/twins_motion.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel


@kernel
def fit_frames(template, positions, weights, flat, rotations, translations):
    """The weighted rotation and translation that lay a template on its points, frame by frame; never a reflection.

    IN  template (N, 3) m; positions (T, N, 3) m, NaN for missing; weights (T or 1, N) >= 0; flat: a limb whose second largest extent is
        below this share of its largest leaves its rotation open (points in a line)
    OUT rotations (T, 3, 3), translations (T, 3) m, world from template; NaN where fewer than three points of weight are present, or
        these lie in a line
    O(T N) time, no memory that grows. Kabsch 1976: the rotation maximises trace(R' C), C = sum of w (x - mean)(p - mean)' =
    U S V', so it is U diag(1, 1, det(U V')) V'; it is found here as Horn's quaternion (1987), which is never a reflection. GaMoCap
    section 3.1 prints C the other way round (p_i p_(i+1)') with R = U V', which is the inverse rotation, and leaves out the determinant.
    """
    mixed, shape, turns = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    four, axes = np.empty((4, 4)), np.empty((4, 4))
    for t in range(len(positions)):
        w = weights[min(t, len(weights) - 1)]
        # First pass: the weighted means of template and points, over the points that both have.
        total, count = 0.0, 0
        here, there = np.zeros(3), np.zeros(3)
        for n in range(len(template)):
            if w[n] > 0.0 and not math.isnan(positions[t, n, 0]) and not math.isnan(template[n, 0]):
                count += 1
                total += w[n]
                for i in range(3):
                    here[i] += w[n] * template[n, i]
                    there[i] += w[n] * positions[t, n, i]
        # Beforehand, so that every way out leaves NaN.
        rotations[t], translations[t] = np.nan, np.nan
        # Two points leave the turn about their line open.
        if count < 3:
            continue
        here /= total
        there /= total
        # Second pass, about the means: the mixed covariance for the rotation, the template's own for its shape.
        mixed[:], shape[:] = 0.0, 0.0
        for n in range(len(template)):
            if w[n] > 0.0 and not math.isnan(positions[t, n, 0]) and not math.isnan(template[n, 0]):
                px, py, pz = w[n] * (template[n, 0] - here[0]), w[n] * (template[n, 1] - here[1]), w[n] * (template[n, 2] - here[2])
                for j in range(3):
                    x, p = positions[t, n, j] - there[j], template[n, j] - here[j]
                    mixed[j, 0] += px * x
                    mixed[j, 1] += py * x
                    mixed[j, 2] += pz * x
                    shape[0, j] += px * p
                    shape[1, j] += py * p
                    shape[2, j] += pz * p
        jacobi(shape, turns)
        # The second extent tells a line from a plane; the third may be zero, for markers in a plane have a rotation.
        low, high = min(shape[0, 0], shape[1, 1], shape[2, 2]), max(shape[0, 0], shape[1, 1], shape[2, 2])
        if not shape[0, 0] + shape[1, 1] + shape[2, 2] - low - high > flat * flat * high:
            continue
        # The translation follows from the rotation: it carries mean to mean.
        _nearest_rotation(mixed, four, axes, rotations[t])
        for i in range(3):
            translations[t, i] = there[i]
            for j in range(3):
                translations[t, i] -= rotations[t, i, j] * here[j]


@kernel
def _nearest_rotation(mixed, four, axes, rotation):
    """The rotation R that maximises trace(R' C), by Horn's quaternion (1987): the eigenvector of the largest eigenvalue of a 4 x 4 matrix.

    IN  mixed C (3, 3); OUT four, axes (4, 4) working memory; rotation (3, 3). O(1), no allocation.
    """
    xx, xy, xz = mixed[0, 0], mixed[1, 0], mixed[2, 0]
    yx, yy, yz = mixed[0, 1], mixed[1, 1], mixed[2, 1]
    zx, zy, zz = mixed[0, 2], mixed[1, 2], mixed[2, 2]
    # Horn's matrix: its eigenvectors are quaternions, and the eigenvalue is trace(R' C).
    four[0, 0], four[1, 1], four[2, 2], four[3, 3] = xx + yy + zz, xx - yy - zz, yy - xx - zz, zz - xx - yy
    four[0, 1], four[0, 2], four[0, 3] = yz - zy, zx - xz, xy - yx
    four[1, 2], four[1, 3], four[2, 3] = xy + yx, zx + xz, yz + zy
    for i in range(4):
        for j in range(i):
            four[i, j] = four[j, i]
    jacobi(four, axes)
    # The largest eigenvalue is the best rotation; a reflection is no quaternion, so it cannot win.
    best = 0
    for i in range(1, 4):
        if four[i, i] > four[best, best]:
            best = i
    w, x, y, z = axes[0, best], axes[1, best], axes[2, best], axes[3, best]
    rotation[0, 0], rotation[0, 1], rotation[0, 2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    rotation[1, 0], rotation[1, 1], rotation[1, 2] = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
    rotation[2, 0], rotation[2, 1], rotation[2, 2] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)


@kernel
def jacobi(matrix, axes):
    """Eigenvalues and eigenvectors of a small symmetric matrix, by cyclic Jacobi rotations.

    IN  matrix (n, n) symmetric; OUT the eigenvalues on its diagonal, unordered, and axes (n, n), the eigenvectors as columns
    O(n^3) a sweep, four to six sweeps for n = 3 or 4; no allocation.
    """
    n = len(matrix)
    for i in range(n):
        for j in range(n):
            axes[i, j] = 1.0 if i == j else 0.0
    for _ in range(30):
        off, size = 0.0, 0.0
        for i in range(n):
            size += matrix[i, i] * matrix[i, i]
            for j in range(i):
                off += matrix[i, j] * matrix[i, j]
        # Relative to the matrix: a finger is turned as exactly as a trunk.
        if not off > 1e-30 * size:
            break
        for p in range(n - 1):
            for q in range(p + 1, n):
                # Zero already, and the ratio would be infinite.
                if matrix[p, q] == 0.0:
                    continue
                # The smaller of the two angles that clear the place, which keeps the sweep stable.
                ratio = (matrix[q, q] - matrix[p, p]) / (2.0 * matrix[p, q])
                tangent = (1.0 if ratio >= 0.0 else -1.0) / (abs(ratio) + math.sqrt(ratio * ratio + 1.0))
                cosine = 1.0 / math.sqrt(tangent * tangent + 1.0)
                sine = tangent * cosine
                for k in range(n):
                    a, b = matrix[k, p], matrix[k, q]
                    matrix[k, p], matrix[k, q] = cosine * a - sine * b, sine * a + cosine * b
                for k in range(n):
                    a, b = matrix[p, k], matrix[q, k]
                    matrix[p, k], matrix[q, k] = cosine * a - sine * b, sine * a + cosine * b
                    a, b = axes[k, p], axes[k, q]
                    axes[k, p], axes[k, q] = cosine * a - sine * b, sine * a + cosine * b


@kernel
def local_positions(positions, rotations, translations, out):
    """Points in the axes of their limb, R'(x - t).

    IN  positions (T, N, 3) m, rotations (T, 3, 3), translations (T, 3) m
    OUT out (T, N, 3) m, NaN where the point or the limb's motion is missing
    O(T N), no allocation.
    """
    for t in range(len(positions)):
        r = rotations[t]
        for n in range(positions.shape[1]):
            x = positions[t, n, 0] - translations[t, 0]
            y = positions[t, n, 1] - translations[t, 1]
            z = positions[t, n, 2] - translations[t, 2]
            for i in range(3):
                out[t, n, i] = r[0, i] * x + r[1, i] * y + r[2, i] * z


@kernel
def point_spread(positions, rotations, translations, means, squares, counts):
    """Where each point is in the axes of a limb on average, and how far it strays from there.

    IN  positions (T, N, 3) m, NaN for missing; rotations (T, 3, 3), translations (T, 3) m
    OUT means (N, 3) m, squares (N,) m2 mean squared distance from the mean, counts (N,) int frames; NaN where a point is never seen
    O(T N), no allocation.
    """
    means[:] = 0.0
    squares[:] = 0.0
    counts[:] = 0
    for t in range(len(positions)):
        r = rotations[t]
        if math.isnan(r[0, 0]):
            continue
        for n in range(positions.shape[1]):
            x = positions[t, n, 0] - translations[t, 0]
            y = positions[t, n, 1] - translations[t, 1]
            z = positions[t, n, 2] - translations[t, 2]
            if math.isnan(x):
                continue
            # Welford's update: no sum of squares that cancels far from the origin.
            counts[n] += 1
            for i in range(3):
                local = r[0, i] * x + r[1, i] * y + r[2, i] * z
                # Mean and squares in one pass, exact also far from the origin (Welford).
                step = local - means[n, i]
                means[n, i] += step / counts[n]
                squares[n] += step * (local - means[n, i])
    for n in range(positions.shape[1]):
        if counts[n] > 0:
            squares[n] /= counts[n]
        else:
            means[n], squares[n] = np.nan, np.nan


@kernel
def eigenvalue_weights(local, reference, rounds, weights):
    """Point weights, frame by frame, with which the inertia tensor has the eigenvalues that it has in the reference.

    The tensor of the frame and that of the reference have the same weights. A point that keeps its place among the principal axes adds the
    same to both, so its weight stays; of all weights that make the change of the three eigenvalues vanish to first order, those nearest to
    equal ones are taken (Gauss-Newton, least change), cut at 0, their sum kept.

    IN  local (T, N, 3) m in the axes of the limb, NaN for missing; reference (N, 3) m; rounds of Gauss-Newton
    OUT weights (T, N), sum N over the points present; 0 where missing
    O(T N rounds). Andriacchi et al. 1998; the minimum is solved here by linear algebra instead of a search.
    """
    points = len(reference)
    slopes = np.empty((3, points))
    for t in range(len(local)):
        w = weights[t]
        count = 0
        for n in range(points):
            seen = not math.isnan(local[t, n, 0]) and not math.isnan(reference[n, 0])
            w[n] = 1.0 if seen else 0.0
            count += 1 if seen else 0
        # Three weights of a fixed sum cannot hold three eigenvalues.
        if count < 4:
            continue
        # To first order only: each step begins where the last one ended.
        for _ in range(rounds):
            before, axes_before, mean_before = _principal(reference, w)
            after, axes_after, mean_after = _principal(local[t], w)
            change = after - before
            _slopes(reference, local[t], w, (axes_before, mean_before, axes_after, mean_after), slopes)
            normal = slopes @ slopes.T
            scale = normal[0, 0] + normal[1, 1] + normal[2, 2]
            # No weight changes any eigenvalue.
            if not scale > 0.0:
                break
            # Points in a plane leave the equations singular; a billionth of their size keeps them solvable.
            for k in range(3):
                normal[k, k] += 1e-9 * scale
            step = np.linalg.solve(normal, -change)
            total = 0.0
            for n in range(points):
                if w[n] > 0.0:
                    # A negative weight has no meaning: such a point is left out.
                    w[n] = max(w[n] + step[0] * slopes[0, n] + step[1] * slopes[1, n] + step[2] * slopes[2, n], 0.0)
                    total += w[n]
            if not total > 0.0:
                w[:] = 0.0
                break
            # The sum is kept, so that weights of different frames compare.
            w *= count / total


@kernel
def _slopes(reference, local, w, axes, out):
    """OUT out (3, N): how the change of each eigenvalue grows with each weight; the sum of the weights is kept."""
    axes_before, mean_before, axes_after, mean_after = axes
    total, mean = 0.0, np.zeros(3)
    for n in range(len(reference)):
        out[:, n] = 0.0
        if w[n] > 0.0:
            total += 1.0
            for k in range(3):
                out[k, n] = _moment(local[n], mean_after, axes_after, k) - _moment(reference[n], mean_before, axes_before, k)
                mean[k] += out[k, n]
    for n in range(len(reference)):
        if w[n] > 0.0:
            for k in range(3):
                out[k, n] -= mean[k] / total


@kernel
def _moment(point, mean, axes, k):
    """m2, the squared distance of a point from principal axis k."""
    square, along = 0.0, 0.0
    for i in range(3):
        step = point[i] - mean[i]
        square += step * step
        along += step * axes[i, k]
    return square - along * along


@kernel
def _principal(points, w):
    """Eigenvalues (3,) m2 and axes (3, 3, columns) of the weighted inertia tensor about the weighted mean (3,) m. O(N)."""
    mean, total = np.zeros(3), 0.0
    for n in range(len(points)):
        if w[n] > 0.0:
            total += w[n]
            for i in range(3):
                mean[i] += w[n] * points[n, i]
    mean /= total
    tensor = np.zeros((3, 3))
    for n in range(len(points)):
        if w[n] > 0.0:
            x, y, z = points[n, 0] - mean[0], points[n, 1] - mean[1], points[n, 2] - mean[2]
            square = x * x + y * y + z * z
            tensor[0, 0] += w[n] * (square - x * x)
            tensor[1, 1] += w[n] * (square - y * y)
            tensor[2, 2] += w[n] * (square - z * z)
            tensor[0, 1] -= w[n] * x * y
            tensor[0, 2] -= w[n] * x * z
            tensor[1, 2] -= w[n] * y * z
    tensor[1, 0], tensor[2, 0], tensor[2, 1] = tensor[0, 1], tensor[0, 2], tensor[1, 2]
    values, axes = np.linalg.eigh(tensor)
    return values, axes, mean
