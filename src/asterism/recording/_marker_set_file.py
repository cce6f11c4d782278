"""The table of a marker set's TOML file in; the fields of a `MarkerSet`, each of its type, out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_LONGEST_NAME = 200


def fields_of(table: Mapping[str, Any], origin: str) -> dict[str, Any]:
    """The fields of a marker set. Raises ValueError that names the first one of another type."""
    return {
        "names": _texts("markers", table.get("markers")),
        "title": _text("title", table.get("title", origin)),
        "aliases": _lists("aliases", table.get("aliases", {})),
        "pairs": tuple(_pair(number, pair) for number, pair in enumerate(_list("pairs", table.get("pairs", [])))),
        "segments": _lists("segments", table.get("segments", {})),
    }


def _text(place: str, value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"`{place}` is {_kind(value)}, not a text")
    # A damaged file can hold a name of megabytes.
    if len(value) > _LONGEST_NAME and place != "title":
        raise ValueError(f"`{place}` has a name of {len(value)} characters, {_LONGEST_NAME} at most are one")
    return value


def _list(place: str, value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise ValueError(f"`{place}` is {_kind(value)}, not a list")
    return value


def _texts(place: str, value: Any) -> tuple[str, ...]:
    return tuple(_text(place, item) for item in _list(place, value))


def _lists(place: str, value: Any) -> dict[str, tuple[str, ...]]:
    if not isinstance(value, dict):
        raise ValueError(f"`{place}` is {_kind(value)}, not a table of lists")
    return {_text(place, name): _texts(f"{place}.{name[:40]}", items) for name, items in value.items()}


def _pair(number: int, value: Any) -> tuple[str, str]:
    names = _texts(f"pairs, number {number + 1}", value)
    if len(names) != 2:
        raise ValueError(f"number {number + 1} of `pairs` has {len(names)} names, not two")
    return names[0], names[1]


def _kind(value: Any) -> str:
    kinds = {
        type(None): "missing",
        bool: "a truth value",
        int: "a number",
        float: "a number",
        str: "a text",
        list: "a list",
        dict: "a table",
    }
    # TOML has dates and times besides these.
    return kinds.get(type(value), "a date or time")
