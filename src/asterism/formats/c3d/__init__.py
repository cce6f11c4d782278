"""C3D files of all vendors: read, described and written with all that they hold; those too long for the memory by ranges of frames."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from asterism.formats.c3d._describe import describe_c3d
from asterism.formats.c3d._reader import read_c3d

if TYPE_CHECKING:
    from asterism.formats.c3d._confidence import LabelSummary
    from asterism.formats.c3d._file import ranges
    from asterism.formats.c3d._long import LabelledRanges, LongRecording, read_long, write_long
    from asterism.formats.c3d._writer import write_c3d, write_c3d_points

__all__ = [
    "LabelSummary",
    "LabelledRanges",
    "LongRecording",
    "describe_c3d",
    "ranges",
    "read_c3d",
    "read_long",
    "write_c3d",
    "write_c3d_points",
    "write_long",
]

_MODULE_OF = {
    "LabelSummary": "_confidence",
    "ranges": "_file",
    **dict.fromkeys(("LabelledRanges", "LongRecording", "read_long", "write_long"), "_long"),
    **dict.fromkeys(("write_c3d", "write_c3d_points"), "_writer"),
}


def __getattr__(name: str) -> Any:
    """Import what writes, or reads by ranges, when it is first used: most commands only read whole files."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    return value
