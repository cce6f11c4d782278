"""A whole recording's labelling: models and clouds in; each model's labels with calibrated confidence out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.errors import AsterismError
from asterism.labelling.body._workspace_kernels import FrameSettings
from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.body.model import BodyModel, BodyRules, length_scale
from asterism.labelling.body.subject import SubjectRules, adapt_body, tells_enough
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.labelling.whole._kernels import score_frames
from asterism.labelling.whole.certainty import Certainty, TrialLabels, beside_spare
from asterism.labelling.whole.joint import Outcome, label_scene
from asterism.labelling.whole.scene import TimeRules, lay_out, marker_starts, own_labels
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling, Recording
from asterism.tracking.linking import find_tracklets


@dataclass(frozen=True)
class BodyInRecording:
    """A model as one of the bodies in a recording.

    labeller        finds the body in single frames
    names, markers  all names of its marker set, and which of them (M,) the body has learned
    certainty       how sure a tracklet's label is, and when it is taken back
    """

    labeller: BodyLabeller
    names: tuple[str, ...]
    markers: Ints
    certainty: Certainty


def label_whole(
    members: Sequence[BodyInRecording],
    clouds: Clouds,
    rules: TimeRules,
    subject_rules: SubjectRules,
    body_rules: BodyRules,
    workers: int = 1,
    progress: Progress | None = None,
) -> tuple[list[Labelling], Outcome | None]:
    """One labelling for each member, each point given to one of them at most; and how it came about, None where there are no points."""
    if not len(clouds.xyz):
        return [_nothing(member, clouds) for member in members], None
    labellers = [member.labeller for member in members]
    unit = min(length_scale(labeller.model.mean[0], body_rules) for labeller in labellers)
    scene = lay_out(clouds, find_tracklets(clouds), rules, unit)
    outcome = label_scene(labellers, scene, rules, subject_rules, body_rules, workers, progress)
    labellings = []
    frame_of = np.repeat(np.arange(len(clouds)), clouds.counts)
    beside = beside_spare(outcome.label, scene.first, scene.last)
    starts = marker_starts(labellers)
    for number, member in enumerate(members):
        label, rival = own_labels(outcome.label, starts, number), own_labels(outcome.rival, starts, number)
        blank = _nothing(member, clouds)
        indices, confidence = blank.indices, blank.confidence
        sure = member.certainty.confidence(outcome.margin, beside)
        kept = (label != NULL) & (sure >= member.certainty.least_confidence)
        # a marker without a point: how likely its best candidate was it, never above one half unless a label was taken back
        candidate = np.where(label != NULL, label, np.where(outcome.label == NULL, rival, NULL))
        chance = np.where(label != NULL, sure, 0.5 * np.exp(np.minimum(outcome.margin, 0.0)))
        points = np.nonzero(candidate[scene.track] != NULL)[0]
        points = points[np.argsort(chance[scene.track[points]], kind="stable")]
        track = scene.track[points]
        at = frame_of[points], member.markers[candidate[track]]
        candidates = np.full(indices.shape, NULL, dtype=np.int64)
        confidence[at], candidates[at] = chance[track], scene.place[points]
        points = np.nonzero(kept[scene.track])[0]
        track = scene.track[points]
        indices[frame_of[points], member.markers[label[track]]] = scene.place[points]
        confidence[frame_of[points], member.markers[label[track]]] = sure[track]
        candidates[indices != NULL] = NULL
        labellings.append(Labelling(indices, confidence, member.names, candidates))
    return labellings, outcome


def subject_body(
    settings: FrameSettings, body: BodyModel, frames: Floats, rate: float, rules: SubjectRules, body_rules: BodyRules
) -> BodyModel:
    """The body model of the one person whose labelled frames these are: (T, M, 3) m, z up, NaN where missing.

    Raises AsterismError where the model cannot be adapted, no frame shows three markers, or the labels fit no body that the model knows.
    """
    if body.within is None:
        raise AsterismError("this model was written by an earlier Asterism and cannot be adapted to a subject; train it again.")
    looked, scores, _, poses = _scored(settings, body, frames, rate, rules)
    if not len(looked):
        raise AsterismError("no frame of the subject's recording shows enough labelled markers; give a standing trial with all of them.")
    if np.median(scores) <= settings.outlier_score:
        raise AsterismError("the subject's labelled markers fit no body that the model knows; check the labels, or train on such bodies.")
    return adapt_body(body, frames[looked], poses, np.ones(len(looked)), rules, body_rules)


def own_body_gain(settings: FrameSettings, own: BodyModel, general: BodyModel, frames: Floats, rate: float, rules: SubjectRules) -> float:
    """Nats per frame by which a subject's body explains labelled frames (T, M, 3) better than the body of people at large.

    NaN where no frame shows enough markers.
    """
    ours, theirs = (_scored(settings, body, frames, rate, rules)[2] for body in (own, general))
    return float(np.mean(ours - theirs)) if len(ours) else float("nan")


def _scored(
    settings: FrameSettings, body: BodyModel, frames: Floats, rate: float, rules: SubjectRules
) -> tuple[Ints, Floats, Floats, Ints]:
    """Frames that tell something new and show enough markers (n,), the score of each label there, and the frames' totals and key poses."""
    shown = ~np.isnan(frames[:, :, 0])
    looked = np.nonzero(tells_enough(frames))[0][:: max(1, round(rules.independent * rate))]
    seen = shown[looked]
    offsets = np.concatenate([[0], np.cumsum(seen.sum(axis=1))]).astype(np.int64)
    xyz, marker = np.ascontiguousarray(frames[looked][seen]), np.nonzero(seen)[1].astype(np.int64)
    scores, totals, poses = np.empty((len(xyz), seen.shape[1])), np.empty(len(looked)), np.empty(len(looked), dtype=np.int64)
    score_frames(xyz, offsets, marker, np.arange(seen.shape[1]), body.arrays(), settings, scores, totals, poses)
    return looked, scores[np.arange(len(xyz)), marker], totals, poses


def trial(
    labeller: BodyLabeller,
    stretches: Sequence[Recording],
    trials: Sequence[tuple[float, int]],
    rules: TimeRules,
    subject_rules: SubjectRules,
    body_rules: BodyRules,
    seed: int,
) -> TrialLabels:
    """Label stretches of recordings whose truth is known, markers hidden in gaps and ghosts added.

    trials: (share of the markers hidden at every moment, ghosts). One entry for each label in each frame that was looked at.
    """
    rng = np.random.default_rng(seed)
    parts = []
    for stretch in stretches:
        for share, ghosts in trials:
            clouds, truth = simulate_gaps_and_ghosts(stretch, round(share * len(stretch.labels)), ghosts, rng)
            if not len(clouds.xyz):
                continue
            scene = lay_out(clouds, find_tracklets(clouds), rules, length_scale(labeller.model.mean[0], body_rules))
            outcome = label_scene([labeller], scene, rules, subject_rules, body_rules)
            label, beside = outcome.label[scene.track], beside_spare(outcome.label, scene.first, scene.last)
            frame_of = np.repeat(np.arange(len(clouds)), clouds.counts)
            looked = np.isin(frame_of, scene.looked) & (label != NULL)
            right = truth[frame_of[looked], label[looked]] == scene.place[looked]
            track = scene.track[looked]
            parts.append(TrialLabels(outcome.margin[track], right.astype(np.float64), beside[track]))
    return TrialLabels.together(parts)


def _nothing(member: BodyInRecording, clouds: Clouds) -> Labelling:
    shape = (len(clouds), len(member.names))
    return Labelling(np.full(shape, NULL, dtype=np.int64), np.zeros(shape), member.names)
