"""Markers of a foot or of the pelvis in; where the point between them is, those hidden or wrong too, out."""

from __future__ import annotations

import math

import numpy as np

from asterism.geometry import fit_rigid
from asterism.live.walking._step_kernels import carried_point
from asterism.live.walking.rules import LiveEventRules
from asterism.recording import Floats

_LEAST = 3
"""Markers that place a foot: two leave a turn open."""
FASTER = 5.0
"""m/s by which two markers of a foot differ at most: one turns about the other at 20 rad/s."""


class CarriedPoint:
    """A point of the body by its markers; while they are hidden or wrong, moved as the others of that part move."""

    def __init__(self, columns: list[int], others: list[int], rules: LiveEventRules) -> None:
        self._rules = rules
        self._columns, self._all = np.array(columns, dtype=np.int64), np.array(sorted({*columns, *others}), dtype=np.int64)
        self.clear()

    def clear(self) -> None:
        """Nothing is known of where it is."""
        self._before = self._template = np.full((len(self._all), 3), np.nan)
        self.place, self.hidden, self._strange = np.full(3, np.nan), 0, 0.0
        self._place_in_template = self.place

    def push(self, points: Floats, step: float) -> Floats:
        """(3,) m, by the markers (M, 3) m of a frame, s after the one before; NaN where none of them is known."""
        now, place, carried = np.empty_like(self._before), np.empty(3), np.empty(3)
        # The others say where it is if it moved as they did: the middle one, since one of them may be another marker, too.
        apart = carried_point(points, self._columns, self._all, self._before, self.place, now, place, carried)
        if apart > self._rules.jump + FASTER * step and self._strange < self._rules.jumped and len(self._all) > 2:
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
