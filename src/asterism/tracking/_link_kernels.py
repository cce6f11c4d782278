"""Linking kernels: points frame by frame in; which point continues which, and where a numbered track must be cut, out.

The rules stand in `linking.LinkRules`. The plain twins are in `tests/twins_links.py`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from asterism._jit import kernel


class LinkLimits(NamedTuple):
    """`linking.LinkRules` at one frame rate: lengths in m per frame, see `LinkRules.limits`.

    noise     error of a prediction that is always possible
    soft      acceleration over one frame that is always possible; hard: the most that ever is
    wild      residuals that a track has shown lately may grow so many times
    clearer   a rival must be so many times farther, and `apart` more
    strange   how far a new point may move unlike its nearest neighbours; spin: times the distance to them; unlike: times their disagreement
    fastest   how far a point may move of whose neighbourhood nothing is known
    quiet     a numbered track that misses less than that is never cut
    jump      a numbered track that misses more than that may be cut without another claim on the point
    """

    noise: float
    soft: float
    hard: float
    wild: float
    clearer: float
    apart: float
    strange: float
    spin: float
    unlike: float
    fastest: float
    quiet: float
    jump: float


class Ends(NamedTuple):
    """The tracks' last points, those of one frame; n of them.

    position      (n, 3) m
    velocity      (n, 3) m per frame, where age > 1
    acceleration  (n, 3) m per frame^2, where age > 2
    age           (n,) points of the track so far
    spread        (n,) m, how far predictions have missed lately, where age > 2
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    age: np.ndarray
    spread: np.ndarray


@kernel
def make_ends(n):
    """Room for the ends of n tracks."""
    return Ends(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.ones(n, dtype=np.int64), np.zeros(n))


class Bench(NamedTuple):
    """Working arrays of one thread, for up to n tracks and points: see `make_bench`."""

    at: np.ndarray
    gate: np.ndarray
    goes: np.ndarray
    best_point: np.ndarray
    best_miss: np.ndarray
    next_miss: np.ndarray
    best_track: np.ndarray
    point_miss: np.ndarray
    other_miss: np.ndarray
    track: np.ndarray
    point: np.ndarray
    miss: np.ndarray


@kernel
def make_bench(n):
    """Working arrays for frames of up to n points."""
    return Bench(
        np.empty((n, 3)),
        np.empty(n),
        np.empty(n, dtype=np.int64),
        np.empty(n, dtype=np.int64),
        np.empty(n),
        np.empty(n),
        np.empty(n, dtype=np.int64),
        np.empty(n),
        np.empty(n),
        np.empty(8 * n, dtype=np.int64),
        np.empty(8 * n, dtype=np.int64),
        np.empty(8 * n),
    )


@kernel
def expect(ends, count, limits, at, gate):
    """Where every track is expected in the next frame, and how far from there it may be.

    A track of three points or more goes on with its velocity and half its acceleration; one of two with its velocity; a single point
    moves as its three nearest neighbours that have a velocity, or stays where it is.
    OUT at (count, 3) m; gate (count,) m. O(count), and O(count) more for each single point.
    """
    near, near2 = np.empty(3, dtype=np.int64), np.empty(3)
    for a in range(count):
        if ends.age[a] > 2:
            for i in range(3):
                at[a, i] = ends.position[a, i] + ends.velocity[a, i] + 0.5 * ends.acceleration[a, i]
            gate[a] = min(limits.noise + limits.soft + limits.wild * ends.spread[a], limits.noise + limits.hard)
            continue
        if ends.age[a] == 2:
            for i in range(3):
                at[a, i] = ends.position[a, i] + ends.velocity[a, i]
            gate[a] = limits.noise + 3.0 * limits.soft
            continue
        known = 0
        for b in range(count):
            if ends.age[b] < 2:
                continue
            far2 = 0.0
            for i in range(3):
                far2 += (ends.position[a, i] - ends.position[b, i]) ** 2
            if known == 3 and far2 >= near2[2]:
                continue
            where = min(known, 2)
            while where > 0 and near2[where - 1] > far2:
                near2[where], near[where] = near2[where - 1], near[where - 1]
                where -= 1
            near2[where], near[where] = far2, b
            known = min(known + 1, 3)
        for i in range(3):
            at[a, i] = ends.position[a, i]
        gate[a] = limits.fastest
        if known == 0:
            continue
        total = 0.0
        for k in range(known):
            total += 1.0 / (near2[k] + 1e-4)
        for i in range(3):
            for k in range(known):
                at[a, i] += ends.velocity[near[k], i] / ((near2[k] + 1e-4) * total)
        most2 = 0.0
        for k in range(known):
            off2 = 0.0
            for i in range(3):
                off2 += (at[a, i] - ends.position[a, i] - ends.velocity[near[k], i]) ** 2
            most2 = max(most2, off2)
        away = limits.strange + limits.spin * math.sqrt(near2[0]) + limits.unlike * math.sqrt(most2)
        gate[a] = min(limits.noise + away, limits.fastest)


@kernel
def begin(ends, count, points, limits, goes, previous):
    """Where no track has a velocity yet, link what moves like its neighbours.

    A point goes on where it is nearest, both ways, without a rival, if two of its three nearest neighbours do and move alike. A pattern
    that moves by its own spacing might deceive one point, not its neighbourhood. OUT goes (count,), previous (n,). O(count (count + n)).
    """
    n = len(points)
    nearest, back = np.full(count, -1, dtype=np.int64), np.full(n, -1, dtype=np.int64)
    miss, rival = np.full(count, np.inf), np.full(count, np.inf)
    point_miss, point_rival = np.full(n, np.inf), np.full(n, np.inf)
    for a in range(count):
        for b in range(n):
            far = 0.0
            for i in range(3):
                far += (points[b, i] - ends.position[a, i]) ** 2
            far = math.sqrt(far)
            if far < miss[a]:
                rival[a], miss[a], nearest[a] = miss[a], far, b
            elif far < rival[a]:
                rival[a] = far
            if far < point_miss[b]:
                point_rival[b], point_miss[b], back[b] = point_miss[b], far, a
            elif far < point_rival[b]:
                point_rival[b] = far
    for a in range(count):
        b = nearest[a]
        clear = limits.clearer * miss[a] + limits.apart
        if b >= 0 and (back[b] != a or miss[a] > limits.fastest or rival[a] <= clear or point_rival[b] <= clear):
            nearest[a] = -1
    near, near2 = np.empty(3, dtype=np.int64), np.empty(3)
    for a in range(count):
        if nearest[a] < 0:
            continue
        known = 0
        for b in range(count):
            far2 = 0.0
            for i in range(3):
                far2 += (ends.position[a, i] - ends.position[b, i]) ** 2
            if b == a or (known == 3 and far2 >= near2[2]):
                continue
            where = min(known, 2)
            while where > 0 and near2[where - 1] > far2:
                near2[where], near[where] = near2[where - 1], near[where - 1]
                where -= 1
            near2[where], near[where] = far2, b
            known = min(known + 1, 3)
        alike = 0
        for k in range(known):
            b = near[k]
            if nearest[b] < 0:
                continue
            off2 = 0.0
            for i in range(3):
                off2 += (points[nearest[a], i] - ends.position[a, i] - points[nearest[b], i] + ends.position[b, i]) ** 2
            alike += math.sqrt(off2) <= limits.noise + limits.strange + limits.spin * math.sqrt(near2[k])
        if alike >= 2:
            goes[a] = nearest[a]
            previous[nearest[a]] = a


@kernel
def advance(ends, points, at, previous, following):
    """Every point goes on with its track, or begins one. IN at (count, 3) where the tracks were expected. OUT following. O(n)."""
    for b in range(len(points)):
        a = previous[b]
        age = ends.age[a] + 1 if a >= 0 else 1
        change2, missed2 = 0.0, 0.0
        following.age[b] = age
        for i in range(3):
            following.position[b, i] = points[b, i]
            following.velocity[b, i] = points[b, i] - ends.position[a, i] if age > 1 else 0.0
            following.acceleration[b, i] = following.velocity[b, i] - ends.velocity[a, i] if age > 2 else 0.0
            change2 += following.acceleration[b, i] ** 2
            missed2 += (points[b, i] - at[a, i]) ** 2 if age > 3 else 0.0
        following.spread[b] = max(0.8 * ends.spread[a], math.sqrt(missed2)) if age > 3 else math.sqrt(change2)


@kernel
def link_step(ends, count, points, limits, bench, previous, following):
    """Which track goes on with which point of the next frame: where both are each other's nearest and no rival comes near.

    IN   ends of `count` tracks; points (n, 3) m, sorted by x; bench with room for both
    OUT  previous (n,) the track that a point continues, -1 for none; following: the tracks' ends in this frame
    What is clear is linked first and is no rival afterwards; what never becomes clear begins a new track.
    O((count + n) log n) and the pairs that come near; O(count (count + n)) where tracks begin.
    """
    n = len(points)
    at, gate, goes = bench.at, bench.gate, bench.goes
    best_point, best_miss, next_miss = bench.best_point, bench.best_miss, bench.next_miss
    best_track, point_miss, other_miss = bench.best_track, bench.point_miss, bench.other_miss
    track, point, miss = bench.track, bench.point, bench.miss
    expect(ends, count, limits, at, gate)
    previous[:] = -1
    for a in range(count):
        goes[a] = -1
    moving = False
    for a in range(count):
        moving = moving or ends.age[a] > 1
    if not moving:
        begin(ends, count, points, limits, goes, previous)
    pairs, room = 0, len(track)
    for a in range(count):
        # a single point takes only what nothing else in its gate rivals; the others' rivals may lie farther than their own gate
        reach = gate[a] if ends.age[a] == 1 else limits.clearer * gate[a] + limits.apart
        low, high = 0, n
        while low < high:
            middle = (low + high) // 2
            if points[middle, 0] < at[a, 0] - reach:
                low = middle + 1
            else:
                high = middle
        for b in range(low, n):
            dx = points[b, 0] - at[a, 0]
            if dx > reach:
                break
            dy, dz = points[b, 1] - at[a, 1], points[b, 2] - at[a, 2]
            far2 = dx * dx + dy * dy + dz * dz
            if far2 > reach * reach:
                continue
            if pairs == room:
                room *= 2
                track, point, miss = _twice(track, room), _twice(point, room), _twice(miss, room)
            track[pairs], point[pairs], miss[pairs] = a, b, math.sqrt(far2)
            pairs += 1
    while True:
        for a in range(count):
            best_point[a], best_miss[a], next_miss[a] = -1, np.inf, np.inf
        for b in range(n):
            best_track[b], point_miss[b], other_miss[b] = -1, np.inf, np.inf
        kept = 0
        for p in range(pairs):
            a, b = track[p], point[p]
            if goes[a] >= 0 or previous[b] >= 0:
                continue
            track[kept], point[kept], miss[kept] = a, b, miss[p]
            kept += 1
            far = miss[kept - 1]
            if far < best_miss[a]:
                next_miss[a], best_miss[a], best_point[a] = best_miss[a], far, b
            elif far < next_miss[a]:
                next_miss[a] = far
            if far < point_miss[b]:
                other_miss[b], point_miss[b], best_track[b] = point_miss[b], far, a
            elif far < other_miss[b]:
                other_miss[b] = far
        pairs = kept
        news = False
        for a in range(count):
            b = best_point[a]
            if b < 0 or best_track[b] != a or best_miss[a] > gate[a]:
                continue
            rival = limits.clearer * best_miss[a] + limits.apart
            if ends.age[a] == 1:
                rival = max(rival, gate[a])
            if next_miss[a] > rival and other_miss[b] > rival:
                goes[a], previous[b] = b, a
                news = True
        if not news:
            break
    advance(ends, points, at, previous, following)


@kernel
def _twice(array, room):
    out = np.empty(room, dtype=array.dtype)
    out[: len(array)] = array
    return out


@kernel
def link_through(xyz, offsets, limits, backwards, linked):
    """`link_step` through all frames, from the first to the last or backwards.

    IN xyz (P, 3) m, each frame's points sorted by x; offsets (T + 1,). OUT linked (P,) the point of the frame before (backwards: after)
    that a point continues, -1 for none.
    """
    most, frames = 0, len(offsets) - 1
    for t in range(frames):
        most = max(most, offsets[t + 1] - offsets[t])
    ends, following, bench = make_ends(most), make_ends(most), make_bench(most)
    count, begins = 0, 0
    for step in range(frames):
        t = frames - 1 - step if backwards else step
        first, last = offsets[t], offsets[t + 1]
        link_step(ends, count, xyz[first:last], limits, bench, linked[first:last], following)
        for p in range(first, last):
            if linked[p] >= 0:
                linked[p] += begins
        ends, following = following, ends
        count, begins = last - first, first


@kernel
def sort_frames(xyz, offsets, order):
    """A frame's points in an order of their own (by x, then y, then z). OUT order (P,), indices into xyz. O(n^2) a frame at worst."""
    for t in range(len(offsets) - 1):
        for p in range(offsets[t], offsets[t + 1]):
            where = p
            while where > offsets[t]:
                q = order[where - 1]
                if xyz[q, 0] < xyz[p, 0] or (
                    xyz[q, 0] == xyz[p, 0] and (xyz[q, 1] < xyz[p, 1] or (xyz[q, 1] == xyz[p, 1] and xyz[q, 2] <= xyz[p, 2]))
                ):
                    break
                order[where] = q
                where -= 1
            order[where] = p


@kernel
def agree(forward, backward, previous, following):
    """The links that both directions found, or that one found and the other could not judge: its track had fewer than three points yet.

    IN forward (P,) previous point of each; backward (P,) next point of each. OUT previous, following (P,), -1 for none. O(P).
    """
    count = len(forward)
    age, age_back = np.ones(count, dtype=np.int64), np.ones(count, dtype=np.int64)
    previous[:], following[:] = -1, -1
    continued = np.full(count, -1, dtype=np.int64)
    for p in range(count):
        if forward[p] >= 0:
            continued[forward[p]] = p
            age[p] = age[forward[p]] + 1
    for p in range(count - 1, -1, -1):
        if backward[p] >= 0:
            age_back[p] = age_back[backward[p]] + 1
    origin = np.full(count, -1, dtype=np.int64)
    for p in range(count):
        if backward[p] >= 0:
            origin[backward[p]] = p
    for q in range(count):
        p = forward[q]
        if p >= 0 and (backward[p] == q or (backward[p] < 0 and origin[q] < 0 and age_back[q] < 3)):
            following[p], previous[q] = q, p
        p = origin[q]
        if p >= 0 and continued[p] < 0 and forward[q] < 0 and age[p] < 3:
            following[p], previous[q] = q, p


@kernel
def number_chains(previous, of_point):
    """Number the chains of linked points, in the order of their first points. OUT of_point (P,). Returns how many. O(P)."""
    count = 0
    for p in range(len(previous)):
        if previous[p] >= 0:
            of_point[p] = of_point[previous[p]]
        else:
            of_point[p] = count
            count += 1
    return count
