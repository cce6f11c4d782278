"""The folders of a session and of its results, at paths or at addresses, in; paths of this disk to work with, and back, out.

What is at an address is known by paths in a folder of temporary files: the command sees empty files there, for the names tell who is in a
session, and a task brings what it reads and takes what it wrote.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, field
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any

from asterism.cli import _printable
from asterism.errors import AsterismError
from asterism.files.addresses import RemoteFolder, below, is_address, local_path
from asterism.files.atomic import write_atomically

Reference = tuple[str | None, str]
"""A file as a message names it: a path alone, or an address of a folder and a place below it."""


@dataclass
class SessionPlaces:
    """Where files are: paths of this disk, and the addresses of those that are elsewhere."""

    folders: dict[Path, RemoteFolder] = field(default_factory=dict)
    _scratch: Path | None = None
    _brought: set[Path] = field(default_factory=set)

    @property
    def scratch(self) -> Path:
        """A folder of temporary files, which goes with this object."""
        if self._scratch is None:
            self._scratch = Path(tempfile.mkdtemp(prefix="asterism-"))
            # processes of a pool end without what others do at their end
            Finalize(self, shutil.rmtree, (self._scratch, True), exitpriority=1)
        return self._scratch

    def path(self, text: str) -> Path:
        """The path for a folder that is named on the command line; of an address, one in the folder of temporary files."""
        return self._folder(text) if is_address(text) else local_path(text)

    def _folder(self, address: str) -> Path:
        path = below(self.scratch, address)
        if path not in self.folders:
            self.folders[path] = RemoteFolder(address.rstrip("/"))
            _printable.show_as(str(path), address.rstrip("/"))
        return path

    def file(self, text: str | None) -> Path | None:
        """The path of a file that is named on the command line, which is brought where it is at an address."""
        if text is None or not is_address(text):
            return None if text is None else local_path(text)
        # of zip://folder/file::archive, the first part names the file; simplecache::s3://bucket/file has none there
        head, middle, rest = text.partition("::")
        inside, outside = (head, middle + rest) if "://" in head else ("", "")
        before, _, name = (inside or text).rpartition("/")
        return self.local((before + outside, name))

    def remote(self, path: Path) -> tuple[RemoteFolder, str] | None:
        """The address of the folder that holds a path, and the place below it; None for a path of this disk."""
        for folder in (path, *path.parents):
            if folder in self.folders:
                return self.folders[folder], path.relative_to(folder).as_posix()
        return None

    def reference(self, path: Path | None) -> Reference | None:
        """A file as a message names it."""
        if path is None:
            return None
        found = self.remote(path)
        return (None, str(path)) if found is None else (found[0].address, found[1])

    def local(self, reference: Reference | None, *, bring: bool = True) -> Path | None:
        """The path of a file that a message names; bring: its bytes, too, where it is at an address."""
        if reference is None or reference[0] is None:
            return None if reference is None else Path(reference[1])
        path = self._folder(reference[0]) / reference[1]
        if bring:
            self.bring(path)
        return path

    def bring(self, path: Path, *, again: bool = False) -> bool:
        """Have the bytes of a file on this disk, once; again: also where they were brought. Whether there is such a file."""
        found = self.remote(path)
        if found is None:
            return path.exists()
        if again or path not in self._brought:
            path.unlink(missing_ok=True)
            if not found[0].fetch(found[1], path):
                return False
            self._brought.add(path)
        return True

    def exists(self, path: Path) -> bool:
        """Whether there is a file, here or at its address."""
        found = self.remote(path)
        return path.exists() if found is None else found[0].exists(found[1])

    def take(self, path: Path) -> None:
        """Write a file of this disk to its address; a table or page names files by their addresses from now on."""
        found = self.remote(path)
        if found is None:
            return
        if path.suffix in (".csv", ".html"):
            text = path.read_bytes()
            for folder, remote in self._longest_first():
                text = text.replace(os.fsencode(folder), remote.address.encode())
            write_atomically(path, text)
        found[0].store(path, found[1])

    def show(self, folder: Path) -> None:
        """Have a file for each file below a folder at an address: those of settings and marker sets whole, the others empty."""
        remote = self.folders.get(folder)
        if remote is None:
            return
        inner = [f"{other.address}/" for other in self.folders.values() if other.address.startswith(f"{remote.address}/")]
        found = remote.files()
        if not found:
            raise AsterismError(f"{remote.address} holds no file; correct the address.")
        for place in found:
            path = folder / place
            # results that lie in the session are no recordings
            if not path.resolve().is_relative_to(folder.resolve()) or f"{remote.address}/{place}".startswith(tuple(inner)):
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.suffix.lower() in (".toml", ".json"):
                self.bring(path)
            else:
                path.touch()

    def told(self, value: Any) -> Any:
        """Plain values with addresses in place of the paths of temporary files."""
        if not self.folders or value is None:
            return value
        text = json.dumps(value)
        for path, folder in self._longest_first():
            text = text.replace(json.dumps(str(path))[1:-1], json.dumps(folder.address)[1:-1])
        return json.loads(text)

    def name(self, path: Path) -> str:
        """A path as results call it: of a temporary file, its address."""
        return str(self.told(str(path)))

    def _longest_first(self) -> list[tuple[Path, RemoteFolder]]:
        return sorted(self.folders.items(), key=lambda pair: -len(str(pair[0])))

    def forget(self, paths: Iterable[Path]) -> None:
        """Remove files of temporary files that are not needed again."""
        for path in paths:
            if self.remote(path) is not None:
                path.unlink(missing_ok=True)
                self._brought.discard(path)
