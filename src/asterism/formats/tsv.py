"""QTM's TSV export of 3D data: a file in, its points out, and back; any other table with tabs is read as CSV."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError, NoMarkers
from asterism.files.atomic import utf8, write_atomically
from asterism.files.text import cells_of, decoded, delimiter_of, lines_of, number_of, read_bytes
from asterism.findings import Finding
from asterism.formats._columns import Points, as_metres, metres_per_unit
from asterism.formats._findings import header_conflict, unread_events
from asterism.formats._tables import frames_in_place, lines_in_order, rate_of, rows_of_numbers
from asterism.formats._writing import all_points, dense_rows, spelled_numbers
from asterism.formats.csv_long import is_long, read_long
from asterism.formats.csv_wide import read_wide
from asterism.recording import Event, Recording, as_vertical

_KEY = re.compile(r"[A-Z][A-Z_0-9]{3,}")
_OTHER_DATA = {
    "BODY_NAMES": "6D data (poses of rigid bodies)",
    "SEGMENT_NAMES": "a skeleton (poses of segments)",
    "SKELETON_NAME": "a skeleton (poses of segments)",
    "FORCE_PLATE_NAME": "data of a force plate",
    "CHANNEL_NAMES": "analog data",
    "NO_OF_CHANNELS": "analog data",
    "EYE_TRACKER_NAME": "data of an eye tracker",
}
"""The keys of QTM's other exports, and what these hold."""


@dataclass(frozen=True)
class _Head:
    """The lines above the table: their keys with values, the events, the lines of unread ones, and the place of what follows."""

    values: dict[str, list[str]]
    events: list[Event]
    unread: list[int]
    stop: int

    def first(self, key: str) -> str:
        """The first value of a key, "" where there is none."""
        return (self.values.get(key) or [""])[0]


def read_tsv(path: Path) -> Points:
    """All trajectories of a QTM export (3D data, with or without the columns Frame and Time and their header). QTM is Z up.

    Raises AsterismError, naming the file, where it holds 6D data, has no marker names, or a cell is not a number.
    """
    lines = lines_of(decoded(path, read_bytes(path)))
    # A spreadsheet that saved the export again may separate its cells otherwise.
    delimiter = delimiter_of(next(line for line in lines if line.strip())) or "\t"
    head = _head(lines, delimiter)
    # Any program writes tables with tabs: without QTM's keys it is one of those.
    if not head.values:
        return read_long(path) if is_long(lines) else read_wide(path)
    held = next((what for key, what in _OTHER_DATA.items() if key in head.values), None)
    if "MARKER_NAMES" not in head.values and held is not None:
        raise NoMarkers(f"{path} holds {held} of QTM and no trajectories of markers; export 3D data from QTM.")
    if "MARKER_NAMES" not in head.values:
        raise AsterismError(f"{path} has no line MARKER_NAMES; export 3D data from QTM again, with its header.")
    included = (head.first("DATA_INCLUDED") or "3D").upper()
    if included != "3D":
        raise NoMarkers(f"{path} holds {included} data of QTM and no trajectories of markers; export 3D data from QTM.")
    labels = head.values["MARKER_NAMES"]
    while labels and not labels[-1]:
        labels.pop()
    # A trajectory without a name has its columns like the others.
    numbers = iter(range(1, len(labels) + 1))
    labels = [label or f"*{next(numbers)}" for label in labels]
    start, extra = _table(lines, head.stop, len(labels), delimiter)
    rows, short = rows_of_numbers(path, lines[start:], start + 1, delimiter, extra + 3 * len(labels), lead=extra)
    rows, moved = lines_in_order(rows, rows[:, 0]) if extra == 2 else (rows, [])
    raw = rows[:, extra:].reshape(len(rows), len(labels), 3)
    scale, units, findings = metres_per_unit(path, "mm", raw)
    positions, missing = as_metres(raw, scale)
    # The time stands just before the coordinates.
    times = rows[:, extra - 1] if extra else None
    rate = rate_of(path, number_of(head.first("FREQUENCY")), times, findings)
    first, jumps = 1, list[Finding]()
    if extra == 2:
        positions, first, jumps = frames_in_place(rows[:, 0], positions)
    for key, count, what in (("NO_OF_FRAMES", len(rows), "frames"), ("NO_OF_MARKERS", len(labels), "markers")):
        number = number_of(head.first(key))
        if number is not None and number != count:
            findings.append(header_conflict(f"the header says {number:g} {what}, the file holds {count}"))
    return Points(
        positions,
        tuple(labels),
        rate,
        "QTM TSV",
        units=units,
        declared=as_vertical("z"),
        first_frame=first,
        first_time=float(times[0]) if times is not None and len(times) and np.isfinite(times[0]) else None,
        events=tuple(head.events),
        findings=(*moved, *findings, *short, *missing, *jumps, *unread_events(head.unread)),
        extra={"description": head.first("DESCRIPTION"), "time_stamp": head.first("TIME_STAMP")},
    )


def _head(lines: list[str], delimiter: str) -> _Head:
    """The header of a file: lines that begin with a key in capitals."""
    values: dict[str, list[str]] = {}
    events: list[Event] = []
    unread: list[int] = []
    for i, line in enumerate(lines):
        cells = cells_of(line, delimiter)
        if not any(cells):
            continue
        # The first line without a key in capitals begins the table.
        if not _KEY.fullmatch(cells[0]) or (len(cells) > 1 and number_of(cells[0]) is not None):
            return _Head(values, events, unread, i)
        if cells[0] == "EVENT":
            time = number_of(cells[3]) if len(cells) > 3 else None
            if time is not None and np.isfinite(time):
                events.append(Event(cells[1], float(time)))
            else:
                unread.append(i + 1)
        else:
            values.setdefault(cells[0], cells[1:])
    return _Head(values, events, unread, len(lines))


def _table(lines: list[str], at: int, markers: int, delimiter: str) -> tuple[int, int]:
    """The place of the first row of numbers, and how many columns (Frame, Time) stand before the coordinates."""
    cells = cells_of(lines[at], delimiter) if at < len(lines) else [""]
    if number_of(cells[0]) is None:
        titles = [cell.casefold() for cell in cells]
        return at + 1, int("frame" in titles[:2]) + int("time" in titles[:2])
    if at < len(lines):
        # Without titles, the number of cells beyond the coordinates tells whether frame and time are there.
        return at, {2: 2, 1: 1}.get(len(lines[at].rstrip(delimiter).split(delimiter)) - 3 * markers, 0)
    return at, 0


def write_tsv(path: Path, recording: Recording) -> list[str]:
    """Write a QTM-like TSV: millimetres, columns Frame and Time, blank where missing. Returns what the format cannot carry."""
    positions, labels, omitted = all_points(recording, "TSV", events=True)
    first, times = recording.first_frame, recording.times
    names = [re.sub(r"[\t\r\n]", " ", label) for label in labels]
    head = [
        f"NO_OF_FRAMES\t{len(positions)}",
        "NO_OF_CAMERAS\t0",
        f"NO_OF_MARKERS\t{len(labels)}",
        f"FREQUENCY\t{recording.rate:.10g}",
        "NO_OF_ANALOG\t0",
        "ANALOG_FREQUENCY\t0",
        f"DESCRIPTION\t{re.sub(r'[^ -~]', ' ', str(recording.metadata.get('description', '')) or '--')}",
        *(
            f"EVENT\t{re.sub('[^ -~]', ' ', f'{e.context} {e.label}'.strip())}\t{round(e.time * recording.rate) + 1}\t{e.time:.6f}"
            for e in recording.events
        ),
        "DATA_INCLUDED\t3D",
        "\t".join(["MARKER_NAMES", *names]),
        "\t".join(["Frame", "Time", *(f"{name} {axis}" for name in names for axis in "XYZ")]),
    ]
    body = spelled_numbers(dense_rows(positions * 1000.0, 5), "\t", 5)
    rows = ["\t".join(filter(None, (str(first + t), f"{times[t]:.6f}", row))) for t, row in enumerate(body)]
    write_atomically(path, utf8("\n".join([*head, *rows]) + "\n"))
    if recording.vertical[2] < 0.99:
        omitted.append("the vertical: QTM's files are Z up")
    if any(event.context for event in recording.events):
        omitted.append("the sides of events: they stand before the events' names")
    return omitted
