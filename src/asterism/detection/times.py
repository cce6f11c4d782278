"""A CSV file of frame times in; when each camera took each of its images, out."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.recording import Floats

_COLUMNS = {
    "camera": r"(cam|camera|port)([_ ]?(id|name|no|number|index))?",
    "frame": r"(frame|image)([_ ]?(id|no|number|index))?",
    "time": r"(frame[_ ]?)?(time|timestamp|t)([_ ]?\(?(s|sec|seconds)\)?)?",
    "sync": r"sync([_ ]?(id|no|number|index))?",
}


@dataclass(frozen=True)
class FrameTimes:
    """When images were taken: one row per camera and image.

    camera (N,) names or numbers, frame (N,) the camera's own count of its images, time (N,) s, sync (N,) number of the common frame to
    which the image belongs, or None where the file does not say
    """

    path: Path
    camera: tuple[str, ...]
    frame: NDArray[np.int64]
    time: Floats
    sync: NDArray[np.int64] | None

    def of(self, cameras: Sequence[str]) -> list[NDArray[np.int64]]:
        """The rows of each camera, called by name, by the number at the end of its name, or else by the order of all numbers.

        Raises AsterismError where a camera has none.
        """
        said = list(dict.fromkeys(self.camera))
        ends = [re.search(r"(\d+)\D*$", name) for name in cameras]
        numbers = [str(int(end[1])) if end else "" for end in ends]
        if set(cameras) <= set(said):
            keys = list(cameras)
        elif len(set(numbers)) == len(cameras) and set(numbers) <= set(said):
            keys = numbers
        elif len(said) == len(cameras) and all(name.isdigit() for name in said):
            keys = sorted(said, key=int)
        else:
            lacking = next((name for name in cameras if name not in said), cameras[0])
            raise AsterismError(f"{self.path} has no times of camera {lacking}, only of {', '.join(said[:12])}; name them alike.")
        names = np.array(self.camera)
        return [np.flatnonzero(names == key)[np.argsort(self.frame[names == key], kind="stable")] for key in keys]


def read_times(path: str | Path) -> FrameTimes:
    """Frame times from a CSV file with the columns camera, frame and time (s), and perhaps sync_index.

    Raises AsterismError, naming file and line, where a column is missing or a cell is no number.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as problem:
        raise AsterismError(f"{path}: its frame times cannot be read ({problem}); give a CSV file.") from None
    lines = [(i + 1, row) for i, row in enumerate(csv.reader(text.splitlines())) if any(row) and not row[0].startswith("#")]
    head = [cell.strip().casefold() for cell in lines[0][1]] if lines else []
    at = {key: next((i for i, name in enumerate(head) if re.fullmatch(pattern, name)), -1) for key, pattern in _COLUMNS.items()}
    missing = [key for key in ("camera", "frame", "time") if at[key] < 0]
    if missing:
        raise AsterismError(
            f"{path}: no column {', '.join(missing)} among {', '.join(head) or 'none'}; name one camera, frame and time each."
        )
    rows = []
    for line, cells in lines[1:]:
        try:
            common = int(cells[at["sync"]]) if at["sync"] >= 0 else 0
            rows.append((cells[at["camera"]].strip(), int(cells[at["frame"]]), float(cells[at["time"]]), common))
        except (ValueError, IndexError):
            raise AsterismError(f"{path}, line {line}: {','.join(cells)[:60]!r} lacks a number; give camera, frame and time.") from None
    if not rows:
        raise AsterismError(f"{path} has no rows; give the time of each frame.")
    time = np.array([row[2] for row in rows])
    if not np.isfinite(time).all():
        raise AsterismError(f"{path}, line {lines[1 + int(np.argmin(np.isfinite(time)))][0]}: the time is not finite; leave the row out.")
    sync_of = np.array([row[3] for row in rows]) if at["sync"] >= 0 else None
    return FrameTimes(path, tuple(row[0] for row in rows), np.array([row[1] for row in rows]), time, sync_of)
