"""Kernel of the check by distances: labelled tracklets of one body in; how far each is from where its near-rigid partners have it, out."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
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
            middle = np.median(theirs[:known])
            std = 1.4826 * np.median(np.abs(theirs[:known] - middle))
            if std < rigid:
                spread[found] = np.sqrt(std * std + noise * noise)
                deviation[found] = min(most, abs(np.median(ours[:mine]) - middle) / spread[found])
                found += 1
        if found < 2:
            continue
        steadiest = np.argsort(spread[:found], kind="mergesort")[:partners]
        out[j] = deviation[steadiest].mean()
