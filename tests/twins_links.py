"""Plain twins of the linking kernels: the same rules, one point at a time, in the words of `linking.LinkRules`."""

from __future__ import annotations

from itertools import pairwise

import numpy as np


def norm(vector):
    return float(np.linalg.norm(vector))


def start_links(old, points, limits):
    """Links of two frames in which nothing has a velocity yet: {track: point}."""
    far = np.linalg.norm(old[:, None] - points[None], axis=2) if len(old) and len(points) else np.zeros((len(old), len(points)))
    clear = {}
    for a in range(len(old)):
        for b in range(len(points)):
            rival = limits.ratio_test * far[a, b] + limits.rival_gap
            rivals = np.concatenate([np.delete(far[a], b), np.delete(far[:, b], a)])
            if far[a, b] <= limits.max_step and (rivals > rival).all():
                clear[a] = b
    links = {}
    for a, b in clear.items():
        away = np.linalg.norm(old - old[a], axis=1)
        near = [k for k in np.argsort(away, kind="stable") if k != a][:3]
        moved = points[b] - old[a]
        alike = [
            k in clear
            and norm(points[clear[k]] - old[k] - moved) <= limits.noise + limits.neighbour_velocity_tol + limits.rotation_tol * away[k]
            for k in near
        ]
        if sum(alike) >= 2:
            links[a] = b
    return links


def expected(paths, spread, limits):
    """Where each track is expected and its gate, from its points so far."""
    out = []
    for a, path in enumerate(paths):
        x = np.array(path)
        if len(x) > 2:
            out.append(
                (
                    x[-1] + (x[-1] - x[-2]) + 0.5 * (x[-1] - 2 * x[-2] + x[-3]),
                    limits.noise + min(limits.usual_change + limits.residual_gain * spread[a], limits.max_change),
                )
            )
        elif len(x) == 2:
            out.append((2 * x[-1] - x[-2], limits.noise + 3 * limits.usual_change))
        else:
            known = [(norm(np.array(p[-1]) - x[-1]), k) for k, p in enumerate(paths) if len(p) > 1]
            near = sorted(known)[:3]
            if not near:
                out.append((x[-1], limits.max_step))
                continue
            weight = np.array([1 / (d * d + 1e-4) for d, _ in near])
            velocity = np.array([np.subtract(paths[k][-1], paths[k][-2]) for _, k in near])
            mean = weight @ velocity / weight.sum()
            unlike = max(norm(mean - v) for v in velocity)
            gate = limits.noise + limits.neighbour_velocity_tol + limits.rotation_tol * near[0][0] + limits.disagreement_gain * unlike
            out.append((x[-1] + mean, min(gate, limits.max_step)))
    return out


def link_forward(frames, limits):
    """For each frame, which point of the frame before each point continues, -1 for none."""
    paths, spread, links = [], [], []
    for points in frames:
        goes = {}
        if not any(len(path) > 1 for path in paths):
            goes = start_links(np.array([path[-1] for path in paths]).reshape(-1, 3), points, limits)
        places = expected(paths, spread, limits)
        reach = [
            gate if len(path) == 1 else limits.ratio_test * gate + limits.rival_gap for path, (_, gate) in zip(paths, places, strict=True)
        ]
        far = {
            (a, b): norm(points[b] - at) for a, (at, _) in enumerate(places) for b in range(len(points)) if norm(points[b] - at) <= reach[a]
        }
        while True:
            open_ = {(a, b): d for (a, b), d in far.items() if a not in goes and b not in goes.values()}
            news = {}
            for (a, b), d in open_.items():
                rival = limits.ratio_test * d + limits.rival_gap
                if len(paths[a]) == 1:
                    rival = max(rival, places[a][1])
                rivals = [e for (i, j), e in open_.items() if (i == a) != (j == b)]
                if d <= places[a][1] and all(e > rival for e in rivals):
                    news[a] = b
            if not news:
                break
            goes |= news
        back = {b: a for a, b in goes.items()}
        links.append([back.get(b, -1) for b in range(len(points))])
        new_paths, new_spread = [], []
        for b, point in enumerate(points):
            a = back.get(b, -1)
            path = [*paths[a], point] if a >= 0 else [point]
            new_paths.append(path)
            if len(path) > 3:
                new_spread.append(max(0.8 * spread[a], norm(point - places[a][0])))
            else:
                new_spread.append(norm(path[2] - 2 * path[1] + path[0]) if len(path) == 3 else 0.0)
        paths, spread = new_paths, new_spread
    return links


def prediction_error(before, a, b, after):
    """How far b is from going on smoothly from a: before (3,) or None the point before a, after that after b."""
    tries = []
    if before is not None:
        tries.append((b - a) - (a - before))
    if after is not None:
        tries.append((b - a) - (after - b))
    if before is not None and after is not None:
        tries.append((b - a) - 0.5 * (a - before + after - b))
    return min(tries, key=norm) if tries else None


def is_cut(positions, t, column, limits):
    """Whether a recording's column is cut between frames t - 1 and t: (T, M, 3), NaN where missing."""

    def at(frame, k):
        there = 0 <= frame < len(positions) and not np.isnan(positions[frame, k, 0])
        return positions[frame, k] if there else None

    def linked(k):
        return at(t - 1, k) is not None and at(t, k) is not None

    def miss(i, j):
        """Column i up to t - 1 goes on in column j."""
        before = at(t - 2, i)
        after = at(t + 1, j)
        return prediction_error(before, at(t - 1, i), at(t, j), after)

    def jerk():
        """The largest second difference of the column within three frames of the link."""
        most = 0.0
        for frames in (range(t - 2, t - 5, -1), range(t + 1, t + 4)):
            for frame in frames:
                if at(frame, column) is None:
                    break
                if at(frame - 1, column) is not None and at(frame + 1, column) is not None:
                    most = max(most, norm(at(frame + 1, column) - 2 * at(frame, column) + at(frame - 1, column)))
        return most

    own = miss(column, column)
    if own is None or norm(own) <= limits.no_cut_below:
        return False
    if norm(own) >= limits.jump and at(t - 2, column) is not None and at(t + 1, column) is not None:
        change = at(t + 1, column) - at(t, column) - at(t - 1, column) + at(t - 2, column)
        if norm(own) > 3 * norm(change) and norm(own) > 4 * jerk():
            return True
    for k in range(positions.shape[1]):
        if k == column:
            continue
        for pair in [(column, k)] * (at(t, k) is not None) + [(k, column)] * (at(t - 1, k) is not None):
            rival = miss(*pair)
            if rival is None or limits.ratio_test * norm(rival) >= norm(own):
                continue
            if not linked(k):
                if norm(own) > 3 * limits.no_cut_below:
                    return True
                continue
            theirs = miss(k, k)
            if limits.ratio_test * norm(rival) < norm(theirs) and theirs @ own < 0.5 * norm(theirs) * norm(own):
                return True
    return False


def strays(positions, farther, least):
    """Links between frames of (T, M, 3) positions, NaN where missing, and those that pass by a point `farther` times nearer."""
    links = wrong = 0
    for here, then in pairwise(positions):
        for a, b in zip(here, then, strict=True):
            if np.isnan(a[0]) or np.isnan(b[0]):
                continue
            links += 1
            length, nearest = norm(b - a), np.nanmin(np.linalg.norm(then - a, axis=1))
            wrong += length > least and farther * nearest < length
    return links, wrong


def combine_directions(forward, backward):
    """The links (p, q) of both directions that count, from forward (P,) previous points and backward (P,) next points."""
    ahead = {(int(p), q) for q, p in enumerate(forward) if p >= 0}
    back = {(p, int(q)) for p, q in enumerate(backward) if q >= 0}

    def age(point, links):
        """How many points of a chain there are up to this one, against the direction in which it was linked."""
        before = [p for p, q in links if q == point]
        return 1 + (age(before[0], links) if before else 0)

    def unknown(p, q, other):
        return not any(p == one or q == two for one, two in other)

    reverse = {(q, p) for p, q in back}
    links = ahead & back
    links |= {(p, q) for p, q in ahead - back if unknown(p, q, back) and age(q, reverse) < 3}
    links |= {(p, q) for p, q in back - ahead if unknown(p, q, ahead) and age(p, ahead) < 3}
    return links


def repair_links(xyz, frame, previous, following, forbidden, limits):
    """The links after ends and beginnings were joined: previous, following (P,)."""
    previous, following = list(previous), list(following)

    def place(p):
        return xyz[p] if p >= 0 else None

    def error(a, b):
        found = prediction_error(place(previous[a]), xyz[a], xyz[b], place(following[b]))
        return np.inf if found is None else norm(found)

    def jerk(a, b):
        most = 0.0
        for p, links in ((a, previous), (b, following)):
            for _ in range(3):
                p = links[p]
                if p < 0:
                    break
                if previous[p] >= 0 and following[p] >= 0:
                    most = max(most, norm(xyz[following[p]] - 2 * xyz[p] + xyz[previous[p]]))
        return most

    for t in range(1, int(max(frame, default=0)) + 1):
        ends = [p for p in range(len(xyz)) if frame[p] == t - 1 and following[p] < 0]
        starts = [p for p in range(len(xyz)) if frame[p] == t and previous[p] < 0]
        errors = {(a, b): error(a, b) for a in ends for b in starts}
        for a in ends if starts else []:
            b = min(starts, key=lambda start: errors[a, start])
            gate = min(limits.noise + limits.usual_change + limits.residual_gain * jerk(a, b), limits.noise + limits.max_change)
            least = limits.ratio_test * errors[a, b] + limits.rival_gap
            rivals = [errors[a, other] for other in starts if other != b] + [errors[other, b] for other in ends if other != a]
            both_known = previous[a] >= 0 and following[b] >= 0
            if both_known and forbidden[b] != a and errors[a, b] <= gate and all(rival > least for rival in rivals):
                following[a], previous[b] = b, a
    return previous, following
