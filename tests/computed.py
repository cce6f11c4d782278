"""What dear functions give for fixed arguments: worked out once, and kept on disk for other tests, other workers and the next run.

A value is kept under a hash of all that it depends on: the arguments, the sources that the function's module imports, directly or not,
the package's tables, and the versions of the libraries. Where one of these changes, it is worked out anew, so that a test of a kept value
fails in the same run in which it would fail without. What a test patches is one of its arguments: `computed(..., beside=...)`.
"""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import os
import pickle
import re
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

import models
import numpy as np

import asterism

R = TypeVar("R")

_HOW = ("NUMBA_BOUNDSCHECK", "NUMBA_DISABLE_JIT", "MUTANT_UNDER_TEST")
"""Variables by which the same sources run otherwise: with each access to an array checked, without compiling, with a deliberate fault."""
_UNUSED = 30 * 86_400.0
"""Seconds after which a value that nobody took is removed, as models are."""


def computed(function: Callable[..., R], *given: Any, beside: object = None, **settings: Any) -> R:
    """What `function(*given, **settings)` gives. It must depend on its arguments, its sources and on `beside` alone.

    beside   what it depends on beside its arguments, such as rules that the test has patched
    Raises TypeError for an argument whose value cannot be told from another one: see `digest`.
    """
    source = Path(inspect.getsourcefile(function) or "")
    how = {name: os.environ[name] for name in _HOW if name in os.environ}
    name = digest((sources(source), function.__qualname__, given, settings, beside, how)).hex()[:32]
    path = _folder() / f"{name}.computed"
    with suppress(FileNotFoundError):
        value: R = pickle.loads(path.read_bytes())
        os.utime(path)
        return value
    value = function(*given, **settings)
    # Written under another name and renamed, so that no other worker reads half of it.
    part = path.with_suffix(f".{os.getpid()}-{threading.get_ident()}")
    part.write_bytes(pickle.dumps(value, protocol=5))
    part.replace(path)
    return value


def digest(value: object) -> bytes:
    """A hash that two values share only if they are equal: of plain values, arrays, and records and collections of these.

    Of a record the fields count, and not what it has worked out from them and remembers.
    """
    made = hashlib.sha256()
    _add(value, made.update)
    return made.digest()


def _add(value: object, put: Callable[[bytes], None]) -> None:
    put(type(value).__qualname__.encode() + b"(")
    if value is None or isinstance(value, bool | int | float | complex | str | bytes | np.generic):
        put(repr(value).encode())
    elif isinstance(value, np.ndarray) and not value.dtype.hasobject:
        put(f"{value.dtype} {value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            put(field.name.encode())
            _add(getattr(value, field.name), put)
    elif isinstance(value, Mapping):
        for key, item in value.items():
            _add(key, put)
            _add(item, put)
    elif isinstance(value, tuple | list):
        for item in value:
            _add(item, put)
    else:
        raise TypeError(f"{type(value)}: give arrays, numbers, strings, records or collections of these")
    put(b")")


@cache
def sources(start: Path) -> bytes:
    """The digest of a source, of those of the package that it imports, and of all tables of the package."""
    package = Path(asterism.__file__).parent
    made = hashlib.sha256(models.sources(start) + repr(sorted(_versions().items())).encode())
    for path in sorted(package.rglob("*")):
        if path.is_file() and path.suffix not in (".py", ".pyc", ".nbi", ".nbc"):
            made.update(path.relative_to(package).as_posix().encode() + path.read_bytes())
    return made.digest()


def _versions() -> dict[str, str]:
    """Of the libraries that the package needs, where it is installed."""
    with suppress(metadata.PackageNotFoundError):
        needed = [re.match(r"[\w.-]+", one)[0] for one in metadata.requires("asterism") or () if "extra ==" not in one]
        return {name: metadata.version(name) for name in needed}
    return {}


@cache
def _folder() -> Path:
    place = models.folder() / "computed"
    place.mkdir(exist_ok=True)
    for path in place.iterdir():
        with suppress(FileNotFoundError):  # another worker was faster
            if time.time() - path.stat().st_mtime > _UNUSED:
                path.unlink()
    return place
