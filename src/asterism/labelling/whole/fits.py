"""How well the points of a recording lie where the others predict them: labels of all points in; nats of each labelled point out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from asterism.labelling.body._workspace_kernels import BodyArrays, FrameSettings
from asterism.labelling.whole._kernels import FrameScores, score_frames
from asterism.labelling.whole.upright import turned
from asterism.recording import NULL, Clouds, Floats, Ints

MIN_FIT, MAX_FIT = -12.0, 15.0
"""Nats that one frame says of a point at least and at most, before the mean over a tracklet. Not tuned."""

AT_ONCE = 500
"""Frames that are scored at once: their scores fit into the cache."""


def point_fits(
    clouds: Clouds,
    xyz: Floats,
    label: Ints,
    body: BodyArrays,
    settings: FrameSettings,
    frames: NDArray[np.bool_],
    group: Ints,
    turns: Floats | None = None,
) -> Floats:
    """The mean fit of each group of points, given to all points of the group: (P,) nats, less what rightly labelled frames usually score.

    The fit of a point is its score as its marker, given all other labels of its frame ("leave one out").
    clouds of P points; xyz (P, 3) m, z up; label (P,): marker of each point, -1 for none; frames (T,): the frames that are scored; group
    (P,): tracklet of each point; turns (T, 3, 3): rotations by which frames are turned first, None for none. A group without a labelled
    point in these frames has 0. O(scored frames), as `score_frames`.
    """
    frame_of = clouds.frame_of
    points = np.nonzero(frames[frame_of])[0]
    xyz = xyz[points] if turns is None else turned(xyz[points], frame_of[points], turns)
    order = np.lexsort((*xyz.T, frame_of[points]))  # the order of the points does not matter
    points, xyz = points[order], xyz[order]
    counts = clouds.counts[frames]
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    labelled = np.nonzero(label[points] != NULL)[0]
    score = np.empty(len(points))
    for begin in range(0, len(counts), AT_ONCE):
        some = offsets[begin : begin + AT_ONCE + 1]
        here = slice(some[0], some[-1])
        score[here] = _own_scores(xyz[here], some - some[0], label[points[here]], body, settings)
    surplus = np.log1p(np.maximum(clouds.counts - body.mean.shape[1], 0))[frame_of[points[labelled]]]
    fit = np.clip(score[labelled] - settings.usual_score + surplus, MIN_FIT, MAX_FIT)
    size = int(group.max(initial=-1)) + 1
    whose = group[points[labelled]]
    count = np.bincount(whose, minlength=size)
    return (np.bincount(whose, weights=fit, minlength=size) / np.maximum(count, 1))[group]


def _own_scores(xyz: Floats, offsets: Ints, label: Ints, body: BodyArrays, settings: FrameSettings) -> Floats:
    """The score (n,) of each point of some frames as its own marker; of a point without a label, as any."""
    frames = len(offsets) - 1
    out = FrameScores(np.empty((len(xyz), body.mean.shape[1])), np.empty(frames), np.empty(frames, dtype=np.int64))
    score_frames(xyz, offsets, np.arange(len(xyz)), label, body, settings, out)
    return out.scores[np.arange(len(xyz)), label]
