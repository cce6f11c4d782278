"""Short-tracklet kernels: a recording whose long tracklets are labelled in; labels of the points of short ones out.

The plain twins are in `tests/twins_tracks.py`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.labelling.body._frame_kernels import frame_settings
from asterism.labelling.body._score_kernels import best_pose, rescore
from asterism.labelling.body._workspace_kernels import make_body_workspace


class ShortLimits(NamedTuple):
    """How the points of short tracklets are scored.

    min_labelled   labelled markers that a frame must show
    min_score      nats, the most that the body can say against a label (negative)
    max_score      nats, the most that it can say for a label
    usual_spread   m, standard deviation of a place that the body predicts; a place that motion predicts more closely counts for more
    motion_spread  m; where motion predicts a place at least so closely, it decides more than the body
    """

    min_labelled: int
    min_score: float
    max_score: float
    usual_spread: float
    motion_spread: float


class Expected(NamedTuple):
    """Where motion expects each marker in each of T frames.

    place   (T, M, 3) m
    spread  (T, M) m, its standard deviation, infinite where nothing is known
    """

    place: np.ndarray
    spread: np.ndarray


class ShortLabels(NamedTuple):
    """What `label_short` gives for P points in T frames.

    label      (P,) marker of each point, -1 for none
    margin     (P,) nats, of the candidates that were labelled
    by_motion  (P,) bool, candidates that were labelled where motion expects the marker closely
    alone      (T,) bool, frames that show too few labelled markers; nothing is labelled there
    body_hits  (M, 4) see `count_body_hits`
    near_hits  (M, 4) see `count_near_hits`
    """

    label: np.ndarray
    margin: np.ndarray
    by_motion: np.ndarray
    alone: np.ndarray
    body_hits: np.ndarray
    near_hits: np.ndarray


@kernel
def score_by_motion(points, c, place, spread, usual_spread):
    """What motion says for point c of a frame as a marker, in nats: above 0 where it comes close to a place that is known well.

    IN points (n, 3) m; place (3,) m; spread, usual_spread m. O(1).
    """
    if spread == np.inf:
        return 0.0
    far2 = (points[c, 0] - place[0]) ** 2 + (points[c, 1] - place[1]) ** 2 + (points[c, 2] - place[2]) ** 2
    # A place known closely is worth more than the body's usual guess, and a point off it loses more.
    return max(0.0, 3.0 * math.log(usual_spread / spread)) - 0.5 * far2 / (spread * spread)


@kernel
def take_best_pairs(scores, label, margin):
    """Give markers to points, the pair with the highest score first, while a score is above 0; each marker and each point once.

    A margin is what a pair's score is above 0, above the scores of the point as other free markers, and of the marker at other free points.
    IN  scores (M, n) nats, -inf for pairs that are not offered
    OUT label (n,) marker of each point, margin (n,) nats; both are written only where a pair is taken. O(M n pairs taken).
    """
    markers, n = scores.shape
    free_marker, free_point = np.ones(markers, dtype=np.bool_), np.ones(n, dtype=np.bool_)
    # The best pair first: what it takes is no rival of the next.
    while True:
        best, best_m, best_c = 0.0, -1, -1
        for m in range(markers):
            if free_marker[m]:
                for c in range(n):
                    if free_point[c] and scores[m, c] > best:
                        best, best_m, best_c = scores[m, c], m, c
        if best_m < 0:
            return
        # Both ways: another point for the marker, another marker for the point.
        rival = 0.0
        for c in range(n):
            if free_point[c] and c != best_c:
                rival = max(rival, scores[best_m, c])
        for m in range(markers):
            if free_marker[m] and m != best_m:
                rival = max(rival, scores[m, best_c])
        label[best_c], margin[best_c] = best_m, best - rival
        free_marker[best_m], free_point[best_c] = False, False


NEAR = 2.5
"""Standard deviations: a point that lies nearer to where motion expects a marker is a hit of `count_near_hits`. Not tuned."""


@kernel
def count_body_hits(scores, point_of, spread, candidate, motion_spread, counts):
    """How often a candidate scores as each marker: in frames in which it may be there, and in those in which another point is it already.

    A candidate that scores as a marker whose point is known, and higher than as any free marker, is a ghost. So the second share tells how
    often ghosts score by chance. Free markers whose place motion knows well are not counted.
    IN     scores (M, n) nats, above 0 for a hit; point_of (M,); spread (M,) m; candidate (n,) bool; motion_spread m
    IN/OUT counts (M, 4): frames in which the marker is free, those with a hit; frames in which another point is it, those with a hit
    O(M n).
    """
    best_free = np.zeros(len(candidate))
    for m in range(len(point_of)):
        if point_of[m] < 0:
            for c in range(len(candidate)):
                # A candidate is the free marker it fits best, and no ghost.
                best_free[c] = max(best_free[c], scores[m, c])
    for m in range(len(point_of)):
        # Motion knows better there: counted by `count_near_hits`.
        if point_of[m] < 0 and spread[m] <= motion_spread:
            continue
        hit = False
        for c in range(len(candidate)):
            hit = hit or (candidate[c] and scores[m, c] > (0.0 if point_of[m] < 0 else best_free[c]))
        # Frames with the marker free, beside those in which every hit is by chance.
        side = 0 if point_of[m] < 0 else 2
        counts[m, side] += 1
        counts[m, side + 1] += hit


@kernel
def count_near_hits(points, point_of, expected, t, candidate, motion_spread, counts):
    """`count_body_hits` for markers whose place motion knows well: how often a candidate is near it, and near the point of a known marker.

    IN     points (n, 3) m; point_of (M,); expected Expected; t frame; candidate (n,) bool; motion_spread m
    IN/OUT counts (M, 4). O(M n).
    """
    for m in range(len(point_of)):
        free = point_of[m] < 0
        if free and expected.spread[t, m] > motion_spread:
            continue
        # At a marker that is known, whatever else lies near is a ghost.
        place = expected.place[t, m] if free else points[point_of[m]]
        reach = NEAR * (expected.spread[t, m] if free else motion_spread)
        hit = False
        for c in range(len(candidate)):
            far2 = (points[c, 0] - place[0]) ** 2 + (points[c, 1] - place[1]) ** 2 + (points[c, 2] - place[2]) ** 2
            hit = hit or (candidate[c] and far2 <= reach * reach)
        side = 0 if free else 2
        counts[m, side] += 1
        counts[m, side + 1] += hit


@kernel
def label_short(xyz, offsets, candidate, body, settings, limits, expected, out):
    """Label the points of short tracklets as markers that no long tracklet holds in their frames.

    A candidate's score as a marker is what the body says, given the frame's labelled points, and what motion says.
    IN     xyz (P, 3) m, z up; offsets (T + 1,); candidate (P,) bool, points to label; body BodyArrays; settings FrameSettings;
           limits ShortLimits; expected Expected
    IN/OUT out ShortLabels
    O(T (K M r^2 + M n)) for frames with a candidate and a free marker; memory for one frame.
    """
    markers, latents = body.load.shape[1], body.load.shape[3]
    point_of = np.empty(markers, dtype=np.int64)
    workspace = make_body_workspace(0, markers, latents)
    for t in range(len(offsets) - 1):
        first, n = offsets[t], offsets[t + 1] - offsets[t]
        out.alone[t] = False
        point_of[:] = -1
        labelled, candidates = 0, 0
        for c in range(n):
            if out.label[first + c] >= 0:
                point_of[out.label[first + c]] = c
                labelled += 1
            elif candidate[first + c]:
                candidates += 1
        # No point to label, or no marker to give.
        if candidates == 0 or labelled == markers:
            continue
        # Too few labels to tell the body by: said, instead of guessed.
        if labelled < limits.min_labelled:
            out.alone[t] = True
            continue
        if n != len(workspace.aligned):
            workspace = make_body_workspace(n, markers, latents)
        points, spread = xyz[first : first + n], expected.spread[t]
        own_settings = frame_settings(settings, n, markers)
        workspace.outlier[:] = False
        k, _ = best_pose(body, points, point_of, own_settings, workspace)
        rescore(body, k, points, point_of, own_settings, workspace)
        scores = workspace.scores
        of_frame = candidate[first : first + n]
        count_body_hits(scores, point_of, spread, of_frame, limits.motion_spread, out.body_hits)
        count_near_hits(points, point_of, expected, t, of_frame, limits.motion_spread, out.near_hits)
        for m in range(markers):
            for c in range(n):
                score = scores[m, c]
                # Only candidates, and only markers that no long tracklet holds.
                scores[m, c] = -np.inf
                if point_of[m] >= 0 or not candidate[first + c] or score < limits.min_score:
                    continue
                moved = score_by_motion(points, c, expected.place[t, m], spread[m], limits.usual_spread)
                # Limited, so that neither the body nor a lucky place decides alone.
                scores[m, c] = min(score, limits.max_score) + moved
        take_best_pairs(scores, out.label[first : first + n], out.margin[first : first + n])
        for c in range(n):
            if candidate[first + c] and out.label[first + c] >= 0:
                out.by_motion[first + c] = spread[out.label[first + c]] <= limits.motion_spread
