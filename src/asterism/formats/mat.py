"""QTM's MAT export: labelled and unidentified trajectories of a file in, its points out, and back."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import numpy as np

from asterism.errors import AsterismError, NoMarkers
from asterism.files.atomic import write_atomically
from asterism.files.text import read_bytes
from asterism.formats._columns import Points, as_metres, metres_per_unit
from asterism.formats._mat5 import variables_of
from asterism.formats._physical import MARKER, UNNAMED
from asterism.formats._writing import all_points
from asterism.recording import Event, Floats, Recording, as_vertical


def read_mat(path: Path) -> Points:
    """The trajectories of a MAT file exported by QTM: labelled ones, then unidentified pieces as *1, *2, ...; QTM is Z up.

    A sample of Type 0 is missing. Raises AsterismError, naming the file, where it is damaged, of MATLAB's version 7.3, or not QTM's.
    """
    data = read_bytes(path)
    # MATLAB's version 7.3 is HDF5, which needs a library of its own.
    if data[1:4] == b"HDF" or data[:10] == b"MATLAB 7.3":
        raise AsterismError(f"{path} is a MAT file of version 7.3; save it with -v7 in MATLAB, or export it from QTM as C3D or TSV.")
    try:
        variables = variables_of(data)
    except ValueError as problem:
        raise AsterismError(f"{path} is damaged or no MAT file ({problem}); export it from QTM again.") from problem
    take = next((value for value in variables.values() if isinstance(value, dict) and "Trajectories" in value), None)
    if take is None:
        raise NoMarkers(
            f"{path} is a MAT file, but not one that QTM exports (no Trajectories in it); export 3D data from QTM as MAT, C3D or TSV."
        )
    try:
        return _points(path, take)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as problem:
        raise AsterismError(f"{path}: its trajectories are not laid out as QTM does ({problem}); export it from QTM again.") from problem


def _points(path: Path, take: dict[str, Any]) -> Points:
    frames, rate = int(_number(take["Frames"])), _number(take["FrameRate"])
    if not 0 <= frames < 100_000_000:
        raise ValueError(f"{frames} frames")
    sets = take["Trajectories"]
    raw, labels, kinds = [], list[str](), list[str]()
    # Pieces that QTM did not identify come after the named ones, numbered through.
    for key in ("Labeled", "Unidentified"):
        part = sets.get(key) if isinstance(sets, dict) else None
        if not isinstance(part, dict) or "Data" not in part:
            continue
        names = [str(name) for name in part.get("Labels", ())] if key == "Labeled" else []
        positions = _samples(part, frames, len(names))
        for i in range(positions.shape[1]):
            named = i < len(names) and bool(names[i].strip())
            labels.append(names[i] if named else f"*{1 + sum(kind == UNNAMED for kind in kinds)}")
            kinds.append(MARKER if named else UNNAMED)
        raw.append(positions)
    together = np.concatenate(raw, axis=1) if raw else np.full((frames, 0, 3), np.nan)
    if not np.isfinite(rate) or rate <= 0:
        raise AsterismError(f"{path} gives a frame rate of {rate:g}; export it from QTM again.")
    # QTM always writes millimetres; the size of the body checks it.
    scale, units, found = metres_per_unit(path, "mm", together)
    positions, missing = as_metres(together, scale, zero_is_missing=False)
    return Points(
        positions,
        tuple(labels),
        rate,
        "QTM MAT",
        units=units,
        kinds=tuple(kinds),
        declared=as_vertical("z"),
        first_frame=int(_number(take["StartFrame"])) if "StartFrame" in take else 1,
        events=_events(take.get("Events")),
        findings=(*found, *missing),
        extra={"time_stamp": str(take.get("Timestamp", "")).replace("\t", " ")},
    )


def _number(value: Any) -> float:
    """The one number that an array of size 1 holds."""
    return float(np.asarray(value, dtype=np.float64).reshape(()))


def _samples(part: dict[str, Any], frames: int, named: int) -> Floats:
    """(T, N, 3) in the file's unit from Data (N, 4, T), which MATLAB stores as (N, 4) where T is 1, with Type 0 as NaN."""
    data = np.asarray(part["Data"], dtype=np.float64)
    # An empty array still says how many trajectories there were.
    if data.size == 0:
        return np.full((frames, max(named, min(data.shape[0], 10_000) if data.ndim == 3 else 0), 3), np.nan)
    # MATLAB drops the last dimension where there is one frame.
    data = data.reshape(*data.shape[:2], -1)
    if data.shape[1] not in (3, 4) or data.shape[2] != frames:
        raise ValueError(f"Data is {data.shape}, expected (trajectories, 4, {frames})")
    positions = np.ascontiguousarray(data[:, :3].transpose(2, 0, 1))
    kinds = part.get("Type")
    if kinds is not None and np.size(kinds) == positions.shape[0] * positions.shape[1]:
        # Type 0 marks samples that QTM has not measured.
        positions[np.asarray(kinds).reshape(len(data), frames).T == 0] = np.nan
    return positions


def _events(entries: Any) -> tuple[Event, ...]:
    found = []
    for row in entries if isinstance(entries, list) else [entries]:
        if isinstance(row, dict) and np.size(row.get("Time", ())) == 1:
            found.append(Event(str(row.get("Label", "")), _number(row["Time"])))
    return tuple(event for event in found if np.isfinite(event.time))


def write_mat(path: Path, recording: Recording) -> list[str]:
    """Write a MAT file laid out as QTM does, in millimetres, compressed. Returns what the format cannot carry."""
    positions, labels, omitted = all_points(recording, "MAT", events=True)
    # Names with a star are ours for points without a name.
    named = [i for i, label in enumerate(labels) if not label.startswith("*")]
    rest = [i for i in range(len(labels)) if i not in set(named)]
    parts: dict[str, Any] = {"Labeled": _part(positions[:, named], [labels[i] for i in named])}
    if rest:
        parts["Unidentified"] = _part(positions[:, rest], None)
    take: dict[str, Any] = {
        "File": path.name,
        "Timestamp": str(recording.metadata.get("time_stamp", "")),
        "StartFrame": float(recording.first_frame),
        "Frames": float(len(positions)),
        "FrameRate": recording.rate,
        "Trajectories": parts,
    }
    if recording.events:
        events = np.zeros(len(recording.events), dtype=[("Label", object), ("Frame", object), ("Time", object)])
        for i, event in enumerate(recording.events):
            events[i] = (f"{event.context} {event.label}".strip(), float(round(event.time * recording.rate) + 1), event.time)
        take["Events"] = events
    name = re.sub(r"\W", "_", path.stem)[:31] or "take"
    # MATLAB's variables begin with a letter and have 31 characters at most.
    name = name if name[0].isalpha() else f"take_{name}"[:31]
    buffer = io.BytesIO()
    from scipy.io import savemat

    savemat(buffer, {name: take}, do_compression=True, long_field_names=True)
    write_atomically(path, buffer.getvalue())
    if recording.vertical[2] < 0.99:
        omitted.append("the vertical: QTM's files are Z up")
    if any(event.context for event in recording.events):
        omitted.append("the sides of events: they stand before the events' names")
    return omitted


def _part(positions: Floats, labels: list[str] | None) -> dict[str, Any]:
    count = positions.shape[1]
    seen = ~np.isnan(positions[:, :, 0])
    data = np.concatenate([positions * 1000.0, np.where(seen, 0.0, np.nan)[:, :, None]], axis=2)
    part: dict[str, Any] = {"Count": float(count)}
    if labels is not None:
        names = np.empty((1, count), dtype=object)
        names[0, :] = labels
        part["Labels"] = names
    return part | {"Data": np.ascontiguousarray(data.transpose(1, 2, 0)), "Type": seen.T.astype(np.uint8)}
