"""Points in, frame by frame as a camera system delivers them; the labels of the frame some pushes ago out.

Points are linked online to tracks (`tracks.py`). Each track adds up how well it fits each marker, given all other points, in each of its
frames. The labels that follow from this evidence are carried into the next frame, where the whole body refines them at little cost. From
time to time, and where the carried labels do not explain a frame, a search that ignores the past looks for a better labelling. What it
finds must score better over several frames before it takes over, unless the carried labels explain nothing.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit, logit

from asterism.errors import AsterismError
from asterism.findings import Finding
from asterism.geometry import rotate_z_up
from asterism.labelling.body._assignment_kernels import assign_greedily
from asterism.labelling.body._frame_kernels import frame_settings
from asterism.labelling.body._refine_kernels import refine
from asterism.labelling.body._score_kernels import best_pose, rescore
from asterism.labelling.body._search_kernels import MAX_LABELLINGS, find_labellings, make_candidates, make_search_workspace
from asterism.labelling.body._workspace_kernels import BodyArrays, BodyWorkspace, FrameModel, FrameSettings, make_body_workspace
from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.body.model import BodyRules
from asterism.labelling.live._evidence_kernels import margins_of_frame
from asterism.labelling.live.body import LiveBody, LiveRules
from asterism.labelling.live.study import LEAST_CHANCE, Studies, Study
from asterism.labelling.live.tracks import TrackEvidence
from asterism.labelling.live.twins import LiveTwins, marker_of
from asterism.labelling.live.verdict import LiveVerdict, LiveVerdictRules
from asterism.labelling.training.calibration import Calibration
from asterism.labelling.whole.verdict import RigidDistances
from asterism.recording import NULL, Floats, Ints, as_vertical
from asterism.tracking.linking import LinkRules

_CROWD = 2.0
"""Points for each marker above which the first frame is not looked at by itself. With one for each it takes 5 ms of 15 markers, 24 of 39,
55 of 73; with three 5, 40 and 82. Among hundreds of reflections a search that finds nobody may take seconds."""


_YOUNG = 4.0
"""Times as soon that a search comes again while labels are new: of 15 markers every hundredth of a second. At half of it what the first
search missed is found later; at double, searches of 59 markers at 200 Hz take longer than frames do."""


@dataclass(frozen=True)
class StreamRules:
    """How a stream weighs the frames. All were chosen on gait subjects left out of the training (docs/recordings.md).

    evidence_memory    s in which a track's evidence decays to 1/e
    independent_after  s; frames of a track that are nearer in time than this repeat each other, and count for less
    max_score          nats, the most that one frame can say for or against a marker
    search_interval    s between searches where the carried labels explain the frames
    retry_interval     s for each marker until the next search where they do not, since a search of more markers takes longer; twice as long
                       after each search, up to `search_interval`, until a marker has lost its label
    search_effort      markers times labellings that one search refines at most, and markers times twins refined in one frame: so no push
                       of a large marker set takes long; twice as many may take twice as long
    most_effort        times as many evaluations as for a frame alone that a search may take at most where those before found no body that
                       fits: every second one takes twice, every fourth four times as many, and so on. With 59 markers a search of four
                       times takes 6 ms, one of eight 12; at one, every third recording of them began with 0.1 s without a label
    max_ghost_evidence independent frames that count at most for whether a track is a marker or a ghost that moves with the body
    ghost_margin_loss  nats that a margin loses where points are left over, as a ghost that moves with the body fits frame after frame
    log_odds_scale     nats of what then remains that make one unit of log odds
    agreement          log odds that a label gains where a study names the same marker. Chosen on 94 stretches, 75 of them labelled by
                       virtual people: at double up to 0.14 points more are right and 0.03 wrong, at half 0.09 and 0.01 fewer
    beginning          s from the first frame that shows a person in which a track that began in it is a marker more often than later ones,
                       as ghosts come at any time. At half 0.06 points fewer are right, at double as many more, and 0.017 more wrong
    first_gain         log odds that the labels of such tracks gain, until a study gives them. Of those that no study had named, with a
                       probability of 0.7 to 0.8 without it, 88 % were right (n 456), of later tracks 67 % (1,210). At half 0.05 points
                       fewer are right, at double as many more, and 0.01 to 0.03 more wrong
    takeover_margin    nats by which a labelling from a search must be better, summed over independent frames, to take over; more by what
                       studies gave for labels that it changes
    marker_frames      frames after which a track is held for no flickering point where it has a label
    lost               s of empty frames behind which tracks go on, as of frames that were lost; in twice as many a body is elsewhere
    ghost_frames       frames after which an unlabelled one is; shorter ones say nothing against the label of a track that lasts
    """

    evidence_memory: float = 0.5
    independent_after: float = 0.1
    max_score: float = 15.0
    search_interval: float = 0.5
    retry_interval: float = 0.003
    search_effort: int = 450
    most_effort: int = 4
    max_ghost_evidence: float = 3.0
    ghost_margin_loss: float = 3.0
    log_odds_scale: float = 3.3
    beginning: float = 0.1
    first_gain: float = 0.75
    takeover_margin: float = 5.0
    agreement: float = 0.3
    lost: float = 0.1
    marker_frames: float = 1.5
    ghost_frames: float = 2.5


@dataclass(frozen=True)
class StreamModel:
    """What a stream labels by.

    labeller          labels single frames
    markers, names    (M,) columns of the marker set that the body model has learned; number of columns
    calibrations      confidence of frames without and with points left over
    least_confidence  labels below this confidence are not given
    body_rules        how the body model was learned
    distances         near-rigid distances of the training, by which the stream is judged; None where the model keeps no sample of it
    """

    labeller: BodyLabeller
    markers: Ints
    names: int
    calibrations: tuple[Calibration, Calibration]
    least_confidence: float
    body_rules: BodyRules
    distances: RigidDistances | None = None


@dataclass(frozen=True)
class FrameLabels:
    """The labels of one frame.

    frame       how many frames were pushed before it
    indices     (M,) int, each marker's place in the pushed points, -1 for none
    confidence  (M,) in [0, 1]: the probability that this entry is right; for -1, that of the best candidate that was not given
    fits        whether the last seconds show what the model was trained on; where they do not, no label is more certain than 0.99
    """

    frame: int
    indices: Ints
    confidence: Floats
    fits: bool = True


@dataclass(frozen=True)
class _WaitingFrame:
    """A frame that waits for its labels: each point's row in the table of tracks, and its place among the points as pushed."""

    frame: int
    rows: Ints
    place: Ints


@dataclass(frozen=True)
class _Frame:
    """A frame's points (n, 3) m, z up, with the settings for so many points and arrays to work in."""

    xyz: Floats
    settings: FrameSettings
    workspace: BodyWorkspace


@dataclass(frozen=True)
class _RefinedLabelling:
    """The point of each marker (M,), -1 for none; the score in nats, and the key pose."""

    point_of: Ints
    score: float
    pose: int

    @property
    def labelled(self) -> int:
        """How many markers have a point."""
        return int((self.point_of >= 0).sum())


class Stream:
    """Labels live points with a fixed delay and bounded memory. Made by `MarkerModel.stream`.

    The cost of a push does not grow with time. The memory grows with the points of a frame and the delay only.
    """

    def __init__(
        self,
        model: StreamModel,
        rate: float,
        delay: int = 0,
        vertical: ArrayLike | str = "z",
        rules: StreamRules | None = None,
        studies: Studies | None = None,
    ) -> None:
        check_timing(rate, delay)
        self.rate, self.delay = float(rate), int(delay)
        self._model, self._rules = model, rules or StreamRules()
        self._vertical = as_vertical(vertical)
        self._independent = 1.0 / (self._rules.independent_after * self.rate)
        self._soonest_retry = min(self._rules.retry_interval * len(model.markers), self._rules.search_interval)
        labeller = model.labeller
        self._live = None if labeller.model.within is None else LiveBody(labeller.model, model.body_rules, self.rate, LiveRules())
        self._verdict = None if model.distances is None else LiveVerdict(model.distances, self.rate, LiveVerdictRules())
        refined = max(4, self._rules.search_effort // len(model.markers))
        self._is_large = refined < MAX_LABELLINGS
        self._candidates = make_candidates(min(refined, MAX_LABELLINGS), len(model.markers))
        self._twins = LiveTwins(labeller, refined)
        self._studies: Studies | None = None
        self._restart()
        body = labeller.body
        for _ in range(2):  # the first push must not wait for kernels to be read or compiled
            self.push(body.mean[0])
        workspace = make_body_workspace(len(model.markers), *body.load.shape[1::2])
        self._search(_Frame(np.ascontiguousarray(body.mean[0]), labeller.settings, workspace))
        self._studies = studies
        self._restart()

    def _restart(self) -> None:
        """Begin as if no frame had been pushed."""
        if self._studies is not None:
            self._studies.restart()
        self._forget_person()
        decay = math.exp(-1.0 / (self._rules.evidence_memory * self.rate))
        self._tracks = TrackEvidence(len(self._model.markers), LinkRules(), self.rate, decay, self._independent)
        self._rival, self._margin = np.zeros(0, dtype=np.int64), 0.0
        self._last_search, self._age = -np.inf, 0
        # s until the next search where labels do not explain the frames, and the markers (M,) that had one at the last search.
        self._retry, self._explained = self._soonest_retry, np.zeros(len(self._model.markers), dtype=np.bool_)
        # Searches since the last one that found a body that fits.
        self._failed = 0
        self._twins.restart()
        self._last_twins, self._twins_compared = -1, False
        self._waiting: deque[_WaitingFrame] = deque()
        self._pushed, self._empty, self._looked = 0, 0, False
        # The first frame that shows the person, and how many tracks had begun by then.
        self._came, self._first_tracks = 0, 0
        # The points and probabilities of all markers in the last frame, where its labels have been asked for.
        self._known: tuple[Ints, Floats] | None = None
        self._labelled = np.full(len(self._model.markers), NULL, dtype=np.int64)

    def _forget_person(self) -> None:
        """Return to the body model of the training."""
        self._body: BodyArrays = self._model.labeller.body
        if self._live is not None:
            self._live.restart()
        if self._verdict is not None:
            self._verdict.restart()

    def push(self, points: ArrayLike) -> FrameLabels | None:
        """Take the next frame's points; give the labels of the frame `delay` pushes ago, None where there is none yet.

        points: (n, 3) m, in any order, n may be 0, as of a frame that was lost: tracks go on behind a few of these. Raises AsterismError
        where they have another shape or are not finite; the frame is then not counted, and the stream can go on.
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
        study = None if self._studies is None else self._studies.taken(self._pushed)
        if study is not None:
            self._take_study(study)
        self._empty = 0 if len(xyz) else self._empty + 1
        if 0 < self._empty <= self._rules.lost * self.rate:
            self._tracks.lose()
            self._tracks.fade()
            return self._pushed_on(np.zeros(0, dtype=np.int64), place, xyz)
        # Whoever comes after a while in which nobody was there may be another person.
        self._looked = self._looked and not self._empty
        before = self._tracks.current
        previous = self._tracks.link(xyz, (frame.rows for frame in self._waiting))
        self._exclude(before)
        self._known = None
        self._look(xyz)
        rival = np.full(len(xyz), NULL, dtype=np.int64)
        if len(self._rival):
            rival[previous >= 0] = self._rival[previous[previous >= 0]]
        self._update(xyz, rival)
        return self._pushed_on(self._tracks.current, place, xyz)

    def _pushed_on(self, rows: Ints, place: Ints, xyz: Floats) -> FrameLabels | None:
        """Let a frame wait for its labels, and give those of the oldest. rows (n,) in the table of tracks; place (n,) as pushed."""
        self._waiting.append(_WaitingFrame(self._pushed, rows, place))
        if self._studies is not None:
            self._studies.add(self._pushed, xyz, self._tracks.serial[rows], unsure=not self._tracks.seen[rows].all())
        self._pushed += 1
        return self._labels() if len(self._waiting) > self.delay else None

    def flush(self) -> list[FrameLabels]:
        """The labels of the last `delay` frames, oldest first. The stream then begins anew."""
        rest = [self._labels() for _ in range(len(self._waiting))]
        self._restart()
        return rest

    def _exclude(self, before: Ints) -> None:
        """Where a track with a label has ended, those that were there beside it and go on are not its marker.

        A ghost that moves with the body fits the marker beside it in every frame, and would get its label once the marker is hidden.
        before: rows of the frame before.
        """
        stays = self._tracks.among(before, self._tracks.current)
        if not stays.any() or not (self._tracks.frames(before[~stays]) > self._rules.marker_frames).any():
            return
        point_of, chance = self._known if self._known is not None else self._chances(before)
        ended = np.nonzero((point_of >= 0) & ~np.append(stays, True)[point_of])[0]
        self._tracks.exclude(before[stays], ended, self._against(chance[ended]))

    def _against(self, chance: Floats) -> Floats:
        """Nats against all other tracks that were there at once with some which are markers with these probabilities."""
        return self._rules.log_odds_scale * logit(np.clip(chance, 0.5, 1.0 - LEAST_CHANCE))

    def _look(self, xyz: Floats) -> None:
        """Label the first frame that shows a person as one by itself: more thoroughly than there is time for in others."""
        if self._looked or not 0.5 <= len(xyz) / len(self._model.markers) <= _CROWD or len(xyz) < 3:
            return
        self._looked, self._came, self._first_tracks = True, self._pushed, self._tracks.begun
        study = None if self._studies is None else self._studies.look(xyz, self._tracks.serial[self._tracks.current])
        if study is not None:
            self._take_study(study)

    def _take_study(self, study: Study) -> None:
        """Take over what a study says of the tracks and of the person."""
        self._tracks.take(study, self._rules.log_odds_scale)
        if study.body is not None:
            self._body = study.body
            if self._live is not None and self._studies is not None:
                self._live.rest(self._pushed + round(self._studies.rules.window * self.rate))

    def findings(self) -> list[Finding]:
        """What a person should know of the stream."""
        return [] if self._studies is None else self._studies.findings()

    def studies_made(self) -> tuple[int, float]:
        """How many studies of the last seconds were taken over, and s of frames since the last one, NaN before it."""
        return (0, math.nan) if self._studies is None else self._studies.made()

    def wait_for_studies(self, seconds: float) -> None:
        """Wait until studies can be made, at most so long: a process takes a second or two to begin."""
        if self._studies is not None:
            self._studies.wait(seconds)

    def close(self) -> None:
        """End what studies need, such as their process. Labels can still be asked for."""
        if self._studies is not None:
            self._studies.close()

    def _update(self, xyz: Floats, rival: Ints) -> None:
        """Label a frame, and add its scores to the evidence of its tracks. rival (n,): the rival labelling's marker of each point."""
        if self._live is not None:
            self._body = self._live.step() or self._body
        self._tracks.fade()
        self._rival, before = np.full(len(xyz), NULL, dtype=np.int64), self._labelled
        self._labelled = np.full(len(self._model.markers), NULL, dtype=np.int64)
        if len(xyz) < 3:
            return
        markers, latents = self._body.load.shape[1], self._body.load.shape[3]
        # a flickering point is hardly mistaken for a marker that has a track
        lasting = int(self._lasting(self._tracks.current)[1].sum())
        settings = frame_settings(self._model.labeller.settings, lasting or len(xyz), markers)
        frame = _Frame(xyz, settings, make_body_workspace(len(xyz), markers, latents))
        carried = self._refined(frame, _assign(self._tracks.totals(self._tracks.current)[0]))
        self._age += 1
        is_young = self._age * self._independent < 1.0
        challenge, margin = self._challenge(frame, rival, carried, is_young)
        chosen, self._margin = self._contest(frame, carried, challenge, margin)
        if chosen.labelled < 3:
            return
        # at once, since no label is sure before; but once in a push, and with many markers in none that has searched
        busy = self._last_twins == self._pushed or (self._is_large and self._last_search == self._pushed)
        if self._twins.lead is None and not busy:
            self._twins.compare(xyz, chosen.point_of)
        self._tracks.join(before, chosen.point_of)
        self._labelled = chosen.point_of
        if self._verdict is not None:
            self._verdict.add(np.where((chosen.point_of >= 0)[:, None], xyz[chosen.point_of], np.nan))
        rescore(self._body, chosen.pose, xyz, chosen.point_of, settings, frame.workspace)
        self._tracks.add(np.clip(frame.workspace.scores.T, -self._rules.max_score, self._rules.max_score))
        if self._live is not None and not is_young and self._live.needs(self._pushed):
            self._learn_body(frame, self._live)

    def _refined(self, frame: _Frame, point_of: Ints) -> _RefinedLabelling:
        """A labelling of the frame, (M,), corrected and completed by the whole body."""
        if (point_of >= 0).sum() < 3:
            return _RefinedLabelling(point_of, -np.inf, 0)
        point_of, workspace = point_of.copy(), frame.workspace
        workspace.outlier[:] = False
        pose = best_pose(self._body, frame.xyz, point_of, frame.settings, workspace)[0]
        score = float(refine(self._body, pose, frame.xyz, point_of, frame.settings, workspace))
        if (point_of >= 0).sum() >= 3:
            return _RefinedLabelling(point_of, score, int(best_pose(self._body, frame.xyz, point_of, frame.settings, workspace)[0]))
        return _RefinedLabelling(point_of, score, 0)

    def _challenge(self, frame: _Frame, rival: Ints, carried: _RefinedLabelling, is_young: bool) -> tuple[Ints, float]:
        """The labelling that competes with the carried one, (M,), and its margin in nats: the rival as linked, or one from a new search."""
        point_of = np.full(len(carried.point_of), NULL, dtype=np.int64)
        if (rival >= 0).sum() >= 3:
            point_of[rival[rival >= 0]] = np.nonzero(rival >= 0)[0]
        if (self._explained & (carried.point_of < 0)).any():
            self._retry = self._soonest_retry
        wait = self._search_interval(frame, carried, is_young) * self.rate
        if self._pushed - self._last_search >= wait and (point_of < 0).all():
            # the twins in one push and the search in the next, so that no push waits for both
            if carried.labelled >= 3 and not self._twins_compared:
                self._last_twins, self._twins_compared = self._pushed, True
                twin = self._twins.compare(frame.xyz, carried.point_of)
                return (twin, 0.0) if twin is not None else (point_of, self._margin)
            self._last_search, self._twins_compared = self._pushed, False
            # What this search does not explain, the next one hardly will, until a label is lost.
            self._retry, self._explained = min(2.0 * self._retry, self._rules.search_interval), carried.point_of >= 0
            return self._search(frame), 0.0
        return point_of, self._margin

    def _search_interval(self, frame: _Frame, carried: _RefinedLabelling, is_young: bool) -> float:
        """From the last search to the next one, in s."""
        if is_young:
            # At once where no body that fits was found.
            return 0.0 if self._failed else self._soonest_retry / _YOUNG
        usual = frame.settings.usual_score * carried.labelled - frame.settings.first_ghost_cost
        explained = carried.score >= usual and carried.labelled >= min(len(frame.xyz), len(carried.point_of)) - 1
        return self._rules.search_interval if explained else self._retry

    def _contest(self, frame: _Frame, carried: _RefinedLabelling, challenge: Ints, margin: float) -> tuple[_RefinedLabelling, float]:
        """The carried labelling or the challenging one, and the margin of the one that remains a rival, in nats."""
        if (challenge >= 0).sum() < 3 or np.array_equal(challenge, carried.point_of):
            return carried, margin
        rival = self._refined(frame, challenge)
        margin += max(self._independent, 1.0 / self._age) * (rival.score - carried.score) if np.isfinite(carried.score) else np.inf
        if np.array_equal(rival.point_of, carried.point_of) or margin < -self._rules.takeover_margin:
            return carried, 0.0
        rejected = carried.labelled < 0.5 * min(len(frame.xyz), len(challenge)) and rival.score > carried.score
        changed = np.nonzero((carried.point_of >= 0) & (carried.point_of != rival.point_of))[0]
        studied = self._tracks.studied_for(self._tracks.current[carried.point_of[changed]], changed)
        if margin > self._rules.takeover_margin + studied or rejected:
            self._take_over(carried, rival, len(frame.xyz))
            return rival, 0.0
        self._rival = marker_of(rival.point_of, len(frame.xyz))
        return carried, margin

    def _take_over(self, carried: _RefinedLabelling, rival: _RefinedLabelling, points: int) -> None:
        """Forget the evidence of all tracks whose label changes; and the person, if few labels stay."""
        if (rival.point_of == carried.point_of).sum() < 0.5 * carried.labelled or carried.labelled < 3:
            self._forget_person()
        changed = marker_of(rival.point_of, points) != marker_of(carried.point_of, points)
        self._tracks.clear(self._tracks.current[changed])
        self._age, self._retry = 0, self._soonest_retry
        self._twins.restart()

    def _learn_body(self, frame: _Frame, live: LiveBody) -> None:
        """Give a frame to the live body model, if enough of its labels have large margins."""
        scores, limited = self._tracks.totals(self._tracks.current, self._rules.max_ghost_evidence)
        point_of = _assign(scores)
        margins = self._margins(self._tracks.current, scores, limited, point_of)
        certain = (point_of >= 0) & (margins >= live.rules.min_margin)
        if certain.sum() < live.rules.min_share * len(point_of):
            return
        frame.workspace.outlier[:] = False
        body, labels = self._model.labeller.body, np.where(certain, point_of, NULL)
        pose = best_pose(body, frame.xyz, labels, frame.settings, frame.workspace)[0]
        live.add(self._pushed, np.where(certain[:, None], frame.xyz[point_of], np.nan), int(pose))

    def _search(self, frame: _Frame) -> Ints:
        """The best labelling of the frame that a search finds without knowing the past: (M,)."""
        labeller, order = self._model.labeller, np.argsort(-frame.xyz[:, 2], kind="stable")
        # Of many points one anchor may take what is allowed for a frame, and end before the body is found: every second search that follows
        # one without a body may take twice as much, every fourth four times.
        number = self._failed + 1
        effort = min(number & -number, self._rules.most_effort)
        settings = frame.settings._replace(max_evaluations=effort * frame.settings.max_evaluations)
        counters = np.zeros(4, dtype=np.int64)
        model = FrameModel(labeller.solvers, labeller.anchors, labeller.body, settings, labeller.twins)
        workspace = make_search_workspace(frame.workspace, self._candidates, settings.proposals_per_anchor)
        _, best = find_labellings(model, np.ascontiguousarray(frame.xyz[order]), workspace, counters)
        self._failed += 1
        if best < 0 or not np.isfinite(self._candidates.scores[best]):
            return np.full(len(self._model.markers), NULL, dtype=np.int64)
        found = self._candidates.labellings[best]
        if self._candidates.scores[best] >= settings.usual_score * (found >= 0).sum() - settings.first_ghost_cost:
            self._failed = 0
        return np.where(found >= 0, order[found], NULL)

    def _labels(self) -> FrameLabels:
        """The oldest waiting frame's labels, from all evidence that its tracks have now."""
        waiting = self._waiting.popleft()
        if not len(waiting.rows):
            # Nothing is to be weighed in a frame that was lost; where frames are lost because the chain is too slow, this must be cheap.
            indices, confidence = np.full(self._model.names, NULL, dtype=np.int64), np.zeros(self._model.names)
            return FrameLabels(waiting.frame, indices, confidence, self._verdict is None or self._verdict.fits)
        against = self._hindsight(waiting.rows)
        point_of, chance = self._chances(waiting.rows, against)
        if waiting.rows is self._tracks.current:
            self._known = point_of, chance
        kept = (point_of >= 0) & (chance >= self._model.least_confidence)
        indices, confidence = np.full(self._model.names, NULL, dtype=np.int64), np.zeros(self._model.names)
        indices[self._model.markers[kept]] = waiting.place[point_of[kept]]
        confidence[self._model.markers] = chance
        ended = waiting.rows[~self._tracks.among(waiting.rows, self._tracks.current)]
        self._tracks.release(ended, (frame.rows for frame in self._waiting))
        return FrameLabels(waiting.frame, indices, confidence, self._verdict is None or self._verdict.fits)

    def _hindsight(self, rows: Ints) -> Floats | None:
        """Nats (n, M) against tracks of a frame that has waited, in these rows, where tracks that began since are the markers.

        None for none.
        """
        tracks, current = self._tracks, self._tracks.current
        began = ~tracks.among(current, rows)
        # A flickering point is no marker that came back.
        if not (tracks.frames(current[began]) > self._rules.marker_frames).any():
            return None
        point_of, chance = self._known = self._chances(current)
        since = (point_of >= 0) & began[point_of]
        against = np.zeros((len(rows), len(point_of)))
        against[np.ix_(tracks.among(rows, current), since)] = self._against(chance[since])
        return against

    def _chances(self, rows: Ints, against: Floats | None = None) -> tuple[Ints, Floats]:
        """The point of each marker among those of the tracks in these rows, (M,), -1 for none, and the probability that this is right.

        For -1, that of the best candidate that was not given. against (n, M): nats to take from what the tracks say.
        """
        scores, limited = self._tracks.totals(rows, self._rules.max_ghost_evidence)
        if against is not None:
            scores, limited = scores - against, limited - against
        point_of = _assign(scores)
        margins = self._margins(rows, scores, limited, point_of)
        given = point_of >= 0
        left = np.ones(len(rows), dtype=np.bool_)
        left[point_of[given]] = False
        lasts, may_be_marker = self._lasting(rows)
        near_ghost = (left & may_be_marker).any() | (left.any() & ~lasts[point_of])
        certainty, gain = self._confidence(margins, near_ghost), self._first_gain(point_of, rows)
        if gain.any():
            certainty = np.where(gain > 0.0, expit(logit(np.minimum(certainty, 1.0 - LEAST_CHANCE)) + gain), certainty)
        certainty = np.minimum(certainty, self._twins.limits(len(margins)))
        if self._verdict is not None:
            certainty = np.minimum(certainty, self._verdict.limit)
        certainty = self._with_study(certainty, point_of, rows, gain)
        return point_of, np.where(given, certainty, 0.5 * np.exp(np.minimum(margins, 0.0)))

    def _first_gain(self, point_of: Ints, rows: Ints) -> Floats:
        """Log odds (M,) that labels gain where their tracks began in the first frame that shows the person, which was not long ago.

        None where a study gives the track a label, or names another marker.
        """
        if not len(rows) or self._pushed - self._came >= self._rules.beginning * self.rate:
            return np.zeros(len(point_of))
        of = rows[point_of]
        studied, given = self._tracks.studied[of], self._tracks.given[of]
        is_open = (studied == NULL) | ((studied == np.arange(len(point_of))) & ~given)
        first = (point_of >= 0) & (self._tracks.serial[of] < self._first_tracks)
        return np.where(first & is_open, self._rules.first_gain, 0.0)

    def _with_study(self, certainty: Floats, point_of: Ints, rows: Ints, gain: Floats) -> Floats:
        """How certain labels (M,) are, in the light of what a study said of their tracks.

        The stream and the study err in part in the same frames: so the mean of what both say counts, as log odds, and a little more where
        both name one marker. Of a study that gives the track another label, it counts how improbable that is. gain (M,): log odds that the
        stream's own have gained, and that count whole.
        """
        if not len(rows):
            return certainty
        of = rows[point_of]
        studied, given, chance = self._tracks.studied[of], self._tracks.given[of], self._tracks.chance[of]
        same = studied == np.arange(len(point_of))
        told = np.nonzero((point_of >= 0) & (studied >= 0) & (same | given))[0]
        if len(told):
            said = np.where(same, chance, 1.0 - chance)[told]
            own, found = logit(np.clip([certainty[told], said], LEAST_CHANCE, 1.0 - LEAST_CHANCE))
            certainty[told] = expit(0.5 * (own + found + gain[told]) + np.where(same[told], self._rules.agreement, 0.0))
        return certainty

    def _margins(self, rows: Ints, scores: Floats, limited: Floats, point_of: Ints) -> Floats:
        """`margins_of_frame` of a labelling of the tracks in these rows; a track that lasts has no rivals among those that flicker."""
        lasts, may_be_marker = self._lasting(rows)
        margins = np.empty(len(point_of))
        margins_of_frame(scores, limited, np.ones(len(rows), dtype=np.bool_), point_of, margins)
        if may_be_marker.all():
            return margins
        kept = may_be_marker.copy()
        kept[point_of[point_of >= 0]] = True
        of_lasting, among_lasting = lasts[point_of] & (point_of >= 0), np.empty(len(point_of))
        margins_of_frame(scores, limited, kept, np.where(of_lasting, point_of, NULL), among_lasting)
        return np.where(of_lasting, among_lasting, margins)

    def _lasting(self, rows: Ints) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which labelled tracks are held for no flickering points, (n + 1,), True at the end, for -1; and which others, (n,)."""
        frames = self._tracks.frames(rows)
        return np.append(frames > self._rules.marker_frames, True), frames > self._rules.ghost_frames

    def _confidence(self, margins: Floats, near_ghost: NDArray[np.bool_]) -> Floats:
        """The probability that labels with these margins are right; near_ghost: where a point without a label may be the marker as well."""
        alone, crowded = (calibration.confidence(margins) for calibration in self._model.calibrations)
        bound = 1.0 / (1.0 + np.exp((self._rules.ghost_margin_loss - margins) / self._rules.log_odds_scale))
        return np.where(near_ghost, np.minimum(crowded, bound), alone)


def check_timing(rate: float, delay: int) -> None:
    """Raise AsterismError where a rate or a delay cannot be those of a stream."""
    if not np.isfinite(rate) or rate <= 0:
        raise AsterismError(f"frame rate {rate} is not a positive number of frames per second; pass the rate of the live system.")
    if not isinstance(delay, int | np.integer) or isinstance(delay, bool) or delay < 0:
        raise AsterismError(f"delay {delay!r} is not a whole number of frames; give 0 for none.")


def _assign(scores: Floats) -> Ints:
    """Points to markers, best score first, none below zero: (n, M) nats in, (M,) points out."""
    point_of = np.empty(scores.shape[1], dtype=np.int64)
    assign_greedily(np.ascontiguousarray(scores.T), 0.0, point_of)
    return point_of
