"""`asterism review`: files in; the pieces of tracks to look at first, as a table, a page and JSON, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._folders import recordings_of
from asterism.cli._labelling import check_labelling, file_labeller, labelled_line, labelled_row, model_json, model_text
from asterism.cli._review_options import ReviewOptions
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.report import ReviewEntry
    from asterism.session import LabelledFile


@takes(ReviewOptions)
def review(options: ReviewOptions) -> None:
    """List the pieces of tracks to look at, or correct them.

    The files are labelled as `asterism label` does it, with the same options: without --model, by virtual people. Nothing is written to
    them. A line is a piece of a track between two gaps: one name for it corrects all its frames. The gain is the expected number of its
    samples whose label is wrong or missing. The list begins where a look corrects most, and ends where none is worth it.

    With --serve a page opens on which each answer is taken at once, labels the rest again and is kept in a log beside the file. It shows
    gaps that can be filled, and gait events that can be moved, too; where no marker set fits, groups of points are named by clicking.
    Without a browser, --csv writes the list as a table; with the answers filled in, --answers corrects the files.
    """
    _check(options)
    if options.serve:
        from asterism.cli._review_page import serve_page

        serve_page(options)
    elif options.answers is not None:
        from asterism.cli._review_answers import correct_by_answers

        raise typer.Exit(correct_by_answers(options))
    else:
        raise typer.Exit(_listed(options))


def _check(options: ReviewOptions) -> None:
    """Raise AsterismError where options contradict each other, or an output cannot be made."""
    check_labelling(options)
    correcting = "--serve" if options.serve else "--answers" if options.answers is not None else "--csv" if options.csv is not None else ""
    if options.serve and (options.answers is not None or options.csv is not None):
        raise AsterismError("--serve takes the answers on its page; leave out --csv and --answers.")
    if options.answers is not None and options.csv is not None:
        raise AsterismError("--answers takes a table that an earlier run wrote; leave out --csv.")
    if options.by_hand and (not options.serve or options.model):
        raise AsterismError("--by-hand names groups of points on the page of --serve, without a model; leave out --by-hand, or --model.")
    # a correction labels tracks again, which single frames do not have
    if correcting and options.frame_wise:
        raise AsterismError(f"{correcting} corrects whole recordings by the model; leave out --frame-wise.")
    if correcting in ("--serve", "--answers") and (options.report is not None or options.json is not None):
        raise AsterismError(f"{correcting} writes no list; leave out --report and --json.")
    if options.answers is not None and options.output is None:
        raise AsterismError("--answers writes corrected files; say where with -o FOLDER.")
    # before the work of minutes, not after it
    for path in (options.report, options.json, options.csv):
        _console.check_new(path, options.overwrite)


def _listed(options: ReviewOptions) -> int:
    """List what to look at; returns the exit status."""
    batch, found = _console.Batch("reviewed"), _Review()
    files = recordings_of(options.files, batch)
    labeller = file_labeller(options, files, batch)
    with _console.progress("labelling") as progress:
        for path in files:
            with batch.file(path):
                if progress:
                    progress((len(batch.done) + len(batch.failed)) / len(files), path.name)
                _add(found, labeller.label(path), options, batch)
    if options.json != "-" and batch.done:
        _print(found)
    if options.report is not None:
        from asterism.report import review_report

        review_report(
            options.report,
            [line.entry for line in found.lines],
            totals=(found.pieces, found.gain),
            model_info={
                "model": model_text(options),
                "files": len(batch.done),
                "keep_labels": options.keep_labels,
                **labeller.about,
            },
            marker_set=labeller.marker_set,
        )
    _console.write_json(
        options.json,
        {
            "command": "review",
            "model": model_json(options),
            "keep_labels": options.keep_labels,
            "frame_wise": options.frame_wise,
            "files": found.rows,
            "failed": batch.failed,
            "findings": [finding.to_dict() for finding in batch.findings],
            "pieces": found.pieces,
            "gain": found.gain,
            "items": [_as_json(line) for line in found.lines],
        },
    )
    if options.csv is not None:
        from asterism.files.atomic import write_atomically
        from asterism.labelling.correction import table_text

        write_atomically(options.csv, table_text([line.question for line in found.lines]).encode())
    return batch.close()


@dataclass(frozen=True)
class _Line:
    """A line of the list: the item, the name that its points have in the file, and, with --csv, its line of the table."""

    point: str
    entry: ReviewEntry
    question: Sequence[str] = ()


@dataclass
class _Review:
    """What was found in all files: a row of each, how many pieces to look at, how many samples they gain, and the lines that gain most."""

    rows: list[dict[str, Any]] = field(default_factory=list)
    pieces: int = 0
    gain: float = 0.0
    lines: Sequence[_Line] = field(default_factory=tuple)


def _add(found: _Review, labelled: LabelledFile, options: ReviewOptions, batch: _console.Batch) -> None:
    """Add what there is to look at in a file."""
    from asterism.report import ReviewEntry

    for finding in labelled.findings:
        batch.found(finding)
    path, recording, clouds, labelling, correction = labelled.path, labelled.about, labelled.clouds, labelled.labelling, None
    items = labelled.to_look_at
    if options.csv is not None:
        from asterism.labelling.correction import question_row

        correction = labelled.correction()
        items = correction.to_look_at()
    found.rows.append(labelled_row(labelled))
    found.pieces += len(items)
    found.gain += sum(item.gain for item in items)
    lines = list(found.lines)
    for item in items[: options.top]:
        # the name that the file gives the piece, by which a person finds it elsewhere
        column = int(clouds.columns[item.points[0]])
        point = recording.labels[column] if column >= 0 else ""
        question = question_row(str(path), correction, item) if correction is not None else ()
        lines.append(_Line(point, ReviewEntry(str(path), item, labelling, clouds, recording.first_frame), question))
    # only what the list can show is kept: a folder of hours has millions of pieces
    found.lines = sorted(lines, key=lambda line: -line.entry.item.gain)[: options.top]


def _print(found: _Review) -> None:
    from asterism.recording.display import counted
    from asterism.report.review import alternatives_text, label_text

    for row in found.rows:
        _console.result(labelled_line(row))
    entries = [line.entry for line in found.lines]
    rows = [
        [
            entry.file,
            line.point,
            label_text(entry.item),
            alternatives_text(entry.item),
            entry.frames,
            str(entry.frame),
            _console.count(entry.item.samples),
            f"{entry.item.gain:.1f}",
        ]
        for line, entry in zip(found.lines, entries, strict=True)
    ]
    if rows:
        columns = ["file", "point", "label", "alternatives", "frames", "look at", "samples", "gain"]
        _console.table("Pieces of tracks to look at first", columns, rows, left=4)
    listed = sum(entry.item.gain for entry in entries)
    _console.result(
        f"{counted(found.pieces, 'piece')} of tracks to look at, with {found.gain:,.1f} samples expected to be wrong or missing; "
        f"{listed:,.1f} of these are in the {counted(len(rows), 'piece')} listed."
        if found.pieces
        else "No piece of a track stands out."
    )


def _as_json(line: _Line) -> dict[str, Any]:
    entry, item = line.entry, line.entry.item
    return {
        "file": entry.file,
        "point": line.point,
        "first_frame": item.first_frame + entry.first_frame,
        "last_frame": item.last_frame + entry.first_frame,
        "look_at": entry.frame,
        "marker": item.marker,
        "confidence": item.confidence,
        "alternatives": [{"marker": name, "chance": chance} for name, chance in item.alternatives],
        "samples": item.samples,
        "gain": item.gain,
    }
