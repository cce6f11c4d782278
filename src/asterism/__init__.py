"""Asterism: which point of an optical motion-capture cloud is which marker, in every frame, with a calibrated confidence.

The names below are the front door; every room has more (`asterism.labelling`, `asterism.simulation`, `asterism.report`, ...).
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

from asterism.errors import AsterismError
from asterism.recording import NULL, Clouds, Event, Labelling, MarkerSet, Recording

if TYPE_CHECKING:
    from asterism.formats import read, write
    from asterism.labelling import SolverEnsemble

try:
    __version__ = version("asterism")
except PackageNotFoundError:  # run from a source tree that is not installed
    __version__ = "0+unknown"

__all__ = [
    "NULL",
    "AsterismError",
    "Clouds",
    "Event",
    "Labelling",
    "MarkerSet",
    "Recording",
    "SolverEnsemble",
    "__version__",
    "read",
    "write",
]

_ROOM_OF = {"read": "asterism.formats", "write": "asterism.formats", "SolverEnsemble": "asterism.labelling"}


def __getattr__(name: str) -> Any:
    """Rooms that take a moment to import (Numba) come in when they are first used."""
    if name in _ROOM_OF:
        return getattr(import_module(_ROOM_OF[name]), name)
    raise AttributeError(f"module 'asterism' has no attribute {name!r}")
