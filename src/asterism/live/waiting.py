"""Frames that one thread takes in and another one works on: a few that wait, the oldest out first."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from asterism.live.frames import TURN

Frame = TypeVar("Frame")


class WaitingFrames(Generic[Frame]):
    """A bounded queue between two threads.

    waits  whether who puts a frame waits until there is room, as a file can; else the oldest one is left out, so that none is old

    >>> queue = WaitingFrames[int](waits=False)
    >>> [queue.put(number, most=2) for number in range(4)], queue.take(0.0), queue.take(0.0), queue.take(0.0)
    ([[], [], [0], [1]], 2, 3, None)
    """

    def __init__(self, *, waits: bool) -> None:
        self.is_stopped, self._waits, self._closed = False, waits, False
        self._frames: deque[Frame] = deque()
        self._there = threading.Condition()

    def put(self, frame: Frame, most: int) -> list[Frame]:
        """Have a frame wait among so many at most; the older ones that were left out for it."""
        with self._there:
            while self._waits and len(self._frames) >= most and not self.is_stopped:
                self._there.wait(TURN)
            self._frames.append(frame)
            left_out = [] if self._waits else [self._frames.popleft() for _ in range(len(self._frames) - most)]
            self._there.notify_all()
            return left_out

    def take(self, timeout: float = math.inf) -> Frame | None:
        """The oldest frame; None where none came within so many seconds, or none comes any more."""
        until = time.monotonic() + timeout
        with self._there:
            while not self._frames and not self._closed and (left := until - time.monotonic()) > 0:
                self._there.wait(min(left, TURN))
            frame = self._frames.popleft() if self._frames else None
            self._there.notify_all()
            return frame

    def take_fresh(self, timeout: float, is_old: Callable[[Frame], bool]) -> tuple[Frame | None, list[Frame]]:
        """The oldest frame that is not old, or the newest one; and the older ones that were left out for it."""
        frame, left_out = self.take(timeout), list[Frame]()
        while frame is not None and is_old(frame) and (newer := self.take(0.0)) is not None:
            left_out.append(frame)
            frame = newer
        return frame, left_out

    @property
    def is_over(self) -> bool:
        """Whether all is taken, and none comes any more."""
        return self._closed and not self._frames

    def stop(self) -> None:
        """Let nobody wait for room any more."""
        with self._there:
            self.is_stopped = True
            self._there.notify_all()

    def close(self) -> None:
        """Say that no frame comes any more; those that wait can be taken."""
        with self._there:
            self.is_stopped = self._closed = True
            self._there.notify_all()
