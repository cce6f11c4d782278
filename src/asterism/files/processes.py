"""How other processes of this package begin: quickly, and without a share in what this one holds."""

from __future__ import annotations

import multiprocessing
import os
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

_NICE = 10
"""By how much a process gives way where the system has no lower class: beside one that wants all of a core it gets a tenth of it. Half of
it takes a quarter; at double (19 is the most) it hardly comes to an end on a busy machine."""


class FreeCores:
    """How many cores nobody used since `begin`, as the system counts (Linux); as many as there are where it does not say."""

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """Begin to count."""
        self._began, self._idle = time.monotonic(), _idle_seconds()

    @property
    def seconds(self) -> float:
        """s that were counted."""
        return time.monotonic() - self._began

    def count(self) -> float:
        """The mean number of cores that were free."""
        if self._idle is None or (now := _idle_seconds()) is None:
            return float(os.cpu_count() or 1)
        return (now - self._idle) / max(self.seconds, 1e-9)


def _idle_seconds() -> float | None:
    """s that all cores together have been idle; None where the system does not say."""
    with suppress(OSError, ValueError, IndexError, AttributeError):
        words = Path("/proc/stat").read_text(encoding="ascii").split(maxsplit=6)
        return (int(words[4]) + int(words[5])) / os.sysconf("SC_CLK_TCK")
    return None


def give_way() -> None:
    """Let every other process go first, at once: this one runs on cores that nobody else wants."""
    # A process that is only nice keeps its core for milliseconds when a frame comes that is to be labelled.
    with suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
        return
    with suppress(AttributeError, OSError):
        os.nice(_NICE)


def clean_context(*modules: str) -> Any:
    """The context of `multiprocessing` in which processes begin that share no locks, threads and pipes with this one.

    modules: what each of them needs, imported once by the server that they are forked from, where the system has one; the first caller of
    a process decides. A process then begins in hundredths of a second, not in one.
    """
    # A fork of this process would share locks that compiled kernels and threads hold, and pipes of others, which then never end.
    servers = "forkserver" in multiprocessing.get_all_start_methods()
    context: Any = multiprocessing.get_context("forkserver" if servers else "spawn")
    if servers:
        context.set_forkserver_preload(list(modules))
    return context
