"""How long work reports what it is doing: one callback type for all rooms, which know no terminal; and the notice of a first compile."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["Progress", "on_first_compile", "report_first_compile"]

Progress = Callable[[float, str], None]
"""Called with the fraction done (0 to 1) and what is being done."""

_first_compile: Callable[[bool], None] | None = None


def on_first_compile(callback: Callable[[bool], None] | None) -> None:
    """Call `callback(kept)` once, before the first kernel of this process compiles that the compile cache does not have.

    `kept` is False where no folder for the cache can be written, so that every run compiles again. None removes the callback.
    """
    global _first_compile
    _first_compile = callback


def report_first_compile(kept: Callable[[], bool]) -> None:
    """Call the callback of `on_first_compile` where there is one, and remove it; `kept` is asked only then."""
    global _first_compile
    callback, _first_compile = _first_compile, None
    if callback is not None:
        callback(kept())
