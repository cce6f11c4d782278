"""The key figures of key.toml: which rows of which scripts stand for each capability, and which of them the README shows."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Group:
    """Key figures that one script gives.

    title    of the section in which they stand
    rows     their names, as the script yields them
    minutes  about what it takes on one core: the longest begin first
    alone    whether it times things: it runs while no other does
    """

    title: str
    script: str
    rows: tuple[str, ...]
    minutes: float
    alone: bool = False


@dataclass(frozen=True)
class Shown:
    """A line of the README's table: what it says, and the rows whose numbers it shows, each with the word after it."""

    text: str
    rows: tuple[tuple[str, str], ...]


def _load() -> tuple[tuple[Group, ...], tuple[Shown, ...]]:
    found: dict[str, Any] = tomllib.loads(Path(__file__).with_name("key.toml").read_text(encoding="utf-8"))
    groups = tuple(Group(**{**group, "rows": tuple(group["rows"])}) for group in found["group"])
    return groups, tuple(Shown(line["text"], tuple((row, word) for row, word in line["rows"])) for line in found["readme"])


KEY, README = _load()
