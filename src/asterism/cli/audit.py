"""`asterism audit`: labelled files in; their wrong labels out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._folders import recordings_of
from asterism.cli._options import Files, Json, Markers, Overwrite, Seed, SubjectName, Vertical
from asterism.findings import exit_status

if TYPE_CHECKING:
    from asterism.labelling.audit import LabelError, NamesAsked
    from asterism.recording import MarkerSet, Recording


LEARNED_AS_NAMED = "The model learns them as they are named; where the names are wrong, correct them and do this again."
"""What becomes of names that differ, where a model learns from them."""


@dataclass(frozen=True)
class AuditOptions:
    """What `asterism audit` is asked to do."""

    files: Files
    markers: Markers = None
    subject: SubjectName = None
    seed: Seed = 0
    vertical: Vertical = None
    overwrite: Overwrite = False
    json: Json = None


@takes(AuditOptions)
def audit(options: AuditOptions) -> None:
    """Find wrong labels in labelled files.

    Such as markers that are exchanged for some frames or throughout, and labels that jump away and back.

    The markers' paths show where two labels are exchanged. With files of several people, the bodies of the other people show which of
    the two is right, and what is wrong throughout. Where it is known where the markers sit, virtual people show it of a single file, too.
    The exit status is 1 where something was found.
    """
    from asterism.cli._recordings import marker_set_of, read_some
    from asterism.recording import subject_of
    from asterism.recording.display import counted

    _console.check_new(options.json, options.overwrite)
    batch = _console.Batch("audited")
    marker_set = marker_set_of(options.markers)
    recordings = read_some(recordings_of(options.files, batch), marker_set, options.vertical, batch)
    subjects = [options.subject or subject_of(recording) for recording in recordings]
    errors, asked = errors_in(recordings, marker_set, subjects, options.seed, "auditing")
    # frames as the file numbers them, by which other programs find them
    errors = [as_numbered(error, recordings) for error in errors]
    if options.json != "-":
        show(errors, batch.done)
        whose = "by --subject" if options.subject else "as the files or their folders say"
        virtual = (
            f"virtual people who wear {asked.worn.title or 'these markers'}" if asked.worn else f"no virtual people, since {asked.why}"
        )
        _console.result(f"evidence: {counted(len(set(subjects)), 'subject')}, {whose}; {virtual}.")
    _console.write_json(
        options.json,
        {
            "command": "audit",
            "files": batch.done,
            "failed": batch.failed,
            "virtual_people": asked.why or "asked",
            "errors": [{**asdict(error), "file": str(batch.done[error.recording]), "damage": error.damage} for error in errors],
            "findings": [finding.to_dict() for finding in [*batch.findings, *(error.finding for error in errors)]],
        },
    )
    status = batch.close()
    # a file that failed counts more than what was found in the others
    raise typer.Exit(status or exit_status(error.finding for error in errors))


def errors_in(
    recordings: Sequence[Recording], marker_set: MarkerSet | None, subjects: Sequence[str] | None, seed: int, what: str
) -> tuple[list[LabelError], NamesAsked]:
    """The wrong labels of recordings, as their markers' paths, the bodies of the others and virtual people say; what these were asked.

    what: the progress shown.
    """
    from asterism.labelling import audit as find_errors
    from asterism.labelling import check_names

    with _console.progress(what) as progress:
        errors = find_errors(recordings, subjects=subjects, seed=seed, progress=progress)
    asked = check_names(recordings, marker_set, subjects=subjects, known=errors)
    return [*errors, *asked.errors], asked


def as_numbered(error: LabelError, recordings: Sequence[Recording]) -> LabelError:
    """The error with frames numbered as its file numbers them."""
    first = recordings[error.recording].first_frame
    return replace(error, first_frame=error.first_frame + first, last_frame=error.last_frame + first)


def ranked(errors: Sequence[LabelError]) -> list[list[LabelError]]:
    """The same markers wrong in the same way in one file, as one entry; errors before hints, the most evidence first."""
    groups: dict[tuple[int, str, tuple[str, ...]], list[LabelError]] = {}
    for error in errors:
        groups.setdefault((error.recording, error.kind, error.markers), []).append(error)
    return sorted(groups.values(), key=lambda some: (not some[0].damage, -sum(error.gain for error in some)))


def show(errors: list[LabelError], files: list[Path]) -> None:
    """The errors as a table, and a line with their number."""
    damage = sum(error.damage for error in errors)
    if errors:
        rows = [
            (
                str(files[some[0].recording]),
                some[0].kind if some[0].damage else f"{some[0].kind} (hint)",
                some[0].description if len(some) == 1 else f"{some[0].description}, and {len(some) - 1} times more, here and there",
                str(some[0].first_frame),
                str(some[-1].last_frame),
                _console.count(sum(error.gain for error in some)),
            )
            for some in ranked(errors)
        ]
        _console.table("Wrong labels", ("file", "kind", "description", "first frame", "last", "evidence"), rows, left=3)
    hints = len(errors) - damage
    found = f"{damage} error{'s' if damage != 1 else ''}" if damage else "no error"
    found += f", {hints} hint{'s' if hints > 1 else ''}" if hints else ""
    _console.result(f"{len(files)} file{'s' if len(files) != 1 else ''}: {found}")
