"""Bytes and a path in; a file that is there whole or not at all, with the permissions and behind the link that it had, out."""

from __future__ import annotations

import errno
import os
import re
import secrets
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from asterism.errors import AsterismError, refuse_special

try:
    import fcntl
except ImportError:  # Windows: whether a file is held cannot be asked there, and none is taken for left
    fcntl = None  # type: ignore[assignment]

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

    The file, and its name, are on the disk when this returns. A file that is replaced keeps its permissions, and a link stays one: its
    target is replaced. Unfinished files of the same name that killed runs left behind are removed. Raises AsterismError where the place
    cannot be written to, or is a device or a pipe.
    """
    refuse_special(path)
    try:
        # The target is replaced, not the link to it.
        target = Path(os.path.realpath(path)) if path.is_symlink() else path
        remove_unfinished(target)
        mode = target.stat().st_mode & 0o777 if target.exists() else None
        with _written(target, data, mode) as temporary:
            # Renaming is atomic: a reader sees the old file or the new one.
            os.replace(temporary, target)
        _keep_names(target.parent)
    except OSError as problem:
        raise AsterismError(
            f"{path} cannot be written ({problem.strerror or problem}); check the folder, space and permissions."
        ) from problem


def create_atomically(path: Path, data: bytes) -> None:
    """Write a file that is not there yet, whole or not at all, in a way that never replaces one that another program makes meanwhile.

    Raises FileExistsError where there is one, OSError where the place cannot be written to.
    """
    with _written(path, data, None) as temporary:
        try:
            os.link(temporary, path)
        except FileExistsError:
            raise
        except OSError:  # a file system without links
            if os.path.lexists(path):
                raise FileExistsError(path) from None
            os.rename(temporary, path)
    _keep_names(path.parent)


@contextmanager
def _written(target: Path, data: bytes | bytearray | Iterable[bytes | bytearray], mode: int | None) -> Iterator[Path]:
    """A temporary file in the target's folder that holds the data, on the disk; gone at the end if it still has its name."""
    temporary, handle = _new_temporary(target, 0o666 if mode is None else 0o600)
    # Held until it is renamed: what nobody holds is the rest of a killed run, whichever machine or container that ran in.
    held = os.dup(handle) if fcntl is not None else -1
    try:
        with os.fdopen(handle, "wb") as stream:
            for piece in [data] if isinstance(data, bytes | bytearray) else data:
                stream.write(piece)
            # On the disk before the name is: else a power cut can leave the new name with nothing in it.
            stream.flush()
            keep(stream.fileno())
        if mode is not None:
            os.chmod(temporary, mode)
        yield temporary
    finally:
        # Also after an error: what is left would look like a file of a killed run.
        temporary.unlink(missing_ok=True)
        if held >= 0:
            os.close(held)


def _new_temporary(target: Path, mode: int) -> tuple[Path, int]:
    """A file of a name that nobody has, created for us alone and held by us, and its handle."""
    while True:
        # By chance, not by the process: two containers that share a folder have processes of one number.
        temporary = target.with_name(f"{_beginning(target.name)}{secrets.token_hex(4)}.part")
        try:
            handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), mode)
        except FileExistsError:
            continue
        # Another program may have taken it for a left one before it was held.
        if holds(handle) in (True, None) and os.path.exists(temporary):
            return temporary, handle
        os.close(handle)


def holds(handle: int) -> bool | None:
    """Whether a file is held by this handle from now on until it is closed; None where the system does not tell."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def keep(handle: int) -> None:
    """Have an open file on the disk when this returns; where a file system knows no such thing, nothing more can be done."""
    try:
        os.fsync(handle)
    except OSError as problem:
        if problem.errno not in (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS):
            raise


def _keep_names(folder: Path) -> None:
    """Have a folder's new names on the disk, which only POSIX lets a program ask for, and not every file system does."""
    if os.name != "posix":
        return
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def remove_unfinished(target: Path) -> None:
    """Remove the temporary files of this name that no running program holds."""
    beginning = _beginning(target.name)
    for path in target.parent.glob(f"{_literally(beginning)}*.part"):
        # earlier versions named them by their process
        if not re.fullmatch(r"[0-9a-f]{1,10}\.part", path.name.removeprefix(beginning)):
            continue
        with suppress(OSError):
            handle = os.open(path, os.O_WRONLY | getattr(os, "O_NOFOLLOW", 0))
            try:
                left = holds(handle)
                if left:
                    path.unlink(missing_ok=True)
            finally:
                os.close(handle)
            if left and _removed is not None:
                _removed(path)


def _beginning(name: str) -> str:
    """How the temporary names of a file begin."""
    return f".{os.fsdecode(os.fsencode(name)[:_LONGEST_NAME])}."


def _literally(text: str) -> str:
    """The text as a pattern of names that only it fits."""
    # Square brackets make the wild cards of a glob stand for themselves.
    return re.sub(r"([*?\[])", r"[\1]", text)
