"""Kernels of features: points in; the values of features, their ranges over people, and which weak classifiers reject, out.

All kernels of this folder take the vertical as +z; `geometry.rotate_z_up` has turned the points before. Twins: tests/twins.py.
"""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.labelling.features.motion_kernels import G9, motion_feature

# Order of `features.FEATURES`: the registry and `feature_value` agree, and a test holds them to it.
G1, G2, G3, G4, G5, G6, G7, G8, G19 = range(9)
LAST_INLINED = G19
"""The kinds up to this one are evaluated by `feature_or_cosine`, those after it by `later_feature`."""
LANES = 64
"""Frames whose features are calculated side by side: as many as a word has bits."""
_ROUNDING = 1e-9
"""Nearer to a limit than this, a cosine does not tell the side of the limit on which its angle lies."""


@kernel(inline=True)
def _length(points, a, b):
    x, y, z = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    return math.sqrt(x * x + y * y + z * z)


@kernel(inline=True)
def _cosine(ux, uy, uz, vx, vy, vz):
    # One root for both lengths.
    norm = math.sqrt((ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz))
    return (ux * vx + uy * vy + uz * vz) / norm if norm != 0.0 else 1.0


@kernel(inline=True)
def _angle(cosine):
    # Rounding may take a cosine beyond 1, where the angle would be NaN.
    if cosine >= 1.0:
        return 0.0
    if cosine <= -1.0:
        return math.pi
    return math.acos(cosine)


@kernel
def feature_value(kind, points, a, b, c, d):
    """One feature over the points at rows a, b, c, d (those that the kind does not need are ignored).

    IN  kind, place in `features.FEATURES`; points (n, 3) m, z up, or with their motion (n, WIDTH); a, b, c, d rows
    Returns m, m2, rad, a ratio, m/s or m2/s2; 0 where points coincide and the value is undefined; NaN where a point is missing, or its
    motion where the kind reads it. O(1).
    Thesis table 4.1; `motion_kernels.motion_feature`. Twin: `feature` in tests/twins.py
    """
    # Two kernels, because one with all kinds would be too large to be inlined into the searches.
    if kind > LAST_INLINED:
        return later_feature(kind, points, a, b, c)
    value = feature_or_cosine(kind, points, a, b, c, d)
    return _angle(value) if kind in (G1, G6, G7) else value


@kernel
def later_feature(kind, points, a, b, c):
    """`feature_value` of the kinds that `feature_or_cosine` does not have: the unit normal's vertical part, and motion.

    IN  as `feature_value`. Returns the value. O(1).
    """
    if kind != G9:
        return motion_feature(kind, points, a, b, c)
    bx, by, bz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    cx, cy, cz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    x, y, z = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    norm = math.sqrt(x * x + y * y + z * z)
    return z / norm if norm != 0.0 else 0.0


@kernel
def feature_or_cosine(kind, points, a, b, c, d):
    """`feature_value` of the kinds up to LAST_INLINED, with the cosine in place of an angle: as good for a comparison, and faster.

    IN  as `feature_value`. Returns the value or cosine. O(1).
    The caller evaluates other kinds with `later_feature`. With that call in here, this kernel would be too large to be inlined.
    """
    if kind == G2:
        return _length(points, a, b)
    if kind == G4:
        return points[a, 2] - points[b, 2]
    bx, by, bz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    if kind == G7:
        return _cosine(bx, by, bz, 0.0, 0.0, 1.0)
    if kind == G3:
        first, second = _length(points, a, b), _length(points, c, d)
        return 2.0 * (first - second) / (first + second) if first + second != 0.0 else 0.0
    if kind == G6:
        return _cosine(bx, by, bz, points[d, 0] - points[c, 0], points[d, 1] - points[c, 1], points[d, 2] - points[c, 2])
    cx, cy, cz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    if kind == G19:
        return bx * cy - by * cx
    if kind == G1:
        return _cosine(bx, by, bz, cx, cy, cz)
    if kind == G5:
        other = math.sqrt(cx * cx + cy * cy + cz * cz)
        return math.sqrt(bx * bx + by * by + bz * bz) / other if other != 0.0 else 0.0
    x, y, z = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    return 0.5 * math.sqrt(x * x + y * y + z * z)


@kernel
def feature_ranges(frames, groups, n_groups, kinds, slots, low, high):
    """Smallest and largest value of each feature over the frames of each group (person).

    IN  frames (N, M, 3) m, NaN where missing; groups (N,) int; kinds (F,); slots (F, 4) marker of each point
    OUT low, high (F, n_groups), +inf and -inf where a group never shows all the feature's points
    O(F N). Eq. 4.4 and section 4.3, step 2. Twin: tests/test_weak.py
    """
    low[:] = np.inf
    high[:] = -np.inf
    for f in range(len(kinds)):
        a, b, c, d = slots[f, 0], slots[f, 1], slots[f, 2], slots[f, 3]
        for t in range(len(frames)):
            value = feature_value(kinds[f], frames[t], a, b, c, d)
            # NaN is neither less nor greater, so missing points widen no range.
            if value < low[f, groups[t]]:
                low[f, groups[t]] = value
            if value > high[f, groups[t]]:
                high[f, groups[t]] = value


@kernel
def _lane_values(kind, x, y, z, a, b, c, d, out):
    """`feature_or_cosine` of one kind up to LAST_INLINED in each of LANES frames, whose points are x, y, z (M, LANES) m.

    The loops hold no call and no branch, so they run in vector registers; the operations and their order are those of `feature_or_cosine`.
    """
    ax, ay, az, bx, by, bz = x[a], y[a], z[a], x[b], y[b], z[b]
    cx, cy, cz, dx, dy, dz = x[c], y[c], z[c], x[d], y[d], z[d]
    for n in range(LANES):
        ux, uy, uz = bx[n] - ax[n], by[n] - ay[n], bz[n] - az[n]
        if kind == G2:
            out[n] = math.sqrt(ux * ux + uy * uy + uz * uz)
        elif kind == G4:
            out[n] = az[n] - bz[n]
        elif kind == G7:
            out[n] = _cosine(ux, uy, uz, 0.0, 0.0, 1.0)
        elif kind == G3:
            vx, vy, vz = dx[n] - cx[n], dy[n] - cy[n], dz[n] - cz[n]
            first, second = math.sqrt(ux * ux + uy * uy + uz * uz), math.sqrt(vx * vx + vy * vy + vz * vz)
            out[n] = 2.0 * (first - second) / (first + second) if first + second != 0.0 else 0.0
        elif kind == G6:
            out[n] = _cosine(ux, uy, uz, dx[n] - cx[n], dy[n] - cy[n], dz[n] - cz[n])
        else:
            vx, vy, vz = cx[n] - ax[n], cy[n] - ay[n], cz[n] - az[n]
            if kind == G19:
                out[n] = ux * vy - uy * vx
            elif kind == G1:
                out[n] = _cosine(ux, uy, uz, vx, vy, vz)
            elif kind == G5:
                other = math.sqrt(vx * vx + vy * vy + vz * vz)
                out[n] = math.sqrt(ux * ux + uy * uy + uz * uz) / other if other != 0.0 else 0.0
            else:
                wx, wy, wz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
                out[n] = 0.5 * math.sqrt(wx * wx + wy * wy + wz * wz)


@kernel
def mark_rejections(frames, labels, kinds, slots, low, high, out):
    """Which weak classifiers reject which labellings, as bits.

    IN  frames (N, M, 3) m; labels (N, M) row of the point that each marker is given; kinds (F,), slots (F, 4), low, high (F,)
    OUT out (F, ceil(N / 64)) uint64, bit n set where classifier f rejects labelling n
    O(F N). Eq. 4.4. Twin: `rejects` in tests/twins.py
    """
    markers = labels.shape[1]
    x, y, z, values = np.empty((markers, LANES)), np.empty((markers, LANES)), np.empty((markers, LANES)), np.empty(LANES)
    for word in range(out.shape[1]):
        first = LANES * word
        # The last word may be part empty; its lanes repeat the last frame and are not read.
        here = min(LANES, len(frames) - first)
        for n in range(LANES):
            frame = first + min(n, here - 1)
            for m in range(markers):
                point = labels[frame, m]
                x[m, n], y[m, n], z[m, n] = frames[frame, point, 0], frames[frame, point, 1], frames[frame, point, 2]
        for f in range(len(kinds)):
            kind, a, b, c, d = kinds[f], slots[f, 0], slots[f, 1], slots[f, 2], slots[f, 3]
            if kind > LAST_INLINED:
                for n in range(here):
                    points, row = frames[first + n], labels[first + n]
                    values[n] = later_feature(kind, points, row[a], row[b], row[c])
            else:
                _lane_values(kind, x, y, z, a, b, c, d, values)
            bits = np.uint64(0)
            near, far = low[f], high[f]
            if kind in (G1, G6, G7):
                # No angle is below 0 or above pi.
                # A cosine falls with its angle, so that the limits change places.
                near = math.cos(min(max(high[f], 0.0), math.pi)) if high[f] < math.pi else -np.inf
                far = math.cos(min(max(low[f], 0.0), math.pi)) if low[f] > 0.0 else np.inf
                for n in range(here):
                    rejected = values[n] < near - _ROUNDING or values[n] > far + _ROUNDING
                    # So near to a limit rounding decides, and the angle itself must.
                    if not rejected and not near + _ROUNDING < values[n] < far - _ROUNDING:
                        angle = _angle(values[n])
                        rejected = angle < low[f] or angle > high[f]
                    bits |= np.uint64(rejected) << np.uint64(n)
            else:
                for n in range(here):
                    bits |= np.uint64(values[n] < near or values[n] > far) << np.uint64(n)
            out[f, word] = bits


@kernel
def count_rejected(frames, choice, labels, kinds, slots, low, high):
    """How many of some labellings at least one of the weak classifiers rejects (eq. 4.5 below 1).

    IN  frames (N, M, 3) m; choice (K,) frame of each labelling; labels (K, M) row of the point that each marker is given
    Returns the number of labellings rejected. O(K F) at worst: the first classifier that rejects a labelling ends its check.
    Twin: `rejects` in tests/twins.py
    """
    total = 0
    for k in range(len(choice)):
        points = frames[choice[k]]
        for f in range(len(kinds)):
            value = feature_value(
                kinds[f], points, labels[k, slots[f, 0]], labels[k, slots[f, 1]], labels[k, slots[f, 2]], labels[k, slots[f, 3]]
            )
            if value < low[f] or value > high[f]:
                total += 1
                # One that rejects is enough.
                break
    return total


@kernel
def point_distances(points, n, out):
    """Distances between the first n points.

    IN  points (>= n, 3 or more) m
    OUT out (>= n, >= n) m
    O(n^2).
    """
    for i in range(n):
        out[i, i] = 0.0
        for j in range(i):
            out[i, j] = _length(points, i, j)
            out[j, i] = out[i, j]
