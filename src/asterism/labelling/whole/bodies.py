"""Several bodies in one volume: sampled frames in; which points belong to which body, as votes for the tracklets, out.

In each frame the body with the most votes is taken, its points are set aside, and the rest is labelled again. The bodies of all frames are
then matched by the tracklets that they share, as a tracklet is a piece of one body. Last, each body is given the model that found it best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from asterism.errors import AsterismError
from asterism.geometry import rotate_z_up
from asterism.labelling.body.labeller import BodyLabeller
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Floats, Ints

MAX_SWEEPS = 3
"""How often, at most, the bodies of each frame are matched with those of the other frames."""


class SeveralBodies(AsterismError):
    """The recording shows more bodies than models were given."""


@dataclass(frozen=True)
class SeveralBodiesRules:
    """When a recording shows two bodies of one model. Chosen on pairs of gait subjects, and on single ones who wear more markers.

    frames           how many frames are sampled
    min_found_share  share of the markers that each of the two must show
    min_margin       nats of a label that counts
    min_separation   distance between their centres seen from above, as a share of the body's height
    min_frame_share  share of the recording's frames with two bodies from which the recording is refused
    """

    frames: int = 12
    min_found_share: float = 0.6
    min_margin: float = 3.0
    min_separation: float = 0.2
    min_frame_share: float = 0.2


@dataclass(frozen=True)
class Bodies:
    """The B bodies of each of E frames, the best one first; M is the number of markers of the largest model.

    model     (B, E): which model found it
    point_of  (B, E, M): the point of each of its markers, -1 for none
    votes     (B, E, M) nats for each of them
    """

    model: Ints
    point_of: Ints
    votes: Floats


def find_bodies(
    labellers: Sequence[BodyLabeller], xyz: Floats, offsets: Ints, max_vote: float, workers: int = 1, report: Progress | None = None
) -> Bodies:
    """Find one body for each labeller in every frame, no point in two of them.

    labellers: one for each body, the same one again for two bodies that it fits. xyz (Q, 3) m, z up, sorted within each frame as
    `label_clouds` asks; offsets (E + 1,); max_vote: nats that one marker counts at most. Labels each frame O(B) times.
    """
    models = list({id(model): model for model in labellers}.values())
    frames, most = len(offsets) - 1, max(model.body.mean.shape[1] for model in models)
    left = np.tile([[sum(model is other for other in labellers)] for model in models], frames)
    point_of, votes = np.full((len(models), frames, most), NULL, dtype=np.int64), np.zeros((len(models), frames, most))
    shape = (len(labellers), frames)
    found = Bodies(np.empty(shape, dtype=np.int64), np.empty((*shape, most), dtype=np.int64), np.empty((*shape, most)))
    free, every = np.ones(len(xyz), dtype=np.bool_), np.arange(frames)
    for turn in range(len(labellers)):
        for number, model in enumerate(models):
            # frames in which the model's labels hold a point that another body has taken are labelled again
            lost = ((point_of[number] != NULL) & ~free[point_of[number]]).any(axis=1) if turn else np.ones(frames, dtype=np.bool_)
            again = np.nonzero(lost & (left[number] > 0))[0]
            of_model = np.s_[number, again, : model.body.mean.shape[1]]
            point_of[of_model], votes[of_model] = _label_free_points(model, xyz, offsets, free, again, max_vote, workers)
            if report:
                report((turn + (number + 1) / len(models)) / len(labellers), "labelling single frames")
        best = np.argmax(np.where(left > 0, votes.sum(axis=2), -1.0), axis=0)
        left[best, every] -= 1
        found.model[turn], found.point_of[turn], found.votes[turn] = best, point_of[best, every], votes[best, every]
        free[found.point_of[turn][found.point_of[turn] != NULL]] = False
    return found


def _label_free_points(
    labeller: BodyLabeller, xyz: Floats, offsets: Ints, free: NDArray[np.bool_], frames: Ints, max_vote: float, workers: int
) -> tuple[Ints, Floats]:
    """The labels of some frames (n,) among the free points (Q,): point of each marker and votes in nats, (n, M)."""
    chosen = np.zeros(len(offsets) - 1, dtype=np.bool_)
    chosen[frames] = True
    frame_of = np.repeat(np.arange(len(chosen)), np.diff(offsets))
    points = np.nonzero(free & chosen[frame_of])[0]
    free_offsets = np.concatenate([[0], np.cumsum(np.bincount(frame_of[points], minlength=len(chosen))[frames])]).astype(np.int64)
    point_of, margins, _ = labeller.label_frames(np.ascontiguousarray(xyz[points]), free_offsets, workers, at_once=50)
    given = point_of != NULL
    point_of[given] = points[(free_offsets[:-1, None] + point_of)[given]]
    return point_of, np.where(given, np.clip(margins, 0.1, max_vote), 0.0)


def follow_bodies(bodies: Bodies, track: Ints) -> Ints:
    """Which body of the recording each body of a frame is: (B, E) numbers below B, each once in a frame.

    track (Q,) the tracklet of each point. Beginning with the frame in which the weakest body has most votes, and going outwards, the bodies
    of each frame are matched with those followed so far by the tracklets that they share; then with those of all other frames, until
    nothing changes.
    """
    count, frames = bodies.model.shape
    order = np.argsort(np.abs(np.arange(frames) - np.argmax(bodies.votes.sum(axis=2).min(axis=0))), kind="stable")
    points = np.zeros((track.max(initial=-1) + 1, count))  # of each tracklet, by body
    body_of = np.full((count, frames), NULL, dtype=np.int64)
    for sweep in range(MAX_SWEEPS):
        before = body_of.copy()
        for e in order:
            tracks = [track[point_of[point_of != NULL]] for point_of in bodies.point_of[:, e]]
            if sweep:
                for b in range(count):
                    points[tracks[b], body_of[b, e]] -= 1.0
            shared = np.array([(points[own] / np.maximum(points[own].sum(axis=1, keepdims=True), 1.0)).sum(axis=0) for own in tracks])
            body_of[:, e] = linear_sum_assignment(shared, maximize=True)[1]
            for b in range(count):
                points[tracks[b], body_of[b, e]] += 1.0
        if np.array_equal(body_of, before):
            break
    return body_of


def votes_of_bodies(labellers: Sequence[BodyLabeller], bodies: Bodies, body_of: Ints, track: Ints) -> Floats:
    """What the bodies, followed through time, say for each tracklet: (J, L) nats, the markers of all models one after the other.

    labellers: as given to `find_bodies`, in that order; each followed body is given the one that found it best, over all frames.
    body_of (B, E): see `follow_bodies`; track (Q,) the tracklet of each point.
    """
    models = list({id(model): model for model in labellers}.values())
    model_of = np.array([next(n for n, model in enumerate(models) if model is labeller) for labeller in labellers])
    count = len(labellers)
    strength = np.zeros((count, len(models)))
    np.add.at(strength, (body_of, bodies.model), bodies.votes.sum(axis=2))
    labeller_of = linear_sum_assignment(strength[:, model_of], maximize=True)[1]
    starts = np.concatenate([[0], np.cumsum([labeller.body.mean.shape[1] for labeller in labellers])])
    votes = np.zeros((track.max(initial=-1) + 1, starts[-1]))
    number = labeller_of[body_of]
    counted = (bodies.point_of != NULL) & (model_of[number] == bodies.model)[:, :, None]
    b, e, marker = np.nonzero(counted)
    np.add.at(votes, (track[bodies.point_of[b, e, marker]], starts[number[b, e]] + marker), bodies.votes[b, e, marker])
    return votes


def check_single_body(model: BodyLabeller, clouds: Clouds, rules: SeveralBodiesRules | None = None) -> None:
    """Raise SeveralBodies where a recording certainly shows two bodies of a model, in too large a share of its frames.

    Samples a few of the frames that have enough points for two bodies, and labels each twice. The other markers of one person who wears
    more than the model knows are no second body, as their centre lies near the first one's.
    """
    rules = rules or SeveralBodiesRules()
    markers = model.body.mean.shape[1]
    crowded = np.nonzero(clouds.counts >= 2 * rules.min_found_share * markers)[0]
    if len(crowded) < rules.min_frame_share * len(clouds) or not len(crowded):
        return
    sampled = crowded[np.unique(np.linspace(0, len(crowded) - 1, rules.frames).round().astype(np.int64))]
    points = [rotate_z_up(clouds[t], clouds.vertical) for t in sampled]
    xyz = np.concatenate([frame[np.lexsort((frame[:, 1], frame[:, 0], -frame[:, 2]))] for frame in points])
    offsets = np.concatenate([[0], np.cumsum(clouds.counts[sampled])]).astype(np.int64)
    bodies = find_bodies([model, model], xyz, offsets, rules.min_margin)
    # either of two equal bodies may be found first, so the first one's margins are small; those of the second one decide
    both = ((bodies.point_of[0] != NULL).sum(axis=1) >= rules.min_found_share * markers) & (
        (bodies.votes[1] >= rules.min_margin).sum(axis=1) >= rules.min_found_share * markers
    )
    labelled = bodies.point_of[:, both, :, None] != NULL
    centre = (labelled * xyz[bodies.point_of[:, both], :2]).sum(axis=2) / labelled.sum(axis=2)
    height = np.ptp(model.body.mean[:, :, 2], axis=1).max()
    separate = int((np.linalg.norm(centre[0] - centre[1], axis=1) >= rules.min_separation * height).sum())
    if separate / len(sampled) * len(crowded) >= rules.min_frame_share * len(clouds):
        raise SeveralBodies(
            f"two bodies with the model's {markers} markers were found in {separate} of {len(sampled)} sampled frames; "
            "give the model once for each body."
        )
