"""Frames of a source in; the same frames with a label for each point, out."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from asterism.findings import Finding
from asterism.labelling.live.stream import FrameLabels
from asterism.labelling.live.study import StudyPlace
from asterism.labelling.marker_model import MarkerModel
from asterism.live.frames import LiveFrame
from asterism.recording import Floats, Ints, MarkerSet
from asterism.session.live import LiveLabeller

_MOST_FILLED = 0.1
"""s of lost frames that are passed on as empty ones, so that velocities keep their meaning. After twice as long the points of a body are
elsewhere and are sought anyway; half of it would call a pause of five frames at 100 Hz a new beginning."""

_BEGINNING = 30.0
"""s that the process of the studies may take to begin before frames are labelled without it; it may still come. Two are usual. Half of it
does on a machine that is four times as slow; double is waited only where kernels are compiled for the first time."""


class Labeller(Protocol):
    """What labels frames: `asterism.session.live.LiveLabeller`, or a model's stream.

    refusal  why no marker set could be found yet; "" where that was not tried
    """

    refusal: str = ""

    @property
    def marker_set(self) -> MarkerSet | None:
        """Whose names the columns of the labels have; None while that is not known."""

    def push(self, points: ArrayLike) -> FrameLabels | None:
        """The labels of the frame some pushes ago."""

    def flush(self) -> list[FrameLabels]:
        """The labels of the last frames, for which `push` has given none yet, oldest first."""

    def findings(self) -> Sequence[Finding]:
        """What a person should know of the marker set that was found, and of the studies."""
        return ()

    def wait_for_studies(self, seconds: float) -> None:
        """Wait until the process of the studies has begun, so that the first frames have what it says; at most so long."""

    def close(self) -> None:
        """End what was begun, such as a process."""


MakeLabeller = Callable[[float, Floats | None], Labeller]
"""A labeller for a rate (frames per second) and a vertical (3,), None where the source does not say what is up."""


class OfModel(Labeller):
    """A model's stream with its marker set."""

    def __init__(self, model: MarkerModel, rate: float, delay: int, vertical: Floats | None, studies: StudyPlace = "process") -> None:
        self._marker_set = model.marker_set
        self._stream = model.stream(rate, delay, "z" if vertical is None else vertical, studies)

    @property
    def marker_set(self) -> MarkerSet:
        """The model's."""
        return self._marker_set

    def push(self, points: ArrayLike) -> FrameLabels | None:
        """See `Stream.push`."""
        return self._stream.push(points)

    def flush(self) -> list[FrameLabels]:
        """See `Stream.flush`."""
        return self._stream.flush()

    def findings(self) -> list[Finding]:
        """See `Stream.findings`."""
        return self._stream.findings()

    def studies_made(self) -> tuple[int, float]:
        """See `Stream.studies_made`."""
        return self._stream.studies_made()

    def wait_for_studies(self, seconds: float) -> None:
        """See `Stream.wait_for_studies`."""
        self._stream.wait_for_studies(seconds)

    def close(self) -> None:
        """See `Stream.close`."""
        self._stream.close()


@dataclass(frozen=True, eq=False)
class LabelledFrame:
    """A frame with its labels.

    frame       as it came
    markers     (M,) the names of the marker set; () while it is not known
    indices     (M,) each marker's place among the points, -1 for none
    confidence  (M,) in [0, 1] that this is right
    done        s on this machine's `time.monotonic`, when the labels were there
    fits        whether the last seconds show what the model was trained on
    """

    frame: LiveFrame
    markers: tuple[str, ...]
    indices: Ints
    confidence: Floats
    done: float
    fits: bool = True

    @property
    def names(self) -> tuple[str, ...]:
        """(n,) the label of each point, "" for none."""
        names = [""] * len(self.frame.points)
        for marker, index in zip(self.markers, self.indices.tolist(), strict=True):
            if index >= 0:
                names[index] = marker
        return tuple(names)

    @property
    def places(self) -> Floats:
        """(M, 3) m, where each marker is; NaN where it has no point."""
        given, places = self.indices >= 0, np.full((len(self.indices), 3), np.nan)
        places[given] = self.frame.points[self.indices[given]]
        return places


class LabelChain:
    """Labels the frames of one source, in their order, with a delay of `delay` frames.

    Lost frames are counted by number and passed on as empty ones where they are few. O(1) memory.
    """

    def __init__(self, labeller: Labeller, rate: float, delay: int = 0) -> None:
        self._labeller, self._delay = labeller, delay
        self._most = round(_MOST_FILLED * rate)
        self._last: int | None = None
        # None stands for a lost frame, whose labels nobody waits for.
        self._waiting: deque[LiveFrame | None] = deque()

    def push(self, frame: LiveFrame) -> LabelledFrame | None:
        """The labels of the frame `delay` frames before this one; None where there are none yet, or where that one was lost."""
        lost = 0 if self._last is None else frame.number - self._last - 1
        self._last = frame.number
        if 0 < lost <= self._most:
            for _ in range(lost):
                self._pushed(None)
        return self._pushed(frame)

    def flush(self) -> list[LabelledFrame]:
        """The labels of the frames that wait, when no frame comes any more."""
        last = [] if self._labeller.marker_set is None else self._labeller.flush()
        # Frames from before the marker set was found have none.
        labels: list[FrameLabels | None] = [*[None] * (len(self._waiting) - len(last)), *last]
        found = [self._with(of, each) for of, each in zip(self._waiting, labels, strict=True) if of is not None]
        self._waiting.clear()
        return found

    @property
    def refusal(self) -> str:
        """Why no marker set could be found yet; "" where that was not tried."""
        return self._labeller.refusal

    def findings(self) -> list[Finding]:
        """What a person should know of the marker set that was found, and of the studies."""
        return list(self._labeller.findings())

    def studies_made(self) -> tuple[int, float]:
        """How many times the last seconds were labelled as a whole, and s of frames since the last time, NaN before it."""
        made = getattr(self._labeller, "studies_made", None)
        return (0, math.nan) if made is None else made()

    def wait_for_studies(self) -> None:
        """Wait until the labeller's process has begun, so that the first frames have what it says; not for long."""
        self._labeller.wait_for_studies(_BEGINNING)

    def close(self) -> None:
        """End what the labeller began, such as a process."""
        self._labeller.close()

    def _pushed(self, frame: LiveFrame | None) -> LabelledFrame | None:
        self._waiting.append(frame)
        labels = self._labeller.push(np.empty((0, 3)) if frame is None else frame.points)
        if len(self._waiting) <= self._delay:
            return None
        of = self._waiting.popleft()
        return None if of is None else self._with(of, labels)

    def _with(self, frame: LiveFrame, labels: FrameLabels | None) -> LabelledFrame:
        markers = self._labeller.marker_set
        if labels is None or markers is None:
            return LabelledFrame(frame, (), np.empty(0, dtype=np.int64), np.empty(0), time.monotonic())
        return LabelledFrame(frame, markers.names, labels.indices, labels.confidence, time.monotonic(), labels.fits)


def make_labeller(model: MarkerModel | None, markers: str | None, delay: int, studies: StudyPlace = "process") -> MakeLabeller:
    """How frames are labelled: by a model, or by virtual people who wear the set given, or one that is found.

    studies  where the last seconds are labelled as a whole: see `MarkerModel.stream`
    """

    def made(rate: float, vertical: Floats | None) -> Labeller:
        if model is not None:
            return OfModel(model, rate, delay, vertical, studies)
        return LiveLabeller(rate, delay, markers=markers, vertical=vertical, studies=studies)

    return made
