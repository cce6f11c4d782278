"""`asterism audit`: labelled files in; where their labels cannot be right, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from asterism.cli import _console
from asterism.cli._options import Files, Json, Markers, Overwrite, Seed, Vertical

if TYPE_CHECKING:
    from asterism.labelling.audit import Finding
    from asterism.recording import Recording


def audit(
    files: Files,
    markers: Markers = None,
    subject: Annotated[
        str | None,
        typer.Option(
            "--subject", metavar="NAME", help="All files are of this person. Else as they say, or their folder.", show_default=False
        ),
    ] = None,
    seed: Seed = 0,
    vertical: Vertical = None,
    overwrite: Overwrite = False,
    json: Json = None,
) -> None:
    """Find mislabelled frames in labelled files: markers that are exchanged for a while or throughout, labels that leap away and back.

    Paths tell where two labels change places; with files of several people, the other people's bodies tell which of the two is right,
    and what is wrong throughout. Leaves with 1 where something was found.
    """
    from asterism.cli._recordings import marker_set_of, read_some
    from asterism.labelling.audit import audit as look_through

    _console.check_new(json, overwrite)
    batch = _console.Batch("looked through")
    recordings = read_some(files, marker_set_of(markers), vertical, batch)
    with _console.progress("auditing") as progress:
        findings = look_through(recordings, subjects=None if subject is None else [subject] * len(recordings), seed=seed, progress=progress)
    findings = [as_numbered(finding, recordings) for finding in findings]
    if json != "-":
        show(findings, batch.done)
    rows = [{**asdict(finding), "file": str(batch.done[finding.recording]), "damage": finding.damage} for finding in findings]
    _console.write_json(json, {"command": "audit", "files": batch.done, "failed": batch.failed, "findings": rows})
    status = batch.close()
    raise typer.Exit(status or int(any(finding.damage for finding in findings)))


def as_numbered(finding: Finding, recordings: Sequence[Recording]) -> Finding:
    """The finding with frames numbered as its file numbers them."""

    first = recordings[finding.recording].first_frame
    return replace(finding, first_frame=finding.first_frame + first, last_frame=finding.last_frame + first)


def show(findings: list[Finding], files: list[Path]) -> None:
    """The findings as a table, or a line that says there are none."""
    damage = sum(finding.damage for finding in findings)
    if findings:
        rows = [
            (
                str(files[finding.recording]),
                finding.kind if finding.damage else f"{finding.kind} (hint)",
                finding.description,
                str(finding.first_frame),
                str(finding.last_frame),
                _console.count(finding.gain),
            )
            for finding in findings
        ]
        _console.table("Labels that cannot be right", ("file", "kind", "what it looks like", "first frame", "last", "nats"), rows, left=3)
    hints = len(findings) - damage
    few = f"{damage} finding{'s' if damage != 1 else ''}" if damage else "nothing is wrong"
    _console.say(
        f"{len(files)} file{'s' if len(files) != 1 else ''}: {few}{f', {hints} hint' + ('s' if hints > 1 else '') if hints else ''}"
    )
