"""Evidence of the tracks of one frame in; what each track says for each marker, and by how much each label is ahead, out."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel


@kernel
def add_up_evidence(table, frames, rows, independent, max_frames, totals, limited):
    """What all frames of the tracks in some rows say for each marker: as much as so many independent frames say, at most.

    What a study said, and what is excluded, counts in full beside them.
    IN  table (evidence, prior, excluded), each (R, M) nats; frames (R,) that the evidence rests on; rows (n,);
        independent share of an independent frame that each further frame counts as; max_frames independent frames, for `limited`
    OUT totals (n, M) nats, without a limit; limited (n, M) nats
    O(n M).
    """
    evidence, prior, excluded = table
    for p in range(len(rows)):
        row = rows[p]
        count = frames[row]
        counted = 1.0 + independent * max(count - 1.0, 0.0)
        share, limited_share = counted / max(count, 1.0), min(counted, max_frames) / max(count, 1.0)
        for m in range(evidence.shape[1]):
            totals[p, m] = evidence[row, m] * share + prior[row, m] - excluded[row, m]
            limited[p, m] = evidence[row, m] * limited_share + prior[row, m] - excluded[row, m]


@kernel
def margins_of_frame(scores, limited, counts, point_of, margin):
    """By how many nats each marker's point beats the nearest other labelling: none, a free point, a swap, another marker taking the point.

    A second frame hardly helps to distinguish a marker from a ghost that moves with the body; it does help to distinguish two markers.
    For a marker without a point: minus the nats that its best free point lacks, not above 0.
    IN  scores (n, M) nats of all frames of each point's track; limited (n, M) nats of few independent ones;
        counts (n,) bool, which points are there at all, all labelled ones among them; point_of (M,), -1 for none
    OUT margin (M,) nats
    O(n M + M^2).
    """
    points, markers = scores.shape
    free = counts.copy()
    for m in range(markers):
        if point_of[m] >= 0:
            free[point_of[m]] = False
    best_free = np.full(markers, -np.inf)
    for p in range(points):
        if free[p]:
            for m in range(markers):
                best_free[m] = max(best_free[m], limited[p, m])
    for m in range(markers):
        p = point_of[m]
        if p < 0:
            margin[m] = min(best_free[m], 0.0)
            continue
        margin[m] = min(limited[p, m], limited[p, m] - max(best_free[m], 0.0))
        for other in range(markers):
            if other == m:
                continue
            # What the other marker gains by this point ...
            cost = scores[p, m] - scores[p, other]
            q = point_of[other]
            if q >= 0:
                # ... and loses with its own, which this marker may take.
                cost += scores[q, other] - max(scores[q, m], 0.0)
            margin[m] = min(margin[m], cost)
