"""Whole recordings: clouds with their tracklets in; one labelling of all tracklets together, and how sure it is of each, out.

Some frames are looked at one by one; what the frame-wise look finds there votes for the tracklets' first labels. Then, in turn,

1. every point of every frame looked at is scored as every marker, given the labels of all other points of its frame (leave one out);
2. a tracklet's gain for a marker is the mean of its frames' scores times the number of independent looks that they amount to;
3. the labels of the greatest total gain are taken, one marker once per frame (`assignment.py`), until they no longer change.

The steps climb: each is the best answer to the others' labels, together they reach a labelling that no relabelling of tracklets improves
as long as the scores stand. Then the surely labelled tracklets teach the model this subject's own body, and the steps are taken again. At
last labels are doubted that do not go with the rest (`doubts.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from asterism.labelling.body._workspace_kernels import BodyArrays
from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.body.model import BodyModel, BodyRules
from asterism.labelling.body.subject import SubjectRules, adapt_body, tells_enough
from asterism.labelling.whole._kernels import gather, margins_of, score_frames
from asterism.labelling.whole.assignment import assign_tracklets
from asterism.labelling.whole.bodies import body_votes, find_bodies, follow_bodies
from asterism.labelling.whole.plausibility import riding_along, strange
from asterism.labelling.whole.scene import Scene, TimeRules, marker_starts, own_labels
from asterism.progress import Progress
from asterism.recording import NULL, Floats, Ints


@dataclass(frozen=True)
class Outcome:
    """Labels of the tracklets of a recording: label (J,) column of all bodies' markers one after the other, -1 for none; margin (J,) nats;
    rival (J,) the next best column; bodies: the models as adapted to the subjects; stages: labels by the way.
    """

    scene: Scene
    label: Ints
    margin: Floats
    rival: Ints
    bodies: list[BodyModel]
    stages: dict[str, Ints] = field(default_factory=dict)


def label_scene(
    labellers: Sequence[BodyLabeller],
    scene: Scene,
    rules: TimeRules,
    subject_rules: SubjectRules,
    body_rules: BodyRules,
    workers: int = 1,
    progress: Progress | None = None,
) -> Outcome:
    """Label all tracklets of a recording together; see the module's head."""
    report = progress or (lambda fraction, what: None)
    starts, bodies = marker_starts(labellers), [labeller.model for labeller in labellers]
    if len(labellers) == 1:
        votes = _votes_of_one(labellers[0], scene, rules, workers, report)
    else:
        votes = _votes_of_several(labellers, scene, rules, workers, report)
    label = assign_tracklets(votes, scene.first, scene.last)
    state = _climb(labellers, bodies, scene, label, rules)
    stages = {"votes": label, "tracks": state.label}
    for turn in range(rules.calibrate):
        if ((state.label != NULL) & (state.margin > rules.clear)).all():
            break
        report(0.7 + 0.3 * turn / rules.calibrate, "the subject's own body")
        adapted = [
            _adapted(labeller, scene, own_labels(state.label, starts, number), state, state.poses[number], rules, subject_rules, body_rules)
            for number, labeller in enumerate(labellers)
        ]
        tried = _climb(labellers, adapted, scene, state.label, rules)
        sure = (state.label != NULL) & (state.margin >= rules.sure)
        if tried.total < state.total or not np.array_equal(tried.label[sure], state.label[sure]):
            break
        state, bodies = tried, adapted
        stages[f"calibrated {turn + 1}"] = state.label
    report(1.0, "labelled")
    margin = state.margin - riding_along(scene, state.label, starts, rules)
    for number, (labeller, body) in enumerate(zip(labellers, bodies, strict=True)):
        doubted = strange(labeller, body, scene, own_labels(state.label, starts, number), rules, body_rules)
        margin[doubted] = np.minimum(margin[doubted], -rules.clear)
    return Outcome(scene, state.label, margin, state.rival, bodies, stages)


@dataclass(frozen=True)
class _State:
    """Labels that no longer change, what they rest on, and their total gain in nats."""

    label: Ints
    margin: Floats
    rival: Ints
    poses: list[Ints]
    total: float


def _votes_of_one(labeller: BodyLabeller, scene: Scene, rules: TimeRules, workers: int, report: Progress) -> Floats:
    """What the frame-wise look says for each tracklet: (J, M) nats."""
    rows, margins, _ = labeller.label_frames(
        scene.seen_xyz, scene.seen_offsets, workers, lambda done: report(0.7 * done, "looking at frames"), at_once=50
    )
    votes = np.zeros((len(scene.first), rows.shape[1]))
    frame, marker = np.nonzero(rows != NULL)
    track = scene.seen_track[scene.seen_offsets[frame] + rows[frame, marker]]
    np.add.at(votes, (track, marker), np.clip(margins[frame, marker], 0.1, rules.vote_limit))
    return votes


def _votes_of_several(labellers: Sequence[BodyLabeller], scene: Scene, rules: TimeRules, workers: int, report: Progress) -> Floats:
    """`_votes_of_one` where there are several bodies, each followed through time."""
    parts = labellers
    bodies = find_bodies(
        parts, scene.seen_xyz, scene.seen_offsets, rules.vote_limit, workers, lambda fraction, what: report(0.7 * fraction, what)
    )
    return body_votes(parts, bodies, follow_bodies(bodies, scene.seen_track), scene.seen_track)


def _climb(labellers: Sequence[BodyLabeller], bodies: Sequence[BodyModel], scene: Scene, label: Ints, rules: TimeRules) -> _State:
    """Relabel until nothing changes."""
    arrays = [labeller.body if body is labeller.model else body.arrays() for labeller, body in zip(labellers, bodies, strict=True)]
    for _ in range(rules.rounds):
        gain, poses = _gains(labellers, arrays, scene, label, rules)
        gain, found, total = _with_credit(gain, scene, labellers, rules)
        if np.array_equal(found, label):
            break
        label = found
    margin, rival = margins_of(gain, found, scene.first, scene.last, np.argsort(scene.first, kind="stable"))
    return _State(found, margin, rival, poses, total)


def _gains(
    labellers: Sequence[BodyLabeller], arrays: Sequence[BodyArrays], scene: Scene, label: Ints, rules: TimeRules
) -> tuple[Floats, list[Ints]]:
    starts = marker_starts(labellers)
    gain, poses = np.zeros((len(scene.first), starts[-1])), []
    for number, (labeller, body) in enumerate(zip(labellers, arrays, strict=True)):
        markers = body.mean.shape[1]
        scores, totals = np.empty((len(scene.seen_xyz), markers)), np.empty(len(scene.looked))
        pose = np.empty(len(scene.looked), dtype=np.int64)
        own = own_labels(label, starts, number)
        score_frames(scene.seen_xyz, scene.seen_offsets, scene.seen_track, own, body, labeller.settings, scores, totals, pose)
        sums, counts = np.zeros((len(scene.first), markers)), np.zeros(len(scene.first))
        gather(scene.seen_track, scores, rules.least_score, rules.most_score, sums, counts)
        gain[:, starts[number] : starts[number + 1]] = sums * (scene.independent / np.maximum(counts, 1.0))[:, None]
        poses.append(pose)
    return gain, poses


def _with_credit(gain: Floats, scene: Scene, labellers: Sequence[BodyLabeller], rules: TimeRules) -> tuple[Floats, Ints, float]:
    """The gains with what a tracklet earns for being a marker rather than a ghost, the best labels, and their total.

    A recording without ghosts, with short ones only, and with ghosts of any length are three explanations: where ghosts are allowed they
    cost nothing each, where they are not each costs `first_ghost`, and to allow them costs `ghosts_cost`. The best explanation counts.
    """
    full = max(labeller.settings.first_ghost_cost for labeller in labellers) * scene.independent * rules.alike
    long = (scene.last - scene.first + 1) / scene.rate >= rules.long_track
    best = -np.inf
    for allowed, costly in ((0, np.ones(len(long), dtype=np.bool_)), (1, long), (2, np.zeros(len(long), dtype=np.bool_))):
        credited = gain + (full * costly)[:, None]
        label = assign_tracklets(np.where(scene.double[:, None], 0.0, credited), scene.first, scene.last)
        taken = label != NULL
        total = credited[taken, label[taken]].sum() - (full * costly).sum() - rules.ghosts_cost * allowed
        if total > best:
            best, chosen, found = float(total), credited, label
        if not ((label == NULL) & costly).any():
            break
    return chosen, found, best


def _adapted(
    labeller: BodyLabeller,
    scene: Scene,
    label: Ints,
    state: _State,
    poses: Ints,
    rules: TimeRules,
    subject_rules: SubjectRules,
    body_rules: BodyRules,
) -> BodyModel:
    """A body model as the surely labelled tracklets show it."""
    markers = labeller.body.mean.shape[1]
    sure = (label != NULL) & (state.margin >= rules.sure)
    frames = np.full((len(scene.looked), markers, 3), np.nan)
    points = np.nonzero(sure[scene.seen_track])[0]
    frames[scene.seen_frame[points], label[scene.seen_track[points]]] = scene.seen_xyz[points]
    usable = tells_enough(frames)
    if labeller.model.within is None or not usable.any():
        return labeller.model
    apart = np.diff(scene.looked, prepend=scene.looked[0] - subject_rules.independent * scene.rate) / scene.rate
    weight = np.minimum(1.0, apart / subject_rules.independent)
    return adapt_body(labeller.model, frames[usable], poses[usable], weight[usable], subject_rules, body_rules)
