"""What a rule of feedback is, and what it says of one frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

_UNITS = {"angle": "degrees", "distance": "m", "height": "m"}


@dataclass(frozen=True)
class FeedbackRule:
    """One value of the body, and when the person is told of it.

    kind, markers  the angle at the second of three markers (degrees), the distance of two, or the height of one over the floor (m)
    above, below   told while the value is above, or below; NaN for no bound
    hysteresis     by how much the value must go back before it is not told any more, in its unit
    text, colour   shown while it is told
    sound          "beep" when it begins, "tone" all the time, higher with the value from `low` to `high`; "" for none
    """

    name: str
    kind: str
    markers: tuple[str, ...]
    above: float = math.nan
    below: float = math.nan
    hysteresis: float = 0.0
    text: str = ""
    colour: str = ""
    sound: str = ""
    low: float = math.nan
    high: float = math.nan

    @property
    def unit(self) -> str:
        """Of its value."""
        return _UNITS[self.kind]


@dataclass(frozen=True)
class Cue:
    """What a rule says of one frame.

    value  NaN where a marker has no label
    on     whether the person is told
    began  whether that begins with this frame
    tone   in [0, 1], how high the tone is; NaN for none
    """

    rule: FeedbackRule
    value: float
    on: bool
    began: bool
    tone: float
