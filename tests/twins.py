"""Plain twins of the kernels: slow, obvious, and what the kernels must equal."""

from __future__ import annotations

from collections import Counter
from itertools import permutations

import numpy as np

from asterism.labelling.features import FEATURES


def feature(name, points):
    """Table 4.1 by its formulas; points: a list of 3-vectors A, B, C, D."""
    a, b, c, d = (*points, None, None, None, None)[:4]
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
            return np.cross(b - a, c - a) @ up


def rejects(weak, row, points_of_slots):
    """Whether one weak classifier rejects, given the points of its slots (eq. 4.4)."""
    kind = FEATURES[weak.kinds[row]]
    value = feature(kind.name, points_of_slots[: kind.points])
    return value < weak.low[row] or value > weak.high[row]


def labellings(weak, markers, points):
    """All assignments of points to markers that no classifier rejects, by trying every one: a set of tuples of rows, in order of `markers`.

    weak.slots are places in `markers`.
    """
    return {
        rows
        for rows in permutations(range(len(points)), len(markers))
        if not any(rejects(weak, f, [points[rows[slot]] for slot in weak.slots[f]]) for f in range(len(weak)))
    }


def matrix(proposals, n_markers):
    """The safe rules of section 4.5.4: of a dict marker -> candidate for each solver, the candidate of each marker or -1."""
    cells = Counter((marker, candidate) for proposal in proposals for marker, candidate in proposal.items())
    out = []
    for marker in range(n_markers):
        column = [c for m, c in cells if m == marker]
        alone = len(column) == 1 and sum(c == column[0] for _, c in cells) == 1
        out.append(column[0] if alone else -1)
    return out
