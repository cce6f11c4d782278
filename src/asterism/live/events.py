"""Markers of feet and pelvis in, frame by frame; heel strikes and toe offs, told a few hundredths of a second after they happened, out.

A recording's rules (`gait.events`) look at both sides of an instant. Here only the past is known: a heel that was farthest ahead of the
pelvis, and has fallen back since by more than a foot in the air does, has struck. When exactly is told by the person's own last steps,
whose strikes and offs the recording's rules find half a second later.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.gait.events import LEVEL_IN, OFF, STRIKE, EventRules, events_by_markers, is_no_stance, rise_of_foot, slides
from asterism.gait.feet import SIDES, TURNING, FootColumns, feet_of, foot_columns, markers_of_feet
from asterism.geometry import fit_rigid
from asterism.live._step_kernels import followed
from asterism.live.analysis import LiveEvent
from asterism.recording import Floats, Recording

KINDS = {STRIKE: "heel strike", OFF: "toe off"}
"""As live events call those of recordings."""
_SIDE = {"L": "left", "R": "right"}


@dataclass(frozen=True)
class LiveEventRules:
    """How events are told while they happen.

    Chosen on 17 walks and runs of `movement` and 40 of simulated people, whole and with markers hidden, exchanged or wrong. Where nothing
    is said, half and double change no count of what is missed or told for nothing by more than one of 200, and no delay by 5 ms.

    noise        m, of a marker's place; jerk  m2/s5, how fast accelerations of a foot change: filters follow 15 Hz
    jump         m, by which a point may be elsewhere than expected, beside three standard deviations, or its marker is another one's
    jumped       s of such, after which the point is where it is seen now; at double, feet that come back are told 0.1 s late
    rough        s over which misses tell how far points are off, and times: a stream whose times jitter is as much less certain
    lost         m, standard deviation of a point's place above which it tells nothing
    prior, steps  steps as which the recording's rules count in what lies between a turning and its event, and last ones of the person
                 beside them; and in how certain that is, with twice their standard deviation
    fall, least_fall  of the usual swing, and m, that a heel goes back (a toe forward) after it turned, until it counts as told. This is the
                 trade of delay against false alarms: at half, strikes of slow steps are told 10 ms sooner, at double of `fall` one in
                 hundred 170 ms later; false ones are as many
    off_soon     s, within which a toe turns, as its speed and acceleration foretell by `sure` standard deviations, when it has left the
                 floor. At half of `sure` offs are told 8 ms sooner and 4 % for nothing, at double 20 ms later
    behind       s of curves before and after an event that the recording's rules look at: a swing, and what their filters need. They judge
                 the last steps as often
    pause        s without a frame after which all but what was learned begins anew, twice a swing's turning; for so long at most left and
                 right foot are given back each other's places, where each is where the other one goes; and over so long a foot stands of
                 which heel or toe is where it was
    floats       m/s up or down below which an end of a foot rests on the floor, be it a stair; at half, stairs hold strikes back, at double
                 who marches slowly strikes at the top
    seen         frames of a marker, after which it counts as worn
    climbs       m/s by which the floor is believed to rise where no foot comes down to it
    upright      cosine of the angle from feet to pelvis against the vertical, over a second, below which nobody walks: 60 degrees
    backwards, backwards_in  of the leg that the pelvis goes back, and in how many s, when the person walks backwards
    lower        m, by which feet are lower between off and strike than between strike and off, where a person walks backwards on a
                 treadmill; at half, one in ten steps of people who drag their feet is lost
    """

    noise: float = 0.001
    jerk: float = 2000.0
    jump: float = 0.05
    jumped: float = 0.15
    rough: float = 1.0
    lost: float = 0.02
    prior: float = 1.0
    steps: int = 6
    fall: float = 0.04
    least_fall: float = 0.005
    off_soon: float = 0.03
    sure: float = 2.0
    behind: tuple[float, float] = (1.0, 0.4)
    pause: float = 0.3
    floats: float = 0.2
    seen: int = 3
    climbs: float = 0.01
    upright: float = 0.5
    backwards: float = 0.4
    backwards_in: float = 1.5
    lower: float = 0.01


class _CarriedPoint:
    """A point of the body by its markers; while they are hidden or wrong, moved as the others of that part move."""

    def __init__(self, columns: list[int], others: list[int], rules: LiveEventRules) -> None:
        self._rules = rules
        self._columns, self._all = columns, sorted({*columns, *others})
        self.clear()

    def clear(self) -> None:
        """Nothing is known of where it is."""
        self._before = self._template = np.full((len(self._all), 3), np.nan)
        self.place, self.hidden, self._strange = np.full(3, np.nan), 0, 0.0
        self._place_in_template = self.place

    def push(self, points: Floats, step: float) -> Floats:
        """(3,) m, by the markers (M, 3) m of a frame, s after the one before; NaN where none of them is known."""
        now = points[self._all]
        moved = now - self._before
        place = points[self._columns].mean(axis=0)
        # The others say where it is if it moved as they did: the middle one, since one of them may be another marker, too.
        carried = self.place + _middle(moved)
        apart = float(np.abs(place - carried).max())
        if apart > self._rules.jump + _FASTER * step and self._strange < self._rules.jumped and len(self._all) > 2:
            self._strange += step
            place[:] = np.nan
        else:
            self._strange = 0.0
        self._before = now
        if not math.isnan(place[0]):
            self.place, self.hidden = place, 0
            self._template, self._place_in_template = now, place
            return place
        self.hidden += 1
        both = np.isfinite(self._template[:, 0]) & np.isfinite(now[:, 0])
        if both.sum() >= _LEAST:
            # Three of them say how the foot has turned, too.
            turn, shift = fit_rigid(self._template[both], now[both])
            off = np.abs(self._template[both] @ turn.T + shift - now[both]).max()
            # One that is no marker of this foot would turn it.
            carried = turn @ self._place_in_template + shift if off < 0.5 * self._rules.jump else carried
        self.place = carried
        return carried


_LEAST = 3
"""Markers that place a foot: two leave a turn open."""
_ANY = (2.0**2, 20.0**2)
"""(m/s)2 and (m/s2)2, variances of speed and acceleration of a foot of which nothing is known: those of a walk. Three frames later
nothing is left of them."""
_FARTHEST_MISS, _ROUGHEST = 25.0, 1000.0
"""Squares of standard deviations that one miss counts at most, and that all together are: 5 of them, and points that are 3 cm off. At half
and double steps of a stream whose times jitter by 5 ms are told as well."""
_MOST_KEPT = 4000
"""Frames of feet that are kept: 3 s at 1,000 Hz, 1 MB. At half, faster cameras judge fewer steps; at double the same."""
_FASTER = 5.0
"""m/s by which two markers of a foot differ at most: one turns about the other at 20 rad/s."""


def _middle(moved: Floats) -> Floats:
    """(3,) the median of the rows (N, 3) that are known; NaN where none is."""
    seen = moved[np.isfinite(moved[:, 0])]
    if not len(seen):
        return np.full(3, np.nan)
    seen.sort(axis=0)
    return np.asarray(0.5 * (seen[(len(seen) - 1) // 2] + seen[len(seen) // 2]))


class _TurningCurve:
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
            expected = self.state[0, 0] + step * self.state[0, 1] + 0.5 * step * step * self.state[0, 2]
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
        cov, jerk = self._cov, self._rules.jerk
        if which:
            return math.sqrt(cov[1, 1] + 2.0 * soon * cov[1, 2] + soon**2 * cov[2, 2] + jerk * soon**3 / 3.0)
        place = cov[0, 0] + 2.0 * soon * cov[0, 1] + soon**2 * (cov[1, 1] + cov[0, 2]) + soon**3 * cov[1, 2]
        return math.sqrt(max(place + 0.25 * soon**4 * cov[2, 2] + jerk * soon**5 / 20.0, 0.0))

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

    def __init__(self, side: str, columns: FootColumns, helpers: list[int], rules: LiveEventRules, offline: EventRules) -> None:
        self.side, self._rules, self._offline = side, rules, offline
        self.places = {STRIKE: _CarriedPoint(columns.heels[side], helpers, rules), OFF: _CarriedPoint(columns.toes[side], helpers, rules)}
        self.curves = {STRIKE: _TurningCurve(1.0, rules), OFF: _TurningCurve(-1.0, rules)}
        self.later = {kind: deque[float](maxlen=rules.steps) for kind in KINDS}
        self.swings = {kind: deque[float](maxlen=rules.steps) for kind in KINDS}
        self._squares = {kind: deque[float](maxlen=rules.steps) for kind in KINDS}
        self.usual = dict.fromkeys(KINDS, 0.0)
        self.clear()

    def clear(self) -> None:
        """Nothing is known of where it is; what was learned of its steps is."""
        self.last: tuple[str, float] | None = None
        self.height = self.since = math.nan
        self._stood, self._ground = np.full((2, 3), np.nan), np.full(2, np.nan)
        self.moves = self.held = False
        for kind in KINDS:
            self.places[kind].clear()
            self.curves[kind].clear()

    def follow(self, ends: Floats, time: float, step: float) -> None:
        """Keep where heel and toe (2, 3) m were."""
        way = ends - self._stood
        known = [math.isfinite(way[0, 0]), math.isfinite(way[1, 0])]
        if not all(known):
            # An end that is seen again, or for the first time, stands where it is.
            self._stood = np.where(np.isnan(self._stood), ends, self._stood)
            way = np.nan_to_num(ends - self._stood)
            known = [math.isfinite(ends[0, 0]), math.isfinite(ends[1, 0])]
            if not any(known):
                return
        self._stood = self._stood + (1.0 - math.exp(-step / self._rules.pause)) * way
        # One end alone turns about the other, which stands.
        nearest = min(math.dist(end, stood) for end, stood, seen in zip(ends, self._stood, known, strict=True) if seen)
        moves = nearest > self._offline.still
        self.since = time if moves and not self.moves else self.since
        self.moves = moves
        if self.last is None or self.last[0] == STRIKE:
            self._ground = np.fmin(self._ground, ends[:, 2])

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
            self._stood, self._ground = np.full((2, 3), np.nan), np.full(2, np.nan)

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
        first = self._offline.strike_sigma if kind == STRIKE else self._offline.off_sigma
        return math.sqrt((prior * (2.0 * first) ** 2 + sum(own)) / (prior + len(own)))

    def offset(self, kind: str) -> float:
        """s, from the turning to the event."""
        first, own = self._offline.strike_later if kind == STRIKE else self._offline.off_later, self.later[kind]
        return (self._rules.prior * first + sum(own)) / (self._rules.prior + len(own))


@dataclass
class _ToldStep:
    foot: _LiveFoot
    kind: str
    turned: float
    time: float


@dataclass
class LiveEvents:
    """Strikes and offs of both feet, frame by frame.

    A tenth of a millisecond a frame, and two or three once a second in which the recording's rules look at the last steps. Bounded memory.
    """

    rules: LiveEventRules = field(default_factory=LiveEventRules)
    offline: EventRules = field(default_factory=EventRules)

    def __post_init__(self) -> None:
        self._markers: tuple[str, ...] = ()
        self._shown = np.zeros(0, dtype=np.int64)
        self._columns: FootColumns | None = None
        self.feet: dict[str, _LiveFoot] = {}
        self._pelvis = _CarriedPoint([], [], self.rules)
        self._walked = self._lay = 0.0
        self._begin()
        # Compiled, and the sets' files read, before the first frame, which must not wait for it.
        markers_of_feet(("LHEE",))
        followed(np.zeros((2, 3)), np.eye(3), 0.01, self.rules.jerk, np.zeros(2), self.rules.noise**2)

    def _begin(self) -> None:
        """A new stream."""
        self._time = self._began = math.nan
        self._ahead = np.full((2, 2), np.nan)
        # A clock that hardly goes on must not fill the memory.
        self._kept: deque[tuple[float, Floats]] = deque(maxlen=_MOST_KEPT)
        self._waiting: deque[_ToldStep] = deque()
        self._learned = -math.inf
        self._learning: Iterator[bool] | None = None
        self._floor = self.leg_length = self._upright = math.nan
        self._before, self._speeds, self._exchanged = np.full((2, 2, 3), np.nan), np.zeros((2, 2, 3)), 0.0
        self._pelvis.clear()
        for foot in self.feet.values():
            foot.clear()
        self._slid: deque[float] = deque(maxlen=self.rules.steps)
        self._floors: deque[Floats] = deque(maxlen=self.rules.steps)
        self._lifts: deque[float] = deque(maxlen=self.rules.steps)
        self._rises = {kind: deque[float](maxlen=self.rules.steps) for kind in KINDS}

    def findings(self) -> list[Finding]:
        """That no steps could be told of somebody who lay."""
        if self._lay <= max(self._walked, 1.0):
            return []
        sentence = f"For {self._lay:.0f} s the person lay, or another axis points up: no strikes and offs were told of it."
        return [Finding("live-not-upright", Severity.NOTE, "steps", sentence, "Say what points up with --vertical, as in --vertical y.")]

    @property
    def on_treadmill(self) -> bool:
        """Whether the floor moves, as far as the last steps show."""
        return bool(self._slid) and float(np.median(self._slid)) > self.offline.still

    @property
    def _goes_round(self) -> bool:
        """Whether feet that seem to be carried along are not level, as those on pedals; the first stances of a stream are not whole."""
        stances = self._rises[OFF]
        return len(stances) >= self.rules.steps // 2 and self.on_treadmill and is_no_stance(stances, self._rises[STRIKE], self.offline)

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

    def is_followed(self, begin: float, end: float) -> bool:
        """Whether the pelvis was followed between two times (s): who is out of view, or elsewhere at once, made steps unseen."""
        seen = [(at, row[4]) for at, row in self._kept if begin <= at <= end and math.isfinite(row[4, 0])]
        times = np.diff([begin, *(at for at, _ in seen), end])
        ways = np.linalg.norm(np.diff([place for _, place in seen], axis=0), axis=1) if len(seen) > 1 else np.zeros(0)
        return bool((times <= self.rules.pause).all() and (ways <= self.rules.jump + _FASTER * times[1:-1]).all())

    def push(self, time: float, markers: tuple[str, ...], points: Floats) -> list[LiveEvent]:
        """Events that are told with this frame of markers (M, 3) m, z up, at `time` s."""
        step = time - self._time
        if markers != self._markers or not step <= self.rules.pause or not step > 0.0:
            if markers != self._markers:
                self._markers, self._shown, self._columns = markers, np.zeros(len(markers), dtype=np.int64), None
                self._feet_of(None)
            # What was learned of the person's steps is kept.
            self._begin()
            self._began, step = time, math.nan
        self._time = time
        before = self._shown
        self._shown = before + (np.isfinite(points[:, 0]) & (before < self.rules.seen))
        if (self._shown != before).any():
            columns = foot_columns(markers, self._shown >= self.rules.seen)
            if columns != self._columns:
                self._columns = columns
                self._feet_of(columns)
                self._begin()
                self._time, self._began, step = time, time, math.nan
        if not self.feet:
            return []
        return self._frame(time, step, points)

    def _feet_of(self, columns: FootColumns | None) -> None:
        self.feet = {}
        if columns is None or not columns.pelvis:
            return
        helpers = markers_of_feet(self._markers)
        self.feet = {side: _LiveFoot(side, columns, helpers[side], self.rules, self.offline) for side in SIDES if side in columns.heels}
        self._pelvis = _CarriedPoint(columns.pelvis, [], self.rules)

    def _frame(self, time: float, step: float, points: Floats) -> list[LiveEvent]:
        since = 0.0 if math.isnan(step) else step
        pelvis = self._pelvis.push(points, since)
        row = np.full((5, 3), np.nan)
        row[4] = pelvis
        pointing = np.zeros(2)
        for foot in self.feet.values():
            at = 0 if foot.side == "L" else 2
            row[at], row[at + 1] = (foot.places[kind].push(points, since) for kind in KINDS)
            way = row[at + 1, :2] - row[at, :2]
            if math.isfinite(way[0]):
                pointing += way
        self._heading(pointing, step)
        self._kept.append((time, row))
        while self._kept[0][0] < time - 2.0 * sum(self.rules.behind):
            self._kept.popleft()
        if not math.isfinite(step):
            return []
        self._size(row, step)
        found = list[LiveEvent]()
        ahead = 2.0 * self._ahead[0] - self._ahead[1]
        ahead = ahead / max(float(np.hypot(*ahead)), 1e-9)
        self._put_right(row, step)
        for foot in self.feet.values():
            at = 0 if foot.side == "L" else 2
            foot.follow(row[at : at + 2], time, step)
            for kind, place in ((STRIKE, at), (OFF, at + 1)):
                curve = foot.curves[kind]
                arm = row[place] - pelvis
                curve.push(time, step, float(arm[0] * ahead[0] + arm[1] * ahead[1]), float(row[place, 2]), foot.places[kind].hidden)
                event = self._told(foot, kind, time)
                if event is not None:
                    found.append(event)
        due = self._waiting and time >= max(self._learned + self.rules.behind[0], self._waiting[0].time + self.rules.behind[1])
        if due and self._learning is None:
            self._learning = self._learn(time)
        # A part of it each frame, so that none is late by all of them.
        if self._learning is not None and next(self._learning, True):
            self._learning = None
        # What is no step forwards of somebody upright is followed, and not told.
        return [] if found and (self._goes_backwards(time, pelvis) or self._upright < self.rules.upright or self._goes_round) else found

    def _heading(self, pointing: Floats, step: float) -> None:
        """Where the feet point: smoothed twice, so that a steady turn is not late."""
        length = float(np.hypot(*pointing))
        if length < 1e-6:
            return
        unit = pointing / length
        if not math.isfinite(self._ahead[0, 0]) or not math.isfinite(step):
            self._ahead[:] = unit
            return
        share = 1.0 - math.exp(-step * 2.0 * math.pi * TURNING)
        self._ahead[0] += share * (unit - self._ahead[0])
        self._ahead[1] += share * (self._ahead[0] - self._ahead[1])

    def _size(self, row: Floats, step: float) -> None:
        """Follow the floor, the height of the pelvis, and whether it is above the feet."""
        heels = row[[0, 2]][np.isfinite(row[[0, 2], 0])]
        if not len(heels) or math.isnan(row[4, 0]):
            return
        lowest, limb, share = float(heels[:, 2].min()), row[4] - heels.mean(axis=0), min(step, 1.0)
        self._floor = lowest if math.isnan(self._floor) else min(lowest, self._floor + self.rules.climbs * step)
        height, upright = float(row[4, 2]) - self._floor, float(limb[2]) / max(float(np.linalg.norm(limb)), 1e-9)
        self.leg_length = height if math.isnan(self.leg_length) else self.leg_length + share * (height - self.leg_length)
        self._upright = upright if math.isnan(self._upright) else self._upright + share * (upright - self._upright)
        lies = self._upright < self.rules.upright
        self._walked, self._lay = self._walked + step * (not lies), self._lay + step * lies

    def _goes_backwards(self, time: float, pelvis: Floats) -> bool:
        first = next((row[4] for at, row in self._kept if at >= time - self.rules.backwards_in and math.isfinite(row[4, 0])), None)
        if first is None or not math.isfinite(pelvis[0]):
            return False
        way = (pelvis - first)[:2] @ self._ahead[0]
        # On a treadmill only the feet tell: who walks backwards has them higher between strike and off than between off and strike.
        in_the_air = len(self._lifts) > 3 and float(np.median(self._lifts)) < -self.rules.lower
        return bool(way < -self.rules.backwards * self.leg_length) or in_the_air

    def _put_right(self, row: Floats, step: float) -> None:
        """Give left and right foot their own places again where a frame has each where the other one goes. Writes the row."""
        feet, before = row[:4].reshape(2, 2, 3), self._before
        expected = before + step * self._speeds
        if not np.isfinite(feet).all() or not np.isfinite(expected).all():
            self._before, self._speeds = feet.copy(), np.zeros_like(feet)
            return
        same, other = (float(np.linalg.norm((one - expected).mean(axis=1), axis=1).max()) for one in (feet, feet[::-1]))
        if same - other > self.rules.jump:
            self._exchanged += step
            # Who is wrong for so long was right: then it is what came before that was exchanged.
            if self._exchanged < self.rules.pause:
                row[:4] = feet[::-1].reshape(4, 3)
                feet = row[:4].reshape(2, 2, 3)
            else:
                for foot in self.feet.values():
                    foot.clear()
                before = feet
        else:
            self._exchanged = 0.0
        self._before, self._speeds = feet.copy(), (feet - before) / step

    def _told(self, foot: _LiveFoot, kind: str, time: float) -> LiveEvent | None:
        rules, curve = self.rules, foot.curves[kind]
        foot.held = foot.held and foot.curves[STRIKE].known
        if not curve.known or not foot.moves or not math.isfinite(self.leg_length):
            return None
        usual = foot.usual[kind]
        least = max(self.offline.least_step * usual, self.offline.least_swing * self.leg_length)
        # A stream that begins in mid-swing shows less of it before than after.
        if max(curve.rise, curve.fall) < least or curve.rise < rules.noise:
            return None
        back = curve.fall >= max(rules.fall * usual, rules.least_fall)
        soon = curve.turns_within(rules.off_soon, rules.sure)
        if not back and (kind == STRIKE or not soon):
            return None
        turned = curve.turned(time)
        at = turned + foot.offset(kind)
        if time < at:
            return None
        if kind == STRIKE and foot.flies(self.leg_length):
            foot.held = True
            return None
        if kind == OFF and foot.held:
            # It has not struck yet since it left.
            curve.anew()
            return None
        # A foot that was seen to come down, or to stand where it was, tells the time itself.
        seen = time if kind == STRIKE and foot.held else foot.since - self.offline.stays if kind == OFF else -math.inf
        told_so, at, foot.held = seen > at, max(at, seen), False
        rise = curve.rise
        curve.anew()
        if foot.last is not None and foot.last[0] != kind:
            before = foot.last[1]
            heights = self._heights(foot, before, at)
            height = float(np.nanmean(heights)) if np.isfinite(heights).any() else math.nan
            self._rises[kind].append(rise_of_foot(self._heights(foot, *(before + share * (at - before) for share in LEVEL_IN))))
            if kind == OFF:
                self._stood(foot, before, at)
            # Up stairs each is higher than the one before; so both of the changes count.
            lift = (height - foot.height) * (1.0 if kind == STRIKE else -1.0)
            if math.isfinite(lift):
                self._lifts.append(lift)
            foot.height = height
        foot.now(kind, at)
        foot.swung(kind, rise)
        if not told_so:
            self._waiting.append(_ToldStep(foot, kind, turned, at))
        # What turned before the first frame was not seen to turn, and what is long ago is not told as if it were now.
        return (
            None
            if at < self._began
            else LiveEvent(KINDS[kind], _SIDE[foot.side], at, time - at, self.offline.moved_sigma if told_so else foot.sd(kind))
        )

    def _stood(self, foot: _LiveFoot, strike: float, off: float) -> None:
        """What a foot that stood says of the floor: the middle of a stance, in which neither heel nor toe turns."""
        begins, ends = (strike + share * (off - strike) for share in (0.3, 0.6))
        heel = 0 if foot.side == "L" else 2
        moved = [self._at(place, ends) - self._at(place, begins) for place in (heel, 4)]
        if ends > begins and math.isfinite(moved[0][0] + moved[1][0]):
            self._slid.append(slides(moved[0], moved[1], self._ahead[0]))
            self._floors.append(moved[0] / (ends - begins))

    def _heights(self, foot: _LiveFoot, begins: float, ends: float) -> Floats:
        """(T, 2) m, of heel and toe between two times."""
        first = 0 if foot.side == "L" else 2
        return np.array([row[first : first + 2, 2] for at, row in self._kept if begins <= at <= ends]).reshape(-1, 2)

    def _learn(self, time: float) -> Iterator[bool]:
        """What the recording's rules say of events that are over, from the curves on both sides of them; False after each part."""
        due = [told for told in self._waiting if told.time + self.rules.behind[1] <= time]
        self._waiting = deque(told for told in self._waiting if told.time + self.rules.behind[1] > time)
        self._learned = time
        kept = [(at, row) for at, row in self._kept if at >= due[0].time - self.rules.behind[0]]
        if len(kept) < 3:
            return
        times = np.array([at for at, _ in kept])
        # Frames that come in bursts must not make a grid as fine as their times are near.
        rate = min(1.0 / float(np.median(np.diff(times))), 4.0 * len(kept) / (times[-1] - times[0]))
        rows = np.round((times - times[0]) * rate).astype(int)
        positions = np.full((rows[-1] + 1, 5, 3), np.nan)
        positions[rows] = [row for _, row in kept]
        try:
            feet = feet_of(Recording(positions, ("LHEE", "LTOE", "RHEE", "RTOE", "SACR"), rate))
        except AsterismError:
            return
        for side in sorted({told.foot.side for told in due} & set(feet.sides)):
            yield False
            events = events_by_markers(feet, side, self.offline, self.on_treadmill)
            for told in due:
                own = [(times[0] + event.time, event.sigma) for event in events if event.label == told.kind and told.foot.side == side]
                at, sigma = min(own, key=lambda one: abs(one[0] - told.time), default=(math.inf, 0.0))
                if abs(at - told.time) < self.offline.near:
                    told.foot.judged(told, float(at), sigma)
