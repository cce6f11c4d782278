"""TRC, the text format of Motion Analysis, Cortex and OpenSim: a file in, its points out, and back."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError
from asterism.files.atomic import utf8, write_atomically
from asterism.files.text import cells_of, decoded, delimiter_of, lines_of, number_of, read_bytes, some_of
from asterism.findings import Finding
from asterism.formats._columns import METRES_PER_UNIT, Points, as_metres, metres_per_unit
from asterism.formats._findings import header_conflict, point_names
from asterism.formats._tables import frames_in_place, lines_in_order, rate_of, rows_of_numbers, separator_of
from asterism.formats._writing import all_points, dense_rows, spelled_numbers
from asterism.recording import Floats, Recording, as_vertical

Y_UP = as_vertical("y")


@dataclass(frozen=True)
class _TrcParts:
    """The parts of a TRC file: its header's values, its markers' names and its table.

    header     the values by their lower-case keys
    labels     (P,) names
    known      how many of them the header names; the others stand behind
    rows       (T, 2 + 3 P) frame, time, coordinates
    findings   what was found while reading
    """

    header: dict[str, str]
    labels: list[str]
    known: int
    rows: Floats
    findings: list[Finding]


def read_trc(path: Path) -> Points:
    """All points of a TRC file, with tabs, commas, semicolons or blanks between its cells.

    A sample is missing where it is blank, NaN in any spelling, or zero in all three coordinates. The number of points is that of the
    columns, not that in the header: points without a name may stand behind those with one, another number in each line. The vertical is
    what the data show, else Y, as in OpenSim.

    Raises AsterismError, naming file and line, where the header is not that of a TRC file or a cell is not a number.
    """
    lines = lines_of(decoded(path, read_bytes(path)))
    sheet = _sheet(path, lines)
    header, labels, rows, findings = sheet.header, sheet.labels, sheet.rows, sheet.findings
    rows, moved = lines_in_order(rows, rows[:, 0])
    findings += moved
    raw = rows[:, 2:].reshape(len(rows), len(labels), 3)
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
        if number is None or number not in (count, sheet.known if key == "nummarkers" else count):
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
    # Some programs leave the row X1, Y1, Z1 out, others write the names into it once more.
    near = range(names_at + 1, min(names_at + 6, len(lines)))
    data_at = next((i for i in near if _is_data(lines[i])), next((i for i in near if not _axes(lines[i].split())), len(lines)))
    below = [cells_of(line, separator_of(line, delimiter)) for line in lines[names_at + 1 : data_at] if line.strip()]
    axes = next((row for row in below if _axes(row)), [])
    order = _axes(axes)[:3] or list("XYZ")
    if sorted(order) != list("XYZ") or any(axis != order[i % 3] for i, axis in enumerate(_axes(axes))):
        raise AsterismError(f"{path}, line {names_at + 2}: the coordinates are not X, Y and Z of each point in one order; export it again.")
    first = next((line for line in lines[data_at:] if line.strip()), "")
    between = separator_of(first, delimiter)
    # Points without a name stand behind those with one, in each line as many as were seen.
    widths = [len(cells_of(line.rstrip(), between)) if '"' in line else len(line.rstrip().split(between)) for line in lines[data_at:]]
    widest = max(widths, default=0)
    if widest * len(widths) > 50 * sum(widths) + 1_000_000:
        raise AsterismError(f"{path}, line {data_at + 1 + widths.index(widest)}: {widest:,} cells, far more than in others; correct it.")
    labels, known, findings = _labels(
        path, lines[names_at], delimiter, len(_axes(axes)) // 3, number_of(header.get("nummarkers", "")), -(-max(widest - 2, 0) // 3)
    )
    rows, more = rows_of_numbers(path, lines[data_at:], data_at + 1, between, 2 + 3 * len(labels), lead=2, least=2 + 3 * known)
    if order != list("XYZ"):
        places = rows[:, 2:].reshape(len(rows), len(labels), 3)[:, :, [order.index(axis) for axis in "XYZ"]]
        rows[:, 2:] = places.reshape(len(rows), -1)
    # A row that is too long by damage leaves a column without a point.
    seen = np.nonzero(~np.isnan(rows[:, 2:]).all(axis=0))[0]
    count = max(known, int(seen[-1]) // 3 + 1 if len(seen) else 0)
    labels, rows = labels[:count], rows[:, : 2 + 3 * count]
    nameless = sum(not label for label in labels)
    if nameless:
        findings.append(point_names(f"{nameless} points have no name; they are numbered from *1"))
    numbers = iter(range(1, nameless + 1))
    labels = [label or f"*{next(numbers)}" for label in labels]
    return _TrcParts(header, labels, known, rows, [*findings, *more])


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
    # OpenSim does not count a last cell that is blank, unless a tab ends it
    ended = (row + "\t" if row.endswith("\t") else row for row in body)
    rows = ["\t".join(filter(None, (str(first + t), f"{times[t]:.6f}", row))) for t, row in enumerate(ended)]
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


def _is_data(line: str) -> bool:
    """Whether a line holds numbers: at least half of its cells, so that a damaged number is not taken for a name."""
    cells = [number_of(cell) for cell in cells_of(line, separator_of(line, "\t")) if cell]
    return len(cells) > 0 and sum(cell is not None for cell in cells) * 2 >= len(cells)


def _axes(row: list[str]) -> list[str]:
    """The axes of a row X1, Y1, Z1, ... or LKNE_X, LKNE_Y, LKNE_Z, ...; empty where it is another row."""
    cells = [cell for cell in row if cell and not re.fullmatch(r"(?i)frame\s*#?|time|[\[(]?s(ec)?[\])]?", cell)]
    found = [match for cell in cells if (match := re.fullmatch(r"(?i)(?:.*[\W_])?([XYZ])\d*", cell))]
    return [match[1].upper() for match in found] if len(found) == len(cells) else []


def _labels(
    path: Path, line: str, delimiter: str | None, headed: int, said: float | None, most: int
) -> tuple[list[str], int, list[Finding]]:
    """The name of each point, "" for none, how many of them the header names, and findings.

    line, delimiter  the row of names, and what separates its cells
    headed           how many points the row X1, Y1, Z1, ... counts; 0 where there is none
    said             NumMarkers, or None
    most             how many points the longest row of numbers holds

    Raises AsterismError where it cannot be told which name is whose.
    """
    cells = cells_of(line, delimiter)
    # Frame# and Time may share a cell.
    if re.fullmatch(r"(?i)frame\s*#?\s+time", cells[0]):
        cells.insert(1, "")
    # Blanks may stand before Time.
    time_at = next((i for i, cell in enumerate(cells) if i and cell), 1)
    is_time = time_at < len(cells) and re.match(r"(?i)\W*(time|t\b|s\b|sec|zeit|temps|tiempo|tempo)", cells[time_at]) is not None
    if time_at == 1 < len(cells) and cells[1] and not is_time:
        raise AsterismError(f"{path}: {cells[1][:40]!r} stands where the column Time belongs, behind Frame#; add that column.")
    cells = cells[time_at + 1 if is_time else 2 :]
    named = [cell for cell in cells if cell]
    count, findings = max(most, headed), list[Finding]()
    # Each name may stand over all three of its columns, or with its axis.
    bare = [re.sub(r"[\W_]+[XYZxyz]$", "", name) for name in named]
    if len(named) == 3 * count > 0 and bare[::3] == bare[1::3] == bare[2::3]:
        named = cells = bare[::3]
    counts = {int(n) for n in (headed, said or 0, most) if 0 < n < 1e6}
    words = len(named[0].split()) if len(named) == 1 else len(named)
    # Between blanks, a name with a blank in it looks like two.
    if len(named) == 1 < words and said != 1 and words in counts:
        named = cells = named[0].split()
    elif (delimiter is None or len(named) == 1) and counts and words not in counts and (said or words > count):
        named = cells = _names_with_blanks(path, line, min(counts), words)
        findings.append(point_names(f"the names of markers hold blanks; they were read as {some_of(named)}"))
    # Several blanks within a cell separate names as well, where the number of points says so.
    apart = [name for cell in named for name in re.split(r"\s{2,}", cell)]
    if len(named) not in counts and len(apart) in counts:
        named = cells = apart
    places = [i for i, cell in enumerate(cells) if cell]
    beside = places == list(range(len(places)))
    # A name over each third cell, as the format has it; else the names stand side by side.
    over = delimiter is not None and all(i % 3 == 0 for i in places) and (not beside or len(places) == 1)
    # With more places than the rows have points, the names have moved.
    over &= not count or not places or places[-1] // 3 < count
    labels = [cells[i] for i in range(0, places[-1] + 1, 3)] if over and places else named
    known = len(labels)
    # Of names that stand elsewhere only the order counts, which tells nothing where some points have none.
    fits = known in (said, count) or (beside and known <= count) or not count
    if not over and not fits:
        raise AsterismError(
            f"{path}: {known} names and {count} points, and the names do not stand over the columns; write each name over its X."
        )
    return labels + [""] * (count - known), known, findings


def _names_with_blanks(path: Path, line: str, count: int, words: int) -> list[str]:
    """The names in a row in which blanks stand within names, too: `count` of them.

    Two blanks separate where that gives as many names as there are points. Else every name has as many words as the others where the
    words that begin a name, such as R and L, begin several and stand nowhere else. Raises AsterismError where neither holds.
    """
    names = re.sub(r"(?i)^\s*frame\s*#?\s+time\s*", "", line)
    apart, each = [cell for cell in re.split(r"\t+|\s{2,}", names.strip()) if cell], names.split()
    if len(apart) == count:
        return apart
    size = len(each) // max(1, count)
    if size > 1 and len(each) == size * count:
        first, others = each[::size], [word for i, word in enumerate(each) if i % size]
        if all(first.count(word) > 1 and word not in others for word in first):
            return [" ".join(each[i : i + size]) for i in range(0, len(each), size)]
    raise AsterismError(
        f"{path}: its row of names has {words} words for {count} markers, so that names hold blanks; separate the names with tabs."
    )
