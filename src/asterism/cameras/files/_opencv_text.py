"""The text of OpenCV's YAML or XML in; its values as plain dictionaries, lists, numbers and texts out.

OpenCV's own parsers overflow their stack where a file is nested deeply, and do not come back from some damaged ones. This reads what
cv2.FileStorage writes and what people write by hand for it; tests compare the two on both.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from typing import Any

DEEPEST = 40
"""Levels of nesting; calibrations have four."""

_NUMBER = re.compile(r"[+-]?(?:\d++\.?\d*+|\.\d++)(?:[eE][+-]?\d++)?|[+-]?0x[0-9a-fA-F]++")
_QUOTE = "\ue000"
"""Stands for &quot;, which belongs to a text, until the quotes around texts have been taken off."""

_SPECIAL = {
    **{".nan": float("nan"), "-.nan": float("nan"), ".inf": float("inf"), "+.inf": float("inf"), "-.inf": float("-inf")},
    **{"true": 1.0, "false": 0.0},
}
_COLON = re.compile(r":(?=\s|$)")
_NOT_IN_KEYS = frozenset("\"'[]{},#")
_FLOW = re.compile(
    r"\s*+(?:(?P<mark>[\[\]{},])|\"(?P<quoted>(?:[^\"\\]|\\.)*+)\"|'(?P<single>(?:[^']|'')*+)'|(?P<plain>[^\[\]{},\"'\s][^\[\]{},]*+))"
)
_BRACKETS = re.compile(r"\"(?:[^\"\\]|\\.)*+(?:\"|$)|'[^']*+(?:'|$)|(?P<bracket>[\[\]{}])", re.DOTALL)
_ESCAPES = {"n": "\n", "t": "\t", "r": "\r"}
_WORD = re.compile(r"\s*+(?:\"(?P<quoted>[^\"]*+)\"|(?P<plain>[^\s\"]\S*+))")


def values_of_yaml(text: str) -> dict[str, Any]:
    """The values of a YAML text by key; nothing where it is no mapping. Raises ValueError, with the line, where it breaks off."""
    lines: list[tuple[int, str]] = []
    begun = False
    for number, line in enumerate(text.splitlines(), 1):
        #
        if line.startswith("---"):
            if begun or lines:
                raise ValueError(f"line {number}: a second document begins; one file is one calibration")
            begun = True
        elif line.startswith("..."):
            break
        elif line.strip() and not line.startswith("%") and not line.lstrip().startswith("#"):
            lines.append((number, line.replace("\t", " ").rstrip()))
    if not lines:
        return {}
    value = _Blocks(lines).block(-1, 0)
    return value if isinstance(value, dict) else {}


def values_of_xml(text: str) -> dict[str, Any]:
    """The values of an XML text by tag. Raises ValueError where it is no whole XML or nested too deeply."""
    try:
        root = ET.fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text).replace("&quot;", _QUOTE))
    except ET.ParseError as problem:
        raise ValueError(str(problem)) from problem
    if root.tag != "opencv_storage":
        raise ValueError(f"its root is <{root.tag[:40]}>, not <opencv_storage>")
    value = _element(root, 0)
    return value if isinstance(value, dict) else {}


def _element(element: ET.Element, depth: int) -> Any:
    if depth > DEEPEST:
        raise ValueError(f"it is nested more than {DEEPEST} levels deep")
    if len(element):
        if all(part.tag == "_" for part in element):
            return [_element(part, depth + 1) for part in element]
        return {part.tag: _element(part, depth + 1) for part in element}
    given = element.text or ""
    found = [(word["quoted"], word["plain"]) for word in _WORD.finditer(given)]
    words = [_number_or_text(plain) if quoted is None else quoted.replace(_QUOTE, '"') for quoted, plain in found]
    if not words or ('"' not in given and any(isinstance(word, str) for word in words)):
        return " ".join(given.split()).replace(_QUOTE, '"')  # a text without quotes
    return words[0] if len(words) == 1 else words


@dataclass
class _Blocks:
    """The lines of a YAML text with their numbers, and the place of the one that is read next."""

    lines: list[tuple[int, str]]
    place: int = field(default=0)

    def block(self, outside: int, depth: int) -> Any:
        """The mapping, list or value that stands further right than `outside`, or a list as far right."""
        if depth > DEEPEST:
            raise self._wrong(f"it is nested more than {DEEPEST} levels deep")
        indent = _indent(self.lines[self.place][1])
        if _is_item(self.lines[self.place][1]):
            return self._items(indent, depth)
        if indent <= outside:
            return ""
        return self._mapping(indent, depth) if _key(self.lines[self.place][1]) else self._flow(self._take()[indent:])

    def _mapping(self, indent: int, depth: int) -> dict[str, Any]:
        found: dict[str, Any] = {}
        while self.place < len(self.lines) and _indent(self.lines[self.place][1]) == indent:
            parts = _key(self.lines[self.place][1])
            if parts is None:
                raise self._wrong("no `key: value` where one belongs")
            self.place += 1
            # Of two equal keys the first one counts.
            found.setdefault(parts[0], self._after(parts[1], indent, depth))
        if self.place < len(self.lines) and _indent(self.lines[self.place][1]) > indent:
            raise self._wrong("a line stands further right than those above it")
        return found

    def _items(self, indent: int, depth: int) -> list[Any]:
        found = []
        while self.place < len(self.lines) and _indent(self.lines[self.place][1]) == indent and _is_item(self.lines[self.place][1]):
            number, line = self.lines[self.place]
            rest = line[indent + 1 :]
            if rest.strip() and (_is_item(rest) or _key(rest)):
                # What stands behind a dash is a block that begins in the middle of the line: blank the dash and read it as one.
                self.lines[self.place] = (number, " " * (indent + 1) + rest)
                found.append(self.block(indent, depth + 1))
            else:
                self.place += 1
                found.append(self._after(rest, indent, depth))
        return found

    def _after(self, rest: str, indent: int, depth: int) -> Any:
        """The value behind a key or dash: the rest of the line, or the block below."""
        # Tags such as !!opencv-matrix say what the keys below say again.
        rest = re.sub(r"^(?:\s*+!\S*+)++", "", rest).strip()
        if rest and not rest.startswith("#"):
            return self._flow(rest)
        if self.place == len(self.lines):
            return ""
        line = self.lines[self.place][1]
        # YAML lets a list stand as far left as its key.
        below = _indent(line) > indent or (_indent(line) == indent and _is_item(line))
        return self.block(indent, depth + 1) if below else ""

    def _flow(self, text: str) -> Any:
        """A value within a line, or one in brackets that goes on in the lines below."""
        if text[:1] not in ("[", "{"):
            match = _FLOW.match(text) if text[:1] in ('"', "'") else None
            if text[:1] in ('"', "'") and match is None:
                raise self._wrong("a text has no closing quote", 1)
            return _scalar(re.sub(r"\s#.*$", "", text)) if match is None else _quoted(match)
        first = self.place
        parts, depth = [text], _open(text)
        # The data of a matrix go over many lines; brackets are counted instead of parsed until the last one closes.
        while depth > 0 and self.place < len(self.lines):
            part = self._take()
            parts.append(part)
            depth += _open(part)
        try:
            return _in_brackets(" ".join(parts))
        except ValueError as problem:
            raise ValueError(f"line {self.lines[first - 1][0]}: {problem}") from None

    def _take(self) -> str:
        self.place += 1
        return self.lines[self.place - 1][1]

    def _wrong(self, what: str, back: int = 0) -> ValueError:
        return ValueError(f"line {self.lines[self.place - back][0]}: {what}")


def _in_brackets(text: str) -> Any:
    """The list or mapping that a text in brackets holds. Raises ValueError where brackets do not fit or are nested too deeply."""
    opened: list[tuple[Any, str | None]] = []
    place, key = 0, None
    while place < len(text):
        match = _FLOW.match(text, place)
        if match is None:
            break
        place = match.end()
        mark = match["mark"]
        if mark in ("[", "{"):
            if len(opened) > DEEPEST:
                raise ValueError(f"it is nested more than {DEEPEST} levels deep")
            # A stack instead of recursion: nesting that a file chooses must not use ours up.
            opened.append(([] if mark == "[" else {}, key))
            key = None
        elif mark in ("]", "}"):
            if not opened or isinstance(opened[-1][0], list) != (mark == "]"):
                break
            value, outer = opened.pop()
            if not opened:
                return value
            _put(opened[-1][0], outer, value)
            key = None
        elif mark is None:
            if not opened:
                break
            key = _item(opened[-1][0], key, match)
    raise ValueError("its brackets do not fit together")


def _item(holder: Any, key: str | None, match: re.Match[str]) -> str | None:
    """Put a value where it belongs, or give the key whose value follows."""
    if match["plain"] is None:
        _put(holder, key, _quoted(match))
        return None
    word = match["plain"].strip()
    if isinstance(holder, dict) and key is None:
        # Within braces a key and its value may be one word, as in {a:1}.
        name, _, rest = word.partition(":")
        if not rest.strip():
            return name.strip()
        _put(holder, name.strip(), _scalar(rest.strip()))
    else:
        _put(holder, key, _scalar(word))
    return None


def _put(holder: Any, key: str | None, value: Any) -> None:
    if isinstance(holder, list):
        holder.append(value)
    elif key is not None:
        holder.setdefault(key, value)


def _quoted(match: re.Match[str]) -> str:
    return _unescaped(match["quoted"]) if match["quoted"] is not None else match["single"].replace("''", "'")


def _unescaped(text: str) -> str:
    return re.sub(r"\\(.)", lambda found: _ESCAPES.get(found[1], found[1]), text).replace(_QUOTE, '"')


def _scalar(text: str) -> Any:
    """What YAML means by a word without quotes: a number, or the text."""
    return _SPECIAL[text.casefold()] if text.casefold() in _SPECIAL else _number_or_text(text)


def _number_or_text(word: str) -> Any:
    if _NUMBER.fullmatch(word):
        return float(int(word, 16)) if "x" in word else float(word)
    return {**_SPECIAL, "true": word, "false": word}.get(word.casefold(), word)


def _key(line: str) -> tuple[str, str] | None:
    """The key of a line `key: value` and what follows it; None for another line."""
    bare = line.strip()
    if bare.startswith('"'):
        name, _, rest = bare[1:].partition('"')
        return (name, rest.lstrip()[1:]) if rest.lstrip().startswith(":") else None
    colon = _COLON.search(bare)
    name = bare[: colon.start()].rstrip() if colon else ""
    return (name, bare[colon.end() :]) if colon and name and not _NOT_IN_KEYS & set(name) and not _is_item(name) else None


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip(" "))


def _is_item(line: str) -> bool:
    bare = line.lstrip(" ")
    return bare == "-" or bare.startswith("- ")


def _open(text: str) -> int:
    """By how many brackets a text opens more than it closes; those in quotes do not count."""
    found = [match["bracket"] for match in _BRACKETS.finditer(text) if match["bracket"]]
    return sum(1 if bracket in "[{" else -1 for bracket in found)
