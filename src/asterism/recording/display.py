"""How the nouns show themselves: a few lines of text in a console, a small table in a notebook."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from html import escape
from pathlib import Path

Rows = Sequence[tuple[str, str]]
"""What is shown of an object: names and values."""


def as_text(name: str, rows: Rows) -> str:
    """`Name(first: value, second: value)` on one line, rows without a value left out."""
    return f"{name}({', '.join(f'{key}: {value}' for key, value in rows if value)})"


def as_html(name: str, rows: Rows) -> str:
    """A table for `_repr_html_`, its content escaped."""
    cells = "".join(
        f"<tr><th style='text-align:left'>{escape(key)}</th><td style='text-align:left'>{escape(value)}</td></tr>"
        for key, value in rows
        if value
    )
    return f"<table><caption>{escape(name)}</caption>{cells}</table>"


def listed(names: Sequence[str], most: int = 6) -> str:
    """The first names of a list, and their number: "LASI, RASI, ... (15)"."""
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown}, ... ({len(names)})"


def counted(number: int, noun: str) -> str:
    """A number with its noun, in the plural where it is not one.

    >>> counted(1, "trial"), counted(1200, "frame")
    ('1 trial', '1,200 frames')
    """
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def how_often(times: int) -> str:
    """A number of times, in words.

    >>> how_often(1), how_often(3)
    ('once', '3 times')
    """
    return "once" if times == 1 else f"{times:,} times"


def singular(name: str) -> str:
    """The name of what a number counts, for the number one.

    >>> singular("pieces of tracks"), singular("frames at 100 Hz")
    ('piece of tracks', 'frame at 100 Hz')
    """
    return re.sub(r"s\b", "", name, count=1)


def significant(number: float, digits: int) -> str:
    """A number rounded to so many digits that count, never as a power of ten.

    >>> significant(99.6, 2), significant(0.012345, 3), significant(123456.0, 2)
    ('100', '0.0123', '123,456')
    """
    if not number or not math.isfinite(number):
        return f"{number:g}"
    places = max(0, digits - 1 - math.floor(math.log10(abs(number))))
    text = f"{number:,.{places}f}"
    return text.rstrip("0").rstrip(".") if places else text


def short_names(files: Sequence[str | Path]) -> list[str]:
    """What to call each file: its name, with as many of its folders as tell it from other files of that name.

    >>> short_names(["data/anna/walk.c3d", "data/ben/walk.c3d", "data/ben/run.c3d"])
    ['anna/walk.c3d', 'ben/walk.c3d', 'run.c3d']
    """
    parts = [Path(file).parts for file in files]
    names = []
    for own in parts:
        # one file that is given twice has one name
        others = {other for other in parts if other != own and other[-1:] == own[-1:]}
        length = next((n for n in range(1, len(own)) if all(other[-n:] != own[-n:] for other in others)), len(own))
        names.append("/".join(own[-length:]))
    return names


def metres(length: float) -> str:
    """A length with its unit, never as a power of ten.

    >>> metres(0.0123), metres(1440.0)
    ('0.0123 m', '1,440 m')
    """
    return f"{significant(length, 3)} m"


def duration(frames: int, rate: float) -> str:
    """Frames, rate and seconds: "500 at 100 Hz (5 s)"."""
    return f"{frames} at {rate:g} Hz ({significant(frames / rate, 4)} s)"
