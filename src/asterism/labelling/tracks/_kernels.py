"""Kernels of the whole-recording look: the frames looked at, the tracklets and their labels in; each tracklet's evidence out."""

from __future__ import annotations

import numpy as np
from numba import njit

from asterism.labelling.body._kernels import LookSettings, best_pose, look_again, make_room


@njit(cache=True, nogil=True)
def frame_settings(settings, points, markers):
    """The settings for a frame of so many points: the more points there are than markers, the likelier a ghost lies anywhere."""
    crowd = np.log(1.0 + max(0, points - markers))
    return LookSettings(
        settings.reward - crowd,
        settings.first_ghost,
        settings.odd - crowd,
        settings.odd_radius,
        settings.far,
        settings.agree,
        settings.ask,
        settings.budget,
        settings.per_anchor,
        settings.least_found,
        settings.clear,
        settings.contest,
        settings.good - crowd,
        settings.enough,
    )


@njit(cache=True, nogil=True)
def score_frames(xyz, offsets, track, label, body, settings, out, totals, poses):
    """Score every point of every frame as every marker, given the labels of all other points of its frame.

    IN  xyz (P, 3) m, z up; offsets (E + 1,); track (P,) tracklet of each point; label (J,) marker of each tracklet, -1 for none
    OUT out (P, M) nats by which "this point is this marker" beats "the marker is hidden and this a ghost", -inf where far;
        totals (E,) score of the frame's labelling, NaN where fewer than three points are labelled (then out is 0)
        poses (E,) its key pose
    O(P M + E (K M r^2 + r^3)); memory for one frame.
    """
    markers, latents = body.load.shape[1], body.load.shape[3]
    rows = np.empty(markers, dtype=np.int64)
    room = make_room(0, markers, latents)
    for t in range(len(offsets) - 1):
        first, n = offsets[t], offsets[t + 1] - offsets[t]
        rows[:] = -1
        labelled = 0
        for c in range(n):
            m = label[track[first + c]]
            if m >= 0:
                rows[m] = c
                labelled += 1
        if labelled < 3:
            out[first : first + n] = 0.0
            totals[t], poses[t] = np.nan, 0
            continue
        if n != len(room.aligned):
            room = make_room(n, markers, latents)
        points = xyz[first : first + n]
        own = frame_settings(settings, n, markers)
        room.odd[:] = False
        k, _ = best_pose(body, points, rows, own, room)
        poses[t] = k
        totals[t] = look_again(body, k, points, rows, own, room)
        for c in range(n):
            for m in range(markers):
                out[first + c, m] = room.scores[m, c]


@njit(cache=True, nogil=True)
def gather(track, scores, least, most, sums, counts):
    """Add up each tracklet's scores over the frames looked at, each held between `least` and `most`.

    IN  track (P,); scores (P, M) nats; least, most nats
    OUT sums (J, M) nats; counts (J,) points
    """
    for p in range(len(track)):
        j = track[p]
        counts[j] += 1
        for m in range(scores.shape[1]):
            sums[j, m] += min(most, max(least, scores[p, m]))
