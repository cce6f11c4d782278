"""Points frame by frame in; for each a column in which it may follow others, for formats that know only columns."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from asterism.recording import Clouds, Ints

_CHANGE = 3.0
_LEAST = 0.01
_CLEAR = 2.0
_REST = 10
_BESIDE = 0.3


def columns_of(clouds: Clouds) -> Ints:
    """(P,) a column for each point: that of the point of the frame before that it follows, else a free one.

    A point follows another where each is the other's nearest after the motion of the last step is carried on, within what a change by 3 m/s
    makes, and where no second one is half as near. A point that has just begun is taken to move as the nearest one that follows another
    does, within 0.3 m: a foot in swing would else begin anew in each frame. A column rests for 10 frames before another point may begin in
    it. No two points of a frame share a column.
    """
    columns = np.full(len(clouds.xyz), -1, dtype=np.int64)
    reach = max(_LEAST, _CHANGE / clouds.rate)
    last_used = np.empty(0, dtype=np.int64)
    before, moved = np.empty((0, 3)), np.empty((0, 3))
    own = np.empty(0, dtype=np.int64)
    for t, points in enumerate(clouds):
        mine = np.full(len(points), -1, dtype=np.int64)
        step = np.zeros((len(points), 3))
        if len(points) and len(before):
            ahead, back = cKDTree(before + moved), cKDTree(points)
            near, which = ahead.query(points, k=2)
            other = back.query(before + moved)[1]
            for p, (distances, candidates) in enumerate(zip(near, which, strict=True)):
                if distances[0] <= reach and distances[0] * _CLEAR <= distances[1] and other[candidates[0]] == p:
                    mine[p] = own[candidates[0]]
                    step[p] = points[p] - before[candidates[0]]
        fresh = np.nonzero(mine < 0)[0]
        free = np.nonzero(last_used < t - _REST)[0]
        free = free[~np.isin(free, mine)][: len(fresh)]
        added = len(last_used) + np.arange(len(fresh) - len(free))
        last_used = np.concatenate([last_used, np.full(len(added), t, dtype=np.int64)])
        mine[fresh] = np.concatenate([free, added])
        last_used[mine] = t
        followed = np.isin(np.arange(len(points)), fresh, invert=True)
        if len(fresh) and followed.any():
            away, beside = cKDTree(points[followed]).query(points[fresh])
            step[fresh] = np.where((away < _BESIDE)[:, None], step[followed][beside], 0.0)
        columns[clouds.offsets[t] : clouds.offsets[t + 1]] = mine
        before, moved, own = points, step, mine
    return columns
