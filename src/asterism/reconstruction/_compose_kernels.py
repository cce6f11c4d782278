"""Composition on flat arrays: the blobs of a frame in, all hypotheses of points that are likelier than strays out."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.geometry._kernels import symmetric_inverse
from asterism.reconstruction._kernels import (
    END,
    FEWEST,
    FIRST,
    GATE,
    NOISE,
    add_ray,
    best_blob,
    clear,
    fit,
    meeting,
    score,
    settle,
    within,
)
from asterism.reconstruction._order_kernels import ascending

NEAREST_TO_BASELINE = 0.02
"""Rays that make a smaller angle (sine) with the line between two cameras are not composed by these two: depth is lost there."""
FIRM = 4
"""Blobs that hypotheses of this many cameras explain are not composed with each other: what else they show is found from the rest."""


@kernel
def _pencil(rig, frame, pair, which, angle, spread):
    """The angle of each blob's epipolar plane about a pair's baseline, and its variance by the pixel noise.

    OUT angle, spread (n,) rad, rad2 of camera `which` (0 or 1) of the pair; infinite where the ray leaves nearly along the baseline
    Two blobs can show one point only where their angles agree: this is the epipolar constraint, with the sensitivity as its gate.
    """
    c = rig.pairs[pair, which]
    cameras = rig.cameras
    u, v = rig.axes[pair, 0], rig.axes[pair, 1]
    u0, u1, u2 = (
        cameras[c, 0] * u[0] + cameras[c, 1] * u[1] + cameras[c, 2] * u[2],
        cameras[c, 3] * u[0] + cameras[c, 4] * u[1] + cameras[c, 5] * u[2],
        cameras[c, 6] * u[0] + cameras[c, 7] * u[1] + cameras[c, 8] * u[2],
    )
    v0, v1, v2 = (
        cameras[c, 0] * v[0] + cameras[c, 1] * v[1] + cameras[c, 2] * v[2],
        cameras[c, 3] * v[0] + cameras[c, 4] * v[1] + cameras[c, 5] * v[2],
        cameras[c, 6] * v[0] + cameras[c, 7] * v[1] + cameras[c, 8] * v[2],
    )
    variance = rig.cameras[c, NOISE] * rig.cameras[c, NOISE]
    for k, blob in enumerate(range(int(frame.grid[c, FIRST]), int(frame.grid[c, END]))):
        x, y = frame.blobs[blob, 0], frame.blobs[blob, 1]
        cu, cv = u0 * x + u1 * y + u2, v0 * x + v1 * y + v2
        rho = cu * cu + cv * cv
        if rho < NEAREST_TO_BASELINE * NEAREST_TO_BASELINE * (x * x + y * y + 1.0):
            angle[k] = np.inf
            spread[k] = 0.0
            continue
        gx, gy = (cu * v0 - cv * u0) / rho, (cu * v1 - cv * u1) / rho
        s0, s1, s2, s3 = frame.blobs[blob, 2], frame.blobs[blob, 3], frame.blobs[blob, 4], frame.blobs[blob, 5]
        k_inverse = 1.0 / (s0 * s3 - s1 * s2)
        px, py = (s3 * gx - s2 * gy) * k_inverse, (s0 * gy - s1 * gx) * k_inverse
        angle[k] = math.atan2(cv, cu)
        spread[k] = variance * (px * px + py * py)


class Hypotheses(NamedTuple):
    """Growing lists: rays (n, C) blob of each camera or -1; points (n, 3) m; scores (n,) nats; links (n, C) to the blob's next one."""

    rays: np.ndarray
    points: np.ndarray
    scores: np.ndarray
    links: np.ndarray


@kernel
def _put(found, at, rays, x, worth):
    """Write a hypothesis to its place in the lists."""
    for c in range(len(rays)):
        found.rays[at, c] = rays[c]
    for axis in range(3):
        found.points[at, axis] = x[axis]
    found.scores[at] = worth


@kernel
def _room(found, count):
    """The lists with room for one more."""
    size = len(found.scores)
    if count < size:
        return found
    rays, points, scores, links = (
        np.empty((2 * size, found.rays.shape[1]), np.int64),
        np.empty((2 * size, 3)),
        np.empty(2 * size),
        np.empty((2 * size, found.rays.shape[1]), np.int64),
    )
    for n in range(size):
        for c in range(rays.shape[1]):
            rays[n, c], links[n, c] = found.rays[n, c], found.links[n, c]
        for axis in range(3):
            points[n, axis] = found.points[n, axis]
        scores[n] = found.scores[n]
    return Hypotheses(rays, points, scores, links)


@kernel
def _together(found, head, a, b, i, j):
    """Whether a hypothesis in the lists holds both blob i of camera a and blob j of camera b."""
    at = head[i]
    while at >= 0:
        if found.rays[at, b] == j:
            return True
        at = found.links[at, a]
    return False


@kernel
def _grown(rig, frame, a, b, i, j, free, rays, x, h, g, out):
    """The hypothesis that starts with blob i of camera a and blob j of camera b and takes the best blob of every other camera.

    IN  free (B,) whether a blob may be taken; h (6,), g (3,), out (1,) to work in
    OUT rays (C,), x (3,) m
    Returns how many cameras it has, and its worth in nats; minus infinity where it cannot be.
    """
    if not meeting(rig, frame, a, b, i, j, x):
        return 0, -np.inf
    for c in range(len(rays)):
        rays[c] = -1
    rays[a], rays[b] = i, j
    if not fit(rig, frame, rays, x, h, g, 1)[0] < np.inf:
        return 0, -np.inf
    for c in range(len(rays)):
        if c in (a, b):
            continue
        blob = best_blob(rig, frame, c, x, h, free, out)
        if blob < 0:
            continue
        clear(g)
        if add_ray(rig, frame, c, blob, x, h, g) < np.inf:
            rays[c] = blob
            _, i0, i1, i2, i3, i4, i5 = symmetric_inverse(h)
            x[0] += i0 * g[0] + i1 * g[1] + i2 * g[2]
            x[1] += i1 * g[0] + i3 * g[1] + i4 * g[2]
            x[2] += i2 * g[0] + i4 * g[1] + i5 * g[2]
    square, many = settle(rig, frame, rays, x, h, g, 1)
    if not square < np.inf or many < rig.setting[FEWEST] or not within(rig, x):
        return many, -np.inf
    return many, score(rig, frame, rays, x, h, square)


@kernel
def compose(rig, frame):
    """All hypotheses of a frame that are likelier than strays: pairs of blobs that pass the gate, grown through all other cameras.

    Thesis algorithm 3.1 over all camera pairs; a pair that lies in a hypothesis already is one of its n (n - 1) / 2 versions and
    not composed again (the merging of algorithm 3.2). One hypothesis holds at most one blob of a camera.
    Returns the lists, how many there are, and how many pairs passed the gate. O(C blobs log blobs + gated pairs * C).
    """
    cameras, blobs = len(rig.cameras), len(frame.blobs)
    most = 1
    for c in range(cameras):
        most = max(most, int(frame.grid[c, END] - frame.grid[c, FIRST]))
    size = max(16, 2 * blobs)
    found = Hypotheses(np.empty((size, cameras), np.int64), np.empty((size, 3)), np.empty(size), np.empty((size, cameras), np.int64))
    count, gated = 0, 0
    head = np.full(blobs, -1, np.int64)
    free, firm = np.ones(blobs, np.bool_), np.zeros(blobs, np.bool_)
    angle, other = np.empty((2, most)), np.empty((2, most))
    rays, x, h, g, out = np.empty(cameras, np.int64), np.empty(3), np.empty(6), np.empty(3), np.empty(1)
    for pair in range(len(rig.pairs)):
        a, b = rig.pairs[pair, 0], rig.pairs[pair, 1]
        first_a, first_b = int(frame.grid[a, FIRST]), int(frame.grid[b, FIRST])
        many_a, many_b = int(frame.grid[a, END]) - first_a, int(frame.grid[b, END]) - first_b
        if many_a == 0 or many_b == 0:
            continue
        _pencil(rig, frame, pair, 0, angle[0], angle[1])
        _pencil(rig, frame, pair, 1, other[0], other[1])
        order = ascending(other[0], many_b)
        last = many_b
        while last > 0 and other[0, order[last - 1]] == np.inf:
            last -= 1
        widest = 0.0
        for k in range(last):
            widest = max(widest, other[1, k])
        for k in range(many_a):
            phi = angle[0, k]
            if phi == np.inf:
                continue
            i = first_a + k
            half = rig.setting[GATE] * math.sqrt(angle[1, k] + widest)
            for turn in range(-1, 2):
                aim = phi + 2.0 * math.pi * turn
                if aim - half > math.pi or aim + half < -math.pi:
                    continue
                low, high = 0, last
                while low < high:
                    middle = (low + high) // 2
                    if other[0, order[middle]] < aim - half:
                        low = middle + 1
                    else:
                        high = middle
                while low < last and other[0, order[low]] <= aim + half:
                    m = order[low]
                    low += 1
                    apart = other[0, m] - aim
                    if apart * apart > rig.setting[GATE] * rig.setting[GATE] * (angle[1, k] + other[1, m]):
                        continue
                    gated += 1
                    j = first_b + m
                    if (firm[i] and firm[j]) or _together(found, head, a, b, i, j):
                        continue
                    many, worth = _grown(rig, frame, a, b, i, j, free, rays, x, h, g, out)
                    if not worth > 0.0 or _listed(found, head, rays):
                        continue
                    found = _room(found, count)
                    _put(found, count, rays, x, worth)
                    for c in range(cameras):
                        if rays[c] >= 0:
                            found.links[count, c] = head[rays[c]]
                            head[rays[c]] = count
                            firm[rays[c]] |= many >= FIRM
                    count += 1
    return found, count, gated


@kernel
def _listed(found, head, rays):
    """Whether a hypothesis with exactly these rays is in the lists."""
    for c in range(len(rays)):
        if rays[c] >= 0:
            at = head[rays[c]]
            while at >= 0:
                same = True
                for d in range(len(rays)):
                    same = same and found.rays[at, d] == rays[d]
                if same:
                    return True
                at = found.links[at, c]
            return False
    return False


@kernel
def with_reduced(rig, frame, found, count):
    """Add hypotheses without the blobs that a rival of three cameras or more claims too, so that both can be chosen.

    Two markers that one camera sees as one blob share it; the one that does not get it is still there by its other cameras.
    Returns the lists and how many there are now.
    """
    cameras, blobs = len(rig.cameras), len(frame.blobs)
    owners = np.zeros(blobs + 1, np.int64)
    serious = np.zeros(count, np.bool_)
    for n in range(count):
        many = 0
        for c in range(cameras):
            many += found.rays[n, c] >= 0
        serious[n] = many >= 3
        if serious[n]:
            for c in range(cameras):
                if found.rays[n, c] >= 0:
                    owners[found.rays[n, c] + 1] += 1
    for blob in range(blobs):
        owners[blob + 1] += owners[blob]
    listed = np.empty(owners[blobs], np.int64)
    fill = owners.copy()
    for n in range(count):
        if serious[n]:
            for c in range(cameras):
                blob = found.rays[n, c]
                if blob >= 0:
                    listed[fill[blob]] = n
                    fill[blob] += 1
    rays, x, h, g = np.empty(cameras, np.int64), np.empty(3), np.empty(6), np.empty(3)
    total = count
    for n in range(count):
        if not serious[n]:
            continue
        begin = total
        for c in range(cameras):
            blob = found.rays[n, c]
            if blob < 0:
                continue
            for place in range(owners[blob], owners[blob + 1]):
                rival = listed[place]
                if rival == n or found.scores[rival] < 0.25 * found.scores[n]:
                    continue
                left = 0
                for d in range(cameras):
                    shared = found.rays[n, d] >= 0 and found.rays[n, d] == found.rays[rival, d]
                    rays[d] = -1 if shared else found.rays[n, d]
                    left += rays[d] >= 0
                if left < max(2, rig.setting[FEWEST]):
                    continue
                again = False
                for other in range(begin, total):
                    same = True
                    for d in range(cameras):
                        same = same and found.rays[other, d] == rays[d]
                    again = again or same
                if again:
                    continue
                for axis in range(3):
                    x[axis] = found.points[n, axis]
                square = fit(rig, frame, rays, x, h, g, 2)[0]
                worth = score(rig, frame, rays, x, h, square)
                if worth > 0.0 and within(rig, x):
                    found = _room(found, total)
                    _put(found, total, rays, x, worth)
                    total += 1
    return found, total
