"""Distance kernels: labelled tracklets of one body in; how far each one's near-rigid distances deviate from what they should be out.

The plain twins are in `tests/twins_tracks.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from asterism._jit import kernel

LEAST_DISTANCE = 1e-6
"""m; what is nearer counts as so far apart. A hundredth of what the finest systems resolve, so that half or double of it changes no label.
Points in one place, as of zeros that stand for missing samples, have no log of their distance."""


class TrackedPoints(NamedTuple):
    """The points of the sampled frames of a recording, Q of them.

    xyz     (Q, 3) m
    frame   (Q,) each point's sampled frame
    track   (Q,) each point's tracklet
    frames  number of sampled frames
    """

    xyz: np.ndarray
    frame: np.ndarray
    track: np.ndarray
    frames: int


class DistanceLimits(NamedTuple):
    """Which distances count, and how much.

    noise          m, standard deviation of a distance beyond what was measured
    size_std       the same as a share of the distance, for bodies of other sizes
    max_std        m; a distance is near-rigid if it varies by less
    min_frames     frames that a distance must be known from
    max_partners   how many of the steadiest distances count; at least two must be known
    max_deviation  standard deviations that one distance counts at most
    """

    noise: float
    size_std: float
    max_std: float
    min_frames: int
    max_partners: int
    max_deviation: float


@kernel
def rigid_deviations(points, label, least_std, limits, out):
    """Compare each tracklet's distances to other markers with those that the other tracklets of its marker have to them.

    All statistics are medians, so that one wrong tracklet does not spoil them. A tracklet is compared only where the others of its marker
    have at least as many points as itself. A distance that was seen in few poses looks steadier than it is: hence `least_std`.
    IN  points TrackedPoints; label (J,) marker of each tracklet, -1 for none; least_std (M, M) m, what the standard deviation of a distance
        is at least; limits DistanceLimits (size_std is not used)
    OUT out (J,) mean deviation in standard deviations, 0 where it cannot be told. O(J M E log E); memory O(E M).

    Bounds: a distance for each frame: E; a partner for each other marker: M.
    """
    xyz, track, frames, markers = points.xyz, points.track, points.frames, len(least_std)
    point_of = _points_of_markers(points, label, markers)
    inside, outside = np.empty(frames), np.empty(frames)
    spread, deviation = np.empty(markers), np.empty(markers)
    for j in range(len(label)):
        out[j] = 0.0
        m = label[j]
        if m < 0:
            continue
        own, other = 0, 0
        for t in range(frames):
            if point_of[t, m] >= 0:
                if track[point_of[t, m]] == j:
                    own += 1
                else:
                    other += 1
        # Fewer others than its own points cannot judge it: they may be the wrong ones.
        if own == 0 or other < max(limits.min_frames, own):
            continue
        found = 0
        for o in range(markers):
            if o == m:
                continue
            n_inside, n_outside = 0, 0
            for t in range(frames):
                p, q = point_of[t, m], point_of[t, o]
                if p < 0 or q < 0:
                    continue
                d = np.sqrt((xyz[p, 0] - xyz[q, 0]) ** 2 + (xyz[p, 1] - xyz[q, 1]) ** 2 + (xyz[p, 2] - xyz[q, 2]) ** 2)
                # Its own distances on one side, those of the other tracklets of its marker on the other.
                if track[p] == j:
                    inside[n_inside] = d
                    n_inside += 1
                else:
                    outside[n_outside] = d
                    n_outside += 1
            if n_inside == 0 or n_outside < limits.min_frames:
                continue
            median, std = _median_and_std(outside, n_outside)
            # A distance that varies tells nothing of who is who.
            if std < limits.max_std:
                std = max(std, least_std[m, o])
                # Never steadier than the training saw it, and never than it can be measured.
                spread[found] = np.sqrt(std * std + limits.noise * limits.noise)
                deviation[found] = min(limits.max_deviation, abs(np.median(inside[:n_inside]) - median) / spread[found])
                found += 1
        # One distance alone may be wrong at its other end.
        if found < 2:
            continue
        # The steadiest distances tell most; many loose ones would only dilute them.
        steadiest = np.argsort(spread[:found], kind="mergesort")[: limits.max_partners]
        out[j] = deviation[steadiest].mean()


@kernel
def training_deviations(points, label, low, high, limits, out):
    """Compare each tracklet's distances to other labelled markers with what they were in the training.

    Which distances are near-rigid is taken from the tracklet's own frames, or from all frames of its marker where it has fewer than
    `min_frames`. The size of the person is the median ratio over all near-rigid distances of the recording.
    IN  points TrackedPoints; label (J,), -1 for none; low, high (M, M) m, the range of each distance in the training; limits DistanceLimits
    OUT out (J,) mean deviation in standard deviations, NaN where it cannot be told
    Returns the median deviation of all near-rigid distances of the recording: how much this body differs from those of the training as a
    whole. O(E M2 log E + Q M) and memory O(E M).

    Bounds: a pair of markers is looked at once: M (M - 1) / 2 of M^2; a distance for each frame: E.
    """
    markers = len(low)
    point_of = _points_of_markers(points, label, markers)
    values = np.empty(points.frames)
    medians, stds = np.full((markers, markers), np.nan), np.full((markers, markers), np.inf)
    ratios, pairs = np.empty(markers * markers), 0
    for m in range(markers):
        for o in range(m):
            known = _distances(points, point_of, m, o, -1, 0, points.frames, values)
            if known < limits.min_frames:
                continue
            median, std = _median_and_std(values, known)
            medians[m, o], stds[m, o] = median, std
            medians[o, m], stds[o, m] = median, std
            # Long, near-rigid distances tell a person's size; short ones are mostly noise.
            if std < limits.max_std and high[m, o] - low[m, o] < limits.max_std and median > 5.0 * limits.max_std:
                ratios[pairs] = 2.0 * median / (low[m, o] + high[m, o])
                pairs += 1
    # The size as a median, which single wrong labels do not move.
    scale = np.median(ratios[:pairs]) if pairs >= limits.min_frames else 1.0
    # The ratios are done with, and their memory is as long.
    all_deviations, pairs = ratios, 0
    for m in range(markers):
        for o in range(m):
            if stds[m, o] < limits.max_std:
                all_deviations[pairs] = _excess(medians[m, o], stds[m, o], scale * low[m, o], scale * high[m, o], limits)[0]
                pairs += 1
    counts = np.zeros(len(label), dtype=np.int64)
    begins, ends = np.full(len(label), points.frames), np.zeros(len(label), dtype=np.int64)
    for q in range(len(points.track)):
        j, t = points.track[q], points.frame[q]
        counts[j] += 1
        begins[j], ends[j] = min(begins[j], t), max(ends[j], t + 1)
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
            # Where its own frames are too few, those of its marker say whether the distance is near-rigid.
            median, std = medians[m, o], stds[m, o]
            if counts[j] >= limits.min_frames:
                known = _distances(points, point_of, m, o, j, begins[j], ends[j], values)
                if known < limits.min_frames:
                    continue
                median, std = _median_and_std(values, known)
            if std < limits.max_std:
                excess, spread[found] = _excess(median, std, scale * low[m, o], scale * high[m, o], limits)
                deviation[found] = min(limits.max_deviation, excess)
                found += 1
        if found >= 2:
            out[j] = deviation[np.argsort(spread[:found], kind="mergesort")[: limits.max_partners]].mean()
    return np.median(all_deviations[:pairs]) if pairs > 0 else 0.0


@kernel
def _points_of_markers(points, label, markers):
    """The point of each marker in each sampled frame: (E, M), -1 for none. O(Q + E M)."""
    point_of = np.full((points.frames, markers), -1, dtype=np.int64)
    for q in range(len(points.track)):
        # A table once, instead of a search for each pair and frame.
        if label[points.track[q]] >= 0:
            point_of[points.frame[q], label[points.track[q]]] = q
    return point_of


@kernel
def _excess(median, std, low, high, limits):
    """By how many standard deviations a distance is outside its range; and the standard deviation, m. O(1)."""
    spread = np.sqrt(std * std + limits.noise * limits.noise + (limits.size_std * median) ** 2)
    return max(low - median, median - high, 0.0) / spread, spread


@kernel
def _distances(points, point_of, m, o, only, begin, end, out):
    """Distances of markers m and o in the frames that show both; where `only` is not -1, those in which m belongs to that tracklet.

    IN begin, end: the frames to look at. OUT out (E,) m. Returns how many. O(end - begin).

    Bounds: a distance for each frame, of which there are E.
    """
    xyz, known = points.xyz, 0
    for t in range(begin, end):
        p, q = point_of[t, m], point_of[t, o]
        if p >= 0 and q >= 0 and (only < 0 or points.track[p] == only):
            out[known] = np.sqrt((xyz[p, 0] - xyz[q, 0]) ** 2 + (xyz[p, 1] - xyz[q, 1]) ** 2 + (xyz[p, 2] - xyz[q, 2]) ** 2)
            known += 1
    return known


@kernel
def _median_and_std(values, n):
    """The median of the first n values, and the standard deviation that follows from their median distance to it. O(n)."""
    median = np.median(values[:n])
    # By the median distance, which a few wrong frames do not move; 1.4826 makes it that of a normal distribution.
    return median, 1.4826 * np.median(np.abs(values[:n] - median))


@kernel
def frame_scatters(distance, log_reference, softness, min_pairs, out):
    """How far the distances of each frame are off the reference that is the nearest to them, sizes of bodies set aside.

    Robust standard deviation of the log ratios about their median. A distance d counts for 1 / sqrt(1 + (softness / d)^2).
    IN  distance (T, N) m, NaN where not known; log_reference (R, N) logs of the references' distances, NaN where not known
    OUT out (T,) NaN where fewer than `min_pairs` distances can be compared
    O(T R N log N). Twin: `RigidDistances.nearest`, frame by frame.

    Bounds: a ratio for each pair: N.
    """
    frames, pairs = distance.shape
    ratio, weight = np.empty(pairs), np.empty(pairs)
    for t in range(frames):
        out[t] = np.nan
        for r in range(len(log_reference)):
            known = 0
            for i in range(pairs):
                apart = distance[t, i]
                # Written so that NaN stays NaN.
                if apart < LEAST_DISTANCE:
                    apart = LEAST_DISTANCE
                value = np.log(apart) - log_reference[r, i]
                # Distances that either side lacks are left out.
                if not np.isnan(value):
                    ratio[known] = value
                    # The log of a short distance is mostly noise.
                    weight[known] = 1.0 / np.sqrt(1.0 + (softness / apart) ** 2)
                    known += 1
            if known < min_pairs:
                continue
            # The median ratio is the size, which is set aside.
            middle = np.median(ratio[:known])
            for i in range(known):
                ratio[i] = abs(ratio[i] - middle) * weight[i]
            scatter = 1.4826 * np.median(ratio[:known])
            # The nearest reference: a pose is enough like one of them.
            if np.isnan(out[t]) or scatter < out[t]:
                out[t] = scatter


@kernel
def frame_deviations(distance, log_reference, spread, most, min_pairs, out):
    """How far the distances of each frame are off a reference, in standard deviations: the root mean square, sizes of bodies set aside.

    IN  distance (T, N) m, NaN where not known; log_reference (N,) logs of the reference's distances, NaN where not known; spread (N,)
        standard deviation of each log; most standard deviations that one distance counts at most
    OUT out (T,) NaN where fewer than `min_pairs` distances can be compared
    O(T N log N). Twin: `RigidDistances.nearest`, frame by frame.

    Bounds: a ratio for each pair: N.
    """
    frames, pairs = distance.shape
    ratio, each = np.empty(pairs), np.empty(pairs)
    for t in range(frames):
        out[t] = np.nan
        known = 0
        for i in range(pairs):
            apart = distance[t, i]
            # Written so that NaN stays NaN.
            if apart < LEAST_DISTANCE:
                apart = LEAST_DISTANCE
            value = np.log(apart) - log_reference[i]
            if not np.isnan(value):
                ratio[known], each[known] = value, spread[i]
                known += 1
        if known < min_pairs:
            continue
        # The median ratio is the size, which is set aside.
        middle, total = np.median(ratio[:known]), 0.0
        for i in range(known):
            deviation = min(abs(ratio[i] - middle) / each[i], most)
            total += deviation * deviation
        out[t] = np.sqrt(total / known)
