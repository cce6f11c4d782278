"""Times of images that come without numbers in; numbers that grow by one, and by more where images were lost, out."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

_LEARNED = 30
"""Steps between images by which the rate is known that a camera really has: half a second at 60 Hz. Half of them take a burst after a pause
for the rate; with twice as many a webcam that goes from 60 to 30 Hz in the dark seems to lose each second image for a second."""
_FOLLOWS = 0.1
"""Share of what an image comes late by that the next due time takes over. A tenth follows a clock that is 1 % off to a tenth of an image,
and is moved by a tenth of the scatter of arrivals. Half of it follows half as well; twice as much is moved by twice as much."""


@dataclass
class NumbersByTime:
    """Counts images by their times, as a camera would that numbers each exposure.

    An image that comes a whole period after its due time is the next but one: one was lost. The period is that of the rate until the median
    of the last steps shows another, so that a webcam that halves its rate in the dark loses nothing.

    rate  images per second that the camera says; NaN where it does not: nothing counts as lost before the steps show it

    >>> numbers = NumbersByTime(100.0)
    >>> [numbers.number(time) for time in (5.0, 5.011, 5.02, 5.041, 5.05)]
    [0, 1, 2, 4, 5]
    """

    rate: float = math.nan
    _number: int = -1
    _due: float = math.nan
    """When the last image was due."""
    _last: float = math.nan
    _steps: deque[float] = field(default_factory=lambda: deque(maxlen=_LEARNED))

    @property
    def period(self) -> float:
        """s from image to image; NaN before it is known."""
        if len(self._steps) == _LEARNED:
            return float(np.median(self._steps))
        return 1.0 / self.rate if self.rate > 0 else math.nan

    def number(self, time: float) -> int:
        """The number of the image of this time, s."""
        step = time - self._last
        if not step > 0:
            # A clock that was set back, or two images of one time, of which only the order is known.
            self._number, self._due, self._last = self._number + 1, time, time
            return self._number
        self._steps.append(step)
        self._last = time
        period = self.period
        if math.isnan(period):
            self._number, self._due = self._number + 1, time
            return self._number
        ahead = max(1, round((time - self._due) / period))
        late = time - self._due - ahead * period
        self._number += ahead
        # One that came early after a late one was never lost by more than half a period: the scale is moved back to it.
        self._due = time - late * (1.0 - _FOLLOWS) if late > -0.5 * period else time
        return self._number

    def restarted(self) -> None:
        """The next image is of another clock."""
        self._last = self._due = math.nan
        self._steps.clear()


_TURN = 65535
"""Frames after which GigE Vision 1 begins again at 1, having 16 bits and no frame 0."""


class FrameIds:
    """A camera's own numbers of its frames, going on where those of 16 bits begin again.

    >>> ids = FrameIds()
    >>> [ids.number(number) for number in (65534, 65535, 1, 2)]
    [65534, 65535, 65536, 65537]
    """

    def __init__(self) -> None:
        self._last, self._turns = 0, 0

    def number(self, number: int) -> int:
        """The number of a frame by the camera's."""
        if number < self._last - _TURN // 2 and self._last <= _TURN:
            self._turns += 1
        self._last = number
        return number + self._turns * _TURN
