"""Lists of hypotheses on flat arrays: each is a point and at most one blob of each camera that it explains."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from asterism._jit import kernel


class Hypotheses(NamedTuple):
    """Growing lists of hypotheses.

    rays    (n, C) the blob of each camera, or -1
    points  (n, 3) m
    scores  (n,) nats: see `score`
    links   (n, C) the previous hypothesis in the list that has the same blob of this camera, or -1
    """

    rays: np.ndarray
    points: np.ndarray
    scores: np.ndarray
    links: np.ndarray


@kernel
def empty_hypotheses(size, cameras):
    """Returns Hypotheses with room for `size` of them. O(size * cameras)."""
    return Hypotheses(np.empty((size, cameras), np.int64), np.empty((size, 3)), np.empty(size), np.empty((size, cameras), np.int64))


@kernel
def append_hypothesis(found, count, rays, point, worth):
    """Write a hypothesis behind the first `count`.

    IN  rays (C,), point (3,) m, worth nats
    OUT found Hypotheses
    Returns the lists, twice as long where they were full. O(C), amortised.
    """
    # Twice as long: each hypothesis is copied about once in all, however many there come to be.
    if count == len(found.scores):
        found = _doubled(found)
    for c in range(len(rays)):
        found.rays[count, c] = rays[c]
    for axis in range(3):
        found.points[count, axis] = point[axis]
    found.scores[count] = worth
    return found


@kernel
def _doubled(found):
    """Returns the same lists with room for twice as many. O(n C)."""
    size, cameras = found.rays.shape
    longer = empty_hypotheses(2 * size, cameras)
    for n in range(size):
        # Element by element, which compiles faster than slices.
        for c in range(cameras):
            longer.rays[n, c], longer.links[n, c] = found.rays[n, c], found.links[n, c]
        for axis in range(3):
            longer.points[n, axis] = found.points[n, axis]
        longer.scores[n] = found.scores[n]
    return longer


@kernel
def same_rays(found, n, rays):
    """Returns whether hypothesis n has exactly these rays (C,). O(C)."""
    same = True
    for c in range(len(rays)):
        same = same and found.rays[n, c] == rays[c]
    return same


@kernel
def holders_by_blob(rays, members, blobs):
    """For each blob the hypotheses that have it.

    IN  rays (n, C); members (m,) the hypotheses that count, in the order in which they are to be listed; blobs: how many there are
    Returns starts (blobs + 1,) and holders (starts[-1],): blob b is held by holders[starts[b]:starts[b + 1]]. O(m C + blobs).

    Bounds: entries are counted before `holders` is made.
    """
    cameras = rays.shape[1]
    starts = np.zeros(blobs + 1, np.int64)
    # Counting sort by blob: one flat array instead of a list for each blob.
    for n in members:
        for c in range(cameras):
            if rays[n, c] >= 0:
                starts[rays[n, c] + 1] += 1
    for blob in range(blobs):
        starts[blob + 1] += starts[blob]
    holders = np.empty(starts[blobs], np.int64)
    fill = np.empty(blobs + 1, np.int64)
    # A copy to count up in, since `starts` is what is given back.
    for blob in range(blobs + 1):
        fill[blob] = starts[blob]
    for n in members:
        for c in range(cameras):
            if rays[n, c] >= 0:
                holders[fill[rays[n, c]]] = n
                fill[rays[n, c]] += 1
    return starts, holders
