"""The last seconds of a stream in; what a labelling of them as a whole says of its tracks and of the person, out.

A frame alone, and the tracks up to it, say less than the seconds together: which tracks are markers that were hidden for a while, which are
ghosts, and how this person differs from others. `asterism label` weighs all of it. A study is such a labelling of the last seconds. It
takes longer than a frame may, so that it is made beside the stream, and what it says is taken over some frames later.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from asterism.findings import Finding
from asterism.labelling.body._workspace_kernels import BodyArrays
from asterism.recording import Floats, Ints

StudyPlace = Literal["process", "push", "none"]
"""Where studies are made: in a process beside the stream; in `push`, which then takes as long as they do; nowhere."""

LEAST_CHANCE = 1e-4
"""What a study's probability counts as at least, and its opposite: no trials tell rarer errors. At half and double odds move by 2 nats."""


@dataclass(frozen=True)
class StudyRules:
    """What is studied, and when. Chosen on `movement`, by virtual people, and on simulated people.

    window      s that are labelled as a whole at most: three steps of a walk
    growth      a study begins when there are so many times the frames of the one before, while there are fewer than `window`
    interval    s from one study to the next at most; one begins at once where a track is new, as soon as the one before is done
    nobody      s with fewer than three points after which what was before is another person's
    noise_std   m, standard deviation of a marker beyond what the body of the person explains, as `LiveRules.noise_std`
    least_doubt probability below which a track without a label says nothing: of the labels that streams are sure of and studies have so,
                96 % are right, as of those of new tracks. With twice as much likewise; with half of it one label in 3,000 is lost
    alone       probability from which labels of the first frame alone are given, and not named as candidates, where only virtual people
                taught the model: of those above it 99.6 % were right (n 1,420), of those from 0.93 to 0.95 97 % (676), of those below 71 %
                (536). Of models of real people all are: 98.8 % of those below it were right (494), with three hidden markers and ghosts
    lag         s for each marker that a study in `push` is held back, since a process would take as long
    frame_lag   s for each marker and each frame of it, likewise. Of studies of 15, 39 and 73 markers, in a process on an idle core
    """

    window: float = 3.0
    growth: float = 1.25
    interval: float = 1.0
    nobody: float = 1.0
    noise_std: float = 0.008
    least_doubt: float = 0.05
    alone: float = 0.95
    lag: float = 1e-3
    frame_lag: float = 2.5e-5


@dataclass(frozen=True, eq=False)
class StreamFrames:
    """F frames of a stream that follow each other.

    first   the number of the first
    xyz     (P, 3) m, z up, all points one frame after the other
    counts  (F,) points of each
    serials (P,) the track of each point
    """

    first: int
    xyz: Floats
    counts: Ints
    serials: Ints


@dataclass(frozen=True, eq=False)
class Study:
    """What the last seconds say as a whole.

    last     the number of their last frame
    frames   how many there were
    serials  (J,) the tracks, in growing order
    markers  (J,) the marker of each at its end, or of which it is a candidate, -1 for none
    given    (J,) whether the marker is its label; not for a candidate
    chance   (J,) the probability that this marker is right
    body     the model of the person; None where too little is certain
    """

    last: int
    frames: int
    serials: Ints
    markers: Ints
    given: NDArray[np.bool_]
    chance: Floats
    body: BodyArrays | None


class Studies(Protocol):
    """Where a stream's studies are made."""

    @property
    def rules(self) -> StudyRules:
        """What is studied, and when."""

    def add(self, number: int, xyz: Floats, serials: Ints, *, unsure: bool) -> None:
        """Take a frame: (n, 3) m, z up, and the track of each point; unsure: whether no study has seen one of these."""

    def taken(self, number: int) -> Study | None:
        """What was found since it was asked before, as the frame with this number comes; None where there is nothing new."""

    def look(self, xyz: Floats, serials: Ints) -> Study | None:
        """What one frame says at once, (n, 3) m, z up, and the track of each point; None while that is not known."""

    def restart(self) -> None:
        """Forget all frames; what is under way is not given any more."""

    def wait(self, seconds: float) -> bool:
        """Wait until a study could begin, at most so long. Gives whether it could."""

    def made(self) -> tuple[int, float]:
        """How many were taken over so far, and s of frames since the last one, NaN before it. One of the first frame alone is none."""

    def findings(self) -> list[Finding]:
        """What a person should know of the studies."""

    def close(self) -> None:
        """End what is under way."""


def frames_kept(rate: float, rules: StudyRules) -> int:
    """How many frames are labelled as a whole at most."""
    return max(1, round(rules.window * rate))


class StudyPlan:
    """When the next study begins, and the frames that it has not had; which were taken over. Memory: the points of `StudyRules.window`."""

    def __init__(self, rate: float, rules: StudyRules) -> None:
        self._rate, self._rules, self._kept = rate, rules, frames_kept(rate, rules)
        self._new: deque[tuple[Floats, Ints]] = deque(maxlen=self._kept)
        self._taken, self._since = 0, 0
        self.restart()

    def restart(self) -> None:
        """Forget all frames."""
        self._new.clear()
        self._last = self._seen = 0

    def add(self, number: int, xyz: Floats, serials: Ints) -> None:
        """Take a frame."""
        self._new.append((xyz, serials))
        self._last, self._seen, self._since = number, self._seen + 1, self._since + 1

    def take(self) -> None:
        """A study was taken over."""
        self._taken, self._since = self._taken + 1, 0

    def made(self) -> tuple[int, float]:
        """See `Studies.made`."""
        return self._taken, self._since / self._rate if self._taken else math.nan

    def is_due(self, *, unsure: bool) -> bool:
        """Whether a study should begin, if none is under way."""
        new = len(self._new)
        known = min(self._seen - new, self._kept)
        growing = known < self._kept and known + new >= self._rules.growth * known
        return unsure or growing or new >= self._rules.interval * self._rate

    @property
    def is_full(self) -> bool:
        """Whether there are as many frames as are labelled as a whole at most."""
        return self._seen >= self._kept

    def frames(self) -> StreamFrames:
        """The frames since this was asked before; there is at least one."""
        xyz, serials = (np.concatenate(parts) for parts in zip(*self._new, strict=True))
        found = StreamFrames(self._last - len(self._new) + 1, xyz, np.array([len(points) for points, _ in self._new]), serials)
        self._new.clear()
        return found
