"""Cycles in; cadence, speed, lengths and times of steps out, each with how certain it is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.gait.cycles import Cycle, without_turns
from asterism.gait.events import GaitEvent, Walking
from asterism.gait.feet import RATE, Feet
from asterism.recording import Floats

PARAMETERS = {
    "cadence": "steps/min",
    "walking speed": "m/s",
    "stride time": "s",
    "step time": "s",
    "stride length": "m",
    "step length": "m",
    "step width": "m",
    "stance": "%",
    "swing": "%",
    "double support": "%",
    "single support": "%",
    "opposite foot off": "%",
    "opposite foot contact": "%",
    "limp index": "",
}
"""Names, with their units. Shares are of the cycle; the limp index is how long this foot stands for each second that the other does."""
SIDED = ("step time", "step length", "stance", "swing", "single support")
"""Parameters that can differ between the sides of one stride."""
TOE_SIGMA = 0.003
"""m, standard deviation of a toe marker's place on the foot that stands, beside what an event that is off adds: shoe and skin."""


@dataclass(frozen=True)
class Parameter:
    """One value of one cycle of the side "L" or "R", with its standard uncertainty in the same unit.

    begins, ends  s from the first frame, the cycle's strikes: the frames that the value comes from
    turns         whether the person turns in the cycle
    """

    name: str
    side: str
    value: float
    sigma: float
    begins: float
    ends: float
    turns: bool = False


@dataclass(frozen=True)
class ParameterSummary:
    """Mean and standard deviation over `count` cycles of one side; `sigma`, standard uncertainty of the mean by the events alone."""

    name: str
    side: str
    mean: float
    deviation: float
    sigma: float
    count: int

    @property
    def unit(self) -> str:
        """See `PARAMETERS`."""
        return PARAMETERS[self.name]


def parameters_of(walking: Walking, cycles: Sequence[Cycle]) -> list[Parameter]:
    """All parameters of all cycles. What the other foot decides is left out where it was not seen. O(cycles).

    Lengths and widths are those between toe markers at the strikes, along and across the way of the stride, as the programs of
    laboratories have them: files that hold both are met by these, and not by heels. On a treadmill the belt's way is added.
    """
    return [parameter for cycle in cycles for parameter in _of_cycle(walking, cycle)]


def _of_cycle(walking: Walking, cycle: Cycle) -> list[Parameter]:
    found: list[Parameter] = []

    def add(name: str, value: float, sigma: float) -> None:
        if np.isfinite(value):
            found.append(Parameter(name, cycle.side, float(value), float(sigma), cycle.strike.time, cycle.next_strike.time, cycle.turns))

    duration, spread = cycle.duration, _hypot(cycle.strike, cycle.next_strike)
    belt, belt_sigma = _belt(walking, cycle)
    begin, end = (_stood(walking.feet, cycle.side, event, belt) for event in (cycle.strike, cycle.next_strike))
    length = float(np.linalg.norm(end.place - begin.place))
    way = (end.place - begin.place) / max(length, 1e-9)
    length_sigma = float(np.hypot(_spread(way, begin, end), belt_sigma * duration))
    add("stride time", duration, spread)
    add("cadence", 120.0 / duration, 120.0 / duration**2 * spread)
    add("stride length", length, length_sigma)
    add("walking speed", length / duration, float(np.hypot(length_sigma, length / duration * spread)) / duration)
    add("stance", 100 * cycle.off_share, 100 / duration * _hypot(cycle.strike, cycle.off))
    add("swing", 100 * (1 - cycle.off_share), 100 / duration * _hypot(cycle.strike, cycle.off))
    if cycle.other_strike is not None:
        # The step of this foot begins with the other's strike.
        time = cycle.next_strike.time - cycle.other_strike.time
        add("step time", time, _hypot(cycle.next_strike, cycle.other_strike))
        theirs = _stood(walking.feet, "R" if cycle.side == "L" else "L", cycle.other_strike, belt)
        apart, across = end.place - theirs.place, np.array([-way[1], way[0]])
        add("step length", float(apart @ way), np.hypot(_spread(way, theirs, end), belt_sigma * time))
        add("step width", abs(float(apart @ across)), _spread(across, theirs, end))
        if cycle.other_off is not None and cycle.other_off.time < cycle.other_strike.time:
            off, contact = ((event.time - cycle.strike.time) / duration for event in (cycle.other_off, cycle.other_strike))
            add("opposite foot off", 100 * off, 100 / duration * _hypot(cycle.strike, cycle.other_off))
            add("opposite foot contact", 100 * contact, 100 / duration * _hypot(cycle.strike, cycle.other_strike))
            # The other foot stands for all of the cycle but this foot's single support.
            alone, its = contact - off, 1 - contact + off
            add("single support", 100 * alone, 100 / duration * _hypot(cycle.other_off, cycle.other_strike))
            limp = cycle.off_share / its
            spreads = (_hypot(cycle.strike, cycle.off), limp * _hypot(cycle.other_off, cycle.other_strike))
            add("limp index", limp, float(np.hypot(*spreads)) / (its * duration))
        if cycle.other_off is not None and cycle.other_off.time < cycle.other_strike.time < cycle.off.time:
            both = cycle.other_off.time - cycle.strike.time + cycle.off.time - cycle.other_strike.time
            spread = np.hypot(_hypot(cycle.strike, cycle.other_off), _hypot(cycle.off, cycle.other_strike))
            add("double support", 100 * both / duration, 100 / duration * spread)
    return found


def _hypot(*events: GaitEvent) -> float:
    return float(np.sqrt(sum(event.sigma**2 for event in events)))


@dataclass(frozen=True)
class _Stood:
    """Where a foot stood at an event: (2,) m on the floor, and how far it goes within the event's standard deviation."""

    place: Floats
    drift: Floats


def _stood(feet: Feet, side: str, event: GaitEvent, belt: Floats) -> _Stood:
    toe = feet.toes[side][:, :2]

    def at(time: float) -> Floats:
        # Between two samples: the curve's times are even, and begin with 0.
        place = min(max(time * RATE, 0.0), len(toe) - 1.0)
        low = min(int(place), len(toe) - 2)
        return np.asarray(toe[low] + (place - low) * (toe[low + 1] - toe[low]))

    # A foot that still moves when it strikes leaves its length as uncertain as the event is.
    velocity = (at(event.time + 1 / RATE) - at(event.time - 1 / RATE)) * RATE / 2 + belt
    return _Stood(at(event.time) + belt * event.time, velocity * event.sigma)


def _spread(way: Floats, one: _Stood, other: _Stood) -> float:
    """m, standard deviation of the distance between two places along a way."""
    return float(np.sqrt(2 * TOE_SIGMA**2 + (one.drift @ way) ** 2 + (other.drift @ way) ** 2))


def _belt(walking: Walking, cycle: Cycle) -> tuple[Floats, float]:
    """(2,) m/s with which a person overtakes a treadmill's belt, which a foot that stands shows, and its standard deviation; else 0."""
    feet, stood = walking.feet, cycle.off.time - cycle.strike.time
    if not walking.treadmill:
        return np.zeros(2), 0.0
    early, late = (round(RATE * (cycle.strike.time + share * stood)) for share in (0.25, 0.6))
    # an event that is no foot's may leave a stance of a sample
    late = max(late, early + 1)
    backwards = (feet.heels[cycle.side][late] - feet.heels[cycle.side][early])[:2] * RATE / (late - early)
    return -backwards, 2**0.5 * TOE_SIGMA * RATE / (late - early)


def summarise(parameters: Sequence[Parameter]) -> list[ParameterSummary]:
    """Mean and standard deviation of each parameter and side, in the order of `PARAMETERS`, left before right.

    Cycles of turns take no part where there are others (`without_turns`).
    """
    found, groups = [], dict[tuple[str, str], list[Parameter]]()
    for one in without_turns(parameters):
        groups.setdefault((one.name, one.side), []).append(one)
    for name in PARAMETERS:
        for side in ("L", "R"):
            if own := groups.get((name, side)):
                values = np.array([one.value for one in own])
                spread = float(values.std(ddof=1)) if len(own) > 1 else float("nan")
                sigma = float(np.sqrt(np.mean([one.sigma**2 for one in own]) / len(own)))
                found.append(ParameterSummary(name, side, float(values.mean()), spread, sigma, len(own)))
    return found


@dataclass(frozen=True)
class Symmetry:
    """How much more the left side's mean of a parameter is than the right's, % of the mean of both, with its standard uncertainty."""

    name: str
    value: float
    sigma: float


def symmetry_index(left: float, right: float) -> float:
    """%, 100 (L - R) / ((L + R) / 2): 0 for even, above 0 for more on the left; NaN where both cancel out. Robinson and others (1987).

    >>> round(symmetry_index(0.66, 0.54))
    20
    """
    return 200.0 * (left - right) / (left + right) if left + right else math.nan


def symmetries(parameters: Sequence[Parameter]) -> list[Symmetry]:
    """The symmetry index (Robinson et al. 1987) of what each foot has of its own, where both sides are known; 0 is symmetric.

    >>> times = [Parameter("step time", "L", 0.6, 0.01, 0.0, 1.0), Parameter("step time", "R", 0.4, 0.01, 0.0, 1.0)]
    >>> [round(one.value) for one in symmetries(times)]
    [40]
    """
    means = {(one.name, one.side): one for one in summarise(parameters)}
    found = []
    for name in SIDED:
        left, right = (means.get((name, side)) for side in ("L", "R"))
        if left is not None and right is not None and (both := (left.mean + right.mean) / 2) > 0:
            sigma = np.hypot(left.sigma * right.mean, right.sigma * left.mean) / both**2
            found.append(Symmetry(name, symmetry_index(left.mean, right.mean), 100 * float(sigma)))
    return found
