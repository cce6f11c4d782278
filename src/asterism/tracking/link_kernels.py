"""Linking kernels: points frame by frame in; which point continues which track out.

The plain twins are in `tests/twins_links.py`.
"""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.tracking._prediction_kernels import extend_tracks, predict_tracks, start_links
from asterism.tracking.link_workspace_kernels import make_link_workspace, make_track_ends

__all__ = ["extend_tracks", "link_frames", "link_step"]


@kernel
def _doubled(array, capacity):
    """A copy of an array with more capacity."""
    out = np.empty(capacity, dtype=array.dtype)
    for i in range(len(array)):
        out[i] = array[i]
    return out


@kernel
def link_step(ends, count, points, limits, workspace, previous, following):
    """Which track goes on with which point of the next frame: where both are each other's nearest and no rival comes near.

    Unambiguous links are made first, and what they link is no rival any more; a point that stays ambiguous begins a new track.
    IN   ends TrackEnds of `count` tracks; points (n, 3) m, sorted by x; limits LinkLimits; workspace LinkWorkspace for count and n
    OUT  previous (n,) the track that a point continues, -1 for none; following TrackEnds in this frame
    O((count + n) log n) and the pairs that come near; O(count (count + n)) where tracks begin.

    Bounds: arrays of pairs are made twice as long where they are full; where all points of two frames lie within reach of each other, that
    is up to twice count n pairs of 24 bytes. Pairs that are kept are written over those before.
    """
    n = len(points)
    predicted, gate, next_point = workspace.predicted, workspace.gate, workspace.next_point
    nearest_point, nearest_track = workspace.nearest_point, workspace.nearest_track
    nearest_point_distance, second_point_distance = workspace.nearest_point_distance, workspace.second_point_distance
    nearest_track_distance, second_track_distance = workspace.nearest_track_distance, workspace.second_track_distance
    pair_track, pair_point, pair_distance = workspace.pair_track, workspace.pair_point, workspace.pair_distance
    predict_tracks(ends, count, limits, predicted, gate)
    previous[:] = -1
    for a in range(count):
        next_point[a] = -1
    moving = False
    for a in range(count):
        moving = moving or ends.age[a] > 1
    # Without any velocity nothing can be predicted: links are made by neighbourhood.
    if not moving:
        start_links(ends, count, points, limits, next_point, previous)
    pairs, capacity = 0, len(pair_track)
    for a in range(count):
        # a single point takes only what nothing else in its gate rivals; the others' rivals may lie farther than their own gate
        reach = gate[a] if ends.age[a] == 1 else limits.ratio_test * gate[a] + limits.rival_gap
        # Points are sorted by x, so that the reachable ones are found by bisection.
        low, high = 0, n
        while low < high:
            middle = (low + high) // 2
            if points[middle, 0] < predicted[a, 0] - reach:
                low = middle + 1
            else:
                high = middle
        for b in range(low, n):
            dx = points[b, 0] - predicted[a, 0]
            if dx > reach:
                break
            dy, dz = points[b, 1] - predicted[a, 1], points[b, 2] - predicted[a, 2]
            far2 = dx * dx + dy * dy + dz * dz
            if far2 > reach * reach:
                continue
            # Crowded frames have more pairs than expected: the memory grows by doubling.
            if pairs == capacity:
                capacity *= 2
                pair_track, pair_point, pair_distance = (
                    _doubled(pair_track, capacity),
                    _doubled(pair_point, capacity),
                    _doubled(pair_distance, capacity),
                )
            pair_track[pairs], pair_point[pairs], pair_distance[pairs] = a, b, math.sqrt(far2)
            pairs += 1
    # Each round links what is unambiguous; what it links is no rival in the next.
    while True:
        for a in range(count):
            nearest_point[a], nearest_point_distance[a], second_point_distance[a] = -1, np.inf, np.inf
        for b in range(n):
            nearest_track[b], nearest_track_distance[b], second_track_distance[b] = -1, np.inf, np.inf
        kept = 0
        for p in range(pairs):
            a, b = pair_track[p], pair_point[p]
            # Pairs of what is linked fall out; the list gets shorter in each round.
            if next_point[a] >= 0 or previous[b] >= 0:
                continue
            pair_track[kept], pair_point[kept], pair_distance[kept] = a, b, pair_distance[p]
            kept += 1
            distance = pair_distance[kept - 1]
            if distance < nearest_point_distance[a]:
                second_point_distance[a], nearest_point_distance[a], nearest_point[a] = nearest_point_distance[a], distance, b
            elif distance < second_point_distance[a]:
                second_point_distance[a] = distance
            if distance < nearest_track_distance[b]:
                second_track_distance[b], nearest_track_distance[b], nearest_track[b] = nearest_track_distance[b], distance, a
            elif distance < second_track_distance[b]:
                second_track_distance[b] = distance
        pairs = kept
        changed = False
        for a in range(count):
            b = nearest_point[a]
            # Each must be the other's nearest.
            if b < 0 or nearest_track[b] != a or nearest_point_distance[a] > gate[a]:
                continue
            rival = limits.ratio_test * nearest_point_distance[a] + limits.rival_gap
            # A single point has no velocity, so that anything in its gate is a rival.
            if ends.age[a] == 1:
                rival = max(rival, gate[a])
            if second_point_distance[a] > rival and second_track_distance[b] > rival:
                next_point[a], previous[b] = b, a
                changed = True
        if not changed:
            break
    extend_tracks(ends, points, predicted, previous, following)


@kernel
def link_frames(xyz, offsets, limits, backwards, linked):
    """`link_step` through all frames, from the first to the last or backwards.

    IN  xyz (P, 3) m, each frame's points sorted by x; offsets (T + 1,); limits LinkLimits
    OUT linked (P,) the point of the frame before (backwards: after) that a point continues, -1 for none
    O(frames) calls of `link_step`; memory for one frame.

    Bounds: workspace and ends have room for the fullest frame.
    """
    most, frames = 0, len(offsets) - 1
    for t in range(frames):
        most = max(most, offsets[t + 1] - offsets[t])
    ends, following, workspace = make_track_ends(most), make_track_ends(most), make_link_workspace(most)
    count, begins = 0, 0
    for step in range(frames):
        t = frames - 1 - step if backwards else step
        first, last = offsets[t], offsets[t + 1]
        link_step(ends, count, xyz[first:last], limits, workspace, linked[first:last], following)
        # Links of a frame count from its own beginning.
        for p in range(first, last):
            if linked[p] >= 0:
                linked[p] += begins
        # Two sets of ends in turn, so that no frame allocates.
        ends, following = following, ends
        count, begins = last - first, first
