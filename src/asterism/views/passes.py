"""A labeller of frames in; the labels of all frames, sought in both directions of time, with what speaks against each, out."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.files.journal import Journal
from asterism.recording import Floats, Ints
from asterism.views.frame import BlobLabels, FrameLabeller
from asterism.views.personal import quality_of


@dataclass(frozen=True, eq=False)
class ScoredFrame:
    """A frame's labels with what is judged of them.

    labels   the labels and the pose, with their margins over what else was tried
    quality  nats per expected sighting, see `quality_of`
    """

    labels: BlobLabels
    quality: float


class Starts:
    """The body found without a start in some frames, once for both directions."""

    def __init__(self, labeller: FrameLabeller) -> None:
        self._labeller = labeller
        self._known: dict[int, ScoredFrame | None] = {}

    def at(self, t: int) -> ScoredFrame | None:
        """Frame t labelled from nothing; None where fewer than two cameras have blobs."""
        if t not in self._known:
            try:
                self._known[t] = seen(self._labeller, self._labeller.from_nothing(t))
            except AsterismError:
                # Fewer than two cameras have blobs here; that stays so for the other direction.
                self._known[t] = None
        return self._known[t]


def seen(labeller: FrameLabeller, labels: BlobLabels) -> ScoredFrame:
    """A frame's labels, judged."""
    return ScoredFrame(labels, quality_of(labeller, labels))


class DirectionalTracker:
    """Frames one after the other, in one direction: predicts, follows, notices that the body is lost, and seeks it anew.

    Every `ViewsRules.turn_frames` frames, and in the first and the last, the followed body is compared with the one that is found without
    a start; the better explanation goes on, and the other one is its rival.
    """

    def __init__(self, labeller: FrameLabeller, starts: Starts, step: int) -> None:
        self.labeller = labeller
        self.seen: dict[int, ScoredFrame | None] = {}
        self.restarts: list[int] = []
        self.failed: dict[int, str] = {}
        self._starts = starts
        self._step = step
        self._wait = 0
        self._patience = 1

    def take(self, t: int, journal: Journal | None = None) -> None:
        """Label frame t; the frame before in the pass's direction was taken before. What `journal` holds of it is taken from there.

        A frame that fails has no body, and why is in `failed`; the next one is sought from nothing.
        """
        if journal is None:
            self._try(t)
        else:
            self._restore(t, journal.step(lambda: self._arrays(t)))

    def _try(self, t: int) -> None:
        try:
            self._take(t)
        # Whatever is wrong with one frame must not cost the others.
        except Exception as problem:
            self.seen[t] = None
            self.failed[t] = " ".join(str(problem).split()) or type(problem).__name__

    def _take(self, t: int) -> None:
        rules = self.labeller.rules
        found = self._followed(t)
        checked = t % rules.turn_frames == 0 or t in (0, len(self.labeller.scene.blobs) - 1)
        # The followed body is compared in regular steps, since a pass that took a wrong turn explains its own blobs well.
        if found is not None and checked:
            found = self._compared(t, seen(self.labeller, self.labeller.turned(t, found.labels)))
        if found is None or found.quality < rules.lost:
            found = self._reacquire(t, found)
        self.seen[t] = found

    def _arrays(self, t: int) -> list[NDArray[Any]]:
        """Frame t labelled, and where the search stands after it, as arrays for a journal."""
        self._try(t)
        found, restarted = self.seen[t], self.restarts[-1:] == [t]
        failed = np.frombuffer(self.failed.get(t, "").encode(), dtype=np.uint8)
        state: list[NDArray[Any]] = [np.array([self._wait, self._patience, restarted], dtype=np.int64), failed]
        if found is None:
            return state
        return [*state, *(np.asarray(getattr(found.labels, one.name)) for one in fields(BlobLabels)), np.array(found.quality)]

    def _restore(self, t: int, arrays: list[NDArray[Any]]) -> None:
        """The tracker as `_arrays` left it."""
        (wait, patience, restarted), failed, *labels = arrays
        self._wait, self._patience = int(wait), int(patience)
        if restarted and self.restarts[-1:] != [t]:
            self.restarts.append(t)
        if len(failed):
            self.failed[t] = failed.tobytes().decode()
        values: list[Any] = [array if array.ndim else float(array) for array in labels]
        self.seen[t] = ScoredFrame(BlobLabels(*values[:-1]), values[-1]) if values else None

    def _followed(self, t: int) -> ScoredFrame | None:
        last, lost = self.seen.get(t - self._step), self.labeller.rules.lost
        if last is None or last.quality < lost:
            return None
        pose = last.labels.pose.copy()
        before = self.seen.get(t - 2 * self._step)
        if before is not None and before.quality >= lost:
            # The place goes on with its velocity; angles with less of it, since limbs swing back.
            pose[3:6] += pose[3:6] - before.labels.pose[3:6]
            pose[9:] += 0.8 * (pose[9:] - before.labels.pose[9:])
        return seen(self.labeller, self.labeller.follow(t, pose, last.labels.rotation, (t - self._step, last.labels)))

    def _compared(self, t: int, followed: ScoredFrame) -> ScoredFrame:
        """The better one of the followed body and the one found without a start."""
        fresh = self._starts.at(t)
        if fresh is None:
            return followed
        ahead = fresh.labels.gain - followed.labels.gain
        # The followed body stays unless the fresh one is clearly better, so that equal explanations do not alternate.
        better, other = (fresh, followed) if ahead > self.labeller.rules.taken_over else (followed, fresh)
        return _with_rival(better, other.labels.labels, better.labels.gain - other.labels.gain)

    def _reacquire(self, t: int, otherwise: ScoredFrame | None) -> ScoredFrame | None:
        """The body found without a start; after tries without success it is tried in fewer frames."""
        # An empty room costs a search only now and then, and less often the longer it stays empty.
        if self._wait > 0:
            self._wait -= 1
            return otherwise
        found = self._starts.at(t)
        if found is not None and found.quality >= self.labeller.rules.lost:
            self.restarts.append(t)
            self._patience = 1
        else:
            self._wait = self._patience
            self._patience = min(2 * self._patience, self.labeller.rules.longest_wait)
        if otherwise is not None and (found is None or otherwise.quality >= found.quality):
            return otherwise
        return found


def _with_rival(one: ScoredFrame, labels: Ints, margin: float) -> ScoredFrame:
    """A frame's labels with one more explanation than which they are better by so many nats."""
    own = one.labels
    rival_margin = np.where(labels == own.labels, own.rival_margin, np.minimum(own.rival_margin, margin))
    return replace(one, labels=replace(own, rival_margin=rival_margin))


def joined(forward: DirectionalTracker, backward: DirectionalTracker) -> list[ScoredFrame | None]:
    """The better one of both directions in each frame, with the other one as its rival.

    The path through the frames with the greatest sum of gains is taken; where the directions differ, going over from one to the other
    costs `ViewsRules.jump`, since a limb does not turn about between two frames. The margin of a frame over its rival is the mean of the
    frames around, `ViewsRules.window` on both sides. O(T window).
    """
    rules = forward.labeller.rules
    pairs = [(forward.seen[t], backward.seen[t]) for t in range(len(forward.seen))]
    ahead, differ = np.zeros(len(pairs)), np.zeros(len(pairs))
    # Only frames in which both directions differ can tell them apart.
    for t, (one, other) in enumerate(pairs):
        if one is not None and other is not None and not np.array_equal(one.labels.labels, other.labels.labels):
            ahead[t], differ[t] = one.labels.gain - other.labels.gain, 1.0
    around = np.ones(2 * rules.window + 1)
    inside = slice(rules.window, rules.window + len(pairs))
    # A single frame decides little; the frames around it have the same body.
    margin = np.convolve(ahead, around)[inside] / np.maximum(np.convolve(differ, around)[inside], 1.0)
    # Viterbi keeps one direction over stretches: going over between two frames means a limb that turned about.
    first = _best_path(ahead, differ > 0, rules.jump)
    return [_better(one, other, float(margin[t]), bool(first[t]), rules.lost) for t, (one, other) in enumerate(pairs)]


def _best_path(ahead: Floats, differ: NDArray[np.bool_], jump: float) -> NDArray[np.bool_]:
    """(T,) whether the first of two explanations is taken in each frame (Viterbi).

    ahead (T,) nats, by how much it gains more than the second; differ (T,) whether they differ; jump: nats that going over costs where
    they differ in both frames. O(T).
    """
    frames = len(ahead)
    # Best sums that end in each direction, and from where they came.
    total, came = np.zeros(2), np.zeros((frames, 2), dtype=np.int64)
    for t in range(frames):
        cost = jump if t > 0 and differ[t] and differ[t - 1] else 0.0
        through = np.array([[total[0], total[1] - cost], [total[0] - cost, total[1]]])
        came[t] = [0 if through[0, 0] >= through[0, 1] else 1, 1 if through[1, 1] >= through[1, 0] else 0]
        total = through.max(axis=1) + np.array([ahead[t], 0.0])
    first = np.empty(frames, dtype=np.bool_)
    state = 0 if frames == 0 or total[0] >= total[1] else 1
    # Back from the end along the way that each best sum came.
    for t in range(frames - 1, -1, -1):
        first[t] = state == 0
        state = int(came[t, state])
    return first


def _better(one: ScoredFrame | None, other: ScoredFrame | None, margin: float, first: bool, lost: float) -> ScoredFrame | None:
    """The explanation of the path; margin: nats of the first over the second. One that is lost gives way to one that is not."""
    if one is None or other is None:
        return one if other is None else other
    # A body that was found beats one that was lost, whatever the path says.
    if (one.quality < lost) != (other.quality < lost):
        return one if one.quality >= lost else other
    return _with_rival(one, other.labels.labels, max(margin, 0.0)) if first else _with_rival(other, one.labels.labels, max(-margin, 0.0))
