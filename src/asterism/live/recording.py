"""Frames as they come and as they are labelled in; a folder that a kill leaves whole, and a C3D of it, out."""

from __future__ import annotations

import itertools
import json
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.files.journal import Journal, in_use, read_steps, unread_bytes
from asterism.findings import Finding, Severity
from asterism.live.analog import KeptAnalog, analog_as_arrays, analog_of_arrays
from asterism.live.chain import LabelledFrame
from asterism.live.clock import rows_of
from asterism.live.frames import LiveFrame
from asterism.live.writing import WritingThread
from asterism.recording import LABELLED_LIVE, NULL, Clouds, Floats, Labelling, Recording
from asterism.recording.rates import rate_of_times

_WORK = "asterism live 1"
_MOST = 4000
"""Frames that wait for the disk at most: 20 s at 200 Hz, some 6 MB. Half of it loses frames while a disk wakes up; at double it is kept by
a machine that has no room."""
_UNKNOWN_RATE = 100.0
"""Frames per second of a recording whose times do not grow, and whose source said no rate. Half and double are as wrong."""


@dataclass
class _Chunk:
    """Frames that are not written yet."""

    frames: list[LiveFrame]
    labels: list[LabelledFrame]


class LiveRecorder:
    """Writes what a session takes and labels to a file, a quarter of a second at a time, from a thread of its own.

    path  of the recording, which must be new: `walk.live`. `recording_of` reads it, finished or not
    name, vertical of the source
    markers  the set, or the model, that somebody chose; "" where the set is found
    tell  what hears at once that the recording ended
    rate  frames per second that the source says; NaN where it does not

    Memory is bounded by `_MOST` frames: where the disk takes longer, frames are not kept, and `lost` counts them, or their labels are not,
    and `unlabelled` counts those. A disk that fails ends the recording and not the session: `problem` says why, and `mend` what
    to do. Where the file is removed or moved meanwhile nothing is kept.
    """

    def __init__(
        self,
        path: Path,
        name: str,
        vertical: Floats | None,
        tell: Callable[[str], None] = lambda problem: None,
        markers: str = "",
        rate: float = math.nan,
    ) -> None:
        if path.exists():
            raise AsterismError(f"{path} exists; name another file to record to, or remove it.")
        self.path, self.problem, self._tell = path, "", tell
        self.mend, self.is_gone = "Make space, or record to another disk.", False
        self.kept, self.lost, self.unlabelled = 0, 0, 0
        self._journal = Journal(path, _WORK)
        up = [0.0, 0.0, 1.0] if vertical is None else vertical.tolist()
        head: dict[str, Any] = {"name": name, "vertical": up, "begun": time.time(), "markers": markers}
        if math.isfinite(rate):
            head["rate"] = rate
        self._written(lambda: [_text(json.dumps(head))])
        self._chunk = _Chunk([], [])
        self._guard = threading.Lock()
        self._thread = WritingThread(self._flush, "live recording")

    def frame(self, frame: LiveFrame) -> None:
        """Keep a frame; returns at once."""
        with self._guard:
            if self.problem or len(self._chunk.frames) >= _MOST:
                self.lost += 1
                return
            self._chunk.frames.append(frame)

    def labelled(self, frame: LabelledFrame) -> None:
        """Keep its labels; returns at once."""
        with self._guard:
            if self.problem:
                return
            if len(self._chunk.labels) >= _MOST:
                self.unlabelled += 1
                return
            self._chunk.labels.append(frame)

    def close(self) -> None:
        """Write the rest."""
        self._thread.close()
        self._journal.close()
        self._look()

    def _look(self) -> None:
        """Whether the file still has its name: no write fails where it has not, and nobody finds what is written."""
        try:
            self.path.stat()
            return
        except (FileNotFoundError, NotADirectoryError):
            self.kept, self.is_gone = 0, True
        except OSError:
            # A network that does not answer says nothing of the file.
            return
        if not self.problem:
            self.mend = f"Leave {self.path.name} and its folder in their place until the session ends; --finish writes one that was moved."
            self._fails(f"{self.path}: recording ended, since the file or its folder was removed or moved meanwhile.")

    def _flush(self) -> None:
        with self._guard:
            chunk, self._chunk = self._chunk, _Chunk([], [])
        if not chunk.frames and not chunk.labels:
            return
        self._written(lambda: _arrays_of(chunk))
        if not self.problem:
            self.kept += len(chunk.frames)
            self._look()

    def _written(self, compute: Callable[[], Sequence[NDArray[Any]]]) -> None:
        try:
            self._journal.step(compute)
            lost = self._journal.lost
        except Exception as problem:  # the session goes on, whatever happens here
            lost = repr(problem)
        if lost and not self.problem:
            self._fails(f"{self.path}: recording ended ({lost}); what was recorded before is kept.")

    def _fails(self, problem: str) -> None:
        self.problem = problem
        self._tell(problem)


class _Arrays(NamedTuple):
    """A chunk as the file holds it.

    frames      (F, 2) number and count of points of each frame
    times       (F, 2) s on the source's clock, and on this machine's when it arrived
    points      (P, 3) m, of all frames one after the other
    labelled    (L, 2) number and count of points of each frame whose labels came meanwhile
    markers     (Q,) of each of its points the marker, NULL for none
    confidence  (Q,)
    names       of the markers, as text
    devices, samples  see `analog_as_arrays`
    arrived     (L,) s, as in `times`. Numbers begin anew with their sender, and some frames arrive at the same time: both tell a frame
    """

    frames: NDArray[np.int64]
    times: Floats
    points: Floats
    labelled: NDArray[np.int64]
    markers: NDArray[np.int64]
    confidence: Floats
    names: NDArray[np.uint8]
    devices: NDArray[np.uint8]
    samples: NDArray[np.float32]
    arrived: Floats


def _text(text: str) -> NDArray[np.uint8]:
    return np.frombuffer(text.encode(), dtype=np.uint8)


def _arrays_of(chunk: _Chunk) -> _Arrays:
    frames, labels = chunk.frames, [each for each in chunk.labels if each.markers]
    marker_of, confidence = [np.empty(0, dtype=np.int64)], [np.empty(0)]
    for each in labels:
        own, sure = np.full(len(each.frame.points), NULL, dtype=np.int64), np.zeros(len(each.frame.points))
        given = each.indices >= 0
        own[each.indices[given]], sure[each.indices[given]] = np.nonzero(given)[0], each.confidence[given]
        marker_of.append(own)
        confidence.append(sure)
    return _Arrays(
        np.array([[each.number, len(each.points)] for each in frames], dtype=np.int64).reshape(-1, 2),
        np.array([[each.time, each.arrived] for each in frames], dtype=np.float64).reshape(-1, 2),
        np.concatenate([np.empty((0, 3)), *(each.points for each in frames)]),
        np.array([[each.frame.number, len(each.frame.points)] for each in labels], dtype=np.int64).reshape(-1, 2),
        np.concatenate(marker_of),
        np.concatenate(confidence),
        _text(json.dumps(list(labels[-1].markers) if labels else [])),
        *analog_as_arrays([part for each in frames for part in each.analog]),
        np.array([each.frame.arrived for each in labels], dtype=np.float64),
    )


@dataclass(frozen=True)
class LeftBehind:
    """What a session that was not finished left beside its output.

    in_use  whether a session still writes to it
    frames  whether frames were recorded; where none were, and nothing is damaged, nobody misses the file
    """

    in_use: bool
    frames: bool


def left_behind(path: Path) -> LeftBehind:
    """What an earlier session left in a file; O(1): no more of it is read than shows whether there are frames."""
    frames = any(len(step[0]) for step in itertools.islice(read_steps(path, _WORK), 1, None))
    return LeftBehind(in_use(path), frames or unread_bytes(path, _WORK) > 0)


def remove_recorded(path: Path) -> Finding | None:
    """Remove a live recording that was written as a whole, so that the next session of that name can begin.

    Where bytes at its end could not be read it is renamed instead, and the finding says so: whatever they hold, nothing is lost. Where a
    session still writes to it, it stays.
    """
    if in_use(path):
        sentence = f"{path}: the session that records to it still runs; what it had recorded until now is written."
        return Finding("live-not-finished", Severity.NOTE, str(path), sentence, "End it with Ctrl-C: then it writes all.")
    unread = unread_bytes(path, _WORK)
    if not unread:
        path.unlink(missing_ok=True)
        return None
    beside = (path.with_name(f"{path.name}.damaged{n or ''}") for n in itertools.count())
    kept = next(each for each in beside if not each.exists())
    path.rename(kept)
    sentence = f"{path}: {unread} bytes at its end could not be read; what came before is written. It is kept as {kept.name}."
    return Finding(
        "live-cut-off",
        Severity.WARNING,
        str(path),
        sentence,
        "Where the session was killed they were its last frames; else look at the disk.",
    )


@dataclass(frozen=True)
class KeptSession:
    """What a live recording holds.

    clouds     all frames that came; those that were lost on the way are empty
    labelling  their labels live, None where no set was found
    name       of the source
    begun      s since 1970
    times      (T,) s on the source's clock, NaN for lost frames
    analog     what devices measured along with them
    markers    the set, or the model, that somebody chose; "" where the set was found
    """

    clouds: Clouds
    labelling: Labelling | None
    name: str
    begun: float
    times: Floats
    analog: tuple[KeptAnalog, ...] = ()
    markers: str = ""

    def recording(self) -> Recording:
        """The labelled trajectories, points without a label behind them; the log says that they are labels given live, and no tracks."""
        recording = Recording.from_clouds(self.clouds, self.labelling)
        if self.labelling is None:
            return recording
        chosen = {"markers": self.markers} if self.markers else {}
        return replace(recording, log=(replace(LABELLED_LIVE, settings=chosen),))


def recording_of(path: Path, rate: float | None = None) -> KeptSession:
    """What was recorded live, up to the moment in which it was stopped or killed.

    rate: frames per second, None for what the source said, else what the times show.
    Raises AsterismError where the file is no live recording, or holds no frame.
    """
    if not path.exists():
        raise AsterismError(f"{path} does not exist; check its name and folder.")
    steps = list(read_steps(path, _WORK))
    if not steps:
        raise AsterismError(f"{path} is no live recording; give the file that a session left beside its output, FILE.c3d.live.")
    head = json.loads(bytes(steps[0][0]))
    chunks = [_Arrays(*step) for step in steps[1:]]
    if not sum(len(chunk.frames) for chunk in chunks):
        raise AsterismError(f"{path} holds no frame: the source sent none while it was recorded.")
    numbers, counts = np.concatenate([chunk.frames for chunk in chunks]).T
    times, arrived = np.concatenate([chunk.times for chunk in chunks]).T
    points = np.concatenate([chunk.points for chunk in chunks])
    row = rows_of(numbers)
    rate = float(rate or head.get("rate") or rate_of_times(row, times).rate)
    rate = rate if math.isfinite(rate) else _UNKNOWN_RATE
    per_frame = np.zeros(row[-1] + 1, dtype=np.int64)
    per_frame[row] = counts
    offsets = np.concatenate([[0], np.cumsum(per_frame)])
    bare = Clouds.from_points([np.empty((0, 3))], rate, head["vertical"])
    clouds = replace(bare, xyz=points, offsets=offsets, columns=np.full(len(points), -1, dtype=np.int64))
    of_row = np.full(len(clouds), np.nan)
    of_row[row] = times
    row_of = dict(zip(zip(numbers.tolist(), arrived.tolist(), strict=True), row.tolist(), strict=True))
    labelling = _labelling(chunks, clouds, row_of)
    analog = analog_of_arrays([(chunk.devices, chunk.samples) for chunk in chunks])
    return KeptSession(clouds, labelling, head["name"], head["begun"], of_row, analog, head["markers"])


def _labelling(chunks: list[_Arrays], clouds: Clouds, row_of: dict[tuple[int, float], int]) -> Labelling | None:
    names: list[str] = next((found for chunk in reversed(chunks) if (found := json.loads(bytes(chunk.names)))), [])
    if not names:
        return None
    indices, confidence = np.full((len(clouds), len(names)), NULL, dtype=np.int64), np.zeros((len(clouds), len(names)))
    for chunk in chunks:
        first = 0
        for (number, count), arrived in zip(chunk.labelled.tolist(), chunk.arrived.tolist(), strict=True):
            markers, sure = chunk.markers[first : first + count], chunk.confidence[first : first + count]
            first += count
            row, given = row_of.get((number, arrived)), np.nonzero(markers >= 0)[0]
            if row is not None:
                indices[row, markers[given]], confidence[row, markers[given]] = given, sure[given]
    return Labelling(indices, confidence, tuple(names))
