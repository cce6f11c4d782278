"""A labelling in; the labels that a person should check first, as pieces of tracks, out; and the labelling with the answers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling
from asterism.tracking.linking import Tracklets, find_tracklets


@dataclass(frozen=True)
class ReviewRules:
    """How the chance that a label is wrong or missing is estimated. Chosen on the gait subjects; see docs/recordings.md.

    reach                  m: a missing marker's chance to be an unlabelled point falls by 1/e over this distance from where it is expected
    alternatives           number of other markers that an item names, at most
    min_chance             chance from which another marker is named
    unlabelled_weight      weight of a frame without a label in a piece's vote, where a label counts with its confidence
    """

    reach: float = 0.1
    alternatives: int = 3
    min_chance: float = 0.01
    unlabelled_weight: float = 0.1


_RULES = ReviewRules()


@dataclass(frozen=True)
class ReviewItem:
    """One piece of a track that a person should check: one name for it corrects all its frames.

    first_frame   first frame of the piece, counted from 0
    last_frame    last frame of the piece
    frame         frame in which a label is most likely to be wrong or missing: look here
    track         the number that the camera system gave the track, or the recording's column; -1 where neither is known
    marker        the marker that most of its frames are labelled, or None where most have no label
    confidence    mean confidence of those labels; for None the chance that the piece is not one of the missing markers
    alternatives  (marker, chance) of what else it could be, the most likely first
    samples       number of its points
    gain          expected number of its samples whose label is wrong or missing
    points        (samples,) places of its points in `clouds.xyz`
    """

    first_frame: int
    last_frame: int
    frame: int
    track: int
    marker: str | None
    confidence: float
    alternatives: tuple[tuple[str, float], ...]
    samples: int
    gain: float
    points: Ints = field(repr=False, compare=False)


def review(
    labelling: Labelling, clouds: Clouds, *, top: int | None = None, least_gain: float = 0.1, tracklets: Tracklets | None = None
) -> list[ReviewItem]:
    """List the pieces of tracks that a person should check first, by expected gain.

    top         the most items to list
    least_gain  samples that an item gains at least
    tracklets   of the clouds, where they are known already; by default those of `find_tracklets`

    A piece is a tracklet: one marker's path between two gaps, so that one name holds for all its frames. A labelled
    point gains 1 - confidence or, where its piece bears another label more often, that label's weight if it is larger. A point without
    a label gains the chance that it is one of the markers that are missing in its frame. A marker's best candidate that was not
    accepted gets the marker's confidence. The other points share what is left, the more the nearer they are to where the marker was
    last and next seen.

    Raises AsterismError where the labelling does not belong to the clouds, `top` is below 1, or `least_gain` is negative.
    O(P), and O(M) for each point without a label.

    >>> from asterism.simulation import simulate_walks
    >>> walk = simulate_walks(1, frames=30, markers="helen-hayes", seed=0)[0]
    >>> clouds = walk.clouds()
    >>> confidence = np.where(np.array(walk.labels) == "LTOE", np.full((30, 1), 0.6), 0.999)
    >>> labelling = Labelling(np.tile(np.arange(15), (30, 1)), confidence, walk.labels)
    >>> [item] = review(labelling, clouds)
    >>> item.marker, item.first_frame, item.last_frame, round(item.gain, 1)
    ('LTOE', 0, 29, 12.0)
    """
    _check(labelling, clouds)
    if top is not None and top < 1:
        raise AsterismError(f"top is {top}, which lists nothing; give 1 or more.")
    if not least_gain >= 0:
        raise AsterismError(f"least_gain is {least_gain}; give 0 or more samples.")
    piece_of = (find_tracklets(clouds) if tracklets is None else tracklets).of_point
    frame_of = clouds.frame_of
    marker_of, confidence = labels_of_points(labelling, clouds)
    votes = _votes(piece_of, marker_of, confidence, len(labelling.names))
    chance = _chances_of_unlabelled(labelling, clouds, marker_of, piece_of, votes)
    unlabelled_before = np.concatenate([[0], np.cumsum(marker_of == NULL)])
    error = _error_probability(piece_of, marker_of, confidence, chance, votes)
    gain = np.bincount(piece_of, weights=error, minlength=len(votes))
    track_of = clouds.columns if clouds.tracks is None else clouds.tracks
    order = np.argsort(piece_of, kind="stable")
    ends = np.searchsorted(piece_of[order], np.arange(len(votes) + 1))
    ranked = np.argsort(-gain, kind="stable")
    ranked = ranked[(gain[ranked] >= least_gain) & (gain[ranked] > 0)][:top]
    items = []
    for piece in ranked:
        points = order[ends[piece] : ends[piece + 1]]
        worst = points[int(np.argmax(error[points]))]
        unlabelled = unlabelled_before[points[marker_of[points] == NULL]]
        marker, mean, alternatives = _label_of_piece(labelling.names, marker_of[points], confidence[points], chance[unlabelled])
        items.append(
            ReviewItem(
                first_frame=int(frame_of[points[0]]),
                last_frame=int(frame_of[points[-1]]),
                frame=int(frame_of[worst]),
                track=int(track_of[points[0]]),
                marker=marker,
                confidence=mean,
                alternatives=alternatives,
                samples=len(points),
                gain=float(gain[piece]),
                points=points,
            )
        )
    return items


def apply_answers(labelling: Labelling, clouds: Clouds, answers: Iterable[tuple[ReviewItem, str | None]]) -> Labelling:
    """The labelling with a person's answers: which marker each item is, or None where it is not a marker. Other labels stay.

    Answered labels have confidence 1. A point that loses its marker to an answer has no label afterwards. Where two answers name one
    marker in a frame, the later answer holds. Raises AsterismError where an answer is not a marker of the labelling.

    >>> from asterism.simulation import simulate_walks
    >>> walk = simulate_walks(1, frames=30, markers="helen-hayes", seed=0)[0]
    >>> clouds = walk.clouds()
    >>> confidence = np.where(np.array(walk.labels) == "LTOE", np.full((30, 1), 0.6), 0.999)
    >>> labelling = Labelling(np.tile(np.arange(15), (30, 1)), confidence, walk.labels)
    >>> [item] = review(labelling, clouds)
    >>> answered = apply_answers(labelling, clouds, [(item, "LTOE")])
    >>> answered.confidence[:, walk.labels.index("LTOE")].tolist() == [1.0] * 30
    True
    """
    _check(labelling, clouds)
    indices, confidence = labelling.indices.copy(), labelling.confidence.copy()
    frame_of = clouds.frame_of
    for item, name in answers:
        if name is not None and name not in labelling.names:
            listed = ", ".join(labelling.names[:8])
            raise AsterismError(f"{name!r} is not a marker of the labelling ({listed}, ...); give one of its markers, or None.")
        frames = frame_of[item.points]
        places = item.points - clouds.offsets[frames]
        at, markers = np.nonzero(indices[frames] == places[:, None])
        indices[frames[at], markers], confidence[frames[at], markers] = NULL, 0.0
        if name is not None:
            marker = labelling.names.index(name)
            indices[frames, marker], confidence[frames, marker] = places, 1.0
    return replace(labelling, indices=indices, confidence=confidence)


def labels_of_points(labelling: Labelling, clouds: Clouds) -> tuple[Ints, Floats]:
    """(P,) the marker of each point, -1 without a label, and (P,) the label's confidence, 0 without a label."""
    marker_of, confidence = np.full(len(clouds.xyz), NULL, dtype=np.int64), np.zeros(len(clouds.xyz))
    frames, markers = np.nonzero(labelling.indices >= 0)
    points = clouds.offsets[frames] + labelling.indices[frames, markers]
    marker_of[points], confidence[points] = markers, labelling.confidence[frames, markers]
    return marker_of, confidence


def _check(labelling: Labelling, clouds: Clouds) -> None:
    if len(labelling.indices) != len(clouds) or (labelling.indices >= clouds.counts[:, None]).any():
        raise AsterismError(
            f"the labelling ({len(labelling.indices)} frames) does not belong to these clouds ({len(clouds)} frames); "
            "give the clouds that were labelled."
        )


def _chances_of_unlabelled(labelling: Labelling, clouds: Clouds, marker_of: Ints, piece_of: Ints, votes: Floats) -> Floats:
    """(F, M) for the F points without a label, in order, the chance to be each of the markers that are missing in their frame."""
    unlabelled = np.nonzero(marker_of == NULL)[0]
    frames = clouds.frame_of[unlabelled]
    missing = labelling.indices[frames] == NULL
    distance = np.linalg.norm(clouds.xyz[unlabelled, None] - _paths(labelling.positions(clouds))[frames], axis=2)
    near = np.exp(-np.where(np.isnan(distance), _RULES.reach, distance) / _RULES.reach)
    confidence, places = labelling.confidence[frames], unlabelled - clouds.offsets[frames]
    best = np.full(confidence.shape, NULL) if labelling.candidates is None else labelling.candidates[frames]
    is_best = best == places[:, None]
    near[is_best] = 0.0
    # the other points share the chance that the marker is in view and is not its best candidate
    left = np.where(best == NULL, 1.0, 1.0 - confidence)
    shared = np.where(is_best, confidence, confidence * left * near / np.maximum(_sum_in_frame(near, frames, len(clouds)), 1e-300))
    chance = np.where(missing, np.maximum(shared, votes[piece_of[unlabelled]]), 0.0)
    chance /= np.maximum(_sum_in_frame(chance, frames, len(clouds)), 1.0)
    return np.asarray(chance / np.maximum(chance.sum(axis=1, keepdims=True), 1.0))


def _sum_in_frame(values: Floats, frames: Ints, count: int) -> Floats:
    """(F, M) for each point, whose frame is in `frames`, the sum of `values` over the points of its frame."""
    total = np.zeros((count, values.shape[1]))
    np.add.at(total, frames, values)
    return total[frames]


def _paths(positions: Floats) -> Floats:
    """(T, M, 3) the markers' paths with straight lines across their gaps; NaN for a marker that is never seen."""
    every = np.arange(len(positions))
    out = positions.copy()
    for marker in range(positions.shape[1]):
        seen = np.nonzero(~np.isnan(positions[:, marker, 0]))[0]
        if 0 < len(seen) < len(positions):
            for axis in range(3):
                out[:, marker, axis] = np.interp(every, seen, positions[seen, marker, axis])
    return out


def _votes(piece_of: Ints, marker_of: Ints, confidence: Floats, markers: int) -> Floats:
    """(pieces, M) the share of each marker among a piece's labels, weighted by their confidence; frames without a label count a little."""
    count = int(piece_of.max(initial=-1)) + 1
    votes = np.zeros((count, markers))
    given = marker_of >= 0
    np.add.at(votes, (piece_of[given], marker_of[given]), confidence[given])
    without = _RULES.unlabelled_weight * np.bincount(piece_of[~given], minlength=count)
    return votes / np.maximum(votes.sum(axis=1) + without, 1e-300)[:, None]


def _error_probability(piece_of: Ints, marker_of: Ints, confidence: Floats, chance: Floats, votes: Floats) -> Floats:
    """(P,) the probability that the point's label is wrong or missing."""
    given = marker_of >= 0
    error = 1.0 - confidence
    error[~given] = chance.sum(axis=1)
    another = given & (marker_of != votes.argmax(axis=1)[piece_of])
    error[another] = np.maximum(error, votes.max(axis=1, initial=0.0)[piece_of])[another]
    return np.clip(error, 0.0, 1.0)


def _label_of_piece(
    names: tuple[str, ...], markers: Ints, confidence: Floats, chance: Floats
) -> tuple[str | None, float, tuple[tuple[str, float], ...]]:
    """The label of most of a piece's points, its confidence, and what else it could be; chance (F, M) of its points without a label."""
    weight = chance.sum(axis=0)
    given = markers >= 0
    np.add.at(weight, markers[given], confidence[given])
    if 2 * given.sum() > len(markers):
        marker = int(np.bincount(markers[given]).argmax())
        mean = float(confidence[markers == marker].sum() / given.sum())
    else:
        marker, mean = NULL, float(1.0 - min(1.0, chance.sum() / len(chance)))
    weight /= len(markers)
    others = [int(m) for m in np.argsort(-weight, kind="stable") if m != marker and weight[m] >= _RULES.min_chance]
    return (names[marker] if marker >= 0 else None), mean, tuple((names[m], float(weight[m])) for m in others[: _RULES.alternatives])
