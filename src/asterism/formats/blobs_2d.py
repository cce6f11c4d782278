"""Blobs of commercial camera systems in: what their software gives of 2D, read, or refused with a sentence that says what to do."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from asterism.errors import AsterismError, guarded_reading
from asterism.formats.csv_blobs import read_blobs
from asterism.recording import Blobs
from asterism.recording.arrays import checked_rate

_SUBPIXELS = 64.0
"""Per pixel: the unit of QTM's 2D positions and sizes, as of its calibration export."""
_QTM_MEND = "save it from QTM's 2D data series as docs/views.md shows"
_NOT_READABLE = {
    ".x2d": "is Vicon's own file of 2D data, whose layout is not published; record the centroids of the DataStream SDK as 2D CSV "
    "(frame, camera, x, y), and give the .xcp as the rig.",
    ".mat": "holds no 2D data: QTM's MAT export has none; " + _QTM_MEND + ".",
    ".qtm": "is QTM's own file, whose layout is not published; " + _QTM_MEND + ".",
    ".tak": "is Motive's own file, whose layout is not published; record the centroids of the Camera SDK as 2D CSV (frame, camera, x, y).",
    ".c3d": "holds 3D points; 2D data of cameras come as 2D CSV (frame, camera, x, y), or as JSON from QTM.",
}


def read_2d(path: str | Path, cameras: Sequence[str] | None = None, rate: float | None = None) -> Blobs:
    """The blobs of a 2D CSV file (see `read_blobs`), or of QTM's 2D data series saved as JSON.

    cameras  names in the rig's order; rate: frames per second, else as the file says

    The JSON: `{"frequency": 100.0, "cameras": [{"serial": 20658, "samples": [[{"position": [119658, 5486], "size": [978, 768]}, ...],
    null, ...]}, ...]}`, where `samples` is what `qtm.data.series._2d.get_samples` of QTM's scripting interface (Python, Lua or REST)
    returns: per frame the markers' positions and sizes in 64ths of a pixel, or null. Source: the reference of that interface (Qualisys,
    qtm-scripting), and the unit of the real-time protocol.

    Raises AsterismError for files of 2D data that are closed (.x2d, .qtm, .tak) or that hold none, and where a file is damaged.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    # Closed formats are named with the way out, before anything is read.
    if suffix in _NOT_READABLE:
        raise AsterismError(f"{path} {_NOT_READABLE[suffix]}")
    if suffix == ".tsv":
        with guarded_reading(path):
            head = path.read_bytes()[:2000]
        if b"NO_OF_FRAMES" in head:
            raise AsterismError(f"{path} is a TSV export of QTM, whose layout for 2D data is not published; {_QTM_MEND}.")
    if suffix == ".json":
        with guarded_reading(path, _QTM_MEND):
            return _qtm(path, None if cameras is None else tuple(cameras), None if rate is None else checked_rate(rate))
    return read_blobs(path, cameras, rate)


def _qtm(path: Path, wanted: tuple[str, ...] | None, wanted_rate: float | None) -> Blobs:
    try:
        content = json.loads(path.read_bytes())
    except ValueError as problem:
        raise AsterismError(f"{path} is no JSON ({problem}); {_QTM_MEND}.") from problem
    entries = content.get("cameras") if isinstance(content, dict) else None
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) and "samples" in entry for entry in entries):
        raise AsterismError(f"{path} has no list `cameras` with `serial` and `samples`; {_QTM_MEND}.")
    names = [str(entry.get("serial", "")) for entry in entries]
    order = tuple(names) if wanted is None else wanted
    # Serials are what both files share: the rig must know every camera that sends points.
    absent = next((name for name in names if name not in order), None)
    if absent is not None:
        raise AsterismError(
            f"{path}: the rig has no camera {absent or '(without a serial)'}; it has {', '.join(order)}. Give its .qca.txt."
        )
    rows = [(t, order.index(name), *_numbers(path, marker)) for name, t, marker in _markers(names, entries)]
    values = np.array(rows, dtype=np.float64).reshape(-1, 6)
    blobs = Blobs.from_rows(
        values[:, 0].astype(np.int64),
        values[:, 1].astype(np.int64),
        values[:, 2:4] / _SUBPIXELS,
        order,
        rate=wanted_rate if wanted_rate is not None else checked_rate(float(content.get("frequency", 100.0))),
        # One size for each blob: the mean of its width and height.
        sizes=values[:, 4:6].mean(axis=1) / _SUBPIXELS,
        frames=max(len(entry["samples"]) for entry in entries),
    )
    # QTM counts frames from 1.
    return replace(blobs, first_frame=1)


def _markers(names: Sequence[str], entries: Sequence[dict[str, Any]]) -> list[tuple[str, int, Any]]:
    """Camera, frame and marker of all samples."""
    return [
        (name, t, marker)
        for name, entry in zip(names, entries, strict=True)
        for t, sample in enumerate(entry["samples"])
        for marker in (sample or ())
    ]


def _numbers(path: Path, marker: Any) -> tuple[float, float, float, float]:
    """x, y, width and height of a marker, in QTM's unit; NaN sizes where it has none."""
    try:
        x, y = marker["position"]
        width, height = marker.get("size", (np.nan, np.nan))
        return float(x), float(y), float(width), float(height)
    except (TypeError, KeyError, ValueError) as problem:
        raise AsterismError(f"{path}: a marker is {str(marker)[:60]}, without a position of two numbers; {_QTM_MEND}.") from problem
