"""A whole recording's labelling: models and clouds in; each model's labels with calibrated confidence out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.geometry import rotate_z_up
from asterism.labelling.body._workspace_kernels import FrameSettings
from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.body.model import BodyModel, BodyRules
from asterism.labelling.body.subject import SubjectRules, adapt_body, shows_enough
from asterism.labelling.training.calibration import LabelTrials
from asterism.labelling.training.trials import Trial
from asterism.labelling.whole._kernels import FrameScores, score_frames
from asterism.labelling.whole.bodies import check_single_body
from asterism.labelling.whole.certainty import Certainty, overlaps_unlabelled
from asterism.labelling.whole.fits import point_fits
from asterism.labelling.whole.foreign import ForeignRules, forward_travel, label_foreign
from asterism.labelling.whole.joint import SceneLabelling, label_scene
from asterism.labelling.whole.scene import RecordingLabellingSettings, Scene, labels_of_body, marker_offsets, prepare_scene
from asterism.labelling.whole.short import frames_with_bodies, label_short_points, long_points, tracklets_of
from asterism.labelling.whole.splits import split_tracklets
from asterism.labelling.whole.verdict import RigidDistances, VerdictRules, confidence_limit, exchangeable, judge_scene
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling, Recording
from asterism.tracking.linking import Tracklets, find_tracklets


@dataclass(frozen=True)
class BodyInRecording:
    """A model as one of the bodies in a recording.

    labeller   labels the body in single frames
    names      all names of its marker set
    markers    (M,) those that the body model has learned
    certainty  how certain a tracklet's label is, and which labels are taken back
    distances  near-rigid distances of the training, by which a recording is judged; None where the model keeps no sample of it
    """

    labeller: BodyLabeller
    names: tuple[str, ...]
    markers: Ints
    certainty: Certainty
    distances: RigidDistances | None = None


@dataclass(frozen=True)
class PointLabels:
    """Labels of the P points of clouds, in their order.

    label            (P,) column among the markers of all bodies, one body after the other, -1 for none
    margin           (P,) nats; of a point without a label: 0 or below, by how much it misses its best column
    rival            (P,) that column, where there is one; -1 otherwise
    near_unlabelled  (P,) 1 where a point without a label was there at some time of the point's tracklet, else 0
    fit              (P,) nats, how well the tracklets of labelled points lie where the others predict them, see `point_fits`
    limit            (P,) what no label of a point may be more certain than
    found            the labels of the long tracklets
    """

    label: Ints
    margin: Floats
    rival: Ints
    near_unlabelled: Ints
    fit: Floats
    limit: Floats
    found: SceneLabelling


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
    tracklets = find_tracklets(clouds)
    markers = int(marker_offsets(labellers)[-1])
    kept = long_points(clouds, tracklets, markers, rules.short)
    if len(labellers) > 1:  # single frames do not tell which body is whose: without long tracklets, the short ones must
        kept |= frames_with_bodies(clouds, kept, markers, rules.short) < rules.short.min_long_frames
    elif whole is not None:
        check_single_body(labellers[0], clouds.select(kept))

    def label_from(scene: Scene, start: Ints | None) -> SceneLabelling:
        return label_scene(labellers, scene, rules, subject_rules, body_rules, workers, progress if start is None else None, start)

    tracklets, found = _label_long_tracklets(labellers, clouds, tracklets, kept, rules, label_from)
    scene, limit = found.scene, np.ones(len(found.label))
    long = np.nonzero(kept)[0][scene.order]
    if whole is not None:
        found, limit = label_if_foreign(whole, found, label_from)
    points = len(clouds.xyz)
    label, margin, rival = np.full(points, NULL, dtype=np.int64), np.zeros(points), np.full(points, NULL, dtype=np.int64)
    near_unlabelled = np.ones(points, dtype=np.int64)
    limits = np.ones(points)
    limits[long] = limit[scene.track]
    label[long], margin[long], rival[long] = found.label[scene.track], found.margin[scene.track], found.rival[scene.track]
    near_unlabelled[long] = overlaps_unlabelled(found.label, scene.first, scene.last)[scene.track]
    offsets, xyz = marker_offsets(labellers), rotate_z_up(clouds.xyz, clouds.vertical)
    if not kept.all():
        for number, (labeller, body) in enumerate(zip(labellers, found.bodies, strict=True)):
            arrays = labeller.body if body is labeller.model else body.arrays()
            of_body = labels_of_body(label, offsets, number)
            marker, its_margin = label_short_points(labeller, arrays, clouds, xyz, ~kept & (label == NULL), of_body, rules.short)
            taken = marker != NULL
            label[taken], margin[taken] = marker[taken] + offsets[number], its_margin[taken]
    fit = np.zeros(points)
    scored = np.isin(np.arange(len(clouds)), scene.sampled_frames)
    scored[clouds.frame_of[~kept & (label != NULL)]] = True
    for number, labeller in enumerate(labellers):  # by the body of people at large: that is what trials on other people were judged by
        of_body = labels_of_body(label, offsets, number)
        own = point_fits(clouds, xyz, of_body, labeller.body, labeller.settings, scored, tracklets.of_point)
        fit = np.where(of_body != NULL, own, fit)
    return PointLabels(label, margin, rival, near_unlabelled, fit, limits, found)


def _label_long_tracklets(
    labellers: Sequence[BodyLabeller],
    clouds: Clouds,
    tracklets: Tracklets,
    kept: NDArray[np.bool_],
    rules: RecordingLabellingSettings,
    label_from: Callable[[Scene, Ints | None], SceneLabelling],
) -> tuple[Tracklets, SceneLabelling]:
    """All tracklets, those cut that go over from one marker to another, and the labels of the kept ones.

    kept (P,): points of the tracklets to label; label_from: labels a scene, from given labels (J,) on where there are some.
    """
    points = clouds.select(kept)
    scene = prepare_scene(points, tracklets_of(tracklets, kept), rules)
    found = label_from(scene, None)
    for _ in range(rules.max_splits):
        split = split_tracklets(tracklets, np.nonzero(kept)[0][scene.order], labellers, scene, found.label, rules)
        if split is None:
            break
        tracklets, before = split, scene
        scene = prepare_scene(points, tracklets_of(tracklets, kept), rules)
        start = np.empty(len(scene.first), dtype=np.int64)
        start[scene.track] = found.label[before.track]  # both parts of a tracklet begin with its label
        found = label_from(scene, start)
    return tracklets, found


def label_if_foreign(
    body: BodyInRecording, found: SceneLabelling, relabel: Callable[[Scene, Ints], SceneLabelling]
) -> tuple[SceneLabelling, Floats]:
    """A recording's labels, and what each of them may be as certain as (J,).

    It is labelled again where it does not fit the body, where the body seems to walk backwards, and where few people taught the model and
    many points are left over. relabel: labels a scene from given labels (J,) on.
    """
    reference = body.distances
    verdict = judge_scene(found.scene, found.label, marker_offsets([body.labeller]), 0, reference)
    if verdict is None or reference is None:
        return found, np.ones(len(found.label))
    names, rules = [body.names[marker] for marker in body.markers], ForeignRules()
    few = len(reference.median) < reference.rules.min_people
    crowded = few and verdict.surplus >= reference.rules.min_surplus * len(names)
    if verdict.fits and not crowded and forward_travel(found, names, rules) > rules.backward:
        return found, np.ones(len(found.label))
    again = label_foreign(body.labeller.model, found, reference, names, relabel, rules)
    return again.found, again.limit


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
        return [_empty_labelling(body, clouds) for body in bodies], None
    labellers = [body.labeller for body in bodies]
    whole = bodies[0] if len(bodies) == 1 else None
    labels = label_points(labellers, clouds, rules, subject_rules, body_rules, workers, progress, whole)
    frame_of = clouds.frame_of
    place = np.arange(len(frame_of)) - clouds.offsets[frame_of]
    offsets = marker_offsets(labellers)
    labellings = []
    for number, body in enumerate(bodies):
        label, rival = labels_of_body(labels.label, offsets, number), labels_of_body(labels.rival, offsets, number)
        blank = _empty_labelling(body, clouds)
        indices, confidence = blank.indices, blank.confidence
        verdict = judge_scene(labels.found.scene, labels.found.label, offsets, number, body.distances)
        certainty = body.certainty.confidence(labels.margin, labels.near_unlabelled, labels.fit)
        certainty = np.minimum(certainty, np.minimum(labels.limit, confidence_limit(verdict)))
        if verdict is not None:
            pairs = exchangeable(label, rival, certainty, len(clouds), VerdictRules())
            named = tuple(tuple(body.names[body.markers[marker]] for marker in pair) for pair in pairs)
            verdict = replace(verdict, exchangeable=named)
        # a marker without a point: the probability that its best candidate was it, above one half only where a label was taken back
        candidate = np.where(label != NULL, label, np.where(labels.label == NULL, rival, NULL))
        chance = np.where(label != NULL, certainty, 0.5 * np.exp(np.minimum(labels.margin, 0.0)))
        points = np.nonzero(candidate != NULL)[0]
        points = points[np.lexsort((*clouds.xyz[points].T, chance[points]))]  # the order of the points does not matter
        at = frame_of[points], body.markers[candidate[points]]
        candidates = np.full(indices.shape, NULL, dtype=np.int64)
        confidence[at], candidates[at] = chance[points], place[points]
        points = np.nonzero((label != NULL) & (certainty >= body.certainty.least_confidence))[0]
        at = frame_of[points], body.markers[label[points]]
        indices[at], confidence[at] = place[points], certainty[points]
        candidates[indices != NULL] = NULL
        labellings.append(Labelling(indices, confidence, body.names, candidates, verdict))
    return labellings, labels.found


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
    trials: Sequence[Trial],
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
            used = np.nonzero(np.isin(frame_of, found.found.scene.sampled_frames) & (found.label != NULL))[0]
            right = truth[frame_of[used], found.label[used]] == used - clouds.offsets[frame_of[used]]
            parts.append(
                LabelTrials(found.margin[used], found.fit[used], found.near_unlabelled[used], right.astype(np.float64), np.ones(len(used)))
            )
    return LabelTrials.together(parts)


def _empty_labelling(body: BodyInRecording, clouds: Clouds) -> Labelling:
    shape = (len(clouds), len(body.names))
    return Labelling(np.full(shape, NULL, dtype=np.int64), np.zeros(shape), body.names)
