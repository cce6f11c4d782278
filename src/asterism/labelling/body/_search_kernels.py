"""Search: a frame's points and the anchors in; the distinct labellings that the anchors lead to out.

The plain twins are in `tests/twins_body.py`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.labelling.body._anchor_kernels import score_from_anchor, search_anchor
from asterism.labelling.body._assignment_kernels import assign_greedily, assign_unambiguous
from asterism.labelling.body._refine_kernels import refine_until_known
from asterism.labelling.body._score_kernels import best_pose, evidence
from asterism.labelling.body._workspace_kernels import BodyWorkspace, copy_labels, count_labelled, index_of
from asterism.labelling.features.feature_kernels import point_distances

MAX_LABELLINGS = 24
"""Labellings of one frame that are kept apart."""
MAX_PROPOSAL_GAP = 20.0
"""nats; a proposal that is farther behind its anchor's best one is not refined."""
MAX_MARKER_SCORE = 25.0
"""nats; one marker counts at most this much when an anchor's proposals are ranked."""
MAX_TWIN_GAP = 40.0
"""nats; a twin that is farther behind what was found is not refined, each pair of a missing marker and a point left over taken as
`MARKER_GAIN`. Half of it misses turned bodies with a pelvis that is off by a third, twice as much costs time and finds no more."""
MARKER_GAIN = 10.0
"""nats that one more marker gains at best, about."""
LAID_SIZES = (0.85, 1.0, 1.18)
"""Sizes in which a body is laid anew, against the mean of the training: half a step beyond what `BodyRules.size_std` holds for likely."""
LAID = 12
"""Ways in which it is laid: each size at four headings."""
LAID_REACH = 0.35
"""m; a marker of a body laid anew takes no point farther off. At half of it tall people are missed, at twice it nothing changes."""
MAX_TURNS = 4
"""How often a better twin is held against its own twins."""


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


class LikelyTriples(NamedTuple):
    """The likeliest triples of points for the three markers of an anchor, likeliest first; L at most.

    points   (L, 3)
    pose     (L,) key pose
    density  (L,) nats
    """

    points: np.ndarray
    pose: np.ndarray
    density: np.ndarray


class AnchorSearchWorkspace(NamedTuple):
    """Working arrays of one thread for the search in frames of n points: see `make_search_workspace`.

    body            BodyWorkspace
    candidates      CandidateLabellings
    distance        (n, n) m between the points
    likely          LikelyTriples
    best_triple     (P,) the triples to refine, best first
    best_score      (P,) nats
    trial           (M,) a labelling
    """

    body: BodyWorkspace
    candidates: CandidateLabellings
    distance: np.ndarray
    likely: LikelyTriples
    best_triple: np.ndarray
    best_score: np.ndarray
    trial: np.ndarray


@kernel
def make_candidates(labellings, markers):
    """Memory for so many labellings of one frame. Returns CandidateLabellings. O(H M) memory."""
    return CandidateLabellings(
        np.empty((labellings, markers), dtype=np.int64),
        np.empty(labellings, dtype=np.int64),
        np.empty((labellings, markers), dtype=np.int64),
        np.empty(labellings),
        np.empty(labellings, dtype=np.int64),
        np.empty(labellings, dtype=np.int64),
        np.empty(labellings, dtype=np.int64),
    )


@kernel
def make_search_workspace(body, candidates, proposals):
    """Working arrays for frames of as many points as the BodyWorkspace `body` is made for; proposals of one anchor.

    Returns AnchorSearchWorkspace. O(n^2) memory.

    Bounds: of an anchor's triples the likeliest are kept, two for each of its proposals and for each point that is no marker's: with more
    points than markers, chance makes likely ones.
    """
    n, markers = len(body.aligned), len(body.all_markers)
    likely = 2 * proposals + 2 * max(0, n - markers)
    return AnchorSearchWorkspace(
        body,
        candidates,
        np.empty((n, n)),
        LikelyTriples(np.empty((likely, 3), dtype=np.int64), np.empty(likely, dtype=np.int64), np.empty(likely)),
        np.empty(proposals, dtype=np.int64),
        np.empty(proposals),
        np.empty(markers, dtype=np.int64),
    )


@kernel(inline=True)
def propose(model, a, points, count, workspace):
    """Choose the triples of an anchor that are worth refining: those from which the whole body scores best.

    IN   model FrameModel; a anchor; points (n, 3) m; the first `count` of workspace.likely
    OUT  workspace.best_triple, best_score (nats). Returns how many triples were chosen. O(count M n).

    Bounds: the best of `best_triple`'s length are kept.
    """
    likely, best_triple, best_score = workspace.likely, workspace.best_triple, workspace.best_score
    chosen, most = 0, len(best_triple)
    for s in range(count):
        total = likely.density[s]
        score_from_anchor(model, a, likely.pose[s], points, likely.points[s], workspace.body)
        for m in range(model.body.load.shape[1]):
            top = 0.0
            for c in range(len(points)):
                top = max(top, workspace.body.scores[m, c])
            # Limited, so that one marker at a lucky point does not outweigh a body that fits.
            total += min(top, MAX_MARKER_SCORE)
        place = chosen
        while place > 0 and best_score[place - 1] < total:
            place -= 1
        # Insertion into the short list of the best.
        if place < most:
            for p in range(min(chosen, most - 1), place, -1):
                best_score[p] = best_score[p - 1]
                best_triple[p] = best_triple[p - 1]
            best_score[place] = total
            best_triple[place] = s
            chosen = min(chosen + 1, most)
    return chosen


@kernel(inline=True)
def find_labellings(model, points, workspace, counters):
    """Let anchors propose labellings and refine them, until enough anchors have led to the best one.

    IN   model FrameModel; points (n, 3) m, z up; workspace SearchWorkspace for n points
    OUT  workspace.candidates; counters (4,), the first three of `FrameLabelling`, the last two added to
    Returns the number of labellings found and the place of the best one, -1 for none.
    O(anchors' search + labellings * (M r^2 + r^3 + M n)).

    Bounds: an anchor is run only while there is room for all that it may propose, and a proposal leads to one labelling.
    """
    anchors, body, settings, candidates, trial = model.anchors, model.body, model.settings, workspace.candidates, workspace.trial
    markers, n = body.load.shape[1], len(points)
    n_proposals, n_labellings, best, most_labelled, extra_run = 0, 0, -1, 0, 0
    evaluations = np.zeros(1, dtype=np.int64)
    point_distances(points, n, workspace.distance)
    for a in range(len(anchors.markers)):
        labelled = count_labelled(candidates.labellings[best]) if best >= 0 else markers
        # Many markers without a point may be hidden, or this labelling may be of a part of the body only.
        needs_more_anchors = extra_run < settings.extra_anchors and (labelled <= min(n, markers) - 2 or labelled <= 0.8 * markers)
        if best >= 0 and candidates.votes[best] >= candidates.votes_needed[best] and not needs_more_anchors:
            break
        # Before the anchor, so that all it may propose has room; or the effort is spent.
        if n_proposals + settings.proposals_per_anchor > len(candidates.proposals) or evaluations[0] > settings.max_evaluations:
            break
        if best >= 0 and candidates.votes_needed[best] < settings.max_votes_needed:
            # only an anchor all of whose markers are labelled can vote for the best labelling; any other one may find what is missing
            one, two, three = anchors.markers[a]
            hidden = candidates.labellings[best, one] < 0 or candidates.labellings[best, two] < 0 or candidates.labellings[best, three] < 0
            if hidden and not needs_more_anchors:
                continue
            if not hidden and candidates.votes[best] >= candidates.votes_needed[best]:
                continue
            extra_run += hidden
        counters[1] += 1
        # Minus one where the search gave up: then nothing may be concluded from this anchor.
        likely = search_anchor(model, a, points, workspace, evaluations)
        if likely <= 0:
            continue
        chosen = propose(model, a, points, likely, workspace)
        for p in range(chosen):
            # Farther behind its anchor's best one than labels elsewhere can make up for.
            if workspace.best_score[p] < workspace.best_score[0] - MAX_PROPOSAL_GAP:
                break
            triple = workspace.best_triple[p]
            k = workspace.likely.pose[triple]
            score_from_anchor(model, a, k, points, workspace.likely.points[triple], workspace.body)
            assign_greedily(workspace.body.scores, settings.first_ghost_cost, trial)
            labelled = count_labelled(trial)
            # It finds much less than another proposal did.
            if labelled < max(most_labelled - 2, settings.min_found_share * min(n, markers)):
                continue
            most_labelled = max(most_labelled, labelled)
            # Known already, before or after refinement: its vote counts, and no work is done twice.
            proposal, final = index_of(candidates.proposals, n_proposals, trial), index_of(candidates.labellings, n_labellings, trial)
            if proposal >= 0:
                final = candidates.labelling_of[proposal]
            elif final < 0:
                copy_labels(trial, candidates.proposals[n_proposals])
                assign_unambiguous(workspace.body.scores, settings.assign_margin, trial)
                known = candidates.labellings
                score, final = refine_until_known(body, k, points, trial, known, n_labellings, -np.inf, 0.0, settings, workspace.body)
                counters[2] += 1
                if final < 0:
                    final = index_of(candidates.labellings, n_labellings, trial)
                if final < 0:
                    final = n_labellings
                    labelled = count_labelled(trial)
                    copy_labels(trial, candidates.labellings[final])
                    candidates.scores[final] = score
                    usual = settings.usual_score * labelled - (settings.first_ghost_cost if labelled < n else 0.0)
                    candidates.votes_needed[final] = settings.max_votes_needed
                    # A labelling that fits as usual needs fewer votes; one of everything needs none but its own.
                    if score >= usual and 10 * labelled >= 6 * min(n, markers):
                        candidates.votes_needed[final] = 1 if labelled == n and labelled == markers else settings.votes_needed
                    candidates.votes[final], candidates.last_vote[final] = 0, -1
                    n_labellings += 1
                candidates.labelling_of[n_proposals] = final
                n_proposals += 1
            # One vote for each anchor, however many of its proposals lead there.
            if candidates.last_vote[final] < a:
                candidates.last_vote[final] = a
                candidates.votes[final] += 1
            if best < 0 or candidates.scores[final] > candidates.scores[best]:
                best = final
    counters[0] = evaluations[0]
    return n_labellings, best


@kernel
def lay_body(mean, turn, size, aligned, scores, trial):
    """Lay a mean body, turned about the vertical and of another size, onto placed points, and give each marker the point next to it.

    The middles come together, and what is lowest; so a body is found whose every marker has a neighbour's label, as of a person much
    taller than those of the training.
    IN  mean (M, 3) m; turn rad; size, factor; aligned (n, 3) m
    OUT scores (M, n), 0 at `LAID_REACH`; trial (M,), -1 for none. O(M n).
    """
    markers, n = scores.shape
    cos, sin = size * math.cos(turn), size * math.sin(turn)
    x0, y0, low, px, py, p_low = 0.0, 0.0, np.inf, 0.0, 0.0, np.inf
    for m in range(markers):
        x0 += mean[m, 0] / markers
        y0 += mean[m, 1] / markers
        low = min(low, size * mean[m, 2])
    for c in range(n):
        px += aligned[c, 0] / n
        py += aligned[c, 1] / n
        p_low = min(p_low, aligned[c, 2])
    for m in range(markers):
        x, y = mean[m, 0] - x0, mean[m, 1] - y0
        at_x, at_y, at_z = px + cos * x - sin * y, py + sin * x + cos * y, size * mean[m, 2] + p_low - low
        for c in range(n):
            dx, dy, dz = aligned[c, 0] - at_x, aligned[c, 1] - at_y, aligned[c, 2] - at_z
            scores[m, c] = 1.0 - (dx * dx + dy * dy + dz * dz) / (LAID_REACH * LAID_REACH)
    assign_greedily(scores, 0.0, trial)


@kernel
def twin_at(w, twins, mean, found, aligned, scores, trial):
    """One of the labellings that a found one is held against: first its twins, then the body laid anew, see `lay_body`.

    IN  w, from 0 to `len(twins) + LAID`, that excluded; twins (W, M), see `twins_of`; mean (M, 3) m, the body; found (M,); aligned (n, 3)
        m, the points as `found` places them
    OUT trial (M,), -1 for none; scores (M, n) is overwritten. O(M), O(M n) for one laid anew.
    """
    count = len(twins)
    if w < count:
        for m in range(len(found)):
            trial[m] = found[twins[w, m]] if twins[w, m] >= 0 else -1
    else:
        lay_body(mean, 0.5 * math.pi * ((w - count) % 4), LAID_SIZES[(w - count) // 4], aligned, scores, trial)


@kernel
def add_twins(model, points, workspace, count, best, counters):
    """Hold the best labelling against its twins, see `twin_at`; each is completed and refined, and any better one held against its own.

    IN     model FrameModel; points (n, 3) m, z up; workspace SearchWorkspace for n points, of whose candidates the first `count` are found,
           `best` the best one of them, with a finite score
    IN/OUT workspace.candidates; where all of its room is taken, the worst one makes way; counters (4,), the third of which is added to
    Returns the number of labellings and the place of the best one. O(W K (M r^2 + r^3)), and one `refine` for each twin that comes near.

    Bounds: a labelling found where all rows are taken is written over the worst row, so `count` stays within them.
    """
    body, settings, candidates, trial = model.body, model.settings, workspace.candidates, workspace.trial
    markers, n, room = body.load.shape[1], len(points), len(candidates.labellings)
    for _ in range(MAX_TURNS):
        found = candidates.labellings[best]
        top, open_pairs = candidates.scores[best], min(markers, n) - count_labelled(candidates.labellings[best])
        # where points are left over beside missing markers, and what is labelled fits poorly, the body may be another one altogether
        is_poor = top < settings.usual_score * (min(markers, n) - open_pairs) - settings.first_ghost_cost
        lays = open_pairs >= 2 and (is_poor or 10 * open_pairs > 3 * markers)
        workspace.body.outlier[:] = False
        pose, _ = best_pose(body, points, found, settings, workspace.body)
        evidence(body, pose, points, found, settings, workspace.body)
        aligned = workspace.body.aligned.copy()
        better = False
        for w in range(len(model.twins) + (LAID if lays else 0)):
            twin_at(w, model.twins, body.mean[pose], found, aligned, workspace.body.scores, trial)
            labelled = count_labelled(trial)
            # Too little of a labelling, or one that was found already.
            if labelled < 3 or index_of(candidates.labellings, count, trial) >= 0:
                continue
            workspace.body.outlier[:] = False
            # Another pose may fit the twin better: a body turned round bends the other way.
            k, score = best_pose(body, points, trial, settings, workspace.body)
            counters[2] += 1
            # Even if each marker without a point earned what a good label does, it would stay behind.
            if score + MARKER_GAIN * (min(markers, n) - labelled) < top - MAX_TWIN_GAP:
                continue
            known = candidates.labellings
            least = top - MAX_TWIN_GAP
            score, row = refine_until_known(body, k, points, trial, known, count, least, MARKER_GAIN, settings, workspace.body)
            hopeless = score + MARKER_GAIN * (min(markers, n) - count_labelled(trial)) < least
            if row >= 0 or hopeless or index_of(candidates.labellings, count, trial) >= 0:
                continue
            place = count
            if count == room:
                # The worst one makes way, and never the best.
                place = 1 if best == 0 else 0
                for h in range(room):
                    if h != best and candidates.scores[h] < candidates.scores[place]:
                        place = h
            count = min(count + 1, room)
            copy_labels(trial, candidates.labellings[place])
            candidates.scores[place] = score
            candidates.votes[place], candidates.last_vote[place] = candidates.votes[best], candidates.last_vote[best]
            candidates.votes_needed[place] = candidates.votes_needed[best]
            # Better: its own twins come next.
            if score > top + 1e-6:
                best, better = place, True
                break
        if not better:
            break
    return count, best
