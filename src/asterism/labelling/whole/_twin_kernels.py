"""Twin kernels: sampled frames with labels in; what the labels, their exchanges and each of the body's twins explain of every frame out.

The plain twin is in `tests/twins_tracks.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.labelling.body._frame_kernels import frame_settings
from asterism.labelling.body._refine_kernels import refine_until_known
from asterism.labelling.body._score_kernels import best_pose, rescore
from asterism.labelling.body._search_kernels import LAID, twin_at
from asterism.labelling.body._workspace_kernels import copy_labels, count_labelled, make_body_workspace
from asterism.labelling.whole._kernels import points_of_markers


class TwinScores(NamedTuple):
    """What `score_twins` gives for W twins of M markers in E frames, and the body laid anew in V ways; the last row is the labels' own.

    scores    (W + V + 1, E) nats; NaN for a twin that labels a frame as the labels do, or with fewer than three markers
    point_of  (W + V + 1, E, M) the point of each marker in its frame, -1 for none
    """

    scores: np.ndarray
    point_of: np.ndarray


@kernel
def same_labels(one, other):
    """Whether two labellings are the same one. IN one, other (M,). O(M)."""
    same = True
    for m in range(len(one)):
        same = same and one[m] == other[m]
    return same


@kernel
def score_twins(xyz, offsets, track, label, twins, body, settings, gap, marker_gain, most, done, out):
    """Label every frame as each twin of the body has it, complete and refine that, and score it; a twin far behind is only scored.

    Where two points or more are left over beside missing markers, the body is laid anew, too.

    IN  xyz (P, 3) m, z up; offsets (E + 1,); track (P,) tracklet of each point; label (J,) marker of each tracklet, -1 for none;
        twins (W, M), see `twins_of`; body BodyArrays; settings FrameSettings; gap nats by which a twin may be behind to be refined, each
        marker without a point taken as marker_gain nats; most, how many are refined in a frame, those that may come nearest first
    IN/OUT done (W + V,) twins that are not looked at; then also those that were looked at in the last frame, all but what `most` left out
    OUT out TwinScores, scores NaN for what was not looked at. O(E (W + V) K (M r^2 + r^3)), and one `refine` for each twin that comes near;
        memory for one frame.
    """
    markers, latents, last = body.load.shape[1], body.load.shape[3], len(twins) + LAID
    raw, workspace = np.empty(markers, dtype=np.int64), make_body_workspace(0, markers, latents)
    out.scores[:], nothing = np.nan, np.empty((0, markers), dtype=np.int64)
    pose, reach, before = np.empty(last, dtype=np.int64), np.empty(last), done.copy()
    for t in range(len(offsets) - 1):
        first, n = offsets[t], offsets[t + 1] - offsets[t]
        own = out.point_of[last, t]
        labelled = points_of_markers(track[first : first + n], label, own)
        done[:] = True
        if labelled < 3:
            out.point_of[:, t] = -1
            continue
        # Frames often have as many points as the one before, and keep its memory.
        if n != len(workspace.aligned):
            workspace = make_body_workspace(n, markers, latents)
        points, own_settings = xyz[first : first + n], frame_settings(settings, n, markers)
        workspace.outlier[:] = False
        k, _ = best_pose(body, points, own, own_settings, workspace)
        top = rescore(body, k, points, own, own_settings, workspace)
        out.scores[last, t] = top
        aligned, mean = workspace.aligned.copy(), body.mean[k]
        lays = min(markers, n) - labelled >= 2
        reach[:] = -np.inf
        for w in range(last):
            trial = out.point_of[w, t]
            trial[:] = -1
            if not before[w] and (w < len(twins) or lays):
                twin_at(w, twins, mean, own, aligned, workspace.scores, trial)
            given = count_labelled(trial)
            # Two points leave the body's turn open; a body alike on both sides has itself as a twin.
            if given < 3 or same_labels(trial, own):
                continue
            workspace.outlier[:] = False
            pose[w], out.scores[w, t] = best_pose(body, points, trial, own_settings, workspace)
            # Even if each marker without a point earned what a good label does, it would stay behind: not refined.
            may_reach = out.scores[w, t] + marker_gain * (min(markers, n) - given)
            if may_reach >= top - gap:
                reach[w] = may_reach
        # Counted, not timed: every machine stops at the same twin.
        for _ in range(most):
            w = np.argmax(reach)
            if reach[w] == -np.inf:
                break
            reach[w] = -np.inf
            trial = out.point_of[w, t]
            copy_labels(trial, raw)
            refined, _ = refine_until_known(body, pose[w], points, trial, nothing, 0, top - gap, marker_gain, own_settings, workspace)
            if refined == -np.inf or same_labels(trial, own):
                # it leads back: only as it stands it is another labelling
                copy_labels(raw, trial)
            else:
                out.scores[w, t] = refined
        for w in range(last):
            if reach[w] > -np.inf:
                done[w], out.scores[w, t] = False, np.nan
                out.point_of[w, t] = -1


@kernel
def score_exchanges(xyz, offsets, track, label, body, settings, apart, both, shown):
    """By how much leave-one-out scores prefer the labels to each exchange of two, or to a hidden marker that takes another one's point.

    A leave-one-out score as another marker takes the point for what it is labelled, too, beside which it lies as no other marker does.
    So it does not tell which exchanges are better.

    IN  xyz (P, 3) m, z up; offsets (E + 1,); track (P,) tracklet of each point; label (J,) marker of each tracklet, -1 for none; body
        BodyArrays; settings FrameSettings
    OUT apart (M, M) nats, the sum over the frames that show the first marker, by scores as `score_frames` gives them; both, shown (M, M)
        frames that show both markers, and the first one
    O(E (M r^2 + r^3 + M n + M^2)); memory for one frame.
    """
    markers, latents = body.load.shape[1], body.load.shape[3]
    own, workspace = np.empty(markers, dtype=np.int64), make_body_workspace(0, markers, latents)
    apart[:], both[:], shown[:] = 0.0, 0, 0
    for t in range(len(offsets) - 1):
        first, n = offsets[t], offsets[t + 1] - offsets[t]
        # Two points leave the body's turn open.
        if points_of_markers(track[first : first + n], label, own) < 3:
            continue
        # Frames often have as many points as the one before, and keep its memory.
        if n != len(workspace.aligned):
            workspace = make_body_workspace(n, markers, latents)
        points, own_settings = xyz[first : first + n], frame_settings(settings, n, markers)
        workspace.outlier[:] = False
        k, _ = best_pose(body, points, own, own_settings, workspace)
        rescore(body, k, points, own, own_settings, workspace)
        scores = workspace.scores
        for a in range(markers):
            for b in range(markers):
                if own[a] < 0 or a == b:
                    continue
                shown[a, b] += 1
                apart[a, b] += scores[a, own[a]] - scores[b, own[a]]
                # Both have a point, and each takes the other's.
                if own[b] >= 0:
                    both[a, b] += 1
                    apart[a, b] += scores[b, own[b]] - scores[a, own[b]]
