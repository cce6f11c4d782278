"""Whole-body kernels: a frame's points, the body model and the anchors in; the best labelling and its margins out.

The mathematics stands in `model.py`. All kernels take the vertical as +z. Their plain twins are in `tests/twins_body.py`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.labelling.partial._kernels import search

LOG_2PI = math.log(2.0 * math.pi)
LABELLINGS = 24
"""Labellings of one frame that are kept apart."""
ROUNDS = 8
"""Relabellings after which a labelling that still changes is taken as it is."""
WORTH_REFINING = 20.0
"""A proposal this many nats behind its anchor's best one is not followed up."""
REACH = 0.6
"""No point farther than this from where a marker is expected is looked at (m)."""


class BodyArrays(NamedTuple):
    """A body model as the kernels read it; K key poses, M markers, r latent directions (pose, size, then small moves of the whole body).

    mean        (K, M, 3) m, the mean body
    whiten      (K, M, 3, 3) takes a residual in m to unit variance
    load        (K, M, 3, r) whitened displacement per unit of each latent
    gram        (K, M, r, r) load' load
    full        (K, r, r) identity plus the sum of gram over all markers
    spread      (K, M, 3, 3) its inverse
    log_scale   (K, M) log |det whiten|
    log_weight  (K,) how frequent the key pose is
    """

    mean: np.ndarray
    whiten: np.ndarray
    load: np.ndarray
    gram: np.ndarray
    full: np.ndarray
    spread: np.ndarray
    log_scale: np.ndarray
    log_weight: np.ndarray


class AnchorArrays(NamedTuple):
    """What follows for the whole body once an anchor's three markers are known; A anchors.

    markers    (A, 3)
    precision  (K, A, 9, 9) of the anchor's own points
    log_own    (K, A) log density at the anchor's mean, with the key pose's weight
    gain       (K, A, M, 3, 9) prediction of every marker per displacement of the anchor's points
    whiten     (K, A, M, 3, 3) takes a prediction's residual to unit variance
    log_scale  (K, A, M) log |det whiten|
    widest     (K, A, M) m2, trace of a prediction's covariance
    """

    markers: np.ndarray
    precision: np.ndarray
    log_own: np.ndarray
    gain: np.ndarray
    whiten: np.ndarray
    log_scale: np.ndarray
    widest: np.ndarray


class LookSettings(NamedTuple):
    """How the whole-body look decides; the numbers of `ensemble.LookRules`.

    reward       nats that a labelled point earns over an occlusion and a ghost
    first_ghost  nats that the first ghost of a frame costs
    odd          nats that an oddly placed point earns, within `odd_radius` (m) of where its marker is expected
    far          squared distance of an anchor's own points beyond which it is not followed up
    agree        anchors that must lead to the best labelling before the others are skipped, where markers or points are left over
    ask          anchors on missing markers that are tried where two points or a fifth of the markers are left over
    budget       feature evaluations per frame
    per_anchor   labellings of one anchor that are followed up
    least_found  share of the markers that a proposal must find at once to be followed up
    clear        nats by which a label must beat its rivals to be taken before the others
    contest      nats: alternatives at least this close are computed exactly
    good         nats per label from which a labelling of most points explains the frame
    enough       anchors that end the search even if the best labelling does not explain the frame
    """

    reward: float
    first_ghost: float
    odd: float
    odd_radius: float
    far: float
    agree: int
    ask: int
    budget: int
    per_anchor: int
    least_found: float
    clear: float
    contest: float
    good: float
    enough: int


@kernel(reassociate=True)
def _count(rows):
    labelled = 0
    for m in range(len(rows)):
        labelled += rows[m] >= 0
    return labelled


@kernel(reassociate=True)
def placing(points, rows, mean, markers):
    """The turn about the vertical and the shift that bring the points at `rows` best onto `mean[markers]`: (cos, sin, from, onto).

    IN  points (n, 3); rows (k,), -1 for none; mean (M, 3); markers (k,). O(k), no allocation.
    """
    count, px, py, pz, qx, qy, qz = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(rows)):
        if rows[i] >= 0:
            count += 1
            px += points[rows[i], 0]
            py += points[rows[i], 1]
            pz += points[rows[i], 2]
            qx += mean[markers[i], 0]
            qy += mean[markers[i], 1]
            qz += mean[markers[i], 2]
    px, py, pz, qx, qy, qz = px / count, py / count, pz / count, qx / count, qy / count, qz / count
    along, across = 0.0, 0.0
    for i in range(len(rows)):
        if rows[i] >= 0:
            ax, ay = points[rows[i], 0] - px, points[rows[i], 1] - py
            bx, by = mean[markers[i], 0] - qx, mean[markers[i], 1] - qy
            along += ax * bx + ay * by
            across += ax * by - ay * bx
    size = math.sqrt(along * along + across * across)
    cos, sin = (along / size, across / size) if size > 0.0 else (1.0, 0.0)
    return cos, sin, (px, py, pz), (qx, qy, qz)


@kernel(reassociate=True)
def align(points, rows, mean, markers, out):
    """Move all points by `placing`. OUT out (n, 3). O(n + k)."""
    cos, sin, here, there = placing(points, rows, mean, markers)
    for i in range(len(points)):
        x, y = points[i, 0] - here[0], points[i, 1] - here[1]
        out[i, 0] = cos * x - sin * y + there[0]
        out[i, 1] = sin * x + cos * y + there[1]
        out[i, 2] = points[i, 2] - here[2] + there[2]


@kernel(reassociate=True)
def _cholesky(matrix, column):
    """Lower triangle of a symmetric positive definite matrix replaced by its Cholesky factor; returns log det. O(r^3 / 3)."""
    n = len(matrix)
    log_det = 0.0
    for j in range(n):
        pivot = math.sqrt(matrix[j, j])
        log_det += 2.0 * math.log(pivot)
        matrix[j, j] = pivot
        for i in range(j + 1, n):
            matrix[i, j] /= pivot
            column[i] = matrix[i, j]
        for i in range(j + 1, n):
            weight = column[i]
            for k in range(j + 1, i + 1):
                matrix[i, k] -= weight * column[k]
    return log_det


@kernel(reassociate=True)
def _inverse_of_factor(factor, inverse):
    """OUT inverse (r, r) of factor factor'. O(r^3 / 2)."""
    n = len(factor)
    # the factor's inverse, row by row, into the lower triangle
    for i in range(n):
        inverse[i, : i + 1] = 0.0
        for k in range(i):
            weight = factor[i, k]
            for j in range(k + 1):
                inverse[i, j] -= weight * inverse[k, j]
        inverse[i, i] = 1.0
        for j in range(i + 1):
            inverse[i, j] /= factor[i, i]
    # its transpose times itself: sums over rows i >= max(a, b), which are overwritten last
    for a in range(n):
        for b in range(a + 1, n):
            inverse[a, b] = 0.0
        for i in range(a + 1, n):
            weight = inverse[i, a]
            for b in range(a + 1, i + 1):
                inverse[a, b] += weight * inverse[i, b]
        total = 0.0
        for i in range(a, n):
            total += inverse[i, a] * inverse[i, a]
        inverse[a, a] = total
    for a in range(n):
        for b in range(a):
            inverse[a, b] = inverse[b, a]


class Room(NamedTuple):
    """Working arrays of one thread, so that no frame allocates: see `make_room`."""

    aligned: np.ndarray
    residual: np.ndarray
    information: np.ndarray
    covariance: np.ndarray
    moment: np.ndarray
    latent: np.ndarray
    slope: np.ndarray
    odd: np.ndarray
    scores: np.ndarray
    everyone: np.ndarray


@kernel(reassociate=True)
def make_room(n, markers, latents):
    """Working arrays for frames of n points."""
    return Room(
        np.empty((n, 3)),
        np.empty((markers, 3)),
        np.empty((latents, latents)),
        np.empty((latents, latents)),
        np.empty(latents),
        np.empty(latents),
        np.empty((3, latents)),
        np.zeros(markers, dtype=np.bool_),
        np.empty((markers, n)),
        np.arange(markers),
    )


@kernel(reassociate=True)
def evidence(body, k, points, rows, settings, room):
    """How likely the labelled points are all together, under one key pose.

    IN   body BodyArrays; k key pose; points (n, 3); rows (M,), -1 for none; settings LookSettings
    OUT  room.aligned, residual, moment, information (its Cholesky factor)
    Markers flagged in room.odd count with `settings.odd` and say nothing of the body.
    Returns the labelling's score: log density of its points plus the rewards, in nats (0 is the empty labelling).
    O(M r^2 + r^3).
    """
    markers, latents = body.load.shape[1], body.load.shape[3]
    align(points, rows, body.mean[k], room.everyone, room.aligned)
    room.moment[:] = 0.0
    counted = 0
    for m in range(markers):
        counted += rows[m] >= 0 and not room.odd[m]
    if 2 * counted > markers:
        room.information[:] = body.full[k]
    else:
        room.information[:] = 0.0
        for i in range(latents):
            room.information[i, i] = 1.0
    for m in range(markers):
        present = rows[m] >= 0 and not room.odd[m]
        if present != (2 * counted > markers):
            sign = 1.0 if present else -1.0
            for i in range(latents):
                for j in range(i + 1):
                    room.information[i, j] += sign * body.gram[k, m, i, j]
    score, squares, labelled = body.log_weight[k], 0.0, 0
    for m in range(markers):
        row = rows[m]
        if row < 0:
            continue
        labelled += 1
        if room.odd[m]:
            score += settings.odd
            continue
        for a in range(3):
            total = 0.0
            for b in range(3):
                total += body.whiten[k, m, a, b] * (room.aligned[row, b] - body.mean[k, m, b])
            room.residual[m, a] = total
            squares += total * total
        for i in range(latents):
            room.moment[i] += (
                body.load[k, m, 0, i] * room.residual[m, 0]
                + body.load[k, m, 1, i] * room.residual[m, 1]
                + body.load[k, m, 2, i] * room.residual[m, 2]
            )
        score += body.log_scale[k, m] - 1.5 * LOG_2PI + settings.reward
    if labelled < len(points):
        score -= settings.first_ghost
    score -= 0.5 * _cholesky(room.information, room.latent)
    quadratic = 0.0
    for i in range(latents):
        total = room.moment[i]
        for j in range(i):
            total -= room.information[i, j] * room.latent[j]
        room.latent[i] = total / room.information[i, i]
        quadratic += room.latent[i] * room.latent[i]
    return score + 0.5 * (quadratic - squares)


@kernel(reassociate=True)
def posterior(room):
    """What the labelled points say of the latents, after `evidence`. OUT room.covariance, latent. O(r^3)."""
    _inverse_of_factor(room.information, room.covariance)
    latents = len(room.latent)
    for i in range(latents):
        total = 0.0
        for j in range(latents):
            total += room.covariance[i, j] * room.moment[j]
        room.latent[i] = total


@kernel(reassociate=True)
def score_all(body, k, rows, settings, room):
    """Score every point as every marker, given all other labelled points (leave one out), after `posterior`.

    OUT room.scores (M, n): nats by which "point c is marker m" beats "m is hidden and c is a ghost"; -inf where far
    O(M (r^2 + n)).
    """
    markers, latents, n = body.load.shape[1], body.load.shape[3], len(room.aligned)
    h, inverse = np.empty((3, 3)), np.empty((3, 3))
    centre, shift = np.empty(3), np.empty(3)
    for m in range(markers):
        for a in range(3):
            room.slope[a] = 0.0
            for j in range(latents):
                weight = body.load[k, m, a, j]
                for i in range(latents):
                    room.slope[a, i] += weight * room.covariance[j, i]
        for a in range(3):
            for b in range(3):
                total = 0.0
                for i in range(latents):
                    total += room.slope[a, i] * body.load[k, m, b, i]
                h[a, b] = total
            total = 0.0
            for i in range(latents):
                total += body.load[k, m, a, i] * room.latent[i]
            centre[a] = total
        counts = rows[m] >= 0 and not room.odd[m]
        sign = -1.0 if counts else 1.0
        for a in range(3):
            for b in range(3):
                h[a, b] = (1.0 if a == b else 0.0) + sign * h[a, b]
        # predictive covariance (whitened): I + h for a hidden marker; (I - h)^-1 leave-one-out for a labelled one
        c00, c01, c02 = h[1, 1] * h[2, 2] - h[1, 2] * h[2, 1], h[0, 2] * h[2, 1] - h[0, 1] * h[2, 2], h[0, 1] * h[1, 2] - h[0, 2] * h[1, 1]
        c11, c12, c22 = h[0, 0] * h[2, 2] - h[0, 2] * h[2, 0], h[0, 2] * h[1, 0] - h[0, 0] * h[1, 2], h[0, 0] * h[1, 1] - h[0, 1] * h[1, 0]
        det = h[0, 0] * c00 + h[0, 1] * (h[1, 2] * h[2, 0] - h[1, 0] * h[2, 2]) + h[0, 2] * (h[1, 0] * h[2, 1] - h[1, 1] * h[2, 0])
        det = max(det, 1e-9)
        inverse[0, 0], inverse[0, 1], inverse[0, 2] = c00 / det, c01 / det, c02 / det
        inverse[1, 0], inverse[1, 1], inverse[1, 2] = c01 / det, c11 / det, c12 / det
        inverse[2, 0], inverse[2, 1], inverse[2, 2] = c02 / det, c12 / det, c22 / det
        base = body.log_scale[k, m] - 1.5 * LOG_2PI + settings.reward
        if counts:
            # leave-one-out centre: e - (I - h)^-1 (e - centre)
            base += 0.5 * math.log(det)
            for a in range(3):
                shift[a] = room.residual[m, a]
                for b in range(3):
                    shift[a] -= inverse[a, b] * (room.residual[m, b] - centre[b])
            q = h
        else:
            base -= 0.5 * math.log(det)
            shift[:] = centre
            q = inverse
        at_x = body.mean[k, m, 0] + body.spread[k, m, 0, 0] * shift[0]
        at_y = body.mean[k, m, 1] + body.spread[k, m, 1, 0] * shift[0] + body.spread[k, m, 1, 1] * shift[1]
        at_z = body.mean[k, m, 2] + body.spread[k, m, 2, 0] * shift[0] + body.spread[k, m, 2, 1] * shift[1]
        at_z += body.spread[k, m, 2, 2] * shift[2]
        for c in range(n):
            dx, dy, dz = room.aligned[c, 0] - at_x, room.aligned[c, 1] - at_y, room.aligned[c, 2] - at_z
            near2 = dx * dx + dy * dy + dz * dz
            if near2 > REACH * REACH:
                room.scores[m, c] = -np.inf
                continue
            dx = room.aligned[c, 0] - body.mean[k, m, 0]
            dy = room.aligned[c, 1] - body.mean[k, m, 1]
            dz = room.aligned[c, 2] - body.mean[k, m, 2]
            x = body.whiten[k, m, 0, 0] * dx + body.whiten[k, m, 0, 1] * dy + body.whiten[k, m, 0, 2] * dz - shift[0]
            y = body.whiten[k, m, 1, 0] * dx + body.whiten[k, m, 1, 1] * dy + body.whiten[k, m, 1, 2] * dz - shift[1]
            z = body.whiten[k, m, 2, 0] * dx + body.whiten[k, m, 2, 1] * dy + body.whiten[k, m, 2, 2] * dz - shift[2]
            score = base - 0.5 * (
                x * (q[0, 0] * x + q[0, 1] * y + q[0, 2] * z)
                + y * (q[1, 0] * x + q[1, 1] * y + q[1, 2] * z)
                + z * (q[2, 0] * x + q[2, 1] * y + q[2, 2] * z)
            )
            if score < settings.odd and near2 < settings.odd_radius * settings.odd_radius:
                score = settings.odd
            room.scores[m, c] = score


@kernel(reassociate=True)
def assign(scores, first_ghost, rows):
    """Give points to markers, best score first; what scores below 0 stays null, unless that saves the only ghosts.

    IN  scores (M, n) nats; first_ghost nats that may be paid to leave no point over
    OUT rows (M,), -1 for none
    O(M n + labels * entries above -first_ghost).
    """
    markers, n = scores.shape
    rows[:] = -1
    entry_marker = np.empty(markers * n, dtype=np.int64)
    entry_row = np.empty(markers * n, dtype=np.int64)
    entries = 0
    for m in range(markers):
        for c in range(n):
            if scores[m, c] > -first_ghost:
                entry_marker[entries], entry_row[entries] = m, c
                entries += 1
    taken = np.zeros(n, dtype=np.bool_)
    given, sure = 0, -1
    order = np.empty(min(markers, n), dtype=np.int64)
    credit = first_ghost
    while True:
        best, chosen, kept = -first_ghost, -1, 0
        for e in range(entries):
            m, c = entry_marker[e], entry_row[e]
            if rows[m] >= 0 or taken[c]:
                continue
            entry_marker[kept], entry_row[kept] = m, c
            if scores[m, c] > best:
                best, chosen = scores[m, c], kept
            kept += 1
        entries = kept
        if sure < 0 and (chosen < 0 or best <= 0.0):
            sure = given
        if chosen < 0:
            break
        if best <= 0.0:
            credit += best
            if credit <= 0.0:
                break
        m = entry_marker[chosen]
        rows[m] = entry_row[chosen]
        taken[rows[m]] = True
        order[given] = m
        given += 1
    if given < n:
        for g in range(sure, given):
            rows[order[g]] = -1


@kernel(reassociate=True)
def assign_clear(scores, gap, rows):
    """Give points to markers only where nothing else comes near: best both ways, and by `gap` nats over the next best and over null.

    IN  scores (M, n) nats. OUT rows (M,), -1 for none. O(M n).
    """
    markers, n = scores.shape
    suitor, suit, rival = np.full(n, -1, dtype=np.int64), np.zeros(n), np.zeros(n)
    for c in range(n):
        for m in range(markers):
            if scores[m, c] > suit[c]:
                rival[c] = suit[c]
                suit[c] = scores[m, c]
                suitor[c] = m
            elif scores[m, c] > rival[c]:
                rival[c] = scores[m, c]
    for m in range(markers):
        best, second, chosen = 0.0, 0.0, -1
        for c in range(n):
            if scores[m, c] > best:
                second = best
                best = scores[m, c]
                chosen = c
            elif scores[m, c] > second:
                second = scores[m, c]
        clear = chosen >= 0 and suitor[chosen] == m and best - second > gap and best - rival[chosen] > gap
        rows[m] = chosen if clear else -1


@kernel(reassociate=True)
def _anchor_displacement(anchors, a, k, body, points, rows3, delta):
    """OUT delta (9,): how far an anchor's points lie from a key pose's, once placed onto it. Returns its squared distance."""
    cos, sin, here, there = placing(points, rows3, body.mean[k], anchors.markers[a])
    for i in range(3):
        m, row = anchors.markers[a, i], rows3[i]
        x, y = points[row, 0] - here[0], points[row, 1] - here[1]
        delta[3 * i] = cos * x - sin * y + there[0] - body.mean[k, m, 0]
        delta[3 * i + 1] = sin * x + cos * y + there[1] - body.mean[k, m, 1]
        delta[3 * i + 2] = points[row, 2] - here[2] + there[2] - body.mean[k, m, 2]
    distance = 0.0
    for i in range(9):
        total = 0.5 * anchors.precision[k, a, i, i] * delta[i]
        for j in range(i):
            total += anchors.precision[k, a, i, j] * delta[j]
        distance += 2.0 * total * delta[i]
    return distance


@kernel(reassociate=True)
def key_pose(anchors, a, body, points, rows3, delta):
    """The key pose that fits an anchor's own points best: (k, its log density, its squared distance). O(81 K)."""
    best, best_log, best_distance = 0, -np.inf, np.inf
    for k in range(len(body.log_weight)):
        distance = _anchor_displacement(anchors, a, k, body, points, rows3, delta)
        log_density = anchors.log_own[k, a] - 0.5 * distance
        if log_density > best_log:
            best, best_log, best_distance = k, log_density, distance
    return best, best_log, best_distance


@kernel(reassociate=True)
def predict(anchors, a, k, body, points, rows3, delta, settings, room):
    """Score every point as every marker from an anchor alone (fills room.scores, like `score_all`). O(M n)."""
    markers, n = body.load.shape[1], len(points)
    _anchor_displacement(anchors, a, k, body, points, rows3, delta)
    align(points, rows3, body.mean[k], anchors.markers[a], room.aligned)
    for m in range(markers):
        mx, my, mz = body.mean[k, m, 0], body.mean[k, m, 1], body.mean[k, m, 2]
        for i in range(9):
            mx += anchors.gain[k, a, m, 0, i] * delta[i]
            my += anchors.gain[k, a, m, 1, i] * delta[i]
            mz += anchors.gain[k, a, m, 2, i] * delta[i]
        w = anchors.whiten[k, a, m]
        base = anchors.log_scale[k, a, m] - 1.5 * LOG_2PI + settings.reward
        # no score above 0 beyond sqrt(2 base) standard deviations
        reach2 = 2.0 * max(base, 0.0) * anchors.widest[k, a, m]
        for c in range(n):
            dx, dy, dz = room.aligned[c, 0] - mx, room.aligned[c, 1] - my, room.aligned[c, 2] - mz
            if dx * dx + dy * dy + dz * dz > reach2:
                room.scores[m, c] = -np.inf
                continue
            x = w[0, 0] * dx
            y = w[1, 0] * dx + w[1, 1] * dy
            z = w[2, 0] * dx + w[2, 1] * dy + w[2, 2] * dz
            room.scores[m, c] = base - 0.5 * (x * x + y * y + z * z)
    for i in range(3):
        m = anchors.markers[a, i]
        for c in range(n):
            room.scores[m, c] = -np.inf
        room.scores[m, rows3[i]] = 50.0


@kernel(reassociate=True)
def best_pose(body, points, rows, settings, room):
    """The key pose under which a labelling scores best, and that score: (k, nats)."""
    best, best_score = 0, -np.inf
    for k in range(len(body.log_weight)):
        score = evidence(body, k, points, rows, settings, room)
        if score > best_score:
            best, best_score = k, score
    return best, best_score


@kernel(reassociate=True)
def look_again(body, k, points, rows, settings, room):
    """Score all points by a labelling under key pose k, odd markers set aside: fills room.scores, room.odd; gives the labelling's score.

    A marker is odd where its own point is so far from where the others expect it that it scores `settings.odd` only.
    """
    score = evidence(body, k, points, rows, settings, room)
    posterior(room)
    score_all(body, k, rows, settings, room)
    news = False
    for m in range(len(rows)):
        odd = rows[m] >= 0 and room.scores[m, rows[m]] <= settings.odd
        if odd != room.odd[m]:
            room.odd[m] = odd
            news = True
    if news:
        score = evidence(body, k, points, rows, settings, room)
        posterior(room)
        score_all(body, k, rows, settings, room)
    return score


@kernel(reassociate=True)
def refine(body, k, points, rows, settings, room):
    """Relabel by the whole body until nothing changes: posterior, leave-one-out scores, assignment.

    First only clear labels are taken (`assign_clear`), which narrow down where the others must be; then all.
    IN k key pose to begin with; IN/OUT rows (M,). Returns the score of the labelling, in nats.
    """
    score = -np.inf
    previous = np.empty_like(rows)
    room.odd[:] = False
    clearly = True
    for step in range(ROUNDS):
        previous[:] = rows
        if _count(rows) < 3:
            rows[:] = -1
            return -np.inf
        if step == 1:
            k, _ = best_pose(body, points, rows, settings, room)
        score = look_again(body, k, points, rows, settings, room)
        if clearly:
            assign_clear(room.scores, settings.clear, rows)
            clearly = _count(rows) > _count(previous) and step < ROUNDS // 2
        if not clearly:
            assign(room.scores, settings.first_ghost, rows)
        same = True
        for m in range(len(rows)):
            if rows[m] != previous[m]:
                same = False
                break
        if same:
            return score
    rows[:] = previous
    return score


@kernel(reassociate=True)
def _known(table, count, rows):
    for h in range(count):
        same = True
        for m in range(len(rows)):
            if table[h, m] != rows[m]:
                same = False
                break
        if same:
            return h
    return -1


class Board(NamedTuple):
    """The labellings of one frame that were found so far: H at most.

    starts, start_final  (H, M) what anchors proposed, (H,) the final labelling that each led to
    finals               (H, M) refined labellings
    scores               (H,) nats
    needs                (H,) anchors that must lead to it: one where all points are all markers and fit like a usual body, more where not
    votes, last_vote     (H,) anchors that led to it, and the last of them
    """

    starts: np.ndarray
    start_final: np.ndarray
    finals: np.ndarray
    scores: np.ndarray
    needs: np.ndarray
    votes: np.ndarray
    last_vote: np.ndarray


@kernel(reassociate=True)
def propose(anchors, a, body, points, found, solutions, settings, room, pick, pick_score, pose_of):
    """Which of an anchor's triples are worth following up: those from which the whole body is found best.

    IN   found (solutions, 3) rows of the anchor's markers
    OUT  pick, pick_score (P,) the best of them and how well they explain the frame (nats); pose_of (solutions,) key pose of each
    Returns the number of picks. O(solutions K + P M n).
    """
    markers, n = body.load.shape[1], len(points)
    delta, density = np.empty(9), np.empty(solutions)
    for s in range(solutions):
        pose_of[s], density[s], distance = key_pose(anchors, a, body, points, found[s], delta)
        if distance > settings.far:
            density[s] = -np.inf
    picks, most = 0, len(pick)
    for _ in range(min(solutions, 2 * most + 2 * max(0, n - markers))):
        s = np.argmax(density)
        total = density[s]
        if total == -np.inf:
            break
        density[s] = -np.inf
        predict(anchors, a, pose_of[s], body, points, found[s], delta, settings, room)
        for m in range(markers):
            top = 0.0
            for c in range(n):
                top = max(top, room.scores[m, c])
            total += min(top, 25.0)
        where = picks
        while where > 0 and pick_score[where - 1] < total:
            where -= 1
        if where < most:
            for p in range(min(picks, most - 1), where, -1):
                pick_score[p] = pick_score[p - 1]
                pick[p] = pick[p - 1]
            pick_score[where] = total
            pick[where] = s
            picks = min(picks + 1, most)
    return picks


@kernel(reassociate=True)
def find_labellings(points, order, solvers, anchors, body, settings, room, board, counters):
    """Let anchors propose and refine what they propose, until enough of them agree on the best labelling.

    OUT  board; counters, see `label_frame`. Returns the number of labellings found and the best one's place, -1 for none.
    """
    markers, n = body.load.shape[1], len(points)
    n_starts, n_finals, best, most_labelled, asked = 0, 0, -1, 0, 0
    found = np.empty((max(64, n * n), 3), dtype=np.int64)
    pose_of = np.empty(len(found), dtype=np.int64)
    pick, pick_score = np.empty(settings.per_anchor, dtype=np.int64), np.empty(settings.per_anchor)
    trial, delta = np.empty(markers, dtype=np.int64), np.empty(9)
    evaluations = np.zeros(2, dtype=np.int64)
    for a in range(len(anchors.markers)):
        labelled = _count(board.finals[best]) if best >= 0 else markers
        curious = asked < settings.ask and (labelled <= min(n, markers) - 2 or labelled <= 0.8 * markers)
        if best >= 0 and board.votes[best] >= board.needs[best] and not curious:
            break
        if n_starts + settings.per_anchor > len(board.starts) or evaluations[0] > settings.budget:
            break
        if best >= 0 and board.needs[best] < settings.enough:
            # only an anchor that sees its markers can still agree; one that does not may find what is missing
            one, two, three = anchors.markers[a]
            hidden = board.finals[best, one] < 0 or board.finals[best, two] < 0 or board.finals[best, three] < 0
            if hidden and not curious:
                continue
            if not hidden and board.votes[best] >= board.needs[best]:
                continue
            asked += hidden
        counters[1] += 1
        solutions = search(solvers, a, points, order, settings.budget, found, evaluations)
        if solutions <= 0:
            continue
        picks = propose(anchors, a, body, points, found, solutions, settings, room, pick, pick_score, pose_of)
        for p in range(picks):
            if pick_score[p] < pick_score[0] - WORTH_REFINING:
                break
            predict(anchors, a, pose_of[pick[p]], body, points, found[pick[p]], delta, settings, room)
            assign(room.scores, settings.first_ghost, trial)
            labelled = _count(trial)
            if labelled < max(most_labelled - 2, settings.least_found * min(n, markers)):
                continue
            most_labelled = max(most_labelled, labelled)
            start, final = _known(board.starts, n_starts, trial), _known(board.finals, n_finals, trial)
            if start >= 0:
                final = board.start_final[start]
            elif final < 0:
                board.starts[n_starts] = trial
                assign_clear(room.scores, settings.clear, trial)
                score = refine(body, pose_of[pick[p]], points, trial, settings, room)
                counters[2] += 1
                final = _known(board.finals, n_finals, trial)
                if final < 0:
                    final = n_finals
                    labelled = _count(trial)
                    board.finals[final] = trial
                    board.scores[final] = score
                    usual = settings.good * labelled - (settings.first_ghost if labelled < n else 0.0)
                    board.needs[final] = settings.enough
                    if score >= usual and 10 * labelled >= 6 * min(n, markers):
                        board.needs[final] = 1 if labelled == n and labelled == markers else settings.agree
                    board.votes[final], board.last_vote[final] = 0, -1
                    n_finals += 1
                board.start_final[n_starts] = final
                n_starts += 1
            if board.last_vote[final] < a:
                board.last_vote[final] = a
                board.votes[final] += 1
            if best < 0 or board.scores[final] > board.scores[best]:
                best = final
    counters[0] = evaluations[0]
    return n_finals, best


@kernel(reassociate=True)
def nearest_changes(body, points, settings, room, rows, margins, counters):
    """For every marker, by how much the labelling beats the nearest one that differs there; a better one replaces it.

    Changes looked at: hide the marker, give it a free point, swap it with another, let another marker take its point. Estimated from the
    leave-one-out scores, computed exactly where they come within `settings.contest`.

    IN/OUT rows (M,). OUT margins (M,) nats; for a null, how far its best free point was from being taken (negative)
    Returns the labelling's score. O(M (r^2 + n)) and O(M + r^3) for each change computed exactly.
    """
    markers, n = body.load.shape[1], len(points)
    trial, owner = np.empty(markers, dtype=np.int64), np.empty(n, dtype=np.int64)
    top = -np.inf
    for _ in range(4):
        room.odd[:] = False
        k, _ = best_pose(body, points, rows, settings, room)
        top = look_again(body, k, points, rows, settings, room)
        local = room.scores.copy()
        owner[:] = -1
        whole = _count(rows) == n
        for m in range(markers):
            margins[m] = -np.inf
            if rows[m] >= 0:
                owner[rows[m]] = m
                margins[m] = local[m, rows[m]] + (settings.first_ghost if whole else 0.0)
        better = False
        for m in range(markers):
            for c in range(n):
                o = owner[c]
                if o == m or local[m, c] == -np.inf:
                    continue
                cost = -local[m, c]
                if rows[m] >= 0:
                    cost += local[m, rows[m]]
                if o >= 0:
                    cost += local[o, c]
                    swap = rows[m] >= 0 and local[o, rows[m]] > -settings.contest
                    if swap:
                        cost -= max(0.0, local[o, rows[m]])
                    # a point that a hidden marker may own has drawn the body towards its present owner: the estimate is not to be trusted
                    if cost < settings.contest or (rows[m] < 0 and local[m, c] > -4.0 * settings.contest):
                        trial[:] = rows
                        trial[m] = c
                        trial[o] = rows[m] if swap else -1
                        was, owner_was = room.odd[m], room.odd[o]
                        room.odd[m], room.odd[o] = False, False
                        cost = top - evidence(body, k, points, trial, settings, room)
                        room.odd[m], room.odd[o] = was, owner_was
                        counters[2] += 1
                        if cost < -1e-6:
                            rows[:] = trial
                            better = True
                            break
                    margins[o] = min(margins[o], cost)
                margins[m] = min(margins[m], cost) if rows[m] >= 0 else max(margins[m], -cost)
            if better:
                break
        if not better:
            break
    return top


@kernel(reassociate=True)
def second_look(body, points, top, settings, room, rows, margins, counters):
    """Where markers and points are both left over, see whether a doubtful label keeps them apart: take it back and relabel.

    IN top score of the labelling; IN/OUT rows (M,). Returns whether a better labelling was found.
    """
    trial, k = np.empty_like(rows), 0
    room.odd[:] = False
    k, _ = best_pose(body, points, rows, settings, room)
    for m in range(len(rows)):
        if rows[m] < 0 or margins[m] >= settings.contest:
            continue
        trial[:] = rows
        trial[m] = -1
        counters[2] += 1
        if refine(body, k, points, trial, settings, room) > top + 1e-6:
            rows[:] = trial
            return True
    return False


@kernel
def frame_settings(settings, points, markers):
    """The settings for a frame of so many points: the more points there are than markers, the likelier a ghost lies anywhere."""
    crowd = math.log(1.0 + max(0, points - markers))
    return LookSettings(
        settings.reward - crowd,
        settings.first_ghost,
        settings.odd - crowd,
        settings.odd_radius,
        settings.far,
        settings.agree,
        settings.ask,
        settings.budget,
        settings.per_anchor,
        settings.least_found,
        settings.clear,
        settings.contest,
        settings.good - crowd,
        settings.enough,
    )


@kernel(reassociate=True)
def label_frame(points, order, solvers, anchors, body, settings, room, board, rows, margins, counters):
    """The best labelling of one frame and by how much it beats the next one, marker by marker.

    Anchors (partial solvers of three markers) propose; from each proposal the whole body is predicted, labelled and refined; labellings
    reached from several anchors collect votes. The best one's margins are taken against its nearest changes and the other labellings found.

    IN   points (n, 3) m, z up; order (n,) search order; solvers SolverArrays, anchors AnchorArrays (the same anchors); body, settings
    OUT  rows (M,), margins (M,) nats (for a null: how far its best free point was from being taken, negative);
         counters (4,): feature evaluations, anchors run, labellings scored, votes of the best
    """
    rows[:] = -1
    margins[:] = -np.inf
    counters[:] = 0
    if len(points) < 3:
        return
    settings = frame_settings(settings, len(points), len(rows))
    count, best = find_labellings(points, order, solvers, anchors, body, settings, room, board, counters)
    if best < 0 or board.scores[best] == -np.inf:
        return
    rows[:] = board.finals[best]
    counters[3] = board.votes[best]
    top = nearest_changes(body, points, settings, room, rows, margins, counters)
    for _ in range(3):
        labelled = _count(rows)
        if labelled == len(rows) or labelled == len(points):
            break
        if not second_look(body, points, top, settings, room, rows, margins, counters):
            break
        top = nearest_changes(body, points, settings, room, rows, margins, counters)
    for h in range(count):
        for m in range(len(rows)):
            if rows[m] >= 0 and board.finals[h, m] != rows[m]:
                margins[m] = min(margins[m], max(0.0, top - board.scores[h]))


@kernel(reassociate=True)
def label_clouds(xyz, offsets, first, last, solvers, anchors, body, settings, rows, margins, counters):
    """`label_frame` for the frames first..last of clouds whose points are sorted within each frame.

    IN  xyz (P, 3) m, z up; offsets (T + 1,)
    OUT rows (T, M), margins (T, M) nats, counters (T, 4); see `label_frame`
    O(frames * (anchors' search + labellings * M r^2)); memory for one frame.
    """
    markers, latents = body.load.shape[1], body.load.shape[3]
    most = 0
    for t in range(first, last):
        most = max(most, offsets[t + 1] - offsets[t])
    order = np.arange(most)
    room = make_room(0, markers, latents)
    board = Board(
        np.empty((LABELLINGS, markers), dtype=np.int64),
        np.empty(LABELLINGS, dtype=np.int64),
        np.empty((LABELLINGS, markers), dtype=np.int64),
        np.empty(LABELLINGS),
        np.empty(LABELLINGS, dtype=np.int64),
        np.empty(LABELLINGS, dtype=np.int64),
        np.empty(LABELLINGS, dtype=np.int64),
    )
    for t in range(first, last):
        n = offsets[t + 1] - offsets[t]
        if n != len(room.aligned):
            room = make_room(n, markers, latents)
        label_frame(
            xyz[offsets[t] : offsets[t + 1]], order[:n], solvers, anchors, body, settings, room, board, rows[t], margins[t], counters[t]
        )
