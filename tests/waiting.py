"""Waiting for what comes over a network or from a thread: until it is there, with a limit that no busy machine reaches."""

from __future__ import annotations

import time
from collections.abc import Callable

from asterism.live import LiveFrame, LiveSource

LONG = 180.0
"""s after which a test gives up, on a machine as busy as it may be: a process that compiles kernels first took more than 60 s."""


def until(condition: Callable[[], object]) -> None:
    """Wait until something is so."""
    limit = time.monotonic() + LONG
    while not condition():
        assert time.monotonic() < limit, "waited in vain"
        time.sleep(0.005)


def taken(source: LiveSource, count: int) -> list[LiveFrame]:
    """The next frames of a source."""
    came, limit = list[LiveFrame](), time.monotonic() + LONG
    while len(came) < count:
        assert time.monotonic() < limit, f"{len(came)} of {count} frames came"
        frame = source.read(0.1)
        came += [] if frame is None else [frame]
    return came
