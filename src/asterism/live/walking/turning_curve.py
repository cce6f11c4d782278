"""How far a heel or toe is ahead of the pelvis in, frame by frame; when it turns, and how certain that is, out."""

from __future__ import annotations

import math

import numpy as np

from asterism.live.walking._step_kernels import followed
from asterism.live.walking.rules import LiveEventRules

_ANY = (2.0**2, 20.0**2)
"""(m/s)2 and (m/s2)2, variances of speed and acceleration of a foot of which nothing is known: those of a walk. Three frames later
nothing is left of them."""
_FARTHEST_MISS, _ROUGHEST = 25.0, 1000.0
"""Squares of standard deviations that one miss counts at most, and that all together are: 5 of them, and points that are 3 cm off. At half
and double steps of a stream whose times jitter by 5 ms are told as well."""


class TurningCurve:
    """How far a point is ahead of the pelvis, and how high: filtered, with the turning of `sign` times the former."""

    def __init__(self, sign: float, rules: LiveEventRules) -> None:
        self._sign, self._rules = sign, rules
        self.state, self._cov = np.zeros((2, 3)), np.eye(3)
        self._strange, self._rough, self._begun, self._hidden = 0.0, 1.0, False, 0
        self.clear()

    def clear(self) -> None:
        """Nothing is known any more."""
        self._begun = False
        self.low = self.top = self.top_time = math.nan

    def anew(self) -> None:
        """The next turning counts from here."""
        self.low = self.top = self._sign * self.state[0, 0]

    @property
    def value(self) -> float:
        """m, of the curve that is to turn."""
        return float(self._sign * self.state[0, 0])

    @property
    def velocity(self) -> float:
        """m/s, of the same."""
        return float(self._sign * self.state[0, 1])

    @property
    def known(self) -> bool:
        """Whether the point is followed."""
        return self._begun and self._cov[0, 0] < self._rules.lost**2

    def push(self, time: float, step: float, ahead: float, height: float, hidden: int) -> None:
        """Take a frame; ahead is NaN where the point is not known."""
        rules = self._rules
        if self._begun and math.isfinite(ahead):
            place, speed, change = self.state[0].tolist()
            expected = place + step * speed + 0.5 * step * step * change
            back = self._hidden > 0 and hidden == 0
            if abs(ahead - expected) > rules.jump + 3.0 * self._sd(0, step) and not back:
                self._strange += step
                if self._strange > rules.jumped:
                    self.clear()
                else:
                    ahead = math.nan
            else:
                self._strange = 0.0
                if back and not self.known:
                    # Nobody knows what it did meanwhile.
                    self.clear()
                elif back:
                    # What was carried while it was hidden drifts: the place is new; speed, and how far it has gone, are not.
                    drift = ahead - expected
                    self.state[0, 0], self.state[1, 0] = ahead - step * self.state[0, 1], height - step * self.state[1, 1]
                    self.low, self.top = self.low + self._sign * drift, self.top + self._sign * drift
        self._hidden = hidden
        if not self._begun:
            if not math.isfinite(ahead):
                return
            self.state[:] = [[ahead, 0.0, 0.0], [height, 0.0, 0.0]]
            self._cov[:] = np.diag([rules.noise**2, *_ANY])
            self._begun, self._strange = True, 0.0
            self.low = self.top = self._sign * ahead
            self.top_time = time
            return
        before = self.velocity
        variance = (rules.noise * (1.0 + hidden)) ** 2 * max(self._rough, 1.0)
        miss = followed(self.state, self._cov, step, rules.jerk, np.array([ahead, height]), variance)
        if math.isfinite(ahead):
            self._rough += min(step / rules.rough, 1.0) * (self._rough * min(miss * miss, _FARTHEST_MISS) - self._rough)
            self._rough = min(max(self._rough, 1.0), _ROUGHEST)
        now, speed = self.value, self.velocity
        if now < self.low:
            self.low = self.top = now
            self.top_time = time
        elif now > self.top:
            self.top, self.top_time = now, time
        if before > 0.0 >= speed and now >= self.top - 2.0 * rules.noise:
            self.top_time = time - step * speed / (speed - before)

    def turns_within(self, soon: float, sure: float) -> bool:
        """Whether it has turned, or will within so many s, by so many standard deviations of its speed then."""
        speed = self._sign * (self.state[0, 1] + soon * self.state[0, 2])
        return bool(speed < -sure * self._sd(1, soon))

    def foretold_lift(self, soon: float) -> float:
        """m/s upwards, so many s from now."""
        return float(self.state[1, 1] + soon * self.state[1, 2])

    def _sd(self, which: int, soon: float) -> float:
        """Standard deviation of the place (0, m) or the speed (1, m/s), foretold so many s from now."""
        (cov00, cov01, cov02), (_, cov11, cov12), (_, _, cov22) = self._cov.tolist()
        jerk = self._rules.jerk
        if which:
            return math.sqrt(cov11 + 2.0 * soon * cov12 + soon**2 * cov22 + jerk * soon**3 / 3.0)
        place = cov00 + 2.0 * soon * cov01 + soon**2 * (cov11 + cov02) + soon**3 * cov12
        return math.sqrt(max(place + 0.25 * soon**4 * cov22 + jerk * soon**5 / 20.0, 0.0))

    def turned(self, time: float) -> float:
        """s, when it turned, or will."""
        speed, change = self.velocity, self._sign * float(self.state[0, 2])
        return time - speed / change if speed > 0.0 > change else self.top_time

    @property
    def rise(self) -> float:
        """m, from the lowest to the highest."""
        return self.top - self.low

    @property
    def fall(self) -> float:
        """m, back since then."""
        return self.top - self.value
