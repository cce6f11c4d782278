"""The library of the Lab Streaming Layer, loaded so that it tells what is wrong and nothing else."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from asterism.live.packages import packages_for

_FILES = ("lsl_api.cfg", "~/lsl_api/lsl_api.cfg", "/etc/lsl_api/lsl_api.cfg")
"""Where the library looks for its settings, in this order; before them where the variable LSLAPICFG says."""
_QUIET = "\n[log]\nlevel = -1\n"
"""Warnings and errors. By itself it tells each network interface and each port as well, on standard error."""


def lsl_library() -> Any:
    """`pylsl`. Raises AsterismError where it is missing. Its settings are those of the person's own file; what that logs is not changed."""
    with packages_for("lsl://"):
        import pylsl
    _set_up()
    return pylsl


@lru_cache
def _set_up() -> None:
    """Give the library its settings, which it reads once."""
    import pylsl

    # Libraries before 1.17 take settings from a file alone.
    with suppress(AttributeError, NotImplementedError, RuntimeError):
        pylsl.set_config_content(lsl_settings())


def lsl_settings() -> str:
    """The settings of the file that the library would read, with no more log than warnings where that says nothing of it."""
    for name in (os.environ.get("LSLAPICFG"), *_FILES):
        with suppress(OSError, UnicodeDecodeError, RuntimeError):
            own = Path(name or "").expanduser().read_text(encoding="utf-8-sig") if name else None
            if own is not None:
                return own if re.search(r"^\s*\[log\]", own, re.MULTILINE) else own + _QUIET
    return _QUIET
