"""A C3D file becomes a `Recording`: path in, positions in metres, events and everything that a writer needs out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from asterism.errors import AsterismError, NoMarkers
from asterism.findings import Finding
from asterism.formats._columns import METRES_PER_UNIT, Points, coded_samples, metres_per_unit, recording_of
from asterism.formats._physical import COMPUTED, OTHER_UNIT, point_kinds
from asterism.formats.c3d._edit import COMPUTED_GROUPS, log_of
from asterism.formats.c3d._file import C3DFile, numbered, open_c3d
from asterism.recording import Floats, Recording, as_vertical

_UNITS = ("UNITS", "MODELED_MARKER_UNITS", "SCALAR_UNITS")
"""Parameters of POINT: the unit of the points, and others among which it may stand by mistake."""


def read_c3d(path: Path, markers: Any = None, vertical: ArrayLike | str | None = None) -> Recording:
    """The recording in a C3D file of any vendor, byte order and number format.

    path      the file
    markers   None: every point that is not computed, under the file's labels; else what `MarkerSet.load` takes
    vertical  None: what POINT:Y_SCREEN declares unless the markers contradict it with two signs, else what the markers show, else +Z, the
              convention of C3D files (metadata["vertical_from"] says which)

    Returns positions in metres, NaN where a point is missing (negative residual, not finite, or all zero where the file has no
    other mark for it); events; and as `source` the whole file, so that `write_c3d` loses nothing.

    Raises AsterismError where the file is not a C3D file, holds no points or no frames, has none of the markers or one of them
    twice, or has impossible units. Source: the public C3D format specification.
    """
    file = open_c3d(path)
    # Force files are C3D files, too: they are passed over, not damaged.
    if not file.layout.points:
        analog = f", only {file.analog_channels} analog channels" if file.analog_channels else ""
        raise NoMarkers(f"{path} holds no points{analog}; choose a recording with markers.")
    if not file.layout.frames:
        raise AsterismError(f"{path} holds no frames; export it again.")
    return recording_of(path, points_of(file), markers, vertical, source=file)


def points_of(file: C3DFile, some: slice | None = None) -> Points:
    """Every point of a file in metres, with what the file says about them. Raises AsterismError for an impossible rate or unit.

    some: the frames, by default all.
    """
    raw = file.coordinates if some is None else file.coordinates_of(some)
    # Some frames of a long recording need not show how large a person is.
    scale, units, found = unit_of(file, raw if some is None else None)
    positions = scaled(raw, scale)
    return Points(
        positions=positions,
        labels=tuple(file.labels),
        rate=file.rate,
        format="C3D",
        units=units,
        kinds=tuple(kinds_of_points(file, positions)),
        declared=declared_vertical(file),
        fallback=as_vertical("z"),
        first_frame=file.first_frame,
        events=file.events,
        subject=one_subject(file),
        findings=(*file.findings, *file.doubts, *found, *coded_samples(file.coded)),
        extra={"encoding": encoding_of(file), "metres_per_unit": scale},
        log=log_of(file.parameters),
        frames=file.layout.frames,
    )


def in_metres(file: C3DFile) -> tuple[Floats, float, str, list[Finding]]:
    """(frames, points, 3) m; metres per unit; the unit's name; a finding where the unit is assumed."""
    whole = file.coordinates
    scale, units, found = unit_of(file, whole)
    return scaled(whole, scale), scale, units, found


def unit_of(file: C3DFile, coordinates: Floats | None = None) -> tuple[float, str, list[Finding]]:
    """Metres per unit, the unit's name, and a finding where the unit is assumed; some 200 frames tell it.

    coordinates  (frames, points, 3) of the file, where they have been read already
    """
    # Values that are no lengths are taken for millimetres, as most files keep them, where they are read as markers all the same.
    if holds_values(file):
        return METRES_PER_UNIT["mm"], "mm", []
    frames = slice(None, None, max(1, file.layout.frames // 200))
    some = file.coordinates_of(frames) if coordinates is None else coordinates[frames]
    # Computed points have other sizes and units, and would mislead the guess.
    kinds = point_kinds(file.labels, None, declared_computed(file))
    captured = np.array([kind != COMPUTED for kind in kinds], dtype=bool)
    declared, *others = (file.parameters.text("POINT", name) for name in _UNITS)
    return metres_per_unit(Path(file.path), declared, some[:, captured], others)


def scaled(raw: Floats, scale: float) -> Floats:
    # Dividing by 1000 is exact where multiplying by 0.001 is not.
    """Coordinates in a file's unit as metres, in place; divided where that is exact."""
    if scale < 1 and scale == 1 / round(1 / scale):
        raw /= round(1 / scale)
    else:
        raw *= scale
    return raw


def kinds_of_points(file: C3DFile, positions: Floats) -> list[str]:
    """For each point "marker", "computed" or "unnamed": what the file declares, its names, and geometry where it is exact.

    positions (frames, points, 3) m. The rounded numbers of integer files keep no exact geometry.
    """
    if holds_values(file):
        return [COMPUTED] * len(file.labels)
    return point_kinds(file.labels, positions if file.layout.real else None, declared_computed(file))


def holds_values(file: C3DFile) -> bool:
    """Whether the unit of the points is none of length, but one of angles, forces or the like."""
    declared, *others = (file.parameters.text("POINT", name).casefold() for name in _UNITS)
    return OTHER_UNIT.fullmatch(declared) is not None and not any(other in METRES_PER_UNIT for other in others)


def declared_computed(file: C3DFile) -> set[str]:
    """Labels that the file lists as angles, forces and the like, also in the groups that it defines (POINT:TYPE_GROUPS)."""
    # Groups that a file defines itself are listed by name and type in turn.
    groups = dict.fromkeys([*COMPUTED_GROUPS, *(name.upper() for name in file.parameters.strings("POINT", "TYPE_GROUPS")[::2])])
    return {
        label
        for group in groups
        if group not in ("", "LABELS", "MARKERS")
        for name in numbered(file.parameters, "POINT", group)
        for label in file.parameters.strings("POINT", name)
        if label
    }


def declared_vertical(file: C3DFile) -> Floats | None:
    """The axis that POINT:Y_SCREEN says points up the screen, or None.

    Qualisys writes -Z for a vertical that is +Z, so a minus counts only in files that Asterism wrote.
    """
    # Our own files have the vertical in full, tilted or not.
    vector = file.parameters.values("POINT", "VERTICAL")
    if file.by_asterism and len(vector) == 3 and np.isfinite(vector).all() and vector.any():
        return as_vertical(vector)
    axis = file.parameters.text("POINT", "Y_SCREEN").casefold()
    if len(axis) not in (1, 2) or axis[-1] not in "xyz" or axis[:-1] not in ("", "+", "-"):
        return None
    return as_vertical(axis if file.by_asterism else axis[-1])


def one_subject(file: C3DFile) -> str:
    """The one subject that SUBJECTS:NAMES names, else ""."""
    # Of several subjects none is the recording's.
    names = [name for name in file.parameters.strings("SUBJECTS", "NAMES") if name]
    return names[0] if len(names) == 1 else ""


def encoding_of(file: C3DFile) -> str:
    """Processor and number format in words: "PC real", "SGI integer"."""
    return f"{file.processor.name} {'real' if file.layout.real else 'integer'}"
