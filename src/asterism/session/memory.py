"""The sizes of recordings in; how many processes the memory of this machine holds at once, out."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

BASE = 0.4e9
"""Bytes of a process with compiled kernels and a model: 0.27 GB with fifteen markers, 0.4 with sixty."""
TIMES = 25.0
"""Bytes for each byte of the recording that is worked on: 20 were measured with 15 markers, to label it and to analyse it. At half, two
long recordings at once may end a process, which costs another try; at double, half as many processes work on long ones."""
HELD = 12.0
"""Bytes for each byte of all recordings of a person, whose analyses stay until their page is written: 7 to 10 were measured."""
KEPT = 0.8
"""Share of the free memory that is given away: what else runs needs some, and the estimate is one."""


def free_memory() -> float | None:
    """Bytes that processes can still have on this machine, or in this container; None where the system does not tell."""
    found = list[float]()
    with suppress(OSError, AttributeError, ValueError):
        match = re.search(r"MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text(encoding="ascii"))
        if match:
            found.append(1024.0 * int(match[1]))
    # a container, or a job of a cluster, may have less than its machine
    with suppress(OSError, ValueError):
        group = Path("/sys/fs/cgroup")
        used = int((group / "memory.current").read_text(encoding="ascii"))
        found.append(float(int((group / "memory.max").read_text(encoding="ascii")) - used))
    if not found:
        with suppress(OSError, ValueError, AttributeError):
            found.append(float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_AVPHYS_PAGES")))
    return min(found, default=None)


def need_of(sizes: Sequence[int]) -> float:
    """Bytes that a process needs for a person with recordings of so many bytes."""
    return BASE + TIMES * max(sizes, default=0) + HELD * sum(sizes)


def that_fit(workers: int, need: float, free: float | None) -> int:
    """How many of some processes fit into the free memory, where each may need so many bytes; at least one."""
    return workers if free is None else max(1, min(workers, int(KEPT * free // need)))
