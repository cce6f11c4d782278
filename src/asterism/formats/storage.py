"""MOT and STO, OpenSim's tables of values over time, and plain CSV tables: files in, a `TimeSeriesTable` or marker points out, and back."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from asterism.errors import AsterismError, NoMarkers, guarded_reading
from asterism.files.atomic import utf8, write_atomically
from asterism.files.text import cell_text, cells_of, decoded, delimiter_of, lines_of, number_of, read_bytes, some_of
from asterism.findings import Finding
from asterism.formats._columns import Points, as_metres, metres_per_unit
from asterism.formats._findings import header_conflict, located, values_left_out
from asterism.formats._groups import ColumnGroup, exact_groups, marker_groups
from asterism.formats._tables import frames_in_place, frames_of, lead_of, lines_in_order, rate_of, rows_of_numbers
from asterism.formats._writing import all_points
from asterism.recording import Floats, Recording, as_vertical

_HEADER_LINES = 400
_MARKERS = "Marker positions"


@dataclass(frozen=True)
class TimeSeriesTable:
    """Named values over time, such as joint angles or forces.

    names       (C,) column names, the time column left out
    values      (T, C) in the file's units, NaN missing
    times       (T,) s
    title       what the first line of the file calls it
    in_degrees  whether angles are degrees; None where the file does not say
    format      "MOT", "STO" or "CSV"
    units       the unit of length that the header names, or ""
    said_rate   rows per second by the header, NaN where it does not say
    findings    what was found while reading; their sentences name no file
    """

    names: tuple[str, ...]
    values: Floats
    times: Floats
    title: str = ""
    in_degrees: bool | None = None
    format: str = "STO"
    units: str = ""
    said_rate: float = float("nan")
    findings: tuple[Finding, ...] = ()

    @property
    def rate(self) -> float:
        """Rows per second, by the times; by the header with fewer than two rows; NaN where neither gives it."""
        steps = np.diff(self.times)
        steps = steps[np.isfinite(steps) & (steps > 0)]
        return float(f"{1 / steps.mean():.6g}") if len(steps) else self.said_rate


def read_table(path: str | Path) -> TimeSeriesTable:
    """The table in a MOT, STO or CSV file; cells that hold three values (Vec3) become columns name_x, name_y, name_z.

    Raises AsterismError, naming file and line, where it has no row of names above numbers, or no time column.
    """
    with guarded_reading(path):
        return _table(Path(path))


def _table(path: Path) -> TimeSeriesTable:
    lines = lines_of(decoded(path, read_bytes(path)))
    end = next((i for i, line in enumerate(lines[:_HEADER_LINES]) if line.strip(" \t,;").casefold() == "endheader"), None)
    header = _header(lines[:end] if end is not None else lines[:0])
    # Our CSV tables carry the same header as comments.
    if end is None:
        header |= _header([line.lstrip("# ") for line in lines[:20] if line.startswith("#")])
    names_at = next(
        (i for i in range(0 if end is None else end + 1, len(lines)) if lines[i].strip(" \t,;") and not lines[i].startswith("#")), None
    )
    if names_at is None:
        raise AsterismError(f"{path} ends before its column names; export it again.")
    delimiter = delimiter_of(lines[names_at])
    names = cells_of(lines[names_at], delimiter)
    # A separator at the end of the header makes a column without a name.
    while names and not names[-1]:
        names.pop()
    body = lines[names_at + 1 :]
    kind = header.get("datatype", "")
    if kind and not kind.casefold().startswith(("double", "vec3")):
        raise NoMarkers(f"{path} holds values of the type {kind[:40]} (orientations, for instance) and no marker positions.")
    # A Vec3 cell holds its three numbers between commas.
    if header.get("datatype", "").casefold().startswith("vec3") and delimiter == "\t":
        names = [names[0], *(f"{name}_{axis}" for name in names[1:] for axis in "xyz")]
        body = [line.replace(",", "\t") for line in body]
    # Numbers in the header are a file without one.
    if not names or any(number_of(name) is not None and name for name in names):
        raise AsterismError(f"{path}, line {names_at + 1}: numbers where the column names belong; write a row of names above the numbers.")
    columns = [column for group in marker_groups(names)[0] for column in group.columns]
    lead = lead_of(columns, len(names)) if columns else None
    values, findings = rows_of_numbers(path, body, names_at + 2, delimiter, len(names), lead)
    for key in ("nrows", "datarows"):
        count = number_of(header.get(key, ""))
        if count is not None and count == count and count != len(values):
            findings.append(header_conflict(f"the header says {count:g} rows, the file holds {len(values)}"))
    time_at = next((i for i, name in enumerate(names) if re.fullmatch(r"(?i)time(\s*[\[(_]?s(ec(onds)?)?[\])]?)?|t", name)), None)
    if time_at is None:
        raise AsterismError(f"{path} has no column called time; add one in seconds.")
    others = [i for i in range(len(names)) if i != time_at]
    degrees = header.get("indegrees", header.get("in_degrees", "")).casefold()
    return TimeSeriesTable(
        tuple(names[i] for i in others),
        values[:, others],
        values[:, time_at],
        title=header.get("title", header.get("", "")),
        in_degrees={"yes": True, "no": False}.get(degrees),
        format={".mot": "MOT", ".sto": "STO"}.get(path.suffix.casefold(), "CSV" if end is None else "STO"),
        units=header.get("units", ""),
        said_rate=number_of(header.get("datarate", "")) or float("nan"),
        findings=tuple(findings),
    )


def table_or_none(path: Path) -> TimeSeriesTable | None:
    """The table in a file, or None where it holds none."""
    try:
        return read_table(path)
    except AsterismError:
        return None


def write_table(path: str | Path, table: TimeSeriesTable) -> list[str]:
    """Write a table as .mot, .sto or .csv; values keep 17 digits, so that they are read back unchanged.

    Returns an empty list: these formats carry everything. Raises AsterismError for another suffix or where the file cannot be written.

    >>> knee = TimeSeriesTable(("knee_flexion",), np.array([[12.5], [13.0]]), np.array([0.0, 0.01]), in_degrees=True)
    >>> write_table("angles.mot", knee)
    []
    >>> read_table("angles.mot").values[:, 0]
    array([12.5, 13. ])
    """
    path = Path(path)
    suffix = path.suffix.casefold()
    if suffix not in (".mot", ".sto", ".csv"):
        raise AsterismError(f"{path}: a table is written as .mot, .sto or .csv; choose one of these suffixes.")
    degrees = {None: "", True: "yes", False: "no"}[table.in_degrees]
    title = re.sub(r"[\r\n]+", " ", table.title) or path.stem
    if suffix == ".csv":
        head = [f"# title={title}", *([f"# inDegrees={degrees}"] if degrees else []), *([f"# Units={table.units}"] if table.units else [])]
        separator = ","
    else:
        head = [title, "version=1", f"nRows={len(table.values)}", f"nColumns={len(table.names) + 1}"]
        head += [f"inDegrees={degrees}"] if degrees else []
        head += [f"DataRate={table.said_rate:.10g}"] if np.isfinite(table.said_rate) else []
        head += [f"Units={table.units}"] if table.units else []
        head += ["endheader"]
        separator = "\t"
    names = [re.sub(r"[\t\r\n,;\"]", " ", name) for name in table.names]
    names = [cell_text(name) for name in names] if suffix == ".csv" else names
    rows = [
        separator.join(_shortest(value) for value in (time, *row))
        for time, row in zip(table.times.tolist(), table.values.tolist(), strict=True)
    ]
    write_atomically(path, utf8("\n".join([*head, separator.join(["time", *names]), *rows]) + "\n"))
    return []


def holds_markers(table: TimeSeriesTable, strictly: bool = True) -> bool:
    """Whether columns are positions of points: groups of x, y and z, none named as a force; strictly: nearly all columns are."""
    groups, rest = _groups_of(table)
    # A table of forces may hold one point of application, too.
    return len(groups) > 0 and (not strictly or len(rest) <= 0.1 * len(table.names))


def _groups_of(table: TimeSeriesTable) -> tuple[list[ColumnGroup], list[int]]:
    exact = exact_groups(table.names, "_t") if table.title == _MARKERS else None
    return (exact, []) if exact is not None else marker_groups(table.names)


def read_marker_table(path: Path) -> Points:
    """The points of a MOT or STO file whose columns are marker positions (name_tx, name_ty, name_tz or name_x, ...).

    Raises AsterismError where it holds something else, such as joint angles, and says what.
    """
    return points_of_table(path, read_table(path))


def points_of_table(path: Path, table: TimeSeriesTable) -> Points:
    """The points in a table's columns. Raises AsterismError where they are no marker positions."""
    if not holds_markers(table):
        what = "joint angles or other values" if table.in_degrees is not None else "values"
        raise NoMarkers(
            f"{path} holds {what} ({some_of(table.names)}), no marker positions; use asterism.formats.read_table or convert it to CSV."
        )
    # Times may be rounded to fewer steps than there are frames: only a step back says something.
    moved = list[Finding]()
    if (np.diff(table.times) < 0).any():
        lines, moved = lines_in_order(np.column_stack([table.times, table.values]), table.times)
        table = replace(table, times=lines[:, 0], values=lines[:, 1:])
    groups, rest = _groups_of(table)
    raw = table.values[:, [column for group in groups for column in group.columns]].reshape(len(table.values), len(groups), 3)
    findings = [*table.findings, *moved]
    if rest:
        findings.append(values_left_out(f"the columns {some_of([table.names[i] for i in rest])} are no positions and are left out"))
    scale, units, found = metres_per_unit(path, table.units or next((g.units for g in groups if g.units), None), raw)
    positions, missing = as_metres(raw, scale)
    rate = rate_of(path, table.said_rate, table.times, findings)
    # A start beyond 30 years is no time of a recording, but a clock's.
    start = float(table.times[0]) if len(table.times) and np.abs(table.times[0]) < 1e9 else None
    positions, _, jumps = frames_in_place(frames_of(table.times, rate), positions)
    return Points(
        positions,
        tuple(group.name for group in groups),
        rate,
        table.format,
        units=units,
        fallback=as_vertical("y"),
        first_frame=1 if start is None else round(start * rate) + 1,
        first_time=start,
        findings=(*found, *findings, *missing, *jumps),
    )


def write_marker_table(path: Path, recording: Recording) -> list[str]:
    """Write positions in metres as columns name_tx, name_ty, name_tz of a MOT or STO file."""
    positions, labels, omitted = all_points(recording, path.suffix[1:].upper())
    bare = [re.sub(r"[\s,;]+", "_", label) for label in labels]
    names = tuple(f"{name}_t{axis}" for name in bare for axis in "xyz")
    times = np.round(recording.times, 9)
    values = np.round(positions, 9) + 0.0
    # Three zeros would be read as a missing sample.
    values[(values == 0).all(axis=2), 0] = 1e-9
    write_table(path, TimeSeriesTable(names, values.reshape(len(values), len(names)), times, _MARKERS, units="m", said_rate=recording.rate))
    if recording.vertical[1] < 0.99:
        omitted.append(f"the vertical: {path.suffix[1:].upper()} readers take Y as up or determine it from the data")
    return omitted


def described_table(path: Path, table: TimeSeriesTable) -> dict[str, Any]:
    """What a table holds, as plain values."""
    return {
        "file": str(path),
        "format": f"{table.format} table",
        "title": table.title,
        "frames": len(table.values),
        "rate": table.rate if np.isfinite(table.rate) else None,
        "duration": float(table.times[-1] - table.times[0]) if len(table.times) else 0.0,
        "columns": list(table.names),
        "in_degrees": table.in_degrees,
        "missing": float(np.isnan(table.values).mean()) if table.values.size else 0.0,
        "findings": located(path, table.findings),
    }


def _header(lines: list[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for i, line in enumerate(lines):
        key, sign, value = line.strip(" \t,;").partition("=")
        if sign:
            found.setdefault(key.strip().casefold(), value.strip(" \t,;"))
        # Keys without a sign of equality come from older programs.
        elif i == 0 and key:
            found[""] = key
        else:
            word = re.fullmatch(r"(datacolumns|datarows|units|name)\s+(\S.*)", key.strip(), re.IGNORECASE)
            if word:
                found.setdefault(word[1].casefold(), word[2].strip())
    # "Units are S.I. units" is a sentence, not a unit.
    if found.get("units", "").casefold().startswith("are "):
        del found["units"]
    return found


def _shortest(value: float) -> str:
    # The shortest text that gives the same bits.
    return "" if value != value else f"{value:.17g}" if float(f"{value:.15g}") != value else f"{value:.15g}"
