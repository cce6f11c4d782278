"""The log of a person's corrections: a file beside the recording, one line of JSON per touch, that survives a crash at any moment."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from asterism.errors import AsterismError, refuse_special
from asterism.files.atomic import create_atomically, keep
from asterism.recording import Clouds

if TYPE_CHECKING:
    from asterism.labelling.marker_model import MarkerModel

FORMAT, VERSION = "asterism-corrections", 1
SUFFIX, NAMES_SUFFIX = ".asterism-log.jsonl", ".asterism-names.jsonl"
"""Of the log of corrections, and of that of names for groups of points."""
UNDO, REDO, SAVED, RELABELLED = "undo", "redo", "saved", "relabelled"

_ATTEMPTS = 5
"""How often an entry is written again because the file was moved away meanwhile: once is rare, five times is no accident."""


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


def log_path(file: Path, folder: Path | None = None, suffix: str = SUFFIX) -> Path:
    """Where the log of a recording's file is: beside it, or in a folder."""
    return (file.parent if folder is None else folder) / f"{file.name}{suffix}"


class CorrectionLog:
    """A log that is open: entries are on the disk, in the file of its name, when `append` returns. One program at a time writes it."""

    def __init__(self, path: Path, points: str, model: str) -> None:
        """Open the log of a recording, labelled by a model, given by their hashes; where there is none, the first entry begins it.

        `entries` are what it holds. Nothing is written before the first `append`. What was said may have been said of another model's
        labels, see `other_model`: it names points and markers, and holds whatever labels the others.

        Raises AsterismError where it cannot be read or written, is damaged, belongs to another recording, is of a later version, or is open
        in another program.
        """
        self.path = path
        self.entries: list[dict[str, Any]] = []
        self.lines: list[int] = []
        """The line of the file that each of them is."""
        self.dropped = False
        """Whether the end of the file was not whole, as of a program that was killed, and is dropped."""
        self._model = self._noted_model = model
        self._header = {"format": FORMAT, "version": VERSION, "points": points, "model": model}
        # what the file must hold, all of it: a log that is deleted under a running program is written again
        self._content = _line(self._header)
        self._found = b""
        """What the file was found or left with."""
        self._changed_at = -1
        self._file = -1
        self._refused: AsterismError | None = None
        if path.is_symlink() or path.exists():
            self._open()
            try:
                self._content, self.entries, self.lines, self.dropped = _parsed(path, self._found, self._header)
                self._noted_model = self._last_model()
            except BaseException:
                self._release()
                raise
        elif not os.access(path.parent, os.W_OK):
            raise self._not_written("its folder does not exist" if not path.parent.exists() else "its folder is read-only")

    def append(self, *entries: Mapping[str, Any]) -> None:
        """Write entries; they are on the disk, in the file of this name, when this returns. A log that was moved away is written again.

        Raises AsterismError where they cannot be written, or another program has changed or replaced the file; none of them stays then.
        """
        now = datetime.now(UTC).isoformat(timespec="seconds")
        # What is said is said of the labels of a model: which one, the log knows.
        noted = ({"kind": RELABELLED, "model": self._model},) if self.other_model else ()
        lines = b"".join(_line({**entry, "at": now}) for entry in (*noted, *entries))
        # The file may be moved away between the check and the write: then once more, into a new one.
        for _ in range(_ATTEMPTS):
            self._secure()
            self._write(lines)
            if self._is_in_place():
                self._content += lines
                self._noted_model = self._model
                return
        raise AsterismError(f"{self.path} is moved away again and again, and the correction was not taken; find out what moves it.")

    @property
    def other_model(self) -> bool:
        """Whether what it holds was said last of the labels of another model."""
        return self._noted_model != self._model

    def relabelled(self, model: str) -> None:
        """Note that a model, given by its hash, has labelled the recording again. Raises AsterismError as `append` does."""
        before, self._model = self._model, model
        try:
            # A model that the log names already needs no line.
            if self.other_model:
                self.append()
        except BaseException:
            self._model = before
            raise

    def close(self) -> None:
        """Close the file, which frees it for other programs.

        Raises AsterismError where what was appended is not in the file any more and cannot be written again.
        """
        try:
            if self._file >= 0 and self._refused is None and self._says_something():
                self._secure()
        finally:
            self._release()

    def _last_model(self) -> str:
        """The hash of the model of whose labels something was said last."""
        lines = (match[0] for match in re.finditer(rb"[^\n\0]+", self._content))
        header = next(filter(None, map(_value, lines)), {})
        models = [entry.get("model") for entry in self.entries if entry["kind"] == RELABELLED]
        return str([header.get("model"), *models][-1])

    def _release(self) -> None:
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _says_something(self) -> bool:
        return self._content.count(b"\n") > 1

    def _secure(self) -> None:
        """Make sure that the file of this name is ours and as we left it; write it where it is not there."""
        if self._refused is not None:
            raise self._refused
        try:
            status = self.path.stat()
        except OSError:
            status = None
        if status is None or self._file < 0:
            self._restore()
        elif not self._is_in_place() or (status.st_size, status.st_mtime_ns) != (len(self._found), self._changed_at):
            # Only the content counts: a copy put in its place, or a new time stamp, is no change.
            held = self._found
            self._release()
            try:
                self._open()
            except AsterismError as problem:
                self._found = b""
                raise self._changed() from problem
            if self._found != held:
                raise self._changed()

    def _restore(self) -> None:
        """Write the whole log as a new file of its name."""
        self._release()
        # Never over a file that another program made meanwhile.
        try:
            create_atomically(self.path, self._content)
        except FileExistsError:
            raise AsterismError(
                f"{self.path} was begun by another program meanwhile, and the correction was not taken; close one, and start again."
            ) from None
        except OSError as problem:
            raise self._not_written(problem.strerror) from problem
        self._open()

    def _open(self) -> None:
        """Open the file of this name, hold it, and read it."""
        try:
            refuse_special(self.path)
            if not self.path.exists():
                raise AsterismError(f"{self.path} is a link that leads nowhere; remove it.")
            self._file = os.open(self.path, os.O_RDWR | getattr(os, "O_BINARY", 0))
        except OSError as problem:
            raise self._not_written(problem.strerror) from problem
        try:
            # Locked before it is read: another program may be writing its last line.
            _lock(self._file, self.path)
            self._note(self._read())
        except OSError as problem:
            self._release()
            raise self._not_written(problem.strerror) from problem
        except BaseException:
            self._release()
            raise

    def _write(self, lines: bytes) -> None:
        """Write lines behind what counts in the file. Where that fails, none of them stays."""
        # What was found behind what counts is an end that is not whole; what is missing is an end of line, or all.
        counts = (len(self._content), len(self._content) - 1, 0)
        kept = next(length for length in counts if self._found.startswith(self._content[:length]))
        try:
            self._put(kept, self._content[kept:] + lines)
            self._note(self._content + lines)
        except OSError as problem:
            # Nothing of a failed write stays, or the next program would read half a line.
            with suppress(OSError):
                os.ftruncate(self._file, kept)
            self._note(self._read())
            raise AsterismError(
                f"{self.path}: the correction cannot be written ({problem.strerror}) and was not taken; make space, and try again."
            ) from problem

    def _put(self, begin: int, data: bytes) -> None:
        os.ftruncate(self._file, begin)
        os.lseek(self._file, begin, os.SEEK_SET)
        while data:
            data = data[os.write(self._file, data) :]
        # A person's work must survive the power being cut.
        keep(self._file)

    def _read(self) -> bytes:
        os.lseek(self._file, 0, os.SEEK_SET)
        parts = []
        while part := os.read(self._file, 1 << 20):
            parts.append(part)
        return b"".join(parts)

    def _note(self, content: bytes) -> None:
        self._found, self._changed_at = content, os.fstat(self._file).st_mtime_ns

    def _is_in_place(self) -> bool:
        """Whether the open file is still the one of this name."""
        try:
            return os.path.samestat(self.path.stat(), os.fstat(self._file))
        except OSError:
            return False

    def _changed(self) -> AsterismError:
        """What to say, from now on, where another program has written to the file. What is not in it any more is kept beside it."""
        self._release()
        told = f"{self.path} was changed or replaced by another program, and the correction was not taken;"
        if self._found.startswith(self._content):
            told += " close that program, and start again: what both have written is in the file."
        elif self._says_something() and (beside := _set_aside(self.path, self._content)) is not None:
            told += f" the corrections before it are kept in {beside}: put that in its place, and start again."
        else:
            told += " start again to go on with the file as it is."
        self._refused = AsterismError(told)
        return self._refused

    def _not_written(self, why: str | None) -> AsterismError:
        return AsterismError(
            f"{self.path}: the log of corrections cannot be written ({why}); put it into another folder with --log-folder."
        )


def _line(values: Mapping[str, Any]) -> bytes:
    return json.dumps(values, separators=(",", ":")).encode() + b"\n"


def _parsed(path: Path, found: bytes, header: Mapping[str, Any]) -> tuple[bytes, list[dict[str, Any]], list[int], bool]:
    """What counts of a log's bytes, its entries, the line of each, and whether an end that was not whole is left out.

    A program that is killed, or a disk that loses power, cuts a file off anywhere or leaves zeros behind it.
    """
    # Zeros end a line, too: earlier versions left one where a last line had lost its end.
    lines = [match for match in re.finditer(rb"[^\n\0]+", found) if match[0].strip()]
    if not lines or (len(lines) == 1 and b"\n" not in found[lines[0].end() :] and _value(lines[0][0]) is None and _begins_log(lines[0][0])):
        # Cut off within its first line, it held nothing that was said.
        return _line(header), [], [], bool(found)
    _check_header(path, lines[0][0], header)
    entries: list[dict[str, Any]] = []
    numbers: list[int] = []
    end = lines[0].end()
    for line in lines[1:]:
        value = _value(line[0])
        number = found.count(b"\n", 0, line.start()) + 1
        if value is None or not isinstance(value.get("kind"), str):
            # A line that is not whole and has others behind it was not cut off by a crash.
            if line is not lines[-1]:
                raise damaged_line(path, number)
            return found[:end] + b"\n", entries, numbers, True
        entries.append(value)
        numbers.append(number)
        end = line.end()
    # What follows the last entry is an end of line, or none where that was cut off.
    return found[:end] + b"\n", entries, numbers, False


def damaged_line(path: Path, number: int) -> AsterismError:
    """What to say of a line that cannot be read; nothing that is whole is to be thrown away."""
    return AsterismError(
        f"{path}, line {number} is damaged; keep a copy of the log, and delete that line and those behind it to go on from there."
    )


def _value(line: bytes) -> dict[str, Any] | None:
    try:
        value = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return value if isinstance(value, dict) else None


def _begins_log(line: bytes) -> bool:
    """Whether half a line is the beginning of a log."""
    beginning = _line({"format": FORMAT})[:-2]
    return beginning.startswith(line[: len(beginning)])


def _check_header(path: Path, line: bytes, expected: Mapping[str, Any]) -> None:
    found = _value(line)
    if found is None or found.get("format") != FORMAT:
        raise AsterismError(f"{path} is no log of corrections, or its first line is damaged; move it away, and correct anew.")
    if found.get("version") != VERSION:
        raise AsterismError(f"{path} was written by a later Asterism; update Asterism.")
    if found.get("points") != expected["points"]:
        raise AsterismError(
            f"{path}: these corrections were made of another recording; give that recording, or move the log away and correct anew."
        )


def _set_aside(path: Path, content: bytes) -> Path | None:
    """Write the log beside the file of its name, as -2, -3 and so on; None where that cannot be."""
    for number in range(2, 100):
        beside = path.with_name(f"{path.name.removesuffix('.jsonl')}-{number}.jsonl")
        try:
            create_atomically(beside, content)
        except FileExistsError:
            continue
        except OSError:
            return None
        return beside
    return None


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
