"""Labelled frames in; angles and events of the person at once, out. What outputs and feedback are given of a frame is here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from asterism.live.chain import LabelledFrame
from asterism.live.cues import Cue

EVENTS = ("heel strike", "toe off")
"""Kinds of events."""


@dataclass(frozen=True)
class LiveEvent:
    """Something that happened at one instant, told while the session goes on.

    kind   one of EVENTS
    side   "left" or "right"
    time   s on the source's clock, when it happened
    told_after  s on the source's clock from then to the frame at which it is told
    sd     s, standard deviation of `time`; NaN where it is not known
    """

    kind: str
    side: str
    time: float
    told_after: float
    sd: float = float("nan")


@dataclass(frozen=True, eq=False)
class FrameAnalysis:
    """What is known of the person in one frame.

    values  by name, in `units`: "left knee flexion" in degrees, "step length symmetry" in %; NaN where labels are missing
    units   of each value
    events  told with this frame
    """

    values: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    events: tuple[LiveEvent, ...] = ()


NOTHING = FrameAnalysis()
"""Of a frame that nobody analyses."""


class LiveAnalysis(Protocol):
    """What follows from labelled frames, one after the other, in bounded memory."""

    def push(self, frame: LabelledFrame) -> FrameAnalysis:
        """What is known with this frame."""


@dataclass(frozen=True, eq=False)
class AnalysedFrame:
    """All that outputs get of one frame.

    labelled  the frame with its labels
    analysis  angles and events
    cues      what each rule of feedback says
    """

    labelled: LabelledFrame
    analysis: FrameAnalysis = NOTHING
    cues: tuple[Cue, ...] = ()
