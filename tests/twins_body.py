"""Plain twins of the whole-body kernels: full covariances, densities by their formula, every triple tried; nothing clever."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import twins

from asterism.labelling.body._refine_kernels import MAX_ROUNDS
from asterism.labelling.body._score_kernels import MAX_DISTANCE
from asterism.labelling.body._search_kernels import (
    LAID_REACH,
    LAID_SIZES,
    MARKER_GAIN,
    MAX_LABELLINGS,
    MAX_MARKER_SCORE,
    MAX_PROPOSAL_GAP,
    MAX_TURNS,
    MAX_TWIN_GAP,
)


def placement(points, rows, mean, markers):
    """The rotation about z and the two centres that bring points[rows] best onto mean[markers] (Procrustes, by SVD in the plane)."""
    here = np.array([points[row] for row in rows if row >= 0])
    there = np.array([mean[m] for m, row in zip(markers, rows, strict=True) if row >= 0])
    a, b = here - here.mean(axis=0), there - there.mean(axis=0)
    u, _, v = np.linalg.svd(b[:, :2].T @ a[:, :2])
    turn = np.eye(3)
    turn[:2, :2] = u @ np.diag([1.0, np.linalg.det(u @ v)]) @ v
    return turn, here.mean(axis=0), there.mean(axis=0)


def place_points(points, rows, mean, markers):
    """All points, placed."""
    turn, here, there = placement(points, rows, mean, markers)
    return (points - here) @ turn.T + there


def coordinates(markers):
    """Places of the markers' coordinates in the flat body."""
    return np.array([3 * m + axis for m in markers for axis in range(3)], dtype=np.int64)


def covariance(model, k):
    """(3M, 3M) m2, of the placed body: latents and noise together, block by block."""
    load, noise = model.load[k], model.noise[k]
    out = np.einsum("air,bjr->aibj", load, load)
    for m in range(len(load)):
        out[m, :, m] += noise[m]
    return out.reshape(3 * len(load), -1)


def log_density(deviation, spread):
    """Of a normal distribution about 0, by its formula; 0 for no numbers at all."""
    square = deviation @ np.linalg.solve(spread, deviation)
    return -0.5 * (len(deviation) * np.log(2 * np.pi) + np.linalg.slogdet(spread)[1] + square)


def squared_distance(deviation, spread):
    """The squared Mahalanobis distance of a deviation."""
    return deviation @ np.linalg.solve(spread, deviation) if len(deviation) else 0.0


def log_tail(square, coordinates, freedom):
    """Minus half the square up to its expectation; from there on the log of a t density, scaled and shifted to go on smoothly."""
    if square <= coordinates:
        return -0.5 * square
    slope_of_t = 0.5 * (freedom + coordinates)
    return -0.5 * coordinates - slope_of_t * (np.log(1 + square / freedom) - np.log(1 + coordinates / freedom))


def tailed_density(deviation, spread, freedom):
    """`log_density` with the tail of a posture that the training lacks."""
    square = squared_distance(deviation, spread)
    return log_density(deviation, spread) + 0.5 * square + log_tail(square, len(deviation), freedom)


def conditional(joint, wanted, known, deviation):
    """Mean and covariance of the coordinates `wanted`, given those `known` deviate so much."""
    if not len(known):
        return np.zeros(len(wanted)), joint[np.ix_(wanted, wanted)]
    gain = np.linalg.solve(joint[np.ix_(known, known)], joint[np.ix_(known, wanted)]).T
    return gain @ deviation, joint[np.ix_(wanted, wanted)] - gain @ joint[np.ix_(known, wanted)]


def observed(k, points, rows, outlier, model):
    """The markers that say something of the body, and how far they all deviate from the mean: names, flat deviation."""
    aligned = place_points(points, rows, model.mean[k], range(len(rows)))
    markers = [m for m in range(len(rows)) if rows[m] >= 0 and not outlier[m]]
    deviation = [aligned[rows[m]] - model.mean[k, m] for m in markers]
    return markers, np.concatenate(deviation) if markers else np.empty(0)


def evidence(model, k, points, rows, outlier, settings):
    """Joint log density of the placed points, the latents integrated out, and the rewards."""
    markers, deviation = observed(k, points, rows, outlier, model)
    at = coordinates(markers)
    score = model.log_weight[k] + tailed_density(deviation, covariance(model, k)[np.ix_(at, at)], settings.tail_freedom)
    score += settings.reward * len(markers) + settings.outlier_score * sum(outlier[m] for m in range(len(rows)) if rows[m] >= 0)
    return score - settings.first_ghost_cost if sum(row >= 0 for row in rows) < len(points) else score


def posterior(model, k, points, rows, outlier):
    """Mean and covariance of the latents, from their joint distribution with the points."""
    markers, deviation = observed(k, points, rows, outlier, model)
    load = model.load[k].reshape(-1, model.load.shape[3])
    joint = np.block([[covariance(model, k), load], [load.T, np.eye(load.shape[1])]])
    return conditional(joint, len(load) + np.arange(load.shape[1]), coordinates(markers), deviation)


def leave_one_out_scores(model, k, points, rows, outlier, settings):
    """Every point as every marker, each marker predicted from the others' points alone, at most `MAX_DISTANCE` away: (M, n)."""
    aligned = place_points(points, rows, model.mean[k], range(len(rows)))
    out = np.empty((len(rows), len(points)))
    for m in range(len(rows)):
        without = [-1 if other == m else row for other, row in enumerate(rows)]
        markers = [other for other in range(len(rows)) if without[other] >= 0 and not outlier[other]]
        deviation = np.concatenate([np.empty(0), *(aligned[rows[other]] - model.mean[k, other] for other in markers)])
        others, joint = coordinates(markers), covariance(model, k)
        centre, _ = conditional(joint, coordinates([m]), others, deviation)
        without = tailed_density(deviation, joint[np.ix_(others, others)], settings.tail_freedom)
        both = np.concatenate([others, coordinates([m])])
        for c, point in enumerate(aligned):
            away = point - model.mean[k, m] - centre
            with_point = np.concatenate([deviation, point - model.mean[k, m]])
            score = settings.reward + tailed_density(with_point, joint[np.ix_(both, both)], settings.tail_freedom) - without
            if np.linalg.norm(away) < settings.outlier_radius:
                score = max(score, settings.outlier_score)
            out[m, c] = score if np.linalg.norm(away) <= MAX_DISTANCE else -np.inf
    return out


def placed_anchor(model, k, points, rows3, triple):
    """All points, placed by an anchor's three, and how far these deviate from a key pose: (n, 3), (9,)."""
    aligned = place_points(points, rows3, model.mean[k], triple)
    return aligned, np.concatenate([aligned[row] - model.mean[k, m] for m, row in zip(triple, rows3, strict=True)])


def anchor_density(model, k, points, rows3, triple):
    """Log density of an anchor's own three points under a key pose, with that pose's weight; and their squared distance."""
    _, deviation = placed_anchor(model, k, points, rows3, triple)
    at = coordinates(triple)
    own = covariance(model, k)[np.ix_(at, at)]
    return model.log_weight[k] + log_density(deviation, own), deviation @ np.linalg.solve(own, deviation)


def score_from_anchor(model, k, points, rows3, triple, settings):
    """Every point as every marker that is not the anchor's, given the anchor's nine coordinates: (M, n), NaN for the anchor's own."""
    aligned, deviation = placed_anchor(model, k, points, rows3, triple)
    out = np.full((len(model.mean[k]), len(points)), np.nan)
    for m in set(range(len(out))) - set(triple.tolist()):
        centre, spread = conditional(covariance(model, k), coordinates([m]), coordinates(triple), deviation)
        for c, point in enumerate(aligned):
            out[m, c] = settings.reward + log_density(point - model.mean[k, m] - centre, spread)
    return out


def assign_greedily(scores, first_ghost):
    """Best pair first. Pairs that score nothing are added only if they leave no point over, and cost less than the first ghost."""

    def best_first(rows, worth):
        free = [
            (scores[m, c], m, c)
            for m in range(len(scores))
            for c in range(scores.shape[1])
            if rows[m] < 0 and c not in rows and worth(scores[m, c])
        ]
        return max(free, default=None)

    gains = [-1] * len(scores)
    while pair := best_first(gains, lambda score: score > 0.0):
        gains[pair[1]] = pair[2]
    complete, paid = list(gains), 0.0
    while pair := best_first(complete, lambda score: score > -first_ghost):
        paid -= pair[0]
        if paid >= first_ghost:
            break
        complete[pair[1]] = pair[2]
    return complete if set(range(scores.shape[1])) <= set(complete) else gains


def assign_unambiguous(scores, gap):
    """Pairs that beat every other pair of their marker and of their point, and null (0), by more than `gap`."""
    rows = [-1] * len(scores)
    for m in range(len(scores)):
        for c in range(scores.shape[1]):
            rivals = [0.0, *np.delete(scores[m], c), *np.delete(scores[:, c], m)]
            if scores[m, c] - max(rivals) > gap:
                rows[m] = c
    return rows


def count(rows):
    """How many markers have a point."""
    return sum(row >= 0 for row in rows)


def best_pose(model, points, rows, outlier, settings):
    """The key pose of the highest evidence."""
    return int(np.argmax([evidence(model, k, points, rows, outlier, settings) for k in range(len(model.mean))]))


def rescore(model, k, points, rows, outlier, settings):
    """Score, leave-one-out scores (M, n) and outliers (M,) of a labelling; what an outlier is follows from the scores before."""
    scores = leave_one_out_scores(model, k, points, rows, outlier, settings)
    outlier = np.array([rows[m] >= 0 and scores[m, rows[m]] <= settings.outlier_score for m in range(len(rows))])
    scores = leave_one_out_scores(model, k, points, rows, outlier, settings)
    return evidence(model, k, points, rows, outlier, settings), scores, outlier


def refine(model, k, points, rows, settings, known=(), least=-np.inf, marker_gain=0.0):
    """Relabel until nothing changes, or until one of the `known` labellings is reached; unambiguous labels first: score, rows.

    What falls below `least`, each marker that could have a point taken as marker_gain, is given up.
    """
    rows, outlier, only_unambiguous = list(rows), np.zeros(len(rows), dtype=bool), True
    for step in range(MAX_ROUNDS):
        if count(rows) < 3:
            return -np.inf, [-1] * len(rows)
        previous = rows
        if step == 1:
            k = best_pose(model, points, rows, outlier, settings)
        score, scores, outlier = rescore(model, k, points, rows, outlier, settings)
        if not only_unambiguous and score + marker_gain * (min(len(rows), len(points)) - count(rows)) < least:
            return score, previous
        if only_unambiguous:
            rows = assign_unambiguous(scores, settings.assign_margin)
            only_unambiguous = count(rows) > count(previous) and step < MAX_ROUNDS // 2
        if not only_unambiguous:
            rows = assign_greedily(scores, settings.first_ghost_cost)
        if rows == previous:
            break
        if not only_unambiguous and tuple(map(int, rows)) in known:
            return np.nan, rows
    return score, previous


def anchor_triples(anchors, a, points):
    """All points that an anchor's three markers may be, by trying every triple."""
    checks = [("g4", (0, 1)), ("g2", (0, 1)), ("g4", (0, 2)), ("g2", (0, 2)), ("g2", (1, 2)), ("g19", (0, 1, 2))]

    def allowed(triple):
        values = [twins.feature(name, [points[triple[slot]] for slot in slots]) for name, slots in checks]
        return all(low <= value <= high for low, value, high in zip(anchors.low[a], values, anchors.high[a], strict=True))

    return [triple for triple in permutations(range(len(points)), 3) if allowed(triple)]


def all_anchor_scores(model, k, points, rows3, triple, settings):
    """`score_from_anchor` as the search uses it: 50 nats for the anchor's own points, nothing where no score above 0 can be."""
    out = score_from_anchor(model, k, points, rows3, triple, settings)
    aligned, deviation = placed_anchor(model, k, points, rows3, triple)
    for m in set(range(len(out))) - set(triple.tolist()):
        centre, spread = conditional(covariance(model, k), coordinates([m]), coordinates(triple), deviation)
        base = settings.reward + log_density(np.zeros(3), spread)
        far = ((aligned - model.mean[k, m] - centre) ** 2).sum(axis=1) > 2 * max(base, 0.0) * np.trace(spread)
        out[m, far] = -np.inf
    out[triple] = -np.inf
    out[triple, rows3] = 50.0
    return out


def likely_triples(model, triple, points, triples, settings):
    """The likeliest triples, likeliest first: [(density, key pose, triple)], two for each proposal and for each point too many."""
    likely = []
    for rows3 in triples:
        found = [anchor_density(model, k, points, rows3, triple) for k in range(len(model.mean))]
        k = int(np.argmax([density for density, _ in found]))
        if found[k][1] <= settings.max_anchor_distance2:
            likely.append((found[k][0], k, rows3))
    most = 2 * settings.proposals_per_anchor + 2 * max(0, len(points) - len(model.mean[0]))
    return sorted(likely, reverse=True)[:most]


def propose(model, triple, points, triples, settings):
    """The triples worth refining, best first: [(score, key pose, triple)]."""
    ranked = []
    for density, k, rows3 in likely_triples(model, triple, points, triples, settings):
        scores = all_anchor_scores(model, k, points, np.array(rows3), triple, settings)
        ranked.append((density + np.clip(scores.max(axis=1), 0.0, MAX_MARKER_SCORE).sum(), k, rows3))
    return sorted(ranked, reverse=True)[: settings.proposals_per_anchor]


def find_labellings(model, anchors, points, settings):
    """The labellings found, {rows: [score, votes needed, anchors that led to it]}, and the best one, None for none."""
    led_to, found, best, most, extra = {}, {}, None, 0, 0
    markers, n = len(model.mean[0]), len(points)
    for a, triple in enumerate(anchors.triples):
        labelled = markers if best is None else count(best)
        needs_more = extra < settings.extra_anchors and (labelled <= min(n, markers) - 2 or labelled <= 0.8 * markers)
        enough = best is not None and len(found[best][2]) >= found[best][1]
        if (enough and not needs_more) or len(led_to) + settings.proposals_per_anchor > MAX_LABELLINGS:
            break
        if best is not None and found[best][1] < settings.max_votes_needed:
            hidden = any(best[m] < 0 for m in triple)
            if (hidden and not needs_more) or (not hidden and enough):
                continue
            extra += hidden
        ranked = propose(model, triple, points, anchor_triples(anchors, a, points), settings)
        for score, k, rows3 in ranked:
            if score < ranked[0][0] - MAX_PROPOSAL_GAP:
                break
            scores = all_anchor_scores(model, k, points, np.array(rows3), triple, settings)
            proposal = tuple(assign_greedily(scores, settings.first_ghost_cost))
            if count(proposal) < max(most - 2, settings.min_found_share * min(n, markers)):
                continue
            most = max(most, count(proposal))
            if proposal in led_to:
                final = led_to[proposal]
            elif proposal in found:
                final = proposal
            else:
                total, rows = refine(model, k, points, assign_unambiguous(scores, settings.assign_margin), settings, found)
                final = led_to[proposal] = tuple(int(row) for row in rows)
                if final not in found:
                    usual = settings.usual_score * count(final) - settings.first_ghost_cost * (count(final) < n)
                    needed = settings.max_votes_needed
                    if total >= usual and count(final) >= 0.6 * min(n, markers):
                        needed = 1 if count(final) == n == markers else settings.votes_needed
                    found[final] = [total, needed, set()]
            found[final][2].add(a)
            if best is None or found[final][0] > found[best][0]:
                best = final
    return found, best


def lay_body(mean, turn, size, aligned):
    """The point next to each marker of a body of this size and heading; the middles and the lowest places come together."""
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    placed = size * (mean - mean.mean(axis=0)) @ rotation.T
    placed += [*aligned.mean(axis=0)[:2], aligned[:, 2].min() - placed[:, 2].min()]
    apart = np.linalg.norm(placed[:, None] - aligned[None], axis=2)
    return assign_greedily(1.0 - (apart / LAID_REACH) ** 2, 0.0)


def held_against(model, k, points, rows, table, lays):
    """What a labelling is held against: its twins, and the body laid anew in every size at four headings."""
    trials = [tuple(rows[m] if m >= 0 else -1 for m in twin) for twin in table.tolist()]
    if lays:
        aligned = place_points(points, rows, model.mean[k], range(len(rows)))
        turns = [0.5 * np.pi * turn for turn in range(4)]
        trials += [tuple(map(int, lay_body(model.mean[k], turn, size, aligned))) for size in LAID_SIZES for turn in turns]
    return trials


def add_twins(model, table, found, best, points, settings):
    """The labellings found and the best one, after it and each better one were held against their twins; `table` as `FrameModel.twins`."""
    markers, n = len(model.mean[0]), len(points)
    none = np.zeros(markers, dtype=bool)
    for _ in range(MAX_TURNS):
        top, better, left = found[best][0], None, min(markers, n) - count(best)
        poor = top < settings.usual_score * count(best) - settings.first_ghost_cost
        lays = left >= 2 and (poor or left > 0.3 * markers)
        pose = best_pose(model, points, best, none, settings)
        for trial in held_against(model, pose, points, best, table, lays):
            if trial in found or count(trial) < 3:
                continue
            k = best_pose(model, points, trial, none, settings)
            open_pairs = min(markers, n) - count(trial)
            if evidence(model, k, points, trial, none, settings) + MARKER_GAIN * open_pairs < top - MAX_TWIN_GAP:
                continue
            score, rows = refine(model, k, points, trial, settings, found, top - MAX_TWIN_GAP, MARKER_GAIN)
            rows = tuple(int(row) for row in rows)
            hopeless = score + MARKER_GAIN * (min(markers, n) - count(rows)) < top - MAX_TWIN_GAP
            if np.isnan(score) or hopeless or rows in found:
                continue
            if len(found) == MAX_LABELLINGS:
                del found[min((other for other in found if other != best), key=lambda other: found[other][0])]
            found[rows] = [score, found[best][1], found[best][2]]
            if score > top + 1e-6:
                better = rows
                break
        if better is None:
            break
        best = better
    return found, best


def score_held_points(model, k, points, rows, outlier, scores, settings):
    """`leave_one_out_scores`, in which a labelled point that is scored as a hidden marker says nothing of the body."""
    out = scores.copy()
    for holder, row in enumerate(rows):
        if row < 0:
            continue
        flags = outlier.copy()
        flags[holder] = True
        without = leave_one_out_scores(model, k, points, rows, flags, settings)[:, row]
        for m in range(len(rows)):
            if rows[m] < 0 and scores[m, row] > -4 * settings.exact_margin:
                out[m, row] = without[m]
    return out


def nearest_changes(model, points, rows, settings):
    """Score, rows and margins (M,) of a labelling after the changes of one or two markers that make it better, four at most."""
    rows, none = list(rows), np.zeros(len(rows), dtype=bool)
    for _ in range(4):
        k = best_pose(model, points, rows, none, settings)
        top, scores, outlier = rescore(model, k, points, rows, none, settings)
        owner = {row: m for m, row in enumerate(rows) if row >= 0}
        scores = score_held_points(model, k, points, rows, outlier, scores, settings)
        hide = settings.first_ghost_cost if len(owner) == len(points) else 0.0
        margins = [scores[m, row] + hide if row >= 0 else -np.inf for m, row in enumerate(rows)]
        better = None
        for m, c in product(range(len(rows)), range(len(points))):
            other, row = owner.get(c), rows[m]
            if other == m or scores[m, c] == -np.inf:
                continue
            cost = (scores[m, row] if row >= 0 else 0.0) - scores[m, c]
            if other is not None:
                swap = row >= 0 and scores[other, row] > -settings.exact_margin
                cost += scores[other, c] - (max(0.0, scores[other, row]) if swap else 0.0)
                if cost < settings.exact_margin:
                    trial, flags = list(rows), outlier.copy()
                    trial[m], trial[other] = c, row if swap else -1
                    flags[[m, other]] = False
                    cost = top - evidence(model, k, points, trial, flags, settings)
                    if cost < -1e-6:
                        better = trial
                        break
                margins[other] = min(margins[other], cost)
            margins[m] = min(margins[m], cost) if row >= 0 else max(margins[m], -cost)
        if better is None:
            break
        rows = better
    return top, rows, margins


def retry_doubtful(model, points, top, rows, margins, settings):
    """The first better labelling that follows when one doubtful label is taken back; None where there is none."""
    k = best_pose(model, points, rows, np.zeros(len(rows), dtype=bool), settings)
    for m, row in enumerate(rows):
        if row >= 0 and margins[m] < settings.exact_margin:
            score, better = refine(model, k, points, [-1 if other == m else row for other, row in enumerate(rows)], settings)
            if score > top + 1e-6:
                return better
    return None


def fits(model, points, rows, settings):
    """How well each marker's point lies where all other labels predict it (M,), 0 for a null; settings for this number of points."""
    none = np.zeros(len(rows), dtype=bool)
    _, scores, _ = rescore(model, best_pose(model, points, rows, none, settings), points, rows, none, settings)
    return [scores[m, row] if row >= 0 else 0.0 for m, row in enumerate(rows)]


def crowded(settings, points, markers):
    """The settings for a frame of so many points."""
    crowd = np.log(1 + max(0, points - markers))
    return settings._replace(**{name: getattr(settings, name) - crowd for name in ("reward", "outlier_score", "usual_score")})


def label_frame(model, anchors, points, settings, table):
    """Rows and margins (M,) of the best labelling of a frame; table (W, M): see `FrameModel.twins`."""
    markers = len(model.mean[0])
    settings = crowded(settings, len(points), markers)
    found, best = find_labellings(model, anchors, points, settings) if len(points) >= 3 else ({}, None)
    if best is None or found[best][0] == -np.inf:
        return [-1] * markers, [-np.inf] * markers
    found, best = add_twins(model, table, found, best, points, settings)
    top, rows, margins = nearest_changes(model, points, best, settings)
    for _ in range(3):
        if count(rows) in (markers, len(points)):
            break
        better = retry_doubtful(model, points, top, rows, margins, settings)
        if better is None:
            break
        top, rows, margins = nearest_changes(model, points, better, settings)
    for other, (score, _, _) in found.items():
        for m in range(markers):
            if rows[m] >= 0 and other[m] != rows[m]:
                margins[m] = min(margins[m], max(0.0, top - score))
    return rows, margins
