"""What the command line does in a run whose kernels no earlier run has compiled: it says so, and compiles in a second process, too."""

from __future__ import annotations

import atexit
import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from asterism.cli import _console
from asterism.progress import on_first_compile

if TYPE_CHECKING:
    import subprocess

_SECONDS = 50
"""Processor time that the kernels of one command take to compile, at most (s, cores of 2024): of `label` 34 to 37 s were measured, of
`train` 42 s. On two idle cores it is over sooner, beside other work later."""
_AHEAD = {"demo": ["tracking", "whole"], "label": ["whole"], "evaluate": ["tracking", "whole"], "warm-up": ["whole"]}
"""Steps of `labelling.compile_ahead` that each command reaches after it has compiled others itself."""


def prepare(words: Sequence[str]) -> None:
    """Be ready for the first kernel that compiles in the run of a command line."""
    on_first_compile(lambda kept: _first_compile(words[0] if words else "", kept))


def _first_compile(command: str, kept: bool) -> None:
    # said each time, as it costs each time
    if not kept:
        _console.notice(
            f"Compiling numerical kernels (up to {_SECONDS} s of processor time). No folder for compiled kernels can be written, so every"
            " run compiles them again; name a writable one in NUMBA_CACHE_DIR.",
        )
        return
    _console.notice(
        f"Compiling the numerical kernels of this command; this happens once (up to {_SECONDS} s of processor time).", in_progress_line=True
    )
    # on one core, a second process would only take turns with the first
    if command in _AHEAD and (os.cpu_count() or 1) > 1 and sys.executable:
        _compile_ahead(_AHEAD[command])


def _compile_ahead(steps: Sequence[str]) -> None:
    """Start the second process. It only fills the compile cache: where it fails, or the run ends before it, nothing is lost.

    `-P` keeps modules of the user's folder from being imported in place of ours.
    """
    import subprocess

    try:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "asterism.labelling.compile_ahead", *steps],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    except OSError:
        return
    atexit.register(_stop, process)


def _stop(process: subprocess.Popen[bytes]) -> None:
    # what it compiles would be used by nobody
    if process.poll() is None:
        process.terminate()
    process.wait()
