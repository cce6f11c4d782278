"""A recording in; its frames as a camera system would deliver them, at their own rate, out."""

from __future__ import annotations

import math
import threading
import time
from pathlib import Path

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.formats import read
from asterism.live.frames import LiveFrame, SourceAbout, SourceEnded

_TOLD = ("format-several-streams",)
"""Notes of readers that somebody who plays a file needs: what is played may not be what was meant."""


class Playback:
    """When what a file holds is due: at so many times its own rate, from the first time that it is waited for.

    speed: inf for as fast as it is taken. Raises AsterismError where the speed is not above 0.
    """

    def __init__(self, speed: float) -> None:
        if not speed > 0:
            raise AsterismError(f"a speed of {speed:g} plays nothing; give one above 0, as in --speed 2.")
        self._speed, self._begin, self._closed = speed, math.nan, threading.Event()

    def rate(self, own: float) -> float:
        """How many come per second, of so many in a second of the file."""
        return own * min(self._speed, 1e6) if math.isfinite(self._speed) else own

    def moment(self, at: float) -> float:
        """s on `time.monotonic` of what is at `at` s of the file; without a bound of the speed as if it were 1."""
        return self._begin + (at / self._speed if math.isfinite(self._speed) else at)

    def waits_for(self, at: float, timeout: float) -> bool:
        """Wait for what is at `at` s of the file; whether it is due within so many seconds. Raises SourceEnded where it is closed."""
        if self._closed.is_set():
            raise SourceEnded
        now = time.monotonic()
        self._begin = now if math.isnan(self._begin) else self._begin
        wait = self._begin + at / self._speed - now
        if self._closed.wait(max(0.0, min(wait, timeout))) and wait <= timeout:
            raise SourceEnded
        return wait <= timeout

    def close(self) -> None:
        """Stop playing."""
        self._closed.set()


class Replay:
    """A source that plays a file: its points without their names, each frame when it is due.

    path   any recording that `asterism.read` reads
    stream the stream of an XDF, as there
    speed  times its own rate; inf for as fast as frames are taken
    loop   whether it begins again at the end, its numbers and times going on

    Raises AsterismError where the file cannot be read, has no frame, or the speed is not above 0.
    """

    damaged = 0

    def __init__(self, path: Path, *, speed: float = 1.0, loop: bool = False, stream: str | None = None) -> None:
        self._playback = Playback(speed)
        recording = read(path, stream=stream)
        told = recording.metadata.get("findings", ())
        self._findings = [each for each in told if each.severity > Severity.NOTE or each.code in _TOLD]
        self._clouds = recording.clouds()
        if not len(self._clouds):
            raise AsterismError(f"{path} has no frame; there is nothing to play.")
        # Its own rate at any speed, as its times are: labels and speeds of the body are taken from it.
        self.about = SourceAbout(path.name, recording.rate, recording.vertical)
        self._loop, self._next = loop, 0

    def read(self, timeout: float) -> LiveFrame | None:
        """The next frame, when it is due."""
        if not self._loop and self._next >= len(self._clouds):
            raise SourceEnded
        at = self._next / self._clouds.rate
        if not self._playback.waits_for(at, timeout):
            return None
        frame = LiveFrame(self._next, at, time.monotonic(), self._clouds[self._next % len(self._clouds)])
        self._next += 1
        return frame

    def findings(self) -> list[Finding]:
        """What is wrong with the file, and that it holds other streams, too."""
        return list(self._findings)

    def close(self) -> None:
        """Stop playing."""
        self._playback.close()
