"""A rig and where its blobs come from in; points of each frame, made in a process of its own, out."""

from __future__ import annotations

import dataclasses
import math
import pickle
import signal
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from asterism.cameras import Rig
from asterism.errors import AsterismError, sentence_of
from asterism.files.plain import as_json
from asterism.files.processes import clean_context
from asterism.findings import Finding
from asterism.live.blobs.judging import JudgeProcess
from asterism.live.blobs.rig_health import RigCameraHealth
from asterism.live.blobs.rig_source import RigSource
from asterism.live.camera_frames import BlobSource
from asterism.live.frames import TURN, LiveFrame, SourceAbout, SourceEnded
from asterism.live.pauses import short_pauses
from asterism.reconstruction import ReconstructionSettings

OpenBlobs = Callable[[], BlobSource]
"""Opens a source of blobs; a function of a module, or a partial of one, so that another process can call it."""

_HEAD = struct.Struct("<qdd")
"""Of each frame: number, time, arrived."""
_TAKEN, _STOP = b"T", b"S"
"""What is said to the process: a frame was taken; nobody wants more."""
_REPORT = 0.5
"""s between two reports of the process. Half of it costs twice the messages; at twice as much a page shows what was a second ago."""
_ON_THE_WAY = 3
"""Frames that may be on their way between the processes: one that is read, one that waits, one that is written. With one, each waits for
the other; twice as many are old where this process is too slow."""
_ENDING = 5.0
"""s that the process may take to end; then it is ended. Its threads end within a tenth of a second; a driver may take longer. Half of it
kills one that only takes its time; twice as much is waited for in vain."""


@dataclass(frozen=True)
class RigReport:
    """What the process says of itself: what of `RigSource` other than frames is asked for."""

    damaged: int
    dropped: int
    image_wait: float
    cameras: list[RigCameraHealth]
    findings: list[Finding]
    ended: bool = False
    problem: str = ""


class RigProcess:
    """What `RigSource` is, with its work in another process, so that neither waits for the other's Python.

    open_blobs  opens the source of blobs there
    rig, settings, keep  as of `RigSource`

    Frames come through a pipe, each a few kilobytes. What is taken is said, so that where this process is too slow frames are dropped
    there, and counted, and what comes through is never old. Raises AsterismError where the source cannot be opened.
    """

    def __init__(
        self, open_blobs: OpenBlobs, rig: Rig, settings: ReconstructionSettings | None = None, *, keep: Path | None = None
    ) -> None:
        context = clean_context(__name__)
        self._pipe, there = context.Pipe()
        # A process that ends with this one may not begin another.
        self._judge = JudgeProcess(context)
        words = (there, self._judge.pipe, open_blobs, rig, settings, keep)
        self._process = context.Process(target=_serve, args=words, name="live rig", daemon=True)
        self._process.start()
        # With our copies open, the end of the process would not end the pipes.
        there.close()
        self._judge.pipe.close()
        self._closed = self._begun = False
        self._report: RigReport | None = None
        try:
            begun = self._pipe.recv()
        except (EOFError, OSError):
            begun = f"the process that makes points ended with status {self._process.exitcode} as it began; start it again."
        if isinstance(begun, str):
            self.close()
            raise AsterismError(begun)
        self.about: SourceAbout = begun[0]
        self.port: int = begun[1]

    @property
    def damaged(self) -> int:
        """Packets or images that could not be read."""
        return 0 if self._report is None else self._report.damaged

    @property
    def dropped(self) -> int:
        """Frames whose points were not made, since newer ones waited."""
        return 0 if self._report is None else self._report.dropped

    @property
    def image_wait(self) -> float:
        """See `RigSource.image_wait`."""
        return 0.0 if self._report is None else self._report.image_wait

    def read(self, timeout: float) -> LiveFrame | None:
        """The points of the next frame; None where none came within so many seconds. Raises SourceEnded."""
        until = time.monotonic() + timeout
        if not self._begun:
            # Frames of the time before are nobody's.
            self._begun = True
            self._judge.begin()
            self._say(_ON_THE_WAY * [_TAKEN])
        while True:
            if self._closed or (self._report is not None and self._report.ended):
                if self._report is not None and self._report.problem:
                    raise AsterismError(self._report.problem)
                raise SourceEnded
            try:
                if not self._pipe.poll(max(0.0, until - time.monotonic())):
                    return None
                frame = self._received(self._pipe.recv_bytes())
            except (EOFError, OSError):
                if self._closed:
                    raise SourceEnded from None
                raise AsterismError("the process that makes points of blobs ended; start it again.") from None
            if frame is not None:
                return frame

    def close(self) -> None:
        """End the process. What it counted to its end is kept."""
        if self._closed:
            return
        self._closed = True
        self._say([_STOP])
        # Behind that, so that nothing is judged in its place.
        self._judge.close()
        with suppress(OSError, EOFError):
            until = time.monotonic() + _ENDING
            while not (self._report is not None and self._report.ended) and self._pipe.poll(max(0.0, until - time.monotonic())):
                self._received(self._pipe.recv_bytes())
        self._pipe.close()
        self._process.join(_ENDING)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def cameras(self) -> list[RigCameraHealth]:
        """How each camera does, in the rig's order."""
        return [] if self._report is None else self._report.cameras

    def camera_numbers(self) -> list[dict[str, Any]]:
        """The same as plain values; what is not known is None."""
        return [as_json(dataclasses.asdict(camera)) for camera in self.cameras()]

    def findings(self) -> list[Finding]:
        """What a person should know of the cameras and their rig."""
        return [] if self._report is None else self._report.findings

    def _say(self, words: list[bytes]) -> None:
        """Say something to the process; that it ended is seen where frames are read."""
        with suppress(OSError):
            for word in words:
                self._pipe.send_bytes(word)

    def _received(self, data: bytes) -> LiveFrame | None:
        """The frame in a message; None for a report, which is kept."""
        if data[:1] == b"F":
            self._say([_TAKEN])
            number, at, arrived = _HEAD.unpack_from(data, 1)
            return LiveFrame(number, at, arrived, np.frombuffer(data, dtype=np.float64, offset=1 + _HEAD.size).reshape(-1, 3))
        self._report = pickle.loads(data[1:])
        return None


def _serve(
    pipe: Connection[Any, Any],
    judge_pipe: Connection[Any, Any],
    open_blobs: OpenBlobs,
    rig: Rig,
    settings: ReconstructionSettings | None,
    keep: Path | None,
) -> None:
    """Send frames until the source ends, or the pipe says or shows that nobody wants them."""
    # Ctrl-C reaches all processes of a terminal: the first one decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    blobs = source = None
    try:
        blobs = open_blobs()
        source = RigSource(blobs, rig, settings, keep=keep, judge_pipe=judge_pipe)
    except Exception as problem:
        if blobs is not None:
            blobs.close()
        pipe.send(sentence_of(problem))
        return
    with short_pauses(), suppress(OSError, EOFError):
        pipe.send((source.about, getattr(blobs, "port", 0)))
        problem_said = _frames(pipe, source)
        source.close()
        _tell(pipe, source, ended=True, problem=problem_said)
    source.close()


def _frames(pipe: Connection[Any, Any], source: RigSource) -> str:
    """Send frames until the end. Returns what went wrong."""
    # What is taken is said for the first time when frames are wanted.
    told, on_the_way = -math.inf, _ON_THE_WAY
    while True:
        while pipe.poll(TURN if on_the_way >= _ON_THE_WAY else 0):
            if pipe.recv_bytes() == _STOP:
                return ""
            on_the_way -= 1
        try:
            frame = None if on_the_way >= _ON_THE_WAY else source.read(TURN)
        except SourceEnded:
            return ""
        except Exception as problem:
            return sentence_of(problem)
        if frame is not None:
            pipe.send_bytes(b"F" + _HEAD.pack(frame.number, frame.time, frame.arrived) + np.ascontiguousarray(frame.points).tobytes())
            on_the_way += 1
        if time.monotonic() - told > _REPORT:
            told = time.monotonic()
            _tell(pipe, source)


def _tell(pipe: Connection[Any, Any], source: RigSource, *, ended: bool = False, problem: str = "") -> None:
    report = RigReport(source.damaged, source.dropped, source.image_wait, source.cameras(), source.findings(), ended, problem)
    pipe.send_bytes(b"R" + pickle.dumps(report))
