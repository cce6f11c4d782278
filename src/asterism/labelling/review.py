"""A labelling in; out comes what a person should look at first, each item settled by naming one piece of a track once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling
from asterism.tracking.linking import find_tracklets

_NEAR = 0.1
_CANDIDATES = 3
_LEAST_CHANCE = 0.01
_SILENT = 0.1


@dataclass(frozen=True)
class Item:
    """One piece of a track that a person should look at: whoever says once which marker it is settles all its frames.

    first_frame, last_frame  the piece, both inclusive, counted from 0
    frame       where the doubt is greatest: look here
    track       the number that the camera system gave the track, or the recording's column; -1 for none
    marker      the marker that most of its frames are labelled, or None where most have no label
    confidence  mean confidence of those labels; for None the chance that the piece is none of the missing markers
    perhaps     (marker, chance) of what else it could be, the likeliest first
    samples     points that naming it once decides
    gain        expected number of its samples whose label is wrong or missing, and would be mended
    points      (samples,) places of its points in `clouds.xyz`
    """

    first_frame: int
    last_frame: int
    frame: int
    track: int
    marker: str | None
    confidence: float
    perhaps: tuple[tuple[str, float], ...]
    samples: int
    gain: float
    points: Ints = field(repr=False, compare=False)


def review(labelling: Labelling, clouds: Clouds, *, top: int | None = None, least_gain: float = 0.1) -> list[Item]:
    """What a person should look at first: the pieces of tracks by expected gain, those that gain at least `least_gain` samples.

    top: at most so many. A piece is a tracklet (`find_tracklets`): one marker's path between two gaps, in which one touch holds for all
    frames. A given label gains 1 - confidence per frame, or, where its piece bears another
    label more often, the weight of that one. A point without a label gains the confidence of the markers that are missing in its
    frame: all of it where it is the marker's best candidate that was not given, else a share of what that one leaves, the larger the nearer
    it is to where the marker was last and next seen.
    Raises AsterismError where the labelling is not one of these clouds, `top` is below 1, or `least_gain` is negative.
    O(P) and O(M) for each point without a label.
    """
    _check(labelling, clouds)
    if top is not None and top < 1:
        raise AsterismError(f"a list of the top {top} is empty; ask for 1 or more.")
    if not least_gain >= 0:
        raise AsterismError(f"a least gain of {least_gain} makes no sense; give 0 or more samples.")
    piece_of = find_tracklets(clouds).of_point
    frame_of = clouds.frame_of
    marker_of, confidence = labels_of_points(labelling, clouds)
    votes = _votes(piece_of, marker_of, confidence, len(labelling.names))
    chance = _chances_of_free_points(labelling, clouds, marker_of, piece_of, votes)
    free_before = np.concatenate([[0], np.cumsum(marker_of == NULL)])
    doubt = _doubt(piece_of, marker_of, confidence, chance, votes)
    gain = np.bincount(piece_of, weights=doubt, minlength=len(votes))
    track_of = clouds.columns if clouds.tracks is None else clouds.tracks
    order = np.argsort(piece_of, kind="stable")
    ends = np.searchsorted(piece_of[order], np.arange(len(votes) + 1))
    ranked = np.argsort(-gain, kind="stable")
    ranked = ranked[(gain[ranked] >= least_gain) & (gain[ranked] > 0)][:top]
    items = []
    for piece in ranked:
        points = order[ends[piece] : ends[piece + 1]]
        worst = points[int(np.argmax(doubt[points]))]
        free = free_before[points[marker_of[points] == NULL]]
        said, sure, perhaps = _told(labelling.names, marker_of[points], confidence[points], chance[free])
        items.append(
            Item(
                first_frame=int(frame_of[points[0]]),
                last_frame=int(frame_of[points[-1]]),
                frame=int(frame_of[worst]),
                track=int(track_of[points[0]]),
                marker=said,
                confidence=sure,
                perhaps=perhaps,
                samples=len(points),
                gain=float(gain[piece]),
                points=points,
            )
        )
    return items


def settle(labelling: Labelling, clouds: Clouds, answers: Iterable[tuple[Item, str | None]]) -> Labelling:
    """The labelling after a person has said of items which marker each is, or None for no marker at all; all else stays.

    Settled labels have confidence 1; a marker that an answer takes from another point leaves that without a label. Where two answers
    claim one marker in a frame, the later one has it. Raises AsterismError where an answer is no marker of the labelling.
    """
    _check(labelling, clouds)
    indices, confidence = labelling.indices.copy(), labelling.confidence.copy()
    frame_of = clouds.frame_of
    for item, name in answers:
        if name is not None and name not in labelling.names:
            raise AsterismError(f"{name!r} is none of the labelling's markers ({', '.join(labelling.names[:8])}, ...); give one, or None.")
        frames = frame_of[item.points]
        places = item.points - clouds.offsets[frames]
        at, markers = np.nonzero(indices[frames] == places[:, None])
        indices[frames[at], markers], confidence[frames[at], markers] = NULL, 0.0
        if name is not None:
            marker = labelling.names.index(name)
            indices[frames, marker], confidence[frames, marker] = places, 1.0
    return replace(labelling, indices=indices, confidence=confidence)


def labels_of_points(labelling: Labelling, clouds: Clouds) -> tuple[Ints, Floats]:
    """For each point of the clouds the marker that it was labelled, -1 for none, and the label's confidence, 0 for none: (P,) both."""
    marker_of, confidence = np.full(len(clouds.xyz), NULL, dtype=np.int64), np.zeros(len(clouds.xyz))
    frames, markers = np.nonzero(labelling.indices >= 0)
    points = clouds.offsets[frames] + labelling.indices[frames, markers]
    marker_of[points], confidence[points] = markers, labelling.confidence[frames, markers]
    return marker_of, confidence


def _check(labelling: Labelling, clouds: Clouds) -> None:
    if len(labelling.indices) != len(clouds) or (labelling.indices >= clouds.counts[:, None]).any():
        raise AsterismError(
            f"the labelling ({len(labelling.indices)} frames) is not one of these clouds ({len(clouds)} frames); give the clouds labelled."
        )


def _chances_of_free_points(labelling: Labelling, clouds: Clouds, marker_of: Ints, piece_of: Ints, votes: Floats) -> Floats:
    """(F, M) for the F points without a label, in order, the chance to be each of the markers that are missing in their frame."""
    free = np.nonzero(marker_of == NULL)[0]
    frames = clouds.frame_of[free]
    missing = labelling.indices[frames] == NULL
    apart = np.linalg.norm(clouds.xyz[free, None] - _paths(labelling.positions(clouds))[frames], axis=2)
    near = np.exp(-np.where(np.isnan(apart), _NEAR, apart) / _NEAR)
    confidence, places = labelling.confidence[frames], free - clouds.offsets[frames]
    best = np.full(confidence.shape, NULL) if labelling.candidates is None else labelling.candidates[frames]
    is_best = best == places[:, None]
    near[is_best] = 0.0
    # what the best candidate leaves of the chance that the marker is here at all, the others share
    left = np.where(best == NULL, 1.0, 1.0 - confidence)
    shared = np.where(is_best, confidence, confidence * left * near / np.maximum(_sum_in_frame(near, frames, len(clouds)), 1e-300))
    own = np.where(missing, np.maximum(shared, votes[piece_of[free]]), 0.0)
    own /= np.maximum(_sum_in_frame(own, frames, len(clouds)), 1.0)
    return np.asarray(own / np.maximum(own.sum(axis=1, keepdims=True), 1.0))


def _sum_in_frame(values: Floats, frames: Ints, count: int) -> Floats:
    """(F, M) for each of the points in `frames` the sum over all of them in its frame."""
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
    """(pieces, M) what share of a piece's labels, weighed by their confidence, names each marker; frames without a label count a little."""
    count = int(piece_of.max(initial=-1)) + 1
    votes = np.zeros((count, markers))
    given = marker_of >= 0
    np.add.at(votes, (piece_of[given], marker_of[given]), confidence[given])
    silent = _SILENT * np.bincount(piece_of[~given], minlength=count)
    return votes / np.maximum(votes.sum(axis=1) + silent, 1e-300)[:, None]


def _doubt(piece_of: Ints, marker_of: Ints, confidence: Floats, chance: Floats, votes: Floats) -> Floats:
    """(P,) the probability that the point's label is wrong, or missing."""
    given = marker_of >= 0
    doubt = 1.0 - confidence
    doubt[~given] = chance.sum(axis=1)
    another = given & (marker_of != votes.argmax(axis=1)[piece_of])
    doubt[another] = np.maximum(doubt, votes.max(axis=1, initial=0.0)[piece_of])[another]
    return np.clip(doubt, 0.0, 1.0)


def _told(
    names: tuple[str, ...], markers: Ints, confidence: Floats, chance: Floats
) -> tuple[str | None, float, tuple[tuple[str, float], ...]]:
    """What most of a piece is labelled, how surely, and what else it could be; chance (F, M) of its points without a label."""
    weight = chance.sum(axis=0)
    given = markers >= 0
    np.add.at(weight, markers[given], confidence[given])
    if 2 * given.sum() > len(markers):
        said = int(np.bincount(markers[given]).argmax())
        own = markers == said
        sure = float(confidence[own].sum() / given.sum())
    else:
        said, sure = NULL, float(1.0 - min(1.0, chance.sum() / len(chance)))
    weight /= len(markers)
    likeliest = [int(m) for m in np.argsort(-weight, kind="stable") if m != said and weight[m] >= _LEAST_CHANCE]
    return (names[said] if said >= 0 else None), sure, tuple((names[m], float(weight[m])) for m in likeliest[:_CANDIDATES])
