"""Live tracks: points frame by frame in; which points continue which track, and each track's evidence for each marker, out."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.special import logit

from asterism.labelling.live._evidence_kernels import add_up_evidence
from asterism.labelling.live.study import LEAST_CHANCE, Study
from asterism.recording import NULL, Floats, Ints
from asterism.tracking.link_kernels import extend_tracks, link_step
from asterism.tracking.link_workspace_kernels import TrackEnds, make_link_workspace, make_track_ends
from asterism.tracking.linking import LinkRules


class TrackEvidence:
    """Links points online, and adds up what the frames of each track say for each of M markers.

    A track keeps one row of the table for as long as it continues, or a frame that it is in waits for its labels. Memory grows with the
    points of a frame and the frames that wait.

    markers      M
    rules, rate  when a point continues a track, and frames per second
    decay        share of the evidence that is left after a frame
    independent  share of an independent frame that each further frame of a track counts as

    current      (n,) rows of the last frame's points
    begun        how many tracks have begun so far
    serial       (rows,) a number that no other track has, -1 for a row without a track
    seen         (rows,) whether a study has seen the track
    studied      (rows,) the marker that a study found for the track, -1 where none has
    given        (rows,) whether that marker is its label; not for a candidate
    chance       (rows,) the study's probability that this marker is right
    """

    def __init__(self, markers: int, rules: LinkRules, rate: float, decay: float, independent: float) -> None:
        self._rules, self._rate, self._decay, self._independent = rules, rate, decay, independent
        self._limits, self._lost = rules.limits(rate), 0
        size = 16
        self._ends, self._next_ends, self._workspace = make_track_ends(size), make_track_ends(size), make_link_workspace(size)
        self._evidence, self._prior, self._frames = np.zeros((size, markers)), np.zeros((size, markers)), np.zeros(size)
        self._excluded = np.zeros((size, markers))
        self.serial, self.studied = np.full(size, NULL, dtype=np.int64), np.full(size, NULL, dtype=np.int64)
        self.seen, self.given, self.chance = np.zeros(size, dtype=np.bool_), np.zeros(size, dtype=np.bool_), np.zeros(size)
        self._free, self.begun = list(range(size)), 0
        self.current = np.zeros(0, dtype=np.int64)

    def __len__(self) -> int:
        """Rows of the table."""
        return len(self._frames)

    def link(self, xyz: Floats, waiting: Iterable[Ints]) -> Ints:
        """Continue the tracks with a frame's points, (n, 3) m, sorted by x; waiting: rows of the frames that wait for labels.

        Gives the point of the frame before that each point continues, -1 for none.
        """
        if len(xyz) > len(self._ends.age):
            ends, count = make_track_ends(2 * len(xyz)), len(self.current)
            for array, old in zip(ends, self._ends, strict=True):
                array[:count] = old[:count]
            self._ends, self._next_ends, self._workspace = ends, make_track_ends(2 * len(xyz)), make_link_workspace(2 * len(xyz))
        previous, step, limits = np.empty(len(xyz), dtype=np.int64), self._lost + 1, self._limits
        if step > 1:
            # Over so many frames, points go on as at a rate that is as much lower.
            limits = self._rules.limits(self._rate / step)
            _at_rate(self._ends, step)
        link_step(self._ends, len(self.current), xyz, limits, self._workspace, previous, self._next_ends)
        self._ends, self._next_ends, self._lost = self._next_ends, self._ends, 0
        self._points, self._previous, self._before = xyz, previous, (self.current, self.serial[self.current])
        self._may_join = step == 1
        if step > 1:
            _at_rate(self._ends, 1.0 / step)
        linked = previous >= 0
        rows = np.empty(len(xyz), dtype=np.int64)
        rows[linked] = self.current[previous[linked]]
        if step > 1:
            # Over lost frames a track may go on as what came back beside it.
            self._excluded[rows[linked]] = 0.0
        rows[~linked] = self._new_rows(int((~linked).sum()))
        ended = self.current[~self.among(self.current, rows)]
        self.current = rows
        self.release(ended, waiting)
        return previous

    def join(self, before: Ints, points: Ints) -> None:
        """Where motion left open which point goes on with a track of one point, let labels decide: places of the last two frames, (M,).

        before, points: where each marker was in the frame before, and is in this one; -1 for nowhere. Two points of a marker are joined
        where the first has no other successor, the second begins a track, and motion allows it.
        """
        both = np.nonzero((before >= 0) & (points >= 0) & self._may_join)[0]
        first, then = before[both], points[both]
        space = self._workspace
        goes_on = np.zeros(len(self._before[0]), dtype=np.bool_)
        goes_on[self._previous[self._previous >= 0]] = True
        is_open = (self._previous[then] < 0) & (self._next_ends.age[first] == 1) & ~goes_on[first]
        first, then = first[is_open], then[is_open]
        is_near = np.linalg.norm(self._points[then] - space.predicted[first], axis=1) <= space.gate[first]
        first, then = first[is_near], then[is_near]
        if not len(first):
            return
        self._previous[then] = first
        extend_tracks(self._next_ends, self._points, space.predicted, self._previous, self._ends)
        begun, rows = self.current[then], self._before[0][first]
        self.current[then], self.serial[rows], self.serial[begun] = rows, self._before[1][first], NULL
        # They have ended for the time of this push, and were not faded with the others.
        joined = set(rows.tolist())
        self._free = [row for row in self._free if row not in joined] + begun.tolist()
        self._evidence[rows] *= self._decay
        self._frames[rows] *= self._decay

    def lose(self) -> None:
        """A frame is lost: what goes on with the next one is sought as far as it may have moved meanwhile."""
        self._lost += 1

    def _new_rows(self, count: int) -> list[int]:
        """Empty rows for tracks that begin."""
        if len(self._free) < count:
            size = len(self._frames)
            more = size + count
            self._free.extend(range(size, size + more))
            for name in ("_evidence", "_prior", "_excluded", "_frames", "serial", "seen", "studied", "given", "chance"):
                old = getattr(self, name)
                setattr(self, name, np.concatenate([old, np.zeros((more, *old.shape[1:]), dtype=old.dtype)]))
            self.serial[size:] = NULL
        rows = [self._free.pop() for _ in range(count)]
        self.clear(rows)
        self.serial[rows] = np.arange(self.begun, self.begun + count)
        self.begun += count
        return rows

    def release(self, rows: Ints, waiting: Iterable[Ints]) -> None:
        """Free the rows of tracks that have ended, except those that a waiting frame needs."""
        if len(rows):
            needed = set().union(*(of_frame.tolist() for of_frame in waiting))
            free = [row for row in rows.tolist() if row not in needed]
            self.serial[free] = NULL
            self._free.extend(free)

    def among(self, rows: Ints, others: Ints) -> NDArray[np.bool_]:
        """Which of these rows of the table are among the others: as `numpy.isin`, which takes 50 times as long for so few."""
        is_other = np.zeros(len(self), dtype=np.bool_)
        is_other[others] = True
        return is_other[rows]

    def fade(self) -> None:
        """Let the evidence of the current tracks decay by one frame."""
        self._evidence[self.current] *= self._decay
        self._frames[self.current] *= self._decay

    def add(self, scores: Floats) -> None:
        """Add a frame's scores, (n, M) nats, to the current tracks."""
        self._evidence[self.current] += scores
        self._frames[self.current] += 1.0

    def frames(self, rows: Ints) -> Floats:
        """How many frames the evidence of each track rests on, those long ago counted less: (n,)."""
        return self._frames[rows]

    def clear(self, rows: Ints | list[int]) -> None:
        """Forget the evidence of some tracks, and what a study said of them."""
        self._evidence[rows], self._prior[rows], self._excluded[rows], self._frames[rows] = 0.0, 0.0, 0.0, 0.0
        self.seen[rows], self.studied[rows], self.given[rows] = False, NULL, False

    def take(self, study: Study, log_odds_scale: float) -> None:
        """Let the labels that a study gives to tracks count beside their frames, until the next one.

        log_odds_scale: nats that make one unit of log odds.
        """
        if not len(study.serials):
            return
        place = np.minimum(np.searchsorted(study.serials, self.serial), len(study.serials) - 1)
        rows = np.nonzero(study.serials[place] == self.serial)[0]
        place = place[rows]
        markers, given, chance = study.markers[place], study.given[place], study.chance[place]
        self.seen[rows], self.studied[rows], self.given[rows], self.chance[rows] = True, markers, given, chance
        odds = log_odds_scale * logit(np.clip(chance, LEAST_CHANCE, 1.0 - LEAST_CHANCE))
        gain = np.where(given, np.maximum(odds, 0.0), 0.0)
        self._prior[rows] = -gain[:, None]
        self._prior[rows, markers] = gain
        # It has weighed which tracks were there at once.
        self._excluded[rows[given], markers[given]] = 0.0

    def studied_for(self, rows: Ints, markers: Ints) -> float:
        """The nats that the last study gave for each of these tracks being these markers, (J,), added up."""
        return float(np.maximum(self._prior[rows, markers], 0.0).sum())

    def exclude(self, rows: Ints, markers: Ints, nats: Floats) -> None:
        """Count so many nats (J,) against each of these tracks being these markers, (J,), until it ends or a study gives it the label."""
        at = np.ix_(rows, markers)
        self._excluded[at] = np.maximum(self._excluded[at], nats)

    def totals(self, rows: Ints, max_frames: float = np.inf) -> tuple[Floats, Floats]:
        """What all frames of each track say for each marker, (n, M) nats; and as much of it as so many independent frames say, at most.

        What a study said, and what is excluded, counts in full beside them.
        """
        totals = np.empty((len(rows), self._evidence.shape[1]))
        limited = np.empty_like(totals)
        table = (self._evidence, self._prior, self._excluded)
        add_up_evidence(table, self._frames, rows, self._independent, max_frames, totals, limited)
        return totals, limited


def _at_rate(ends: TrackEnds, step: float) -> None:
    """OUT ends: their motion per frame, of frames that are as many times as far apart."""
    ends.velocity[:] *= step
    ends.acceleration[:] *= step * step
