"""Times on one camera's clock and when its images arrived here in; offset, drift and how late each image was, out."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from asterism.live.blobs._clock_kernels import fit_line
from asterism.live.clock import BUCKET, JUMP

_KEPT = 120
"""Buckets by which offset and drift are told: a minute, in which quartz warms up by less than it scatters. Half of them tell drift a
third as well; twice as many lag behind a clock that is being slewed."""
_QUARTZ = 1e-4
"""Share by which clocks run apart before anything is measured: 100 ppm, the worst that quartz is sold with. Half of it is doubted by cheap
cameras; twice as much takes twice as long to know a drift."""
_STEP = 0.01
"""s, besides ten times the scatter, by which images come too early, or in two half seconds all too late, where the clock was set by less.
Half of it is what a busy machine makes; with twice as much cameras are moved by up to two frames at 100 Hz for a minute."""
_SCATTER = 1e-3
"""s by which the fastest images scatter, as believed before any came: what a network or USB does. It counts as one half second; a tenth
of it calls the offset of the first second too exact, ten times as much doubts it for a minute."""


class CameraClock:
    """Compares a camera's clock with this machine's, which differ in their zero and speed, while images come.

    The fastest image of each half second is held for one that did not wait. A line through these, in which late ones weigh less, tells
    the offset and the drift, both with a standard deviation. A one-way stream cannot tell the least time that an image is on its way, so
    that is a part of the offset. A clock that jumps is begun anew and counted. O(1) an image, bounded memory.

    >>> clock = CameraClock()
    >>> late = [clock.observe(0.01 * n, 50.0 + 0.01 * n + (0.002 if n % 3 else 0.0)) for n in range(1000)]
    >>> round(late[-2], 4), round(clock.offset(9.99), 4), clock.jumps
    (0.002, 50.0, 0)
    """

    def __init__(self) -> None:
        self.jumps = 0
        self._begin()

    def _begin(self) -> None:
        self._least: deque[list[float]] = deque(maxlen=_KEPT)
        """[time of the fastest image, least difference of the clocks] of each half second"""
        self._bucket = -math.inf
        self._last: tuple[float, float] | None = None
        self._at, self._offset, self._drift, self._spread = 0.0, math.nan, 0.0, _SCATTER
        self._variance = np.diag([math.inf, _QUARTZ**2])
        self._slow = 0

    def observe(self, time: float, arrived: float) -> float:
        """How much longer than the fastest image this one was on its way, s; at least 0."""
        if self._was_set(time, arrived):
            self.jumps += 1
            self._begin()
        self._last = (time, arrived)
        difference = arrived - time
        if arrived - self._bucket >= BUCKET or not self._least:
            if self._least:
                self._fit()
            self._bucket = arrived
            self._least.append([time, difference])
        elif difference < self._least[-1][1]:
            self._least[-1] = [time, difference]
        if len(self._least) == 1:
            self._at, self._offset = self._least[0]
        return max(0.0, difference - self.offset(time))

    def _was_set(self, time: float, arrived: float) -> bool:
        if self._last is None:
            return False
        since = arrived - self._last[1]
        # Between two images both clocks go on by as much; and no image comes earlier than the fastest.
        early = self.offset(time) - (arrived - time) if len(self._least) > 2 else 0.0
        return abs(time - self._last[0] - since) > JUMP + 10 * _QUARTZ * abs(since) or early > _STEP + 10 * self._spread or self._slow >= 2

    def offset(self, time: float) -> float:
        """s that this machine's clock is ahead of the camera's at a time (s) of the camera's, its fastest way included; NaN at first."""
        return self._offset + self._drift * (time - self._at)

    def offset_sd(self, time: float) -> float:
        """s, standard deviation of that."""
        apart = time - self._at
        return math.sqrt(self._variance[0, 0] + 2 * apart * self._variance[0, 1] + apart**2 * self._variance[1, 1])

    @property
    def last_time(self) -> float:
        """s on the camera's clock, of its last image; NaN where none came."""
        return math.nan if self._last is None else self._last[0]

    @property
    def drift_ppm(self) -> float:
        """By how many millionths this machine's clock is faster."""
        return 1e6 * self._drift

    @property
    def drift_sd_ppm(self) -> float:
        """Standard deviation of that; 100 where nothing is known yet."""
        return 1e6 * math.sqrt(self._variance[1, 1])

    def _fit(self) -> None:
        """The line through the fastest images of the buckets, with a drift of 0 +- 100 ppm as what is believed before."""
        # Of one layout, however many there are: the kernel is compiled for each.
        times, least = np.ascontiguousarray(np.array(self._least).T)
        slow = len(least) > 2 and least[-1] - self.offset(float(times[-1])) > _STEP + 10 * self._spread
        self._slow = self._slow + 1 if slow else 0
        self._at = float(times[-1])
        self._offset, self._drift, self._spread = fit_line(times - self._at, least, _SCATTER, _QUARTZ, self._variance)


def compile_fit() -> None:
    """Compile the kernel of `CameraClock`, or load it, so that no image waits for it: a second the first time."""
    clock = CameraClock()
    for at in (0.0, BUCKET):
        clock.observe(at, at)


def same_clock(one: CameraClock, other: CameraClock, most: float) -> bool:
    """Whether two cameras' times are of one clock: zeros less apart than images may be on their way, and no drift that shows.

    most: s that an image is on its way at most. Two clocks that were started by hand or by a switch are as near to each other once in
    hundreds of times; where they are not one, their drift tells it after some time.
    """
    apart = abs(one.offset(one.last_time) - other.offset(other.last_time))
    drift, sd = abs(one.drift_ppm - other.drift_ppm), math.hypot(one.drift_sd_ppm, other.drift_sd_ppm)
    return apart <= most and drift <= 5 * sd
