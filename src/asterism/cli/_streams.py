"""Standard output and error as a process was given them; streams that can be written, or that say why not, out."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Any

from asterism.errors import AsterismError


class StandardOutputError(AsterismError):
    """Standard output that cannot be written: no file that is being worked on is to blame."""


class _Output(io.TextIOWrapper):
    """Standard output whose failures name it. A reader that has gone stays a `BrokenPipeError`."""

    def write(self, text: str) -> int:
        return int(self._guarded(super().write, text))

    def flush(self) -> None:
        self._guarded(super().flush)

    def _guarded(self, act: Any, *given: Any) -> Any:
        try:
            return act(*given)
        except BrokenPipeError:
            raise
        except OSError as problem:
            # Windows says so of a pipe whose reader has gone.
            if sys.platform == "win32" and problem.errno == errno.EINVAL:
                raise BrokenPipeError from problem
            raise StandardOutputError(
                f"standard output cannot be written ({problem.strerror}); make space, or lead it elsewhere."
            ) from problem


def guard_standard_streams() -> None:
    """Make streams that were closed lead nowhere, and the failures of standard output name it."""
    # A closed stream's number would go to the next file that is opened, and what a library prints into that file.
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w", encoding="utf-8"))  # noqa: SIM115
    if type(sys.stdout) is io.TextIOWrapper and sys.stdout.name != os.devnull:
        lines, errors, encoding = sys.stdout.line_buffering, sys.stdout.errors, sys.stdout.encoding
        sys.stdout = _Output(sys.stdout.detach(), encoding, errors, line_buffering=lines)
