"""Several bodies in one volume: the frames looked at in; which points are whose, as votes that follow each body through time, out.

In each frame the body that is found best is taken, its points are set aside, and the rest is looked at again. The bodies of all frames are
tied together by the tracklets that they share, for a tracklet is a piece of one body; only then it is said which model each body goes by.
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

SWEEPS = 3
"""How often, at most, the bodies of each frame are matched with those of the other frames."""


class SeveralBodies(AsterismError):
    """A recording that shows more bodies than it was said to."""


@dataclass(frozen=True)
class CrowdRules:
    """When a recording shows two bodies of one model. Chosen on pairs of gait subjects, and on single ones who wear more markers.

    frames  how many frames are looked at
    found   share of the markers that each of the two must show
    sure    nats of a label that counts
    apart   share of the body's height that their middles are apart by, seen from above
    share   share of the recording's frames that show two, from which it is too much for one labelling
    """

    frames: int = 12
    found: float = 0.6
    sure: float = 3.0
    apart: float = 0.2
    share: float = 0.2


@dataclass(frozen=True)
class Bodies:
    """The B bodies of each of E frames, the best one first; M is the number of markers of the largest model.

    model  (B, E): which model found it
    rows   (B, E, M): the point of each of its markers, -1 for none
    votes  (B, E, M) nats for each of them
    """

    model: Ints
    rows: Ints
    votes: Floats


def find_bodies(
    parts: Sequence[BodyLabeller], xyz: Floats, offsets: Ints, vote_limit: float, workers: int = 1, report: Progress | None = None
) -> Bodies:
    """Find one body for each model in every frame, no point in two of them.

    parts: the models, the same one again for two bodies that it fits. xyz (Q, 3) m, z up, sorted within each frame as `label_clouds` asks;
    offsets (E + 1,); vote_limit: nats that one marker counts at most. O(B) looks at each frame.
    """
    models = list({id(model): model for model in parts}.values())
    frames, most = len(offsets) - 1, max(model.body.mean.shape[1] for model in models)
    left = np.tile([[sum(model is other for other in parts)] for model in models], frames)
    rows, votes = np.full((len(models), frames, most), NULL, dtype=np.int64), np.zeros((len(models), frames, most))
    shape = (len(parts), frames)
    found = Bodies(np.empty(shape, dtype=np.int64), np.empty((*shape, most), dtype=np.int64), np.empty((*shape, most)))
    free, every = np.ones(len(xyz), dtype=np.bool_), np.arange(frames)
    for turn in range(len(parts)):
        for number, model in enumerate(models):
            robbed = ((rows[number] != NULL) & ~free[rows[number]]).any(axis=1) if turn else np.ones(frames, dtype=np.bool_)
            again = np.nonzero(robbed & (left[number] > 0))[0]
            markers = model.body.mean.shape[1]
            rows[number, again, :markers], votes[number, again, :markers] = _look(model, xyz, offsets, free, again, vote_limit, workers)
            if report:
                report((turn + (number + 1) / len(models)) / len(parts), "looking at frames")
        best = np.argmax(np.where(left > 0, votes.sum(axis=2), -1.0), axis=0)
        left[best, every] -= 1
        found.model[turn], found.rows[turn], found.votes[turn] = best, rows[best, every], votes[best, every]
        free[found.rows[turn][found.rows[turn] != NULL]] = False
    return found


def _look(
    model: BodyLabeller, xyz: Floats, offsets: Ints, free: NDArray[np.bool_], which: Ints, vote_limit: float, workers: int
) -> tuple[Ints, Floats]:
    """What a model finds among the free points of some frames: rows, votes (n, M)."""
    chosen = np.zeros(len(offsets) - 1, dtype=np.bool_)
    chosen[which] = True
    frame_of = np.repeat(np.arange(len(chosen)), np.diff(offsets))
    points = np.nonzero(free & chosen[frame_of])[0]
    own = np.concatenate([[0], np.cumsum(np.bincount(frame_of[points], minlength=len(chosen))[which])]).astype(np.int64)
    rows, margins, _ = model.label_frames(np.ascontiguousarray(xyz[points]), own, workers, at_once=50)
    given = rows != NULL
    rows[given] = points[(own[:-1, None] + rows)[given]]
    return rows, np.where(given, np.clip(margins, 0.1, vote_limit), 0.0)


def follow_bodies(bodies: Bodies, track: Ints) -> Ints:
    """Which body of the recording each body of a frame is: (B, E) numbers below B, each once in a frame.

    track (Q,) the tracklet of each point. From the frame that shows all bodies best outwards, the bodies of each frame are matched with
    those followed so far, by the tracklets that they share; then again with those of all other frames, until nothing changes.
    """
    count, frames = bodies.model.shape
    order = np.argsort(np.abs(np.arange(frames) - np.argmax(bodies.votes.sum(axis=2).min(axis=0))), kind="stable")
    claims = np.zeros((track.max(initial=-1) + 1, count))
    who = np.full((count, frames), NULL, dtype=np.int64)
    for sweep in range(SWEEPS):
        before = who.copy()
        for e in order:
            own = [track[rows[rows != NULL]] for rows in bodies.rows[:, e]]
            if sweep:
                for b in range(count):
                    claims[own[b], who[b, e]] -= 1.0
            shared = np.array([(claims[tracks] / np.maximum(claims[tracks].sum(axis=1, keepdims=True), 1.0)).sum(axis=0) for tracks in own])
            who[:, e] = linear_sum_assignment(shared, maximize=True)[1]
            for b in range(count):
                claims[own[b], who[b, e]] += 1.0
        if np.array_equal(who, before):
            break
    return who


def body_votes(parts: Sequence[BodyLabeller], bodies: Bodies, who: Ints, track: Ints) -> Floats:
    """What the bodies, followed through time, say for each tracklet: (J, L) nats, the markers of all models one after the other.

    parts: the models that `find_bodies` was given, in that order; each followed body goes by the one that found it best on the whole.
    """
    models = list({id(model): model for model in parts}.values())
    model_of = np.array([next(n for n, model in enumerate(models) if model is part) for part in parts])
    count = len(parts)
    strength = np.zeros((count, len(models)))
    np.add.at(strength, (who, bodies.model), bodies.votes.sum(axis=2))
    member_of = linear_sum_assignment(strength[:, model_of], maximize=True)[1]
    starts = np.concatenate([[0], np.cumsum([part.body.mean.shape[1] for part in parts])])
    votes = np.zeros((track.max(initial=-1) + 1, starts[-1]))
    member = member_of[who]
    counted = (bodies.rows != NULL) & (model_of[member] == bodies.model)[:, :, None]
    b, e, marker = np.nonzero(counted)
    np.add.at(votes, (track[bodies.rows[b, e, marker]], starts[member[b, e]] + marker), bodies.votes[b, e, marker])
    return votes


def check_for_one(model: BodyLabeller, clouds: Clouds, rules: CrowdRules | None = None) -> None:
    """Raise SeveralBodies where a recording surely shows two bodies of a model, in too large a share of its frames.

    A few frames are looked at, of those that have points enough for two: 2 looks each. What is left of one person who wears more markers
    than the model knows is no second one: it does not stand apart.
    """
    rules = rules or CrowdRules()
    markers = model.body.mean.shape[1]
    crowded = np.nonzero(clouds.counts >= 2 * rules.found * markers)[0]
    if len(crowded) < rules.share * len(clouds) or not len(crowded):
        return
    some = crowded[np.unique(np.linspace(0, len(crowded) - 1, rules.frames).round().astype(np.int64))]
    points = [rotate_z_up(clouds[t], clouds.vertical) for t in some]
    xyz = np.concatenate([frame[np.lexsort((frame[:, 1], frame[:, 0], -frame[:, 2]))] for frame in points])
    offsets = np.concatenate([[0], np.cumsum(clouds.counts[some])]).astype(np.int64)
    bodies = find_bodies([model, model], xyz, offsets, rules.sure)
    # where two stand there alike, nobody knows which of them is the first: the second one's labels are what is sure
    both = ((bodies.rows[0] != NULL).sum(axis=1) >= rules.found * markers) & (
        (bodies.votes[1] >= rules.sure).sum(axis=1) >= rules.found * markers
    )
    there = bodies.rows[:, both, :, None] != NULL
    middle = (there * xyz[bodies.rows[:, both], :2]).sum(axis=2) / there.sum(axis=2)
    height = np.ptp(model.body.mean[:, :, 2], axis=1).max()
    apart = int((np.linalg.norm(middle[0] - middle[1], axis=1) >= rules.apart * height).sum())
    if apart / len(some) * len(crowded) >= rules.share * len(clouds):
        raise SeveralBodies(
            f"two bodies that wear the model's {markers} markers are there in {apart} of {len(some)} frames looked at; "
            "give the model once for each of them."
        )
