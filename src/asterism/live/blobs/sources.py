"""A file of blobs, or blobs as JSON over UDP, in; the blobs of each camera as they come out."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding
from asterism.formats.blobs_2d import read_2d
from asterism.live.camera_frames import LiveBlobs
from asterism.live.datagrams import NO_JSON, DamagedJson, HostPort, ListeningSocket, keys_of, overflow, whole_number
from asterism.live.frames import SourceEnded
from asterism.live.json_reading import json_of
from asterism.live.replay import Playback
from asterism.recording import Floats

MOST_BLOBS = 2000
"""Blobs of an image that are read: a camera that looks at lamps or the sun has hundreds. Half of them cuts a dense suit in a near view;
with twice as many a datagram would not hold them."""
_FARTHEST = 1e5
"""px from the image's corner: no image is that large, see `cameras.camera.LARGEST_IMAGE`. Half and double do as well."""


class ReplayBlobs:
    """Plays a file of blobs, each camera's when they are due. Frames without times, or with equal ones, are numbered together.

    path     any file that `asterism reconstruct` reads
    cameras  names in the rig's order
    speed    times its own rate; inf for as fast as they are taken
    loop     whether it begins again at the end, its numbers and times going on
    Raises AsterismError where the file cannot be read, has no frame, or the speed is not above 0.
    """

    damaged = 0

    def __init__(
        self, path: Path, cameras: Sequence[str] | None = None, *, rate: float | None = None, speed: float = 1.0, loop: bool = False
    ) -> None:
        self._playback = Playback(speed)
        self._blobs = read_2d(path, cameras, rate)
        blobs = self._blobs
        if not len(blobs):
            raise AsterismError(f"{path} has no frame; there is nothing to play.")
        self.name, self.cameras = path.name, blobs.cameras
        times = np.arange(len(blobs))[:, None] / blobs.rate + np.zeros(len(blobs.cameras))
        if blobs.times is not None:
            times = blobs.times - np.nanmin(blobs.times)
        self.rate = self._playback.rate(blobs.rate)
        known = np.isfinite(times)
        first, last = np.where(known, times, np.inf).min(axis=1), np.where(known, times, -np.inf).max(axis=1)
        self.numbered_together = bool((first >= last).all())
        frame, camera = np.nonzero(known)
        order = np.argsort(times[known], kind="stable")
        self._due = list(zip(times[known][order].tolist(), frame[order].tolist(), camera[order].tolist(), strict=True))
        self._long = float(np.nanmax(times)) + 1 / blobs.rate
        self._loop, self._next = loop, 0

    def read(self, timeout: float) -> LiveBlobs | None:
        """The next blobs, when they are due."""
        if not self._loop and self._next >= len(self._due):
            raise SourceEnded
        turn, row = divmod(self._next, len(self._due))
        since, frame, camera = self._due[row]
        at = turn * self._long + since
        if not self._playback.waits_for(at, timeout):
            return None
        self._next += 1
        blobs = self._blobs
        cell = frame * len(blobs.cameras) + camera
        place = slice(blobs.offsets[cell], blobs.offsets[cell + 1])
        number = turn * len(blobs) + frame
        # When it was due: however long it had to wait to be taken, the cameras keep their places beside each other.
        arrived = self._playback.moment(at)
        return LiveBlobs(blobs.cameras[camera], number, at, arrived, blobs.xy[place], blobs.sizes[place])

    def close(self) -> None:
        """Stop playing."""
        self._playback.close()


def blobs_as_json(blobs: LiveBlobs) -> bytes:
    """The blobs of a camera as a datagram that `blobs_of_json` reads: thousandths of a pixel."""
    rows: list[list[float]] = np.round(blobs.xy, 3).tolist()
    if np.isfinite(blobs.sizes).any():
        rows = [[*row, size] for row, size in zip(rows, np.round(blobs.sizes, 2).tolist(), strict=True)]
    content = {"camera": blobs.camera, "frame": blobs.number, "time": blobs.time, "blobs": rows}
    return json.dumps(content, separators=(",", ":")).encode()


def blobs_of_json(data: bytes, arrived: float) -> LiveBlobs | None:
    """The blobs in a datagram; None where it is damaged, or holds none. Never raises.

    {"camera": "c1", "frame": 12, "time": 0.12, "blobs": [[x, y], [x, y, size], ...]}: pixels, the centre of the top left one is (0, 0);
    size is a diameter in px, and may be left out. Blobs that are not finite are left out.
    """
    try:
        content = json_of(data)
        camera, number, at, rows = content["camera"], whole_number(content["frame"]), float(content["time"]), content["blobs"]
        if type(camera) is float:
            # A whole number that is too long for `json_of`, which the standard library tells from a float; or 1.0.
            camera = json.loads(data.decode("utf-8"))["camera"]
            camera = whole_number(camera) if type(camera) is float else camera
        if type(camera) not in (str, int) or number is None or not math.isfinite(at):
            return None
        if not isinstance(rows, list) or len(rows) > MOST_BLOBS:
            return None
        xy, sizes = _table(rows)
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError, IndexError):
        return None
    # One look at all of them, which is false where one is NaN, too.
    if len(xy) and not np.abs(xy).max() < _FARTHEST:
        near = (np.abs(xy) < _FARTHEST).all(axis=1)
        xy, sizes = xy[near], sizes[near]
    return LiveBlobs(str(camera), number, at, arrived, xy, sizes)


def why_no_blobs(data: bytes) -> str:
    """What is wrong with a datagram that `blobs_of_json` does not take, for a person who writes a sender."""
    try:
        content = json.loads(data.decode("utf-8"))
    except (ValueError, RecursionError):
        return NO_JSON
    keys = ("camera", "frame", "time", "blobs")
    if not isinstance(content, dict):
        return "it is no object with camera, frame, time and blobs"
    lacking = next((key for key in keys if key not in content), None)
    if lacking is not None:
        return f'it has no "{lacking}", but {keys_of(content)}'
    camera, number, at, rows = (content[key] for key in keys)
    if type(camera) not in (str, int) and whole_number(camera) is None:
        return 'its "camera" is no text and no whole number'
    if whole_number(number) is None:
        return 'its "frame" is no whole number below 2^53'
    if type(at) not in (int, float) or not abs(at) < math.inf:
        return 'its "time" is no number'
    if not isinstance(rows, list) or len(rows) > MOST_BLOBS:
        return f'its "blobs" are no list of at most {MOST_BLOBS} [x, y]'
    return 'one of its "blobs" is not [x, y], or [x, y, size], in numbers'


def _table(rows: list[Any]) -> tuple[Floats, Floats]:
    """(n, 2) px, and sizes (n,) px of each blob. Raises ValueError, TypeError or OverflowError."""
    if not rows:
        return np.empty((0, 2)), np.empty(0)
    widths = set(map(len, rows))
    if set(map(type, rows)) != {list} or not widths <= {2, 3}:
        raise ValueError
    if widths == {2}:
        return _numbers(rows, 2), np.full(len(rows), np.nan)
    table = _numbers([[*row, np.nan][:3] for row in rows], 3)
    sizes = np.where((table[:, 2] >= 0) & (table[:, 2] < _FARTHEST), table[:, 2], np.nan)
    return np.ascontiguousarray(table[:, :2]), sizes


def _numbers(rows: list[Any], width: int) -> Floats:
    """(n, width). Twelve cameras at 200 Hz are 2,400 of these a second; NumPy looks at nested lists twice as long."""
    try:
        return np.fromiter(chain.from_iterable(rows), np.float64, width * len(rows)).reshape(-1, width)
    except TypeError:
        # null is a number that is missing.
        table = np.array(rows, dtype=np.float64)
        if table.shape != (len(rows), width):
            raise ValueError from None
        return table


class JsonBlobs:
    """Blobs that arrive as JSON, one image of one camera a datagram, see `blobs_of_json`.

    place              where to listen
    cameras            the names that are expected, those of the rig
    rate               frames per second that each camera was told to take
    numbered_together  whether equal numbers are one exposure; else times tell
    Raises AsterismError where the address is none of this machine's, or the port is taken.
    """

    def __init__(self, place: HostPort, cameras: Sequence[str], rate: float = math.nan, *, numbered_together: bool = False) -> None:
        self._damaged = DamagedJson(why_no_blobs)
        self.name, self.cameras, self.rate = f"blobs at {place}", tuple(cameras), rate
        self.numbered_together = numbered_together
        self._socket = ListeningSocket(place)

    @property
    def port(self) -> int:
        """The port that is listened to: a free one where 0 was asked for."""
        return self._socket.port

    def read(self, timeout: float) -> LiveBlobs | None:
        """The next image that is whole."""
        for data, _, arrived in self._socket.received(timeout):
            blobs = blobs_of_json(data, arrived)
            if blobs is not None:
                return blobs
            self._damaged.add(data)
        return None

    @property
    def damaged(self) -> int:
        """Packets that could not be read."""
        return self._damaged.count

    @property
    def overflowed(self) -> int:
        """Images that came while this machine was too busy to read them."""
        return self._socket.overflowed

    def findings(self) -> list[Finding]:
        """What a person should know of it."""
        return [*overflow(self.name, self.overflowed), *self._damaged.findings(self.name)]

    def close(self) -> None:
        """Stop listening."""
        self._socket.close()
