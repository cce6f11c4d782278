"""A labelled recording and what a person says of some tracklets in; the recording labelled again, and at once, out.

The first labelling looks for the body in single frames and adapts the model to the subject, which takes most of its time. Both are kept.
Labelling again repeats the steps in which all tracklets are labelled together (`joint.py`), with the person's labels held. Frames are
scored again only where a label in them has changed, and tracklets with the same labels keep what the first labelling found against them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from asterism.geometry import rotate_z_up
from asterism.labelling.body._workspace_kernels import BodyArrays
from asterism.labelling.body.model import BodyRules
from asterism.labelling.body.subject import SubjectRules
from asterism.labelling.whole._kernels import FrameScores, margins_of, overlaps, rivals_weight, score_frames, sum_scores
from asterism.labelling.whole.assignment import assign_tracklets
from asterism.labelling.whole.certainty import overlaps_unlabelled
from asterism.labelling.whole.fits import point_fits
from asterism.labelling.whole.foreign import ForeignConfidence
from asterism.labelling.whole.joint import SceneLabelling
from asterism.labelling.whole.label import LongTracklets, label_all_points, label_long_tracklets, with_short_points
from asterism.labelling.whole.plausibility import compare_with_training, ghost_penalty
from asterism.labelling.whole.point_labels import BodyInRecording, PointLabels, labelling_of
from asterism.labelling.whole.scene import RecordingScene, marker_offsets, prepare_scene, score_again, score_scene, with_fewer_samples
from asterism.labelling.whole.settings import RecordingLabellingSettings
from asterism.labelling.whole.short import tracklets_of
from asterism.labelling.whole.turned import hold_against_twins
from asterism.labelling.whole.upright import turned
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling
from asterism.tracking.linking import Tracklets

FREE = -2
"""Instead of a known label: the tracklet is to be labelled."""

CERTAIN = 1e6
"""nats, the gain of a label that is known: more than all others of a recording together."""


@dataclass(frozen=True)
class LabelledTracklets:
    """A labelled recording of one body, and what labelling it again begins with.

    body        the model
    clouds      the recording, of P points in T frames; at least one point
    long        its tracklets: all of them, which are labelled together, and the labels of these
    points      the labels of all points
    labelling   the same, as of all markers of the body's set
    body_rules  with which the model was trained
    settings    how it was labelled
    """

    body: BodyInRecording
    clouds: Clouds
    long: LongTracklets
    points: PointLabels
    labelling: Labelling
    body_rules: BodyRules
    settings: RecordingLabellingSettings

    @cached_property
    def xyz(self) -> Floats:
        """(P, 3) m, z up."""
        return rotate_z_up(self.clouds.xyz, self.clouds.vertical)

    @cached_property
    def upright(self) -> RecordingScene:
        """The scene with the body upright in every sampled frame."""
        return _turned(self.long.found.scene, self.long.found)

    @cached_property
    def arrays(self) -> BodyArrays:
        """The model as adapted to the subject, as the kernels read it."""
        model = self.long.found.bodies[0]
        return self.body.labeller.body if model is self.body.labeller.model else model.arrays()

    @cached_property
    def scores(self) -> Floats:
        """(Q, M) nats of each sampled point as each marker, given the labels of all others."""
        out = np.empty((len(self.upright.sampled_xyz), self.arrays.mean.shape[1]))
        _score(out, self.upright, self.long.found.label, None, self)
        return out

    @cached_property
    def ghosts(self) -> int:
        """Which ghosts the recording shows, by the labels: 0 for none, 1 for short ones only, 2 for ghosts of any length."""
        scene = self.upright
        long = (scene.last - scene.first + 1) / scene.rate >= self.settings.long_track
        unlabelled = self.long.found.label == NULL
        return 2 if (unlabelled & long).any() else 1 if unlabelled.any() else 0

    @cached_property
    def gain(self) -> Floats:
        """(J, M) nats of each long tracklet as each marker."""
        return _gain(self.scores, self.upright, np.full(len(self.upright.first), FREE), self)

    @cached_property
    def rivals_weight(self) -> float:
        """By how much the gains of long tracklets are raised against many short rivals: see `joint.py`."""
        scene = self.upright
        pairs = overlaps(self.gain, scene.first, scene.last, np.argsort(scene.first, kind="stable"))
        return float(rivals_weight(self.gain, pairs, scene.first, scene.last, scene.samples, scene.independent))

    @cached_property
    def penalty(self) -> Floats:
        """(J,) nats by which the margins of long tracklets were lowered, as their distances or places are off."""
        found, first, last = self.long.found, self.upright.first, self.upright.last
        margin, _ = margins_of(self.gain, found.label, first, last, np.argsort(first, kind="stable"))
        return np.asarray(np.maximum(margin - found.by_body, 0.0))


def label_tracklets(
    body: BodyInRecording,
    clouds: Clouds,
    settings: RecordingLabellingSettings,
    subject_rules: SubjectRules,
    body_rules: BodyRules,
    workers: int = 1,
    progress: Progress | None = None,
) -> LabelledTracklets:
    """Label a recording as `label_whole` does, with one body, and keep what labelling it again needs; clouds have at least one point.

    Raises SeveralBodies where the recording certainly shows two such bodies.
    """
    long = label_long_tracklets([body.labeller], clouds, settings, subject_rules, body_rules, workers, progress, body)
    points = label_all_points([body.labeller], clouds, long, settings)
    labelling = labelling_of(body, 0, clouds, points, marker_offsets([body.labeller]), settings)
    return LabelledTracklets(body, clouds, long, points, labelling, body_rules, settings)


def relabel_tracklets(before: LabelledTracklets, tracklets: Tracklets, fixed: Ints) -> Labelling:
    """Label a recording again, in which something is known of some tracklets.

    tracklets: those of before, or some of them cut; fixed (J,): a column of the body's markers, -1 for no marker, `FREE` where nothing is
    known. Labels that are known have confidence 1. Of two tracklets that are known to be one marker at the same time, one is taken. Where
    nothing is known and cut, the labelling is that of before, bit for bit. O(P), and O(Q M) for the Q points of sampled frames in which a
    label changes, in each of a few rounds.
    """
    of_point = fixed[tracklets.of_point]
    cut = len(tracklets) != len(before.long.tracklets)
    if not cut and (fixed == FREE).all():
        return before.labelling
    kept = before.long.kept | (of_point != FREE)  # a short tracklet of which something is known is labelled with the long ones
    problem = _problem(before, tracklets, kept, of_point, anew=cut or not np.array_equal(kept, before.long.kept))
    found = _ascent(before, problem)
    foreign = before.long.foreign
    if foreign is not None:
        foreign = _of_tracklets(foreign, problem)
    long = LongTracklets(tracklets, kept, found, foreign)
    labels = _point_labels(before, long, problem)
    labelling = labelling_of(before.body, 0, before.clouds, labels, marker_offsets([before.body.labeller]), before.settings)
    return _with_known(labelling, before.body, before.clouds, of_point)


@dataclass(frozen=True)
class _RelabelProblem:
    """What is labelled again.

    scene      the long tracklets, the body upright
    fixed      (J,) what is known of them
    start      (J,) labels of the first labelling, -1 for tracklets that were short
    penalty    (J,) nats by which their margins were lowered then
    earlier    (J,) their numbers in the first labelling's scene, -1 for those that were short
    scores     (Q, M) nats of the sampled points under the first labels; None where there are none for this scene
    """

    scene: RecordingScene
    fixed: Ints
    start: Ints
    penalty: Floats
    earlier: Ints
    scores: Floats | None


def _problem(before: LabelledTracklets, tracklets: Tracklets, kept: NDArray[np.bool_], fixed: Ints, anew: bool) -> _RelabelProblem:
    """The scene of the kept points (P,), and what the first labelling says of it; fixed (P,). anew: it is another one than then."""
    found, scene = before.long.found, before.upright
    was_long = np.full(len(kept), NULL, dtype=np.int64)
    was_long[np.nonzero(before.long.kept)[0][scene.order]] = scene.track
    if anew:
        plain = prepare_scene(before.clouds.select(kept), tracklets_of(tracklets, kept), before.settings)
        scene = _turned(plain, found)
    points = np.nonzero(kept)[0][scene.order]
    known, earlier = np.empty(len(scene.first), dtype=np.int64), np.empty(len(scene.first), dtype=np.int64)
    known[scene.track], earlier[scene.track] = fixed[points], was_long[points]
    start = np.where(earlier >= 0, found.label[earlier], NULL)
    penalty = np.where(earlier >= 0, before.penalty[earlier], 0.0)
    return _RelabelProblem(scene, known, start, penalty, earlier, None if anew else before.scores)


def _turned(scene: RecordingScene, found: SceneLabelling) -> RecordingScene:
    """A scene with its sampled frames turned as those of a labelling were, where it had them."""
    if found.turns is None:
        return scene
    turns = np.tile(np.eye(3), (len(scene.sampled_frames), 1, 1))
    _, here, there = np.intersect1d(scene.sampled_frames, found.scene.sampled_frames, return_indices=True)
    turns[here] = found.turns[there]
    return replace(scene, sampled_xyz=turned(scene.sampled_xyz, scene.sampled_frame, turns))


def _ascent(before: LabelledTracklets, problem: _RelabelProblem) -> SceneLabelling:
    """Labels that no longer change, and their margins."""
    scene, fixed = problem.scene, problem.fixed
    label = np.where(fixed == FREE, problem.start, fixed)
    if problem.scores is None:
        scores = np.empty((len(scene.sampled_xyz), before.arrays.mean.shape[1]))
        _score(scores, scene, label, None, before)
    else:
        scores = problem.scores.copy()
        _score(scores, scene, label, label != problem.start, before)
    for last in range(before.settings.relabel.rounds):
        gain = _gain(scores, scene, fixed, before)
        by_length = np.maximum(1.0, before.rivals_weight * scene.samples / np.maximum(scene.independent, 1e-12))
        found = assign_tracklets(gain * by_length[:, None], scene.first, scene.last).label
        changed = found != label
        label = found
        if not changed.any() or last == before.settings.relabel.rounds - 1:
            break
        _score(scores, scene, label, changed, before)
    margin, rival = margins_of(gain, label, scene.first, scene.last, np.argsort(scene.first, kind="stable"))
    penalty, doubtful = _lost_margin(before, problem, label)
    by_body = margin - penalty
    margin = np.where(doubtful, np.minimum(by_body, -before.settings.no_adapt_margin), by_body)
    turns, held = before.long.found.turns if scene is before.upright else None, before.long.found.held
    if not np.array_equal(label, problem.start):
        rules = replace(before.settings.twins, rounds=0)
        held = hold_against_twins([before.body.labeller], scene, label, lambda given, _: given, rules, before.settings)
    return SceneLabelling(scene, label, margin, rival, before.long.found.bodies, 0.0, by_body, turns=turns, held=held)


def _score(scores: Floats, scene: RecordingScene, label: Ints, changed: NDArray[np.bool_] | None, before: LabelledTracklets) -> None:
    """Write the scores (Q, M) of all sampled points, or of those in frames that show one of the changed tracklets (J,)."""
    arrays, settings, frames = before.arrays, before.body.labeller.settings, len(scene.sampled_frames)
    again = np.ones(frames, dtype=np.bool_)
    if changed is not None:
        again = np.bincount(scene.sampled_frame[changed[scene.sampled_track]], minlength=frames) > 0
    score_again(scene, again, label, arrays, settings, FrameScores(scores, np.empty(frames), np.empty(frames, dtype=np.int64)))


def _gain(scores: Floats, scene: RecordingScene, fixed: Ints, before: LabelledTracklets) -> Floats:
    """The gain of each tracklet for each marker (J, M) nats, with what it earns for being no ghost.

    Which ghosts the recording shows is what the first labelling found; see `joint.py`.
    """
    sums, counts = np.zeros((len(scene.first), scores.shape[1])), np.zeros(len(scene.first))
    sum_scores(scene.sampled_track, scores, before.settings.min_score, before.settings.max_score, sums, counts)
    gain = sums * (scene.independent / np.maximum(counts, 1.0))[:, None]
    _hold_labels(gain, fixed)
    cost = before.body.labeller.settings.first_ghost_cost * scene.independent * before.settings.frame_correlation
    costly = np.ones(len(cost), dtype=np.bool_)
    if before.ghosts:
        costly = (scene.last - scene.first + 1) / scene.rate >= before.settings.long_track if before.ghosts == 1 else ~costly
    return np.asarray(gain + (cost * costly)[:, None])


def _hold_labels(gain: Floats, fixed: Ints) -> None:
    """Make the known labels (J,) the only ones that gains (J, L) allow these tracklets."""
    known = np.nonzero(fixed != FREE)[0]
    gain[known] = -CERTAIN
    named = known[fixed[known] != NULL]
    gain[named, fixed[named]] = CERTAIN


def _lost_margin(before: LabelledTracklets, problem: _RelabelProblem, label: Ints) -> tuple[Floats, NDArray[np.bool_]]:
    """Nats of margin (J,) that labels lose in this body, and whether their distances are not those of the training (J,).

    What they lost in the first labelling, where they are the same; only labels that changed are looked at.
    """
    found = before.long.found
    doubtful = np.where(problem.earlier >= 0, (found.margin < found.by_body)[problem.earlier], False)
    changed = (label != problem.start) & (label != NULL) & (problem.fixed == FREE)
    if not changed.any():
        return problem.penalty, doubtful
    few, number = _merged(with_fewer_samples(problem.scene, before.settings.relabel.penalty_frames, before.settings), label, changed)
    labels = np.full(len(few.first), NULL, dtype=np.int64)
    labels[number] = label
    near = overlaps_unlabelled(np.where(problem.fixed == NULL, 0, label), problem.scene.first, problem.scene.last)
    in_body = ghost_penalty([before.body.labeller], found.bodies, few, labels, before.settings)[number] * near
    scores = score_scene(few, labels, before.arrays, before.body.labeller.settings).scores
    compared = compare_with_training(before.body.labeller, scores, few, labels, before.settings, before.body_rules)
    return np.where(changed, in_body, problem.penalty), np.where(changed, compared.are_off(before.settings)[number], doubtful)


def _merged(scene: RecordingScene, label: Ints, apart: NDArray[np.bool_]) -> tuple[RecordingScene, Ints]:
    """The scene with the tracklets of one marker merged, but for those apart (J,), and the new number of each tracklet (J,).

    A tracklet's distances and places are compared with those of all others of its marker, so that those apart are found to be the same.
    """
    merged = ~apart & (label != NULL)
    key = np.where(merged, label, len(label) + np.arange(len(label)) + int(label.max(initial=0)))
    numbers, number = np.unique(key, return_inverse=True)
    first, last = np.full(len(numbers), np.iinfo(np.int64).max), np.full(len(numbers), -1)
    np.minimum.at(first, number, scene.first)
    np.maximum.at(last, number, scene.last)
    samples = np.bincount(number, weights=scene.samples, minlength=len(numbers)).astype(np.int64)
    track = number[scene.sampled_track]
    return replace(scene, first=first, last=last, sampled_track=track, samples=samples, independent=samples.astype(np.float64)), number


def _point_labels(before: LabelledTracklets, long: LongTracklets, problem: _RelabelProblem) -> PointLabels:
    """The labels of all points. The fit is that of the first labelling where a point has the same label."""
    labeller, clouds, found = before.body.labeller, before.clouds, long.found
    labels = long.points()
    # what a person said to be no marker is no sign that a marker is left over
    explained = np.where(problem.fixed == NULL, 0, found.label)
    left_over = labels.left_over
    points = np.nonzero(long.kept)[0][found.scene.order]
    left_over[points] = overlaps_unlabelled(explained, found.scene.first, found.scene.last)[found.scene.track]
    if not long.kept.all():
        labels = with_short_points([labeller], clouds, before.xyz, long.kept, labels, before.settings)
    same = labels.label == before.points.label
    other = ~same & (labels.label != NULL) & ~((labels.track != NULL) & (problem.fixed[labels.track] != FREE))
    fit = np.where(same, before.points.fit, 0.0)
    if other.any():
        scored, group, turns = long.fit_frames(clouds, labels), long.fit_groups(labels), before.long.found.turns_of(len(clouds))
        shown = np.zeros(len(clouds), dtype=np.bool_)
        shown[clouds.frame_of[other]] = True
        anew = point_fits(clouds, before.xyz, labels.label, labeller.body, labeller.settings, scored & shown, group, turns)
        fit = np.where(other, anew, fit)
    return replace(labels, fit=fit)


def _of_tracklets(foreign: ForeignConfidence, problem: _RelabelProblem) -> ForeignConfidence:
    """The confidence of tracklets in a foreign recording, as the first labelling found it; those that were short get the median."""
    known = problem.earlier >= 0
    log_odds = np.where(known, foreign.log_odds[problem.earlier], float(np.median(foreign.log_odds)))
    return replace(foreign, log_odds=log_odds, limit=np.where(known, foreign.limit[problem.earlier], 1.0))


def _with_known(labelling: Labelling, body: BodyInRecording, clouds: Clouds, fixed: Ints) -> Labelling:
    """The labelling with the labels that are known, fixed (P,): at confidence 1, and no other point has their markers in their frames."""
    indices, confidence = labelling.indices, labelling.confidence
    points = np.nonzero(fixed >= 0)[0]
    frames = clouds.frame_of[points]
    at = frames, body.markers[fixed[points]]
    indices[at], confidence[at] = points - clouds.offsets[frames], 1.0
    if labelling.candidates is not None:
        labelling.candidates[at] = NULL
    return labelling


def marker_chances(before: LabelledTracklets, labelling: Labelling, points: Ints) -> Floats:
    """The chance of one piece of a track to be each marker of the set, given the labels of all others: (markers of the set,).

    points: places of its points in the clouds, in the order of frames. A marker that the model has not learned has chance 0. By the body
    alone, in some of the piece's frames; O(M).
    """
    body, clouds = before.body, before.clouds
    sampled = points[np.unique(np.linspace(0, len(points) - 1, before.settings.relabel.chance_frames).round().astype(np.int64))]
    frames = np.searchsorted(clouds.offsets, sampled, side="right") - 1
    some = clouds.frames(frames)
    xyz, row = rotate_z_up(some.xyz, some.vertical), some.frame_of
    order = np.lexsort((xyz[:, 1], xyz[:, 0], -xyz[:, 2], row))
    label = np.full(len(xyz), NULL, dtype=np.int64)
    given, marker = np.nonzero(labelling.indices[frames][:, body.markers] >= 0)
    label[some.offsets[given] + labelling.indices[frames[given], body.markers[marker]]] = marker
    own = np.zeros(len(xyz), dtype=np.bool_)
    own[some.offsets[:-1] + sampled - clouds.offsets[frames]] = True
    scores = np.empty((len(xyz), before.arrays.mean.shape[1]))
    out = FrameScores(scores, np.empty(len(frames)), np.empty(len(frames), dtype=np.int64))
    sorted_xyz = np.ascontiguousarray(xyz[order])
    score_frames(sorted_xyz, some.offsets, np.arange(len(xyz)), label[order], before.arrays, body.labeller.settings, out)
    gain = np.clip(scores[own[order]], before.settings.min_score, before.settings.max_score).mean(axis=0)
    gain *= len(frames) / (1.0 + before.settings.frame_correlation * (len(frames) - 1.0))
    chance = np.zeros(len(body.names))
    chance[body.markers] = softmax(np.append(gain, 0.0))[:-1]
    return chance
