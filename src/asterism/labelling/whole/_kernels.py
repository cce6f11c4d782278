"""Kernels for whole recordings: sampled frames, tracklets and their labels in; each tracklet's evidence, labels and margins out.

The plain twins are in `tests/twins_tracks.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.labelling.body._frame_kernels import frame_settings
from asterism.labelling.body._score_kernels import best_pose, rescore
from asterism.labelling.body._workspace_kernels import make_body_workspace


class FrameScores(NamedTuple):
    """What `score_frames` gives for P points and M markers in E frames.

    scores  (P, M) nats by which "this point is this marker" beats "the marker is hidden and this a ghost", -inf where far
    totals  (E,) nats, the score of each frame's labelling; NaN where fewer than three points are labelled (their scores are then 0)
    poses   (E,) key pose of each frame
    """

    scores: np.ndarray
    totals: np.ndarray
    poses: np.ndarray


@kernel
def points_of_markers(track, label, point_of):
    """The point of each marker in a frame. IN track (n,) tracklet of each point; label (J,) marker of each tracklet, -1 for none.

    OUT point_of (M,), -1 for none. Returns how many markers have a point. O(M + n).
    """
    point_of[:] = -1
    labelled = 0
    for c in range(len(track)):
        m = label[track[c]]
        if m >= 0:
            point_of[m] = c
            labelled += 1
    return labelled


@kernel
def score_frames(xyz, offsets, track, label, body, settings, out):
    """Score every point of every frame as every marker, given the labels of all other points of its frame.

    IN  xyz (P, 3) m, z up; offsets (E + 1,); track (P,) tracklet of each point; label (J,) marker of each tracklet, -1 for none;
        body BodyArrays; settings FrameSettings
    OUT out FrameScores
    O(P M + E (K M r^2 + r^3)); memory for one frame.
    """
    scores, totals, poses = out
    markers, latents = body.load.shape[1], body.load.shape[3]
    point_of = np.empty(markers, dtype=np.int64)
    workspace = make_body_workspace(0, markers, latents)
    for t in range(len(offsets) - 1):
        first, n = offsets[t], offsets[t + 1] - offsets[t]
        # Two points leave the body's turn open.
        if points_of_markers(track[first : first + n], label, point_of) < 3:
            scores[first : first + n] = 0.0
            totals[t], poses[t] = np.nan, 0
            continue
        # Frames often have as many points as the one before, and keep its memory.
        if n != len(workspace.aligned):
            workspace = make_body_workspace(n, markers, latents)
        points = xyz[first : first + n]
        # A crowded frame asks more of a label.
        own_settings = frame_settings(settings, n, markers)
        # Outliers are of one frame.
        workspace.outlier[:] = False
        k, _ = best_pose(body, points, point_of, own_settings, workspace)
        poses[t] = k
        totals[t] = rescore(body, k, points, point_of, own_settings, workspace)
        for c in range(n):
            for m in range(markers):
                scores[first + c, m] = workspace.scores[m, c]


@kernel
def sum_scores(track, scores, least, most, sums, counts):
    """Add up each tracklet's scores over its points, each clipped to `least` and `most`.

    IN  track (P,); scores (P, M) nats; least, most nats
    OUT sums (J, M) nats; counts (J,) points; both are added to. O(P M).
    """
    for p in range(len(track)):
        j = track[p]
        counts[j] += 1
        for m in range(scores.shape[1]):
            # Clipped, so that one frame neither makes nor spoils a tracklet.
            sums[j, m] += min(most, max(least, scores[p, m]))


@kernel
def best_split(scores):
    """By how much two markers, one before a sample and one from it on, explain a tracklet better than one: (nats, that sample).

    IN  scores (n, L) nats of a tracklet's samples, in the order of their frames. No marker at all scores 0. O(n L).
    """
    samples, markers = scores.shape
    total, before = np.zeros(markers), np.zeros(markers)
    one = 0.0
    for m in range(markers):
        for s in range(samples):
            total[m] += scores[s, m]
        # One marker throughout, or none, is what a split must beat.
        one = max(one, total[m])
    gain, at = 0.0, 0
    for s in range(1, samples):
        # Each side alone has its best marker, or none.
        head, tail = 0.0, 0.0
        for m in range(markers):
            before[m] += scores[s - 1, m]
            head, tail = max(head, before[m]), max(tail, total[m] - before[m])
        if head + tail - one > gain:
            gain, at = head + tail - one, s
    return gain, at


@kernel
def keep_lasting(there, count, last, frame):
    """Keep those of the first `count` tracklets in `there` that last until `frame`, in their order.

    IN/OUT there (J,); IN last (J,) frames. Returns how many are kept. O(count).

    Bounds: kept ones are written over those before.
    """
    kept = 0
    for s in range(count):
        # Tracklets come by their first frame, so that one that has ended is over for all that follow.
        if last[there[s]] >= frame:
            there[kept] = there[s]
            kept += 1
    return kept


@kernel
def overlaps(gain, first, last, order):
    """Pairs (n, 2) of tracklets that overlap in time and both gain by a common marker.

    IN  gain (J, L); first, last (J,); order (J,) tracklets by first frame. O(J (L + simultaneous tracklets * L / 32)).

    Bounds: each tracklet comes into `there` once: J. Pairs are made twice as long where they are full.
    """
    tracks, markers = gain.shape
    gains_by = np.zeros((tracks, (markers + 31) // 32), dtype=np.int64)  # a bit for each marker
    for j in range(tracks):
        for m in range(markers):
            if gain[j, m] > 0.0:
                # Bits, because whether two tracklets gain by a common marker is asked for every pair.
                gains_by[j, m // 32] |= 1 << (m % 32)
    pairs = np.empty((max(16, tracks), 2), dtype=np.int64)
    count = 0
    there = np.empty(tracks, dtype=np.int64)
    n_there = 0
    for o in range(tracks):
        j = order[o]
        # It gains by no marker, and is no one's rival.
        if not gains_by[j].any():
            continue
        n_there = keep_lasting(there, n_there, last, first[j])
        for s in range(n_there):
            i = there[s]
            for w in range(gains_by.shape[1]):
                if gains_by[j, w] & gains_by[i, w]:
                    # How many there are is not known before: twice as long where they are full.
                    if count == len(pairs):
                        grown = np.empty((2 * count, 2), dtype=np.int64)
                        for p in range(count):
                            grown[p, 0], grown[p, 1] = pairs[p, 0], pairs[p, 1]
                        pairs = grown
                    pairs[count, 0], pairs[count, 1] = i, j
                    count += 1
                    # One common marker is enough.
                    break
        there[n_there] = j
        n_there += 1
    return pairs[:count]


@kernel
def rivals_weight(gain, pairs, first, last, samples, independent):
    """How many independent frames the shorter rivals for a tracklet's best marker amount to, for each of its frames: the largest share.

    IN  gain (J, L); pairs (n, 2), see `overlaps`; first, last (J,) frames; samples (J,); independent (J,). Returns frames. O(n + J L).
    """
    tracks = len(gain)
    rivals = np.zeros(tracks)
    best = np.empty(tracks, dtype=np.int64)
    for j in range(tracks):
        best[j] = np.argmax(gain[j])
    for p in range(len(pairs)):
        i, j = pairs[p, 0], pairs[p, 1]
        # Only the shorter of two is a rival: a long one decides for itself.
        longer = (last[i] - first[i]) - (last[j] - first[j])
        if longer < 0:
            i, j = j, i
        if longer != 0 and gain[i, best[i]] > 0.0 and gain[j, best[i]] > 0.0:
            rivals[i] += independent[j]
    most = 0.0
    for j in range(tracks):
        if samples[j] > 0:
            most = max(most, rivals[j] / samples[j])
    return most


@kernel
def settle_dominant(gain, pairs, rounds):
    """Give every tracklet its best marker where that is worth more than all other uses of it; what conflicts with that loses its gain.

    If a tracklet gains by its best marker, beyond its second best, more than all tracklets that overlap it could gain by that marker
    together, it has that marker in every best labelling.
    IN     pairs (n, 2), see `overlaps`; rounds: how often to look at most
    IN/OUT gain (J, L): gains that no best labelling uses become 0. O(rounds (n + J) L).
    """
    tracks, markers = gain.shape
    claimed = np.empty((tracks, markers))
    settled = np.full(tracks, -1, dtype=np.int64)
    for _ in range(rounds):
        claimed[:] = 0.0
        for p in range(len(pairs)):
            i, j = pairs[p, 0], pairs[p, 1]
            for m in range(markers):
                if gain[i, m] > 0.0 and gain[j, m] > 0.0:
                    # All that overlapping tracklets could gain by a marker together bounds what taking it can cost.
                    claimed[i, m] += gain[j, m]
                    claimed[j, m] += gain[i, m]
        changed = False
        for j in range(tracks):
            if settled[j] >= 0:
                continue
            best = np.argmax(gain[j])
            second = 0.0
            for m in range(markers):
                if m != best:
                    second = max(second, gain[j, m])
            # Worth more than everything else the marker could do: every best labelling has it.
            if gain[j, best] - second > claimed[j, best]:
                settled[j] = best
                for m in range(markers):
                    if m != best:
                        # Its other gains are never used, and so stand in no one's way.
                        gain[j, m] = min(gain[j, m], 0.0)
                changed = True
        if not changed:
            return
        for p in range(len(pairs)):
            i, j = pairs[p, 0], pairs[p, 1]
            # Beside it no other tracklet can have its marker.
            if settled[i] >= 0 and settled[j] != settled[i]:
                gain[j, settled[i]] = min(gain[j, settled[i]], 0.0)
            if settled[j] >= 0 and settled[i] != settled[j]:
                gain[i, settled[j]] = min(gain[i, settled[j]], 0.0)


@kernel
def branch_and_bound(gain, first, last, steps, label):
    """The labels of the greatest total gain, each marker once at a time; depth first, a tracklet's markers from the best to none.

    IN  gain (J, L), only gains above 0 are taken; first, last (J,) frames; steps: the search gives up after so many
    OUT label (J,), -1 for none. Returns whether the search was completed. O(L^J) at worst.

    Bounds: a tracklet has L markers and none: L + 1. Depths are 0 to J.
    """
    tracks, markers = gain.shape
    ranked = np.empty((tracks, markers + 1), dtype=np.int64)
    options = np.empty(tracks, dtype=np.int64)
    rest = np.zeros(tracks + 1)
    for j in range(tracks - 1, -1, -1):
        options[j] = 0
        # Best markers first, so that good labellings come early and cut more.
        for m in np.argsort(-gain[j], kind="mergesort"):
            if gain[j, m] > 0.0:
                ranked[j, options[j]] = m
                options[j] += 1
        # What the tracklets from here on could gain at most, if none was in another's way.
        rest[j] = rest[j + 1] + (gain[j, ranked[j, 0]] if options[j] > 0 else 0.0)
        ranked[j, options[j]] = -1
        options[j] += 1
    tried = np.zeros(tracks + 1, dtype=np.int64)
    now = np.full(tracks, -1, dtype=np.int64)
    value = np.zeros(tracks + 1)
    best = -1.0
    j = 0
    for _ in range(steps):
        if j < 0:
            return True
        if j == tracks:
            # All tracklets are decided, and better than ever.
            if value[j] > best:
                best = value[j]
                for i in range(tracks):
                    label[i] = now[i]
            j -= 1
            continue
        # Nothing is left to try for it: back to the one before.
        if tried[j] == options[j]:
            tried[j] = 0
            j -= 1
            continue
        m = ranked[j, tried[j]]
        tried[j] += 1
        step = gain[j, m] if m >= 0 else 0.0
        # Markers come by falling gain, so that the later ones cannot win either.
        if value[j] + step + rest[j + 1] <= best:
            tried[j] = 0
            j -= 1
            continue
        held = False
        if m >= 0:
            # A marker is held by one tracklet at a time.
            for i in range(j):
                if now[i] == m and first[i] <= last[j] and last[i] >= first[j]:
                    held = True
                    break
        if not held:
            now[j] = m
            value[j + 1] = value[j] + step
            j += 1
    return j < 0


@kernel
def assign_roughly(gain, by_end, before, label):
    """Labels of a great total gain, each marker once at a time: one marker after the other takes the tracklets that it gains most by.

    That is exact for one marker, as tracklets that exclude each other are intervals: the best of the first i to end is that of one less, or
    this one with the best of those that end before it begins. A tracklet that has another marker counts with what it gains more. Repeated
    until nothing changes, in at most 30 rounds.
    IN  gain (J, L), only gains above 0 are taken; by_end (J,) tracklets by their last frame; before (J,) for each of these, how many end
        before it begins
    OUT label (J,), -1 for none. O(J L) in each round.

    Bounds: `before` of place i is i at most, so places fall.
    """
    tracks, markers = gain.shape
    best, takes = np.zeros(tracks + 1), np.zeros(tracks, dtype=np.bool_)
    label[:] = -1
    for _ in range(30):
        changed = False
        for m in range(markers):
            for i in range(tracks):
                j = by_end[i]
                # A tracklet that has a label counts with what it gains by changing it.
                more = gain[j, m]
                if label[j] >= 0 and label[j] != m:
                    more -= gain[j, label[j]]
                total = more + best[before[i]]
                # Taken where it is worth more than the best without it.
                takes[i] = more > 0.0 and total > best[i] + 1e-9
                best[i + 1] = total if takes[i] else best[i]
            i = tracks - 1
            # Back from the last: what was taken, and before it what ends before it begins.
            while i >= 0:
                j = by_end[i]
                if takes[i]:
                    changed |= label[j] != m
                    label[j] = m
                    # Those that overlap it lose the marker.
                    for k in range(before[i], i):
                        if label[by_end[k]] == m:
                            label[by_end[k]] = -1
                            changed = True
                    i = before[i] - 1
                else:
                    if label[j] == m:
                        label[j] = -1
                        changed = True
                    i -= 1
        if not changed:
            break


@kernel
def margins_of(gain, label, first, last, order):
    """By how much each tracklet's label beats the other labels that it, or the tracklets that overlap it in time, could have.

    For a labelled tracklet: against no label, every other marker (whose holder loses it, or swaps), and every unlabelled tracklet that
    could take its marker. For one without a label: its best gain less what the present holder would lose, negative.
    IN  gain (J, L) nats; label (J,); first, last (J,) frames; order (J,) tracklets by first frame
    Returns margin (J,) nats and rival (J,), the best other marker (for a null: the best marker), -1 for none.
    O(J * simultaneous tracklets * L).

    Bounds: each tracklet comes into `there` once: J.
    """
    tracks, markers = gain.shape
    margin, rival = np.empty(tracks), np.full(tracks, -1, dtype=np.int64)
    taken = np.zeros((tracks, markers))
    # what it costs to free each marker for a tracklet: what its holders at that time lose if they take the tracklet's label or none
    there = np.empty(tracks, dtype=np.int64)
    n_there = 0
    for o in range(tracks):
        j = order[o]
        n_there = keep_lasting(there, n_there, last, first[j])
        for s in range(n_there):
            i = there[s]
            if label[i] >= 0 and label[i] != label[j]:
                # The holder may take the label that becomes free, which makes the exchange cheaper.
                out = max(0.0, gain[i, label[j]]) if label[j] >= 0 else 0.0
                taken[j, label[i]] += gain[i, label[i]] - out
            if label[j] >= 0 and label[i] != label[j]:
                out = max(0.0, gain[j, label[i]]) if label[i] >= 0 else 0.0
                taken[i, label[j]] += gain[j, label[j]] - out
        there[n_there] = j
        n_there += 1
    for j in range(tracks):
        best = -np.inf
        for m in range(markers):
            # The best other marker, less what its holders would lose.
            if m != label[j] and gain[j, m] - taken[j, m] > best:
                best, rival[j] = gain[j, m] - taken[j, m], m
        margin[j] = gain[j, label[j]] - max(best, 0.0) if label[j] >= 0 else min(0.0, best)
    # a tracklet without a label that could have taken a labelled one's marker
    n_there = 0
    for o in range(tracks):
        j = order[o]
        n_there = keep_lasting(there, n_there, last, first[j])
        for s in range(n_there):
            i = there[s]
            # A ghost that could have the label leaves it less sure.
            if label[i] >= 0 and label[j] < 0:
                margin[i] = min(margin[i], max(0.0, gain[i, label[i]] - max(0.0, gain[j, label[i]])))
            if label[j] >= 0 and label[i] < 0:
                margin[j] = min(margin[j], max(0.0, gain[j, label[j]] - max(0.0, gain[i, label[j]])))
        there[n_there] = j
        n_there += 1
    return margin, rival
