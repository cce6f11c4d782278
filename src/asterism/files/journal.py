"""The steps of long work in, one after the other; a file from which the same work goes on after it was broken off, out."""

from __future__ import annotations

import hashlib
import io
import os
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError, refuse_special
from asterism.files.atomic import holds

Arrays = list[NDArray[Any]]

_MAGIC = b"asterism steps 1\n"
_HEAD = struct.Struct("<QI")
"""Of each step: how many bytes it has, and their CRC-32."""


class Journal:
    """The results of steps, each in the file before the next one begins; a step that is there already is not done again.

    path  of the file; it is made with the first step
    work  all that the results depend on, as text: steps of other work are not used

    kept   how many steps of the same work were found
    other  whether the file held steps of other work, which were given up
    lost   why steps are not kept any more, as with a full disk; "" where they are

    A step that was cut off by a kill is done again. Raises AsterismError where the path is something else's, or another run has it open.
    """

    def __init__(self, path: Path, work: str) -> None:
        self.path, self.kept, self.other, self.lost = path, 0, False, ""
        self._begin = _begin_of(work)
        self._done = 0
        self._stream: io.BufferedRandom | None = None
        refuse_special(path)
        if path.exists():
            self._found()

    def step(self, compute: Callable[[], Sequence[NDArray[Any]]]) -> Arrays:
        """The arrays of the next step: those in the file, else those that `compute` gives, which are kept."""
        if self._done < self.kept and self._stream is not None:
            content = _next(self._stream)
            assert content is not None
            self._done += 1
            return _arrays(content)
        found = list(compute())
        self._done += 1
        self._keep(found)
        return found

    def close(self) -> None:
        """Leave the file for a later run."""
        if self._stream is not None:
            # What a full disk did not take is in the buffer still, and told in `lost`.
            with suppress(OSError):
                self._stream.close()
            self._stream = None

    def remove(self) -> None:
        """The work is done: the file is needed no more."""
        there = self._stream is not None
        self.close()
        if there:
            self.path.unlink(missing_ok=True)

    def _found(self) -> None:
        """Go to the first step of the file; a part of a step at its end is cut off."""
        stream = self._open("r+b")
        begin = stream.read(len(self._begin))
        if begin and not begin.startswith(_MAGIC[: len(begin)]):
            stream.close()
            raise AsterismError(f"{self.path} is not a file of unfinished work, whose name it has; move it elsewhere.")
        if begin != self._begin:
            # Steps of other work say nothing here.
            self.other = len(begin) == len(self._begin)
            stream.seek(0)
            stream.truncate()
            stream.write(self._begin)
            stream.flush()
        whole = stream.tell()
        while _next(stream) is not None:
            self.kept, whole = self.kept + 1, stream.tell()
        stream.truncate(whole)
        stream.seek(len(self._begin))
        self._stream = stream

    def _open(self, mode: str) -> io.BufferedRandom:
        try:
            stream: Any = open(self.path, mode)  # noqa: SIM115 -- open until the work is done
        except OSError as problem:
            raise AsterismError(f"{self.path} cannot be opened ({problem.strerror}); check its permissions.") from problem
        if holds(stream.fileno()) is False:
            stream.close()
            raise AsterismError(f"{self.path} is in use: another run does the same work; wait for it, or name another output.")
        return stream

    def _keep(self, arrays: Arrays) -> None:
        if self.lost:
            return
        content = io.BytesIO()
        for array in arrays:
            np.lib.format.write_array(content, np.asarray(array), allow_pickle=False)
        data = content.getvalue()
        try:
            if self._stream is None:
                self._stream = self._open("x+b")
                self._stream.write(self._begin)
            self._stream.write(_HEAD.pack(len(data), zlib.crc32(data)) + data)
            # With the system, where a kill of this process leaves it.
            self._stream.flush()
        except (OSError, AsterismError) as problem:
            # Work that can be done and not be kept is done.
            self.lost = getattr(problem, "strerror", None) or str(problem)


def read_steps(path: Path, work: str) -> Iterator[Arrays]:
    """The whole steps of this work that a file holds, up to the first one that is damaged or cut off; none where it is no such file.

    The file is only read: one that another run still writes to, or whose end is damaged, stays as it is.
    """
    with suppress(OSError), open(path, "rb") as stream:
        if _begins(stream, work):
            while (content := _next(stream)) is not None:
                yield _arrays(content)


def unread_bytes(path: Path, work: str) -> int:
    """How many bytes are behind the last whole step of this work: all of them where a file holds none. 0 where there is no file."""
    end = 0
    with suppress(OSError), open(path, "rb") as stream:
        if _begins(stream, work):
            end = stream.tell()
            while _next(stream) is not None:
                end = stream.tell()
        return os.fstat(stream.fileno()).st_size - end
    return 0


def in_use(path: Path) -> bool:
    """Whether another run has a journal open; False where the system does not tell."""
    with suppress(OSError), open(path, "rb") as stream:
        return holds(stream.fileno()) is False
    return False


def _begins(stream: io.BufferedReader, work: str) -> bool:
    """Whether a file holds steps of this work, which are read next."""
    begin = _begin_of(work)
    return stream.read(len(begin)) == begin


def _begin_of(work: str) -> bytes:
    """What a file with steps of this work begins with."""
    return _MAGIC + hashlib.sha256(work.encode("utf-8", "surrogateescape")).digest()


def _next(stream: io.BufferedRandom | io.BufferedReader) -> bytes | None:
    """The bytes of the step that begins here; None at the end, and where it is not whole."""
    head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return None
    length, check = _HEAD.unpack(head)
    # A damaged length must not ask for more memory than there is file.
    if length > os.fstat(stream.fileno()).st_size - stream.tell():
        return None
    content = stream.read(length)
    return content if zlib.crc32(content) == check else None


def _arrays(content: bytes) -> Arrays:
    stream = io.BytesIO(content)
    found: Arrays = []
    while stream.tell() < len(content):
        found.append(np.lib.format.read_array(stream, allow_pickle=False))
    return found
