"""Nothing in; the folder in which Asterism keeps what it can make again, out."""

from __future__ import annotations

import os
import sys
from pathlib import Path

VARIABLE = "ASTERISM_CACHE"
"""The environment variable that names the folder, instead of the system's usual place."""


def cache_folder() -> Path:
    """The user's folder for what can be made again at any time; it need not exist, or be writable.

    `ASTERISM_CACHE` where it is set; else asterism/ in `LOCALAPPDATA` (Windows), in ~/Library/Caches (macOS), or in `XDG_CACHE_HOME` or
    ~/.cache (any other system).
    """
    chosen = os.environ.get(VARIABLE)
    if chosen:
        return Path(chosen)
    if sys.platform == "win32":
        return _given("LOCALAPPDATA", "AppData", "Local") / "asterism" / "Cache"
    if sys.platform == "darwin":
        return _home() / "Library" / "Caches" / "asterism"
    return _given("XDG_CACHE_HOME", ".cache") / "asterism"


def _given(variable: str, *usual: str) -> Path:
    """The folder that a variable names, where that is absolute, as the XDG specification asks; else a folder in the home."""
    named = Path(os.environ.get(variable, ""))
    return named if named.is_absolute() else _home().joinpath(*usual)


def _home() -> Path:
    """The home; where there is none (a container without users), a folder that cannot be made."""
    try:
        return Path.home()
    except RuntimeError:
        return Path(os.devnull)
