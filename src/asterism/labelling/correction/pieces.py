"""Tracklets and their labels in; the table of pieces that a person corrects, and the pieces that a touch cuts, out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.labelling.correction.touches import PointInFrame
from asterism.labelling.review import labels_of_points
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling
from asterism.tracking.linking import Tracklets

SAME_PLACE = 0.0005
"""m between a point that was written down and the point that is meant: more than rounding, less than between two markers."""


@dataclass(frozen=True)
class Pieces:
    """The J pieces of tracks of a recording, by their first frames.

    id           (J,) the place of the piece's first point in `clouds.xyz`; a cut leaves it to the earlier part
    first, last  (J,) frames, inclusive, counted from 0
    track        (J,) the number that the camera system gave the first point's track, or its column; -1 where neither is known
    marker       (J,) the marker that most of its points are labelled, by place in the labelling's names; -1 where most have no label
    confidence   (J,) mean confidence of these labels; for -1 the mean chance that no label is right, as far as it is known
    ghost        (J,) whether a person said that it is no marker
    person       (J,) whether a person said what it is
    of_point     (P,) the piece of each point, by place in this table
    """

    id: Ints
    first: Ints
    last: Ints
    track: Ints
    marker: Ints
    confidence: Floats
    ghost: NDArray[np.bool_]
    person: NDArray[np.bool_]
    of_point: Ints

    def __len__(self) -> int:
        return len(self.id)

    def place_of(self, piece: int) -> int:
        """The place of a piece in this table. Raises AsterismError where there is no piece with this id."""
        # Ids are places of points: one that begins no piece is of an earlier state.
        if not 0 <= piece < len(self.of_point) or self.id[self.of_point[piece]] != piece:
            raise AsterismError(f"there is no piece {piece}; it may have been part of a cut that was taken back.")
        return int(self.of_point[piece])


def table_of_pieces(
    tracklets: Tracklets, clouds: Clouds, labelling: Labelling, ghost: NDArray[np.bool_], person: NDArray[np.bool_]
) -> Pieces:
    """The table; tracklets numbered by their first points, ghost and person (J,) in this order. O(P + J M)."""
    count, points = len(tracklets), len(clouds.xyz)
    number = np.full(count, points, dtype=np.int64)
    np.minimum.at(number, tracklets.of_point, np.arange(points))
    # The camera system's own numbers are what a person knows a track by.
    numbers = clouds.columns if clouds.tracks is None else clouds.tracks
    marker_of, confidence = labels_of_points(labelling, clouds)
    markers = len(labelling.names)
    given = marker_of != NULL
    key = tracklets.of_point[given] * markers + marker_of[given]
    votes = np.bincount(key, minlength=count * markers).reshape(count, markers)
    weight = np.bincount(key, weights=confidence[given], minlength=count * markers).reshape(count, markers)
    samples, labelled = np.bincount(tracklets.of_point, minlength=count), votes.sum(axis=1)
    best = votes.argmax(axis=1) if markers else np.zeros(count, dtype=np.int64)
    # More than half: a piece with two labels has none that a person could confirm.
    marker = np.where(2 * labelled > samples, best, NULL)
    mean = weight[np.arange(count), best] / np.maximum(labelled, 1) if markers else np.zeros(count)
    return Pieces(
        id=number,
        first=tracklets.first,
        last=tracklets.last,
        track=numbers[number],
        marker=marker,
        confidence=np.where(person | (marker == NULL), 1.0, mean),
        ghost=ghost,
        person=person,
        of_point=tracklets.of_point,
    )


def by_first_points(tracklets: Tracklets) -> Tracklets:
    """The tracklets, numbered by the places of their first points in the clouds, which are in the order of frames."""
    _, first_point, of_point = np.unique(tracklets.of_point, return_index=True, return_inverse=True)
    # First points are in the order of frames, so that the table reads like the recording.
    order = np.argsort(first_point)
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    kept = np.unique(tracklets.of_point)[order]
    return Tracklets(rank[of_point], tracklets.first[kept], tracklets.last[kept])


def cut_before(tracklets: Tracklets, clouds: Clouds, points: Ints) -> Tracklets:
    """The tracklets, each cut before these points (places in `clouds.xyz`); a tracklet's own first point cuts nothing. O(P log P)."""
    if not len(points):
        return tracklets
    begins = np.zeros(len(clouds.xyz), dtype=np.int64)
    begins[points] = 1
    order = np.argsort(tracklets.of_point, kind="stable")  # in each tracklet by frames
    part = np.cumsum(begins[order])
    of_sorted = tracklets.of_point[order]
    # A part begins with a new tracklet, or where a cut lies before a point.
    new = np.ones(len(order), dtype=np.bool_)
    new[1:] = (of_sorted[1:] != of_sorted[:-1]) | (part[1:] != part[:-1])
    number = np.cumsum(new) - 1
    of_point = np.empty_like(number)
    of_point[order] = number
    frames, ends = clouds.frame_of[order], np.append(new[1:], True)
    return by_first_points(Tracklets(of_point, frames[new], frames[ends]))


def point_of_piece(pieces: Pieces, clouds: Clouds, place: int, frame: int) -> int:
    """The point of a piece in a frame, by place in `clouds.xyz`. Raises AsterismError where the piece is not there in the frame."""
    if not pieces.first[place] <= frame <= pieces.last[place]:
        raise AsterismError(
            f"the piece {pieces.id[place]} is there in frames {pieces.first[place]} to {pieces.last[place]}, not in {frame}; "
            "give a frame of its own."
        )
    begin, end = clouds.offsets[frame : frame + 2]
    return int(begin + np.nonzero(pieces.of_point[begin:end] == place)[0][0])


def described(point: int, clouds: Clouds) -> PointInFrame:
    """A point (place in `clouds.xyz`) as it is written down."""
    x, y, z = clouds.xyz[point].tolist()
    numbers = clouds.columns if clouds.tracks is None else clouds.tracks
    frame = int(np.searchsorted(clouds.offsets, point, side="right")) - 1
    return PointInFrame(frame, (x, y, z), int(numbers[point]))


def found_again(point: PointInFrame, clouds: Clouds) -> int:
    """The place in `clouds.xyz` of a point that was written down; of coincident points the one of the same track.

    Raises AsterismError where no point is there.
    """
    if 0 <= point.frame < len(clouds) and clouds.counts[point.frame]:
        begin, end = clouds.offsets[point.frame : point.frame + 2]
        # By place, not by number: a file that was written again orders its points anew.
        distance = np.linalg.norm(clouds.xyz[begin:end] - np.array(point.position), axis=1)
        numbers = clouds.columns if clouds.tracks is None else clouds.tracks
        near = np.nonzero(distance <= SAME_PLACE)[0]
        if len(near):
            # Of points in one place, such as doubled ones, the track tells which was meant.
            same = near[numbers[begin + near] == point.track]
            chosen = same if len(same) else near
            return int(begin + chosen[np.argmin(distance[chosen])])
    raise AsterismError(f"frame {point.frame} has no point at {point.position}; the answer belongs to another recording.")
