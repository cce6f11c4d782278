"""Kernels of the checks by distances: labelled tracklets of one body in; how far off each one's near-rigid distances are, out."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel


@kernel
def misfits(xyz, frame, track, label, frames, markers, noise, rigid, least, partners, most, out):
    """Compare each tracklet's distances to other markers with those that the other tracklets of its marker have to them.

    Medians all over, so that a wrong tracklet among them does not spoil it. A tracklet is compared only with others that were looked at
    at least as often as itself, and by its `partners` steadiest distances, at least two.
    IN  xyz (Q, 3) m; frame, track (Q,); label (J,), -1 for none; frames E; markers M; noise, rigid (m): least and greatest spread of a
        near-rigid distance; least: frames that a distance must be known from; partners; most: standard deviations that one counts at most
    OUT out (J,) mean deviation in standard deviations, 0 where it cannot be told. O(J M E log E); memory O(E M).
    """
    row = np.full((frames, markers), -1, dtype=np.int64)
    for q in range(len(track)):
        if label[track[q]] >= 0:
            row[frame[q], label[track[q]]] = q
    ours, theirs = np.empty(frames), np.empty(frames)
    spread, deviation = np.empty(markers), np.empty(markers)
    for j in range(len(label)):
        out[j] = 0.0
        m = label[j]
        if m < 0:
            continue
        own, other = 0, 0
        for t in range(frames):
            if row[t, m] >= 0:
                if track[row[t, m]] == j:
                    own += 1
                else:
                    other += 1
        if own == 0 or other < max(least, own):
            continue
        found = 0
        for o in range(markers):
            if o == m:
                continue
            mine, known = 0, 0
            for t in range(frames):
                p, q = row[t, m], row[t, o]
                if p < 0 or q < 0:
                    continue
                d = np.sqrt((xyz[p, 0] - xyz[q, 0]) ** 2 + (xyz[p, 1] - xyz[q, 1]) ** 2 + (xyz[p, 2] - xyz[q, 2]) ** 2)
                if track[p] == j:
                    ours[mine] = d
                    mine += 1
                else:
                    theirs[known] = d
                    known += 1
            if mine == 0 or known < least:
                continue
            middle, std = _middle_and_std(theirs, known)
            if std < rigid:
                spread[found] = np.sqrt(std * std + noise * noise)
                deviation[found] = min(most, abs(np.median(ours[:mine]) - middle) / spread[found])
                found += 1
        if found < 2:
            continue
        steadiest = np.argsort(spread[:found], kind="mergesort")[:partners]
        out[j] = deviation[steadiest].mean()


@kernel
def foreign_distances(xyz, frame, track, label, frames, low, high, noise, size, rigid, least, partners, most, out):
    """Compare each tracklet's distances to other labelled markers with what they were in the training.

    Which distances are near-rigid the tracklet's own frames say, or all frames of its marker where it has fewer than `least`; how large the
    person is, the median over all near-rigid distances of the recording.
    IN  xyz (Q, 3) m; frame, track (Q,); label (J,), -1 for none; frames E; low, high (M, M) m, the range of each distance in the training;
        noise (m), size (share of the distance): standard deviations that distances differ by between people; rigid (m): greatest spread of
        a near-rigid distance; least: frames that a distance must be known from; partners: the steadiest that count, at least two;
        most: standard deviations that one counts at most
    OUT out (J,) mean deviation in standard deviations, NaN where it cannot be told
    Gives the median deviation of all near-rigid distances of the recording: how much this body differs from those of the training as a
    whole. O(E M2 log E + J E M) and memory O(E M).
    """
    markers = len(low)
    row = np.full((frames, markers), -1, dtype=np.int64)
    for q in range(len(track)):
        if label[track[q]] >= 0:
            row[frame[q], label[track[q]]] = q
    apart = np.empty(frames)
    middles, stds = np.full((markers, markers), np.nan), np.full((markers, markers), np.inf)
    ratios, pairs = np.empty(markers * markers), 0
    for m in range(markers):
        for o in range(m):
            known = _distances(xyz, row, track, m, o, -1, apart)
            if known < least:
                continue
            middle, std = _middle_and_std(apart, known)
            middles[m, o], stds[m, o] = middle, std
            if std < rigid and high[m, o] - low[m, o] < rigid and middle > 5.0 * rigid:
                ratios[pairs] = 2.0 * middle / (low[m, o] + high[m, o])
                pairs += 1
    scale = np.median(ratios[:pairs]) if pairs >= least else 1.0
    usual, pairs = ratios, 0
    for m in range(markers):
        for o in range(m):
            if stds[m, o] < rigid:
                usual[pairs] = _excess(middles[m, o], stds[m, o], scale * low[m, o], scale * high[m, o], noise, size)[0]
                pairs += 1
    looks = np.zeros(len(label), dtype=np.int64)
    for q in range(len(track)):
        looks[track[q]] += 1
    spread, deviation = np.empty(markers), np.empty(markers)
    for j in range(len(label)):
        out[j] = np.nan
        m = label[j]
        if m < 0:
            continue
        found = 0
        for o in range(markers):
            if o == m:
                continue
            known = _distances(xyz, row, track, m, o, j if looks[j] >= least else -1, apart)
            if known < least:
                continue
            middle, std = _middle_and_std(apart, known)
            if std < rigid:
                far, spread[found] = _excess(middle, std, scale * low[m, o], scale * high[m, o], noise, size)
                deviation[found] = min(most, far)
                found += 1
        if found >= 2:
            out[j] = deviation[np.argsort(spread[:found], kind="mergesort")[:partners]].mean()
    return np.median(usual[:pairs]) if pairs > 0 else 0.0


@kernel
def _excess(middle, std, low, high, noise, size):
    """How far a distance is outside its range, in standard deviations, and one of those in metres."""
    spread = np.sqrt(std * std + noise * noise + (size * middle) ** 2)
    return max(low - middle, middle - high, 0.0) / spread, spread


@kernel
def _distances(xyz, row, track, m, o, only, out):
    """Distances of markers m and o in the frames that show both, where `only` is not -1 those in which that tracklet is m; how many."""
    known = 0
    for t in range(len(row)):
        p, q = row[t, m], row[t, o]
        if p >= 0 and q >= 0 and (only < 0 or track[p] == only):
            out[known] = np.sqrt((xyz[p, 0] - xyz[q, 0]) ** 2 + (xyz[p, 1] - xyz[q, 1]) ** 2 + (xyz[p, 2] - xyz[q, 2]) ** 2)
            known += 1
    return known


@kernel
def _middle_and_std(values, n):
    """The median of the first n values, and the standard deviation that their median distance from it amounts to."""
    middle = np.median(values[:n])
    return middle, 1.4826 * np.median(np.abs(values[:n] - middle))
