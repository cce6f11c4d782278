"""An address that fsspec knows in, such as s3://bucket/people; its files on this disk, and files of this disk there, each whole, out."""

from __future__ import annotations

import re
import secrets
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import url2pathname

from asterism.errors import AsterismError
from asterism.files.atomic import write_atomically
from asterism.files.stalls import unless_stalled

_PIECE = 1 << 20
_WHOLE = {"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "oci", "oss", "tos", "hf"}
"""Stores in which an object is not there before its last byte is: nothing needs another name meanwhile."""


def is_address(text: str) -> bool:
    """Whether a text is no path of this machine: s3://bucket/people, zip://people::/data/all.zip."""
    return not text.startswith(("file://", "local://")) and re.search(r"^[a-z][a-z0-9+.-]+://|::", text) is not None


def local_path(text: str) -> Path:
    """The path that a text names, which is no `is_address`; file:///data is /data."""
    return Path(url2pathname(urlsplit(text).path)) if text.startswith(("file://", "local://")) else Path(text)


@dataclass(frozen=True)
class RemoteFolder:
    """A folder at an address. Places are paths below it, with slashes. Its methods raise AsterismError where the address fails.

    A file is written whole or not at all: in stores of objects by the store, elsewhere under another name that is then moved. A file
    system that can do neither, such as an archive, is refused by `check`.
    """

    address: str

    def files(self) -> list[str]:
        """The places of all files below the folder, in order; none where there is no folder."""
        system, root = _opened(self.address)

        def find(came: Callable[[int], object]) -> list[str]:
            system.invalidate_cache()
            return [str(path) for path in system.find(root)]

        prefix = f"{root.rstrip('/')}/" if root else ""
        return sorted(path.removeprefix(prefix) for path in self._guarded("", "listed", find) if path.startswith(prefix))

    def exists(self, place: str) -> bool:
        """Whether there is a file."""
        system, root = _opened(self.address)

        def ask(came: Callable[[int], object]) -> bool:
            system.invalidate_cache()
            return bool(system.isfile(f"{root}/{place}"))

        return self._guarded(place, "looked for", ask)

    def fetch(self, place: str, target: Path) -> bool:
        """Copy a file to a path of this disk, whose folder is made; False where there is none."""
        system, root = _opened(self.address)

        def read(came: Callable[[int], object]) -> bool:
            system.invalidate_cache()
            try:
                file = system.open(f"{root}/{place}", "rb")
            except (FileNotFoundError, IsADirectoryError, KeyError):
                return False
            with file:
                target.parent.mkdir(parents=True, exist_ok=True)
                write_atomically(target, _pieces(file, came))
            return True

        return bool(self._guarded(place, "read", read))

    def store(self, source: Path, place: str) -> None:
        """Copy a file of this disk to a place, whole or not at all; what is there is replaced."""
        system, root = _opened(self.address)
        target = f"{root}/{place}"

        def write(came: Callable[[int], object]) -> None:
            folder = target.rpartition("/")[0]
            system.makedirs(folder, exist_ok=True)
            if _protocols(system) & _WHOLE:
                _copy(source, system, target, came)
                return
            unfinished = f"{folder}/.{target.rpartition('/')[2]}.{secrets.token_hex(4)}.part"
            try:
                _copy(source, system, unfinished, came)
                _move(system, unfinished, target)
            except BaseException:
                if system.exists(unfinished):
                    system.rm_file(unfinished)
                raise

        self._guarded(place, "written", write)

    def remove(self, place: str) -> None:
        """Remove a file; nothing where there is none."""
        system, root = _opened(self.address)

        def remove(came: Callable[[int], object]) -> None:
            if system.exists(f"{root}/{place}"):
                system.rm_file(f"{root}/{place}")

        self._guarded(place, "removed", remove)

    def modified(self, place: str) -> datetime | None:
        """When a file was written, by the clock of its disk; None where the file system does not tell."""
        system, root = _opened(self.address)

        def ask(came: Callable[[int], object]) -> datetime | None:
            try:
                system.invalidate_cache()
                found = system.modified(f"{root}/{place}")
            except (NotImplementedError, KeyError):
                return None
            return found if isinstance(found, datetime) else None

        return self._guarded(place, "looked at", ask)

    def check(self, scratch: Path) -> None:
        """Raise AsterismError where nothing can be written to the folder: a small file is, and is removed again."""
        trial = scratch / "trial"
        trial.write_bytes(b"asterism\n")
        name = f".asterism-{secrets.token_hex(4)}"
        self.store(trial, name)
        self.remove(name)

    def _guarded(self, place: str, what: str, work: Callable[[Callable[[int], object]], Any]) -> Any:
        name = f"{self.address}/{place}" if place else self.address
        try:
            return unless_stalled(name, work)
        except AsterismError:
            raise
        # each file system has errors of its own
        except Exception as problem:
            said = problem.strerror if isinstance(problem, OSError) and problem.strerror else " ".join(str(problem).split())
            raise AsterismError(
                f"{name} cannot be {what} ({said or type(problem).__name__}); check the address and its rights."
            ) from problem


def _pieces(file: Any, came: Callable[[int], object]) -> Iterator[bytes]:
    count = 0
    while piece := file.read(_PIECE):
        yield piece
        count += len(piece)
        came(count)


def _copy(source: Path, system: Any, target: str, came: Callable[[int], object]) -> None:
    with source.open("rb") as file, system.open(target, "wb") as there:
        for piece in _pieces(file, came):
            there.write(piece)


def _move(system: Any, source: str, target: str) -> None:
    try:
        system.mv(source, target)
    except FileExistsError:
        # some servers replace no file by moving another one: for a moment there is none
        system.rm_file(target)
        system.mv(source, target)


def _protocols(system: Any) -> set[str]:
    return {system.protocol} if isinstance(system.protocol, str) else set(system.protocol)


@lru_cache(maxsize=32)
def _opened(address: str) -> tuple[Any, str]:
    """The file system of an address, and the folder in it. Raises AsterismError where what knows it is not installed."""
    try:
        from fsspec.core import url_to_fs  # type: ignore[import-untyped, unused-ignore]
    except ImportError:
        raise AsterismError(f"{address} is read by fsspec; install it with `pip install 'asterism[cluster]'`.") from None
    try:
        system, root = url_to_fs(address, use_listings_cache=False)
    except ImportError as problem:
        raise AsterismError(f"{address} needs another package ({problem}); install it on all machines that work on it.") from problem
    except ValueError as problem:
        raise AsterismError(f"{address} is no address that fsspec knows ({problem}); correct it.") from problem
    except OSError as problem:
        raise AsterismError(f"{address} cannot be opened ({problem.strerror or problem}); check the address.") from problem
    return system, root.rstrip("/")


def below(folder: Path, address: str) -> Path:
    """Where files of an address go below a folder of this disk: one path for each, whose last part is the file's name."""
    parts = [re.sub(r'[:*?"<>|\\]+|^\.\.?$', "-", part) for part in address.split("/")]
    return folder.joinpath(*filter(None, parts))
