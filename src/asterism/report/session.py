"""The recordings of a processed session in; one page on all of them, which leads to the page of each person, out."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from asterism.findings import Finding, Severity
from asterism.labelling.correction.readiness import READY
from asterism.report.page import NOTHING, Cell, Page, Section, Table, findings_table, write_page

MOST = 500
"""Lines of a table of recordings or findings on the page: what a browser draws at once, and more than anybody reads. Of more, those that
need a look come first."""


def session_report(path: Path, rows: Sequence[Mapping[str, Any]], findings: Sequence[Finding], failed: Mapping[str, str]) -> None:
    """Write the page. rows: as `asterism process` has them. failed: files and persons that could not be processed, each with the reason."""
    walks = [row for row in rows if row.get("kind") == "walk"]
    to_look_at = [row for row in rows if row.get("look_at")]
    persons = list(dict.fromkeys(row["person"] for row in rows))
    seen = sum(finding.severity > Severity.NOTE for finding in findings)
    merits = [
        (str(len(rows)), "recordings", ""),
        (str(len(persons)), "persons", ""),
        (str(len(walks)), "walks analysed", ""),
        (str(len(to_look_at)), "recordings to look at", "warn" if to_look_at else "good"),
        (str(len(failed)), "failed", "bad" if failed else "good"),
    ]
    sections = [
        Section("Persons", "Each name leads to the person's report.", table=_persons(rows, persons)),
        Section("Recordings", _which(rows), table=_recordings(_first(rows))),
    ]
    if failed:
        lines = [[name, said] for name, said in failed.items()]
        sections.insert(0, Section("Failed", "The next run tries these again.", table=Table(["what", "why"], lines, left=2)))
    if findings:
        shown = sorted(findings, key=lambda finding: -finding.severity)[:MOST]
        more = Counter(finding.code for finding in sorted(findings, key=lambda finding: -finding.severity)[MOST:])
        rest = [["", f"{count} more [{code}]; --json has all"] for code, count in more.most_common()]
        sections.append(Section("What to know", table=findings_table(shown, rest)))
    lead = f"{len(failed)} could not be processed. " if failed else ""
    lead += f"{seen} findings to read below." if seen else "" if failed else "Nothing was found that needs a look."
    write_page(path, Page(f"Session of {len(persons)} persons", lead, {}, merits, sections))


def _persons(rows: Sequence[Mapping[str, Any]], persons: Sequence[str]) -> Table:
    lines = list[list[str | Cell]]()
    for person in persons:
        own = [row for row in rows if row["person"] == person]
        report = next((row["report"] for row in own if row.get("report")), "")
        look_at = sum(row.get("look_at") or 0 for row in own)
        speeds = [row["speed"] for row in own if row.get("speed") is not None]
        cadences = [row["cadence"] for row in own if row.get("cadence") is not None]
        lines.append(
            [
                Cell(person, href=report),
                str(len(own)),
                str(sum(row.get("readiness") == READY for row in own)),
                Cell(str(look_at), tint=1.0 if look_at else 0.0),
                str(sum(row.get("cycles") or 0 for row in own)),
                f"{sum(cadences) / len(cadences):.1f}" if cadences else NOTHING,
                f"{sum(speeds) / len(speeds):.2f}" if speeds else NOTHING,
            ]
        )
    return Table(["person", "recordings", "ready", "to look at", "cycles", "steps/min", "m/s"], lines)


def _needs_a_look(row: Mapping[str, Any]) -> bool:
    return bool(row.get("look_at")) or row.get("readiness") != READY


def _first(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The rows that the page shows: all, or of many those that need a look first."""
    return list(rows) if len(rows) <= MOST else sorted(rows, key=_needs_a_look, reverse=True)[:MOST]


def _which(rows: Sequence[Mapping[str, Any]]) -> str:
    if len(rows) <= MOST:
        return ""
    return f"{MOST} of {len(rows)}, those that need a look first ({sum(map(_needs_a_look, rows))}); session.csv has all."


def _shared(names: Sequence[str]) -> str:
    """The folder that all names have before them; "" where some are paths and others addresses."""
    try:
        return os.path.commonpath([os.path.dirname(name) for name in names])
    except ValueError:
        return ""


def _recordings(rows: Sequence[Mapping[str, Any]]) -> Table:
    lines = list[list[str | Cell]]()
    # what all have before their names is no news, and as wide as the page
    shared = _shared([str(row["file"]) for row in rows])
    for row in rows:
        labelled, look_at = row.get("labelled"), row.get("look_at")
        lines.append(
            [
                str(row["file"]).removeprefix(shared).lstrip("/\\"),
                str(row.get("kind") or NOTHING),
                str(row.get("use") or NOTHING),
                NOTHING if labelled is None else f"{100 * labelled:.2f} %",
                Cell(str(look_at or 0), tint=1.0 if look_at else 0.0),
                str(row.get("cycles") or NOTHING),
            ]
        )
    return Table(["file", "kind", "labels", "labelled", "to look at", "cycles"], lines, left=3)
