"""Blobs as they come in; a file that keeps them, written beside the session, out."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path

from asterism.formats.kept_blobs import KeptBlobs, KeptImage
from asterism.live.writing import WritingThread

_MOST = 20_000
"""Images that wait for the disk: 8 s of 12 cameras at 200 Hz, some 16 MB. Half of it loses images while a disk wakes up; at double it is
kept by a machine that has no room."""


class BlobRecorder:
    """Writes blobs to a file from a thread of its own.

    What does not fit into memory while the disk is busy is not kept, and `left_out` counts it. A disk that fails ends the recording and not
    the session: `problem` says why. Raises AsterismError where the file exists.
    """

    def __init__(self, path: Path, cameras: Sequence[str], rate: float, together: bool) -> None:
        self.path, self.left_out = path, 0
        self._file = KeptBlobs(path, cameras, rate, together)
        self._waiting = list[KeptImage]()
        self._guard = threading.Lock()
        self._thread = WritingThread(self._flush, "live blobs recording")

    @property
    def problem(self) -> str:
        """Why nothing is kept any more; "" where it is."""
        return f"{self.path}: recording ended ({self._file.lost}); what was recorded before is kept." if self._file.lost else ""

    def add(self, image: KeptImage) -> None:
        """Keep an image; returns at once."""
        with self._guard:
            if self._file.lost or len(self._waiting) >= _MOST:
                self.left_out += 1
            else:
                self._waiting.append(image)

    def close(self) -> None:
        """Write the rest."""
        self._thread.close()
        self._file.close()

    def _flush(self) -> None:
        with self._guard:
            images, self._waiting = self._waiting, []
        if images:
            self._file.add(images)
