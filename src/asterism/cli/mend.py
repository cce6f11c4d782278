"""`asterism mend`: labelled files in; copies with their wrong labels put right out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._folders import check_output, outputs_of, trials
from asterism.cli._options import Files, Json, Markers, Overwrite, Seed, SubjectName, Vertical
from asterism.cli.audit import as_numbered, errors_in, show
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.labelling.audit import LabelError
    from asterism.recording import MarkerSet, Recording


@dataclass(frozen=True)
class MendOptions:
    """What `asterism mend` is asked to do."""

    files: Files
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER", help="Where the mended files go.", show_default=False)]
    markers: Markers = None
    subject: SubjectName = None
    seed: Seed = 0
    vertical: Vertical = None
    overwrite: Overwrite = False
    json: Json = None


@takes(MendOptions)
def mend(options: MendOptions) -> None:
    """Put right the wrong labels that `audit` finds.

    Files stay as they are; copies are written.

    Labels that are exchanged are exchanged back, and a label that jumps off its marker is taken back there. Everything else in a file stays
    as it is. Only files with a wrong label are written, to FOLDER. The result is audited again: what is still wrong is named, and the
    exit status is then 1.
    """
    from asterism.cli._recordings import marker_set_of

    _console.check_new(options.json, options.overwrite)
    batch, marker_set = _console.Batch("audited"), marker_set_of(options.markers)
    files = _read(options, marker_set, batch)

    def found_in(recordings: Sequence[Recording], what: str) -> list[LabelError]:
        subjects = None if options.subject is None else [options.subject] * len(recordings)
        return errors_in(recordings, marker_set, subjects, options.seed, what)[0]

    before = [file.audited for file in files]
    # all files at once: what a marker's distances are, only the others tell
    errors = found_in(before, "auditing")
    after = [_mended(file, [error for error in errors if error.recording == i], batch) for i, file in enumerate(files)]
    # labels that were put right can show others that were hidden by them
    left = errors if all(one is other for one, other in zip(before, after, strict=True)) else found_in(after, "auditing again")
    # frames as the files number them, by which other programs find them
    mended, left = [as_numbered(error, before) for error in errors], [as_numbered(error, after) for error in left]
    # a file in which nothing was wrong is not copied
    written = [file for file, one, other in zip(files, before, after, strict=True) if one is not other]
    if options.json != "-":
        show(mended, batch.done)
        for file in written:
            _console.result(f"{file.path}: mended, {file.target}")
    # what may be right is left for the person
    for error in left:
        by_hand = "Correct it by hand, for instance with asterism review."
        batch.found(replace(error.finding, mend=by_hand) if error.damage else error.finding)
    _console.write_json(
        options.json,
        {
            "command": "mend",
            "files": batch.done,
            "failed": batch.failed,
            "written": [{"file": file.path, "output": file.target} for file in written],
            "errors": [{**asdict(error), "file": str(batch.done[error.recording])} for error in mended],
            "left": [{**asdict(error), "file": str(batch.done[error.recording])} for error in left],
            "findings": [finding.to_dict() for finding in batch.findings],
        },
    )
    raise typer.Exit(batch.close())


@dataclass(frozen=True)
class _File:
    """A file, where its mended copy goes, all that is in it, and the markers that are audited; columns: of these in the whole."""

    path: Path
    target: Path
    whole: Recording
    audited: Recording
    columns: dict[str, int]


def _read(options: MendOptions, marker_set: MarkerSet | None, batch: _console.Batch) -> list[_File]:
    """The files that can be read. Raises AsterismError where two would be written to one place, or none is left."""
    from asterism import formats
    from asterism.cli._options import vertical_axis
    from asterism.cli._recordings import report_warnings, with_names
    from asterism.labelling.training.markers import named_markers
    from asterism.recording import MarkerSet

    axis, files = vertical_axis(options.vertical), list[_File]()
    found = trials(options.files, batch, without=options.output)
    for trial, target in zip(found, outputs_of(found, options.output), strict=True):
        with batch.file(trial.path):
            # before the audit, which takes minutes
            check_output(trial.path, target, options.overwrite)
            whole = formats.read(trial.path, vertical=axis)
            report_warnings(whole, batch)
            # without a set, every name of the file is held against the others
            names = MarkerSet(with_names(trial.path, named_markers(whole))) if marker_set is None else marker_set
            audited, columns = _audited(trial.path, whole, names)
            files.append(_File(trial.path, target, whole, audited, columns))
    if not files:
        raise AsterismError("none of the files can be used; the reasons are above.")
    return files


def _audited(path: Path, whole: Recording, markers: MarkerSet) -> tuple[Recording, dict[str, int]]:
    """The markers of a set that a file has, and the column of each. Raises AsterismError where it has none, or two have one name."""
    from asterism.formats import wanted_columns

    columns, names = wanted_columns(path, whole.labels, markers)
    there = {name: int(column) for name, column in zip(names, columns, strict=True) if column >= 0}
    return replace(whole, positions=whole.positions[:, list(there.values())], labels=tuple(there), origin=None, source=None), there


def _mended(file: _File, errors: Sequence[LabelError], batch: _console.Batch) -> Recording:
    """The audited markers with the labels put right; a file in which a label was wrong is written."""
    from asterism import __version__, formats
    from asterism.cli._recordings import not_carried
    from asterism.labelling.audit import mend_errors

    # in the whole file, so that everything else in it stays as it is
    result, mended = mend_errors(file.whole, errors, file.columns)
    if not mended:
        return file.audited
    file.target.parent.mkdir(parents=True, exist_ok=True)
    logged = result.logged("mended", f"asterism {__version__}", errors=[error.description for error in mended])
    for finding in not_carried(file.target, formats.write(file.target, logged)):
        batch.found(finding)
    positions = file.audited.positions.copy()
    # the second audit looks at the same markers as the first
    for place, name in enumerate(file.audited.labels):
        positions[:, place] = result.positions[:, file.columns[name]]
    return replace(file.audited, positions=positions)
