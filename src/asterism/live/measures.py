"""A value of the body, frame by frame, in; its repetitions, its change and its two sides, out. Bounded memory."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from asterism.gait.parameters import symmetry_index

_NEAR_TURN = 0.1
"""Share of a way at either end that its time leaves out, as is usual for rise times: a body that rests there trembles. Half of it is the
tremble of a small movement; with twice as much two thirds of a smooth way's time are left out."""
_MOST_SAMPLES = 12_000
"""Samples of a value that are kept: a minute at 200 Hz. What is forgotten first is the rest before a movement, which counts to no way. Half
of them forget a slow repetition at 200 Hz; twice as many only take memory."""


@dataclass(frozen=True)
class TurningPoint:
    """Where a value turns: a highest one, or a lowest one. time in s; value in its unit."""

    is_high: bool
    time: float
    value: float


class TurningPoints:
    """Where a value turns, told when it has gone back by `swing`, in its unit; smaller turns are trembles.

    The beginning is no turning point: one counts when the value came to it by `swing`, too.
    """

    def __init__(self, swing: float) -> None:
        self.swing = swing
        self._rising: bool | None = None
        self._high = self._low = (math.nan, math.nan)

    @property
    def low(self) -> float:
        """The lowest value since the last highest one."""
        return self._low[1]

    def push(self, time: float, value: float) -> TurningPoint | None:
        """The turning point that is sure with this value; None where none is."""
        if not value <= self._high[1]:
            self._high = (time, value)
        if not value >= self._low[1]:
            self._low = (time, value)
        # Until the direction is known, both ends are looked for.
        if self._rising is not True and value - self._low[1] >= self.swing:
            found = None if self._rising is None else TurningPoint(False, *self._low)
            self._rising, self._high = True, (time, value)
            return found
        if self._rising is not False and self._high[1] - value >= self.swing:
            found = None if self._rising is None else TurningPoint(True, *self._high)
            self._rising, self._low = False, (time, value)
            return found
        return None


class Repetitions:
    """What each repetition comes to.

    which  "highest" or "lowest" value of each, in its unit; "range" from the lowest to the highest; "tempo", the time that the value rises
           over the time that it falls (backswing over downswing)
    swing  how far the value goes at least from turn to turn, in its unit

    Times are those from a tenth to nine tenths of a way, as rise times are measured: rests at either end count to neither way.
    """

    def __init__(self, which: str, swing: float) -> None:
        self.which, self._turns = which, TurningPoints(swing)
        self._low = self._top = self._rise = math.nan
        # since the last turning point
        self._seen: deque[tuple[float, float]] = deque(maxlen=_MOST_SAMPLES)

    def push(self, time: float, value: float) -> float:
        """What the repetition that ends with this value comes to; NaN where none ends."""
        low, turn = self._turns.low, self._turns.push(time, value)
        if self.which in ("highest", "lowest"):
            return turn.value if turn is not None and turn.is_high == (self.which == "highest") else math.nan
        self._seen.append((time, value))
        found = math.nan
        if turn is not None and turn.is_high:
            self._low, self._top = low, turn.value
            self._rise = _way_time([each for each in self._seen if each[0] <= turn.time], self._low, self._top)
            found = self._top - self._low if self.which == "range" else math.nan
        elif self.which == "tempo" and not math.isnan(self._rise):
            # Told as soon as the value is back near where it came from, or turns before.
            low = self._low if turn is None else turn.value
            if turn is not None or value <= low + _NEAR_TURN * (self._top - low):
                fall = _way_time([(-t, v) for t, v in reversed(self._seen)], low, self._top)
                found, self._rise = self._rise / fall, math.nan
        if turn is not None:
            self._seen = deque((each for each in self._seen if each[0] >= turn.time), maxlen=_MOST_SAMPLES)
        return found


def _way_time(way: Sequence[tuple[float, float]], low: float, top: float) -> float:
    """s that a way up spends between a tenth and nine tenths of it. way: (time, value) from its low turning point on."""
    near, far = low + _NEAR_TURN * (top - low), top - _NEAR_TURN * (top - low)
    left = max((t for t, v in way if v <= near), default=math.nan)
    return min((t for t, v in way if v >= far and t > left), default=math.nan) - left


class Change:
    """A value less its mean before.

    against  "start": the mean of the first `over` seconds in which it was known; "before": the mean of the last `over` seconds
    over     s
    """

    def __init__(self, against: str, over: float) -> None:
        self.against, self.over = against, over
        self._begin = self._mean = math.nan
        # The sum goes along, so that a push takes O(1) however long the time before is. In an hour it rounds by 1e-10 of a value.
        self._seen, self._sum = deque[tuple[float, float]](), 0.0

    @property
    def has_start(self) -> bool:
        """Whether it knows the first seconds."""
        return self.against == "start" and not math.isnan(self._mean)

    def push(self, time: float, value: float) -> float:
        """The change; NaN until so many seconds were seen."""
        if math.isnan(value):
            return math.nan
        if math.isnan(self._begin):
            self._begin = time
        if time - self._begin >= self.over:
            while self.against == "before" and self._seen and time - self._seen[0][0] > self.over:
                self._forget_oldest()
            if self.against == "before" or math.isnan(self._mean):
                self._mean = self._sum / len(self._seen) if self._seen else math.nan
        if self.against == "before" or math.isnan(self._mean):
            self._seen.append((time, value))
            self._sum += value
            if len(self._seen) > _MOST_SAMPLES:
                self._forget_oldest()
        else:
            self._seen.clear()
        return value - self._mean

    def _forget_oldest(self) -> None:
        self._sum -= self._seen.popleft()[1]


class LiveSymmetry:
    """The `symmetry_index` of the means of the last values of both sides.

    last  values of each side that are asked for
    """

    def __init__(self, last: int) -> None:
        self._values: dict[str, deque[float]] = {side: deque(maxlen=last) for side in ("left", "right")}

    def take(self, side: str, value: float, *, is_held: bool) -> None:
        """Take a value of a side; NaN is passed over. is_held: it is given again in each frame until there is another one."""
        values = self._values[side]
        if not math.isnan(value) and not (is_held and values and value == values[-1]):
            values.append(value)

    @property
    def value(self) -> float:
        """%; NaN until both sides have their values."""
        if any(len(values) < (values.maxlen or 1) for values in self._values.values()):
            return math.nan
        left, right = (sum(values) / len(values) for values in self._values.values())
        return symmetry_index(left, right)
