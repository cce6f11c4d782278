"""Heel and toe of one foot in; whether it moves or flies, and how long after a turning its events are, as its own last steps say, out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.gait.events import OFF, STRIKE, EventRules
from asterism.gait.feet import FootColumns
from asterism.live.walking.carried_point import CarriedPoint
from asterism.live.walking.rules import KINDS, LiveEventRules
from asterism.live.walking.turning_curve import TurningCurve

PLACES = {"L": {STRIKE: 0, OFF: 1}, "R": {STRIKE: 2, OFF: 3}}
"""Where heel and toe of each foot are among the points of a frame, by the events that they tell."""

_NOWHERE = (math.nan, math.nan, math.nan)
"""m, an end of the foot that has not been seen."""


@dataclass
class ToldStep:
    """An event that was told, and waits for what the recording's rules say of it.

    foot, kind  whose, and OFF or STRIKE
    turned      s, when the foot's curve turned; time  s, when the event was, as it was told
    """

    foot: LiveFoot
    kind: str
    turned: float
    time: float


class LiveFoot:
    """One foot: what turns, what was told, and what its last steps say of the time."""

    def __init__(self, side: str, columns: FootColumns, helpers: list[int], rules: LiveEventRules, offline: EventRules) -> None:
        self.side, self._rules, self._offline = side, rules, offline
        self.rows = PLACES[side]
        self.places = {STRIKE: CarriedPoint(columns.heels[side], helpers, rules), OFF: CarriedPoint(columns.toes[side], helpers, rules)}
        self.curves = {STRIKE: TurningCurve(1.0, rules), OFF: TurningCurve(-1.0, rules)}
        self.later = {kind: deque[float](maxlen=rules.steps) for kind in KINDS}
        self.swings = {kind: deque[float](maxlen=rules.steps) for kind in KINDS}
        self._squares = {kind: deque[float](maxlen=rules.steps) for kind in KINDS}
        self.usual = dict.fromkeys(KINDS, 0.0)
        self.clear()

    def clear(self) -> None:
        """Nothing is known of where it is; what was learned of its steps is."""
        self.last: tuple[str, float] | None = None
        self.height = self.since = math.nan
        self._stood: list[Sequence[float]]
        self._stood, self._ground = [_NOWHERE, _NOWHERE], np.full(2, np.nan)
        self.moves = self.held = False
        for kind in KINDS:
            self.places[kind].clear()
            self.curves[kind].clear()

    def follow(self, ends: Sequence[Sequence[float]], time: float, step: float) -> None:
        """Keep where heel and toe (2, 3) m were."""
        share = 1.0 - math.exp(-step / self._rules.pause)
        # One end alone turns about the other, which stands.
        nearest = math.inf
        for number, end in enumerate(ends):
            if math.isnan(end[0]):
                continue
            # An end that is seen again, or for the first time, stands where it is.
            before = end if math.isnan(self._stood[number][0]) else self._stood[number]
            stood = [was + share * (now - was) for was, now in zip(before, end, strict=True)]
            self._stood[number] = stood
            nearest = min(nearest, math.dist(end, stood))
        if math.isinf(nearest):
            return
        moves = nearest > self._offline.still
        self.since = time if moves and not self.moves else self.since
        self.moves = moves
        if self.last is None or self.last[0] == STRIKE:
            self._ground = np.fmin(self._ground, [end[2] for end in ends])

    def flies(self, leg_length: float) -> bool:
        """Whether heel and toe are above where the foot stood last, and go up or down: who kicks, or marches, turns in the air."""
        speeds = [abs(curve.foretold_lift(self._rules.off_soon)) for curve in self.curves.values()]
        above = np.array([curve.state[1, 0] for curve in self.curves.values()]) - self._ground
        lands = self._offline.lands if self.held else self._offline.in_the_air * leg_length
        return bool(above.min() > lands) and min(speeds) > self._rules.floats

    def now(self, kind: str, at: float) -> None:
        """Keep that it struck or left at a time."""
        self.last = (kind, at)
        if kind == STRIKE:
            self._stood, self._ground = [_NOWHERE, _NOWHERE], np.full(2, np.nan)

    def swung(self, kind: str, rise: float) -> None:
        """Keep how far a heel or toe went."""
        self.swings[kind].append(rise)
        self.usual[kind] = float(np.median(self.swings[kind]))

    def judged(self, told: ToldStep, at: float, sigma: float) -> None:
        """Keep what the recording's rules say of an event: its time s, and standard deviation."""
        self.later[told.kind].append(at - told.turned)
        self._squares[told.kind].append((at - told.time) ** 2 + sigma**2)

    def sd(self, kind: str) -> float:
        """s, standard deviation of an event: how certain those of recordings are, and how well they were met."""
        own, prior = self._squares[kind], self._rules.prior
        first = self._offline.strike_sigma if kind == STRIKE else self._offline.off_sigma
        return math.sqrt((prior * (2.0 * first) ** 2 + sum(own)) / (prior + len(own)))

    def offset(self, kind: str) -> float:
        """s, from the turning to the event."""
        first, own = self._offline.strike_later if kind == STRIKE else self._offline.off_later, self.later[kind]
        return (self._rules.prior * first + sum(own)) / (self._rules.prior + len(own))
