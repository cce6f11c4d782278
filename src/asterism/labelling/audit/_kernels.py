"""Kernels of the audit: how well an exchange of two markers explains their paths, or a frame. Twins: tests/twins_audit.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.labelling.body._score_kernels import best_pose, evidence, rescore
from asterism.labelling.body._workspace_kernels import make_body_workspace

DEGREES_OF_FREEDOM = 3.0
"""Of the Student t density of a step, so that impacts and other sudden steps cost little."""


@kernel
def step_log_density(before, at, after, early, late, scale):
    """Log density (nats, up to a constant) of a step: the distance of a point from its prediction at constant velocity from the last two.

    IN  before, at, after (3,) m; early, late frames between them; scale m, usual prediction error where both are 1
    OUT nats
    O(1).
    """
    ratio = late / early
    square = 0.0
    for i in range(3):
        error = after[i] - at[i] - ratio * (at[i] - before[i])
        square += error * error
    # A gap in the path lets the prediction drift with the square of the time that it bridges.
    usual = scale * 0.5 * late * (late + early)
    return -0.5 * (DEGREES_OF_FREEDOM + 3.0) * math.log(1.0 + square / (DEGREES_OF_FREEDOM * usual * usual))


@kernel
def path_score(paths, times, scales, emission, switch, states):
    """Log likelihood (nats, up to a constant) of two paths whose points are exchanged in the frames that `states` marks.

    IN  paths (n, 2, 3) m; times (n,) frames, rising; scales (2,) m; emission (n,) nats for each exchanged frame;
        switch nats for each change; states (n,) 0 or 1
    OUT nats
    O(n).
    """
    score = 0.0
    for i in range(len(times)):
        score += states[i] * emission[i]
        if i >= 1 and states[i] != states[i - 1]:
            score -= switch
        # Two frames before are needed for a prediction: the first step that can be judged is the third sample.
        if i >= 2:
            early, late = times[i - 1] - times[i - 2], times[i] - times[i - 1]
            for who in range(2):
                # An exchanged state swaps the two columns, which is what the exclusive or with the state does.
                one, two, three = paths[i - 2, who ^ states[i - 2]], paths[i - 1, who ^ states[i - 1]], paths[i, who ^ states[i]]
                score += step_log_density(one, two, three, early, late, scales[who])
    return score


@kernel
def exchange_path(paths, times, scales, emission, switch, states):
    """The frames in which two markers are most likely exchanged: the best path of a two-state chain (Viterbi over pairs of frames).

    IN  paths, times, scales, emission, switch as in `path_score`
    OUT states (n,) 0 or 1; returned: nats by which they are more likely than no exchange, 0 where no exchange is most likely
    O(8 n), 4 n bytes.
    """
    n = len(times)
    states[:] = 0
    if n < 3:
        return 0.0
    # score[2 * s + r]: best so far with state s in the frame before last and r in the last
    score, updated = np.empty(4), np.empty(4)
    origin = np.zeros((n, 4), dtype=np.int8)
    for s in range(2):
        for r in range(2):
            score[2 * s + r] = s * emission[0] + r * emission[1] - (switch if s != r else 0.0)
    never = 0.0
    for i in range(2, n):
        early, late = times[i - 1] - times[i - 2], times[i] - times[i - 1]
        updated[:] = -np.inf
        for q in range(2):
            for s in range(2):
                for r in range(2):
                    step = 0.0
                    for who in range(2):
                        step += step_log_density(paths[i - 2, who ^ q], paths[i - 1, who ^ s], paths[i, who ^ r], early, late, scales[who])
                    # The path that never leaves the first state is the hypothesis to beat: all labels right.
                    if q == 0 and s == 0 and r == 0:
                        never += step
                    step += score[2 * q + s] + r * emission[i] - (switch if s != r else 0.0)
                    if step > updated[2 * s + r]:
                        updated[2 * s + r] = step
                        origin[i, 2 * s + r] = q
        score[:] = updated
    best = int(np.argmax(score))
    top = score[best]
    # Only what beats "no exchange at all" counts, so that a tie keeps the labels as they are.
    if top <= never:
        return 0.0
    # Walk the best path back: each entry of `origin` names the state two frames before.
    for i in range(n - 1, 1, -1):
        states[i] = best & 1
        best = 2 * origin[i, best] + (best >> 1)
    states[1] = best & 1
    states[0] = best >> 1
    return top - never


@kernel
def all_exchanges(positions, scales, emission, switch, pairs, gains):
    """The gain of `exchange_path` for many pairs of markers, over the frames that show both.

    The larger scale of a pair counts for both markers, so that an exchange up to a frame and one from there on gain the same.

    IN  positions (T, M, 3) m, NaN where missing; scales (M,) m; emission (P, T) nats; pairs (P, 2)
    OUT gains (P,) nats
    O(P T).

    Bounds: a row for each frame that shows both: T.
    """
    frames = len(positions)
    paths, times, states = np.empty((frames, 2, 3)), np.empty(frames), np.empty(frames, dtype=np.int64)
    pair_emission, pair_scales = np.empty(frames), np.empty(2)
    for p in range(len(pairs)):
        a, b = pairs[p]
        n = 0
        for t in range(frames):
            # Gaps are bridged: only frames that show both can tell.
            if not (np.isnan(positions[t, a, 0]) or np.isnan(positions[t, b, 0])):
                paths[n, 0], paths[n, 1], times[n], pair_emission[n] = positions[t, a], positions[t, b], t, emission[p, t]
                n += 1
        # With unequal scales an exchange would gain by moving the rougher path to the rougher marker.
        pair_scales[:] = max(scales[a], scales[b])
        gains[p] = exchange_path(paths[:n], times[:n], pair_scales, pair_emission[:n], switch, states[:n])


@kernel
def exchange_gains(frames, body, settings, pairs, least, most, gains, own_scores):
    """Nats by which each frame is explained better with two markers exchanged.

    IN   frames (N, M, 3) m, z up, NaN where missing; body BodyArrays; settings FrameSettings; pairs (P, 2);
         least nats: an exchange that loses more by the leave-one-out scores is not computed exactly; most nats, the bound of a gain
    OUT  gains (P, N), within -most and most, 0 where a marker is missing; own_scores (N, M) each point's score as the marker that it
         is labelled, given all others, NaN where missing
    O(N (M r^2 + r^3 + P)) and O(M r^2 + r^3) for each exchange computed exactly.

    Bounds: a point for each marker that is there: M.
    """
    markers, latents = body.load.shape[1], body.load.shape[3]
    rows, trial = np.empty(markers, dtype=np.int64), np.empty(markers, dtype=np.int64)
    for t in range(len(frames)):
        n = 0
        points = np.empty((markers, 3))
        for m in range(markers):
            rows[m] = -1
            if not np.isnan(frames[t, m, 0]):
                points[n] = frames[t, m]
                rows[m] = n
                n += 1
        gains[:, t] = 0.0
        own_scores[t] = np.nan
        # Fewer than four points leave the pose open, so that any exchange would fit.
        if n < 4:
            continue
        workspace = make_body_workspace(n, markers, latents)
        k, _ = best_pose(body, points[:n], rows, settings, workspace)
        rescore(body, k, points[:n], rows, settings, workspace)
        scores = workspace.scores.copy()
        # Scores are kept even where no pair is computed exactly: they tell misplaced markers.
        for m in range(markers):
            if rows[m] >= 0:
                own_scores[t, m] = scores[m, rows[m]]
        workspace.outlier[:] = False
        top = -np.inf
        for p in range(len(pairs)):
            a, b = pairs[p]
            if rows[a] < 0 or rows[b] < 0:
                continue
            # The cheap estimate by leave-one-out scores spares the exact evidence for pairs that cannot gain.
            estimate = scores[a, rows[b]] + scores[b, rows[a]] - max(scores[a, rows[a]], -most) - max(scores[b, rows[b]], -most)
            gain = -most
            if estimate > -least:
                # The evidence as labelled is needed once per frame, and only where some pair is a candidate.
                if top == -np.inf:
                    top = evidence(body, k, points[:n], rows, settings, workspace)
                trial[:] = rows
                trial[a], trial[b] = rows[b], rows[a]
                gain = evidence(body, k, points[:n], trial, settings, workspace) - top
            gains[p, t] = min(max(gain, -most), most)
