"""A whole recording's labelling: models and clouds in; each model's labels with calibrated confidence out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.geometry import rotate_z_up
from asterism.labelling.body._score_kernels import NO_TAIL
from asterism.labelling.body._workspace_kernels import FrameSettings
from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.body.model import BodyModel, BodyRules
from asterism.labelling.body.subject import SubjectRules, adapt_body, shows_enough
from asterism.labelling.training.calibration import LabelTrials
from asterism.labelling.training.trials import TrainingTrial
from asterism.labelling.whole._kernels import FrameScores, score_frames
from asterism.labelling.whole.bodies import check_single_body
from asterism.labelling.whole.certainty import overlaps_unlabelled
from asterism.labelling.whole.fits import point_fits
from asterism.labelling.whole.foreign import ForeignConfidence, ForeignLabels, forward_travel, label_foreign
from asterism.labelling.whole.joint import SceneLabelling, SceneWork, label_scene
from asterism.labelling.whole.point_labels import BodyInRecording, PointLabels, empty_labelling, labelling_of
from asterism.labelling.whole.scene import RecordingScene, labels_of_body, marker_offsets, prepare_scene
from asterism.labelling.whole.settings import RecordingLabellingSettings
from asterism.labelling.whole.short import frames_with_bodies, label_short_points, long_points, tracklets_of
from asterism.labelling.whole.splits import split_tracklets
from asterism.labelling.whole.verdict import judge_scene
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling, Recording
from asterism.recording.verdict import FITS, UNKNOWN
from asterism.tracking.linking import Tracklets, find_tracklets


@dataclass(frozen=True)
class LongTracklets:
    """The long tracklets of a recording, labelled.

    tracklets  of all points, cut by the body
    kept       (P,) the points of the long ones
    found      the long ones' labels
    foreign    how certain they may be in a recording that is foreign to its model; None otherwise
    """

    tracklets: Tracklets
    kept: NDArray[np.bool_]
    found: SceneLabelling
    foreign: ForeignConfidence | None

    def points(self) -> PointLabels:
        """The labels of all points, none of which belongs to a short tracklet."""
        points, scene = len(self.kept), self.found.scene
        long = np.nonzero(self.kept)[0][scene.order]
        label, margin, rival = np.full(points, NULL, dtype=np.int64), np.zeros(points), np.full(points, NULL, dtype=np.int64)
        # in a foreign recording distances that are off the training's say little; what they say is part of `foreign`
        margins = self.found.margin if self.foreign is None else self.found.by_body
        label[long], margin[long], rival[long] = (of_track[scene.track] for of_track in (self.found.label, margins, self.found.rival))
        left_over = np.ones(points, dtype=np.int64)
        left_over[long] = overlaps_unlabelled(self.found.label, scene.first, scene.last)[scene.track]
        foreign = None if self.foreign is None else self.foreign.of_points(points, long, scene.track)
        track = np.full(points, NULL, dtype=np.int64)
        track[long] = scene.track
        return PointLabels(label, margin, rival, left_over, np.zeros(points), foreign, np.zeros(points, dtype=np.bool_), track, self.found)

    def fit_frames(self, clouds: Clouds, labels: PointLabels) -> NDArray[np.bool_]:
        """The frames (T,) by which the fit of labels is judged: those sampled, and those with a labelled point of a short tracklet."""
        found = np.isin(np.arange(len(clouds)), self.found.scene.sampled_frames)
        found[clouds.frame_of[~self.kept & (labels.label != NULL)]] = True
        return found

    def fit_groups(self, labels: PointLabels) -> Ints:
        """(P,) which points share their fit: those of a tracklet; a point labelled alone in its frame has its own."""
        group = self.tracklets.of_point.copy()
        group[labels.alone] = len(self.tracklets) + np.arange(labels.alone.sum())
        return group


def label_points(
    labellers: Sequence[BodyLabeller],
    clouds: Clouds,
    rules: RecordingLabellingSettings,
    subject_rules: SubjectRules,
    body_rules: BodyRules,
    workers: int = 1,
    progress: Progress | None = None,
    whole: BodyInRecording | None = None,
) -> PointLabels:
    """Label the long tracklets of a recording together, then the points of the short ones; clouds have at least one point.

    whole: the only body; where the recording does not fit it, the tracklets are labelled again (`foreign.py`). Raises SeveralBodies where
    the long tracklets certainly show two such bodies.
    """
    long = label_long_tracklets(labellers, clouds, rules, subject_rules, body_rules, workers, progress, whole)
    return label_all_points(labellers, clouds, long, rules)


def label_long_tracklets(
    labellers: Sequence[BodyLabeller],
    clouds: Clouds,
    rules: RecordingLabellingSettings,
    subject_rules: SubjectRules,
    body_rules: BodyRules,
    workers: int,
    progress: Progress | None,
    whole: BodyInRecording | None,
) -> LongTracklets:
    """The first part of `label_points`: the long tracklets."""
    tracklets = find_tracklets(clouds)
    markers = int(marker_offsets(labellers)[-1])
    kept = long_points(clouds, tracklets, markers, rules.short)
    if len(labellers) > 1:  # single frames do not tell which body is whose: without long tracklets, the short ones must
        kept |= frames_with_bodies(clouds, kept, markers, rules.short) < rules.short.min_long_frames
    points = clouds.select(kept)
    if len(labellers) == 1 and whole is not None:
        check_single_body(labellers[0], points, rules.bodies)

    arrays = list[FrameScores]()

    def label_from(scene: RecordingScene, start: Ints | None) -> SceneLabelling:
        work = SceneWork(workers, progress if start is None else None, arrays)
        return label_scene(labellers, scene, rules, subject_rules, body_rules, work, start)

    tracklets, found = _label_and_split(labellers, points, tracklets, kept, rules, label_from, arrays)
    foreign = None
    if whole is not None:
        again = label_if_foreign(whole, found, label_from, rules)
        if again is not None:
            found, foreign = again.found, again.confidence
    return LongTracklets(tracklets, kept, found, foreign)


def label_all_points(
    labellers: Sequence[BodyLabeller], clouds: Clouds, long: LongTracklets, rules: RecordingLabellingSettings
) -> PointLabels:
    """The second part of `label_points`: the labels of the long tracklets as labels of points, and those of short tracklets."""
    labels, xyz = long.points(), rotate_z_up(clouds.xyz, clouds.vertical)
    if not long.kept.all():
        labels = with_short_points(labellers, clouds, xyz, long.kept, labels, rules)
    return replace(labels, fit=_fits(labellers, clouds, xyz, long, labels))


def _label_and_split(
    labellers: Sequence[BodyLabeller],
    points: Clouds,
    tracklets: Tracklets,
    kept: NDArray[np.bool_],
    rules: RecordingLabellingSettings,
    label_from: Callable[[RecordingScene, Ints | None], SceneLabelling],
    arrays: Sequence[FrameScores],
) -> tuple[Tracklets, SceneLabelling]:
    """All tracklets, those cut that go over from one marker to another, and the labels of the kept ones.

    points: those of the tracklets to label, which `kept` (P,) marks among all; label_from: labels a scene, from given labels (J,) on where
    there are some; arrays: see `label_scene`.
    """
    scene = prepare_scene(points, tracklets_of(tracklets, kept), rules)
    found = label_from(scene, None)
    for _ in range(rules.max_splits):
        split = split_tracklets(tracklets, np.nonzero(kept)[0][scene.order], labellers, scene, found.label, rules, arrays)
        if split is None:
            break
        tracklets, before = split, scene
        scene = prepare_scene(points, tracklets_of(tracklets, kept), rules)
        start = np.empty(len(scene.first), dtype=np.int64)
        start[scene.track] = found.label[before.track]  # both parts of a tracklet begin with its label
        found = label_from(scene, start)
    return tracklets, found


def with_short_points(
    labellers: Sequence[BodyLabeller],
    clouds: Clouds,
    xyz: Floats,
    kept: NDArray[np.bool_],
    labels: PointLabels,
    rules: RecordingLabellingSettings,
) -> PointLabels:
    """The labels, with those of points of short tracklets, written over those given; kept (P,): the points of the long ones."""
    label, margin, alone, left_over, offsets = labels.label, labels.margin, labels.alone, labels.left_over, marker_offsets(labellers)
    for number, (labeller, body) in enumerate(zip(labellers, labels.found.bodies, strict=True)):
        arrays = labeller.body if body is labeller.model else body.arrays()
        of_body = labels_of_body(label, offsets, number)
        short = label_short_points(labeller, arrays, clouds, xyz, ~kept & (label == NULL), of_body, rules.short)
        taken = short.label != NULL
        label[taken], margin[taken], alone[taken] = short.label[taken] + offsets[number], short.margin[taken], short.alone[taken]
    unlabelled = np.bincount(clouds.frame_of, weights=label == NULL, minlength=len(clouds)) > 0
    left_over[alone] = unlabelled[clouds.frame_of[alone]]
    return labels


def _fits(labellers: Sequence[BodyLabeller], clouds: Clouds, xyz: Floats, long: LongTracklets, labels: PointLabels) -> Floats:
    """How well the tracklets of labelled points lie where the others predict them, (P,) nats; labels alone in their frame by themselves.

    By the body of people at large: that is what trials on other people were judged by.
    """
    fit, offsets = np.zeros(len(labels.label)), marker_offsets(labellers)
    scored, group, turns = long.fit_frames(clouds, labels), long.fit_groups(labels), long.found.turns_of(len(clouds))
    for number, labeller in enumerate(labellers):
        of_body = labels_of_body(labels.label, offsets, number)
        own = point_fits(clouds, xyz, of_body, labeller.body, labeller.settings, scored, group, turns)
        fit = np.where(of_body != NULL, own, fit)
    return fit


def label_if_foreign(
    body: BodyInRecording,
    found: SceneLabelling,
    relabel: Callable[[RecordingScene, Ints], SceneLabelling],
    settings: RecordingLabellingSettings,
) -> ForeignLabels | None:
    """A recording labelled again, None where there is no need.

    There is where it does not fit the body, where the body seems to walk backwards, and where many points are left over from a model of few
    people, none of whom has such distances. relabel: labels a scene from given labels (J,) on.
    """
    reference = body.distances
    verdict = judge_scene(found.scene, found.label, marker_offsets([body.labeller]), 0, reference)
    if verdict is None or reference is None:
        return None
    names, rules = [body.names[marker] for marker in body.markers], settings.foreign
    few = reference.few_people and not verdict.scatter <= reference.rules.own_scatter
    crowded = few and verdict.surplus >= reference.rules.min_surplus * len(names)
    # where nothing could be compared, no other labelling can be told to be better
    if verdict.kind in (FITS, UNKNOWN) and not crowded and forward_travel(found, names, rules) > rules.backward:
        return None
    return label_foreign(body.labeller, found, reference, names, relabel, settings)


def label_whole(
    bodies: Sequence[BodyInRecording],
    clouds: Clouds,
    rules: RecordingLabellingSettings,
    subject_rules: SubjectRules,
    body_rules: BodyRules,
    workers: int = 1,
    progress: Progress | None = None,
) -> tuple[list[Labelling], SceneLabelling | None]:
    """One labelling for each body, each point given to one of them at most; and those of the long tracklets, None without a point.

    Raises SeveralBodies where one body is given, and the recording certainly shows two of it.
    """
    if not len(clouds.xyz):
        return [empty_labelling(body, clouds) for body in bodies], None
    labellers = [body.labeller for body in bodies]
    whole = bodies[0] if len(bodies) == 1 else None
    labels = label_points(labellers, clouds, rules, subject_rules, body_rules, workers, progress, whole)
    offsets = marker_offsets(labellers)
    return [labelling_of(body, number, clouds, labels, offsets, rules) for number, body in enumerate(bodies)], labels.found


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
    # the labels are given: a body that they do not fit must not pass for one in an unknown posture
    settings = settings._replace(tail_freedom=NO_TAIL)
    score_frames(xyz, offsets, marker, np.arange(visible.shape[1]), body.arrays(), settings, FrameScores(scores, totals, poses))
    return used, scores[np.arange(len(xyz)), marker], totals, poses


def run_trials(
    labeller: BodyLabeller,
    stretches: Sequence[Recording],
    trials: Sequence[TrainingTrial],
    rules: RecordingLabellingSettings,
    subject_rules: SubjectRules,
    body_rules: BodyRules,
    seed: int,
) -> LabelTrials:
    """Label stretches of recordings whose truth is known, with markers hidden in gaps, and ghosts or clutter added.

    One entry for each label in each sampled frame.
    """
    rng = np.random.default_rng(seed)
    parts = []
    for stretch in stretches:
        for trial in trials:
            clouds, truth = trial.in_time(stretch, rng)
            if not len(clouds.xyz):
                continue
            found = label_points([labeller], clouds, rules, subject_rules, body_rules)
            frame_of = clouds.frame_of
            used = np.nonzero(np.isin(frame_of, found.found.scene.sampled_frames) & (found.label != NULL) & ~found.alone)[0]
            right = truth[frame_of[used], found.label[used]] == used - clouds.offsets[frame_of[used]]
            parts.append(
                LabelTrials(found.margin[used], found.fit[used], found.left_over[used], right.astype(np.float64), np.ones(len(used)))
            )
    return LabelTrials.together(parts)
