"""QTM's TSV export of 3D data: a file in, its points out, and back; a table with tabs that is no such export reads as CSV."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError
from asterism.formats._columns import Points, as_metres, metres_per_unit
from asterism.formats._text import decoded, frames_in_place, lines_of, number_of, rate_of, read_bytes, rows_of_numbers, write_atomically
from asterism.formats._writing import all_points, dense_rows, spelled_numbers
from asterism.formats.csv_long import is_long, read_long
from asterism.formats.csv_wide import read_wide
from asterism.recording import Event, Recording, as_vertical

_KEY = re.compile(r"[A-Z][A-Z_0-9]{3,}")


def read_tsv(path: Path) -> Points:
    """All trajectories of a QTM export (3D data, with or without the columns Frame and Time and their header). QTM is Z up.

    Raises AsterismError, naming the file, where it holds 6D data, has no marker names, or a cell is no number.
    """
    lines = lines_of(decoded(path, read_bytes(path)))
    header: dict[str, list[str]] = {}
    events: list[Event] = []
    at = len(lines)
    for i, line in enumerate(lines):
        cells = [cell.strip() for cell in line.split("\t")]
        if not line.strip():
            continue
        if not _KEY.fullmatch(cells[0]) or (len(cells) > 1 and number_of(cells[0]) is not None):
            at = i
            break
        if cells[0] == "EVENT" and len(cells) > 3:
            time = number_of(cells[3])
            if time is not None and np.isfinite(time):
                events.append(Event(cells[1], float(time)))
        else:
            header.setdefault(cells[0], cells[1:])
    if "MARKER_NAMES" not in header:
        if not header:
            return read_long(path) if is_long(lines) else read_wide(path)
        raise AsterismError(f"{path} has no line MARKER_NAMES; export 3D data from QTM again, with its header.")
    included = (header.get("DATA_INCLUDED") or ["3D"])[0].upper()
    if included != "3D":
        raise AsterismError(f"{path} holds {included} data (poses of bodies), no trajectories; export 3D data from QTM.")
    labels = [label for label in header["MARKER_NAMES"] if label]
    remarks: list[str] = []
    extra, start = 0, at
    if at < len(lines) and number_of(lines[at].split("\t")[0]) is None:
        titles = [cell.strip().casefold() for cell in lines[at].split("\t")]
        extra = int("frame" in titles[:2]) + int("time" in titles[:2])
        start = at + 1
    elif at < len(lines):
        extra = {2: 2, 1: 1}.get(len(lines[at].rstrip("\t").split("\t")) - 3 * len(labels), 0)
    rows, more = rows_of_numbers(path, lines[start:], start + 1, "\t", extra + 3 * len(labels))
    raw = rows[:, extra:].reshape(len(rows), len(labels), 3)
    scale, units, remark = metres_per_unit(path, "mm", raw)
    positions, odd = as_metres(raw, scale)
    times = rows[:, extra - 1] if extra else None
    rate = rate_of(path, number_of((header.get("FREQUENCY") or [""])[0]), times, remarks)
    first, jumps = 1, list[str]()
    if extra == 2:
        positions, first, jumps = frames_in_place(rows[:, 0], positions)
    for key, found, what in (("NO_OF_FRAMES", len(rows), "frames"), ("NO_OF_MARKERS", len(labels), "markers")):
        number = number_of((header.get(key) or [""])[0])
        if number is not None and number != found:
            remarks.append(f"the header says {number:g} {what}, the file holds {found}")
    return Points(
        positions,
        tuple(labels),
        rate,
        "QTM TSV",
        units=units,
        declared=as_vertical("z"),
        first_frame=first,
        first_time=float(times[0]) if times is not None and len(times) and np.isfinite(times[0]) else None,
        events=tuple(events),
        oddities=tuple([*([remark] if remark else []), *remarks, *more, *odd, *jumps]),
        extra={"description": (header.get("DESCRIPTION") or [""])[0], "time_stamp": (header.get("TIME_STAMP") or [""])[0]},
    )


def write_tsv(path: Path, recording: Recording) -> list[str]:
    """Write a QTM-like TSV: millimetres, columns Frame and Time, blank where missing. Returns what was lost."""
    positions, labels, lost = all_points(recording, "TSV", events=True)
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
    write_atomically(path, ("\n".join([*head, *rows]) + "\n").encode())
    if recording.vertical[2] < 0.99:
        lost.append("the vertical: QTM's files are Z up")
    if any(event.context for event in recording.events):
        lost.append("the sides of events: they stand before the events' names")
    return lost
