"""`asterism learn`: a model and corrected files in, a model that has learned them out."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from asterism.cli import _console
from asterism.cli._folders import recordings_of
from asterism.cli._options import Json, Overwrite, SubjectName, Vertical
from asterism.cli.audit import LEARNED_AS_NAMED, as_numbered
from asterism.errors import AsterismError
from asterism.findings import exit_status


def learn(
    given: Annotated[
        list[Path],
        typer.Argument(
            metavar="[MODEL] FILES",
            help="The model to start from, else one of virtual people who wear the marker set; corrected recordings, points labelled.",
            show_default=False,
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The model to write.", show_default=False)],
    markers: Annotated[
        str | None,
        typer.Option(
            "--markers",
            metavar="SET",
            help="Without a model, the set worn: a shipped one, a TOML file, or names with commas. Else the names of the files tell it.",
            show_default=False,
        ),
    ] = None,
    subject: SubjectName = None,
    search_again: Annotated[bool, typer.Option("--search-again", help="Search the partial solvers anew, too; takes minutes.")] = False,
    vertical: Vertical = None,
    overwrite: Overwrite = False,
    json: Json = None,
) -> None:
    """Teach a model corrected recordings, in seconds to a minute.

    A model carries what it needs of its training, so the old files are not needed. With --overwrite the output may be the model itself.
    Without a model, learning starts from virtual people, as `asterism label` labels by them.
    A file that cannot be read stops the learning before it starts, and is named. Where it is known where the markers sit, names that are
    exchanged throughout a file are told, and the exit status is then 1.
    """
    from asterism import formats
    from asterism.cli._labelling import model_or_virtual
    from asterism.cli._recordings import read_people, report_coincident
    from asterism.labelling import check_names
    from asterism.session.people import people_in

    # a model may be called anything
    recordings_only = formats.is_recording_file(given[0]) or given[0].is_dir()
    model, files = (None, given) if recordings_only else (given[0], given[1:])
    if not files:
        raise AsterismError(f"{model} has nothing to learn from; give corrected recordings after it.")
    _console.check_new(output, overwrite)
    _console.check_new(json, overwrite)
    batch = _console.Batch("read")
    paths = recordings_of(files, batch)
    before, worn = model_or_virtual(model, markers, paths, vertical)
    # under the names of the model: what it does not know cannot be learned
    recordings = read_people(paths, before.marker_set, vertical, batch)
    report_coincident(recordings, batch)
    batch.tell_passed_over()
    # a model that has learned half of a session looks like one that has learned all of it
    if batch.failed:
        raise AsterismError(f"{len(batch.failed)} of {len(files)} files cannot be used, named above; correct them or leave them out.")
    subjects = None if subject is None else [subject] * len(recordings)
    named = [
        replace(as_numbered(error, recordings).finding, mend=LEARNED_AS_NAMED)
        for error in check_names(recordings, before.marker_set, subjects=subjects).errors
    ]
    for finding in named:
        batch.found(finding)
    started = time.perf_counter()
    with _console.progress("learning") as progress:
        after = before.learn(recordings, subjects=subjects, search_again=search_again, progress=progress)
    seconds = time.perf_counter() - started
    after.save(output)
    about = after.about
    # people tell more than recordings: the confidence is tried on them
    new_people = [name for name in about["subjects"] if name not in before.about["subjects"]]
    # a recording that the model has learned already counts once
    taught = sum(max(1, len(people_in(recording.labels, before.marker_set))) for recording in recordings)
    known = taught - (about["recordings"] - before.about["recordings"])
    if json != "-":
        from asterism.recording.display import counted

        virtual = f" and virtual people who wear {worn}" if worn else ""
        _console.result(
            f"{output}: {counted(about['recordings'], 'recording')} of {counted(len(about['subjects']), 'subject')} "
            f"({counted(about['frames'], 'frame')}){virtual}; learned {counted(len(recordings), 'recording')} in {seconds:.0f} s, "
            f"{counted(len(new_people), 'new subject')}{f', {known} known already' if known else ''}"
        )
    _console.write_json(
        json,
        {
            "command": "learn",
            "model": model,
            "marker_set": worn,
            "output": output,
            "files": files,
            "new_subjects": new_people,
            "known_already": known,
            **about,
            "findings": [finding.to_dict() for finding in batch.findings],
            "seconds": seconds,
        },
    )
    raise typer.Exit(exit_status(batch.findings))
