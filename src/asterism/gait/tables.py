"""Analysed walks in; one table of all numbers, each with its uncertainty and the frames behind it, out: CSV, Parquet or a data frame."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from asterism.errors import AsterismError
from asterism.files.atomic import utf8, write_atomically
from asterism.gait.analysis import GaitAnalysis
from asterism.gait.cycles import Cycle, midstances, over_cycle
from asterism.gait.parameters import PARAMETERS, summarise, symmetries
from asterism.motion.clinical import ClinicalErrors, clinical_uncertainty
from asterism.motion.uncertainty import MonteCarloRules
from asterism.recording import Floats

if TYPE_CHECKING:
    import pandas

COLUMNS = (
    "file", "kind", "name", "side", "cycle", "percent", "axis", "value", "uncertainty", "unit", "deviation", "cycles",
    "begins_s", "ends_s", "first_frame", "last_frame",
)  # fmt: skip
"""Of the table. `deviation` is the standard deviation over `cycles` of a mean; s count from the first frame, frames as the file does."""
_TEXTS = frozenset({"file", "kind", "name", "side", "axis", "unit"})
_WHOLE = frozenset({"cycle", "percent", "cycles", "first_frame", "last_frame"})
_CYCLES = 2
"""Of each side, whose angles are drawn again: their uncertainty differs by 1 to 2 % between cycles of a side. Of one, a gap would stay."""
_TRIALS = 100
"""Of the Monte Carlo of angles: a standard uncertainty is then within 7 % of that of many trials. At half 10 %, at double 5 %."""


@dataclass(frozen=True)
class GaitTable:
    """Rows of `COLUMNS`, None where a cell has nothing."""

    rows: tuple[tuple[Any, ...], ...]

    def of(self, *kinds: str) -> GaitTable:
        """The rows of these kinds: "event", "parameter", "mean", "symmetry", "curve", "maximum", "minimum"."""
        return GaitTable(tuple(row for row in self.rows if row[1] in kinds))

    def to_dataframe(self) -> pandas.DataFrame:
        """The table for pandas. Needs pandas, which Asterism does not install; raises AsterismError where it is missing."""
        try:
            import pandas
        except ImportError:
            raise AsterismError("a data frame needs pandas; install it with `pip install pandas`.") from None
        columns = {name: list(values) for name, values in self._columns().items()}
        kinds = {name: "Int64" if name in _WHOLE else "str" if name in _TEXTS else "float64" for name in COLUMNS}
        return pandas.DataFrame(columns).astype(kinds)

    def write(self, path: str | Path) -> None:
        """Write it whole or not at all, as CSV or Parquet by the end of its name.

        Raises AsterismError for another name, for Parquet where pyarrow is missing, and where the file cannot be written.
        """
        path = Path(path)
        check_table(path)
        write_atomically(path, self._parquet() if path.suffix.casefold() == ".parquet" else utf8(self._csv()))

    def _columns(self) -> dict[str, tuple[Any, ...]]:
        return dict(zip(COLUMNS, zip(*self.rows, strict=True) if self.rows else [()] * len(COLUMNS), strict=True))

    def _csv(self) -> str:
        import csv

        text = io.StringIO()
        lines = csv.writer(text, lineterminator="\n")
        lines.writerow(COLUMNS)
        for row in self.rows:
            # Seven digits are more than any of these numbers is certain to.
            lines.writerow(["" if one is None else f"{one:.7g}" if isinstance(one, float) else one for one in row])
        return text.getvalue()

    def _parquet(self) -> bytes:
        import pyarrow
        import pyarrow.parquet

        types = {name: pyarrow.string() if name in _TEXTS else pyarrow.int64() if name in _WHOLE else pyarrow.float64() for name in COLUMNS}
        columns = [pyarrow.array(values, types[name]) for name, values in self._columns().items()]
        out = io.BytesIO()
        pyarrow.parquet.write_table(pyarrow.table(columns, names=list(COLUMNS)), out)
        return out.getvalue()


def check_table(path: Path) -> None:
    """Raise AsterismError where a table cannot be written under this name: it is neither CSV nor Parquet, or pyarrow is missing."""
    from importlib.util import find_spec

    if path.suffix.casefold() not in (".csv", ".parquet"):
        raise AsterismError(f"{path}: a table is CSV or Parquet; give it a name that ends in .csv or .parquet.")
    if path.suffix.casefold() == ".parquet" and find_spec("pyarrow") is None:
        raise AsterismError(f"{path}: Parquet needs pyarrow; install it with `pip install pyarrow`, or write a .csv.")


def gait_table(analyses: Sequence[tuple[str, GaitAnalysis]], *, curves: bool = True) -> GaitTable:
    """All numbers of walks, by the names of their files.

    curves  False: without the curves over the cycle and their extremes, which take most of the time and of the rows

    Angles of hips, knees and ankles are as uncertain as markers that are placed by hand and slide on the skin make them
    (`clinical_uncertainty`), and as fills do; of other curves only fills are known. O(cycles + trials T).

    >>> from asterism.gait import analyse_gait
    >>> from asterism.simulation import simulate_walks
    >>> table = gait_table([("walk", analyse_gait(simulate_walks(1, frames=300, markers="helen-hayes", seed=0)[0]))], curves=False)
    >>> sorted({row[1] for row in table.rows})
    ['event', 'mean', 'parameter', 'symmetry']
    """
    return GaitTable(tuple(row for name, analysis in analyses for row in _rows(name, analysis, curves)))


def _rows(file: str, analysis: GaitAnalysis, curves: bool) -> Iterator[tuple[Any, ...]]:
    recording = analysis.recording

    def row(kind: str, name: str, value: float, sigma: float | None, unit: str, begins: float, ends: float, **more: Any) -> tuple[Any, ...]:
        cells = {"side": None, "cycle": None, "percent": None, "axis": None, "deviation": None, "cycles": None} | more
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
        its: dict[str, Any] = {"side": one.side, "cycle": numbers[one.side, one.begins]}
        yield row("parameter", one.name, one.value, one.sigma, PARAMETERS[one.name], one.begins, one.ends, **its)
    spans = {side: (own[0].strike.time, own[-1].next_strike.time) for side in "LR" if (own := _of_side(analysis.cycles, side))}
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
            which = {"side": cycle.side, "cycle": number, "axis": letter}
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
    spread = _angle_sigmas(analysis)
    for name, angles in analysis.curves.items():
        fills = analysis.fill_sigmas.get(name, np.zeros(angles.shape))
        for number, cycle in enumerate(_of_side(analysis.cycles, name[0])):
            # Of an angle of which only fills are known, no fill is no certainty.
            sigma = np.hypot(spread[name], fills[number]) if name in spread else np.where(fills[number] > 0, fills[number], np.nan)
            yield name, cycle, np.degrees(angles[number]), np.degrees(sigma), "deg"
    per_kg = analysis.kinetics is not None and analysis.kinetics.per_kg
    for name, loads in analysis.loads.items():
        for number, cycle in enumerate(analysis.loaded[name]):
            yield name, cycle, loads[number], np.full(loads[number].shape, np.nan), load_unit(name, per_kg)


def _angle_sigmas(analysis: GaitAnalysis) -> Mapping[str, Floats]:
    """(101, 3) rad by name, of the angles whose errors have a model, the same for all cycles.

    Markers are as badly placed in each cycle, so that some cycles tell it of all.
    """
    chosen = [cycle for side in "LR" for cycle in _of_side(analysis.cycles, side)[:_CYCLES]]
    if analysis.clinical is None or not chosen:
        return {}
    recording, frames = analysis.recording, np.zeros(len(analysis.recording), dtype=bool)
    for cycle in chosen:
        begin, end = (int(edge * recording.rate) for edge in (cycle.strike.time, cycle.next_strike.time))
        frames[begin : end + 2] = True
    some = replace(recording, positions=recording.positions[frames], source=None, origin=None)
    joints = tuple(replace(joint, angles=joint.angles[frames]) for joint in analysis.clinical.joints)
    rules = MonteCarloRules(block=_TRIALS, most=_TRIALS)
    spread = clinical_uncertainty(some, replace(analysis.clinical, joints=joints), ClinicalErrors(), rules=rules, budget_trials=2)
    found = {}
    for one in spread.joints:
        side, over_time = one.joint.side[0].upper(), np.full((len(recording), 3), np.nan)
        over_time[frames] = one.standard
        curves = [over_cycle(over_time, recording.rate, cycle) for cycle in chosen if cycle.side == side]
        if curves and np.isfinite(curves).any(axis=0).all():
            found[f"{side}{one.joint.joint.title()}Angles"] = np.sqrt(np.nanmean(np.square(curves), axis=0))
    return found


def load_unit(name: str, per_kg: bool) -> str:
    """The unit of a moment, power or force by Plug-in-Gait's name."""
    unit = "N m" if name.endswith("Moment") else "W" if name.endswith("Power") else "N"
    return f"{unit}/kg" if per_kg else unit
