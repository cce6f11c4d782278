"""Search: a frame's points and the anchors in; the distinct labellings that the anchors lead to out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.labelling.body._anchor_kernels import anchor_key_pose, score_from_anchor
from asterism.labelling.body._assignment_kernels import assign_greedily, assign_unambiguous
from asterism.labelling.body._refine_kernels import refine
from asterism.labelling.body._workspace_kernels import count_labelled
from asterism.labelling.partial._search_kernels import search

MAX_LABELLINGS = 24
"""Labellings of one frame that are kept apart."""
MAX_PROPOSAL_GAP = 20.0
"""A proposal this many nats behind its anchor's best one is not followed up."""


@kernel
def _index_of(table, count, point_of):
    """Where a labelling is among the first `count` rows of a table, -1 where it is not. O(count M)."""
    for h in range(count):
        same = True
        for m in range(len(point_of)):
            if table[h, m] != point_of[m]:
                same = False
                break
        if same:
            return h
    return -1


class CandidateLabellings(NamedTuple):
    """The labellings of one frame that were found so far: H at most.

    proposals     (H, M) what anchors proposed
    labelling_of  (H,) the refined labelling that each proposal led to
    labellings    (H, M) refined labellings
    scores        (H,) nats
    votes_needed  (H,) anchors that must lead to it: one where all points are all markers and fit like a usual body, more where not
    votes         (H,) anchors that led to it
    last_vote     (H,) the last of those anchors
    """

    proposals: np.ndarray
    labelling_of: np.ndarray
    labellings: np.ndarray
    scores: np.ndarray
    votes_needed: np.ndarray
    votes: np.ndarray
    last_vote: np.ndarray


@kernel
def propose(anchors, a, body, points, found, solutions, settings, workspace, pick, pick_score, pose_of):
    """Which of an anchor's triples are worth following up: those from which the whole body is found best.

    IN   found (solutions, 3) points of the anchor's markers
    OUT  pick, pick_score (P,) the best of them and how well they explain the frame (nats); pose_of (solutions,) key pose of each
    Returns the number of picks. O(solutions K + P M n).
    """
    markers, n = body.load.shape[1], len(points)
    delta, density = np.empty(9), np.empty(solutions)
    for s in range(solutions):
        pose_of[s], density[s], distance = anchor_key_pose(anchors, a, body, points, found[s], delta)
        if distance > settings.max_anchor_distance2:
            density[s] = -np.inf
    picks, most = 0, len(pick)
    for _ in range(min(solutions, 2 * most + 2 * max(0, n - markers))):
        s = np.argmax(density)
        total = density[s]
        if total == -np.inf:
            break
        density[s] = -np.inf
        score_from_anchor(anchors, a, pose_of[s], body, points, found[s], delta, settings, workspace)
        for m in range(markers):
            top = 0.0
            for c in range(n):
                top = max(top, workspace.scores[m, c])
            total += min(top, 25.0)
        where = picks
        while where > 0 and pick_score[where - 1] < total:
            where -= 1
        if where < most:
            for p in range(min(picks, most - 1), where, -1):
                pick_score[p] = pick_score[p - 1]
                pick[p] = pick[p - 1]
            pick_score[where] = total
            pick[where] = s
            picks = min(picks + 1, most)
    return picks


@kernel
def find_labellings(points, order, solvers, anchors, body, settings, workspace, candidates, counters):
    """Let anchors propose and refine what they propose, until enough of them agree on the best labelling.

    OUT  candidates; counters, see `label_frame`. Returns the number of labellings found and the best one's place, -1 for none.
    """
    markers, n = body.load.shape[1], len(points)
    n_proposals, n_labellings, best, most_labelled, extra_run = 0, 0, -1, 0, 0
    found = np.empty((max(64, n * n), 3), dtype=np.int64)
    pose_of = np.empty(len(found), dtype=np.int64)
    pick, pick_score = np.empty(settings.proposals_per_anchor, dtype=np.int64), np.empty(settings.proposals_per_anchor)
    trial, delta = np.empty(markers, dtype=np.int64), np.empty(9)
    evaluations = np.zeros(2, dtype=np.int64)
    for a in range(len(anchors.markers)):
        labelled = count_labelled(candidates.labellings[best]) if best >= 0 else markers
        needs_more_anchors = extra_run < settings.extra_anchors and (labelled <= min(n, markers) - 2 or labelled <= 0.8 * markers)
        if best >= 0 and candidates.votes[best] >= candidates.votes_needed[best] and not needs_more_anchors:
            break
        if n_proposals + settings.proposals_per_anchor > len(candidates.proposals) or evaluations[0] > settings.max_evaluations:
            break
        if best >= 0 and candidates.votes_needed[best] < settings.max_votes_needed:
            # only an anchor that sees its markers can still agree; one that does not may find what is missing
            one, two, three = anchors.markers[a]
            hidden = candidates.labellings[best, one] < 0 or candidates.labellings[best, two] < 0 or candidates.labellings[best, three] < 0
            if hidden and not needs_more_anchors:
                continue
            if not hidden and candidates.votes[best] >= candidates.votes_needed[best]:
                continue
            extra_run += hidden
        counters[1] += 1
        solutions = search(solvers, a, points, order, settings.max_evaluations, found, evaluations)
        if solutions <= 0:
            continue
        picks = propose(anchors, a, body, points, found, solutions, settings, workspace, pick, pick_score, pose_of)
        for p in range(picks):
            if pick_score[p] < pick_score[0] - MAX_PROPOSAL_GAP:
                break
            score_from_anchor(anchors, a, pose_of[pick[p]], body, points, found[pick[p]], delta, settings, workspace)
            assign_greedily(workspace.scores, settings.first_ghost_cost, trial)
            labelled = count_labelled(trial)
            if labelled < max(most_labelled - 2, settings.min_found_share * min(n, markers)):
                continue
            most_labelled = max(most_labelled, labelled)
            start, final = _index_of(candidates.proposals, n_proposals, trial), _index_of(candidates.labellings, n_labellings, trial)
            if start >= 0:
                final = candidates.labelling_of[start]
            elif final < 0:
                candidates.proposals[n_proposals] = trial
                assign_unambiguous(workspace.scores, settings.assign_margin, trial)
                score = refine(body, pose_of[pick[p]], points, trial, settings, workspace)
                counters[2] += 1
                final = _index_of(candidates.labellings, n_labellings, trial)
                if final < 0:
                    final = n_labellings
                    labelled = count_labelled(trial)
                    candidates.labellings[final] = trial
                    candidates.scores[final] = score
                    usual = settings.usual_score * labelled - (settings.first_ghost_cost if labelled < n else 0.0)
                    candidates.votes_needed[final] = settings.max_votes_needed
                    if score >= usual and 10 * labelled >= 6 * min(n, markers):
                        candidates.votes_needed[final] = 1 if labelled == n and labelled == markers else settings.votes_needed
                    candidates.votes[final], candidates.last_vote[final] = 0, -1
                    n_labellings += 1
                candidates.labelling_of[n_proposals] = final
                n_proposals += 1
            if candidates.last_vote[final] < a:
                candidates.last_vote[final] = a
                candidates.votes[final] += 1
            if best < 0 or candidates.scores[final] > candidates.scores[best]:
                best = final
    counters[0] = evaluations[0]
    return n_labellings, best
