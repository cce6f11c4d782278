"""C3D files of all vendors: read, described and written with all that they hold."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from asterism.formats.c3d._describe import describe_c3d
from asterism.formats.c3d._reader import read_c3d

if TYPE_CHECKING:
    from asterism.formats.c3d._writer import write_c3d, write_c3d_points

__all__ = ["describe_c3d", "read_c3d", "write_c3d", "write_c3d_points"]


def __getattr__(name: str) -> Any:
    """Import what writes when it is first used: most commands only read."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from asterism.formats.c3d import _writer

    globals()[name] = value = getattr(_writer, name)
    return value
