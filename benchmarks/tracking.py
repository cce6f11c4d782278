"""The peer that every optical system ships: a first frame labelled by hand, then each marker followed from frame to frame.

It is here to be beaten in the same run, on the same clouds. It is given more than a person could give: the true places of all markers
in the first frame, hidden ones included.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from asterism.recording import NULL, Clouds, Floats, Labelling

LIMIT, GROWTH, FARTHEST = 0.04, 0.01, 0.2
"""A point farther than this from where a marker is expected is not that marker, in metres: at once, more per frame of absence, at most."""

INERTIA = 0.5
"""Share of the old velocity in the new one."""


def follow(first: Floats, clouds: Clouds, names: tuple[str, ...]) -> Labelling:
    """Labels by constant velocity and optimal assignment, from the markers' places (M, 3) m in the first frame, all at confidence 1.

    A marker without a point keeps its velocity for as long as it has been followed without one for less than a quarter of a second, then
    it waits where it is; it may be found again ever farther from there.
    """
    place, velocity = np.nan_to_num(first, nan=np.inf), np.zeros_like(first)
    seen = place
    absent = np.zeros(len(first), dtype=np.int64)
    indices = np.full((len(clouds), len(first)), NULL, dtype=np.int64)
    patience = round(0.25 * clouds.rate)
    for frame, points in enumerate(clouds):
        expected = place + velocity * (absent < patience)[:, None]
        limit = np.minimum(LIMIT + GROWTH * absent, FARTHEST)
        found = np.zeros(len(first), dtype=np.bool_)
        if len(points):
            apart = np.sqrt(((expected[:, None] - points) ** 2).sum(axis=2))
            markers, candidates = linear_sum_assignment(np.minimum(apart, limit[:, None]))
            near = apart[markers, candidates] < limit[markers]
            markers, candidates = markers[near], candidates[near]
            indices[frame, markers] = candidates
            found[markers] = True
            step = (points[candidates] - seen[markers]) / (absent[markers] + 1)[:, None]
            velocity[markers] = INERTIA * velocity[markers] + (1 - INERTIA) * step
            expected[markers] = points[candidates]
        place, seen = expected, np.where(found[:, None], expected, seen)
        absent = np.where(found, 0, absent + 1)
    return Labelling(indices, (indices != NULL).astype(np.float64), names)
