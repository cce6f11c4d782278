"""Bytes of a message in; what they say as JSON, read by orjson where it is installed, else by the standard library."""

from __future__ import annotations

import json
from typing import Any

try:
    import orjson
except ImportError:
    orjson = None


def json_of(data: bytes) -> Any:
    """What JSON in UTF-8 says, as `json.loads` reads it. Raises ValueError or RecursionError.

    orjson takes a seventh of the time. What it refuses is read again, since the standard library takes more: NaN, infinities, numbers
    beyond floats, and halves of surrogate pairs. One difference stays: whole numbers of 65 bits and more may be floats.
    """
    if orjson is not None:
        try:
            return orjson.loads(data)
        except ValueError:
            pass
    return json.loads(data.decode("utf-8"))
