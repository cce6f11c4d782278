"""Labels of points in; the labelling of a recording out.

The points of a long tracklet share margin and fit, so that their confidence is worked out once. Points are put into order only where two
of them are candidates for one marker in one frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.whole.certainty import Certainty
from asterism.labelling.whole.foreign import ForeignConfidence
from asterism.labelling.whole.joint import SceneLabelling
from asterism.labelling.whole.scene import labels_of_body
from asterism.labelling.whole.settings import RecordingLabellingSettings
from asterism.labelling.whole.verdict import (
    JudgedPoints,
    RigidDistances,
    RivalCounts,
    VerdictRules,
    confidence_limit,
    judge_points,
)
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling
from asterism.recording.verdict import CERTAIN, OTHER_BODY, Verdict

FRAMES_AT_ONCE = 2000
"""Frames that are written at once: what is worked out for them fits into the cache."""


@dataclass(frozen=True)
class BodyInRecording:
    """A model as one of the bodies in a recording.

    labeller         labels the body in single frames
    names            all names of its marker set
    markers          (M,) those that the body model has learned
    certainty        how certain a tracklet's label is, and which labels are taken back
    frame_certainty  the same for labels of a point in a frame that is labelled by itself
    distances        near-rigid distances of the training, by which a recording is judged; None where the model keeps no sample of it
    """

    labeller: BodyLabeller
    names: tuple[str, ...]
    markers: Ints
    certainty: Certainty
    frame_certainty: Certainty
    distances: RigidDistances | None = None


@dataclass(frozen=True)
class PointLabels:
    """Labels of the P points of clouds, in their order.

    label       (P,) column among the markers of all bodies, one body after the other, -1 for none
    margin      (P,) nats; of a point without a label: 0 or below, by how much it misses its best column
    rival       (P,) that column, where there is one; -1 otherwise
    left_over   (P,) 1 where a point without a label was there at some time of the point's tracklet (in its frame, where `alone`), else 0
    fit         (P,) nats, how well the tracklets of labelled points (the points, where `alone`) lie where the others predict them, see
                `point_fits`
    foreign     how certain labels may be in a recording that is foreign to its model; None otherwise
    alone       (P,) whether the label is one of a frame that was labelled by itself
    track       (P,) number of the long tracklet of the point in its scene, -1 for none; the points of one share all of these
    found       the labels of the long tracklets
    """

    label: Ints
    margin: Floats
    rival: Ints
    left_over: Ints
    fit: Floats
    foreign: ForeignConfidence | None
    alone: NDArray[np.bool_]
    track: Ints
    found: SceneLabelling

    def confidence(self, certainty: Certainty, frame_certainty: Certainty) -> tuple[Floats, Floats]:
        """The probability that each label is right, and below which it is taken back: (P,) each."""
        in_time = certainty.confidence(self.margin, self.left_over, self.fit)
        least = np.where(self.alone, frame_certainty.least_confidence, certainty.least_confidence)
        if self.foreign is not None:
            by_evidence = self.foreign.by_evidence(in_time, self.fit)
            in_time = np.minimum(by_evidence, self.foreign.limit)
            least = np.where(by_evidence < self.foreign.least_confidence, np.inf, least)
        in_time[self.alone] = frame_certainty.confidence(self.margin[self.alone], self.left_over[self.alone], self.fit[self.alone])
        return in_time, least

    def of_some(self, points: Ints | slice) -> PointLabels:
        """Those of some of the points."""
        return replace(
            self,
            label=self.label[points],
            margin=self.margin[points],
            rival=self.rival[points],
            left_over=self.left_over[points],
            fit=self.fit[points],
            foreign=None if self.foreign is None else self.foreign.of_some(points),
            alone=self.alone[points],
            track=self.track[points],
        )


NEIGHBOURS = 2
"""Markers nearest to one in the mean body, whose name it may have got: one on each side along a limb."""

FRAMES_LOOKED_AT = 20
"""Frames that tell whether a neighbour is absent and points are left over: it is the same in all of them. Not tuned."""


def labelling_of(
    body: BodyInRecording, number: int, clouds: Clouds, labels: PointLabels, offsets: Ints, rules: RecordingLabellingSettings
) -> Labelling:
    """The labels of the body with this number; offsets: where each body's markers begin among the columns.

    A marker without a point has the probability that its best candidate was it. O(P), and O(F log F) for F points without a label; memory
    O(T M).
    """
    verdict = _verdict_of(body, number, clouds, labels, offsets)
    verdict_rules = VerdictRules() if body.distances is None else body.distances.rules
    blank = empty_labelling(body, clouds)
    out = blank.indices, blank.confidence, np.full(blank.indices.shape, NULL, dtype=np.int64)
    one_of_each = np.zeros(int(labels.track.max(initial=NULL)) + 2, dtype=np.int64)  # the last one for no tracklet
    one_of_each[labels.track] = np.arange(len(labels.track))
    mine = (labels.label == NULL) | (labels_of_body(labels.label, offsets, number) != NULL)
    doubt = _crowd_doubt(body, clouds, labels, mine)
    of_tracks, rivals = _certainty(body, labels.of_some(one_of_each), verdict, rules, doubt), RivalCounts(len(body.markers))
    for begin in range(0, len(clouds), FRAMES_AT_ONCE):
        frames = slice(begin, begin + FRAMES_AT_ONCE)
        some = clouds.frames(frames)
        here = labels.of_some(slice(clouds.offsets[begin], clouds.offsets[begin] + len(some.xyz)))
        certainty, least = (of_track[here.track] for of_track in of_tracks)
        short = np.nonzero((here.track == NULL) & (here.label != NULL))[0]
        certainty[short], least[short] = _certainty(body, here.of_some(short), verdict, rules, doubt)
        label, rival = labels_of_body(here.label, offsets, number), labels_of_body(here.rival, offsets, number)
        rivals.add(label, rival, certainty, verdict_rules)
        chance = np.where(here.label == NULL, 0.5 * np.exp(np.minimum(here.margin, 0.0)), certainty)
        rival = np.where(here.label == NULL, rival, NULL)
        _write([of_all[frames] for of_all in out], some, label, rival, chance, certainty >= least, body.markers)
    if verdict is not None:
        # labels that were all taken back are nobody's to compare
        given = bool((out[0] != NULL).any())
        pairs = rivals.exchangeable(len(clouds)) if given else ()
        named = tuple(tuple(body.names[body.markers[marker]] for marker in pair) for pair in pairs)
        verdict = replace(verdict if given else verdict.without_labels(), exchangeable=named, rough=labels.found.rough)
    indices, confidence, candidates = out
    own = body.markers
    _limit(own[beside_left_over(body.labeller.body.mean[0], indices[:, own], clouds, mine)], indices, confidence)
    _limit(own[beside_doubtful(body.labeller, indices[:, own], confidence[:, own], candidates[:, own])], indices, confidence)
    return Labelling(indices, confidence, body.names, candidates, verdict)


def beside_left_over(mean: Floats, indices: Ints, clouds: Clouds, mine: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Markers (M,) that may have their neighbour's point: the neighbour has none in most frames, and points beside them have no name.

    mean (M, 3) m, the mean body; indices (T, M); mine (P,) points that may be of this body. An elbow that is called a marker of the upper
    arm fits as well as the right name, once for a person, where hands place the latter anywhere along the arm. But the elbow then has no
    point, and wrists that belong to it are left over. O(M^2 + F n) for `FRAMES_LOOKED_AT` frames of n points.
    """
    apart, near = _neighbours(mean)
    absent = 2 * (indices != NULL).sum(axis=0) < len(indices)
    suspects = np.nonzero(~absent & absent[near].any(axis=1))[0]
    found, shown = np.zeros(len(mean), dtype=np.int64), np.zeros(len(mean), dtype=np.int64)
    some = np.unique(np.linspace(0, len(indices) - 1, min(len(indices), FRAMES_LOOKED_AT)).astype(np.int64)) if len(suspects) else ()
    for frame in some:
        points, free = clouds[frame], mine[clouds.offsets[frame] : clouds.offsets[frame + 1]].copy()
        free[indices[frame][indices[frame] != NULL]] = False
        for marker in suspects[indices[frame, suspects] != NULL]:
            shown[marker] += 1
            reach = 2.0 * max(apart[marker, other] for other in near[marker] if absent[other])
            found[marker] += bool((np.linalg.norm(points[free] - points[indices[frame, marker]], axis=1) < reach).any())
    return 2 * found > shown


def beside_doubtful(labeller: BodyLabeller, indices: Ints, confidence: Floats, candidates: Ints) -> NDArray[np.bool_]:
    """Markers (M,) that many laboratories leave out, and that are labelled beside a neighbour of whose label most frames are not sure.

    indices, confidence, candidates (T, M); labels that were taken back are candidates. The neighbour's name may be this one's point's:
    nothing is lost where nobody wears this one. An arm that is labelled one marker along, elbow as upper arm and wrist as elbow, is no
    exchange of few markers, but hardly all of it is sure.
    """
    given = indices != NULL
    known = given | (candidates != NULL)
    doubtful = known.any(axis=0) & (2 * (given & (confidence > CERTAIN)).sum(axis=0) <= known.sum(axis=0))
    return labeller.optional & doubtful[_neighbours(labeller.body.mean[0])[1]].any(axis=1)


def _neighbours(mean: Floats) -> tuple[Floats, Ints]:
    """How far markers are apart in the mean body (M, 3) m, infinitely from themselves: (M, M); and the nearest of each: (M, NEIGHBOURS)."""
    apart = np.linalg.norm(mean[:, None] - mean, axis=2)
    np.fill_diagonal(apart, np.inf)
    return apart, np.argsort(apart, axis=1)[:, :NEIGHBOURS]


def _limit(columns: Ints, indices: Ints, confidence: Floats) -> None:
    """No label of these markers is sure: indices, confidence (T, markers of the set), the latter in place."""
    here = confidence[:, columns]
    confidence[:, columns] = np.where(indices[:, columns] != NULL, np.minimum(here, CERTAIN), here)


def _write(
    out: Sequence[NDArray[Any]], clouds: Clouds, label: Ints, rival: Ints, chance: Floats, accepted: NDArray[np.bool_], markers: Ints
) -> None:
    """Write indices, confidence and candidates of some frames: (T, markers of the set) each.

    label (P,): what each point is, -1 for none; rival (P,): what a point without a label may be, -1 for none; chance (P,) of that; accepted
    (P,): whether a label is given; markers: columns of the output.
    """
    (indices, confidence, candidates), frame_of = out, clouds.frame_of
    given = np.nonzero(label != NULL)[0]
    frame, marker = frame_of[given], markers[label[given]]
    place = given - clouds.offsets[frame]
    confidence[frame, marker] = chance[given]
    indices[frame, marker] = np.where(accepted[given], place, NULL)
    candidates[frame, marker] = np.where(accepted[given], NULL, place)

    points = np.nonzero(rival != NULL)[0]
    frame, marker = frame_of[points], markers[rival[points]]
    open_ = indices[frame, marker] == NULL
    points, frame, marker = points[open_], frame[open_], marker[open_]
    held = candidates[frame, marker] != NULL  # by a point whose label was not given
    holders = clouds.offsets[frame[held]] + candidates[frame[held], marker[held]]
    points, frame, marker = (np.concatenate(both) for both in ((points, holders), (frame, frame[held]), (marker, marker[held])))
    order = np.lexsort((*clouds.xyz[points].T, chance[points]))  # the best comes last; the order of the points does not matter
    points, frame, marker = points[order], frame[order], marker[order]
    confidence[frame, marker], candidates[frame, marker] = chance[points], points - clouds.offsets[frame]


def _certainty(
    body: BodyInRecording, labels: PointLabels, verdict: Verdict | None, rules: RecordingLabellingSettings, doubt: float
) -> tuple[Floats, Floats]:
    """How certain each label is, and below which it is taken back: (P,) each. doubt: log odds that all of them lose."""
    certainty, least = labels.confidence(body.certainty, body.frame_certainty)
    certainty = np.minimum(certainty, confidence_limit(verdict))
    # the verdict says that no label is given, whatever single points may look like
    least = np.full_like(least, np.inf) if verdict is not None and verdict.kind == OTHER_BODY else least
    if labels.found.held is not None:
        # few people say little of where markers sit on others: to their model all near ones may be exchanged
        many = body.distances is None or not body.distances.few_people
        certainty = np.minimum(certainty, labels.found.held.limits(labels.label, rules.twins, with_exchanges=many))
    return (expit(logit(certainty) - doubt) if doubt else certainty), least


def _crowd_doubt(body: BodyInRecording, clouds: Clouds, labels: PointLabels, mine: NDArray[np.bool_]) -> float:
    """Log odds that labels lose where a usual frame shows more lasting points than the body has markers; see `VerdictRules.crowd_doubt`.

    Of a model of many people only: one of few is tried among such points, and a foreign recording has evidence of its own.
    mine (P,): points that may be of this body.
    """
    if body.distances is None or body.distances.spread is None or labels.foreign is not None:
        return 0.0
    counts = np.bincount(clouds.frame_of, weights=mine & (labels.track != NULL), minlength=len(clouds))
    return body.distances.rules.crowd_doubt * float(np.log(max(1.0, np.median(counts) / len(body.markers))))


def empty_labelling(body: BodyInRecording, clouds: Clouds) -> Labelling:
    """The labelling in which no marker has a point."""
    shape = (len(clouds), len(body.names))
    return Labelling(np.full(shape, NULL, dtype=np.int64), np.zeros(shape), body.names)


def _verdict_of(body: BodyInRecording, number: int, clouds: Clouds, labels: PointLabels, offsets: Ints) -> Verdict | None:
    """The verdict on the labels of the body with this number; None for a model that keeps no sample of its training."""
    if body.distances is None:
        return None
    points = JudgedPoints(clouds.frame_of, clouds.xyz, labels.label, labels.track != NULL, len(clouds))
    return judge_points(points, offsets, number, body.distances)
