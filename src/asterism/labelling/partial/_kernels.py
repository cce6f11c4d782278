"""Feature and tree-search kernels: points and solvers as flat arrays in, feature values and feasible labellings out.

All of them take the vertical as +z; `geometry.rotate_z_up` has turned the points before they come here. Their plain twins are in
`tests/twins.py`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.labelling.partial._motion_kernels import moving_feature

# Order of `features.FEATURES`: the registry and `feature` below agree, and a test holds them to it.
G1, G2, G3, G4, G5, G6, G7, G8, G9 = range(9)


@kernel(inline=True)
def _length(points, a, b):
    x, y, z = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    return math.sqrt(x * x + y * y + z * z)


@kernel(inline=True)
def _cosine(ux, uy, uz, vx, vy, vz):
    norm = math.sqrt((ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz))
    if norm == 0.0:
        return 1.0
    return (ux * vx + uy * vy + uz * vz) / norm


@kernel
def feature(kind, points, a, b, c, d):
    """One feature over the points at rows a, b, c, d (those that the kind does not need are ignored).

    IN  kind, place in `features.FEATURES`; points (n, 3) m, z up, or with their motion (n, WIDTH); a, b, c, d rows
    Gives m, m2, rad, a ratio, m/s or m2/s2; 0 where points coincide and the value is undefined; NaN where a point is missing, or its motion
    where the kind needs it. O(1).
    Thesis table 4.1; `motion._kernels.moving_feature`. Twin: tests/twins.py
    """
    if kind > G9:
        return moving_feature(kind, points, a, b, c)
    value = bare_feature(kind, points, a, b, c, d)
    if kind in (G1, G6, G7):
        if value >= 1.0:
            return 0.0
        if value <= -1.0:
            return math.pi
        return math.acos(value)
    return value


@kernel
def bare_feature(kind, points, a, b, c, d):
    """`feature` up to G9, but of angles the cosine: as good for a comparison, and quicker. O(1).

    The caller sends the others to `moving_feature` itself: with that call in here this would be too large to be inlined.
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
    if kind == G9:
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
    O(F N). Eq. 4.4 and section 4.3, step 2.
    """
    low[:] = np.inf
    high[:] = -np.inf
    for f in range(len(kinds)):
        a, b, c, d = slots[f, 0], slots[f, 1], slots[f, 2], slots[f, 3]
        for t in range(len(frames)):
            value = feature(kinds[f], frames[t], a, b, c, d)
            if value < low[f, groups[t]]:
                low[f, groups[t]] = value
            if value > high[f, groups[t]]:
                high[f, groups[t]] = value


@kernel
def rejections(frames, labels, kinds, slots, low, high, out):
    """Which weak classifiers reject which labellings, as bits.

    IN  frames (N, M, 3) m; labels (N, M) row of the point that each marker is given; kinds (F,), slots (F, 4), low, high (F,)
    OUT out (F, ceil(N / 64)) uint64, bit n set where classifier f rejects labelling n
    O(F N). Eq. 4.4.
    """
    out[:] = 0
    for f in range(len(kinds)):
        for n in range(len(frames)):
            value = feature(
                kinds[f], frames[n], labels[n, slots[f, 0]], labels[n, slots[f, 1]], labels[n, slots[f, 2]], labels[n, slots[f, 3]]
            )
            if value < low[f] or value > high[f]:
                out[f, n >> 6] |= np.uint64(1) << np.uint64(n & 63)


class SolverArrays(NamedTuple):
    """Solvers, one after the other in flat arrays; what `search` walks over.

    markers        marker of each depth, solver s owns markers[first_depth[s]:first_depth[s + 1]]
    first_feature  (depths + 1,) classifiers that become computable at a depth
    kinds, slots   feature, and the depths (within the solver) of its points: (C,), (C, 4)
    low, high      (C,) interval of each classifier
    """

    first_depth: np.ndarray
    markers: np.ndarray
    first_feature: np.ndarray
    kinds: np.ndarray
    slots: np.ndarray
    low: np.ndarray
    high: np.ndarray


@kernel
def search(solvers, s, points, order, budget, found, counters):
    """All labellings of one solver's markers that every weak classifier accepts: the tree search of section 4.4.2.

    A classifier is evaluated at the first depth at which its points are assigned; the first that rejects cuts the branch.

    IN   solvers SolverArrays; s which of them; points (n, 3) m, z up; order (n,) rows in the order in which to try them
         budget, feature evaluations after which the search gives up
    OUT  found (S, >= depth) rows of `points` by depth; counters (2,): evaluations made (added to), evaluations until the first solution
    Returns the number of labellings found, or -1 where the budget or S did not suffice: then nothing may be concluded.
    O(n ** depth) at worst, in practice about n per depth and living branch; no memory but the path.
    """
    depths = solvers.first_depth[s + 1] - solvers.first_depth[s]
    n = len(points)
    path, tried = np.empty(depths, dtype=np.int64), np.empty(depths, dtype=np.int64)
    used = np.empty(n, dtype=np.bool_)
    return search_in(solvers, s, points, n, np.empty((0, 0)), order, budget, found, counters, path, tried, used)


@kernel
def search_in(solvers, s, points, n, distance, order, budget, found, counters, path, tried, used):
    """`search` over the first n points with the caller's memory: path, tried (>= depths,), used (>= n,).

    IN  distance (>= n, >= n) m between the points, or empty (0, 0): then every distance is computed where it is needed
    """
    first = solvers.first_depth[s]
    depths = solvers.first_depth[s + 1] - first
    if n < depths:
        return 0
    known = len(distance) > 0
    tried[:depths] = 0
    used[:n] = False
    depth, solutions, evaluations = 0, 0, counters[0]
    while depth >= 0:
        if tried[depth] > 0:
            used[path[depth]] = False
        accepted = False
        begin, end = solvers.first_feature[first + depth], solvers.first_feature[first + depth + 1]
        while tried[depth] < n and not accepted:
            row = order[tried[depth]]
            tried[depth] += 1
            if used[row]:
                continue
            path[depth] = row
            accepted = True
            for f in range(begin, end):
                evaluations += 1
                kind = solvers.kinds[f]
                a, b = path[solvers.slots[f, 0]], path[solvers.slots[f, 1]]
                if known and kind == G2:
                    value = distance[a, b]
                elif kind == G4:
                    value = points[a, 2] - points[b, 2]
                elif kind == G9:
                    c = path[solvers.slots[f, 2]]
                    value = (points[b, 0] - points[a, 0]) * (points[c, 1] - points[a, 1])
                    value -= (points[b, 1] - points[a, 1]) * (points[c, 0] - points[a, 0])
                else:
                    value = feature(kind, points, a, b, path[solvers.slots[f, 2]], path[solvers.slots[f, 3]])
                if value < solvers.low[f] or value > solvers.high[f]:
                    accepted = False
                    break
        if evaluations > budget:
            counters[0] = evaluations
            return -1
        if not accepted:
            # `path[depth]` still names the last rejected row, which is not in use: clear the level and step back.
            tried[depth] = 0
            depth -= 1
            continue
        used[path[depth]] = True
        if depth == depths - 1:
            if solutions == 0:
                counters[1] = evaluations
            if solutions == len(found):
                counters[0] = evaluations
                return -1
            for k in range(depths):
                found[solutions, k] = path[k]
            solutions += 1
        else:
            depth += 1
    counters[0] = evaluations
    return solutions


@kernel
def common(found, solutions, depths, out):
    """Where all labellings that a solver found agree.

    OUT out (>= depths,): the row of each depth, -1 where they differ. O(solutions depths).
    """
    for k in range(depths):
        out[k] = found[0, k] if solutions > 0 else -1
        for i in range(1, solutions):
            if found[i, k] != found[0, k]:
                out[k] = -1
                break


@kernel
def distances(points, n, out):
    """OUT out (>= n, >= n) m: distances between the first n points. O(n^2)."""
    for i in range(n):
        out[i, i] = 0.0
        for j in range(i):
            out[i, j] = _length(points, i, j)
            out[j, i] = out[i, j]


@kernel
def highest_first(points, n, order):
    """OUT order (>= n,): rows of the first n points, highest first, equal heights in row order. O(n^2), n is small."""
    for i in range(n):
        j = i
        while j > 0 and points[order[j - 1], 2] < points[i, 2]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = i


@kernel(inline=True)
def popcount(word):
    """How many bits of a uint64 are set."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@kernel
def cover(table, wrong, weight, most, chosen, gains):
    """Greedy choice of weak classifiers that together reject as many wrong labellings as they can (section 4.4.1).

    Weights are whole numbers, so that equal inputs give equal choices. When nothing is left to gain, a second round goes over all samples
    with the classifiers that remain: then each sample is rejected twice, and so on.

    IN  table (F, W) uint64 which samples each classifier rejects; wrong (W,) which samples count; weight (W,) int of a word's samples
        most, how many to choose
    OUT chosen (>= most,) rows of table in order; gains (>= most,) weight of the samples that each adds in its round
    Returns how many were chosen, and how many of these the first round took. O(most F W).
    """
    features, words = table.shape
    left = wrong.copy()
    taken = np.zeros(features, dtype=np.bool_)
    count, first_round, fresh = 0, -1, True
    while count < most:
        best, best_gain = -1, 0
        for f in range(features):
            if taken[f]:
                continue
            gain = 0
            for w in range(words):
                gain += weight[w] * popcount(table[f, w] & left[w])
            if gain > best_gain:
                best, best_gain = f, gain
        if best < 0:
            if first_round < 0:
                first_round = count
            if fresh:
                break
            left[:] = wrong
            fresh = True
            continue
        fresh = False
        taken[best] = True
        chosen[count], gains[count] = best, best_gain
        count += 1
        for w in range(words):
            left[w] &= ~table[best, w]
    return count, first_round if first_round >= 0 else count


@kernel
def rejected(frames, choice, labels, kinds, slots, low, high):
    """How many of some labellings at least one of the weak classifiers rejects (eq. 4.5 below 1).

    IN  frames (N, M, 3) m; choice (K,) frame of each labelling; labels (K, M) row of the point that each marker is given
    O(K F) at worst, the first classifier that rejects ends it.
    """
    total = 0
    for k in range(len(choice)):
        points = frames[choice[k]]
        for f in range(len(kinds)):
            value = feature(
                kinds[f], points, labels[k, slots[f, 0]], labels[k, slots[f, 1]], labels[k, slots[f, 2]], labels[k, slots[f, 3]]
            )
            if value < low[f] or value > high[f]:
                total += 1
                break
    return total


@kernel
def label_whole(solvers, lowest_first, xyz, offsets, budget, indices, first, total):
    """Label frames with solver 0 alone: a marker is given where all feasible labellings of the frame agree on its point.

    IN  lowest_first, whether low points are tried first, else high ones; xyz (P, 3) m, offsets (T + 1,)
        budget, feature evaluations per frame
    OUT indices (T, M) by marker, -1 for none; first, total (T,) evaluations until the first feasible labelling (-1 without one), and in all
    No allocation per frame. Section 5.2.
    """
    depths = solvers.first_depth[1]
    most = 0
    for t in range(len(offsets) - 1):
        most = max(most, offsets[t + 1] - offsets[t])
    path, tried = np.empty(depths, dtype=np.int64), np.empty(depths, dtype=np.int64)
    used, order = np.empty(most, dtype=np.bool_), np.empty(most, dtype=np.int64)
    found, agreed = np.empty((64, depths), dtype=np.int64), np.empty(depths, dtype=np.int64)
    counters, distance = np.zeros(2, dtype=np.int64), np.empty((most, most))
    indices[:] = -1
    for t in range(len(offsets) - 1):
        points, n = xyz[offsets[t] : offsets[t + 1]], offsets[t + 1] - offsets[t]
        highest_first(points, n, order)
        if lowest_first:
            order[:n] = order[:n][::-1].copy()
        distances(points, n, distance)
        counters[0] = 0
        solutions = search_in(solvers, 0, points, n, distance, order, budget, found, counters, path, tried, used)
        total[t] = counters[0]
        first[t] = counters[1] if solutions > 0 else -1
        common(found, solutions, depths, agreed)
        for k in range(depths):
            indices[t, solvers.markers[k]] = agreed[k]


class PairRules(NamedTuple):
    """What two markers' points must keep to, for all solvers of an ensemble alike: what `search_by_pairs` checks first.

    near, far     (M, M) m, distance; -inf and inf where nothing is known
    below, above  (M, M) m, height of the first marker over the second
    kinds         (K,) features of two points' motion that the solvers use, none for a solver of single frames
    low, high     (K, M, M) their intervals; a value that is not known (NaN) keeps to them
    """

    near: np.ndarray
    far: np.ndarray
    below: np.ndarray
    above: np.ndarray
    kinds: np.ndarray
    low: np.ndarray
    high: np.ndarray


class Bench(NamedTuple):
    """The memory of `search_by_pairs` for frames of up to n points and solvers of up to D markers, W = ceil(n / 64).

    points    (n, 3) m, the frame's points, highest first, with their motion (n, WIDTH) where solvers need it; order (n,) their rows
    distance  (n, n) m; motion (K, n, n) the features of two points' motion
    rows      (M, M, n, W) bits: with marker a at point i, which points marker b may have; stamp (M, M, n) the frame they were made for
    mask      (D, W) points still to try at each depth; path (D,) point at each depth
    found     (32, D) labellings; agreed (D,) where they agree
    counters  (2,) feature evaluations so far, until the first labelling
    """

    points: np.ndarray
    order: np.ndarray
    distance: np.ndarray
    motion: np.ndarray
    rows: np.ndarray
    stamp: np.ndarray
    mask: np.ndarray
    path: np.ndarray
    found: np.ndarray
    agreed: np.ndarray
    counters: np.ndarray


@kernel
def make_bench(markers, n, depths, width, motions):
    """Memory for M markers, n points of so many numbers, D depths, K features of two points' motion."""
    words = (n + 63) // 64
    return Bench(
        np.empty((n, width)),
        np.empty(n, dtype=np.int64),
        np.empty((n, n)),
        np.empty((motions, n, n)),
        np.empty((markers, markers, n, words), dtype=np.uint64),
        np.full((markers, markers, n), -1, dtype=np.int64),
        np.empty((depths, words), dtype=np.uint64),
        np.empty(depths, dtype=np.int64),
        np.empty((32, depths), dtype=np.int64),
        np.empty(depths, dtype=np.int64),
        np.zeros(2, dtype=np.int64),
    )


@kernel
def lay_out(points, n, kinds, bench):
    """Put a frame's first n points on the bench, highest first, with their distances and features (K,) of their motion. O(n^2 K)."""
    highest_first(points, n, bench.order)
    for i in range(n):
        for axis in range(bench.points.shape[1]):
            bench.points[i, axis] = points[bench.order[i], axis]
    distances(bench.points, n, bench.distance)
    for k in range(len(kinds)):
        for i in range(n):
            for j in range(n):
                bench.motion[k, i, j] = moving_feature(kinds[k], bench.points, i, j, 0)


@kernel
def search_by_pairs(solvers, pairs, s, n, now, budget, bench):
    """`search` for an ensemble: what pairs of points allow is looked up as bits, made when first needed and shared by the frame's solvers.

    IN  solvers SolverArrays without the classifiers in `pairs`, angles by their cosines, motion behind all others (`solver.share_pairs`)
        n points on the bench; now, a number of the frame that is new to the bench
        budget, feature evaluations for this solver on this frame; distance and height of a pair of points count as one
    OUT bench.found points (rows of bench.points) by depth; bench.counters
    Returns the number of labellings found, or -1 where the budget or the room for labellings did not suffice.
    """
    first = solvers.first_depth[s]
    depths = solvers.first_depth[s + 1] - first
    bench.counters[0] = 0
    if n < depths:
        return 0
    words = (n + 63) // 64
    points, path, mask = bench.points, bench.path, bench.mask
    everything(mask, 0, n)
    depth, solutions, evaluations = 0, 0, 0
    while depth >= 0:
        row = -1
        for w in range(words):
            if mask[depth, w] != 0:
                lowest = mask[depth, w] & (~mask[depth, w] + np.uint64(1))
                mask[depth, w] ^= lowest
                row = 64 * w + popcount(lowest - np.uint64(1))
                break
        if row < 0:
            depth -= 1
            continue
        path[depth] = row
        accepted = True
        moving = end = solvers.first_feature[first + depth + 1]
        for f in range(solvers.first_feature[first + depth], end):
            if solvers.kinds[f] > G9:
                moving = f
                break
            evaluations += 1
            value = bare_feature(
                solvers.kinds[f],
                points,
                path[solvers.slots[f, 0]],
                path[solvers.slots[f, 1]],
                path[solvers.slots[f, 2]],
                path[solvers.slots[f, 3]],
            )
            if value < solvers.low[f] or value > solvers.high[f]:
                accepted = False
                break
        if accepted and moving < end:
            accepted, made = moves_as_learned(solvers, moving, end, points, path)
            evaluations += made
        if evaluations > budget:
            bench.counters[0] = evaluations
            return -1
        if not accepted:
            continue
        if depth == depths - 1:
            if solutions == 0:
                bench.counters[1] = evaluations
            if solutions == len(bench.found):
                bench.counters[0] = evaluations
                return -1
            for k in range(depths):
                bench.found[solutions, k] = path[k]
            solutions += 1
            continue
        depth += 1
        b = solvers.markers[first + depth]
        everything(mask, depth, n)
        for e in range(depth):
            a, i = solvers.markers[first + e], path[e]
            if bench.stamp[a, b, i] != now:
                bench.stamp[a, b, i] = now
                evaluations += allowed_points(pairs, a, b, i, n, bench)
                if len(pairs.kinds) > 0:
                    evaluations += forbid_by_motion(pairs, a, b, i, n, bench)
            living = np.uint64(0)
            for w in range(words):
                mask[depth, w] &= bench.rows[a, b, i, w]
                living |= mask[depth, w]
            if living == 0:
                break
    bench.counters[0] = evaluations
    return solutions


@kernel
def moves_as_learned(solvers, begin, end, points, path):
    """Whether classifiers begin to end, all of motion, accept the points of a path; and how many were evaluated. O(end - begin)."""
    for f in range(begin, end):
        slots = solvers.slots[f]
        value = moving_feature(solvers.kinds[f], points, path[slots[0]], path[slots[1]], path[slots[2]])
        if value < solvers.low[f] or value > solvers.high[f]:
            return False, f + 1 - begin
    return True, end - begin


@kernel(inline=True)
def everything(mask, depth, n):
    """OUT mask[depth]: the first n bits set."""
    for w in range((n + 63) // 64):
        left = n - 64 * w
        mask[depth, w] = ~np.uint64(0) if left >= 64 else (np.uint64(1) << np.uint64(left)) - np.uint64(1)


@kernel
def allowed_points(pairs, a, b, i, n, bench):
    """OUT bench.rows[a, b, i]: the points that marker b may have while marker a has point i. Returns the evaluations made. O(n)."""
    near, far, below, above = pairs.near[a, b], pairs.far[a, b], pairs.below[a, b], pairs.above[a, b]
    height = bench.points[i, 2]
    for w in range((n + 63) // 64):
        bits = np.uint64(0)
        for j in range(64 * w, min(n, 64 * w + 64)):
            d, h = bench.distance[i, j], height - bench.points[j, 2]
            fits = (d >= near) & (d <= far) & (h >= below) & (h <= above) & (i != j)
            bits |= np.uint64(fits) << np.uint64(j - 64 * w)
        bench.rows[a, b, i, w] = bits
    return n


@kernel
def forbid_by_motion(pairs, a, b, i, n, bench):
    """OUT bench.rows[a, b, i]: without the points whose motion does not go with that of point i. Returns the evaluations made. O(n K).

    Apart from `allowed_points`, whose loop would be slower with it.
    """
    evaluations = 0
    for k in range(len(pairs.kinds)):
        low, high = pairs.low[k, a, b], pairs.high[k, a, b]
        for j in range(n):
            bit = np.uint64(1) << np.uint64(j & 63)
            if bench.rows[a, b, i, j >> 6] & bit != 0:
                evaluations += 1
                value = bench.motion[k, i, j]
                if value < low or value > high:
                    bench.rows[a, b, i, j >> 6] ^= bit
    return evaluations


@kernel
def expose(solvers, pairs, s, frames, choice, hidden, lost, budget, allowed, bench, now, hits, failures, silent):
    """Expose one solver to frames some of whose markers are hidden, and count against the truth (section 4.5.1, hit rates).

    A solver proposes a point for a marker where all labellings that it found agree on it. With the marker in sight a proposal of its
    point is a hit. A proposal of any other point is a failure. No proposal is silence.

    IN  solvers, pairs as in `search_by_pairs`; frames (N, M, 3) m, NaN where missing, or (N, M, WIDTH)
        choice (E,) frame of each exposure; hidden, lost (E, M) bool, markers hidden, and those whose motion is not known
        budget, evaluations per exposure
        allowed, failures after which a marker is hopeless, as it is after 50 silences that are four times its hits
        (where all are, the count stops)
        now, as many numbers from here on as there are exposures are new to the bench
    OUT hits, failures, silent (M,) set to the counts, all markers; silent: own markers all in sight and yet no proposal
    Returns the number of exposures made. O(E times a search).
    """
    first = solvers.first_depth[s]
    depths = solvers.first_depth[s + 1] - first
    markers = frames.shape[1]
    points, row = np.empty((markers, frames.shape[2])), np.empty(markers, dtype=np.int64)
    hits[:] = 0
    failures[:] = 0
    silent[:] = 0
    for e in range(len(choice)):
        n = 0
        for m in range(markers):
            row[m] = -1
            if not hidden[e, m] and not np.isnan(frames[choice[e], m, 0]):
                points[n] = frames[choice[e], m]
                if lost[e, m]:
                    points[n, 3:] = np.nan
                row[m] = n
                n += 1
        lay_out(points, n, pairs.kinds, bench)
        complete = True
        for k in range(depths):
            complete = complete and row[solvers.markers[first + k]] >= 0
        solutions = search_by_pairs(solvers, pairs, s, n, now + e, budget, bench)
        common(bench.found, solutions, depths, bench.agreed)
        hopeless = True
        for k in range(depths):
            m = solvers.markers[first + k]
            if bench.agreed[k] < 0:
                silent[m] += complete
            elif bench.order[bench.agreed[k]] == row[m]:
                hits[m] += 1
            else:
                failures[m] += 1
            hopeless = hopeless and (failures[m] > allowed or (silent[m] > 50 and silent[m] > 4 * hits[m]))
        if hopeless:
            return e + 1
    return len(choice)


class Whole(NamedTuple):
    """The strong classifier of the whole model, arranged to test one marker at a time.

    first         (M + 1,) marker m owns classifiers first[m]:first[m + 1], all that read it, the most rejecting first
    kinds, slots  (C,), (C, 4) markers, the first `points` of them in use
    points        (C,) how many points a classifier reads
    low, high     (C,) as in `search_by_pairs`, angles by their cosines
    """

    first: np.ndarray
    kinds: np.ndarray
    slots: np.ndarray
    points: np.ndarray
    low: np.ndarray
    high: np.ndarray


@kernel
def fits(whole, m, place, points, slack, least):
    """How well marker m at its place goes with all the markers that have one.

    IN  place (M,) row of `points` of each marker, -1 for none; slack, share of an interval by which a value may miss it and nearly fit
        least, classifiers that must have had a say
    Returns (2 where all accept, 1 where none is missed by more than the slack, else 0; evaluations made). O(classifiers that read m).
    A value that is not known (NaN) has no say.
    """
    evaluations, said, level = 0, 0, 2
    for f in range(whole.first[m], whole.first[m + 1]):
        a, b, c, d = place[whole.slots[f, 0]], place[whole.slots[f, 1]], place[whole.slots[f, 2]], place[whole.slots[f, 3]]
        used = whole.points[f]
        if a < 0 or b < 0 or (used > 2 and c < 0) or (used > 3 and d < 0):
            continue
        evaluations += 1
        kind = whole.kinds[f]
        value = bare_feature(kind, points, a, b, c, d) if kind <= G9 else moving_feature(kind, points, a, b, c)
        said += value == value
        low, high = whole.low[f], whole.high[f]
        if value < low or value > high:
            level = 1
            room = slack * (high - low)
            if value < low - room or value > high + room:
                return 0, evaluations
    return level if said >= least else min(level, 1), evaluations


@kernel
def complete(whole, points, n, place, taken, levels, rounds, slack, least):
    """Give the free points to markers without one, where the strong classifier of the whole model leaves no choice.

    A marker gets a point that fits it, given the markers that have theirs, if no other free point nearly fits it, and if the point nearly
    fits no other marker that lacks one: the safe rules of the labelling matrix, stricter. New labels speak in the next round.

    IN  points (n, 3); rounds at most; slack, least as in `fits`. levels (M, n) int is memory.
    OUT place (M,), taken (n,) bool: completed
    Returns the evaluations made.
    """
    markers, evaluations = len(place), 0
    for _ in range(rounds):
        for m in range(markers):
            for c in range(n):
                levels[m, c] = 0
                if place[m] < 0 and not taken[c]:
                    place[m] = c
                    levels[m, c], made = fits(whole, m, place, points, slack, least)
                    evaluations += made
                    place[m] = -1
        changed = False
        for m in range(markers):
            if place[m] >= 0:
                continue
            near, only = 0, -1
            for c in range(n):
                near += levels[m, c] > 0
                if levels[m, c] == 2:
                    only = c
            if near != 1 or only < 0:
                continue
            rivals = 0
            for other in range(markers):
                rivals += levels[other, only] > 0
            if rivals == 1:
                place[m], taken[only], changed = only, True, True
        if not changed:
            break
    return evaluations


@kernel
def label_by_matrix(solvers, pairs, trusted, whole, outvote, slack, least, xyz, offsets, budget, indices, votes, evaluations):
    """Label frames with an ensemble of partial solvers through the labelling matrix and its safe rules (section 4.5.4).

    A solver proposes a point for a marker where all labellings that it found agree on it and it is trusted with the marker. A column
    with proposals of two points, and a row with proposals of two markers, give null.

    IN  solvers, pairs as in `search_by_pairs`; trusted (D,) bool whether the solver may propose the marker of this depth
        whole, the strong classifier of the whole model: a label then takes two solvers that propose it (where there are
        two), or `outvote` times as many as propose otherwise, and `complete` has the last word (slack, least); a model without markers:
        the thesis' rules alone
        xyz (P, 3) m, or (P, WIDTH) with their motion; offsets (T + 1,)
        budget, feature evaluations per frame and solver, after which a solver proposes nothing
    OUT indices (T, M) -1 for none; votes (T, M) of the solvers trusted with the marker the share that propose the point given, or, for a
        null, the point most often proposed; evaluations (T,) feature evaluations
    No allocation per frame. O(T times solvers times a search).
    """
    frames, markers = indices.shape
    count = len(solvers.first_depth) - 1
    most, deepest = 1, 1
    for t in range(frames):
        most = max(most, offsets[t + 1] - offsets[t])
    able = np.zeros(markers, dtype=np.int64)
    for s in range(count):
        deepest = max(deepest, solvers.first_depth[s + 1] - solvers.first_depth[s])
        for k in range(solvers.first_depth[s], solvers.first_depth[s + 1]):
            able[solvers.markers[k]] += trusted[k]
    bench, matrix = make_bench(markers, most, deepest, xyz.shape[1], len(pairs.kinds)), np.empty((markers, most), dtype=np.int64)
    lone = np.empty(markers, dtype=np.int64)
    place, taken, levels = np.empty(markers, dtype=np.int64), np.empty(most, dtype=np.bool_), np.empty((markers, most), dtype=np.int64)
    for t in range(frames):
        n = offsets[t + 1] - offsets[t]
        lay_out(xyz[offsets[t] : offsets[t + 1]], n, pairs.kinds, bench)
        matrix[:, :n] = 0
        evaluations[t] = 0
        for s in range(count):
            first = solvers.first_depth[s]
            depths = solvers.first_depth[s + 1] - first
            solutions = search_by_pairs(solvers, pairs, s, n, t, budget, bench)
            evaluations[t] += bench.counters[0]
            if solutions <= 0:
                continue
            common(bench.found, solutions, depths, bench.agreed)
            for k in range(depths):
                if bench.agreed[k] >= 0 and trusted[first + k]:
                    matrix[solvers.markers[first + k], bench.agreed[k]] += 1
        place[:] = -1
        taken[:n] = False
        for m in range(markers):
            votes[t, m], lone[m] = 0.0, -1
            best, rivals = -1, 0
            for c in range(n):
                rivals += matrix[m, c]
                if matrix[m, c] > 0 and (best < 0 or matrix[m, c] > matrix[m, best]):
                    best = c
            if best < 0:
                continue
            mine = matrix[m, best]
            votes[t, m] = mine / able[m]
            for other in range(markers):
                rivals += matrix[other, best]
            rivals -= 2 * mine
            if rivals == 0 and mine == 1 and able[m] > 1 and len(whole.first) > 1:
                lone[m] = best
            elif rivals == 0 or (len(whole.first) > 1 and mine > outvote * rivals):
                place[m], taken[best] = best, True
        if len(whole.first) > 1:
            evaluations[t] += complete(whole, bench.points, n, place, taken, levels, 3, slack, least)
            for m in range(markers):
                if place[m] < 0 and lone[m] >= 0 and not taken[lone[m]]:
                    place[m] = lone[m]
                    level, made = fits(whole, m, place, bench.points, slack, least)
                    evaluations[t] += made
                    taken[lone[m]] = level == 2
                    if level < 2:
                        place[m] = -1
        for m in range(markers):
            indices[t, m] = bench.order[place[m]] if place[m] >= 0 else -1


@kernel
def arrange(table, reads, markers, start, order, rank, first_feature):
    """In which order to assign markers and to evaluate weak classifiers, so that wrong branches die early.

    From the first marker on, the next is always the one for which the classifiers that it makes computable reject the largest share of
    wrong points; at each depth the classifier that rejects most comes first, then the one that adds most, and so on.

    IN  table (F, M, R) uint64 bits: does classifier f reject when marker m alone is given a wrong point; reads (F, M) bool
        markers (D,) of the solver, start its first one
    OUT order (D,) markers by depth; rank (F,) classifiers by depth; first_feature (D + 1,)
    O(D^2 F R).
    """
    features, all_markers, words = table.shape
    placed, assigned = np.zeros(features, dtype=np.bool_), np.zeros(all_markers, dtype=np.bool_)
    open_marker = np.zeros(all_markers, dtype=np.bool_)
    for m in markers:
        open_marker[m] = True
    missing = np.zeros(features, dtype=np.int64)
    for f in range(features):
        for m in range(all_markers):
            missing[f] += reads[f, m]
    left = np.empty(words, dtype=np.uint64)
    count = 0
    for depth in range(len(markers)):
        best, best_share = start, -1
        if depth > 0:
            for m in range(all_markers):
                if not open_marker[m]:
                    continue
                share = 0
                for w in range(words):
                    any_bits = np.uint64(0)
                    for f in range(features):
                        if not placed[f] and missing[f] == 1 and reads[f, m]:
                            any_bits |= table[f, m, w]
                    share += popcount(any_bits)
                if share > best_share:
                    best, best_share = m, share
        order[depth] = best
        assigned[best] = True
        open_marker[best] = False
        first_feature[depth] = count
        for f in range(features):
            missing[f] -= reads[f, best]
        left[:] = ~np.uint64(0)
        while True:
            chosen, most = -1, -1
            for f in range(features):
                if placed[f] or missing[f] > 0 or not reads[f, best]:
                    continue
                gain = 0
                for w in range(words):
                    gain += popcount(table[f, best, w] & left[w])
                if gain > most:
                    chosen, most = f, gain
            if chosen < 0:
                break
            placed[chosen] = True
            rank[count] = chosen
            count += 1
            for w in range(words):
                left[w] &= ~table[chosen, best, w]
    first_feature[len(markers)] = count


@kernel
def confusions(whole, frames, choice, known, taken_for, shown):
    """In how many frames a marker's point could be taken for another marker, when only some labels are known, and these are right.

    It could if no classifier objects to the move (the other marker gets the point, the first one none) or to the swap of the two.

    IN  frames (N, M, 3) m, NaN where missing; choice (K,) frames to look at; known (K, M) bool, which labels are known in each
    OUT taken_for (M, M) int, row the marker whose point it is, column the marker that it is taken for; shown (M,) frames with the marker
    O(K M^2), most pairs end at the first classifier.
    """
    markers = frames.shape[1]
    place = np.empty(markers, dtype=np.int64)
    for k in range(len(choice)):
        points = frames[choice[k]]
        for a in range(markers):
            if np.isnan(points[a, 0]):
                continue
            shown[a] += 1
            taken_for[a, a] += 1
            for b in range(markers):
                if a == b:
                    continue
                for m in range(markers):
                    place[m] = m if known[k, m] and not np.isnan(points[m, 0]) else -1
                place[a], place[b] = -1, a
                could = fits(whole, b, place, points, 0.0, 1)[0] == 2
                if not could and not np.isnan(points[b, 0]):
                    place[a] = b
                    could = fits(whole, b, place, points, 0.0, 1)[0] == 2 and fits(whole, a, place, points, 0.0, 1)[0] == 2
                taken_for[a, b] += could
