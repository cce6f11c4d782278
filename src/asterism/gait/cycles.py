"""Events in; gait cycles, and curves over them from 0 to 100 %, out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from asterism.gait.events import OFF, STRIKE, GaitEvent, Walking
from asterism.gait.feet import RATE
from asterism.recording import Floats, Ints

MIDSTANCE = "Midstance"
"""The event of a foot that stands: the other one, which swings, passes it."""
FOOT_SIGMA = 0.01
"""m, standard deviation of how far a foot is ahead of the other, by markers that sit on two shoes by hand."""

POINTS = 101
"""Points of a curve over a cycle: 0, 1, ... 100 %."""
LONGEST = 4.0
"""s: between two strikes that are farther apart one was missed, or the person stood."""


@dataclass(frozen=True)
class Cycle:
    """From one strike of a foot to its next.

    side                     of the foot
    strike, off, next_strike  events of this foot
    other_off, other_strike   of the other foot within the cycle; None where it has none
    turns                    whether the person turns in it: see `without_turns`
    """

    side: str
    strike: GaitEvent
    off: GaitEvent
    next_strike: GaitEvent
    other_off: GaitEvent | None = None
    other_strike: GaitEvent | None = None
    turns: bool = False

    @property
    def duration(self) -> float:
        """s."""
        return self.next_strike.time - self.strike.time

    @property
    def off_share(self) -> float:
        """Of the cycle, when the foot leaves the floor."""
        return (self.off.time - self.strike.time) / self.duration


def cycles_of(walking: Walking) -> list[Cycle]:
    """All whole cycles, in the order of time."""
    cycles = []
    for side in walking.feet.sides:
        own = [event for event in walking.events if event.side == side]
        other = [event for event in walking.events if event.side != side]
        for strike, off, following in zip(own, own[1:], own[2:], strict=False):
            if (strike.label, off.label, following.label) != (STRIKE, OFF, STRIKE) or following.time - strike.time > LONGEST:
                continue
            inside = [event for event in other if strike.time <= event.time <= following.time]
            offs, strikes = ([event for event in inside if event.label == label] for label in (OFF, STRIKE))
            turns = bool(abs(_turned(walking, strike.time, following.time)) > TURNING)
            cycles.append(Cycle(side, strike, off, following, offs[0] if offs else None, strikes[0] if strikes else None, turns))
    return sorted(cycles, key=lambda cycle: cycle.strike.time)


TURNING = np.deg2rad(15.0)
"""By which the direction of both feet may change from a strike to the next of the same foot: sway has the period of a cycle and takes no
part. 40 cycles straight ahead of nine people in `movement` (walks, a treadmill, a sprint of 7 m/s) change by 7 degrees at most, near the
ends of recordings. At half, these turn; at double, a right angle in three strides is straight."""


def _turned(walking: Walking, begins: float, ends: float) -> float:
    """rad by which the feet point elsewhere at the end, the shorter way round: nobody turns by more than half within a cycle."""
    ahead = walking.feet.ahead
    first, last = (ahead[min(round(time * RATE), len(ahead) - 1)] for time in (begins, ends))
    return float(np.arctan2(first[0] * last[1] - first[1] * last[0], first @ last))


class _OfCycle(Protocol):
    @property
    def turns(self) -> bool: ...


_Of = TypeVar("_Of", bound=_OfCycle)


def without_turns(cycles: Iterable[_Of]) -> list[_Of]:
    """The cycles, or parameters of cycles, that count in means and scores: those in which nobody turns, and all where each is of a turn.

    Pelvic rotation, foot progression, and the lengths and widths of steps are others in a turn.
    """
    every = list(cycles)
    return [one for one in every if not one.turns] or every


def midstances(walking: Walking) -> list[GaitEvent]:
    """When the swinging foot passes the one that stands ("feet adjacent" of Whittle 2014), of each foot, in the order of time. O(T).

    The middle of heel and toe counts, in the direction in which the feet point. A stance in which the other foot is not seen to pass has
    none. Its uncertainty is that of the feet's places, at the speed with which they pass.
    """
    feet, found = walking.feet, []
    if len(feet.sides) < 2:
        return []
    middles = {side: (feet.heels[side] + feet.toes[side]) / 2 for side in feet.sides}
    for side, other in (("L", "R"), ("R", "L")):
        apart = ((middles[other] - middles[side])[:, :2] * feet.ahead).sum(axis=1)
        own = [event for event in walking.events if event.side == side]
        for begin, end in walking.swings(other):
            # While one foot swings, the other has to stand all the time.
            stands = any(one.time <= begin and end <= two.time for one, two in pairwise(own) if (one.label, two.label) == (STRIKE, OFF))
            first, last = (min(max(round(RATE * time), 0), len(apart) - 1) for time in (begin, end))
            passed = np.nonzero((apart[first:last] < 0) & (apart[first + 1 : last + 1] >= 0))[0] + first
            if stands and len(passed) == 1:
                at = int(passed[0])
                speed = float(apart[at + 1] - apart[at]) * RATE
                found.append(GaitEvent(side, MIDSTANCE, (at - apart[at] * RATE / speed) / RATE, FOOT_SIGMA / speed, "markers"))
    return sorted(found, key=lambda event: event.time)


def over_cycle(values: Floats, rate: float, cycle: Cycle) -> Floats:
    """(POINTS, ...) of a curve (T, ...) at `rate` from the first frame; NaN where the curve is missing, or ends before the cycle does.

    >>> from asterism.gait.events import GaitEvent
    >>> events = [GaitEvent("L", label, time, 0.0, "") for label, time in ((STRIKE, 0.1), (OFF, 0.7), (STRIKE, 1.1))]
    >>> over_cycle(np.linspace(0.0, 2.0, 201), 100.0, Cycle("L", *events))[[0, 50, 100]].round(6)
    array([0.1, 0.6, 1.1])
    """
    lower, upper, share, outside = _places(cycle.strike.time, cycle.next_strike.time, rate, len(values))
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    first = values[lower]
    out = np.where(share > 0, first * (1 - share) + values[upper] * share, first)
    out[outside] = np.nan
    return np.asarray(out)


@lru_cache(maxsize=64)
def _places(begins: float, ends: float, rate: float, count: int) -> tuple[Ints, Ints, Floats, NDArray[np.bool_]]:
    """(POINTS,) the samples below and above each point of a cycle, the share of the latter, and what lies outside: alike for all curves."""
    places = rate * np.linspace(begins, ends, POINTS)
    below = np.floor(places).astype(np.int64)
    lower, upper = (np.clip(below + step, 0, count - 1) for step in (0, 1))
    outside = (below < 0) | (below >= count) | ((below + 1 >= count) & (places > below))
    return lower, upper, places - below, outside
