"""Strikes and offs while they come in; cadence, lengths and times of steps, and how alike both sides are, out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from asterism.gait.parameters import symmetry_index
from asterism.live.analysis import LiveEvent
from asterism.live.walking.events import LiveEvents
from asterism.recording import Floats

_LAST = 4
"""Steps of each side that symmetry compares. Of two alone the noise of a step shows, 8 hide for ten seconds that something changed."""
_STANDS = 2.5
"""s without a strike after which a person stands: steps take a second at the slowest. At half, a slow walk is lost between two strikes; at
double, what is shown of somebody who stands is of five seconds ago."""
_SIDED = {"step length": "m", "step time": "s", "stance time": "s"}
_OTHER = {"left": "right", "right": "left"}


class LiveSteps:
    """What the last steps were like, each value from the strike or off that tells it.

    cadence, walking speed                      of the last stride, steps/min and m/s
    left (right) step length, time, stance time  of the last one of that side, m and s, as `gait.parameters` defines them
    ... symmetry                                % by which the left side's mean of its last four is more than the right's, of their mean
    """

    units: Mapping[str, str] = {
        "cadence": "steps/min",
        "walking speed": "m/s",
        **{f"{side} {name}": unit for side in _OTHER for name, unit in _SIDED.items()},
        **{f"{name} symmetry": "%" for name in _SIDED},
    }

    def __init__(self) -> None:
        self._clear()

    def _clear(self) -> None:
        self._values = dict.fromkeys(self.units, math.nan)
        self._last = {f"{side} {name}": deque[float](maxlen=_LAST) for side in _OTHER for name in _SIDED}
        self._strikes: dict[str, tuple[float, Floats]] = {}
        self._time = math.nan

    def push(self, time: float, events: Sequence[LiveEvent], found: LiveEvents) -> dict[str, float]:
        """All values at `time` s, NaN while they are not known; found: who told the events."""
        # A clock that was set back, or a person who stands.
        if not -1.0 < time - self._time < _STANDS and not math.isnan(self._time):
            self._clear()
        for event in sorted(events, key=lambda one: one.time):
            (self._struck if event.kind == "heel strike" else self._left)(event, found)
            self._time = event.time
        return dict(self._values)

    def _struck(self, event: LiveEvent, found: LiveEvents) -> None:
        place, belt = found.toe_at(event.side, event.time), found.belt
        before, other = self._strikes.get(event.side), self._strikes.get(_OTHER[event.side])
        self._strikes[event.side] = (event.time, place)
        if before is None or other is None or not before[0] < other[0] < event.time:
            return
        if not found.is_followed(other[0], event.time) or not found.is_followed(before[0], other[0]):
            return
        stride = event.time - before[0]
        way = place - before[1] - belt * stride
        length = float(np.linalg.norm(way))
        self._values["cadence"] = 120.0 / stride
        self._values["walking speed"] = length / stride
        self._tell(event.side, "step time", event.time - other[0])
        along = (place - other[1] - belt * (event.time - other[0])) @ way / max(length, 1e-9)
        self._tell(event.side, "step length", float(along))

    def _left(self, event: LiveEvent, found: LiveEvents) -> None:
        strike = self._strikes.get(event.side)
        if strike is not None and event.time - strike[0] < _STANDS and found.is_followed(strike[0], event.time):
            self._tell(event.side, "stance time", event.time - strike[0])

    def _tell(self, side: str, name: str, value: float) -> None:
        if not math.isfinite(value):
            return
        self._values[f"{side} {name}"] = value
        self._last[f"{side} {name}"].append(value)
        left, right = (self._last[f"{one} {name}"] for one in ("left", "right"))
        if left and right:
            self._values[f"{name} symmetry"] = symmetry_index(float(np.mean(left)), float(np.mean(right)))
