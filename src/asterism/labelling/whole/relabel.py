"""A labelled recording and what a person says of some tracklets in; the recording labelled again, and at once, out.

The first labelling looks for the body in single frames and adapts the model to the subject, which takes most of its time. Both are kept:
labelling again only repeats the steps in which all tracklets are labelled together (`joint.py`), with the person's labels held.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from asterism.geometry import rotate_z_up
from asterism.labelling.body.model import BodyRules
from asterism.labelling.body.subject import SubjectRules
from asterism.labelling.whole._kernels import FrameScores, score_frames
from asterism.labelling.whole.foreign import ForeignConfidence
from asterism.labelling.whole.joint import FREE, relabel_scene
from asterism.labelling.whole.label import BodyInRecording, LongTracklets, label_all_points, label_long_tracklets, labelling_of
from asterism.labelling.whole.scene import RecordingLabellingSettings, marker_offsets, prepare_scene
from asterism.labelling.whole.short import tracklets_of
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling
from asterism.tracking.linking import Tracklets

CHANCE_FRAMES = 20
"""Frames of a piece by which the chances of other markers are told, at most."""


@dataclass(frozen=True)
class LabelledTracklets:
    """A labelled recording of one body, and what labelling it again begins with.

    body        the model
    clouds      the recording, of P points in T frames; at least one point
    long        its tracklets: all of them, which are labelled together, and the labels of these
    by_itself   (P,) the points of tracklets that are labelled together because they are long, not because something is known of them
    fixed       (J,) what a person said of each of the J tracklets: a column of the body's markers, -1 for no marker, `FREE` for nothing
    labelling   the labels, of all markers of the body's set; those that a person gave have confidence 1
    body_rules  with which the model was trained
    """

    body: BodyInRecording
    clouds: Clouds
    long: LongTracklets
    by_itself: NDArray[np.bool_]
    fixed: Ints
    labelling: Labelling
    body_rules: BodyRules


def label_tracklets(
    body: BodyInRecording, clouds: Clouds, body_rules: BodyRules, workers: int = 1, progress: Progress | None = None
) -> LabelledTracklets:
    """Label a recording as `label_whole` does, with one body, and keep what labelling it again needs; clouds have at least one point.

    Raises SeveralBodies where the recording certainly shows two such bodies.
    """
    rules = RecordingLabellingSettings()
    long = label_long_tracklets([body.labeller], clouds, rules, SubjectRules(), body_rules, workers, progress, body)
    fixed = np.full(len(long.tracklets), FREE, dtype=np.int64)
    return LabelledTracklets(body, clouds, long, long.kept, fixed, _labelling(body, clouds, long, rules), body_rules)


def relabel_tracklets(before: LabelledTracklets, tracklets: Tracklets, fixed: Ints) -> LabelledTracklets:
    """Label a recording again.

    tracklets: those of before, or some of them cut; fixed (J,): what is known of each, see `LabelledTracklets`. What is known may change in
    any way: nothing of an earlier call stays but the labels to begin with. Of two tracklets that are known to be one marker at the same
    time, one is taken. O(P), and the steps of `relabel_scene`.
    """
    rules, body, clouds = RecordingLabellingSettings(), before.body, before.clouds
    known = fixed[tracklets.of_point] != FREE
    kept = before.by_itself | known  # a short tracklet of which something is known is labelled with the long ones
    scene = prepare_scene(clouds.select(kept), tracklets_of(tracklets, kept), rules)
    number = np.empty(len(scene.first), dtype=np.int64)
    number[scene.track] = tracklets.of_point[np.nonzero(kept)[0][scene.order]]
    earlier = _of_points(before)
    of_scene = earlier[np.nonzero(kept)[0][scene.order]]
    start = np.full(len(scene.first), NULL, dtype=np.int64)
    was_long = of_scene != NULL
    start[scene.track[was_long]] = before.long.found.label[of_scene[was_long]]
    found = relabel_scene([body.labeller], scene, before.long.found.bodies, start, fixed[number], rules, before.body_rules)
    foreign = before.long.foreign
    if foreign is not None:
        foreign = _of_tracklets(foreign, len(scene.first), scene.track[was_long], of_scene[was_long])
    long = LongTracklets(tracklets, kept, found, foreign)
    labelling = _with_known(_labelling(body, clouds, long, rules), body, clouds, fixed[tracklets.of_point])
    return LabelledTracklets(body, clouds, long, before.by_itself, fixed, labelling, before.body_rules)


def _labelling(body: BodyInRecording, clouds: Clouds, long: LongTracklets, rules: RecordingLabellingSettings) -> Labelling:
    labels = label_all_points([body.labeller], clouds, long, rules)
    return labelling_of(body, 0, clouds, labels, marker_offsets([body.labeller]))


def _of_points(before: LabelledTracklets) -> Ints:
    """(P,) the number in its scene of each point's long tracklet; -1 for points of short ones."""
    scene, kept = before.long.found.scene, before.long.kept
    out = np.full(len(kept), NULL, dtype=np.int64)
    out[np.nonzero(kept)[0][scene.order]] = scene.track
    return out


def _of_tracklets(foreign: ForeignConfidence, tracklets: int, track: Ints, earlier: Ints) -> ForeignConfidence:
    """The confidence of new tracklets, those of points that were in earlier ones; others get the median."""
    log_odds, limit = np.full(tracklets, float(np.median(foreign.log_odds))), np.ones(tracklets)
    log_odds[track], limit[track] = foreign.log_odds[earlier], foreign.limit[earlier]
    return replace(foreign, log_odds=log_odds, limit=limit)


def _with_known(labelling: Labelling, body: BodyInRecording, clouds: Clouds, fixed: Ints) -> Labelling:
    """The labelling with the labels that are known, fixed (P,): at confidence 1, and no other point has their markers in their frames."""
    indices, confidence = labelling.indices.copy(), labelling.confidence.copy()
    candidates = None if labelling.candidates is None else labelling.candidates.copy()
    points = np.nonzero(fixed >= 0)[0]
    frames = clouds.frame_of[points]
    at = frames, body.markers[fixed[points]]
    indices[at], confidence[at] = points - clouds.offsets[frames], 1.0
    if candidates is not None:
        candidates[at] = NULL
    return replace(labelling, indices=indices, confidence=confidence, candidates=candidates)


def marker_chances(before: LabelledTracklets, labelling: Labelling, points: Ints) -> Floats:
    """The chance of one piece of a track to be each marker of the set, given the labels of all others: (markers of the set,).

    points: places of its points in the clouds, in the order of frames. A marker that the model has not learned has chance 0. By the body
    alone, in some of the piece's frames; O(M).
    """
    body, clouds, rules = before.body, before.clouds, RecordingLabellingSettings()
    sampled = points[np.unique(np.linspace(0, len(points) - 1, CHANCE_FRAMES).round().astype(np.int64))]
    frames = clouds.frame_of[sampled]
    some = clouds.frames(frames)
    xyz, row = rotate_z_up(some.xyz, some.vertical), some.frame_of
    order = np.lexsort((xyz[:, 1], xyz[:, 0], -xyz[:, 2], row))
    label = np.full(len(xyz), NULL, dtype=np.int64)
    given, marker = np.nonzero(labelling.indices[frames][:, body.markers] >= 0)
    label[some.offsets[given] + labelling.indices[frames[given], body.markers[marker]]] = marker
    own = np.zeros(len(xyz), dtype=np.bool_)
    own[some.offsets[:-1] + sampled - clouds.offsets[frames]] = True
    model = before.long.found.bodies[0]
    arrays, settings = (body.labeller.body if model is body.labeller.model else model.arrays()), body.labeller.settings
    scores = np.empty((len(xyz), arrays.mean.shape[1]))
    out = FrameScores(scores, np.empty(len(frames)), np.empty(len(frames), dtype=np.int64))
    score_frames(np.ascontiguousarray(xyz[order]), some.offsets, np.arange(len(xyz)), label[order], arrays, settings, out)
    gain = np.clip(scores[own[order]], rules.min_score, rules.max_score).mean(axis=0)
    gain *= len(frames) / (1.0 + rules.frame_correlation * (len(frames) - 1.0))
    chance = np.zeros(len(body.names))
    chance[body.markers] = softmax(np.append(gain, 0.0))[:-1]
    return chance
