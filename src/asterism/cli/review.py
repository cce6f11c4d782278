"""`asterism review`: files in; what a person should look at first, as a table, a page and JSON, out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._options import Files, FrameWise, Json, Model, Overwrite, Report, Vertical, Workers, vertical_axis

if TYPE_CHECKING:
    from asterism.labelling import Item
    from asterism.recording import Clouds, Labelling, Recording


def review(
    files: Files,
    model: Model,
    top: Annotated[int, typer.Option("--top", metavar="N", min=1, help="How many lines to list, of all files together.")] = 20,
    keep_labels: Annotated[
        bool, typer.Option("--keep-labels", help="Labels that a file has already are right; only the others are in doubt.")
    ] = False,
    frame_wise: FrameWise = False,
    workers: Workers = 1,
    vertical: Vertical = None,
    overwrite: Overwrite = False,
    report: Report = None,
    json: Json = None,
) -> None:
    """List what a person should look at first.

    The files are labelled as `asterism label` does it, whatever names their points have now, and nothing is written to them. A line is
    a piece of a track between two gaps: saying once which marker it is settles all its frames. The gain is how many of its samples are
    probably wrong or missing; the list begins where a look mends most.
    """
    from asterism import formats
    from asterism.cli._recordings import labels_kept
    from asterism.labelling import SolverEnsemble
    from asterism.labelling import review as review_labelling

    _console.check_new(report, overwrite)
    _console.check_new(json, overwrite)
    axis = vertical_axis(vertical)
    ensemble = SolverEnsemble.load(model)
    batch = _console.Batch("reviewed")
    listed: list[_Listed] = []
    pieces, gain = 0, 0.0
    with _console.progress("labelling") as progress:
        for path in files:
            with batch.file(path):
                if progress:
                    progress((len(batch.done) + len(batch.failed)) / len(files), path.name)
                recording = formats.read(path, vertical=axis)
                clouds = recording.clouds()
                labelling = ensemble.label(clouds, time=not frame_wise, workers=workers)
                if keep_labels:
                    labelling = labels_kept(path, labelling, recording, clouds, ensemble.marker_set)
                items = review_labelling(labelling, clouds)
                pieces, gain = pieces + len(items), gain + sum(item.gain for item in items)
                listed += [_Listed(path, item, recording, labelling, clouds) for item in items[:top]]
                listed = sorted(listed, key=lambda entry: -entry.item.gain)[:top]
    if json != "-" and batch.done:
        _print(listed, pieces, gain)
    if report is not None:
        from asterism.report import review_report

        review_report(
            report,
            [(str(entry.path), entry.item) for entry in listed],
            {str(entry.path): (entry.labelling, entry.clouds) for entry in listed},
            first_frames={str(entry.path): entry.first for entry in listed},
            totals=(pieces, gain),
            model_info={"model": str(model), "files": len(batch.done), "keep_labels": keep_labels, **ensemble.about},
            marker_set=ensemble.marker_set,
        )
    _console.write_json(
        json,
        {
            "command": "review",
            "model": model,
            "keep_labels": keep_labels,
            "frame_wise": frame_wise,
            "files": batch.done,
            "failed": batch.failed,
            "pieces": pieces,
            "gain": gain,
            "items": [_as_json(entry) for entry in listed],
        },
    )
    raise typer.Exit(batch.close())


@dataclass(frozen=True)
class _Listed:
    """An item and where it is from."""

    path: Path
    item: Item
    recording: Recording
    labelling: Labelling
    clouds: Clouds

    @property
    def first(self) -> int:
        """The number that the file gives its first frame."""

        return self.recording.first_frame

    @property
    def column(self) -> str:
        """The name that the piece's points have in the file."""
        column = int(self.clouds.columns[self.item.points[0]])
        return self.recording.labels[column] if column >= 0 else ""


def _print(listed: list[_Listed], pieces: int, gain: float) -> None:
    from asterism.report.review import perhaps, said

    rows = [
        [
            str(e.path),
            e.column,
            said(e.item),
            perhaps(e.item),
            f"{e.item.first_frame + e.first} to {e.item.last_frame + e.first}",
            str(e.item.frame + e.first),
            _console.count(e.item.samples),
            f"{e.item.gain:.1f}",
        ]
        for e in listed
    ]
    if rows:
        _console.table("Look at these first", ["file", "point", "said", "perhaps", "frames", "look at", "samples", "gain"], rows, left=4)
    shown = sum(entry.item.gain for entry in listed)
    _console.result(
        f"{pieces:,} pieces of tracks in doubt, {gain:,.1f} samples probably wrong or missing; the {len(listed)} listed hold {shown:,.1f}."
        if pieces
        else "Nothing is in doubt."
    )


def _as_json(entry: _Listed) -> dict[str, Any]:
    item = entry.item
    return {
        "file": entry.path,
        "point": entry.column,
        "first_frame": item.first_frame + entry.first,
        "last_frame": item.last_frame + entry.first,
        "look_at": item.frame + entry.first,
        "marker": item.marker,
        "confidence": item.confidence,
        "perhaps": [{"marker": name, "chance": chance} for name, chance in item.perhaps],
        "samples": item.samples,
        "gain": item.gain,
    }
