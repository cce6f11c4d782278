"""The one kernel decorator: one policy of compiler flags, and a compile cache that knows the sources of all kernels that a kernel calls.

Policy of flags, the same for all kernels:

- `nogil`: kernels touch no Python object, so threads run them side by side.
- `error_model="numpy"`: a division by zero gives an infinity or NaN, as NumPy does, and NaN means missing. Kernels therefore test a divisor
  that can be zero. Numba's other model puts a branch that raises behind each division, which keeps loops from running in vector registers.
- no fast-math: the order of additions is the order of the source, and NaN and infinity keep their meaning. So a result does not depend on
  which kernel was inlined into which.
- `no_cfunc_wrapper`: nobody calls kernels from C; leaving the wrapper out saves a twentieth of the compiling.
- `inline=True` copies a kernel into each of its callers before these compile. It is for small kernels in the innermost loops, and for the
  steps of `label_clouds`, which have one caller each: copied into it, the whole compiles in three quarters of the time. Linking does not.

Everything that depends on private parts of Numba is in this file. Where a release of Numba has changed them, its own cache takes over.
"""

from __future__ import annotations

import atexit
import gc
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
from typing import Any, overload

import numba
from numba import njit

from asterism.progress import report_first_compile

Function = Callable[..., Any]

_FLAGS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_UNUSED_SECONDS = 30 * 86400.0
"""A folder of compiled kernels from other sources is removed when it has not been used for this long (s)."""
_DIGEST = hashlib.sha256().digest_size
"""Bytes in front of a compiled kernel by which a damaged file is recognised."""
_IMPORT = re.compile(rb"^[ \t]*(?:from[ \t]+([.\w]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)|import[ \t]+([^\n]*))", re.MULTILINE)


@overload
def kernel(function: Function, /) -> Function: ...


@overload
def kernel(*, inline: bool = False) -> Callable[[Function], Function]: ...


def kernel(function: Function | None = None, /, *, inline: bool = False) -> Any:
    """Compile a function with Numba when it is first called, by the policy of this file. Used bare, or as `@kernel(inline=True)`.

    With `NUMBA_DISABLE_JIT=1` the function stays plain Python.
    """

    def decorate(function: Function) -> Function:
        flags = _FLAGS | ({"inline": "always"} if inline else {})
        dispatcher: Any = njit(**flags)(function)
        if not numba.config.DISABLE_JIT:
            _ignore_literals(dispatcher)
            _keep_compiled(dispatcher, function, flags)
        return dispatcher

    return decorate if function is None else decorate(function)


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


def _ignore_literals(dispatcher: Any) -> None:
    """Let a kernel that is called with a constant compile for the constant's type. Numba compiles it for each constant anew."""
    resolve = getattr(dispatcher, "get_call_template", None)
    unliteral = getattr(numba.types, "unliteral", None)
    if resolve is None or unliteral is None:
        return

    def resolve_types(args: Any, kws: Any) -> Any:
        return resolve(tuple(map(unliteral, args)), {name: unliteral(kind) for name, kind in kws.items()})

    dispatcher.get_call_template = resolve_types


def _keep_compiled(dispatcher: Any, function: Function, flags: dict[str, Any]) -> None:
    """Give a dispatcher the cache of this file, or Numba's where that does not work with the Numba that is installed."""
    try:
        cache = dispatcher._cache = _cache_class()(function, flags)
        _compile_in_turn(dispatcher, cache)
        _compare_flags_quickly(dispatcher)
    except (ImportError, AttributeError, TypeError):
        try:
            dispatcher.enable_caching()
        except RuntimeError:  # no folder can be written
            return


def _compile_in_turn(dispatcher: Any, cache: Any) -> None:
    """Let a kernel compile without the collector of garbage, and wait where another process compiles the same one.

    A compile makes a million objects that live as long as it does. Looking through them again and again takes a sixth of its time.
    """
    from numba.core.compiler_lock import global_compiler_lock

    plain = dispatcher.compile

    def compile_in_turn(sig: Any) -> Any:
        if not isinstance(sig, tuple) or sig in dispatcher.overloads:
            return plain(sig)
        # Numba's lock comes first: a thread that has it may wait for a kernel, and never one that has a kernel for it.
        with global_compiler_lock, _collector_paused(), cache.turn(sig, dispatcher.targetctx):
            return plain(sig)

    dispatcher.compile = compile_in_turn


def _compare_flags_quickly(dispatcher: Any) -> None:
    """Numba looks up each call that it types by the compiler's flags, among others, and compares all fifty of them each time.

    They are the same object, or were set alike; only where neither holds does Numba's own comparison decide.
    """
    customize = dispatcher._compiler._customize_flags
    dispatcher._compiler._customize_flags = lambda flags: _flags_class()(customize(flags))


@cache
def _flags_class() -> type:
    from numba.core.compiler import Flags

    class KernelFlags(Flags):
        __slots__ = ()

        def __eq__(self, other: object) -> bool:
            alike = self is other or (type(other) is KernelFlags and self._values == other._values)
            return alike or bool(super().__eq__(other))

        def __hash__(self) -> int:
            return hash(KernelFlags)

    return KernelFlags


@contextmanager
def _collector_paused() -> Iterator[None]:
    """Collect no garbage."""
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


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


@cache
def _cache_class() -> type:
    """The cache as a subclass of Numba's, made when it is first needed.

    One file holds one kernel, compiled for one list of argument types on one kind of processor; its name is a hash of all that.
    """
    from numba.core.caching import _Cache
    from numba.core.compiler import CompileResult
    from numba.core.serialize import dumps

    class KernelCache(_Cache):
        def __init__(self, function: Function, flags: dict[str, Any]) -> None:
            self.module, self.name = function.__module__, re.sub(r"[^\w.]", "", function.__qualname__)
            code = function.__code__
            own, policy = source_stamp(self.module), source_stamp(__name__)
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
        def cache_path(self) -> str:
            return str(_folders(self.module, self.stamp)[0])

        @contextmanager
        def turn(self, sig: Any, target_context: Any) -> Iterator[None]:
            """Wait until no other process compiles the same, unless it is there already."""
            target_context.refresh()
            name = self._file_name(sig, target_context.codegen())
            if not self.known or _kept_in(_folders(self.module, self.stamp), name) is not None:
                yield
                return
            report_first_compile(lambda: _is_kept(self.module, self.stamp))
            with _alone(_writable_folder(self.module, self.stamp), name):
                yield

        def load_overload(self, sig: Any, target_context: Any) -> Any:
            target_context.refresh()
            if self.known:
                compiled = _kept_in(_folders(self.module, self.stamp), self._file_name(sig, target_context.codegen()))
                if compiled is not None:
                    return CompileResult._rebuild(target_context, *pickle.loads(compiled))
            report_first_compile(lambda: self.known and _is_kept(self.module, self.stamp))
            return None

        def save_overload(self, sig: Any, data: Any) -> None:
            # What depends on values outside the source cannot be told apart by it.
            if not self.known or any(not lifted.can_cache for lifted in data.lifted) or data.library.has_dynamic_globals:
                return
            folder = _writable_folder(self.module, self.stamp)
            if folder is None:
                return
            compiled = dumps(data._reduce())
            with suppress(OSError):  # the disk is full, or another process holds the file
                _replace(folder / self._file_name(sig, data.codegen), hashlib.sha256(compiled).digest() + compiled)
                _remove_outdated(folder, f"{self.module.rpartition('.')[2]}.{self.name}-", self.stamp)

        def _file_name(self, sig: Any, codegen: Any) -> str:
            config = numba.config
            key = (self.what, codegen.magic_tuple(), _described(sig), config.OPT, config.BOUNDSCHECK, config.LOOP_VECTORIZE)
            digest = hashlib.sha256(repr(key).encode()).hexdigest()[:20]
            return f"{self.module.rpartition('.')[2]}.{self.name}-{self.stamp}.{digest}.nbc"

        def enable(self) -> None: ...

        def disable(self) -> None: ...

        def flush(self) -> None: ...

    return KernelCache


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
