"""How long work reports its progress: one callback type for all rooms, which know no terminal."""

from collections.abc import Callable

__all__ = ["Progress"]

Progress = Callable[[float, str], None]
"""Called with the fraction done (0 to 1) and what is being done."""
