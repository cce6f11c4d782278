"""Bytes and a path in; a file that is there whole or not at all, with the permissions and behind the link that it had, out."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from asterism.errors import AsterismError

_LONGEST_NAME = 180
"""Bytes of a file's name that its temporary name repeats: file systems end at 255."""

_removed: Callable[[Path], None] | None = None


def on_removed(callback: Callable[[Path], None] | None) -> None:
    """Call `callback(path)` for each unfinished file of a killed run that is removed. None removes the callback."""
    global _removed
    _removed = callback


def utf8(text: str) -> bytes:
    """The text as UTF-8; what is no character, as in file names that are not UTF-8, becomes a question mark."""
    return text.encode("utf-8", "replace")


def write_atomically(path: Path, data: bytes | bytearray | Iterable[bytes | bytearray]) -> None:
    """Write the whole file or nothing, under a temporary name in the same folder that is then renamed. data: its bytes, or pieces of them.

    A file that is replaced keeps its permissions, and a link stays one: its target is replaced. Unfinished files of the same name that
    killed runs left behind are removed. Raises AsterismError where the place cannot be written to.
    """
    try:
        # The target is replaced, not the link to it.
        target = Path(os.path.realpath(path)) if path.is_symlink() else path
        remove_unfinished(target)
        temporary = target.with_name(_temporary_name(target.name, os.getpid()))
        mode = target.stat().st_mode & 0o777 if target.exists() else None
        try:
            # Created for us alone: a file of that name is another process', or an attack.
            handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666 if mode is None else 0o600)
            with os.fdopen(handle, "wb") as stream:
                for piece in [data] if isinstance(data, bytes | bytearray) else data:
                    stream.write(piece)
            if mode is not None:
                os.chmod(temporary, mode)
            # Renaming is atomic: a reader sees the old file or the new one.
            os.replace(temporary, target)
        finally:
            # Also after an error: what is left would look like a file of a killed run.
            temporary.unlink(missing_ok=True)
    except OSError as problem:
        raise AsterismError(
            f"{path} cannot be written ({problem.strerror or problem}); check the folder, space and permissions."
        ) from problem


def remove_unfinished(target: Path) -> None:
    """Remove the temporary files of this name whose process has ended."""
    beginning = _temporary_name(target.name, 0).removesuffix("0.part")
    for path in target.parent.glob(f"{_literally(beginning)}*.part"):
        found = re.fullmatch(r"(\d{1,10})\.part", path.name.removeprefix(beginning))
        # Only a process that has ended leaves its file behind.
        if found and not _runs(int(found[1])):
            path.unlink(missing_ok=True)
            if _removed is not None:
                _removed(path)


def _temporary_name(name: str, process: int) -> str:
    short = os.fsdecode(os.fsencode(name)[:_LONGEST_NAME])
    return f".{short}.{process}.part"


def _literally(text: str) -> str:
    """The text as a pattern of names that only it fits."""
    # Square brackets make the wild cards of a glob stand for themselves.
    return re.sub(r"([*?\[])", r"[\1]", text)


def _runs(process: int) -> bool:
    """Whether another process of this number runs; also where that cannot be told. This process has no unfinished file when it asks."""
    if process == os.getpid():
        return False
    # Windows tells nothing without rights: then the file stays.
    if sys.platform == "win32":
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
