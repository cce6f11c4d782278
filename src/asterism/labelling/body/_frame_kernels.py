"""One frame: its points in; the best labelling and each marker's margin over the nearest other labelling out.

The plain twins are in `tests/twins_body.py`.
"""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.labelling.body._refine_kernels import refine
from asterism.labelling.body._score_kernels import best_pose, evidence, rescore, score_held_points
from asterism.labelling.body._search_kernels import MAX_LABELLINGS, add_twins, find_labellings, make_candidates, make_search_workspace
from asterism.labelling.body._workspace_kernels import (
    FrameLabelling,
    FrameModel,
    FrameSettings,
    copy_labels,
    count_labelled,
    make_body_workspace,
)


@kernel(inline=True)
def nearest_changes(body, points, settings, workspace, labelling):
    """For every marker, by how much the labelling beats the nearest one that differs there; a better one replaces it.

    Changes that are compared: hide the marker, give it a free point, swap it with another, let another marker take its point. They are
    estimated from the leave-one-out scores, and those of two markers computed exactly if the estimate is less than `settings.exact_margin`.
    IN     body BodyArrays; points (n, 3) m; settings FrameSettings; workspace BodyWorkspace
    IN/OUT labelling.point_of; labelling.counters, the third of which is added to
    OUT    labelling.margins, labelling.fits
    Returns the labelling's score in nats. O(M (r^2 + n)), and O(M r^2 + r^3) for each change computed exactly.
    """
    point_of, margins = labelling.point_of, labelling.margins
    markers, n = body.load.shape[1], len(points)
    trial, owner = np.empty(markers, dtype=np.int64), np.empty(n, dtype=np.int64)
    swap_cost = np.empty((markers, markers))
    top = -np.inf
    # A better labelling found on the way is taken, and its own changes are looked at, so often at most.
    for _ in range(4):
        workspace.outlier[:] = False
        k, _ = best_pose(body, points, point_of, settings, workspace)
        top = rescore(body, k, points, point_of, settings, workspace)
        scores = workspace.scores.copy()
        # Estimates for points that are held now, or they would speak for their present labels.
        score_held_points(body, k, point_of, -4.0 * settings.exact_margin, settings, workspace, scores)
        owner[:], swap_cost[:] = -1, np.nan
        # To hide a marker makes the only ghost, which costs.
        no_ghost = count_labelled(point_of) == n
        for m in range(markers):
            margins[m], labelling.fits[m] = -np.inf, 0.0
            if point_of[m] >= 0:
                owner[point_of[m]] = m
                labelling.fits[m] = scores[m, point_of[m]]
                margins[m] = scores[m, point_of[m]] + (settings.first_ghost_cost if no_ghost else 0.0)
        better = False
        for m in range(markers):
            for c in range(n):
                o = owner[c]
                # Its own point, or one too far.
                if o == m or scores[m, c] == -np.inf:
                    continue
                cost = -scores[m, c]
                if point_of[m] >= 0:
                    cost += scores[m, point_of[m]]
                if o >= 0:
                    cost += scores[o, c]
                    swap = point_of[m] >= 0 and scores[o, point_of[m]] > -settings.exact_margin
                    if swap:
                        cost -= max(0.0, scores[o, point_of[m]])
                    # The same swap was computed from the other marker's side.
                    if swap and cost < settings.exact_margin and not math.isnan(swap_cost[o, m]):
                        cost = swap_cost[o, m]
                    # Estimates take one change at a time; only where they come near, both are computed together.
                    elif cost < settings.exact_margin:
                        copy_labels(point_of, trial)
                        trial[m] = c
                        trial[o] = point_of[m] if swap else -1
                        was, owner_was = workspace.outlier[m], workspace.outlier[o]
                        workspace.outlier[m], workspace.outlier[o] = False, False
                        cost = top - evidence(body, k, points, trial, settings, workspace)
                        workspace.outlier[m], workspace.outlier[o] = was, owner_was
                        labelling.counters[2] += 1
                        # Better beyond rounding: taken, and all begins anew.
                        if cost < -1e-6:
                            copy_labels(trial, point_of)
                            better = True
                            break
                        if swap:
                            swap_cost[m, o] = cost
                    margins[o] = min(margins[o], cost)
                margins[m] = min(margins[m], cost) if point_of[m] >= 0 else max(margins[m], -cost)
            if better:
                break
        if not better:
            break
    return top


@kernel(inline=True)
def retry_doubtful(body, points, top, settings, workspace, labelling):
    """Where markers and points are both left over: take back each doubtful label in turn, and refine what remains.

    A label is doubtful if its margin is less than `settings.exact_margin`.
    IN     body BodyArrays; points (n, 3) m; top score of the labelling; settings FrameSettings; workspace BodyWorkspace; labelling.margins
    IN/OUT labelling.point_of; labelling.counters, the third of which is added to
    Returns whether a better labelling was found. O(doubtful labels) calls of `refine`.
    """
    point_of = labelling.point_of
    trial, k = np.empty_like(point_of), 0
    workspace.outlier[:] = False
    k, _ = best_pose(body, points, point_of, settings, workspace)
    for m in range(len(point_of)):
        # A sure label is not in the way of others.
        if point_of[m] < 0 or labelling.margins[m] >= settings.exact_margin:
            continue
        copy_labels(point_of, trial)
        trial[m] = -1
        labelling.counters[2] += 1
        # Without the doubtful one, another marker may get the point, and this one what is left.
        if refine(body, k, points, trial, settings, workspace) > top + 1e-6:
            copy_labels(trial, point_of)
            return True
    return False


@kernel(inline=True)
def frame_settings(settings, points, markers):
    """The settings for a frame of so many points: the more points than markers, the likelier a ghost lies near any place.

    Returns FrameSettings. O(1).
    """
    # With many points, something lies near every place, and a label must be worth more than chance.
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
        tail_freedom=settings.tail_freedom,
        usual_score=settings.usual_score - log_surplus,
    )


@kernel(inline=True)
def label_frame(model, points, workspace, labelling):
    """The best labelling of one frame, and by how much it beats the next one, marker by marker.

    Anchors (partial solvers of three markers) propose; from each proposal the whole body is predicted, labelled and refined; labellings
    that several anchors lead to collect votes. The margins of the best one are those over its nearest changes and over all others found.
    IN   model FrameModel; points (n, 3) m, z up; workspace SearchWorkspace for n points
    OUT  labelling FrameLabelling
    O(anchors' search + labellings * (M r^2 + r^3 + M n)).
    """
    point_of, margins, candidates = labelling.point_of, labelling.margins, workspace.candidates
    point_of[:] = -1
    margins[:] = -np.inf
    labelling.fits[:] = 0.0
    labelling.counters[:] = 0
    # Two points leave the body's turn open.
    if len(points) < 3:
        return
    body, settings = model.body, frame_settings(model.settings, len(points), len(point_of))
    own_model = FrameModel(model.solvers, model.anchors, body, settings, model.twins)
    count, best = find_labellings(own_model, points, workspace, labelling.counters)
    if best < 0 or candidates.scores[best] == -np.inf:
        return
    count, best = add_twins(own_model, points, workspace, count, best, labelling.counters)
    copy_labels(candidates.labellings[best], point_of)
    labelling.counters[3] = candidates.votes[best]
    top = -np.inf
    for attempt in range(4):
        top = nearest_changes(body, points, settings, workspace.body, labelling)
        labelled = count_labelled(point_of)
        if attempt == 3 or labelled == len(point_of) or labelled == len(points):
            break
        # Nothing better is to be had.
        if not retry_doubtful(body, points, top, settings, workspace.body, labelling):
            break
    # A labelling found on the way may come nearer than any single change.
    for h in range(count):
        for m in range(len(point_of)):
            if point_of[m] >= 0 and candidates.labellings[h, m] != point_of[m]:
                margins[m] = min(margins[m], max(0.0, top - candidates.scores[h]))


@kernel
def label_clouds(model, xyz, offsets, first, last, labelling):
    """`label_frame` for the frames first..last of clouds whose points are sorted within each frame.

    IN  model FrameModel; xyz (P, 3) m, z up; offsets (T + 1,)
    OUT labelling FrameLabelling of arrays with one row for each of T frames
    O(last - first) calls of `label_frame`; memory for one frame.
    """
    markers, latents = model.body.load.shape[1], model.body.load.shape[3]
    proposals = model.settings.proposals_per_anchor
    candidates = make_candidates(MAX_LABELLINGS, markers)
    workspace = make_search_workspace(make_body_workspace(0, markers, latents), candidates, proposals)
    for t in range(first, last):
        points = xyz[offsets[t] : offsets[t + 1]]
        # Frames often have as many points as the one before, and keep its memory.
        if len(points) != len(workspace.body.aligned):
            workspace = make_search_workspace(make_body_workspace(len(points), markers, latents), candidates, proposals)
        row = FrameLabelling(labelling.point_of[t], labelling.margins[t], labelling.counters[t], labelling.fits[t])
        label_frame(model, points, workspace, row)
