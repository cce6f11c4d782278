"""Labels of points in; the labelling of a recording out: what `labelling_of` gives, for recordings that are labelled again and again.

The points of a long tracklet share margin and fit, so that their confidence is worked out once. Points are put into order only where two
of them are candidates for one marker in one frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from asterism.labelling.whole.label import BodyInRecording, PointLabels
from asterism.labelling.whole.verdict import MIN_FRAMES, VerdictRules, confidence_limit, judge, judge_scene
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling
from asterism.recording.verdict import Verdict


@dataclass(frozen=True)
class TieOrder:
    """Places by which points are put into order where nothing else tells: the same for any order of the points.

    rank      (P,) each point's place among all, by its coordinates
    frame_of  (P,) its frame
    place     (P,) its place in its frame
    """

    rank: Ints
    frame_of: Ints
    place: Ints

    @classmethod
    def of(cls, clouds: Clouds) -> TieOrder:
        """The order of the points of clouds. O(P log P)."""
        rank, frame_of = np.empty(len(clouds.xyz), dtype=np.int64), clouds.frame_of
        rank[np.lexsort(clouds.xyz.T)] = np.arange(len(rank))
        return cls(rank, frame_of, np.arange(len(rank)) - clouds.offsets[frame_of])


def fast_labelling(body: BodyInRecording, clouds: Clouds, labels: PointLabels, track: Ints, ties: TieOrder) -> Labelling:
    """The labelling by the labels of all points, of one body; equal to `labelling_of`.

    track (P,): number of the long tracklet of each point, whose points share label, margin and fit; -1 for others.
    """
    label, rival, frame_of = labels.label, labels.rival, ties.frame_of
    certainty, least = _by_tracklets(body, labels, track)
    verdict = _verdict(body, clouds, labels, frame_of)
    certainty = np.minimum(certainty, confidence_limit(verdict))
    if body.distances is not None:
        certainty = np.minimum(certainty, body.distances.margin_limits(labels.margin))
    if verdict is not None:
        pairs = _exchangeable(label, rival, certainty, len(clouds), len(body.markers))
        named = tuple(tuple(body.names[body.markers[marker]] for marker in pair) for pair in pairs)
        verdict = replace(verdict, exchangeable=named)
    shape = (len(clouds), len(body.names))
    indices, candidates = np.full(shape, NULL, dtype=np.int64), np.full(shape, NULL, dtype=np.int64)
    confidence = np.zeros(shape)
    given = np.nonzero(label != NULL)[0]
    at = frame_of[given], body.markers[label[given]]
    confidence[at], candidates[at] = certainty[given], ties.place[given]
    free = np.nonzero((label == NULL) & (rival != NULL))[0]
    chance = 0.5 * np.exp(np.minimum(labels.margin[free], 0.0))
    # the best candidate of each marker in each frame comes last; a label that is as certain as a candidate without one comes by its place
    holder = np.full(shape, NULL, dtype=np.int64)
    holder[at] = given
    there = holder[frame_of[free], body.markers[rival[free]]]
    beats = (there == NULL) | (chance > certainty[there]) | ((chance == certainty[there]) & (ties.rank[free] > ties.rank[there]))
    free, chance = free[beats], chance[beats]
    order = np.lexsort((ties.rank[free], chance))
    free, chance = free[order], chance[order]
    at_free = frame_of[free], body.markers[rival[free]]
    confidence[at_free], candidates[at_free] = chance, ties.place[free]
    given = given[certainty[given] >= least[given]]
    at = frame_of[given], body.markers[label[given]]
    indices[at], confidence[at] = ties.place[given], certainty[given]
    candidates[indices != NULL] = NULL
    return Labelling(indices, confidence, body.names, candidates, verdict)


def _by_tracklets(body: BodyInRecording, labels: PointLabels, track: Ints) -> tuple[Floats, Floats]:
    """How certain each label is, and below which it is taken back: (P,) each, worked out once for each long tracklet."""
    by_itself = np.nonzero((track == NULL) & ((labels.label != NULL) | labels.alone))[0]
    count = int(track.max(initial=-1)) + 1
    one = np.zeros(count, dtype=np.int64)
    points = np.nonzero(track != NULL)[0]
    one[track[points]] = points
    some = np.concatenate([one, by_itself])
    foreign = labels.foreign
    if foreign is not None:
        foreign = replace(foreign, log_odds=foreign.log_odds[some], limit=foreign.limit[some])
    few = PointLabels(
        labels.label[some],
        labels.margin[some],
        labels.rival[some],
        labels.left_over[some],
        labels.fit[some],
        foreign,
        labels.alone[some],
        labels.found,
    )
    certainty, least = few.confidence(body.certainty, body.frame_certainty)
    out, limit = np.zeros(len(track)), np.zeros(len(track))
    out[points], limit[points] = certainty[track[points]], least[track[points]]
    out[by_itself], limit[by_itself] = certainty[count:], least[count:]
    return out, limit


def _verdict(body: BodyInRecording, clouds: Clouds, labels: PointLabels, frame_of: Ints) -> Verdict | None:
    """The verdict, by the long tracklets, or by all points where these are in few frames."""
    scene, markers = labels.found.scene, len(body.markers)
    if body.distances is None:
        return None
    if len(scene.sampled_frames) >= MIN_FRAMES:
        return judge_scene(scene, labels.found.label, np.array([0, markers]), 0, body.distances)
    positions = np.full((len(clouds), markers, 3), np.nan)
    given = labels.label != NULL
    positions[frame_of[given], labels.label[given]] = clouds.xyz[given]
    return judge(positions, clouds.counts, body.distances)


def _exchangeable(label: Ints, rival: Ints, certainty: Floats, frames: int, markers: int) -> tuple[tuple[int, int], ...]:
    """What `verdict.exchangeable` gives, in one pass over the points."""
    own = np.bincount(label[label != NULL], minlength=markers)
    doubtful = np.nonzero((label != NULL) & (rival != NULL) & (certainty < VerdictRules().either_way))[0]
    table = np.bincount(label[doubtful] * markers + rival[doubtful], minlength=markers * markers).reshape(markers, markers)
    usual = np.where((own > 0) & (2 * own >= frames) & (2 * table.sum(axis=1) > own), table.argmax(axis=1), NULL)
    return tuple((m, int(usual[m])) for m in range(markers) if usual[m] > m and usual[usual[m]] == m)
