"""Markers of feet and pelvis in, frame by frame; heel strikes and toe offs, told a few hundredths of a second after they happened, out.

A recording's rules (`gait.events`) look at both sides of an instant. Here only the past is known: a heel that was farthest ahead of the
pelvis, and has fallen back since by more than a foot in the air does, has struck. When exactly is told by the person's own last steps,
whose strikes and offs the recording's rules find half a second later.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from asterism.errors import AsterismError
from asterism.gait.events import OFF, STRIKE, EventRules, events_by_markers
from asterism.gait.feet import SIDES, FootColumns, feet_of, foot_columns, markers_of_feet
from asterism.live._step_kernels import followed
from asterism.live.analysis import LiveEvent
from asterism.recording import Floats, Recording

KINDS = {STRIKE: "heel strike", OFF: "toe off"}
"""As live events call those of recordings."""
_SIDE = {"L": "left", "R": "right"}


@dataclass(frozen=True)
class LiveEventRules:
    """How events are told while they happen; chosen on walks and runs of `movement` and simulated people.

    noise        m, of a marker's place
    jerk         m2/s5, how fast accelerations of a foot change
    jump         m, and jump_acceleration m/s2: a point farther from where it was expected is another marker, for these frames
    jumped       frames of such in a row after which the point is where it is seen now
    strike_later, off_later  s, from the turning of heel and toe to the event, before the person's own steps tell it
    fall         of the usual swing, and least_fall m, that a heel goes back after it turned, until it has struck; a toe comes forward
    off_soon     s, within which a toe turns, as its speed and acceleration foretell, when it has left the floor
    whole        of the usual swing, which tells a second strike (off) in a row, whose off (strike) between was not seen
    sure         standard deviations of the foretold speed by which it must be past the turning
    prior        steps as which `strike_later` and `off_later` count
    steps        last steps of the person that count
    sigma        s, standard deviation of an event about what the person's steps tell
    every        s, at least, from one such judgement to the next
    behind       s of curves before and after an event by which the recording's rules judge it
    pause        s without a frame after which everything begins anew
    backwards    of the leg that the pelvis goes back in `backwards_in` s when the person walks backwards, and no event is told
    """

    noise: float = 0.001
    jerk: float = 2000.0
    jump: float = 0.05
    jump_acceleration: float = 100.0
    jumped: int = 5
    strike_later: float = 0.040
    off_later: float = -0.010
    fall: float = 0.04
    least_fall: float = 0.01
    whole: float = 0.5
    off_soon: float = 0.03
    sure: float = 2.0
    prior: float = 2.0
    steps: int = 6
    sigma: float = 0.02
    every: float = 1.0
    behind: tuple[float, float] = (1.0, 0.4)
    pause: float = 0.3
    backwards: float = 0.4
    backwards_in: float = 1.5


class _CarriedPoint:
    """A point of the body by its markers; while they are hidden, moved as the others of that part move."""

    def __init__(self, columns: list[int], others: list[int]) -> None:
        self._columns, self._all = columns, sorted({*columns, *others})
        self._before = np.full((len(self._all), 3), np.nan)
        self.place, self.hidden = np.full(3, np.nan), 0

    def push(self, points: Floats) -> Floats:
        """(3,) m, by the markers (M, 3) m of a frame; NaN where none of them is known."""
        own = points[self._columns]
        now = points[self._all]
        if not math.isnan(own.sum()):
            self.place, self.hidden = own.mean(axis=0), 0
        else:
            moved = now - self._before
            seen = np.isfinite(moved[:, 0])
            self.hidden += 1
            self.place = self.place + moved[seen].mean(axis=0) if seen.any() else np.full(3, np.nan)
        self._before = now
        return self.place


class _TurningCurve:
    """How far a point is ahead of the pelvis, and how high: filtered, with the turning of `sign` times the former."""

    def __init__(self, sign: float, rules: LiveEventRules) -> None:
        self._sign, self._rules = sign, rules
        self.state, self._cov = np.zeros((2, 3)), np.eye(3)
        self._strange, self._begun, self._hidden = 0, False, 0
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
        return self._begun and self._cov[0, 0] < 0.02**2

    def push(self, time: float, step: float, ahead: float, height: float, hidden: int) -> None:
        """Take a frame; ahead is NaN where the point is not known."""
        rules = self._rules
        if self._begun and math.isfinite(ahead):
            expected = self.state[0, 0] + step * self.state[0, 1] + 0.5 * step * step * self.state[0, 2]
            back = self._hidden > 0 and hidden == 0
            if abs(ahead - expected) > rules.jump + rules.jump_acceleration * step * step and not back:
                self._strange += 1
                ahead = math.nan if self._strange < rules.jumped else ahead
                if self._strange >= rules.jumped:
                    self.clear()
            else:
                self._strange = 0
                if back:
                    # What was carried while it was hidden drifts: the place is new, the speed is not.
                    self.state[0, 0], self.state[1, 0] = ahead - step * self.state[0, 1], height - step * self.state[1, 1]
        self._hidden = hidden
        if not self._begun:
            if not math.isfinite(ahead):
                return
            self.state[:] = [[ahead, 0.0, 0.0], [height, 0.0, 0.0]]
            self._cov[:] = np.diag([rules.noise**2, 2.0**2, 20.0**2])
            self._begun, self._strange = True, 0
            self.low = self.top = self._sign * ahead
            self.top_time = time
            return
        before = self.velocity
        variance = (rules.noise * (1.0 + hidden)) ** 2
        followed(self.state, self._cov, step, rules.jerk, np.array([ahead, height]), variance)
        now, speed = self.value, self.velocity
        if now < self.low:
            self.low = self.top = now
            self.top_time = time
        elif now > self.top:
            self.top, self.top_time = now, time
        if before > 0.0 >= speed and now >= self.top - 0.002:
            self.top_time = time - step * speed / (speed - before)

    def turns_within(self, soon: float, sure: float) -> bool:
        """Whether it has turned, or will within so many s, by so many standard deviations of its speed then."""
        cov, jerk = self._cov, self._rules.jerk
        variance = cov[1, 1] + 2.0 * soon * cov[1, 2] + soon**2 * cov[2, 2] + jerk * soon**3 / 3.0
        speed = self._sign * (self.state[0, 1] + soon * self.state[0, 2])
        return bool(speed < -sure * math.sqrt(variance))

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


class _LiveFoot:
    """One foot: what turns, what was told, and what its last steps say of the time."""

    def __init__(self, side: str, columns: FootColumns, helpers: list[int], rules: LiveEventRules) -> None:
        self.side, self._rules = side, rules
        self.places = {STRIKE: _CarriedPoint(columns.heels[side], helpers), OFF: _CarriedPoint(columns.toes[side], helpers)}
        self.curves = {STRIKE: _TurningCurve(1.0, rules), OFF: _TurningCurve(-1.0, rules)}
        self.later = {kind: deque[float](maxlen=rules.steps) for kind in KINDS}
        self.swings = {kind: deque[float](maxlen=rules.steps) for kind in KINDS}
        self._squares = {kind: deque[float](maxlen=rules.steps) for kind in KINDS}
        self.usual = dict.fromkeys(KINDS, 0.0)
        self.last: tuple[str, float] | None = None

    def swung(self, kind: str, rise: float) -> None:
        """Keep how far a heel or toe went."""
        self.swings[kind].append(rise)
        self.usual[kind] = float(np.median(self.swings[kind]))

    def judged(self, told: _ToldStep, at: float, sigma: float) -> None:
        """Keep what the recording's rules say of an event: its time s, and standard deviation."""
        self.later[told.kind].append(at - told.turned)
        self._squares[told.kind].append((at - told.time) ** 2 + sigma**2)

    def sd(self, kind: str) -> float:
        """s, standard deviation of an event: how certain those of recordings are, and how well they were met."""
        own, prior = self._squares[kind], self._rules.prior
        return math.sqrt((prior * self._rules.sigma**2 + sum(own)) / (prior + len(own)))

    def offset(self, kind: str) -> float:
        """s, from the turning to the event."""
        rules = self._rules
        first = rules.strike_later if kind == STRIKE else rules.off_later
        own = self.later[kind]
        return (rules.prior * first + sum(own)) / (rules.prior + len(own))


@dataclass
class _ToldStep:
    foot: _LiveFoot
    kind: str
    turned: float
    time: float


@dataclass
class LiveEvents:
    """Strikes and offs of both feet, frame by frame.

    O(1) a frame and bounded memory, beside a millisecond or two each step in which the recording's rules look at the last one.
    """

    rules: LiveEventRules = field(default_factory=LiveEventRules)
    offline: EventRules = field(default_factory=EventRules)

    def __post_init__(self) -> None:
        self._markers: tuple[str, ...] = ()
        self._shown = np.zeros(0, dtype=np.int64)
        self._columns: FootColumns | None = None
        self.feet: dict[str, _LiveFoot] = {}
        self._pelvis = _CarriedPoint([], [])
        self._begin()

    def _begin(self) -> None:
        """A new stream."""
        self._time = math.nan
        self._ahead = np.full((2, 2), np.nan)
        self._kept: deque[tuple[float, Floats]] = deque()
        self._waiting: deque[_ToldStep] = deque()
        self._learned = -math.inf
        self._floor, self.leg_length = math.nan, math.nan
        self._slid: deque[float] = deque(maxlen=self.rules.steps)
        self._floors: deque[Floats] = deque(maxlen=self.rules.steps)

    @property
    def on_treadmill(self) -> bool:
        """Whether the floor moves, as far as the last steps show."""
        return bool(self._slid) and float(np.median(self._slid)) > 0.0

    @property
    def belt(self) -> Floats:
        """(2,) m/s with which the floor moves, as feet that stood on it show; 0 beside a treadmill."""
        return np.median(self._floors, axis=0) if self.on_treadmill else np.zeros(2)

    def toe_at(self, side: str, time: float) -> Floats:
        """(2,) m, where the toe of "left" or "right" was at a time of the last second; NaN where it is not known."""
        return self._at(1 if side == "left" else 3, time)

    def _at(self, place: int, time: float) -> Floats:
        later = None
        for at, row in reversed(self._kept):
            if at <= time:
                if later is None or later[0] <= at:
                    return row[place, :2]
                share = (time - at) / (later[0] - at)
                return np.asarray(row[place, :2] + share * (later[1][place, :2] - row[place, :2]))
            later = (at, row)
        return np.full(2, np.nan)

    def push(self, time: float, markers: tuple[str, ...], points: Floats) -> list[LiveEvent]:
        """Events that are told with this frame of markers (M, 3) m, z up, at `time` s."""
        step = time - self._time
        if markers != self._markers or not step <= self.rules.pause or not step > 0.0:
            if markers != self._markers:
                self._markers, self._shown, self._columns = markers, np.zeros(len(markers), dtype=np.int64), None
            self._begin()
            self._feet_of(self._columns)
            step = math.nan
        self._time = time
        before = self._shown
        self._shown = before + (np.isfinite(points[:, 0]) & (before <= 10))
        if (before <= 10).any() and (self._shown != before).any() and len(markers):
            columns = foot_columns(markers, self._shown > 10)
            if columns != self._columns:
                self._columns = columns
                self._begin()
                self._time, step = time, math.nan
                self._feet_of(columns)
        if not self.feet:
            return []
        return self._frame(time, step, points)

    def _feet_of(self, columns: FootColumns | None) -> None:
        self.feet = {}
        if columns is None or not columns.pelvis:
            return
        helpers = markers_of_feet(self._markers)
        self.feet = {side: _LiveFoot(side, columns, helpers[side], self.rules) for side in SIDES if side in columns.heels}
        self._pelvis = _CarriedPoint(columns.pelvis, [])

    def _frame(self, time: float, step: float, points: Floats) -> list[LiveEvent]:
        pelvis = self._pelvis.push(points)
        row = np.full((5, 3), np.nan)
        row[4] = pelvis
        pointing = np.zeros(2)
        for foot in self.feet.values():
            at = 0 if foot.side == "L" else 2
            row[at], row[at + 1] = foot.places[STRIKE].push(points), foot.places[OFF].push(points)
            way = row[at + 1, :2] - row[at, :2]
            if math.isfinite(way[0]):
                pointing += way
        self._heading(pointing, step)
        self._kept.append((time, row))
        while self._kept[0][0] < time - sum(self.rules.behind) - self.rules.every - 0.5:
            self._kept.popleft()
        if not math.isfinite(step):
            return []
        self._size(row, step)
        found = list[LiveEvent]()
        backwards = self._goes_backwards(time, pelvis)
        ahead = 2.0 * self._ahead[0] - self._ahead[1]
        ahead = ahead / max(float(np.hypot(*ahead)), 1e-9)
        for foot in self.feet.values():
            at = 0 if foot.side == "L" else 2
            for kind, place in ((STRIKE, at), (OFF, at + 1)):
                curve = foot.curves[kind]
                arm = row[place] - pelvis
                curve.push(time, step, float(arm[0] * ahead[0] + arm[1] * ahead[1]), float(row[place, 2]), foot.places[kind].hidden)
                event = None if backwards else self._told(foot, kind, time)
                if event is not None:
                    found.append(event)
        if self._waiting and time >= max(self._learned + self.rules.every, self._waiting[0].time + self.rules.behind[1]):
            self._learn(time)
        return found

    def _heading(self, pointing: Floats, step: float) -> None:
        """Where the feet point: smoothed twice, so that a steady turn is not late."""
        length = float(np.hypot(*pointing))
        if length < 1e-6:
            return
        unit = pointing / length
        if not math.isfinite(self._ahead[0, 0]) or not math.isfinite(step):
            self._ahead[:] = unit
            return
        share = 1.0 - math.exp(-step / 0.2)
        self._ahead[0] += share * (unit - self._ahead[0])
        self._ahead[1] += share * (self._ahead[0] - self._ahead[1])

    def _size(self, row: Floats, step: float) -> None:
        """Follow the floor and the height of the pelvis."""
        lowest = np.nanmin(row[[0, 2], 2]) if np.isfinite(row[[0, 2], 2]).any() else math.nan
        if math.isfinite(lowest):
            self._floor = lowest if not math.isfinite(self._floor) else min(lowest, self._floor + 0.01 * step)
        if math.isfinite(row[4, 2]) and math.isfinite(self._floor):
            height = float(row[4, 2] - self._floor)
            self.leg_length = height if math.isnan(self.leg_length) else self.leg_length + min(2.0 * step, 1.0) * (height - self.leg_length)

    def _goes_backwards(self, time: float, pelvis: Floats) -> bool:
        first = next((row[4] for at, row in self._kept if at >= time - self.rules.backwards_in and math.isfinite(row[4, 0])), None)
        if first is None or not math.isfinite(pelvis[0]):
            return False
        way = (pelvis - first)[:2] @ self._ahead[0]
        return bool(way < -self.rules.backwards * self.leg_length)

    def _told(self, foot: _LiveFoot, kind: str, time: float) -> LiveEvent | None:
        rules, curve = self.rules, foot.curves[kind]
        if not curve.known or not math.isfinite(self.leg_length):
            return None
        usual = foot.usual[kind]
        least = max(self.offline.least_step * usual, self.offline.least_swing * self.leg_length)
        # A stream that begins in mid-swing shows less of it before than after.
        if max(curve.rise, curve.fall) < least or curve.rise < 0.001:
            return None
        back = curve.fall >= max(rules.fall * usual, rules.least_fall)
        if not back and (kind == STRIKE or not curve.turns_within(rules.off_soon, rules.sure)):
            return None
        turned = curve.turned(time)
        at = turned + foot.offset(kind)
        if time < at:
            return None
        rise = curve.rise
        curve.anew()
        if foot.last is not None and foot.last[0] == kind and rise < rules.whole * usual:
            return None
        if kind == OFF and foot.last is not None:
            self._stood(foot, foot.last[1], at)
        foot.last = (kind, at)
        foot.swung(kind, rise)
        self._waiting.append(_ToldStep(foot, kind, turned, at))
        return LiveEvent(KINDS[kind], _SIDE[foot.side], at, time - at, foot.sd(kind))

    def _stood(self, foot: _LiveFoot, strike: float, off: float) -> None:
        """What a foot that stood says of the floor: the middle of a stance, in which neither heel nor toe turns."""
        begins, ends = (strike + share * (off - strike) for share in (0.3, 0.6))
        heel = 0 if foot.side == "L" else 2
        moved = [self._at(place, ends) - self._at(place, begins) for place in (heel, 4)]
        if ends > begins and math.isfinite(moved[0][0] + moved[1][0]):
            self._slid.append(float(np.hypot(*moved[0]) - np.hypot(*moved[1])))
            self._floors.append(moved[0] / (ends - begins))

    def _learn(self, time: float) -> None:
        """What the recording's rules say of events that are over, from the curves on both sides of them."""
        due = [told for told in self._waiting if told.time + self.rules.behind[1] <= time]
        self._waiting = deque(told for told in self._waiting if told.time + self.rules.behind[1] > time)
        self._learned = time
        kept = [(at, row) for at, row in self._kept if at >= due[0].time - self.rules.behind[0]]
        times = np.array([at for at, _ in kept])
        rate = 1.0 / float(np.median(np.diff(times)))
        rows = np.round((times - times[0]) * rate).astype(int)
        positions = np.full((rows[-1] + 1, 5, 3), np.nan)
        positions[rows] = [row for _, row in kept]
        try:
            feet = feet_of(Recording(positions, ("LHEE", "LTOE", "RHEE", "RTOE", "SACR"), rate))
        except AsterismError:
            return
        for side in {told.foot.side for told in due} & set(feet.sides):
            events = events_by_markers(feet, side, self.offline, self.on_treadmill)
            for told in due:
                own = [(times[0] + event.time, event.sigma) for event in events if event.label == told.kind and told.foot.side == side]
                at, sigma = min(own, key=lambda one: abs(one[0] - told.time), default=(math.inf, 0.0))
                if abs(at - told.time) < self.offline.near:
                    told.foot.judged(told, float(at), sigma)
