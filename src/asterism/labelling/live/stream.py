"""Points in, frame by frame as a camera system delivers them; the labels of the frame some pushes ago out.

Points are linked online (`tracks`). Every track gathers evidence: how well it fits each marker, given all others, in each of its frames.
The labels that the tracks carry are the proposal for the next frame, which the whole body checks, mends and completes; that costs
little. From time to time, and where the carried labels do not explain a frame, a search that knows nothing of the past looks for a
better labelling. What it finds must lead for some frames before it takes over, unless what is carried explains nothing.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from asterism.errors import AsterismError
from asterism.geometry import rotate_z_up
from asterism.labelling.body._frame_kernels import frame_settings
from asterism.labelling.body._refine_kernels import refine
from asterism.labelling.body._score_kernels import best_pose, rescore
from asterism.labelling.body._search_kernels import MAX_LABELLINGS, CandidateLabellings, find_labellings
from asterism.labelling.body._workspace_kernels import BodyWorkspace, FrameSettings, make_body_workspace
from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.live.body import LiveBody
from asterism.labelling.training.calibration import Calibration
from asterism.recording import NULL, Floats, Ints, as_vertical
from asterism.tracking._link_kernels import link_step
from asterism.tracking._link_workspace_kernels import make_link_workspace, make_track_ends
from asterism.tracking.linking import LinkRules


@dataclass(frozen=True)
class StreamRules:
    """How a stream weighs what it sees. Chosen on gait subjects left out.

    memory      s over which a track's evidence fades
    repeats     s after which a frame says something new of a track: nearer ones repeat each other
    most        nats that one frame may say for or against a marker
    search      s between searches where the carried labels explain the frames
    again       s between searches where they do not
    budget      feature evaluations of one such search
    effort      markers times labellings that one search of a large marker set follows up: what it costs at most
    riding      times that a track at most tells anew whether it is a marker or a ghost that rides along
    doubt       nats that a margin is worth less where points are left over: ghosts that ride along fit in frame after frame
    dull        and how many nats of what then remains are one of log odds
    lead        nats by which a labelling that a search found must lead, over frames that say something new, to take over
    """

    memory: float = 0.5
    repeats: float = 0.1
    most: float = 15.0
    search: float = 0.5
    again: float = 0.05
    budget: int = 20_000
    effort: int = 450
    riding: float = 3.0
    doubt: float = 3.0
    dull: float = 3.3
    lead: float = 5.0


@dataclass(frozen=True)
class FrameLabels:
    """The labels of one frame.

    frame       how many frames were pushed before it
    indices     (M,) int, each marker's place in the pushed points, -1 for none
    confidence  (M,) in [0, 1]: the probability that this entry is right; for -1, that of the best candidate that was not given
    """

    frame: int
    indices: Ints
    confidence: Floats


@dataclass(frozen=True)
class _Seen:
    """A frame that waits for its labels: the rows of the tracks' table that its points are in, and their places as pushed."""

    frame: int
    track: Ints
    place: Ints


class Stream:
    """Labels live points with a fixed delay and bounded memory. Made by `SolverEnsemble.stream`.

    What a push costs does not grow with time; what it needs of memory grows with the points of a frame and the delay only.
    """

    def __init__(
        self,
        model: BodyLabeller,
        live: LiveBody | None,
        markers: Ints,
        count: int,
        calibrations: tuple[Calibration, Calibration],
        least_confidence: float,
        rate: float,
        delay: int = 0,
        vertical: ArrayLike | str = "z",
        rules: StreamRules | None = None,
    ) -> None:
        if not np.isfinite(rate) or rate <= 0:
            raise AsterismError(f"frame rate {rate} is not a positive number of frames per second; pass the rate of the live system.")
        if not isinstance(delay, int | np.integer) or isinstance(delay, bool) or delay < 0:
            raise AsterismError(f"a delay of {delay!r} frames makes no sense; give a whole number, 0 for none.")
        self.rate, self.delay = float(rate), int(delay)
        self._model, self._markers, self._count = model, markers, count
        self._live, self._body = live, model.body
        self._calibrations, self._least_confidence = calibrations, least_confidence
        self._vertical = as_vertical(vertical)
        self._rules = rules or StreamRules()
        self._limits = LinkRules().limits(self.rate)
        self._forget = math.exp(-1.0 / (self._rules.memory * self.rate))
        self._new = 1.0 / (self._rules.repeats * self.rate)
        starts = int(np.clip(self._rules.effort // len(markers), 4, MAX_LABELLINGS))
        shape = (starts, len(markers))
        slots = [np.empty(starts, dtype=np.int64) for _ in range(4)]
        starting, finals = np.empty(shape, dtype=np.int64), np.empty(shape, dtype=np.int64)
        self._candidates = CandidateLabellings(starting, slots[0], finals, np.empty(starts), *slots[1:])
        self._restart()
        for _ in range(2):  # the first push must not wait for kernels to be read or compiled
            self.push(model.body.mean[0])
        self._search(
            np.ascontiguousarray(model.body.mean[0]), model.settings, make_body_workspace(len(markers), *model.body.load.shape[1::2])
        )
        self._restart()

    def _restart(self) -> None:
        self._forget_person()
        size, markers = 16, len(self._markers)
        self._ends, self._following, self._link_workspace = make_track_ends(size), make_track_ends(size), make_link_workspace(size)
        self._evidence, self._weight = np.zeros((size, markers)), np.zeros(size)
        self._free = list(range(size))
        self._track = np.zeros(0, dtype=np.int64)
        self._rival, self._lead = np.zeros(0, dtype=np.int64), 0.0
        self._searched, self._age = -np.inf, 0
        self._waiting: deque[_Seen] = deque()
        self._pushed = 0

    def push(self, points: ArrayLike) -> FrameLabels | None:
        """Take the next frame's points; give the labels of the frame `delay` pushes ago, None where there is none yet.

        points: (n, 3) m, in any order, n may be 0. Raises AsterismError where they have another shape or are not finite; the stream
        then stands as it was before.
        """
        xyz = np.asarray(points, dtype=np.float64)
        if xyz.size == 0:
            xyz = xyz.reshape(0, 3)
        if xyz.ndim != 2 or xyz.shape[1] != 3:
            raise AsterismError(f"frame {self._pushed}: points have shape {xyz.shape}, expected (points, 3); transpose or split them.")
        if not np.isfinite(xyz).all():
            raise AsterismError(f"frame {self._pushed}: a point is NaN or infinite; leave missing points out of the push.")
        xyz = rotate_z_up(xyz, self._vertical)
        place = np.lexsort((xyz[:, 2], xyz[:, 1], xyz[:, 0]))
        xyz = np.ascontiguousarray(xyz[place])
        rival = self._link(xyz)
        self._look(xyz, rival)
        self._waiting.append(_Seen(self._pushed, self._track, place))
        self._pushed += 1
        return self._labels() if len(self._waiting) > self.delay else None

    def flush(self) -> list[FrameLabels]:
        """The labels of the last `delay` frames, oldest first. The stream then begins anew."""
        rest = [self._labels() for _ in range(len(self._waiting))]
        self._restart()
        return rest

    def _link(self, xyz: Floats) -> Ints:
        """Continue the tracks with a frame's points. Returns the rival labelling's marker of each point."""
        if len(xyz) > len(self._ends.age):
            ends, count = make_track_ends(2 * len(xyz)), len(self._track)
            for array, old in zip(ends, self._ends, strict=True):
                array[:count] = old[:count]
            self._ends, self._following, self._link_workspace = ends, make_track_ends(2 * len(xyz)), make_link_workspace(2 * len(xyz))
        previous = np.empty(len(xyz), dtype=np.int64)
        link_step(self._ends, len(self._track), xyz, self._limits, self._link_workspace, previous, self._following)
        self._ends, self._following = self._following, self._ends
        linked = previous >= 0
        new = int((~linked).sum())
        if len(self._free) < new:
            size = len(self._weight)
            self._free.extend(range(size, 2 * size + new))
            self._evidence = np.concatenate([self._evidence, np.zeros((size + new, len(self._markers)))])
            self._weight = np.concatenate([self._weight, np.zeros(size + new)])
        track, rival = np.empty(len(xyz), dtype=np.int64), np.full(len(xyz), NULL, dtype=np.int64)
        track[linked] = self._track[previous[linked]]
        fresh = [self._free.pop() for _ in range(new)]
        track[~linked] = fresh
        self._evidence[fresh], self._weight[fresh] = 0.0, 0.0
        if len(self._rival):
            rival[linked] = self._rival[previous[linked]]
        self._release(np.setdiff1d(self._track, track, assume_unique=True))
        self._track = track
        return rival

    def _release(self, tracks: Ints) -> None:
        """Tracks that no frame needs any more give their rows back."""
        if len(tracks):
            needed = set().union(*(seen.track.tolist() for seen in self._waiting))
            self._free.extend(track for track in tracks.tolist() if track not in needed)

    def _totals(self, tracks: Ints, most: float = np.inf) -> Floats:
        """(n, M) nats: what all frames of each track say for each marker, counted `most` times one frame at most."""
        weight = self._weight[tracks]
        told = np.minimum(1.0 + self._new * np.maximum(weight - 1.0, 0.0), most) / np.maximum(weight, 1.0)
        return self._evidence[tracks] * told[:, None]

    def _look(self, xyz: Floats, rival: Ints) -> None:
        """See what labelling the frame has, and let it speak for every track."""
        model, rules = self._model, self._rules
        if self._live is not None:
            self._body = self._live.step() or self._body
        markers, latents = self._body.load.shape[1], self._body.load.shape[3]
        self._evidence[self._track] *= self._forget
        self._weight[self._track] *= self._forget
        self._rival = np.full(len(xyz), NULL, dtype=np.int64)
        if len(xyz) < 3:
            return
        settings = frame_settings(model.settings, len(xyz), markers)
        workspace = make_body_workspace(len(xyz), markers, latents)
        rows = _assign(self._totals(self._track))
        score, pose = self._refine(xyz, rows, settings, workspace)
        lead, challenge = self._lead, np.full(markers, NULL, dtype=np.int64)
        if (rival >= 0).sum() >= 3:
            challenge[rival[rival >= 0]] = np.nonzero(rival >= 0)[0]
        labelled = int((rows >= 0).sum())
        explained = score >= settings.usual_score * labelled - settings.first_ghost_cost and labelled >= min(len(xyz), markers) - 1
        self._age += 1
        young = self._age * self._new < 1.0
        wait = 0.0 if young else (rules.search if explained else rules.again) * self.rate
        if self._pushed - self._searched >= wait and (challenge < 0).all():
            self._searched = self._pushed
            challenge, lead = self._search(xyz, settings, workspace), 0.0
        if (challenge >= 0).sum() >= 3 and not np.array_equal(challenge, rows):
            other, other_pose = self._refine(xyz, challenge, settings, workspace)
            lead += max(self._new, 1.0 / self._age) * (other - score) if np.isfinite(score) else np.inf
            hopeless = labelled < 0.5 * min(len(xyz), markers) and other > score
            if np.array_equal(challenge, rows) or lead < -rules.lead:
                lead = 0.0
            elif lead > rules.lead or hopeless:
                if (challenge == rows).sum() < 0.5 * labelled or labelled < 3:
                    self._forget_person()
                changed = _marker_of(challenge, len(xyz)) != _marker_of(rows, len(xyz))
                self._evidence[self._track[changed]], self._weight[self._track[changed]] = 0.0, 0.0
                rows, pose, lead, self._age = challenge, other_pose, 0.0, 0
            else:
                self._rival = _marker_of(challenge, len(xyz))
        self._lead = lead
        if (rows >= 0).sum() < 3:
            return
        rescore(self._body, pose, xyz, rows, settings, workspace)
        self._evidence[self._track] += np.clip(workspace.scores.T, -rules.most, rules.most)
        self._weight[self._track] += 1.0
        if self._live is not None and not young and self._live.wants(self._pushed):
            self._learn(xyz, self._live, workspace, settings)

    def _learn(self, xyz: Floats, live: LiveBody, workspace: BodyWorkspace, settings: FrameSettings) -> None:
        """Let the frame teach what this body is like, where enough of it is labelled surely."""
        scores = self._totals(self._track)
        rows = _assign(scores)
        sure = (rows >= 0) & (_margins(scores, self._totals(self._track, self._rules.riding), rows) >= live.rules.sure)
        if sure.sum() < live.rules.share * len(rows):
            return
        workspace.outlier[:] = False
        pose = best_pose(self._model.body, xyz, np.where(sure, rows, NULL), settings, workspace)[0]
        live.see(self._pushed, np.where(sure[:, None], xyz[rows], np.nan), int(pose))

    def _forget_person(self) -> None:
        """Whoever comes is not who was there."""
        self._body = self._model.body
        if self._live is not None:
            self._live.restart()

    def _refine(self, xyz: Floats, rows: Ints, settings: FrameSettings, workspace: BodyWorkspace) -> tuple[float, int]:
        """Mend and complete a labelling of the frame, in place: its score in nats, and the key pose."""
        body = self._body
        if (rows >= 0).sum() < 3:
            return -np.inf, 0
        workspace.outlier[:] = False
        pose = best_pose(body, xyz, rows, settings, workspace)[0]
        score = float(refine(body, pose, xyz, rows, settings, workspace))
        return score, int(best_pose(body, xyz, rows, settings, workspace)[0]) if (rows >= 0).sum() >= 3 else 0

    def _search(self, xyz: Floats, settings: FrameSettings, workspace: BodyWorkspace) -> Ints:
        """The best labelling of the frame that a search finds, whatever came before: (M,). For large marker sets it is a short one."""
        model, rules = self._model, self._rules
        short = settings
        if len(self._candidates.proposals) < MAX_LABELLINGS:
            short = settings._replace(
                max_evaluations=rules.budget,
                votes_needed=1,
                extra_anchors=1,
                max_votes_needed=2,
                proposals_per_anchor=min(2, settings.proposals_per_anchor),
            )
        order = np.argsort(-xyz[:, 2], kind="stable")
        counters = np.zeros(4, dtype=np.int64)
        _, best = find_labellings(
            np.ascontiguousarray(xyz[order]),
            np.arange(len(xyz)),
            model.solvers,
            model.anchors,
            model.body,
            short,
            workspace,
            self._candidates,
            counters,
        )
        rows = np.full(model.body.load.shape[1], NULL, dtype=np.int64)
        if best >= 0 and np.isfinite(self._candidates.scores[best]):
            found = self._candidates.labellings[best]
            rows = np.where(found >= 0, order[found], NULL)
        return rows

    def _labels(self) -> FrameLabels:
        """The oldest waiting frame's labels, from all that its tracks have said until now."""
        seen = self._waiting.popleft()
        scores = self._totals(seen.track)
        rows = _assign(scores)
        margins = _margins(scores, self._totals(seen.track, self._rules.riding), rows)
        given = rows >= 0
        own = np.where(given, self._confidence(margins, given.sum() < len(seen.track)), 0.5 * np.exp(np.minimum(margins, 0.0)))
        kept = given & (own >= self._least_confidence)
        indices, confidence = np.full(self._count, NULL, dtype=np.int64), np.zeros(self._count)
        indices[self._markers[kept]] = seen.place[rows[kept]]
        confidence[self._markers] = own
        self._release(np.setdiff1d(seen.track, self._track, assume_unique=True))
        return FrameLabels(seen.frame, indices, confidence)

    def _confidence(self, margins: Floats, spare: bool) -> Floats:
        """The probability that labels with such margins are right; `spare` says whether points are left over in their frame."""
        single = self._calibrations[int(spare)].confidence(margins)
        return np.minimum(single, 1.0 / (1.0 + np.exp((self._rules.doubt - margins) / self._rules.dull))) if spare else single


def _marker_of(rows: Ints, points: int) -> Ints:
    """The marker of each point (n,), from the point of each marker (M,)."""
    marker = np.full(points, NULL, dtype=np.int64)
    marker[rows[rows >= 0]] = np.nonzero(rows >= 0)[0]
    return marker


def _assign(scores: Floats) -> Ints:
    """Points to markers, best score first, none below zero: (n, M) nats in, (M,) points out."""
    rows = np.full(scores.shape[1], NULL, dtype=np.int64)
    points, markers = np.nonzero(scores > 0.0)
    taken = np.zeros(len(scores), dtype=np.bool_)
    for e in np.argsort(-scores[points, markers], kind="stable"):
        if rows[markers[e]] < 0 and not taken[points[e]]:
            rows[markers[e]] = points[e]
            taken[points[e]] = True
    return rows


def _margins(scores: Floats, single: Floats, rows: Ints) -> Floats:
    """By how many nats each marker's point beats the nearest other labelling: none, a free point, a swap, another marker taking the point.

    Whether a point is a marker or a ghost that rides along, a second frame hardly tells; which of two markers it is, all frames tell.
    For a marker without a point, how far its best free point is from being taken (not above 0).
    IN scores (n, M) of all frames of each point's track together, single (n, M) of few of them, rows (M,).
    """
    points, markers = scores.shape
    free = np.ones(points, dtype=np.bool_)
    free[rows[rows >= 0]] = False
    best_free = single[free].max(axis=0) if free.any() else np.full(markers, -np.inf)
    given = np.nonzero(rows >= 0)[0]
    margins = np.minimum(best_free, 0.0)
    here = single[rows[given], given]
    margins[given] = np.minimum(here, here - np.maximum(best_free[given], 0.0))
    # what marker m' (columns) gets from the point of marker m (rows), and the other way round
    own, takes = scores[rows[given], given], scores[rows[given]]
    cost = own[:, None] - takes
    cost[:, given] += own[None, :] - np.maximum(takes[:, given].T, 0.0)
    cost[np.arange(len(given)), given] = np.inf
    margins[given] = np.minimum(margins[given], cost.min(axis=1, initial=np.inf))
    return margins
