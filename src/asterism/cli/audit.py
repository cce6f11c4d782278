"""`asterism audit`: labelled files in; where their labels cannot be right, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from asterism.cli import _console
from asterism.cli._options import Files, Json, Markers, Overwrite, Seed, Vertical
from asterism.findings import exit_status

if TYPE_CHECKING:
    from asterism.labelling.audit import LabelError
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
        errors = look_through(recordings, subjects=None if subject is None else [subject] * len(recordings), seed=seed, progress=progress)
    errors = [as_numbered(error, recordings) for error in errors]
    if json != "-":
        show(errors, batch.done)
    rows = [{**asdict(error), "file": str(batch.done[error.recording]), "damage": error.damage} for error in errors]
    _console.write_json(json, {"command": "audit", "files": batch.done, "failed": batch.failed, "findings": rows})
    status = batch.close()
    raise typer.Exit(status or exit_status(error.finding for error in errors))


def as_numbered(error: LabelError, recordings: Sequence[Recording]) -> LabelError:
    """The error with frames numbered as its file numbers them."""
    first = recordings[error.recording].first_frame
    return replace(error, first_frame=error.first_frame + first, last_frame=error.last_frame + first)


def show(errors: list[LabelError], files: list[Path]) -> None:
    """The errors as a table, or a line that says there are none."""
    damage = sum(error.damage for error in errors)
    if errors:
        rows = [
            (
                str(files[error.recording]),
                error.kind if error.damage else f"{error.kind} (hint)",
                error.description,
                str(error.first_frame),
                str(error.last_frame),
                _console.count(error.gain),
            )
            for error in errors
        ]
        _console.table("Labels that cannot be right", ("file", "kind", "what it looks like", "first frame", "last", "nats"), rows, left=3)
    hints = len(errors) - damage
    few = f"{damage} finding{'s' if damage != 1 else ''}" if damage else "nothing is wrong"
    _console.result(
        f"{len(files)} file{'s' if len(files) != 1 else ''}: {few}{f', {hints} hint' + ('s' if hints > 1 else '') if hints else ''}"
    )
