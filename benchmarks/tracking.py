"""The peer that every optical system ships: a first frame labelled by hand, then each marker followed from frame to frame.

It is here to be beaten in the same run, on the same clouds. It is given more than a person could give: the true places of all markers
in the first frame, hidden ones included.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from asterism.recording import NULL, Clouds, Floats, Labelling

LIMIT, GROWTH, FARTHEST = 0.02, 0.005, 0.2
"""A point farther than this from where a marker is expected is not that marker, in metres: at once, more per frame of absence, at most.
These and the next two are the best of some twenty choices on the walks of three gait subjects, at 100 Hz."""

INERTIA = 0.5
"""Share of the old velocity in the new one."""

PATIENCE = 5
"""Frames for which an absent marker keeps its own velocity; then it moves with the others."""


def follow(first: Floats, clouds: Clouds, names: tuple[str, ...]) -> Labelling:
    """Labels by track number where there is one, else by constant velocity and optimal assignment; every label at confidence 1.

    first  (M, 3) m, where the markers are in the first frame, NaN for unknown

    A track keeps the marker that it was once given. Tracks that are new and points without a number are assigned to the markers that are
    absent; such a marker goes on at its own velocity, then at the median velocity of the markers that are there.
    """
    place, velocity, drift = np.nan_to_num(first, nan=np.inf), np.zeros_like(first), np.zeros(3)
    seen, absent = place, np.zeros(len(first), dtype=np.int64)
    indices = np.full((len(clouds), len(first)), NULL, dtype=np.int64)
    marker_of: dict[int, int] = {}
    for frame, points in enumerate(clouds):
        tracks = np.full(len(points), -1) if clouds.tracks is None else clouds.tracks[clouds.offsets[frame] : clouds.offsets[frame + 1]]
        expected = place + np.where((absent <= PATIENCE)[:, None], velocity, drift)
        own = np.array([marker_of.get(track, NULL) for track in tracks.tolist()], dtype=np.int64)
        candidates = np.nonzero(own != NULL)[0]
        markers = own[candidates]
        lost, free = np.setdiff1d(np.arange(len(first)), markers), np.nonzero(own == NULL)[0]
        if len(lost) and len(free):
            limit = np.minimum(LIMIT + GROWTH * absent[lost], FARTHEST)
            apart = np.sqrt(((expected[lost, None] - points[free]) ** 2).sum(axis=2))
            rows, columns = linear_sum_assignment(np.minimum(apart, limit[:, None]))
            near = apart[rows, columns] < limit[rows]
            again, by = lost[rows[near]], free[columns[near]]
            marker_of.update((track, marker) for track, marker in zip(tracks[by].tolist(), again.tolist(), strict=True) if track >= 0)
            markers, candidates = np.concatenate([markers, again]), np.concatenate([candidates, by])
        found = np.zeros(len(first), dtype=np.bool_)
        found[markers] = True
        indices[frame, markers] = candidates
        step = (points[candidates] - seen[markers]) / (absent[markers] + 1)[:, None]
        velocity[markers] = INERTIA * velocity[markers] + (1 - INERTIA) * step
        expected[markers] = points[candidates]
        if len(markers):
            drift = np.median(velocity[markers], axis=0)
        place, seen = expected, np.where(found[:, None], expected, seen)
        absent = np.where(found, 0, absent + 1)
    return Labelling(indices, (indices != NULL).astype(np.float64), names)
