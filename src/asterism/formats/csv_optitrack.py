"""The CSV export of Motive 1.0 to 1.7 and of Tracking Tools (versions 1.0 and 1.1 of the format): a file in, its markers out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError, NoMarkers
from asterism.files.text import cells_of, decoded, delimiter_of, lines_of, number_of, read_bytes
from asterism.findings import Finding
from asterism.formats._columns import Points, as_metres, metres_per_unit
from asterism.formats._findings import cut_off, header_conflict, rate_conflict, values_left_out
from asterism.formats._tables import frames_in_place, rate_of
from asterism.recording import Floats, as_vertical, is_unnamed

_BODY = 11
"""Cells of a rigid body in a row: its number, place (3), quaternion (4) and angles (3)."""


def is_optitrack(lines: Sequence[str]) -> bool:
    """Whether rows begin with what they hold: comment, info, frame."""
    kinds = {_cells(line)[0].casefold() for line in lines[:200] if line.strip(" ,;\t")}
    return "info" in kinds and bool(kinds & {"comment", "frame", "righthanded", "lefthanded"})


def read_optitrack(path: Path) -> Points:
    """All markers of the export, each under its name; markers without one are numbered within their frame. Metres, Y up.

    A left-handed file is mirrored in z, because a mirrored body has its sides exchanged. Poses of rigid bodies are left out.
    Raises AsterismError, naming file and line, where a row of a frame cannot be read, and NoMarkers where no frame has a marker.
    """
    lines = lines_of(decoded(path, read_bytes(path)))
    info: dict[str, str] = {}
    left_handed, bodies = False, 0
    frames: list[float] = []
    times: list[float] = []
    seen: list[list[tuple[str, list[float]]]] = []
    findings: list[Finding] = []
    for i, line in enumerate(lines):
        cells = _cells(line)
        kind = cells[0].casefold()
        left_handed |= kind == "lefthanded"
        if kind == "info" and len(cells) > 2:
            info[cells[1].casefold()] = cells[2]
        if kind != "frame":
            continue
        try:
            frame, time, count, markers = _frame(cells)
        except ValueError:
            # Without its end, the last row is that of a file that was cut off.
            if i == len(lines) - 1 and len(frames):
                findings.append(cut_off("the file ends within a line; its last frame is left out"))
                break
            raise AsterismError(
                f"{path}, line {i + 1}: a row of a frame that cannot be read; correct it or export the file again."
            ) from None
        frames.append(frame)
        times.append(time)
        seen.append(markers)
        bodies = max(bodies, count)
    if not any(seen):
        what = "poses of rigid bodies" if bodies else "no frame"
        raise NoMarkers(f"{path} is an OptiTrack export with {what} and no marker; export it again with markers.")
    labels, raw = _columns(seen)
    scale, units, found = metres_per_unit(path, "m", raw)
    positions, missing = as_metres(raw, scale)
    if left_handed:
        positions[:, :, 2] *= -1.0
        findings.append(header_conflict("the file is left-handed; its z axis was turned round"))
    if bodies:
        findings.append(values_left_out(f"the poses of {bodies} rigid bodies are left out"))
    said = number_of(info.get("framecount", ""))
    if said is not None and said == said and said != len(frames):
        findings.append(header_conflict(f"the header says {said:g} frames, the file holds {len(frames)}"))
    rate = _rate(path, np.array(frames), np.array(times), findings)
    positions, first, jumps = frames_in_place(np.array(frames), positions)
    return Points(
        positions,
        tuple(labels),
        rate,
        "OptiTrack CSV",
        units=units,
        declared=as_vertical("y"),
        first_frame=first,
        first_time=times[0],
        findings=(*found, *findings, *missing, *jumps),
    )


def _cells(line: str) -> list[str]:
    return cells_of(line, delimiter_of(line)) or [""]


def _frame(cells: list[str]) -> tuple[float, float, int, list[tuple[str, list[float]]]]:
    """The number of a frame, its time (s), how many rigid bodies it has, and its markers. Raises ValueError where cells do not fit."""
    while cells and not cells[-1]:
        cells = cells[:-1]
    # Some files have one more cell before the number of rigid bodies: the row must come out even.
    for lead in (3, 4):
        bodies = int(_number(cells[lead])) if lead < len(cells) else -1
        at = lead + 1 + _BODY * bodies
        count = int(_number(cells[at])) if bodies >= 0 and at < len(cells) else -1
        rest = cells[at + 1 :]
        # Version 1.1 has a name behind the number of a marker, 1.0 has none.
        width = next((width for width in (5, 4) if len(rest) in (count * width, count * width - (width == 5))), 0)
        if count >= 0 and width and bool(count) == bool(rest):
            rows = [rest[i * width : (i + 1) * width] for i in range(count)]
            # A marker's own number stands behind its place, unless cells have moved.
            for row in rows:
                _number(row[3])
            return (
                _number(cells[1]),
                _number(cells[2]),
                bodies,
                [(row[4] if len(row) == 5 else "", [_number(cell) for cell in row[:3]]) for row in rows],
            )
    raise ValueError


def _number(cell: str) -> float:
    number = number_of(cell)
    if number is None or number != number:
        raise ValueError
    return number


def _columns(seen: list[list[tuple[str, list[float]]]]) -> tuple[list[str], Floats]:
    """The labels, and positions (T, P, 3). A name that occurs twice in a frame counts once; the others have none."""
    named = list(dict.fromkeys(name for markers in seen for name, _ in markers if name and not is_unnamed(name)))
    index = {name: column for column, name in enumerate(named)}
    places: list[tuple[int, int, list[float]]] = []
    most = 0
    for t, markers in enumerate(seen):
        taken: set[int] = set()
        unnamed = 0
        for name, place in markers:
            column = index.get(name, -1)
            if column < 0 or column in taken:
                column, unnamed = len(named) + unnamed, unnamed + 1
            taken.add(column)
            places.append((t, column, place))
        most = max(most, unnamed)
    raw = np.full((len(seen), len(named) + most, 3), np.nan)
    for t, column, place in places:
        raw[t, column] = place
    return [*named, *(f"*{i + 1}" for i in range(most))], raw


def _rate(path: Path, frames: Floats, times: Floats, findings: list[Finding]) -> float:
    """Frames per second by the times; where these are those at which frames arrived, and uneven, by their mean."""
    try:
        return rate_of(path, None, times, findings)
    except AsterismError:
        span, steps = float(times[-1] - times[0]), float(frames[-1] - frames[0])
        if not (span > 0 and steps > 0):
            raise
        rate = float(f"{steps / span:.4g}")
        findings.append(rate_conflict(f"its times are uneven; the rate is their mean, {rate:g} frames per second"))
        return rate
