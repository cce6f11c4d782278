"""A labelled scene held against its twins: labels of tracklets in; better ones, and how far ahead of the twins they are, out.

Single frames that were labelled turned round agree with one another, and so do all their tracklets. So in a few frames the labels found are
exchanged for those of each twin of the body (`body/twins.py`), completed with the points that are left over, refined, and compared by the
joint evidence of the whole frame, by the body of people at large. A person stands in one posture, and wears the markers in one way: what
one frame says for the labels against a twin, the next one repeats. So a twin that is behind by few nats a frame limits the confidence,
however many frames there are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import expit

from asterism.labelling.body._search_kernels import LAID
from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.whole._twin_kernels import TwinScores, score_twins
from asterism.labelling.whole.scene import RecordingScene, labels_of_body, marker_offsets, score_scene, with_fewer_samples
from asterism.labelling.whole.settings import RecordingLabellingSettings, TwinRules
from asterism.recording import NULL, Floats, Ints


def twin_limits(lead: Floats, label: Ints, rules: TwinRules) -> Floats:
    """What labels (P,), columns of all bodies, may be as certain as, by the lead (L,) of each column: (P,)."""
    return np.append(expit(rules.prior + lead / rules.scale), 1.0)[label]


def joint_evidence(labellers: Sequence[BodyLabeller], scene: RecordingScene, label: Ints) -> float:
    """What the labels (J,) explain of a frame, the mean over the sampled ones in nats, by the bodies of people at large."""
    offsets, total = marker_offsets(labellers), 0.0
    for number, labeller in enumerate(labellers):
        totals = score_scene(scene, labels_of_body(label, offsets, number), labeller.body, labeller.settings).totals
        # a frame with fewer than three labels explains nothing
        total += float(np.where(np.isnan(totals), -labeller.settings.first_ghost_cost, totals).mean()) if len(totals) else 0.0
    return total


def hold_against_twins(
    labellers: Sequence[BodyLabeller],
    scene: RecordingScene,
    label: Ints,
    relabel: Callable[[Ints], Ints],
    rules: TwinRules,
    settings: RecordingLabellingSettings,
) -> tuple[Ints, Floats]:
    """Hold the labels (J,) of a scene, columns of all bodies, against the twins of each body.

    relabel: labels the scene from given labels (J,) on until they no longer change. Gives labels (J,), those given where no twin is better,
    and by how many nats a frame each column (L,) is ahead of the best twin that labels most of its points otherwise, infinite where there
    is none. O(frames) calls of `score_twins`, and one `relabel` where a twin is better.
    """
    few, offsets = with_fewer_samples(scene, rules.frames, settings), marker_offsets(labellers)
    lead = np.full(offsets[-1], np.inf)
    for number, labeller in enumerate(labellers):
        columns = slice(offsets[number], offsets[number + 1])
        for turn in range(rules.rounds + 1):
            lead[columns], better = _lead_over_twins(labeller, few, label, offsets, number, rules)
            if better is None or turn == rules.rounds:
                break
            other = relabel(better)
            if joint_evidence(labellers, few, other) <= joint_evidence(labellers, few, label):
                break
            label = other
    return label, np.maximum(lead, 0.0)


def _lead_over_twins(
    labeller: BodyLabeller, few: RecordingScene, label: Ints, offsets: Ints, number: int, rules: TwinRules
) -> tuple[Floats, Ints | None]:
    """The lead (M,) of the labels of the body with this number over its twins, in nats a frame.

    And the labels (J,) of the best twin that is ahead, None where there is none.
    """
    own = labels_of_body(label, offsets, number)
    # the points of other bodies are theirs
    points = np.nonzero((label == NULL)[few.sampled_track] | (own != NULL)[few.sampled_track])[0]
    frames, markers = len(few.sampled_frames), int(offsets[number + 1] - offsets[number])
    begins = np.concatenate([[0], np.cumsum(np.bincount(few.sampled_frame[points], minlength=frames))]).astype(np.int64)
    track = few.sampled_track[points]
    lead, point_of = compare_with_twins(labeller, np.ascontiguousarray(few.sampled_xyz[points]), begins, track, own, rules)
    if point_of is None:
        return lead, None
    # each tracklet becomes what the twin says of it in most of the frames
    votes = np.zeros((len(label), markers + 1), dtype=np.int64)
    votes[:, markers] = np.bincount(track, minlength=len(label))
    frame, marker = np.nonzero(point_of != NULL)
    np.add.at(votes, (track[begins[frame] + point_of[frame, marker]], marker), 2)
    given, mine, better = votes.argmax(axis=1), (own != NULL) | (label == NULL), label.copy()
    better[mine] = np.where(given == markers, NULL, given + offsets[number])[mine]
    return lead, better


def compare_with_twins(
    labeller: BodyLabeller, xyz: Floats, offsets: Ints, track: Ints, label: Ints, rules: TwinRules
) -> tuple[Floats, Ints | None]:
    """Hold labels of one body in some frames against its twins.

    xyz (P, 3) m, z up; offsets (E + 1,) where each frame's points begin; track (P,) tracklet of each point; label (J,) marker of each
    tracklet, -1 for none. Gives by how many nats a frame each marker (M,) is ahead of the best twin that has another point for it in most
    frames, infinite where there is none; and the points (E, M) of the best twin that is ahead of the labels, None where there is none.
    """
    frames, markers = len(offsets) - 1, labeller.body.mean.shape[1]
    shape = (len(labeller.twins) + LAID + 1, frames)
    out = TwinScores(np.empty(shape), np.empty((*shape, markers), dtype=np.int64))
    score_twins(xyz, offsets, track, label, labeller.twins, labeller.body, labeller.settings, rules.gap, rules.marker_gain, out)
    ahead = out.scores[-1] - out.scores[:-1]
    seen = ~np.isnan(ahead)
    behind = np.where(seen, ahead, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    behind[~seen.any(axis=1)] = np.inf
    # a marker is labelled otherwise where its point is another one in most of the frames that show it
    shown = (out.point_of[-1] != NULL)[None] & seen[:, :, None]
    differs = 2 * (shown & (out.point_of[:-1] != out.point_of[-1])).sum(axis=1) > shown.sum(axis=1)
    lead = np.where(differs, behind[:, None], np.inf).min(axis=0)
    best = int(np.argmin(behind))
    if behind[best] >= 0.0:
        return lead, None
    return lead, np.where(seen[best][:, None], out.point_of[best], NULL)
