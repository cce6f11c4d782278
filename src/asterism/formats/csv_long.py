"""CSV with one row per sample: frame, time, marker, x, y, z (labelled) or frame, x, y, z (anonymous clouds): in and out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.files.atomic import utf8, write_atomically
from asterism.files.text import cell_text, cells_of, decoded, delimiter_of, lines_of, name_of_cell, number_of, read_bytes, some_of
from asterism.findings import Finding
from asterism.formats._columns import Points, as_metres, metres_per_unit
from asterism.formats._comments import comment_lines, comments_of, data_start
from asterism.formats._confidence import LabelConfidence
from asterism.formats._findings import cut_off, unread_events
from asterism.formats._tables import decimal_points, rate_of
from asterism.formats._writing import all_points
from asterism.recording import Clouds, Floats, Ints, Recording

_AXIS = re.compile(r"(?i)(?:pos(?:ition)?[_ .]?|coord(?:inate)?[_ .]?)?([xyz])(?:\s*[\[(_ ]\s*(mm|cm|m)\s*[\])]?)?")
_NAME = re.compile(r"(?i)(marker|name|label|point|trajectory)([_ ]?(name|label|id))?")
_FRAME = re.compile(r"(?i)(frame|frames|frame[_ ]?(no|number|id|index)|t_index|frame#)")
_TIME = re.compile(r"(?i)(time|t|timestamp|seconds)(\s*[\[(_ ]\s*s\w*\s*[\])]?)?")
_MOST_SPREAD, _MOST_EMPTY = 200, 2_000_000


def is_long(lines: Sequence[str]) -> bool:
    """Whether the header has one column each for x, y and z and one for the frame or the time."""
    at = data_start(lines)
    if at >= len(lines):
        return False
    names = cells_of(lines[at], delimiter_of(lines[at]))
    axes = [match[1].lower() for name in names if (match := _AXIS.fullmatch(name))]
    return sorted(axes) == ["x", "y", "z"] and any(_FRAME.fullmatch(name) or _TIME.fullmatch(name) for name in names)


def read_long(path: Path) -> Points:
    """All points of a CSV file with one row per sample; without a column of names, the n-th point of each frame is called *n.

    Frames come from a frame column, else from the distinct times. A frame without rows has no points.

    Raises AsterismError, naming file and line, where a marker occurs twice in a frame or a cell is not a number.
    """
    lines = lines_of(decoded(path, read_bytes(path)))
    comments = comments_of(lines)
    at = data_start(lines)
    delimiter = delimiter_of(lines[at])
    names = cells_of(lines[at], delimiter)
    axes = {match[1].lower(): i for i, name in enumerate(names) if (match := _AXIS.fullmatch(name))}
    units = next((match[2] for name in names if (match := _AXIS.fullmatch(name)) and match[2]), None)
    frame_at = next((i for i, name in enumerate(names) if _FRAME.fullmatch(name)), None)
    time_at = next((i for i, name in enumerate(names) if _TIME.fullmatch(name)), None)
    name_at = next((i for i, name in enumerate(names) if _NAME.fullmatch(name)), None)
    # The clock and the place are what every row must have.
    wanted = [i for i in (frame_at, time_at) if i is not None] + [axes[axis] for axis in "xyz"]
    findings: list[Finding] = []
    # Our own files end with a line's end: without it, the last line was cut off, maybe within a number.
    if comments.frames is not None and lines[-1].strip():
        lines = lines[:-1]
        findings.append(cut_off("the file ends within a line, which is left out"))
    values, marks, line_numbers = _samples(path, lines, at + 1, delimiter, wanted, name_at, len(names))
    count = 1 + (frame_at is not None and time_at is not None)
    raw = values[:, count:]
    frame, frames, first = _frames(path, values[:, 0], frame_at is not None, comments.first_frame, comments.frames, line_numbers)
    times: Floats | None = None
    if time_at is not None:
        stamps = values[:, [i for i in (frame_at, time_at) if i is not None].index(time_at)]
        times = np.full(frames, np.nan)
        times[frame] = stamps
        known = np.isfinite(times)
        # Frames without a row have a time, too: the clock runs on between them.
        if known.sum() > 1:
            times = np.interp(np.arange(frames), np.nonzero(known)[0], times[known])
    labels, column = _columns(path, marks, frame, line_numbers)
    # Few samples over many frames and names are damage, and would fill the memory.
    if frames * max(1, len(labels)) > _MOST_SPREAD * len(values) + _MOST_EMPTY:
        raise AsterismError(
            f"{path} spreads over {frames} frames and {len(labels)} points, too many for memory; split it or correct its frame numbers."
        )
    spread = np.full((frames, len(labels), 3), np.nan)
    spread[frame, column] = raw
    scale, name, found = metres_per_unit(path, comments.units or units, spread)
    positions, missing = as_metres(spread, scale)
    return Points(
        positions,
        tuple(labels),
        rate_of(path, comments.rate, times, findings),
        "CSV long",
        units=name,
        declared=comments.vertical,
        first_frame=first,
        first_time=float(times[0]) if times is not None and len(times) and np.isfinite(times[0]) else None,
        events=comments.events,
        subject=comments.subject,
        findings=(*found, *findings, *missing, *unread_events(comments.unread)),
    )


def write_long(path: Path, recording: Recording, confidence: LabelConfidence | None = None) -> list[str]:
    """Write one row per visible sample: frame, time, marker, x, y, z in metres, 17 digits; and the confidence, where it is given."""
    positions, labels, omitted = all_points(recording, "CSV", events=True)
    first, times = recording.first_frame, recording.times
    head = comment_lines(
        "m", recording.rate, recording.vertical, len(positions), first, str(recording.metadata.get("subject", "")), recording.events
    )
    names = [cell_text(re.sub(r"[\s,;\"]+", " ", label)) for label in labels]
    frames, columns = np.nonzero(~np.isnan(positions[:, :, 0]))
    ends = _confidence_cells(confidence, labels, frames, columns)
    rows = [
        f"{first + t},{times[t]:.9g},{names[m]},{x:.17g},{y:.17g},{z:.17g}{end}"
        for t, m, (x, y, z), end in zip(frames.tolist(), columns.tolist(), positions[frames, columns].tolist(), ends, strict=True)
    ]
    title = "frame,time,marker,x,y,z" + ("" if confidence is None else ",confidence")
    write_atomically(path, utf8("\n".join([*head, title, *rows]) + "\n"))
    # A column without a sample has no row, so that the file cannot name it.
    unseen = [label for m, label in enumerate(labels) if np.isnan(positions[:, m, 0]).all()]
    if unseen:
        omitted.append(f"columns without a sample: {', '.join(unseen[:5])}")
    return omitted


def _confidence_cells(confidence: LabelConfidence | None, labels: Sequence[str], frames: Ints, columns: Ints) -> list[str]:
    """The last cell of each row, with the comma before it: empty for a label without a confidence, nothing where none is known."""
    if confidence is None:
        return [""] * len(frames)
    values = {name: confidence.values[:, m] for m, name in enumerate(confidence.names)}
    pairs = zip(frames.tolist(), columns.tolist(), strict=True)
    return [f",{values[labels[m]][t]:.6g}" if labels[m] in values else "," for t, m in pairs]


def read_long_confidence(path: Path) -> LabelConfidence | None:
    """The column `confidence` of a file that Asterism wrote, by label and frame; None where it has none."""
    lines = lines_of(decoded(path, read_bytes(path)))
    at = data_start(lines)
    # Only our own files have this column, so that their header tells them.
    if at >= len(lines) or lines[at].strip() != "frame,time,marker,x,y,z,confidence":
        return None
    points = read_long(path)
    index = {label: m for m, label in enumerate(points.labels)}
    values = np.full((len(points.positions), len(index)), np.nan)
    for line in lines[at + 1 :]:
        cells = cells_of(line, ",")
        if len(cells) == 7 and cells[6]:
            number = number_of(cells[6])
            values[int(cells[0]) - points.first_frame, index[cells[2]]] = np.nan if number is None else number
    known = np.nonzero(~np.isnan(values).all(axis=0))[0]
    return LabelConfidence(tuple(points.labels[m] for m in known), np.nan_to_num(values[:, known]))


def write_clouds(path: Path, clouds: Clouds) -> list[str]:
    """Write anonymous clouds, one row per point: frame, x, y, z in metres, 17 digits; frames count from 0."""
    head = comment_lines("m", clouds.rate, clouds.vertical, len(clouds), 0)
    frames = clouds.frame_of
    rows = [f"{t},{x:.17g},{y:.17g},{z:.17g}" for t, (x, y, z) in zip(frames.tolist(), clouds.xyz.tolist(), strict=True)]
    write_atomically(path, utf8("\n".join([*head, "frame,x,y,z", *rows]) + "\n"))
    return [] if (clouds.columns < 0).all() else ["the columns that the points came from"]


def _samples(
    path: Path, lines: list[str], start: int, delimiter: str | None, wanted: list[int], name_at: int | None, width: int
) -> tuple[Floats, list[str] | None, list[int]]:
    """The wanted numbers of each row, its marker's name, and its line number; the header has `width` cells."""
    values: list[list[float]] = []
    marks: list[str] = []
    numbers: list[int] = []
    with_point = decimal_points(path, lines[start:], delimiter)
    last = max([*wanted, -1 if name_at is None else name_at])
    for i in range(start, len(lines)):
        line = lines[i]
        if not line.strip(" ,;\t"):
            continue
        cells = cells_of(line, delimiter) if '"' in line else line.split(delimiter)
        if len(cells) > width and any(cell.strip() for cell in cells[width:]):
            raise AsterismError(f"{path}, line {i + 1}: {len(cells)} cells where the header has {width}; correct or remove this line.")
        if len(cells) <= last:
            # The last line of a file that broke off is dropped; others are damage inside.
            if i == len(lines) - 1:
                break
            raise AsterismError(f"{path}, line {i + 1}: {len(cells)} cells where the header has more; correct or remove this line.")
        try:
            row = [float(cells[k] if with_point is None else with_point(cells[k])) for k in wanted]
        except ValueError:
            row = []
            for k in wanted:
                number = number_of(cells[k] if with_point is None else with_point(cells[k]))
                if number is None:
                    raise AsterismError(
                        f"{path}, line {i + 1}, column {k + 1}: {cells[k].strip()[:30]!r} is not a number; correct it or leave it blank."
                    ) from None
                row.append(number)
        values.append(row)
        numbers.append(i + 1)
        if name_at is not None:
            marks.append(name_of_cell(cells[name_at].strip()))
    return np.array(values, dtype=np.float64).reshape(len(values), len(wanted)), marks if name_at is not None else None, numbers


def _frames(
    path: Path, column: Floats, numbered: bool, first: int | None, count: int | None, lines: list[int]
) -> tuple[NDArray[np.int64], int, int]:
    """For each row its frame from 0, the number of frames, and the number of the first."""
    if not len(column):
        return np.empty(0, dtype=np.int64), count or 0, 1 if first is None else first
    wrong = ~np.isfinite(column) | ((column != np.round(column)) | (np.abs(column) > 2**31) if numbered else False)
    if wrong.any():
        raise AsterismError(f"{path}, line {lines[int(np.nonzero(wrong)[0][0])]}: the frame is not a whole number; correct it.")
    if not numbered:
        # Distinct times are the frames where no column counts them.
        _, frame = np.unique(column, return_inverse=True)
        return frame.astype(np.int64), int(frame.max()) + 1, 1
    low = int(column.min()) if first is None else min(first, int(column.min()))
    frame = (column - low).astype(np.int64)
    span = int(frame.max()) + 1
    # The file may end with empty frames, which only its comment knows.
    if count is not None and span <= count <= span + 1_000_000:
        span = count
    if span > 100 * len(column) + 100_000:
        raise AsterismError(
            f"{path}: frame numbers run from {low} to {low + span - 1} for {len(column)} samples; correct the frame column."
        )
    return frame, span, low


def _columns(path: Path, marks: list[str] | None, frame: NDArray[np.int64], lines: list[int]) -> tuple[list[str], NDArray[np.int64]]:
    """The labels in order of appearance and each row's column; anonymous points are numbered within their frame."""
    # Points without a name are counted within their frame, in the order of the rows.
    if marks is None:
        order = np.argsort(frame, kind="stable")
        ordered = frame[order]
        starts = np.searchsorted(ordered, ordered, side="left")
        column = np.empty(len(frame), dtype=np.int64)
        column[order] = np.arange(len(frame)) - starts
        return [f"*{i + 1}" for i in range(int(column.max()) + 1 if len(column) else 0)], column
    index: dict[str, int] = {}
    column = np.array([index.setdefault(mark, len(index)) for mark in marks], dtype=np.int64)
    labels = [name or "*" for name in index]
    # Frame and marker as one number: equal ones are repeats.
    key = frame * max(1, len(index)) + column
    order = np.argsort(key, kind="stable")
    repeated = np.nonzero(np.diff(key[order]) == 0)[0]
    if len(repeated):
        row = int(order[repeated[0] + 1])
        raise AsterismError(
            f"{path}, line {lines[row]}: {some_of([labels[int(column[row])]])} occurs twice in this frame; remove or rename one of the two."
        )
    return labels, column
