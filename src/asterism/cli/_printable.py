"""Texts of strangers (labels, names, paths) in; the same as text only, for a terminal, out."""

from __future__ import annotations

import re

_HIDDEN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069\ufeff\ud800-\udfff]")

_SHOWN: dict[str, str] = {}


def show_as(path: str, name: str) -> None:
    """From now on, show a path of a temporary file, and those below it, under another name."""
    _SHOWN[path] = name


def printable(text: str) -> str:
    """The text with what a terminal would obey (escapes, carriage returns, marks that turn the writing's direction) written out.

    Line ends and tabs stay. An escape becomes \\x1b, a mark \\u202e. Paths of `show_as` have their other names.
    """
    for path in sorted(_SHOWN, key=len, reverse=True):
        text = text.replace(path, _SHOWN[path])
    return _HIDDEN.sub(lambda found: found[0].encode("unicode_escape", "surrogatepass").decode("ascii"), text)
