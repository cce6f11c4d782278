"""Blobs that a live session keeps, quarter of a second by quarter of a second: in and out. A kill leaves such a file whole."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError, guarded_reading
from asterism.files.journal import Journal, read_steps
from asterism.recording import Blobs, Floats, Ints
from asterism.recording.rates import rate_of_times

KEPT_SUFFIX = ".blobs"
_WORK = "asterism blobs 1"
_BEGUN_ANEW = 1000
"""Numbers by which an image may be behind the newest; farther behind, its source began anew. Half and double do as well: 5 s at 200 Hz."""
_MOST_EMPTY = 10_000
"""Numbers that may lack; a farther number is that of a source that began anew, as for live recordings of points."""


@dataclass(frozen=True, eq=False)
class KeptImage:
    """The blobs of one image.

    camera  its place in the rig
    number  the camera's own
    time    s on a clock that all cameras share; NaN where it is not known
    xy      (n, 2) px; sizes (n,) px
    """

    camera: int
    number: int
    time: float
    xy: Floats
    sizes: Floats


class KeptBlobs:
    """A file of blobs that grows.

    path      must be new
    cameras   names in the rig's order
    rate      frames per second, NaN where it is not known
    together  whether equal numbers are one exposure

    `lost` says why nothing is kept any more, as with a full disk; "" where it is. Raises AsterismError where the file exists.
    """

    def __init__(self, path: Path, cameras: Sequence[str], rate: float, together: bool) -> None:
        if path.exists():
            raise AsterismError(f"{path} exists; name another file to record to, or remove it.")
        self._journal = Journal(path, _WORK)
        head = {"cameras": list(cameras), "rate": rate if np.isfinite(rate) else None, "together": together}
        self._journal.step(lambda: [np.frombuffer(json.dumps(head).encode(), dtype=np.uint8)])

    @property
    def lost(self) -> str:
        """Why nothing is kept any more."""
        return self._journal.lost

    def add(self, images: Sequence[KeptImage]) -> None:
        """Keep images. Pixels have 24 bits: 0.0001 px."""
        self._journal.step(lambda: _arrays(images))

    def close(self) -> None:
        """Leave the file as it is."""
        self._journal.close()


def _arrays(images: Sequence[KeptImage]) -> list[NDArray[Any]]:
    """Camera, number and count of each image; its time; blobs x, y and size."""
    return [
        np.array([[each.camera, each.number, len(each.xy)] for each in images], dtype=np.int64).reshape(-1, 3),
        np.array([each.time for each in images], dtype=np.float64),
        np.concatenate([np.empty((0, 3)), *(np.column_stack([each.xy, each.sizes]) for each in images)]).astype(np.float32),
    ]


def read_kept_blobs(path: Path, cameras: Sequence[str] | None = None, rate: float | None = None) -> Blobs:
    """The blobs that a live session kept, up to the moment in which it was stopped or killed.

    cameras  names in the rig's order, else as the session had them; rate: frames per second, else as the file says, or its times

    Where a source began anew its frames follow those before. Raises AsterismError where the file is another one's, damaged or empty, or
    `cameras` lack one of its cameras.
    """
    with guarded_reading(path):
        # A file that is not there is told as such.
        path.open("rb").close()
        steps = list(read_steps(path, _WORK))
        if not steps:
            raise AsterismError(f"{path} holds no blobs of a live session; give the file that `asterism live` left beside its output.")
        head = json.loads(bytes(steps[0][0]))
        if len(steps) < 2:
            raise AsterismError(f"{path} holds no image: no camera sent one while it was recorded.")
        images, times, blobs = (np.concatenate([step[k] for step in steps[1:]]) for k in range(3))
        names = tuple(head["cameras"])
        order = names if cameras is None else tuple(cameras)
        absent = [name for name in names if name not in order]
        if absent:
            raise AsterismError(f"{path}: the rig has no camera {absent[0]}; it has {', '.join(order)}.")
        return _blobs(images, times, blobs, names, order, head["together"], rate or head["rate"])


def _blobs(
    images: Ints, times: Floats, blobs: Floats, names: Sequence[str], order: Sequence[str], together: bool, rate: float | None
) -> Blobs:
    row = np.empty(len(images), dtype=np.int64)
    groups = [np.arange(len(images))] if together else [np.flatnonzero(images[:, 0] == c) for c in range(len(names))]
    for group in groups:
        row[group] = _rows(images[group, 1])
    camera = np.array([order.index(name) for name in names])[images[:, 0]]
    frames, counts = int(row.max(initial=-1)) + 1, images[:, 2]
    when = None
    if not together:
        when = np.full((frames, len(order)), np.nan)
        when[row, camera] = times
    if rate is None:
        first = np.flatnonzero(images[:, 0] == images[0, 0])
        first = first[np.unique(row[first], return_index=True)[1]]
        told = rate_of_times(row[first], times[first]).rate
        rate = told if np.isfinite(told) else 100.0
    return Blobs.from_rows(
        np.repeat(row, counts), np.repeat(camera, counts), blobs[:, :2], order, rate=rate, sizes=blobs[:, 2], frames=frames, times=when
    )


def _rows(numbers: Ints) -> Ints:
    """The frame in which each image stands, by its number: numbers go on, and where the source began anew the next frame follows."""
    turn, newest = np.zeros(len(numbers), dtype=np.int64), int(numbers[0]) if len(numbers) else 0
    for n, number in enumerate(numbers.tolist()):
        anew = not -_BEGUN_ANEW < number - newest < _MOST_EMPTY
        turn[n] = turn[n - 1] + anew if n else 0
        newest = number if anew else max(newest, number)
    rows, base = np.empty(len(numbers), dtype=np.int64), 0
    for which in range(int(turn.max(initial=-1)) + 1):
        own = numbers[turn == which]
        rows[turn == which] = base + own - own.min()
        base += int(own.max() - own.min()) + 1
    return rows
