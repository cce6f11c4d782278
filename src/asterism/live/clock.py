"""Times on a source's clock and when they arrived here in; which frames were lost, and how long each was on its way, out."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from asterism.recording import Ints

WINDOW = 10.0
"""s over which the fastest frame stands for the way without waiting. Half of it calls a slow second the usual one; twice as long hides that
clocks drift by a millisecond a minute."""
BUCKET = 0.5
"""s of frames that share their fastest one, so that memory is twenty numbers at any rate. Twice as long forgets in jumps of a second."""
JUMP = 1.0
"""s by which a clock that is set anew differs from what is expected. Networks seldom hold a frame back for so long. Half of it is a pause
that a busy machine makes; with twice as much a clock that was set by a second counts as a delay for ten seconds."""
_WINDOW = 1000
"""Numbers by which a late frame may be behind: 5 s at 200 Hz, longer than networks hold one back. Half of it does as well; with twice as
much a sender that begins anew in its first 10 s, and not 5, loses four frames until that is believed."""
_IN_A_ROW = 5
"""Late frames, each the next of the one before, after which a source began anew. Half of them a network can hold back together; with twice
as many ten frames are lost where a sender was started again."""


class RecentMost:
    """The greatest of the values of the last ten seconds. O(1) a value, twenty numbers.

    >>> recent = RecentMost()
    >>> for at, value in ((0.0, 3.0), (0.1, 5.0), (7.0, 2.0), (12.0, 1.0)):
    ...     recent.add(at, value)
    >>> recent.most
    2.0
    """

    def __init__(self) -> None:
        self._buckets: deque[tuple[float, float]] = deque()
        """(begin s, the greatest value) of each half second"""
        self.most = -math.inf
        """The greatest one; minus infinity where there is none."""

    def add(self, at: float, value: float) -> None:
        """Take a value at a time, s; times grow."""
        if self._buckets and at - self._buckets[-1][0] < BUCKET:
            begun, most = self._buckets[-1]
            if value > most:
                self._buckets[-1] = begun, value
        else:
            self._buckets.append((at, value))
        if self._buckets[0][0] < at - WINDOW:
            while self._buckets[0][0] < at - WINDOW:
                self._buckets.popleft()
            self.most = max(value for _, value in self._buckets)
        elif value > self.most:
            self.most = value

    def clear(self) -> None:
        """Forget all of them."""
        self._buckets.clear()
        self.most = -math.inf


@dataclass
class SourceClock:
    """Compares a source's clock with this machine's, whose zeros and speeds differ.

    The fastest frame of the last ten seconds is held for one that did not wait; what others took longer is their lateness. A clock that
    jumps is begun anew and counted. O(1) a frame, bounded memory. Offset and drift with their uncertainty are told by `CameraClock`.

    >>> clock = SourceClock()
    >>> [round(clock.lateness(time, time + 50.0 + late), 3) for time, late in ((0.0, 0.002), (0.01, 0.0), (0.02, 0.03))]
    [0.0, 0.0, 0.03]
    """

    jumps: int = 0
    _ahead: RecentMost = field(default_factory=RecentMost)
    """s that the source's clock is ahead of this machine's when its frames come: most for the fastest"""
    _last: tuple[float, float] | None = None

    @property
    def offset(self) -> float:
        """s that this machine's clock is ahead of the source's, its fastest way included; NaN before the first frame."""
        return math.nan if self._last is None else -self._ahead.most

    def lateness(self, time: float, arrived: float) -> float:
        """How much longer than the fastest frame this one was on its way, s; at least 0."""
        # Between two frames both clocks go on by as much, unless one was set.
        if self._last is not None and abs((time - self._last[0]) - (arrived - self._last[1])) > JUMP + _pause(arrived - self._last[1]):
            self._ahead.clear()
            self.jumps += 1
        self._last = (time, arrived)
        self._ahead.add(arrived, time - arrived)
        return max(0.0, arrived - time - self.offset)


def _pause(since: float) -> float:
    """s by which the clocks of two machines may differ after so long without a frame: a thousandth, ten times what quartz is off by."""
    return 1e-3 * since


@dataclass
class FrameCount:
    """Counts the frames of a source by their numbers.

    received  frames that were taken
    lost      numbers that were passed over, and did not come later
    late      frames that came after a later one, or twice: they are not used
    restarts  times that the numbers began anew
    others    frames of a second sender behind the same address, whose numbers go on beside: they are not used, but for the first one

    >>> count = FrameCount()
    >>> [count.takes(number) for number in (7, 8, 11, 10, 11)], count.lost, count.late
    ([True, True, True, False, False], 1, 2)
    """

    received: int = 0
    lost: int = 0
    late: int = 0
    restarts: int = 0
    others: int = 0
    _last: int | None = None
    _behind: int = 0
    _before: int = 0
    _beside: int | None = None
    """the last of the numbers from which these jumped away, or that go on beside"""
    _jump: tuple[int, int] | None = None
    """lost ones and restarts that were counted for the jump, while nothing shows that the numbers before it go on"""
    _heard: int = 0
    """frames that were taken up to when one of those was heard"""
    _in_a_row: int = 0
    _missing: set[int] = field(default_factory=set)
    """the latest of the lost ones, which may still come"""

    def takes(self, number: int, *, silent: bool = False) -> bool:
        """Whether a frame of this number is a new one; silent: nothing came for a second.

        A number that is farther behind than 1000, or farther ahead than ten times that, is that of a source that began anew: nothing was
        lost. So are late ones that follow each other, since a network delays one frame or two, and not a row of them; and one after a
        silence, for which no network holds a frame back. Where the numbers from which they jumped go on, there are two senders, and the
        first is heard until the second sends five frames in a row.
        """
        if self._last is not None:
            ahead = number - self._last
            if abs(ahead) >= _WINDOW and not silent and self._goes_on_beside(number):
                return self._of_another(number)
            self._in_a_row = 0
            if number in self._missing and not silent:
                # Who begins anew sends numbers again that were there; this one was not.
                self._missing.discard(number)
                self._before, self.lost, self.late = number, self.lost - 1, self.late + 1
                return False
            self._behind = 0 if ahead > 0 else self._behind + 1 if number == self._before + 1 else 1
            self._before = number
            if -_WINDOW < ahead <= 0 and self._behind < _IN_A_ROW and not silent:
                self.late += 1
                return False
            lost, restarts = (ahead - 1, 0) if 0 < ahead <= 10 * _WINDOW else (0, 1)
            self.lost, self.restarts = self.lost + lost, self.restarts + restarts
            if not 0 < ahead < _WINDOW:
                self._missing.clear()
            elif lost:
                kept = {missing for missing in self._missing if missing > number - _WINDOW}
                self._missing = kept.union(range(self._last + 1, number))
            if abs(ahead) >= _WINDOW:
                self._beside, self._jump, self._heard = self._last, (lost, restarts), self.received
        self._last = number
        self.received += 1
        return True

    def _goes_on_beside(self, number: int) -> bool:
        return self._beside is not None and 0 < number - self._beside < _WINDOW and self.received - self._heard < _WINDOW

    def _of_another(self, number: int) -> bool:
        """Whether a frame is taken that goes on with the numbers beside those that are heard."""
        self._in_a_row += 1
        self._heard = self.received
        if self._jump is None and self._in_a_row < _IN_A_ROW:
            self._beside = number
            self.others += 1
            return False
        # The first sender goes on: there was no jump. Or the one that is heard has ended.
        lost, restarts = self._jump or (0, -1)
        self.lost, self.restarts, self.others = self.lost - lost, self.restarts - restarts, self.others + (self._jump is not None)
        self._last, self._beside, self._jump, self._in_a_row = number, self._last, None, 0
        self._missing.clear()
        self.received += 1
        return True


def rows_of(numbers: ArrayLike) -> Ints:
    """(n,) the frame of a recording in which each frame stands: numbers go on, and where the source began anew the next one follows.

    >>> rows_of([7, 8, 10, 0, 1]).tolist()
    [0, 1, 3, 4, 5]
    """
    steps = np.diff(np.asarray(numbers, dtype=np.int64))
    return np.concatenate([[0], np.cumsum(np.where((steps < 1) | (steps > _GAP), 1, steps))])


_GAP = 10_000
"""Numbers that may lack; a farther one is that of a source that began anew. Half and double do as well: a minute at 200 Hz."""
_STEPS = 128
"""Latest steps between two time stamps, by which their spread is known. Half of them know it badly; twice as many adapt late."""
_TIMING = 0.02
"""Share by which the true rate may differ from the nominal one: 59.94 is called 60. Half of it does as well; with twice as much a sender
that loses one frame in thirty seems to be a slower one."""
_FORGET = 0.02
"""Share of the clock's lead over the numbers that is forgotten with each frame: the difference of two quartz clocks then adds up to a
twentieth of one. With half of it to a tenth; with twice as much two losses in a second do not add up."""


@dataclass
class SampleNumbers:
    """Numbers for the samples of a source that has time stamps and no numbers, so that lost ones leave a gap.

    rate    frames per second that the source says it has
    jumps   times that its clock was set
    late    about how many that counted as lost came after all: of a sender that stops, catches up, and stamps frames as it sends them

    A frame has the next number, unless its time stamp is later than the spread of the time stamps explains. So a sender that stamps badly
    has few gaps, and one that stamps well has one for each frame that is lost. Cameras, which may halve their rate in the dark, are
    numbered by `NumbersByTime`. O(1) a frame, bounded memory.

    >>> numbers = SampleNumbers(100.0)
    >>> [numbers.next(time, time) for time in (5.0, 5.01, 5.021, 5.05, 5.06)]
    [0, 1, 2, 5, 6]
    """

    rate: float
    jumps: int = 0
    late: float = 0.0
    _missing: float = 0.0
    """lost ones of the latest frames"""
    _steps: deque[float] = field(default_factory=lambda: deque(maxlen=_STEPS))
    _last: tuple[float, float] | None = None
    _number: int = 0
    _due: float = 0.0
    """the number by the time alone"""
    _period: float = float("nan")
    _spread: float = 0.1
    """standard deviation of a time stamp, in frames"""
    _since: int = 0

    @property
    def spread(self) -> float:
        """Standard deviation of a time stamp, in frames; beyond a sixth the loss of a single frame is not seen at once."""
        return self._spread

    @property
    def measured_rate(self) -> float:
        """Frames per second, by the latest steps; NaN before there are enough."""
        step = self._step() if len(self._steps) == _STEPS else float("nan")
        return 1.0 / step if step > 0 else float("nan")

    def _step(self) -> float:
        """s from frame to frame: of the median and the mean of the latest steps that which is nearer to what is said.

        Losses move the mean alone, and stamps of a sender that stops and catches up the median alone; another rate moves both.
        """
        steps = np.array(self._steps)
        return min(float(np.median(steps)), float(np.mean(steps)), key=lambda step: abs(step * self.rate - 1.0))

    @property
    def is_off(self) -> bool:
        """Whether the source sends at another rate than it says, which makes gaps where nothing was lost."""
        return abs(self.measured_rate / self.rate - 1.0) > _TIMING

    def next(self, time: float, arrived: float) -> int:
        """The number of the next frame. time: its stamp, s; arrived: s on this machine's clock."""
        if self._last is None:
            self._last, self._period = (time, arrived), 1.0 / self.rate
            return 0
        step, waited = time - self._last[0], arrived - self._last[1]
        self._last = (time, arrived)
        self._number += 1
        # A frame cannot be seconds older than the last one, nor come sooner after it than they were taken.
        if step < -JUMP or step - waited > JUMP + _pause(waited):
            self.jumps += 1
            self._due = self._number
            return self._number
        self._learn(step)
        self._due += step / self._period
        if (ahead := self._due - self._number) > 0.5 + 3.0 * self._spread:
            self._number += round(ahead)
            self._missing += round(ahead)
        # Stamps that come too soon take no number back, and leave no debt that hides the next loss.
        debt = max(0.0, self._number - 0.5 - 3.0 * self._spread - self._due)
        self._due += debt
        late = min(debt, self._missing)
        self.late += late
        self._missing = (1.0 - _FORGET) * (self._missing - late)
        self._due += _FORGET * (self._number - self._due)
        return self._number

    def _learn(self, step: float) -> None:
        self._steps.append(step)
        self._since += 1
        if self._since % (_STEPS // 4):
            return
        step = self._step()
        self._period = step if abs(step * self.rate - 1.0) < _TIMING else 1.0 / self.rate
        # Nine in ten steps of a normal distribution are within 1.645 standard deviations; a step has the errors of two stamps.
        self._spread = float(np.quantile(np.abs(np.array(self._steps) / self._period - 1.0), 0.9)) / (1.645 * 2**0.5)


_CLOCK_SET = 2.0
"""s by which the time of a coarse clock may be off before the clock counts as set: stamps of whole seconds are off by one. Half of it takes
these for clocks that are set; twice as much follows one that was set by 3 s for a minute."""
_FOLLOWS = 0.05
"""Share of a frame's time by which times that are made follow a coarse clock at most: speeds are wrong by as much. Half of it and double
follow clocks that run apart by far more than clocks do."""


@dataclass
class StreamTimes:
    """The times of frames, also of a sender whose timestamps do not move, or move in steps in which several frames have one.

    By number and rate, or by arrival where there is no rate; behind a clock that moves, so that they stay with it. The clock of Windows, by
    which programs stamp frames, stands still for 16 ms: speeds would be infinite.

    >>> times = StreamTimes(rate=100.0)
    >>> [times.of(number, 0.0, 5.0 + 0.01 * number) for number in (7, 8, 10)], times.made
    ([0.0, 0.01, 0.03], True)
    """

    rate: float
    made: bool = False
    """Whether times had to be made."""
    _said: float = math.nan
    """s that the sender said of the last frame, and below its number, what was told of it, and when it arrived."""
    _number: int = 0
    _told: float = 0.0
    _arrived: float = 0.0

    def of(self, number: int, time: float, arrived: float) -> float:
        """s of the frame, of which the sender said `time`."""
        self.made = self.made or (time == self._said and number > self._number)
        step = (number - self._number) / self.rate if self.rate > 0 else arrived - self._arrived
        told, off = self._told + step, time - self._told - step
        if not self.made or (time != self._said and abs(off) > _CLOCK_SET):
            told = time
        elif number <= self._number:
            # What comes late moves nothing on.
            return told
        elif time != self._said:
            # Of a clock that stands still there is nothing to follow.
            told += min(max(step * off, -_FOLLOWS * step), _FOLLOWS * step)
        self._said, self._number, self._told, self._arrived = time, number, told, arrived
        return told
