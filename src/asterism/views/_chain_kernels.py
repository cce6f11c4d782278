"""Placed markers of each frame in; which of them are one point over time, and how far their labels agree, out. Twins:
tests/twins_views.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel


@kernel
def link_chains(xyz, offsets, fastest, near, previous, following):
    """Link the points of each frame to those of the next one that are the same beyond doubt.

    IN  xyz (P, 3) m; offsets (T + 1,): frame t has xyz[offsets[t]:offsets[t + 1]]; fastest m: how far a point moves in a frame at most;
        near m: how far it is beside its way
    OUT previous, following (P,): rows, -1 for none. No other point of either frame is within three times of how far the point goes
    O(P N) for N points of a frame, no allocation.
    """
    previous[:] = -1
    following[:] = -1
    for t in range(len(offsets) - 2):
        for p in range(offsets[t], offsets[t + 1]):
            best, second, chosen = np.inf, np.inf, -1
            for q in range(offsets[t + 1], offsets[t + 2]):
                square = (xyz[q, 0] - xyz[p, 0]) ** 2 + (xyz[q, 1] - xyz[p, 1]) ** 2 + (xyz[q, 2] - xyz[p, 2]) ** 2
                if square < best:
                    best, second, chosen = square, best, q
                elif square < second:
                    second = square
            if chosen < 0 or best > fastest * fastest:
                continue
            for r in range(offsets[t], offsets[t + 1]):
                if r != p:
                    square = (xyz[chosen, 0] - xyz[r, 0]) ** 2 + (xyz[chosen, 1] - xyz[r, 1]) ** 2 + (xyz[chosen, 2] - xyz[r, 2]) ** 2
                    second = min(second, square)
            # Where all other points are as far away, at most one point of a frame can have this one as its next.
            if math.sqrt(second) >= 3.0 * (0.5 * math.sqrt(best) + near):
                following[p], previous[chosen] = chosen, p


@kernel
def label_odds(previous, following, frame, labels, weights, window, total, out):
    """By how much the label of a point is the one that its chain has within `window` frames.

    IN  previous, following (P,) rows, -1 for none; frame (P,); labels (P,) in 0 to M - 1; weights (P,) nats for each label
    WORK total (M,), zero before and after
    OUT out (P,) nats: of its label's weights together, less the most that its chain has of another label
    O(P window), no allocation.
    """
    for p in range(len(labels)):
        first = p
        while previous[first] >= 0 and frame[p] - frame[previous[first]] <= window:
            first = previous[first]
        q = first
        while q >= 0 and frame[q] - frame[p] <= window:
            total[labels[q]] += weights[q]
            q = following[q]
        own, most, q = total[labels[p]], 0.0, first
        # Each sum is taken out as it is read, so that the work array is clean for the next point.
        while q >= 0 and frame[q] - frame[p] <= window:
            if labels[q] != labels[p]:
                most = max(most, total[labels[q]])
            total[labels[q]] = 0.0
            q = following[q]
        out[p] = own - most
