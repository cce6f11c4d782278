"""Stands for the processes that read damaged files: one that hangs and crashes where it is told to."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

HANGS, CRASHES = 3, 5


def read_all(folder: Path, numbers: range, model: bool, told: Any) -> None:
    """Hang at one number and crash at another."""
    told.send(None)
    for number in numbers:
        if number == HANGS:
            time.sleep(60)
        if number == CRASHES:
            os._exit(11)
        told.send([])
