"""Labelled frames of a stream in, one by one; a body model adapted to the person, in small steps, out."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from asterism.labelling.body._workspace_kernels import BodyArrays
from asterism.labelling.body.model import BodyModel, BodyRules
from asterism.labelling.body.subject import SubjectRules, adapt_in_steps
from asterism.recording import Floats


@dataclass(frozen=True)
class LiveRules:
    """When a stream adapts the body model to the person that it sees. Chosen on simulated people and on `movement`, by virtual people.

    min_margin   nats; labels with at least this margin are learned from. With half of it a tenth more labels are wrong; with twice as much
                 a person whom virtual people stand for is hardly learned
    min_share    share of the markers that a frame must label with this margin; a third of them does as well
    adapt_after  numbers of frames after which the model is adapted; after the last one it stays as it is. Without the first, twice as many
                 labels are wrong where nothing is hidden
    noise_std    m, standard deviation of a marker beyond what the adapted model explains: more than for a whole recording, which shows all
                 poses
    """

    min_margin: float = 10.0
    min_share: float = 0.5
    adapt_after: tuple[int, ...] = (1, 3, 6, 12, 24)
    noise_std: float = 0.008


class LiveBody:
    """A body model that adapts to the person in front of the cameras.

    The work is done in small steps, one a frame, so that no frame waits long. Memory: the last of `LiveRules.adapt_after` frames at most.
    """

    def __init__(self, body: BodyModel, body_rules: BodyRules, rate: float, rules: LiveRules) -> None:
        self.rules = rules
        self._body, self._body_rules, self._subject_rules = body, body_rules, SubjectRules(noise_std=rules.noise_std)
        self._interval = self._subject_rules.independent_after * rate
        self.restart()

    def restart(self) -> None:
        """Forget the person."""
        self._rests_until = 0
        self._frames: list[Floats] = []
        self._poses: list[int] = []
        self._last = -np.inf
        self._steps: Generator[None, None, BodyModel] | None = None

    def rest(self, until: int) -> None:
        """Learn nothing before a frame, since a study knows the person better."""
        self._rests_until, self._steps = until, None

    def needs(self, frame: int) -> bool:
        """Whether a frame would add to what is known."""
        return (
            frame >= self._rests_until
            and self._steps is None
            and len(self._frames) < self.rules.adapt_after[-1]
            and frame - self._last >= self._interval
        )

    def add(self, frame: int, points: Floats, pose: int) -> None:
        """Learn from a frame: points (M, 3) m, NaN where a label has too small a margin, and its key pose."""
        self._last = frame
        self._frames.append(points)
        self._poses.append(pose)
        if len(self._frames) in self.rules.adapt_after:
            weight = np.ones(len(self._frames))
            self._steps = adapt_in_steps(
                self._body, np.array(self._frames), np.array(self._poses), weight, self._subject_rules, self._body_rules
            )

    def step(self) -> BodyArrays | None:
        """Do one step of the adaptation, if one is under way. Gives the adapted body after its last step, None otherwise."""
        if self._steps is None:
            return None
        try:
            next(self._steps)
        except StopIteration as done:
            self._steps = None
            found: BodyModel = done.value
            return found.arrays()
        return None
