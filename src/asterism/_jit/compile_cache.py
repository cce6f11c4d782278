"""The compile cache: files of compiled kernels that know the sources of all kernels that a kernel calls.

One file holds one kernel, compiled for one list of argument types on one kind of processor; its name is a hash of all that. A kernel has
up to two of them: what other kernels link (`.link`), and machine code that Python calls (`.run`).
"""

from __future__ import annotations

import atexit
import hashlib
import os
import pickle
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba

from asterism.progress import report_first_compile

Function = Callable[..., Any]

_UNUSED_SECONDS = 30 * 86400.0
"""A folder of compiled kernels from other sources is removed when it has not been used for this long (s)."""
_DIGEST = hashlib.sha256().digest_size
"""Bytes in front of a compiled kernel by which a damaged file is recognised."""
_IMPORT = re.compile(rb"^[ \t]*(?:from[ \t]+([.\w]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)|import[ \t]+([^\n]*))", re.MULTILINE)


@cache
def source_stamp(module: str) -> str | None:
    """Hash of the sources of a module and of all modules of its package that it imports, transitively; None where a source is missing.

    Only loaded modules count. Computed once per process and module.
    """
    digest = hashlib.sha256()
    reached, waiting = {module}, [module]
    while waiting:
        name = waiting.pop()
        source, imports = _source(name)
        if source is None:
            return None
        digest.update(name.encode() + b"\0" + source)
        for other in sorted(imports - reached):
            reached.add(other)
            waiting.append(other)
    return digest.hexdigest()


@cache
def _source(module: str) -> tuple[bytes | None, frozenset[str]]:
    """The hash of a loaded module's source, and the modules of the same package that it imports."""
    loaded = sys.modules.get(module)
    path = getattr(loaded, "__file__", None)
    if path is None or not path.endswith(".py"):
        return None, frozenset()
    try:
        loader: Any = getattr(loaded, "__loader__", None)
        text: bytes = loader.get_data(path) if hasattr(loader, "get_data") else Path(path).read_bytes()
    except OSError:
        return None, frozenset()
    package = getattr(loaded, "__package__", None) or ""
    return hashlib.sha256(text).digest(), frozenset(_imports(text, module, package))


def _imports(text: bytes, module: str, package: str) -> Iterator[str]:
    """Names of loaded modules of the same package that a source imports; text that only looks like an import does no harm."""
    top = module.partition(".")[0]
    for origin, names, plain in _IMPORT.findall(text):
        base = origin.decode()
        dots = len(base) - len(base.lstrip("."))
        if dots:
            base = ".".join([*package.split(".")[: len(package.split(".")) - dots + 1], *filter(None, [base.lstrip(".")])])
        words = re.findall(r"[\w.]+", (names or plain).decode(errors="replace"))
        for name in [base, *(f"{base}.{word}" for word in words)] if base else words:
            if name.partition(".")[0] == top and name != module and name in sys.modules:
                yield name


_ours: set[Path] = set()
"""Locks that this process holds."""


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """One process at a time, where the system locks files; a process that dies lets go."""
    try:
        import fcntl

        handle = os.open(path, os.O_CREAT | os.O_RDWR)
    except (ImportError, OSError):
        yield
        return
    try:
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        _ours.add(path)
        yield
    finally:
        _ours.discard(path)
        path.unlink(missing_ok=True)  # who waits for it finds what was compiled
        os.close(handle)


@contextmanager
def _alone(folder: Path | None, name: str) -> Iterator[None]:
    """Hold the lock of a kernel's file; nothing where no folder can be written, or this process holds it already."""
    lock = folder / f"{name}.lock" if folder is not None else None
    if lock is None or lock in _ours:
        yield
        return
    with _locked(lock):
        yield


class KernelFiles:
    """The files of one kernel."""

    def __init__(self, function: Function, flags: dict[str, Any]) -> None:
        self.module, self.name = function.__module__, re.sub(r"[^\w.]", "", function.__qualname__)
        code = function.__code__
        own, policy = source_stamp(self.module), source_stamp(__package__)
        # A function with a closure has values that no source tells.
        self.known = own is not None and policy is not None and function.__closure__ is None
        self.stamp = hashlib.sha256(f"{own} {policy}".encode()).hexdigest()[:16]
        self.what = (
            numba.__version__,
            sys.version,
            sorted(flags.items()),
            code.co_firstlineno,
            code.co_code.hex(),
        )

    @property
    def path(self) -> str:
        """The folder that is looked into first."""
        return str(_folders(self.module, self.stamp)[0])

    @contextmanager
    def turn(self, kind: str, sig: Any, codegen: Any) -> Iterator[None]:
        """Wait until no other process compiles the same, unless it is there already."""
        name = self._file_name(kind, sig, codegen)
        if not self.known or _kept_in(_folders(self.module, self.stamp), name) is not None:
            yield
            return
        report_first_compile(lambda: _is_kept(self.module, self.stamp))
        with _alone(_writable_folder(self.module, self.stamp), name):
            yield

    def read(self, kind: str, sig: Any, codegen: Any) -> Any:
        """What `write` kept; None where it is not there."""
        if self.known:
            compiled = _kept_in(_folders(self.module, self.stamp), self._file_name(kind, sig, codegen))
            if compiled is not None:
                return pickle.loads(compiled)
        report_first_compile(lambda: self.known and _is_kept(self.module, self.stamp))
        return None

    def write(self, kind: str, sig: Any, codegen: Any, compiled: Callable[[], bytes]) -> None:
        """Keep what was compiled for argument types `sig`."""
        folder = _writable_folder(self.module, self.stamp) if self.known else None
        if folder is None:
            return
        content = compiled()
        with suppress(OSError):  # the disk is full, or another process holds the file
            _replace(folder / self._file_name(kind, sig, codegen), hashlib.sha256(content).digest() + content)
            _remove_outdated(folder, f"{self.module.rpartition('.')[2]}.{self.name}-", self.stamp)

    def _file_name(self, kind: str, sig: Any, codegen: Any) -> str:
        config = numba.config
        key = (self.what, codegen.magic_tuple(), _described(sig), config.OPT, config.BOUNDSCHECK, config.LOOP_VECTORIZE)
        digest = hashlib.sha256(repr(key).encode()).hexdigest()[:20]
        return f"{self.module.rpartition('.')[2]}.{self.name}-{self.stamp}.{digest}.{kind}.nbc"


def _kept_in(folders: Iterable[Path], name: str) -> bytes | None:
    """A compiled kernel from the first folder that has it whole; None where none has."""
    for folder in folders:
        try:
            content = (folder / name).read_bytes()
        except OSError:
            continue
        if content[:_DIGEST] == hashlib.sha256(content[_DIGEST:]).digest():
            return content[_DIGEST:]
    return None


def _described(sig: Any) -> str:
    """Argument types as text; of named tuples also the names and the order of their fields, which their text leaves out."""
    parts, waiting = [repr(sig)], list(sig if isinstance(sig, tuple) else sig.args)
    while waiting:
        kind = waiting.pop()
        given = getattr(kind, "instance_class", None)
        if given is not None:
            parts.append(f"{given.__module__}.{given.__qualname__}{getattr(given, '_fields', ())}")
        waiting.extend(getattr(kind, "types", ()))
    return " ".join(parts)


def _folders(module: str, stamp: str) -> list[Path]:
    """Where compiled kernels of a module may be, best first: `NUMBA_CACHE_DIR`, beside the source, the user's cache, a temporary folder.

    Folders that several versions of the source may share carry the stamp of the sources in their name.
    """
    name = f"{module}-{stamp}"
    if numba.config.CACHE_DIR:
        folders = [Path(numba.config.CACHE_DIR) / name]
    else:
        folders = [Path(str(sys.modules[module].__file__)).parent / "__pycache__"]
        user = _user_folder()
        if user is not None:
            folders.append(user / name)
    if _temporary is not None:
        folders.append(Path(_temporary) / name)
    return folders


def _user_folder() -> Path | None:
    try:
        from numba.misc.appdirs import AppDirs

        return Path(AppDirs(appname="asterism", appauthor=False).user_cache_dir) / "kernels"
    except (ImportError, AttributeError, OSError):
        return None


_temporary: str | None = None


@cache
def _writable_folder(module: str, stamp: str) -> Path | None:
    """The first of `_folders` that can be written, a temporary one at last; None where not even that can be made."""
    global _temporary
    for folder in _folders(module, stamp):
        try:
            new = not folder.exists()
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError:
            continue
        if new:
            _remove_unused(folder, module)
        return folder
    try:
        _temporary = tempfile.mkdtemp(prefix="asterism-kernels-")
    except OSError:
        return None
    atexit.register(shutil.rmtree, _temporary, ignore_errors=True)
    folder = Path(_temporary) / f"{module}-{stamp}"
    folder.mkdir()
    return folder


def _is_kept(module: str, stamp: str) -> bool:
    """Whether what compiles now is there in the next run."""
    folder = _writable_folder(module, stamp)
    return folder is not None and (_temporary is None or Path(_temporary) not in folder.parents)


def _replace(path: Path, content: bytes) -> None:
    """Write a file so that another process sees the old one or the new one, and nothing between."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=path.name[:40], suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def _remove_outdated(folder: Path, prefix: str, stamp: str) -> None:
    """Remove compiled forms of a kernel that came from other sources, beside the source only."""
    if folder.name != "__pycache__":
        return
    for path in folder.glob(f"{prefix}*.nb[ci]"):
        if not path.name.startswith(f"{prefix}{stamp}."):
            path.unlink(missing_ok=True)


def _remove_unused(folder: Path, module: str) -> None:
    """Remove folders of the same module from other sources that have not been written for long."""
    for other in folder.parent.glob(f"{module}-{'[0-9a-f]' * 16}"):
        with suppress(OSError):
            if other != folder and time.time() - other.stat().st_mtime > _UNUSED_SECONDS:
                shutil.rmtree(other, ignore_errors=True)
