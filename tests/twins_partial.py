"""Plain twins of the kernels of partial solvers that decide: slow, obvious, and what the kernels must equal."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import twins

from asterism.labelling.features.registry import FEATURES


def bits_of(words, count):
    """(..., W) words as (..., count) booleans."""
    return np.unpackbits(np.ascontiguousarray(words).astype("<u8").view(np.uint8), axis=-1, bitorder="little")[..., :count].astype(bool)


def value(kind, points, *, cosine=True):
    """A feature, or of an angle its cosine; NaN where a point or a motion is missing, 0 where coincident points leave it undefined.

    points: a list of rows, as many as the feature takes.
    """
    name, points = FEATURES[kind].name, np.asarray(points)
    if np.isnan(points[:, :3]).any():
        return np.nan
    with np.errstate(all="ignore"):
        number = twins.feature(name, points)
    if name == "g11" and np.array_equal(points[0, :3], points[1, :3]):
        return 0.0 * points[:2, 9:12].sum()
    if not FEATURES[kind].moving and not np.isfinite(number):
        number = 0.0
    return np.cos(number) if cosine and name in ("g1", "g6", "g7") else number


def labellings(solver, points):
    """All labellings of a solver, rows by depth, by trying every one."""
    weak = solver.weak
    intervals = list(zip(weak.kinds, weak.slots, weak.low, weak.high, strict=True))
    return [
        rows
        for rows in permutations(range(len(points)), len(solver.markers))
        if not any(
            low > number or number > high
            for kind, slots, low, high in intervals
            for number in [value(kind, [points[rows[slot]] for slot in slots[: FEATURES[kind].points]], cosine=False)]
        )
    ]


def choose_covering(rejects, weights, most):
    """Greedy weighted cover: rejects (F, K) bool, weights (K,) of the samples that count, 0 of the others.

    Returns the classifiers in order, the gain of each, and how many the first round took.
    """
    chosen, gains, first_round = [], [], None
    left = weights > 0
    fresh = True
    while len(chosen) < most:
        gain = [0 if f in chosen else int((rejects[f] * left * weights).sum()) for f in range(len(rejects))]
        best = int(np.argmax(gain)) if len(gain) else -1
        if best < 0 or gain[best] == 0:
            first_round = len(chosen) if first_round is None else first_round
            if fresh:
                break
            left, fresh = weights > 0, True
            continue
        chosen.append(best)
        gains.append(gain[best])
        left = left & ~rejects[best]
        fresh = False
    return chosen, gains, len(chosen) if first_round is None else first_round


def order_tests(rejects, reads, markers, start):
    """The tree of `order_tests`: rejects (F, M, R) bool, reads (F, M) bool.

    Returns the markers by depth, and the classifiers of each depth in order.
    """
    order, tests, placed = [], [], set()
    read_by = [set(np.nonzero(row)[0].tolist()) for row in reads]

    def computable_with(marker):
        """Classifiers not placed yet that marker makes computable."""
        return [f for f in range(len(reads)) if f not in placed and marker in read_by[f] and read_by[f] <= {*order, marker}]

    def share(marker):
        now = computable_with(marker)
        return int(rejects[now, marker].any(axis=0).sum()) if now else 0

    for depth in range(len(markers)):
        free = sorted(set(markers) - set(order))
        best = start if depth == 0 else free[int(np.argmax([share(marker) for marker in free]))]
        computable = computable_with(best)
        order.append(best)
        ranked, left = [], np.ones(rejects.shape[2], dtype=bool)
        while computable:
            gain = [int((rejects[f, best] & left).sum()) for f in computable]
            f = computable.pop(int(np.argmax(gain)))
            ranked.append(f)
            left &= ~rejects[f, best]
        placed |= set(ranked)
        tests.append(ranked)
    return order, tests


def check_marker(strong, m, place, points, slack, min_tests):
    """The level of `check_marker`, from the classifiers that read m and whose markers all have points."""
    known, missed, far = 0, False, False
    for f in range(strong.first[m], strong.first[m + 1]):
        rows = [place[marker] for marker in strong.slots[f, : strong.points[f]]]
        if min(rows) < 0:
            continue
        number = value(strong.kinds[f], [points[row] for row in rows])
        known += not np.isnan(number)
        low, high = strong.low[f], strong.high[f]
        missed |= bool(number < low or number > high)
        far |= bool(number < low - slack * (high - low) or number > high + slack * (high - low))
    if far:
        return 0
    return 1 if missed or known < min_tests else 2


def complete_labels(strong, points, place, rules):
    """The labels after completion, as a list; `place` is not changed."""
    place = list(place)
    for _ in range(rules.rounds):
        free = sorted(set(range(len(points))) - set(place))
        open_markers = [m for m, row in enumerate(place) if row < 0]
        level = {
            (m, c): check_marker(strong, m, [*place[:m], c, *place[m + 1 :]], points, rules.slack, rules.min_tests)
            for m in open_markers
            for c in free
        }
        given = {}
        for m in open_markers:
            near = [c for c in free if level[m, c] > 0]
            if len(near) == 1 and level[m, near[0]] == 2 and sum(level[other, near[0]] > 0 for other in open_markers) == 1:
                given[m] = near[0]
        for m, c in given.items():
            place[m] = c
        if not given:
            break
    return place


def label_by_matrix(proposals, trusting, strong, points, rules):
    """Labels of one frame from the proposals, a dict marker -> candidate for each solver, with the strong classifier.

    trusting: how many solvers are trusted with each marker.
    """
    cells = np.zeros((len(trusting), max(len(points), 1)), dtype=int)
    for proposal in proposals:
        for marker, candidate in proposal.items():
            cells[marker, candidate] += 1
    place, single = choose_by_votes(cells, trusting, True, rules.outvote)
    place = complete_labels(strong, points, place, rules)
    return accept_single(strong, points, rules, single, place)


def choose_by_votes(cells, trusting, completing, outvote):
    """The candidate of each marker by the safe rules, and those that a single solver proposed, from votes (M, n)."""
    place, single = [-1] * len(trusting), {}
    for m in range(len(trusting)):
        if cells[m].sum() == 0:
            continue
        best = int(np.argmax(cells[m]))
        votes = cells[m, best]
        against = cells[m].sum() + cells[:, best].sum() - 2 * votes
        if against == 0 and votes == 1 and trusting[m] > 1 and completing:
            single[m] = best
        elif against == 0 or (completing and votes > outvote * against):
            place[m] = best
    return place, single


def accept_single(strong, points, rules, single, place):
    """The labels with those candidates of single solvers that are free and that the strong classifier accepts."""
    place = list(place)
    for m, candidate in sorted(single.items()):
        if place[m] < 0 and candidate not in place:
            tried = [*place[:m], candidate, *place[m + 1 :]]
            if check_marker(strong, m, tried, points, rules.slack, rules.min_tests) == 2:
                place = tried
    return place


def count_confusions(strong, frames, known):
    """taken_for (M, M) and shown (M,) of `count_confusions`, over all frames."""
    markers = frames.shape[1]
    taken_for, shown = np.zeros((markers, markers), dtype=int), np.zeros(markers, dtype=int)

    def accepted(places, marker, points):
        return check_marker(strong, marker, [places.get(m, -1) for m in range(markers)], points, 0.0, 1) == 2

    for points, labels_known in zip(frames, known, strict=True):
        visible = ~np.isnan(points[:, 0])
        for a in np.nonzero(visible)[0].tolist():
            shown[a] += 1
            taken_for[a, a] += 1
            for b in set(range(markers)) - {a}:
                others = {m: m for m in range(markers) if labels_known[m] and visible[m] and m not in (a, b)}
                moved = accepted({**others, b: a}, b, points)
                swap = {**others, b: a, a: b}
                swapped = visible[b] and accepted(swap, b, points) and accepted(swap, a, points)
                taken_for[a, b] += bool(moved or swapped)
    return taken_for, shown


def agreement(labellings, depths):
    """Where all labellings (tuples of rows) agree: a row or -1 by depth; all -1 without a labelling."""
    return [next(iter(rows)) if len(rows := {labelling[k] for labelling in labellings}) == 1 else -1 for k in range(depths)]


def label_by_full_solver(solver, points, most):
    """The row of each marker (by depth) of one frame, -1 where feasible labellings differ, or there is none or more than `most`."""
    found = labellings(solver, points)
    return agreement(found if len(found) <= most else (), len(solver.markers))


def evaluate_solver(solver, frames, chosen, hidden, motion_unknown, n_markers):
    """Counts (hits, failures, abstentions), each (n_markers,), by trying every labelling of every frame; never ends early."""
    hits, failures, abstentions = (np.zeros(n_markers, dtype=int) for _ in range(3))
    for frame, out, unknown in zip(chosen, hidden, motion_unknown, strict=True):
        there = [m for m in range(n_markers) if not out[m] and not np.isnan(frames[frame, m, 0])]
        points = frames[frame, there].copy()
        points[unknown[there], 3:] = np.nan
        agreed = label_by_full_solver(solver, points, 32)
        in_sight = set(solver.markers.tolist()) <= set(there)
        for marker, row in zip(solver.markers.tolist(), agreed, strict=True):
            if row < 0:
                abstentions[marker] += in_sight
            elif there[row] == marker:
                hits[marker] += 1
            else:
                failures[marker] += 1
    return hits, failures, abstentions


def handed_in_points(solver, frames, chosen, hidden, motion_unknown, n_markers):
    """For each frame and depth the set of markers whose points some labelling of the solver gives."""
    out = []
    for frame, away, unknown in zip(chosen, hidden, motion_unknown, strict=True):
        there = [m for m in range(n_markers) if not away[m] and not np.isnan(frames[frame, m, 0])]
        points = frames[frame, there].copy()
        points[unknown[there], 3:] = np.nan
        found = labellings(solver, points)
        found = found if len(found) <= 32 else []
        out.append([{there[labelling[k]] for labelling in found} for k in range(len(solver.markers))])
    return out
