"""Analysed walks in; one table of all numbers, each with its uncertainty and the frames behind it, out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from asterism.files.tables import NumberTable
from asterism.gait.analysis import GaitAnalysis
from asterism.gait.cycles import POINTS, Cycle, midstances, without_turns
from asterism.gait.intervals import PLACED
from asterism.gait.parameters import PARAMETERS, summarise, symmetries
from asterism.recording import Floats, shipped_sets

COLUMNS: Mapping[str, type] = {
    "file": str, "kind": str, "name": str, "side": str, "cycle": int, "percent": int, "turns": int, "axis": str, "value": float,
    "uncertainty": float, "unit": str, "deviation": float, "cycles": int, "begins_s": float, "ends_s": float,
    "first_frame": int, "last_frame": int,
}  # fmt: skip
"""Of the table. `deviation` is the standard deviation over `cycles` of a mean; s count from the first frame, frames as the file does.
`turns` is 1 of a cycle in which the person turns: means are of the others, where there are others.

Kinds are "event", "parameter", "mean", "symmetry", "curve", "maximum" and "minimum".
"""
_LEGS = frozenset({"THI", "KNE", "TIB", "ANK", "HEE", "TOE"})
_STEP = 0.001
"""m, by which a marker is moved to see what it does."""


def gait_table(analyses: Sequence[tuple[str, GaitAnalysis]], *, curves: bool = True) -> NumberTable:
    """All numbers of walks, by the names of their files.

    curves  False: without the curves over the cycle and their extremes, which take most of the time and of the rows

    Angles of legs and pelvis are as uncertain as their bands (`angle_bands`), those of trunk, head and arms as markers that are placed
    anew make them; what was filled in this cycle is added. Moments and powers have the uncertainty of `KineticErrors`, the ground's force
    and muscles none. O(cycles).

    >>> from asterism.gait import analyse_gait
    >>> from asterism.simulation import simulate_walks
    >>> table = gait_table([("walk", analyse_gait(simulate_walks(1, frames=300, markers="helen-hayes", seed=0)[0]))], curves=False)
    >>> sorted({row[1] for row in table.rows})
    ['event', 'mean', 'parameter', 'symmetry']
    """
    return NumberTable(COLUMNS, tuple(row for name, analysis in analyses for row in _rows(name, analysis, curves)))


def _rows(file: str, analysis: GaitAnalysis, curves: bool) -> Iterator[tuple[Any, ...]]:
    recording = analysis.recording

    def row(kind: str, name: str, value: float, sigma: float | None, unit: str, begins: float, ends: float, **more: Any) -> tuple[Any, ...]:
        cells = {"side": None, "cycle": None, "turns": None, "percent": None, "axis": None, "deviation": None, "cycles": None} | more
        # A time that is a frame's, but for the last digit, is of this frame alone.
        places = np.round([begins * recording.rate, ends * recording.rate], 6)
        first, last = recording.first_frame + int(np.floor(places[0])), recording.first_frame + int(np.ceil(places[1]))
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
        for axis, letter in enumerate("xyz"[: values.shape[1]]):
            known = np.flatnonzero(np.isfinite(values[:, axis]))
            if not len(known):
                continue
            which: dict[str, Any] = {"side": cycle.side, "cycle": number, "turns": int(cycle.turns), "axis": letter}
            places = [("curve", int(percent)) for percent in known]
            places += [("maximum", int(known[values[known, axis].argmax()])), ("minimum", int(known[values[known, axis].argmin()]))]
            for kind, percent in places:
                time = times[percent]
                yield row(kind, name, values[percent, axis], sigmas[percent, axis], unit, time, time, percent=percent, **which)


def _known(value: float | None) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None


def _of_side(cycles: Sequence[Cycle], side: str) -> list[Cycle]:
    return [cycle for cycle in cycles if cycle.side == side]


def _curves(analysis: GaitAnalysis) -> Iterator[tuple[str, Cycle, Floats, Floats, str]]:
    """Each curve of each cycle (101, n) with its standard uncertainty, NaN where that is not known, and unit."""
    spread = {
        name: np.sqrt(sum(part**2 for source, part in band.standard.items() if source != "fills"))
        for name, band in (analysis.bands.items() if analysis.curves else ())
    }
    spread |= {name: values for name, values in _placed_anew(analysis).items() if name not in spread}
    for name, angles in analysis.curves.items():
        fills = analysis.fill_sigmas.get(name, np.zeros(angles.shape))
        for number, cycle in enumerate(_of_side(analysis.cycles, name[0])):
            # Of an angle of which only fills are known, no fill is no certainty.
            sigma = np.hypot(spread[name], fills[number]) if name in spread else np.where(fills[number] > 0, fills[number], np.nan)
            yield name, cycle, np.degrees(angles[number]), np.degrees(sigma), "deg"
    per_kg = analysis.kinetics is not None and analysis.kinetics.per_kg
    for name, loads in analysis.loads.items():
        for number, cycle in enumerate(analysis.loaded[name]):
            sigma = analysis.load_sigmas[name][number] if name in analysis.load_sigmas else np.full(loads[number].shape, np.nan)
            yield name, cycle, loads[number], sigma, load_unit(name, per_kg)
    for channel in analysis.emg:
        for side, envelopes in channel.cycles.items():
            for cycle, curve in zip(_of_side(analysis.cycles, side), envelopes, strict=True):
                yield f"EMG {channel.name}", cycle, curve[:, None], np.full((len(curve), 1), np.nan), channel.unit


def _placed_anew(analysis: GaitAnalysis) -> dict[str, Floats]:
    """(101, 3) rad: what markers of trunk, head and arms that are placed anew, `PLACED` m beside, make of angles, by their names.

    Where a marker may be off by as much in each direction, the axes along which it is moved do not matter.
    """
    names = shipped_sets()["plug-in-gait"].names
    worn = [column for column, label in enumerate(analysis.recording.labels) if label in names and label[1:] not in _LEGS]
    shown = [own[0] for side in "LR" if (own := _of_side(analysis.cycles, side))]
    clinical = analysis.clinical
    if clinical is None or clinical.model.name != "plug-in-gait" or not shown:
        return {}
    rate, last = analysis.recording.rate, len(analysis.recording) - 1
    frames = np.unique([np.clip(np.linspace(one.strike.time, one.next_strike.time, 51) * rate, 0, last).astype(int) for one in shown])
    some = replace(analysis.recording, positions=analysis.recording.positions[frames], source=None, origin=None)
    middle = clinical.model.outputs(some)
    variance = {name: np.zeros_like(values) for name, values in middle.items() if name in analysis.curves}
    for column in worn:
        for axis in range(3):
            positions = some.positions.copy()
            positions[:, column, axis] += _STEP
            for name, values in clinical.model.outputs(replace(some, positions=positions)).items():
                if name in variance:
                    apart = (values - middle[name] + np.pi) % (2 * np.pi) - np.pi
                    variance[name] += (apart * PLACED / _STEP) ** 2
    found = {}
    for cycle in shown:
        places = np.linspace(cycle.strike.time, cycle.next_strike.time, POINTS) * rate
        for name, values in variance.items():
            if name[0] == cycle.side and (known := np.isfinite(values).all(axis=1)).any():
                curves = [np.interp(places, frames[known], np.sqrt(values[known, axis])) for axis in range(3)]
                found[name] = np.stack(curves, axis=1)
    return found


def load_unit(name: str, per_kg: bool) -> str:
    """The unit of a moment, power or force by Plug-in-Gait's name."""
    unit = "N m" if name.endswith("Moment") else "W" if name.endswith("Power") else "N"
    return f"{unit}/kg" if per_kg else unit
