"""Cycles in; cadence, speed, lengths and times of steps out, each with how certain it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.gait.cycles import Cycle
from asterism.gait.events import GaitEvent, Walking
from asterism.gait.feet import RATE, Feet

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
HEEL_SIGMA = 0.003
"""m, standard deviation of a heel marker's place along the floor from step to step, beside what an event that is off adds."""


@dataclass(frozen=True)
class Parameter:
    """One value of one cycle of the side "L" or "R", with its standard uncertainty in the same unit; `begins` s, the cycle's strike."""

    name: str
    side: str
    value: float
    sigma: float
    begins: float


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

    On a treadmill lengths are those that the belt has run: the speed with which feet that stand go backwards, times the time.
    """
    return [parameter for cycle in cycles for parameter in _of_cycle(walking, cycle)]


def _of_cycle(walking: Walking, cycle: Cycle) -> list[Parameter]:
    found: list[Parameter] = []

    def add(name: str, value: float, sigma: float) -> None:
        if np.isfinite(value):
            found.append(Parameter(name, cycle.side, float(value), float(sigma), cycle.strike.time))

    duration, spread = cycle.duration, _hypot(cycle.strike, cycle.next_strike)
    length, speed = _stride(walking, cycle)
    add("stride time", duration, spread)
    add("cadence", 120.0 / duration, 120.0 / duration**2 * spread)
    add("stride length", length, np.hypot(HEEL_SIGMA, speed * spread if walking.treadmill else 0.0))
    add("walking speed", length / duration, length / duration**2 * spread)
    add("stance", 100 * cycle.off_share, 100 / duration * _hypot(cycle.strike, cycle.off))
    add("swing", 100 * (1 - cycle.off_share), 100 / duration * _hypot(cycle.strike, cycle.off))
    if cycle.other_strike is not None:
        # The step of this foot begins with the other's strike.
        add("step time", cycle.next_strike.time - cycle.other_strike.time, _hypot(cycle.next_strike, cycle.other_strike))
        ahead, aside = _step(walking, cycle, speed)
        add("step length", ahead, np.hypot(HEEL_SIGMA, speed * _hypot(cycle.next_strike, cycle.other_strike) if walking.treadmill else 0.0))
        add("step width", abs(aside), HEEL_SIGMA)
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


def _at(feet: Feet, points: np.ndarray, time: float) -> np.ndarray:
    return np.asarray(points[min(max(round(RATE * time), 0), len(points) - 1)])


def _stride(walking: Walking, cycle: Cycle) -> tuple[float, float]:
    """m that the foot comes ahead from strike to strike, and m/s of the belt on a treadmill, or of the person elsewhere."""
    feet, heel = walking.feet, walking.feet.heels[cycle.side]
    moved = _at(feet, heel, cycle.next_strike.time) - _at(feet, heel, cycle.strike.time)
    if not walking.treadmill:
        length = float(np.linalg.norm(moved[:2]))
        return length, length / cycle.duration
    # a foot that stands shows the belt
    stood = cycle.off.time - cycle.strike.time
    early, late = (round(RATE * (cycle.strike.time + share * stood)) for share in (0.25, 0.6))
    belt = float(np.linalg.norm((heel[late] - heel[early])[:2])) * RATE / (late - early)
    forwards = float(moved[:2] @ _at(feet, feet.ahead, cycle.next_strike.time))
    return belt * cycle.duration + forwards, belt


def _step(walking: Walking, cycle: Cycle, speed: float) -> tuple[float, float]:
    """m ahead and aside of the other heel at its strike, along the way of this foot's stride."""
    feet = walking.feet
    other = next((side for side in feet.sides if side != cycle.side), None)
    assert cycle.other_strike is not None
    if other is None:
        return float("nan"), float("nan")
    own = [_at(feet, feet.heels[cycle.side], event.time) for event in (cycle.strike, cycle.next_strike)]
    theirs = _at(feet, feet.heels[other], cycle.other_strike.time)
    if walking.treadmill:
        # Each place is moved to where it would be on a floor that stands.
        along = _at(feet, feet.ahead, cycle.other_strike.time)
        own[0] = own[0][:2] + along * speed * cycle.strike.time
        own[1] = own[1][:2] + along * speed * cycle.next_strike.time
        theirs = theirs[:2] + along * speed * cycle.other_strike.time
    way = (own[1] - own[0])[:2]
    way = way / max(float(np.linalg.norm(way)), 1e-9)
    apart = (own[1] - theirs)[:2]
    return float(apart @ way), float(way[0] * apart[1] - way[1] * apart[0])


def summarise(parameters: Sequence[Parameter]) -> list[ParameterSummary]:
    """Mean and standard deviation of each parameter and side, in the order of `PARAMETERS`, left before right."""
    found = []
    for name in PARAMETERS:
        for side in ("L", "R"):
            own = [one for one in parameters if (one.name, one.side) == (name, side)]
            if own:
                values = np.array([one.value for one in own])
                spread = float(values.std(ddof=1)) if len(own) > 1 else float("nan")
                sigma = float(np.sqrt(np.mean([one.sigma**2 for one in own]) / len(own)))
                found.append(ParameterSummary(name, side, float(values.mean()), spread, sigma, len(own)))
    return found
