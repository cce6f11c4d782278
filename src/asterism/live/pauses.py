"""What Python itself holds frames up for, made short while they come."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_SWITCH = 5e-4
"""s after which a thread lets another one run. Frames are read in one thread and worked on in another, whose kernels give Python back and
wait for it some ten times a frame. Half of it switches for nothing; Python's own 5 ms hold a frame up by 15."""


@contextmanager
def short_pauses() -> Iterator[None]:
    """Let threads of this process switch soon, and its garbage collector look at no object from before: tens of milliseconds of a large
    program. Both are as before in the end."""
    before = sys.getswitchinterval()
    # Python lets go of all frozen objects or of none: who froze theirs keeps them so, and needs no more.
    freezes = not gc.get_freeze_count()
    sys.setswitchinterval(min(before, _SWITCH))
    if freezes:
        gc.freeze()
    try:
        yield
    finally:
        if freezes:
            gc.unfreeze()
        sys.setswitchinterval(before)
