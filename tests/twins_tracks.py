"""Plain twins of the kernels of whole recordings: every pair of tracklets, every marker, one at a time."""

from __future__ import annotations

from itertools import product

import numpy as np
import twins_body


def score_frames(model, frames, tracks, label, settings):
    """Scores of all points of all frames (P, M), each frame's labelling's score (E,) and key pose (E,)."""
    markers, scores, totals, poses = len(model.mean[0]), [], [], []
    for points, track in zip(frames, tracks, strict=True):
        rows = np.full(markers, -1)
        for c, j in enumerate(track):
            if label[j] >= 0:
                rows[label[j]] = c
        if (rows >= 0).sum() < 3:
            scores.append(np.zeros((len(points), markers)))
            totals.append(np.nan)
            poses.append(0)
            continue
        crowd = np.log(1 + max(0, len(points) - markers))
        own = settings._replace(
            reward=settings.reward - crowd, outlier_score=settings.outlier_score - crowd, usual_score=settings.usual_score - crowd
        )
        none = np.zeros(markers, dtype=bool)
        k = int(np.argmax([twins_body.evidence(model, k, points, rows, none, own) for k in range(len(model.mean))]))
        found = twins_body.leave_one_out_scores(model, k, points, rows, none, own)
        outlier = np.array([rows[m] >= 0 and found[m, rows[m]] <= own.outlier_score for m in range(markers)])
        if outlier.any():
            found = twins_body.leave_one_out_scores(model, k, points, rows, outlier, own)
        scores.append(found.T)
        totals.append(twins_body.evidence(model, k, points, rows, outlier, own))
        poses.append(k)
    return np.concatenate(scores), np.array(totals), np.array(poses)


def prediction_residuals(model, frames, tracks, label, settings):
    """How far each labelled point lies from where all other labelled points of its frame predict its marker: (P, 3), NaN elsewhere."""
    markers, out = len(model.mean[0]), []
    for points, track in zip(frames, tracks, strict=True):
        residuals = np.full((len(points), 3), np.nan)
        rows = np.full(markers, -1)
        for c, j in enumerate(track):
            if label[j] >= 0:
                rows[label[j]] = c
        if (rows >= 0).sum() >= 4:
            own = twins_body.crowded(settings, len(points), markers)
            none = np.zeros(markers, dtype=bool)
            k = int(np.argmax([twins_body.evidence(model, k, points, rows, none, own) for k in range(len(model.mean))]))
            found = twins_body.leave_one_out_scores(model, k, points, rows, none, own)
            outlier = [rows[m] >= 0 and found[m, rows[m]] <= own.outlier_score for m in range(markers)]
            for m in np.nonzero(rows >= 0)[0]:
                others = [row if other != m else -1 for other, row in enumerate(rows)]
                aligned = twins_body.place_points(points, rows, model.mean[k], range(markers))
                said = [o for o in range(markers) if others[o] >= 0 and not outlier[o]]
                deviation = np.concatenate([np.empty(0), *(aligned[rows[o]] - model.mean[k, o] for o in said)])
                joint = twins_body.covariance(model, k)
                centre, _ = twins_body.conditional(joint, twins_body.coordinates([m]), twins_body.coordinates(said), deviation)
                residuals[rows[m]] = aligned[rows[m]] - model.mean[k, m] - centre
        out.append(residuals)
    return np.concatenate(out)


def residual_deviations(residuals, track, label, noise, least):
    """Standard deviations (J,) between each tracklet's mean residual and the middle of those of the other tracklets of its marker."""
    known, out = ~np.isnan(residuals[:, 0]), np.full(len(label), np.nan)
    for j, m in enumerate(label):
        own = residuals[known & (track == j)]
        others = residuals[known & (label[track] == m) & (track != j)]
        if m >= 0 and len(own) and len(others) >= max(least, len(own)):
            middle = np.median(others, axis=0)
            std = 1.4826 * np.median(np.abs(others - middle), axis=0)
            out[j] = np.sqrt((((own.mean(axis=0) - middle) / np.hypot(std, noise)) ** 2).mean())
    return out


def sum_scores(track, scores, least, most, tracklets):
    """Sums of each tracklet's clipped scores (J, M), and its points (J,)."""
    own = [np.clip(scores[track == j], least, most) for j in range(tracklets)]
    return np.array([part.sum(axis=0) for part in own]), np.array([len(part) for part in own])


def together(first, last, i, j):
    """Whether two tracklets share a frame."""
    return len(set(range(first[i], last[i] + 1)) & set(range(first[j], last[j] + 1))) > 0


def overlaps(gain, first, last):
    """Pairs of tracklets that are there at the same time and could both be one marker."""
    everyone = range(len(gain))
    return {
        frozenset((i, j))
        for i in everyone
        for j in everyone
        if i < j and together(first, last, i, j) and ((gain[i] > 0) & (gain[j] > 0)).any()
    }


def margins(gain, label, first, last):
    """How much each tracklet's label is worth over its best other one, and that one."""
    tracklets, markers = gain.shape
    margin, rival = np.empty(tracklets), np.full(tracklets, -1)
    for j in range(tracklets):
        beside = [i for i in range(tracklets) if i != j and together(first, last, i, j)]

        def instead(m, j=j, beside=beside):
            """The gain of being m; whoever is m loses its own, or takes the label that becomes free where that is worth something."""
            free = label[j]
            lost = [gain[i, m] - (max(0.0, gain[i, free]) if free >= 0 else 0.0) for i in beside if label[i] == m]
            return gain[j, m] - sum(lost)

        others = [m for m in range(markers) if m != label[j]]
        worth = [instead(m) for m in others]
        best = max(worth, default=-np.inf)
        if np.isfinite(best):
            rival[j] = others[int(np.argmax(worth))]
        if label[j] < 0:
            margin[j] = min(0.0, best)
            continue
        margin[j] = gain[j, label[j]] - max(0.0, best)
        for i in beside:
            if label[i] < 0:
                margin[j] = min(margin[j], max(0.0, gain[j, label[j]] - max(0.0, gain[i, label[j]])))
    return margin, rival


def rigid_deviations(xyz, frame, track, label, least_std, noise, rigid, least, partners, most):
    """Mean deviation (J,) of each labelled tracklet's near-rigid distances from those of the other tracklets of its marker."""
    frames, markers = int(frame.max()) + 1, len(least_std)
    at = {(t, label[j]): (place, j) for place, t, j in zip(xyz, frame, track, strict=True) if label[j] >= 0}
    out = np.zeros(len(label))
    for j, m in enumerate(label):
        shown = [t for t in range(frames) if m >= 0 and (t, m) in at]
        own = [t for t in shown if at[t, m][1] == j]
        others = [t for t in shown if at[t, m][1] != j]
        if not own or len(others) < max(least, len(own)):
            continue
        known_distances = []
        for o in range(markers):
            apart = [[np.linalg.norm(at[t, m][0] - at[t, o][0]) for t in some if o != m and (t, o) in at] for some in (own, others)]
            if not apart[0] or len(apart[1]) < least:
                continue
            middle = np.median(apart[1])
            std = 1.4826 * np.median(np.abs(apart[1] - middle))
            if std < rigid:
                spread = np.hypot(max(std, least_std[m, o]), noise)
                known_distances.append((spread, o, min(most, abs(np.median(apart[0]) - middle) / spread)))
        if len(known_distances) >= 2:
            out[j] = np.mean([deviation for _, _, deviation in sorted(known_distances)[:partners]])
    return out


def training_deviations(xyz, frame, track, label, frames, low, high, noise, size, rigid, least, partners, most):
    """Mean deviation (J,) of each labelled tracklet's near-rigid distances from the training's, for a person of the recording's size.

    And the median deviation of all of the recording's.
    """
    markers = len(low)
    at = {(t, label[j]): (place, j) for place, t, j in zip(xyz, frame, track, strict=True) if label[j] >= 0}

    def middle_and_std(m, o, only=None):
        apart = [
            np.linalg.norm(at[t, m][0] - at[t, o][0])
            for t in range(frames)
            if (t, m) in at and (t, o) in at and (only is None or at[t, m][1] == only)
        ]
        if len(apart) < least:
            return None
        return np.median(apart), 1.4826 * np.median(np.abs(apart - np.median(apart)))

    def excess(m, o, known):
        spread = np.sqrt(known[1] ** 2 + noise**2 + (size * known[0]) ** 2)
        return max(scale * low[m, o] - known[0], known[0] - scale * high[m, o], 0.0) / spread, spread

    ratios, all_known = [], {}
    for m in range(markers):
        for o in range(m):
            known = all_known[m, o] = middle_and_std(m, o)
            if known and high[m, o] - low[m, o] < rigid and known[1] < rigid and known[0] > 5 * rigid:
                ratios.append(2 * known[0] / (low[m, o] + high[m, o]))
    scale = np.median(ratios) if len(ratios) >= least else 1.0
    out = np.full(len(label), np.nan)
    for j, m in enumerate(label):
        known_distances = []
        for o in range(markers if m >= 0 else 0):
            known = middle_and_std(m, o, j if (track == j).sum() >= least else None) if o != m else None
            if known and known[1] < rigid:
                far, spread = excess(m, o, known)
                known_distances.append((spread, o, min(most, far)))
        if len(known_distances) >= 2:
            out[j] = np.mean([deviation for _, _, deviation in sorted(known_distances)[:partners]])
    usual = [excess(m, o, known)[0] for (m, o), known in all_known.items() if known and known[1] < rigid]
    return out, np.median(usual) if usual else 0.0


def best_total(gain, first, last):
    """The greatest total gain of all labellings that give no marker to two tracklets at once, by trying every labelling."""
    tracklets, markers = gain.shape

    def total(labels):
        for j, i in product(range(tracklets), range(tracklets)):
            if i < j and labels[i] == labels[j] >= 0 and together(first, last, i, j):
                return -np.inf
        return sum(gain[j, m] for j, m in enumerate(labels) if m >= 0)

    return max(total(labels) for labels in product(range(-1, markers), repeat=tracklets))


def rivals_weight(gain, first, last, samples, independent):
    """The largest share of a tracklet's frames that the shorter rivals for its best marker amount to."""
    most = 0.0
    for i in range(len(gain)):
        best = int(np.argmax(gain[i]))
        if gain[i, best] <= 0 or not samples[i]:
            continue
        rivals = [
            independent[j]
            for j in range(len(gain))
            if together(first, last, i, j) and gain[j, best] > 0 and last[j] - first[j] < last[i] - first[i]
        ]
        most = max(most, sum(rivals) / samples[i])
    return most


def best_pairs(scores):
    """Marker and margin by point: the best free pair again and again."""
    found, taken = {}, set()
    while True:
        free = [(m, c) for m, c in np.ndindex(*scores.shape) if m not in taken and c not in found and scores[m, c] > 0]
        if not free:
            return found
        m, c = max(free, key=lambda pair: scores[pair])
        others = [scores[o, p] for o, p in np.ndindex(*scores.shape) if (o == m) != (p == c) and o not in taken and p not in found]
        found[c] = (m, scores[m, c] - max([0.0, *others]))
        taken.add(m)


def label_short(model, frames, candidates, labels, place, spread, settings, limits):
    """Marker and margin (by frame and point) of candidates; frames left alone; and the counts of hits by the body and by motion."""
    markers = len(model.mean[0])
    given, alone, hits, near = [], [], np.zeros((markers, 4), dtype=int), np.zeros((markers, 4), dtype=int)
    for t, (points, candidate, label) in enumerate(zip(frames, candidates, labels, strict=True)):
        free = [m for m in range(markers) if m not in label]
        given.append({})
        alone.append(bool(candidate.any() and free and markers - len(free) < limits.min_labelled))
        if not candidate.any() or not free or alone[-1]:
            continue
        body = score_frames(model, [points], [np.arange(len(points))], label, settings)[0].T
        for m in range(markers):
            by_motion, side = spread[t, m] <= limits.motion_spread, 0 if m in free else 2
            if m not in free or not by_motion:
                best_free = np.maximum(body[free].max(axis=0), 0.0)[candidate]
                hits[m, side : side + 2] += [1, bool((body[m, candidate] > (0 if m in free else best_free)).any())]
            if m not in free or by_motion:
                centre = place[t, m] if m in free else points[list(label).index(m)]
                reach = 2.5 * (spread[t, m] if m in free else limits.motion_spread)
                near[m, side : side + 2] += [1, bool((np.linalg.norm(points[candidate] - centre, axis=1) <= reach).any())]
        scores = np.full(body.shape, -np.inf)
        for m in free:
            for c in np.nonzero(candidate)[0]:
                if body[m, c] >= limits.min_score:
                    far = np.linalg.norm(points[c] - place[t, m])
                    close = max(0.0, 3 * np.log(limits.usual_spread / spread[t, m])) if np.isfinite(spread[t, m]) else 0.0
                    scores[m, c] = min(body[m, c], limits.max_score) + close - 0.5 * (far / spread[t, m]) ** 2
        given[-1] = best_pairs(scores)
    return given, alone, hits, near


def best_split(scores):
    """By how much the best split of a tracklet's samples beats the best single marker."""
    options = [max(0.0, *scores[:s].sum(axis=0)) + max(0.0, *scores[s:].sum(axis=0)) for s in range(1, len(scores))]
    return max([0.0, *(option - max(0.0, *scores.sum(axis=0)) for option in options)])


def score_twins(model, frames, tracks, label, table, settings, gap, marker_gain):
    """Scores (W + 13, E) and rows (W + 13, E, M) of each twin of `table`, the body laid anew, and the labels; refined where near."""
    markers, count = len(model.mean[0]), len(table) + 12
    scores, rows = np.full((count + 1, len(frames)), np.nan), np.full((count + 1, len(frames), markers), -1)
    none = np.zeros(markers, dtype=bool)
    for t, (points, track) in enumerate(zip(frames, tracks, strict=True)):
        for c, j in enumerate(track):
            if label[j] >= 0:
                rows[count, t, label[j]] = c
        own = rows[count, t].tolist()
        if twins_body.count(own) < 3:
            rows[count, t] = -1
            continue
        rules = twins_body.crowded(settings, len(points), markers)
        pose = twins_body.best_pose(model, points, own, none, rules)
        scores[count, t] = top = twins_body.rescore(model, pose, points, own, none, rules)[0]
        lays = min(markers, len(points)) - twins_body.count(own) >= 2
        for w, trial in enumerate(map(list, twins_body.held_against(model, pose, points, own, table, lays))):
            rows[w, t] = trial
            if twins_body.count(trial) < 3 or trial == own:
                continue
            k = twins_body.best_pose(model, points, trial, none, rules)
            scores[w, t] = twins_body.evidence(model, k, points, trial, none, rules)
            if scores[w, t] + marker_gain * (min(markers, len(points)) - twins_body.count(trial)) < top - gap:
                continue
            refined, better = twins_body.refine(model, k, points, trial, rules, (), top - gap, marker_gain)
            if refined > -np.inf and list(map(int, better)) != own:
                scores[w, t], rows[w, t] = refined, better
    return scores, rows


def rows_of(label, track, markers):
    """The point of each marker of a frame (M,), -1 for none."""
    rows = np.full(markers, -1)
    for c, j in enumerate(track):
        if label[j] >= 0:
            rows[label[j]] = c
    return rows


def score_exchanges(model, frames, tracks, label, settings):
    """By how much the scores prefer the labels to each exchange, and how often both markers, and the first one, are seen: (M, M)."""
    markers = len(model.mean[0])
    apart, both, shown = (np.zeros((markers, markers)) for _ in range(3))
    none = np.zeros(markers, dtype=bool)
    for points, track in zip(frames, tracks, strict=True):
        rows, own = rows_of(label, track, markers), twins_body.crowded(settings, len(points), markers)
        if (rows >= 0).sum() < 3:
            continue
        k = twins_body.best_pose(model, points, rows, none, own)
        _, scores, _ = twins_body.rescore(model, k, points, rows, none, own)
        for a, b in product(np.nonzero(rows >= 0)[0], range(markers)):
            if a == b:
                continue
            shown[a, b] += 1
            both[a, b] += rows[b] >= 0
            with np.errstate(invalid="ignore"):
                apart[a, b] += scores[a, rows[a]] - scores[b, rows[a]]
                if rows[b] >= 0:
                    apart[a, b] += scores[b, rows[b]] - scores[a, rows[b]]
    return apart, both, shown
