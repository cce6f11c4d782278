"""The last frames of a rig in; what they say of its noise and cameras, found in a process that gives way to all others, out."""

from __future__ import annotations

import signal
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from asterism.files.processes import clean_context, give_way
from asterism.reconstruction.streaming import Judgement, RecentFrames, judged


class JudgeProcess:
    """Judges noise and cameras in a process of its own: some tenths of a second of Python, for which frames would wait otherwise.

    context  of `clean_context`; None for its own
    pipe     for `judge`; it may be given to another process, and is then closed here. Nothing runs before `begin`
    """

    def __init__(self, context: Any = None) -> None:
        self._context = clean_context(__name__) if context is None else context
        self.pipe, self._there = self._context.Pipe()
        self._process: Any = None

    def begin(self) -> None:
        """Start the process, once."""
        if self._process is None and not self._there.closed:
            self._process = self._context.Process(target=_serve, args=(self._there,), name="live judge", daemon=True)
            self._process.start()
            # With our copy open, the end of the process would not end the pipe.
            self._there.close()

    def close(self) -> None:
        """End the process at once. Whoever waits for a judgement gets an OSError or EOFError."""
        self._there.close()
        if self._process is not None:
            # It has nothing that would be lost.
            self._process.kill()
            self._process.join()
        self.pipe.close()


def judge(pipe: Connection[Any, Any], recent: RecentFrames) -> Judgement | None:
    """What `judged` says, by the process at the other end. Raises OSError or EOFError where it has ended."""
    pipe.send((len(recent.frames), replace(recent, frames=())))
    # One after the other, so that other threads need not wait until all of them are written.
    for frame in recent.frames:
        pipe.send(frame)
    found: Judgement | None = pipe.recv()
    return found


def _serve(pipe: Connection[Any, Any]) -> None:
    """Judge what comes until nobody wants it."""
    # Ctrl-C reaches all processes of a terminal: the first one decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    give_way()
    with suppress(OSError, EOFError):
        while True:
            count, recent = pipe.recv()
            frames = tuple(pipe.recv() for _ in range(count))
            pipe.send(judged(replace(recent, frames=frames)))
