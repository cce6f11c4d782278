"""Asterism: which point of an optical motion-capture cloud is which marker, in every frame, with a calibrated confidence.

The names below are the front door; every room has more (`asterism.labelling`, `asterism.simulation`, `asterism.report`, ...)
and is imported when it is first named: after `import asterism`, `asterism.labelling.audit(...)` works as it stands.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.formats import read, write
    from asterism.labelling import MarkerModel
    from asterism.recording import NULL, Clouds, Event, Labelling, MarkerSet, Recording

    __version__: str

__all__ = [
    "NULL",
    "AsterismError",
    "Clouds",
    "Event",
    "Labelling",
    "MarkerModel",
    "MarkerSet",
    "Recording",
    "__version__",
    "read",
    "write",
]

_ROOMS = (
    "calibration",
    "cameras",
    "detection",
    "errors",
    "findings",
    "formats",
    "garment",
    "geometry",
    "labelling",
    "motion",
    "reconstruction",
    "recording",
    "report",
    "session",
    "simulation",
    "synchronization",
    "tracking",
)
_ROOM_OF = {
    "read": "formats",
    "write": "formats",
    "MarkerModel": "labelling",
    **dict.fromkeys(("NULL", "Clouds", "Event", "Labelling", "MarkerSet", "Recording"), "recording"),
}


def __getattr__(name: str) -> Any:
    """Import a name, or a room, when it is first used, so that commands which need no NumPy or Numba start at once."""
    if name in _ROOM_OF:
        value = getattr(import_module(f"asterism.{_ROOM_OF[name]}"), name)
    elif name in _ROOMS:
        return import_module(f"asterism.{name}")
    elif name == "SolverEnsemble":
        return _earlier_name()
    elif name == "__version__":
        value = _version()
    else:
        raise AttributeError(f"module 'asterism' has no attribute {name!r}")
    globals()[name] = value
    return value


def _earlier_name() -> Any:
    """`MarkerModel`, under its name before 0.2."""
    import warnings

    from asterism.labelling import MarkerModel

    warnings.warn("SolverEnsemble is now called MarkerModel.", DeprecationWarning, stacklevel=3)
    return MarkerModel


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_ROOMS})


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("asterism")
    except PackageNotFoundError:  # run from a source tree that is not installed
        return "0+unknown"
