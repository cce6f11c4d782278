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
from asterism.live.analysis import LiveEvent
from asterism.live.walking._step_kernels import followed, nearer_exchanged
from asterism.live.walking.carried_point import FASTER, CarriedPoint
from asterism.live.walking.foot import PLACES, LiveFoot, ToldStep
from asterism.live.walking.rules import KINDS, LiveEventRules
from asterism.recording import Floats, Recording

_SIDE = {"L": "left", "R": "right"}
_PELVIS = 4
"""Its row in what is kept of a frame, (5, 3) m; before it are `PLACES` of the feet."""
_MOST_KEPT = 4000
"""Frames of feet that are kept: 3 s at 1,000 Hz, 1 MB. At half, faster cameras judge fewer steps; at double the same."""


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
        self.feet: dict[str, LiveFoot] = {}
        self._pelvis = CarriedPoint([], [], self.rules)
        self._walked = self._lay = 0.0
        self._begin()
        # Compiled, and the sets' files read, before the first frame, which must not wait for it.
        markers_of_feet(("LHEE",))
        followed(np.zeros((2, 3)), np.eye(3), 0.01, self.rules.jerk, np.zeros(2), self.rules.noise**2)
        CarriedPoint([0], [], self.rules).push(np.zeros((1, 3)), 0.01)
        nearer_exchanged(*np.zeros((3, 2, 2, 3)), 0.01)

    def _begin(self) -> None:
        """A new stream."""
        self._time = self._began = math.nan
        self._ahead = np.full((2, 2), np.nan)
        # A clock that hardly goes on must not fill the memory.
        self._kept: deque[tuple[float, Floats]] = deque(maxlen=_MOST_KEPT)
        self._waiting: deque[ToldStep] = deque()
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
        return self._at(PLACES["L" if side == "left" else "R"][OFF], time)

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
        seen = [(at, row[_PELVIS]) for at, row in self._kept if begin <= at <= end and math.isfinite(row[_PELVIS, 0])]
        times = np.diff([begin, *(at for at, _ in seen), end])
        ways = np.linalg.norm(np.diff([place for _, place in seen], axis=0), axis=1) if len(seen) > 1 else np.zeros(0)
        return bool((times <= self.rules.pause).all() and (ways <= self.rules.jump + FASTER * times[1:-1]).all())

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
        few = self._shown < self.rules.seen
        # After some frames all markers that are worn have been seen often enough, and nothing is left to count.
        if few.any() and (counted := few & np.isfinite(points[:, 0])).any():
            self._shown = self._shown + counted
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
        self.feet = {side: LiveFoot(side, columns, helpers[side], self.rules, self.offline) for side in SIDES if side in columns.heels}
        self._pelvis = CarriedPoint(columns.pelvis, [], self.rules)

    def _frame(self, time: float, step: float, points: Floats) -> list[LiveEvent]:
        since = 0.0 if math.isnan(step) else step
        pelvis = self._pelvis.push(points, since)
        row = np.full((5, 3), np.nan)
        row[_PELVIS] = pelvis
        for foot in self.feet.values():
            for kind, place in foot.rows.items():
                row[place] = foot.places[kind].push(points, since)
        places = row.tolist()
        self._heading(places, step)
        self._kept.append((time, row))
        while self._kept[0][0] < time - 2.0 * sum(self.rules.behind):
            self._kept.popleft()
        if not math.isfinite(step):
            return []
        self._size(places, step)
        found = list[LiveEvent]()
        (once_x, once_y), (twice_x, twice_y) = self._ahead.tolist()
        ahead_x, ahead_y = 2.0 * once_x - twice_x, 2.0 * once_y - twice_y
        length = max(float(np.hypot(ahead_x, ahead_y)), 1e-9)
        ahead_x, ahead_y = ahead_x / length, ahead_y / length
        self._put_right(row, step)
        places = row.tolist()
        pelvis_x, pelvis_y, _ = places[_PELVIS]
        for foot in self.feet.values():
            foot.follow([places[place] for place in foot.rows.values()], time, step)
            for kind, place in foot.rows.items():
                curve = foot.curves[kind]
                x, y, height = places[place]
                ahead = (x - pelvis_x) * ahead_x + (y - pelvis_y) * ahead_y
                curve.push(time, step, ahead, height, foot.places[kind].hidden)
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

    def _heading(self, places: list[list[float]], step: float) -> None:
        """Where the feet point: smoothed twice, so that a steady turn is not late. The places (5, 3) m are those of a frame."""
        x = y = 0.0
        for foot in self.feet.values():
            heel, toe = places[foot.rows[STRIKE]], places[foot.rows[OFF]]
            if math.isfinite(toe[0] - heel[0]):
                x, y = x + (toe[0] - heel[0]), y + (toe[1] - heel[1])
        length = float(np.hypot(x, y))
        if length < 1e-6:
            return
        unit = (x / length, y / length)
        once, twice = self._ahead.tolist()
        if not math.isfinite(once[0]) or not math.isfinite(step):
            self._ahead[:] = unit
            return
        share = 1.0 - math.exp(-step * 2.0 * math.pi * TURNING)
        for k in range(2):
            once[k] += share * (unit[k] - once[k])
            self._ahead[:, k] = once[k], twice[k] + share * (once[k] - twice[k])

    def _size(self, places: list[list[float]], step: float) -> None:
        """Follow the floor, the height of the pelvis, and whether it is above the feet, by the places (5, 3) m of a frame."""
        heels = [heel for heel in (places[rows[STRIKE]] for rows in PLACES.values()) if math.isfinite(heel[0])]
        pelvis = places[_PELVIS]
        if not heels or math.isnan(pelvis[0]):
            return
        lowest, share = min(heel[2] for heel in heels), min(step, 1.0)
        limb = [pelvis[k] - sum(heel[k] for heel in heels) / len(heels) for k in range(3)]
        self._floor = lowest if math.isnan(self._floor) else min(lowest, self._floor + self.rules.climbs * step)
        height, upright = pelvis[2] - self._floor, limb[2] / max(math.hypot(*limb), 1e-9)
        self.leg_length = height if math.isnan(self.leg_length) else self.leg_length + share * (height - self.leg_length)
        self._upright = upright if math.isnan(self._upright) else self._upright + share * (upright - self._upright)
        lies = self._upright < self.rules.upright
        self._walked, self._lay = self._walked + step * (not lies), self._lay + step * lies

    def _goes_backwards(self, time: float, pelvis: Floats) -> bool:
        kept = (row[_PELVIS] for at, row in self._kept if at >= time - self.rules.backwards_in)
        first = next((place for place in kept if math.isfinite(place[0])), None)
        if first is None or not math.isfinite(pelvis[0]):
            return False
        way = (pelvis - first)[:2] @ self._ahead[0]
        # On a treadmill only the feet tell: who walks backwards has them higher between strike and off than between off and strike.
        in_the_air = len(self._lifts) > 3 and float(np.median(self._lifts)) < -self.rules.lower
        return bool(way < -self.rules.backwards * self.leg_length) or in_the_air

    def _put_right(self, row: Floats, step: float) -> None:
        """Give left and right foot their own places again where a frame has each where the other one goes. Writes the row."""
        feet, before = row[:_PELVIS].reshape(2, 2, 3), self._before
        nearer = nearer_exchanged(feet, before, self._speeds, step)
        if math.isnan(nearer):
            self._before, self._speeds = feet.copy(), np.zeros_like(feet)
            return
        if nearer > self.rules.jump:
            self._exchanged += step
            # Who is wrong for so long was right: then it is what came before that was exchanged.
            if self._exchanged < self.rules.pause:
                row[:_PELVIS] = feet[::-1].reshape(-1, 3)
                feet = row[:_PELVIS].reshape(2, 2, 3)
            else:
                for foot in self.feet.values():
                    foot.clear()
                before = feet
        else:
            self._exchanged = 0.0
        self._before, self._speeds = feet.copy(), (feet - before) / step

    def _told(self, foot: LiveFoot, kind: str, time: float) -> LiveEvent | None:
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
            self._waiting.append(ToldStep(foot, kind, turned, at))
        # What turned before the first frame was not seen to turn, and what is long ago is not told as if it were now.
        return (
            None
            if at < self._began
            else LiveEvent(KINDS[kind], _SIDE[foot.side], at, time - at, self.offline.moved_sigma if told_so else foot.sd(kind))
        )

    def _stood(self, foot: LiveFoot, strike: float, off: float) -> None:
        """What a foot that stood says of the floor: the middle of a stance, in which neither heel nor toe turns."""
        begins, ends = (strike + share * (off - strike) for share in (0.3, 0.6))
        moved = [self._at(place, ends) - self._at(place, begins) for place in (foot.rows[STRIKE], _PELVIS)]
        if ends > begins and math.isfinite(moved[0][0] + moved[1][0]):
            self._slid.append(slides(moved[0], moved[1], self._ahead[0]))
            self._floors.append(moved[0] / (ends - begins))

    def _heights(self, foot: LiveFoot, begins: float, ends: float) -> Floats:
        """(T, 2) m, of heel and toe between two times."""
        ends_of = list(foot.rows.values())
        return np.array([row[ends_of, 2] for at, row in self._kept if begins <= at <= ends]).reshape(-1, 2)

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
