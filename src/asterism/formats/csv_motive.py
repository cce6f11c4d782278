"""Motive's CSV export (versions 1.2x and 3.x): a file in, its markers out; poses of rigid bodies and bones are left out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError
from asterism.files.text import cells_of, decoded, delimiter_of, lines_of, number_of, read_bytes
from asterism.formats._columns import Points, as_metres, metres_per_unit
from asterism.formats._findings import header_conflict
from asterism.formats._physical import COMPUTED, MARKER, UNNAMED, kinds_by_name
from asterism.formats._tables import blanked, frames_in_place, lead_of, lines_in_order, rate_of, rows_of_numbers
from asterism.recording import Floats, as_vertical
from asterism.recording.arrays import nan_median

_TYPES = {"marker", "rigid body", "rigid body marker", "bone", "bone marker", "skeleton", "marker set", "unlabeled marker"}
_TWIN = 0.01


@dataclass(frozen=True)
class _Block:
    kind: str
    name: str
    columns: tuple[int, int, int]


def read_motive(path: Path) -> Points:
    """All markers of a Motive export. Rigid-body markers count as computed only where the file also has the measured ones.

    Positions of rigid bodies and bones are poses, computed. Motive is Y up. Raises AsterismError, naming the file, where its
    header or a cell cannot be read.
    """
    lines = lines_of(decoded(path, read_bytes(path)))
    # A spreadsheet that saved the export again writes its own separator and decimal sign.
    top = next(i for i, line in enumerate(lines) if line.strip())
    delimiter = delimiter_of(lines[top])
    header = _key_values(cells_of(lines[top], delimiter))
    at = next((i for i, line in enumerate(lines[: top + 24]) if i > top and cells_of(line, delimiter)[:1] in (["Frame"], ["frame"])), None)
    if at is None:
        raise AsterismError(f"{path} has no line that begins with Frame; export it from Motive again, with its header.")
    above = [cells_of(line, delimiter) for line in lines[top + 1 : at]]
    # Motive moves these rows from version to version: they are found by what they hold.
    types = next((row for row in above if any(cell.casefold() in _TYPES for cell in row[2:])), None)
    if types is None:
        raise AsterismError(f"{path} has no row with the types of its columns (Marker, Rigid Body, ...); export it with its header.")
    below = above[above.index(types) + 1 :]
    names = next((row for row in above if row[1:2] in (["Name"], ["name"])), below[0] if below else [])
    if names[1:2] in (["ID"], ["Parent"]) or names == types:
        raise AsterismError(f"{path} has no row with the names of its markers; export it from Motive again, with its header.")
    what = next((row for row in reversed(above) if any(cell.casefold() == "position" for cell in row)), [])
    axes = cells_of(lines[at], delimiter)
    blocks = _blocks(path, types, names, what, axes)
    if not blocks:
        raise AsterismError(f"{path} holds no positions; export it from Motive again, with markers.")
    columns = [column for block in blocks for column in block.columns]
    # A timecode is no number.
    words = {i for i, axis in enumerate(axes) if axis.casefold() == "timecode"}
    body = blanked(lines[at + 1 :], words, delimiter)
    values, findings = rows_of_numbers(path, body, at + 2, delimiter, len(axes), lead_of(columns, len(axes)))
    values, moved = lines_in_order(values, values[:, 0])
    findings += moved
    raw = values[:, columns].reshape(len(values), len(blocks), 3)
    scale, units, found = metres_per_unit(path, header.get("length units"), raw)
    positions, missing = as_metres(raw, scale)
    declared = number_of(header.get("export frame rate", header.get("capture frame rate", "")))
    times = values[:, 1] if len(axes) > 1 and axes[1].casefold().startswith("time") else None
    rate = rate_of(path, declared, times, findings)
    # Kinds are told before empty frames are put in between.
    kinds = _kinds(blocks, positions)
    positions, first, jumps = frames_in_place(values[:, 0], positions)
    # A recording that was stopped early still has the header of the whole take.
    total = number_of(header.get("total exported frames", ""))
    if total is not None and total == total and total != len(values):
        findings.append(header_conflict(f"the header says {total:g} frames, the file holds {len(values)}"))
    return Points(
        positions,
        tuple(block.name for block in blocks),
        rate,
        "Motive CSV",
        units=units,
        kinds=kinds,
        declared=as_vertical("y"),
        first_frame=first,
        first_time=float(times[0]) if times is not None and len(times) and np.isfinite(times[0]) else None,
        findings=(*found, *findings, *missing, *jumps),
        extra={"motive_version": header.get("format version", ""), "take": header.get("take name", "")},
    )


def _key_values(cells: list[str]) -> dict[str, str]:
    return {key.casefold(): value for key, value in zip(cells[::2], cells[1::2], strict=False) if key}


def _blocks(path: Path, types: list[str], names: list[str], what: list[str], axes: list[str]) -> list[_Block]:
    """Runs of three columns X, Y, Z that are positions of one thing. Raises AsterismError where the rows above do not fit them."""
    blocks = []
    for i in range(2, len(axes) - 2):
        trio = [cell.upper() for cell in axes[i : i + 3]]
        if trio != ["X", "Y", "Z"] or {cell.casefold() for cell in what[i : i + 3]} == {"rotation"}:
            continue
        # Rows that have lost a cell would give the names to other markers.
        if any(len(row) < i + 3 or len(set(row[i : i + 3])) != 1 for row in (types, names, *([what] if what else []))):
            raise AsterismError(
                f"{path}, column {i + 1}: X, Y and Z do not stand below one name, type and Position; export it from Motive again."
            )
        blocks.append(_Block(types[i].casefold(), names[i], (i, i + 1, i + 2)))
    return blocks


def _kinds(blocks: list[_Block], positions: Floats) -> tuple[str, ...]:
    """Poses are computed; fitted markers of a rigid body or a bone are where a measured marker runs along within 10 mm."""
    measured = [i for i, block in enumerate(blocks) if block.kind in ("marker", "unlabeled marker")]
    kinds = []
    for i, block in enumerate(blocks):
        # A fitted marker is a copy only where a measured one runs along.
        if block.kind in ("rigid body", "bone", "skeleton") or (
            block.kind in ("rigid body marker", "bone marker") and _has_twin(positions, i, measured)
        ):
            kinds.append(COMPUTED)
        else:
            kinds.append(UNNAMED if kinds_by_name([block.name])[0] == UNNAMED else MARKER)
    return tuple(kinds)


def _has_twin(positions: Floats, fitted: int, measured: list[int]) -> bool:
    for other in measured:
        apart = np.linalg.norm(positions[:, fitted] - positions[:, other], axis=1)
        both = np.isfinite(apart)
        # 10 mm: the fit moves a marker by its error, seldom by more.
        if both.sum() > 0 and float(nan_median(apart[both], axis=0)) < _TWIN:
            return True
    return False
