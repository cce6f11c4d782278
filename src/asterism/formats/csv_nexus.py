"""Nexus' ASCII export: the section Trajectories of a file in, its points out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError, NoMarkers
from asterism.files.text import cells_of, decoded, delimiter_of, lines_of, number_of, read_bytes, some_of
from asterism.findings import Finding
from asterism.formats._columns import Points, as_metres, metres_per_unit
from asterism.formats._findings import cut_off, header_conflict, point_names, unread_events
from asterism.formats._tables import frames_in_place, lead_of, lines_in_order, rows_of_numbers
from asterism.recording import Event, Floats, as_vertical

_BLANKS = ' ,;\t"\ufeff'
_TRAJECTORIES = {"trajectories", "unlabeled trajectories", "unlabelled trajectories"}
_SECTIONS = _TRAJECTORIES | {"devices", "model outputs", "joints", "segments", "events", "emg", "force plates"}


def is_nexus(lines: Sequence[str]) -> bool:
    """Whether the first line names one of Nexus' sections and the second line is a rate or an event table."""
    top = next((i for i, line in enumerate(lines) if line.strip(_BLANKS)), 0)
    first = lines[top].strip(_BLANKS).casefold()
    if first not in _SECTIONS or len(lines) < top + 2:
        # A single word may be anything's header: the second line must be a rate.
        return False
    return number_of(lines[top + 1].strip(_BLANKS)) is not None or first == "events"


@dataclass(frozen=True)
class _Trajectories:
    """The points of one section: positions (T, P, 3) in the file's unit, the first frame's number, and what was found."""

    positions: Floats
    labels: list[str]
    rate: float
    units: str | None
    first: int
    findings: list[Finding]


def read_nexus(path: Path) -> Points:
    """The points of the sections Trajectories and Unlabeled Trajectories, and the events of the section Events where the file has one.

    Nexus is Z up. Raises AsterismError, naming file and line, where it has no such section or a cell is not a number.
    """
    lines = lines_of(decoded(path, read_bytes(path)))
    bare = [line.strip(_BLANKS).casefold() for line in lines]
    found = [i for i, line in enumerate(bare) if line in _TRAJECTORIES]
    if not found:
        held = some_of([lines[i].strip(_BLANKS) for i, line in enumerate(bare) if line in _SECTIONS])
        raise NoMarkers(f"{path} has no section Trajectories (it has {held}); export it from Nexus again, with trajectories.")
    # Points that Nexus could not label stand in a section of their own.
    sections = [_section(path, lines, bare, at) for at in found]
    filled = [section for section in sections if len(section.positions)] or sections[:1]
    first = min(section.first for section in filled)
    frames = max(section.first + len(section.positions) for section in filled) - first
    labels = [label for section in sections for label in section.labels]
    raw = np.full((frames, len(labels), 3), np.nan)
    done = 0
    for section in sections:
        start = section.first - first if len(section.positions) else 0
        raw[start : start + len(section.positions), done : done + len(section.labels)] = section.positions
        done += len(section.labels)
    scale, name, findings = metres_per_unit(path, sections[0].units, raw)
    positions, missing = as_metres(raw, scale)
    events, unread = _events(lines, bare)
    # What stands between blank lines under no known name is another section, or one whose name was damaged.
    starts = [i for i, line in enumerate(bare) if line and (i == 0 or not bare[i - 1])]
    unknown = [i for i in starts if bare[i] not in _SECTIONS]
    if unknown:
        begins = lines[unknown[0]].strip(_BLANKS)[:40]
        findings.append(header_conflict(f"a part without a known name, from line {unknown[0] + 1} on ({begins}), is left out"))
    numbers = iter(range(1, len(labels) + 1))
    return Points(
        positions,
        tuple(label or f"*{next(numbers)}" for label in labels),
        sections[0].rate,
        "Nexus CSV",
        units=name,
        declared=as_vertical("z"),
        first_frame=first,
        events=events,
        findings=(*findings, *(finding for section in sections for finding in section.findings), *missing, *unread),
    )


def _section(path: Path, lines: list[str], bare: list[str], at: int) -> _Trajectories:
    """The section of trajectories that begins at line `at`, counted from 0."""
    rate = number_of(bare[at + 1]) if at + 1 < len(bare) else None
    if rate is None or not 0 < rate < 1e6:
        raise AsterismError(f"{path}, line {at + 2}: the frame rate of the trajectories is missing here; export the file again.")
    if at + 4 >= len(lines):
        raise AsterismError(f"{path} ends within the header of its trajectories; export it again.")
    delimiter = delimiter_of(lines[at + 2]) or ","
    over, axes = cells_of(lines[at + 2], delimiter), cells_of(lines[at + 3], delimiter)
    words = [cell for cell in cells_of(lines[at + 4], delimiter) if cell]
    units = next(iter(words), None)
    # Nexus leaves the row of units out of some exports.
    has_units = len(words) > 0 and all(number_of(word) is None for word in words)
    labels, columns = _points(over, axes)
    astray = [i for i, name in enumerate(over) if name and i not in columns[::3]]
    if labels and astray:
        raise AsterismError(
            f"{path}, line {at + 3}, column {astray[0] + 1}: {over[astray[0]][:40]!r} does not stand over an X with Y and Z; "
            "correct the header or export the file again."
        )
    if not labels:
        raise AsterismError(f"{path}, line {at + 3}: no trajectory is named over columns X, Y, Z; export the file again.")
    # Nexus numbers what it could not label: such a number is no marker's name.
    if bare[at] != "trajectories":
        labels = [label if label.startswith("*") else "" for label in labels]
    start = at + (5 if has_units else 4)
    # The section ends with a blank line, or where the next one begins.
    end = next((i for i in range(start, len(lines)) if not bare[i] or bare[i] in _SECTIONS), len(lines))
    width = max(len(over), len(axes), max(columns) + 1)
    # Only the last line of the file may be cut off, and the lines of another section are whole.
    body = [*lines[start:end], *([""] if end < len(lines) else [])]
    values, findings = rows_of_numbers(path, body, start + 1, delimiter, width, lead_of(columns, width))
    nameless = sum(not label for label in labels) if bare[at] == "trajectories" else 0
    if nameless:
        findings.append(point_names(f"{nameless} trajectories have no name; they are numbered from *1"))
    if not len(values):
        findings.append(cut_off(f"its section {lines[at].strip(_BLANKS)} has no row of numbers"))
    frame_at = next((i for i, cell in enumerate(axes) if cell.casefold() == "frame"), 0)
    values, moved = lines_in_order(values, values[:, frame_at])
    findings += moved
    positions = values[:, columns].reshape(len(values), len(labels), 3)
    positions, first, jumps = frames_in_place(values[:, frame_at], positions)
    return _Trajectories(positions, labels, float(rate), units if has_units else None, first, [*findings, *jumps])


def _points(over: list[str], axes: list[str]) -> tuple[list[str], list[int]]:
    """Names, "" for none, that stand over an X with Y and Z beside it, and the three columns of each, one after the other."""
    labels: list[str] = []
    columns: list[int] = []
    for i, axis in enumerate(axes[:-2] if len(axes) > 2 else []):
        # X' and X'' are velocities and accelerations.
        trio = [re.sub(r"[^\w']", "", cell).upper() for cell in axes[i : i + 3]]
        if axis and trio == ["X", "Y", "Z"]:
            # Columns without a name are a trajectory that was not labelled.
            labels.append(over[i] if i < len(over) else "")
            columns += [i, i + 1, i + 2]
    return labels, columns


def _events(lines: list[str], bare: list[str]) -> tuple[tuple[Event, ...], list[Finding]]:
    """Rows Subject, Context, Name, Time of the section Events; and a finding where rows have no time."""
    at = next((i for i, line in enumerate(bare) if line == "events"), None)
    if at is None:
        return (), []
    events: list[Event] = []
    names: list[str] = []
    unread: list[int] = []
    for i in range(at + 1, len(lines)):
        if not bare[i] or bare[i] in _SECTIONS:
            if names:
                break
            continue
        cells = cells_of(lines[i], delimiter_of(lines[i]))
        lowered = [cell.casefold() for cell in cells]
        # The section has columns in any order, by version.
        if not names and "name" in lowered and any(cell.startswith("time") for cell in lowered):
            names = ["time" if cell.startswith("time") else cell for cell in lowered]
            # A number among the names is an event whose line joined theirs.
            unread += [i + 1] if any(number_of(cell) is not None for cell in cells if cell) else []
            continue
        row = dict(zip(names, cells, strict=False))
        time = number_of(row.get("time", ""))
        # The rate stands alone above the names of the columns.
        if not names and len([cell for cell in cells if cell]) == 1:
            continue
        if time is not None and np.isfinite(time) and row.get("name") and not any(cells[len(names) :]):
            events.append(Event(row["name"], float(time), row.get("context", "")))
        else:
            unread.append(i + 1)
    return tuple(events), unread_events(unread)
