"""Figures in; `figures.json` out: one entry per figure of an issue's table, the missed ones included."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

FIGURES = Path(__file__).with_name("figures.json")

_COMPARE = {
    "<=": lambda measured, bound: measured <= bound,
    ">=": lambda measured, bound: measured >= bound,
    "<": lambda measured, bound: measured < bound,
    ">": lambda measured, bound: measured > bound,
    "==": lambda measured, bound: measured == bound,
}


@dataclass(frozen=True)
class Figure:
    """One measured number: which row of which table, what was asked ("<= 0.01", or "none"), its unit, and n samples behind it."""

    row: str
    asked: str
    measured: float
    unit: str
    n: int

    def __post_init__(self) -> None:
        if not (self.unit and self.n > 0 and math.isfinite(self.measured)):
            raise ValueError(f"a figure needs a unit, samples and a finite number: {self}")


@dataclass(frozen=True)
class Entry:
    """A figure as it is kept, with the issue's title, the command that measured it and the day."""

    issue: str
    row: str
    asked: str
    measured: float
    unit: str
    n: int
    command: str
    date: str


def reached(asked: str, measured: float) -> bool | None:
    """Whether a number does what was asked; None where nothing was asked.

    Raises ValueError where `asked` is neither "none" nor a comparison with a number.
    """
    if asked == "none":
        return None
    match = re.fullmatch(r"(<=|>=|<|>|==) (\S+)", asked)
    if not match:
        raise ValueError(f"{asked!r} is no expression such as '<= 0.01'")
    return _COMPARE[match[1]](measured, float(match[2]))


def load(path: Path = FIGURES) -> list[Entry]:
    """All entries of the file, in its order; none where it does not exist."""
    if not path.exists():
        return []
    return [Entry(**entry) for entry in json.loads(path.read_text(encoding="utf-8"))]


def record(issue: str, figures: Iterable[Figure], command: str, path: Path = FIGURES) -> None:
    """Put figures in their places: each replaces the entry of the same issue and row, new ones go behind; the rest stays."""
    today = datetime.now(UTC).date().isoformat()
    entries = {(entry.issue, entry.row): entry for entry in load(path)}
    for figure in figures:
        entries[issue, figure.row] = Entry(
            issue, figure.row, figure.asked, _rounded(figure.measured), figure.unit, figure.n, command, today
        )
    save(list(entries.values()), path)


def save(entries: list[Entry], path: Path = FIGURES) -> None:
    """Write the whole file, under a temporary name first."""
    temporary = path.with_name(path.name + ".part")
    text = ",\n".join(" " + json.dumps(asdict(entry), ensure_ascii=False) for entry in entries)
    temporary.write_text(f"[\n{text}\n]\n", encoding="utf-8")
    os.replace(temporary, path)


def _rounded(value: float) -> float:
    return float(f"{value:.7g}")
