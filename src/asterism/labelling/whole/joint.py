"""Whole recordings: clouds with their tracklets in; one labelling of all tracklets together, with margins, out.

Some frames are sampled and labelled singly; the labels found there vote for the tracklets' first labels. Then, in turn,

1. every point of every sampled frame is scored as every marker, given the labels of all other points of its frame (leave one out);
2. a tracklet's gain for a marker is the mean of its points' scores times the number of independent frames that they amount to;
3. the labels of the greatest total gain are taken, one marker once per frame (`assignment.py`), until they no longer change.

This is a coordinate ascent: each step gives the best labels for the scores that the last labels gave. Then tracklets with large margins
adapt the model to this subject's own body, and the steps are taken again. Finally, labels that do not agree with the others lose margin
(`plausibility.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest

import numpy as np

from asterism.labelling.body.labeller import MOST_EVALUATIONS, BodyLabeller
from asterism.labelling.body.model import BodyModel, BodyRules
from asterism.labelling.body.subject import SubjectRules, adapt_body, shows_enough
from asterism.labelling.whole._kernels import FrameScores, margins_of, overlaps, rivals_weight, sum_scores
from asterism.labelling.whole.assignment import Assignment, assign_tracklets
from asterism.labelling.whole.bodies import find_bodies, follow_bodies, votes_of_bodies
from asterism.labelling.whole.plausibility import compare_with_training, ghost_penalty
from asterism.labelling.whole.scene import RecordingScene, SceneScores, labels_of_body, marker_offsets, placed_points
from asterism.labelling.whole.settings import RecordingLabellingSettings
from asterism.labelling.whole.turned import HeldLabels, hold_against_twins
from asterism.labelling.whole.upright import turned, upright_turns
from asterism.progress import Progress
from asterism.recording import NULL, Floats, Ints

CROWDED_SEARCH = {"votes_needed": 1, "max_votes_needed": 1, "extra_anchors": 1, "proposals_per_anchor": 2}
"""The search for the first votes where frames show many ghosts (`RecordingLabellingSettings.crowded`): many frames vote, and labelling them
together corrects what a short search of one misses. Chosen on six gait subjects in clutter."""


@dataclass(frozen=True)
class SceneLabelling:
    """Labels of the J tracklets of a recording.

    scene   the recording
    label   (J,) column among the markers of all bodies, one body after the other, -1 for none
    margin  (J,) nats
    rival   (J,) the second best column
    bodies  the models as adapted to the subjects
    total   nats, the total gain of the labels
    by_body (J,) nats, the margin before labels whose distances are off lost theirs
    stages  labels (J,) after each stage, by name
    rough   number of tracklets that could not all be compared exactly, see `assignment.py`
    held    how far the labels are ahead of the body's twins and of exchanges, see `turned.py`; None where not compared
    turns   (E, 3, 3) rotations that set the body upright in each sampled frame, see `upright.py`; None where none is turned
    """

    scene: RecordingScene
    label: Ints
    margin: Floats
    rival: Ints
    bodies: list[BodyModel]
    total: float
    by_body: Floats
    stages: dict[str, Ints] = field(default_factory=dict)
    turns: Floats | None = None
    rough: int = 0
    held: HeldLabels | None = None

    def turns_of(self, frames: int) -> Floats | None:
        """The rotation of each of so many frames of the recording (T, 3, 3), the identity for those not sampled; None as `turns`."""
        if self.turns is None:
            return None
        found = np.tile(np.eye(3), (frames, 1, 1))
        found[self.scene.sampled_frames] = self.turns
        return found


@dataclass(frozen=True)
class SceneWork:
    """How a scene is worked on: threads, who is told how far it is, and arrays of an earlier scene to be written over.

    arrays: scores by body that nobody needs any more; they are written over again by the next call that is given this list
    """

    workers: int = 1
    progress: Progress | None = None
    arrays: list[FrameScores] = field(default_factory=list)


def label_scene(
    labellers: Sequence[BodyLabeller],
    scene: RecordingScene,
    rules: RecordingLabellingSettings,
    subject_rules: SubjectRules,
    body_rules: BodyRules,
    work: SceneWork | None = None,
    start: Ints | None = None,
) -> SceneLabelling:
    """Label all tracklets of a recording together; see the module's head.

    start: labels (J,) to begin with, -1 for none, instead of what the sampled frames vote for.
    """
    work = work or SceneWork()
    workers, arrays = work.workers, work.arrays
    report = work.progress or (lambda fraction, what: None)
    bodies = [labeller.model for labeller in labellers]
    if start is not None:
        label = start
    elif len(labellers) == 1:
        label = assign_tracklets(_votes_of_one(labellers[0], scene, rules, workers, report), scene.first, scene.last).label
    else:
        label = assign_tracklets(_votes_of_several(labellers, scene, rules, workers, report), scene.first, scene.last).label
    upright, state = scene, _coordinate_ascent(labellers, _scores(labellers, bodies, scene, arrays), label, rules)
    stages = {"votes": label, "tracks": state.label}
    turns = upright_turns(labellers[0], state.scores[0], state.label, rules) if len(labellers) == 1 else None
    if turns is not None:
        upright = replace(scene, sampled_xyz=turned(scene.sampled_xyz, scene.sampled_frame, turns))
        scores = state.scores[0].with_frames(upright, (turns != np.eye(3)).any(axis=(1, 2)))
        state = _coordinate_ascent(labellers, [scores], state.label, rules)
        stages["upright"] = state.label

    def relabel(start: Ints, without: Ints) -> Ints:
        return _coordinate_ascent(labellers, state.scores, start, rules, without=without).label

    held = hold_against_twins(labellers, upright, state.label, relabel, rules.twins, rules)
    state = _coordinate_ascent(labellers, state.scores, held.label, rules, held.excess)
    stages["twin"] = state.label
    for turn in range(rules.adapt_rounds):
        if ((state.label != NULL) & (state.margin > rules.no_adapt_margin)).all():
            break
        report(0.7 + 0.3 * turn / rules.adapt_rounds, "the subject's own body")
        adapted = [
            _adapted_body(labeller, number, upright, state, rules, subject_rules, body_rules) for number, labeller in enumerate(labellers)
        ]
        arrays[:] = state.arrays  # one set for all: memory that is new costs as much as the scores
        trial = _coordinate_ascent(labellers, _scores(labellers, adapted, upright, arrays), state.label, rules, held.excess)
        firm = (state.label != NULL) & (state.margin >= rules.adapt_margin)
        if trial.total < state.total or not np.array_equal(trial.label[firm], state.label[firm]):
            state = replace(state, scores=_scores(labellers, bodies, upright, arrays))
            break
        state, bodies = trial, adapted
        stages[f"adapted {turn + 1}"] = state.label
    report(1.0, "labelled")
    found = _judged(labellers, bodies, upright, state, rules, body_rules)
    arrays[:] = state.arrays
    return replace(found, scene=scene, stages=stages, turns=turns, held=held)


def _judged(
    labellers: Sequence[BodyLabeller],
    bodies: Sequence[BodyModel],
    scene: RecordingScene,
    state: _JointLabels,
    rules: RecordingLabellingSettings,
    body_rules: BodyRules,
) -> SceneLabelling:
    """The labels; those that do not agree with the others have lost margin."""
    by_body = state.margin - ghost_penalty(labellers, bodies, scene, state.label, rules)
    margin = by_body.copy()
    for number, labeller in enumerate(labellers):
        own = labels_of_body(state.label, state.offsets, number)
        scores = state.scores[number].of(own).scores
        doubtful = (own != NULL) & compare_with_training(labeller, scores, scene, own, rules, body_rules).are_off(rules)
        margin[doubtful] = np.minimum(margin[doubtful], -rules.no_adapt_margin)
    return SceneLabelling(scene, state.label, margin, state.rival, list(bodies), state.total, by_body, rough=state.rough)


@dataclass(frozen=True)
class _JointLabels:
    """Labels that no longer change (J,), columns of all bodies.

    margin, rival  (J,) nats and columns
    offsets        where each body's markers begin among the columns
    poses          key pose of each sampled frame (E,), by body
    total          their total gain in nats
    scores         what the scene scores by each body
    rough          tracklets that could not all be compared exactly
    """

    label: Ints
    margin: Floats
    rival: Ints
    offsets: Ints
    poses: list[Ints]
    total: float
    scores: list[SceneScores]
    rough: int

    @property
    def arrays(self) -> list[FrameScores]:
        """What the scores are written to."""
        return [scores.scored for scores in self.scores if scores.scored is not None]


def _votes_of_one(
    labeller: BodyLabeller, scene: RecordingScene, rules: RecordingLabellingSettings, workers: int, report: Progress
) -> Floats:
    """The votes of the sampled frames, labelled singly, for each tracklet: (J, M) nats."""
    crowd = np.diff(scene.sampled_offsets).mean() / labeller.body.mean.shape[1] if len(scene.sampled_frames) else 0.0
    search = {"max_evaluations": MOST_EVALUATIONS, **(CROWDED_SEARCH if crowd > rules.crowded else {})}
    labeller = replace(labeller, settings=labeller.settings._replace(**search))
    frames = voting_frames(scene, rules)
    points = np.nonzero(np.isin(scene.sampled_frame, frames))[0]
    offsets = np.concatenate([[0], np.cumsum(np.diff(scene.sampled_offsets)[frames])]).astype(np.int64)
    point_of, margins, _ = labeller.label_frames(
        np.ascontiguousarray(scene.sampled_xyz[points]),
        offsets,
        workers,
        lambda done, _: report(0.7 * done, "labelling single frames"),
        at_once=50,
    )
    votes = np.zeros((len(scene.first), point_of.shape[1]))
    frame, marker = np.nonzero(point_of != NULL)
    track = scene.sampled_track[points[offsets[frame] + point_of[frame, marker]]]
    np.add.at(votes, (track, marker), np.clip(margins[frame, marker], 0.1, rules.max_vote))
    return votes


def voting_frames(scene: RecordingScene, rules: RecordingLabellingSettings) -> Ints:
    """Which sampled frames vote: some, evenly spread, and one of each tracklet that none of these shows.

    As many for each second of a long recording as of a short one: of an hour, few frames would leave most tracklets out, and one more frame
    for each of them costs more.
    """
    frames = len(scene.sampled_frames)
    spread = max(rules.least_voting, frames // rules.voting_interval)
    if frames <= spread:
        return np.arange(frames)
    votes = np.zeros(frames, dtype=np.bool_)
    votes[np.linspace(0, frames - 1, spread).round().astype(np.int64)] = True
    shown = np.zeros(len(scene.first), dtype=np.bool_)
    shown[scene.sampled_track[votes[scene.sampled_frame]]] = True
    for e in range(frames):
        tracks = scene.sampled_track[scene.sampled_offsets[e] : scene.sampled_offsets[e + 1]]
        if not shown[tracks].all():
            votes[e] = True
            shown[tracks] = True
    return np.nonzero(votes)[0]


def _votes_of_several(
    labellers: Sequence[BodyLabeller], scene: RecordingScene, rules: RecordingLabellingSettings, workers: int, report: Progress
) -> Floats:
    """`_votes_of_one` where there are several bodies, each followed through time."""
    bodies = find_bodies(
        labellers, scene.sampled_xyz, scene.sampled_offsets, rules.max_vote, workers, lambda fraction, what: report(0.7 * fraction, what)
    )
    return votes_of_bodies(labellers, bodies, follow_bodies(bodies, scene.sampled_track), scene.sampled_track)


def _scores(
    labellers: Sequence[BodyLabeller], bodies: Sequence[BodyModel], scene: RecordingScene, arrays: Sequence[FrameScores]
) -> list[SceneScores]:
    """What the scene scores by each body, to be asked for labels; written over scores that nobody needs any more, where given."""
    return [
        SceneScores(scene, labeller.body if body is labeller.model else body.arrays(), labeller.settings, scored=scored)
        for labeller, body, scored in zip_longest(labellers, bodies, arrays)
    ]


def _coordinate_ascent(
    labellers: Sequence[BodyLabeller],
    scores: list[SceneScores],
    label: Ints,
    rules: RecordingLabellingSettings,
    excess: Floats | None = None,
    without: Ints | None = None,
) -> _JointLabels:
    """Relabel until nothing changes, or labels come back.

    Two labels that are exchanged may be exchanged again in the next round, as leave-one-out scores take both points for what they are
    labelled. Of labels that give points to the same tracklets the best are taken, by the joint evidence of all points.
    excess (L, L): see `HeldLabels`; none where not known. without: columns that no tracklet may have.
    """
    scene, visited = scores[0].scene, list[tuple[float, Ints, Floats, list[Ints], float, int]]()
    for _ in range(rules.max_rounds):
        gain, poses, joint = _gains(labellers, scores, label, rules)
        if excess is not None:
            given = label != NULL
            gain[given] -= excess[label[given]] * scene.independent[given, None]
        if without is not None:
            gain[:, without] = -np.inf
        gain, found, total = _with_ghost_credit(gain, scene, labellers, rules)
        visited.append((joint, label, gain, poses, total, int(found.rough.sum())))
        if any(np.array_equal(found.label, one[1]) for one in visited):
            break
        label = found.label
    same = [one for one in visited if np.array_equal(one[1] == NULL, visited[-1][1] == NULL)]
    joint, label, gain, poses, total, rough = max(reversed(same), key=lambda one: one[0])
    margin, rival = margins_of(gain, label, scene.first, scene.last, np.argsort(scene.first, kind="stable"))
    return _JointLabels(label, margin, rival, marker_offsets(labellers), poses, total, scores, rough)


def _gains(
    labellers: Sequence[BodyLabeller], scores: Sequence[SceneScores], label: Ints, rules: RecordingLabellingSettings
) -> tuple[Floats, list[Ints], float]:
    """Each tracklet's gain for each column, given the labels of all others (J, L) in nats; key poses (E,) by body; and the evidence.

    The evidence is the joint one of all labels, nats over all sampled frames; a frame with fewer than three labels has none.
    """
    offsets, scene = marker_offsets(labellers), scores[0].scene
    gain, poses, joint = np.zeros((len(scene.first), offsets[-1])), [], 0.0
    for number, of_body in enumerate(scores):
        scored = of_body.of(labels_of_body(label, offsets, number))
        sums, counts = np.zeros((len(scene.first), scored.scores.shape[1])), np.zeros(len(scene.first))
        sum_scores(scene.sampled_track, scored.scores, rules.min_score, rules.max_score, sums, counts)
        gain[:, offsets[number] : offsets[number + 1]] = sums * (scene.independent / np.maximum(counts, 1.0))[:, None]
        poses.append(scored.poses.copy())
        joint += float(np.nansum(scored.totals))
    return gain, poses, joint


def _with_ghost_credit(
    gain: Floats, scene: RecordingScene, labellers: Sequence[BodyLabeller], rules: RecordingLabellingSettings
) -> tuple[Floats, Assignment, float]:
    """The gains with what a tracklet earns for being a marker rather than a ghost, the best labels, and their total.

    Three explanations compete: no ghosts, short ghosts only, ghosts of any length. A ghost that is not allowed costs `first_ghost_cost` for
    each independent frame; an allowed one costs nothing; each step of allowance costs `ghosts_cost`. The best explanation counts.
    """
    full = max(labeller.settings.first_ghost_cost for labeller in labellers) * scene.independent * rules.frame_correlation
    long = (scene.last - scene.first + 1) / scene.rate >= rules.long_track
    best = -np.inf
    for allowed, costly in ((0, np.ones(len(long), dtype=np.bool_)), (1, long), (2, np.zeros(len(long), dtype=np.bool_))):
        credited = gain + (full * costly)[:, None]
        assignment = assign_tracklets(_by_length(credited, scene), scene.first, scene.last)
        label = assignment.label
        taken = label != NULL
        total = credited[taken, label[taken]].sum() - (full * costly).sum() - rules.ghosts_cost * allowed
        if total > best:
            best, chosen, found = float(total), credited, assignment
        if not ((label == NULL) & costly).any():
            break
    return chosen, found, best


def _by_length(gain: Floats, scene: RecordingScene) -> Floats:
    """The gains (J, L), those of long tracklets raised as far as needed: not even all shorter rivals together have more frames than one.

    A tracklet's frames resemble each other, so that many count like few. The frames of many short ghosts do not, and together they would
    outweigh the marker that they are beside, one after the other.
    """
    pairs = overlaps(gain, scene.first, scene.last, np.argsort(scene.first, kind="stable"))
    weight = rivals_weight(gain, pairs, scene.first, scene.last, scene.samples, scene.independent)
    return gain * np.maximum(1.0, weight * scene.samples / np.maximum(scene.independent, 1e-12))[:, None]


def _adapted_body(
    labeller: BodyLabeller,
    number: int,
    scene: RecordingScene,
    state: _JointLabels,
    rules: RecordingLabellingSettings,
    subject_rules: SubjectRules,
    body_rules: BodyRules,
) -> BodyModel:
    """The model of the body with this number, adapted by the tracklets whose labels have large margins."""
    label, poses = labels_of_body(state.label, state.offsets, number), state.poses[number]
    firm = np.where(state.margin >= rules.adapt_margin, label, NULL)
    shape = len(scene.sampled_frames), labeller.body.mean.shape[1]
    frames = placed_points(scene.sampled_frame, firm[scene.sampled_track], scene.sampled_xyz, *shape)
    usable = shows_enough(frames)
    if labeller.model.within is None or not usable.any():
        return labeller.model
    interval = np.diff(scene.sampled_frames, prepend=scene.sampled_frames[0] - subject_rules.independent_after * scene.rate) / scene.rate
    weight = np.minimum(1.0, interval / subject_rules.independent_after)
    return adapt_body(labeller.model, frames[usable], poses[usable], weight[usable], subject_rules, body_rules)
