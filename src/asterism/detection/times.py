"""A CSV file of frame times in; when each camera took each of its images, out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError, guarded_reading
from asterism.files.text import cells_of, decoded, delimiter_of, lines_of, number_of, read_bytes, some_of
from asterism.recording import Floats

_COLUMNS = {
    "camera": r"(cam|camera|port)([_ ]?(id|name|no|number|index))?",
    "frame": r"(frame|image)([_ ]?(id|no|number|index))?",
    "time": r"(frame[_ ]?)?(time|timestamp|t)([_ ]?\(?(s|sec|seconds)\)?)?",
    "sync": r"sync([_ ]?(id|no|number|index))?",
}

_SLOWEST_S = 2.0
"""Times between images that are longer are not seconds."""


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
        listed = list(dict.fromkeys(self.camera))
        ends = [re.search(r"(\d+)\D*$", name) for name in cameras]
        numbers = [str(int(end[1])) if end else "" for end in ends]
        # Names first, then numbers at their ends, then mere order: the surest way that fits all cameras.
        if set(cameras) <= set(listed):
            keys = list(cameras)
        elif len(set(numbers)) == len(cameras) and set(numbers) <= set(listed):
            keys = numbers
        elif len(listed) == len(cameras) and all(name.isdigit() for name in listed):
            keys = sorted(listed, key=int)
        else:
            lacking = next((name for name in cameras if name not in listed), cameras[0])
            raise AsterismError(f"{self.path} has no times of camera {lacking}, only of {', '.join(listed[:12])}; name them alike.")
        names = np.array(self.camera)
        return [np.flatnonzero(names == key)[np.argsort(self.frame[names == key], kind="stable")] for key in keys]


def read_times(path: str | Path) -> FrameTimes:
    """Frame times from a CSV file with the columns camera, frame and time (s), and perhaps sync_index.

    Raises AsterismError, naming file and line, where a column is missing, a cell is not a number, a camera has two times of one image
    or two images of one common frame, or times are not seconds.
    """
    with guarded_reading(path):
        return _times(Path(path))


def _times(path: Path) -> FrameTimes:
    lines = [(i + 1, line) for i, line in enumerate(lines_of(decoded(path, read_bytes(path)))) if line.strip(" ,;\t") and line[0] != "#"]
    delimiter = delimiter_of(lines[0][1]) if lines else None
    head = [cell.casefold() for cell in cells_of(lines[0][1], delimiter)] if lines else []
    at = {key: next((i for i, name in enumerate(head) if re.fullmatch(pattern, name)), -1) for key, pattern in _COLUMNS.items()}
    missing = [key for key in ("camera", "frame", "time") if at[key] < 0]
    if missing:
        raise AsterismError(f"{path}: no column {', '.join(missing)} among {some_of(head)}; name one camera, frame and time each.")
    if len(lines) < 2:
        raise AsterismError(f"{path} has no rows; give the time of each frame.")
    names: list[str] = []
    numbers = np.zeros((len(lines) - 1, 3))
    for row, (line, text) in enumerate(lines[1:]):
        cells = cells_of(text.replace(",", ".") if delimiter == ";" else text, delimiter)
        # Where semicolons part the cells, commas are decimal ones.
        given = [number_of(cells[at[key]]) if 0 <= at[key] < len(cells) else None for key in ("frame", "time", "sync")]
        numbers[row] = [np.nan if number is None else number for number in given]
        whole = numbers[row, [0, 2] if at["sync"] >= 0 else [0]]
        if not np.isfinite(numbers[row, 1]) or not (whole == np.rint(whole)).all() or not cells[at["camera"]]:
            raise AsterismError(f"{path}, line {line}: {text[:60]!r} lacks a number; give camera, frame and time, or leave the row out.")
        names.append(cells[at["camera"]])
    frame, time = numbers[:, 0].astype(np.int64), numbers[:, 1].copy()
    sync = numbers[:, 2].astype(np.int64) if at["sync"] >= 0 else None
    _check(path, names, frame, time, sync)
    return FrameTimes(path, tuple(names), frame, time, sync)


def _check(path: Path, names: Sequence[str], frame: NDArray[np.int64], time: Floats, sync: NDArray[np.int64] | None) -> None:
    steps = []
    for name in dict.fromkeys(names):
        rows = np.flatnonzero(np.array(names) == name)
        #
        rows = rows[np.argsort(frame[rows], kind="stable")]
        steps.append(np.diff(time[rows]))
        for what, numbers in (("image", frame), ("common frame", sync)):
            counted = np.unique(numbers[rows], return_counts=True) if numbers is not None else (np.zeros(0), np.zeros(0))
            if (counted[1] > 1).any():
                raise AsterismError(f"{path}: camera {name} has two rows of {what} {counted[0][np.argmax(counted[1])]}; leave one out.")
    usual = float(np.median(np.concatenate(steps))) if any(map(len, steps)) else 0.0
    if usual > _SLOWEST_S:
        raise AsterismError(f"{path}: {usual:g} s pass from one image to the next; give times in seconds, not in thousandths or less.")
