"""Kept figures and the sources in; the rows whose figures are not of the code as it is out, and what has changed since."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from benchmarks.figures import Entry
from benchmarks.runs import Run
from benchmarks.sources import Folder, Sources, hash_of

SHOWN = 4
"""Changed sources that are named of each row."""

Row = tuple[str, str]
"""A chapter and a row of it."""


@dataclass(frozen=True)
class StaleRow:
    """A row to measure again: how many kept figures it has, by which commits, and what has changed since."""

    chapter: str
    row: str
    figures: int
    commits: tuple[str, ...]
    changed: tuple[str, ...]

    def __str__(self) -> str:
        if not self.figures:
            return f"{self.chapter} {self.row}: never measured"
        by = ", ".join(commit or "unknown sources" for commit in self.commits)
        more = f" and {len(self.changed) - SHOWN} more" if len(self.changed) > SHOWN else ""
        since = f"; changed since: {', '.join(self.changed[:SHOWN])}{more}" if self.changed else ""
        return f"{self.chapter} {self.row}: {self.figures} figures by {by}{since}"


def command_of(chapter: str, row: str) -> str:
    """The command that measures a row."""
    return f"python -m benchmarks {chapter} --rows {row}"


def stale_rows(entries: Sequence[Entry], sources: Sources, contents: Mapping[str, Folder], explain: bool = True) -> list[StaleRow]:
    """Rows with a figure of other sources than these, and rows without any; then commands of kept figures that are no rows any more.

    `contents` says what the folders of recordings hold (see `read_values.contents`); `explain` looks into git for what has changed.
    """
    by_command: dict[str, list[Entry]] = {}
    for entry in entries:
        by_command.setdefault(entry.command, []).append(entry)
    before: dict[str, Sources | None] = {}
    found = []
    for chapter, row in sources.rows():
        own = by_command.pop(command_of(chapter, row), [])
        current = hash_of(sources, chapter, row, contents)
        old = [entry for entry in own if entry.sources != current]
        if own and not old:
            continue
        commits = tuple(dict.fromkeys(entry.commit for entry in old))
        for commit in commits if explain else ():
            if commit and commit not in before:
                before[commit] = Sources.at(commit.removesuffix("+"))
        changed = {name for commit in commits for name in _changed(before.get(commit), sources, (chapter, row))}
        found.append(StaleRow(chapter, row, len(own), commits, tuple(sorted(changed))))
    for command, own in by_command.items():
        chapter, _, row = command.removeprefix("python -m benchmarks ").partition(" --rows ")
        found.append(StaleRow(chapter, row, len(own), tuple(dict.fromkeys(entry.commit for entry in own)), ("there is no such row",)))
    return found


def report(stale: Collection[StaleRow], runs: Mapping[Row, Run]) -> str:
    """What is stale, each with the command that measures it again and how long it took last; and a line about all."""
    lines = []
    known = 0.0
    for row in stale:
        run = runs.get((row.chapter, row.row))
        known += run.seconds if run else 0.0
        took = f"{run.seconds:.0f} s with {run.jobs} jobs" if run else "no duration known"
        lines += [str(row), f"    {command_of(row.chapter, row.row)}    ({took})"]
    unknown = sum((row.chapter, row.row) not in runs for row in stale)
    figures = sum(row.figures for row in stale)
    never = sum(not row.figures for row in stale)
    lines.append(
        f"{figures} figures of {len(stale) - never} rows are stale, {never} rows were never measured; "
        f"{known / 60:.0f} min to measure again, and {unknown} rows of unknown duration."
        if stale
        else "No figure is stale."
    )
    return "\n".join(lines)


def _changed(before: Sources | None, now: Sources, row: Row) -> set[str]:
    """Names of what differs between two states of the repository; nothing where the row was not there before."""
    if before is None:
        return set()
    try:
        old = before.measured_by(*row)
    except (KeyError, ValueError):
        return {"the row itself"}
    new = now.measured_by(*row)
    return {name for name in {*old, *new} if old.get(name) != new.get(name)} or {"the recordings, or what is read of them"}
