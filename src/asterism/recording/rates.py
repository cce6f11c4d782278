"""Times of frames in; how many frames there are in a second, and how surely the times say so, out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from asterism.recording.arrays import Floats

TICK = 0.0156
"""s of the coarsest clock by which programs stamp frames, that of Windows. Half of it believes four stamps of such a clock, which are off
by a twentieth; with twice as much the rate of a slow sender takes a frame or two more."""
TO_RATE = 30
"""Frames by which the rate is known to 1 % at 100 Hz, whatever clock stamps them. Half of them tell it three times as badly; with twice as
many a live session begins 0.3 s later."""
_PARTS = 16
"""Parts of a recording whose rates are compared, each of `TO_RATE` frames at least: seven of them may be spoilt by a clock that is set or a
sender that pauses. Half of the parts bear three; twice as many are as good where there are frames enough."""
_SCATTER = 0.5
"""Steps, or ticks where these are longer, by which stamps may scatter about a line: up to it frames keep their order. Where they scatter
more, times are no line, as where the clock was set or the sender paused, and the middle step counts. Half of it takes bad stamps for a
pause; twice as much takes pauses of half a second for a slower sender."""
_DIGITS = 6
"""Digits of a rate: quartz clocks agree to five. Half of them call 59.94 another rate; with twice as many 100 is 99.9999999."""


@dataclass(frozen=True)
class RateOfTimes:
    """What times say of the rate.

    rate  frames per second, the whole number where the times agree with one; NaN where they do not grow
    step  s from frame to frame, 0 or less where the times do not grow
    sd    s, standard deviation of the step, were the stamps those of the coarsest clock; infinite where they are too few, or no line
    """

    rate: float
    step: float
    sd: float


def rate_of_times(numbers: ArrayLike, times: ArrayLike) -> RateOfTimes:
    """The rate of frames by straight lines through their times.

    numbers  (n,) of the frames, which grow; what is missing was lost
    times    (n,) s, all finite

    The middle step alone would be wrong: whole milliseconds of 120 Hz are steps of 8, 8 and 9. Of long recordings the middle line of 16
    counts, so that pauses, and clocks that are set, change nothing. O(n).

    >>> rate_of_times(range(31), [int(1000 * n / 120) / 1000 for n in range(31)]).rate
    120.0
    """
    frames, clock = np.asarray(numbers, dtype=np.float64), np.asarray(times, dtype=np.float64)
    if len(frames) < 2:
        return RateOfTimes(np.nan, 0.0, np.inf)
    parts = max(1, min(_PARTS, len(frames) // TO_RATE))
    lines = [_line(*each) for each in zip(np.array_split(frames, parts), np.array_split(clock, parts), strict=True)]
    step, scatter, spread = np.median(lines, axis=0).tolist()
    if np.isinf(scatter):
        step = float(np.median(np.diff(clock) / np.diff(frames)))
    sd, surest = (max(scatter, least) / (spread * parts) ** 0.5 for least in (TICK / 12**0.5, 0.0))
    return RateOfTimes(_rate(step, surest), step, sd)


def _line(frames: Floats, clock: Floats) -> tuple[float, float, float]:
    """The step of the straight line with the least squares; s by which the times scatter about it, infinite where they are none; spread."""
    x, y = frames - frames.mean(), clock - clock.mean()
    spread = float(x @ x)
    step = float(x @ y) / spread
    scatter = float(np.sqrt(((y - step * x) ** 2).sum() / max(1, len(frames) - 2)))
    is_line = len(frames) > 2 and scatter <= _SCATTER * max(step, TICK)
    return step, scatter if is_line else np.inf, spread


def _rate(step: float, sd: float) -> float:
    """Frames per second, the whole number where the step agrees with one within two standard deviations."""
    if not step > 0:
        return np.nan
    rate = float(f"{1.0 / step:.{_DIGITS}g}")
    # A part of a thousand at most: 59.94 is not 60.
    return float(round(rate)) if abs(rate - round(rate)) <= min(2.0 * sd / step, 5e-4) * rate else rate
