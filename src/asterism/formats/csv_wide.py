"""CSV with one row per frame and three columns per marker (frame, time, LKNE_x, LKNE_y, LKNE_z, ...): in and out."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError, NoMarkers
from asterism.files.atomic import utf8, write_atomically
from asterism.files.text import cell_text, cells_of, decoded, delimiter_of, lines_of, number_of, read_bytes, some_of
from asterism.findings import Finding
from asterism.formats._columns import METRES_PER_UNIT, Points, as_metres, metres_per_unit
from asterism.formats._comments import comment_lines, comments_of, data_start
from asterism.formats._confidence import LabelConfidence
from asterism.formats._findings import header_conflict, unread_events, values_left_out
from asterism.formats._groups import exact_groups, marker_groups
from asterism.formats._physical import OTHER_UNIT
from asterism.formats._tables import blanked, frames_in_place, frames_of, lead_of, lines_in_order, rate_of, rows_of_numbers, separator_of
from asterism.formats._writing import all_points, dense_rows, spelled_numbers
from asterism.recording import Recording

_CONFIDENCE = "_confidence"
_HIGHEST_HEADER = 40
"""Lines above the names of the columns that are looked through; the longest that programs write are half of it."""
_FRAME = re.compile(r"(?i)(frame|frames|fnum|field ?#?|frame[ _]?(no|number|id|index)?\.?#?|index|sample|#|nr|no)?")
_TIME = re.compile(
    r"(?i)(time|t|timestamp|seconds|zeit|temps|tiempo|tempo)(\s*[\[(_ ]\s*(?P<unit>s|sec|secs|seconds|ms|milliseconds)\s*[\])]?)?"
)


def read_wide(path: Path) -> Points:
    """All points of a CSV file with three columns per marker, separated by commas, semicolons or tabs.

    The header is one row (LKNE_x, LKNE.X, X LKNE, LKNE_x (mm), LKNE[0], ...) or two (names over x, y, z); a row of units may
    follow. The rate comes from a time column or a comment line `# rate=100`. A sample is missing where it is blank, NaN, or zero in all
    three coordinates.

    Raises AsterismError, naming the file, where no three columns are those of a marker.
    """
    lines = lines_of(decoded(path, read_bytes(path)))
    comments = comments_of(lines)
    at = data_start(lines)
    if at >= len(lines):
        raise AsterismError(f"{path} has no header row; write one such as frame,time,LKNE_x,LKNE_y,LKNE_z.")
    delimiter = delimiter_of(lines[at])
    names, units, body_at = _header(lines, at, delimiter)
    said_rate = comments.rate
    # Programs write what they know of the recording above the names of the columns.
    if not marker_groups(names)[0]:
        found_at = next((i for i in range(at + 1, min(at + _HIGHEST_HEADER, len(lines))) if _names_markers(lines, i)), None)
        if found_at is not None:
            above, said_units = _preamble(lines[at:found_at])
            said_rate = said_rate if said_rate is not None and np.isfinite(said_rate) else above
            delimiter = delimiter_of(lines[found_at])
            names, units, body_at = _header(lines, found_at, delimiter)
            units = units or said_units
    # Our own files are read exactly: no name of theirs can be mistaken for an axis.
    by_asterism = comments.frames is not None and names[:2] == ["frame", "time"]
    positions_end = _positions_end(names) if by_asterism else len(names)
    exact = exact_groups(names[:positions_end], "_", 2) if by_asterism else None
    groups, rest = marker_groups(names) if exact is None else (exact, [0, 1])
    if not groups:
        shown = some_of([name for name in names if name])
        raise NoMarkers(
            f"{path} is a table of values ({shown}) and no recording: no columns are called like positions of a marker, "
            "such as LKNE_x, LKNE_y, LKNE_z."
        )
    columns = [column for group in groups for column in group.columns]
    body = _numbers_only(lines[body_at:], names, rest, delimiter)
    values, findings = rows_of_numbers(path, body, body_at + 1, delimiter, len(names), lead_of(columns, positions_end), stop=positions_end)
    time_at = next((i for i in rest if names[i] and _TIME.fullmatch(names[i])), None)
    frame_at = next((i for i in rest if _FRAME.fullmatch(names[i]) and i != time_at), None)
    # Times may be rounded to fewer steps than there are frames: of these only a step back says something.
    if frame_at is not None or (time_at is not None and (np.diff(values[:, time_at]) < 0).any()):
        values, moved = lines_in_order(values, values[:, time_at if frame_at is None else frame_at])
        findings += moved
    raw = values[:, columns].reshape(len(values), len(groups), 3)
    if comments.frames is not None and comments.frames != len(values):
        findings.append(header_conflict(f"the header says {comments.frames} frames, the file holds {len(values)}"))
    unit = comments.units or units or next((group.units for group in groups if group.units), None)
    scale, name, found = metres_per_unit(path, unit, raw)
    positions, missing = as_metres(raw, scale)
    times = None
    if time_at is not None:
        match = _TIME.fullmatch(names[time_at])
        milliseconds = match is not None and (match["unit"] or "").lower().startswith("m")
        times = values[:, time_at] * (0.001 if milliseconds else 1.0)
    rate = rate_of(path, said_rate, times, findings)
    first, jumps = comments.first_frame, list[Finding]()
    if frame_at is not None:
        # A frame column also shows the frames that were left out.
        positions, numbered, jumps = frames_in_place(values[:, frame_at], positions)
        first = numbered if len(values) else first
    elif times is not None:
        positions, _, jumps = frames_in_place(frames_of(times, rate), positions)
    others = [names[i] for i in rest if names[i] and i not in (time_at, frame_at)]
    if others:
        findings.append(values_left_out(f"the columns {some_of(others)} are no positions and are left out"))
    return Points(
        positions,
        tuple(group.name for group in groups),
        rate,
        "CSV",
        units=name,
        declared=comments.vertical,
        first_frame=1 if first is None else first,
        first_time=float(times[0]) if times is not None and len(times) and np.isfinite(times[0]) else None,
        events=comments.events,
        subject=comments.subject,
        findings=(*found, *findings, *missing, *jumps, *unread_events(comments.unread)),
    )


def write_wide(path: Path, recording: Recording, confidence: LabelConfidence | None = None) -> list[str]:
    """Write frame, time and three columns per marker; comment lines on top carry units, rate, vertical and events.

    The confidence of labels follows in a column each, such as LKNE_confidence.

    Units are those of the file that the recording came from where that is mm, cm or m, else metres. Returns what the format cannot carry.
    """
    positions, labels, omitted = all_points(recording, "CSV", events=True)
    units = str(recording.metadata.get("units", "")).casefold()
    units = units if units in ("mm", "cm", "m") else "m"
    decimals = {"mm": 6, "cm": 7, "m": 9}[units]
    first, times = recording.first_frame, recording.times
    head = comment_lines(
        units, recording.rate, recording.vertical, len(positions), first, str(recording.metadata.get("subject", "")), recording.events
    )
    # Separators and # in a name would end a cell, or the header.
    bare = [cell_text(re.sub(r'[,;"#]', " ", label)) for label in _unrepeated(labels)]
    names = [f"{label}_{axis}" for label in bare for axis in "xyz"]
    body = spelled_numbers(dense_rows(positions / METRES_PER_UNIT[units], decimals), ",", decimals)
    if confidence is not None:
        # Of repeated labels the first keeps its name, so that it gets the confidence.
        bare_of = dict(zip(reversed(labels), reversed(bare), strict=True))
        names += [f"{bare_of.get(name, name)}{_CONFIDENCE}" for name in confidence.names]
        body = [
            f"{row},{','.join(f'{value:.6g}' for value in values)}" for row, values in zip(body, confidence.values.tolist(), strict=True)
        ]
    rows = [",".join(filter(None, (str(first + t), f"{times[t]:.9g}", row))) for t, row in enumerate(body)]
    write_atomically(path, utf8("\n".join([*head, ",".join(["frame", "time", *names]), *rows]) + "\n"))
    if len(set(labels)) < len(labels):
        omitted.append("labels that occur more than once, to whose repeats a number was added")
    return omitted


def read_wide_confidence(path: Path) -> LabelConfidence | None:
    """The columns of confidence in a file that Asterism wrote; None where it has none."""
    lines = lines_of(decoded(path, read_bytes(path)))
    at = data_start(lines)
    if comments_of(lines).frames is None or at >= len(lines):
        return None
    names = cells_of(lines[at], ",")
    begin = _positions_end(names)
    if begin == len(names):
        return None
    values, _ = rows_of_numbers(path, lines[at + 1 :], at + 2, ",", len(names))
    return LabelConfidence(tuple(name.removesuffix(_CONFIDENCE) for name in names[begin:]), np.nan_to_num(values[:, begin:]))


def _positions_end(names: list[str]) -> int:
    """Where the columns of positions end and those of confidence begin."""
    end = len(names)
    while end > 2 and names[end - 1].endswith(_CONFIDENCE):
        end -= 1
    return end


def _header(lines: list[str], at: int, delimiter: str | None) -> tuple[list[str], str | None, int]:
    """Column names, the unit of a units row, and where the numbers begin."""
    names = cells_of(lines[at], delimiter)
    below = cells_of(lines[at + 1], delimiter) if at + 1 < len(lines) else []
    axes = [cell for cell in below if re.fullmatch(r"(?i)[xyz]", cell)]
    body = at + 1
    # Names over axes: the name stands over the first of its three columns.
    if len(axes) >= 3 and len(axes) >= 0.5 * len([cell for cell in below if cell]):
        width = max(len(names), len(below))
        names += [""] * (width - len(names))
        below += [""] * (width - len(below))
        over = ""
        joined = []
        for name, axis in zip(names, below, strict=True):
            # A blank cell belongs to the name before it.
            over = name or over
            joined.append(f"{over}_{axis}" if re.fullmatch(r"(?i)[xyz]", axis) else (axis or name))
        names, body = joined, at + 2
        below = cells_of(lines[body], delimiter) if body < len(lines) else []
    words = [cell.strip("[]()").casefold() for cell in below]
    lengths = [word for word in words if word in METRES_PER_UNIT]
    # A row of units has words where the data have numbers.
    if sum(word in METRES_PER_UNIT or OTHER_UNIT.fullmatch(word) is not None for word in words) < 3 or any(
        number_of(word) is not None for word in words if word
    ):
        return names, None, body
    # What is measured in newtons or degrees is no position: its unit becomes part of its name, as in a header of one row.
    named = [f"{name} ({word})" if OTHER_UNIT.fullmatch(word) else name for name, word in zip(names, words, strict=False)]
    return [*named, *names[len(named) :]], next(iter(lengths), None), body + 1


def _names_markers(lines: list[str], at: int) -> bool:
    """Whether a line is a header that spells out positions of points, with numbers below."""
    names, _, body = _header(lines, at, delimiter_of(lines[at]))
    first = next((line for line in lines[body:] if line.strip(" ,;\t")), "")
    numbers = [number_of(cell) for cell in cells_of(first, separator_of(first, delimiter_of(lines[at])))]
    return None not in numbers and len(numbers) > 2 and len(marker_groups(names)[0]) > 0


def _preamble(lines: list[str]) -> tuple[float | None, str | None]:
    """The frames per second and the unit of length in lines such as `Frequency: 100` and `Units,mm`; None where they are not there."""
    rate, units = None, None
    for line in lines:
        key, *values = [cell for cell in re.split(r"[:=,;\t]+\s*", line.strip(' ,;\t"')) if cell] or [""]
        value = values[0].strip(' "').casefold() if values else ""
        if rate is None and re.search(r"(?i)freq|rate|\bfps\b|\bhz\b", key):
            rate = number_of(re.sub(r"\s*(hz|fps)$", "", value)) if value else None
        if units is None and value in METRES_PER_UNIT and re.search(r"(?i)unit", key):
            units = value
    return rate, units


def _numbers_only(lines: list[str], names: list[str], rest: list[int], delimiter: str | None) -> list[str]:
    """The data lines with columns that hold text (a subject, a comment) blanked, where the first line has such."""
    first = next((line for line in lines if line.strip(" ,;\t")), "")
    cells = cells_of(first, delimiter)
    # Columns of text, such as a subject, are blanked, or no row would be one of numbers.
    words = {i for i in rest if i < len(cells) and number_of(cells[i]) is None}
    return lines if len(cells) > len(names) else blanked(lines, words, delimiter)


def _unrepeated(labels: tuple[str, ...]) -> list[str]:
    seen: dict[str, int] = {}
    out = []
    for label in labels:
        seen[label] = seen.get(label, 0) + 1
        out.append(label if seen[label] == 1 else f"{label} {seen[label]}")
    return out
