"""Plain twins of the kernels: slow, obvious, and what the kernels must equal."""

from __future__ import annotations

from collections import Counter
from functools import cache
from itertools import permutations

import numpy as np

from asterism.labelling.features.registry import FEATURES


def feature(name, points):
    """Table 4.1 by its formulas, and the features of motion; points: a list of rows A, B, C, D, 3 numbers or with their motion 15."""
    a, b, c, d = (*(np.asarray(point)[:3] for point in points), None, None, None, None)[:4]
    up = np.array([0.0, 0.0, 1.0])

    def angle(u, v):
        return np.arccos(np.clip(u @ v / (np.linalg.norm(u) * np.linalg.norm(v)), -1, 1))

    match name:
        case "g1":
            return angle(b - a, c - a)
        case "g2":
            return np.linalg.norm(b - a)
        case "g3":
            one, two = np.linalg.norm(b - a), np.linalg.norm(d - c)
            return (one - two) / ((one + two) / 2)
        case "g4":
            return (a - b) @ up
        case "g5":
            return np.linalg.norm(b - a) / np.linalg.norm(c - a)
        case "g6":
            return angle(b - a, d - c)
        case "g7":
            return angle(b - a, up)
        case "g8":
            return np.linalg.norm(np.cross(b - a, c - a)) / 2
        case "g9":
            normal = np.cross(b - a, c - a)
            return normal @ up / np.linalg.norm(normal)
        case "g19":
            return np.cross(b - a, c - a) @ up
    frames = [[np.asarray(point)[at : at + 3] for point in points] for at in (0, 3, 6)]
    _, before, after = frames
    velocity, acceleration = (np.asarray(points[1])[at : at + 3] - np.asarray(points[0])[at : at + 3] for at in (9, 12))
    match name:
        case "g10":
            return np.linalg.norm(velocity)
        case "g11":
            return abs((b - a) @ velocity) / np.linalg.norm(b - a)
        case "g12":
            return velocity @ velocity + (b - a) @ acceleration
        case "g13":
            return np.mean([feature("g2", three) for three in frames])
        case "g14":
            return np.mean([feature("g4", three) for three in frames])
        case "g15":
            return np.ptp([feature("g2", three) for three in frames])
        case "g16":
            return np.ptp([feature("g4", three) for three in frames])
        case "g17":
            return (np.linalg.norm(after[1] - before[0]) + np.linalg.norm(before[1] - after[0])) / 2
        case "g18":
            return np.mean([feature("g19", three) for three in frames])


def motion(positions, rate):
    """Of one marker's positions (T, 3), gaps NaN: what each frame tells of its motion (T, 15), by fitting parabolas one by one."""
    away, reach = round(0.2 * rate), max(2, round(0.05 * rate))
    out = np.full((len(positions), 15), np.nan)
    for t, here in enumerate(positions):
        out[t, :3] = here
        window = range(t - away, t + away + 1)
        if window[0] >= 0 and window[-1] < len(positions) and not np.isnan(positions[window]).any():
            out[t, 3:6], out[t, 6:9] = positions[window[0]], positions[window[-1]]
        window = range(t - reach, t + reach + 1)
        if window[0] >= 0 and window[-1] < len(positions) and not np.isnan(positions[window]).any():
            seconds = (np.array(window) - t) / rate
            bend, slope, _ = np.polyfit(seconds, positions[window], 2)
            out[t, 9:12], out[t, 12:15] = slope, 2 * bend
    return out


def rejects(weak, row, points_of_slots):
    """Whether one weak classifier rejects, given the points of its slots (eq. 4.4)."""
    kind = FEATURES[weak.kinds[row]]
    value = feature(kind.name, points_of_slots[: kind.points])
    return value < weak.low[row] or value > weak.high[row]


def labellings(weak, markers, points):
    """All assignments of points to markers that no classifier rejects, by trying every one: a set of tuples of rows, in order of `markers`.

    weak.slots are places in `markers`. What a classifier says about the same points is asked once.
    """
    slots = [tuple(own[: FEATURES[kind].points].tolist()) for own, kind in zip(weak.slots, weak.kinds, strict=True)]

    @cache
    def rejected(f, rows):
        return rejects(weak, f, [points[row] for row in rows])

    return {
        rows
        for rows in permutations(range(len(points)), len(markers))
        if not any(rejected(f, tuple(rows[slot] for slot in slots[f])) for f in range(len(weak)))
    }


def matrix(proposals, n_markers):
    """The safe rules of section 4.5.4: of a dict marker -> set of candidates for each solver, the candidate of each marker or -1."""
    cells = Counter((marker, candidate) for proposal in proposals for marker, some in proposal.items() for candidate in some)
    out = []
    for marker in range(n_markers):
        column = [c for m, c in cells if m == marker]
        alone = len(column) == 1 and sum(c == column[0] for _, c in cells) == 1
        out.append(column[0] if alone else -1)
    return out
