"""Plain twins of the audit's kernels: every sequence of states is tried, every exchange scored in full."""

from __future__ import annotations

from itertools import product

import numpy as np


def step_log_density(before, at, after, early, late, scale):
    """A Student t density with 3 degrees of freedom, about where an even motion would lead; its width grows as an acceleration's miss."""
    expected = at + (at - before) * (late / early)
    usual = scale * (late * (late + early) / 2.0)
    return -3.0 * np.log(1.0 + np.sum((after - expected) ** 2) / (3.0 * usual**2))


def path_score(paths, times, scales, emission, switch, states):
    """Sum over frames of the emission, minus the switches, plus the steps of both paths."""
    mended = np.array([pair[::-1] if state else pair for pair, state in zip(paths, states, strict=True)])
    score = float(np.dot(states, emission)) - switch * np.count_nonzero(np.diff(states))
    for i in range(2, len(times)):
        early, late = times[i - 1] - times[i - 2], times[i] - times[i - 1]
        score += sum(step_log_density(*mended[i - 2 : i + 1, who], early, late, scales[who]) for who in range(2))
    return score


def exchange_path(paths, times, scales, emission, switch):
    """The best of all 2^n sequences of states, and by how much it beats never."""
    best = max(product((0, 1), repeat=len(times)), key=lambda states: path_score(paths, times, scales, emission, switch, states))
    never = path_score(paths, times, scales, emission, switch, (0,) * len(times))
    return np.array(best), path_score(paths, times, scales, emission, switch, best) - never


def all_exchanges(positions, scales, emission, switch, pairs):
    """The gain of each pair over the frames that show both, at the larger of their scales; 0 with fewer than three such frames."""
    gains = []
    for p, (a, b) in enumerate(pairs):
        (shown,) = np.nonzero(~np.isnan(positions[:, [a, b]]).any(axis=(1, 2)))
        both = np.full(2, max(scales[a], scales[b]))
        paths, times = positions[shown][:, [a, b]], shown.astype(np.float64)
        gains.append(exchange_path(paths, times, both, emission[p, shown], switch)[1] if len(shown) >= 3 else 0.0)
    return np.array(gains)


def exchange_gains(frames, explain, pairs, most):
    """The difference of two whole labellings; `explain` gives the nats of points (n, 3) with their markers' rows, in the best pose."""
    gains = np.zeros((len(pairs), len(frames)))
    for t, frame in enumerate(frames):
        shown = ~np.isnan(frame[:, 0])
        points, rows = np.ascontiguousarray(frame[shown]), np.where(shown, np.cumsum(shown) - 1, -1)
        of = explain(points, rows)
        for p, (a, b) in enumerate(pairs):
            if shown[[a, b]].all():
                other = rows.copy()
                other[[a, b]] = rows[[b, a]]
                gains[p, t] = np.clip(of(other) - of(rows), -most, most)
    return gains
