"""Surely labelled frames of a stream in, one by one; the model of the body that is there, narrowed to it bit by bit, out."""

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
    """When a stream learns the body that it sees. Chosen on gait subjects left out.

    sure       nats from which a label teaches
    share      of the markers that a frame must show surely
    counts     of frames after which the model is narrowed; after the last it stays
    noise_std  where a marker sits beyond what the narrowed model explains (m): more than in a whole recording, of which all poses are seen
    """

    sure: float = 20.0
    share: float = 0.6
    counts: tuple[int, ...] = (3, 6, 12, 24)
    noise_std: float = 0.008


class LiveBody:
    """A body model that becomes that of the person in front of the cameras.

    The work is done in small steps, one a frame, so that no frame waits long. Memory: `LiveRules.counts` frames at most.
    """

    def __init__(self, body: BodyModel, body_rules: BodyRules, rate: float, rules: LiveRules) -> None:
        self.rules = rules
        self._body, self._body_rules, self._subject_rules = body, body_rules, SubjectRules(noise_std=rules.noise_std)
        self._apart = self._subject_rules.independent * rate
        self.restart()

    def restart(self) -> None:
        """Forget the person."""
        self._frames: list[Floats] = []
        self._poses: list[int] = []
        self._last = -np.inf
        self._steps: Generator[None, None, BodyModel] | None = None

    def wants(self, frame: int) -> bool:
        """Whether a frame would tell something new."""
        return self._steps is None and len(self._frames) < self.rules.counts[-1] and frame - self._last >= self._apart

    def see(self, frame: int, points: Floats, pose: int) -> None:
        """Learn from a frame: points (M, 3) m, NaN where no label is sure, and its key pose."""
        self._last = frame
        self._frames.append(points)
        self._poses.append(pose)
        if len(self._frames) in self.rules.counts:
            weight = np.ones(len(self._frames))
            self._steps = adapt_in_steps(
                self._body, np.array(self._frames), np.array(self._poses), weight, self._subject_rules, self._body_rules
            )

    def step(self) -> BodyArrays | None:
        """Go on with the work, if there is any; the new body once it is done."""
        if self._steps is None:
            return None
        try:
            next(self._steps)
        except StopIteration as done:
            self._steps = None
            found: BodyModel = done.value
            return found.arrays()
        return None
