"""Bytes of a message in; what they say as JSON, read by orjson where it is installed, else by the standard library."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

_quick_loads: Callable[[bytes], Any] | None
try:
    import orjson

    _quick_loads = orjson.loads
except ImportError:
    _quick_loads = None


def json_of(data: bytes) -> Any:
    """What JSON in UTF-8 says, as `json.loads` reads it. Raises ValueError or RecursionError.

    orjson takes a seventh of the time. What it refuses is read again, since the standard library takes more: NaN, infinities, numbers
    beyond floats, and halves of surrogate pairs. One difference stays: whole numbers of 65 bits and more may be floats.
    """
    if _quick_loads is not None:
        try:
            return _quick_loads(data)
        except ValueError:
            pass
    return json.loads(data.decode("utf-8"))
