"""Frame rates and lengths of videos in; whether their frames come apart before they end, out."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

_MOST_APART = 0.5
"""Frames that two videos may come apart by their rates: as far as the nearest frames of cameras without a common trigger are, too."""


def rates_apart(names: Sequence[str], rates: Sequence[float], lengths: Sequence[int]) -> tuple[str, str] | None:
    """The slowest of several videos, and a sentence, where frames with one number come apart by more than half a frame; else None.

    names, rates (frames per second, NaN where unknown) and lengths (frames) of the cameras. 30 and 29.97 frames/s are 3.6 frames apart
    after two minutes: what counts is how far, not how different the rates are.

    >>> rates_apart(["a", "b"], [30.0, 29.97], [3600, 3600])[1]
    'camera b has 29.97 frames/s, a 30: at the end of 3600 frames they are 3.6 frames apart.'
    >>> rates_apart(["a", "b"], [30.0, 29.97], [300, 300])
    """
    known = [c for c, rate in enumerate(rates) if isfinite(rate) and rate > 0]
    if len(known) < 2:
        return None
    slow, fast = min(known, key=lambda c: rates[c]), max(known, key=lambda c: rates[c])
    frames = min(lengths[slow], lengths[fast])
    apart = (rates[fast] / rates[slow] - 1.0) * frames
    if apart <= _MOST_APART:
        return None
    return names[slow], (
        f"camera {names[slow]} has {rates[slow]:.6g} frames/s, {names[fast]} {rates[fast]:.6g}: "
        f"at the end of {frames} frames they are {apart:.1f} frames apart."
    )
