"""What `asterism review` is asked to do: shared by its table, its page and its answers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from asterism.cli._options import (
    Files,
    FrameWise,
    Json,
    KnownLabelsOption,
    Models,
    NoStatic,
    Overwrite,
    Report,
    Subjects,
    Vertical,
    Workers,
    WornSets,
)


@dataclass(frozen=True)
class ReviewOptions:
    """What `asterism review` is asked to do."""

    files: Files
    model: Models = None
    markers: WornSets = None
    top: Annotated[int, typer.Option("--top", metavar="N", min=1, help="How many lines to list, of all files together.")] = 20
    keep_labels: Annotated[
        bool, typer.Option("--keep-labels", help="Take labels that a file already has as right; review only the others.")
    ] = False
    known_labels: KnownLabelsOption = None
    frame_wise: FrameWise = False
    subject: Subjects = None
    no_static: NoStatic = False
    workers: Workers = 1
    vertical: Vertical = None
    overwrite: Overwrite = False
    report: Report = None
    json: Json = None
    csv: Annotated[
        Path | None,
        typer.Option("--csv", metavar="FILE", help="Write the list as a table with an empty column `answer`.", show_default=False),
    ] = None
    answers: Annotated[
        Path | None,
        typer.Option("--answers", metavar="FILE", help="Correct the files by that table, filled in; needs -o.", show_default=False),
    ] = None
    serve: Annotated[bool, typer.Option("--serve", help="Open a page in the browser on which the labels are corrected.")] = False
    by_hand: Annotated[
        bool, typer.Option("--by-hand", help="Page: name groups of points by clicking, without any model; else where no set fits.")
    ] = False
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FOLDER", help="Where corrected files go. Page: else `corrected`.", show_default=False),
    ] = None
    log_folder: Annotated[
        Path | None,
        typer.Option("--log-folder", metavar="FOLDER", help="Where the page's logs go, else beside the files.", show_default=False),
    ] = None
    port: Annotated[int, typer.Option("--port", metavar="N", min=0, max=65535, help="Port of the page; 0 for a free one.")] = 0
    host: Annotated[
        str, typer.Option("--host", metavar="ADDRESS", help="Address of this machine that serves the page; 0.0.0.0 lets a tablet in.")
    ] = "127.0.0.1"
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the page's address only.")] = False
