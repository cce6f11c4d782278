"""A whole recording's labelling: models and clouds in; each model's labels with calibrated confidence out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.errors import AsterismError
from asterism.labelling.body._workspace_kernels import FrameSettings
from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.body.model import BodyModel, BodyRules, length_scale
from asterism.labelling.body.subject import SubjectRules, adapt_body, shows_enough
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.labelling.whole._kernels import FrameScores, score_frames
from asterism.labelling.whole.certainty import Certainty, TrialLabels, overlaps_unlabelled
from asterism.labelling.whole.joint import SceneLabelling, label_scene
from asterism.labelling.whole.scene import RecordingLabellingSettings, labels_of_body, marker_offsets, prepare_scene
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling, Recording
from asterism.tracking.linking import find_tracklets


@dataclass(frozen=True)
class BodyInRecording:
    """A model as one of the bodies in a recording.

    labeller   labels the body in single frames
    names      all names of its marker set
    markers    (M,) those that the body model has learned
    certainty  how certain a tracklet's label is, and which labels are taken back
    """

    labeller: BodyLabeller
    names: tuple[str, ...]
    markers: Ints
    certainty: Certainty


def label_whole(
    bodies: Sequence[BodyInRecording],
    clouds: Clouds,
    rules: RecordingLabellingSettings,
    subject_rules: SubjectRules,
    body_rules: BodyRules,
    workers: int = 1,
    progress: Progress | None = None,
) -> tuple[list[Labelling], SceneLabelling | None]:
    """One labelling for each body, each point given to one of them at most; and the labels of the tracklets, None without any point."""
    if not len(clouds.xyz):
        return [_empty_labelling(body, clouds) for body in bodies], None
    labellers = [body.labeller for body in bodies]
    unit = min(length_scale(labeller.model.mean[0], body_rules) for labeller in labellers)
    scene = prepare_scene(clouds, find_tracklets(clouds), rules, unit)
    found = label_scene(labellers, scene, rules, subject_rules, body_rules, workers, progress)
    frame_of = clouds.frame_of
    near_unlabelled = overlaps_unlabelled(found.label, scene.first, scene.last)
    offsets = marker_offsets(labellers)
    labellings = []
    for number, body in enumerate(bodies):
        label, rival = labels_of_body(found.label, offsets, number), labels_of_body(found.rival, offsets, number)
        blank = _empty_labelling(body, clouds)
        indices, confidence = blank.indices, blank.confidence
        certainty = body.certainty.confidence(found.margin, near_unlabelled)
        kept = (label != NULL) & (certainty >= body.certainty.least_confidence)
        # a marker without a point: the probability that its best candidate was it, above one half only where a label was taken back
        candidate = np.where(label != NULL, label, np.where(found.label == NULL, rival, NULL))
        chance = np.where(label != NULL, certainty, 0.5 * np.exp(np.minimum(found.margin, 0.0)))
        points = np.nonzero(candidate[scene.track] != NULL)[0]
        points = points[np.argsort(chance[scene.track[points]], kind="stable")]
        track = scene.track[points]
        at = frame_of[points], body.markers[candidate[track]]
        candidates = np.full(indices.shape, NULL, dtype=np.int64)
        confidence[at], candidates[at] = chance[track], scene.place[points]
        points = np.nonzero(kept[scene.track])[0]
        track = scene.track[points]
        at = frame_of[points], body.markers[label[track]]
        indices[at], confidence[at] = scene.place[points], certainty[track]
        candidates[indices != NULL] = NULL
        labellings.append(Labelling(indices, confidence, body.names, candidates))
    return labellings, found


def subject_body(
    settings: FrameSettings, body: BodyModel, frames: Floats, rate: float, rules: SubjectRules, body_rules: BodyRules
) -> BodyModel:
    """The body model of the one person whose labelled frames these are: (T, M, 3) m, z up, NaN where missing.

    Raises AsterismError where the model cannot be adapted, no frame shows three markers, or the labels fit no body that the model knows.
    """
    if body.within is None:
        raise AsterismError("this model was written by an earlier Asterism and cannot be adapted to a subject; train it again.")
    used, scores, _, poses = _scores_of_labels(settings, body, frames, rate, rules)
    if not len(used):
        raise AsterismError("no frame of the subject's recording shows enough labelled markers; give a standing trial with all of them.")
    if np.median(scores) <= settings.outlier_score:
        raise AsterismError("the subject's labelled markers fit no body that the model knows; check the labels, or train on such bodies.")
    return adapt_body(body, frames[used], poses, np.ones(len(used)), rules, body_rules)


def subject_body_gain(
    settings: FrameSettings, adapted: BodyModel, general: BodyModel, frames: Floats, rate: float, rules: SubjectRules
) -> float:
    """Nats per frame by which a subject's body explains labelled frames (T, M, 3) better than the body of people at large.

    NaN where no frame shows enough markers.
    """
    of_subject, of_people = (_scores_of_labels(settings, body, frames, rate, rules)[2] for body in (adapted, general))
    return float(np.mean(of_subject - of_people)) if len(of_subject) else float("nan")


def _scores_of_labels(
    settings: FrameSettings, body: BodyModel, frames: Floats, rate: float, rules: SubjectRules
) -> tuple[Ints, Floats, Floats, Ints]:
    """Independent frames that show enough markers (n,), the score of each label there, and the frames' scores and key poses (n,)."""
    shown = ~np.isnan(frames[:, :, 0])
    used = np.nonzero(shows_enough(frames))[0][:: max(1, round(rules.independent_after * rate))]
    visible = shown[used]
    offsets = np.concatenate([[0], np.cumsum(visible.sum(axis=1))]).astype(np.int64)
    xyz, marker = np.ascontiguousarray(frames[used][visible]), np.nonzero(visible)[1].astype(np.int64)
    scores, totals, poses = np.empty((len(xyz), visible.shape[1])), np.empty(len(used)), np.empty(len(used), dtype=np.int64)
    score_frames(xyz, offsets, marker, np.arange(visible.shape[1]), body.arrays(), settings, FrameScores(scores, totals, poses))
    return used, scores[np.arange(len(xyz)), marker], totals, poses


def run_trials(
    labeller: BodyLabeller,
    stretches: Sequence[Recording],
    trials: Sequence[tuple[float, int]],
    rules: RecordingLabellingSettings,
    subject_rules: SubjectRules,
    body_rules: BodyRules,
    seed: int,
) -> TrialLabels:
    """Label stretches of recordings whose truth is known, with markers hidden in gaps and ghosts added.

    trials: (share of the markers hidden at every moment, ghosts). One entry for each label in each sampled frame.
    """
    rng = np.random.default_rng(seed)
    parts = []
    for stretch in stretches:
        for share, ghosts in trials:
            clouds, truth = simulate_gaps_and_ghosts(stretch, round(share * len(stretch.labels)), ghosts, rng)
            if not len(clouds.xyz):
                continue
            scene = prepare_scene(clouds, find_tracklets(clouds), rules, length_scale(labeller.model.mean[0], body_rules))
            found = label_scene([labeller], scene, rules, subject_rules, body_rules)
            label, near_unlabelled = found.label[scene.track], overlaps_unlabelled(found.label, scene.first, scene.last)
            frame_of = clouds.frame_of
            used = np.isin(frame_of, scene.sampled_frames) & (label != NULL)
            right = truth[frame_of[used], label[used]] == scene.place[used]
            track = scene.track[used]
            parts.append(TrialLabels(found.margin[track], right.astype(np.float64), near_unlabelled[track]))
    return TrialLabels.together(parts)


def _empty_labelling(body: BodyInRecording, clouds: Clouds) -> Labelling:
    shape = (len(clouds), len(body.names))
    return Labelling(np.full(shape, NULL, dtype=np.int64), np.zeros(shape), body.names)
