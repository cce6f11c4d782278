"""The address of a camera in; its parts out."""

from __future__ import annotations

import re
from urllib.parse import parse_qsl

from asterism.errors import AsterismError
from asterism.live.cameras.settings import setting_value


def without_password(address: str) -> str:
    """An address as it may be shown.

    >>> without_password("rtsp://lab:secret@192.168.1.7/stream")
    'rtsp://lab:…@192.168.1.7/stream'
    """
    return re.sub(r"(://[^/@:]*:)[^/]*@", r"\1…@", address)


class Query:
    """The words after the question mark of an address: each is asked for by name, and one that nobody asks for is refused."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._words = dict(parse_qsl(address.partition("?")[2], keep_blank_values=True))
        self._asked: set[str] = set()

    def text(self, name: str, otherwise: str) -> str:
        """A word's value."""
        self._asked.add(name)
        return self._words.get(name, otherwise)

    def number(self, name: str, otherwise: float) -> float:
        """A word's value as a finite number. Raises AsterismError where it is none."""
        text = self.text(name, "")
        try:
            return otherwise if not text else float(setting_value("threshold", text))
        except (AsterismError, ValueError):
            raise AsterismError(f"{self.address}: {name} = {text} is no number from 0 on.") from None

    def whole(self, name: str, otherwise: int) -> int:
        """A word's value as a whole number of at most five digits. Raises AsterismError where it is none."""
        text = self.text(name, str(otherwise))
        if not (text.isascii() and text.isdigit() and len(text) <= 5):
            raise AsterismError(f"{self.address}: {name} = {text} is no whole number from 0 to 99999.")
        return int(text)

    def check_all_used(self) -> None:
        """Raise AsterismError where the address has a word that means nothing."""
        other = sorted(set(self._words) - self._asked)
        if other:
            raise AsterismError(f"{self.address}: {other[0]} means nothing there; choose from {', '.join(sorted(self._asked))}.")
