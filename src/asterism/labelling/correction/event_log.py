"""The log of a person's corrections: a file beside the recording, one line of JSON per touch, that survives a crash at any moment."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import Clouds

if TYPE_CHECKING:
    from asterism.labelling.marker_model import MarkerModel

FORMAT, VERSION = "asterism-corrections", 1
SUFFIX = ".asterism-log.jsonl"
UNDO, REDO, SAVED = "undo", "redo", "saved"


def hash_of_points(clouds: Clouds) -> str:
    """A hash of a recording's points and rate: 64 hexadecimal digits."""
    # The rate is part of who a recording is: labels depend on it.
    digest = hashlib.sha256(f"{clouds.rate!r}".encode())
    digest.update(np.ascontiguousarray(clouds.offsets, dtype="<i8").tobytes())
    digest.update(np.ascontiguousarray(clouds.xyz, dtype="<f8").tobytes())
    return digest.hexdigest()


def hash_of_models(models: Sequence[MarkerModel]) -> str:
    """A hash of what the models of several bodies label by; of one model, its own."""
    hashes = [hash_of_model(model) for model in models]
    return hashes[0] if len(hashes) == 1 else hashlib.sha256(" ".join(hashes).encode()).hexdigest()


def hash_of_model(model: MarkerModel) -> str:
    """A hash of what a model labels by: 64 hexadecimal digits."""
    state = model.state
    digest = hashlib.sha256(json.dumps([state.marker_set.names, state.usual_score, state.least_confidence], sort_keys=True).encode())
    # Only what decides labels counts: a model that is saved again stays the same one.
    arrays = {"markers": state.markers, "triples": state.anchors.triples, **state.body.to_arrays()}
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode() + array.tobytes())
    return digest.hexdigest()


def log_path(file: Path, folder: Path | None = None) -> Path:
    """Where the log of a recording's file is: beside it, or in a folder."""
    return (file.parent if folder is None else folder) / f"{file.name}{SUFFIX}"


class CorrectionLog:
    """A log that is open: entries are appended and on the disk when `append` returns. One program at a time holds it."""

    def __init__(self, path: Path, points: str, model: str) -> None:
        """Open the log of a recording and a model, given by their hashes, or begin it. `entries` are what it holds.

        Raises AsterismError where it cannot be read or written, is damaged, belongs to another recording or model, is of a later version,
        or is open in another program.
        """
        self.path = path
        self.entries: list[dict[str, Any]] = []
        self.dropped = False
        """Whether the last entry was not whole, as of a program that was killed, and was dropped."""
        header = {"format": FORMAT, "version": VERSION, "points": points, "model": model}
        try:
            if not path.exists():
                _begin(path, header)
            self._file = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
        except OSError as problem:
            raise AsterismError(
                f"{path}: the log of corrections cannot be written ({problem.strerror}); put it into another folder with --log-folder."
            ) from problem
        try:
            # Locked before it is read: another program may be writing its last line.
            _lock(self._file, path)
            self._length = self._read(header)
        except BaseException:
            os.close(self._file)
            raise

    def append(self, *entries: Mapping[str, Any]) -> None:
        """Write entries; they are on the disk when this returns.

        Raises AsterismError where they cannot be written; none of them stays then.
        """
        now = datetime.now(UTC).isoformat(timespec="seconds")
        lines = b"".join(json.dumps({**entry, "at": now}, separators=(",", ":")).encode() + b"\n" for entry in entries)
        try:
            # The file may hold half a line of an entry that failed before.
            os.lseek(self._file, self._length, os.SEEK_SET)
            written = 0
            while written < len(lines):
                written += os.write(self._file, lines[written:])
            # A person's work must survive the power being cut.
            os.fsync(self._file)
        except OSError as problem:
            # Nothing of a failed write stays, or the next program would call the log damaged.
            os.ftruncate(self._file, self._length)
            raise AsterismError(
                f"{self.path}: the correction cannot be written ({problem.strerror}) and was not taken; make space, and try again."
            ) from problem
        self._length += len(lines)

    def close(self) -> None:
        """Close the file, which frees it for other programs."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _read(self, header: Mapping[str, Any]) -> int:
        """Read the header and the entries; cut a last line off that is not whole. Returns the length in bytes."""
        content = b""
        while part := os.read(self._file, 1 << 20):
            content += part
        lines = content.split(b"\n")
        _check_header(self.path, lines[0], header)
        length = len(lines[0]) + 1
        for number, line in enumerate(lines[1:], 2):
            entry = _entry(line)
            if entry is None:
                # A line that is not whole and has others behind it was not cut off by a crash.
                if any(later.strip(b"\0 \r\n") for later in lines[number:]):
                    raise AsterismError(f"{self.path}, line {number} is damaged; delete it, or delete the log and correct anew.")
                self.dropped = bool(line)
                break
            self.entries.append(entry)
            length += len(line) + 1
        # What was cut off is removed, so that the next entry begins on a line of its own.
        if length != len(content):
            os.ftruncate(self._file, length)
            os.fsync(self._file)
        return length


def _entry(line: bytes) -> dict[str, Any] | None:
    try:
        entry = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return entry if isinstance(entry, dict) and isinstance(entry.get("kind"), str) else None


def _check_header(path: Path, line: bytes, expected: Mapping[str, Any]) -> None:
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise AsterismError(f"{path} is no log of corrections, or its first line is damaged; move it away, and correct anew.")
    if found.get("version") != VERSION:
        raise AsterismError(f"{path} was written by a later Asterism; update Asterism.")
    for what, name in (("points", "recording"), ("model", "model")):
        if found.get(what) != expected[what]:
            raise AsterismError(
                f"{path}: these corrections were made of another {name}; give that {name}, or move the log away and correct anew."
            )


def _begin(path: Path, header: Mapping[str, Any]) -> None:
    """Write a log with its header only, so that no other program ever sees half of it."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with temporary.open("wb") as file:
            file.write(json.dumps(header, separators=(",", ":")).encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
        try:
            os.link(temporary, path)  # fails where another program was faster, whose log must stay
        except FileExistsError:
            return
        except OSError:  # a file system without links
            os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    # The new name itself must be on the disk, which only POSIX lets a program ask for.
    if os.name == "posix":
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _lock(file: int, path: Path) -> None:
    """Hold a file for as long as it is open. Raises AsterismError where another program, or another log, holds it."""
    try:
        if os.name == "posix":
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        else:
            import msvcrt

            # Windows locks bytes, not files: one far behind the end stands for the whole.
            os.lseek(file, 1 << 30, os.SEEK_SET)
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
            os.lseek(file, 0, os.SEEK_SET)
    except OSError as problem:
        raise AsterismError(f"{path} is open in another program that corrects this recording; close that one first.") from problem
