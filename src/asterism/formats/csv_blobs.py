"""2D CSV, one row per blob (frame, camera, x, y, perhaps size and time): in and out."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError, guarded_reading
from asterism.files.atomic import utf8, write_atomically
from asterism.files.text import cell_text, cells_of, decoded, delimiter_of, lines_of, name_of_cell, number_of, read_bytes, some_of
from asterism.formats.kept_blobs import KEPT_SUFFIX, read_kept_blobs
from asterism.recording import Blobs, Floats, Ints
from asterism.recording.arrays import checked_rate
from asterism.recording.rates import rate_of_times

_COLUMNS = {
    "frame": r"frame([_ ]?(no|number|id|index))?|sync_index",
    "camera": r"cam(era)?([_ ]?(no|number|id|name|index))?",
    "x": r"x([_ ]?\(?px\)?)?",
    "y": r"y([_ ]?\(?px\)?)?",
    "size": r"(size|diameter)([_ ]?\(?px\)?)?",
    "time": r"(time|t|frame_time)([_ ]?\(?s\)?)?",
}
_WANTED = ("frame", "camera", "x", "y")
_DEFAULT_RATE = 100.0
_MOST_EMPTY, _MOST_SPREAD = 5_000_000, 50
_CLOCK_JITTER = 1e-6


def read_blobs(path: str | Path, cameras: Sequence[str] | None = None, rate: float | None = None) -> Blobs:
    """The blobs of a 2D CSV file with the columns frame, camera, x, y (px) and perhaps size (px) and time (s).

    A file that ends in .blobs is what a live session kept, see `kept_blobs`.

    cameras  names in the rig's order; the column `camera` holds names or numbers. Without them, the cameras are those that the
             file mentions
    rate     frames per second; else what the file's comments say, else by its times, else 100

    Frames may start at any number and be left out; `first_frame` is the number of the first. A row without x and y is an image without
    blobs. A blob that is repeated counts once. Raises AsterismError, naming file and line, where a column is missing, a cell is
    not a number, a camera is unknown or its number ambiguous, a camera has two times for one frame, or the file breaks off.
    """
    wanted_rate = None if rate is None else checked_rate(rate)
    if Path(path).suffix.lower() == KEPT_SUFFIX:
        return read_kept_blobs(Path(path), None if cameras is None else tuple(cameras), wanted_rate)
    with guarded_reading(path):
        return _blobs(Path(path), None if cameras is None else tuple(cameras), wanted_rate)


def _blobs(path: Path, wanted: tuple[str, ...] | None, wanted_rate: float | None) -> Blobs:
    lines = lines_of(decoded(path, read_bytes(path)))
    comments = dict(_comment(line) for line in lines[:20] if line.startswith("#") and "=" in line)
    start = next((i for i, line in enumerate(lines) if line.strip(" ,;\t") and not line.startswith("#")), len(lines))
    sheet = _BlobTable.opened(path, lines, start)
    values, names = sheet.values()
    listed = tuple(name for name in comments.get("cameras", "").split("|") if name)
    order, camera = _cameras(path, names, values[:, 1], listed if wanted is None else wanted, strict=wanted is not None)
    _refuse(sheet, values[:, 0] != np.round(values[:, 0]), "the frame is not a whole number; correct it")
    _refuse(sheet, np.abs(values[:, 0]) > 2**53, "the frame number is too large; correct it")
    # A row without a place says that the camera looked and saw nothing.
    present = ~np.isnan(values[:, 2:4])
    declared_blobs = _whole(comments.get("blobs"), int(present[:, 0].sum()))
    # The file's own count shows a file that broke off.
    if declared_blobs != present[:, 0].sum():
        raise AsterismError(
            f"{path} declares {declared_blobs} blobs and has {present[:, 0].sum()}; it was cut off or joined, write it again."
        )
    _refuse(sheet, present[:, 0] != present[:, 1], "only one of x and y is given; give both, or neither where the camera saw nothing")
    _refuse(sheet, np.isinf(values[:, 2:4]).any(axis=1), "a position is infinite; leave the row out")
    _refuse(sheet, values[:, 4] < 0, "a size is negative; correct it")
    frames = values[:, 0].astype(np.int64)
    declared = _whole(comments.get("first_frame"), int(frames.min()) if len(frames) else 0)
    first = int(frames.min(initial=declared))
    total = max(int(frames.max(initial=first - 1)) - first + 1, _whole(comments.get("frames"), 0))
    # A single wrong frame number would spread the file over millions of empty frames.
    if total * len(order) > _MOST_SPREAD * len(values) + _MOST_EMPTY:
        raise AsterismError(
            f"{path}: frame numbers run from {first} to {first + total - 1} for {len(values)} rows; correct the column frame."
        )
    times = _times(sheet, values[:, 5], frames - first, camera, total, len(order))
    # Two programs that write one log repeat its rows.
    seen = present.all(axis=1) & _first_of_its_kind(np.column_stack([frames, camera, values[:, 2:4]]))
    blobs = Blobs.from_rows(
        frames[seen] - first,
        camera[seen],
        values[seen, 2:4],
        order,
        rate=wanted_rate if wanted_rate is not None else _rate(comments.get("rate"), times),
        sizes=values[seen, 4],
        frames=total,
        times=times,
    )
    return replace(blobs, first_frame=first)


def _comment(line: str) -> tuple[str, str]:
    """Name and value of a line `# name = value`; blanks, commas and semicolons at its end belong to neither."""
    name, _, value = line[1:].partition("=")
    return name.strip(), value.lstrip().rstrip(" \t,;")


def _first_of_its_kind(rows: Floats) -> NDArray[np.bool_]:
    """(n,) whether a row of (n, m) differs from all rows before it."""
    # Sorted, equal rows stand together, and the first of each is the earliest.
    order = np.lexsort(rows.T[::-1])
    first = np.ones(len(rows), dtype=bool)
    first[order[1:]] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    return first


def write_blobs(blobs: Blobs, path: str | Path) -> None:
    """Write blobs as 2D CSV, with 17 digits, to be read back unchanged. Raises AsterismError where the file cannot be written.

    >>> blobs = Blobs.from_rows([0, 0, 1], [0, 1, 0], [[320.5, 240.0], [300.0, 250.25], [321.0, 240.0]], ["left", "right"], rate=50.0)
    >>> write_blobs(blobs, "2d.csv")
    >>> read_blobs("2d.csv", rate=50.0)
    Blobs(frames: 2 at 50 Hz (0.04 s), cameras: left, right, blobs: 3)
    """
    path = Path(path)
    # The separators of the file, and what its header puts between names, must not be in one.
    spoilt = next((name for name in blobs.cameras if re.search(r'[,;\t"|\r\n]', name) or name != name.strip()), None)
    if spoilt is not None:
        raise AsterismError(f"{path}: the camera {spoilt!r} has a comma, bar, quote or blank in its name that CSV cannot carry; rename it.")
    sized = bool(np.isfinite(blobs.sizes).any())
    # The counts let a reader see that the file is whole.
    head = [f"# rate={blobs.rate!r}", f"# frames={len(blobs)}", f"# first_frame={blobs.first_frame}", f"# blobs={len(blobs.xy)}"]
    head += [f"# cameras={'|'.join(blobs.cameras)}"]
    head += [",".join(["frame", "camera", "x", "y", *(["size"] if sized else []), *(["time"] if blobs.times is not None else [])])]
    spelled = [cell_text(name) for name in blobs.cameras]
    names = [spelled[c] for c in blobs.camera_of]
    frame, camera = blobs.frame_of, blobs.camera_of
    cells = [(frame + blobs.first_frame).tolist(), names, blobs.xy[:, 0].tolist(), blobs.xy[:, 1].tolist()]
    pattern = "%d,%s,%.17g,%.17g"
    if sized:
        cells.append(["" if size != size else repr(size) for size in blobs.sizes.tolist()])
        pattern += ",%s"
    if blobs.times is not None:
        cells.append([_time(time) for time in blobs.times[frame, camera].tolist()])
        pattern += ",%s"
    rows = [pattern % row for row in zip(*cells, strict=True)]
    if blobs.times is not None:
        # Images without blobs have a row for their time, or the clock would have gaps.
        empty = np.argwhere((blobs.counts == 0) & np.isfinite(blobs.times))
        gap = ",,,," if sized else ",,,"
        rows += [f"{t + blobs.first_frame},{spelled[c]}{gap}{_time(float(blobs.times[t, c]))}" for t, c in empty.tolist()]
    write_atomically(path, utf8("\n".join([*head, *rows]) + "\n"))


def describe_blobs(path: Path) -> dict[str, Any]:
    """What a 2D file holds, as plain values: frames, rate, cameras with their blobs and the number of frames with blobs."""
    blobs = read_blobs(path)
    counts = blobs.counts
    return {
        "file": str(path),
        "format": "2D CSV",
        "frames": len(blobs),
        "rate": blobs.rate,
        "first_frame": blobs.first_frame,
        "blobs": {name: int(number) for name, number in zip(blobs.cameras, counts.sum(axis=0), strict=True)},
        "frames_with_blobs": {name: int(number) for name, number in zip(blobs.cameras, (counts > 0).sum(axis=0), strict=True)},
        "triggered_together": blobs.times is None,
    }


def is_blobs(lines: Sequence[str]) -> bool:
    """Whether a header has one column each for frame, camera, x and y."""
    header = next((line for line in lines if line.strip(" ,;\t") and not line.startswith("#")), "")
    return set(_WANTED) <= set(_columns(cells_of(header, delimiter_of(header))))


def _columns(names: Sequence[str]) -> list[str]:
    return [next((key for key, pattern in _COLUMNS.items() if re.fullmatch(pattern, name.casefold())), "") for name in names]


@dataclass(frozen=True)
class _BlobTable:
    """The rows of one file below its header; `place` is the column of each of `_COLUMNS`, -1 for a missing one."""

    path: Path
    lines: list[str]
    header: int
    delimiter: str | None
    place: tuple[int, ...]
    width: int

    @classmethod
    def opened(cls, path: Path, lines: list[str], header: int) -> _BlobTable:
        if header >= len(lines):
            raise AsterismError(f"{path} ends before its column names; export it again.")
        delimiter = delimiter_of(lines[header])
        names = cells_of(lines[header], delimiter)
        kinds = _columns(names)
        missing = [key for key in _WANTED if key not in kinds]
        if missing:
            raise AsterismError(f"{path}, line {header + 1}: no column {', '.join(missing)} among {some_of(names)}; add it to the header.")
        twice = next((key for key in _COLUMNS if kinds.count(key) > 1), None)
        if twice:
            raise AsterismError(f"{path}, line {header + 1}: two columns are the {twice}; rename or remove one.")
        place = tuple(kinds.index(key) if key in kinds else -1 for key in _COLUMNS)
        return cls(path, lines, header, delimiter, place, len(names))

    def values(self) -> tuple[Floats, list[str]]:
        """(rows, 6): frame, camera (its place among the names that the file uses), x, y, size, time, NaN where blank; and these names."""
        try:
            # The fast way takes whole columns; what it cannot read, the careful one names.
            return self._fast()
        except (ValueError, UnicodeDecodeError):
            return self._careful()

    def _fast(self) -> tuple[Floats, list[str]]:
        """All cells at once. Raises ValueError where one is not blank, a number or a camera's name."""
        known: dict[str, int] = {}
        used = [column for column in self.place if column >= 0]
        body = [line for line in self.lines[self.header + 1 :] if line]
        text = "\n".join(body)
        mark = self.delimiter
        # A row with another number of cells shows in the count of separators.
        if '"' in text or (mark is not None and text.count(mark) != len(body) * (self.width - 1)):
            raise ValueError
        if mark is not None:
            text = text.replace(",", ".") if mark == ";" else text
            # Twice, since pairs of separators overlap.
            for _ in range(2):
                text = text.replace(mark + mark, f"{mark}nan{mark}")
            text = f"{text}\n".replace(f"{mark}\n", f"{mark}nan\n")
        out = np.full((len(body), 6), np.nan)
        if len(out):
            out[:, [i for i, column in enumerate(self.place) if column >= 0]] = np.loadtxt(
                io.StringIO(text),
                delimiter=mark,
                usecols=used,
                comments=None,
                ndmin=2,
                encoding="utf-8",
                converters={self.place[1]: lambda cell: known.setdefault(cell.strip(), len(known))},
            )
        # A blank camera or frame has to be named with its line.
        if "nan" in known or not np.isfinite(out[:, 0]).all():
            raise ValueError
        return out, [name_of_cell(name) for name in known]

    def _careful(self) -> tuple[Floats, list[str]]:
        """Row by row, with blanks. Raises AsterismError that names the first impossible cell."""
        known: dict[str, int] = {}
        rows = []
        header = _columns(cells_of(self.lines[self.header], self.delimiter))
        for i in self.rows():
            line = self.lines[i]
            cells = cells_of(line.replace(",", ".") if self.delimiter == ";" else line, self.delimiter)
            where = f"{self.path}, line {i + 1}"
            if len(cells) <= max(self.place):
                raise AsterismError(f"{where}: {len(cells)} cells, {self.width} in the header; the file breaks off, write it again.")
            if any(cells[self.width :]):
                raise AsterismError(f"{where}: {len(cells)} cells where the header has {self.width}; correct this line or the header.")
            row = [number_of(cells[k]) if k >= 0 else float("nan") for k in self.place]
            name = cells[self.place[1]]
            row[1] = known.setdefault(name, len(known))
            wrong = next((k for k, value in enumerate(row) if value is None or (k == 0 and value != value) or (k == 1 and not name)), None)
            if wrong is not None and _columns(cells) == header:
                raise AsterismError(f"{where}: a second header; two files were joined, give them one after the other.")
            if wrong is not None:
                what = cells[self.place[wrong]]
                raise AsterismError(
                    f"{where}: {what[:30]!r} is not a {'camera' if wrong == 1 else 'number'} ({list(_COLUMNS)[wrong]}); correct it."
                )
            rows.append(row)
        return np.array(rows, dtype=np.float64).reshape(-1, 6), list(known)

    def rows(self) -> list[int]:
        """The places of the lines that hold a row."""
        return [i for i in range(self.header + 1, len(self.lines)) if self.lines[i].strip(" ,;\t")]


def _refuse(sheet: _BlobTable, wrong: Any, why: str) -> None:
    if wrong.any():
        raise AsterismError(f"{sheet.path}, line {sheet.rows()[int(np.argmax(wrong))] + 1}: {why}.")


def _cameras(path: Path, used: list[str], place: Floats, names: tuple[str, ...], strict: bool) -> tuple[tuple[str, ...], Ints]:
    """The cameras' names in order, and for each row its camera; `strict`: no other names are allowed."""
    # Cameras may be numbers: 1, 1.0 and 01 are one.
    plain = [str(int(float(name))) if re.fullmatch(r"\d{1,9}(\.0*)?", name) else name for name in used]
    if not strict:
        named = [name for name in plain if name not in names]
        # Numbers within names count as numbers: camera 10 comes after 9.
        names = (*names, *sorted(dict.fromkeys(named), key=lambda name: [(len(d), d) if d.isdigit() else (0, d) for d in _pieces(name)]))
    elif not all(name in names for name in plain):
        unknown_names = [name for name in plain if name not in names]
        numbers = [int(name) for name in plain if name.isdigit()]
        if len(numbers) < len(plain) or max(numbers) > len(names):
            unknown = next((name for name in unknown_names if not name.isdigit()), unknown_names[0])
            raise AsterismError(f"{path}: there is no camera {unknown[:40]}; the rig has {some_of(names, 12)}.")
        # Neither 0 nor the last number leaves open whether they count from 0 or 1.
        if 0 in numbers and len(names) in numbers:
            raise AsterismError(f"{path}: cameras are numbered 0 to {len(names)}, one more than the rig has ({some_of(names, 12)}).")
        if 0 not in numbers and len(names) not in numbers:
            raise AsterismError(
                f"{path}: cameras are numbered {min(numbers)} to {max(numbers)} and the rig has {len(names)}: they may "
                "count from 0 or from 1; name them as the rig does."
            )
        plain = [names[number - (0 not in numbers)] for number in numbers]
    if not names:
        raise AsterismError(f"{path} has no rows; record or detect again.")
    index = {name: i for i, name in enumerate(names)}
    lookup = np.array([index[name] for name in plain], dtype=np.int64)
    return names, lookup[place.astype(np.int64)] if len(place) else np.empty(0, dtype=np.int64)


def _pieces(name: str) -> list[str]:
    return [piece for piece in re.split(r"(\d+)", name) if piece]


def _times(sheet: _BlobTable, stamps: Floats, frame: Ints, camera: Ints, frames: int, cameras: int) -> Floats | None:
    if not np.isfinite(stamps).any():
        return None
    times = np.full(frames * cameras, np.nan)
    cell, known = frame * cameras + camera, np.isfinite(stamps)
    # The first of repeated stamps stays: the later ones are compared with it.
    times[cell[known][::-1]] = stamps[known][::-1]
    differs = known & (np.abs(times[cell] - stamps) > _CLOCK_JITTER)
    _refuse(sheet, differs, "the camera took this frame at two different times; correct the column time")
    return times.reshape(frames, cameras)


def _rate(declared: str | None, times: Floats | None) -> float:
    number = number_of(declared or "")
    if number is not None and 0 < number < 1e6:
        return float(number)
    if times is not None:
        # Of the camera that was seen most.
        column = times[:, np.isfinite(times).sum(axis=0).argmax()]
        there = np.flatnonzero(np.isfinite(column))
        found = rate_of_times(there, column[there]).rate
        if np.isfinite(found):
            return found
    return _DEFAULT_RATE


def _whole(text: str | None, otherwise: int) -> int:
    return int(text) if text is not None and re.fullmatch(r"-?\d{1,9}", text) else otherwise


def _time(time: float) -> str:
    return "" if time != time else repr(time)
