"""The newest release's figures in; docs/figures.md and the table of README.md out. No number is typed by hand."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any

from benchmarks.figures import asked_text, measured_text, reached
from benchmarks.key import KEY, README, Shown

ROOT = Path(__file__).parents[1]
PAGE, FIRST_PAGE, RELEASES = ROOT / "docs" / "figures.md", ROOT / "README.md", ROOT / "docs" / "figures"
BEGIN, END = "<!-- figures: begin -->", "<!-- figures: end -->"

Release = Mapping[str, Any]
"""What a release's file holds, see `release.release_of`."""

TEMPLATE = Path(__file__).with_name("page.md")
"""The page's own words, with the places of what is measured."""

NONE_YET = "No release has been measured yet; this page is written anew from the file of the first one."


def newest(folder: Path = RELEASES) -> Release | None:
    """The file of the highest version, or None where there is none."""
    found = sorted(folder.glob("*.json"), key=lambda path: [int(part) for part in re.findall(r"\d+", path.stem)])
    return json.loads(found[-1].read_text(encoding="utf-8")) if found else None


def measured_with(release: Release) -> str:
    """'Measured with 0.2.0, 27 November 2026, two cores'."""
    day, cores = date.fromisoformat(release["date"]), release["machine"]["cores"]
    words = {1: "one core", 2: "two cores", 4: "four cores", 8: "eight cores"}
    return f"Measured with {release['version']}, {day.day} {day:%B %Y}, {words.get(cores, f'{cores} cores')}"


def page_of(release: Release | None) -> str:
    """The page of all key figures."""
    if release is None:
        return TEMPLATE.read_text(encoding="utf-8").format(measured=NONE_YET, tables="")
    entries = {entry["row"]: entry for entry in release["rows"]}
    verdicts = [reached(entry["asked"], entry["measured"]) for entry in release["rows"]]
    machine, simulated = release["machine"], "" if release["recordings"] == "real" else " Its recordings of people are simulated ones."
    place = f"{machine['processor']}, {machine['system']}, Python {machine['python']}; commit `{release['commit'][:12]}`"
    counts = f"{verdicts.count(True)} of {verdicts.count(True) + verdicts.count(False)} figures reach what is asked."
    parts = []
    for title in dict.fromkeys(group.title for group in KEY):
        parts += [f"## {title}\n", "| row | asked | measured | reached | n |", "|---|---|---|---|---|"]
        for group in KEY:
            if group.title == title:
                parts += [_line(row, entries.get(row), group.script, release["failed"]) for row in group.rows]
        parts.append("")
    words = f"{measured_with(release)} ({place}).{simulated} {counts}"
    return TEMPLATE.read_text(encoding="utf-8").format(measured=words, tables="\n".join(parts) + "\n")


def _line(row: str, entry: Mapping[str, Any] | None, script: str, failed: Mapping[str, str]) -> str:
    if entry is None:
        return f"| {row} | | not measured{': `' + script + '` failed' if script in failed else ''} | **no** | |"
    verdict = {True: "yes", False: "**no**", None: ""}[reached(entry["asked"], entry["measured"])]
    measured = measured_text(entry["measured"], entry["unit"])
    return f"| {row} | {asked_text(entry['asked'], entry['unit'])} | {measured} | {verdict} | {entry['n']:,} |"


def table_of(release: Release | None) -> str:
    """The README's table, without its marks."""
    if release is None:
        return "(No release has been measured yet: `python -m benchmarks release`.)\n"
    entries = {entry["row"]: entry for entry in release["rows"]}
    lines = [f"| {measured_with(release)} | | n |", "|---|---|---|"]
    lines += [_shown(line, entries) for line in README]
    return "\n".join(lines) + "\n"


def _shown(line: Shown, entries: Mapping[str, Mapping[str, Any]]) -> str:
    cells, counts = [], []
    for row, word in line.rows:
        entry = entries.get(row)
        if entry is None:
            return f"| {line.text} | not measured | |"
        value = f"{100 * entry['measured']:.2f} %" if entry["unit"] == "fraction" else measured_text(entry["measured"], entry["unit"])
        missed = f" (asked {asked_text(entry['asked'], entry['unit'])})" if reached(entry["asked"], entry["measured"]) is False else ""
        cells.append(f"{value} {word}{missed}")
        counts.append(entry["n"])
    return f"| {line.text} | {', '.join(cells)} | {max(counts):,} |"


def with_table(page: str, release: Release | None) -> str:
    """A page with the table between its marks written anew. Raises ValueError where it has not both marks once."""
    if page.count(BEGIN) != 1 or page.count(END) != 1:
        raise ValueError(f"the page needs the marks {BEGIN} and {END} once each, around the table")
    before, rest = page.split(BEGIN)
    return f"{before}{BEGIN}\n{table_of(release)}{END}{rest.split(END)[1]}"


def main() -> int:
    """Write the pages, each under a temporary name first."""
    release = newest()
    for path, content in ((PAGE, page_of(release)), (FIRST_PAGE, with_table(FIRST_PAGE.read_text(encoding="utf-8"), release))):
        temporary = path.with_name(path.name + ".part")
        temporary.write_text(content, encoding="utf-8")
        os.replace(temporary, path)
    return 0
