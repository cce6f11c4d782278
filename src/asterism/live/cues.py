"""What a rule of feedback is, and what it says of one frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

_UNITS = {"angle": "degrees", "distance": "m", "height": "m", "event": "s", "symmetry": "%"}


@dataclass(frozen=True)
class FeedbackRule:
    """One value of the body, and when the person is told of it.

    kind        what the value is: the "angle" at the second of three markers (degrees), the "distance" of two or the "height" of one over
                the floor (m), a "value" of the analysis, the "symmetry" of one of both sides (%), an "event" (s since the one before)
    markers     of an angle, a distance or a height
    of          the name of a value without or with its side, or of an event
    side        of an event, "left" or "right"; "" for both
    every       events from one that is told to the next
    last        values of each side that a symmetry is of
    each        "highest", "lowest", "range" or "tempo" of each repetition instead of the value in each frame; "" for that
    swing       how far the value goes at least from turn to turn, in its unit
    change      the value less its mean of the first `over` seconds, "start", or of the last ones, "before"; "" for the value itself
    over        s
    above       told while the value is above; NaN for no bound
    below       told while the value is below. A `below` over `above` is a range: told within it
    hysteresis  by how much the value must go back before it is not told any more, in its unit
    after       s that this must last until it is told
    hold        s that it is told at least
    text        shown while it is told; {value} stands for the value
    colour      of the text
    sound       "beep" when it begins, "tone" all the time, higher with the value from `low` to `high`; "" for none
    """

    name: str
    kind: str
    markers: tuple[str, ...] = ()
    above: float = math.nan
    below: float = math.nan
    hysteresis: float = 0.0
    text: str = ""
    colour: str = ""
    sound: str = ""
    low: float = math.nan
    high: float = math.nan
    of: str = ""
    side: str = ""
    every: int = 1
    last: int = 5
    each: str = ""
    swing: float = math.nan
    change: str = ""
    over: float = math.nan
    after: float = 0.0
    hold: float = 0.0

    @property
    def unit(self) -> str:
        """Of its value; "" where only the analysis knows it, and for a ratio."""
        return "" if self.each == "tempo" else _UNITS.get(self.kind, "")

    @property
    def is_moment(self) -> bool:
        """Whether it speaks of single instants, each anew: events and repetitions. The others speak of each frame."""
        return self.kind == "event" or (self.each != "" and self.kind != "symmetry")


@dataclass(frozen=True)
class Cue:
    """What a rule says of one frame.

    value  NaN where a marker has no label
    on     whether the person is told
    began  whether that begins with this frame
    tone   in [0, 1], how high the tone is; NaN for none
    unit   of the value
    """

    rule: FeedbackRule
    value: float
    on: bool
    began: bool
    tone: float
    unit: str = ""

    @property
    def text(self) -> str:
        """The rule's text with the value."""
        return self.rule.text.replace("{value}", self.shown)

    @property
    def shown(self) -> str:
        """The value with its unit, as people read it while they move."""
        if math.isnan(self.value):
            return "–"
        digits, unit = {"degrees": (0, "°"), "m": (2, " m"), "s": (2, " s"), "%": (0, " %")}.get(
            self.unit, (1, f" {self.unit}" if self.unit else "")
        )
        return f"{self.value:.{digits}f}{unit}"
