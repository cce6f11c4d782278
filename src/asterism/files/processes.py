"""How other processes of this package begin: quickly, and without a share in what this one holds."""

from __future__ import annotations

import multiprocessing
from typing import Any


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
