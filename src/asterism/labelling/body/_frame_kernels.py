"""One frame: its points in; the best labelling and each marker's margin over the nearest other labelling out."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.labelling.body._refine_kernels import refine
from asterism.labelling.body._score_kernels import best_pose, evidence, rescore
from asterism.labelling.body._search_kernels import MAX_LABELLINGS, CandidateLabellings, find_labellings
from asterism.labelling.body._workspace_kernels import FrameSettings, count_labelled, make_body_workspace


@kernel
def nearest_changes(body, points, settings, workspace, point_of, margins, counters):
    """For every marker, by how much the labelling beats the nearest one that differs there; a better one replaces it.

    Changes looked at: hide the marker, give it a free point, swap it with another, let another marker take its point. Estimated from the
    leave-one-out scores, computed exactly where they come within `settings.exact_margin`.

    IN/OUT point_of (M,). OUT margins (M,) nats; for a null, how far its best free point was from being taken (negative)
    Returns the labelling's score. O(M (r^2 + n)) and O(M + r^3) for each change computed exactly.
    """
    markers, n = body.load.shape[1], len(points)
    trial, owner = np.empty(markers, dtype=np.int64), np.empty(n, dtype=np.int64)
    top = -np.inf
    for _ in range(4):
        workspace.outlier[:] = False
        k, _ = best_pose(body, points, point_of, settings, workspace)
        top = rescore(body, k, points, point_of, settings, workspace)
        local = workspace.scores.copy()
        owner[:] = -1
        whole = count_labelled(point_of) == n
        for m in range(markers):
            margins[m] = -np.inf
            if point_of[m] >= 0:
                owner[point_of[m]] = m
                margins[m] = local[m, point_of[m]] + (settings.first_ghost_cost if whole else 0.0)
        better = False
        for m in range(markers):
            for c in range(n):
                o = owner[c]
                if o == m or local[m, c] == -np.inf:
                    continue
                cost = -local[m, c]
                if point_of[m] >= 0:
                    cost += local[m, point_of[m]]
                if o >= 0:
                    cost += local[o, c]
                    swap = point_of[m] >= 0 and local[o, point_of[m]] > -settings.exact_margin
                    if swap:
                        cost -= max(0.0, local[o, point_of[m]])
                    # a point that a hidden marker may own has drawn the body towards its present owner: the estimate is not to be trusted
                    if cost < settings.exact_margin or (point_of[m] < 0 and local[m, c] > -4.0 * settings.exact_margin):
                        trial[:] = point_of
                        trial[m] = c
                        trial[o] = point_of[m] if swap else -1
                        was, owner_was = workspace.outlier[m], workspace.outlier[o]
                        workspace.outlier[m], workspace.outlier[o] = False, False
                        cost = top - evidence(body, k, points, trial, settings, workspace)
                        workspace.outlier[m], workspace.outlier[o] = was, owner_was
                        counters[2] += 1
                        if cost < -1e-6:
                            point_of[:] = trial
                            better = True
                            break
                    margins[o] = min(margins[o], cost)
                margins[m] = min(margins[m], cost) if point_of[m] >= 0 else max(margins[m], -cost)
            if better:
                break
        if not better:
            break
    return top


@kernel
def retry_doubtful(body, points, top, settings, workspace, point_of, margins, counters):
    """Where markers and points are both left over, see whether a doubtful label keeps them apart: take it back and relabel.

    IN top score of the labelling; IN/OUT point_of (M,). Returns whether a better labelling was found.
    """
    trial, k = np.empty_like(point_of), 0
    workspace.outlier[:] = False
    k, _ = best_pose(body, points, point_of, settings, workspace)
    for m in range(len(point_of)):
        if point_of[m] < 0 or margins[m] >= settings.exact_margin:
            continue
        trial[:] = point_of
        trial[m] = -1
        counters[2] += 1
        if refine(body, k, points, trial, settings, workspace) > top + 1e-6:
            point_of[:] = trial
            return True
    return False


@kernel
def frame_settings(settings, points, markers):
    """The settings for a frame of so many points: the more points there are than markers, the likelier a ghost lies anywhere."""
    log_surplus = math.log(1.0 + max(0, points - markers))
    return FrameSettings(
        reward=settings.reward - log_surplus,
        first_ghost_cost=settings.first_ghost_cost,
        outlier_score=settings.outlier_score - log_surplus,
        outlier_radius=settings.outlier_radius,
        max_anchor_distance2=settings.max_anchor_distance2,
        votes_needed=settings.votes_needed,
        max_votes_needed=settings.max_votes_needed,
        extra_anchors=settings.extra_anchors,
        max_evaluations=settings.max_evaluations,
        proposals_per_anchor=settings.proposals_per_anchor,
        min_found_share=settings.min_found_share,
        assign_margin=settings.assign_margin,
        exact_margin=settings.exact_margin,
        usual_score=settings.usual_score - log_surplus,
    )


@kernel
def label_frame(points, order, solvers, anchors, body, settings, workspace, candidates, point_of, margins, counters):
    """The best labelling of one frame and by how much it beats the next one, marker by marker.

    Anchors (partial solvers of three markers) propose; from each proposal the whole body is predicted, labelled and refined; labellings
    reached from several anchors collect votes. The best one's margins are taken against its nearest changes and the other labellings found.

    IN   points (n, 3) m, z up; order (n,) search order; solvers SolverArrays, anchors AnchorArrays (the same anchors); body, settings
    OUT  point_of (M,), margins (M,) nats (for a null: how far its best free point was from being taken, negative);
         counters (4,): feature evaluations, anchors run, labellings scored, votes of the best
    """
    point_of[:] = -1
    margins[:] = -np.inf
    counters[:] = 0
    if len(points) < 3:
        return
    settings = frame_settings(settings, len(points), len(point_of))
    count, best = find_labellings(points, order, solvers, anchors, body, settings, workspace, candidates, counters)
    if best < 0 or candidates.scores[best] == -np.inf:
        return
    point_of[:] = candidates.labellings[best]
    counters[3] = candidates.votes[best]
    top = nearest_changes(body, points, settings, workspace, point_of, margins, counters)
    for _ in range(3):
        labelled = count_labelled(point_of)
        if labelled == len(point_of) or labelled == len(points):
            break
        if not retry_doubtful(body, points, top, settings, workspace, point_of, margins, counters):
            break
        top = nearest_changes(body, points, settings, workspace, point_of, margins, counters)
    for h in range(count):
        for m in range(len(point_of)):
            if point_of[m] >= 0 and candidates.labellings[h, m] != point_of[m]:
                margins[m] = min(margins[m], max(0.0, top - candidates.scores[h]))


@kernel
def label_clouds(xyz, offsets, first, last, solvers, anchors, body, settings, point_of, margins, counters):
    """`label_frame` for the frames first..last of clouds whose points are sorted within each frame.

    IN  xyz (P, 3) m, z up; offsets (T + 1,)
    OUT point_of (T, M), margins (T, M) nats, counters (T, 4); see `label_frame`
    O(frames * (anchors' search + labellings * M r^2)); memory for one frame.
    """
    markers, latents = body.load.shape[1], body.load.shape[3]
    most = 0
    for t in range(first, last):
        most = max(most, offsets[t + 1] - offsets[t])
    order = np.arange(most)
    workspace = make_body_workspace(0, markers, latents)
    candidates = CandidateLabellings(
        np.empty((MAX_LABELLINGS, markers), dtype=np.int64),
        np.empty(MAX_LABELLINGS, dtype=np.int64),
        np.empty((MAX_LABELLINGS, markers), dtype=np.int64),
        np.empty(MAX_LABELLINGS),
        np.empty(MAX_LABELLINGS, dtype=np.int64),
        np.empty(MAX_LABELLINGS, dtype=np.int64),
        np.empty(MAX_LABELLINGS, dtype=np.int64),
    )
    for t in range(first, last):
        n = offsets[t + 1] - offsets[t]
        if n != len(workspace.aligned):
            workspace = make_body_workspace(n, markers, latents)
        label_frame(
            xyz[offsets[t] : offsets[t + 1]],
            order[:n],
            solvers,
            anchors,
            body,
            settings,
            workspace,
            candidates,
            point_of[t],
            margins[t],
            counters[t],
        )
