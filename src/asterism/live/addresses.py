"""The address of a camera, a source or an output in; its parts out, or what is wrong with them."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from types import MappingProxyType
from urllib.parse import parse_qsl, urlsplit

from asterism.errors import AsterismError

_ON, _OFF = ("1", "true", "yes", "on", ""), ("0", "false", "no", "off")


def without_password(address: str) -> str:
    """An address as it may be shown.

    >>> without_password("rtsp://lab:secret@192.168.1.7/stream")
    'rtsp://lab:…@192.168.1.7/stream'
    """
    return re.sub(r"(://[^/@:]*:)[^/]*@", r"\1…@", address)


def in_words(problem: BaseException) -> str:
    """What a failure of the network means, in the system's words and without numbers and names of exceptions; "no answer" for nothing.

    >>> import errno
    >>> in_words(ConnectionRefusedError(errno.ECONNREFUSED, "Connect call failed ('127.0.0.1', 9)")), in_words(TimeoutError())
    ('connection refused', 'no answer')
    """
    said = str(problem)
    if isinstance(problem, OSError) and problem.errno is not None:
        # Numbers below 0 are those of names that are not known.
        said = os.strerror(problem.errno) if problem.errno > 0 else problem.strerror or said
        said = said[:1].lower() + said[1:]
    return said or "no answer"


class Query:
    """The options after the question mark of an address: each is asked for by name, and one that nobody asks for is refused.

    bare: whether nothing but options stands behind the host and the port, so that a path is refused, too.
    """

    def __init__(self, address: str, *, bare: bool = False) -> None:
        # What is behind the question mark may be a secret.
        self.address = without_password(address.partition("?")[0])
        self._options = parse_qsl(address.partition("?")[2], keep_blank_values=True)
        self._asked: set[str] = set()
        self._path = urlsplit(address).path.strip("/") if bare else ""

    def texts(self, name: str) -> tuple[str, ...]:
        """All values of an option that may be given several times."""
        self._asked.add(name)
        return tuple(value for key, value in self._options if key == name)

    def text(self, name: str, otherwise: str) -> str:
        """An option's value."""
        return (*self.texts(name), otherwise)[0]

    def number(self, name: str, otherwise: float) -> float:
        """An option's value as a finite number from 0 on. Raises AsterismError where it is none."""
        text = self.text(name, "")
        try:
            value = float(text) if text else otherwise
        except ValueError:
            value = -1.0
        if text and not 0 <= value < math.inf:
            raise AsterismError(f"{self.address}: {name} = {text} is no number from 0 on.")
        return value

    def whole(self, name: str, otherwise: int) -> int:
        """An option's value as a whole number of at most five digits. Raises AsterismError where it is none."""
        text = self.text(name, str(otherwise))
        if not (text.isascii() and text.isdigit() and len(text) <= 5):
            raise AsterismError(f"{self.address}: {name} = {text} is no whole number from 0 to 99999.")
        return int(text)

    def switch(self, name: str) -> bool:
        """Whether an option is on: ?name, ?name=1 or ?name=yes. Raises AsterismError where its value is neither on nor off."""
        text = self.text(name, "0").lower()
        if text not in (*_ON, *_OFF):
            raise AsterismError(f"{self.address}: {name} = {text} is neither 1 nor 0.")
        return text in _ON

    def check_all_used(self, needs: Mapping[str, str] = MappingProxyType({})) -> None:
        """Raise AsterismError where the address says what means nothing there; needs: what options would need, by their names."""
        unknown = sorted({key for key, _ in self._options} - self._asked)
        if unknown:
            known = f"choose from {', '.join(sorted(self._asked))}" if self._asked else "there are no options"
            raise AsterismError(f"{self.address}: the option {unknown[0]} means nothing there; {needs.get(unknown[0], known)}.")
        if self._path:
            raise AsterismError(f"{self.address}: {self._path} means nothing behind the host and the port; leave it out.")
