"""Composition on flat arrays: the blobs of a frame in, all hypotheses of points that are likelier than strays out."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.geometry.shared_kernels import symmetric_inverse
from asterism.reconstruction._fit_kernels import FitWorkspace, add_ray, closest_point, fit, fit_and_prune, fit_workspace, set_zero
from asterism.reconstruction._hypothesis_kernels import append_hypothesis, empty_hypotheses, same_rays
from asterism.reconstruction._input_kernels import END, FEWEST, FIRST, GATE, NOISE, inside_volume
from asterism.reconstruction._order_kernels import ascending
from asterism.reconstruction._score_kernels import best_blob, score

LEAST_BASELINE_SINE = 0.02
"""Rays that make a smaller angle (sine) with the line between two cameras are not composed by these two: depth is lost there."""
WELL_SUPPORTED_CAMERAS = 4
"""Two blobs that both lie in hypotheses of this many cameras are not composed with each other: what else they show is found from the
other blobs."""


class BlobIndex(NamedTuple):
    """What is known about each of the B blobs of a frame while hypotheses are composed.

    head            (B,) the last hypothesis that holds it, -1 for none; `Hypotheses.links` gives the ones before
    well_supported  (B,) bool, whether a hypothesis of WELL_SUPPORTED_CAMERAS holds it
    available       (B,) bool, whether it may be used
    """

    head: np.ndarray
    well_supported: np.ndarray
    available: np.ndarray


class PairAngles(NamedTuple):
    """The epipolar angles of the blobs of both cameras of a pair: angles (2, n) rad, variances (2, n) rad2."""

    angles: np.ndarray
    variances: np.ndarray


class ComposeWorkspace(NamedTuple):
    """What composition works on: epipolar angles of a pair and its blobs (m, 2) that agree, what is known about each blob, rays (C,) of one
    hypothesis, and its fit."""

    epipolar: PairAngles
    partners: np.ndarray
    blob_index: BlobIndex
    rays: np.ndarray
    fit: FitWorkspace


@kernel
def compose(rig, frame):
    """All hypotheses of a frame that are likelier than strays: pairs of blobs that pass the gate, grown through all other cameras.

    Thesis algorithm 3.1 over all camera pairs. A pair of blobs that lies in a hypothesis already is one of its n (n - 1) / 2 versions and
    is not composed again (the merging of algorithm 3.2). One hypothesis holds at most one blob of a camera.

    Returns Hypotheses, how many there are, and how many pairs passed the gate. O(C blobs log blobs + gated pairs * C).
    Twin: tests/twins_reconstruction.py

    Bounds: `most` is the number of blobs of the fullest camera, which `epipolar` holds of each of two; hypotheses are appended to lists
    that grow.
    """
    cameras, blobs = len(rig.cameras), len(frame.blobs)
    # One workspace for all pairs, as large as the fullest camera asks.
    most = 1
    for c in range(cameras):
        most = max(most, int(frame.grid[c, END] - frame.grid[c, FIRST]))
    found, count, gated = empty_hypotheses(max(16, 2 * blobs), cameras), 0, 0
    index = BlobIndex(np.full(blobs, -1, np.int64), np.zeros(blobs, np.bool_), np.ones(blobs, np.bool_))
    epipolar = PairAngles(np.empty((2, most)), np.empty((2, most)))
    # Room for the partners of some blobs, so that most pairs of cameras are searched at once.
    work = ComposeWorkspace(epipolar, np.empty((16 * most, 2), np.int64), index, np.empty(cameras, np.int64), fit_workspace())
    # The most rectangular pairs first (`RigArrays.pairs`): their hypotheses lie best, and later pairs find them composed.
    for pair in range(len(rig.pairs)):
        found, count, passed = _compose_pair(rig, frame, pair, found, count, work)
        gated += passed
    return found, count, gated


@kernel
def _compose_pair(rig, frame, pair, found, count, work):
    """Compose all blobs of one camera pair whose epipolar angles agree.

    OUT found, added to; work ComposeWorkspace
    Returns Hypotheses, how many there are now, and how many pairs of blobs passed the gate. O(n log n) for n blobs, and
    the pairs that pass.
    """
    a, b = rig.pairs[pair, 0], rig.pairs[pair, 1]
    first_a, first_b = int(frame.grid[a, FIRST]), int(frame.grid[b, FIRST])
    many_a, many_b = int(frame.grid[a, END]) - first_a, int(frame.grid[b, END]) - first_b
    gated, k = 0, 0
    if many_a == 0 or many_b == 0:
        return found, count, gated
    epipolar = work.epipolar
    _epipolar_angles(rig, frame, pair, 0, epipolar)
    _epipolar_angles(rig, frame, pair, 1, epipolar)
    # By angle, so that the blobs within the gate are a stretch of the order.
    order, partners = ascending(epipolar.angles[1], many_b), work.partners
    while k < many_a:
        k, many, passed = _partners(
            rig.limits[GATE], epipolar, order, first_a, first_b, k, many_a, work.blob_index.well_supported, partners
        )
        gated += passed
        for n in range(many):
            found, count = _compose_blobs(rig, frame, pair, partners[n, 0], partners[n, 1], found, count, work)
    return found, count, gated


@kernel
def _partners(gate, epipolar, order, first_a, first_b, begin, end, well_supported, out):
    """The pairs of blobs whose epipolar angles agree, but for those that both lie in hypotheses of many cameras already.

    IN  order: the second camera's blobs by angle; first_a, first_b: the number of each camera's first blob; begin, end: which blobs of the
        first camera; well_supported of BlobIndex
    OUT out (m, 2): the numbers of both blobs
    Returns the first camera's blob to go on with, how many pairs there are, and how many passed the gate. The loop is apart from the
    composition, in which each look at an array costs a count of its owners. O(n log n), and the pairs that pass.

    Bounds: a blob has three times as many partners at most as the other camera has blobs, and is begun only where there is room for these.
    """
    angle, variance, others, variances = epipolar.angles[0], epipolar.variances[0], epipolar.angles[1], epipolar.variances[1]
    last = len(order)
    # Rays along the baseline have no angle; infinity put them at the end.
    while last > 0 and others[order[last - 1]] == np.inf:
        last -= 1
    # The gate of the stretch must hold for the least exact blob; each pair is then tried by its own variance.
    widest = 0.0
    for k in range(len(order)):
        widest = max(widest, variances[k])
    many, gated, k = 0, 0, begin
    while k < end and many + 3 * len(order) <= len(out):
        half = gate * math.sqrt(variance[k] + widest)
        # An angle near pi has partners near minus pi.
        for turn in range(-1, 2):
            aim = angle[k] + 2.0 * math.pi * turn
            # Infinite, too.
            if aim - half > math.pi or aim + half < -math.pi:
                continue
            at = _first_not_below(others, order, last, aim - half)
            while at < last and others[order[at]] <= aim + half:
                m = order[at]
                at += 1
                miss = others[m] - aim
                # Both blobs' inexactness together says whether they can be one point.
                if miss * miss > gate * gate * (variance[k] + variances[m]):
                    continue
                gated += 1
                # Most pairs of a crowd end here.
                if not (well_supported[first_a + k] and well_supported[first_b + m]):
                    out[many, 0], out[many, 1] = first_a + k, first_b + m
                    many += 1
        k += 1
    return k, many, gated


@kernel
def _epipolar_angles(rig, frame, pair, which, out):
    """The angle of each blob's epipolar plane about a pair's baseline, and its variance by the pixel noise.

    IN  which: 0 or 1, the camera of the pair
    OUT out: row `which`; the angle is infinite where the ray leaves nearly along the baseline
    Two blobs can show one point only where their angles agree: this is the epipolar constraint, with the sensitivity as its gate.
    O(blobs of the camera), no allocation.
    """
    angle, spread = out.angles[which], out.variances[which]
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
        # Squared distance from the baseline's direction, by which an angle about it loses its meaning.
        rho = cu * cu + cv * cv
        # Along the baseline a small error turns the plane by any angle.
        if rho < LEAST_BASELINE_SINE * LEAST_BASELINE_SINE * (x * x + y * y + 1.0):
            angle[k] = np.inf
            spread[k] = 0.0
            continue
        # Derivative of the angle by the place in the image; the Jacobian's inverse brings pixel noise to it.
        gx, gy = (cu * v0 - cv * u0) / rho, (cu * v1 - cv * u1) / rho
        s0, s1, s2, s3 = frame.blobs[blob, 2], frame.blobs[blob, 3], frame.blobs[blob, 4], frame.blobs[blob, 5]
        k_inverse = 1.0 / (s0 * s3 - s1 * s2)
        px, py = (s3 * gx - s2 * gy) * k_inverse, (s0 * gy - s1 * gx) * k_inverse
        angle[k] = math.atan2(cv, cu)
        spread[k] = variance * (px * px + py * py)


@kernel
def _first_not_below(values, order, last, limit):
    """Returns the first place among the first `last` of an order (n,) whose value is not below a limit. O(log n)."""
    low, high = 0, last
    while low < high:
        middle = (low + high) // 2
        if values[order[middle]] < limit:
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def _compose_blobs(rig, frame, pair, i, j, found, count, work):
    """Grow blob i of a pair's first camera and blob j of its second, and add the hypothesis unless it is known or unlikely.

    Returns Hypotheses and how many there are now. O(C), and the hypotheses of blob i.
    """
    index, rays = work.blob_index, work.rays
    # Known already, or both have better homes meanwhile.
    if (index.well_supported[i] and index.well_supported[j]) or _is_composed(rig, pair, i, j, index, found):
        return found, count
    many, worth = _grow_hypothesis(rig, frame, pair, i, j, index.available, rays, work.fit)
    # No likelier than two strays, or found before from another pair.
    if not worth > 0.0 or _is_listed(found, index.head, rays):
        return found, count
    found = append_hypothesis(found, count, rays, work.fit.point, worth)
    for c in range(len(rays)):
        if rays[c] >= 0:
            # At the head of each blob's list, so that lists need no memory of their own.
            found.links[count, c] = index.head[rays[c]]
            index.head[rays[c]] = count
            index.well_supported[rays[c]] |= many >= WELL_SUPPORTED_CAMERAS
    return found, count + 1


@kernel
def _is_composed(rig, pair, i, j, index, found):
    """Returns whether a hypothesis holds both blob i of a pair's first camera and blob j of its second. O(hypotheses of blob i)."""
    a, b = rig.pairs[pair, 0], rig.pairs[pair, 1]
    at = index.head[i]
    while at >= 0:
        # The pair is one of the n (n - 1) / 2 versions of a hypothesis that exists.
        if found.rays[at, b] == j:
            return True
        at = found.links[at, a]
    return False


@kernel
def _is_listed(found, head, rays):
    """Returns whether a hypothesis with exactly these rays is in the lists. O(C * hypotheses of one blob)."""
    for c in range(len(rays)):
        if rays[c] >= 0:
            at = head[rays[c]]
            # The list of its first ray is enough: the same rays would stand in it.
            while at >= 0:
                if same_rays(found, at, rays):
                    return True
                at = found.links[at, c]
            return False
    return False


@kernel
def _grow_hypothesis(rig, frame, pair, i, j, available, rays, work):
    """The hypothesis that starts with blob i of a pair's first camera and blob j of its second and takes the best blob of all others.

    IN  available (B,) whether a blob may be taken
    OUT rays (C,); work: the point and its information
    Returns how many cameras it has, and its score in nats; minus infinity where it is impossible. O(C), and the blobs near the point.
    """
    a, b = rig.pairs[pair, 0], rig.pairs[pair, 1]
    x, h, g = work.point, work.information, work.gradient
    # Behind a camera or parallel: the pair is no point.
    if not closest_point(rig, frame, pair, i, j, x):
        return 0, -np.inf
    for c in range(len(rays)):
        rays[c] = -1
    rays[a], rays[b] = i, j
    if not fit(rig, frame, rays, work, 1)[0] < np.inf:
        return 0, -np.inf
    for c in range(len(rays)):
        # One blob after the other: each narrows down where the next must be.
        if c in (a, b):
            continue
        blob = best_blob(rig, frame, c, work, available)[0]
        if blob < 0:
            continue
        # Gradient of the new ray alone: for the others the point is at its best already.
        set_zero(g)
        # One step of the filter, cheaper than a new fit, which follows once at the end.
        if add_ray(rig, frame, c, blob, work) < np.inf:
            rays[c] = blob
            _, i0, i1, i2, i3, i4, i5 = symmetric_inverse(h)
            x[0] += i0 * g[0] + i1 * g[1] + i2 * g[2]
            x[1] += i1 * g[0] + i3 * g[1] + i4 * g[2]
            x[2] += i2 * g[0] + i4 * g[1] + i5 * g[2]
    # All rays together may show that one of the first two was wrong.
    square, many = fit_and_prune(rig, frame, rays, work, 1)
    if not square < np.inf or many < rig.limits[FEWEST] or not inside_volume(rig, x):
        return many, -np.inf
    return many, score(rig, frame, rays, work, square)
