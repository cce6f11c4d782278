"""TRC, the text format of Motion Analysis, Cortex and OpenSim: a file in, its points out, and back."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError
from asterism.files.atomic import utf8, write_atomically
from asterism.files.text import cells_of, decoded, delimiter_of, lines_of, number_of, read_bytes
from asterism.findings import Finding
from asterism.formats._columns import METRES_PER_UNIT, Points, as_metres, metres_per_unit
from asterism.formats._findings import cut_off, header_conflict, point_names
from asterism.formats._tables import frames_in_place, rate_of, rows_of_numbers
from asterism.formats._writing import all_points, dense_rows, spelled_numbers
from asterism.recording import Floats, Recording, as_vertical

Y_UP = as_vertical("y")


@dataclass(frozen=True)
class _TrcParts:
    """The parts of a TRC file: its header's values, its markers' names and its table.

    header     the values by their lower-case keys
    labels     (P,) names
    rows       (T, 2 + 3 P) frame, time, coordinates
    delimiter  what separates cells; None is any blank
    findings   what was found while reading
    """

    header: dict[str, str]
    labels: list[str]
    rows: Floats
    delimiter: str | None
    findings: list[Finding]


def read_trc(path: Path) -> Points:
    """All points of a TRC file, with tabs, commas, semicolons or blanks between its cells.

    A sample is missing where it is blank, NaN in any spelling, or zero in all three coordinates. The number of points is that of the
    columns, not that in the header. The vertical is what the data show, else Y, as in OpenSim.

    Raises AsterismError, naming file and line, where the header is not that of a TRC file or a cell is not a number.
    """
    lines = lines_of(decoded(path, read_bytes(path)))
    sheet = _sheet(path, lines)
    header, labels, rows, findings = sheet.header, sheet.labels, sheet.rows, sheet.findings
    raw = rows[:, 2:].reshape(len(rows), len(labels), 3)
    # A cut last line may end within a number, which then reads as another one.
    if len(raw) and _cut_short(lines, sheet.delimiter):
        findings.append(cut_off("the file ends within a line; the last marker of its last frame is taken as missing"))
        seen = np.nonzero(~np.isnan(raw[-1]).all(axis=1))[0]
        raw[-1, seen[-1:]] = np.nan
    scale, units, found = metres_per_unit(path, header.get("units"), raw, list(header.values()))
    positions, missing = as_metres(raw, scale)
    declared = number_of(header.get("datarate", ""))
    # Some programs fill in one of the two rates only.
    if declared is None or not declared > 0:
        declared = number_of(header.get("camerarate", ""))
    rate = rate_of(path, declared, rows[:, 1], findings)
    first_time = float(rows[0, 1]) if len(rows) and np.isfinite(rows[0, 1]) else None
    positions, first, jumps = frames_in_place(rows[:, 0], positions)
    for key, count, what in (("numframes", len(rows), "frames"), ("nummarkers", len(labels), "markers")):
        number = number_of(header.get(key, ""))
        # Readers of other programs trust the header, so that its errors are worth a note.
        if number is None or number != count:
            findings.append(header_conflict(f"the header says {header.get(key) or 'no number of'} {what}, the file holds {count}"))
    return Points(
        positions,
        tuple(labels),
        rate,
        "TRC",
        units=units,
        fallback=Y_UP,
        first_frame=first,
        first_time=first_time,
        findings=(*found, *findings, *missing, *jumps),
    )


def _sheet(path: Path, lines: list[str]) -> _TrcParts:
    """The parts of a file. Raises AsterismError where the header is not that of a TRC file or a cell is not a number."""
    # Lines may stand above the header, and blanks between its parts.
    at = next((i for i, line in enumerate(lines[:12]) if "datarate" in line.casefold()), None)
    if at is None or at + 2 >= len(lines):
        raise AsterismError(f"{path} is not a TRC file: it has no line with DataRate, CameraRate, NumFrames; export it again.")
    names_at = next((i for i in range(at + 1, min(at + 6, len(lines))) if lines[i].strip(' \t,;"').casefold().startswith("frame")), None)
    if names_at is None:
        raise AsterismError(
            f"{path} has no line with Frame#, Time and the markers' names after its header; add it or export the file again."
        )
    header = _header(lines[at], lines[at + 1] if names_at > at + 1 else "")
    delimiter = delimiter_of(lines[names_at])
    # Some programs leave the row X1, Y1, Z1 out.
    letters = cells_of(lines[names_at + 1], delimiter) if names_at + 1 < len(lines) else []
    has_letters = any(re.fullmatch(r"[XYZxyz]\d*", cell) for cell in letters)
    data_at = names_at + 2 if has_letters else names_at + 1
    labels, findings = _labels(lines[names_at], delimiter, letters if has_letters else [], lines[data_at : data_at + 3])
    if letters and has_letters and not _in_order(letters):
        raise AsterismError(f"{path}, line {names_at + 2}: the coordinates are not in the order X, Y, Z; export the file in that order.")
    rows, more = rows_of_numbers(path, lines[data_at:], data_at + 1, delimiter, 2 + 3 * len(labels))
    return _TrcParts(header, labels, rows, delimiter, [*findings, *more])


def write_trc(path: Path, recording: Recording) -> list[str]:
    """Write a TRC file in the units of the file that the recording came from, else millimetres; blanks are missing.

    The axes stay as they are. Returns what the format cannot carry: a vertical other than Y, and events.
    """
    positions, labels, omitted = all_points(recording, "TRC")
    units = str(recording.metadata.get("units", "")).casefold()
    units = units if units in ("mm", "cm", "m") else "mm"
    values = positions / METRES_PER_UNIT[units]
    decimals = {"mm": 5, "cm": 6, "m": 8}[units]
    frames, points = values.shape[:2]
    first, times = recording.first_frame, recording.times
    rate = f"{recording.rate:.10g}"
    names = [re.sub(r"[\t\r\n]", " ", label) for label in labels]
    head = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{frames}\t{points}\t{units}\t{rate}\t{first}\t{frames}",
        "Frame#\tTime" + "".join(f"\t{name}\t\t" for name in names),
        "\t" + "".join(f"\tX{i + 1}\tY{i + 1}\tZ{i + 1}" for i in range(points)),
        "",
    ]
    body = spelled_numbers(dense_rows(values, decimals), "\t", decimals)
    rows = ["\t".join(filter(None, (str(first + t), f"{times[t]:.6f}", row))) for t, row in enumerate(body)]
    write_atomically(path, utf8("\n".join([*head, *rows]) + "\n"))
    if recording.vertical[1] < 0.99:
        omitted.append("the vertical: TRC readers take Y as up or determine it from the data")
    return omitted


def _header(keys: str, values: str) -> dict[str, str]:
    """The header's two lines as a table; where blanks were padded with tabs, the non-blank cells correspond."""
    delimiter = delimiter_of(keys)
    names, cells = cells_of(keys, delimiter), cells_of(values, delimiter_of(values) if delimiter is None else delimiter)
    filled, written = [n for n in names if n], [c for c in cells if c]
    # Padding with tabs moves values from under their keys; the filled cells still pair up.
    pairs = (
        zip(filled, written, strict=False) if len(cells) > len(names) or len(filled) == len(written) else zip(names, cells, strict=False)
    )
    return {name.casefold(): cell for name, cell in pairs if name}


def _labels(line: str, delimiter: str | None, letters: list[str], data: list[str]) -> tuple[list[str], list[Finding]]:
    """Marker names, whether each stands over its X column (with two blanks after it) or directly behind the one before; and findings."""
    cells = cells_of(line, delimiter)[2:]
    named = [cell for cell in cells if cell]
    width = max((len(cells_of(row, delimiter)) for row in data if row.strip()), default=0)
    # The letters count the columns best, then the rows, then the names.
    columns = sum(bool(re.fullmatch(r"[XYZxyz]\d*", cell)) for cell in letters) or max(width - 2, 3 * len(named))
    count = max(columns // 3, len(named))
    # A name over each third cell, as the format has it; else the names stand side by side.
    spread = delimiter is not None and all(i % 3 == 0 for i, cell in enumerate(cells) if cell) and not (len(named) == 1 and count > 1)
    if spread:
        labels = [cells[i] if i < len(cells) else "" for i in range(0, 3 * count, 3)]
    elif len(named) <= count:
        labels = named + [""] * (count - len(named))
    else:
        labels = named
    nameless = sum(not label for label in labels)
    findings = [point_names(f"{nameless} points have no name; they are numbered *1, *2, ...")] if nameless else []
    numbers = iter(range(1, nameless + 1))
    return [label or f"*{next(numbers)}" for label in labels], findings


def _in_order(letters: list[str]) -> bool:
    found = "".join(cell[0] for cell in letters if re.fullmatch(r"[XYZxyz]\d*", cell)).upper()
    return all(found[i] == "XYZ"[i % 3] for i in range(len(found)))


def _cut_short(lines: list[str], delimiter: str | None) -> bool:
    """Whether the last line lacks its end and has fewer cells, or fewer decimals in its last one, than the line above: a cut file."""
    if len(lines) < 2 or not lines[-1].strip():
        return False
    last, above = cells_of(lines[-1], delimiter), cells_of(lines[-2], delimiter)
    if len(last) < len(above):
        return any(above[len(last) :])
    # A number that lost its last digits has fewer decimals than the one above it.
    decimals = [len(cells[-1].partition(".")[2]) for cells in (last, above)]
    return bool(last[-1]) and last[-1].casefold() != "nan" and decimals[0] < decimals[1]
