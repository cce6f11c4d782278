"""Figures in; `figures.json` out: one entry per figure of an issue's table, the missed ones included."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
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
    """One measured number: which row of which table, what was asked ("<= 0.01", or "none"), its unit, and n samples behind it.

    n      different samples: frames, points, files
    draws  how often they were hidden or cluttered at random in all, where that is more than once each; else 0
    ours   whether we set the bound ourselves: nobody asked for it, no document prints it
    """

    row: str
    asked: str
    measured: float
    unit: str
    n: int
    draws: int = 0
    ours: bool = False

    def __post_init__(self) -> None:
        if not (self.unit and self.n > 0 and math.isfinite(self.measured)):
            raise ValueError(f"a figure needs a unit, samples and a finite number: {self}")
        if self.draws and self.draws < self.n:
            raise ValueError(f"there cannot be fewer draws than different samples: {self}")


@dataclass(frozen=True)
class Origin:
    """What measured a figure: the commit, with "+" where files had changed since, and the hash of all that the row measures."""

    commit: str = ""
    sources: str = ""


NOBODY = Origin()


@dataclass(frozen=True)
class Entry:
    """A figure as it is kept, with the issue's title, the command that measured it, the day, and the sources (see `Origin`)."""

    issue: str
    row: str
    asked: str
    measured: float
    unit: str
    n: int
    command: str
    date: str
    draws: int = 0
    ours: bool = False
    commit: str = ""
    sources: str = ""


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


UNLABELLED_SHOWN, UNLABELLED_MOST = 0.1, 0.5
"""Shares of the markers in view without a label: said beside a share of wrong labels from the first on; from the second on no bound on
wrong labels is reached."""


@dataclass(frozen=True)
class Judged:
    """A kept figure, whether it does what was asked, whether it is of other code, and beside wrong labels what is without one, in %."""

    entry: Entry
    reached: bool | None
    stale: bool
    unlabelled: float | None


def judged(entries: Sequence[Entry], stale: Collection[str] = ()) -> list[Judged]:
    """Each figure with its verdict: few wrong labels are no merit where hardly any were given, and what other code measured proves nothing.

    stale  commands whose figures are not of the code as it is
    """
    values = {(entry.issue, entry.row): entry.measured for entry in entries}
    out = []
    for entry in entries:
        missing = _unlabelled(entry, values)
        verdict = reached(entry.asked, entry.measured)
        if verdict and missing is not None and missing >= UNLABELLED_MOST:
            verdict = False
        shown = 100 * missing if missing is not None and missing >= UNLABELLED_SHOWN else None
        out.append(Judged(entry, verdict, entry.command in stale, shown))
    return out


def _unlabelled(entry: Entry, values: Mapping[tuple[str, str], float]) -> float | None:
    """The share of the markers in view without a label, where this row is about wrong ones and a row beside it tells."""
    start, _, what = entry.row.rpartition(": ")
    if what not in ("FA", "wrong"):
        return None
    if (entry.issue, f"{start}: missed") in values:
        return values[entry.issue, f"{start}: missed"]
    right = values.get((entry.issue, f"{start}: right"))
    if right is None or entry.measured >= 1:
        return None
    return max(0.0, 1 - right / (1 - entry.measured))


def load(path: Path | None = None) -> list[Entry]:
    """All entries of the file, in its order; none where it does not exist."""
    path = path or FIGURES
    if not path.exists():
        return []
    return [Entry(**entry) for entry in json.loads(path.read_text(encoding="utf-8"))]


def record(issue: str, figures: Iterable[Figure], command: str, path: Path | None = None, origin: Origin = NOBODY) -> None:
    """Put figures in their places: each replaces the entry of the same issue and row, new ones go behind; the rest stays."""
    today = datetime.now(UTC).date().isoformat()
    entries = {(entry.issue, entry.row): entry for entry in load(path)}
    for figure in figures:
        kept = replace(figure, measured=_rounded(figure.measured))
        entries[issue, figure.row] = Entry(issue=issue, command=command, date=today, **asdict(kept), **asdict(origin))
    save(list(entries.values()), path)


def forget_others(command: str, rows: Collection[str], path: Path | None = None) -> None:
    """Drop what a command measured once and does not measure any more."""
    save([entry for entry in load(path) if entry.command != command or entry.row in rows], path)


def save(entries: list[Entry], path: Path | None = None) -> None:
    """Write the whole file, under a temporary name first."""
    path = path or FIGURES
    temporary = path.with_name(path.name + ".part")
    text = ",\n".join(" " + json.dumps(asdict(entry), ensure_ascii=False) for entry in entries)
    temporary.write_text(f"[\n{text}\n]\n", encoding="utf-8")
    os.replace(temporary, path)


def _rounded(value: float) -> float:
    return float(f"{value:.7g}")
