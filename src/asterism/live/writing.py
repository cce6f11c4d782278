"""What is to be written while frames come in; a thread that writes it a few times a second out, so that nobody waits for a disk."""

from __future__ import annotations

import threading
from collections.abc import Callable

_EVERY = 0.25
"""s of frames that are written together. A kill loses them: half of what a person would miss; half of it again doubles the writes."""


class WritingThread:
    """Calls `write` four times a second in a thread of its own, and a last time when it is closed. write: must not raise."""

    def __init__(self, write: Callable[[], None], name: str) -> None:
        self._write, self._end = write, threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Write the rest, and end."""
        self._end.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._end.wait(_EVERY):
            self._write()
        self._write()
