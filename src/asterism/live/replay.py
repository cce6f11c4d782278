"""A recording in; its frames as a camera system would deliver them, at their own rate, out."""

from __future__ import annotations

import threading
import time
from pathlib import Path

from asterism.errors import AsterismError
from asterism.formats import read
from asterism.live.frames import LiveFrame, SourceAbout, SourceEnded


class Replay:
    """A source that plays a file: its points without their names, each frame when it is due.

    path   any recording that `asterism.read` reads
    speed  times its own rate; inf for as fast as frames are taken
    loop   whether it begins again at the end, its numbers and times going on

    Raises AsterismError where the file cannot be read, has no frame, or the speed is not above 0.
    """

    damaged = 0

    def __init__(self, path: Path, *, speed: float = 1.0, loop: bool = False) -> None:
        if not speed > 0:
            raise AsterismError(f"a speed of {speed:g} plays nothing; give one above 0, as in --speed 2.")
        recording = read(path)
        self._clouds = recording.clouds()
        if not len(self._clouds):
            raise AsterismError(f"{path} has no frame; there is nothing to play.")
        self.about = SourceAbout(
            path.name, recording.rate * min(speed, 1e6) if speed < float("inf") else recording.rate, recording.vertical
        )
        self._speed, self._loop, self._next = speed, loop, 0
        self._begin: float | None = None
        self._closed = threading.Event()

    def read(self, timeout: float) -> LiveFrame | None:
        """The next frame, when it is due."""
        if self._closed.is_set() or (not self._loop and self._next >= len(self._clouds)):
            raise SourceEnded
        now = time.monotonic()
        self._begin = now if self._begin is None else self._begin
        at = self._next / self._clouds.rate
        wait = self._begin + at / self._speed - now
        if wait > timeout:
            self._closed.wait(timeout)
            return None
        if wait > 0 and self._closed.wait(wait):
            raise SourceEnded
        frame = LiveFrame(self._next, at, time.monotonic(), self._clouds[self._next % len(self._clouds)])
        self._next += 1
        return frame

    def close(self) -> None:
        """Stop playing."""
        self._closed.set()
