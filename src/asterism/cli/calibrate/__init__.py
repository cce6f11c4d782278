"""`asterism calibrate`: the verbs that make and mend rigs, one file each."""

from __future__ import annotations

from collections.abc import Callable

VERBS: dict[Callable[..., None], str] = {}
"""Each verb with its example."""
