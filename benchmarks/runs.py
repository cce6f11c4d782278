"""Rows that ran to their end, in `runs.json`: how long each took, by which sources; so that a run goes on where it was stopped."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path

RUNS = Path(__file__).with_name("runs.json")


@dataclass(frozen=True)
class Run:
    """The last time that a row was measured whole.

    seconds      wall time, with so many processes (`jobs`)
    cpu_seconds  of all processes: what it costs, however busy the machine was
    sources      hash of all that it measures, see `sources.hash_of`
    """

    chapter: str
    row: str
    seconds: float
    cpu_seconds: float
    jobs: int
    commit: str
    sources: str
    date: str


def load(path: Path | None = None) -> dict[tuple[str, str], Run]:
    """The runs by chapter and row; none where the file does not exist."""
    path = path or RUNS
    if not path.exists():
        return {}
    runs = (Run(**entry) for entry in json.loads(path.read_text(encoding="utf-8")))
    return {(run.chapter, run.row): run for run in runs}


def record(run: Run, path: Path | None = None) -> None:
    """Put a run in the place of the row's last one."""
    path = path or RUNS
    runs = {**load(path), (run.chapter, run.row): run}
    text = ",\n".join(" " + json.dumps(asdict(runs[key])) for key in sorted(runs))
    temporary = path.with_name(path.name + ".part")
    temporary.write_text(f"[\n{text}\n]\n", encoding="utf-8")
    os.replace(temporary, path)


def cpu_seconds() -> float:
    """Processor time of this process and of its children that have ended."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system
