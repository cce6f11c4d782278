"""Texts, tables and figures in; one HTML file out, with style, script and data inside."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from asterism.files.atomic import utf8, write_atomically
from asterism.findings import Finding, Severity
from asterism.recording.display import singular
from asterism.report.player import deflated, player_script, player_style, template

NOTHING = "–"


@dataclass(frozen=True)
class Cell:
    """A table's cell: its text, the strength of its tint (0 to 1), and which of the page's tints it is ("warn", "bad").

    place    a recording of the page's player, its first and last frame, to which the cell leads
    drawing  SVG of our own beside the text
    href     the page that it leads to, beside this one
    """

    text: str
    tint: float = 0.0
    kind: str = "warn"
    place: tuple[int, int, int] | None = None
    drawing: str = ""
    href: str = ""


@dataclass(frozen=True)
class Table:
    """A table: the first `left` columns are text, the others numbers. Where it `opens`, row i shows the player's recording i."""

    head: Sequence[str]
    rows: Sequence[Sequence[str | Cell]]
    left: int = 1
    opens: bool = False


@dataclass(frozen=True)
class Section:
    """One block of a page, shown in this order: heading, text, drawing, figure (a Plotly figure as a plain dict), player, table, note.

    drawing  HTML of our own, such as `report.cycle_panels.drawn_panels` gives it, in which all texts of others are escaped
    player   recordings, as `report.player.pack_recordings` gives them, of which the player shows one at a time
    """

    heading: str
    text: str = ""
    figure: Mapping[str, Any] | None = None
    player: Sequence[Mapping[str, Any]] | None = None
    table: Table | None = None
    note: str = ""
    folded: bool = False
    drawing: str = ""


@dataclass(frozen=True)
class Page:
    """A whole report."""

    title: str
    lead: str
    facts: Mapping[str, Any]
    figures_of_merit: Sequence[tuple[str, str, str]]  # value, name, one of "", "good", "warn", "bad"
    sections: Sequence[Section] = field(default_factory=tuple)


def write_page(path: str | Path, page: Page) -> None:
    """Render the page and write it to `path`, completely or not at all. Raises AsterismError where the file cannot be written."""
    target = Path(path)
    figures = {f"figure-{i}": s.figure for i, s in enumerate(page.sections) if s.figure is not None}
    players = {f"player-{i}": s.player for i, s in enumerate(page.sections) if s.player}
    facts = {"Asterism": _version(), **page.facts, "written": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")}
    # Scripts only where something is drawn: a page of tables stays readable by any program.
    html = (
        _environment()
        .get_template("page.html")
        .render(
            page=page,
            facts={name.replace("_", " "): _fact_text(value) for name, value in facts.items() if not _says_nothing(value)},
            style=template("page.css") + player_style(),
            script=player_script() + template("page.js") + template("panels.js") if figures or players else "",
            plotly=_plotly() if figures else "",
            data=_as_script({"figures": _without_markup(figures), "players": players}),
            is_cell=lambda cell: isinstance(cell, Cell),
            singular=singular,
        )
    )
    # Whole or not at all: a browser that reloads must not meet half a page.
    write_atomically(target, utf8(html))


@cache
def _environment() -> Environment:
    """The pages' templates, compiled once for all pages of a process. Every text is escaped: labels and names come from others' files."""
    return Environment(
        loader=PackageLoader("asterism.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=visible_text,
        auto_reload=False,
    )


_OWN_TAGS = re.compile("&lt;(/?extra|br)>")
"""Tags of ours in a figure's texts, which Plotly obeys."""


def _without_markup(value: Any) -> Any:
    """A figure in whose texts Plotly finds no tags but ours: it would make links and pictures of a label."""
    if isinstance(value, str):
        return _OWN_TAGS.sub(r"<\1>", visible_text(str(value)).replace("&", "&amp;").replace("<", "&lt;"))
    if isinstance(value, Mapping):
        return {key: _without_markup(item) for key, item in value.items()}
    # Numbers hold no markup; only arrays of texts are looked through.
    if isinstance(value, np.ndarray):
        return _without_markup(value.tolist()) if value.dtype.kind in "OU" else value
    return [_without_markup(item) for item in value] if isinstance(value, list | tuple) else value


_UNSEEN = re.compile("[\\x00-\\x08\\x0b-\\x1f\\x7f-\\x9f\\u061c\\u200b-\\u200f\\u2028-\\u202e\\u2060-\\u2069\\ufeff]")


def visible_text(value: Any) -> Any:
    """A text with a sign in place of each character that cannot be seen, such as marks that turn the direction of writing."""
    return _UNSEEN.sub("\ufffd", value) if type(value) is str else value


def percent(share: float, digits: int = 1) -> str:
    """A share 0..1 as text: 99.2 %; a dash where it is not known.

    >>> percent(0.9921), percent(float("nan"))
    ('99.2 %', '–')
    """
    return NOTHING if share is None or math.isnan(share) else f"{100 * share:.{digits}f} %"


def count(number: float) -> str:
    """A whole number with separated thousands; a dash where it is not known."""
    return NOTHING if number is None or math.isnan(number) else f"{number:,.0f}"


def decimal(value: float, digits: int, unit: str = "") -> str:
    """A number with so many digits behind the point, and its unit; a dash where it is not known."""
    return f"{value:.{digits}f}{unit}" if math.isfinite(value) else NOTHING


def millimetres(metres: float) -> str:
    """A length in m as text: 0.32 mm; a dash where it is not known."""
    return decimal(1000 * metres, 2, " mm")


_SEVERITIES = {Severity.ERROR: Cell("do not use", 1.0, "bad"), Severity.WARNING: Cell("look at this", 0.6), Severity.NOTE: Cell("note")}


def findings_table(findings: Sequence[Finding], more: Sequence[Sequence[str | Cell]] = ()) -> Table:
    """What was found, the more severe ones tinted, and `more` rows; one row that says so where there is nothing."""
    rows: list[Sequence[str | Cell]] = [(_SEVERITIES[finding.severity], str(finding)) for finding in findings]
    rows += more
    return Table(["", "what was found"], rows or [["good", "nothing speaks against it"]], left=2)


def tinted(share: float, digits: int, worst: float, kind: str = "warn") -> Cell:
    """A share as a cell whose tint grows with its root up to `worst`."""
    # The root makes small shares visible beside large ones.
    known = not math.isnan(share) and worst > 0
    return Cell(percent(share, digits), min(math.sqrt(max(share, 0.0) / worst), 1.0) if known else 0.0, kind)


def plain(value: Any) -> Any:
    """The value as JSON can hold it: arrays as lists, numbers that are not finite as null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    # JSON has no NaN: a gap in a line is null.
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _says_nothing(value: Any) -> bool:
    return value is None or (isinstance(value, str | list | tuple | Mapping) and not value)


def _fact_text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{str(key).replace('_', ' ')} {_fact_text(item)}" for key, item in value.items() if not _says_nothing(item))
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def _as_script(value: Any) -> str:
    # A label could close the script; written as escapes it cannot.
    text = json.dumps(plain(value), ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


@cache
def _plotly() -> str:
    """Plotly's script, deflated: 2 MB of a page instead of 5. Half a second, once for all pages of a process."""
    from plotly.offline import get_plotlyjs

    load: Callable[[], str] = get_plotlyjs
    return deflated(np.frombuffer(load().encode("utf-8"), dtype=np.uint8))


@cache
def _version() -> str:
    try:
        return metadata.version("asterism")
    except metadata.PackageNotFoundError:
        return "0+unknown"
