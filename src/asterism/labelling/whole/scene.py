"""A recording laid out for labelling as a whole: clouds and their tracklets in; ordered points and the frames to look at, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.geometry import rotate_z_up
from asterism.labelling.body.labeller import BodyLabeller
from asterism.recording import NULL, Clouds, Floats, Ints
from asterism.tracking.linking import Tracklets


@dataclass(frozen=True)
class TimeRules:
    """How a whole recording is labelled. Chosen on the gait subjects, each left out in turn (docs/recordings.md).

    look         seconds between the frames that are looked at
    rounds       relabellings after which the labels are taken as they are
    least_score  nats that one frame can say against a label (negative)
    most_score   nats that one frame can say for a label
    alike        correlation of two looks at one tracklet: many looks are worth 1 / alike independent ones at most
    long_track   seconds from which a tracklet is too long for a ghost, where the recording shows no long ghosts
    blink        seconds up to which a tracklet is a double where a long one is never farther than
    double       m from it: a marker that the cameras composed twice
    ghosts_cost  nats that it costs to take a recording for one with ghosts, and again for one with long ghosts
    vote_limit   nats that one frame-wise look can say for a label
    sure         nats from which a tracklet's label teaches the model the subject's own body
    clear        nats; where every tracklet's label has more, the model is not adapted: there is nothing to win
    rigid        m; two markers are near-rigid where their distance spreads by less in this recording
    rigid_noise  m that such a distance varies at least
    misfit       standard deviations that a tracklet's near-rigid distances may be off without being doubted
    misfit_cost  nats of margin lost for each square of what is beyond that
    foreign_noise  m that a near-rigid distance differs between bodies of one size at least
    familiar     standard deviations that a tracklet's near-rigid distances may be off those of the training where the frame fits as usual
    unfamiliar   the same where most of its frames fit worse than those of people left out did
    calibrate    how often the model is adapted to the subject's own body; 0 for never
    """

    look: float = 0.1
    rounds: int = 4
    least_score: float = -4.0
    most_score: float = 15.0
    alike: float = 0.3
    long_track: float = 0.9
    blink: float = 0.05
    double: float = 0.03
    ghosts_cost: float = 30.0
    vote_limit: float = 10.0
    sure: float = 6.0
    clear: float = 15.0
    rigid: float = 0.02
    rigid_noise: float = 0.004
    misfit: float = 1.2
    misfit_cost: float = 12.0
    foreign_noise: float = 0.01
    familiar: float = 5.0
    unfamiliar: float = 2.5
    calibrate: int = 2


@dataclass(frozen=True)
class Scene:
    """A recording laid out for the kernels.

    xyz (P, 3) m, z up; offsets (T + 1,); place (P,) each point's place in its frame of the clouds; track (P,); first, last (J,) frames
    looked (E,) the frames looked at, and their points: seen_xyz (Q, 3), seen_offsets (E + 1,), seen_track (Q,), seen_frame (Q,) of 0..E-1
    independent (J,) independent looks at each tracklet; double (J,) whether a tracklet is no more than a double of a long one
    """

    xyz: Floats
    offsets: Ints
    place: Ints
    track: Ints
    first: Ints
    last: Ints
    rate: float
    looked: Ints
    seen_xyz: Floats
    seen_offsets: Ints
    seen_track: Ints
    seen_frame: Ints
    independent: Floats
    double: NDArray[np.bool_]


def lay_out(clouds: Clouds, tracklets: Tracklets, rules: TimeRules, unit: float) -> Scene:
    """Order the points of every frame, whatever order they came in, number the tracklets likewise, and choose the frames to look at.

    unit: `length_scale` of the smallest body that is looked for.
    """
    frame_of = np.repeat(np.arange(len(clouds)), clouds.counts)
    xyz = rotate_z_up(clouds.xyz, clouds.vertical)
    order = np.lexsort((xyz[:, 1], xyz[:, 0], -xyz[:, 2], frame_of))
    xyz = np.ascontiguousarray(xyz[order])
    _, begins, track = np.unique(tracklets.of_point[order], return_index=True, return_inverse=True)
    rank = np.empty(len(begins), dtype=np.int64)
    by_first_point = np.argsort(begins)
    rank[by_first_point] = np.arange(len(begins))
    track = rank[track]
    first, last = np.full(len(begins), len(clouds)), np.full(len(begins), -1)
    np.minimum.at(first, track, frame_of)
    np.maximum.at(last, track, frame_of)

    step = max(1, round(rules.look * clouds.rate))
    look = np.zeros(len(clouds), dtype=np.bool_)
    look[step // 2 :: step] = True
    if len(look) and not look.any():
        look[len(look) // 2] = True
    seen_before = np.concatenate([[0], np.cumsum(look)])
    unseen = np.nonzero(seen_before[last + 1] == seen_before[first])[0]
    for j in unseen[np.argsort(last[unseen], kind="stable")]:
        if not look[first[j] : last[j] + 1].any():
            look[(first[j] + last[j]) // 2] = True
    looked = np.nonzero(look)[0]
    seen = look[frame_of]
    seen_track = track[seen]
    looks = np.bincount(seen_track, minlength=len(begins))
    return Scene(
        xyz,
        clouds.offsets,
        order - clouds.offsets[frame_of],
        track,
        first,
        last,
        clouds.rate,
        looked,
        np.ascontiguousarray(xyz[seen]),
        np.concatenate([[0], np.cumsum(clouds.counts[looked])]).astype(np.int64),
        seen_track,
        np.repeat(np.arange(len(looked)), clouds.counts[looked]),
        looks / (1.0 + rules.alike * (looks - 1.0)),
        _doubles(xyz, clouds.offsets, track, (last - first + 1) / clouds.rate, rules, unit),
    )


def _doubles(xyz: Floats, offsets: Ints, track: Ints, duration: Floats, rules: TimeRules, unit: float) -> NDArray[np.bool_]:
    """Tracklets (J,) of a blink all of whose points lie beside one of a long tracklet. O(points of blinks * points of a frame)."""
    double = duration <= rules.blink
    long = duration >= rules.long_track
    points = np.nonzero(double[track])[0]
    for point, frame in zip(points, np.searchsorted(offsets, points, side="right") - 1, strict=True):
        others = np.arange(offsets[frame], offsets[frame + 1])
        others = others[long[track[others]]]
        if not (np.linalg.norm(xyz[others] - xyz[point], axis=1) < rules.double * unit).any():
            double[track[point]] = False
    return double


def marker_starts(labellers: Sequence[BodyLabeller]) -> Ints:
    """Where each body's markers begin among the columns of all bodies, and their number at the end."""
    return np.concatenate([[0], np.cumsum([labeller.body.mean.shape[1] for labeller in labellers])]).astype(np.int64)


def own_labels(label: Ints, starts: Ints, number: int) -> Ints:
    """The labels (J,) as one body's markers, -1 for those of others."""
    return np.where((label >= starts[number]) & (label < starts[number + 1]), label - starts[number], NULL)
