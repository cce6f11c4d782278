"""Curves over the gait cycle in; small pictures of them, as SVG that needs no script and prints as it stands, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from itertools import pairwise

import numpy as np

from asterism.recording import Floats, Ints
from asterism.report.figures import SIDES

_WIDTH, _HEIGHT = 3600, 1900
"""Units of a picture; ten of them are about a pixel, so that whole numbers are exact enough."""
_LEFT, _TOP, _BOTTOM, _PER_PERCENT = 430, 60, 1660, 31
"""Where the axes are: 0 % at the left, the highest and the lowest value, and the units of one percent."""
_RIGHT = _LEFT + 100 * _PER_PERCENT

_FEW = 10
"""Cycles of a side that are drawn as they are; more of them are fainter, so that all together are as dark. At half, six walks are pale."""
_MOST = 60
"""Cycles of a side that are drawn, evenly chosen of more; means are of all. At half, one minute on a treadmill has too few, at double the
page of ten such walks is twice as large."""


@dataclass(frozen=True)
class CycleCurve:
    """One cycle's curve (101,), its name ("walk 2, cycle 1"), and where the player shows it: recording, its first and last frame.

    counts  whether it is in the mean; it is drawn paler where not
    """

    values: Floats
    name: str = ""
    place: tuple[int, int, int] | None = None
    counts: bool = True


@dataclass(frozen=True)
class CurvesOfSide:
    """What a panel shows of one foot.

    side      "left" or "right"
    cycles    of that foot
    off       %, where it leaves the floor, the mean over the cycles; None where it is not drawn
    interval  (101,) each: what the measurement leaves open about the mean, low and high; not drawn of the earlier session
    earlier   whether they are of the first of two sessions, which is drawn paler
    """

    side: str
    cycles: Sequence[CycleCurve]
    off: float | None = None
    interval: tuple[Floats, Floats] | None = None
    earlier: bool = False

    @cached_property
    def mean(self) -> Floats:
        """(101,) over the cycles that count and in which the curve is known; NaN where none is."""
        curves = np.stack([one.values for one in self.cycles])
        known = np.isfinite(curves) & np.array([one.counts for one in self.cycles])[:, None]
        curves = np.where(known, curves, 0.0)
        return np.where(known.any(axis=0), curves.sum(axis=0) / np.maximum(known.sum(axis=0), 1), np.nan)


@dataclass(frozen=True)
class CyclePanel:
    """One picture: title, which says what is positive, unit, the curves of each foot, and the band (101,) of controls, low and high."""

    title: str
    unit: str
    sides: Sequence[CurvesOfSide]
    control: tuple[Floats, Floats] | None = None
    notes: Sequence[str] = field(default=())


def drawn_panels(panels: Sequence[CyclePanel], sessions: tuple[str, str] | None = None, interval: str = "95 % interval") -> str:
    """The panels as HTML, three beside each other where there is room, below a legend of what they have. O(points).

    sessions  the names of two; interval: what the legend calls the curves' intervals
    """
    leads = any(cycle.place for panel in panels for one in panel.sides for cycle in one.cycles)
    hint = '<p class="screen">Click a curve: the player below goes to this moment of its cycle.</p>' if leads else ""
    return (
        f'<div class="keys">{_legend(panels, sessions, interval)}</div>\n{hint}<div class="panels">\n{"".join(map(_panel, panels))}</div>'
    )


def _legend(panels: Sequence[CyclePanel], sessions: tuple[str, str] | None, interval: str) -> str:
    """A swatch and a word for each kind of line and band that is drawn."""
    shown = [one for panel in panels for one in panel.sides if one.cycles]
    keys = []
    for side, style in SIDES.items():
        dash = ' stroke-dasharray="5 3"' if "dash" in style else ""
        for earlier in (True, False):
            if any(one.side == side and one.earlier == earlier for one in shown):
                name = side if sessions is None else f"{side}, {sessions[0] if earlier else sessions[1]}"
                look = f'stroke="{style["color"]}" stroke-width="{1.4 if earlier else 2.6}" opacity="{0.65 if earlier else 1}"'
                keys.append((f'<path d="M0 6h26" {look}{dash}/>', name))
    thin = f"single cycles, {_MOST} of them at most" if any(len(one.cycles) > _MOST for one in shown) else "each cycle"
    keys.append(('<path d="M0 6h26" stroke="#5b6780" stroke-width="0.8" opacity="0.6"/>', thin))
    if not all(cycle.counts for one in shown for cycle in one.cycles):
        keys.append(('<path d="M0 6h26" stroke="#5b6780" stroke-width="0.8" opacity="0.4"/>', "a cycle of a turn, in no mean"))
    if any(panel.control for panel in panels):
        keys.append(('<rect width="26" height="12" fill="#64748b" opacity="0.25"/>', "controls, mean ± 1 SD"))
    if any(one.interval for one in shown):
        interval = interval if sessions is None else f"{interval}, {sessions[1]}"
        keys.append(
            ('<rect width="26" height="12" fill="#d1344b" opacity="0.2"/><path d="M0 .5h26M0 11.5h26" stroke="#d1344b"/>', interval)
        )
    if any(one.off is not None for one in shown):
        keys.append(('<path d="M13 0v12" stroke="#5b6780" stroke-width="1.4"/>', "foot off"))
    told = [f'<span><svg viewBox="0 0 26 12" aria-hidden="true">{mark}</svg>{escape(name)}</span>' for mark, name in keys]
    # A page draws it, paper does not.
    if any(cycle.place for one in shown for cycle in one.cycles):
        mark = '<path d="M13 0v12" stroke="#5b6780" stroke-dasharray="2 2"/>'
        told.append(f'<span class="screen"><svg viewBox="0 0 26 12" aria-hidden="true">{mark}</svg>the player&#39;s moment</span>')
    return "".join(told)


def _panel(panel: CyclePanel) -> str:
    unit = f" <small>{escape(panel.unit)}</small>" if panel.unit else ""
    if not any(np.isfinite(cycle.values).any() for one in panel.sides for cycle in one.cycles):
        return f'<figure class="panel"><figcaption>{escape(panel.title)} <small>not known in any cycle</small></figcaption></figure>\n'
    low, high, ticks = _axis(panel)
    scale = _Scale(low, high)
    parts = [_grid(scale, ticks)]
    if panel.control is not None:
        parts.append(f'<path class="control" d="{scale.area(*panel.control)}"/>')
    sides = [one for one in panel.sides if one.cycles]
    for one in sides:
        # Of two sessions the later one's alone: four bands hide each other.
        if one.interval is not None and not one.earlier:
            edges = "".join(f'<path class="edge" d="{scale.path(edge)}"/>' for edge in one.interval)
            parts.append(f'<g class="interval {one.side}"><path d="{scale.area(*one.interval)}"/>{edges}</g>')
    for one in sides:
        age = " earlier" if one.earlier else ""
        if one.off is not None:
            at = _LEFT + round(_PER_PERCENT * one.off)
            parts.append(f'<path class="off {one.side}{age}" d="M{at} {_TOP}V{_BOTTOM}"/>')
        # Many cycles would hide their mean, and more than a page can hold would make it slow.
        shown = one.cycles[:: -(-len(one.cycles) // _MOST)]
        parts.append(f'<g opacity="{min(1.0, _FEW / len(shown)):.2f}">')
        for cycle in shown:
            turn = "" if cycle.counts else " turn"
            go = "" if cycle.place is None else ' data-go="{}:{}:{}"'.format(*cycle.place)
            line = scale.path(scale.within(cycle.values))
            parts.append(f'<path class="cycle {one.side}{age}{turn}" d="{line}" data-name="{escape(cycle.name)}"{go}/>')
        parts.append("</g>")
    for one in sides:
        parts.append(f'<path class="mean {one.side}{" earlier" if one.earlier else ""}" d="{scale.path(one.mean)}"/>')
    notes = "".join(f"<small>{escape(note)}</small>" for note in panel.notes)
    return (
        f'<figure class="panel" data-low="{low:g}" data-high="{high:g}" data-unit="{escape(panel.unit)}">'
        f"<figcaption>{escape(panel.title)}{unit}{notes}</figcaption>"
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{escape(_spoken(panel))}">{"".join(parts)}</svg></figure>\n'
    )


def _axis(panel: CyclePanel) -> tuple[float, float, Floats]:
    """The lowest and the highest value that fit, and three to six round ones between them."""
    # A turn by a right angle would leave no room for the rest.
    every_cycle = [(one, cycle) for one in panel.sides for cycle in one.cycles]
    counted = [(one, cycle) for one, cycle in every_cycle if cycle.counts]
    curves = [values for one, cycle in counted or every_cycle for values in (cycle.values, *(one.interval or ()))]
    every = np.concatenate([np.zeros(0), *curves, *(panel.control or ())])
    every = every[np.isfinite(every)]
    low, high = (float(every.min()), float(every.max())) if len(every) else (0.0, 1.0)
    room = 0.06 * (high - low) or max(abs(high), 1.0)
    low, high = low - room, high + room
    raw = (high - low) / 5
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * next(size for size in (1, 2, 5, 10) if size * power >= raw * 0.999)
    return low, high, step * np.arange(np.ceil(low / step), np.floor(high / step) + 1)


@dataclass(frozen=True)
class _Scale:
    low: float
    high: float

    def y(self, values: Floats) -> Floats:
        return _BOTTOM - (_BOTTOM - _TOP) * (np.asarray(values, dtype=np.float64) - self.low) / (self.high - self.low)

    def within(self, values: Floats) -> Floats:
        """The values that are in the picture, NaN elsewhere."""
        with np.errstate(invalid="ignore"):
            return np.where((values >= self.low) & (values <= self.high), values, np.nan)

    def path(self, values: Floats) -> str:
        """A line from 0 to 100 %, broken where the values are."""
        return "".join(f"M{_place(first, heights[0])}{_steps(heights, 1)}" for first, heights in self._runs(values))

    def area(self, low: Floats, high: Floats) -> str:
        """What lies between two curves, as far as both are known."""
        both = np.isfinite(low) & np.isfinite(high)
        below, above = (self._runs(np.where(both, edge, np.nan)) for edge in (low, high))
        return "".join(
            f"M{_place(first, lower[0])}{_steps(lower, 1)}L{_place(first + len(upper) - 1, upper[-1])}{_steps(upper[::-1], -1)}Z"
            for (first, lower), (_, upper) in zip(below, above, strict=True)
        )

    def _runs(self, values: Floats) -> list[tuple[int, Ints]]:
        """Where each unbroken part of a curve begins, %, and its heights."""
        known = np.flatnonzero(np.isfinite(values))
        heights = np.rint(self.y(values[known])).astype(np.int64)
        breaks = [0, *(np.flatnonzero(np.diff(known) > 1) + 1).tolist(), len(known)]
        return [(int(known[begin]), heights[begin:end]) for begin, end in pairwise(breaks) if end > begin]


def _place(percent: int, height: int) -> str:
    return f"{_LEFT + _PER_PERCENT * percent} {height}"


def _steps(heights: Ints, way: int) -> str:
    """From point to point, a percent each: shorter to write than places."""
    step = way * _PER_PERCENT
    return f"l{step} " + f" {step} ".join(map(str, np.diff(heights).tolist())) if len(heights) > 1 else ""


def _grid(scale: _Scale, ticks: Floats) -> str:
    """Lines and numbers of the axes."""
    digits = max(0, -int(np.floor(np.log10(np.diff(ticks).min())))) if len(ticks) > 1 else 1
    heights = np.rint(scale.y(ticks)).astype(int)
    lines = "".join(f"M{_LEFT} {height}H{_RIGHT}" for height in heights)
    across = range(0, 101, 20)
    lines += "".join(f"M{_LEFT + _PER_PERCENT * at} {_TOP}V{_BOTTOM}" for at in across)
    zero = f'<path class="zero" d="M{_LEFT} {scale.y(np.zeros(1))[0]:.0f}H{_RIGHT}"/>' if scale.low < 0 < scale.high else ""
    values = "".join(
        f'<text x="{_LEFT - 50}" y="{height + 45}" text-anchor="end">{tick:.{digits}f}</text>'
        for tick, height in zip(ticks + 0.0, heights, strict=True)
    )
    percents = "".join(
        f'<text x="{_LEFT + _PER_PERCENT * at}" y="{_BOTTOM + 170}" text-anchor="middle">{at}{" %" if at == 100 else ""}</text>'
        for at in across
    )
    return f'<path class="grid" d="{lines}"/>{zero}{values}{percents}'


def _spoken(panel: CyclePanel) -> str:
    """The picture in words, for those who cannot see it."""
    said = [f"{panel.title} in {panel.unit or 'no unit'} over the gait cycle"]
    for one in panel.sides:
        if one.cycles and np.isfinite(one.mean).any():
            mean = one.mean
            lowest, highest = int(np.nanargmin(mean)), int(np.nanargmax(mean))
            said.append(f"{one.side} from {mean[lowest]:.1f} at {lowest} % to {mean[highest]:.1f} at {highest} %")
    return "; ".join(said)
