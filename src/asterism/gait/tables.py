"""Analysed walks in; one table of all numbers, each with its uncertainty and the frames behind it, out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from asterism.files.tables import NumberTable
from asterism.gait.analysis import GaitAnalysis
from asterism.gait.cycles import Cycle, midstances, without_turns
from asterism.gait.intervals import moved_by_events
from asterism.gait.parameters import PARAMETERS, summarise, symmetries
from asterism.recording import Floats

COLUMNS: Mapping[str, type] = {
    "file": str, "kind": str, "name": str, "side": str, "cycle": int, "percent": int, "turns": int, "axis": str, "value": float,
    "uncertainty": float, "unit": str, "deviation": float, "cycles": int, "begins_s": float, "ends_s": float,
    "first_frame": int, "last_frame": int,
}  # fmt: skip
"""Of the table. `deviation` is the standard deviation over `cycles` of a mean; s count from the first frame, frames as the file does.
`turns` is 1 of a cycle in which the person turns: means are of the others, where there are others.

Kinds are "event", "parameter", "mean", "symmetry", "curve", "maximum" and "minimum".
"""


def gait_table(analyses: Sequence[tuple[str, GaitAnalysis]], *, curves: bool = True) -> NumberTable:
    """All numbers of walks, by the names of their files.

    curves  False: without the curves over the cycle and their extremes, which take most of the time and of the rows

    Angles are as uncertain as their bands of another session (`angle_bands`), but for fills and strikes, which are those of this cycle.
    Moments, powers and the ground's force have the uncertainty of `KineticErrors`, muscles that of `envelope_spread`. O(cycles).

    >>> from asterism.gait import analyse_gait
    >>> from asterism.simulation import simulate_walks
    >>> table = gait_table([("walk", analyse_gait(simulate_walks(1, frames=300, markers="helen-hayes", seed=0)[0]))], curves=False)
    >>> sorted({row[1] for row in table.rows})
    ['event', 'mean', 'parameter', 'symmetry']
    """
    return NumberTable(COLUMNS, tuple(row for name, analysis in analyses for row in _rows(name, analysis, curves)))


def _rows(file: str, analysis: GaitAnalysis, curves: bool) -> Iterator[tuple[Any, ...]]:
    recording = analysis.recording

    def frames_of(begins: Any, ends: Any) -> tuple[Any, Any]:
        # A time that is a frame's, but for the last digit, is of this frame alone.
        places = np.round([begins * recording.rate, ends * recording.rate], 6)
        return recording.first_frame + np.floor(places[0]).astype(int), recording.first_frame + np.ceil(places[1]).astype(int)

    def row(kind: str, name: str, value: float, sigma: float | None, unit: str, begins: float, ends: float, **more: Any) -> tuple[Any, ...]:
        cells = {"side": None, "cycle": None, "turns": None, "percent": None, "axis": None, "deviation": None, "cycles": None} | more
        first, last = map(int, frames_of(begins, ends))
        cells |= {"file": file, "kind": kind, "name": name, "value": float(value), "unit": unit, "begins_s": float(begins)}
        cells |= {"uncertainty": _known(sigma), "ends_s": float(ends), "first_frame": first, "last_frame": last}
        return tuple(cells[column] for column in COLUMNS)

    walking = analysis.walking
    for event in sorted((*walking.events, *midstances(walking)), key=lambda one: one.time):
        yield row("event", event.label, event.time, event.sigma, "s", event.time, event.time, side=event.side)
    numbers = {(side, one.strike.time): n + 1 for side in "LR" for n, one in enumerate(_of_side(analysis.cycles, side))}
    for one in analysis.parameters:
        its: dict[str, Any] = {"side": one.side, "cycle": numbers[one.side, one.begins], "turns": int(one.turns)}
        yield row("parameter", one.name, one.value, one.sigma, PARAMETERS[one.name], one.begins, one.ends, **its)
    spans = {
        side: (own[0].strike.time, own[-1].next_strike.time) for side in "LR" if (own := _of_side(without_turns(analysis.cycles), side))
    }
    for mean in summarise(analysis.parameters):
        more: dict[str, Any] = {"side": mean.side, "deviation": _known(mean.deviation), "cycles": mean.count}
        yield row("mean", mean.name, mean.mean, mean.sigma, mean.unit, *spans[mean.side], **more)
    for symmetry in symmetries(analysis.parameters):
        begins, ends = (edge(span[which] for span in spans.values()) for which, edge in ((0, min), (1, max)))
        yield row("symmetry", symmetry.name, symmetry.value, symmetry.sigma, "%", begins, ends)
    if not curves:
        return
    for name, cycle, values, sigmas, unit in _curves(analysis):
        number = numbers[cycle.side, cycle.strike.time]
        times = np.linspace(cycle.strike.time, cycle.next_strike.time, len(values))
        first, last = (places.tolist() for places in frames_of(times, times))
        seconds = times.tolist()
        for axis, letter in enumerate("xyz"[: values.shape[1]]):
            known = np.flatnonzero(np.isfinite(values[:, axis]))
            if not len(known):
                continue
            places = [("curve", percent) for percent in known.tolist()]
            places += [("maximum", int(known[values[known, axis].argmax()])), ("minimum", int(known[values[known, axis].argmin()]))]
            shown, off = values[:, axis].tolist(), [_known(sigma) for sigma in sigmas[:, axis].tolist()]
            # In the order of `COLUMNS`: nearly all rows are these.
            for kind, here in places:
                yield (
                    file, kind, name, cycle.side, number, here, int(cycle.turns), letter, shown[here], off[here], unit, None, None,
                    seconds[here], seconds[here], first[here], last[here],
                )  # fmt: skip


def _known(value: float | None) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None


def _of_side(cycles: Sequence[Cycle], side: str) -> list[Cycle]:
    return [cycle for cycle in cycles if cycle.side == side]


def _curves(analysis: GaitAnalysis) -> Iterator[tuple[str, Cycle, Floats, Floats, str]]:
    """Each curve of each cycle (101, n) with its standard uncertainty, NaN where that is not known, and unit."""
    bands = analysis.bands if analysis.curves else {}
    for name, angles in analysis.curves.items():
        fills = analysis.fill_sigmas.get(name, np.zeros(angles.shape))
        for number, cycle in enumerate(_of_side(analysis.cycles, name[0])):
            parts = [fills[number], moved_by_events(angles[number : number + 1], [cycle])]
            parts += [part for source, part in bands[name].standard.items() if source in ("measures", "placement")] if name in bands else []
            # Of an angle that has no band, it is not known how certain it is.
            sigma = np.sqrt(sum(part**2 for part in parts)) if name in bands else np.full(angles[number].shape, np.nan)
            yield name, cycle, np.degrees(angles[number]), np.degrees(sigma), "deg"
    per_kg = analysis.kinetics is not None and analysis.kinetics.per_kg
    for name, loads in analysis.loads.items():
        for number, cycle in enumerate(analysis.loaded[name]):
            sigma = analysis.load_sigmas[name][number] if name in analysis.load_sigmas else np.full(loads[number].shape, np.nan)
            yield name, cycle, loads[number], sigma, load_unit(name, per_kg)
    for channel in analysis.emg:
        for side, envelopes in channel.cycles.items():
            for cycle, curve in zip(_of_side(analysis.cycles, side), envelopes, strict=True):
                off = np.nan if channel.spread is None else channel.spread
                sigma = np.hypot(off * curve[:, None], moved_by_events(curve[None, :, None], [cycle]))
                yield f"EMG {channel.name}", cycle, curve[:, None], sigma, channel.unit


def load_unit(name: str, per_kg: bool) -> str:
    """The unit of a moment, power or force by Plug-in-Gait's name."""
    unit = "N m" if name.endswith("Moment") else "W" if name.endswith("Power") else "N"
    return f"{unit}/kg" if per_kg else unit
