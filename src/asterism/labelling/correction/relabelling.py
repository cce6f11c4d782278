"""A labelled recording of one body or several, and what a person says of its tracks, in; its labels again out.

Each body is labelled again by itself, with the points of the others left out: what a person says of one seldom concerns another. What
labelling again changes is laid over the first labels, which may come from anywhere: from stretches, or from names of the file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.labelling.correction.pieces import by_first_points
from asterism.labelling.recording_labeller import LabelledBodies, RecordingLabeller, TrainedModel
from asterism.labelling.review import labels_of_points
from asterism.labelling.whole.bodies import SeveralBodies
from asterism.labelling.whole.relabel import FREE, LabelledTracklets, label_tracklets, marker_chances, relabel_tracklets
from asterism.labelling.whole.short import tracklets_of
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling
from asterism.tracking.linking import Tracklets, find_tracklets


@dataclass(frozen=True)
class _RelabelledBody:
    """One body of the recording.

    before  its first labelling, of its points alone
    points  (p,) these, by their places among all points
    start   the place of its first marker among those of all bodies
    column  (M,) the column of the body's model for each of its markers, -1 for those that the model has not learned
    """

    before: LabelledTracklets
    points: Ints
    start: int
    column: Ints

    @classmethod
    def of(cls, before: LabelledTracklets, points: Ints, start: int) -> _RelabelledBody:
        column = np.full(len(before.body.names), NULL, dtype=np.int64)
        column[before.body.markers] = np.arange(len(before.body.markers))
        return cls(before, points, start, column)

    @property
    def markers(self) -> slice:
        """Its markers among those of all bodies."""
        return slice(self.start, self.start + len(self.column))


class Relabelling:
    """Labels a recording again, as often as a person says something."""

    def __init__(self, labeller: RecordingLabeller, clouds: Clouds, labelling: Labelling, bodies: LabelledBodies | None) -> None:
        """labelling: the first one; bodies: what the models alone say, None where they said it of stretches only."""
        self.clouds, self.first = clouds, labelling
        # The one body's own tracklets are there already: labelling it again would only cost time.
        if bodies is not None and bodies.tracklets is not None:
            self._bodies = [_RelabelledBody.of(bodies.tracklets, np.arange(len(clouds.xyz)), 0)]
        else:
            self._bodies = _bodies(labeller, clouds, [labelling] if bodies is None else bodies.bodies)
        self.tracklets = by_first_points(self._all_tracklets())

    @property
    def _is_whole(self) -> bool:
        """Whether the first labels are those of one body and all points, as its model gave them."""
        first, (body, *others) = self.first, self._bodies
        given = body.before.labelling
        is_all = not others and len(body.points) == len(self.clouds.xyz)
        return is_all and first.indices is given.indices and first.confidence is given.confidence

    def label(self, tracklets: Tracklets, said: Ints) -> Labelling:
        """The labels with what was said.

        tracklets: those of this recording, or some of them cut; said (J,): the place of a tracklet's marker, -1 for no marker, `FREE` for
        nothing.
        """
        again = [self._again(body, tracklets, said) for body in self._bodies]
        # Labels of the file or of stretches must stay where nothing was said.
        labelling = again[0] if self._is_whole else self._laid_over(again)
        return self._with_said(labelling, said[tracklets.of_point])

    def chances(self, labelling: Labelling, points: Ints) -> Floats:
        """The chance of a piece of a track to be each of all markers, given the labels of all others: see `marker_chances`."""
        chances = np.zeros(len(labelling.names))
        for body in self._bodies:
            places = np.searchsorted(body.points, points)
            # A piece whose points are not all of this body has no chance in it.
            if places[-1] < len(body.points) and (body.points[np.minimum(places, len(body.points) - 1)] == points).all():
                chances[body.markers] = marker_chances(body.before, self._of_body(body, labelling), places)
        return chances

    def _again(self, body: _RelabelledBody, tracklets: Tracklets, said: Ints) -> Labelling:
        """A body's labels with what was said, of its points alone."""
        shown = np.zeros(len(self.clouds.xyz), dtype=np.bool_)
        shown[body.points] = True
        number = np.unique(tracklets.of_point[shown])
        own = said[number] - body.start
        # another body's marker is none of this one
        mine = (own >= 0) & (own < len(body.column)) & (said[number] >= 0)
        column = np.where(mine, body.column[np.where(mine, own, 0)], NULL)
        return relabel_tracklets(body.before, tracklets_of(tracklets, shown), np.where(said[number] == FREE, FREE, column))

    def _laid_over(self, again: list[Labelling]) -> Labelling:
        """The first labels, with what labelling the bodies again has changed in them."""
        first = self.first
        indices, confidence = first.indices.copy(), first.confidence.copy()
        candidates = None if first.candidates is None else first.candidates.copy()
        changed = np.zeros(indices.shape, dtype=np.bool_)
        for body, labelling in zip(self._bodies, again, strict=True):
            before = body.before.labelling
            # What did not change keeps the first label, wherever that came from.
            differs = (labelling.indices != before.indices) | (labelling.confidence != before.confidence)
            frames, markers = np.nonzero(differs)
            at = frames, body.start + markers
            changed[at] = True
            indices[at] = self._places(body, labelling.indices, frames, markers)
            confidence[at] = labelling.confidence[frames, markers]
            if candidates is not None:
                of_body = labelling.candidates
                candidates[at] = NULL if of_body is None else self._places(body, of_body, frames, markers)
        # a point has one label: that which has changed
        taken = np.zeros(len(self.clouds.xyz), dtype=np.bool_)
        frames, markers = np.nonzero(changed & (indices != NULL))
        taken[self.clouds.offsets[frames] + indices[frames, markers]] = True
        frames, markers = np.nonzero(~changed & (indices != NULL))
        lost = taken[self.clouds.offsets[frames] + indices[frames, markers]]
        indices[frames[lost], markers[lost]], confidence[frames[lost], markers[lost]] = NULL, 0.0
        return replace(first, indices=indices, confidence=confidence, candidates=candidates)

    def _places(self, body: _RelabelledBody, indices: Ints, frames: Ints, markers: Ints) -> Ints:
        """Places (n,) of a body's points in their frames, among all points; -1 stays."""
        given = indices[frames, markers]
        point = body.points[np.where(given == NULL, 0, body.before.clouds.offsets[frames] + given)]
        return np.where(given == NULL, NULL, point - self.clouds.offsets[frames])

    def _of_body(self, body: _RelabelledBody, labelling: Labelling) -> Labelling:
        """A labelling of all bodies as one of a body and its points alone."""
        # With one body and all points the labelling is already its own.
        if len(body.points) == len(self.clouds.xyz) and len(labelling.names) == len(body.column):
            return labelling
        indices = np.full((len(self.clouds), len(body.column)), NULL, dtype=np.int64)
        frames, markers = np.nonzero(labelling.indices[:, body.markers] != NULL)
        point = self.clouds.offsets[frames] + labelling.indices[frames, body.start + markers]
        place = np.searchsorted(body.points, point)
        known = place < len(body.points)
        # Points of other bodies lie between this one's: only exact hits are its own.
        known[known] = body.points[place[known]] == point[known]
        indices[frames[known], markers[known]] = place[known] - body.before.clouds.offsets[frames[known]]
        return Labelling(indices, labelling.confidence[:, body.markers], body.before.body.names)

    def _with_said(self, labelling: Labelling, said: Ints) -> Labelling:
        """The labelling with what was said of points (P,), where the models could not hold it.

        They cannot where the marker is not learned, or where the point was another body's.
        """
        marker, confidence = labels_of_points(labelling, self.clouds)
        # What a person said holds with certainty, also where the model would not have said it.
        missed = (said != FREE) & ((marker != said) | ((said != NULL) & (confidence < 1.0)))
        points = np.nonzero(missed)[0]
        if not len(points):
            return labelling
        indices, certain = labelling.indices.copy(), labelling.confidence.copy()
        frames = self.clouds.frame_of[points]
        # The point's former label goes first: two markers must not share it.
        before = marker[points] != NULL
        indices[frames[before], marker[points][before]], certain[frames[before], marker[points][before]] = NULL, 0.0
        named = said[points] != NULL
        at = frames[named], said[points][named]
        indices[at], certain[at] = points[named] - self.clouds.offsets[frames[named]], 1.0
        return replace(labelling, indices=indices, confidence=certain)

    def _all_tracklets(self) -> Tracklets:
        """The tracklets of all points: those of the bodies, and those of points that belong to none."""
        of_point = np.full(len(self.clouds.xyz), NULL, dtype=np.int64)
        first, last = list[Ints](), list[Ints]()
        parts = [(body.points, body.before.long.tracklets) for body in self._bodies]
        # Points of no body are kept as pieces, or a person could not name them.
        rest = np.ones(len(of_point), dtype=np.bool_)
        for points, _ in parts:
            rest[points] = False
        if rest.any():
            parts.append((np.nonzero(rest)[0], find_tracklets(self.clouds.select(rest))))
        count = 0
        for points, tracklets in parts:
            of_point[points] = count + tracklets.of_point
            count += len(tracklets)
            first.append(tracklets.first)
            last.append(tracklets.last)
        return Tracklets(of_point, np.concatenate(first), np.concatenate(last))


def _bodies(labeller: RecordingLabeller, clouds: Clouds, labellings: Sequence[Labelling]) -> list[_RelabelledBody]:
    """The bodies of a recording, each labelled by itself; labellings: of each of them, and perhaps of others that are not corrected."""
    body_of = _body_of_points(clouds, labellings)
    bodies, start = list[_RelabelledBody](), 0
    for number, model in enumerate(labeller.models):
        shown = body_of == number
        if shown.any():
            try:
                before = _labelled_alone(labeller, model, clouds.select(shown))
            except SeveralBodies:  # a third person, whose points no body has: only what has a label is surely of this one
                shown = labels_of_points(labellings[number], clouds)[0] != NULL
                before = _labelled_alone(labeller, model, clouds.select(shown))
            bodies.append(_RelabelledBody.of(before, np.nonzero(shown)[0], start))
        start += len(model.marker_set)
    return bodies


def _labelled_alone(labeller: RecordingLabeller, model: TrainedModel, clouds: Clouds) -> LabelledTracklets:
    settings = labeller.settings
    return label_tracklets(model.in_recording(), clouds, settings.recording, settings.subject, model.state.body_rules, settings.workers)


def _body_of_points(clouds: Clouds, labellings: Sequence[Labelling]) -> Ints:
    """(P,) which of the bodies each point belongs to: whole tracklets go to the body that labels most of their points.

    A tracklet without a label goes to the nearest body of its frames.
    """
    if len(labellings) == 1:
        return np.zeros(len(clouds.xyz), dtype=np.int64)
    tracklets = find_tracklets(clouds)
    votes, distance = np.zeros((len(tracklets), len(labellings))), np.zeros((len(tracklets), len(labellings)))
    frames = clouds.frame_of
    for number, labelling in enumerate(labellings):
        marker, _ = labels_of_points(labelling, clouds)
        # By votes of points: a single wrong label must not move a tracklet to another body.
        votes[:, number] = np.bincount(tracklets.of_point, weights=marker != NULL, minlength=len(tracklets))
        own = np.bincount(frames, weights=marker != NULL, minlength=len(clouds))
        centre = np.stack([np.bincount(frames, weights=(marker != NULL) * x, minlength=len(clouds)) for x in clouds.xyz.T], axis=1)
        away = np.linalg.norm(clouds.xyz - (centre / np.maximum(own, 1.0)[:, None])[frames], axis=1)
        # A body that a frame does not show is no neighbour there.
        away = np.where(own[frames] > 0, away, np.inf)
        nearest = np.full(len(tracklets), np.inf)
        np.minimum.at(nearest, tracklets.of_point, away)
        distance[:, number] = nearest
    body = np.where(votes.any(axis=1), votes.argmax(axis=1), distance.argmin(axis=1))
    return np.asarray(body[tracklets.of_point])
